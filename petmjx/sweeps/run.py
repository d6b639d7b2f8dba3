"""Runs a sweep: simulates each placement once, forks the settled states into all drives, and searches levels.

The engine gets placements and drives in batches over many plans, since a device is fast with large batches.
``Batching`` limits what is in memory, for sweeps of any size.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from petmjx.config import Simulation
from petmjx.engines.base import Engine, Progress
from petmjx.engines.retry import ATTEMPTS, DEFAULT_CHUNK_WORLDS, AnyWorld, World, WorldResult, score_worlds
from petmjx.plans.plan import Plan
from petmjx.sweeps.design import SearchItem
from petmjx.sweeps.grid import PlacementGroup, SweepPlan
from petmjx.sweeps.search import Bisection, Found
from petmjx.verdict import Attempt, Flag, Outcome, Verdict
from petmjx.world.job import Job
from petmjx.world.scene import Scene
from petmjx.world.variants import Variant

SAME_STEP_ATTEMPTS = tuple(attempt for attempt in ATTEMPTS if attempt.timestep_divisor == 1)
"""The attempts at placements whose states are kept, and at their forks. A state counts time in steps, so no world can
start from a state that was reached with half the timestep: the attempt with half the timestep is left out."""

Test = tuple[int, int]
"""Item of a search and index of the tested level, as in `Bisection`."""


@dataclass(frozen=True)
class Batching:
    """How much of a sweep is in memory and in the engine at the same time. None of it changes a result.

    Attributes:
        undriven: most worlds without a drive in one call of the engine; their states are not kept. With 43 boxes each,
            their scenes take 160 MB. With fewer, the MJX engines would choose (and compile) their shapes more often.
        placements: most settled states that are kept; one with 43 boxes takes 10 to 20 KB.
        worlds: most variants into which these states are forked (a single placement may have more).
        drives: most forked worlds in one call of the engine; in a search also the tests of one round.
    """

    undriven: int = DEFAULT_CHUNK_WORLDS
    placements: int = 4096
    worlds: int = 65_536
    drives: int = 16_384


@dataclass(frozen=True, eq=False)
class Settled:
    """A placement that has settled: its outcome, with the state from which drives start."""

    group: PlacementGroup
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]


@dataclass(frozen=True, eq=False)
class SweptWorld:
    """One world of a sweep with its final outcome.

    Attributes:
        settled: the placement it was forked from; None for a world that was simulated from its beginning.
        driven: whether its drive was simulated. If the placement does not stand, the world has its outcome; without
            early stop it is shaken, too, but is not stable.
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
    """The answer of a search for one placement, profile and direction.

    Attributes:
        largest_survived, first_failed: level in g, or scale; None where there is none.
        at_largest, at_failure: the worlds that say so; None where no world was simulated for it.
    """

    group: PlacementGroup
    item: SearchItem
    found: Found
    largest_survived: float | None
    first_failed: float | None
    at_largest: SweptWorld | None
    at_failure: SweptWorld | None


@dataclass
class Tally:
    """What a sweep has cost so far. Steps are world-steps after the soft start, of each world's last attempt."""

    placements: int = 0
    placement_steps: int = 0
    placement_s: float = 0.0
    drives: int = 0
    drive_steps: int = 0
    drive_s: float = 0.0


@dataclass(frozen=True, eq=False)
class _Placing(World):
    """A placement as a world that the engine simulates."""

    group: PlacementGroup


@dataclass(frozen=True, eq=False)
class _Driving(World):
    """A fork as a world that the engine simulates; ``test``: the test of a search that it is."""

    settled: Settled
    change: Variant
    test: Test = (-1, -1)


