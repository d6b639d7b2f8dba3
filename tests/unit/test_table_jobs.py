"""Tables of mjx-warp: which jobs of a run get rows in which table."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from support.job_streams import LateStream, feedback_stream, put
from support.worlds import make_scene

from petmjx.common.errors import InputError
from petmjx.engines.job_stream import JobBounds, JobStream
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.warp.block_launch import Features
from petmjx.engines.warp.block_sizes import MAX_BOXES
from petmjx.engines.warp.kernel_features import KernelFeatures
from petmjx.engines.warp.table_jobs import LEAST_FOLLOWING_ROWS, MOST_PROFILE_BYTES, TableJobs
from petmjx.engines.warp.world_table import WorldTable
from petmjx.options.placing import Placing
from petmjx.options.simulation import Simulation
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job

SMALL, LARGE = Job(make_scene(2)), Job(make_scene(9))
REFUSED = Job(make_scene([((10, 10, 10), (20 * (k % 32), 20 * (k // 32), 0), 1.0) for k in range(MAX_BOXES + 1)]))
BY_HAND = Job(replace(SMALL.scene, placing=Placing(name="hand")))


class RowsOnly(WorldTable):
    """A table that has rows with jobs, but no states."""

    def __init__(self, jobs: list[Job], rows: int, needs: KernelFeatures, profiles: int = 1) -> None:
        sim = Simulation()
        self.run: Any = SimpleNamespace(needs=needs, sim=sim, timetable=build_timetable(sim, needs.most_boxes))
        self.table: Any = SimpleNamespace(status=np.zeros(rows, np.int32))
        self.jobs, self.stream_numbers, self.slices = jobs, list(range(len(jobs))), 0
        self.recorder: Any = SimpleNamespace(idle=all(job.record is None for job in jobs))
        self.profiles: Any = jnp.zeros((profiles, 4, 3))
        self.profile_rows = dict[int, int]()
        self.__post_init__()

    @property
    def boards(self) -> int:
        return 99

    def add(self, jobs: Any, numbers: Any, at_once: int) -> Any:
        free = np.flatnonzero(~self.live)[: len(jobs)]
        self.live[free] = True
        return free


def jobs_of(jobs: list[Job] | JobStream[Any], size: int = 8) -> TableJobs:
    return TableJobs(JobStream.of(jobs), size, 0, granule=4)


def begun(source: TableJobs) -> RowsOnly:
    jobs, _, rows = source.begin()
    return RowsOnly(jobs, rows, source.needs)


@pytest.mark.parametrize(("n_jobs", "rows"), [(1, 1), (3, 4), (8, 8), (9, 8), (13, 8)])
def test_a_list_has_as_many_rows_as_it_needs_or_as_there_are(n_jobs: int, rows: int) -> None:
    source = jobs_of([SMALL] * n_jobs)
    jobs, numbers, made = source.begin()
    assert (len(jobs), numbers, made) == (min(n_jobs, 8), list(range(min(n_jobs, 8))), rows)
    assert source.needs == KernelFeatures({96: 96 if n_jobs > 8 else 4}), "with columns for larger plans that follow"
    assert source.alone == (n_jobs == 1)


def test_jobs_join_in_order_once_half_of_the_rows_are_free() -> None:
    source = jobs_of([SMALL] * 14)
    table = begun(source)
    table.end(np.arange(3))
    assert source.join(table) == []
    table.end(np.arange(5))
    assert source.join(table) == [0, 1, 2, 3, 4]
    assert [*source.in_flight] == list(range(13))
    table.end(np.arange(8))
    assert source.join(table) == [0]
    assert source.ended


def test_jobs_that_are_still_being_made_are_waited_for_when_no_world_is_live() -> None:
    source = jobs_of(LateStream([SMALL] * 2, [LARGE] * 3, looks=2))
    table = begun(source)
    assert (len(table.jobs), table.rows, source.needs) == (2, 8, KernelFeatures({96: 96}))
    assert source.join(table) == source.join(table) == []
    assert source.join(table, wait=True) == [2, 3, 4]
    assert source.ended


def test_jobs_that_follow_join_the_table_whose_kernels_know_them() -> None:
    stream = feedback_stream([SMALL])
    source = jobs_of(stream)
    table = begun(source)
    put(stream, SMALL, SMALL, BY_HAND, SMALL)
    assert table.rows == 4
    assert source.join(table) == [1, 2]
    assert source.join(table) == []
    assert [source.needs_another(table, blocks) for blocks in (2, 3)] == [False, True]
    assert not source.ended
    jobs, numbers, _ = source.begin()
    assert (jobs, numbers) == ([BY_HAND, SMALL], [3, 4])
    assert source.needs.features.hands
    put(stream, LARGE)
    assert source.begin()[:2] == ([LARGE], [5])
    assert source.needs == KernelFeatures({96: 12})


@pytest.mark.parametrize("job", [REFUSED, replace(SMALL, record=Record(0.1))])
def test_what_is_refused_or_recorded_waits_for_the_outcomes_before(job: Job) -> None:
    source = jobs_of(LateStream([SMALL] * 2, [job], looks=0))
    table = begun(source)
    assert source.join(table) == []
    assert not source.needs_another(table, 99)
    table.end(np.arange(2))
    assert source.join(table, wait=True) == []
    assert not source.ended
    if job is REFUSED:
        for _ in range(2):
            with pytest.raises(InputError, match=f"one plan has {MAX_BOXES + 1}"):
                source.begin()
    else:
        assert source.recorded


def test_another_table_is_due_when_no_more_worlds_run_than_there_are_blocks() -> None:
    source = jobs_of(LateStream([SMALL] * 3, [BY_HAND], looks=0))
    table = begun(source)
    assert source.join(table) == []
    assert [source.needs_another(table, blocks) for blocks in (2, 3)] == [False, True]
    table.end(np.arange(3))
    assert not source.needs_another(table, 3)


def test_profiles_that_no_live_world_needs_give_way() -> None:
    def driven(level: float, steps: int = 4) -> Job:
        return replace(SMALL, drive=Drive(Excitation("push", "force", np.full((steps, 3), level))))

    first, second, third = driven(1), driven(2), driven(3)
    table = RowsOnly([first, SMALL], 4, KernelFeatures({96: 4}), profiles=2)
    table.profile_rows = {id(first.drive.excitation): 0}  # type: ignore[union-attr]
    assert table._with_profiles([SMALL, second, first, third]) == 3, "the third one has no room"
    assert np.asarray(table.profiles)[:, 0, 0].tolist() == [0.0, 2.0]
    table.end(np.array([0]))
    assert [table.fits(job) for job in (third, driven(4, steps=5))] == [True, False], "the other one is too long"
    assert table._with_profiles([third]) == 1
    assert [*table.profile_rows] == [id(third.drive.excitation)]  # type: ignore[union-attr]
    assert 3.0 in np.asarray(table.profiles)[:, 0, 0]


def test_a_table_has_room_for_what_will_follow() -> None:
    """The table has room for larger plans and for drives although no such job exists yet. Profiles take a limited part
    of the memory."""
    pushed = replace(SMALL, drive=Drive(Excitation("push", "force", np.zeros((4, 3)))))
    for excitations, drive_steps, room in ((3, 700, 3), (None, 700, 8), (None, MOST_PROFILE_BYTES // 36, 3)):
        bounds = JobBounds(5, {2, 9, MAX_BOXES + 1}, drive_steps, excitations)
        stream = JobStream[Any](feedback=True, bounds=bounds)
        put(stream, SMALL, pushed)
        source = jobs_of(stream)
        jobs, _, rows = source.begin()
        assert (rows, source.needs) == (8, KernelFeatures({96: 12})), "one that is refused waits for its turn"
        assert source.profile_room(jobs, rows) == (room, drive_steps)
    for n_jobs, rows in ((40, 64), (10**6, LEAST_FOLLOWING_ROWS)):
        stream = JobStream[Any](feedback=True, bounds=JobBounds(n_jobs, {2}, 700, 3))
        put(stream, SMALL)
        assert jobs_of(stream, 32_768).begin()[2] == rows, "many drives follow one placement"
    stream = JobStream[Any](feedback=True, bounds=JobBounds(100, {2}, 700, 3))
    put(stream, *[SMALL] * 80)
    assert jobs_of(stream, 32_768).begin()[2] == 128, "a row a world, of which no more than one leg is ready at once"
    for depth_first in (False, True):
        stream = JobStream[Any](feedback=True, bounds=JobBounds(5, {2}, 700, 3, wraps=True))
        put(stream, SMALL)
        source = TableJobs(stream, 8, 0, granule=4, depth_first=depth_first)
        source.begin()
        assert source.needs.features.wraps == depth_first, "legs with film begin at once, or have a table of their own"
    source = jobs_of(feedback_stream([SMALL, pushed]))
    jobs, _, rows = source.begin()
    assert source.profile_room(jobs, rows) == (4, 0), "unknown: four times as many as there are"


def test_needs_of_both() -> None:
    both = KernelFeatures({96: 8}, Features(hands=True)) | KernelFeatures(
        {96: 12, MAX_BOXES: 100}, Features(wraps=True)
    )
    assert both == KernelFeatures({96: 12, MAX_BOXES: 100}, Features(hands=True, wraps=True))
    assert both.sizes == [MAX_BOXES, 96]
    assert both.most_boxes == 100
    assert both.know(BY_HAND)
    assert not KernelFeatures({96: 12}).know(BY_HAND)


def test_a_table_knows_the_stiffer_contacts_that_may_follow() -> None:
    stiff = replace(SMALL, stiff=0.5)
    for following, fits in (((0.5,), True), ((), False)):
        stream = JobStream[Any](feedback=True, stiff=following)
        put(stream, SMALL)
        stream.close()
        source = jobs_of(stream)
        assert begun(source).fits(stiff) == fits
    assert KernelFeatures.of([SMALL, stiff], 4).queues == [(0.5, 96), (None, 96)]
    both = KernelFeatures({96: 8}, stiff=frozenset([0.5])) | KernelFeatures({MAX_BOXES: 100})
    assert both.queues == [(0.5, MAX_BOXES), (0.5, 96), (None, MAX_BOXES), (None, 96)]
    assert not both.know(replace(SMALL, stiff=0.1))


def test_jobs_whose_features_could_not_be_found_are_looked_at_again(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = feedback_stream([SMALL])
    source = jobs_of(stream)
    source.begin()
    put(stream, LARGE)
    with monkeypatch.context() as short:
        short.setattr(KernelFeatures, "of", lambda *_: _no_memory())
        with pytest.raises(MemoryError):
            source.begin()
    assert [*source.in_flight] == [0]
    assert source.begin()[0] == [LARGE]


def _no_memory() -> KernelFeatures:
    raise MemoryError
