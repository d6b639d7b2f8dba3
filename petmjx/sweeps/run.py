"""Runs a sweep: places every plan once per placement, forks the settled states into all drives, searches levels.

Placements and drives are handed to the engine as batches over many plans, since a device is fast with large batches.
``Batching`` bounds what is held at a time, for sweeps of any size.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from petmjx.config import Simulation
from petmjx.engines.base import Engine, Progress
from petmjx.engines.retry import ATTEMPTS, DEFAULT_CHUNK_WORLDS, World, WorldResult, score_worlds
from petmjx.plans.plan import Plan
from petmjx.sweeps.design import SearchItem
from petmjx.sweeps.grid import PlacementGroup, SweepPlan
from petmjx.sweeps.search import Bisection
from petmjx.verdict import Attempt, Flag, Outcome, Verdict
from petmjx.world.job import Job
from petmjx.world.scene import Scene
from petmjx.world.variants import Variant

SAME_STEP_ATTEMPTS = tuple(attempt for attempt in ATTEMPTS if attempt.timestep_divisor == 1)
"""The retry procedure of placements whose states are kept, and of their forks. A state counts time in steps, so
no world can start from one that was reached with half the timestep; the attempt that halves it is left out."""


@dataclass(frozen=True)
class Batching:
    """How much of a sweep is held and simulated at a time. None of it changes a result.

    Attributes:
        undriven: worlds without a drive handed to the engine at a time; their states are not kept. Their scenes take
            160 MB, of 43 boxes each; fewer would have the MJX engines choose (and compile) their shapes more often.
        placements: settled states kept at a time; one of 43 boxes takes 10 to 20 KB.
        worlds: variants that these states are forked into, at most (a single placement with more is one chunk).
        drives: forked worlds handed to the engine at a time; in a search a round of tests, whose outcomes are held.
    """

    undriven: int = DEFAULT_CHUNK_WORLDS
    placements: int = 4096
    worlds: int = 65_536
    drives: int = 16_384


@dataclass(frozen=True, eq=False)
class Settled:
    """A placement that is over: what it came to, with the state that drives start from."""

    group: PlacementGroup
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]


@dataclass(frozen=True, eq=False)
class SweptWorld:
    """One world of a sweep with its final outcome.

    Attributes:
        settled: the placement it was forked from; None for a world without a drive.
        driven: whether its drive was simulated. Where the placement does not stand, the world has its outcome;
            without early stop it is shaken, too, but is not stable.
    """

    plan: Plan
    variant: Variant
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]
    settled: Settled | None = None
    driven: bool = False


@dataclass(frozen=True, eq=False)
class Answer:
    """What a search found for one placement, profile and direction.

    Attributes:
        stands_at_rest: whether the placement stands without a drive; if not, nothing was tested.
        largest_survived, first_failed: level in g, or scale; None where there is none.
        at_largest, at_failure: the worlds that say so; None where no world was simulated for it.
        box, mode: which box went first at ``first_failed`` (or at rest), −1 for none, and how it failed.
        monotone: whether no tested level above ``first_failed`` was survived.
    """

    plan: Plan
    group: PlacementGroup
    item: SearchItem
    stands_at_rest: bool
    largest_survived: float | None
    first_failed: float | None
    at_largest: SweptWorld | None
    at_failure: SweptWorld | None
    box: int
    mode: str
    monotone: bool
    n_tests: int
    n_invalid: int


@dataclass
class Tally:
    """What a sweep has cost. Steps are world-steps after the soft start, of each world's last attempt."""

    placements: int = 0
    placement_steps: int = 0
    placement_s: float = 0.0
    drives: int = 0
    drive_steps: int = 0
    drive_s: float = 0.0


@dataclass(frozen=True, eq=False)
class _Placing(World):
    """A placement on its way through the runner."""

    group: PlacementGroup
    scene: Scene


@dataclass(frozen=True, eq=False)
class _Driving(World):
    """A fork on its way through the runner; ``test`` is its number among a round's tests."""

    settled: Settled
    change: Variant
    test: int = 0


