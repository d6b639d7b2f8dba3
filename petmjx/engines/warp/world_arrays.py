"""The data of mjx-warp's kernels as records: constants, worlds, states, workspace, and results.

The kernels and their C++ functions take whole records. Each array is declared once, with its element type and axes.
``Worlds`` and ``State`` have the fields of the tables in petmjx/engines/mjx/world_constants.py, world_state.py and
running_metrics.py. JAX passes these arrays, and the kernels change ``State`` in place. All other arrays are declared in
this file. The workspace is one buffer, which is divided into arrays of the shapes that are declared here.

Axes. ``world``: row of a table of worlds. ``block``: lane, which steps one world at a time; a lane is a thread block or
one of its warps. ``queue``: queue of worlds of one size. ``body``: the carrier, followed by the boxes in packing order.
``free_body``: body that can move.
``dof``: degree of freedom; each free body has six. ``geom``: the floor, followed by the shapes of the bodies. ``pair``:
two geoms that are near each other. ``contact``: point in which the geoms of a pair touch. Units are SI.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args, get_type_hints

import warp as wp
from jaxtyping import Bool, Float, Int

from petmjx.engines.mjx import running_metrics, scene_rows, world_constants, world_state
from petmjx.options.materials import PAIR_TABLES
from petmjx.options.thresholds import Thresholds

PANEL = 16
"""Number of rows of a panel in the Cholesky factorisation. The Hessian is padded to a multiple of this number."""

EFC_WORDS = 32
"""Number of values stored per contact: contact frame (9), moment arms of both bodies (9 + 9), reference accelerations
(aref, 3), stiffness of a constraint row (D, 1), friction (1)."""

BUFFER_WORDS = 1024
"""Number of 32-bit words in a row of the buffer that holds workspaces."""

if TYPE_CHECKING:
    _Record = TypeVar("_Record")
    Ref = Annotated[_Record, "passed by reference"]
else:
    Ref = wp.ref
    """Type of a record that is passed by reference to a function of a kernel.

    Records have hundreds of fields. If they are passed by value, half of the compile time goes into copies. A function
    that is generic in another argument must still take records by value, since Warp (1.18) cannot match references in
    such a function.
    """

TYPES: Mapping[Any, Any] = {Float: wp.float32, Int: wp.int32, Bool: wp.bool}
"""Element type in JAX's annotations → element type on the device."""

_PAIRS: Mapping[str, tuple[Any, str]] = {
    scene_rows.PAIR + table.name: (wp.float32, " ".join(("world surface surface", *map(str, table.entry))))
    for table in PAIR_TABLES
}
"""Name of the array of each table of ``world_constants.Worlds.pairs`` → element type and axes."""


def record(cls: type, tables: Sequence[type] = (), without: Sequence[str] = ()) -> Any:
    """A Warp struct whose arrays declare their axes: ``Annotated[type, "axis axis"]``. An axis is a name or a number.

    Args:
        tables: records of JAX arrays. The struct also gets the fields of these records, except the fields named in
            ``without``.
    """
    annotations, axes = dict[str, Any](), dict[str, str]()
    for name, kind in inspect.get_annotations(cls, eval_str=True).items():
        if hasattr(kind, "__metadata__"):
            annotations[name], axes[name] = get_args(kind)
        elif kind is Thresholds:
            annotations |= dict.fromkeys(Thresholds.model_fields, float)
        else:
            annotations[name] = kind
    for table in tables:
        for name, kind in get_type_hints(table).items():
            if name in without:
                continue
            # the field ``pairs`` is a dictionary of tables (``PAIR_TABLES``), each of which is an array of the struct
            arrays = _PAIRS if name == "pairs" else {name: (TYPES[kind.dtype], kind.dim_str)}
            for array, (dtype, of) in arrays.items():
                annotations[array] = wp.array(dtype=dtype, ndim=len(of.split()))
                axes[array] = of
    cls.__annotations__ = annotations
    struct: Any = wp.struct(cls)
    struct.shapes = {
        name: tuple(int(axis) if axis.isdigit() else axis for axis in of.split()) for name, of in axes.items()
    }
    return struct


