"""Simulates worlds with an engine, repeats the invalid ones with other settings, and yields each world's last outcome.

Which attempts there are: petmjx/engines/attempts.py.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Final, Generic

from petmjx.basics.errors import InputError, PetmjxError
from petmjx.basics.text import counted, one_line
from petmjx.engines.attempts import ATTEMPTS, BESIDE, STAND_INS, AttemptRecipe, Engines, ready_for
from petmjx.engines.base import Engine, GrowingJobs, JobsInParts, Progress
from petmjx.engines.beside.lookers import Lookers
from petmjx.engines.beside.process import READY, Answer, Task
from petmjx.engines.chunks import DEFAULT_CHUNK_WORLDS, Chunks
from petmjx.engines.failing import failed_outcome
from petmjx.engines.looked_at import MOST_TOGETHER, looked_at
from petmjx.engines.sinking import may_sink
from petmjx.engines.worlds import AnyWorld, WorldResult
from petmjx.options.config import Simulation, Solver
from petmjx.options.physics import Cone
from petmjx.verdict import Attempt, Flag, Outcome, Verdict
from petmjx.world.job import Job, KeptState

LARGE: Final = 1000
"""Worlds of a run that is worth processes beside it."""

MOST_DELAY_S: Final = 0.1
"""Up to ``MOST_TOGETHER`` answers are looked at together. If an engine says how many are at hand, it is these; else
those that come within so many seconds, or, if more worlds may follow from them, each alone."""

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

    ``chunk_worlds`` worlds are given to an engine at a time, and the next ones are made meanwhile; an engine may take
    these before all others have ended (``JobsInParts``). Invalid ones are collected and simulated again together, at
    the end or when they are as many. So memory does not grow with the number of worlds. Attempts that CPU threads make
    beside a GPU (petmjx/engines/attempts.py) begin at once.

    ``more`` gives worlds that follow from the results so far, each once. An engine with ``takes_more`` simulates them
    beside those that still run, any other one when these have ended.

    An error of an engine that has a stand-in does not end the run: that simulates what was left unanswered. Nor does an
    error at a further attempt: without a stand-in such worlds are invalid by ``failed``.

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
    source = Chunks[AnyWorld](iter(worlds), chunk_worlds)
    waiting: list[tuple[AttemptRecipe, _Pending[AnyWorld]]] = []
    aside: list[AnyWorld] = []
    besides = _Besides[AnyWorld](sim, engines)

    def went_on(attempt: AttemptRecipe, found: _Pending[AnyWorld]) -> Iterator[WorldResult[AnyWorld]]:
        """After an attempt: yield the result if it is final; else the world waits for its next attempt, or begins it.

        Args:
            found: with the attempt's outcome.
        """
        world, outcome, records = found
        assert outcome is not None
        later = attempts[attempts.index(attempt) + 1 :]
        following = next((each for each in later if each.is_for(outcome, sim)), None)
        if following is None:
            yield WorldResult(world, outcome, records)
        elif not besides.begin(following, found):
            waiting.append((following, found))

    def from_beside(wait: bool = False) -> Iterator[WorldResult[AnyWorld]]:
        for attempt, found in besides.ended(wait=wait):
            yield from went_on(attempt, found)

    def next_chunk() -> list[AnyWorld] | None:
        """For an engine that still has the one before; none where as many wait, for other attempts or engines."""
        return source.take_made() if len(waiting) + len(aside) < chunk_worlds else []

    def attempt_at(batch: list[_Pending[AnyWorld]], attempt: AttemptRecipe) -> Iterator[WorldResult[AnyWorld]]:
        making = _Making(attempt, attempt.apply_to_sim(sim), engines, more if attempt is first else None, aside)
        if attempt is first and more is None:
            making.lookers, besides.making = besides.lookers, making
            making.next_chunk = None if source.ended else next_chunk
        for found in making.run(batch):
            yield from went_on(attempt, found)
            yield from from_beside()

    def retry() -> Iterator[WorldResult[AnyWorld]]:
        for attempt in retries:
            chosen = [pending for asked, pending in waiting if asked is attempt]
            waiting[:] = [each for each in waiting if each[0] is not attempt]
            if chosen:
                progress.message = f"{len(chosen)} again, attempt {attempt.number}"
                yield from attempt_at(chosen, attempt)

    try:
        while True:
            worlds = aside or source.take() or (more() if more else ())
            batch: list[_Pending[AnyWorld]] = [(world, None, ()) for world in worlds]
            del worlds
            aside.clear()
            ended = not batch
            if batch:
                besides.prepare([world for world, _, _ in batch], retries)
                yield from attempt_at(batch, first)
            elif not waiting and besides.unanswered:
                progress.message = f"{counted(besides.unanswered, 'world')} again on CPU threads"
                yield from from_beside(wait=True)
            elif not waiting:
                return
            if len(waiting) >= chunk_worlds or ended:
                yield from retry()  # from whose results more may follow
    except GeneratorExit:
        raise
    except BaseException:  # ctrl-C, too, loses nothing that has come
        yield from from_beside()
        for found in besides.making.made([], engine.name) if besides.making is not None else ():
            yield from went_on(first, found)
        raise
    finally:
        source.close()
        besides.close()


@dataclass(eq=False)
class _Besides(Generic[AnyWorld]):
    """What is done beside the engine of a run: further attempts at single worlds, and looks at outcomes."""

    sim: Simulation
    engines: Engines
    lookers: Lookers[_Pending[AnyWorld]] | None = None
    making: _Making[AnyWorld] | None = None
    """Whose answers they look at."""
    _numbers: Iterator[int] = field(default_factory=count)
    _asked: dict[int, tuple[_Making[AnyWorld], _Pending[AnyWorld], str]] = field(default_factory=dict)
    """Number of a task → the attempt that it makes, the world, and the name of the engine."""

    @property
    def unanswered(self) -> int:
        """Worlds that are simulated now."""
        return len(self._asked)

    def prepare(self, worlds: Sequence[AnyWorld], retries: Sequence[AttemptRecipe]) -> None:
        """At the beginning of a large run: start what looks at outcomes, and what makes the attempts that few worlds
        need, with a box of one of them. It may have to compile a kernel, for as long as many worlds take."""
        name = BESIDE.get(self.engines.own.name)
        if name is None or len(worlds) < LARGE:
            return
        if self.lookers is None and not self.engines.own.looks:
            self.lookers = Lookers.here()
        if self.sim.physics.cone is not Cone.ELLIPTIC or self.sim.has_soft:
            return
        scene = next((each.job.scene for each in worlds if not each.job.settles), None)
        for attempt in retries if self.sim.solver is not Solver.CG else ():
            if attempt.few and scene is not None:
                job, sim = Job(scene.first(1)), attempt.apply_to_sim(self.sim)
                self.engines.helper.begin(Task(READY, name, job, sim))

    def begin(self, attempt: AttemptRecipe, pending: _Pending[AnyWorld]) -> bool:
        """Begin an attempt at a world. False if it is not made beside the engine of the run."""
        making = _Making[AnyWorld](attempt, attempt.apply_to_sim(self.sim), self.engines, None, [])
        world, before, _ = pending
        # where boxes of a plan may sink, they do in all its worlds with errors
        sank = world.variant != 0 and before is not None and before.verdict is Verdict.INVALID
        few = attempt.few and not (sank and may_sink(world.job.scene, self.sim))
        traits = {"doubles": attempt.doubles, "soft": making.is_soft(world), "few": few}
        name = self.engines.beside(world.job, making.sim, **traits)
        if name is not None:
            self._ask(making, pending, name)
        return name is not None

    def _ask(self, making: _Making[AnyWorld], pending: _Pending[AnyWorld], engine: str) -> None:
        (job,) = making.attempt.apply_to_jobs([ready_for(engine, pending[0].job)])
        number = next(self._numbers)
        self._asked[number] = making, pending, engine
        self.engines.helper.begin(Task(number, engine, job, making.sim))

    def ended(self, *, wait: bool) -> Iterator[tuple[AttemptRecipe, _Pending[AnyWorld]]]:
        """The attempts that have ended, and the worlds with their outcomes.

        Args:
            wait: for one at least, if there is any.
        """
        if self._asked:
            for answer in self.engines.helper.ended(wait=wait):
                if answer.number not in self._asked:  # READY, of this run or the one before
                    continue
                making, pending, engine = self._asked.pop(answer.number)
                for found in self._made(making, pending, engine, answer):
                    yield making.attempt, found

    def _made(
        self, making: _Making[AnyWorld], pending: _Pending[AnyWorld], engine: str, answer: Answer
    ) -> Iterator[_Pending[AnyWorld]]:
        """What becomes of an answer: without an outcome the stand-in is asked, and then once more in this process."""
        stand_in = self.engines.stand_in
        if answer.outcome is not None:
            self.engines.progress.world_steps += answer.outcome.n_steps
            yield from making.made([(pending, answer.outcome)], engine)
        elif stand_in is not None and engine != stand_in.name:
            self.engines.note_failure(engine, making.attempt.number, 1, answer.message)
            self._ask(making, pending, stand_in.name)
        else:
            yield from making.stood_in([pending])

    def close(self) -> None:
        """Nothing more is asked."""
        if self.lookers is not None:
            self.lookers.close()
        if "helper" in vars(self.engines):
            self.engines.helper.close()


@dataclass(eq=False)
class _Asked(Generic[AnyWorld]):
    """What an engine was asked in one run: how many worlds, and those of them that it has not answered, by the number
    of their job."""

    count: int = 0
    unanswered: dict[int, _Pending[AnyWorld]] = field(default_factory=dict)

    def add(self, batch: Sequence[_Pending[AnyWorld]]) -> None:
        """It is asked more."""
        self.unanswered.update(enumerate(batch, self.count))
        self.count += len(batch)


@dataclass(eq=False)
class _Making(Generic[AnyWorld]):
    """One attempt at a batch of worlds.

    Attributes:
        sim: the run's options with the attempt's changes.
        more: worlds that follow from the results so far, if they may be added to the batch.
        next_chunk: other worlds that may be added once they are made; None as long as they are not, and no worlds at
            the end.
        aside: those of all of them that another engine simulates are put here.
        lookers: look at answers beside the run, if there are any.
    """

    attempt: AttemptRecipe
    sim: Simulation
    engines: Engines
    more: Callable[[], Iterable[AnyWorld]] | None
    aside: list[AnyWorld]
    lookers: Lookers[_Pending[AnyWorld]] | None = None
    next_chunk: Callable[[], list[AnyWorld] | None] | None = None
    _message: str = ""
    """Of the last error of an engine."""

    def run(self, batch: list[_Pending[AnyWorld]]) -> Iterator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]]]:
        """Yield world, outcome, and its records with this attempt's record.

        Args:
            batch: is emptied, since worlds that have ended would take memory.
        """
        own = self.engines.own
        left, others = list[_Pending[AnyWorld]](), list[_Pending[AnyWorld]]()
        for pending in batch:
            (left if self._engine_for(pending[0]) is own else others).append(pending)
        batch.clear()
        if left:
            left = yield from self._run_on(own, left)
        yield from self.stood_in(left + others)

    def stood_in(self, left: list[_Pending[AnyWorld]]) -> Iterator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]]]:
        """The same of worlds that the stand-in takes over, if there is one."""
        maker = self.engines.own
        if left and self.engines.stand_in is not None:
            maker = self.engines.stand_in
            left = yield from self._run_on(maker, left)
        failed = [failed_outcome(0, pending[0].job, self.sim, self._message) for pending in left]
        yield from self.made(list(zip(left, failed, strict=True)), maker.name)

    def _engine_for(self, world: AnyWorld) -> Engine:
        return self.engines.for_job(world.job, self.sim, doubles=self.attempt.doubles, soft=self.is_soft(world))

    def is_soft(self, world: AnyWorld) -> bool:
        """Whether boxes of a world are soft at this attempt."""
        return self.attempt.soft or world.job.scene.soft is not None

    def _run_on(
        self, engine: Engine, batch: list[_Pending[AnyWorld]]
    ) -> Generator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]], None, list[_Pending[AnyWorld]]]:
        """Yield what an engine made of worlds; return those that an error of the engine left unanswered.

        Args:
            batch: is emptied, as of ``run``.
        """
        asked = _Asked[AnyWorld]()
        jobs = self._jobs_of(batch, asked, engine)
        batch.clear()
        takes_more = self.more is not None and engine.takes_more
        if takes_more:
            jobs = GrowingJobs(jobs)
        elif self.next_chunk is not None and engine is self.engines.own:
            jobs = JobsInParts(jobs, partial(self._next_part, asked, engine))
        answers = iter(engine.run(jobs, self.sim, self.engines.progress))
        came: list[tuple[_Pending[AnyWorld], Outcome]] = []
        looked_s = -math.inf
        while True:
            try:
                answer = next(answers, None)
            except BaseException as error:  # ctrl-C, too, loses nothing that has come
                yield from self.made(came, engine.name, looks=engine.looks)
                if not isinstance(error, Exception):
                    raise
                refused = isinstance(error, PetmjxError) or self.engines.stand_in is None
                if self.attempt.number == 1 and refused:
                    raise  # the user's to change: what the engine refuses, or the user's own engine
                self._message = one_line(error)
                self.engines.note_failure(engine.name, self.attempt.number, len(asked.unanswered), self._message)
                return list(asked.unanswered.values())
            if answer is None:
                break
            if answer.job not in asked.unanswered:
                raise RuntimeError(f"engine {engine.name} answered job {answer.job} twice, or it was never asked")
            came.append((asked.unanswered.pop(answer.job), answer))
            at_hand = self.engines.progress.at_hand if engine is self.engines.own else None
            soon = time.monotonic() - looked_s < MOST_DELAY_S and not takes_more
            idle = not (soon if at_hand is None else at_hand > 0)
            if len(came) == MOST_TOGETHER or idle:
                yield from self.made(came, engine.name, looks=engine.looks, wait=idle)
                came, looked_s = [], time.monotonic()
            if takes_more:
                assert self.more is not None
                jobs += self._jobs_of(self._own_of(self.more(), engine), asked, engine)
        yield from self.made(came, engine.name, looks=engine.looks)
        if asked.unanswered:
            raise RuntimeError(f"engine {engine.name} did not answer {len(asked.unanswered)} of {asked.count} jobs")
        return []

    def _next_part(self, asked: _Asked[AnyWorld], engine: Engine) -> Sequence[Job] | None:
        """As of ``JobsInParts``."""
        assert self.next_chunk is not None
        chunk = self.next_chunk()
        return None if chunk is None else self._jobs_of(self._own_of(chunk, engine), asked, engine)

    def _own_of(self, worlds: Iterable[AnyWorld], engine: Engine) -> list[_Pending[AnyWorld]]:
        """Those that an engine simulates. The others are put aside."""
        own: list[_Pending[AnyWorld]] = []
        for world in worlds:
            if self._engine_for(world) is engine:
                own.append((world, None, ()))
            else:
                self.aside.append(world)
        return own

    def _jobs_of(self, batch: Sequence[_Pending[AnyWorld]], asked: _Asked[AnyWorld], engine: Engine) -> list[Job]:
        """The jobs of worlds of which an engine is asked now."""
        asked.add(batch)
        return self.attempt.apply_to_jobs([ready_for(engine.name, pending[0].job) for pending in batch])

    def made(
        self, came: list[tuple[_Pending[AnyWorld], Outcome]], engine: str, *, looks: bool = False, wait: bool = True
    ) -> Iterator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]]]:
        """What becomes of the answers of many worlds.

        Args:
            looks: the engine has looked at them itself.
            wait: for those that are looked at beside the run; else some of them follow in later calls.
        """
        if looks:
            found = came
        elif self.lookers is not None:
            found = self.lookers.exchanged(came, [world.job for (world, _, _), _ in came], self.sim, wait=wait)
        else:
            jobs = [world.job for (world, _, _), _ in came]
            jobs = self.attempt.apply_to_jobs(jobs) if self.attempt.soft else jobs
            outcomes = looked_at([answer for _, answer in came], jobs, self.sim)
            found = [(pending, outcome) for (pending, _), outcome in zip(came, outcomes, strict=True)]
        for (world, before, records), outcome in found:
            outcome.attempt, outcome.engine = self.attempt.number, engine
            outcome.solver = self.sim.solver.value
            if outcome.state is not None and not isinstance(outcome.state, KeptState):
                outcome.state = KeptState(engine, outcome.state)
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
