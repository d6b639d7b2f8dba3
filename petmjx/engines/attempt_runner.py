"""Runs one attempt at a batch of worlds on an engine or its fallback, and checks the outcomes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Generic, cast

from petmjx.common.errors import PetmjxError
from petmjx.common.text import one_line
from petmjx.engines.attempts import AttemptRecipe, Engines, ready_for
from petmjx.engines.failed_world import failed_outcome
from petmjx.engines.job_stream import JobStream
from petmjx.engines.outcome_checks import MOST_TOGETHER, outcome_checks
from petmjx.engines.protocol import Capability, Engine, Progress, StreamEngine
from petmjx.engines.subprocess.check_pool import CheckPool
from petmjx.engines.verdict import Attempt, Flag, Outcome
from petmjx.engines.world_results import AnyWorld
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job, KeptState


def _never() -> bool:
    return False


def _no_more() -> None:
    return None


Pending = tuple[AnyWorld, Outcome | None, tuple[Attempt, ...]]
"""A world between two attempts: the outcome of the last attempt, and the records of all attempts so far."""


AttemptResult = tuple[AnyWorld, Outcome, tuple[Attempt, ...]]
"""A world after an attempt, with its outcome and the records of all attempts so far."""


class _End:
    """Value that marks the end of an engine's outcomes."""


_END: Final = _End()


def run_engine(
    engine: Engine, stream: JobStream[Any], sim: Simulation, progress: Progress, most: int
) -> Generator[Outcome]:
    """Simulate the jobs of a stream. Engines that take no stream get lists of jobs, one after the other.

    Args:
        most: largest number of jobs in a list.
    """
    stream.begin()
    if getattr(engine, "streams", False):
        yield from cast(StreamEngine, engine).run(stream, sim, progress)
        return
    while jobs := stream.take(most, least=most):
        first = stream.taken - len(jobs)
        for outcome in engine.run(jobs, sim, progress):
            if first and outcome is not None:
                outcome.job += first
            yield outcome


