"""Open worlds (to which boxes can be added) as a JAX pytree, and the pure functions that return changed open worlds.

Jitted programs can call these functions.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import warp as wp
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import Timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds
from petmjx.engines.mjx.world_state import State, Status, fresh_state, of_flat, put_rows, take_rows
from petmjx.engines.warp import world_arrays
from petmjx.engines.warp.block_launch import Features, Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.compiled_programs import constants
from petmjx.engines.warp.contact_buffers import MORE_BOXES
from petmjx.engines.warp.kernel_launcher import SLICE_NS, KernelLauncher
from petmjx.engines.warp.next_boxes import NewBox, with_new_box
from petmjx.options.simulation import Check, Simulation


class OpenState(NamedTuple):
    """Open worlds: their states and their constants. The constants change only when worlds get boxes or start again."""

    worlds: Worlds
    state: State


class Simulator:
    """The pure functions that return changed open worlds.

    Args:
        most_boxes: largest number of boxes of a world.
        boards: largest number of shapes of a carrier.
        room: factor by which buffers are larger than the default.
        threads: number of CPU threads. If ``threads`` is None, there is one thread.
        features: features of the kernel.
    """

    def __init__(
        self,
        sim: Simulation,
        timetable: Timetable,
        most_boxes: int,
        boards: int,
        room: int = 1,
        threads: int | None = None,
        *,
        features: Features,
    ) -> None:
        launch = Launch.here(most_boxes, features)
        pool = BlockPool.of(launch, threads or launch.blocks, most_boxes, boards, room * (most_boxes + MORE_BOXES))
        self._launcher = KernelLauncher(constants(sim, timetable), [pool], SLICE_NS)
        self._sim, self._timetable = sim, timetable
        self._placing = Rules(sim, timetable, most_boxes, driven=False, carries=True)
        self._driving = Rules(sim, timetable, most_boxes, driven=True)

    def load(self) -> None:
        """Compile the kernel, or load it from Warp's cache."""
        self._launcher.load()

    def begin(self, worlds: Worlds) -> State:
        """The states of worlds before their soft start."""
        static = self._sim.check is Check.STATIC
        ends = jnp.full(len(worlds.n_boxes), NEVER, jnp.int32)
        fresh: State = fresh_state(worlds, all_placed=static, ends=ends, rest_steps=self._timetable.rest_steps)
        return fresh

    def reset(self, open_: OpenState, rows: Int[Array, " row"], worlds: Worlds) -> OpenState:
        """Start the worlds in the rows ``rows`` again, with the constants ``worlds``. Row numbers beyond the last
        world are ignored."""
        fresh = self.begin(worlds)
        return OpenState(put_rows(open_.worlds, rows, worlds), put_rows(open_.state, rows, fresh))

    def put(self, open_: OpenState, rows: Int[Array, " row"], worlds: Worlds) -> OpenState:
        """Add boxes to worlds. In each paused world, the first new box is placed.

        Args:
            rows: row numbers of these worlds. Row numbers beyond the last world are ignored.
            worlds: constants of these worlds, for their existing boxes and the new boxes.
        """
        after = put_rows(open_.worlds, rows, worlds)
        return OpenState(after, self._placing.go_on_placing(open_.state, after))

    def put_next(self, open_: OpenState, rows: Int[Array, " row"], box: NewBox) -> OpenState:
        """Add one box, which appears at its place, to each of these worlds. In all other respects, this function does
        the same as ``put``."""
        return self.put(open_, rows, with_new_box(take_rows(open_.worlds, rows), box))

    def finish(self, open_: OpenState) -> State:
        """Let each paused world begin its rest window or its drive, as its constants say. A world may have paused
        because its boxes did not come to rest in time. If boxes of a paused world still move, the world first waits
        longer, up to ``longest_wait_s`` after its last placement. (The wait before the pause may have been shorter.)"""
        state, worlds = open_.state, open_.worlds
        paused = state.status == Status.PAUSED
        goes = paused & ~(self._placing.moves(state) & self._lasts_longer(state))
        settles = goes & worlds.settles & (not self._sim.waits_for_rest)
        rests = goes & ~settles
        state = self._placing.noting_motion(state, settles)
        rest_from = self._placing.rest_from(state)
        return state._replace(
            rest_from=jnp.where(rests, rest_from, state.rest_from),
            end=jnp.where(rests, rest_from + self._timetable.rest_steps, state.end),
            driven_from=jnp.where(settles, state.step, state.driven_from),
            status=jnp.where(settles, Status.SETTLED, jnp.where(paused, Status.RUNNING, state.status)),
        )

    def go_on(self, open_: OpenState, profiles: Float[Array, "profile step 3"]) -> OpenState:
        """Simulate until each world has paused, ended, or overflowed its buffers."""
        return jax.lax.while_loop(self.going, lambda worlds: self.time_slice(worlds, profiles), open_)

    @staticmethod
    def going(open_: OpenState) -> Bool[Array, ""]:
        """Whether any world can continue."""
        state, driven = open_.state, open_.worlds.driven
        return (state.running | ((state.status == Status.SETTLED) & driven)).any()

    def time_slice(self, open_: OpenState, profiles: Float[Array, "profile step 3"]) -> OpenState:
        """Simulate the worlds for a time slice (one call of the kernels)."""
        worlds, n = open_.worlds, len(open_.worlds.n_boxes)
        flat_worlds = worlds.flat() | {"profiles": profiles, "order": jnp.arange(n, dtype=jnp.int32)[None]}
        flat = self._driving.begin_drives(open_.state, worlds).flat()
        after, *_ = self._launcher(flat_worlds, flat, self._launcher.workspace(), _no_frames(n, worlds.half.shape[1]))
        return OpenState(worlds, of_flat(after))

    def _lasts_longer(self, state: State) -> Bool[Array, " world"]:
        """(world,) whether a paused world may wait longer: its last placement is less than ``longest_wait_s`` ago."""
        patient = self._sim.waits_for_rest and self._sim.check is Check.ONE_BY_ONE
        return patient & (state.step < jnp.asarray(self._timetable.longest)[state.last_placed_at])


def _no_frames(n_worlds: int, n_boxes: int) -> dict[str, jax.Array]:
    """Frame buffers for worlds that are not recorded."""
    shapes = world_arrays.array_shapes(world_arrays.FrameBuffer, {"frame": 1, "box": n_boxes, "world": n_worlds})
    kinds = world_arrays.array_types(world_arrays.FrameBuffer)
    return {name: jnp.zeros(shape, wp.dtype_to_numpy(kinds[name].dtype)) for name, shape in shapes.items()}
