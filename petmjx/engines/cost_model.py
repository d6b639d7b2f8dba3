"""The cost model: expected steps and times of runs, for ``auto`` and for all estimates of time.

On a CPU thread, a step of a pallet at rest takes one iteration of Newton's method. The cost of a step grows somewhat
faster than the number of boxes. While boxes land or slide, a step takes more iterations. An iteration is expensive if
boxes stand on several other boxes, since this ties the columns of a pallet into one system of equations. So the
additional cost of a landing grows with the square of the number of standing boxes, and with the number of ties
(supports of a box beyond its first support). If each box stands on only one other, as in a block of columns, landings
cost next to nothing.

On a device, too, the cost of a step of a full stack grows with the square of the number of boxes. But a plan with more
boxes is at rest in a larger share of its steps, so the cost of a run grows more slowly. At the end of a run, and of
each round of a search, the device is nearly idle until the longest worlds end. In runs of a few hundred worlds, this
takes most of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.options.carriers import Carrier, walls_of
from petmjx.options.placing import Way
from petmjx.options.simulation import SOFT_START_STEPS, Check, Schedule, Simulation
from petmjx.world.job import Drive, Job

STEP_SHARE = 0.072
"""Steps of the adaptive schedule as a share of the fixed schedule's steps, for physics ``pallet``. The share is the
mean over 2,000 generated plans and 63 third-party plans of 16 to 241 boxes."""

SOFT_STARTS = 2 * SOFT_START_STEPS
"""Number of steps of the soft start (both halves), which comes before the first box of a placement. The schedule does
not include these steps."""

QUIET_STEPS = 220
"""Steps until a pallet is quiet with the adaptive schedule, if boxes are not placed one by one. Static checks of 45 to
241 boxes took 150 to 890 steps until the pallet was quiet."""

DRIVEN_QUIET_STEPS = 115
"""Steps after a profile until a pallet that stands is quiet. In drives of EUMOS's profile, pallets of 3 to 20 boxes
that stood took 315 to 324 steps, of which the profile has 200. Drives in which most pallets of 3 to 60 boxes fell took
160 to 610 steps on average."""

COST_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.36}
"""The cost of a schedule on a device as a share of the fixed schedule's cost. On the same machine, 10,003 plans with
the adaptive schedule took 17 s, and 4,000 plans with the fixed schedule took 21 s. The adaptive schedule leaves out
cheap steps, in which all boxes are at rest. In the remaining steps, boxes move and pallets collapse."""

JAX_POWER, WARP_POWER = 2.0, 1.0
"""Over whole runs, the cost of a step grows with the number of boxes to the power ``JAX_POWER`` on ``mjx-jax``, and to
the power ``WARP_POWER`` on ``mjx-warp``, where steps at rest are cheap and plans with more boxes are at rest in a
larger share of their steps. While n boxes are placed one by one, the cost of a step on ``mjx-warp`` is the mean of the
costs with 1, 2, …, n boxes: about 1 / (``WARP_POWER`` + 1) of the cost with n boxes. On ``mjx-jax``, all boxes are in
the model from the beginning, so every step has the full cost."""

SHAKEN_FACTOR = 2.5
"""Cost of a step of a drive on a device, relative to a step of the same pallet with the fixed schedule. Measured on an
H200: 735 to 786 drives of EUMOS per second, in a run of 6,400 drives that did not end when the pallet was quiet."""

FALLING_FACTOR = 4.0
"""Cost of a step of a fall on a device, relative to a step of the same boxes with the fixed schedule. On an H200, 300
plans of 24 boxes that fall took 4 s."""

DRIVE_TAIL_STEPS = 1150
"""The longest drives of a run on a device take as long as if the mean drive had this number of steps and ended like a
placement, whatever the length of the profile: after some drives, boxes creep for a long time."""

TAIL_WORLDS = 5
"""The longest of n worlds on a device takes ``Costs.gpu_tail_s`` · ln(1 + n / ``TAIL_WORLDS``) per unit of the mean
world's work: lengths of worlds have an exponential tail, so the longest of n worlds grows with the logarithm of n."""

REST_POWER = 1.25
"""The cost of a step at rest on a CPU thread grows with this power of the number of standing boxes."""

TYPICAL_TIES = 0.5
"""Assumed number of supports of a box beyond its first support, as a mean over the boxes of a plan, if the plan is
unknown. The mean is 0.24 to 1.3 in 62 third-party plans of 45 to 241 boxes. In most generated plans, the mean is 0.1 or
less, since their boxes have many different heights."""

SHAKEN_STEPS = 700
"""A drive is expected to have at most this number of steps in which boxes slide or fall. EUMOS's profile has fewer
steps than this number. A profile that tilts the carrier has 2,970 steps, and boxes are at rest in most of them. A drive
that shakes boxes for many seconds takes up to ten times as long as expected."""

STEADY_G, CREEPING = 0.35, 2.0
"""A drive with a horizontal acceleration above ``STEADY_G``, in units of 9.81 m/s², is expected to make unstable
pallets fall soon. After a drive with a smaller acceleration, boxes may creep for a long time. So a weaker drive is
expected to take ``CREEPING`` times as many steps, and is begun earlier. Measured on EUMOS's 4,032 drives of 100 plans:
strong drives take 336 steps on average and at most 1,149; weak drives take 570 steps on average and at most 6,088."""