@dataclass(eq=False)
class SweepRun:
    """One sweep on one engine. Iterate over :meth:`worlds` once; ``tally`` fills meanwhile.

    Args:
        plan: what to simulate.
        engine: states are its own: placements and drives run on the same instance.
        progress: kept up to date; its message says what is going on while no world finishes.
        on_answer: is called with each answer of a search. It should keep only what it needs: an answer holds worlds
            with all their boxes.
    """

    plan: SweepPlan
    engine: Engine
    on_answer: Callable[[Answer], None] = lambda answer: None
    progress: Progress = field(default_factory=Progress)
    batching: Batching = field(default_factory=Batching)
    tally: Tally = field(default_factory=Tally)

    @cached_property
    def sim(self) -> Simulation:
        """The configuration of every world, before retries change it."""
        return self.plan.sweep.simulation

    def worlds(self) -> Iterator[SweptWorld]:
        """Simulate everything; each world once, as it becomes final, in any order."""
        profiles = bool(self.plan.sweep.profiles)
        if self.plan.sweep.nominal or not profiles:
            yield from self._run_placements(group for group in self.plan.groups() if not _is_driven(group))
        if not profiles:
            return
        for chunk in self._chunks():
            settled = self._settle(chunk)
            yield from self._search(settled) if self.plan.search is not None else self._fork(settled)

    def _chunks(self) -> Iterator[list[PlacementGroup]]:
        """Placements with drives, as many at a time as may be held."""
        search = self.plan.search
        most = self.batching.worlds
        per_search = 0
        if search is not None:
            per_search = len(self.plan.search_items()) * search.sections
            most = self.batching.drives
        chunk: list[PlacementGroup] = []
        worlds = 0
        for group in filter(_is_driven, self.plan.groups()):
            more = len(group.variants) or per_search
            if chunk and (worlds + more > most or len(chunk) >= self.batching.placements):
                yield chunk
                chunk, worlds = [], 0
            chunk.append(group)
            worlds += more
        if chunk:
            yield chunk

    # Placements.

    def _placing(self, groups: Iterable[PlacementGroup], keep_state: bool) -> Iterator[_Placing]:
        for group in groups:
            scene = self.plan.scene(group)
            yield _Placing(group.plan, group.placement.index, Job(scene, keep_state=keep_state), group, scene)

    def _count_placement(self, outcome: Outcome) -> None:
        self.tally.placements += 1
        self.tally.placement_steps += outcome.n_steps

    def _run_placements(self, groups: Iterable[PlacementGroup]) -> Iterator[SweptWorld]:
        """Worlds without a drive: the placement's own outcome, rest window included."""
        watch = _Stopwatch()
        results = score_worlds(
            self._placing(groups, keep_state=False),
            self.sim,
            self.engine,
            progress=self.progress,
            chunk_worlds=self.batching.undriven,
        )
        for result in results:
            world = result.world
            assert isinstance(world, _Placing)
            self._count_placement(result.outcome)
            first, *others = world.group.variants
            yield SweptWorld(world.plan, first, world.scene, result.outcome, result.attempts)
            for variant in others:
                yield SweptWorld(world.plan, variant, world.scene, _as_fork(result.outcome), result.attempts)
        self.tally.placement_s += watch.seconds

    def _settle(self, groups: Sequence[PlacementGroup]) -> list[Settled]:
        """Simulate placements and keep their states, in the order of the groups."""
        watch = _Stopwatch()
        found: dict[int, Settled] = {}
        number = {id(group): index for index, group in enumerate(groups)}
        results = score_worlds(
            self._placing(groups, keep_state=True),
            self.sim,
            self.engine,
            progress=self.progress,
            chunk_worlds=self.batching.placements,
            attempts=SAME_STEP_ATTEMPTS,
        )
        for result in results:
            world = result.world
            assert isinstance(world, _Placing)
            self._count_placement(result.outcome)
            found[number[id(world.group)]] = Settled(world.group, world.scene, result.outcome, result.attempts)
            self.progress.message = f"placed {len(found):,} of {len(groups):,}"
        self.tally.placement_s += watch.seconds
        self.progress.message = ""
        return [found[index] for index in range(len(groups))]

    def _can_be_driven(self, settled: Settled) -> bool:
        """Not where the placement does not stand; without early stop, not where it is invalid."""
        outcome = settled.outcome
        shaken = outcome.verdict is Verdict.STABLE if self.sim.early_stop else outcome.verdict is not Verdict.INVALID
        return shaken and outcome.state is not None

    # Drives.

    def _fork(self, settled: Sequence[Settled]) -> Iterator[SweptWorld]:
        """All variants of settled placements."""

        def drives() -> Iterator[_Driving]:
            for start in settled:
                if self._can_be_driven(start):
                    for variant in start.group.variants:
                        yield self._driving(start, variant)

        for start in settled:
            if not self._can_be_driven(start):
                for variant in start.group.variants:
                    yield _undriven(start, variant)
        for _, world in self._drive(drives()):
            yield world

    def _driving(self, start: Settled, variant: Variant, test: int = 0) -> _Driving:
        plan = start.group.plan
        job = Job(start.scene, drive=self.plan.drive(plan, variant), start=start.outcome.state)
        return _Driving(plan, variant.index, job, start, variant, test)

    def _drive(self, worlds: Iterable[_Driving]) -> Iterator[tuple[int, SweptWorld]]:
        """Simulate forks; yields the number of the test with each."""
        watch = _Stopwatch()
        results = score_worlds(
            worlds,
            self.sim,
            self.engine,
            progress=self.progress,
            chunk_worlds=self.batching.drives,
            attempts=SAME_STEP_ATTEMPTS,
        )
        for result in results:
            world = result.world
            assert isinstance(world, _Driving)
            self.tally.drives += 1
            self.tally.drive_steps += result.outcome.n_steps
            yield world.test, _swept(world, result)
        self.tally.drive_s += watch.seconds

    # Search.

    def _search(self, settled: Sequence[Settled]) -> Iterator[SweptWorld]:
        """Bisection over all placements, profiles and directions of a chunk at once, round by round.

        A placement that does not stand has one row per profile and direction, at the lowest level, with its own
        outcome; nothing is simulated for it.
        """
        if not settled:
            return
        plan, search = self.plan, self.plan.search
        assert search is not None
        items = plan.search_items()
        asked = [(start, number) for start in settled for number in range(len(items))]
        stands = [start.outcome.verdict is Verdict.STABLE for start, _ in asked]
        bisection = Bisection(plan.search_levels, len(asked), stands, search.sections, self.sim.thresholds.tilt_deg)
        for (start, number), stood in zip(asked, stands, strict=True):
            if not stood:
                yield _undriven(start, plan.search_variant(start.group, number, 0))
        worlds: dict[tuple[int, int], SweptWorld] = {}
        while not bisection.done:
            tests, levels = bisection.next_tests()

            def drives(
                tests: Sequence[int] = tests.tolist(), levels: Sequence[int] = levels.tolist()
            ) -> Iterator[_Driving]:
                for test, (which, level) in enumerate(zip(tests, levels, strict=True)):
                    start, number = asked[which]
                    yield self._driving(start, plan.search_variant(start.group, number, level), test)

            done: dict[int, SweptWorld] = {}
            for test, world in self._drive(drives()):
                done[test] = world
                yield world
            bisection.record(tests, levels, [done[test].outcome for test in range(len(tests))])
            worlds.update({(int(tests[test]), int(levels[test])): world for test, world in done.items()})
            worlds = _needed(worlds, bisection)
        for answer in _answers(asked, items, bisection, worlds):
            self.on_answer(answer)


