"""The cost model: ``auto`` and all estimates of time use it.

On a CPU thread a step of a pallet at rest takes one iteration of Newton's method, whose cost grows somewhat faster than
the boxes. While boxes land or slide a step takes more iterations, and each of them costs more the more contacts slide:
what a landing costs beyond rest grows with the square of the standing boxes. On a device a full stack's step grows with
that square, too; but of plans with more boxes more steps are at rest, so that their runs take less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from petmjx.basics.units import FloatArray, seconds_to_steps
from petmjx.options.config import SOFT_START_STEPS, Check, Schedule, Simulation
from petmjx.world.job import Job

STEP_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.16}
"""Steps of a schedule as a share of the fixed schedule's, physics ``pallet``: 0.15 to 0.17 of generated plans of 8 to
80 boxes and third-party ones of 98 to 204; physics ``reference`` takes twice as many."""

STATIC_STEPS = 220
"""Steps of a static check with the schedule adaptive: the mean of 12 generated and 9 third-party plans (150 to 700)."""

COST_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.4}
"""The cost of a schedule on a device as a share of the fixed schedule's. The remaining steps are the expensive ones, in
which boxes move and pallets collapse."""

JAX_POWER, WARP_POWER = 2.0, 1.0
"""The cost of a step of ``mjx-jax`` and ``mjx-warp`` grows with this power of the boxes, over whole runs: of plans with
more boxes more steps are at rest. While boxes come one by one, on ``mjx-warp`` it is the mean of k to this power over
k = 1…n: a share of 1 / (power + 1). On ``mjx-jax`` all boxes are in the model from the beginning."""

SHAKEN_FACTOR = 1.3
"""Cost of a step of a drive on a device, relative to a step of the same pallet at rest."""

CARRIED_STEPS = 3.0
"""Steps of a placement by hand, relative to one in which boxes appear: 2.4 to 4.5 with 5 to 98 boxes."""

CARRIED_ON_DEVICE = 3.8
"""Its cost on a device, relative to one in which boxes appear."""

REST_POWER = 1.25
"""The cost of a step at rest on a CPU thread grows with this power of the standing boxes."""

STATIC_LANDINGS = 22
"""What it costs beyond rest that all boxes of a static check land at once, in landings of one box on the full pallet:
12 to 24 with 38 to 241 boxes."""

SHAKEN_STEPS = 700
"""Steps of a drive in which boxes slide or fall, at most: all of EUMOS's profile. Of the 10,715 steps of the pushes of
``radial-force`` most are at rest."""


@dataclass(frozen=True, eq=False)
class Work:
    """What a run has to simulate: placements, and drives from their settled states.

    Attributes:
        sim: its check and schedule decide how many steps a placement has.
        boxes: of each plan.
        placements, drives: of each plan.
        carried: placements in which boxes are carried to their places.
        drive_steps: most of one drive, with all the time to come to rest; mean over profiles.
    """

    sim: Simulation
    boxes: Sequence[int]
    placements: int = 1
    carried: int = 0
    drives: int = 0
    drive_steps: float = 0.0

    @property
    def fixed_steps(self) -> FloatArray:
        """(n,) steps of one placement of each plan with the fixed schedule, with the time to settle before a drive."""
        sim, boxes = self.sim, np.asarray(self.boxes)
        one_by_one = sim.check is Check.ONE_BY_ONE
        if self.drives:
            seconds = (boxes * sim.interval_s if one_by_one else 0.0 * boxes) + sim.settle_s
        else:
            seconds = (boxes + 1) * sim.interval_s if one_by_one else 0.0 * boxes + sim.duration_s
        return np.array([seconds_to_steps(float(each), sim.physics.timestep_s) for each in seconds], dtype=float)

    @property
    def steps(self) -> FloatArray:
        """(n,) expected steps of each plan, with soft starts."""
        placements = self.placements + (CARRIED_STEPS - 1) * self.carried
        return placements * self._placing_steps + self.drives * self.drive_steps

    def appearing(self, carried_cost: float) -> float:
        """As many placements of each plan in which boxes appear as cost as much as all of them.

        Args:
            carried_cost: of a placement by hand, relative to one in which boxes appear.
        """
        return self.placements + (carried_cost - 1) * self.carried

    @property
    def _placing_steps(self) -> FloatArray:
        """(n,) expected steps of one placement, with its soft start."""
        steps = STEP_SHARE[self.sim.schedule] * self.fixed_steps
        if self.sim.check is Check.STATIC and self.sim.schedule is Schedule.ADAPTIVE:
            steps = np.minimum(self.fixed_steps, STATIC_STEPS)
        return 2 * SOFT_START_STEPS + steps

    def _placing(self, power: float, *, grows: bool) -> FloatArray:
        """(n,) box^power × steps of one placement, on a device; ``grows``: boxes that are to come cost nothing."""
        share = 1 / (power + 1) if grows and self.sim.check is Check.ONE_BY_ONE else 1.0
        return share * COST_SHARE[self.sim.schedule] * np.asarray(self.boxes, dtype=float) ** power * self.fixed_steps

    def _driving(self, power: float) -> FloatArray:
        """(n,) box^power × steps of one drive, on a device."""
        return SHAKEN_FACTOR * np.asarray(self.boxes, dtype=float) ** power * self.drive_steps


@dataclass(frozen=True)
class ThreadCosts:
    """Measured costs of an engine on one CPU thread.

    Attributes:
        rest_s: time for a step of a world at rest, s per box to the power ``REST_POWER``.
        overhead_s: time that any step takes in addition, s.
        landing_s: time that it takes in addition until a box has landed, s per box² of those that stand then.
        shaken_s: time that each of the first ``SHAKEN_STEPS`` steps of a drive takes in addition, s per box².
        carried: cost of a placement by hand, relative to one in which boxes appear.
    """

    rest_s: float
    overhead_s: float
    landing_s: float
    shaken_s: float
    carried: float

    def seconds(self, work: Work, threads: int) -> float:
        """Expected time, s, with the worlds shared out over threads: at least that of the longest one."""
        placing_s, driving_s = self.placing_s(work), self.driving_s(work.boxes, work.drive_steps)
        thread_s = float((work.appearing(self.carried) * placing_s + work.drives * driving_s).sum())
        each_s = (self.carried if work.carried else 1.0) * placing_s
        longest_s = float((each_s + (driving_s if work.drives else 0.0)).max())
        return max(thread_s / threads, longest_s)

    def placing_s(self, work: Work) -> FloatArray:
        """(n,) time of one placement of each plan, s."""
        boxes = np.asarray(work.boxes, dtype=float)
        one_by_one = work.sim.check is Check.ONE_BY_ONE
        # sums over the boxes that stand, 1…n, where they come one by one
        at_rest = self.rest_s * boxes**REST_POWER / (REST_POWER + 1 if one_by_one else 1)
        landings = boxes**3 / 3 if one_by_one else STATIC_LANDINGS * boxes**2
        return (at_rest + self.overhead_s) * work._placing_steps + self.landing_s * landings

    def driving_s(self, boxes: Sequence[int], steps: FloatArray | float) -> FloatArray:
        """(n,) time of a drive of each plan, s. steps: of the drive."""
        n = np.asarray(boxes, dtype=float)
        at_rest = self.rest_s * n**REST_POWER + self.overhead_s
        return np.asarray(at_rest * steps + self.shaken_s * n**2 * np.minimum(steps, SHAKEN_STEPS))


@dataclass(frozen=True)
class Costs:
    """Measured costs of the engines, in the detail that ``auto`` and estimates of time need.

    Attributes:
        mujoco, kernel: of ``mujoco`` and of ``mjx-warp-cpu`` on a CPU thread.
        kernel_start_s: time to start ``mjx-warp-cpu``, with compilation, s.
        jax_step_s: time of ``mjx-jax`` on a CPU for a step of one world, s per box²: 57 steps/s with 40 boxes on two
            cores.
        gpu_step_s: time of a device for a step of ``full_worlds`` worlds, s per box to the power ``WARP_POWER``.
        full_worlds: worlds that fill the device.
        tail_worlds: cost of the end of a run, in worlds: the last worlds run on a nearly idle device.
        gpu_start_s: time to start the device engine, with compilation, s.
    """

    mujoco: ThreadCosts = ThreadCosts(1.5e-6, 3.6e-5, 8.3e-6, 4.5e-7, 8.6)
    kernel: ThreadCosts = ThreadCosts(4.2e-7, 6e-6, 2.3e-6, 5e-8, 4.9)
    kernel_start_s: float = 10.0
    jax_step_s: float = 1.1e-5
    gpu_step_s: float = 3.6e-6
    full_worlds: int = 264
    tail_worlds: int = 900
    gpu_start_s: float = 17.0

    def seconds(self, work: Work, threads: int, gpus: int = 1) -> dict[str, float]:
        """Engine → expected time, s, with the worlds shared out over threads or GPUs; for ``mjx-jax`` that on a CPU."""
        n_plans = len(work.boxes)
        if not n_plans:
            starts = {"mjx-warp": self.gpu_start_s, "mjx-warp-cpu": self.kernel_start_s}
            return {"mujoco": 0.0, "mjx-jax": 0.0} | starts
        placements = work.appearing(CARRIED_ON_DEVICE)
        jax_placing, jax_driving = work._placing(JAX_POWER, grows=False), work._driving(JAX_POWER)
        return {
            "mujoco": self.mujoco.seconds(work, threads),
            "mjx-warp-cpu": self.kernel_start_s + self.kernel.seconds(work, threads),
            "mjx-jax": self.jax_step_s * float((placements * jax_placing + work.drives * jax_driving).sum()),
            "mjx-warp": self.gpu_start_s
            + self._phase_s(n_plans * placements / gpus, float(work._placing(WARP_POWER, grows=True).mean()))
            + self._phase_s(n_plans * work.drives / gpus, float(work._driving(WARP_POWER).mean())),
        }

    def of_jobs(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) expected time of each job on one CPU thread, s. On a device only its order counts."""
        boxes = [job.scene.n_boxes for job in jobs]
        placed = np.array([job.start is None for job in jobs], dtype=float)
        placed *= [self.mujoco.carried if job.scene.placing.carries else 1.0 for job in jobs]
        rest = [seconds_to_steps(job.drive.rest_s, sim.physics.timestep_s) if job.drive else 0 for job in jobs]
        shaken = [len(job.drive.excitation.samples) if job.drive else 0 for job in jobs]
        drive_steps = np.array(rest, dtype=float) + shaken
        placing = Work(sim, boxes, drives=int(any(job.settles for job in jobs)))
        return np.asarray(placed * self.mujoco.placing_s(placing) + self.mujoco.driving_s(boxes, drive_steps))

    def _phase_s(self, worlds: float, work: float) -> float:
        """Time of a phase of many worlds on the device, with its end, when only a few still run."""
        return self.gpu_step_s * work * (worlds + self.tail_worlds) / self.full_worlds if worlds else 0.0


MEASURED = Costs()
"""Records of runs that it was fitted to, within a factor of two: the lines ``estimates`` of
benchmarks/results/cpu-0.3.jsonl and h200-0.3.jsonl, with which tests compare it, and those of
tests/unit/test_choose.py.

CPU threads: one thread of two virtual EPYC cores, physics ``pallet``: scores of generated plans of 5 to 80 boxes and
third-party ones of 98 to 204, static checks, scores with confidence, EUMOS's drives and search, tilts, placement
errors; and on a slower one third-party plans of 16 to 241 boxes, both schedules, which took 1.5 times as long. Plans
that fall early take less. Physics ``reference`` is not fitted, and other CPUs are slower or faster. Worlds that are
simulated again with finer steps are not estimated.

Devices: one H200, adaptive if nothing else is said: 500, 2,000 and 10,003 generated plans, 2,000 with the schedule
fixed, 63 and 630 plans of 156 boxes on average, 1,000 plans with confidence 16, 100,000 worlds of 10 to 25 boxes with
errors, 6,400 drives of EUMOS's profile. ``mjx-warp`` compiles for 13 to 23 s (0.5 s with a kernel kept from an earlier
run)."""
