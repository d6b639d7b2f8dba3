"""The expected work of a run (``Work``): how many steps its worlds take, and how the costs of different kinds of steps
compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.options.carriers import walls_of
from petmjx.options.placing import Way
from petmjx.options.simulation import SOFT_START_STEPS, Check, Schedule, Simulation
from petmjx.world.carrier_boards import pallet
from petmjx.world.job import Drive

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
"""Steps after a profile until a pallet that stands is quiet. In drives with EUMOS's profile, pallets of 3 to 20 boxes
that stood took 315 to 324 steps. The profile itself has 200 of these steps. Drives in which most pallets of 3 to 60
boxes fell took 160 to 610 steps on average."""
COST_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.36}
"""The cost of a schedule on a device as a share of the fixed schedule's cost. On the same machine, 10,003 plans with
the adaptive schedule took 17 s, and 4,000 plans with the fixed schedule took 21 s. The adaptive schedule leaves out
cheap steps, in which all boxes are at rest. In the remaining steps, boxes move and pallets collapse."""
SHAKEN_FACTOR = 2.5
"""Cost of a step of a drive on a device, relative to a step of the same pallet with the fixed schedule. Measured on an
H200: 735 to 786 drives of EUMOS per second, in a run of 6,400 drives that did not end when the pallet was quiet."""
FALLING_FACTOR = 4.0
"""Cost of a step of a fall on a device, relative to a step of the same boxes with the fixed schedule. On an H200, 300
plans of 24 boxes that fall took 4 s."""
TYPICAL_TIES = 0.5
"""Assumed number of supports of a box beyond its first support, as a mean over the boxes of a plan, if the plan is
unknown. The mean is 0.24 to 1.3 in 62 third-party plans of 45 to 241 boxes. In most generated plans, boxes have many
different heights, so few tops are level, and the mean is 0.1 or less."""
STEADY_G, CREEPING = 0.35, 2.0
"""A drive with a horizontal acceleration above ``STEADY_G``, in units of 9.81 m/s², is expected to make unstable
pallets fall soon. After a drive with a smaller acceleration, boxes may creep for a long time. So a weaker drive is
expected to take ``CREEPING`` times as many steps, and is begun earlier. Measured on EUMOS's 4,032 drives of 100 plans:
strong drives take 336 steps on average and at most 1,149; weak drives take 570 steps on average and at most 6,088."""
FALL_STEPS = 1350
"""Number of steps of a fall while boxes are placed one by one: from the first box that tips over to the drop that ends
the world. The 22 plans of two shelf packers, which all fall, take 1,730 to 1,910 steps on average. In about 450 of
these steps, boxes are placed."""
STATIC_FALL_STEPS = 400
"""Number of steps of a static check in which boxes fall, until one has dropped and the world ends. If a static check
has fewer steps, boxes are expected to fall in all its steps. 17 plans with loose boxes took 200 to 600 steps on
``mujoco``."""
FALL_BOXES = 7
"""Number of boxes that are placed during the ``FALL_STEPS`` steps of a fall. The number was measured with the same 22
plans as ``FALL_STEPS``."""
LOST = 0.5
"""Number of steps of a fall in a placement with errors, relative to a fall in a placement without errors. The cost of
the fall decreases by the same factor. A world with errors ends when a box has tilted too far, before the box drops."""
FEWEST_WALLS = 2
"""Smallest number of walls that make steps more expensive. A trailer's headboard, a single wall, costs nothing at
first: a load touches the headboard only after sliding."""
REFERENCE_STEPS = 2.8
"""Number of steps of a placement with the physics ``reference``, relative to the physics ``pallet``, with the adaptive
schedule."""
WAY_STEPS = {Way.DROP: 3.1, Way.HAND: 4.0, Way.TINES: 7.0}
"""Number of steps of a placement whose boxes fall or are carried to their places, relative to a placement whose boxes
appear at their places. Measurements with plans of 14 and of 40 boxes agree within a tenth. Placements by hand were also
compared with the fixed schedule. They take 0.285 times as many steps: 0.45 times with few boxes, and 0.24 times with
many boxes. The factor 0.285 is about 4 × ``STEP_SHARE``."""
DISPLACED_STEPS, CARRIED_STEPS = 1.1, 5.0
"""Number of steps of a placement with errors of places or sizes, relative to a placement whose boxes appear exactly at
their places. ``DISPLACED_STEPS`` is for boxes that appear at places with errors; boxes that would overlap are moved
apart first. ``CARRIED_STEPS`` is for boxes that are carried to their places, and get stuck at their neighbours."""
FAILING_BOXES = 0.008
"""Probability that a box fails, and so ends the world, if it is carried to its place with errors. For 20 plans of 18 to
71 boxes, about 26 of 80 worlds with errors failed; for two plans of 146 and 238 boxes, six of ten worlds failed."""
DRIVEN_SWAY = 4.0
"""With compliant boxes, a placement and a drive take more steps than with rigid boxes, since the pile sways. The value
is the number of additional steps of a drive, divided by the number of additional steps of one placement. It is larger
than 1, since a drive makes a pile sway more. Columns of 18 boxes of 50 N/mm took 470 additional steps in EUMOS's
profile, and 30 in a placement."""
FALLING_SWAY_MM = 50.0
"""A pile of compliant boxes is expected to fall when its ``Work.sway_mm`` has reached this value. While boxes are
placed, the sway grows with the cube of the height."""
GIVING_STEPS, SWAY_STEPS, SWAY_MM, MOST_SWAY_STEPS = 9.0, 13.0, 15.0, 250.0
"""A pile of compliant boxes sways after each placement. If ``Work.sway_mm`` is w, the pile comes to rest after
``GIVING_STEPS`` + ``SWAY_STEPS`` · √w · (1 + w / ``SWAY_MM``) additional steps, at most after ``MOST_SWAY_STEPS``
additional steps. The period of a mass on springs that it compresses by s is 2π·√(s/g), and the sway w grows in
proportion to s, so the number of steps grows with the square root of w. A pile that sways by more than ``SWAY_MM`` is
close to falling, and comes to rest more slowly; a pile that sways much more falls before all boxes are placed. The
numbers were fitted to 12 generated plans of 10 to 73 boxes, each with 11 stiffnesses of 10 to 20,000 N/mm."""
DISPLACED_COST, CARRIED_COST = 2.8, 4.5
"""Cost of a placement with errors on a device, relative to a placement without errors. ``DISPLACED_COST`` is for boxes
that appear at places with errors, and may slip into gaps between other boxes. ``CARRIED_COST`` is for boxes that are
carried to their places. On one GPU, 10,003 worlds without errors took 17 s. With errors, 8,000 worlds (of 500 plans)
took 35 s if boxes appeared, and 4,000 worlds (of 250 plans) took 30 s if boxes were carried by hand."""
_SHARES = 50
"""Number of points at which ``Work.share_before_failure`` evaluates an integral over the share of placed boxes."""


def rest_steps(sim: Simulation, rest_s: float, quiet_steps: int = DRIVEN_QUIET_STEPS) -> int:
    """Expected number of steps after a profile until the pallet is quiet.

    Args:
        rest_s: the longest time to come to rest, s.
        quiet_steps: number of steps until the pallet is quiet with the adaptive schedule.
    """
    most = seconds_to_steps(rest_s, sim.physics.timestep_s)
    return min(most, quiet_steps) if sim.schedule is Schedule.ADAPTIVE else most


def expected_drive_steps(drive: Drive, sim: Simulation) -> float:
    """Expected number of steps of one drive. The order of jobs in a run and ``Costs.long_steps`` are computed from it.
    The number is larger than the mean, so that few drives count as long."""
    steps = rest_steps(sim, drive.rest_s, QUIET_STEPS) + len(drive.excitation.samples)
    peak_g = abs(drive.scale) * drive.excitation.peak_g
    return CREEPING * steps if sim.schedule is Schedule.ADAPTIVE and peak_g <= STEADY_G else steps


@dataclass(frozen=True)
class WayOfPlacing:
    """How boxes are placed in some placements of a plan.

    Attributes:
        count: number of these placements of each plan.
        steps: number of steps of the placement, relative to a placement whose boxes appear exactly at their places.
        has_errors: whether places or sizes have errors.
        is_carried: whether a hand or tines carry the boxes.
    """

    count: int
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
        rounds: number of drives of a pallet that must follow one another, because later drives depend on the results of
            earlier ones: the rounds of a search, or the legs of a chain.
        filmed: share of all steps of drives in which the pallet is wrapped in film, 0 to 1. The field holds one value
            for all plans, or one value per plan.
        gentle: share of all steps of drives that belong to gentle drives, 0 to 1. The field holds one value for all
            plans, or one value per plan. In a gentle drive, the horizontal acceleration is at most ``STEADY_G``;
            vertical accelerations do not count. Drives with random vibrations are not gentle.
        giving: number of compliant boxes of each plan; empty if no plan has compliant boxes.
        sway_mm: how far a pile of each plan's compliant boxes sways, mm (petmjx.plans.plan_workload); empty if no plan
            has compliant boxes.
        ties: for each plan, the mean number of supports that a box has in addition to its first support
            (petmjx.plans.plan_workload); if ``ties`` is empty, ``TYPICAL_TIES`` is used.
        placed_share: for each plan, the share of its boxes that are placed before the first box that tips over at once
            (petmjx.plans.plan_workload). The share is 1 if no box tips over. If ``placed_share`` is empty, the share is
            unknown, and no box is expected to tip over.
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
        """With this way of placing: whether a world ends when one of its boxes fails because of errors."""
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
        """Whether boxes may touch several boards, or walls on several sides."""
        boards = pallet(self.sim.carrier)
        sides = walls_of(self.sim.carrier, self.sim.walls).sides or ()
        return (boards is not None and len(boards.boards) > 1) or len(sides) >= FEWEST_WALLS

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
        return np.trunc(seconds / sim.physics.timestep_s)  # ``seconds_to_steps`` for all plans at once

    @property
    def steps(self) -> FloatArray:
        """(n,) expected number of steps of each plan, including soft starts."""
        placing = sum(
            (way.count * self.share_before_failure(way) * self.placement_steps(way) for way in self.ways),
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
            WayOfPlacing(self.planned, WAY_STEPS.get(name, 1.0), is_carried=self.sim.placing.carries),
            WayOfPlacing(self.displaced, DISPLACED_STEPS * drop, has_errors=True),
            WayOfPlacing(self.carried, CARRIED_STEPS * tines, has_errors=True, is_carried=True),
        )

    def placement_steps(self, way: WayOfPlacing) -> FloatArray:
        """(n,) expected number of steps of one placement of each plan in which no box fails because of errors, not
        counting the soft start."""
        return way.steps * self.share * self._placing_steps + way.falls * self.fall_steps

    def share_before_failure(self, way: WayOfPlacing, power: float = 1.0) -> FloatArray:
        """(n,) expected share of the boxes of each plan that are placed before a box fails because of errors. Each box
        fails with the probability ``FAILING_BOXES``, so this share has an exponential distribution over the worlds of a
        plan, cut off at 1.

        Args:
            power: the exponent p of the mean: the result is (mean of shareᵖ) to the power 1 / p.
        """
        if not self._ends_with_failure(way):
            return np.ones(len(self.boxes))
        failures = FAILING_BOXES * np.asarray(self.boxes, dtype=float)[:, None]
        share = (np.arange(_SHARES) + 0.5) / _SHARES
        mean = (failures * np.exp(-failures * share) * share**power).mean(axis=1) + np.exp(-failures[:, 0])
        return np.asarray(mean ** (1 / power))

    @property
    def on_device(self) -> float:
        """Cost of all placements of a plan on a device, with and without errors. A cost of 1 is the cost of one
        placement of this plan in which boxes appear exactly at their places."""
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

    def placing(self, power: float, *, grows: bool) -> FloatArray:
        """(n,) cost of one placement on a device: the number of boxes to a power, times the number of steps. ``grows``:
        whether boxes that are not yet placed cost nothing.
        """
        share = 1 / (power + 1) if grows and self.sim.check is Check.ONE_BY_ONE else 1.0
        boxes = np.asarray(self.boxes, dtype=float)
        placed = self.share if grows else 1.0
        cost = share * COST_SHARE[self.sim.schedule] * (placed * boxes) ** power * placed * self.fixed_steps
        fallen = np.minimum(placed * boxes + FALL_BOXES, boxes)
        return np.asarray(cost + FALLING_FACTOR * fallen**power * self.fall_steps)

    def driving(self, power: float, steps: FloatArray | float) -> FloatArray:
        """(n,) cost of a drive of each plan on a device: the number of boxes to a power, times the number of steps.
        ``steps``: number of steps of the drive.
        """
        return np.asarray(SHAKEN_FACTOR * np.asarray(self.boxes, dtype=float) ** power * steps)
