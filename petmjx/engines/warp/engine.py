"""Engine ``mjx-warp``: worlds on NVIDIA Warp's kernels, each at its own pace. The fastest engine."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import why_no_warp
from petmjx.common.units import FloatArray
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mjx.host_to_device import GRANULE, is_out_of_memory, load, tables
from petmjx.engines.mjx.jax_setup import set_up_jax
from petmjx.engines.mjx.readback import prepare_readback, read_back
from petmjx.engines.mjx.world_state import Status
from petmjx.engines.open_worlds import MOST_BOXES
from petmjx.engines.protocol import GROUP_WORLDS, Engine, Progress, RunLock, says_at_hand, takes_stream
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
"""Rows of a table if more jobs may follow, as a multiple of the jobs at the beginning. Jobs that find no free row run
in a later group."""

MORE_AT_ONCE = 64
"""Jobs that are written into a table at a time. XLA compiles a program for each number."""

LEFT_SHARE, READY_SHARE = 16, 3
"""A group with a successor ends when one world in ``LEFT_SHARE`` is left; the remaining worlds go on in the next group.
The tables of the next group are made when ``READY_SHARE`` times as many worlds are left. The device is still busy
during that time."""

UNDER_WAY = 2
"""Slices in flight, so that the device is never idle. Worlds that end in one slice come to the host when the next slice
has ended."""

LOADING_NS = 10**9
"""Time of the slices in flight while the tables of the next group are made, ns. The thread that makes the tables cannot
begin slices meanwhile. At least two slices are in flight, and at most as many as fill a second of a GPU."""

GPU_SLICE_NS = 100_000_000
"""Time slice of a call on a GPU, ns. If it is longer, the host waits for worlds; if shorter, the device waits for
calls."""

MIN_BLOCKS = 16
"""With fewer thread blocks than this, no useful amount of memory is saved."""


def _half_pool(pool: BlockPool) -> BlockPool:
    """The same pool with half as many blocks, but with at least ``MIN_BLOCKS``, or all if it has fewer."""
    return replace(pool, blocks=min(pool.blocks, max(pool.blocks // 2, MIN_BLOCKS)))


class MjxWarpEngine(Engine):
    """Simulates worlds on Warp's kernels, each at its own pace in a thread block
    (petmjx/engines/warp/kernel_launcher.py).

    It has Newton's method only. C MuJoCo simulates attempts that need another solver (petmjx/engines/attempts.py).

    Args:
        lanes: most worlds in blocks of one kind; None: as many as the device has room for.
        allow_cpu: run Warp's kernels on the CPU if there is no CUDA device; slow, for tests.
        group_size: worlds whose states are on the device at the same time. It bounds memory for any number of jobs.
        slice_ns: time slice of a call, ns. After each slice the host looks which worlds have ended.

    Attributes:
        granule: box columns of tables are a multiple of this.
        least_rows: fewest rows of a table if more jobs may follow, for runs that begin with few jobs and last long.

    Raises:
        EngineUnavailable: no CUDA device, or Warp is not installed; the line says which.
    """

    name = "mjx-warp"

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
        """The last rollout for each set of launches, with its key."""
        self._pools = BlockPools(lanes, self._blocks)

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> WarpWorlds:
        """See ``Engine.open``."""
        return WarpWorlds(scenes, sim, most_boxes)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """See ``Engine.paths``."""
        with self._running:
            return paths(bodies, sim, self._blocks, self.slice_ns, self.group_size)

    def _drop(self) -> None:
        """Free the memory of all kept rollouts."""
        while self._kept:
            _, (_, rollout) = self._kept.popitem()
            rollout.close()

    @says_at_hand
    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        """Simulate each job once. Outcomes come as worlds reach their end.

        Raises:
            RuntimeError: an earlier run of the same thread has not ended. (Runs of other threads are waited for.)
        """
        stream = JobStream.of(jobs)
        if stream.ended:
            return
        with self._running:
            yield from self._outcomes(self._sequence(stream, sim, progress or Progress()))

    def _sequence(self, jobs: JobStream[Any], sim: Simulation, progress: Progress) -> GroupSequence:
        most_left = 0 if jobs.feedback else self.group_size // LEFT_SHARE
        alone = jobs.closed and jobs.ready == 1 and not jobs.feedback
        groups = Groups.of(jobs, self.group_size, READY_SHARE * most_left, self.granule)
        return GroupSequence(groups, sim, progress, most_left, alone)

    def _outcomes(self, sequence: GroupSequence) -> Iterator[Outcome]:
        """Outcomes of all jobs of a ``GroupSequence``."""
        with closing(sequence):
            while sequence.groups:
                waits = sequence.waits_for_host
                try:
                    for outcome in outcomes_of(self._slices(sequence), sequence.sim, sequence.progress, waits=waits):
                        if outcome is not None:  # None: a pause
                            del sequence.in_flight[outcome.job]
                        yield outcome
                except Exception as error:
                    if not is_out_of_memory(error):
                        raise
                else:
                    continue
                self._drop()
                yield from self._again(sequence)  # after the ``except`` block: the error's traceback holds the tables

    def _again(self, sequence: GroupSequence) -> Iterator[Outcome]:
        """After memory ran out, and with it the states of all worlds were lost: simulate the jobs without an outcome
        again, one size or half of them at a time. A world that was alone is given up."""
        lost, sim, progress = sequence.lose(), sequence.sim, sequence.progress
        if sequence.alone and lost:
            begun = GroupStart(sequence.next_run(), [*lost.values()], [*lost])
            slices = self._launcher(begun, sequence, waits=True, simulate=False)
            yield from outcomes_of(slices, sim, progress, waits=True)
            return
        numbers = np.array([*lost], int)
        sizes = np.array([size_of(job) for job in lost.values()])
        apart = [numbers[sizes == size] for size in np.unique(sizes)]
        for part in apart if len(apart) > 1 else np.array_split(numbers, 2):
            if len(part):
                progress.message = f"out of device memory, again with {len(part)} of the worlds"
                jobs = JobStream.of([lost[number] for number in part.tolist()])
                for outcome in self._outcomes(self._sequence(jobs, sim, progress)):
                    if outcome is not None:
                        outcome.job = int(part[outcome.job])
                    yield outcome

    @property
    def _while_loading(self) -> int:
        """Slices in flight while the tables of the next group are made."""
        return max(LOADING_NS // max(self.slice_ns, GPU_SLICE_NS), UNDER_WAY)

    def _slices(self, sequence: GroupSequence) -> Generator[SliceResult]:
        """Slice results of one group after another, as long as the groups agree in whether slices wait for the host."""
        waits = sequence.waits_for_host
        while sequence.groups and sequence.waits_for_host == waits:
            yield from self._launcher(sequence.begin(), sequence, waits=waits)

    def _load_group(self, run: Run, jobs: list[Job], most: int = 0, ahead: RowPrefetcher | None = None) -> Group:
        """The tables of a group.

        Args:
            most: jobs for which there are rows, if there are fewer jobs now.
            ahead: may have prefetched the rows.
        """
        rows, width = 1 << (max(len(jobs), most) - 1).bit_length(), run.needs.most_boxes
        ready = ahead.take(jobs, width) if ahead is not None else None
        return Group(**vars(load(jobs, rows, width, run.sim, run.timetable, ready)), run=run)

    def _launcher(
        self, begun: GroupStart, sequence: GroupSequence, *, waits: bool, simulate: bool = True
    ) -> Generator[SliceResult]:
        """Run time slices until all worlds of a group have ended, or are left to the next group. While the device runs
        a slice, the host makes outcomes of ended worlds, from which more jobs may follow. If none can follow and no
        world is recorded, the next slice is already in flight.

        Args:
            sequence: its waiting jobs may join the group; its next group takes over the last worlds.
            waits: the next slice waits for the host.
            simulate: False if memory has run out; all worlds are given up then.
        """
        jobs, numbers, sim = begun.jobs, begun.numbers, begun.run.sim
        group, queues, emitted = self._begin(begun, sequence)
        begun = begun._replace(left=None)  # its table is no longer needed
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
                    self._take(group, numbers, queues, sequence)
                    if not emitted[: len(jobs)].all():
                        rollout.keep_under_way(at_once, group, queues.order)
                    else:
                        rollout.finish(group)  # no world runs in the slices in flight
                if frames is not None:
                    hand_over(frames, group.recorder)
                yield SliceResult(picked, group.recorder, jobs, numbers)
                if rollout is not None and emitted[: len(jobs)].all() and self._take(group, numbers, queues, sequence):
                    rollout.keep_under_way(at_once, group, queues.order)
                if rollout is None or not group.recorder.idle:
                    continue
                rest = np.flatnonzero(~emitted[: len(jobs)])
                most = READY_SHARE * sequence.most_left
                if leaving is None and sequence.next_is_due(len(rest), most, rollout.launcher.blocks):
                    rollout.keep_under_way(self._while_loading, group, queues.order)
                    leaving = self._leaving(sequence, begun, rest, len(group.table.status))
                if leaving is not None and 0 < len(rest) <= sequence.most_left:
                    rollout.finish(group)
                    leaving.leave(group.table, emitted, most)
                    sequence.left = leaving
                    return
        except BaseException:
            self._drop()  # the memory of a call that did not return is lost
            raise

    def _begin(self, begun: GroupStart, sequence: GroupSequence) -> tuple[Group, Queues, NDArray[np.bool_]]:
        """The tables of a group, its queues, and the mask of rows whose outcomes the group before has given already."""
        run, jobs, _, left = begun
        if left is not None and left.ready is not None:
            group, queues = left.ready
        else:
            rows = min(max(SPARE_ROWS * len(jobs), self.least_rows), self.group_size) if sequence.groups.grows else 0
            group, queues = self._load(run, jobs, len(left.jobs) if left is not None else 0, rows, sequence)
        emitted = np.zeros(len(group.table.status), bool)
        if left is not None:
            n_own = len(jobs) - len(left.jobs)
            emitted[n_own : len(jobs)] = left.emitted
            group.table = left.put_into(group.table, n_own)
        return group, queues, emitted

    def _load(self, run: Run, jobs: list[Job], n_left: int, rows: int, sequence: GroupSequence) -> tuple[Group, Queues]:
        """The tables of a group, with at least ``rows`` rows, and its queues. The last ``n_left`` jobs come first in
        the queues, since they may go on for long."""
        run = replace(run, needs=run.needs.of_sizes(jobs))
        group = self._load_group(run, jobs, rows, sequence.ahead)
        queues, n_own = Queues(run.needs.sizes, size_of, len(group.table.status)), len(jobs) - n_left
        if n_left:
            queues.add(jobs[n_own:], n_own, run.sim)
        queues.add(jobs[:n_own], 0, run.sim)
        return group, queues

    def _leaving(self, sequence: GroupSequence, begun: GroupStart, rest: NDArray[np.int64], rows: int) -> GroupHandover:
        """The handover of a group's remaining worlds to the next group, with the tables of that group.

        Args:
            rest: rows of the worlds that have not ended.
            rows: rows of the group's tables. The next group's tables have the same number, for which programs are
                compiled already.
        """
        left = GroupHandover(
            [begun.jobs[row] for row in rest.tolist()], [begun.numbers[row] for row in rest.tolist()], rest
        )
        try:
            together = [*sequence.groups.following(), *left.jobs]
            left.ready = self._load(sequence.next_run(), together, len(rest), rows, sequence)
        except Exception as error:
            if not is_out_of_memory(error):
                raise
        return left

    def _take(self, group: Group, numbers: list[int], queues: Queues, sequence: GroupSequence) -> bool:
        """Put waiting jobs into free rows of a group, in order, until one does not fit. Returns whether any was
        added."""
        free = min(len(group.table.status), self.group_size) - len(group.jobs)
        fitting = list(takewhile(group.fits, sequence.groups.waiting(free)))
        if not fitting:
            return False
        sequence.groups.join(len(fitting))
        queues.add(fitting, len(group.jobs), group.run.sim)
        for first in range(0, len(fitting), MORE_AT_ONCE):
            some = fitting[first : first + MORE_AT_ONCE]
            width, run = group.table.qpos.shape[1], group.run
            new_rows = tables(some, MORE_AT_ONCE, width, group.profile_rows, run.sim, run.timetable, group.boards)
            group.add(some, *new_rows)
            sequence.join(some, numbers)
        return True

    def _make_room(self, group: Group, rows: NDArray[np.int64]) -> Rollout | None:
        """Enlarge the buffers of worlds that overflowed them and were stopped. Worlds that overflow at ``most_room``
        are given up."""
        sizes = np.array([size_of(group.jobs[row]) for row in rows.tolist()])
        for size in np.unique(sizes).tolist():
            some = rows[sizes == size]
            growth = self._pools.grow(group.run, size)
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
        """The rollout for a group, with fewer blocks if memory is short; None if not even ``MIN_BLOCKS`` fit. With
        blocks of two sizes the error of memory is raised instead."""
        run = group.run
        pools = self._pools.of(group)
        launches = tuple(pool.launch for pool in pools)
        key = run.sim, run.timetable, pools
        if launches in self._kept and self._kept[launches][0] == key:
            return self._kept[launches][1]
        if launches in self._kept:
            self._kept.pop(launches)[1].close()
        while True:
            try:
                rollout = Rollout(run, pools, self.slice_ns)
            except Exception as error:
                if not is_out_of_memory(error):
                    raise
                if not self._kept and any(pool.is_extra for pool in pools):
                    pools = tuple(pool for pool in pools if not pool.is_extra)
                elif not self._kept:
                    more, pools = pools, tuple(_half_pool(pool) for pool in pools)
                    if pools == more:
                        if len(pools) > 1:
                            raise  # each size may fit alone
                        return None
                self._drop()  # kept rollouts of other sizes may take the memory: try again without them
                lanes = sum(pool.blocks for pool in pools)
                run.progress.message = f"out of device memory, again with {lanes} lanes"
            else:
                self._kept[launches] = (key, rollout)
                return rollout

    def _blocks(self, launch: Launch) -> int:
        """The number of blocks of a launch, at most ``lanes``."""
        return min(self.lanes or launch.blocks, launch.blocks)
