"""Runs one attempt at a batch of worlds on an engine or its fallback, and checks the outcomes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final, Generic

from petmjx.common.errors import PetmjxError
from petmjx.common.text import one_line
from petmjx.engines.attempts import AttemptRecipe, Engines, ready_for
from petmjx.engines.failed_world import failed_outcome
from petmjx.engines.outcome_checks import MOST_TOGETHER, outcome_checks
from petmjx.engines.protocol import Engine, GrowingJobs, JobsInParts
from petmjx.engines.subprocess.check_pool import CheckPool
from petmjx.engines.verdict import Attempt, Flag, Outcome
from petmjx.engines.world_results import AnyWorld
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job, KeptState


def _never() -> bool:
    return False


Pending = tuple[AnyWorld, Outcome | None, tuple[Attempt, ...]]
"""A world between two attempts, with the outcome of the last one and the records of all before."""


Made = tuple[AnyWorld, Outcome, tuple[Attempt, ...]]
"""A world after an attempt, with its outcome and the records of all attempts so far."""


class _End:
    """Marks the end of an engine's outcomes."""


_END: Final = _End()


@dataclass(eq=False)
class _PendingJobs(Generic[AnyWorld]):
    """The jobs of one run of an engine: their number, and the worlds without an outcome by the number of their job."""

    count: int = 0
    unanswered: dict[int, Pending[AnyWorld]] = field(default_factory=dict)

    def add(self, batch: Sequence[Pending[AnyWorld]]) -> None:
        """Add jobs to the run. After an error of the engine none are added."""
        try:
            self.unanswered.update(enumerate(batch, self.count))
        except BaseException:
            for number in range(self.count, self.count + len(batch)):
                self.unanswered.pop(number, None)
            raise
        self.count += len(batch)