GENTLE_COST = 0.25
"""Additional cost of a step of a drive with an acceleration of at most ``STEADY_G``, relative to a stronger drive: in
most of its steps, boxes neither slide nor fall. On ``mujoco``, this factor was 0.1 to 0.25 for 10 to 45 boxes in
EUMOS's profile of 0.1 to 0.3 g, relative to 0.4 to 0.8 g."""


FALL_STEPS = 1350
"""Number of steps of a fall while boxes are placed one by one: from the first box that tips over to the drop that ends
the world. The 22 plans of two shelf packers, which all fall, take 1,730 to 1,910 steps on average. In about 450 of
these steps, boxes are placed."""

STATIC_FALL_STEPS = 400
"""Number of steps of a static check in which boxes fall, until one has dropped and the world ends. If a static check
has fewer steps, boxes are expected to fall in all its steps. 17 plans with loose boxes took 200 to 600 steps on
``mujoco``."""

FALL_BOXES = 7
"""Number of boxes that are placed during the ``FALL_STEPS`` steps of a fall, in the plans of the two shelf packers."""

STATIC_FALL_BOXES = 12
"""A fall in a static check of n boxes costs n / ``STATIC_FALL_BOXES`` times as much as a fall while boxes are placed
one by one, since all boxes may fall. Static checks of plans of 24 boxes took 1 to 1.4 times as long as
placing the boxes one by one, and those of generated plans of 41 boxes 1.6 to 5 times as long."""

LOST = 0.5
"""Number of steps of a fall in a placement with errors, relative to a fall in a placement without errors. The cost of
the fall decreases by the same factor. A world with errors ends when a box has tilted too far, before the box drops."""

BOARDS_COST = 1.35
"""Cost of a step on a carrier of boards, or between walls, relative to a slab. The measured cost was 1.2 to 1.7 for
scores, drives and searches of 5 to 60 boxes on epal-1 and gma-48x40, and in a gitterbox."""

FEWEST_WALLS = 2
"""Smallest number of walls that make steps more expensive. A trailer's headboard, a single wall, costs nothing at
first: a load touches the headboard only after sliding."""

REFERENCE_STEPS = 2.8
"""Number of steps of a placement with the physics ``reference``, relative to the physics ``pallet``, with the adaptive
schedule."""

WAY_STEPS = {Way.DROP: 3.1, Way.HAND: 4.0, Way.TINES: 7.0}
"""Number of steps of a placement whose boxes fall or are carried to their places, relative to a placement whose boxes
appear at their places. Measurements with plans of 14 and of 40 boxes agree within a tenth. Placements by hand take
0.285 times as many steps as the fixed schedule: 0.45 times with few boxes, and 0.24 times with many."""

DISPLACED_STEPS, CARRIED_STEPS = 1.1, 5.0
"""Number of steps of a placement with errors of places or sizes, relative to a placement whose boxes appear exactly at
their places. ``DISPLACED_STEPS`` is for boxes that appear at places with errors; boxes that would overlap are moved
apart first. ``CARRIED_STEPS`` is for boxes that are carried to their places, and get stuck at their neighbours."""

FAILING_BOXES = 0.008
"""Chance of a box that is carried to its place with errors to fail, which ends the world. Of 80 worlds with errors of
20 plans of 18 to 71 boxes, about 26 failed; of ten worlds of two plans of 146 and 238 boxes, six failed."""

FAILING_POWER = 2.5
"""The time of a world with errors grows with this power of the share of boxes that are placed before one fails: the
number of steps grows with the share, and the time of a step with the number of standing boxes."""

DRIVEN_SWAY = 4.0
"""Number of additional steps of a drive of compliant boxes, relative to those of one placement: a drive makes a pile
sway further. Columns of 18 boxes of 50 N/mm took 470 additional steps in EUMOS's profile, and 30 in a placement."""

FALLING_SWAY_MM = 50.0
"""A pile of compliant boxes is expected to fall when its ``Work.sway_mm`` has reached this value. While boxes are
placed, the sway grows with the cube of the height."""

GIVING_STEPS, SWAY_STEPS, SWAY_MM, MOST_SWAY_STEPS = 9.0, 13.0, 15.0, 250.0
"""A pile of compliant boxes sways after each placement. If ``Work.sway_mm`` is w, the pile comes to rest after
``GIVING_STEPS`` + ``SWAY_STEPS`` · √w · (1 + w / ``SWAY_MM``) additional steps, at most after ``MOST_SWAY_STEPS``
additional steps. The period of a mass on springs that it compresses by s is 2π·√(s/g), so the number of steps grows
with the square root of w. A pile that sways by more than ``SWAY_MM`` is close to falling, and comes to rest more
slowly; a pile that sways much more falls before all boxes are placed. The numbers were fitted to 12 generated plans of
10 to 73 boxes, each with 11 stiffnesses of 10 to 20,000 N/mm."""


