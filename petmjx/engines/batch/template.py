"""The padded model of a capacity: one compiled MuJoCo model for every plan of up to that many boxes.

What differs from world to world (sizes, masses, frictions, gravity) is not in the template but in per-world
overrides of model fields, which ``override_fields`` alone computes.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from petmjx.config import Cone, Physics, Solver
from petmjx.world.model import CARRIER_NAME, FLOOR_NAME, add_pair, box_name, skin_of

FLOOR_GEOM, CARRIER_GEOM, FIRST_BOX_GEOM = 0, 1, 2
WORLD_BODY, CARRIER_BODY, FIRST_BOX_BODY = 0, 1, 2

FLOAT32_TOLERANCE = 1e-6
"""Smallest relative solver tolerance: float32 does not resolve MuJoCo's 1e-8, which would only cost iterations."""

MAX_ITERATIONS = 100
"""MuJoCo's default limit of solver iterations."""

LINE_SEARCH_ITERATIONS = 50
"""MuJoCo's default limit of a line search."""

PARKING_HEIGHT_M = 50.0
PARKING_PITCH_M = 8.0
"""Boxes that are not placed yet hang in a row this high and this far apart: no two bounding spheres meet
(the largest BED-BPP item is under 1 m), and float32 still resolves their positions to 0.05 mm."""


def padded_template(
    capacity: int,
    physics: Physics,
    *,
    held: bool,
    solver: Solver,
    tolerance: float,
    iterations: int,
    line_search_iterations: int,
) -> mujoco.MjModel:
    """Compile the template: floor, carrier, ``capacity`` boxes; nominal sizes that overrides replace.

    Args:
        held: the carrier has no joint (prescribed-acceleration profiles) instead of a free one.
    """
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep = physics.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON if solver is Solver.NEWTON else mujoco.mjtSolver.mjSOL_CG
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if physics.cone is Cone.ELLIPTIC else mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.impratio = physics.impratio
    option.gravity = (0.0, 0.0, -physics.gravity_m_s2)
    option.tolerance = tolerance
    option.iterations = iterations
    option.ls_iterations = line_search_iterations
    contact: dict[str, Any] = {"solref": physics.solref, "solimp": (*physics.solimp, 0.5, 2.0)}
    declared = physics.has_own_friction
    if declared:
        contact |= {"contype": 0, "conaffinity": 0}
    spec.worldbody.add_geom(
        name=FLOOR_NAME,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0, 0, 1),
        pos=(0, 0, physics.floor_z_m),
        friction=physics.floor_friction,
        **contact,
    )

    frictions = {FLOOR_NAME: physics.floor_friction}

    def add_box(
        name: str, half: tuple[float, float, float], pos: tuple[float, float, float], mass: float, free: bool
    ) -> None:
        body = spec.worldbody.add_body(pos=pos)
        if free:
            body.add_freejoint()
        else:
            body.mocap = True  # stands where its world's data say
        # An explicit inertial keeps the inertia frame aligned with the box: MuJoCo would otherwise sort the
        # principal axes, and the per-world diagonals could not be written in box order.
        body.explicitinertial = True
        body.mass = mass
        body.inertia = [mass / 3 * (half[1] ** 2 + half[2] ** 2) for _ in range(3)]
        body.ipos = (0, 0, 0)
        body.iquat = (1, 0, 0, 0)
        skin = skin_of(physics, name)
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[each + skin for each in half],
            margin=-skin,
            friction=physics.box_friction,
            **contact,
        )
        if declared:
            for other, friction in frictions.items():
                if free or other != FLOOR_NAME:
                    add_pair(spec, physics, (other, name), (friction, physics.box_friction))
        frictions[name] = physics.box_friction

    carrier_half = (0.4, 0.3, physics.carrier_half_height_m)
    add_box(CARRIER_NAME, carrier_half, (0.0, 0.0, PARKING_HEIGHT_M), physics.carrier_mass_kg, not held)
    for k in range(capacity):
        add_box(box_name(k), (0.15, 0.15, 0.1), (PARKING_PITCH_M * (k + 1), 0.0, PARKING_HEIGHT_M), 5.0, True)
    return spec.compile()


