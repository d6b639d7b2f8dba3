"""Runs a sweep: simulates each placement of boxes once, starts all drives (motions of the carrier) or chains from the
settled state of their placement, and searches for the largest levels survived.

The engine gets the placements, drives and legs (parts of a chain) of many plans in one stream, since a GPU is efficient
only with many simulations at a time. ``petmjx.runs.forked_worlds.Batching`` limits the memory of a sweep.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from petmjx.engines.attempt_settings import ATTEMPTS
from petmjx.engines.job_stream import JobBounds
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.simulation_loop import FIRST_WORLDS, check_pool_for, score_worlds
from petmjx.engines.subprocess.check_pool import CheckPool
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.engines.world_results import AnyWorld, WorldResult
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.results.recording import NO_RECORDING, Recording
from petmjx.results.resume import CompletedWorlds
from petmjx.runs.chain_legs import PLACING, after, with_sustained_force
from petmjx.runs.forked_worlds import Batching, DriveWorld, LegStart, LegWorld, PlacementWorld, SettledPlacement, Test
from petmjx.runs.level_search import Bisection, Probe, SearchBracket
from petmjx.runs.study import FinishedWorld, LegEnd
from petmjx.runs.sweep_cost import job_bounds
from petmjx.runs.sweep_design import SearchItem
from petmjx.runs.sweep_worlds import PlacementGroup, SweepPlan
from petmjx.world.job import Job
from petmjx.world.variants import LegSpec, Variant


@dataclass
class Tally:
    """What a sweep has cost up to now: numbers of simulations, numbers of steps, and times in s. Of each simulation,
    only the steps of its last attempt, after the soft start, are counted."""

    placements: int = 0
    placement_steps: int = 0
    placement_s: float = 0.0
    drives: int = 0
    drive_steps: int = 0
    drive_s: float = 0.0


@dataclass(frozen=True, eq=False)
class SearchAnswer:
    """The answer of a search for one placement, one profile and one direction.

    Attributes:
        largest_survived, first_failed: largest level survived, and smallest level that failed, in g or as a scale.
            ``largest_survived`` is None if no level was survived, and ``first_failed`` is None if no level failed.
        at_largest, at_failure: results of the tests at the levels ``largest_survived`` and ``first_failed``; None if
            there was no test at the level.
    """

    group: PlacementGroup
    item: SearchItem
    bracket: SearchBracket
    largest_survived: float | None
    first_failed: float | None
    at_largest: Probe | None
    at_failure: Probe | None


SAME_STEP_ATTEMPTS = tuple(attempt for attempt in ATTEMPTS if attempt.timestep_divisor == 1 and not attempt.soft)
"""The attempts for placements whose states are stored, and for the simulations that start from these states. Attempts
with half the timestep or with soft boxes are left out. A state counts time in steps of the usual timestep, and attempts
with soft boxes neither store states nor start from them."""


def _n_drives(variant: Variant) -> int:
    """Number of drives or legs of a variant that are simulated if the pallet stands until the end."""
    return len(variant.legs) or int(variant.drive is not None)


def _drained(worlds: list[AnyWorld]) -> list[AnyWorld]:
    """Empty a list of worlds, and return the worlds."""
    drained = worlds.copy()
    worlds.clear()
    return drained


@dataclass(eq=False)
class SweepRun:
    """Runs one sweep on one engine. Iterate over :meth:`worlds` once; the iteration updates ``tally``.

    Args:
        plan: the sweep with its plans.
        engine: the engine for placements and drives. The engine object must stay the same for the whole sweep, since no
            other object can use its states.
        progress: progress of the run, which is updated during the simulation. While placements are simulated,
            ``progress.message`` has the number of placements that have ended.
        on_answer: function that is called for each answer of a search.
        values_of: function that returns column → value, for the columns that the sweep adds to the row of a world.
        recorded: the completed worlds of the run. Completed worlds are not simulated again; the answers of a search are
            computed from the rows of completed worlds.
        recording: determines which worlds are recorded, and which histories are stored.
    """

    plan: SweepPlan
    engine: Engine
    on_answer: Callable[[SearchAnswer], None] = lambda answer: None
    values_of: Callable[[FinishedWorld], Mapping[str, Any]] = lambda world: {}
    recorded: CompletedWorlds = field(default_factory=CompletedWorlds)
    recording: Recording = NO_RECORDING
    progress: Progress = field(default_factory=Progress)
    batching: Batching = field(default_factory=Batching)
    tally: Tally = field(default_factory=Tally)
    _check_pool: CheckPool[Any] | None = field(default=None, init=False)
    _work_done: int = field(default=0, init=False)
    _work: int = field(default=0, init=False)
    """Total work: the sum of the numbers of boxes over all placements, drives and legs; 0 if the total is unknown or if
    there are only placements."""

    @cached_property
    def sim(self) -> Simulation:
        """The options with which every world is simulated. If a world needs further attempts, they may use other
        options."""
        return self.plan.sweep.simulation

    def worlds(self) -> Iterator[FinishedWorld]:
        """Simulate all missing worlds. Yields each world when its outcome is final, in any order."""
        # The check pool takes seconds to start, and is needed soon after the first drives begin. So the check pool is
        # started before the first boxes are placed.
        is_counted = self.plan.sweep.search is None
        self._check_pool = check_pool_for(self.engine, self.plan.n_worlds - len(self.recorded)) if is_counted else None
        try:
            yield from self._all_worlds()
        finally:
            if self._check_pool is not None:
                self._check_pool.close()

    def _all_worlds(self) -> Iterator[FinishedWorld]:
        has_drives = self.plan.sweep.has_drives
        if has_drives and self.plan.sweep.search is None:
            self._work = sum(
                group.plan.n_boxes * (1 + sum(map(_n_drives, self._missing(group)))) for group in self._groups()
            )
        if self.plan.sweep.nominal or not has_drives:
            yield from self._run_placements(group for group in self._groups() if not group.driven)
        if not has_drives:
            return
        for chunk in self._chunks():
            if self.plan.sweep.search is None:
                yield from self._fork(chunk)
            else:
                yield from self._search(self._settle([group for group in chunk if not self._answer_again(group)]))

    def world(self, plan_id: str, index: int) -> FinishedWorld:
        """Simulate one world alone, exactly as in the whole sweep.

        Args:
            index: number of the variant, as in ``worlds``.

        Raises:
            InputError: the plan has no such variant.
        """
        group, variant = self.plan.find(plan_id, index)
        if not group.driven:
            return next(world for world in self._run_placements([group]) if world.variant.index == index)
        (world,) = self._fork([replace(group, variants=(variant,))])
        return world

    def _groups(self) -> Iterator[PlacementGroup]:
        """The placements from which worlds must still be simulated. In a search, all placements are returned, since
        only outcomes can tell which worlds a search needs."""
        return (group for group in self.plan.groups(self._has_all_worlds) if not group.variants or self._missing(group))

    def _has_all_worlds(self, plan: Plan) -> bool:
        """Whether a resumed run has already completed all worlds of a plan. If all worlds of the plan are complete,
        they need not be checked one by one."""
        is_counted = self.plan.sweep.search is None
        return is_counted and self.recorded.n_of(plan.plan_id) == self.plan.n_variants

    def _missing(self, group: PlacementGroup) -> list[Variant]:
        """The variants of a placement whose worlds must still be simulated."""
        return [variant for variant in group.variants if (group.plan.plan_id, variant.index) not in self.recorded]

    def _chunks(self) -> Iterator[list[PlacementGroup]]:
        """Placements with drives, in groups as large as ``Batching`` allows."""
        search = self.plan.sweep.search
        # the limit for chains is lower: in a leg, each world may have a drive of its own, whose samples take memory
        most = self.batching.worlds if search is None and not self.plan.sweep.legs else self.batching.drives
        per_search = 0 if search is None else len(self.plan.search_items()) * search.sections
        chunk: list[PlacementGroup] = []
        worlds = histories = 0
        for group in (group for group in self._groups() if group.driven):
            n_forks = len(group.variants) or per_search
            more_histories = int(self.recording.of(group.plan) is not None)
            full = worlds + n_forks > most or len(chunk) >= self.batching.placements
            if chunk and (full or histories + more_histories > self.batching.histories):
                yield chunk
                chunk, worlds, histories = [], 0, 0
            chunk.append(group)
            worlds += n_forks
            histories += more_histories
        if chunk:
            yield chunk

    def _score(
        self,
        worlds: Iterable[AnyWorld],
        most_pending: int,
        *,
        forks: bool,
        begin_with: int = FIRST_WORLDS,
        following: Callable[[], Iterable[AnyWorld]] | None = None,
        bounds: JobBounds | None = None,
    ) -> Iterator[WorldResult[AnyWorld]]:
        return score_worlds(
            worlds,
            self.sim,
            self.engine,
            progress=self.progress,
            begin_with=begin_with,
            most_pending=most_pending,
            attempts=SAME_STEP_ATTEMPTS if forks else ATTEMPTS,
            following=following,
            bounds=bounds,
            check_pool=self._check_pool,
        )

    # Placements.

    def _place(
        self, groups: Iterable[PlacementGroup], most_pending: int, keep_state: bool
    ) -> Iterator[SettledPlacement]:
        begin = time.perf_counter()
        for result in self._score(self._placements(groups, keep_state), most_pending, forks=keep_state):
            yield self._settled(result)
        self.tally.placement_s += time.perf_counter() - begin

    def _placements(self, groups: Iterable[PlacementGroup], keep_state: bool) -> Iterator[PlacementWorld]:
        return (
            PlacementWorld(
                group.plan,
                group.index,
                self.plan.job(group, scene, keep_state=keep_state, record=self.recording.of(group.plan)),
                group,
            )
            for group, scene in self.plan.scenes(groups)
        )

    def _note_work(self, plan: Plan, count: int = 1) -> None:
        """Report to the display of progress that ``count`` placements, drives or legs of a plan have ended or will not
        be simulated."""
        self._work_done += count * plan.n_boxes
        if self._work:
            self.progress.work_share = self._work_done / self._work

    def _settled(self, result: WorldResult[Any]) -> SettledPlacement:
        self._note_work(result.world.plan)
        self.tally.placements += 1
        self.tally.placement_steps += result.outcome.n_steps
        return SettledPlacement(result.world.group, result.world.job.scene, result.outcome, result.attempts)

    def _run_placements(self, groups: Iterable[PlacementGroup]) -> Iterator[FinishedWorld]:
        """Simulate placements without drives. All variants of a placement get the outcome of the placement."""
        for placed in self._place(groups, self.batching.undriven, keep_state=False):
            for variant in self._missing(placed.group):
                if variant is placed.group.variants[0]:
                    yield FinishedWorld(placed.group.plan, variant, placed.scene, placed.outcome, placed.attempts)
                else:
                    yield placed.undriven(variant)

    def _settle(self, groups: Sequence[PlacementGroup]) -> list[SettledPlacement]:
        """Simulate placements, and return them with their settled states, in the order of the groups."""
        settled_by_group: dict[int, SettledPlacement] = {}
        for settled in self._place(groups, self.batching.placements, keep_state=True):
            settled_by_group[id(settled.group)] = settled
            self.progress.message = f"placed {len(settled_by_group):,} of {len(groups):,}"
        self.progress.message = ""
        return [settled_by_group[id(group)] for group in groups]

    def _can_be_driven(self, settled: SettledPlacement) -> bool:
        """Whether drives (motions of the carrier) are simulated after a placement. With the option ``early_stop``,
        drives are simulated only if the pallet stands at the end of the placement. Without the option ``early_stop``,
        the simulation of the placement only has to be valid."""
        outcome = settled.outcome
        shaken = outcome.verdict is Verdict.STABLE if self.sim.early_stop else outcome.verdict is not Verdict.INVALID
        return shaken and outcome.state is not None

    # Drives.

    def _fork(self, groups: Sequence[PlacementGroup]) -> Iterator[FinishedWorld]:
        """Simulate placements, and start the worlds of all variants from the settled states of these placements. Drives
        and the first legs of chains begin as soon as their own placement has settled, while other placements continue.
        A further leg begins when the leg before it has ended."""
        begin = time.perf_counter()
        n_settled = 0
        ready: list[DriveWorld | LegWorld] = []
        following, bounds = partial(_drained, ready), job_bounds(self.plan, groups)
        worlds: Iterator[PlacementWorld | DriveWorld | LegWorld] = self._placements(groups, keep_state=True)
        for result in self._score(worlds, self.batching.drives, forks=True, following=following, bounds=bounds):
            if isinstance(result.world, DriveWorld):
                yield self._driven(result)
                continue
            if isinstance(result.world, LegWorld):
                ended, further = self._after_leg(result)
                if further is not None:
                    ready += self._legs_of(further)
                yield from ended
                continue
            start, n_settled = self._settled(result), n_settled + 1
            self.progress.message = f"placed {n_settled:,} of {len(groups):,}" if n_settled < len(groups) else ""
            if n_settled == len(groups):
                self.tally.placement_s += time.perf_counter() - begin
                begin = time.perf_counter()
            missing = self._missing(start.group)
            if not self._can_be_driven(start):
                self._note_work(start.group.plan, sum(map(_n_drives, missing)))
                yield from map(start.undriven, missing)
            elif missing[0].legs:
                ready += self._legs_of(LegStart(start, tuple(missing), 0, None))
            else:
                ready += (self._driving(start, variant) for variant in missing)
        self.tally.drive_s += time.perf_counter() - begin

    def _driving(self, start: SettledPlacement, variant: Variant, test: Test = (-1, -1)) -> DriveWorld:
        plan = start.group.plan
        drive, record = self.plan.drive(plan, variant, start.load_height_m), self.recording.of(plan)
        job = Job(start.scene, drive=drive, start=start.outcome.state, record=record)
        return DriveWorld(plan, variant.index, job, start, variant, test)

    def _drive(
        self, worlds: Iterable[DriveWorld], following: Callable[[], Iterable[DriveWorld]] | None = None
    ) -> Iterator[tuple[Test, FinishedWorld]]:
        """Simulate drives, and yield each finished world with its test. ``following`` is called for further drives,
        which depend on the results so far."""
        begin = time.perf_counter()
        most = self.batching.drives  # all drives can begin immediately, since their scenes have already been made
        for result in self._score(worlds, most, forks=True, begin_with=most, following=following):
            yield result.world.test, self._driven(result)
        self.tally.drive_s += time.perf_counter() - begin

    def _driven(self, result: WorldResult[Any]) -> FinishedWorld:
        world, outcome = result.world, result.outcome
        self._note_work(world.plan)
        self.tally.drives += 1
        self.tally.drive_steps += outcome.n_steps
        final = world.settled.shaken(outcome, self.sim.thresholds)
        return FinishedWorld(
            world.plan, world.change, world.job.scene, final, result.attempts, world.settled.outcome, driven=True
        )

    # Chains.

    def _legs_of(self, begin: LegStart) -> Iterator[LegWorld]:
        """The worlds of the next leg, for the variants of ``begin``, whose journeys were equal so far. Variants whose
        next leg is also equal share one world."""
        placed, before = begin.settled, begin.before
        plan, record = placed.group.plan, self.recording.of(placed.group.plan)
        alike: dict[tuple[LegSpec, int], list[Variant]] = {}
        for change in begin.changes:
            alike.setdefault((change.legs[begin.number], change.replicate), []).append(change)
        for (leg, _), changes_of_leg in alike.items():
            drive = self.plan.leg_drive(plan, changes_of_leg[0], leg, placed.load_height_m)
            poses = None if before is None else np.concatenate([before.boxes.pos, before.boxes.quat], axis=1)
            scene = placed.scene_of(leg)
            job = Job(scene, drive=drive, start=placed.outcome.state, poses=poses, record=record)
            yield LegWorld(plan, changes_of_leg[0].index, job, replace(begin, changes=tuple(changes_of_leg)))

    def _after_leg(self, result: WorldResult[Any]) -> tuple[list[FinishedWorld], LegStart | None]:
        """The finished worlds of variants that end with this leg; and the beginning of the next leg of all other
        variants, or None if all variants have ended."""
        self.tally.drives += 1
        self.tally.drive_steps += result.outcome.n_steps
        world: LegWorld = result.world
        begin = world.begin
        if begin.before is None:
            outcome = begin.settled.shaken(result.outcome, self.sim.thresholds)
            outcome = with_sustained_force(outcome, begin.settled.outcome.boxes)
        else:
            outcome = after(begin.before, result.outcome, self.sim.physics.timestep_s)
        stands, number = outcome.verdict is Verdict.STABLE, begin.number + 1
        end = None if stands else self._end(world, outcome, result.outcome.n_steps)
        further = tuple(change for change in begin.changes if stands and len(change.legs) > number)
        ended = []
        for change in begin.changes:
            if change in further:
                self._note_work(world.plan)
                continue
            self._note_work(world.plan, len(change.legs) - begin.number)
            scene, placed = world.job.scene, begin.settled.outcome
            ended.append(FinishedWorld(world.plan, change, scene, outcome, result.attempts, placed, True, end))
        return ended, LegStart(begin.settled, further, number, outcome) if further else None

    def _end(self, world: LegWorld, outcome: Outcome, n_steps: int) -> LegEnd:
        """The leg in which the pallet of an unstable or invalid world failed. ``n_steps``: number of steps of this
        leg."""
        if world.begin.settled.outcome.verdict is not Verdict.STABLE:
            return LegEnd(PLACING, 0.0)
        return LegEnd(world.leg.name, outcome.sim_time_s - n_steps * self.sim.physics.timestep_s)

    # Search.

    def _search(self, settled: Sequence[SettledPlacement]) -> Iterator[FinishedWorld]:
        """Search for the largest level survived, for all given placements, profiles and directions at the same time.

        A search item is one combination of a placement, a profile and a direction. When all current tests of a search
        item have ended, its next tests begin, while tests of other search items continue. If the pallet does not stand
        at the end of a placement, no drive is simulated. The table ``worlds`` then has one row per profile and
        direction, at the lowest level, with the outcome of the placement.
        """
        items, thresholds = self.plan.search_items(), self.sim.thresholds
        searches = [(start, number) for start in settled for number in range(len(items))]
        bisection = self._bisection([Probe.of(start.outcome, thresholds) for start, _ in searches])

        def variant(which: int, level: int) -> Variant:
            start, number = searches[which]
            return self.plan.search_variant(start.group, number, level)

        def recorded(which: int, level: int) -> Probe | None:
            start, number = searches[which]
            return self._recorded_test(start.group, number, level)

        for which, bracket in enumerate(bisection.items):
            if not bracket.stands_at_rest and recorded(which, 0) is None:
                yield searches[which][0].undriven(variant(which, 0))
        tested: dict[Test, Probe] = {}
        missing: dict[int, set[Test]] = {}

        def next_drives(which: int) -> list[DriveWorld]:
            """The drives that a search item needs next; an empty list if the answer for the item is known."""
            while tests := bisection.next_tests(which):
                probes = {test: probe for test in tests if (probe := tested.get(test) or recorded(*test)) is not None}
                tested.update(probes)
                if missing_now := [test for test in tests if test not in probes]:
                    missing[which] = set(missing_now)
                    return [self._driving(searches[which][0], variant(*test), test) for test in missing_now]
                # Only two results can still become the answer for a search item: the result at the largest level that
                # the pallet survived, and the result at the smallest level at which it failed. The others are dropped.
                now = {test: tested.pop(test) for test in {*tests, *bisection.bounds(which)} if test in tested}
                bisection.record(tests, [now[test] for test in tests])
                tested.update((test, now[test]) for test in bisection.bounds(which) if test in now)
            return []

        ready_drives: list[DriveWorld] = []
        # ``first`` is a list, because the engine would run a generator, and with it the search, in another thread.
        first = [drive for which in range(len(searches)) for drive in next_drives(which)]
        for test, world in self._drive(first, partial(_drained, ready_drives)):
            which, _ = test
            tested[test] = Probe.of(world.outcome, thresholds, self.values_of(world))
            missing[which].remove(test)
            if not missing[which]:
                ready_drives += next_drives(which)
            yield world
        self._answer([(start.group, number) for start, number in searches], bisection, tested)

    def _bisection(self, at_rest: Sequence[Probe]) -> Bisection:
        sweep = self.plan.sweep
        assert sweep.search is not None
        return Bisection(sweep.search_levels, at_rest, sweep.search.sections)

    def _answer(
        self, searches: Sequence[tuple[PlacementGroup, int]], bisection: Bisection, tested: Mapping[Test, Probe]
    ) -> None:
        items = self.plan.search_items()
        for which, ((group, number), bracket) in enumerate(zip(searches, bisection.items, strict=True)):
            self.on_answer(
                SearchAnswer(
                    group,
                    items[number],
                    bracket,
                    bisection.largest_survived(which),
                    bisection.first_failed(which),
                    tested.get((which, bracket.survived)),
                    tested.get((which, bracket.failed)),
                )
            )

    def _answer_again(self, group: PlacementGroup) -> bool:
        """Find the answers of a search (the largest levels survived) for one placement again. The answers follow from
        the rows of worlds that were completed before the run was resumed. Returns False if a world is missing."""
        if not len(self.recorded):
            return False
        numbers = range(len(self.plan.search_items()))
        bisection = self._bisection([self._recorded_rest(group, number) for number in numbers])
        if any(
            bracket.stands_at_rest and not bisection.next_tests(which) for which, bracket in enumerate(bisection.items)
        ):
            # a search with a single level tests no level, so no recorded row shows whether the placement stood
            return False
        tested: dict[Test, Probe] = {}
        for which in range(len(bisection.items)):
            while tests := bisection.next_tests(which):
                worlds = [self._recorded_test(group, *test) for test in tests]
                stored_worlds = [world for world in worlds if world is not None]
                if len(stored_worlds) < len(tests):
                    return False
                tested |= zip(tests, stored_worlds, strict=True)
                bisection.record(tests, stored_worlds)
        self._answer([(group, number) for number in numbers], bisection, tested)
        return True

    def _recorded_rest(self, group: PlacementGroup, number: int) -> Probe:
        """The result of a placement without a profile, found from the rows of completed worlds. If the pallet did not
        stand, its search has written a single row: for the lowest level, with 0 simulated steps. The result is then the
        outcome in this row. In all other cases, the result is a stable outcome. A failed test at the lowest level may
        also have 0 steps, but then the search has also written rows of tests at higher levels.
        """
        row = self._row(group, number, 0)
        first = self._bisection([Probe(Verdict.STABLE)]).next_tests(0)
        tested = any(self._row(group, number, level) is not None for _, level in first if level > 0)
        fell = row is not None and row["n_steps"] == 0 and not tested
        return Probe.from_row(row) if fell and row is not None else Probe(Verdict.STABLE)

    def _recorded_test(self, group: PlacementGroup, number: int, level: int) -> Probe | None:
        row = self._row(group, number, level)
        return None if row is None else Probe.from_row(row)

    def _row(self, group: PlacementGroup, number: int, level: int) -> dict[str, Any] | None:
        if not len(self.recorded):
            return None
        return self.recorded.row(group.plan.plan_id, self.plan.search_variant(group, number, level).index)
