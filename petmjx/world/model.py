"""The exact MuJoCo model of one scene. The engine ``mujoco`` steps it, and ``petmjx export`` writes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from petmjx.config import Cone, Physics, Triple
from petmjx.units import FloatArray
from petmjx.world.scene import IDENTITY_QUAT, Scene

FLOOR_NAME = "floor"
CARRIER_NAME = "carrier"

_CONE = {Cone.PYRAMIDAL: mujoco.mjtCone.mjCONE_PYRAMIDAL, Cone.ELLIPTIC: mujoco.mjtCone.mjCONE_ELLIPTIC}

_SOLIMP_TAIL = (0.5, 2.0)
"""MuJoCo's defaults for the last two solimp numbers. The reference implementation does not change them."""

_BOX_COLOURS = ((0.80, 0.65, 0.45, 1.0), (0.70, 0.52, 0.35, 1.0), (0.88, 0.76, 0.58, 1.0))
"""Cardboard in three shades, so that a viewer shows where one box ends and the next begins."""


@dataclass(frozen=True, eq=False)
class HeldCarrier:
    """The pose at which a carrier is clamped, as a static body. pos (3,) m, quat (4,) (w, x, y, z)."""

    pos: FloatArray
    quat: FloatArray


def box_name(box: int) -> str:
    """Body name of a box, by packing order from 0."""
    return f"box_{box}"


def build_spec(
    scene: Scene, physics: Physics, held_carrier: HeldCarrier | None = None, n_boxes: int | None = None
) -> mujoco.MjSpec:
    """The exact, unpadded model of a scene (docs/rules.md, section 1).

    Bodies in order: world (with the floor), carrier, box_0, box_1, …. A free carrier has the first free joint (qpos
    0…6, qvel 0…5); the boxes' joints follow in the same order. Initial positions are the release poses.

    Args:
        held_carrier: clamp the carrier at this pose instead of giving it a free joint.
        n_boxes: build only the first boxes in packing order; all of them when None.

    Raises:
        ValueError: ``n_boxes`` is not in 0…scene.n_boxes.
    """
    count = scene.n_boxes if n_boxes is None else n_boxes
    if not 0 <= count <= scene.n_boxes:
        raise ValueError(f"n_boxes must be 0…{scene.n_boxes}, got {count}")
    spec = mujoco.MjSpec()
    _set_options(spec, physics)
    _add_box_body(
        spec,
        CARRIER_NAME,
        pos=scene.carrier_pos if held_carrier is None else held_carrier.pos,
        quat=np.array(IDENTITY_QUAT) if held_carrier is None else held_carrier.quat,
        half_size=scene.carrier_half_size,
        mass=scene.carrier_mass,
        friction=scene.carrier_friction,
        physics=physics,
        rgba=(0.45, 0.32, 0.20, 1.0),
        free=held_carrier is None,
    )
    _add_geom(
        spec.worldbody,
        FLOOR_NAME,
        mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0.0, 0.0, 0.1),
        friction=scene.floor_friction,
        physics=physics,
        rgba=(0.55, 0.57, 0.60, 1.0),
        pos=(0.0, 0.0, scene.floor_z),
    )
    if held_carrier is None:
        add_pair(spec, physics, (FLOOR_NAME, CARRIER_NAME), (scene.floor_friction, scene.carrier_friction))
    add_boxes(spec, scene, physics, range(count))
    return spec


def add_boxes(
    spec: mujoco.MjSpec, scene: Scene, physics: Physics, boxes: Sequence[int], before: Sequence[int] = ()
) -> None:
    """Add boxes, whose bodies then have this order, to a spec that already holds those before them."""
    others: dict[str, dict[str, Any]] = {}
    if physics.has_own_friction:
        for other, friction in ((FLOOR_NAME, scene.floor_friction), (CARRIER_NAME, scene.carrier_friction)):
            others[other] = _pair_values(physics, (other, box_name(0)), (friction, scene.box_friction))
        among = _pair_values(physics, (box_name(0), box_name(1)), (scene.box_friction, scene.box_friction))
        others |= {box_name(box): among for box in before}
    for box in boxes:
        _add_box_body(
            spec,
            box_name(box),
            pos=scene.start_pos[box],
            quat=scene.start_quat[box],
            half_size=scene.half_size[box],
            mass=float(scene.mass[box]),
            friction=scene.box_friction,
            physics=physics,
            rgba=_BOX_COLOURS[box % len(_BOX_COLOURS)],
        )
        for other, values in others.items():
            spec.add_pair(geomname1=other, geomname2=box_name(box), **values)
        if physics.has_own_friction:
            others[box_name(box)] = among


