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

from petmjx.config import SOFT_START_STEPS, Check, Schedule, Simulation
from petmjx.units import FloatArray, seconds_to_steps
from petmjx.world.job import Job

STEP_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.21}
"""Steps of a schedule as a share of the fixed schedule's. Measured on 2,000 generated plans, physics ``pallet``
(benchmarks/README.md); physics ``reference`` takes twice as many."""

STATIC_STEPS = 220
"""Steps of a static check with the schedule adaptive: the mean of 12 generated and 9 third-party plans (150 to 700)."""

COST_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.4}
"""The cost of a schedule on a device as a share of the fixed schedule's, fitted together with ``MEASURED``. The
remaining steps are the expensive ones, in which boxes move and pallets collapse."""

JAX_POWER, WARP_POWER = 2.0, 1.6
"""The cost of a step of ``mjx-jax`` and ``mjx-warp`` grows with this power of the boxes. While they come one by one, on
``mjx-warp`` it is the mean of k to this power over k = 1…n: a share of 1 / (power + 1). On ``mjx-jax`` all boxes are in
the model from the beginning."""

SHAKEN_FACTOR = 2.0
"""Cost of a step of a drive on a device, relative to a step of the same pallet at rest."""

CARRIED_STEPS = 2.2
"""Steps of a placement by hand, relative to one in which boxes appear: 221 and 100 steps a box in 1,000 generated plans
(docs/placing.md), 193 and 85 in six."""

CARRIED_COST = 4.0
"""Its cost, relative to one in which boxes appear, ..."""

REST_POWER = 1.25
"""The cost of a step at rest on a CPU thread grows with this power of the standing boxes."""

