"""Rollouts of mjx-warp: time slices in which every world of a table goes on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Int
from numpy.typing import NDArray

from petmjx.engines.warp.frame_buffers import room_for
from petmjx.engines.warp.kernel_launcher import SLICE_NS, BlockPool
from petmjx.engines.warp.programs import READ_COUNTS, programs
from petmjx.engines.warp.world_table import Run, WorldTable


class Slice(NamedTuple):
    """The results of a time slice other than states.

    Attributes:
        number: number of the slice of its table.
        began: time at which the host began it, s.
        readback: statuses of all rows, then the counts ``READ_COUNTS``.
    """

    number: int
    began: float
    readback: Int[Array, " word"]
    frames: dict[str, jax.Array]
    counts: dict[str, jax.Array]


class Rollout:
    """The buffers of a run and its time slices in flight, in order.

    Args:
        pools: block pools, as from ``BlockPools.of``.
        slice_ns: time slice of a call of the kernels, ns.
    """

    def __init__(self, run: Run, pools: Sequence[BlockPool], slice_ns: int = SLICE_NS) -> None:
        self.programs = programs(run.sim, run.timetable, tuple(pools), slice_ns)
        self.launcher = self.programs.launcher
        self.workspace = self.launcher.workspace().block_until_ready()
        self._slices: deque[Slice] = deque()
        self._last_end = 0.0

    @property
    def under_way(self) -> int:
        """Number of slices in flight: begun, and not waited for yet."""
        return len(self._slices)

    def start(self, table: WorldTable, order: Int[Array, "queue world"]) -> None:
        """Begin a time slice for all running worlds of a table, after the slices in flight."""
        lanes = self.launcher.lanes
        if table.frames is None or (len(table.frames["of"]) < lanes and not table.recorder.idle):
            table.frames = room_for(table, lanes)
        arguments = (table.table, self.workspace, table.worlds, table.profiles, order, table.frames)
        program = self.programs.compiled(arguments, table.run.progress)
        began = time.perf_counter()
        table.table, self.workspace, readback, frames, counts = program(*arguments)
        self._slices.append(Slice(table.slices, began, readback, frames, counts))
        table.slices += 1

    def keep_under_way(self, count: int, table: WorldTable, order: Int[Array, "queue world"]) -> None:
        """Begin slices until ``count`` are in flight."""
        while self.under_way < count:
            self.start(table, order)

    def finish(self, table: WorldTable) -> None:
        """Wait for all slices in flight."""
        while self.under_way:
            self.wait(table)

    def close(self) -> None:
        """Wait for slices in flight, and free the workspace."""
        while self._slices:
            with suppress(jax.errors.JaxRuntimeError):  # the rollout may be closed because of this error
                self._slices.popleft().readback.block_until_ready()
        if not self.workspace.is_deleted():
            with suppress(jax.errors.JaxRuntimeError):
                self.workspace.block_until_ready()
            self.workspace.delete()

    def wait(self, table: WorldTable) -> tuple[NDArray[np.int32], Slice]:
        """Wait for the first slice in flight. Returns the statuses of the table's worlds after it, and the slice."""
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
