"""The states of worlds on the device, from step to step: tables with the same rows and box columns as
``world_constants.Worlds``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from typing import Any, NamedTuple, TypeVar, get_type_hints

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.mjx.running_metrics import Metrics, no_metrics
from petmjx.engines.mjx.world_constants import NEVER, Worlds
from petmjx.options.simulation import SOFT_START_STEPS
from petmjx.world.scene import IDENTITY_QUAT

SOFT_START_BEGIN = -2 * SOFT_START_STEPS
"""Step counter of a fresh world: the steps of the soft start come before step 0."""


class Status:
    """The phases of a world. The phases are plain integers, since device arrays store them."""

    RUNNING = 0
    SETTLED = 2
    """The placement is over, and the pallet is at rest. A drive may follow."""
    FINISHED = 3
    OVERFLOWED = 4
    """On mjx-warp: a buffer is too small for the next step."""
    PAUSED = 5
    """All boxes of an open world, or of a placement that pauses, are placed and at rest. More boxes may follow."""
    PLACES = 6
    """On mjx-warp: a placement that had paused goes on. The next box is placed before the next step."""
    LEFT = 7
    """On mjx-warp: the world has taken ``Worlds.most_steps`` steps, and leaves the GPU. A CPU thread continues it."""


class State(NamedTuple):
    """The states of worlds between two steps. Steps are counted from the end of the soft start."""

    # MuJoCo's arrays of free bodies, with boxes and carrier in separate arrays. ``qpos``: poses. ``qpos_remainder``: on
    # mjx-warp, the part of positions that single precision cannot hold; on mjx-jax, 0. ``qvel``: velocities. ``qacc``:
    # accelerations of the last step. ``qacc_warmstart``: accelerations from which mjx-warp's solver starts in the next
    # step; mjx-jax's solver starts from ``qacc`` instead.
    qpos: Float[Array, "world box 7"]
    qpos_remainder: Float[Array, "world box 3"]
    qvel: Float[Array, "world box 6"]
    qacc: Float[Array, "world box 6"]
    qacc_warmstart: Float[Array, "world box 6"]
    carrier_qpos: Float[Array, "world 7"]
    carrier_qpos_remainder: Float[Array, "world 3"]
    carrier_qvel: Float[Array, "world 6"]
    carrier_qacc: Float[Array, "world 6"]
    carrier_qacc_warmstart: Float[Array, "world 6"]

    # The index of each placed body in the system of equations of mjx-warp's solver, which sorts the bodies. A newly
    # placed box comes last.
    position: Int[Array, "world box"]
    carrier_position: Int[Array, " world"]

    # Placing: the last step taken, the number of placed boxes, and the step after which the last box was placed.
    step: Int[Array, " world"]
    placed: Int[Array, " world"]
    last_placed_at: Int[Array, " world"]

    # Carrying, for the box that was placed last. ``carried_from``: the step after which a hand took up the box, or
    # NEVER. ``lowered_from``: the step after which the hand began to set the box down, or NEVER. ``carried_steps``: the
    # number of steps of the box's path. ``way_begin``, ``way_end``: the origin of the box's frame at the ends of the
    # path.
    carried_from: Int[Array, " world"]
    lowered_from: Int[Array, " world"]
    carried_steps: Int[Array, " world"]
    way_begin: Float[Array, "world 3"]
    way_end: Float[Array, "world 3"]

    # Landing: the number of steps for which a box still counts as landing, and the velocity of the box before it
    # touched anything.
    landing_left: Int[Array, "world box"]
    landing_qvel: Float[Array, "world box 6"]

    # Film: the positions of the boxes when the film was wound around them, and the anchors at which the film holds
    # them, both relative to the carrier.
    film_home: Float[Array, "world box 3"]
    film_anchor: Float[Array, "world box 3"]

    # For the rules. ``waits_since``: the step after which the wait for the next event began. ``quiet_steps``: the
    # number of steps for which all boxes have been quiet. ``quiet_speed``: the boxes' speeds at the first of these
    # steps. ``violent_since``: the first step of the present series of violent samples (accelerations above the
    # thresholds).
    waits_since: Int[Array, " world"]
    quiet_steps: Int[Array, " world"]
    quiet_speed: Float[Array, "world box"]
    violent_since: Int[Array, " world"]

    # Trembling: the number of looks (checks whether the pallet is quiet) since the last placement, and whether each box
    # trembles (1) or stays (2). The other three arrays describe the path of each box since boxes were last examined for
    # trembling and staying. ``tremble_path``: length of the path, m. ``tremble_away``: largest distance of the box from
    # the beginning of the path, m. ``tremble_qpos``: pose of the box at the beginning of the path.
    tremble_looks: Int[Array, " world"]
    trembles: Int[Array, "world box"]
    tremble_path: Float[Array, "world box"]
    tremble_away: Float[Array, "world box"]
    tremble_qpos: Float[Array, "world box 7"]

    # Future events, as steps or NEVER: the start of the drive, the start of the rest window, and the end of the world.
    # In the last steps before the end, boxes must be still: ``still_qpos`` has the poses at the first of these steps.
    driven_from: Int[Array, " world"]
    rest_from: Int[Array, " world"]
    end: Int[Array, " world"]
    still_qpos: Float[Array, "world box 7"]
    status: Int[Array, " world"]

    # For the outcome. ``flags``: bits of Flag. ``steps_done``: number of simulated steps, without the steps of a
    # settled placement from which the world started. ``iterations_done``: number of iterations of the solver since the
    # beginning of the placement or of the drive.
    flags: Int[Array, " world"]
    steps_done: Int[Array, " world"]
    iterations_done: Int[Array, " world"]
    metrics: Metrics

    # Force on top of each box in the last step before the world paused, N.
    top_force: Float[Array, "world box"]

    @property
    def running(self) -> Bool[Array, " world"]:
        return self.status == Status.RUNNING

    def flat(self) -> dict[str, Array]:
        """All arrays by name, including the arrays of the metrics, as the kernels of mjx-warp take them."""
        arrays: dict[str, Array] = self._asdict() | self.metrics._asdict()
        del arrays["metrics"]
        return arrays


def of_flat(arrays: Mapping[str, Array]) -> State:
    """The states from arrays by name, the inverse of ``State.flat``."""
    metrics = Metrics(**{name: arrays[name] for name in Metrics._fields})
    return State(**{name: arrays[name] for name in State._fields if name != "metrics"}, metrics=metrics)


Record = TypeVar("Record", bound=tuple[Any, ...])


def second_axes(record: type[Any]) -> dict[str, str]:
    """Name of each field of a record → name of its second axis, read from the annotations; "" if it has none."""
    shapes = {name: getattr(kind, "dim_str", "").split() for name, kind in get_type_hints(record).items()}
    return {name: axes[1] if len(axes) > 1 else "" for name, axes in shapes.items()}


@cache
def per_box(record: type[Any]) -> tuple[str, ...]:
    """Names of a record's fields whose second axis is ``box``."""
    return tuple(name for name, axis in second_axes(record).items() if axis == "box")


