"""Reads ended worlds back from the device to the host."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int
from numpy.typing import NDArray

from petmjx.engines.mjx.running_metrics import RunMetrics, run_metrics
from petmjx.engines.mjx.world_constants import Worlds, device_array
from petmjx.engines.mjx.world_state import State, take_rows
from petmjx.options.simulation import Simulation

READBACK_ROWS: Final = 256
"""Number of rows that are read back at a time. (Smaller tables are read back as a whole.) All reads of a table have the
same number of rows, because JAX compiles a separate program for each number of rows."""


class Readback(NamedTuple):
    """States and metrics of some rows of a table, packed as bits into one integer array. The host waits for each array
    that it fetches from a GPU, so a single array is fastest.

    Attributes:
        rows: numbers of the rows; ``bits`` may have more rows, as padding.
        bits: the values of all arrays.
        kinds: a ``State`` and ``RunMetrics`` that hold the shape and type of each array instead of the array.
    """

    rows: NDArray[np.int64]
    bits: Int[Array, "row word"]
    kinds: Any

    def on_host(self) -> tuple[State, RunMetrics]:
        """The arrays, copied to the host. The call waits for the device."""
        bits, first = np.asarray(self.bits), 0

        def next_of(kind: Any) -> NDArray[Any]:
            nonlocal first
            words = bits[:, first : first + math.prod(kind.shape[1:])]
            first += words.shape[1]
            array: NDArray[Any] = words.view(kind.dtype).reshape(kind.shape)
            return array

        arrays: tuple[State, RunMetrics] = jax.tree.map(next_of, self.kinds)
        return arrays


@partial(jax.jit, static_argnames="sim")
def reduce_metrics(state: State, worlds: Worlds, sim: Simulation) -> RunMetrics:
    """The metrics that are computed once a world has ended, for every world of a table, on the device."""
    placed = jnp.arange(worlds.half.shape[1])[None] < state.placed[:, None]
    return run_metrics(state.metrics, state.qpos, worlds, placed, state.step >= state.end, sim.thresholds)


@partial(jax.jit, static_argnames="sim")
def _readback_words(table: State, worlds: Worlds, rows: Int[Array, " row"], sim: Simulation) -> Int[Array, "row word"]:
    table_rows = take_rows(table, rows)
    arrays = jax.tree.leaves((table_rows, reduce_metrics(table_rows, take_rows(worlds, rows), sim)))
    words = [jax.lax.bitcast_convert_type(array, jnp.int32).reshape(len(rows), -1) for array in arrays]
    return jnp.concatenate(words, axis=1)


def prepare_readback(table: State, worlds: Worlds, sim: Simulation) -> None:
    """Compile the programs of ``readbacks_of`` while the device is busy, so that later calls need no compilation."""
    readbacks_of(np.zeros(1, np.int64), table, worlds, sim)


def readbacks_of(rows: NDArray[np.int64], table: State, worlds: Worlds, sim: Simulation) -> list[Readback]:
    """Rows of a table, still on the device, in batches of equal size. The last batch is padded."""
    if not len(rows):  # in most time slices, no world ends
        return []
    size = min(READBACK_ROWS, len(table.status))

    def kind(of_row: tuple[int, ...], dtype: Any) -> Any:
        return jax.ShapeDtypeStruct((size, *of_row), dtype)  # type: ignore[no-untyped-call]  # JAX has no types for it

    state = jax.tree.map(lambda array: kind(array.shape[1:], array.dtype), table)
    number = state.metrics.max_tilt
    of_axes = kind((*number.shape[1:], 3), number.dtype)
    kinds = state, RunMetrics(shift=of_axes, max_tilt=number, max_top_force=number, rest_force=number)
    batches = []
    for first in range(0, len(rows), size):
        chunk_rows = rows[first : first + size]
        padded = device_array(np.resize(chunk_rows, size).astype(np.int32))
        batches.append(Readback(chunk_rows, _readback_words(table, worlds, padded, sim), kinds))
    return batches