@dataclass(eq=False)
class AttemptRunner(Generic[AnyWorld]):
    """One attempt at many worlds.

    Attributes:
        sim: the run's options with the attempt's changes.
        put_following: puts further jobs, which follow from results, into the stream, after each outcome.
        check_pool: pool that checks outcomes in other processes, if there is one.
        most: largest number of jobs in a list, for engines that take no stream.
    """

    attempt: AttemptRecipe
    sim: Simulation
    engines: Engines
    put_following: Callable[[], None] = _no_more
    check_pool: CheckPool[Pending[AnyWorld]] | None = None
    most: int = sys.maxsize
    _message: str = ""
    """Text of the last error of an engine."""

    def run(self, batch: list[Pending[AnyWorld]]) -> Iterator[AttemptResult[AnyWorld] | None]:
        """Yield each world with its outcome and the records of its attempts, including this one. Yield None when the
        engine pauses.

        Args:
            batch: the worlds. The list is emptied, since finished worlds would take memory.
        """
        engine = self.engines.primary
        left, others = list[Pending[AnyWorld]](), list[Pending[AnyWorld]]()
        for pending in batch:
            (left if self.engine_for(pending[0]) is engine else others).append(pending)
        batch.clear()
        if left:
            left = yield from self.run_stream(engine, self._stream_of(left, engine))
        yield from self.run_fallback(left + others)

    def _stream_of(self, batch: list[Pending[AnyWorld]], engine: Engine) -> JobStream[Pending[AnyWorld]]:
        """A stream with the jobs of these worlds alone. The batch is emptied."""
        stream = JobStream[Pending[AnyWorld]]()
        for job, pending in zip(self.jobs_of([world for world, _, _ in batch], engine), batch, strict=True):
            stream.put(job, pending)
        stream.close()
        batch.clear()
        return stream

    def run_fallback(self, left: list[Pending[AnyWorld]]) -> Iterator[AttemptResult[AnyWorld] | None]:
        """Run the worlds that the engine left unanswered on its fallback, if it has one. Worlds that still have no
        answer fail. Yields as ``run`` does.
        """
        engine = self.engines.primary
        if left and self.engines.fallback is not None:
            engine = self.engines.fallback
            left = yield from self.run_stream(engine, self._stream_of(left, engine))
        failed = [failed_outcome(0, pending[0].job, self.sim, self._message) for pending in left]
        yield from self.checked_results(list(zip(left, failed, strict=True)), engine.name)

    def engine_for(self, world: AnyWorld) -> Engine:
        """The engine of the run, or its fallback."""
        return self.engines.for_job(world.job, self.sim, doubles=self.attempt.doubles, soft=self.is_soft(world))

    def is_soft(self, world: AnyWorld) -> bool:
        """Whether boxes of a world are soft at this attempt."""
        return self.attempt.soft or world.job.scene.soft is not None

    def run_stream(
        self, engine: Engine, stream: JobStream[Pending[AnyWorld]]
    ) -> Generator[AttemptResult[AnyWorld] | None, None, list[Pending[AnyWorld]]]:
        """Yield the worlds with the outcomes of an engine; return the worlds that an error left unanswered."""
        engine_name = "" if Capability.MIXED in engine.capabilities else engine.name
        checked = Capability.CHECKS in engine.capabilities
        progress, tells = self.engines.progress, getattr(engine, "tells", False)
        progress.at_hand, progress.pauses = None, tells
        answers = run_engine(engine, stream, self.sim, progress, self.most)
        arrivals: list[tuple[Pending[AnyWorld], Outcome]] = []
        while True:
            try:
                answer = next(answers, _END)
            except BaseException as error:  # even ctrl-C loses no outcome that has arrived
                if self.check_pool is not None and not isinstance(error, Exception):
                    self.check_pool.hurry()
                yield from self.checked_results(arrivals, engine_name, checked=checked)
                if not isinstance(error, Exception):
                    raise
                refused = isinstance(error, PetmjxError) or self.engines.fallback is None
                if self.attempt.number == 1 and refused:
                    raise  # the user can change the refused worlds, or mend an engine without a fallback
                if not stream.taken:  # the engine would refuse the jobs again
                    stream.take(sys.maxsize, least=1)
                unanswered = list(stream.in_flight.values())
                self._message = one_line(error)
                self.engines.note_failure(engine.name, self.attempt.number, len(unanswered), self._message)
                return unanswered
            if answer is None and tells:
                yield from self.checked_results([], engine_name, checked=checked, wait=False)
                self._follow(stream, arrivals)
                yield None
                continue
            if answer is _END:
                break
            assert isinstance(answer, Outcome)
            try:
                arrivals.append((stream.answered(answer.job), answer))
            except KeyError:
                raise RuntimeError(
                    f"engine {engine.name} returned two outcomes for job {answer.job}, or had no such job"
                ) from None
            # Up to MOST_TOGETHER outcomes are checked together. No outcome is delayed: only outcomes that are ready now
            # are added.
            idle = not (tells and progress.at_hand)
            if len(arrivals) == MOST_TOGETHER or idle:
                until = self._has_outcomes if tells else _never
                yield from self.checked_results(arrivals, engine_name, checked=checked, wait=idle, until=until)
                arrivals = []
            self._follow(stream, arrivals)
        yield from self.checked_results(arrivals, engine_name, checked=checked)
        if stream.in_flight:
            raise RuntimeError(
                f"engine {engine.name} returned no outcome for {len(stream.in_flight)} of {stream.taken} jobs"
            )
        return []

    def _follow(self, stream: JobStream[Any], arrivals: Sequence[Any]) -> None:
        """Put the jobs that follow from the results so far into the stream. ``arrivals``: outcomes that are not checked
        yet.
        """
        self.put_following()
        if not arrivals and (self.check_pool is None or not self.check_pool.has_unanswered):
            stream.followed()

    def jobs_of(self, worlds: Sequence[AnyWorld], engine: Engine) -> list[Job]:
        """The jobs of these worlds at this attempt, for an engine."""
        jobs = [world.job for world in worlds]
        if Capability.MIXED not in engine.capabilities:
            jobs = [ready_for(engine.name, job) for job in jobs]
        return self.attempt.apply_to_jobs(jobs)

    def checked_results(
        self,
        arrivals: list[tuple[Pending[AnyWorld], Outcome]],
        engine: str,
        *,
        checked: bool = False,
        wait: bool = True,
        until: Callable[[], bool] = _never,
    ) -> Iterator[AttemptResult[AnyWorld]]:
        """Check the outcomes of many worlds.

        Args:
            engine: the engine that made them; empty if each outcome names its engine.
            checked: whether the engine has already checked the outcomes.
            wait: True: wait for all outcomes in the pool; False: later calls return some of them.
            until: as in ``CheckPool.exchanged``.
        """
        if checked:
            answered = arrivals
        elif self.check_pool is not None:
            jobs = [world.job for (world, _, _), _ in arrivals]
            answered = self.check_pool.exchanged(arrivals, jobs, self.sim, wait=wait, until=until)
        else:
            jobs = [world.job for (world, _, _), _ in arrivals]
            jobs = self.attempt.apply_to_jobs(jobs) if self.attempt.soft else jobs
            outcomes = outcome_checks([answer for _, answer in arrivals], jobs, self.sim)
            answered = [(pending, outcome) for (pending, _), outcome in zip(arrivals, outcomes, strict=True)]
        for (world, before, records), outcome in answered:
            outcome.attempt, outcome.engine = self.attempt.number, engine or outcome.engine
            outcome.solver = self.sim.solver.value
            if outcome.state is not None and not isinstance(outcome.state, KeptState):
                outcome.state = KeptState(outcome.engine, outcome.state)
            records = (*records, Attempt.of(outcome, self.sim.physics.timestep_s))
            if self.attempt.checks and before is not None:
                outcome = self._checked(world, before, outcome)
            yield world, outcome, records

    def _has_outcomes(self) -> bool:
        """Whether the engine of the run reports that outcomes are at hand."""
        return (self.engines.progress.at_hand or 0) > 0

    def _checked(self, world: AnyWorld, before: Outcome, checked: Outcome) -> Outcome:
        """The outcome of a world that was checked at half the timestep: the earlier outcome, with a flag if the verdict
        changed."""
        if checked.verdict is before.verdict:
            return before
        self.engines.note(f"{world.name}: {before.verdict}, but {checked.verdict} at half the timestep")
        return replace(before, flags=before.flags | Flag.TIMESTEP)
