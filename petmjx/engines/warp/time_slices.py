"""Time slices: calls of mjx-warp's kernels, in which every world of a table advances. This module starts slices, waits
for their results, puts further jobs into the rows of ended worlds, and makes the outcomes of these worlds."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from threading import Lock
from typing import Final, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Int
from numpy.typing import NDArray

from petmjx.common.prefetch import prefetch
from petmjx.engines.mjx.frame_recorder import Recorder
from petmjx.engines.mjx.outcomes import outcomes
from petmjx.engines.mjx.readback import Readback, prepare_readback, readbacks_of
from petmjx.engines.mjx.world_state import Status
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Flag, Outcome
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_pool_choice import BlockPools
from petmjx.engines.warp.block_queues import Queues
from petmjx.engines.warp.compiled_programs import READ_COUNTS, programs
from petmjx.engines.warp.frame_buffers import PickedFrames, hand_over, pick_frames, room_for
from petmjx.engines.warp.kernel_features import size_of
from petmjx.engines.warp.kernel_launcher import SLICE_NS
from petmjx.engines.warp.long_worlds import LongWorlds
from petmjx.engines.warp.table_jobs import TableJobs
from petmjx.engines.warp.world_table import TableRun, WorldTable
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

UNDER_WAY = 2
"""Number of slices that are started and not yet read, so that the device is never idle. While a slice runs, the CPU
reads the worlds that ended in earlier slices."""

MOST_AHEAD: Final = 40
"""Number of slices whose ended worlds may wait for the CPU before no further slice is started: 4 s of a GPU's work.
Each slice holds copies of the rows of its ended worlds, padded to hundreds of rows. All slices together take 200 MB for
plans of up to 76 boxes and 700 MB for 250 boxes. If slices hold several batches of ended worlds, these numbers are
larger."""


class Slice(NamedTuple):
    """The results of a time slice, except for the states.

    Attributes:
        number: number of the slice, counted from the first slice of its table.
        began: time at which the CPU started the slice, s.
        readback: statuses of all rows, followed by the counts ``READ_COUNTS``.
    """

    number: int
    began: float
    readback: Int[Array, " word"]
    frames: dict[str, jax.Array]
    counts: dict[str, jax.Array]


class SliceResult(NamedTuple):
    """The worlds that have ended in a time slice.

    Attributes:
        picked: states and metrics of the ended worlds, on the device.
        recorder: object that holds the histories of recorded worlds.
        jobs: number of a table row → job of the ended world that was in this row. The row itself may already hold
            another world.
        stream_numbers: number of a table row → stream number of the job that ``jobs`` has for this row.
    """

    picked: Sequence[Readback]
    recorder: Recorder
    jobs: Mapping[int, Job]
    stream_numbers: Mapping[int, int]


class Rollout:
    """The buffers of a run, and the queue of its started time slices.

    Args:
        pools: block pools, as returned by ``BlockPools.of``.
        slice_ns: length of a time slice, ns.
    """

    def __init__(self, run: TableRun, pools: Sequence[BlockPool], slice_ns: int = SLICE_NS) -> None:
        self.programs = programs(run.sim, run.timetable, tuple(pools), slice_ns)
        self.launcher = self.programs.launcher
        self.workspace = self.launcher.workspace().block_until_ready()
        self._slices: deque[Slice] = deque()
        self._last_end = 0.0

    @property
    def under_way(self) -> int:
        """Number of slices that have been started and that no caller has waited for yet."""
        return len(self._slices)

    def start(self, table: WorldTable, order: Int[Array, "queue world"]) -> None:
        """Start a time slice for all running worlds of a table, after the slices that are already started."""
        lanes = self.launcher.lanes
        if table.frames is None or (len(table.frames["of"]) < lanes and not table.recorder.idle):
            table.frames = room_for(table, lanes)
        arguments = (table.table, self.workspace, table.worlds, table.profiles, order, table.frames)
        program = self.programs.compiled(arguments, table.run.progress)
        began = time.perf_counter()
        table.table, self.workspace, readback, frames, counts = program(*arguments)
        self._slices.append(Slice(table.slices, began, readback, frames, counts))
        table.slices += 1

    def finish(self, table: WorldTable) -> None:
        """Wait for all started slices."""
        while self.under_way:
            self.wait(table)

    def close(self) -> None:
        """Wait for all started slices, and free the workspace."""
        while self._slices:
            with suppress(jax.errors.JaxRuntimeError):  # the rollout may be closed because of an error in a slice
                self._slices.popleft().readback.block_until_ready()
        if not self.workspace.is_deleted():
            with suppress(jax.errors.JaxRuntimeError):
                self.workspace.block_until_ready()
            self.workspace.delete()

    def wait(self, table: WorldTable) -> tuple[NDArray[np.int32], Slice]:
        """Wait for the oldest started slice. Returns the statuses of the table's worlds after this slice, and the
        slice."""
        ended = self._slices.popleft()
        readback = np.array(ended.readback)
        self._last_end, began = time.perf_counter(), max(ended.began, self._last_end)
        progress = table.run.progress
        counts = dict(zip(READ_COUNTS, readback[-len(READ_COUNTS) :].tolist(), strict=True))
        progress.message = table.run.message
        progress.world_steps += counts["steps"]
        extra = progress.extra
        sums = {"seconds": self._last_end - began, "steps": counts["steps"], "iterations": counts["iterations"]}
        for quantity, amount in sums.items():
            extra[f"kernel {quantity}"] = extra.get(f"kernel {quantity}", 0) + amount
        extra["kernel lanes"] = max(extra.get("kernel lanes", 0), self.launcher.lanes)
        extra["kernel contacts"] = max(extra.get("kernel contacts", 0), counts["contacts"])
        return table.status_after(ended.number, readback[: table.rows]), ended


class TableSlices:
    """The time slices of a table, up to the slice after which all its worlds have ended or continue in another table.
    While the device computes a slice, the CPU makes outcomes of ended worlds, and puts further jobs into their rows.

    Args:
        waits: whether each slice waits for the outcomes of the previous slice. Slices must wait if worlds are recorded,
            since the CPU must fetch the frames.
        pools: the block pools, which enlarge the buffers of worlds.
        rollout_for: function that returns the buffers (``Rollout``) for the table, or None if memory has run out.
    """

    def __init__(
        self,
        table: WorldTable,
        source: TableJobs,
        queues: Queues,
        waits: bool,
        pools: BlockPools,
        rollout_for: Callable[[WorldTable], Rollout | None],
    ) -> None:
        self._table, self._source, self._queues, self._waits = table, source, queues, waits
        self._pools, self._rollout_for = pools, rollout_for
        self._rollout: Rollout | None = None

    def results(self, *, simulate: bool) -> Generator[SliceResult]:
        """The worlds that end in each slice.

        Args:
            simulate: whether to simulate the worlds. False: all worlds are given up, since memory has run out.
        """
        table = self._table
        self._queues.add(table.jobs, np.arange(len(table.jobs)), table.live, table.run.sim)
        self._rollout = self._rollout_for(table) if simulate else None
        if self._rollout is None:
            self._give_up_table()
        else:
            self._keep_under_way(self._rollout)
            prepare_readback(table.table, table.worlds, table.run.sim)
        while table.live.any():
            status, frames = self._wait_for_slice()
            if self._rollout is not None and (status == Status.OVERFLOWED).any():
                status = self._grow_overflowed(self._rollout)
            result = self._read_ended(status)
            if self._rollout is not None:
                self._refill(self._rollout)
            if frames is not None:
                hand_over(frames, table.recorder)
            yield result
            if self._rollout is None:
                continue
            while not table.live.any() and self._outcomes_come and self._source.wait_for_following():
                # at this ``yield``, the caller may close the generator, or take the outcomes of long worlds
                yield SliceResult((), table.recorder, {}, {})
            if not table.live.any() and self._join(wait=True):
                self._keep_under_way(self._rollout)
            elif self._source.needs_another(table, self._rollout.launcher.blocks):
                self._hand_to_next_table(self._rollout)
                return

    @property
    def _outcomes_come(self) -> bool:
        """Whether outcomes may come while this generator waits for jobs. If slices wait for the CPU, only worlds that
        have left the device can still give outcomes."""
        return not self._waits or bool(self._source.left)

    def _keep_under_way(self, rollout: Rollout) -> None:
        """Start slices until ``UNDER_WAY`` slices are started and not yet read. Only one is started if the CPU must
        read each slice before the next one begins.
        """
        # A job that is made because of an outcome can join only a slice that is not started yet. So while blocks are
        # idle, slices are started one by one, so that jobs can join soon.
        blocks_idle = int(self._table.live.sum()) <= rollout.launcher.blocks
        single = self._waits or (self._source.feedback and blocks_idle)
        while rollout.under_way < (1 if single else UNDER_WAY):
            rollout.start(self._table, self._queues.order)

    def _wait_for_slice(self) -> tuple[NDArray[np.int32], PickedFrames | None]:
        """Wait for the oldest started slice. Returns the statuses of the worlds after this slice, and the frames of
        recorded worlds."""
        if self._rollout is None:
            return self._table.status(), None
        status, ended_slice = self._rollout.wait(self._table)
        return status, None if self._table.recorder.idle else pick_frames(ended_slice.frames)

    def _grow_overflowed(self, rollout: Rollout) -> NDArray[np.int32]:
        """Enlarge the buffers of worlds that overflowed their buffers and stopped. Worlds that overflow the largest
        buffers (``most_room``) are given up. Returns the statuses of all worlds."""
        table = self._table
        rollout.finish(table)
        rows = np.flatnonzero(table.status() == Status.OVERFLOWED)
        sizes = np.array([size_of(table.jobs[row]) for row in rows.tolist()])
        for size in np.unique(sizes).tolist():
            some = rows[sizes == size]
            growth = self._pools.buffers.grow(table.run, size)
            if growth is None:
                table.give_up(some, Flag.NONE)
                continue
            table.run.progress.message = (
                f"{len(some)} worlds overflowed their buffers: continuing with buffers that are {growth} times as large"
            )
            table.retry(some)
            table.table = table.table._replace(status=table.table.status.at[some].set(Status.RUNNING))
        self._rollout = self._rollout_for(table)
        if self._rollout is None:
            self._give_up_table()
        return table.status()

    def _give_up_table(self) -> None:
        """Give up all worlds that have not ended, since memory has run out."""
        is_live = self._table.live.copy()
        is_live[self._table.ended(self._table.status())] = False
        self._table.give_up(np.flatnonzero(is_live), Flag.OUT_OF_MEMORY)

    def _read_ended(self, status: NDArray[np.int32]) -> SliceResult:
        """Copy the results of the ended worlds to new arrays on the device, and free the table rows of these worlds."""
        table = self._table
        ended = table.ended(status)
        picked = readbacks_of(ended, table.table, table.worlds, table.run.sim)
        jobs = {row: table.jobs[row] for row in ended.tolist()}
        stream_numbers = {row: table.stream_numbers[row] for row in ended.tolist()}
        self._source.left.update(stream_numbers[row] for row in ended[status[ended] == Status.LEFT].tolist())
        table.end(ended)
        return SliceResult(picked, table.recorder, jobs, stream_numbers)

    def _refill(self, rollout: Rollout) -> None:
        """Put waiting jobs into free rows, and start the next slices."""
        self._join()
        live = self._table.live
        if not live.any():
            rollout.finish(self._table)  # the started slices have no running world
            return
        self._keep_under_way(rollout)
        # Worlds wait in the queues only if there are more live worlds than blocks. The queues are examined while the
        # device works on the started slices.
        if live.sum() > rollout.launcher.blocks:
            self._queues.examine(self._table.jobs, live)

    def _join(self, *, wait: bool = False) -> bool:
        """Put waiting jobs into free rows. Returns whether a job was added."""
        table = self._table
        rows = self._source.join(table, wait=wait)
        if rows:
            self._queues.add([table.jobs[row] for row in rows], np.array(rows), table.live, table.run.sim)
        return bool(rows)

    def _hand_to_next_table(self, rollout: Rollout) -> None:
        """Let the worlds that have not ended continue in the next table."""
        rollout.finish(self._table)
        self._source.running = self._table.take_running()


def outcomes_of(
    slices: Generator[SliceResult],
    sim: Simulation,
    progress: Progress,
    *,
    waits: bool,
    continued: LongWorlds | None = None,
) -> Iterator[Outcome]:
    """The outcomes of the worlds that end in these slices, with the stream numbers of their jobs.

    Args:
        waits: whether each slice waits for the outcomes of the previous slice. If slices do not wait, a thread runs
            them, since for small worlds the CPU may be slower than the device.
        continued: object that simulates worlds that have left the device, and is closed at the end; None if no world
            leaves the device.
    """
    counting, at_hand = Lock(), 0
    progress.at_hand = 0

    def count(more: int) -> None:
        nonlocal at_hand
        with counting:
            at_hand += more
            progress.at_hand = at_hand

    def counted() -> Generator[SliceResult]:
        with closing(slices):
            for next_slice in slices:
                # the number is 0 if no world has ended in the slice
                count(sum(len(batch.rows) for batch in next_slice.picked))
                yield next_slice

    try:
        with closing(counted() if waits else prefetch(counted(), most=MOST_AHEAD)) as ready_slices:
            for picked, recorder, jobs, stream_numbers in ready_slices:
                if progress.pauses and at_hand <= 0:
                    yield None  # type: ignore[misc]  # callers that set ``pauses`` expect it
                job_of = {stream_numbers[row]: job for row, job in jobs.items()} if continued is not None else {}
                for outcome in outcomes(picked, jobs, stream_numbers, sim, recorder):
                    count(-1)
                    if continued is None or not continued.take(job_of[outcome.job], outcome):
                        yield outcome
                if continued is not None:
                    yield from continued.ended()
        if continued is not None:
            yield from continued.last()
    finally:
        progress.at_hand = None  # after an error, no further outcome is ready, whatever was counted before
        if continued is not None:
            continued.close()
