"""The cost model: expected steps and times of runs, for ``auto`` and for all estimates of time.

On a CPU thread, a step of a pallet at rest takes one iteration of Newton's method. The cost of a step grows somewhat
faster than the number of boxes. While boxes land or slide, a step takes more iterations, and an iteration costs more if
more contacts slide. So the additional cost of a landing grows with the square of the number of standing boxes.

On a device, the cost of a step of a full stack grows with the square, too. But plans with more boxes have a larger
share of steps at rest, so the cost of their runs grows more slowly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.options.carriers import Carrier
from petmjx.options.simulation import SOFT_START_STEPS, Check, Schedule, Simulation
from petmjx.world.carrier_boards import has_walls
from petmjx.world.job import Drive, Job

STEP_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.072}
"""Steps of a schedule as a share of the fixed schedule's steps, for physics ``pallet``. The value is the mean of 2,000
generated plans and of 63 third-party plans of 16 to 241 boxes. Physics ``reference`` takes three to four times as many
steps."""

SOFT_STARTS = 2 * SOFT_START_STEPS
"""Number of steps of the soft starts, which come before the first box of a placement. These steps are not part of the
schedule."""

QUIET_STEPS = 220
"""Steps until a pallet is quiet with the adaptive schedule, if boxes are not placed one by one. Static checks of 45 to
241 boxes took 150 to 890 such steps. After EUMOS's profile, pallets that stand took 216 steps."""

COST_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.36}
"""The cost of a schedule on a device as a share of the fixed schedule's cost. On the same machine, 10,003 plans took
17 s, and 4,000 plans with the fixed schedule took 21 s. The adaptive schedule saves cheap steps: in the remaining ones,
boxes move and pallets collapse."""

JAX_POWER, WARP_POWER = 2.0, 1.0
"""Over whole runs, the cost of a step on ``mjx-jax`` and ``mjx-warp`` grows with this power of the number of boxes,
since plans with more boxes have more steps at rest. While n boxes are placed one by one, the cost on ``mjx-warp`` is
the mean of k to this power over k = 1…n: about 1 / (power + 1) of the full cost. On ``mjx-jax``, all boxes are in the
model from the beginning."""

SHAKEN_FACTOR = 2.5
"""Cost of a step of a drive on a device, relative to a step of the same pallet with the fixed schedule. Measured on an
H200: 6,400 drives of EUMOS at 735 to 786 per second, when drives still continued after the pallet was quiet."""

REST_POWER = 1.25
"""The cost of a step at rest on a CPU thread grows with this power of the number of standing boxes."""

STATIC_LANDINGS = 45
"""Additional cost when all boxes of a static check land at once. The unit is the landing of one box on the full pallet.
Fitted to checks of 16 to 241 boxes with both schedules."""

SHAKEN_STEPS = 700
"""In a drive, boxes are expected to slide or fall in at most this many steps. This number covers all of EUMOS's
profile. In most of a tilt's 2,970 steps, boxes are at rest. Drives of many seconds without rest take up to ten times as
long as expected."""

STEADY_G, CREEPING = 0.35, 2.0
"""A drive with an acceleration above ``STEADY_G``, in units of 9.81 m/s², shakes a pallet down. After a weaker
drive the pallet may creep. So weaker drives are expected to take ``CREEPING`` times as many steps, and are begun
earlier. Measured on EUMOS's 4,032 drives of 100 plans: strong drives take 336 steps on average and 1,149 at most, weak
ones 570 and 6,088."""


FALL_STEPS = 1350
"""Steps from the first box that tips over to the drop that ends a world whose boxes are placed one by one. 22 plans of
two shelf packers, none of which stands, take 1,730 to 1,910 steps on average. About 450 of these steps are for
placing."""

STATIC_FALL_STEPS = 600
"""Number of steps of a static check in which boxes fall, until one has dropped and the world ends. A check with fewer
steps counts with all its steps. For ten shelf packings, the number was 480, but each step took more iterations than
when single boxes fall."""