DISPLACED_COST, CARRIED_COST = 2.8, 4.5
"""Cost of a placement with errors on a device, relative to a placement without errors. ``DISPLACED_COST`` is for boxes
that appear at places with errors, and may slip into gaps between other boxes. ``CARRIED_COST`` is for boxes that are
carried to their places. On one GPU, 8,000 worlds with errors (of 500 plans) took 35 s if boxes appeared, 4,000 worlds
with errors (of 250 plans) took 30 s if boxes were carried by hand, and 10,003 worlds without errors took 17 s."""


_SHARES = 50
"""Number of shares of placed boxes over which ``Work.share_before_failure`` sums."""

LONG_PLACEMENT, LONG_DRIVE = 3.0, 2.5
"""A world is long if its placement takes more than ``LONG_PLACEMENT`` times as many steps as a placement whose boxes
stand, or its drive more than ``LONG_DRIVE`` times the expected steps, not counting the rest window. A placement of
fewer than ``FALL_STEPS`` steps is never long. So worlds of few boxes that fall are not long, although they take 400 to
650 steps, while worlds of few boxes that stand take only 165 to 210."""


def rest_steps(sim: Simulation, rest_s: float, quiet_steps: int = DRIVEN_QUIET_STEPS) -> int:
    """Expected number of steps after a profile until the pallet is quiet.

    Args:
        rest_s: the longest time to come to rest, s.
        quiet_steps: number of steps until the pallet is quiet with the adaptive schedule.
    """
    most = seconds_to_steps(rest_s, sim.physics.timestep_s)
    return min(most, quiet_steps) if sim.schedule is Schedule.ADAPTIVE else most


def expected_drive_steps(drive: Drive, sim: Simulation) -> float:
    """Number of steps of one drive, from which its order in a run and ``Costs.long_steps`` are computed. The number is
    larger than the mean, so that few drives count as long."""
    steps = rest_steps(sim, drive.rest_s, QUIET_STEPS) + len(drive.excitation.samples)
    peak_g = abs(drive.scale) * drive.excitation.peak_g
    return CREEPING * steps if sim.schedule is Schedule.ADAPTIVE and peak_g <= STEADY_G else steps


@dataclass(frozen=True)
class WayOfPlacing:
    """How boxes are placed.

    Attributes:
        steps: number of steps of the placement, relative to boxes that appear exactly at their places.
        has_errors: whether places or sizes have errors.
        is_carried: whether a hand or tines carry the boxes.
    """

    steps: float
    has_errors: bool = False
    is_carried: bool = False

    @property
    def falls(self) -> float:
        """Cost of a fall with this way of placing, relative to a fall in a placement without errors."""
        return LOST if self.has_errors else 1.0


