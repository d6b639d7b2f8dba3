"""Engine handover: a run that begins on C MuJoCo continues in Warp kernels if worlds take longer than expected.

``auto`` chooses this engine for a small amount of work on a machine without a GPU. For this choice, the time of the run
is estimated from the numbers of boxes. On C MuJoCo, plans that collapse take many times as long as plans that stand; in
the kernels, the increase is smaller. So the CPU time of finished worlds is compared with their expected time. If the
kernels would finish the remaining worlds sooner, even with the time for compiling, these worlds go to the kernels.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any, Final

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.text import count_text, one_line, three_digits
from petmjx.common.units import FloatArray
from petmjx.engines.attempt_settings import ready_for
from petmjx.engines.attempt_with_fallback import outcomes_of_stream
from petmjx.engines.cost_model import Costs
from petmjx.engines.engine_choice import GAIN
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.open_world_protocol import MOST_BOXES, OpenWorlds
from petmjx.engines.protocol import PHYSICS, Capability, Engine, Progress, says_at_hand, takes_stream
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job, KeptState
from petmjx.world.scene import Scene

LEAST_WORLDS: Final = 20
"""Smallest number of finished worlds for a comparison with the expected time. The times of single worlds vary by a
factor of ten."""

SLOWER: Final = 2.0
"""Smallest ratio of measured to expected time for a handover. Estimates of time may be wrong by this factor."""


_Numbered = tuple[int, Job]
"""A job and its number in the run's stream of jobs."""


class HandoverEngine(Engine):
    """An engine that begins a run on C MuJoCo. If worlds take longer than expected, kernels simulate all jobs that have
    not begun by then.

    Only first attempts (first simulations of worlds) go to the kernels. C MuJoCo makes all further attempts, which need
    double precision. Each outcome names the engine that made it.

    Args:
        mujoco: the engine with which the run begins.
        make_faster: function that creates the engine with the kernels. If the function raises ``EngineUnavailable`` or
            ``InputError``, the run stays on ``mujoco``.
        costs: the estimated times of both engines. ``costs.kernel_start_s`` is the time until the kernels can start to
            simulate.
    """

    name = MujocoEngine.name
    capabilities = PHYSICS["mujoco"] | Capability.MIXED

    def __init__(self, mujoco: MujocoEngine, make_faster: Callable[[], Engine], costs: Costs) -> None:
        self._mujoco, self._make_faster, self._costs = mujoco, make_faster, costs
        self._faster: Engine | None = None
        self._stays = False
        """Whether the run stays on C MuJoCo, because the engine with the kernels is unavailable or has failed."""
        self._sim: Simulation | None = None
        self._worlds, self._spent_s, self._expected_s = 0, 0.0, 0.0

    @property
    def device(self) -> str:
        return self._mujoco.device

    @property
    def threads(self) -> int:
        """Number of worlds that are simulated at the same time."""
        return self._mujoco.threads

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> OpenWorlds:
        """See ``Engine.open``. C MuJoCo simulates these worlds."""
        return self._mujoco.open(scenes, sim, most_boxes)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """See ``Engine.paths``. C MuJoCo simulates these worlds."""
        return self._mujoco.paths(bodies, sim)

    def retire(self) -> None:
        if self._faster is not None:
            self._faster.retire()

    def close(self) -> None:
        if self._faster is not None:
            self._faster.close()

    @says_at_hand
    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        """See ``Engine.run``. Jobs may start from settled states (``KeptState``) of either engine."""
        progress = progress if progress is not None else Progress()
        self._sim = self._sim or sim
        first_attempt = sim == self._sim and sim.solver is Solver.NEWTON
        run = _Shared(self, JobStream.of(jobs), sim, progress, first_attempt=first_attempt)
        while run.take(wait=True):
            yield from run.on_mujoco() if run.for_mujoco else run.on_faster()

    def _hands_over(self, waiting: Callable[[], Sequence[Job]], sim: Simulation, progress: Progress) -> bool:
        """Whether the jobs that have not begun go to the kernels. If the result is True, the engine with the kernels
        has been created.

        Args:
            waiting: function that returns the jobs that have not begun.
        """
        slower = self._spent_s / self._expected_s if self._expected_s > 0 else 1.0
        if self._stays or self._worlds < LEAST_WORLDS or slower < SLOWER:
            return False
        if not (jobs := waiting()):
            return False
        threads, costs = self.threads, self._costs
        mujoco_s = slower * float(costs.of_jobs(jobs, sim).sum()) / threads
        if mujoco_s < GAIN * costs.kernel_start_s:
            return False
        placed_again = [ready_for("", job) for job in jobs]
        faster_s = costs.kernel_start_s + slower * float(costs.of_jobs(placed_again, sim, costs.kernel).sum()) / threads
        if mujoco_s < GAIN * faster_s:
            return False
        try:
            self._faster = self._make_faster()
        except (EngineUnavailable, InputError):
            self._stays = True
            return False
        progress.notes[
            f"auto: {count_text(self._worlds, 'world')} took {three_digits(slower)} times as long as expected on "
            f"{self.name}; {count_text(len(jobs), 'world')} that had not begun went to {self._faster.name}"
        ] = None
        return True