STATIC_LANDINGS = 9
"""What it costs beyond rest that all boxes of a static check land at once, in landings of one box on the full pallet:
5 to 11 with 43 to 241 boxes."""

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
        drive_steps: of one drive, with the time to come to rest; mean over profiles.
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

    @property
    def _appearing(self) -> float:
        """As many placements in which boxes appear as cost as much."""
        return self.placements + (CARRIED_COST - 1) * self.carried

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
class Costs:
    """Measured costs of the engines, in the detail that ``auto`` and estimates of time need.

    Attributes:
        cpu_rest_s: time of one CPU thread for a step of a world at rest, s per box to the power ``REST_POWER``.
        cpu_overhead_s: time that any step takes in addition, s.
        cpu_landing_s: time that it takes in addition until a box has landed, s per box² of those that stand then.
        cpu_shaken_s: time that each of the first ``SHAKEN_STEPS`` steps of a drive takes in addition, s per box².
        jax_step_s: time of ``mjx-jax`` on a CPU for a step of one world, s per box²: 57 steps/s with 40 boxes on two
            cores.
        gpu_step_s: time of a device for a step of ``full_worlds`` worlds, s per box to the power ``WARP_POWER``.
        full_worlds: worlds that fill the device.
        tail_worlds: cost of the end of a run, in worlds: the last worlds run on a nearly idle device.
        gpu_start_s: time to start the device engine, with compilation, s.
        kernel_share: time of ``mjx-warp-cpu``, as a share of that of ``mujoco`` on as many threads.
        kernel_start_s: time to start it, with compilation, s.
    """

    cpu_rest_s: float = 2.4e-6
    cpu_overhead_s: float = 2e-5
    cpu_landing_s: float = 1e-5
    cpu_shaken_s: float = 4.5e-7
    jax_step_s: float = 1.1e-5
    gpu_step_s: float = 4.6e-7
    full_worlds: int = 264
    tail_worlds: int = 800
    gpu_start_s: float = 17.0
    kernel_share: float = 0.33
    kernel_start_s: float = 10.0

    def seconds(self, work: Work, threads: int, gpus: int = 1) -> dict[str, float]:
        """Engine → expected time, s, with the worlds shared out over threads or GPUs; for ``mjx-jax`` that on a CPU."""
        n_plans = len(work.boxes)
        if not n_plans:
            starts = {"mjx-warp": self.gpu_start_s, "mjx-warp-cpu": self.kernel_start_s}
            return {"mujoco": 0.0, "mjx-jax": 0.0} | starts
        jax_placing, jax_driving = work._placing(JAX_POWER, grows=False), work._driving(JAX_POWER)
        jax_steps = float((work._appearing * jax_placing + work.drives * jax_driving).sum())
        placing_s, driving_s = self._placing_s(work), self._driving_s(work.boxes, work.drive_steps)
        thread_s = float((work._appearing * placing_s + work.drives * driving_s).sum())
        each_s = (CARRIED_COST if work.carried else 1.0) * placing_s
        longest_s = float((each_s + (driving_s if work.drives else 0.0)).max())
        cpu_s = max(thread_s / threads, longest_s)
        return {
            "mujoco": cpu_s,
            "mjx-warp-cpu": self.kernel_start_s + self.kernel_share * cpu_s,
            "mjx-jax": self.jax_step_s * jax_steps,
            "mjx-warp": self.gpu_start_s
            + self._phase_s(n_plans * work._appearing / gpus, float(work._placing(WARP_POWER, grows=True).mean()))
            + self._phase_s(n_plans * work.drives / gpus, float(work._driving(WARP_POWER).mean())),
        }

    def of_jobs(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) expected time of each job on one CPU thread, s. On a device only its order counts."""
        boxes = [job.scene.n_boxes for job in jobs]
        placed = np.array([job.start is None for job in jobs], dtype=float)
        placed *= [CARRIED_COST if job.scene.placing.carries else 1.0 for job in jobs]
        rest = [seconds_to_steps(job.drive.rest_s, sim.physics.timestep_s) if job.drive else 0 for job in jobs]
        shaken = [len(job.drive.excitation.samples) if job.drive else 0 for job in jobs]
        drive_steps = np.array(rest, dtype=float) + shaken
        placing = Work(sim, boxes, drives=int(any(job.keep_state or job.drive for job in jobs)))
        return np.asarray(placed * self._placing_s(placing) + self._driving_s(boxes, drive_steps))

    def _placing_s(self, work: Work) -> FloatArray:
        """(n,) time of one placement of each plan on one CPU thread, s."""
        boxes = np.asarray(work.boxes, dtype=float)
        one_by_one = work.sim.check is Check.ONE_BY_ONE
        # sums over the boxes that stand, 1…n, where they come one by one
        at_rest = self.cpu_rest_s * boxes**REST_POWER / (REST_POWER + 1 if one_by_one else 1)
        landings = boxes**3 / 3 if one_by_one else STATIC_LANDINGS * boxes**2
        return (at_rest + self.cpu_overhead_s) * work._placing_steps + self.cpu_landing_s * landings

    def _driving_s(self, boxes: Sequence[int], steps: FloatArray | float) -> FloatArray:
        """(n,) time of a drive of each plan on one CPU thread, s. steps: of the drive."""
        n = np.asarray(boxes, dtype=float)
        at_rest = self.cpu_rest_s * n**REST_POWER + self.cpu_overhead_s
        return np.asarray(at_rest * steps + self.cpu_shaken_s * n**2 * np.minimum(steps, SHAKEN_STEPS))

    def _phase_s(self, worlds: float, work: float) -> float:
        """Time of a phase of many worlds on the device, with its end, when only a few still run."""
        return self.gpu_step_s * work * (worlds + self.tail_worlds) / self.full_worlds if worlds else 0.0


MEASURED = Costs()
"""Devices: fitted to plans on one H200 (benchmarks/results/h200-0.2.md), within a factor of two but for 63 large plans,
which take less than half of what is estimated since the kernels became faster. Measured there:
mjx-warp compiles for 13 to 23 s (0.5 s with a kernel kept from an earlier run) and runs 3.1 s for 500 generated plans,
5.4 s for 2,000 and 20 s for 10,003, adaptive (estimated: 2.6, 5.6 and 22 s); 14 s for 2,000 with the schedule fixed
(14); 47 s for 630 plans of 156 boxes on average (78), and 21 s for 63 of them (47); 3.8 to 4.4 s for
4,032 drives of EUMOS's profile. Not fitted to other devices.

CPU threads: fitted to ``mujoco`` on one thread of two virtual EPYC cores, physics ``pallet``: 21 third-party plans of
16 to 241 boxes and 110 generated ones, box by box, both schedules; static checks of 8 to 12 generated plans and 4 to 9
of the others; drives of EUMOS's profile and of radial forces at 0.2, 0.5 and 0.8 g (benchmarks/results/cpu-0.2.md).
Third-party plans are within a factor of two of it but for two, one of 45 boxes that takes 2.1 times as long (2.5 with
the schedule fixed) and one of 160 that collapses at its end (2.1). Plans that fall early take less, drives of EUMOS's
profile that move nothing a fifth of the estimate. On 16 threads of the machine with the H100 petmjx 0.1 took
1.6 times as long. Physics ``reference`` is not fitted, and other CPUs are slower or faster. ``mjx-warp-cpu`` takes 0.29
of the time of ``mujoco`` for 200 generated plans and 0.40 for 20 of 103 to 154 boxes, compiles for 7 s and starts in
3 s (two virtual Xeon cores with AVX-512, benchmarks/results/cpu-0.3.jsonl)."""