BOARDS_COST = 1.25
"""Cost of a step on a carrier of boards, relative to a slab. The measured cost was 1.2 to 1.5 for scores, drives and
searches of 5 to 30 boxes on epal-1 and gma-48x40."""

FALL_BOXES = 7
"""Number of boxes that are placed during ``FALL_STEPS``, in the same plans."""


@dataclass(frozen=True)
class Errors:
    """Cost or steps of placements with errors, relative to a placement without errors.

    Attributes:
        displaced: factor for placements in which boxes appear at places with errors, and slip into each other's gaps.
        carried: factor for placements in which boxes are carried to their places.
    """

    displaced: float
    carried: float

    def of(self, job: Job) -> float:
        """The factor for the placement of a job."""
        if job.scene.placing.carries:
            return self.carried
        return self.displaced if job.has_errors else 1.0


ERROR_STEPS = Errors(displaced=1.1, carried=4.0)
"""Number of steps of a placement with errors, relative to a placement without errors. If boxes are moved apart before
they appear, the placement takes hardly more steps than as planned. Boxes placed by hand take a share of 0.285 of the
fixed schedule's steps instead of 0.072. The share is 0.45 with few boxes, and 0.24 with many."""

ON_DEVICE = Errors(displaced=2.8, carried=4.5)
"""Cost of a placement with errors on a device, relative to a placement without errors. 8,000 worlds of 500 plans took
35 s, and 4,000 worlds of 250 plans by hand took 30 s; 10,003 worlds without errors took 17 s."""


def rest_steps(sim: Simulation, rest_s: float) -> int:
    """Expected number of steps after a profile until the pallet is quiet. ``rest_s``: the time to come to rest, s."""
    most = seconds_to_steps(rest_s, sim.physics.timestep_s)
    return min(most, QUIET_STEPS) if sim.schedule is Schedule.ADAPTIVE else most


def expected_drive_steps(drive: Drive, sim: Simulation) -> float:
    """Expected number of steps of one drive."""
    steps = rest_steps(sim, drive.rest_s) + len(drive.excitation.samples)
    peak_g = abs(drive.scale) * drive.excitation.peak_g
    return CREEPING * steps if sim.schedule is Schedule.ADAPTIVE and peak_g <= STEADY_G else steps


