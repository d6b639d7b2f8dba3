"""The padded template for a capacity: one compiled MuJoCo model for all plans of up to ``capacity`` boxes.

Sizes, masses, frictions and gravity differ from world to world. So the values that differ are not in the template, but
in overrides of model fields for each world. Only ``override_fields`` computes these overrides.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from petmjx.engines.mjx.compliance import laws
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.options.physics import Physics
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.body_shapes import Body
from petmjx.world.mujoco_model import HeldCarrier, build_spec
from petmjx.world.scene import IDENTITY_QUAT, Scene
from petmjx.world.surface_pairs import NOT_GIVEN

FLOOR_GEOM = 0
CARRIER_BODY, FIRST_BOX_BODY = 1, 2

FLOAT32_TOLERANCE = 1e-6
"""Smallest relative solver tolerance. Float32 cannot reach MuJoCo's tolerance of 1e-8; trying would only cost
iterations."""

MAX_ITERATIONS = 100
"""MuJoCo's default limit of solver iterations."""

LINE_SEARCH_ITERATIONS = 50
"""MuJoCo's default limit of line search iterations."""

VMAP_LINE_SEARCH_ITERATIONS = 30
"""Largest number of line search iterations. Under ``vmap``, MJX's own solver (used with pyramidal cones) always takes
the largest number of iterations. With 10 iterations, the force on a box differed from the force in C MuJoCo by more
than 50 N in 2.2 % of the steps of small piles. The reason: the solver had given up while boxes landed. With 30
iterations, this happened in 0.2 % of the steps."""

CONTACTS_PER_PAIR = 4
"""Number of contacts that MJX's collider makes for two boxes, and for a plane and a box."""

PARKING_HEIGHT_M = 50.0
PARKING_PITCH_M = 8.0
"""Distance between boxes that are not yet placed. Boxes that are not yet placed hang in a row at ``PARKING_HEIGHT_M``.
At this distance no two bounding spheres meet (the largest BED-BPP item is under 1 m), and float32 still resolves
positions to 0.05 mm."""


def padded_template(capacity: int, boards: int, sim: Simulation, *, held: bool) -> mujoco.MjModel:
    """Compile the template: floor, a carrier of ``boards`` shapes, ``capacity`` boxes. The template's sizes are
    placeholders: in each world, the model fields of ``override_fields`` replace them.

    Args:
        boards: number of shapes of the carrier; with 0, nothing touches the carrier.
        held: whether the carrier is clamped, for profiles with a prescribed acceleration. A clamped carrier has no
            joint, and its pose is in the data of its world.
    """
    scene = _nominal_scene(capacity, boards, sim.physics)
    at = HeldCarrier(scene.carrier.pos, np.array(IDENTITY_QUAT), mocap=True) if held else None
    spec = build_spec(scene, sim.physics, at)
    option = spec.option
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON if sim.solver is Solver.NEWTON else mujoco.mjtSolver.mjSOL_CG
    option.tolerance = max(sim.solver_tolerance or 0.0, FLOAT32_TOLERANCE)
    option.iterations = sim.solver_iterations or MAX_ITERATIONS
    option.ls_iterations = VMAP_LINE_SEARCH_ITERATIONS
    return spec.compile()


def contact_geoms(model: Any) -> Int[np.ndarray, "pair 2"]:
    """The geoms of each pair of an MJX model, in the order of MJX's contacts: pairs with the same types of geoms are
    side by side (MuJoCo 3.17: collision_driver.py). Each pair has ``CONTACTS_PER_PAIR`` contacts."""
    from mujoco.mjx._src.collision_driver import geom_pairs

    pairs_by_types: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for one, two, _ in geom_pairs(model):
        pairs_by_types.setdefault((int(model.geom_type[one]), int(model.geom_type[two])), []).append((one, two))
    return np.array([pair for pairs in pairs_by_types.values() for pair in pairs]).reshape(-1, 2)


def _nominal_scene(capacity: int, boards: int, physics: Physics) -> Scene:
    """The carrier, and boxes that wait in the air. Inertia is explicit. For boxes without a given inertia, MuJoCo would
    sort the principal axes, and overrides could not follow the order of a box's axes."""
    half, place = np.tile([0.15, 0.15, 0.1], (capacity, 1)), np.array(parked_positions(capacity), np.float64)
    solid = np.array([0.4, 0.3, physics.carrier_half_height_m])
    board = np.tile(solid, (boards, 1))
    aloft = np.array([0.0, 0.0, PARKING_HEIGHT_M])
    friction = np.tile(physics.carrier_friction, (boards, 1))
    return Scene(
        half_size=half,
        mass=np.full(capacity, 5.0),
        target=place,
        start_pos=place,
        start_quat=np.tile(IDENTITY_QUAT, (capacity, 1)),
        friction=np.tile(physics.box_friction, (capacity, 1)),
        carrier=Body(aloft, physics.carrier_mass_kg, board, np.zeros((boards, 3)), friction, solid),
        floor_friction=physics.floor_friction,
        floor_z=physics.floor_z_m,
        inertia_box=half,
    )