@dataclass(frozen=True, eq=False)
class Work:
    """The work of a run: placements, and drives from their settled states.

    Attributes:
        sim: the options; their check and schedule determine how many steps a placement has.
        boxes: number of boxes of each plan.
        placements, drives: number of placements and of drives of each plan.
        displaced: number of placements in which boxes appear at places with errors, or with changed sizes.
        carried: number of placements with errors of places or sizes in which boxes are carried to their places.
        drive_steps: steps of one drive, including ``rest_steps``; the mean over profiles.
        rounds: number of drives of a pallet that follow one another, since the results of earlier drives decide on
            them: the rounds of a search, or the legs of a chain.
        filmed: share of the steps of drives in which pallets are wrapped in film, 0 to 1: one value for all plans, or
            one for each plan.
        gentle: share of the steps of drives whose largest horizontal acceleration is at most ``STEADY_G``, 0 to 1, as
            ``filmed``. Vertical accelerations do not count. Drives with random vibrations are not gentle.
        giving: number of compliant boxes of each plan; empty if no plan has compliant boxes.
        sway_mm: how far a pile of each plan's compliant boxes sways, mm (petmjx.plans.plan_statics); empty if no plan
            has compliant boxes.
        ties: for each plan, the mean number of supports that a box has in addition to its first support
            (petmjx.plans.plan_statics); if ``ties`` is empty, ``TYPICAL_TIES`` is used.
        placed_share: for each plan, the share of its boxes that are placed before the first box that tips over at once
            (petmjx.plans.plan_statics); 1 without such a box. If ``placed_share`` is empty, the share is unknown, and
            no box is expected to tip over.
        driven_share: for each plan, the share of its drives' steps that are expected to be simulated, 0 to 1. Legs
            after the leg in which the pallet probably falls are not simulated. If ``driven_share`` is empty, all drives
            are simulated.
    """

    sim: Simulation
    boxes: Sequence[int]
    placements: int = 1
    displaced: int = 0
    carried: int = 0
    drives: int = 0
    drive_steps: float = 0.0
    rounds: int = 1
    filmed: float | Sequence[float] | FloatArray = 0.0
    gentle: float | Sequence[float] | FloatArray = 0.0
    giving: Sequence[float] | FloatArray = ()
    ties: Sequence[float] | FloatArray = ()
    placed_share: Sequence[float] | FloatArray = ()
    sway_mm: Sequence[float] | FloatArray = ()
    driven_share: Sequence[float] | FloatArray = ()

    @property
    def share(self) -> FloatArray:
        """(n,) share of the boxes of each plan that are placed before the world ends."""
        one_by_one = self.sim.check is Check.ONE_BY_ONE
        placed = np.asarray(self.placed_share, dtype=float) if self._falls.any() and one_by_one else 1.0
        if len(self.sway_mm) and self.sim.early_stop and one_by_one:
            sway_mm = np.where(self.compliant > 0, np.asarray(self.sway_mm, dtype=float), 0.0)
            placed = placed * np.minimum(1.0, (FALLING_SWAY_MM / np.maximum(sway_mm, 1e-9)) ** (1 / 3))
        return np.broadcast_to(placed, len(self.boxes))

    @property
    def _falls(self) -> NDArray[np.bool_]:
        """(n,) whether a box of each plan is expected to tip over, which ends the world."""
        has_shares = len(self.placed_share) > 0 and self.sim.early_stop
        return np.asarray(self.placed_share, dtype=float) < 1.0 if has_shares else np.zeros(len(self.boxes), dtype=bool)

    @property
    def fall_steps(self) -> FloatArray:
        """(n,) number of steps in which boxes fall before the world ends."""
        if self.sim.check is Check.ONE_BY_ONE:
            return np.where(self._falls, float(FALL_STEPS), 0.0)
        return np.where(self._falls, np.minimum(self.fixed_steps, STATIC_FALL_STEPS), 0.0)

    @property
    def shaken(self) -> FloatArray:
        """(n,) expected number of drives of each plan that are simulated. A pallet that does not stand is not
        shaken."""
        share = np.asarray(self.driven_share, dtype=float) if len(self.driven_share) else 1.0
        carried = self.ways[2]
        stand = np.where(self._ends_with_failure(carried), np.exp(-FAILING_BOXES * np.asarray(self.boxes)), 1.0)
        stand = (self.placements - self.carried * (1 - stand)) / max(self.placements, 1)
        return np.where(self._falls, 0.0, self.drives * share * stand)

    def _ends_with_failure(self, way: WayOfPlacing) -> bool:
        """Whether a world ends when one of its boxes, which are placed in this way, fails because of errors."""
        one_by_one = self.sim.check is Check.ONE_BY_ONE
        return way.has_errors and way.is_carried and self.sim.early_stop and one_by_one

    @property
    def planned(self) -> int:
        """Number of placements without errors."""
        return self.placements - self.displaced - self.carried

    @property
    def coupling(self) -> FloatArray:
        """(n,) how strongly the boxes of each plan are tied together, about 0 to 1. The more strongly boxes are tied
        together, the more computing time a landing takes. The result is the square root of ``ties``: of the powers of
        ``ties`` that were tried, the square root agrees best with measured times."""
        return np.sqrt(self.ties if len(self.ties) else np.full(len(self.boxes), TYPICAL_TIES))

    @property
    def compliant(self) -> FloatArray:
        """(n,) number of compliant boxes of each plan."""
        gives = len(self.giving) > 0 and self.sim.physics.has_own_friction
        return np.asarray(self.giving, dtype=float) if gives else np.zeros(len(self.boxes))

    @property
    def sway_steps(self) -> FloatArray:
        """(n,) number of steps in which a pile of compliant boxes comes to rest after a placement, in addition to the
        steps of a pile of rigid boxes."""
        if not len(self.sway_mm) or self.sim.schedule is Schedule.FIXED:
            return np.zeros(len(self.boxes))
        sway_mm = np.asarray(self.sway_mm, dtype=float)
        steps = GIVING_STEPS + SWAY_STEPS * np.sqrt(sway_mm) * (1 + sway_mm / SWAY_MM)
        return np.where(self.compliant > 0, np.minimum(steps, MOST_SWAY_STEPS), 0.0)

    @property
    def on_boards(self) -> bool:
        """Whether boxes may touch boards, or walls on several sides."""
        slabs = (Carrier.FOOTPRINT, Carrier.EURO_PALLET, Carrier.ROLLCONTAINER, Carrier.TRAILER)
        sides = walls_of(self.sim.carrier, self.sim.walls).sides or ()
        return self.sim.carrier not in slabs or len(sides) >= FEWEST_WALLS

    @property
    def fixed_steps(self) -> FloatArray:
        """(n,) steps of one placement of each plan with the fixed schedule, including the time to settle before a
        drive."""
        sim, boxes = self.sim, np.asarray(self.boxes)
        one_by_one = sim.check is Check.ONE_BY_ONE
        if self.drives:
            seconds = (boxes * sim.interval_s if one_by_one else 0.0 * boxes) + sim.settle_s
        else:
            seconds = (boxes + 1) * sim.interval_s if one_by_one else 0.0 * boxes + sim.duration_s
        return np.trunc(seconds / sim.physics.timestep_s)  # as ``seconds_to_steps``, for all plans at once

    @property
    def steps(self) -> FloatArray:
        """(n,) expected number of steps of each plan, including soft starts."""
        ways = zip((self.planned, self.displaced, self.carried), self.ways, strict=True)
        placing = sum(
            (count * self.share_before_failure(way) * self.placement_steps(way) for count, way in ways),
            np.zeros(len(self.boxes)),
        )
        return (
            self.placements * SOFT_STARTS + placing + self.shaken * (self.drive_steps + DRIVEN_SWAY * self.sway_steps)
        )

    @property
    def ways(self) -> tuple[WayOfPlacing, WayOfPlacing, WayOfPlacing]:
        """Three ways of placing: boxes appear or are carried without errors; boxes appear at places with errors; boxes
        are carried to places with errors.
        """
        name = self.sim.placing.name
        drop = WAY_STEPS[Way.DROP] if name is Way.DROP else 1.0
        tines = WAY_STEPS[Way.TINES] / WAY_STEPS[Way.HAND] if name is Way.TINES else 1.0
        return (
            WayOfPlacing(WAY_STEPS.get(name, 1.0), is_carried=self.sim.placing.carries),
            WayOfPlacing(DISPLACED_STEPS * drop, has_errors=True),
            WayOfPlacing(CARRIED_STEPS * tines, has_errors=True, is_carried=True),
        )

    def placement_steps(self, way: WayOfPlacing) -> FloatArray:
        """(n,) expected number of steps of one placement of each plan in which no box fails because of errors, not
        counting the soft start."""
        return way.steps * self.share * self._placing_steps + way.falls * self.fall_steps

    def share_before_failure(self, way: WayOfPlacing, power: float = 1.0) -> FloatArray:
        """(n,) expected share of the boxes of each plan that are placed before a box fails because of errors. Each box
        fails with the chance ``FAILING_BOXES``, so the shares of worlds are distributed exponentially up to 1.

        Args:
            power: the result is the mean of this power of the share, to the power 1 / ``power``.
        """
        if not self._ends_with_failure(way):
            return np.ones(len(self.boxes))
        failures = FAILING_BOXES * np.asarray(self.boxes, dtype=float)[:, None]
        share = (np.arange(_SHARES) + 0.5) / _SHARES
        mean = (failures * np.exp(-failures * share) * share**power).mean(axis=1) + np.exp(-failures[:, 0])
        return np.asarray(mean ** (1 / power))

    @property
    def on_device(self) -> float:
        """Cost of all placements of a plan on a device, with and without errors. A cost of 1 is that of one placement
        of this plan in which boxes appear exactly at their places."""
        planned = CARRIED_COST if self.sim.placing.carries else 1.0
        return planned * self.planned + DISPLACED_COST * self.displaced + CARRIED_COST * self.carried

    @property
    def _placing_steps(self) -> FloatArray:
        """(n,) expected number of steps of one placement of each plan if boxes appear exactly at their places and
        stand. The soft start is not counted."""
        if self.sim.schedule is Schedule.FIXED:
            return self.fixed_steps
        if self.sim.check is Check.STATIC:
            return np.minimum(self.fixed_steps, QUIET_STEPS + self.sway_steps)
        share = STEP_SHARE * (REFERENCE_STEPS if self.sim.physics.falls_into_place else 1.0)
        return np.asarray(min(share, 1.0) * self.fixed_steps + self.sway_steps * np.asarray(self.boxes))

    def _placing(self, power: float, *, grows: bool) -> FloatArray:
        """(n,) cost of one placement on a device: the number of boxes to a power, times the number of steps. ``grows``:
        whether boxes that are not yet placed cost nothing.
        """
        share = 1 / (power + 1) if grows and self.sim.check is Check.ONE_BY_ONE else 1.0
        boxes = np.asarray(self.boxes, dtype=float)
        placed = self.share if grows else 1.0
        cost = share * COST_SHARE[self.sim.schedule] * (placed * boxes) ** power * placed * self.fixed_steps
        fallen = np.minimum(placed * boxes + FALL_BOXES, boxes)
        return np.asarray(cost + FALLING_FACTOR * fallen**power * self.fall_steps)

    def _driving(self, power: float, steps: FloatArray | float) -> FloatArray:
        """(n,) cost of a drive of each plan on a device: the number of boxes to a power, times the number of steps.
        ``steps``: number of steps of the drive.
        """
        return np.asarray(SHAKEN_FACTOR * np.asarray(self.boxes, dtype=float) ** power * steps)


