"""Simulates a batch of worlds once (an *attempt*) on an engine or its fallback engine, and checks the outcomes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Generic, cast

from petmjx.common.errors import PetmjxError
from petmjx.common.text import one_line
from petmjx.engines.attempt_settings import AttemptRecipe, Engines, ready_for
from petmjx.engines.failed_world import failed_outcome
from petmjx.engines.job_stream import JobStream
from petmjx.engines.outcome_checks import MOST_TOGETHER, outcome_checks
from petmjx.engines.protocol import Capability, Engine, Progress, StreamEngine
from petmjx.engines.subprocess.check_pool import CheckPool
from petmjx.engines.verdict import Attempt, Flag, Outcome, Reason
from petmjx.engines.world_results import AnyWorld
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job, KeptState


def _never() -> bool:
    return False


def _no_more() -> None:
    return None


Pending = tuple[AnyWorld, Outcome | None, tuple[Attempt, ...]]
"""A world between two attempts: the world, the outcome of its last attempt, and the records of all attempts so far."""


AttemptResult = tuple[AnyWorld, Outcome, tuple[Attempt, ...]]
"""A world after an attempt: the world, the attempt's outcome, and the records of all attempts so far."""


_END: Final = object()
"""What follows an engine's last outcome."""


def outcomes_of_stream(
    engine: Engine, stream: JobStream[Any], sim: Simulation, progress: Progress, most: int = sys.maxsize
) -> Generator[Outcome]:
    """Simulate the jobs of a stream. An engine that cannot read a stream gets lists of jobs, one list after another.

    Args:
        most: largest number of jobs in a list.
    """
    stream.begin()
    if engine.streams:
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
    """Makes one attempt at many worlds.

    Attributes:
        sim: the run's options with the changes of this attempt.
        put_following: function that is called after each outcome. ``put_following`` puts the jobs that follow from
            results, such as the drives of a settled pallet, into the stream.
        check_pool: pool of processes that check outcomes; None if this process checks them.
        most: largest number of jobs in a list, for engines that cannot read a stream.
        verdicts_only: whether only verdicts are needed, as in ``outcome_checks``. A check pool ignores this value and
            makes all checks.
        joined: world → runner of its further attempt, for worlds whose further attempt is in the stream of
            ``run_stream``.
    """

    attempt: AttemptRecipe
    sim: Simulation
    engines: Engines
    put_following: Callable[[], None] = _no_more
    check_pool: CheckPool[Pending[AnyWorld]] | None = None
    most: int = sys.maxsize
    verdicts_only: bool = False
    joined: dict[AnyWorld, AttemptRunner[AnyWorld]] = field(default_factory=dict)
    _message: str = ""
    """Text of the last exception that an engine raised."""

    def run(self, batch: list[Pending[AnyWorld]]) -> Iterator[AttemptResult[AnyWorld] | None]:
        """Yield each world with its outcome and the records of all its attempts, this attempt included. Yield None when
        the engine pauses.

        Args:
            batch: the worlds. This method empties the list, so that finished worlds do not stay in memory.
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
        """A stream that holds only the jobs of these worlds. This method empties the list ``batch``."""
        stream = JobStream[Pending[AnyWorld]]()
        for job, pending in zip(self.jobs_of([world for world, _, _ in batch], engine), batch, strict=True):
            stream.put(self.attempt.after(pending[1], job), pending)
        stream.close()
        batch.clear()
        return stream

    def run_fallback(self, left: list[Pending[AnyWorld]]) -> Iterator[AttemptResult[AnyWorld] | None]:
        """Simulate the worlds for which the engine returned no outcome. If there is a fallback engine, it simulates
        these worlds. Worlds that still have no outcome become invalid, with the reason ``failed``. Like ``run``, this
        method yields results of attempts, and None when the engine pauses.
        """
        engine = self.engines.primary
        if left and self.engines.fallback is not None:
            engine = self.engines.fallback
            left = yield from self.run_stream(engine, self._stream_of(left, engine))
        failed = [failed_outcome(0, pending[0].job, self.sim, self._message) for pending in left]
        yield from self.checked_results(list(zip(left, failed, strict=True)), engine.name)

    def engine_for(self, world: AnyWorld) -> Engine:
        """The engine that simulates a world at this attempt: the engine of the run, or its fallback engine."""
        return self.engines.for_job(world.job, self.sim, self.attempt, soft=self.is_soft(world))

    def is_soft(self, world: AnyWorld) -> bool:
        """Whether this attempt simulates boxes of the world as soft bodies."""
        return self.attempt.soft or world.job.scene.soft is not None

    def run_stream(
        self, engine: Engine, stream: JobStream[Pending[AnyWorld]]
    ) -> Generator[AttemptResult[AnyWorld] | None, None, list[Pending[AnyWorld]]]:
        """Yield the worlds with their outcomes. If the engine raises an error, return the worlds that have no
        outcome.
        """
        engine_name = "" if Capability.MIXED in engine.capabilities else engine.name
        checked = Capability.CHECKS in engine.capabilities
        progress, tells = self.engines.progress, engine.tells
        progress.at_hand, progress.pauses = None, tells
        answers = outcomes_of_stream(engine, stream, self.sim, progress, self.most)
        arrivals: list[tuple[Pending[AnyWorld], Outcome]] = []
        while True:
            try:
                answer = next(answers, _END)
            except BaseException as error:  # even after Ctrl-C, no outcome that has arrived is lost
                if self.check_pool is not None and not isinstance(error, Exception):
                    self.check_pool.hurry()
                yield from self.checked_results(arrivals, engine_name, checked=checked)
                if not isinstance(error, Exception):
                    raise
                refused = isinstance(error, PetmjxError) or self.engines.fallback is None
                if self.attempt.number == 1 and refused:
                    # Only the user can help: with other worlds or, if there is no fallback engine, with another engine.
                    raise
                if not stream.taken:
                    # The engine would refuse the same jobs again, so all of them go to the fallback engine.
                    stream.take(sys.maxsize, least=1)
                unanswered = list(stream.in_flight.values())
                self._message = one_line(error)
                n_here = sum(pending[0] not in self.joined for pending in unanswered)
                self.engines.note_failure(engine.name, self.attempt.number, n_here, self._message)
                return unanswered
            if answer is None and tells:
                # The engine pauses, although it had reported that another outcome is ready. The world of this outcome
                # may have turned out to be a long world, which leaves the GPU (petmjx/engines/warp/long_worlds.py).
                yield from self.checked_results(arrivals, engine_name, checked=checked, wait=False)
                arrivals = []
                self._follow(stream, arrivals)
                yield None
                continue
            if answer is _END:
                break
            assert isinstance(answer, Outcome)
            try:
                pending = stream.answered(answer.job)
            except KeyError:
                raise RuntimeError(
                    f"engine {engine.name} returned an outcome for job {answer.job}, but this job already has an "
                    "outcome, or does not exist"
                ) from None
            if (runner := self.joined.pop(pending[0], None)) is None:
                arrivals.append((pending, answer))
            else:
                yield from runner.checked_results([(pending, answer)], engine_name, checked=checked)
            # Up to MOST_TOGETHER outcomes are checked together. Only outcomes that are ready now are checked together,
            # so no outcome waits for a later outcome.
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
        """Put the jobs that follow from the results so far into the stream.

        ``arrivals``: outcomes that are not checked yet.
        """
        self.put_following()
        if not arrivals and (self.check_pool is None or not self.check_pool.has_unanswered):
            stream.followed()

    def jobs_of(self, worlds: Sequence[AnyWorld], engine: Engine) -> list[Job]:
        """The jobs of these worlds, with the changes of this attempt, in a form that the engine can run."""
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
        """Check the outcomes of many worlds, and yield each world with its outcome and the records of its attempts.

        Args:
            engine: name of the engine that made the outcomes; empty if each outcome names its engine.
            checked: whether the engine has already checked the outcomes.
            wait: if True, wait until the check pool has checked all outcomes. If ``wait`` is False, yield only the
                outcomes that are ready; later calls yield the remaining outcomes.
            until: see ``CheckPool.exchanged``.
        """
        if checked:
            answered = arrivals
        elif self.check_pool is not None:
            jobs = [world.job for (world, _, _), _ in arrivals]
            answered = self.check_pool.exchanged(arrivals, jobs, self.sim, wait=wait, until=until)
        else:
            jobs = [world.job for (world, _, _), _ in arrivals]
            jobs = self.attempt.apply_to_jobs(jobs) if self.attempt.soft else jobs
            unchecked = [answer for _, answer in arrivals]
            outcomes = outcome_checks(unchecked, jobs, self.sim, verdicts_only=self.verdicts_only)
            answered = [(pending, outcome) for (pending, _), outcome in zip(arrivals, outcomes, strict=True)]
        for (world, before, records), outcome in answered:
            outcome.attempt, outcome.engine = self.attempt.number, engine or outcome.engine
            outcome.solver = self.sim.solver.value
            if outcome.state is not None and not isinstance(outcome.state, KeptState):
                outcome.state = KeptState(outcome.engine, outcome.state)
            records = (*records, Attempt.of(outcome, self.sim.physics.timestep_s))
            if before is not None and outcome.reason is Reason.ITERATION_LIMIT:
                outcome = before  # an attempt without a verdict changes nothing
            elif before is not None and self.attempt.checks:
                outcome = self._checked(world, before, outcome)
            yield world, outcome, records

    def _has_outcomes(self) -> bool:
        """Whether the engine of the run reports that further outcomes are ready."""
        return (self.engines.progress.at_hand or 0) > 0

    def _checked(self, world: AnyWorld, before: Outcome, checked: Outcome) -> Outcome:
        """The outcome of a world after the attempt with half the timestep. The outcome is the previous one, with
        ``Flag.TIMESTEP`` if half the timestep gives another verdict."""
        if checked.verdict is before.verdict:
            return before
        self.engines.note(f"{world.name}: the verdict is {before.verdict}, but {checked.verdict} at half the timestep")
        return replace(before, flags=before.flags | Flag.TIMESTEP)
