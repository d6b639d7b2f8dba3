"""Constants of worlds on the device: tables made from jobs, with one row per world.

All worlds of a table have the same number of box columns; columns beyond a world's boxes are padding. The docstring of
``petmjx.engines.mjx`` explains the names of axes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from petmjx.common.units import seconds_to_steps
from petmjx.engines.contact_penetration import stiffened
from petmjx.engines.metrics import CONFIRM_S
from petmjx.engines.mjx.padded_sizes import padded_rows
from petmjx.engines.mjx.scene_rows import PAIR, Rows, gather_rows, more_shapes, rows_of, with_padding_rows
from petmjx.options.materials import PAIR_TABLES
from petmjx.options.simulation import Simulation
from petmjx.world.job import ACCELERATION, FORCE, Drive, Excitation, Job

NEVER = np.iinfo(np.int32).max
"""A step that no world reaches. The value also stands for an end that is not known yet."""


class Worlds(NamedTuple):
    """Constants of worlds.

    Body 0 is the carrier, and box k is body k + 1.

    Shapes and boxes: shapes are in the order of bodies, and the shapes of body b begin at ``first_shape[b]``.
    ``shape_body`` is the body of each shape. ``half`` has the boxes' half extents. ``middle`` has the vector from each
    box's centre of mass (the origin of the box's frame) to its middle. For ``inertia_box``, see
    ``petmjx.world.body_shapes.Body``.

    Contacts: ``floor_friction`` and ``friction`` are sliding, torsional and rolling coefficients. For
    ``shape_surface`` and ``pairs``, see petmjx/world/surface_pairs.py; the axes of a table in ``pairs`` are "world
    surface surface", and the axes of an entry. petmjx/world/compliance.py explains ``shape_give`` (m³/N) and ``sinks``,
    the expected descent of boxes (m).

    Drives: ``driven`` states whether a drive follows the placement, and ``held`` whether the drive holds the carrier
    fixed. ``drive_yaw`` is (cos, sin) of the angle by which the drive is rotated about the vertical. ``profile_steps``
    is the number of samples of the drive. ``drive_steps`` is the number of steps from the beginning of the drive to the
    world's end, unless the world rests earlier. In the drive, the culprit (the first box beyond a threshold) ends the
    world if it is tilted too far and has moved sideways by at least ``allowed_sway``, m.

    Ends: ``settles`` states whether the placement ends in a settled state, because a drive starts from this state, or
    because the state is kept. ``ends_when_lost``: a box that is tilted too far at a check is lost at once, like a box
    that has dropped (``petmjx.world.job.Job.ends_when_lost``). ``confirm_steps``: a fall is confirmed this number of
    steps after the first sign of failure (``petmjx.engines.metrics.CONFIRM_S``); ``NEVER`` if the world does more than
    confirm a fall.
    ``pauses``: when its boxes are at rest, the world waits for further boxes (petmjx/engines/open_world_protocol.py).
    ``ends_when_gone``: the world is a trial, which ends when a box is gone (``petmjx.engines.metrics.GONE_TILT``).
    ``most_steps`` is the number of steps after which the world leaves a GPU (petmjx/engines/warp/long_worlds.py).
    ``most_iterations`` is the largest number of solver iterations of the placement or the drive; ``NEVER``: no limit.

    Placing: ``start`` is the release pose of a box whose ``support`` is at its planned place. If the support has sunk
    or risen, the box is released lower or higher, by at most ``most_followed``, m (petmjx/world/release_places.py).
    ``appears``: all boxes begin at ``start``. In other worlds, boxes are carried, and begin at an offset of
    ``way_offset`` from ``start``. The path of a carried box has ``way_steps`` steps; for a box that falls,
    ``way_steps`` is 0. At the end of the path, boxes are set down, unless they are released to fall
    (petmjx/world/approach_paths.py). ``hand_force`` (N) and ``hand_speed`` (m/s) are a hand's limits. ``way_aside`` (m)
    has the largest distances by which the start of a path may be moved aside. Axis 2 of this array is the direction:
    towards low or towards high coordinates. Axis 3 is the coordinate: x or y. ``wrap_press`` and ``wrap_hold``, N, are
    the forces of film (petmjx/world/film.py).
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
    pairs: dict[str, Float[Array, "world surface surface ..."]]
    floor_z: Float[Array, " world"]
    profile: Int[Array, " world"]
    drive_scale: Float[Array, " world"]
    drive_yaw: Float[Array, "world 2"]
    profile_steps: Int[Array, " world"]
    drive_steps: Int[Array, " world"]
    driven: Bool[Array, " world"]
    held: Bool[Array, " world"]
    settles: Bool[Array, " world"]
    ends_when_lost: Bool[Array, " world"]
    confirm_steps: Int[Array, " world"]
    allowed_sway: Float[Array, " world"]
    pauses: Bool[Array, " world"]
    ends_when_gone: Bool[Array, " world"]
    most_steps: Int[Array, " world"]
    most_iterations: Int[Array, " world"]
    appears: Bool[Array, " world"]
    way_offset: Float[Array, "world box 3"]
    way_steps: Int[Array, "world box"]
    way_aside: Float[Array, "world box 2 2"]
    falls: Bool[Array, "world box"]
    hand_force: Float[Array, " world"]
    hand_speed: Float[Array, " world"]
    wrap_press: Float[Array, "world box 3"]
    wrap_hold: Float[Array, "world box"]

    def flat(self) -> dict[str, Array]:
        """All arrays by name, as the kernels of mjx-warp take them. A table of ``pairs`` has the name ``PAIR`` + its
        key."""
        arrays: dict[str, Any] = self._asdict()
        pairs: dict[str, Array] = arrays.pop("pairs")
        return arrays | {PAIR + name: table for name, table in pairs.items()}