@record
class Model:
    """Constants of a run: first the constants of contacts and the solver, then the constants of the rules
    (docs/rules.md)."""

    timestep: float
    gravity: float
    solref: wp.vec2
    solimp: wp.vec3  # Impedances d₀ and d_width, and the width of the rise, m.
    skin: float  # Margin added to boxes in collision detection, m.
    carrier_skin: float  # Margin added to the carrier in collision detection, m.
    pyramidal: int  # 1 if friction cones are pyramidal.
    friction_damping: float  # Damping along a contact's tangents, 1/s; 0: the same damping as along the normal.
    slip_slack: float  # Slip is corrected only above this tangential acceleration, m/s²; inf: never.
    kinetic_share: float  # Friction of contacts that slide fast, as a share of friction at rest.
    impratio_invsqrt: wp.float64  # 1 / √impratio.
    tolerance: wp.float64  # Tolerance of the solver, as in MuJoCo.
    iterations: int  # Largest number of solver iterations.
    ls_iterations: int  # Largest number of iterations of the solver's line search.

    queue: int  # The queue from which these blocks take worlds.
    most_idle: int  # If more lanes (places for a world) than this number are empty, all lanes stop until the next call.
    most_placed: int  # A world with more placed boxes than this number moves to other blocks in the next call.
    npairmax: int  # Largest number of pairs of near geoms of a world.
    nconmax: int  # Largest number of contacts of a world.

    fixed: int  # 1 if the schedule is fixed (boxes are placed at fixed times).
    waits_for_rest: int
    extends: int  # 1 if a world that still moves at its planned end gets more time.
    early_stop: int
    soft_start: int  # Number of steps of a soft start.
    sample_every: int
    rest_steps: int
    still_steps: int
    due_steps: int
    longest_steps: int
    static_end: int  # Last step of a static check's placement; NEVER if boxes are placed one by one.
    thresholds: Thresholds  # The struct has a number for each threshold, with the threshold's name.
    quiet_speed: float
    slow_speed: float
    slowing: float
    still_speed: float
    tremble_share: float
    tremble_looks: int
    quiet_steps: int
    landing_steps: int
    poll_steps: int
    hand_rate: float  # Natural angular frequency of the hand's spring, 1/s.
    lowering_rate: float  # Damping constant / mass, for the damper by which the hand sets boxes down, 1/s.
    # Largest number of steps for which a hand waits, at the end of the path, until the box has stopped. Also the
    # largest number of steps for which the hand sets the box down.
    stuck_steps: int
    film_rate: float  # Natural angular frequency of a box that film holds, 1/s.
    landing_time: float  # Time in which a landing box is stopped, s.
    landing_lasts: int  # Number of steps for which a box counts as landing after its first touch.
    restitution: float

    # Arrays of step numbers, as in Timetable. The first three have an entry for each step, the last has an entry for
    # each number of boxes.
    due: wp.array[int]
    longest: wp.array[int]
    settled: wp.array[int]
    settled_nominally: wp.array[int]


@partial(record, tables=(world_constants.Worlds,), without=("driven",))
class Worlds:
    """Constants of worlds: the table ``world_constants.Worlds``, the samples of the excitations, and the queues."""

    profiles: Annotated[wp.array3d[float], "profile step 3"]
    # For each queue: the table rows of its worlds, in the order in which blocks take the worlds; then −1.
    order: Annotated[wp.array2d[int], "queue world"]

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


