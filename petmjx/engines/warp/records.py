"""The data that the step's kernels share, as records: model, state, workspace, output, and collisions.

Each array is declared only here, with its element type and its axes. Kernels and C++ take whole records. JAX passes the
arrays of ``State``, ``Model`` and ``Out``, in this order. The workspace is one buffer, divided by these shapes.

Axes. ``world``: a lane. ``block``: a body that moves; ``dof``: one of its six rows; ``pose``: one of its seven
coordinates. ``slot``: a contact of one lane; ``contact``: a contact of the pool that all lanes share. ``body`` and
``geom``: as in MuJoCo. ``box``: in packing order. Units are SI.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args

import warp as wp
from mujoco.mjx.third_party.mujoco_warp._src.types import vec5

from petmjx.engines.batch.capacities import round_up

PANEL = 16
"""Rows of a panel of the Cholesky factorisation. The Hessian is padded to a multiple."""

MAX_PANELS = 104
"""Panels of the largest system, limited by shared memory, which holds the right-hand side."""

ROW_WORDS = 32
"""Numbers of a contact: frame (9), moment arms of both bodies (9 + 9), reference accelerations (3), stiffness of a row
(1), friction (1)."""


def record(cls: type) -> Any:
    """A Warp struct whose arrays name their axes: ``Annotated[type, "axis axis"]``. An axis is a name or a number."""
    shapes = {}
    for name, kind in inspect.get_annotations(cls, eval_str=True).items():
        if hasattr(kind, "__metadata__"):
            cls.__annotations__[name], axes = get_args(kind)
            shapes[name] = tuple(int(axis) if axis.isdigit() else axis for axis in axes.split())
    made: Any = wp.struct(cls)
    made.shapes = shapes
    return made


@record
class Model:
    """Constants of a step: numbers of the template, then arrays that differ between worlds, named as MJX's fields."""

    held: int  # 1 if the carrier is clamped: its body is then no block
    pyramidal: int  # 1 with pyramidal friction cones
    timestep: float
    floor_z: float
    n_geoms: int
    pool: int  # most contacts of all worlds together
    room: int  # most contacts of one world
    limit: int  # most iterations of the solver
    trials: int  # most iterations of its line search
    tolerance: wp.float64  # of the solver, as MuJoCo's
    slack: wp.float64  # 1 / √impratio
    friction_damping: float  # of a contact's tangents, 1/s; 0: as much as of its normal

    body_mass: Annotated[wp.array2d[float], "world body"]
    body_inertia: Annotated[wp.array3d[float], "world body 3"]
    body_invweight0: Annotated[wp.array3d[float], "world body 2"]
    geom_size: Annotated[wp.array2d[wp.vec3], "world geom"]
    geom_rbound: Annotated[wp.array2d[float], "world geom"]
    geom_aabb: Annotated[wp.array3d[wp.vec3], "world geom 2"]
    geom_friction: Annotated[wp.array2d[wp.vec3], "world geom"]


@record
class State:
    """The state before a step."""

    qpos: Annotated[wp.array2d[float], "world pose"]
    qvel: Annotated[wp.array2d[float], "world dof"]
    warmstart: Annotated[wp.array2d[float], "world dof"]  # accelerations with which the solver starts
    carrier_force: Annotated[wp.array2d[float], "world 3"]
    gravity: Annotated[wp.array2d[float], "world 3"]
    carrier_pose: Annotated[wp.array2d[float], "world 7"]  # used if the carrier is held


@record
class Workspace:
    """Arrays that are used within one step. Elements of eight bytes come first, so that every array is aligned."""

    acceleration: Annotated[wp.array2d[wp.float64], "world dof"]
    direction: Annotated[wp.array2d[wp.float64], "world dof"]
    gradient: Annotated[wp.array2d[wp.float64], "world dof"]
    residual: Annotated[wp.array3d[wp.float64], "world slot 3"]  # J·a − r
    slope: Annotated[wp.array3d[wp.float64], "world slot 3"]  # J·direction
    force: Annotated[wp.array3d[wp.float64], "world slot 3"]  # of a contact, in its frame
    contact_key: Annotated[wp.array2d[wp.int64], "world slot"]
    hessian: Annotated[wp.array3d[float], "world padded_dof padded_dof"]
    rows: Annotated[wp.array3d[float], "world slot row_word"]
    curvature: Annotated[wp.array3d[float], "world slot 6"]
    inertia: Annotated[wp.array2d[float], "world dof"]  # diagonal of the inertia matrix
    smooth: Annotated[wp.array2d[float], "world dof"]  # accelerations without contacts
    blocks: Annotated[wp.array3d[int], "world slot 2"]  # of a contact, lower first; negative: does not move
    links: Annotated[wp.array2d[int], "world link"]  # 2 × slot + side, block after block
    link_begin: Annotated[wp.array2d[int], "world block_end"]
    lowest: Annotated[wp.array2d[int], "world block"]  # the lowest block that a block touches, or itself
    pair_begin: Annotated[wp.array2d[int], "world slot"]  # first contact of each pair of blocks, in no order
    n_blocks: Annotated[wp.array[int], "world"]  # up to the highest block with a contact