def add_pair(spec: mujoco.MjSpec, physics: Physics, names: tuple[str, str], frictions: tuple[Triple, Triple]) -> None:
    """Declare that two geoms touch, if their friction has a time constant of its own: MuJoCo gives it to declared pairs
    only. All else is what it would be without: MuJoCo takes the larger friction of two geoms.

    Args:
        names: of the geoms.
        frictions: of the geoms: sliding, torsional and rolling coefficients.
    """
    if not physics.has_own_friction:
        return
    spec.add_pair(geomname1=names[0], geomname2=names[1], **_pair_values(physics, names, frictions))


def _pair_values(physics: Physics, names: tuple[str, str], frictions: tuple[Triple, Triple]) -> dict[str, Any]:
    sliding, torsional, rolling = map(max, *frictions)
    return {
        "margin": -sum(skin_of(physics, name) for name in names),
        "friction": [sliding, sliding, torsional, rolling, rolling],
        "solref": physics.solref,
        "solreffriction": physics.solreffriction,
        "solimp": physics.solimp + _SOLIMP_TAIL,
    }


def skin_of(physics: Physics, name: str) -> float:
    """By how much the geom of this name is larger than what it stands for, on each side, m: the floor not at all, the
    carrier twice as much as boxes (docs/rules.md)."""
    if name == FLOOR_NAME:
        return 0.0
    return physics.carrier_skin_m if name == CARRIER_NAME else physics.skin_m


def to_mjcf(scene: Scene, physics: Physics) -> str:
    """The scene as MJCF text for MuJoCo's viewer, with every box at its release pose."""
    spec = build_spec(scene, physics)
    spec.modelname = "petmjx"
    spec.worldbody.add_light(pos=[0.0, 0.0, 4.0], dir=[0.0, 0.0, -1.0])
    spec.compile()
    return str(spec.to_xml())


def _set_options(spec: mujoco.MjSpec, physics: Physics) -> None:
    option = spec.option
    option.timestep = physics.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = _CONE[physics.cone]
    option.impratio = physics.impratio
    option.gravity = np.array([0.0, 0.0, -physics.gravity_m_s2])


def _add_box_body(
    spec: mujoco.MjSpec,
    name: str,
    *,
    pos: FloatArray,
    quat: FloatArray,
    half_size: FloatArray,
    mass: float,
    friction: Triple,
    physics: Physics,
    rgba: tuple[float, float, float, float],
    free: bool = True,
) -> None:
    body = spec.worldbody.add_body(name=name, pos=pos, quat=quat)
    if free:
        body.add_freejoint(name=name)
    length, width, height = (float(half) for half in half_size)
    if min(length, width, height) <= 0:
        raise ValueError(f"half sizes must be positive, got {half_size.tolist()} m for {name}")
    geom = _add_geom(
        body,
        name,
        mujoco.mjtGeom.mjGEOM_BOX,
        size=(length, width, height),
        friction=friction,
        physics=physics,
        rgba=rgba,
    )
    geom.mass = mass
    if physics.skin_m:
        _add_skin(body, geom, skin_of(physics, name))


def _add_skin(body: mujoco.MjsBody, geom: mujoco.MjsGeom, skin_m: float) -> None:
    """Make a body's box larger on all sides, and its contacts begin as deep as the skins of both partners are thick:
    those of faces where the boxes themselves touch, those of edges and corners up to √2 − 1 and √3 − 1 skins before.
    Its mass and inertia stay.

    MuJoCo's collider takes the contact of two edges, one point, instead of a face's if it is less deep by 5 % (3.17:
    ``engine_collision_box.c``). At the depth of a contact, a tenth of a millimetre, it takes now the one and now the
    other, and pallets tremble. With a skin faces and edges are both deeper by as much (docs/validation.md).
    """
    size = np.array(geom.size)
    squares = size**2
    body.explicitinertial = True
    body.mass = geom.mass
    body.ipos, body.iquat = np.zeros(3), np.array(IDENTITY_QUAT)
    body.inertia = geom.mass / 3 * (squares.sum() - squares)
    geom.size = size + skin_m
    geom.margin = -skin_m


def _add_geom(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    *,
    size: Triple,
    friction: Triple,
    physics: Physics,
    rgba: tuple[float, float, float, float],
    pos: Triple = (0.0, 0.0, 0.0),
) -> mujoco.MjsGeom:
    geom = body.add_geom(name=name, type=kind, size=size, pos=pos, rgba=rgba)
    geom.friction = np.array(friction)
    geom.solref = np.array(physics.solref)
    geom.solimp = np.array(physics.solimp + _SOLIMP_TAIL)
    if physics.has_own_friction:
        geom.contype = geom.conaffinity = 0  # touches what it is declared to touch (add_pair), and that only once
    return geom