@dataclass(frozen=True)
class ThreadCosts:
    """Measured costs of an engine on one CPU thread.

    Attributes:
        rest_s: time of a step of a world at rest, divided by (number of boxes) to the power ``REST_POWER``, s.
        overhead_s: additional time of any step, s.
        landing_s: additional time for one box to land, divided by the square of the number of standing boxes, s, if
            ``Work.coupling`` is 1.
        static_s: additional time for all boxes of a static check to land, divided by the square of their number, s, if
            ``Work.coupling`` is 1.
        shaken_s: additional time of each of the first ``SHAKEN_STEPS`` steps of a drive, s per box to the power
            ``shaken_power``.
        shaken_power: see ``shaken_s``. In the drives of 3 to 205 boxes that were measured on each engine, the power is
            2 on ``mujoco``, and 1.75 in the kernels.
        fall_s: additional time of a fall while boxes are placed one by one, until a box has dropped, s. The time of a
            fall hardly depends on the number of boxes. The time of a single fall varies from a tenth of this value to
            ten times this value.
        jammed: cost of a placement by hand with errors, in which boxes jam, relative to a placement without errors.
        hand_s: additional time of a step of a placement by hand, s.
        film_s: additional time of each of the first ``SHAKEN_STEPS`` steps of a drive in film, s per box.
        give_s: additional time of a step, s per compliant box.
        driven_s: additional time of a step of a drive, s, because forces on tops are summed in each step and contacts
            slide.
        board_s: additional time of a step of a placement on a carrier of boards, s per box, because all pairs of boxes
            and boards are checked.
    """

    rest_s: float
    overhead_s: float
    landing_s: float
    static_s: float
    shaken_s: float
    shaken_power: float
    fall_s: float
    jammed: float
    hand_s: float = 0.0
    film_s: float = 0.0
    give_s: float = 0.0
    driven_s: float = 0.0
    board_s: float = 0.0

    def slowed(self, factor: float) -> ThreadCosts:
        """The costs on a CPU thread that takes ``factor`` times as long."""
        times = {name: factor * value for name, value in vars(self).items() if name.endswith("_s")}
        return replace(self, **times)

    def seconds(self, work: Work, threads: int) -> float:
        """Expected time of a run whose worlds are divided among threads, s. The result is at least the time of the
        world that takes longest.
        """
        counts = (work.planned, work.displaced, work.carried)
        placing = [
            (count, self.placing_s(work, way, work.share_before_failure(way, FAILING_POWER)))
            for count, way in zip(counts, work.ways, strict=True)
            if count
        ]
        driving_s = self.driving_s(work)
        plans_s = sum((count * placing_s for count, placing_s in placing), work.shaken * driving_s)
        longest_s = np.max([placing_s for _, placing_s in placing], axis=0) + np.where(work.shaken > 0, driving_s, 0.0)
        return max(float(plans_s.sum()) / threads, float(longest_s.max()))

    def placing_s(
        self, work: Work, way: WayOfPlacing | None = None, placed_share: FloatArray | float = 1.0
    ) -> FloatArray:
        """(n,) time of one placement of each plan, s.

        Args:
            way: how boxes are placed. If ``way`` is None, boxes are placed as planned.
            placed_share: share of the boxes that are placed before a box fails because of errors
                (``Work.share_before_failure``). If the share is 1, no box fails.
        """
        way = way or work.ways[0]
        share = work.share * placed_share
        boxes = np.asarray(work.boxes, dtype=float) * share
        one_by_one = work.sim.check is Check.ONE_BY_ONE
        # if boxes are placed one by one, the number of standing boxes grows from 1 to n, so costs are sums over 1…n
        standing = 0.5 if one_by_one else 1.0
        step_s = self.rest_s * boxes**REST_POWER / (REST_POWER + 1 if one_by_one else 1) + self.overhead_s
        step_s = step_s + standing * self.give_s * work.compliant * share + self.hand_s * way.is_carried
        landings_s = self.landing_s * boxes**3 / 3 if one_by_one else self.static_s * boxes**2
        placed_s = step_s * (SOFT_STARTS + way.steps * share * work._placing_steps) + work.coupling * landings_s
        fallen = np.minimum(boxes + FALL_BOXES, np.asarray(work.boxes, dtype=float))
        fall_s = self.fall_s * (1.0 if one_by_one else boxes / STATIC_FALL_BOXES) * (work.fall_steps > 0)
        falling_s = way.falls * (work.fall_steps * (self.rest_s * fallen**REST_POWER + self.overhead_s) + fall_s)
        if way.has_errors:
            placed_s = placed_s * (self.jammed if way.is_carried else _displaced_cost(work.coupling))
        placing_s = placed_s + falling_s
        if work.on_boards:
            steps = SOFT_STARTS + placed_share * work.placement_steps(way)
            placing_s = BOARDS_COST * (placing_s + standing * self.board_s * steps * np.asarray(work.boxes))
        return np.asarray(placing_s)

    def driving_s(self, work: Work, steps: FloatArray | float | None = None) -> FloatArray:
        """(n,) time of one drive of each plan, s. ``steps``: number of steps of the drive; None: ``drive_steps`` and
        ``sway_steps``."""
        steps = work.drive_steps + DRIVEN_SWAY * work.sway_steps if steps is None else steps
        n = np.asarray(work.boxes, dtype=float)
        step_s = self.rest_s * n**REST_POWER + self.overhead_s + self.driven_s
        step_s = step_s + self.give_s * work.compliant
        strong = 1 - np.asarray(work.gentle) * (1 - GENTLE_COST)
        shaken_s = self.shaken_s * n**self.shaken_power + self.film_s * np.asarray(work.filmed) * n
        shaken_s = strong * shaken_s * np.minimum(steps, SHAKEN_STEPS)
        return np.asarray((step_s * steps + shaken_s) * (BOARDS_COST if work.on_boards else 1.0))