def device_array(values: NDArray[Any]) -> jax.Array:
    """An array on the device. On a CPU it may share the memory of ``values``, so ``values`` must not change afterwards.

    ``jnp.asarray`` would compile a program for each shape.
    """
    array: jax.Array = jax.device_put(values)
    return array


def device_arrays(arrays: Iterable[NDArray[Any]]) -> list[jax.Array]:
    """``device_array`` for many arrays in one call. One call for all arrays takes half the time of a call per array."""
    uploads: list[jax.Array] = jax.device_put([*arrays])
    return uploads


MANY_PADDING_ROWS: Final = 4096
"""If at least this number of padding rows is needed, the device makes them by repeating the first row. If 10,000
padding rows of 24 kB each were uploaded, the first step of a run would begin later."""


def upload_worlds(
    jobs: Sequence[Job],
    rows: int,
    width: int,
    profiles: dict[int, int],
    sim: Simulation,
    boards: int = 1,
) -> Worlds:
    """Constants of a group of jobs, as device arrays. The constants are computed on the host: on a device, each
    operation would first have to be compiled for each shape.

    Args:
        rows: number of rows of the tables, at least one per job. Padding rows repeat the first job's scene and never
            run.
        width: number of box columns.
        profiles: ``id`` of an excitation → its row in the table of profiles.
        boards: number of columns for the shapes of a carrier; increased if a carrier has more shapes.
    """
    on_host = rows if rows - len(jobs) < MANY_PADDING_ROWS else padded_rows(len(jobs))
    padding = on_host - len(jobs)
    of_scenes = _rows_of_scenes(jobs, width, sim, boards, padding)
    of_jobs = _rows_of_jobs(jobs, profiles, sim)
    of_jobs = {name: with_padding_rows(values, padding) for name, values in of_jobs.items()}
    columns = of_scenes | of_jobs | {"ends_when_gone": np.zeros(on_host, np.bool_)}
    on_device: dict[str, Any] = dict(zip(columns, device_arrays(columns.values()), strict=True))
    pairs = {table.name: on_device.pop(PAIR + table.name) for table in PAIR_TABLES}
    worlds = Worlds(**on_device, pairs=pairs)
    return worlds if on_host == rows else _with_padding_rows(worlds, rows)


