"""``petmjx.release``: simulates the free motion of boxes from any pose and velocity, so that petmjx can be compared
with camera recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petmjx.common.argument_checks import array_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import MM_PER_M, FloatArray, mm_to_m
from petmjx.engines.protocol import Engine
from petmjx.loop.engine_setup import ready_engine
from petmjx.options.carriers import CARRIER_EXTENT_M, OwnCarrier
from petmjx.options.physics import HIGHEST_FRICTION, HIGHEST_RESTITUTION, LANDING_S, Physics
from petmjx.options.run_options import AUTO
from petmjx.options.simulation import LONGEST_S, Simulation
from petmjx.plans.plan_fields import FARTHEST_MM, LARGEST_KG, LARGEST_MM, SMALLEST_KG, SMALLEST_MM
from petmjx.world.free_bodies import FreeBodies, Ground, inertia_box
from petmjx.world.scene import Scene

PLANE: Final = "plane"
"""Name of the ground that is an infinite plane."""

MANY_WORLDS: Final = 1_000
"""Smallest number of worlds for which the engine ``auto`` means ``mjx-warp``, if there is a GPU. A GPU simulates about
this number of worlds at the same time, but each world more slowly than a CPU thread does."""

FASTEST_M_S: Final = 100.0
FASTEST_RAD_S: Final = 1_000.0
"""Largest allowed velocities, m/s and rad/s. A larger velocity is probably in the wrong unit, and a faster box would
pass through obstacles within one step."""

SMALLEST_KG_M2: Final = 1e-12
LARGEST_KG_M2: Final = 1e6
"""Smallest and largest allowed moment of inertia, kg·m². The largest value exceeds the moments of any box of an allowed
size and mass."""

UNIT_WITHIN: Final = 0.01
"""Largest allowed difference of a quaternion's length from 1. Quaternions from a camera are rounded, so they are
normalised."""

_SMALL_RAD: Final = 1e-6
"""If half of the rotation angle between two steps is less than this angle, rad, the orientation is interpolated
linearly, because a formula with sines would lose digits."""

ON_STEP: Final = 1e-6
"""If a time differs from the time of a step by at most this share of a timestep, the two times count as equal."""


class _Argument(NamedTuple):
    """Describes an argument of ``release`` that has a value for each box: how many numbers a value has, and the limits
    of these numbers."""

    numbers: int
    low: float
    high: float


_ARGUMENTS: Final = {
    "size_mm": _Argument(3, SMALLEST_MM, LARGEST_MM),
    "mass_kg": _Argument(1, SMALLEST_KG, LARGEST_KG),
    "pos_m": _Argument(3, -FARTHEST_MM / MM_PER_M, FARTHEST_MM / MM_PER_M),
    "quat_wxyz": _Argument(4, -1 - UNIT_WITHIN, 1 + UNIT_WITHIN),
    "vel_m_s": _Argument(3, -FASTEST_M_S, FASTEST_M_S),
    "angvel_rad_s": _Argument(3, -FASTEST_RAD_S, FASTEST_RAD_S),
    "inertia_kg_m2": _Argument(3, SMALLEST_KG_M2, LARGEST_KG_M2),
    "friction": _Argument(1, 0.0, HIGHEST_FRICTION),
    "restitution": _Argument(1, 0.0, HIGHEST_RESTITUTION),
}


@dataclass(frozen=True, eq=False)
class Trajectories:
    """The trajectories of the boxes that ``petmjx.release`` released. The arrays have an axis for the k boxes of a
    world only if the arguments of ``release`` had it.

    Attributes:
        times_s: (t,) times after the release, s.
        pos_m: (n, t, 3) or (n, k, t, 3) centres of the boxes, m. If a simulation fails, ``pos_m`` is NaN from the
            moment at which the world's numbers are no longer finite.
        quat_wxyz: (n, t, 4) or (n, k, t, 4) orientations of the boxes, as quaternions of length 1. Of the two
            equivalent quaternions q and -q, the one nearer to the previous quaternion is given.
        engine: name of the engine that computed the trajectories.
    """

    times_s: FloatArray
    pos_m: FloatArray
    quat_wxyz: FloatArray
    engine: str


def release(
    size_mm: ArrayLike,
    mass_kg: ArrayLike,
    pos_m: ArrayLike,
    quat_wxyz: ArrayLike,
    vel_m_s: ArrayLike,
    angvel_rad_s: ArrayLike,
    times_s: ArrayLike,
    *,
    inertia_kg_m2: ArrayLike | None = None,
    friction: ArrayLike | None = None,
    restitution: ArrayLike | None = None,
    ground: str | Path = PLANE,
    physics: str | Mapping[str, Any] | Physics = "pallet",
    engine: str | Engine = AUTO,
) -> Trajectories:
    """Release boxes with any pose and velocity, and simulate their motion. Boxes are not placed one by one, and there
    are no verdicts. Many worlds (separate simulations) are computed together, with the same contacts and time steps as
    for plans (docs/released-boxes.md).

    The first axes of arrays are (n, …) for n worlds with one box each, or (n, k, …) for n worlds with k boxes each.
    Axes of length 1 and missing leading axes are broadcast as in NumPy, so a single size, mass or friction applies to
    all boxes.

    Args:
        size_mm: (…, 3) extents along the boxes' axes, mm.
        mass_kg: (…) masses of the boxes, kg.
        pos_m: (…, 3) centres of the boxes, m; z = 0 is the ground.
        quat_wxyz: (…, 4) orientations of the boxes, as quaternions (w, x, y, z).
        vel_m_s: (…, 3) velocities of the centres at the release, m/s.
        angvel_rad_s: (…, 3) angular velocities at the release, along the boxes' own axes, rad/s.
        times_s: (t,) increasing times after the release at which poses are wanted, s. At multiples of the timestep,
            poses are exactly as simulated. Between two steps, positions are interpolated linearly, and orientations
            along the shortest rotation.
        inertia_kg_m2: (…, 3) principal moments of inertia along the boxes' axes, kg·m², or one number for all moments
            of all boxes. If ``inertia_kg_m2`` is None, boxes are solid and homogeneous.
        friction: (…) coefficient of sliding friction between a box and the ground. For two boxes that touch, the larger
            coefficient of the two is used. If ``friction`` is None, the coefficients in ``physics`` are used.
        restitution: (…) speed of a box after a bounce as a share of its speed before, up to 0.9. All boxes of a world
            must have the same value. A landing box is stopped within ``physics.landing_s`` or, if ``physics.landing_s``
            is 0, within 3 ms. If ``restitution`` is None, the value in ``physics`` is used.
        ground: "plane" for an infinite plane, the name of a carrier of a fixed size, or a TOML file of boards. A
            carrier does not move. The front-left corner of the carrier is at the origin, and its top at z = 0.
        physics: the name of a preset, a mapping that changes a preset, or a ``petmjx.Physics``.
        engine: mujoco, mjx-warp, mjx-warp-cpu, mjx-jax or an engine object. ``auto`` means ``mjx-warp`` for 1,000
            worlds or more if there is a GPU, else ``mujoco``.

    Raises:
        InputError: an argument is unusable. The message names the argument.
        EngineUnavailable: the engine cannot run here.
    """
    sim = _options(physics, ground)
    arguments: dict[str, Any] = {
        "size_mm": size_mm,
        "mass_kg": mass_kg,
        "pos_m": pos_m,
        "quat_wxyz": quat_wxyz,
        "vel_m_s": vel_m_s,
        "angvel_rad_s": angvel_rad_s,
    }
    optional = {"inertia_kg_m2": inertia_kg_m2, "friction": friction, "restitution": restitution}
    arguments |= {name: values for name, values in optional.items() if values is not None}
    boxes, axes = _box_arguments({name: _numbers(name, values) for name, values in arguments.items()})
    times, steps, share = _steps(times_s, sim.physics.timestep_s)
    below = _ground(sim, ground, smooth=friction is not None)
    scenes = _scenes(boxes, below, sim)
    velocity = np.concatenate([boxes["vel_m_s"], boxes["angvel_rad_s"]], axis=-1)
    bodies = FreeBodies(scenes, velocity, np.unique(steps).astype(np.int32), below.is_plane)
    runner, owned = ready_engine(engine, {}, gpu=len(scenes) >= MANY_WORLDS)
    try:
        poses = _poses(runner, bodies, sim, boxes.get("restitution")).swapaxes(1, 2)
    finally:
        if owned:
            runner.close()
    rows = np.searchsorted(bodies.steps, steps)
    pos, quat = _interpolated_poses(poses[:, :, rows[0]], poses[:, :, rows[1]], share)
    return Trajectories(times, pos.reshape(*axes, -1, 3), quat.reshape(*axes, -1, 4), runner.name)


def _poses(runner: Any, bodies: FreeBodies, sim: Simulation, restitution: FloatArray | None) -> FloatArray:
    """(n, s, k, 7) poses of the boxes in all worlds, at the s steps in ``bodies.steps``. Worlds with the same
    restitution are simulated together.

    Args:
        restitution: (n, k, 1) restitution of each box. If ``restitution`` is None, the value in the options is used.

    Raises:
        InputError: boxes of a world have different restitutions.
    """
    if restitution is None:
        poses: FloatArray = runner.paths(bodies, sim)
        return poses
    of_world = restitution[:, 0, 0]
    if (restitution[..., 0] != of_world[:, None]).any():
        raise InputError("restitution must be the same for all boxes of a world")
    landing_s = sim.physics.landing_s or LANDING_S
    poses_of_world: dict[int, FloatArray] = {}
    for share in np.unique(of_world).tolist():
        rows = np.flatnonzero(of_world == share)
        bounces = sim.changed(physics=sim.physics.changed(landing_s=landing_s, restitution=share))
        alike = replace(bodies, scenes=tuple(bodies.scenes[row] for row in rows), velocity=bodies.velocity[rows])
        poses_of_world |= dict(zip(rows.tolist(), runner.paths(alike, bounces), strict=True))
    return np.stack([poses_of_world[world] for world in range(len(of_world))])


def _options(physics: Any, ground: Any) -> Simulation:
    """The simulation's options with the given physics and ground. Raises InputError if the physics or the ground is
    unknown."""
    if not isinstance(physics, str | Mapping | Physics):
        raise InputError(f"physics must be a table, a record or the name of a preset, {shown_value(physics)}")
    sim = Simulation(physics=physics, placing="exact")
    fixed = [str(carrier) for carrier, extent in CARRIER_EXTENT_M.items() if extent is not None]
    is_named = isinstance(ground, str) and ground in (PLANE, *fixed)
    has_boards = isinstance(ground, Path | OwnCarrier) or (isinstance(ground, str) and ground.lower().endswith(".toml"))
    if not is_named and not has_boards:
        raise InputError(
            f"ground must be {', '.join(map(repr, (PLANE, *fixed)))} or a TOML file of boards, {shown_value(ground)}"
        )
    return sim if ground == PLANE else sim.changed(carrier=ground)


def _ground(sim: Simulation, ground: Any, *, smooth: bool) -> Ground:
    surface = Ground.plane(sim.physics) if ground == PLANE else Ground.of_carrier(sim)
    return surface.smooth if smooth else surface


def _numbers(name: str, values: Any) -> FloatArray:
    """The values of an argument, checked: (…, k) for values of k numbers each. The last axis exists even if k is 1.

    Raises:
        InputError: values are not numbers, are beyond the limits, or have a wrong shape.
    """
    numbers, low, high = _ARGUMENTS[name]
    try:
        array = np.asarray(values)
    except Exception:  # converting an object of an unknown class may raise anything
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "iuf" or not array.size:
        raise InputError(f"{name} must be an array of numbers, {shown_value(values)}")
    if name == "inertia_kg_m2" and array.ndim == 0:
        array = np.repeat(array, 3)
    if numbers == 1:
        array = array[..., None]
    shapes = f"(n, {numbers}) or (n, k, {numbers})" if numbers > 1 else "(n,) or (n, k)"
    if array.ndim == 0 or array.shape[-1] != numbers or array.ndim > 3:
        raise InputError(f"{name} must have the shape {shapes}, got {np.shape(values)}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite")
    beyond = (array < low) | (array > high)
    if beyond.any():
        position = np.argwhere(beyond)[0].tolist()
        raise InputError(f"{name} must be from {low:g} to {high:g}, got {array[tuple(position)]:g}")
    if name == "quat_wxyz":
        length = np.linalg.norm(array, axis=-1, keepdims=True)
        if (abs(length - 1) > UNIT_WITHIN).any():
            wrong = length[abs(length - 1) > UNIT_WITHIN][0]
            raise InputError(f"quat_wxyz must have the length 1, got {wrong:g}")
        array /= length
    return array


def _box_arguments(arrays: dict[str, FloatArray]) -> tuple[dict[str, FloatArray], tuple[int, ...]]:
    """The arguments as arrays (n, k, numbers), and the first axes that the arguments had: (n,) or (n, k).

    Raises:
        InputError: the shapes of two arguments do not fit together.
    """
    axes: tuple[int, ...] = ()
    for name, array in arrays.items():
        try:
            axes = np.broadcast_shapes(axes, array.shape[:-1])
        except ValueError:
            raise InputError(
                f"{name} has the axes {array.shape[:-1]}, which do not fit the axes {axes} of the arguments before it"
            ) from None
    if not axes:
        raise InputError("pos_m must have the shape (n, 3) or (n, k, 3), got (3,)")
    full = {name: np.broadcast_to(array, (*axes, array.shape[-1])) for name, array in arrays.items()}
    return {name: array.reshape(axes[0], -1, array.shape[-1]) for name, array in full.items()}, axes


def _scenes(boxes: Mapping[str, FloatArray], ground: Ground, sim: Simulation) -> tuple[Scene, ...]:
    """One scene (sizes, masses, poses and the carrier) for each world.

    Raises:
        InputError: no body can have these moments of inertia.
    """
    n, k, _ = boxes["pos_m"].shape
    half_size, mass = mm_to_m(boxes["size_mm"] / 2), boxes["mass_kg"][..., 0]
    friction = np.tile(sim.physics.box_friction, (n, k, 1))
    if "friction" in boxes:
        friction[..., :1] = boxes["friction"]
    equal = half_size
    if "inertia_kg_m2" in boxes:
        equal = inertia_box(boxes["inertia_kg_m2"], mass)
        if not np.isfinite(equal).all():
            raise InputError("inertia_kg_m2 must be possible for a body: no moment may exceed the sum of the other two")
    return tuple(
        Scene(
            half_size=half_size[world],
            mass=mass[world],
            target=boxes["pos_m"][world],
            start_pos=boxes["pos_m"][world],
            start_quat=boxes["quat_wxyz"][world],
            friction=friction[world],
            carrier=ground.carrier,
            floor_friction=ground.friction,
            floor_z=ground.floor_z,
            inertia_box=equal[world],
        )
        for world in range(n)
    )


def _steps(times_s: Any, timestep_s: float) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Three arrays: (t,) the times; (2, t) the numbers of the steps before and after each time (the same step twice if
    the time is on a step); and (t,) the position of the time between these two steps, from 0 to 1.

    Raises:
        InputError: values are not times, or do not increase.
    """
    times = array_of(times_s, "times_s", ())
    if not len(times):
        raise InputError("times_s must have at least one time")
    if times[0] < 0 or times[-1] > LONGEST_S or not (np.diff(times) > 0).all():
        raise InputError(f"times_s must increase, and lie between 0 and {LONGEST_S:g} s")
    count = times / timestep_s
    nearest = np.round(count)
    exact = abs(count - nearest) <= ON_STEP
    before = np.where(exact, nearest, np.floor(count))
    steps = np.stack([before, before + ~exact]).astype(np.int64)
    return times, steps, np.where(exact, 0.0, count - before)