@dataclass(eq=False)
class SweepRun:
    """One sweep on one engine. Iterate over :meth:`worlds` once; ``tally`` fills meanwhile.

    Args:
        plan: what to simulate.
        engine: placements and drives run on this one object, since only it can use its states.
        progress: kept up to date; its message says what happens while no world finishes.
        on_answer: called with each answer of a search. It should keep only what it needs: an answer has worlds with all
            their boxes.
    """

    plan: SweepPlan
    engine: Engine
    on_answer: Callable[[Answer], None] = lambda answer: None
    progress: Progress = field(default_factory=Progress)
    batching: Batching = field(default_factory=Batching)
    tally: Tally = field(default_factory=Tally)

    @cached_property
    def sim(self) -> Simulation:
        """The options of every world, before attempts change them."""
        return self.plan.sweep.simulation

    def worlds(self) -> Iterator[SweptWorld]:
        """Simulate everything; yield each world when it is final, in any order."""
        profiles = bool(self.plan.sweep.profiles)
        if self.plan.sweep.nominal or not profiles:
            yield from self._run_placements(group for group in self.plan.groups() if not _is_driven(group))
        if not profiles:
            return
        for chunk in self._chunks():
            settled = self._settle(chunk)
            yield from self._search(settled) if self.plan.sweep.search is not None else self._fork(settled)

    def _chunks(self) -> Iterator[list[PlacementGroup]]:
        """Placements with drives, in chunks as large as ``Batching`` allows."""
        search = self.plan.sweep.search
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

    def _score(self, worlds: Iterable[AnyWorld], chunk_worlds: int, forks: bool) -> Iterator[WorldResult[AnyWorld]]:
        attempts = SAME_STEP_ATTEMPTS if forks else ATTEMPTS
        return score_worlds(
            worlds, self.sim, self.engine, progress=self.progress, chunk_worlds=chunk_worlds, attempts=attempts
        )

    # Placements.

    def _place(self, groups: Iterable[PlacementGroup], chunk_worlds: int, keep_state: bool) -> Iterator[Settled]:
        begin = time.perf_counter()
        worlds = (
            _Placing(group.plan, group.placement.index, Job(self.plan.scene(group), keep_state=keep_state), group)
            for group in groups
        )
        for result in self._score(worlds, chunk_worlds, forks=keep_state):
            self.tally.placements += 1
            self.tally.placement_steps += result.outcome.n_steps
            yield Settled(result.world.group, result.world.job.scene, result.outcome, result.attempts)
        self.tally.placement_s += time.perf_counter() - begin

    def _run_placements(self, groups: Iterable[PlacementGroup]) -> Iterator[SweptWorld]:
        """Worlds without a drive: they have the placement's outcome, with rest window."""
        for placed in self._place(groups, self.batching.undriven, keep_state=False):
            first, *others = placed.group.variants
            yield SweptWorld(placed.group.plan, first, placed.scene, placed.outcome, placed.attempts)
            for variant in others:
                yield _undriven(placed, variant)

    def _settle(self, groups: Sequence[PlacementGroup]) -> list[Settled]:
        """Simulate placements and keep their states, in the order of the groups."""
        found: dict[int, Settled] = {}
        for settled in self._place(groups, self.batching.placements, keep_state=True):
            found[id(settled.group)] = settled
            self.progress.message = f"placed {len(found):,} of {len(groups):,}"
        self.progress.message = ""
        return [found[id(group)] for group in groups]

    def _can_be_driven(self, settled: Settled) -> bool:
        """Not if the placement does not stand; without early stop, not if it is invalid."""
        outcome = settled.outcome
        shaken = outcome.verdict is Verdict.STABLE if self.sim.early_stop else outcome.verdict is not Verdict.INVALID
        return shaken and outcome.state is not None

    # Drives.

    def _fork(self, settled: Sequence[Settled]) -> Iterator[SweptWorld]:
        """All variants of settled placements."""
        for start in settled:
            if not self._can_be_driven(start):
                for variant in start.group.variants:
                    yield _undriven(start, variant)
        shaken = (start for start in settled if self._can_be_driven(start))
        drives = (self._driving(start, variant) for start in shaken for variant in start.group.variants)
        for _, world in self._drive(drives):
            yield world

    def _driving(self, start: Settled, variant: Variant, test: Test = (-1, -1)) -> _Driving:
        plan = start.group.plan
        job = Job(start.scene, drive=self.plan.drive(plan, variant), start=start.outcome.state)
        return _Driving(plan, variant.index, job, start, variant, test)

    def _drive(self, worlds: Iterable[_Driving]) -> Iterator[tuple[Test, SweptWorld]]:
        """Simulate forks; yield each one with its test."""
        begin = time.perf_counter()
        for result in self._score(worlds, self.batching.drives, forks=True):
            world, outcome = result.world, result.outcome
            self.tally.drives += 1
            self.tally.drive_steps += outcome.n_steps
            final = _as_placed(outcome, world.settled.outcome)
            swept = SweptWorld(
                world.plan, world.change, world.job.scene, final, result.attempts, world.settled, driven=True
            )
            yield world.test, swept
        self.tally.drive_s += time.perf_counter() - begin

    # Search.

    def _search(self, settled: Sequence[Settled]) -> Iterator[SweptWorld]:
        """Bisection over all placements, profiles and directions of a chunk together, round by round.

        A placement that does not stand has one row per profile and direction, at the lowest level, with its own
        outcome. Nothing more is simulated for it.
        """
        sweep, items = self.plan.sweep, self.plan.search_items()
        assert sweep.search is not None
        asked = [(start, number) for start in settled for number in range(len(items))]
        at_rest = [start.outcome for start, _ in asked]
        bisection = Bisection(sweep.search_levels, at_rest, sweep.search.sections, self.sim.thresholds.tilt_deg)

        def variant(which: int, level: int) -> Variant:
            start, number = asked[which]
            return self.plan.search_variant(start.group, number, level)

        for which, found in enumerate(bisection.items):
            if not found.stands_at_rest:
                yield _undriven(asked[which][0], variant(which, 0))
        worlds: dict[Test, SweptWorld] = {}
        while tests := bisection.next_tests():
            drives = (self._driving(asked[test[0]][0], variant(*test), test) for test in tests)
            for test, world in self._drive(drives):
                worlds[test] = world
                yield world
            bisection.record(tests, [worlds[test].outcome for test in tests])
            # Only the worlds at the bounds of an item's search can still become an answer.
            worlds = {test: worlds[test] for test in bisection.bounds() if test in worlds}
        for which, ((start, number), found) in enumerate(zip(asked, bisection.items, strict=True)):
            self.on_answer(
                Answer(
                    start.group,
                    items[number],
                    found,
                    bisection.largest_survived(which),
                    bisection.first_failed(which),
                    worlds.get((which, found.survived)),
                    worlds.get((which, found.failed)),
                )
            )


def _is_driven(group: PlacementGroup) -> bool:
    """Whether a placement's worlds have drives. All worlds of a group have one, or none has. True for a search."""
    return all(variant.drive is not None for variant in group.variants)


def _as_placed(outcome: Outcome, placed: Outcome) -> Outcome:
    """What did not stand before it was shaken has not passed, even if it ends where the plan has it."""
    if outcome.verdict is not Verdict.STABLE or placed.verdict is Verdict.STABLE:
        return outcome
    kept = ("verdict", "reason", "culprit", "first_sign_s")
    return replace(outcome, **{name: getattr(placed, name) for name in kept})


def _undriven(start: Settled, variant: Variant) -> SweptWorld:
    """A world with the outcome of another one: no step was simulated for it."""
    outcome = replace(start.outcome, flags=start.outcome.flags | Flag.FORKED, n_steps=0, state=None)
    return SweptWorld(start.group.plan, variant, start.scene, outcome, start.attempts, start)
