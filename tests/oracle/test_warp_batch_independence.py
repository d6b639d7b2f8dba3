"""On mjx-warp, the outcome of a world does not depend on other worlds.

The outcome does not depend on thread blocks, rows of the table, time slices (launches of the kernel) or earlier runs
either.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from petmjx.engines.mjx.world_state import SOFT_START_BEGIN
from petmjx.engines.verdict import Outcome
from petmjx.world.edge_distances import EdgeRisk
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.scene import build_scene

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.fake_stepper import assert_same, run_all
from support.job_streams import LateStream, feedback_stream, put
from support.plans import Box, heap, make_plan, make_scene
from support.tiny_worlds import (
    LONG_NS,
    SHORT,
    SOME_NS,
    STEP_NS,
    TINY,
    assert_equal_worlds,
    devices,
    engine,
    shared_engine,
    sizes_apart,
    tiny_scenes,
)
from support.worlds import simulate

from petmjx.engines.warp import block_queues, table_jobs, time_slices
from petmjx.engines.warp import engine as mjx_warp
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_queues import Queues
from petmjx.engines.warp.cpu_engine import MjxWarpCpuEngine
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.table_jobs import TableJobs
from petmjx.engines.warp.time_slices import Rollout
from petmjx.engines.warp.world_table import RunningWorlds, WorldTable

pytestmark = pytest.mark.usefixtures("ranks_may_differ")

TOWERS_AND_SHEET: list[Box] = [((200, 200, 100), (x, 0, 0), 5) for x in (0, 400)] + [((600, 200, 5), (0, 0, 100), 0.5)]
WITH_SHEET = build_scene(replace(make_plan(boxes=TOWERS_AND_SHEET), kinds=("", "", "sheet")), SHORT)


@pytest.mark.slow
def test_slices_of_any_length_give_the_same(crowd: dict[str, Outcome]) -> None:
    """In a slice (launch of the kernel) of 0.3 ms, each thread block takes some steps. test_warp_tail_blocks.py has
    slices of one step."""
    names = ("hand-overhang-45", "hand-falls-off")
    assert_equal_worlds(simulate(engine(slice_ns=300_000), tiny_scenes(names), SHORT), crowd)


@pytest.mark.slow
@devices
def test_what_is_kept_from_step_to_step_changes_nothing(device: str) -> None:
    """In a slice of one step, nothing is kept from the step before. In a long slice, the order of bodies changes, and
    contacts begin and end."""
    scene = {"heap": make_scene(heap(24))}
    static = SHORT.changed(check="static", duration_s=0.3)
    kept, anew = (simulate(engine(slice_ns=time), scene, static) for time in (LONG_NS, 0))
    assert_equal_worlds(kept, anew)
    assert kept["heap"].boxes.shift_m.max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["a list", "jobs that may become more", "a recorded world"])
def test_the_next_slice_is_under_way_where_nothing_can_come_between(
    kind: str, monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    under_way: list[int] = []
    wait = Rollout.wait

    def watched(self: Rollout, group: Any) -> Any:
        under_way.append(self.under_way)
        return wait(self, group)

    monkeypatch.setattr(Rollout, "wait", watched)
    record = Record(0.05) if kind == "a recorded world" else None
    some = TINY[:2] if "more" in kind else TINY[:1]
    jobs = [Job(scene, record=record) for scene in tiny_scenes(some).values()]
    outcomes = run_all(engine(slice_ns=STEP_NS), feedback_stream(jobs) if "more" in kind else jobs, SHORT)
    assert_equal_worlds(dict(zip(some, outcomes, strict=True)), crowd)
    assert len(under_way) > 3
    # If jobs may follow, only one slice is under way while blocks are idle, so that these jobs can join earlier. Two
    # slices are under way while all blocks (here one) have worlds.
    expected = {"a list": {2}, "jobs that may become more": {1, 2}, "a recorded world": {1}}
    assert set(under_way[:-1]) == expected[kind]


@pytest.mark.slow
def test_alone_and_in_any_order_as_in_company(crowd: dict[str, Outcome]) -> None:
    assert_equal_worlds(simulate(shared_engine(), tiny_scenes(TINY[::-1]), SHORT), crowd)
    wide = make_scene(9)
    mixed = {"nine boxes": wide, **tiny_scenes(("hand-bridge", "hand-falls-off"))}
    outcomes = simulate(shared_engine(), mixed, SHORT)
    assert outcomes.pop("nine boxes").n_boxes == 9
    assert_equal_worlds(outcomes, crowd)
    for name in ("hand-one-box", "hand-bridge"):
        assert_equal_worlds(simulate(shared_engine(), tiny_scenes((name,)), SHORT), crowd)


@pytest.mark.slow
def test_any_number_of_blocks_gives_the_same(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    here = Launch.here
    monkeypatch.setattr(Launch, "here", lambda *args, **options: replace(here(*args, **options), blocks=3))
    assert_equal_worlds(simulate(engine(slice_ns=SOME_NS), tiny_scenes(), SHORT), crowd)


@pytest.mark.slow
def test_tables_of_any_size_give_the_same(crowd: dict[str, Outcome]) -> None:
    """In a table with two rows, a world begins when another world has ended."""
    assert_equal_worlds(simulate(engine(most_rows=2), tiny_scenes(), SHORT), crowd)


@pytest.mark.slow
def test_rows_of_ended_worlds_are_given_to_further_jobs(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """Fifteen worlds share eight rows. Six worlds have rows at the beginning.

    When a job gets its row, a slice may still be running. The results of that slice do not belong to the job.
    """
    scenes, rows = tiny_scenes(TINY[:3]), list[int]()
    jobs = [Job(scene) for scene in scenes.values()]
    add, load = WorldTable.add, MjxWarpEngine._load
    tables: list[WorldTable] = []

    def watched(self: WorldTable, *args: Any) -> Any:
        rows.extend(joined := add(self, *args).tolist())
        return np.array(joined, int)

    monkeypatch.setattr(WorldTable, "add", watched)
    monkeypatch.setattr(MjxWarpEngine, "_load", lambda *args: tables.append(load(*args)) or tables[-1])
    monkeypatch.setattr(table_jobs, "JOIN_ROWS", 2)
    run = engine(most_rows=8, slice_ns=SOME_NS).run(LateStream(jobs * 2, jobs * 3), SHORT)
    outcome_by_job = {outcome.job: outcome for outcome in run}
    for first in range(0, 15, 3):
        assert_equal_worlds({name: outcome_by_job.pop(first + k) for k, name in enumerate(scenes)}, crowd)
    assert not outcome_by_job
    assert len(tables) == 1
    assert len(rows) == 9
    assert len(set(rows)) < 9
    assert max(rows) < 8


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [1, 10_000])
def test_a_job_without_room_in_the_table_has_another_one(
    blocks: int, monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """A second, wider table is made as soon as the number of running worlds is at most the number of blocks. The
    running worlds continue in the second table."""
    widths: list[tuple[int, int]] = []
    put_running = WorldTable.put_running

    def watched(self: WorldTable, running: RunningWorlds) -> None:
        put_running(self, running)
        widths.append((running.states.qpos.shape[1], self.table.qpos.shape[1]))
        assert (np.asarray(self.table.step)[: len(running.jobs)] > SOFT_START_BEGIN).any()
        some.slice_ns = SOME_NS

    monkeypatch.setattr(WorldTable, "put_running", watched)
    some = engine(slice_ns=STEP_NS)
    monkeypatch.setattr(table_jobs, "_roomy", lambda needs: needs)
    needs_another = TableJobs.needs_another
    monkeypatch.setattr(TableJobs, "needs_another", lambda self, table, _: needs_another(self, table, blocks))
    wide, scenes = make_scene(9), tiny_scenes(TINY[:3])
    alone = simulate(shared_engine(), {"nine": wide}, SHORT)
    jobs = [Job(scene) for scene in scenes.values()]
    run = some.run(LateStream(jobs, [Job(wide), *jobs, jobs[0]]), SHORT)
    outcome_by_job = dict(sorted((outcome.job, outcome) for outcome in run))
    assert list(outcome_by_job) == list(range(2 * len(jobs) + 2))
    assert widths == [(4, 12)]
    assert_equal_worlds({"nine": outcome_by_job[len(jobs)]}, alone)
    for first in (0, len(jobs) + 1):
        assert_equal_worlds({name: outcome_by_job[first + k] for k, name in enumerate(scenes)}, crowd)


@pytest.mark.slow
def test_a_sheet_of_several_pieces_has_another_table(crowd: dict[str, Outcome]) -> None:
    """The pieces of the sheet are further shapes. A table that was made for boxes alone has no room for them."""
    scenes = tiny_scenes(TINY[:2])
    jobs = [Job(scene) for scene in scenes.values()]
    (alone,) = run_all(shared_engine(), [Job(WITH_SHEET)], SHORT)
    for stream in (LateStream(jobs, [Job(WITH_SHEET), jobs[0]]), feedback_stream(jobs)):
        outcome_by_job = {}
        for outcome in engine(slice_ns=SOME_NS).run(stream, SHORT):
            if stream.feedback and not outcome_by_job:
                put(stream, Job(WITH_SHEET), jobs[0])
            outcome_by_job[outcome.job] = outcome
        assert_equal_worlds({"sheet": outcome_by_job[2]}, {"sheet": alone})
        assert_equal_worlds({name: outcome_by_job[k] for k, name in enumerate(scenes)}, crowd)


@pytest.mark.slow
def test_memory_that_runs_out_for_outcomes_loses_no_world(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """The device is ahead of the host: when further jobs get the rows of ended worlds, the outcomes of some of these
    worlds are not made yet."""
    has_joined, add, make = threading.Event(), WorldTable.add, time_slices.outcomes

    def watched(self: WorldTable, *args: Any) -> Any:
        rows = add(self, *args)
        has_joined.set()
        return rows

    def late(*args: Any) -> Iterator[Outcome]:
        if not failed:
            failed.append(has_joined.wait(60))
            raise MemoryError
        return make(*args)

    failed: list[bool] = []
    monkeypatch.setattr(WorldTable, "add", watched)
    monkeypatch.setattr(time_slices, "outcomes", late)
    monkeypatch.setattr(time_slices, "MOST_AHEAD", 1 << 20)
    monkeypatch.setattr(table_jobs, "JOIN_ROWS", 2)
    scenes = tiny_scenes()
    outcomes = run_all(engine(most_rows=8, slice_ns=SOME_NS), [Job(scene) for scene in scenes.values()] * 2, SHORT)
    assert failed == [True]
    for first in (0, len(scenes)):
        assert_equal_worlds(dict(zip(scenes, outcomes[first : first + len(scenes)], strict=True)), crowd)


@pytest.mark.slow
def test_worlds_of_each_size_have_blocks_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Worlds of all sizes run at the same time, in tables as wide as the largest world of the run. The memory of a
    block is only as wide as the worlds of its own size."""
    scenes = {**tiny_scenes(), "five": make_scene(5), "nine": make_scene(9)}
    alike = simulate(engine(), scenes, SHORT)
    sizes_apart(monkeypatch, 4)
    queues = []

    class Watched(Queues):
        def add(self, *args: Any) -> None:
            super().add(*args)
            queues.append(np.asarray(self.order))

    monkeypatch.setattr(mjx_warp, "Queues", Watched)
    some = engine()
    assert_equal_worlds(simulate(some, scenes, SHORT), alike)
    ((_, rollout),) = some._rollouts._kept.values()
    assert [pool.n_boxes for pool in rollout.launcher.pools] == [12, 4]
    (order,) = queues
    assert [sorted(row[row >= 0].tolist()) for row in order] == [[5, 6], [0, 1, 2, 3, 4]]
    few = engine(most_rows=2)  # a table of two rows may have worlds of one size only
    assert_equal_worlds(simulate(few, scenes, SHORT), alike)


