"""The data that the GPU engine's kernel works on, as records: constants, worlds, their state, workspace, and results.

Each array is declared only here, with its element type and its axes. The kernel and its C++ take whole records. JAX
passes the arrays of ``Tables`` and ``State``: they are the tables of petmjx/engines/batch/state.py, field by field, and
the kernel changes ``State`` in place. The workspace is one buffer, divided by the shapes given here.

Axes. ``world``: a row of the tables. ``lane``: a thread block, which has one world at a time. ``queue``: of worlds for
lanes of one size. ``body``: the carrier, then the boxes in packing order; ``block``: a body that moves; ``dof``: one of
its six rows. ``geom``: the floor, then the shapes of the bodies. ``pair``: two geoms that are near one another;
``slot``: a contact. Units are SI.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args

import warp as wp

PANEL = 16
"""Rows of a panel of the Cholesky factorisation. The Hessian is padded to a multiple."""

MAX_BOXES = 512
"""Boxes of the largest world. Shared memory limits it: it holds the solver's right-hand side."""

ROW_WORDS = 32
"""Numbers of a contact: frame (9), moment arms of both bodies (9 + 9), reference accelerations (3), stiffness of a row
(1), friction (1)."""

BUFFER_WORDS = 1024
"""Numbers in a row of the buffer that holds workspaces."""


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
    """Constants of a run: contacts and solver, then the numbers of the rules (docs/rules.md)."""

    timestep: float
    gravity: float
    solref: wp.vec2
    low_impedance: float
    high_impedance: float
    impedance_width: float
    skin: float  # by how much boxes are larger for the collider, m
    carrier_skin: float  # the same of the carrier
    pyramidal: int  # 1 with pyramidal friction cones
    friction_damping: float  # of a contact's tangents, 1/s; 0: as much as of its normal
    slack: wp.float64  # 1 / √impratio
    tolerance: wp.float64  # of the solver, as MuJoCo's
    limit: int  # most iterations of the solver
    driven_limit: int  # the same in a drive
    trials: int  # most iterations of its line search

    queue: int  # from which these lanes take worlds
    pairs: int  # most pairs of near geoms of a world
    room: int  # most contacts of a world

    fixed: int  # 1 with the fixed schedule
    waits_for_rest: int
    extends: int  # 1 if a world that moves at its end is waited for
    early_stop: int
    soft_start: int  # steps
    sample_every: int
    rest_steps: int
    still_steps: int
    due_steps: int
    longest_steps: int
    static_end: int  # last step of the placement of a static check; NEVER with boxes one by one
    shift: float
    shift_floor: float
    tilt: float  # degrees
    drop_z: float
    linear_acceleration: float
    angular_acceleration: float
    quiet_speed: float
    slow_speed: float
    slowing: float
    still_speed: float
    most_followed: float  # how far a box follows its support
    quiet_steps: int
    min_steps: int
    poll_steps: int

    due: wp.array[int]  # by step; as in Timetable
    longest: wp.array[int]
    settled: wp.array[int]
    settled_nominally: wp.array[int]  # by number of boxes


@record
class Tables:
    """Constants of worlds: fields of ``batch.state.Worlds``. And ``profiles``, whose rows are excitations."""

    n_boxes: Annotated[wp.array[int], "world"]
    half: Annotated[wp.array3d[float], "world box 3"]
    middle: Annotated[wp.array3d[float], "world box 3"]
    target: Annotated[wp.array3d[float], "world box 3"]
    start: Annotated[wp.array3d[float], "world box 7"]
    support: Annotated[wp.array2d[int], "world box"]
    carrier_pos: Annotated[wp.array2d[float], "world 3"]
    mass: Annotated[wp.array2d[float], "world body"]
    inertia_box: Annotated[wp.array3d[float], "world body 3"]
    first_shape: Annotated[wp.array2d[int], "world body_end"]
    shape_body: Annotated[wp.array2d[int], "world shape"]
    shape_half: Annotated[wp.array3d[float], "world shape 3"]
    shape_pos: Annotated[wp.array3d[float], "world shape 3"]
    friction: Annotated[wp.array3d[float], "world shape 3"]
    floor_friction: Annotated[wp.array2d[float], "world 3"]
    shape_surface: Annotated[wp.array2d[int], "world shape"]
    pair_friction: Annotated[wp.array3d[float], "world surface surface"]
    floor_z: Annotated[wp.array[float], "world"]
    profile: Annotated[wp.array[int], "world"]
    drive_scale: Annotated[wp.array[float], "world"]
    drive_yaw: Annotated[wp.array2d[float], "world 2"]
    drive_steps: Annotated[wp.array[int], "world"]
    held: Annotated[wp.array[wp.bool], "world"]
    settles: Annotated[wp.array[wp.bool], "world"]
    pauses: Annotated[wp.array[wp.bool], "world"]
    profiles: Annotated[wp.array3d[float], "profile step 3"]
    order: Annotated[wp.array2d[int], "queue world"]  # in which worlds take lanes; behind them negative numbers