@dataclass(frozen=True)
class Costs:
    """Measured costs of the engines, as detailed as ``auto`` and estimates of time need them.

    Attributes:
        mujoco, kernel: costs of ``mujoco`` and of ``mjx-warp-cpu`` on one CPU thread.
        kernel_start_s: time to start ``mjx-warp-cpu``, including compilation, s.
        kernel_load_s: time to start ``mjx-warp-cpu`` if an earlier run has compiled the kernel, s.
        jax_step_s: time of a step of one world of n boxes on ``mjx-jax`` on a CPU, divided by n², s. On two cores, a
            world of 40 boxes takes 57 steps per second.
        gpu_step_s: time of a step of ``full_worlds`` worlds on a device, divided by (number of boxes) to the power
            ``WARP_POWER``, s.
        full_worlds: number of worlds that fill the device.
        gpu_tail_s: time for which the longest worlds of a phase of a run leave the device nearly idle, s per unit of a
            world's work (``Work._placing``, ``Work._driving``) and of the logarithm of ``TAIL_WORLDS``.
        host_s: time of the host for a world of a run on a device, s.
        gpu_start_s: time to start the device engine, including compilation, s.
        gpu_load_s: time to start the device engine if an earlier run has compiled the kernels, s.
    """

    mujoco: ThreadCosts = ThreadCosts(
        rest_s=1.3e-6,
        overhead_s=2.2e-5,
        landing_s=2.6e-6,
        static_s=1e-4,
        shaken_s=1.5e-6,
        shaken_power=2.0,
        fall_s=0.45,
        jammed=1.45,
        hand_s=9e-5,
        film_s=2.6e-5,
        give_s=3e-5,
        driven_s=3.5e-5,
    )
    kernel: ThreadCosts = ThreadCosts(
        rest_s=4e-7,
        overhead_s=3.8e-6,
        landing_s=9e-7,
        static_s=2e-5,
        shaken_s=1.1e-7,
        shaken_power=1.75,
        fall_s=0.05,
        jammed=1.3,
        hand_s=1e-6,
        film_s=2e-6,
        give_s=1.2e-6,
        board_s=4.5e-6,
    )
    kernel_start_s: float = 6.0
    kernel_load_s: float = 0.8
    jax_step_s: float = 1.1e-5
    gpu_step_s: float = 1.45e-6
    full_worlds: int = 264
    gpu_tail_s: float = 6e-6
    host_s: float = 2e-4
    gpu_start_s: float = 17.0
    gpu_load_s: float = 0.8

    def slowed(self, factor: float) -> Costs:
        """The costs on a machine whose CPU threads take ``factor`` times as long. The factor does not change the costs
        of GPUs.
        """
        return replace(
            self,
            mujoco=self.mujoco.slowed(factor),
            kernel=self.kernel.slowed(factor),
            kernel_start_s=factor * self.kernel_start_s,
            kernel_load_s=factor * self.kernel_load_s,
            jax_step_s=factor * self.jax_step_s,
        )

    def seconds(self, work: Work, threads: int, gpus: int = 1) -> dict[str, float]:
        """Name of an engine → expected time of the run if its worlds are divided among threads or GPUs, s. For
        ``mjx-jax``, the value is the time on a CPU."""
        n_plans = len(work.boxes)
        if not n_plans:
            starts = {"mjx-warp": self.gpu_start_s, "mjx-warp-cpu": self.kernel_start_s}
            return {"mujoco": 0.0, "mjx-jax": 0.0} | starts
        placements = work.on_device
        jax_placing, jax_driving = work._placing(JAX_POWER, grows=False), work._driving(JAX_POWER, work.drive_steps)
        placing, driving = work._placing(WARP_POWER, grows=True), work._driving(WARP_POWER, work.drive_steps)
        placed, driven = float(placing.mean()), float(driving.mean())
        device_s = self._phase_s(n_plans * work.placements / gpus, placements / work.placements * placed, placed)
        creeping = float(work._driving(WARP_POWER, DRIVE_TAIL_STEPS).mean())
        device_s += self._phase_s(float(work.shaken.sum()) / gpus, driven, creeping, work.rounds)
        return {
            "mujoco": self.mujoco.seconds(work, threads),
            "mjx-warp-cpu": self.kernel_start_s + self.kernel.seconds(work, threads),
            "mjx-jax": self.jax_step_s * float((placements * jax_placing + work.shaken * jax_driving).sum()),
            "mjx-warp": self.gpu_start_s + device_s,
        }

    def of_jobs(self, jobs: Sequence[Job], sim: Simulation, costs: ThreadCosts | None = None) -> FloatArray:
        """(n,) expected time of each job on one CPU thread, s. ``costs``: costs of the engine. If ``costs`` is None,
        those of ``mujoco`` are used."""
        costs = costs or self.mujoco
        work, drive_steps = _expected_work(jobs, sim)
        placing_s = _of_placements(jobs, *(costs.placing_s(work, way) for way in work.ways))
        return placing_s + costs.driving_s(work, drive_steps)

    def of_jobs_on_device(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) expected time of each job in a thread block of ``mjx-warp``; the unit is one step of one box."""
        work, drive_steps = _expected_work(jobs, sim)
        placing = _of_placements(jobs, 1.0, DISPLACED_COST, CARRIED_COST) * work._placing(WARP_POWER, grows=True)
        return np.asarray(placing + work._driving(WARP_POWER, drive_steps))

    def long_steps(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) for each job, the number of steps from which on its world counts as long (``LONG_PLACEMENT``,
        ``LONG_DRIVE``). The number depends neither on the machine nor on the other jobs."""
        steps = np.full(len(jobs), float(seconds_to_steps(sim.rest_window_s, sim.physics.timestep_s)))
        for settles in (False, True):  # _expected_work needs jobs that all settle, or none of which settles
            rows = [row for row, job in enumerate(jobs) if job.settles is settles]
            some = [jobs[row] for row in rows]
            work, drive_steps = _expected_work(some, sim)
            placing = _of_placements(some, *(work.placement_steps(way) for way in work.ways))
            if sim.check is Check.ONE_BY_ONE:  # each box waits for a quiet pallet, even if ``interval_s`` is short
                placing = np.where(placing > 0, np.maximum(placing, sim.quiet.steps * np.array(work.boxes)), 0.0)
            long_placement = np.where(placing > 0, np.maximum(LONG_PLACEMENT * placing, FALL_STEPS), 0.0)
            steps[rows] += long_placement + LONG_DRIVE * drive_steps
        return steps

    def _phase_s(self, worlds: float, work: float, tail_work: float, rounds: int = 1) -> float:
        """Time of a phase of many worlds on the device, s. The time includes the end of each round of the phase, when
        only a few worlds still run.

        Args:
            work: work of the mean world.
            tail_work: ``work`` without the factors that have no effect on the time of the longest worlds.
            rounds: number of rounds, each of which begins when the round before it has ended.
        """
        if not worlds:
            return 0.0
        full_s = worlds * (self.gpu_step_s * work / self.full_worlds + self.host_s)
        return full_s + rounds * self.gpu_tail_s * tail_work * float(np.log1p(worlds / rounds / TAIL_WORLDS))