def narrow(state: State, capacity: int) -> State:
    """The states with columns for only the first ``capacity`` boxes."""

    def cut(record: Any) -> dict[str, Any]:
        kind: Any = type(record)
        return {name: getattr(record, name)[:, :capacity] for name in per_box(kind)}

    return state._replace(**cut(state), metrics=state.metrics._replace(**cut(state.metrics)))


def put_rows(table: Record, rows: Int[Array, " row"], values: Record) -> Record:
    """Write records into rows of a table. Rows beyond the end of the table are dropped."""
    written: Record = jax.tree.map(lambda old, new: old.at[rows].set(new, mode="drop"), table, values)
    return written


def put_resized(table: State, rows: Int[Array, " row"], values: State) -> State:
    """``put_rows`` for states with another number of box columns. Columns that the table does not have are dropped. If
    the states have fewer columns than the table, the table's remaining columns are not changed."""

    def write(old: Array, new: Array) -> Array:
        columns = tuple(slice(min(sizes)) for sizes in zip(old.shape[1:], new.shape[1:], strict=True))
        return old.at[(rows, *columns)].set(new[(slice(None), *columns)], mode="drop")

    written: State = jax.tree.map(write, table, values)
    return written


def select_rows(chosen: Bool[Array, " row"], one: Record, other: Record) -> Record:
    """The rows of ``one`` where ``chosen`` is True, and the rows of ``other`` elsewhere."""

    def select(a: Array, b: Array) -> Array:
        return jnp.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    selected: Record = jax.tree.map(select, one, other)
    return selected


