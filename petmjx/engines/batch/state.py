"""Worlds on the device: what is constant about them, and their states from step to step.

Rows are worlds; box columns are padded to the same number. Axes are named in ``petmjx.engines.batch``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from petmjx.config import SOFT_START_STEPS, Simulation
from petmjx.history import CARRIER
from petmjx.units import seconds_to_steps
from petmjx.world.give import gives, sinks_m
from petmjx.world.job import Job
from petmjx.world.pairs import filled_up
from petmjx.world.placing import course_of, most_aside_m
from petmjx.world.release import NOTHING, release_of
from petmjx.world.scene import IDENTITY_QUAT
from petmjx.world.wrap import film_of

NEVER = np.iinfo(np.int32).max
"""A step that is never reached: an end that is not known yet."""

SOFT_START_BEGIN = -2 * SOFT_START_STEPS
"""Step counter of a fresh world: the soft start's steps come before step 0."""


class Status:
    """Where a world is. Plain integers, because they live in device arrays."""

    RUNNING = 0
    SETTLED = 2
    """Placement is over, and the pallet has come to rest. A drive may follow."""
    FINISHED = 3
    OVERFLOWED = 4
    """On mjx-warp: a buffer is too small for the next step."""
    PAUSED = 5
    """All boxes of an open world are placed and rest, and more may come."""


class Worlds(NamedTuple):
    """Constants of worlds.

    Body 0 is the carrier, and box k is body k + 1. The shapes of body b are from ``first_shape[b]`` on, in the order of
    bodies, and ``shape_body`` says whose each is. ``half`` and ``middle`` are the boxes' half extents and their middles
    in their frames; ``inertia_box`` is as in ``petmjx.world.body.Body``. ``floor_friction`` and ``friction``: sliding,
    torsional and rolling coefficients; ``shape_surface`` and ``pair_friction``: petmjx/world/pairs.py; ``shape_give``,
    m³/N, and ``sinks``, how far boxes are meant to come down: petmjx/world/give.py. ``drive_yaw`` is
    (cos, sin); ``drive_steps`` counts from the drive's first step to the world's end. ``driven``: a drive follows;
    ``held``: it holds the carrier fast. ``settles``: the placement ends in a settled state, for a drive or to keep.
    ``pauses``: when its boxes rest the world waits for more (petmjx/engines/open.py). ``start`` is where a box is
    released if its ``support``, which it follows by ``most_followed``, m, is where the plan has it
    (petmjx/world/release.py). ``appears``: all boxes begin there.
    Else they begin by ``way_offset`` from there, for a way of ``way_steps``, or 0 if they fall; at its end those that
    are not let go to fall are set down (petmjx/world/placing.py). ``hand_force``, N, ``hand_speed``, m/s, and
    ``hand_aside``, m, are what a hand may do; ``wrap_press`` and ``wrap_hold``, N, what film does
    (petmjx/world/wrap.py).
    """

    n_boxes: Int[Array, " world"]
    half: Float[Array, "world box 3"]
    middle: Float[Array, "world box 3"]
    target: Float[Array, "world box 3"]
    start: Float[Array, "world box 7"]
    support: Int[Array, "world box"]
    sinks: Float[Array, "world box"]
    most_followed: Float[Array, " world"]
    carrier_pos: Float[Array, "world 3"]
    mass: Float[Array, "world body"]
    inertia_box: Float[Array, "world body 3"]
    first_shape: Int[Array, "world body_end"]
    shape_body: Int[Array, "world shape"]
    shape_half: Float[Array, "world shape 3"]
    shape_pos: Float[Array, "world shape 3"]
    friction: Float[Array, "world shape 3"]
    floor_friction: Float[Array, "world 3"]
    shape_surface: Int[Array, "world shape"]
    shape_give: Float[Array, "world shape"]
    pair_friction: Float[Array, "world surface surface"]
    floor_z: Float[Array, " world"]
    profile: Int[Array, " world"]
    drive_scale: Float[Array, " world"]
    drive_yaw: Float[Array, "world 2"]
    drive_steps: Int[Array, " world"]
    driven: Bool[Array, " world"]
    held: Bool[Array, " world"]
    settles: Bool[Array, " world"]
    pauses: Bool[Array, " world"]
    appears: Bool[Array, " world"]
    way_offset: Float[Array, "world box 3"]
    way_steps: Int[Array, "world box"]
    falls: Bool[Array, "world box"]
    hand_force: Float[Array, " world"]
    hand_speed: Float[Array, " world"]
    hand_aside: Float[Array, " world"]
    wrap_press: Float[Array, "world box 3"]
    wrap_hold: Float[Array, "world box"]