@dataclass(frozen=True, eq=False)
class Work:
    """The work of a run: placements, and drives from their settled states.

    Attributes:
        sim: the options; their check and schedule determine how many steps a placement has.
        boxes: number of boxes of each plan.
        placements, drives: number of placements and of drives of each plan.
        displaced: number of placements in which boxes appear at places with errors, or with changed sizes.
        carried: number of placements in which boxes are carried to their places.
        drive_steps: steps of one drive, including ``rest_steps``; the mean over profiles.
        filmed: whether shaken pallets are wrapped in film.
        placed_share: for each plan, the share of its boxes that are placed before the first box that tips over at once
            (petmjx.plans.loose_boxes); 1 without such a box. Empty: the share is unknown, and no box is expected to tip
            over.
    """

    sim: Simulation
    boxes: Sequence[int]
    placements: int = 1
    displaced: int = 0
    carried: int = 0
    drives: int = 0
    drive_steps: float = 0.0
    filmed: bool = False
    placed_share: Sequence[float] | FloatArray = ()

    @property
    def share(self) -> FloatArray:
        """(n,) share of the boxes of each plan that are placed before the world ends."""
        has_share = self._falls.any() and self.sim.check is Check.ONE_BY_ONE
        return np.asarray(self.placed_share, dtype=float) if has_share else np.ones(len(self.boxes))

    @property
    def _falls(self) -> NDArray[np.bool_]:
        """(n,) whether each plan has a box that tips over, which ends the world."""
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
        """(n,) number of drives of each plan; 0 for a pallet that does not stand, since it is not shaken."""
        return np.where(self._falls, 0.0, float(self.drives))

    @property
    def on_boards(self) -> bool:
        """Whether the carrier has boards or walls."""
        slabs = (Carrier.FOOTPRINT, Carrier.EURO_PALLET, Carrier.ROLLCONTAINER)
        return self.sim.carrier not in slabs or has_walls(self.sim)

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
        return np.array([seconds_to_steps(float(period), sim.physics.timestep_s) for period in seconds], dtype=float)

    @property
    def steps(self) -> FloatArray:
        """(n,) expected steps of each plan, including soft starts."""
        placing = self.as_planned(ERROR_STEPS) * (self.share * self._placing_steps + self.fall_steps)
        return self.placements * SOFT_STARTS + placing + self.shaken * self.drive_steps

    def as_planned(self, errors: Errors) -> float:
        """(n,) for each plan, the number of placements without errors that cost as much, or have as many steps, as all
        its placements."""
        displaced, carried = (errors.displaced - 1) * self.displaced, (errors.carried - 1) * self.carried
        return self.placements + displaced + carried

    @property
    def _placing_steps(self) -> FloatArray:
        """(n,) expected steps of one placement that has no placing error, not counting its soft start."""
        if self.sim.check is Check.STATIC and self.sim.schedule is Schedule.ADAPTIVE:
            return np.minimum(self.fixed_steps, QUIET_STEPS)
        return STEP_SHARE[self.sim.schedule] * self.fixed_steps

    def _placing(self, power: float, *, grows: bool) -> FloatArray:
        """(n,) box^power × steps of one placement on a device. ``grows``: whether boxes that are not yet placed cost
        nothing.
        """
        share = 1 / (power + 1) if grows and self.sim.check is Check.ONE_BY_ONE else 1.0
        return share * COST_SHARE[self.sim.schedule] * np.asarray(self.boxes, dtype=float) ** power * self.fixed_steps

    def _driving(self, power: float, steps: FloatArray | float) -> FloatArray:
        """(n,) box^power × steps of a drive of each plan, on a device. ``steps``: number of steps of the drive."""
        return np.asarray(SHAKEN_FACTOR * np.asarray(self.boxes, dtype=float) ** power * steps)


@dataclass(frozen=True)
class ThreadCosts:
    """Measured costs of an engine on one CPU thread.

    Attributes:
        rest_s: time of a step of a world at rest, s per box to the power ``REST_POWER``.
        overhead_s: additional time of any step, s.
        landing_s: additional time until a box has landed, s per box² of the standing boxes.
        driven_s: additional time of a step of a drive, s: forces are summed in each step, and contacts slide.
        board_s: additional time of a step on a carrier of boards, s per box: all pairs are checked.
        shaken_s: additional time of each of the first ``SHAKEN_STEPS`` steps of a drive, s per box².
        fall_s: additional time of a step in which boxes of a placement fall, s per box².
        errors: relative cost of placements with errors.
        film_s: additional time of a step in which film acts, s.
    """

    rest_s: float
    overhead_s: float
    landing_s: float
    shaken_s: float
    fall_s: float
    errors: Errors
    film_s: float = 0.0
    driven_s: float = 0.0
    board_s: float = 0.0

    def slowed(self, factor: float) -> ThreadCosts:
        """The costs on a thread that is slower by ``factor``."""
        times = ("rest_s", "overhead_s", "landing_s", "shaken_s", "fall_s", "film_s", "driven_s", "board_s")
        return replace(self, **{name: factor * getattr(self, name) for name in times})

    def seconds(self, work: Work, threads: int) -> float:
        """Expected time if the worlds are divided among threads, s. This time is at least that of the longest world."""
        placing_s, driving_s = self.placing_s(work), self.driving_s(work.boxes, work.drive_steps)
        driving_s = driving_s + work.drive_steps * self.film_s * work.filmed
        thread_s = float((work.as_planned(self.errors) * placing_s + work.shaken * driving_s).sum())
        each_s = (self.errors.carried if work.carried else self.errors.displaced if work.displaced else 1.0) * placing_s
        longest_s = float((each_s + np.where(work.shaken > 0, driving_s, 0.0)).max())
        if work.on_boards:
            # on average, half of the boxes are placed
            thread_s += 0.5 * self.board_s * float((work.steps * np.asarray(work.boxes)).sum())
            return BOARDS_COST * max(thread_s / threads, longest_s)
        return max(thread_s / threads, longest_s)

    def placing_s(self, work: Work) -> FloatArray:
        """(n,) time of one placement of each plan, s."""
        boxes = np.asarray(work.boxes, dtype=float) * work.share
        one_by_one = work.sim.check is Check.ONE_BY_ONE
        # if boxes are placed one by one, these are sums over 1…n standing boxes
        at_rest = self.rest_s * boxes**REST_POWER / (REST_POWER + 1 if one_by_one else 1)
        landings = boxes**3 / 3 if one_by_one else STATIC_LANDINGS * boxes**2
        placing_s = (at_rest + self.overhead_s) * (SOFT_STARTS + work.share * work._placing_steps)
        fallen = np.minimum(boxes + FALL_BOXES, np.asarray(work.boxes, dtype=float))
        falling_s = self.rest_s * fallen**REST_POWER + self.overhead_s + self.fall_s * fallen**2
        return np.asarray(placing_s + self.landing_s * landings + work.fall_steps * falling_s)

    def driving_s(self, boxes: Sequence[int], steps: FloatArray | float) -> FloatArray:
        """(n,) time of one drive of each plan, s. ``steps``: number of steps of the drive."""
        n = np.asarray(boxes, dtype=float)
        at_rest = self.rest_s * n**REST_POWER + self.overhead_s
        shaken_s = self.shaken_s * n**2 * np.minimum(steps, SHAKEN_STEPS)
        return np.asarray((at_rest + self.driven_s) * steps + shaken_s)


