"""Arrays of the next boxes of many open worlds, and the states of these worlds. Trying a place for a box needs only
these arrays; no scene is built.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import judged_samples
from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx.world_constants import Worlds, device_array
from petmjx.engines.mjx.world_state import State, Status, take_rows
from petmjx.engines.open_world_protocol import Snapshots
from petmjx.engines.step_clock import Clock
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Simulation
from petmjx.world.growing_scenes import EmptyCarrier, NextBoxes, Stacks
from petmjx.world.release_places import release_of_next
from petmjx.world.scene import IDENTITY_QUAT


class NewBox(NamedTuple):
    """The constants of one box per world. The fields are as in ``Worlds``, without the axis of boxes."""

    half: Float[Array, "world 3"]
    target: Float[Array, "world 3"]
    start: Float[Array, "world 7"]
    support: Int[Array, " world"]
    mass: Float[Array, " world"]
    friction: Float[Array, "world 3"]
    surface: Int[Array, " world"]


def new_box(before: Stacks, boxes: NextBoxes, blank: EmptyCarrier, sim: Simulation, rows: int) -> NewBox:
    """The constants of boxes that appear at their places, one box on each of the given stacks.

    Args:
        rows: number of rows of the arrays, at least one per box. Additional rows repeat the first box, and are not
            used.
    """
    release = release_of_next(before, boxes, sim)
    start = np.hstack([release.pos, np.tile(IDENTITY_QUAT, (len(boxes), 1))])
    spread = np.concatenate([np.arange(len(boxes)), np.zeros(rows - len(boxes), np.intp)])

    def up(values: NDArray[np.generic], kind: type[np.generic] = np.float32) -> Array:
        return device_array(values.astype(kind)[spread])

    return NewBox(
        half=up(boxes.half_size),
        target=up(boxes.target),
        start=up(start),
        support=up(release.support, np.int32),
        mass=up(boxes.mass),
        friction=up(np.tile(blank.friction, (len(boxes), 1))),
        surface=up(np.full(len(boxes), blank.surface), np.int32),
    )


def with_new_box(worlds: Worlds, box: NewBox) -> Worlds:
    """The constants of worlds with one more box each, bit-identical to the constants from ``upload_worlds``.

    A world without a free column keeps its constants.
    """
    k, row = worlds.n_boxes, jnp.arange(len(worlds.n_boxes))
    shape = worlds.first_shape[row, jnp.minimum(k + 1, worlds.first_shape.shape[1] - 1)]
    return worlds._replace(
        n_boxes=jnp.minimum(k + 1, worlds.half.shape[1]),
        half=worlds.half.at[row, k].set(box.half, mode="drop"),
        middle=worlds.middle.at[row, k].set(0.0, mode="drop"),
        target=worlds.target.at[row, k].set(box.target, mode="drop"),
        start=worlds.start.at[row, k].set(box.start, mode="drop"),
        support=worlds.support.at[row, k].set(box.support, mode="drop"),
        mass=worlds.mass.at[row, k + 1].set(box.mass, mode="drop"),
        inertia_box=worlds.inertia_box.at[row, k + 1].set(box.half, mode="drop"),
        shape_body=worlds.shape_body.at[row, shape].set(k + 1, mode="drop"),
        shape_half=worlds.shape_half.at[row, shape].set(box.half, mode="drop"),
        shape_pos=worlds.shape_pos.at[row, shape].set(0.0, mode="drop"),
        friction=worlds.friction.at[row, shape].set(box.friction, mode="drop"),
        shape_surface=worlds.shape_surface.at[row, shape].set(box.surface, mode="drop"),
    )


class SnapshotInputs(NamedTuple):
    """The fields of ``State`` and ``Metrics`` from which ``Snapshots`` are computed."""

    placed: Int[Array, " world"]
    step: Int[Array, " world"]
    status: Int[Array, " world"]
    flags: Int[Array, " world"]
    culprit: Int[Array, " world"]
    quiet_steps: Int[Array, " world"]
    qpos: Float[Array, "world box 7"]
    top_force: Float[Array, "world box"]
    max_tilt: Float[Array, "world box"]
    max_top_force: Float[Array, "world box"]
    drop_step: Int[Array, "world box"]
    sampled: dict[str, Float[Array, "world box"]]

    @classmethod
    def of(cls, state: State) -> SnapshotInputs:
        """The inputs for the snapshots of all worlds."""
        arrays = state.flat()
        sampled = {name: arrays[name] for name in judged_samples()}
        return cls(**{name: arrays[name] for name in cls._fields if name != "sampled"}, sampled=sampled)

    def flags_now(self, sim: Simulation) -> NDArray[np.int64]:
        """(m,) the flags of each world, as integers in the CPU's memory. A world has ``MOVING`` if it paused because
        its time was up although it was not at rest."""
        tilted = np.asarray(self.max_tilt) > sim.thresholds.tilt_deg
        failed = (np.asarray(self.culprit) >= 0) & (tilted | (np.asarray(self.drop_step) >= 0)).any(axis=1)
        moves = (np.asarray(self.status) == Status.PAUSED) & (np.asarray(self.quiet_steps) < sim.quiet.steps) & ~failed
        return np.asarray(self.flags, np.int64) | np.where(moves, int(Flag.MOVING), 0)


@jax.jit
def snapshot_inputs(worlds: Worlds, state: State, rows: Int[Array, " row"]) -> SnapshotInputs:
    """The inputs for the snapshots of the worlds in the rows ``rows``, with the middles of boxes instead of their
    centres of mass. For a row beyond the table, the inputs belong to an arbitrary world."""
    inputs = take_rows(SnapshotInputs.of(state), rows)
    middles = motion.middles(inputs.qpos, take_rows(worlds, rows).middle)
    return inputs._replace(qpos=jnp.concatenate([middles, inputs.qpos[..., 3:]], axis=-1))


def snapshots_of(report: SnapshotInputs, half_size: FloatArray, target: FloatArray, sim: Simulation) -> Snapshots:
    """The snapshots of the first m worlds, where m is the length of ``half_size``.

    Args:
        report: what ``snapshot_inputs`` returned for at least m worlds, on the device.
        half_size, target: (m, k, 3) half extents and planned centres of the boxes, m.
    """
    state: SnapshotInputs = jax.tree.map(lambda values: values[: len(half_size)], jax.device_get(report))
    width = half_size.shape[1]
    placed = np.asarray(state.placed, np.int64)
    beyond = np.arange(width) >= placed[:, None]

    def doubles(values: NDArray[np.generic]) -> FloatArray:
        table = np.asarray(values)[:, :width].astype(np.float64)
        table[beyond] = np.nan
        return table

    clock, pose = Clock(sim.physics.timestep_s), doubles(np.asarray(state.qpos))
    steps, which = np.unique(np.maximum(np.asarray(state.step), 0), return_inverse=True)
    return Snapshots(
        placed=placed,
        time_s=np.array([clock.time_s(int(step)) for step in steps])[which],
        ended=np.asarray(state.status) == Status.FINISHED,
        flags=state.flags_now(sim),
        culprit=np.asarray(state.culprit, np.int64),
        pos=pose[:, :, :3],
        quat=pose[:, :, 3:],
        target=target,
        half_size=half_size,
        top_force_n=doubles(np.asarray(state.top_force)),
        max_tilt_deg=doubles(np.asarray(state.max_tilt)),
        max_top_force_n=doubles(np.fmax(state.max_top_force, state.top_force)),
        dropped=(np.asarray(state.drop_step)[:, :width] >= 0) & ~beyond,
        sampled={name: doubles(np.asarray(values)) for name, values in state.sampled.items()},
    )