@partial(record, tables=(world_state.State, running_metrics.Metrics), without=("metrics",))
class State:
    """States of worlds: the table ``world_state.State`` and its metrics."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


@record
class Workspace:
    """Arrays that thread blocks use during a step. Each array begins at a multiple of 16 bytes."""

    qacc: Annotated[wp.array2d[wp.float64], "block dof"]
    search: Annotated[wp.array2d[wp.float64], "block dof"]
    grad: Annotated[wp.array2d[wp.float64], "block dof"]
    Jaref: Annotated[wp.array3d[wp.float64], "block contact 3"]  # Residuals J·qacc − aref.
    jv: Annotated[wp.array3d[wp.float64], "block contact 3"]  # Products J·search.
    contact_force: Annotated[wp.array3d[wp.float64], "block contact 3"]  # Force in the contact's frame.
    # The largest excess over thresholds (upper 32 bits), and LAST_BOX − index of the box that has it (lower 32 bits).
    worst: Annotated[wp.array[wp.int64], "block"]
    hessian: Annotated[wp.array2d[float], "block entry"]  # The non-zero part of the Hessian, if not in shared memory.
    strip: Annotated[wp.array2d[float], "block part"]  # Rows of the Hessian's factor, if not in shared memory.
    efc: Annotated[wp.array3d[float], "block contact efc_word"]  # Written by make_constraint; efc.cuh has the layout.
    curvature: Annotated[wp.array3d[float], "block contact 6"]
    qM: Annotated[wp.array2d[float], "block dof"]  # Diagonal of the inertia matrix.
    qacc_smooth: Annotated[wp.array2d[float], "block dof"]  # Accelerations without contacts.
    drag: Annotated[wp.array3d[float], "block contact 2"]  # Friction force / largest friction force (contact.cuh).
    excess: Annotated[wp.array2d[float], "block contact"]  # Slip excess, m/s² (contact_laws.py); negative: no slip.
    geom_xpos: Annotated[wp.array2d[wp.vec3], "block geom"]  # Centres of geoms.
    geom_xmat: Annotated[wp.array2d[wp.mat33], "block geom"]
    geom_reach: Annotated[wp.array2d[wp.vec3], "block geom"]  # Half extents of a geom's bounding box, along x, y, z.
    # The values of geom_xpos and geom_reach at the last search for near pairs.
    listed_xpos: Annotated[wp.array2d[wp.vec3], "block geom"]
    listed_reach: Annotated[wp.array2d[wp.vec3], "block geom"]
    qpos_before: Annotated[wp.array3d[float], "block box 7"]  # Poses of the boxes at the beginning of a step.
    top_force: Annotated[wp.array2d[float], "block box"]
    pair_geom1: Annotated[wp.array2d[int], "block pair"]  # Of the pair's two geoms, the one with the smaller index.
    pair_geom2: Annotated[wp.array2d[int], "block pair"]
    pair_normal: Annotated[wp.array2d[wp.vec3], "block pair"]
    pair_points: Annotated[wp.array3d[wp.vec4], "block pair 8"]  # Contact point, and the two geoms' distance.
    pair_spring: Annotated[wp.array2d[float], "block pair"]  # Stiffness of the contacts, N/m; 0: both geoms are rigid.
    # For each geom, the first pair in which this geom is pair_geom1.
    geom1_pairadr: Annotated[wp.array2d[int], "block geom_end"]
    geom2_pair: Annotated[wp.array2d[int], "block pair"]  # The pairs, sorted by pair_geom2.
    geom2_pairadr: Annotated[wp.array2d[int], "block geom_end"]  # For each geom, its first entry in geom2_pair.
    pair_ncon: Annotated[wp.array2d[int], "block pair"]  # Contacts of each pair.
    pair_conadr: Annotated[wp.array2d[int], "block pair_end"]  # The first contact of each pair.
    contact_pair: Annotated[wp.array2d[int], "block contact"]
    # the two bodies of a contact, as indices of free bodies, the smaller index first; negative: the body does not move
    contact_bodies: Annotated[wp.array3d[int], "block contact 2"]
    # The contacts of each body, one body after another. An entry is 2 × the number of the contact, plus 1 if the body
    # is the contact's second body.
    body_contact: Annotated[wp.array2d[int], "block link"]
    body_conadr: Annotated[wp.array2d[int], "block free_body_end"]
    # For each body, the first body of its component (all bodies with which it is joined by contacts).
    body_component: Annotated[wp.array2d[int], "block body"]
    body_root: Annotated[wp.array2d[int], "block body"]  # The body from which distances in a component are counted.
    body_level: Annotated[wp.array2d[int], "block body"]  # Distance from the root, in contacts.
    position: Annotated[wp.array2d[int], "block free_body"]  # Index of a body in the solver's system of equations.
    # ``lowest[block, i]``: i is the index of a body in the solver's system of equations. The value is the lowest index
    # among this body and the bodies that it touches.
    lowest: Annotated[wp.array2d[int], "block free_body"]
    bodies_conadr: Annotated[wp.array2d[int], "block contact"]  # The first contact of each pair of bodies.
    ncon: Annotated[wp.array[int], "block"]
    nfree: Annotated[wp.array[int], "block"]  # Number of bodies that can move.
    solver_niter: Annotated[wp.array[int], "block"]
    solver_paused: Annotated[wp.array[int], "block"]  # Iterations before the solver paused; 0: it has not paused.
    world: Annotated[wp.array[int], "block"]  # The world of a block; negative: no world.
    frame: Annotated[wp.array[int], "block"]  # Index in FrameBuffer of the frame that a block writes.


@record
class FrameBuffer:
    """Frames of recorded worlds, in the order in which blocks write them. All worlds of a call share this buffer."""

    every: Annotated[wp.array[int], "world"]  # Steps between two frames; 0: the world is not recorded.
    used: Annotated[wp.array[int], "1"]
    of: Annotated[wp.array[int], "frame"]  # The world to which each frame belongs.
    step: Annotated[wp.array[int], "frame"]
    placed: Annotated[wp.array[int], "frame"]
    pose: Annotated[wp.array3d[float], "frame box 7"]
    top_force: Annotated[wp.array2d[float], "frame box"]
    carrier_pose: Annotated[wp.array2d[float], "frame 7"]


@record
class Counts:
    """Counters of one call of the kernels."""

    taken: Annotated[wp.array[int], "queue"]  # Number of worlds that blocks have taken so far.
    idle: Annotated[wp.array[int], "queue"]  # Number of lanes that found no further world.
    # GPU: time of the first reading of the clock, in units of 1,024 ns; CPU: 1 when the slice is over (block.cuh).
    clock: Annotated[wp.array[int], "1"]
    steps: Annotated[wp.array[int], "1"]
    iterations: Annotated[wp.array[int], "1"]
    contacts: Annotated[wp.array[int], "1"]  # Largest number of contacts of a world so far.


@record
class Thread:
    """A thread, its block, and the world of the block."""

    block: int
    thread: int
    threads: int
    world: int
    placed: int  # Number of placed boxes.
    geoms: int  # Number of geoms: the floor, and the shapes of the carrier and of the placed boxes.
    held: int  # 1 if the carrier cannot move, and so is not a free body.
    hands: int  # 1 if a hand may carry boxes; if 0, the compiler leaves out the code for hands.
    gives: int  # 1 if boxes may be compliant; if 0, the compiler leaves out the code for compliance.
    wraps: int  # 1 if film may hold boxes; if 0, the compiler leaves out the code for film.
    lands: int  # 1 if the law of landing boxes may act; if 0, the compiler leaves out its code.
    carried: int  # 1 if a hand holds the box that was placed last.


def most_panels(n_boxes: int) -> int:
    """Number of panels of the system of equations of a world with ``n_boxes`` boxes and a moving carrier."""
    return -(-6 * (n_boxes + 1) // PANEL)


def axes(blocks: int, n_boxes: int, boards: int, npairmax: int, nconmax: int) -> dict[str, int]:
    """Name of an axis → size of this axis, for the workspace of some thread blocks.

    Args:
        n_boxes: largest number of boxes of a world.
        boards: largest number of shapes of a carrier.
        npairmax: largest number of pairs of near geoms of a world.
        nconmax: largest number of contacts of a world.
    """
    panels = most_panels(n_boxes)
    return {
        "block": blocks,
        "box": n_boxes,
        "geom": n_boxes + boards + 1,
        "geom_end": n_boxes + boards + 2,
        "body": n_boxes + 1,
        "free_body": n_boxes + 1,
        "free_body_end": n_boxes + 2,
        "dof": 6 * (n_boxes + 1),
        "entry": panels * (panels + 1) // 2 * PANEL**2,
        "part": panels * 2 * PANEL**2,
        "pair": npairmax,
        "pair_end": npairmax + 1,
        "contact": nconmax,
        "link": 2 * nconmax,
        "efc_word": EFC_WORDS,
    }


def array_types(kind: Any) -> dict[str, Any]:
    """Name of an array → type of this array, for all arrays of a record, in the order of their declarations."""
    return {name: kind.vars[name].type for name in kind.shapes}


def array_shapes(kind: Any, sizes: Mapping[str, int]) -> dict[str, tuple[int, ...]]:
    """Name of an array → shape of this array, for all arrays of a record.

    Args:
        kind: the class of the record.
        sizes: name of an axis → size of this axis.
    """
    return {
        name: tuple(axis if isinstance(axis, int) else sizes[axis] for axis in shape)
        for name, shape in kind.shapes.items()
    }


def filled_record(kind: Any, values: Mapping[str, Any]) -> Any:
    """A record whose fields are taken from ``values``. Additional entries of ``values`` are not used. The rows of
    arrays must be contiguous (arrays.cuh)."""
    instance = kind()
    for name in kind.vars:
        assert getattr(values[name], "is_contiguous", True), name
        setattr(instance, name, values[name])
    return instance


def _parts(sizes: Mapping[str, int]) -> Iterator[tuple[str, Any, tuple[int, ...], int]]:
    """Name, element type, shape and number of 32-bit words of each workspace array, in the order of the buffer."""
    types = array_types(Workspace)
    for name, shape in array_shapes(Workspace, sizes).items():
        words = wp.types.type_size_in_bytes(types[name].dtype) // 4 * math.prod(shape)
        yield name, types[name].dtype, shape, words + -words % 4


def buffer_rows(sizes: Mapping[str, int]) -> int:
    """Number of rows, of ``BUFFER_WORDS`` words each, of a buffer for the workspace of some blocks. An array of the
    workspace holds the data of all blocks one after another.

    Args:
        sizes: axis → size.
    """
    return -(-sum(words for *_, words in _parts(sizes)) // BUFFER_WORDS)


def in_buffer(buffer: Any, sizes: Mapping[str, int], first_row: int = 0) -> dict[str, Any]:
    """The arrays of a workspace, as views of a buffer of 32-bit words (row, ``BUFFER_WORDS``). The workspace begins at
    row ``first_row`` of the buffer.
    """
    views: dict[str, Any] = {}
    pointer = buffer.ptr + 4 * BUFFER_WORDS * first_row
    for name, dtype, shape, words in _parts(sizes):
        views[name] = wp.array(ptr=pointer, dtype=dtype, shape=shape, device=buffer.device)
        pointer += 4 * words
    return views
