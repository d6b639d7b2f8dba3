"""``LongWorlds``: the long worlds of a GPU, which CPU threads simulate to their ends.

A thread block of a GPU takes about four times as long for a step as a CPU thread, so a run would wait for its longest
worlds. A world leaves the GPU after a number of steps that depends on its job alone (``most_steps``). So the world's
outcome does not depend on other worlds, or on how busy the machine is. From this step on, the last digits of the
world's numbers are those of ``mjx-warp-cpu``.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.failed_world import failed_outcome
from petmjx.engines.mjx.world_constants import NEVER
from petmjx.engines.mjx.world_state import State, Status
from petmjx.engines.protocol import Progress
from petmjx.engines.subprocess.attempt_process import JOBS_WORTH_A_PROCESS, READY, AttemptSimulator, AttemptTask
from petmjx.engines.verdict import Flag, Outcome
from petmjx.options.simulation import Schedule, Simulation
from petmjx.world.job import Job

PAUSE_S: Final = 0.05
"""Time between two checks whether CPU threads have ended a world, s. The checks are made when no world is left on the
GPU."""


def most_steps(jobs: Sequence[Job], sim: Simulation) -> NDArray[np.int32]:
    """(n,) number of steps after which the world of each job leaves the GPU.

    The number is ``NEVER`` for worlds that stay on the GPU. With the fixed schedule, all worlds stay, since all are
    long. A placement from whose state drives start also stays, since the drives wait for the state. The world of
    a placement that pauses after some boxes (``Job.pauses_after``) stays, too, as does a placement that starts from the
    state at such a pause.
    """
    if sim.schedule is Schedule.FIXED:
        return np.full(len(jobs), NEVER, np.int32)
    stays = [
        job.keep_state or job.pauses_after is not None or (job.start is not None and job.drive is None) for job in jobs
    ]
    return np.where(stays, NEVER, MEASURED.long_steps(jobs, sim)).astype(np.int32)


ENGINE: Final = "mjx-warp-cpu"
"""Name of the engine that simulates long worlds to their ends."""


class LongWorlds:
    """Simulates worlds that have left a GPU.

    Args:
        simulator: simulates each world on one thread, and starts from states with ``Status.LEFT``.
    """

    def __init__(self, simulator: AttemptSimulator, sim: Simulation, progress: Progress) -> None:
        self._simulator, self._sim, self._progress = simulator, sim, progress
        self._many, self._prepared = False, set[bool]()
        """Two values: whether there are at least ``JOBS_WORTH_A_PROCESS`` jobs whose worlds may leave the GPU; and the
        kinds of worlds for which the process has been made ready, True for worlds with a drive and False for worlds
        without."""
        self._left: dict[int, tuple[Job, Outcome]] = {}
        """For each world that a CPU thread continues: stream number → the job of the world, and the outcome with which
        the world left the GPU."""

    def prepare(self, jobs: Sequence[Job]) -> None:
        """Start the process before the first slice, if there are many jobs. The process then simulates a world of one
        box, so that it has loaded its kernel and programs before they are needed. With the fixed schedule, the process
        is not started, since no world leaves the GPU (``most_steps``)."""
        self._many = len(jobs) >= JOBS_WORTH_A_PROCESS and self._sim.schedule is not Schedule.FIXED
        if self._many:
            self._get_ready(jobs[0])

    def _get_ready(self, job: Job) -> None:
        """Let the process simulate the first box of a job, with the drive of the job if it has one. The process has
        then loaded its kernel and programs before a long world needs them."""
        if self._many and (driven := job.drive is not None) not in self._prepared:
            self._prepared.add(driven)
            self._simulator.begin(AttemptTask(READY, ENGINE, Job(job.scene.first(1), job.drive), self._sim))

    def take(self, job: Job, outcome: Outcome) -> bool:
        """Continue a world that has left the GPU. Returns False if the world has not left the GPU, so that its outcome
        is final."""
        self._get_ready(job)
        if not (isinstance(outcome.state, State) and int(outcome.state.status) == Status.LEFT):
            return False
        self._progress.notes[f"long worlds were simulated to their ends on {ENGINE}"] = None
        self._left[outcome.job] = job, outcome
        # ``poses`` is left out, since it has the boxes' poses at the beginning of the drive, not when the world left
        # the GPU
        continued = replace(job, start=outcome.state, poses=None)
        self._simulator.begin(AttemptTask(outcome.job, ENGINE, continued, self._sim))
        return True

    def ended(self) -> Iterator[Outcome]:
        """The outcomes of the worlds that have ended since the last call. ``Outcome.job`` is the job's number in the
        run's stream of jobs."""
        for answer in self._simulator.ended(wait=False):
            if answer.number not in self._left:  # the task READY belongs to no world
                continue
            job, before = self._left.pop(answer.number)
            outcome = answer.outcome
            if outcome is None:
                outcome = failed_outcome(answer.number, job, self._sim, answer.message)
                self._progress.notes[f"{ENGINE} failed to simulate a long world to its end ({answer.message})"] = None
            steps = max(outcome.n_steps - before.n_steps, 0)
            # The thread that simulates worlds on the GPU also adds to ``world_steps``. The next line calls no function,
            # so Python does not switch to that thread within the line.
            self._progress.world_steps += steps
            history = outcome.history
            if before.history is not None and history is not None:
                history = before.history.then(history)
            forked = Flag.FORKED if job.forks else Flag.NONE
            flags = (outcome.flags & ~Flag.FORKED) | forked
            yield replace(outcome, job=answer.number, flags=flags, history=history)

    def last(self) -> Iterator[Outcome]:
        """Wait for the outcomes of all worlds, when no world is left on the GPU. If ``Progress.pauses`` is set, also
        yields None before each wait of ``PAUSE_S``."""
        before = self._progress.message
        while self._left:
            self._progress.message = f"{count_text(len(self._left), 'long world')} on CPU threads"
            if self._progress.pauses:
                yield None  # type: ignore[misc]  # callers that set ``pauses`` expect it
            time.sleep(PAUSE_S)
            yield from self.ended()
        self._progress.message = before

    def close(self) -> None:
        """End the simulation of all worlds."""
        self._simulator.close()
