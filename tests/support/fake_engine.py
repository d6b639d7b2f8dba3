"""Engines without physics, for tests of code that handles outcomes. A world takes microseconds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.engines.mujoco.world_run import SettledState, WorldRun
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from support.outcomes import make_outcome


class LargestFirst:
    """Simulates the largest plans first, as engines do. Plans with an even number of boxes are unstable.

    Args:
        interrupt_after: number of worlds after which KeyboardInterrupt is raised.
    """

    name = "largest-first"

    def __init__(self, interrupt_after: int | None = None) -> None:
        self._left = interrupt_after

    @staticmethod
    def verdict(n_boxes: int) -> Verdict:
        return Verdict.STABLE if n_boxes % 2 else Verdict.UNSTABLE

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for job in sorted(range(len(jobs)), key=lambda job: (-jobs[job].scene.n_boxes, -job)):
            if self._left == 0:
                raise KeyboardInterrupt
            self._left = None if self._left is None else self._left - 1
            n = jobs[job].scene.n_boxes
            falls = self.verdict(n) is Verdict.UNSTABLE
            ending = {"reason": Reason.DROP, "culprit": n - 1, "first_sign_s": 0.5} if falls else {}
            yield replace(make_outcome(n, self.verdict(n), **ending), job=job)


def end_without_physics(world: WorldRun) -> Outcome:
    """Replaces ``WorldRun.run``. The ``mujoco`` engine works as usual, with its streams, its threads, and worlds that
    start from settled states. But how a world ends is decided by a rule, and not by a simulation.

    A plan stands if its upper boxes lie within 170 mm of one another. In a drive (motion of the carrier), it stands up
    to a level that depends on the number of boxes, on their mass and on the direction.
    """
    job, scene = world._job, world._job.scene
    if isinstance(job.start, SettledState) and (end_outcome := job.start.ended_as(world._stream_number)) is not None:
        return end_outcome
    places = scene.start_pos
    stands = bool(np.ptp(places[:, 0]) < 0.17)
    if job.drive is not None:
        largest = 0.2 * scene.n_boxes / (1 + scene.total_mass / 100) * (1 + 0.5 * np.cos(job.drive.yaw_rad))
        stands = stands and bool(job.drive.scale < largest)
    ending = {} if stands else {"reason": Reason.SHIFT, "culprit": scene.n_boxes - 1, "first_sign_s": 0.5}
    verdict = Verdict.STABLE if stands else Verdict.UNSTABLE
    outcome = make_outcome(
        scene.n_boxes, verdict, job=world._stream_number, pos=places, quat=scene.start_quat, **ending
    )
    if job.keep_state:
        ended = None if stands else replace(outcome)
        outcome.state = SettledState(100, None, OracleMetrics(scene, world._sim.thresholds), Flag.NONE, ended)
    return outcome
