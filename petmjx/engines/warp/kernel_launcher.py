"""Launches the kernels of mjx-warp, in a call from JAX in which each world advances at its own pace (docs/batching.md).

The thread blocks for worlds of one size form a block pool, which has its own kernel
(petmjx/engines/warp/block_launch.py) and its own queue of worlds. All block pools run at the same time on the same
tables of worlds. States are in the tables of petmjx/engines/mjx/world_state.py, and an interrupted world continues in
the next call. So results do not depend on the blocks, on the order of worlds, or on the length of a slice.
"""

from __future__ import annotations

import inspect
import itertools
import weakref
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import warp as wp

from petmjx.engines.mjx.world_constants import NEVER
from petmjx.engines.warp import world_arrays
from petmjx.engines.warp.block_launch import Call, kernel, launch_all, load_kernels
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.world_arrays import (
    Counts,
    FrameBuffer,
    Model,
    State,
    Workspace,
    Worlds,
    array_types,
    filled_record,
)

SLICE_NS = 250_000_000
"""Length of a time slice (one call of the kernels), ns, if an engine sets no other length: short enough for a progress
bar and for an interruption."""


class KernelLauncher:
    """Launches kernels with the constants of a run.

    Args:
        constants: the fields of ``world_arrays.Model``, except the fields that depend on the block pool.
        pools: block pools, in the order of the queues from which they take worlds. The device starts the blocks of the
            first block pools first.
        slice_ns: length of a time slice, ns. With 0, each block takes one step.
        of_stiff: ``BlockPool.stiff`` → the constants that differ from ``constants`` for block pools with this value.
    """

    def __init__(
        self,
        constants: Mapping[str, Any],
        pools: Sequence[BlockPool],
        slice_ns: int = SLICE_NS,
        of_stiff: Mapping[float | None, Mapping[str, Any]] = MappingProxyType({}),
    ) -> None:
        self.pools = tuple(pools)
        self.models = [
            filled_record(
                Model,
                {
                    **constants,
                    **of_stiff.get(pool.stiff, {}),
                    "queue": queue,
                    "most_idle": pool.most_idle,
                    "most_placed": pool.n_boxes if pool.least else NEVER,
                    "npairmax": pool.npairmax,
                    "nconmax": pool.nconmax,
                },
            )
            for queue, pool in enumerate(pools)
        ]
        # extra block pools and block pools for stiff contacts are left out: their blocks take the place of other blocks
        self.blocks = sum(pool.blocks for pool in pools if not pool.is_extra and pool.stiff is None)
        self.lanes = sum(pool.lanes for pool in pools)
        self.slice_ns = slice_ns
        self.id = next(_IDS)
        _LAUNCHERS[self.id] = self

    def workspace(self) -> jax.Array:
        """A new workspace (memory for use within a step) for all blocks. The workspace is an argument of each call."""
        rows = sum(world_arrays.buffer_rows(pool.sizes) for pool in self.pools)
        return jnp.zeros((rows, world_arrays.BUFFER_WORDS), jnp.float32)

    def load(self) -> None:
        """Compile the kernels in parallel, or load them from Warp's cache."""
        load_kernels([pool.launch for pool in self.pools])

    def __call__(
        self,
        worlds: Mapping[str, jax.Array],
        state: Mapping[str, jax.Array],
        workspace: jax.Array,
        frames: Mapping[str, jax.Array],
    ) -> tuple[dict[str, jax.Array], jax.Array, dict[str, jax.Array], dict[str, jax.Array]]:
        """Simulate the worlds for a time slice. Returns the states of the worlds, the workspace, the recorded frames,
        and ``Counts``. Fields of a state that no kernel uses keep their values."""
        kinds, shapes = array_types(Counts), world_arrays.array_shapes(Counts, {"queue": len(self.pools)})
        counts = {name: jnp.zeros(shapes[name], wp.dtype_to_numpy(kind.dtype)) for name, kind in kinds.items()}
        arrays = {**worlds, **state, **counts, "workspace": workspace}
        assert len(arrays) == len(worlds) + len(state) + len(counts) + 1, "arrays of two records have the same name"
        arrays |= {_of_frames(name): values for name, values in frames.items()}
        call = wp.jax_callable(
            _launch,
            num_outputs=len(_CHANGED),
            graph_mode=wp.JaxCallableGraphMode.NONE,
            in_out_argnames=list(_CHANGED),
        )
        changed = call(self.id, *(arrays[name] for name in _INPUTS | _CHANGED))
        outputs = dict(zip(_CHANGED, changed, strict=True))
        after = {name: outputs.get(name, values) for name, values in state.items()}
        kept = {name: outputs[_of_frames(name)] for name in frames}
        return after, outputs["workspace"], kept, {name: outputs[name] for name in counts}

    def launch(self, arrays: dict[str, Any]) -> None:
        """Launch the kernels on Warp arrays, whose names are in ``_INPUTS`` and ``_CHANGED``."""
        worlds, state, counts = (filled_record(kind, arrays) for kind in (Worlds, State, Counts))
        frames = filled_record(FrameBuffer, {name: arrays[_of_frames(name)] for name in array_types(FrameBuffer)})
        row, calls = 0, []
        for pool, model in zip(self.pools, self.models, strict=True):
            work = filled_record(Workspace, world_arrays.in_buffer(arrays["workspace"], pool.sizes, row))
            row += world_arrays.buffer_rows(pool.sizes)
            before = model, worlds, self.lanes, self.slice_ns
            after = *pool.launch.feature_arguments, state, work, frames, counts
            calls.append(Call(kernel(pool.launch), pool.blocks, pool.launch.threads, before, after))
        launch_all(calls, arrays["clock"], self.slice_ns)


def _of_frames(name: str) -> str:
    """The name of an array of ``FrameBuffer`` among all arrays that JAX passes. The name has a prefix, since ``State``
    uses some of the same names."""
    return f"frame_{name}"


_INPUTS = array_types(Worlds)
_CHANGED = (
    array_types(State)
    | array_types(Counts)
    | {"workspace": wp.array2d[float]}
    | {_of_frames(name): kind for name, kind in array_types(FrameBuffer).items()}
)
"""Name → type of the arrays that JAX passes and the kernels change."""

_IDS = itertools.count()
_LAUNCHERS: weakref.WeakValueDictionary[int, KernelLauncher] = weakref.WeakValueDictionary()
"""Number of a launcher → the launcher with this number. JAX never frees a function that it calls. If such a function
were a method of a launcher, the launcher and the memory of its run would never be freed. So the function ``_launch``
gets only the number of the launcher."""


def _launch(launcher: int, *arrays: Any) -> None:
    """Launch the kernels of a launcher. JAX calls this function with the arrays of ``_INPUTS`` and ``_CHANGED``."""
    _LAUNCHERS[launcher].launch(dict(zip(_INPUTS | _CHANGED, arrays, strict=True)))


# Warp reads the types of the buffers from the signature.
_launch.__annotations__ = {"launcher": int} | _INPUTS | _CHANGED
_launch.__signature__ = inspect.Signature(  # type: ignore[attr-defined]  # inspect reads it
    [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in _launch.__annotations__]
)