@record
class Out:
    """The results of a step."""

    next_qpos: Annotated[wp.array2d[float], "world pose"]
    next_qvel: Annotated[wp.array2d[float], "world dof"]
    qacc: Annotated[wp.array2d[float], "world dof"]
    top_force: Annotated[wp.array2d[float], "world box"]
    overflow: Annotated[wp.array[int], "world"]  # flag bits
    contacts: Annotated[wp.array[int], "world"]  # number found, which may be more than fit
    iterations: Annotated[wp.array[int], "world"]  # of the solver


@record
class Collisions:
    """Arrays of mujoco_warp's collision pipeline: poses of geoms (input) and the pool of contacts (output)."""

    geom_xpos: Annotated[wp.array2d[wp.vec3], "world geom"]
    geom_xmat: Annotated[wp.array2d[wp.mat33], "world geom"]
    nacon: Annotated[wp.array[int], "1"]  # number of contacts
    ncollision: Annotated[wp.array[int], "1"]  # number of pairs of geoms that were checked
    worldid: Annotated[wp.array[int], "contact"]
    geom: Annotated[wp.array[wp.vec2i], "contact"]
    dist: Annotated[wp.array[float], "contact"]
    pos: Annotated[wp.array[wp.vec3], "contact"]
    frame: Annotated[wp.array[wp.mat33], "contact"]
    friction: Annotated[wp.array[vec5], "contact"]
    solref: Annotated[wp.array[wp.vec2], "contact"]
    solimp: Annotated[wp.array[vec5], "contact"]


def axes(lanes: int, n_blocks: int, room: int, n_boxes: int) -> dict[str, int]:
    """Sizes of the step's axes.

    Args:
        n_blocks: bodies of a lane that move.
        room: most contacts of a lane.
    """
    return {
        "world": lanes,
        "block": n_blocks,
        "block_end": n_blocks + 1,
        "box": n_boxes,
        "pose": 7 * n_blocks,
        "dof": 6 * n_blocks,
        "padded_dof": round_up(6 * n_blocks, PANEL),
        "slot": room,
        "link": 2 * room,
        "row_word": ROW_WORDS,
    }


def array_types(kind: Any) -> dict[str, Any]:
    """Name → type of a record's arrays, in order."""
    return {name: kind.vars[name].type for name in kind.shapes}


def array_shapes(kind: Any, sizes: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Name → shape of a record's arrays, for axes of these sizes."""
    return {
        name: tuple(axis if isinstance(axis, int) else sizes[axis] for axis in shape)
        for name, shape in kind.shapes.items()
    }


def filled(kind: Any, values: Mapping[str, Any]) -> Any:
    """A record with its fields from ``values``, which may have more entries."""
    instance = kind()
    for name in kind.vars:
        setattr(instance, name, values[name])
    return instance


def _parts(sizes: Mapping[str, int]) -> Iterator[tuple[str, Any, tuple[int, ...], int]]:
    """Name, element type, shape and 32-bit words of the workspace's arrays, in the order of its buffer."""
    types = array_types(Workspace)
    for name, shape in array_shapes(Workspace, sizes).items():
        words = wp.types.type_size_in_bytes(types[name].dtype) // 4 * math.prod(shape)
        yield name, types[name].dtype, shape, words + words % 2


def buffer_shape(sizes: Mapping[str, int]) -> tuple[int, int]:
    """(world, word) of the buffer that holds the workspace; in it lane lies after lane within each array.

    Args:
        sizes: axis → size.
    """
    return sizes["world"], -(-sum(words for *_, words in _parts(sizes)) // sizes["world"])


def in_buffer(buffer: Any, sizes: Mapping[str, int]) -> dict[str, Any]:
    """The workspace's arrays, as views of its buffer."""
    views: dict[str, Any] = {}
    pointer = buffer.ptr
    for name, dtype, shape, words in _parts(sizes):
        views[name] = wp.array(ptr=pointer, dtype=dtype, shape=shape, device=buffer.device)
        pointer += 4 * words
    return views


def lane_bytes(n_blocks: int, room: int) -> int:
    """Device memory of a lane, bytes. Nearly all of it is the workspace."""
    return 4 * buffer_shape(axes(1, n_blocks, room, 0))[1]