def take_rows(record: Record, rows: Int[Array, " row"]) -> Record:
    """Rows of a record, in the order of ``rows``. For an out-of-range row, the result is some valid row."""
    selected: Record = jax.tree.map(lambda a: jnp.take(a, rows, axis=0, mode="clip"), record)
    return selected


@partial(jax.jit, static_argnames=("all_placed", "rest_steps"))
def fresh_state(worlds: Worlds, *, all_placed: bool, ends: Int[Array, " world"], rest_steps: int) -> State:
    """The states before the soft start.

    Args:
        all_placed: whether all boxes stand at their release poses from the start (static check).
        ends: the last step of each world if it is known in advance (fixed schedule); else NEVER.
    """
    n, width = worlds.n_boxes.shape[0], worlds.half.shape[1]
    zeros, ints = jnp.zeros((n, width)), jnp.zeros(n, jnp.int32)
    never = jnp.full(n, NEVER, jnp.int32)
    upright = jnp.broadcast_to(jnp.array(IDENTITY_QUAT), (n, 4))
    return State(
        qpos=worlds.start,
        qpos_remainder=jnp.zeros((n, width, 3)),
        qvel=jnp.zeros((n, width, 6)),
        qacc=jnp.zeros((n, width, 6)),
        qacc_warmstart=jnp.zeros((n, width, 6)),
        carrier_qpos=jnp.concatenate([worlds.carrier_pos, upright], axis=-1),
        carrier_qpos_remainder=jnp.zeros((n, 3)),
        carrier_qvel=jnp.zeros((n, 6)),
        carrier_qacc=jnp.zeros((n, 6)),
        carrier_qacc_warmstart=jnp.zeros((n, 6)),
        position=jnp.broadcast_to(jnp.arange(1, width + 1, dtype=jnp.int32), (n, width)),
        carrier_position=ints,
        step=jnp.full(n, SOFT_START_BEGIN, jnp.int32),
        placed=worlds.n_boxes if all_placed else ints,
        last_placed_at=ints,
        carried_from=never,
        lowered_from=never,
        carried_steps=ints,
        way_begin=jnp.zeros((n, 3)),
        way_end=jnp.zeros((n, 3)),
        landing_left=jnp.zeros((n, width), jnp.int32),
        landing_qvel=jnp.zeros((n, width, 6)),
        film_home=jnp.zeros_like(worlds.half),
        film_anchor=jnp.zeros_like(worlds.half),
        waits_since=ints,
        quiet_steps=ints,
        quiet_speed=zeros,
        violent_since=never,
        tremble_looks=ints,
        trembles=jnp.zeros((n, width), jnp.int32),
        tremble_path=zeros,
        tremble_away=zeros,
        tremble_qpos=worlds.start,
        driven_from=never,
        rest_from=jnp.where(ends == NEVER, NEVER, ends - rest_steps),
        end=ends,
        still_qpos=worlds.start,
        status=ints,
        flags=ints,
        steps_done=ints,
        iterations_done=ints,
        metrics=no_metrics(n, width),
        top_force=zeros,
    )
