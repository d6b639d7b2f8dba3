"""Simulates worlds with an engine, repeats invalid ones with other settings, and yields the last outcome of each world.

The attempts are listed in petmjx/engines/attempts.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final, Generic

from petmjx.common.errors import InputError
from petmjx.common.processes import defer_signals
from petmjx.common.text import count_text
from petmjx.engines.attempt_runner import AttemptRunner, Made, Pending
from petmjx.engines.attempts import ATTEMPTS, BESIDE, FALLBACKS, AttemptRecipe, Engines, ready_for
from petmjx.engines.contact_penetration import may_penetrate
from petmjx.engines.protocol import GROUP_WORLDS, Engine, Progress
from petmjx.engines.subprocess.attempt_process import READY, Answer, Task
from petmjx.engines.subprocess.check_pool import LARGE, CheckPool
from petmjx.engines.verdict import Verdict
from petmjx.engines.world_results import AnyWorld, WorldResult
from petmjx.options.physics import Cone
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.job import Job

DEFAULT_CHUNK_WORLDS: Final = 13 * GROUP_WORLDS["mjx-warp"] // 8
"""Largest number of worlds made at once: two groups of mjx-warp, less the part that each may still have of the one
before (``LEFT_SHARE`` and ``READY_SHARE`` in petmjx/engines/warp/engine.py)."""

CHUNK_BOXES: Final = 1 << 20
"""Number of boxes from which on no more worlds are added to a chunk: 130 MB of scenes, and as much for the next
chunk."""

FIRST_WORLDS, GROWTH = 2048, 8
"""Worlds of the first chunk for an engine that takes parts, and the factor by which each next chunk is larger. So a GPU
begins after half a second, and works on most chunks for as long as it takes to make the next one. 2,048 worlds fill its
blocks for few boxes."""


def check_pool_for(engine: Engine, worlds: int) -> CheckPool[Any] | None:
    """A pool that checks outcomes beside an engine with this many worlds; None if it is not worthwhile."""
    return CheckPool.here() if engine.name in BESIDE and not engine.looks and worlds >= LARGE else None


def score_worlds(
    worlds: Iterable[AnyWorld],
    sim: Simulation,
    engine: Engine,
    *,
    progress: Progress | None = None,
    chunk_worlds: int = DEFAULT_CHUNK_WORLDS,
    first_worlds: int = FIRST_WORLDS,
    attempts: Sequence[AttemptRecipe] = ATTEMPTS,
    more: Callable[[], Iterable[AnyWorld]] | None = None,
    check_pool: CheckPool[Any] | None = None,
) -> Iterator[WorldResult[AnyWorld]]:
    """Simulate worlds and yield the result of each one when it is final, in any order.

    A device is given ``chunk_worlds`` worlds at a time, and the next chunk is made meanwhile. An engine may take the
    next chunk before the worlds of this one have ended (``JobsInParts``); its first chunk then has ``first_worlds``.
    Invalid worlds are collected and simulated again together, when they fill a chunk or at the end. So memory does not
    grow with the number of worlds. Attempts that CPU threads make beside a GPU (petmjx/engines/attempts.py) begin at
    once.

    ``more`` gives worlds that follow from the results so far, each world once. An engine with ``takes_more`` simulates
    them beside the worlds that still run, any other engine after these have ended.

    ``check_pool``: a pool that several calls use one after the other; None: a call with many worlds starts its own.

    An error of an engine with a fallback does not end the run: the fallback simulates the unanswered worlds. Nor does
    an error at a further attempt: without a fallback these worlds are invalid by ``failed``.

    Raises:
        RuntimeError: the engine did not answer every job exactly once.
        InputError: the options ask for soft boxes, which the engine does not have.
        PetmjxError: the engine refuses the worlds at the first attempt.
        Exception: an error of an engine without a fallback at the first attempt.
    """
    if sim.has_soft and engine.name != "mujoco" and engine.name not in FALLBACKS:
        raise InputError(f"soft boxes need the engine mujoco, got {engine.name}")
    progress = progress or Progress()
    engines = Engines(engine, progress)
    first, *retries = attempts
    chunk_worlds *= engine.devices
    begins_with = min(first_worlds, chunk_worlds) if engine.takes_parts and more is None else chunk_worlds
    source = Chunks[AnyWorld](iter(worlds), begins_with, chunk_worlds, CHUNK_BOXES * engine.devices)
    waiting: list[tuple[AttemptRecipe, Pending[AnyWorld]]] = []
    aside: list[AnyWorld] = []
    besides = _SideTasks[AnyWorld](sim, engines, check_pool)

    def went_on(attempt: AttemptRecipe, pending: Pending[AnyWorld]) -> Iterator[WorldResult[AnyWorld]]:
        """After an attempt: yield the result if it is final; else the world waits for its next attempt, or begins it.

        Args:
            pending: with the attempt's outcome.
        """
        world, outcome, records = pending
        assert outcome is not None
        later = attempts[attempts.index(attempt) + 1 :]
        following = next((recipe for recipe in later if recipe.is_for(outcome, sim)), None)
        if following is None:
            yield WorldResult(world, outcome, records)
        elif not besides.begin(following, pending):
            waiting.append((following, pending))

    def from_beside(wait: bool = False) -> Iterator[WorldResult[AnyWorld]]:
        for attempt, pending in besides.ended(wait=wait):
            yield from went_on(attempt, pending)

    def next_chunk() -> list[AnyWorld] | None:
        """The next chunk for an engine that still has the one before; none if a chunk's worth of worlds waits for other
        attempts or engines."""
        return source.take_made() if len(waiting) + len(aside) < chunk_worlds else []

    def attempt_at(batch: list[Pending[AnyWorld]], attempt: AttemptRecipe) -> Iterator[WorldResult[AnyWorld]]:
        making = AttemptRunner(attempt, attempt.apply_to_sim(sim), engines, more if attempt is first else None, aside)
        if attempt is first and more is None:
            making.check_pool, besides.making = besides.check_pool, making
            making.next_chunk = next_chunk if source.more else None
        for pending in making.run(batch):
            if pending is not None:  # None: the engine pauses
                yield from went_on(attempt, pending)
            yield from from_beside()

    def retry() -> Iterator[WorldResult[AnyWorld]]:
        for attempt in retries:
            chosen = [pending for recipe, pending in waiting if recipe is attempt]
            waiting[:] = [entry for entry in waiting if entry[0] is not attempt]
            if chosen:
                progress.message = f"{len(chosen)} again, attempt {attempt.number}"
                yield from attempt_at(chosen, attempt)

    try:
        while True:
            next_worlds = aside or source.take() or (more() if more else ())
            batch: list[Pending[AnyWorld]] = [(world, None, ()) for world in next_worlds]
            del next_worlds  # finished worlds take memory
            aside.clear()
            ended = not batch
            if batch:
                besides.prepare([world for world, _, _ in batch], retries)
                yield from attempt_at(batch, first)
            elif not waiting and besides.unanswered:
                progress.message = f"{count_text(besides.unanswered, 'world')} again on CPU threads"
                yield from from_beside(wait=True)
            elif not waiting:
                return
            if len(waiting) >= chunk_worlds or ended:
                yield from retry()  # more worlds may follow from its results
    except GeneratorExit:
        raise
    except BaseException as error:  # even ctrl-C loses no outcome that has arrived
        if besides.check_pool is not None and not isinstance(error, Exception):
            besides.check_pool.hurry()
        yield from from_beside()
        for answered in besides.making.made([], engine.name) if besides.making is not None else ():
            yield from went_on(first, answered)
        raise
    finally:
        with defer_signals(afterwards=True), ExitStack() as closing:  # a second ctrl-C skips nothing of it
            closing.callback(source.close)
            closing.callback(besides.close)


@dataclass(eq=False)
class Chunks(Generic[AnyWorld]):
    """Worlds in chunks. A thread makes the next chunk while an engine has this one, so that a device need not wait.

    Args:
        size: number of worlds of the next chunk. The chunk after it has ``GROWTH`` times as many.
        most: largest number of worlds of a chunk.
        most_boxes: number of boxes from which on no more worlds are added to a chunk.
    """

    source: Iterator[AnyWorld]
    size: int
    most: int
    most_boxes: int = CHUNK_BOXES
    _ended: bool = False
    _maker: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "petmjx-worlds"))
    _next: Future[list[AnyWorld]] | None = None

    @property
    def more(self) -> bool:
        """Whether the next chunk is being made, or is ready."""
        return self._next is not None

    def take(self) -> list[AnyWorld]:
        """The next worlds; an empty list at the end."""
        chunk = self._made() if self._next is None else self._next.result()
        self._next = None if self._ended else self._maker.submit(self._made)
        return chunk

    def take_made(self) -> list[AnyWorld] | None:
        """As ``take``, but None while the worlds are being made. An error of the source is raised by ``take`` alone:
        here it means no more worlds."""
        if self._next is not None and not self._next.done():
            return None
        return self.take() if self._next is not None and self._next.exception() is None else []

    def _made(self) -> list[AnyWorld]:
        chunk, boxes, size = list[AnyWorld](), 0, self.size
        self.size = min(GROWTH * size, self.most)
        for world in self.source:
            chunk.append(world)
            boxes += world.job.scene.n_boxes
            if self._ended or len(chunk) == size or boxes >= self.most_boxes:
                return chunk
        self._ended = True
        return chunk

    def close(self) -> None:
        """Make no more worlds, and wait for the one that is being made."""
        self._ended = True
        self._maker.shutdown()


@dataclass(eq=False)
class _SideTasks(Generic[AnyWorld]):
    """Side tasks of a run, in other processes: further attempts at single worlds, and checks of outcomes."""

    sim: Simulation
    engines: Engines
    lent: CheckPool[Pending[AnyWorld]] | None = None
    """A pool that is kept after this run."""
    check_pool: CheckPool[Pending[AnyWorld]] | None = None
    making: AttemptRunner[AnyWorld] | None = None
    """The attempt whose outcomes the pool checks."""
    _numbers: Iterator[int] = field(default_factory=count)
    _asked: dict[int, tuple[AttemptRunner[AnyWorld], Pending[AnyWorld], str]] = field(default_factory=dict)
    """Number of a task → the attempt that it makes, the world, and the name of the engine."""

    @property
    def unanswered(self) -> int:
        """Number of worlds that are being simulated."""
        return len(self._asked)

    def prepare(self, worlds: Sequence[AnyWorld], retries: Sequence[AttemptRecipe]) -> None:
        """At the beginning of a large run: start the pool, and the process for attempts that few worlds need. That
        process simulates one box first: it may have to compile a kernel, which takes as long as many worlds."""
        self.check_pool = self.check_pool or self.lent or check_pool_for(self.engines.own, len(worlds))
        name = BESIDE.get(self.engines.own.name)
        if name is None or len(worlds) < LARGE:
            return
        if self.sim.physics.cone is not Cone.ELLIPTIC or self.sim.has_soft:
            return
        scene = next((world.job.scene for world in worlds if not world.job.settles), None)
        for attempt in retries if self.sim.solver is not Solver.CG else ():
            if attempt.few and scene is not None:
                job, sim = Job(scene.first(1)), attempt.apply_to_sim(self.sim)
                self.engines.helper.begin(Task(READY, name, job, sim))

    def begin(self, attempt: AttemptRecipe, pending: Pending[AnyWorld]) -> bool:
        """Begin an attempt at a world. False if it is not made beside the engine of the run."""
        making = AttemptRunner[AnyWorld](attempt, attempt.apply_to_sim(self.sim), self.engines, None, [])
        world, before, _ = pending
        # if boxes of a plan may sink, they do in all its worlds with errors
        sank = world.variant != 0 and before is not None and before.verdict is Verdict.INVALID
        few = attempt.few and not (sank and may_penetrate(world.job.scene, self.sim))
        traits = {"doubles": attempt.doubles, "soft": making.is_soft(world), "few": few}
        name = self.engines.beside(world.job, making.sim, **traits)
        if name is not None:
            self._ask(making, pending, name)
        return name is not None

    def _ask(self, making: AttemptRunner[AnyWorld], pending: Pending[AnyWorld], engine: str) -> None:
        (job,) = making.attempt.apply_to_jobs([ready_for(engine, pending[0].job)])
        number = next(self._numbers)
        self._asked[number] = making, pending, engine
        self.engines.helper.begin(Task(number, engine, job, making.sim))

    def ended(self, *, wait: bool) -> Iterator[tuple[AttemptRecipe, Pending[AnyWorld]]]:
        """The attempts that have ended, and the worlds with their outcomes.

        Args:
            wait: True: wait for at least one, if any attempt is running.
        """
        if self._asked:
            for answer in self.engines.helper.ended(wait=wait):
                if answer.number not in self._asked:  # READY, of this run or the one before
                    continue
                making, pending, engine = self._asked.pop(answer.number)
                for answered in self._made(making, pending, engine, answer):
                    if answered is not None:
                        yield making.attempt, answered

    def _made(
        self, making: AttemptRunner[AnyWorld], pending: Pending[AnyWorld], engine: str, answer: Answer
    ) -> Iterator[Made[AnyWorld] | None]:
        """The world with the outcome of an answer. Without an outcome the fallback is asked beside the run. If it has
        no outcome either, it simulates the world in this process."""
        fallback = self.engines.fallback
        if answer.outcome is not None:
            self.engines.progress.world_steps += answer.outcome.n_steps
            yield from making.made([(pending, answer.outcome)], engine)
        elif fallback is not None and engine != fallback.name:
            self.engines.note_failure(engine, making.attempt.number, 1, answer.message)
            self._ask(making, pending, fallback.name)
        else:
            yield from making.had_fallback([pending])

    def close(self) -> None:
        """End the side tasks."""
        if self.check_pool is not None and self.check_pool is not self.lent:
            self.check_pool.close()
        if "helper" in vars(self.engines):
            self.engines.helper.close()