class Metrics(NamedTuple):
    """Running statistics of boxes; everything over the samples since a box was placed."""

    max_tilt: Float[Array, "world box"]
    max_lin_acc: Float[Array, "world box"]
    max_ang_acc: Float[Array, "world box"]
    max_top_force: Float[Array, "world box"]
    rest_force_sum: Float[Array, "world box"]
    rest_samples: Int[Array, " world"]
    drop_step: Int[Array, "world box"]
    max_sway: Float[Array, "world box"]
    sway_anchor: Float[Array, "world box 2"]
    culprit: Int[Array, " world"]
    sign_step: Int[Array, " world"]
    sign_placed: Int[Array, " world"]


class State(NamedTuple):
    """The state of worlds between two steps. Steps are counted from the end of the soft start."""

    # As MuJoCo's arrays of free bodies, boxes and carrier apart: positions, velocities, the accelerations of the last
    # step, and those from which mjx-warp's solver starts in the next one. Other solvers start from the last step's.
    qpos: Float[Array, "world box 7"]
    qvel: Float[Array, "world box 6"]
    qacc: Float[Array, "world box 6"]
    qacc_warmstart: Float[Array, "world box 6"]
    carrier_qpos: Float[Array, "world 7"]
    carrier_qvel: Float[Array, "world 6"]
    carrier_qacc: Float[Array, "world 6"]
    carrier_qacc_warmstart: Float[Array, "world 6"]

    # Where bodies stand in the system of equations, for a solver that orders them (mjx-warp): a permutation of those
    # that are placed, in which a box that is placed comes last.
    position: Int[Array, "world box"]
    carrier_position: Int[Array, " world"]

    # Placing: the last step taken, how many boxes are placed, and the step after which the last one was.
    step: Int[Array, " world"]
    placed: Int[Array, " world"]
    last_placed_at: Int[Array, " world"]

    # Carrying: the steps after which a hand took up the last of these boxes, and began to set it down, or NEVER; the
    # steps and the ends of its way, where the origin of the box's frame is.
    carried_from: Int[Array, " world"]
    lowered_from: Int[Array, " world"]
    carried_steps: Int[Array, " world"]
    way_begin: Float[Array, "world 3"]
    way_end: Float[Array, "world 3"]

    # Film: where boxes were when it was put around them, and from where it holds them, less the carrier's place.
    film_home: Float[Array, "world box 3"]
    film_anchor: Float[Array, "world box 3"]

    # For the rules: the step after which the wait for the next event began, steps for which all boxes have been quiet,
    # their speed at the first of these, and the first of consecutive violent samples.
    waits_since: Int[Array, " world"]
    quiet_steps: Int[Array, " world"]
    quiet_speed: Float[Array, "world box"]
    violent_since: Int[Array, " world"]

    # What follows, as steps or NEVER: when the drive starts, the rest window starts, and the world ends. And the poses
    # shortly before the end, from which on boxes must be still.
    driven_from: Int[Array, " world"]
    rest_from: Int[Array, " world"]
    end: Int[Array, " world"]
    still_qpos: Float[Array, "world box 7"]
    status: Int[Array, " world"]

    # For the outcome: bits of Flag, steps simulated in this run of jobs, and what was measured.
    flags: Int[Array, " world"]
    steps_done: Int[Array, " world"]
    metrics: Metrics

    # Force on each box's top in the step after which the world paused, N.
    top_force: Float[Array, "world box"]

    @property
    def running(self) -> Bool[Array, " world"]:
        return self.status == Status.RUNNING


Record = TypeVar("Record", Worlds, Metrics, State)


def per_box(record: type[Any]) -> tuple[str, ...]:
    """Names of a record's fields whose second axis is ``box``, from their annotations."""
    shapes = {name: getattr(kind, "dim_str", "") for name, kind in get_type_hints(record).items()}
    return tuple(name for name, shape in shapes.items() if shape.split()[1:2] == ["box"])


def narrow(state: State, capacity: int) -> State:
    """States with columns for the first ``capacity`` boxes."""

    def cut(record: State | Metrics) -> dict[str, Any]:
        return {name: getattr(record, name)[:, :capacity] for name in per_box(type(record))}

    return state._replace(**cut(state), metrics=state.metrics._replace(**cut(state.metrics)))


def put_rows(table: Record, rows: Int[Array, " row"], values: Record) -> Record:
    """Write records into rows of a table. Rows beyond its end are dropped."""
    written: Record = jax.tree.map(lambda old, new: old.at[rows].set(new, mode="drop"), table, values)
    return written


def take_rows(record: Record, rows: Int[Array, " row"]) -> Record:
    """Rows of a record, in order; out-of-range rows give some valid row."""
    taken: Record = jax.tree.map(lambda a: jnp.take(a, rows, axis=0, mode="clip"), record)
    return taken


