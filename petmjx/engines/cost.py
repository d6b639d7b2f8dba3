"""The cost model: ``auto`` and all estimates of time use it.

The cost of a step grows about with the square of the number of standing boxes, on CPU threads and on a device.
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

COST_SHARE = {Schedule.FIXED: 1.0, Schedule.ADAPTIVE: 0.4}
"""The same for the cost, fitted together with ``H100``. The remaining steps are the expensive ones, in which boxes move
and pallets collapse."""

GROWING_SHARE = 1 / 3
"""Cost of a step while boxes come one by one, as a share of that of the full pallet: the mean of k² over k = 1…n."""

SHAKEN_FACTOR = 2.0
"""Cost of a step of a drive, relative to a step of the same pallet at rest. A pallet that slides takes up to five times
as long per step; one that falls ends earlier. Measured on two plans of 16 and 20 boxes on the CPU."""


@dataclass(frozen=True, eq=False)
class Work:
    """What a run has to simulate: placements, and drives from their settled states.

    Attributes:
        sim: its check and schedule decide how many steps a placement has.
        boxes: of each plan.
        placements, drives: of each plan.
        drive_steps: of one drive, with the time to come to rest; mean over profiles.
    """

    sim: Simulation
    boxes: Sequence[int]
    placements: int = 1
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
        placing = 2 * SOFT_START_STEPS + STEP_SHARE[self.sim.schedule] * self.fixed_steps
        return self.placements * placing + self.drives * self.drive_steps

    @property
    def _placing(self) -> FloatArray:
        """(n,) box² × steps of one placement."""
        share = GROWING_SHARE if self.sim.check is Check.ONE_BY_ONE else 1.0
        return share * COST_SHARE[self.sim.schedule] * np.asarray(self.boxes, dtype=float) ** 2 * self.fixed_steps

    @property
    def _driving(self) -> FloatArray:
        """(n,) box² × steps of one drive."""
        return SHAKEN_FACTOR * np.asarray(self.boxes, dtype=float) ** 2 * self.drive_steps


@dataclass(frozen=True)
class Costs:
    """Measured costs of the engines, in the detail that ``auto`` and estimates of time need.

    Attributes:
        cpu_step_s: time of one CPU thread for a step of one world, s per box².
        cpu_overhead_s: time that such a step takes in addition, s.
        jax_step_s: as ``cpu_step_s``, for ``mjx-jax`` on a CPU: 57 steps/s with 40 boxes on two cores.
        gpu_step_s: time of a device for a step of ``full_lanes`` worlds, s per box².
        full_lanes: worlds that fill the device.
        tail_lanes: cost of the end of a run, in worlds: the last worlds run on a nearly idle device.
        gpu_start_s: time to start the device engine, with compilation, s.
    """

    cpu_step_s: float = 2.4e-7
    cpu_overhead_s: float = 3e-5
    jax_step_s: float = 1.1e-5
    gpu_step_s: float = 2.4e-6
    full_lanes: int = 2048
    tail_lanes: int = 3300
    gpu_start_s: float = 25.0

    def seconds(self, work: Work, threads: int, gpus: int = 1) -> dict[str, float]:
        """Engine → expected time, s, with the worlds shared out over threads or GPUs; for ``mjx-jax`` that on a CPU."""
        n_plans = len(work.boxes)
        if not n_plans:
            return {"mujoco": 0.0, "mjx-jax": 0.0, "mjx-warp": self.gpu_start_s}
        worlds = n_plans * (work.placements + work.drives)
        box2_steps = float((work.placements * work._placing + work.drives * work._driving).sum())
        thread_s = self.cpu_step_s * box2_steps + self.cpu_overhead_s * float(work.steps.sum())
        return {
            "mujoco": thread_s / min(threads, worlds),
            "mjx-jax": self.jax_step_s * box2_steps,
            "mjx-warp": self.gpu_start_s
            + self._phase_s(n_plans * work.placements / gpus, float(work._placing.mean()))
            + self._phase_s(n_plans * work.drives / gpus, float(work._driving.mean())),
        }

    def of_jobs(self, jobs: Sequence[Job], sim: Simulation) -> FloatArray:
        """(n,) expected time of each job on one CPU thread, s. On a device only its order counts."""
        boxes = [job.scene.n_boxes for job in jobs]
        placed = np.array([job.start is None for job in jobs])
        rest = [seconds_to_steps(job.drive.rest_s, sim.physics.timestep_s) if job.drive else 0 for job in jobs]
        shaken = [len(job.drive.excitation.samples) if job.drive else 0 for job in jobs]
        drive_steps = np.array(rest, dtype=float) + shaken
        placing = Work(sim, boxes, drives=int(any(job.keep_state or job.drive for job in jobs)))
        box2_steps = placed * placing._placing + SHAKEN_FACTOR * np.array(boxes, dtype=float) ** 2 * drive_steps
        return self.cpu_step_s * box2_steps + self.cpu_overhead_s * (placed * placing.steps + drive_steps)

    def _phase_s(self, worlds: float, box2_steps: float) -> float:
        """Time of a phase of many worlds on the device, with its end, when only a few still run."""
        return self.gpu_step_s * box2_steps * (worlds + self.tail_lanes) / self.full_lanes if worlds else 0.0


H100 = Costs()
"""Fitted to generated plans with 43 boxes on average, adaptive, on one H100 and 16 threads (benchmarks/README.md).
Measured there: mjx-warp compiles for 22 s (7 s with programs kept from an earlier run) and runs 18 s for 500 plans,
24 s for 2,000, 41 s for 4,000 and 63 s for 8,000; mujoco scores 13.8 plans/s. So a GPU is faster from about 650 such
plans on. Not fitted to other sizes or devices."""