def _displaced_cost(coupling: FloatArray) -> FloatArray:
    """(n,) cost of a placement whose boxes appear at places with errors, relative to a placement without errors. With
    errors, boxes that stand on several others lose some of these supports, and rock. On ``mujoco`` and on
    ``mjx-warp-cpu``, the measured values are 1.6 for generated plans, and 2.6 to 3 for a third-party plan."""
    return 1.3 + 1.9 * coupling


def _expected_work(jobs: Sequence[Job], sim: Simulation) -> tuple[Work, FloatArray]:
    """The work of all jobs if they are placed as planned, and (n,) steps of each job's drive."""
    drive_steps = np.array([expected_drive_steps(job.drive, sim) if job.drive else 0.0 for job in jobs])
    work = Work(sim, [job.scene.n_boxes for job in jobs], drives=int(any(job.settles for job in jobs)))
    return work, drive_steps


def _of_placements(
    jobs: Sequence[Job], planned: FloatArray | float, displaced: FloatArray | float, carried: FloatArray | float
) -> FloatArray:
    """(n,) for each job, one of the three values: for boxes that appear at their places without errors, for boxes that
    appear with errors, or for boxes that are carried. The result is 0 for jobs that start from a state, and so have no
    placement."""
    carries = np.array([job.scene.placing.carries for job in jobs], dtype=bool)
    has_errors = np.array([job.has_errors for job in jobs], dtype=bool)
    starts = np.array([job.start is not None for job in jobs], dtype=bool)
    return np.where(starts, 0.0, np.where(carries, carried, np.where(has_errors, displaced, planned)))