@dataclass(eq=False)
class AttemptRunner(Generic[AnyWorld]):
    """One attempt at a batch of worlds.

    Attributes:
        sim: the run's options with the attempt's changes.
        more: worlds that follow from the results so far, if they may be added to the batch.
        next_chunk: makes further worlds that may be added; None while they are being made, and no worlds at the end.
        aside: receives the worlds that another engine simulates.
        check_pool: pool that checks outcomes in other processes, if there is one.
    """

    attempt: AttemptRecipe
    sim: Simulation
    engines: Engines
    more: Callable[[], Iterable[AnyWorld]] | None
    aside: list[AnyWorld]
    check_pool: CheckPool[Pending[AnyWorld]] | None = None
    next_chunk: Callable[[], list[AnyWorld] | None] | None = None
    _message: str = ""
    """Text of the last error of an engine."""
    _put_back: list[AnyWorld] | None = None
    """The chunk for which jobs could not be made while an engine had others."""

    def run(self, batch: list[Pending[AnyWorld]]) -> Iterator[Made[AnyWorld] | None]:
        """Yield world, outcome, and its records with this attempt's record; None in pauses of the engine.

        Args:
            batch: the worlds. It is emptied, since finished worlds would take memory.
        """
        engine = self.engines.own
        left, others = list[Pending[AnyWorld]](), list[Pending[AnyWorld]]()
        for pending in batch:
            (left if self._engine_for(pending[0]) is engine else others).append(pending)
        batch.clear()
        if left:
            left = yield from self._run_on(engine, left)
        self.aside += self._put_back or ()
        yield from self.had_fallback(left + others)

    def had_fallback(self, left: list[Pending[AnyWorld]]) -> Iterator[Made[AnyWorld] | None]:
        """Run the worlds that an engine left unanswered on its fallback, if it has one; yields as ``run``."""
        maker = self.engines.own
        if left and self.engines.fallback is not None:
            maker = self.engines.fallback
            left = yield from self._run_on(maker, left)
        failed = [failed_outcome(0, pending[0].job, self.sim, self._message) for pending in left]
        yield from self.made(list(zip(left, failed, strict=True)), maker.name)

    def _engine_for(self, world: AnyWorld) -> Engine:
        return self.engines.for_job(world.job, self.sim, doubles=self.attempt.doubles, soft=self.is_soft(world))

    def is_soft(self, world: AnyWorld) -> bool:
        """Whether boxes of a world are soft at this attempt."""
        return self.attempt.soft or world.job.scene.soft is not None

    def _run_on(
        self, engine: Engine, batch: list[Pending[AnyWorld]]
    ) -> Generator[Made[AnyWorld] | None, None, list[Pending[AnyWorld]]]:
        """Yield the worlds with the outcomes of an engine; return the worlds that an error left unanswered.

        Args:
            batch: is emptied, as of ``run``.
        """
        ledger, maker = _PendingJobs[AnyWorld](), "" if engine.names_engines else engine.name
        jobs = self._jobs_of(batch, ledger, engine)
        batch.clear()
        takes_more = self.more is not None and engine.takes_more
        if takes_more:
            jobs = GrowingJobs(jobs)
        elif self.next_chunk is not None and engine is self.engines.own:
            jobs = JobsInParts(jobs, partial(self._next_part, ledger, engine))
        progress, tells = self.engines.progress, getattr(engine, "tells", False)
        progress.at_hand, progress.pauses = None, tells
        answers: Iterator[Outcome | _End | None] = iter(engine.run(jobs, self.sim, progress))
        arrivals: list[tuple[Pending[AnyWorld], Outcome]] = []
        while True:
            try:
                answer = next(answers, _END)
            except BaseException as error:  # even ctrl-C loses no outcome that has arrived
                if self.check_pool is not None and not isinstance(error, Exception):
                    self.check_pool.hurry()
                yield from self.made(arrivals, maker, looks=engine.looks)
                if not isinstance(error, Exception):
                    raise
                refused = isinstance(error, PetmjxError) or self.engines.fallback is None
                if self.attempt.number == 1 and refused:
                    raise  # the user can change it: worlds that the engine refuses, or the user's own engine
                self._message = one_line(error)
                self.engines.note_failure(engine.name, self.attempt.number, len(ledger.unanswered), self._message)
                return list(ledger.unanswered.values())
            if answer is None and tells:
                yield from self.made([], maker, looks=engine.looks, wait=False)
                yield None
                continue
            if answer is _END:
                break
            assert isinstance(answer, Outcome)
            if answer.job not in ledger.unanswered:
                raise RuntimeError(f"engine {engine.name} answered job {answer.job} twice, or it was never asked")
            arrivals.append((ledger.unanswered.pop(answer.job), answer))
            # up to MOST_TOGETHER outcomes are checked together, but none is held back: further ones must be at hand
            idle = not (tells and progress.at_hand)
            if len(arrivals) == MOST_TOGETHER or idle:
                until = self._has_outcomes if tells else _never
                yield from self.made(arrivals, maker, looks=engine.looks, wait=idle, until=until)
                arrivals = []
            if takes_more:
                assert self.more is not None
                jobs += self._more_jobs(self.more(), ledger, engine)
        yield from self.made(arrivals, maker, looks=engine.looks)
        if ledger.unanswered:
            raise RuntimeError(f"engine {engine.name} did not answer {len(ledger.unanswered)} of {ledger.count} jobs")
        return []

    def _next_part(self, ledger: _PendingJobs[AnyWorld], engine: Engine) -> Sequence[Job] | None:
        """The next part for ``JobsInParts``. The engine would take an error here for its own, and a lack of memory on
        the host for one on its device. So a chunk with an error is put back, and no other one follows. It is tried
        again once the engine has finished its jobs. If the error comes again, it ends the run."""
        assert self.next_chunk is not None
        if self._put_back:
            return ()
        chunk: list[AnyWorld] | None = None
        try:
            chunk = self.next_chunk()
            return None if chunk is None else self._more_jobs(chunk, ledger, engine)
        except Exception as error:
            self._put_back = chunk  # needs no memory
            with suppress(Exception):
                self.engines.note(f"worlds were made again after an error: {one_line(error)}")
            return ()

    def _more_jobs(self, worlds: Iterable[AnyWorld], ledger: _PendingJobs[AnyWorld], engine: Engine) -> list[Job]:
        """Jobs of the worlds that this engine simulates, added to the ledger. Other worlds are put aside."""
        batch, others = list[Pending[AnyWorld]](), list[AnyWorld]()
        for world in worlds:
            if self._engine_for(world) is engine:
                batch.append((world, None, ()))
            else:
                others.append(world)
        before = len(self.aside)
        self.aside += others
        try:
            return self._jobs_of(batch, ledger, engine)
        except BaseException:
            del self.aside[before:]
            raise

    def _jobs_of(self, batch: Sequence[Pending[AnyWorld]], ledger: _PendingJobs[AnyWorld], engine: Engine) -> list[Job]:
        """Jobs of these worlds, added to the ledger. After an error of the engine there are none."""
        jobs = [pending[0].job for pending in batch]
        jobs = self.attempt.apply_to_jobs(
            jobs if engine.names_engines else [ready_for(engine.name, job) for job in jobs]
        )
        ledger.add(batch)
        return jobs

    def made(
        self,
        arrivals: list[tuple[Pending[AnyWorld], Outcome]],
        engine: str,
        *,
        looks: bool = False,
        wait: bool = True,
        until: Callable[[], bool] = _never,
    ) -> Iterator[Made[AnyWorld]]:
        """Check the outcomes of many worlds.

        Args:
            engine: the engine that made them; empty if each outcome names its engine.
            looks: True: the engine has already checked them.
            wait: True: wait for outcomes that are checked in the pool; else some of them follow in later calls.
            until: as in ``CheckPool.exchanged``.
        """
        if looks:
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
        """The outcome of a world that was checked at half the timestep: the earlier one, with a flag if the verdict
        changed."""
        if checked.verdict is before.verdict:
            return before
        name = f"{world.plan.plan_id}, variant {world.variant}" if world.variant else world.plan.plan_id
        self.engines.note(f"{name}: {before.verdict}, and {checked.verdict} at half the timestep")
        return replace(before, flags=before.flags | Flag.TIMESTEP)