def test_blocks_take_the_longest_worlds_of_their_size_first() -> None:
    """Worlds that are added later are sorted into the queues, too. Worlds that have ended are in no queue."""
    jobs = [Job(make_scene(n)) for n in (3, 9, 2, 7, 4)]
    queues = Queues(["12", "4"], lambda job: "4" if job.scene.n_boxes <= 4 else "12", rows=8)
    live = np.arange(8) < 5
    queues.add(jobs, np.arange(5), live, SHORT)
    assert np.asarray(queues.order).tolist() == [[1, 3] + [-1] * 6, [4, 0, 2] + [-1] * 5]
    live[[1, 5]] = False, True
    queues.add([Job(make_scene(8))], np.array([5]), live, SHORT)
    assert np.asarray(queues.order).tolist() == [[5, 3] + [-1] * 6, [4, 0, 2] + [-1] * 5]


def test_worlds_in_which_a_box_tips_over_come_before_longer_worlds() -> None:
    beyond = make_scene([((100, 100, 50), (0, 0, 0), 1.0), ((100, 100, 50), (60, 0, 50), 1.0)])
    longer = Job(make_scene(12))
    jobs = [Job(make_scene(9)), Job(beyond), Job(make_scene(4)), Job(beyond, has_errors=True)]
    queues = Queues(["12"], lambda job: "12", rows=4)
    live = np.ones(4, bool)
    queues.add(jobs, np.arange(4), live, SHORT)
    assert np.asarray(queues.order).tolist() == [[0, 2, 3, 1]]
    queues.examine(jobs, live)
    assert np.asarray(queues.order).tolist() == [[1, 0, 2, 3]]
    jobs[2] = longer
    queues.add([longer], np.array([2]), live, SHORT)
    queues.examine(jobs, live)
    assert np.asarray(queues.order).tolist() == [[1, 2, 0, 3]]


