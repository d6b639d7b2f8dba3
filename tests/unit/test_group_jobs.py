"""Which jobs of a run are in which group of mjx-warp."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from support.job_streams import LateStream, feedback_stream, put
from support.worlds import make_scene

from petmjx.common.errors import InputError
from petmjx.engines.job_stream import JobStream
from petmjx.engines.protocol import Progress
from petmjx.engines.warp.group_jobs import Groups, GrowingGroups
from petmjx.engines.warp.group_schedule import GroupSequence, RowPrefetcher
from petmjx.engines.warp.kernel_features import KernelFeatures
from petmjx.engines.warp.world_arrays import MAX_BOXES
from petmjx.options.placing import Placing
from petmjx.options.simulation import Simulation
from petmjx.world.history import Record
from petmjx.world.job import Job

SMALL, LARGE = Job(make_scene(2)), Job(make_scene(9))
REFUSED = Job(make_scene([((10, 10, 10), (20 * (k % 32), 20 * (k // 32), 0), 1.0) for k in range(MAX_BOXES + 1)]))
BY_HAND = Job(replace(SMALL.scene, placing=Placing(name="hand")))


def groups_of(jobs: list[Job] | JobStream[Any], size: int = 8, left: int = 2) -> Groups:
    return Groups.of(JobStream.of(jobs), size, left, granule=4)


def sizes_of(groups: Groups) -> list[tuple[int, int]]:
    """The number of the first job of each group, and how many it has."""
    sizes = []
    while groups:
        group = groups.take()
        sizes.append((groups.first, len(group)))
    return sizes


@pytest.mark.parametrize(
    ("n_jobs", "groups"), [(1, [(0, 1)]), (8, [(0, 8)]), (9, [(0, 5), (5, 4)]), (13, [(0, 6), (6, 6), (12, 1)])]
)
def test_groups_are_equal_and_leave_room_for_what_the_one_before_leaves(
    n_jobs: int, groups: list[tuple[int, int]]
) -> None:
    assert sizes_of(groups_of([SMALL] * n_jobs)) == groups


def test_parts_follow_each_other_once_they_are_made() -> None:
    """The first part is small, so that a device begins soon; the next ones are as large as two groups."""
    stream = LateStream([SMALL] * 3, [LARGE, *[SMALL] * 13], looks=2)
    groups = groups_of(stream)
    assert (len(groups.take()), groups.first, groups.needs) == (3, 0, KernelFeatures({96: 4}))
    assert [len(groups.following()) for _ in range(3)] == [0, 0, 6]
    assert groups.following() is groups.following()
    assert groups.needs == KernelFeatures({96: 12})
    assert [(len(groups.take()), groups.first) for _ in range(3)] == [(6, 3), (6, 9), (2, 15)]
    assert not groups


def test_tables_are_made_once_their_rows_are_there_or_the_device_is_nearly_idle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(RowPrefetcher, "prepare", lambda *_: None)
    groups = groups_of([SMALL] * 13)
    groups.take()
    sequence = GroupSequence(groups, Simulation(), Progress(), most_left=4, alone=False)
    for made, due in ((False, [False, False, False, True, False]), (True, [False, True, True, True, False])):
        monkeypatch.setattr(RowPrefetcher, "ready", made)
        assert [sequence.next_is_due(rest, 6, 2) for rest in (7, 6, 3, 2, 0)] == due
    sequence.close()


def test_a_part_that_is_refused_is_so_once_the_group_before_has_ended() -> None:
    """Until then it is as one that is not made yet: the outcomes of that group come first."""
    groups = groups_of(LateStream([SMALL] * 2, [SMALL, REFUSED], looks=0))
    assert len(groups.take()) == 2
    assert [groups.following() for _ in range(2)] == [(), ()]
    assert (groups.first, groups.needs) == (0, KernelFeatures({96: 4}))
    for ask in (groups.__bool__, groups.take, groups.__bool__):
        with pytest.raises(InputError, match=f"one has {MAX_BOXES + 1}"):
            ask()


def test_jobs_that_follow_join_the_group_whose_kernels_know_them() -> None:
    stream = feedback_stream([SMALL])
    groups = groups_of(stream)
    group = groups.take()
    put(stream, SMALL, SMALL, BY_HAND, SMALL)
    assert groups.following() == ()
    assert groups.waiting(1) == [SMALL]
    assert groups.waiting(9) == [SMALL, SMALL]
    group += groups.join(2)
    assert groups.waiting(9) == []
    assert groups
    assert [job is BY_HAND for job in groups.take()] == [True, False]
    assert groups.needs.hands
    assert not groups
    put(stream, LARGE)
    assert groups
    assert (groups.take(), groups.first) == ([LARGE], 5)
    assert groups.needs == KernelFeatures({96: 12})


def test_a_group_with_recorded_worlds_says_so() -> None:
    groups = groups_of([SMALL] * 5 + [replace(SMALL, record=Record(0.1))] * 4)
    recorded = []
    while groups:
        recorded.append(groups.recorded)
        groups.take()
    assert recorded == [False, True]


def test_needs_of_both_and_of_some() -> None:
    both = KernelFeatures({96: 8}, hands=True) | KernelFeatures({96: 12, MAX_BOXES: 100}, wraps=True)
    assert both == KernelFeatures({96: 12, MAX_BOXES: 100}, hands=True, wraps=True)
    assert both.sizes == [MAX_BOXES, 96]
    assert both.most_boxes == 100
    assert both.of_sizes([SMALL]) == KernelFeatures({96: 12}, hands=True, wraps=True)
    assert both.know(BY_HAND)
    assert not KernelFeatures({96: 12}).know(BY_HAND)


def test_jobs_whose_features_could_not_be_found_are_looked_at_again(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = feedback_stream([SMALL])
    groups = groups_of(stream)
    assert isinstance(groups, GrowingGroups)
    assert groups.take() == [SMALL]
    put(stream, LARGE)
    with monkeypatch.context() as short:
        short.setattr(KernelFeatures, "of", lambda *_: _no_memory())
        with pytest.raises(MemoryError):
            groups.take()
    assert groups.needs.know(SMALL)
    assert groups.take() == [LARGE]
    assert groups.needs.know(LARGE)


def _no_memory() -> KernelFeatures:
    raise MemoryError