def uploaded(values: NDArray[Any]) -> jax.Array:
    """An array on the device. On a CPU it may share the memory of ``values``, which must not change any more.

    ``jnp.asarray`` would compile a program for each shape.
    """
    array: jax.Array = jax.device_put(values)
    return array


def upload_worlds(
    jobs: Sequence[Job], rows: int, width: int, profiles: dict[int, int], sim: Simulation, boards: int = 1
) -> Worlds:
    """Constants of a group of jobs as device arrays. Everything is made on the host: on a device each operation of each
    shape would first have to be compiled.

    Args:
        rows: at least one a job; those beyond repeat the first job's scene and are never run.
        width: box columns.
        profiles: ``id`` of an excitation → its row in the profile table.
        boards: shapes for which carriers have room; more where a scene's has more.
    """
    scenes = list({id(job.scene): job.scene for job in jobs}.values())
    row_of = {id(scene): row for row, scene in enumerate(scenes)}
    n, boards = len(scenes), max(boards, *(len(scene.shapes.body) - scene.n_boxes for scene in scenes))
    half, middle = np.full((n, width, 3), 0.1, np.float32), np.zeros((n, width, 3), np.float32)
    target, start = np.zeros((n, width, 3), np.float32), np.zeros((n, width, 7), np.float32)
    start[:, :, 3:] = IDENTITY_QUAT
    support, sinks = np.full((n, width), NOTHING, np.int32), np.zeros((n, width), np.float32)
    most_followed = np.zeros(n, np.float32)
    way_offset, way_steps = np.zeros((n, width, 3), np.float32), np.zeros((n, width), np.int32)
    falls, appears = np.zeros((n, width), np.bool_), np.ones(n, np.bool_)
    wrap_press, wrap_hold = np.zeros((n, width, 3), np.float32), np.zeros((n, width), np.float32)
    mass, inertia_box = np.ones((n, width + 1), np.float32), np.full((n, width + 1, 3), 0.1, np.float32)
    first_shape = np.tile(np.arange(width + 2, dtype=np.int32), (n, 1))
    shape_body, shape_surface = (np.zeros((n, boards + width), np.int32) for _ in range(2))
    shape_give = np.zeros((n, boards + width), np.float32)
    shape_half, shape_pos, friction = (np.full((n, boards + width, 3), fill, np.float32) for fill in (0.1, 0.0, 1.0))
    for row, scene in enumerate(scenes):
        k, release, shapes = scene.n_boxes, release_of(scene, sim), scene.shapes
        half[row, :k], middle[row, :k], target[row, :k] = scene.half_size, scene.middle, scene.target
        place, quat, course = release.pos, scene.start_quat, course_of(scene, sim)
        if course is not None:
            place, quat, appears[row] = place + course.lift, course.quat, False
            way_offset[row, :k], way_steps[row, :k], falls[row, :k] = course.offset, course.steps, course.falls
        start[row, :k, :3], start[row, :k, 3:] = scene.frames(place, quat), quat
        if scene.wrap.holds:
            wrap_press[row, :k], wrap_hold[row, :k] = film_of(scene)
        support[row, :k], most_followed[row] = release.support, release.most_followed_m
        mass[row, : k + 1] = np.append(scene.carrier.mass, scene.mass)
        inertia_box[row, : k + 1] = scene.inertia_boxes
        s = len(shapes.body)
        more_shapes = np.bincount(shapes.body - CARRIER, minlength=width + 1) - 1
        first_shape[row, 1 : k + 2] += np.cumsum(more_shapes[: k + 1])
        first_shape[row, k + 2 :] += more_shapes[: k + 1].sum()
        shape_body[row, :s], shape_half[row, :s] = shapes.body - CARRIER, shapes.half_size
        shape_pos[row, :s], friction[row, :s] = shapes.pos, shapes.friction
        shape_surface[row, :s] = shapes.surface
        if scene.stiffness is not None:
            sinks[row, :k] = sinks_m(scene, sim.physics.gravity_m_s2)
            shape_give[row, :s] = np.append(gives(scene.stiffness, scene.half_size), 0.0)[shapes.body]
    spare = rows - len(jobs)
    fan_out = np.array([row_of[id(job.scene)] for job in jobs] + [0] * spare)

    def spread(values: Any, dtype: Any = np.float32) -> jax.Array:
        return uploaded(np.asarray(values, dtype)[fan_out])

    def each(value: Callable[[Job], Any], dtype: Any) -> jax.Array:
        values = np.array([value(job) for job in jobs], dtype)
        return uploaded(np.concatenate([values, np.repeat(values[:1], spare, axis=0)]))

    def drive_steps(job: Job) -> int:
        if job.drive is None:
            return 0
        return len(job.drive.excitation.samples) + seconds_to_steps(job.drive.rest_s, sim.physics.timestep_s)

    return Worlds(
        n_boxes=spread([scene.n_boxes for scene in scenes], np.int32),
        half=spread(half),
        middle=spread(middle),
        target=spread(target),
        start=spread(start),
        support=spread(support, np.int32),
        sinks=spread(sinks),
        most_followed=spread(most_followed),
        carrier_pos=spread([scene.carrier.pos for scene in scenes]),
        mass=spread(mass),
        inertia_box=spread(inertia_box),
        first_shape=spread(first_shape, np.int32),
        shape_body=spread(shape_body, np.int32),
        shape_half=spread(shape_half),
        shape_pos=spread(shape_pos),
        friction=spread(friction),
        floor_friction=spread([scene.floor_friction for scene in scenes]),
        shape_surface=spread(shape_surface, np.int32),
        shape_give=spread(shape_give),
        pair_friction=spread([filled_up(scene.pair_friction) for scene in scenes]),
        floor_z=spread([scene.floor_z for scene in scenes]),
        profile=each(lambda job: profiles[id(job.drive.excitation)] if job.drive else 0, np.int32),
        drive_scale=each(_drive_factor, np.float32),
        drive_yaw=each(lambda job: _direction(job), np.float32),
        drive_steps=each(drive_steps, np.int32),
        driven=each(lambda job: job.drive is not None, np.bool_),
        held=each(lambda job: job.drive is not None and job.drive.excitation.kind == "acceleration", np.bool_),
        settles=each(lambda job: job.drive is not None or job.keep_state, np.bool_),
        pauses=uploaded(np.zeros(rows, np.bool_)),
        appears=spread(appears, np.bool_),
        way_offset=spread(way_offset),
        way_steps=spread(way_steps, np.int32),
        falls=spread(falls, np.bool_),
        hand_force=spread([scene.placing.force_n for scene in scenes]),
        hand_speed=spread([scene.placing.speed_m_s for scene in scenes]),
        hand_aside=spread([most_aside_m(scene.placing) for scene in scenes]),
        wrap_press=spread(wrap_press),
        wrap_hold=spread(wrap_hold),
    )


