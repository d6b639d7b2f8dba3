"""Engine ``mjx-warp``: worlds that each go at their own pace, on NVIDIA Warp's kernels. The fastest engine."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import why_no_warp
from petmjx.common.units import FloatArray
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.mjx.host_to_device import GRANULE, is_out_of_memory, load, tables
from petmjx.engines.mjx.jax_setup import set_up_jax
from petmjx.engines.mjx.readback import prepare_readback, read_back
from petmjx.engines.mjx.world_state import Status
from petmjx.engines.open_worlds import MOST_BOXES
from petmjx.engines.protocol import GROUP_WORLDS, Engine, GrowingJobs, JobsInParts, Progress, RunLock, says_at_hand
from petmjx.engines.verdict import Flag, Outcome
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import BlockPools
from petmjx.engines.warp.block_queues import Queues
from petmjx.engines.warp.frame_buffers import hand_over, pick_frames
from petmjx.engines.warp.free_bodies import paths
from petmjx.engines.warp.group_jobs import Groups
from petmjx.engines.warp.group_schedule import GroupHandover, GroupSequence, GroupStart, RowPrefetcher
from petmjx.engines.warp.kernel_features import size_of
from petmjx.engines.warp.kernel_launcher import BlockPool
from petmjx.engines.warp.open_worlds import WarpWorlds
from petmjx.engines.warp.slice_result import SliceResult, outcomes_of
from petmjx.engines.warp.time_slices import Rollout
from petmjx.engines.warp.world_groups import Group, Run
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job
from petmjx.world.scene import Scene

SPARE_ROWS = 4
"""Rows of a table when more jobs may follow, as a multiple of the jobs at the beginning; jobs without a row run after
the others."""

MORE_AT_ONCE = 64
"""Jobs that are put into a table at the same time. XLA compiles a program for each number."""

LEFT_SHARE, READY_SHARE = 16, 3
"""A group that another one follows ends when a world in so many is left, which goes on there. Tables for these are made
when so many times as many are left: that takes as long as the device has enough of them."""

UNDER_WAY = 2
"""Slices that a device has, so that it is never idle. What ends in one comes to the host when the next has ended."""

LOADING_NS = 10**9
"""Time of the slices under way while the tables of the next group are made: the thread that makes them cannot begin
others. They are at least two, and at most as many as a second of a GPU has."""

GPU_SLICE_NS = 100_000_000
"""Time of a call on a GPU: if it is longer the host waits for worlds, if shorter the device for calls."""

MIN_BLOCKS = 16
"""With fewer thread blocks than this, no useful amount of memory is saved."""


def _half_pool(fleet: BlockPool) -> BlockPool:
    """The same with half as many blocks, but never fewer than the useful minimum."""
    return replace(fleet, blocks=min(fleet.blocks, max(fleet.blocks // 2, MIN_BLOCKS)))


class MjxWarpEngine(Engine):
    """Worlds on Warp's kernels, each at its own pace, in a thread block of its own
    (petmjx/engines/warp/kernel_launcher.py).

    With Newton's method only: C MuJoCo simulates what needs another one (petmjx/engines/attempts.py).

    Args:
        lanes: most worlds in blocks of a kind; None: as many as the device has room for.
        allow_cpu: run Warp's kernels on the CPU if there is no CUDA device: slow, for tests.
        group_size: worlds whose states are on the device at the same time; it bounds memory for any number of jobs.
        slice_ns: time between two looks at which worlds have ended, ns.

    Attributes:
        granule: tables have room for a multiple of so many boxes.
        least_rows: of a table when more jobs may follow, for runs that begin with few and go on for long.

    Raises:
        EngineUnavailable: no CUDA device, or Warp is not installed; the line says which.
    """

    name = "mjx-warp"
    takes_more = takes_parts = True

    def __init__(
        self,
        lanes: int | None = None,
        *,
        allow_cpu: bool = False,
        group_size: int = GROUP_WORLDS["mjx-warp"],
        slice_ns: int = GPU_SLICE_NS,
    ) -> None:
        problem = None if allow_cpu else why_no_warp()
        if problem:
            raise EngineUnavailable(f"engine mjx-warp cannot run here: {problem}")
        set_up_warp()
        set_up_jax()
        self.lanes, self.group_size, self.slice_ns = lanes, group_size, slice_ns
        self.granule, self.least_rows = GRANULE, 0
        self._running = RunLock(self.name)
        self._kept: dict[tuple[Launch, ...], tuple[object, Rollout]] = {}
        """The last rollout for each kind of launches, and what it depends on."""
        self._fleets = BlockPools(lanes, self._blocks)

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> WarpWorlds:
        """As in the protocol."""
        return WarpWorlds(scenes, sim, most_boxes)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """As in the protocol."""
        with self._running:
            return paths(bodies, sim, self._blocks, self.slice_ns, self.group_size)

    def _drop(self) -> None:
        """Free the memory of the rollouts that are kept."""
        while self._kept:
            _, (_, rollout) = self._kept.popitem()
            rollout.close()

    @says_at_hand
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once. Outcomes come as worlds reach their end.

        Raises:
            RuntimeError: an earlier run of the same thread has not ended. (Runs of other threads are waited for.)
        """
        if not jobs:
            return
        with self._running:
            yield from self._outcomes(self._course(jobs, sim, progress or Progress()))

    def _course(self, jobs: Sequence[Job], sim: Simulation, progress: Progress) -> GroupSequence:
        most_left = 0 if isinstance(jobs, GrowingJobs) else self.group_size // LEFT_SHARE
        alone = len(jobs) == 1 and not isinstance(jobs, GrowingJobs | JobsInParts)
        groups = Groups.of(jobs, self.group_size, READY_SHARE * most_left, self.granule)
        return GroupSequence(groups, sim, progress, most_left, alone)

    def _outcomes(self, course: GroupSequence) -> Iterator[Outcome]:
        """Outcomes of all jobs of a course."""
        with closing(course):
            while course.groups:
                waits = course.waits_for_host
                try:
                    for outcome in outcomes_of(self._rounds(course), course.sim, course.progress, waits=waits):
                        if outcome is not None:  # None: a pause
                            del course.asked[outcome.job]
                        yield outcome
                except Exception as error:
                    if not is_out_of_memory(error):
                        raise
                else:
                    continue
                self._drop()
                yield from self._again(course)  # not before the error is gone: its traceback holds the tables

    def _again(self, course: GroupSequence) -> Iterator[Outcome]:
        """Memory ran out, and the states of all worlds are lost with it: those without an outcome once more, one size
        or half of them at a time. A world that has been alone is given up."""
        lost, sim, progress = course.lose(), course.sim, course.progress
        if course.alone and lost:
            begun = GroupStart(course.next_run(), [*lost.values()], [*lost])
            yield from outcomes_of(self._march(begun, course, waits=True, simulate=False), sim, progress, waits=True)
            return
        numbers = np.array([*lost], int)
        sizes = np.array([size_of(job) for job in lost.values()])
        apart = [numbers[sizes == size] for size in np.unique(sizes)]
        for part in apart if len(apart) > 1 else np.array_split(numbers, 2):
            if len(part):
                progress.message = f"out of device memory, again with {len(part)} of the worlds"
                for outcome in self._outcomes(self._course([lost[number] for number in part.tolist()], sim, progress)):
                    if outcome is not None:
                        outcome.job = int(part[outcome.job])
                    yield outcome

    @property
    def _while_loading(self) -> int:
        """Slices under way while the tables of the next group are made."""
        return max(LOADING_NS // max(self.slice_ns, GPU_SLICE_NS), UNDER_WAY)

    def _rounds(self, course: GroupSequence) -> Generator[SliceResult]:
        """Of one group after the other, up to one that waits for the host while these do not, or the reverse."""
        waits = course.waits_for_host
        while course.groups and course.waits_for_host == waits:
            yield from self._march(course.begin(), course, waits=waits)

    def _load_group(self, run: Run, jobs: list[Job], most: int = 0, ahead: RowPrefetcher | None = None) -> Group:
        """The tables of a group.

        Args:
            most: rows for as many jobs, if there are fewer now.
            ahead: may have begun them.
        """
        rows, width = 1 << (max(len(jobs), most) - 1).bit_length(), run.needs.most_boxes
        ready = ahead.take(jobs, width) if ahead is not None else None
        return Group(**vars(load(jobs, rows, width, run.sim, run.timetable, ready)), run=run)

    def _march(
        self, begun: GroupStart, course: GroupSequence, *, waits: bool, simulate: bool = True
    ) -> Generator[SliceResult]:
        """Slices of time until all worlds of a group have ended. While the device works on one, the host makes outcomes
        of the worlds that have ended, and from these more jobs may follow. Where none can, and no world is recorded,
        the next slice is under way already.

        Args:
            course: from which jobs may join, or to whose next group the last worlds are left.
            waits: the next slice waits for the host.
            simulate: off if memory has run out: all worlds are given up.
        """
        jobs, numbers, sim = begun.jobs, begun.numbers, begun.run.sim
        group, queues, emitted = self._begin(begun, course)
        begun = begun._replace(left=None)  # its table is not needed any more
        rollout = self._rollout(group) if simulate else None
        at_once = 1 if waits else UNDER_WAY
        leaving: GroupHandover | None = None
        try:
            if rollout is None:
                group.give_up(np.arange(len(jobs)), Flag.OUT_OF_MEMORY)
            else:
                rollout.keep_under_way(at_once, group, queues.order)
                prepare_readback(group.table, group.worlds, sim)
            while not emitted[: len(jobs)].all():
                frames = None
                if rollout is None:
                    status = group.status()
                else:
                    status, ended_slice = rollout.wait(group)
                    frames = None if group.recorder.idle else pick_frames(ended_slice.frames)
                if rollout is not None and (status == Status.OVERFLOWED).any():
                    rollout.finish(group)
                    rollout = self._make_room(group, np.flatnonzero(group.status() == Status.OVERFLOWED))
                    status = group.status()
                ended = np.flatnonzero(group.handed_on(status) & ~emitted[: len(jobs)])
                emitted[ended] = True
                picked = read_back(ended, group.table, group.worlds, sim)
                if rollout is not None:
                    self._take(group, numbers, queues, course)
                    if not emitted[: len(jobs)].all():
                        rollout.keep_under_way(at_once, group, queues.order)
                    else:
                        rollout.finish(group)  # no world runs in what is under way
                if frames is not None:
                    hand_over(frames, group.recorder)
                yield SliceResult(picked, group.recorder, jobs, numbers)
                if rollout is not None and emitted[: len(jobs)].all() and self._take(group, numbers, queues, course):
                    rollout.keep_under_way(at_once, group, queues.order)
                if rollout is None or not group.recorder.idle:
                    continue
                rest = np.flatnonzero(~emitted[: len(jobs)])
                most = READY_SHARE * course.most_left
                if leaving is None and course.next_is_due(len(rest), most, rollout.march.blocks):
                    rollout.keep_under_way(self._while_loading, group, queues.order)
                    leaving = self._leaving(course, begun, rest, len(group.table.status))
                if leaving is not None and 0 < len(rest) <= course.most_left:
                    rollout.finish(group)
                    leaving.leave(group.table, emitted, most)
                    course.left = leaving
                    return
        except BaseException:
            self._drop()  # the memory of a call that did not come back is gone
            raise

    def _begin(self, begun: GroupStart, course: GroupSequence) -> tuple[Group, Queues, NDArray[np.bool_]]:
        """The tables of a group, its queues, and which of its rows have given their outcomes, where the group before
        had them."""
        run, jobs, _, left = begun
        if left is not None and left.ready is not None:
            group, queues = left.ready
        else:
            rows = min(max(SPARE_ROWS * len(jobs), self.least_rows), self.group_size) if course.groups.grows else 0
            group, queues = self._load(run, jobs, len(left.jobs) if left is not None else 0, rows, course)
        emitted = np.zeros(len(group.table.status), bool)
        if left is not None:
            n_own = len(jobs) - len(left.jobs)
            emitted[n_own : len(jobs)] = left.emitted
            group.table = left.put_into(group.table, n_own)
        return group, queues, emitted

    def _load(self, run: Run, jobs: list[Job], n_left: int, rows: int, course: GroupSequence) -> tuple[Group, Queues]:
        """The tables of a group, with so many rows at least, and its queues. The last ``n_left`` jobs come first: they
        may go on for long."""
        run = replace(run, needs=run.needs.of_sizes(jobs))
        group = self._load_group(run, jobs, rows, course.ahead)
        queues, n_own = Queues(run.needs.sizes, size_of, len(group.table.status)), len(jobs) - n_left
        if n_left:
            queues.add(jobs[n_own:], n_own, run.sim)
        queues.add(jobs[:n_own], 0, run.sim)
        return group, queues

    def _leaving(self, course: GroupSequence, begun: GroupStart, rest: NDArray[np.int64], rows: int) -> GroupHandover:
        """What a group will leave to the one that follows, with the tables of that.

        Args:
            rest: rows of the worlds that have not ended.
            rows: of the group's tables. Those of the next one have as many, for which programs are compiled.
        """
        left = GroupHandover(
            [begun.jobs[row] for row in rest.tolist()], [begun.numbers[row] for row in rest.tolist()], rest
        )
        try:
            together = [*course.groups.following(), *left.jobs]
            left.ready = self._load(course.next_run(), together, len(rest), rows, course)
        except Exception as error:
            if not is_out_of_memory(error):
                raise
        return left

    def _take(self, group: Group, numbers: list[int], queues: Queues, course: GroupSequence) -> bool:
        """Put waiting jobs into free rows of a group, in their order, until one does not fit; whether any did."""
        free = min(len(group.table.status), self.group_size) - len(group.jobs)
        fitting = list(takewhile(group.fits, course.groups.waiting(free)))
        if not fitting:
            return False
        queues.add(fitting, len(group.jobs), group.run.sim)
        for first in range(0, len(fitting), MORE_AT_ONCE):
            some = fitting[first : first + MORE_AT_ONCE]
            width, run = group.table.qpos.shape[1], group.run
            made = tables(some, MORE_AT_ONCE, width, group.profile_rows, run.sim, run.timetable, group.boards)
            group.add(some, *made)
            course.join(some, numbers)
        return True

    def _make_room(self, group: Group, rows: NDArray[np.int64]) -> Rollout | None:
        """Larger buffers for worlds that are stopped since they need them; at ``most_room`` they are given up."""
        sizes = np.array([size_of(group.jobs[row]) for row in rows.tolist()])
        for size in np.unique(sizes).tolist():
            some = rows[sizes == size]
            growth = self._fleets.grow(group.run, size)
            if growth is None:
                group.give_up(some, Flag.NONE)
                continue
            group.run.progress.message = f"{len(some)} worlds overflowed their buffers, on with {growth}× as large ones"
            group.retry(some)
            group.table = group.table._replace(status=group.table.status.at[some].set(Status.RUNNING))
        rollout = self._rollout(group)
        if rollout is None:
            group.give_up(np.flatnonzero(~group.handed_on(group.status())), Flag.OUT_OF_MEMORY)
        return rollout

    def _rollout(self, group: Group) -> Rollout | None:
        """The programs for a group, with fewer blocks if memory is short; None if not even ``MIN_BLOCKS`` fit. What
        says that memory is short is raised if these are blocks of two sizes."""
        run = group.run
        fleets = self._fleets.of(group)
        launches = tuple(fleet.launch for fleet in fleets)
        key = run.sim, run.timetable, fleets
        if launches in self._kept and self._kept[launches][0] == key:
            return self._kept[launches][1]
        if launches in self._kept:
            self._kept.pop(launches)[1].close()
        while True:
            try:
                rollout = Rollout(run, fleets, self.slice_ns)
            except Exception as error:
                if not is_out_of_memory(error):
                    raise
                if not self._kept and any(fleet.is_extra for fleet in fleets):
                    fleets = tuple(fleet for fleet in fleets if not fleet.is_extra)
                elif not self._kept:
                    more, fleets = fleets, tuple(_half_pool(fleet) for fleet in fleets)
                    if fleets == more:
                        if len(fleets) > 1:
                            raise  # each size alone may have room
                        return None
                self._drop()  # programs of other sizes may be what takes the memory: once more without them
                lanes = sum(fleet.blocks for fleet in fleets)
                run.progress.message = f"out of device memory, again with {lanes} lanes"
            else:
                self._kept[launches] = (key, rollout)
                return rollout

    def _blocks(self, launch: Launch) -> int:
        """Blocks of a launch."""
        return min(self.lanes or launch.blocks, launch.blocks)