def _interpolated_poses(before: FloatArray, after: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Interpolate between the poses ``before`` and ``after`` (…, t, 7), at the fractions ``share`` (t,) of the
    intervals. Positions (…, t, 3) are interpolated linearly, orientations (…, t, 4) along the shortest rotation
    (Shoemake 1985, "slerp"). Of the two equivalent quaternions q and -q, the one nearer to the previous quaternion is
    returned."""
    share = share[:, None]
    pos = before[..., :3] + share * (after[..., :3] - before[..., :3])
    first, last = before[..., 3:], after[..., 3:]
    cosine = (first * last).sum(axis=-1, keepdims=True)
    last, cosine = np.where(cosine < 0, -last, last), abs(cosine)
    angle = np.arccos(np.minimum(cosine, 1.0))
    turns = angle > _SMALL_RAD
    sine = np.where(turns, np.sin(angle), 1.0)
    weights = (
        np.where(turns, np.sin((1 - share) * angle) / sine, 1 - share),
        np.where(turns, np.sin(share * angle) / sine, share),
    )
    quat = weights[0] * first + weights[1] * last
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    flips = (quat[..., 1:, :] * quat[..., :-1, :]).sum(axis=-1) < 0
    sign = np.where(np.cumsum(flips, axis=-1) % 2, -1.0, 1.0)
    quat[..., 1:, :] *= sign[..., None]
    return pos, quat