def parked_positions(capacity: int) -> Float[Array, "box 3"]:
    """Where boxes of a lane wait for their turn, m."""
    x = PARKING_PITCH_M * jnp.arange(1, capacity + 1)
    return jnp.stack([x, jnp.zeros(capacity), jnp.full(capacity, PARKING_HEIGHT_M)], axis=-1)


def _box_inertia(half: Float[Array, "lane body 3"], mass: Float[Array, "lane body"]) -> Float[Array, "lane body 3"]:
    """Principal moments of solid boxes in box order: m/3 · (b² + c²) for half extents a, b, c."""
    squares = half**2
    return mass[..., None] / 3 * (squares.sum(-1, keepdims=True) - squares)


def override_fields(
    half: Float[Array, "lane box 3"],
    mass: Float[Array, "lane box"],
    carrier_half: Float[Array, "lane 3"],
    carrier_mass: Float[Array, " lane"],
    friction: Float[Array, "lane 3 3"],
    base: Any,
    *,
    held: bool,
    physics: Physics,
) -> dict[str, Float[Array, "lane ..."]]:
    """Per-world model fields, keyed as ``Model.tree_replace`` takes them.

    ``friction`` rows are floor, carrier, box. ``physics`` says by how much geoms are larger than boxes. ``base`` is the
    template's MJX model, whose values stand for what no world changes (the world body, the floor). Derived fields
    follow MuJoCo's compiler: ``body_invweight0`` and ``dof_invweight0`` of a free body are 1/m and the mean of 1/I;
    ``geom_rbound`` is the half diagonal; all are checked against it in tests.
    """
    lanes, capacity = mass.shape
    all_half = jnp.concatenate([carrier_half[:, None], half], axis=1)
    geom_half = all_half + jnp.array([physics.carrier_skin_m] + [physics.skin_m] * capacity)[None, :, None]
    all_mass = jnp.concatenate([carrier_mass[:, None], mass], axis=1)
    inertia = _box_inertia(all_half, all_mass)
    inv_translation = 1 / all_mass
    inv_rotation = (1 / inertia).mean(-1)
    if held:
        inv_translation = inv_translation.at[:, 0].set(0.0)
        inv_rotation = inv_rotation.at[:, 0].set(0.0)

    def with_world_body(values: Float[Array, "lane body *k"]) -> Float[Array, "lane body+1 *k"]:
        return jnp.concatenate([jnp.zeros((lanes, 1, *values.shape[2:])), values], axis=1)

    def with_floor(values: Float[Array, "lane body *k"], name: str) -> Float[Array, "lane body+1 *k"]:
        floor = jnp.broadcast_to(getattr(base, name)[FLOOR_GEOM], (lanes, 1, *values.shape[2:]))
        return jnp.concatenate([floor, values], axis=1)

    free = slice(1, None) if held else slice(None)
    dof = jnp.stack([inv_translation, inv_rotation], axis=-1)[:, free]
    fields = {
        "body_mass": with_world_body(all_mass),
        "body_inertia": with_world_body(inertia),
        "body_subtreemass": jnp.concatenate([all_mass.sum(1, keepdims=True), all_mass], axis=1),
        "body_invweight0": with_world_body(jnp.stack([inv_translation, inv_rotation], axis=-1)),
        "dof_invweight0": jnp.repeat(dof, 3, axis=-1).reshape(lanes, -1),
        "geom_size": with_floor(geom_half, "geom_size"),
        "geom_rbound": with_floor(jnp.sqrt((geom_half**2).sum(-1)), "geom_rbound"),
        "geom_aabb": with_floor(jnp.concatenate([jnp.zeros_like(geom_half), geom_half], axis=-1), "geom_aabb"),
        "geom_friction": jnp.concatenate(
            [friction[:, :2], jnp.broadcast_to(friction[:, 2:], (lanes, capacity, 3))], axis=1
        ),
    }
    if getattr(base, "npair", 0):
        partners = jnp.maximum(fields["geom_friction"][:, base.pair_geom1], fields["geom_friction"][:, base.pair_geom2])
        fields["pair_friction"] = partners[..., jnp.array([0, 0, 1, 2, 2])]
    return fields