def parked_positions(capacity: int) -> Float[Array, "box 3"]:
    """Places at which the boxes of a world wait until they are placed, m."""
    x = PARKING_PITCH_M * jnp.arange(1, capacity + 1)
    return jnp.stack([x, jnp.zeros(capacity), jnp.full(capacity, PARKING_HEIGHT_M)], axis=-1)


def _box_inertia(half: Float[Array, "world body 3"], mass: Float[Array, "world body"]) -> Float[Array, "world body 3"]:
    """Principal moments of solid boxes, in the order of their axes: m/3 · (b² + c²) for half extents a, b, c."""
    squares = half**2
    return mass[..., None] / 3 * (squares.sum(-1, keepdims=True) - squares)


def override_fields(
    worlds: Worlds, model: Any, *, held: bool, physics: Physics, gives: bool = False
) -> dict[str, Float[Array, "world ..."]]:
    """Model fields for each world, under the names that ``Model.tree_replace`` takes.

    ``physics`` defines the skin: the distance by which geoms are larger than boxes. ``model`` is the template's MJX
    model. The model's values are kept for the world body and the floor, which are the same in all worlds. With
    ``gives``, contacts of compliant boxes get their own laws.

    Derived fields are computed as in MuJoCo's compiler. ``body_invweight0`` and ``dof_invweight0`` of a free body are
    1/m and the mean of 1/I. ``geom_rbound`` is the half diagonal. Tests compare all these fields with the fields that
    the compiler makes.
    """
    n_worlds, shapes = worlds.shape_half.shape[:2]
    boards = shapes - worlds.half.shape[1]
    skin = jnp.array([physics.carrier_skin_m] * boards + [physics.skin_m] * (shapes - boards))
    geom_half = worlds.shape_half + skin[None, :, None]
    inertia = _box_inertia(worlds.inertia_box, worlds.mass)
    inv_translation = 1 / worlds.mass
    inv_rotation = (1 / inertia).mean(-1)
    if held:
        inv_translation = inv_translation.at[:, 0].set(0.0)
        inv_rotation = inv_rotation.at[:, 0].set(0.0)

    def with_world_body(values: Float[Array, "world body *k"]) -> Float[Array, "world body+1 *k"]:
        return jnp.concatenate([jnp.zeros((n_worlds, 1, *values.shape[2:])), values], axis=1)

    def with_floor(values: Float[Array, "world shape *k"], name: str) -> Float[Array, "world shape+1 *k"]:
        floor = jnp.broadcast_to(getattr(model, name)[FLOOR_GEOM], (n_worlds, 1, *values.shape[2:]))
        return jnp.concatenate([floor, values], axis=1)

    floor = jnp.zeros((n_worlds, 3)).at[:, 2].set(worlds.floor_z)
    free = slice(1, None) if held else slice(None)
    dof = jnp.stack([inv_translation, inv_rotation], axis=-1)[:, free]
    fields = {
        "body_mass": with_world_body(worlds.mass),
        "body_inertia": with_world_body(inertia),
        "body_subtreemass": jnp.concatenate([worlds.mass.sum(1, keepdims=True), worlds.mass], axis=1),
        "body_invweight0": with_world_body(jnp.stack([inv_translation, inv_rotation], axis=-1)),
        "dof_invweight0": jnp.repeat(dof, 3, axis=-1).reshape(n_worlds, -1),
        "geom_size": with_floor(geom_half, "geom_size"),
        "geom_pos": jnp.concatenate([floor[:, None], worlds.shape_pos], axis=1),
        "geom_rbound": with_floor(jnp.sqrt((geom_half**2).sum(-1)), "geom_rbound"),
        "geom_aabb": with_floor(jnp.concatenate([jnp.zeros_like(geom_half), geom_half], axis=-1), "geom_aabb"),
        "geom_friction": jnp.concatenate([worlds.floor_friction[:, None], worlds.friction], axis=1),
    }
    if getattr(model, "npair", 0):
        partners = jnp.maximum(
            fields["geom_friction"][:, model.pair_geom1], fields["geom_friction"][:, model.pair_geom2]
        )
        surface = jnp.concatenate([jnp.zeros((n_worlds, 1), jnp.int32), worlds.shape_surface], axis=1)
        pair = jnp.arange(n_worlds)[:, None], surface[:, model.pair_geom1], surface[:, model.pair_geom2]
        pair_friction = worlds.pairs["friction"][pair]
        sliding = jnp.where(pair_friction == NOT_GIVEN, partners[..., 0], pair_friction)
        fields["pair_friction"] = partners[..., jnp.array([0, 0, 1, 2, 2])].at[..., :2].set(sliding[..., None])
        if gives:
            # ``pair_solref`` is only in ``fields`` if a further value of pairs of materials sets it
            fields |= laws(worlds, model, inv_translation, physics, fields.get("pair_solref", model.pair_solref))
    return fields