class _Shared:
    """The jobs of one run, divided between C MuJoCo and the kernels.

    Attributes:
        for_mujoco, for_faster: the jobs that wait for C MuJoCo and for the kernels.
    """

    def __init__(
        self,
        engine: HandoverEngine,
        jobs: JobStream[Any],
        sim: Simulation,
        progress: Progress,
        *,
        first_attempt: bool,
    ) -> None:
        self._engine, self._jobs, self._sim, self._progress = engine, jobs, sim, progress
        self._first_attempt = first_attempt
        self._taken = 0
        self.for_mujoco, self.for_faster = deque[_Numbered](), deque[_Numbered]()

    def take(self, *, wait: bool = False) -> bool:
        """Take the jobs that can begin now from the stream. Returns whether any job waits for an engine. Jobs that C
        MuJoCo cannot begin yet stay in the stream. Jobs that follow from outcomes are taken first.

        Args:
            wait: whether to wait for jobs if there are none.
        """
        wait = wait and not self.for_mujoco and not self.for_faster
        room = 2 * self._engine.threads
        most = room - len(self.for_mujoco) if self._engine._faster is None else sys.maxsize
        for job in self._jobs.take(most, least=room if wait else 1, wait=wait):
            (self.for_mujoco if self._is_for_mujoco(job) else self.for_faster).append((self._taken, job))
            self._taken += 1
        return bool(self.for_mujoco or self.for_faster)

    def _is_for_mujoco(self, job: Job) -> bool:
        stays = self._engine._faster is None or self._engine._stays
        # A job with ``poses`` moves the boxes of its start state to these poses. The kernels cannot start from a state
        # of C MuJoCo: they would repeat the placement, and could not move the boxes afterwards.
        starts_from_own_state = (
            job.poses is not None and isinstance(job.start, KeptState) and job.start.engine == self._engine.name
        )
        return stays or starts_from_own_state or job.scene.soft is not None or not self._first_attempt

    def _simulated(
        self, engine: Engine, waiting: deque[_Numbered], room: int, stream: JobStream[_Numbered]
    ) -> Iterator[tuple[Outcome | None, Job | None]]:
        """The outcomes of jobs on an engine, each with its job. A pair (None, None) means that the engine pauses.

        Args:
            waiting: the jobs, to which the caller may add jobs between two outcomes.
            room: largest number of jobs that the engine may have at a time, that is, jobs whose outcomes have not come
                yet.
            stream: an empty stream, from which the engine takes the jobs.
        """

        def feed() -> None:
            while waiting and len(stream.in_flight) + stream.ready < room:
                stream_number, job = waiting.popleft()
                stream.put(ready_for(engine.name, job), (stream_number, job))

        feed()
        stream.close()  # closed for other sources: from now on, only ``feed`` adds jobs, between two outcomes
        with closing(outcomes_of_stream(engine, stream, self._sim, self._progress)) as outcomes:
            for outcome in outcomes:
                job = None
                if outcome is not None:
                    outcome.job, job = stream.answered(outcome.job)
                    outcome.engine = engine.name
                yield outcome, job
                self.take()
                feed()
                if self._jobs.all_followed:
                    stream.followed()

    def on_mujoco(self) -> Iterator[Outcome]:
        """Simulate jobs on C MuJoCo. C MuJoCo gets only jobs that it can begin at once, so that the other jobs can
        still go to the kernels."""
        engine, spent_s = self._engine, self._progress.thread_s
        room = 2 * engine.threads
        with closing(self._simulated(engine._mujoco, self.for_mujoco, room, JobStream())) as outcomes:  # type: ignore[type-var]  # a generator
            for outcome, job in outcomes:
                if job is not None and self._first_attempt:
                    engine._worlds += 1
                    engine._spent_s += self._progress.thread_s - spent_s
                    engine._expected_s += float(engine._costs.of_jobs([job], self._sim)[0])
                spent_s = self._progress.thread_s
                yield outcome  # type: ignore[misc]  # None is allowed only with ``Progress.pauses``
                if job is not None and self._first_attempt:
                    self._reconsider()

    def _reconsider(self) -> None:
        """If the kernels are faster, let them have the jobs that have not begun."""
        if self._engine._faster is None and self._engine._hands_over(self._waiting, self._sim, self._progress):
            left = [numbered for numbered in self.for_mujoco if self._is_for_mujoco(numbered[1])]
            self.for_faster += [numbered for numbered in self.for_mujoco if not self._is_for_mujoco(numbered[1])]
            self.for_mujoco.clear()
            self.for_mujoco += left

    def _waiting(self) -> list[Job]:
        """The jobs that have not begun."""
        return [job for _, job in self.for_mujoco] + self._jobs.peek(sys.maxsize)

    def on_faster(self) -> Iterator[Outcome]:
        """Simulate the jobs ``for_faster`` on the engine with the Warp kernels. If this engine fails, C MuJoCo
        simulates the jobs that have no outcome yet."""
        faster, progress = self._engine._faster, self._progress
        assert faster is not None
        stream = JobStream[_Numbered](feedback=self._jobs.feedback, bounds=self._jobs.bounds)
        try:
            with closing(self._simulated(faster, self.for_faster, sys.maxsize, stream)) as outcomes:  # type: ignore[type-var]  # a generator
                for outcome, _ in outcomes:
                    yield outcome  # type: ignore[misc]  # None is allowed only with ``Progress.pauses``
        except Exception as error:
            self._engine._stays = True
            stream.take(sys.maxsize)
            unanswered = stream.in_flight.values()
            left = count_text(len(unanswered), "world")
            progress.notes[f"{faster.name} failed ({one_line(error)}); {left}: went to {self._engine.name}"] = None
            self.for_mujoco += [*unanswered, *self.for_faster]
            self.for_faster.clear()