@record
class State:
    """The state of worlds: fields of ``batch.state.State`` and its metrics."""

    pose: Annotated[wp.array3d[float], "world box 7"]
    vel: Annotated[wp.array3d[float], "world box 6"]
    warm: Annotated[wp.array3d[float], "world box 6"]
    ahead: Annotated[wp.array3d[float], "world box 6"]
    carrier_pose: Annotated[wp.array2d[float], "world 7"]
    carrier_vel: Annotated[wp.array2d[float], "world 6"]
    carrier_warm: Annotated[wp.array2d[float], "world 6"]
    carrier_ahead: Annotated[wp.array2d[float], "world 6"]
    position: Annotated[wp.array2d[int], "world box"]
    carrier_position: Annotated[wp.array[int], "world"]
    step: Annotated[wp.array[int], "world"]
    placed: Annotated[wp.array[int], "world"]
    last_placed_at: Annotated[wp.array[int], "world"]
    waits_since: Annotated[wp.array[int], "world"]
    quiet_steps: Annotated[wp.array[int], "world"]
    quiet_speed: Annotated[wp.array2d[float], "world box"]
    violent_since: Annotated[wp.array[int], "world"]
    driven_from: Annotated[wp.array[int], "world"]
    rest_from: Annotated[wp.array[int], "world"]
    end: Annotated[wp.array[int], "world"]
    still_pose: Annotated[wp.array3d[float], "world box 7"]
    status: Annotated[wp.array[int], "world"]
    flags: Annotated[wp.array[int], "world"]
    steps_done: Annotated[wp.array[int], "world"]
    top_force: Annotated[wp.array2d[float], "world box"]
    max_tilt: Annotated[wp.array2d[float], "world box"]
    max_lin_acc: Annotated[wp.array2d[float], "world box"]
    max_ang_acc: Annotated[wp.array2d[float], "world box"]
    max_top_force: Annotated[wp.array2d[float], "world box"]
    rest_force_sum: Annotated[wp.array2d[float], "world box"]
    rest_samples: Annotated[wp.array[int], "world"]
    drop_step: Annotated[wp.array2d[int], "world box"]
    max_sway: Annotated[wp.array2d[float], "world box"]
    sway_anchor: Annotated[wp.array3d[float], "world box 2"]
    culprit: Annotated[wp.array[int], "world"]
    sign_step: Annotated[wp.array[int], "world"]
    sign_placed: Annotated[wp.array[int], "world"]


@record
class Workspace:
    """Arrays of a lane, used within a step. Each array begins at a multiple of 16 bytes."""

    acceleration: Annotated[wp.array2d[wp.float64], "lane dof"]
    direction: Annotated[wp.array2d[wp.float64], "lane dof"]
    gradient: Annotated[wp.array2d[wp.float64], "lane dof"]
    residual: Annotated[wp.array3d[wp.float64], "lane slot 3"]  # J·a − r
    slope: Annotated[wp.array3d[wp.float64], "lane slot 3"]  # J·direction
    force: Annotated[wp.array3d[wp.float64], "lane slot 3"]  # of a contact, in its frame
    worst: Annotated[wp.array[wp.int64], "lane"]  # the largest excess and its box
    hessian: Annotated[wp.array2d[float], "lane entry"]  # its envelope, if shared memory has no room for it
    strip: Annotated[wp.array2d[float], "lane part"]  # rows of its factor, if shared memory has no room for them
    rows: Annotated[wp.array3d[float], "lane slot row_word"]
    curvature: Annotated[wp.array3d[float], "lane slot 6"]
    inertia: Annotated[wp.array2d[float], "lane dof"]  # diagonal of the inertia matrix
    smooth: Annotated[wp.array2d[float], "lane dof"]  # accelerations without contacts
    drag: Annotated[wp.array3d[float], "lane slot 2"]  # of a contact: contact.cuh
    place: Annotated[wp.array2d[wp.vec3], "lane geom"]  # centres
    turn: Annotated[wp.array2d[wp.mat33], "lane geom"]
    reach: Annotated[wp.array2d[wp.vec3], "lane geom"]  # half extents of the box around a geom, along x, y, z
    home: Annotated[wp.array2d[wp.vec3], "lane geom"]  # place and reach when pairs were listed
    home_reach: Annotated[wp.array2d[wp.vec3], "lane geom"]
    seen: Annotated[wp.array3d[float], "lane box 7"]  # poses at the beginning of a step
    top_force: Annotated[wp.array2d[float], "lane box"]
    first: Annotated[wp.array2d[int], "lane pair"]  # the lower geom of a pair
    second: Annotated[wp.array2d[int], "lane pair"]
    normal: Annotated[wp.array2d[wp.vec3], "lane pair"]
    points: Annotated[wp.array3d[wp.vec4], "lane pair 8"]  # where a pair touches, and its distance there
    pair_of: Annotated[wp.array2d[int], "lane geom_end"]  # the first pair of each lower geom
    lower: Annotated[wp.array2d[int], "lane pair"]  # the pairs of each higher geom
    lower_of: Annotated[wp.array2d[int], "lane geom_end"]  # where they begin
    touching: Annotated[wp.array2d[int], "lane pair"]  # contacts of each pair
    contact_of: Annotated[wp.array2d[int], "lane pair_end"]  # the first contact of each pair
    pair_at: Annotated[wp.array2d[int], "lane slot"]  # of a contact
    blocks: Annotated[wp.array3d[int], "lane slot 2"]  # of a contact, lower first; negative: does not move
    links: Annotated[wp.array2d[int], "lane link"]  # 2 × slot + side, block after block
    link_begin: Annotated[wp.array2d[int], "lane block_end"]
    level: Annotated[wp.array2d[int], "lane block"]  # of the carrier and the boxes, when blocks are put in order
    position: Annotated[wp.array2d[int], "lane block"]  # of a block in the solver's system
    lowest: Annotated[wp.array2d[int], "lane block"]  # by position: the lowest that its block touches, or its own
    pair_begin: Annotated[wp.array2d[int], "lane slot"]  # first contact of each pair of blocks, in no order
    contacts: Annotated[wp.array[int], "lane"]
    n_blocks: Annotated[wp.array[int], "lane"]
    iterations: Annotated[wp.array[int], "lane"]  # of the solver
    world: Annotated[wp.array[int], "lane"]  # which a lane has; negative: none
    frame: Annotated[wp.array[int], "lane"]  # which a lane writes