def _is_driven(group: PlacementGroup) -> bool:
    """Whether a placement's worlds have drives; all of a group have, or none. A search's group is empty."""
    return all(variant.drive is not None for variant in group.variants)


def _swept(world: _Driving, result: WorldResult) -> SweptWorld:
    start, outcome, placed = world.settled, result.outcome, world.settled.outcome
    if outcome.verdict is Verdict.STABLE and placed.verdict is not Verdict.STABLE:
        # what did not stand before it was shaken has not passed, even if it ends where the plan has it
        kept = ("verdict", "reason", "culprit", "first_sign_s")
        outcome = replace(outcome, **{name: getattr(placed, name) for name in kept})
    return SweptWorld(world.plan, world.change, start.scene, outcome, result.attempts, start, driven=True)


def _undriven(start: Settled, variant: Variant) -> SweptWorld:
    return SweptWorld(start.group.plan, variant, start.scene, _as_fork(start.outcome), start.attempts, start)


def _as_fork(outcome: Outcome) -> Outcome:
    """The outcome of another world as this one's own: no step was taken for it."""
    return replace(outcome, flags=outcome.flags | Flag.FORKED, n_steps=0, state=None)


def _needed(worlds: dict[tuple[int, int], SweptWorld], bisection: Bisection) -> dict[tuple[int, int], SweptWorld]:
    """The worlds that may yet be an answer: those at the bounds of each item's search."""
    bounds = {(item, level) for item, pair in enumerate(bisection.bounds()) for level in pair}
    return {key: world for key, world in worlds.items() if key in bounds}


def _answers(
    asked: Sequence[tuple[Settled, int]],
    items: Sequence[SearchItem],
    bisection: Bisection,
    worlds: dict[tuple[int, int], SweptWorld],
) -> Iterator[Answer]:
    rows = bisection.result().to_dict("records")
    for which, ((start, number), row, (low, high)) in enumerate(zip(asked, rows, bisection.bounds(), strict=True)):
        stands = bool(row["stands_at_rest"])
        box, mode = int(row["box"]), str(row["mode"])
        if not stands:
            box, mode = start.outcome.culprit, bisection.mode_of(start.outcome)
        yield Answer(
            plan=start.group.plan,
            group=start.group,
            item=items[number],
            stands_at_rest=stands,
            largest_survived=_known(row["largest_survived"]),
            first_failed=_known(row["first_failed"]),
            at_largest=worlds.get((which, low)),
            at_failure=worlds.get((which, high)) if stands else None,
            box=box,
            mode=mode,
            monotone=bool(row["monotone"]),
            n_tests=int(row["n_tests"]),
            n_invalid=int(row["n_invalid"]),
        )


def _known(value: float) -> float | None:
    return None if value != value else float(value)


class _Stopwatch:
    """Seconds since it was made."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._begin = clock()

    @property
    def seconds(self) -> float:
        return self._clock() - self._begin