def _rows_of_scenes(jobs: Sequence[Job], width: int, sim: Simulation, boards: int, padding: int) -> Rows:
    """The rows of the jobs' scenes, as ``rows_of`` makes them. ``rows_of`` is called once for each stiffness of
    contacts, because the place at which a box is released depends on the stiffness."""
    if all(job.stiff is None for job in jobs):
        return rows_of([job.scene for job in jobs], width, sim, boards, padding)
    boards = max(boards, *(more_shapes(job.scene) for job in jobs))
    numbers, parts = list[int](), list[Rows]()
    for stiff in dict.fromkeys(job.stiff for job in jobs):
        alike = [number for number, job in enumerate(jobs) if job.stiff == stiff]
        of_part = sim if stiff is None else stiffened(sim, stiff)
        parts.append(rows_of([jobs[number].scene for number in alike], width, of_part, boards))
        numbers += alike
    source = np.concatenate([np.argsort(numbers), np.full(padding, numbers.index(0))])
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return dict(zip(joined, gather_rows(joined.values(), source), strict=True))


@partial(jax.jit, static_argnames="rows")
def _with_padding_rows(worlds: Worlds, rows: int) -> Worlds:
    """The rows of worlds, followed by padding rows that repeat the first row."""

    def extended(values: jax.Array) -> jax.Array:
        return jnp.concatenate([values, jnp.broadcast_to(values[:1], (rows - len(values), *values.shape[1:]))])

    extended_worlds: Worlds = jax.tree.map(extended, worlds)
    return extended_worlds


_NO_DRIVE: Final = Drive(Excitation("none", FORCE, np.zeros((0, 3))), scale=0.0, rest_s=0.0)


def _rows_of_jobs(jobs: Sequence[Job], profiles: dict[int, int], sim: Simulation) -> Rows:
    """The fields that depend on the job, not only on its scene."""
    timestep_s = sim.physics.timestep_s
    drives = [job.drive or _NO_DRIVE for job in jobs]
    profiles = {id(_NO_DRIVE.excitation): 0, **profiles}
    profile_steps = np.array([len(drive.excitation.samples) for drive in drives], np.int32)
    rest_steps = np.array([seconds_to_steps(drive.rest_s, timestep_s) for drive in drives], np.int32)
    scales = [drive.scale * drive.unit(job.scene.total_mass) for drive, job in zip(drives, jobs, strict=True)]
    yaws = [drive.yaw_rad for drive in drives]
    confirm_steps = seconds_to_steps(CONFIRM_S, timestep_s)
    most = [job.scene.n_boxes if job.pauses_after is None else job.pauses_after for job in jobs]
    return {
        "n_boxes": np.array(most, np.int32),
        "pauses": np.array([job.pauses_after is not None for job in jobs]),
        "profile": np.array([profiles[id(drive.excitation)] for drive in drives], np.int32),
        "drive_scale": np.array(scales, np.float32),
        "drive_yaw": np.array([(math.cos(yaw), math.sin(yaw)) for yaw in yaws], np.float32),
        "profile_steps": profile_steps,
        "drive_steps": profile_steps + rest_steps,
        "driven": np.array([job.drive is not None for job in jobs]),
        "held": np.array([drive.excitation.kind == ACCELERATION for drive in drives]),
        "settles": np.array([job.settles for job in jobs]),
        "ends_when_lost": np.array([job.ends_when_lost for job in jobs]),
        "confirm_steps": np.array([confirm_steps if job.confirms else NEVER for job in jobs], np.int32),
        "allowed_sway": np.array([drive.allowed_sway_m for drive in drives], np.float32),
        "most_steps": np.full(len(jobs), NEVER, np.int32),
        "most_iterations": np.array([job.most_iterations(sim.iteration_limit) or NEVER for job in jobs], np.int32),
    }