@dataclass(frozen=True)
class Costs:
    """Measured costs of the engines, as detailed as ``auto`` and estimates of time need them.

    Attributes:
        mujoco, kernel: costs of ``mujoco`` and of ``mjx-warp-cpu`` on one CPU thread.
        kernel_start_s: time to start ``mjx-warp-cpu``, including compilation, s.
        jax_step_s: time of a step of one world on ``mjx-jax`` on a CPU, s per box²; 57 steps/s with 40 boxes on two
            cores.
        gpu_step_s: time of a step of ``full_worlds`` worlds on a device, s per box to the power ``WARP_POWER``.
        full_worlds: number of worlds that fill the device.
        tail_worlds: cost of the end of a run, as a number of worlds: the last worlds leave the device nearly idle.
        gpu_start_s: time to start the device engine, including compilation, s.
    """

    mujoco: ThreadCosts = ThreadCosts(
        1.3e-6, 2.2e-5, 1.9e-6, 6.5e-7, 1e-6, Errors(2.0, 9.5), film_s=1.2e-4, driven_s=3.5e-5
    )
    kernel: ThreadCosts = ThreadCosts(4e-7, 6e-6, 9e-7, 6e-8, 1.5e-7, Errors(1.3, 4.9), board_s=3e-6)
    kernel_start_s: float = 10.0
    jax_step_s: float = 1.1e-5
    gpu_step_s: float = 2.6e-6
    full_worlds: int = 264
    tail_worlds: int = 900
    gpu_start_s: float = 17.0

    def slowed(self, factor: float) -> Costs:
        """The costs on a machine whose CPU threads are slower by ``factor``. The costs of GPUs do not change."""
        return replace(
            self,
            mujoco=self.mujoco.slowed(factor),
            kernel=self.kernel.slowed(factor),
            kernel_start_s=factor * self.kernel_start_s,
            jax_step_s=factor * self.jax_step_s,
        )

    def seconds(self, work: Work, threads: int, gpus: int = 1) -> dict[str, float]:
        """Engine → expected time, s, if the worlds are divided among threads or GPUs. For ``mjx-jax`` it is the time on
        a CPU."""
        n_plans = len(work.boxes)
        if not n_plans:
            starts = {"mjx-warp": self.gpu_start_s, "mjx-warp-cpu": self.kernel_start_s}
            return {"mujoco": 0.0, "mjx-jax": 0.0} | starts
        placements = work.as_planned(ON_DEVICE)
        jax_placing, jax_driving = work._placing(JAX_POWER, grows=False), work._driving(JAX_POWER, work.drive_steps)
        return {
            "mujoco": self.mujoco.seconds(work, threads),
            "mjx-warp-cpu": self.kernel_start_s + self.kernel.seconds(work, threads),
            "mjx-jax": self.jax_step_s * float((placements * jax_placing + work.drives * jax_driving).sum()),
            "mjx-warp": self.gpu_start_s
            + self._phase_s(n_plans * placements / gpus, float(work._placing(WARP_POWER, grows=True).mean()))
            + self._phase_s(n_plans * work.drives / gpus, float(work._driving(WARP_POWER, work.drive_steps).mean())),
        }

    def of_jobs(self, jobs: Sequence[Job], sim: Simulation, costs: ThreadCosts | None = None) -> FloatArray:
        """(n,) expected time of each job on one CPU thread, s. ``costs``: costs of the engine; None: of ``mujoco``."""
        costs = costs or self.mujoco
        work, placements, drive_steps = _expected_work(jobs, sim, costs.errors)
        drives_s = costs.driving_s(work.boxes, drive_steps)
        return np.asarray(placements * costs.placing_s(work) + drives_s)

    def of_jobs_on_device(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) expected time of each job in a thread block of ``mjx-warp``; the unit is one step of one box."""
        work, placements, drive_steps = _expected_work(jobs, sim, ON_DEVICE)
        placing = placements * work._placing(WARP_POWER, grows=True)
        return np.asarray(placing + work._driving(WARP_POWER, drive_steps))

    def _phase_s(self, worlds: float, work: float) -> float:
        """Time of a phase of many worlds on the device, s, including its end, when only a few worlds still run."""
        return self.gpu_step_s * work * (worlds + self.tail_worlds) / self.full_worlds if worlds else 0.0


def _expected_work(jobs: Sequence[Job], sim: Simulation, errors: Errors) -> tuple[Work, FloatArray, FloatArray]:
    """The work of all jobs if they are placed as planned; (n,) factor by which errors raise the cost of each placement
    (0 if a job starts from a state); and (n,) steps of each job's drive.
    """
    placements = np.array([errors.of(job) if job.start is None else 0.0 for job in jobs])
    drive_steps = np.array([expected_drive_steps(job.drive, sim) if job.drive else 0.0 for job in jobs])
    work = Work(sim, [job.scene.n_boxes for job in jobs], drives=int(any(job.settles for job in jobs)))
    return work, placements, drive_steps


MEASURED = Costs()
"""The measured costs. The times expected from them agree with the records of runs within a factor of two. These records
are the lines ``estimates`` of benchmarks/results/cpu-0.3.jsonl and h200-0.3.jsonl, and the records of
tests/unit/test_engine_choice.py. Tests compare the model with all these records.

CPU threads: one thread of two virtual EPYC cores, and a busier thread that was 2.3 to 3.6 times as slow
(petmjx/engines/machine_speed.py), with physics ``pallet``. The runs are scores of generated plans of 5 to 80 boxes and
of third-party plans of 16 to 241 boxes, static checks, both schedules, scores with confidence (boxes placed exactly and
by hand), EUMOS's drives and search, tilts, and placement errors. The costs of plans with a box that tips over at once
are fitted to shelf packings of 24 boxes (tests/unit/test_falling_plans.py). The costs of film are fitted to EUMOS's
drives of 8, 20 and 44 boxes with 1 to 16 turns, each compared with the same drive without film.

Other plans that fall early take less time. Large plans that collapse take up to five times as long. Physics
``reference`` is not fitted, and other CPUs are slower or faster. The time for simulating worlds again with finer steps
is not estimated.

Devices: one H100, without start and compilation. The schedule is adaptive unless stated otherwise. The runs are 10,003
generated plans, 4,000 with the fixed schedule, 500 and 1,000 plans with confidence 16 (placed exactly), 250 by hand,
and 128,000 and a million worlds of 12 boxes with errors. ``mjx-warp`` compiles for 13 to 23 s (0.5 s with a kernel from
an earlier run)."""