@record
class Frames:
    """Frames of recorded worlds, in the order in which lanes write them; all worlds of a call share the room."""

    every: Annotated[wp.array[int], "world"]  # steps between two frames of a world; 0: it is not recorded
    used: Annotated[wp.array[int], "1"]
    of: Annotated[wp.array[int], "frame"]  # the world of a frame
    step: Annotated[wp.array[int], "frame"]
    placed: Annotated[wp.array[int], "frame"]
    pose: Annotated[wp.array3d[float], "frame box 7"]
    top_force: Annotated[wp.array2d[float], "frame box"]
    carrier_pose: Annotated[wp.array2d[float], "frame 7"]


@record
class Counts:
    """What a call counts."""

    taken: Annotated[wp.array[int], "queue"]  # worlds that lanes have taken, so far
    clock: Annotated[wp.array[int], "1"]  # when it began: block.cuh
    steps: Annotated[wp.array[int], "1"]
    iterations: Annotated[wp.array[int], "1"]
    contacts: Annotated[wp.array[int], "1"]  # most of a world


@record
class Lane:
    """A thread of a lane, and its lane's world."""

    lane: int
    thread: int
    threads: int
    world: int
    placed: int  # boxes that stand
    geoms: int  # the floor and the shapes of the carrier and of these boxes
    held: int  # 1 if the carrier is held fast: its body is then no block


def most_panels(n_boxes: int) -> int:
    """Panels of the system of a world with so many boxes and a carrier that moves."""
    return -(-6 * (n_boxes + 1) // PANEL)


def axes(lanes: int, n_boxes: int, boards: int, pairs: int, room: int) -> dict[str, int]:
    """Sizes of the axes of a lane.

    Args:
        n_boxes: most boxes of a world.
        boards: most shapes of a carrier.
        pairs: most pairs of near geoms of a world.
        room: most contacts of a world.
    """
    n_blocks = n_boxes + 1
    panels = most_panels(n_boxes)
    return {
        "lane": lanes,
        "box": n_boxes,
        "geom": n_boxes + boards + 1,
        "geom_end": n_boxes + boards + 2,
        "block": n_blocks,
        "block_end": n_blocks + 1,
        "dof": 6 * n_blocks,
        "entry": panels * (panels + 1) // 2 * PANEL**2,
        "part": panels * 2 * PANEL**2,
        "pair": pairs,
        "pair_end": pairs + 1,
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
        yield name, types[name].dtype, shape, words + -words % 4


def buffer_rows(sizes: Mapping[str, int]) -> int:
    """Rows of ``BUFFER_WORDS`` that hold the workspace of some lanes; in them lane lies after lane within each array.

    Args:
        sizes: axis → size.
    """
    return -(-sum(words for *_, words in _parts(sizes)) // BUFFER_WORDS)


def in_buffer(buffer: Any, sizes: Mapping[str, int], first_row: int = 0) -> dict[str, Any]:
    """The workspace's arrays, as views of a buffer of 32-bit words (row, ``BUFFER_WORDS``) from this row on."""
    views: dict[str, Any] = {}
    pointer = buffer.ptr + 4 * BUFFER_WORDS * first_row
    for name, dtype, shape, words in _parts(sizes):
        views[name] = wp.array(ptr=pointer, dtype=dtype, shape=shape, device=buffer.device)
        pointer += 4 * words
    return views


def lane_bytes(n_boxes: int, boards: int, pairs: int, room: int) -> int:
    """Device memory of a lane, bytes."""
    return 4 * sum(words for *_, words in _parts(axes(1, n_boxes, boards, pairs, room)))
