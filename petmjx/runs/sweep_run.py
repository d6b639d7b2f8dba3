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
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.simulation_loop import check_pool_for, score_worlds
from petmjx.engines.subprocess.check_pool import CheckPool
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.engines.world_results import AnyWorld, WorldResult
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.results.recording import NO_RECORDING, Recording
from petmjx.results.resume import CompletedWorlds
from petmjx.runs.chain_legs import PLACING, after, with_sustained_force
from petmjx.runs.forked_worlds import (
    Batching,
    DriveWorld,
    LegStart,
    LegWorld,
    PlacementSearch,
    PlacementWorld,
    SettledPlacement,
)
from petmjx.runs.level_search import LevelSearch, Probe
from petmjx.runs.study import FinishedWorld, LegEnd
from petmjx.runs.sweep_cost import job_bounds
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
        on_answer: function that is called for each search that has found its answer.
        values_of: function that returns column → value, for the columns that the sweep adds to the row of a world.
        recorded: the completed worlds of the run. Completed worlds are not simulated again; the answers of a search are
            computed from the rows of completed worlds.
        recording: determines which worlds are recorded, and which histories are stored.
    """

    plan: SweepPlan
    engine: Engine
    on_answer: Callable[[PlacementSearch], None] = lambda search: None
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
            yield from self._fork(chunk)

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
        is_grid = self.plan.sweep.search is None and not self.plan.sweep.legs
        # the limit for chains is lower: in a leg, each world may have a drive of its own, whose samples take memory
        most = self.batching.worlds if is_grid else self.batching.drives
        chunk: list[PlacementGroup] = []
        worlds = histories = 0
        for group in self._groups():
            if not group.driven or (not group.variants and self._answer_again(group)):
                continue
            n_forks = self.plan.most_forks(group)
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

    # Placements.

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
        begin = time.perf_counter()
        for result in score_worlds(
            self._placements(groups, keep_state=False),
            self.sim,
            self.engine,
            progress=self.progress,
            most_pending=self.batching.undriven,
            check_pool=self._check_pool,
        ):
            placed = self._settled(result)
            for variant in self._missing(placed.group):
                if variant is placed.group.variants[0]:
                    yield FinishedWorld(placed.group.plan, variant, placed.scene, placed.outcome, placed.attempts)
                else:
                    yield placed.undriven(variant)
        self.tally.placement_s += time.perf_counter() - begin

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
        A further leg begins when the leg before it has ended, and further tests of a search begin when all tests before
        them have ended."""
        begin = time.perf_counter()
        n_settled = 0
        ready: list[DriveWorld | LegWorld] = []
        worlds: Iterator[PlacementWorld | DriveWorld | LegWorld] = self._placements(groups, keep_state=True)
        for result in score_worlds(
            worlds,
            self.sim,
            self.engine,
            progress=self.progress,
            most_pending=self.batching.drives,
            attempts=SAME_STEP_ATTEMPTS,
            following=partial(_drained, ready),
            bounds=job_bounds(self.plan, groups),
            check_pool=self._check_pool,
        ):
            if isinstance(result.world, DriveWorld):
                world = self._driven(result)
                ready += self._after_test(result.world, world)
                yield world
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
            if not start.group.variants:  # a search makes its variants level by level
                ended, drives = self._begin_searches(start)
                ready += drives
                yield from ended
            elif not self._can_be_driven(start):
                self._note_work(start.group.plan, sum(map(_n_drives, missing)))
                yield from map(start.undriven, missing)
            elif missing[0].legs:
                ready += self._legs_of(LegStart(start, tuple(missing), 0, None))
            else:
                ready += (self._driving(start, variant) for variant in missing)
        self.tally.drive_s += time.perf_counter() - begin

    def _driving(
        self, start: SettledPlacement, variant: Variant, search: PlacementSearch | None = None, level: int = -1
    ) -> DriveWorld:
        plan = start.group.plan
        drive, record = self.plan.drive(plan, variant, start.load_height_m), self.recording.of(plan)
        job = Job(start.scene, drive=drive, start=start.outcome.state, record=record)
        return DriveWorld(plan, variant.index, job, start, variant, search, level)

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

    def _begin_searches(self, start: SettledPlacement) -> tuple[list[FinishedWorld], list[DriveWorld]]:
        """Begin to search for the largest level survived, for all profiles and directions of a placement. Returns
        finished worlds and the first tests.

        When all current tests of a search have ended, its next tests begin, while tests of other searches continue. If
        the pallet does not stand at the end of the placement, no drive is simulated. The table ``worlds`` then has one
        row per profile and direction, at the lowest level, with the outcome of the placement.
        """
        group, ended, drives = start.group, [], []
        at_rest = Probe.of(start.outcome, self.sim.thresholds)
        for number in range(len(self.plan.search_items())):
            search = PlacementSearch(group, number, self._level_search(at_rest))
            if not search.levels.stands_at_rest and self._row(group, number, 0) is None:
                ended.append(start.undriven(self.plan.search_variant(group, number, 0)))
            drives += self._next_drives(search, start)
        return ended, drives

    def _after_test(self, drive: DriveWorld, world: FinishedWorld) -> list[DriveWorld]:
        """The drives that a search needs after a test. The list is empty if other tests of the same round have not
        ended, and for drives that belong to no search."""
        search = drive.search
        if search is None:
            return []
        search.results[drive.level] = Probe.of(world.outcome, self.sim.thresholds, self.values_of(world))
        if len(search.results) < len(search.levels.next_levels()):
            return []
        return self._next_drives(search, drive.settled)

    def _next_drives(self, search: PlacementSearch, start: SettledPlacement) -> list[DriveWorld]:
        """The drives that a search needs next; an empty list if its answer is known."""
        levels = self._missing_levels(search)
        if not levels:
            self.on_answer(search)
        group, number = search.group, search.number
        return [self._driving(start, self.plan.search_variant(group, number, level), search, level) for level in levels]

    def _missing_levels(self, search: PlacementSearch) -> list[int]:
        """The levels that must be tested next. Before, the search goes on with the results of all tests that have
        ended, or that were completed before the run was resumed."""
        while levels := search.levels.next_levels():
            for level in levels:
                if level not in search.results and (row := self._row(search.group, search.number, level)) is not None:
                    search.results[level] = Probe.from_row(row)
            if missing := [level for level in levels if level not in search.results]:
                return missing
            search.levels.record(search.results)
            search.results.clear()
        return []

    def _level_search(self, at_rest: Probe) -> LevelSearch:
        search, levels = self.plan.sweep.search, self.plan.sweep.search_levels
        assert search is not None
        return LevelSearch(len(levels), at_rest, search.sections, from_zero=bool(levels[0] == 0))

    def _answer_again(self, group: PlacementGroup) -> bool:
        """Find the answers of a search (the largest levels survived) for one placement again. The answers follow from
        the rows of worlds that were completed before the run was resumed. Returns False if a world is missing."""
        if not len(self.recorded):
            return False
        searches = []
        for number in range(len(self.plan.search_items())):
            search = PlacementSearch(group, number, self._level_search(self._recorded_rest(group, number)))
            # a search with a single level tests no level, so no recorded row shows whether the placement stood
            unknown = search.levels.stands_at_rest and not search.levels.next_levels()
            if unknown or self._missing_levels(search):
                return False
            searches.append(search)
        for search in searches:
            self.on_answer(search)
        return True

    def _recorded_rest(self, group: PlacementGroup, number: int) -> Probe:
        """The result of a placement without a profile, found from the rows of completed worlds. If the pallet did not
        stand, its search has written a single row: for the lowest level, with 0 simulated steps. The result is then the
        outcome in this row. In all other cases, the result is a stable outcome. A failed test at the lowest level may
        also have 0 steps, but then the search has also written rows of tests at higher levels.
        """
        stands = Probe(Verdict.STABLE)
        row = self._row(group, number, 0)
        first = self._level_search(stands).next_levels()
        tested = any(self._row(group, number, level) is not None for level in first if level > 0)
        return Probe.from_row(row) if row is not None and row["n_steps"] == 0 and not tested else stands

    def _row(self, group: PlacementGroup, number: int, level: int) -> dict[str, Any] | None:
        if not len(self.recorded):
            return None
        return self.recorded.row(group.plan.plan_id, self.plan.search_variant(group, number, level).index)