def test_worlds_that_may_be_simulated_again_come_first_and_the_longest_are_examined_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In one plan a load acts beyond an edge, in another one 0.4 mm inside an edge."""
    beyond = make_scene([((100, 100, 50), (0, 0, 0), 1.0), ((100, 100, 50), (60, 0, 50), 1.0)])
    near = make_scene([((100, 100, 50), (0, 0, 0), 1.0), ((100, 100, 50), (49.6, 0, 50), 1.0)])
    jobs = [Job(make_scene(9)), Job(beyond), Job(near)]
    queues = Queues(["12"], lambda job: "12", rows=3)
    live = np.ones(3, bool)
    queues.add(jobs, np.arange(3), live, SHORT)
    assert np.asarray(queues.order).tolist() == [[0, 1, 2]]
    monkeypatch.setattr(block_queues, "EXAMINED_AT_ONCE", 2)
    monkeypatch.setattr(block_queues, "EXAMINING_S", 0.0)
    queues.examine(jobs, live)
    assert np.asarray(queues.order).tolist() == [[1, 0, 2]]
    queues.examine(jobs, live)
    assert np.asarray(queues.order).tolist() == [[2, 1, 0]]
    known = [replace(job, edge_risk=risk) for job, risk in zip(jobs, (EdgeRisk.NEAR, EdgeRisk.INSIDE, 1), strict=True)]
    queues.add(known, np.arange(3), live, SHORT)
    queues.examine(known, live)
    assert np.asarray(queues.order).tolist() == [[0, 2, 1]], "what the run knows already is not examined"


def test_worlds_on_their_way_come_first_on_a_cpu_all_that_have_been_placed() -> None:
    queues = Queues(["12"], lambda job: "12", rows=4, depth_first=MjxWarpCpuEngine.depth_first)
    push = Drive(Excitation("push", "force", np.zeros((1, 3))))
    kept: Any = object()
    jobs = [Job(make_scene(3)), Job(make_scene(9), push, start=kept), Job(make_scene(9))]
    queues.add(jobs, np.arange(3), np.arange(4) < 3, SHORT)
    assert np.asarray(queues.order).tolist() == [[1, 2, 0, -1]]
    queues.add([Job(make_scene(3), push, start=kept)], np.array([3]), np.arange(4) < 4, SHORT)
    assert np.asarray(queues.order).tolist() == [[3, 1, 2, 0]], "the latest first"
    queues = Queues(["12"], lambda job: "12", rows=4, depth_first=MjxWarpEngine.depth_first)
    second_leg = Job(make_scene(3), push, start=kept, poses=np.zeros((3, 7)))
    queues.add([*jobs, second_leg], np.arange(4), np.arange(4) < 4, SHORT)
    order = np.asarray(queues.order)[0].tolist()
    assert order[0] == 3
    assert order[-1] == 0, "the others by their length"


@pytest.mark.gpu
def test_blocks_of_two_sizes_at_the_same_time_give_what_each_gives_alone() -> None:
    """There are more worlds of each size than blocks, so small worlds wait until the first large worlds have ended."""
    small = {f"{name} {k}": scene for name, scene in tiny_scenes().items() for k in range(120)}
    large = {f"{n} boxes, {k}": make_scene(n) for n in (97, 110) for k in range(80)}
    together = simulate(MjxWarpEngine(), large | small, SHORT)
    for alone in (large, small):
        assert_equal_worlds(simulate(MjxWarpEngine(), alone, SHORT), together)


@pytest.mark.slow
def test_a_run_that_is_left_early_does_not_change_the_next(crowd: dict[str, Outcome]) -> None:
    left = engine(slice_ns=SOME_NS)
    begun = left.run([Job(scene) for scene in tiny_scenes().values()], SHORT)
    next(begun)
    begun.close()
    assert_equal_worlds(simulate(left, tiny_scenes(), SHORT), crowd)


@pytest.mark.slow
def test_worlds_that_come_later_are_as_those_that_were_there(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """One job has a table with four rows. Of the jobs that follow it, two fit into that table, one of them in the row
    of the first job. The next job has more boxes and does not fit, and the jobs after it wait. These three get a new
    table."""
    names = ["hand-bridge", "hand-one-box", "hand-overhang-45", "nine boxes", "hand-falls-off", "hand-bridge"]
    jobs = {**tiny_scenes(), "nine boxes": make_scene(9)}
    some, tables = engine(), list[WorldTable]()
    load = some._load

    def watched(*args: Any) -> WorldTable:
        tables.append(load(*args))
        return tables[-1]

    monkeypatch.setattr(some, "_load", watched)
    stream, numbers = feedback_stream([Job(jobs[names[0]])]), []
    for outcome in some.run(stream, SHORT):
        numbers.append(outcome.job)
        if names[outcome.job] in crowd:
            assert_equal_worlds({names[outcome.job]: outcome}, crowd)
        if outcome.job == 0:
            put(stream, *[Job(jobs[name]) for name in names[1:]])
    assert sorted(numbers) == list(range(len(names)))
    assert [table.stream_numbers for table in tables] == [[1, 2], [3, 4, 5]]
    tables.clear()
    some.least_rows = some.granule = 16
    stream, numbers = feedback_stream([Job(jobs[names[0]])]), []
    for outcome in some.run(stream, SHORT):
        numbers.append(outcome.job)
        if outcome.job == 0:
            put(stream, *[Job(jobs[name]) for name in names[1:]])
    assert sorted(numbers) == list(range(len(names)))
    assert [sorted(table.stream_numbers) for table in tables] == [[1, 2, 3, 4, 5]]


@pytest.mark.slow
def test_drives_that_come_later_are_as_those_that_were_there() -> None:
    """Some of these drives (motions of the carrier) have a profile that is new to the run. The drives with new profiles
    wait until the other worlds have ended."""
    scene = tiny_scenes(("hand-overhang-45",))["hand-overhang-45"]
    (kept,) = shared_engine().run([Job(scene, keep_state=True)], SHORT)
    push, pull = (Excitation("push", "force", np.tile([level, 0.0, 0.0], (40, 1))) for level in (0.6, -0.6))
    jobs = [
        Job(scene, drive=Drive(profile, scale=scale, rest_s=0.1), start=kept.state)
        for profile, scale in ((push, 1.0), (push, 0.2), (pull, 1.0))
    ]
    together = {outcome.job: outcome for outcome in shared_engine().run(jobs, SHORT)}
    stream, outcome_by_job = feedback_stream(jobs[:1]), {}
    for outcome in shared_engine().run(stream, SHORT):
        outcome_by_job[outcome.job] = outcome
        put(stream, *(jobs[1:] if outcome.job == 0 else []))
    assert together.keys() == outcome_by_job.keys()
    for job, outcome in outcome_by_job.items():
        assert_same(outcome, together[job])


@pytest.mark.slow
@pytest.mark.parametrize("schedule", ["adaptive", "fixed"])
def test_worlds_that_come_later_may_be_larger_than_all_before(schedule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later world may have more boxes than all worlds before, but need blocks of the same size. Such a world does not
    join a table that has room for it, since the timetable of the run is only long enough for the largest plan so far. A
    later world may also need blocks of a size that the run does not have."""
    sizes_apart(monkeypatch, 4)
    scenes = {n: make_scene(n) for n in (3, 4, 6)}
    sim = SHORT.changed(schedule=schedule)
    alone = simulate(engine(), {str(n): scene for n, scene in scenes.items()}, sim)
    stream, numbers = feedback_stream([Job(scenes[3])]), []
    for outcome in engine().run(stream, sim):
        numbers.append(outcome.job)
        assert_equal_worlds({str((3, 4, 6)[outcome.job]): outcome}, alone)
        if outcome.job == 0:
            put(stream, Job(scenes[4]), Job(scenes[6]))
    assert sorted(numbers) == [0, 1, 2]