MEASURED = Costs()
"""The measured costs. The times expected from these costs agree with the records of runs within a factor of two. The
records are the lines ``estimates`` of benchmarks/results/cpu-0.3.jsonl and h200-0.3.jsonl, and the records of
tests/unit/test_engine_choice.py. Tests compare the model with all these records.

The costs of CPU threads were measured with one thread on a machine of two virtual EPYC cores. Other programs kept these
cores busy, so the thread took 1.7 to 2.5 times as long as on an idle core (petmjx/engines/machine_speed.py). The plans
were generated plans of 5 to 80 boxes, blocks of up to 120 boxes, and third-party plans of 45 to 140 boxes. The runs
were scores and static checks on several carriers, with all ways of placing, both schedules and both physics; scores
with confidence; and ready-made sweeps and chains. The cost of film was fitted to drives of 8, 22 and 40 boxes, and the
cost of a step with compliant boxes to plans of 16 to 24 boxes.

On C MuJoCo, the time of a single fall varies from a tenth of the mean to ten times the mean. So estimates for a few
plans that fall are less exact. The estimates leave out the time for simulating worlds again with smaller timesteps.

The costs of devices were fitted to records of one H100 and one H200. The times do not include start and compilation.
The runs were: 10, 300, 3,000 and 10,003 generated plans; 300 plans that fall; 2,000 and 4,000 generated plans with the
fixed schedule; 100, 500 and 1,000 plans with ``confidence`` 16, whose boxes appear at their places; 100 plans with
``confidence`` 16, whose boxes are carried by hand; 128,000 and a million worlds of 12 boxes with placement errors; the
profile of EUMOS for 20 plans; and searches of EUMOS's levels for 30 plans. ``mjx-warp`` compiles for 13 to 23 s (0.1 to
1.6 s if an earlier run has compiled the kernels)."""