def _direction(job: Job) -> tuple[float, float]:
    yaw = job.drive.yaw_rad if job.drive else 0.0
    return math.cos(yaw), math.sin(yaw)


def _drive_factor(job: Job) -> float:
    """What a profile's samples are multiplied by."""
    return job.drive.scale * job.drive.unit(job.scene.total_mass) if job.drive is not None else 0.0


@partial(jax.jit, static_argnames=("all_placed", "rest_steps"))
def fresh_state(worlds: Worlds, *, all_placed: bool, ends: Int[Array, " world"], rest_steps: int) -> State:
    """States before the soft start.

    Args:
        all_placed: static check; every box stands at its release pose from the start.
        ends: the last step, where it is known in advance (fixed schedule); else NEVER.
    """
    n, width = worlds.n_boxes.shape[0], worlds.half.shape[1]
    zeros, ints = jnp.zeros((n, width)), jnp.zeros(n, jnp.int32)
    never = jnp.full(n, NEVER, jnp.int32)
    upright = jnp.broadcast_to(jnp.array(IDENTITY_QUAT), (n, 4))
    metrics = Metrics(
        max_tilt=zeros,
        max_lin_acc=zeros,
        max_ang_acc=zeros,
        max_top_force=zeros,
        rest_force_sum=zeros,
        rest_samples=ints,
        drop_step=jnp.full((n, width), -1, jnp.int32),
        max_sway=zeros,
        sway_anchor=jnp.zeros((n, width, 2)),
        culprit=jnp.full(n, -1, jnp.int32),
        sign_step=jnp.full(n, -1, jnp.int32),
        sign_placed=ints,
    )
    return State(
        qpos=worlds.start,
        qvel=jnp.zeros((n, width, 6)),
        qacc=jnp.zeros((n, width, 6)),
        qacc_warmstart=jnp.zeros((n, width, 6)),
        carrier_qpos=jnp.concatenate([worlds.carrier_pos, upright], axis=-1),
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
        film_home=jnp.zeros_like(worlds.half),
        film_anchor=jnp.zeros_like(worlds.half),
        waits_since=ints,
        quiet_steps=ints,
        quiet_speed=zeros,
        violent_since=never,
        driven_from=never,
        rest_from=jnp.where(ends == NEVER, NEVER, ends - rest_steps),
        end=ends,
        still_qpos=worlds.start,
        status=ints,
        flags=ints,
        steps_done=ints,
        metrics=metrics,
        top_force=zeros,
    )
