"""Simulates worlds with an engine, repeats the invalid ones with other settings, and yields each world's last outcome.

Which attempts there are: petmjx/engines/attempts.py.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final, Generic, TypeVar

from petmjx.config import Simulation
from petmjx.engines.attempts import ATTEMPTS, AttemptRecipe
from petmjx.engines.base import Engine, GrowingJobs, Progress
from petmjx.engines.edges import note_edges
from petmjx.engines.failing import failed_outcome
from petmjx.engines.sinking import note_softness
from petmjx.engines.stand_in import STAND_INS, Engines, ready_for
from petmjx.errors import InputError, PetmjxError
from petmjx.plans.plan import Plan
from petmjx.text import one_line
from petmjx.verdict import Attempt, Flag, Outcome, margin_of
from petmjx.world.job import Job, KeptState

DEFAULT_CHUNK_WORLDS = 32_768
"""Worlds given to an engine at once. With 43 boxes each their scenes take 160 MB, for any number of plans. With smaller
chunks the MJX engines would choose (and compile) their shapes more often."""


@dataclass(frozen=True, eq=False)
class World:
    """One plan in one variant. It is simulated once, and again if it is invalid."""

    plan: Plan
    variant: int
    job: Job


AnyWorld = TypeVar("AnyWorld", bound=World)


@dataclass(frozen=True, eq=False)
class WorldResult(Generic[AnyWorld]):
    """A world, the outcome of its last attempt, and all its attempts in order (often only one)."""

    world: AnyWorld
    outcome: Outcome
    attempts: tuple[Attempt, ...]


MOST_TOGETHER: Final = 64
MOST_DELAY_S: Final = 0.1
"""Answers that come within so many seconds are looked at together, up to so many."""

_Pending = tuple[AnyWorld, Outcome | None, tuple[Attempt, ...]]
"""A world between two attempts: with the outcome of the last one, and the records of all before."""


def score_worlds(
    worlds: Iterable[AnyWorld],
    sim: Simulation,
    engine: Engine,
    *,
    progress: Progress | None = None,
    chunk_worlds: int = DEFAULT_CHUNK_WORLDS,
    attempts: Sequence[AttemptRecipe] = ATTEMPTS,
    more: Callable[[], Iterable[AnyWorld]] | None = None,
) -> Iterator[WorldResult[AnyWorld]]:
    """Simulate worlds and yield the result of each one when it is final, in any order.

    ``chunk_worlds`` worlds are taken and simulated at a time. Invalid ones are collected and simulated again together,
    at the end or when a chunk is full. So memory does not grow with the number of worlds.

    ``more`` gives worlds that follow from the results so far, each once. An engine with ``takes_more`` simulates them
    beside those that still run, any other one when these have ended.

    An error of an engine that has a stand-in (petmjx/engines/stand_in.py) does not end the run: the stand-in simulates
    what was left unanswered. Nor does an error at a further attempt: without a stand-in such worlds are invalid by
    ``failed``.

    Raises:
        RuntimeError: the engine did not answer every job exactly once.
        InputError: the engine has no soft boxes, which the options ask for.
        PetmjxError: the engine refuses the worlds at the first attempt.
        Exception: that of an engine without a stand-in at the first attempt.
    """
    if sim.has_soft and engine.name != "mujoco" and engine.name not in STAND_INS:
        raise InputError(f"soft boxes need the engine mujoco, got {engine.name}")
    progress = progress or Progress()
    engines = Engines(engine, progress)
    first, *retries = attempts
    source = iter(worlds)
    waiting: list[_Pending[AnyWorld]] = []
    aside: list[AnyWorld] = []

    def attempt_at(
        batch: list[_Pending[AnyWorld]], attempt: AttemptRecipe, later: Sequence[AttemptRecipe]
    ) -> Generator[WorldResult[AnyWorld], None, list[_Pending[AnyWorld]]]:
        """Yield results that are final; return the worlds for which there is a later attempt."""
        again: list[_Pending[AnyWorld]] = []
        making = _Making(attempt, attempt.apply_to_sim(sim), engines, more if attempt is first else None, aside)
        for world, outcome, records in making.run(batch):
            if any(each.is_for(outcome, sim) for each in later):
                again.append((world, outcome, records))
            else:
                yield WorldResult(world, outcome, records)
        return again

    def retry(batch: Sequence[_Pending[AnyWorld]]) -> Iterator[WorldResult[AnyWorld]]:
        for number, attempt in enumerate(retries, start=1):
            chosen: list[_Pending[AnyWorld]] = []
            others: list[_Pending[AnyWorld]] = []
            for pending in batch:
                fits = pending[1] is not None and attempt.is_for(pending[1], sim)
                (chosen if fits else others).append(pending)
            if chosen:
                progress.message = f"{len(chosen)} again, attempt {attempt.number}"
                batch = others + (yield from attempt_at(chosen, attempt, retries[number:]))

    while True:
        chunk = list(islice(source, chunk_worlds)) or aside.copy() or list(more() if more else ())
        aside.clear()
        if chunk:
            waiting += yield from attempt_at([(world, None, ()) for world in chunk], first, retries)
        elif not waiting:
            return
        if len(waiting) >= chunk_worlds or not chunk:
            invalid, waiting = waiting, []
            yield from retry(invalid)  # from whose results more may follow


@dataclass(eq=False)
class _Making(Generic[AnyWorld]):
    """One attempt at a batch of worlds.

    Attributes:
        sim: the run's options with the attempt's changes.
        more: worlds that follow from the results so far, if they may be added to the batch.
        aside: those of them that another engine simulates are put here.
    """

    attempt: AttemptRecipe
    sim: Simulation
    engines: Engines
    more: Callable[[], Iterable[AnyWorld]] | None
    aside: list[AnyWorld]
    _message: str = ""
    """Of the last error of an engine."""

    def run(self, batch: Sequence[_Pending[AnyWorld]]) -> Iterator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]]]:
        """Yield world, outcome, and its records with this attempt's record."""
        own = maker = self.engines.own
        chosen = [self._engine_for(world) for world, _, _ in batch]
        left = [pending for pending, engine in zip(batch, chosen, strict=True) if engine is own]
        others = [pending for pending, engine in zip(batch, chosen, strict=True) if engine is not own]
        if left:
            left = yield from self._run_on(own, left)
        if (left or others) and self.engines.stand_in is not None:
            maker = self.engines.stand_in
            left = yield from self._run_on(maker, left + others)
        failed = [failed_outcome(0, pending[0].job, self.sim, self._message) for pending in left]
        yield from self._made(list(zip(left, failed, strict=True)), maker)

    def _engine_for(self, world: AnyWorld) -> Engine:
        soft = self.attempt.soft or world.job.scene.soft is not None
        return self.engines.for_job(world.job, self.sim, doubles=self.attempt.doubles, soft=soft)

    def _run_on(
        self, engine: Engine, batch: list[_Pending[AnyWorld]]
    ) -> Generator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]], None, list[_Pending[AnyWorld]]]:
        """Yield what an engine made of worlds; return those that an error of the engine left unanswered."""
        jobs = self.attempt.apply_to_jobs([ready_for(engine, pending[0].job) for pending in batch])
        takes_more = self.more is not None and engine.takes_more
        if takes_more:
            jobs = GrowingJobs(jobs)
        unanswered = set(range(len(batch)))
        answers = iter(engine.run(jobs, self.sim, self.engines.progress))
        came: list[tuple[_Pending[AnyWorld], Outcome]] = []
        looked_s = -math.inf
        while True:
            try:
                answer = next(answers, None)
            except BaseException as error:  # ctrl-C, too, loses nothing that has come
                yield from self._made(came, engine)
                if not isinstance(error, Exception):
                    raise
                refused = isinstance(error, PetmjxError) or self.engines.stand_in is None
                if self.attempt.number == 1 and refused:
                    raise  # the user's to change: what the engine refuses, or the user's own engine
                self._message = one_line(error)
                self.engines.note_failure(engine, self.attempt.number, len(unanswered), self._message)
                return [batch[index] for index in sorted(unanswered)]
            if answer is None:
                break
            if answer.job not in unanswered:
                raise RuntimeError(f"engine {engine.name} answered job {answer.job} twice, or it was never asked")
            unanswered.remove(answer.job)
            came.append((batch[answer.job], answer))
            if takes_more or len(came) == MOST_TOGETHER or time.monotonic() - looked_s > MOST_DELAY_S:
                yield from self._made(came, engine)
                came, looked_s = [], time.monotonic()
            for world in self._following(engine) if takes_more else ():
                unanswered.add(len(batch))
                batch.append((world, None, ()))
                jobs.append(ready_for(engine, world.job))
        yield from self._made(came, engine)
        if unanswered:
            raise RuntimeError(f"engine {engine.name} did not answer {len(unanswered)} of {len(batch)} jobs")
        return []

    def _following(self, engine: Engine) -> Iterator[AnyWorld]:
        """Worlds that follow from the results so far, those of other engines left out."""
        assert self.more is not None
        for world in self.more():
            if self._engine_for(world) is engine:
                yield world
            else:
                self.aside.append(world)

    def _made(
        self, came: Sequence[tuple[_Pending[AnyWorld], Outcome]], engine: Engine
    ) -> Iterator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]]]:
        """What becomes of answers, for all of them together: one by one that took longer than a GPU's simulation."""
        worlds = [pending[0] for pending, _ in came]
        scenes = [world.job.scene.all_soft if self.attempt.soft else world.job.scene for world in worlds]
        outcomes = note_softness([answer for _, answer in came], scenes, self.sim)
        for outcome in outcomes:
            outcome.attempt, outcome.engine = self.attempt.number, engine.name
            outcome.solver = self.sim.solver.value
            outcome.margin = margin_of(outcome.verdict, outcome.boxes, outcome.n_placed, self.sim.thresholds)
            if outcome.state is not None and not isinstance(outcome.state, KeptState):
                outcome.state = KeptState(engine.name, outcome.state)
        note_edges(outcomes, [world.job for world in worlds])
        for (_, before, records), world, outcome in zip((each for each, _ in came), worlds, outcomes, strict=True):
            records = (*records, Attempt.of(outcome, self.sim.physics.timestep_s))
            if self.attempt.checks and before is not None:
                outcome = self._checked(world, before, outcome)
            yield world, outcome, records

    def _checked(self, world: AnyWorld, before: Outcome, checked: Outcome) -> Outcome:
        """The outcome of a world that was checked at half the timestep: the one before, which says so if it changed."""
        if checked.verdict is before.verdict:
            return before
        name = f"{world.plan.plan_id}, variant {world.variant}" if world.variant else world.plan.plan_id
        self.engines.note(f"{name}: {before.verdict}, and {checked.verdict} at half the timestep")
        return replace(before, flags=before.flags | Flag.TIMESTEP)
