"""The MuJoCo model of a scene. The engine ``mujoco`` simulates this model, and ``petmjx export`` writes it as text. The
MJX engines use a version with additional, unused bodies.

Boxes are rigid bodies, or flex bodies (soft bodies of MuJoCo).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.physics import Cone, Physics, Triple
from petmjx.world.compliance import Face, compliances, law_between
from petmjx.world.history import CARRIER, FLOOR
from petmjx.world.scene import IDENTITY_QUAT, Scene
from petmjx.world.soft_boxes import add_soft_box, check_soft, set_for_soft, soft_friction
from petmjx.world.surface_pairs import NOT_GIVEN, Pairs, filled_up

FLOOR_NAME = "floor"
CARRIER_NAME = "carrier"

_CONE = {Cone.PYRAMIDAL: mujoco.mjtCone.mjCONE_PYRAMIDAL, Cone.ELLIPTIC: mujoco.mjtCone.mjCONE_ELLIPTIC}

_SOLIMP_TAIL = (0.5, 2.0)
"""The last two numbers of ``solimp``: MuJoCo's defaults, which the reference implementation uses, too."""

BOX_COLOURS = ((0.80, 0.65, 0.45, 1.0), (0.70, 0.52, 0.35, 1.0), (0.88, 0.76, 0.58, 1.0))
"""Three shades of cardboard for boxes, so that neighbours can be told apart in a viewer."""

_WALL_OPACITY = 0.1
"""Opacity of a carrier's walls, so low that boxes behind them are visible."""

_CARRIER_COLOUR = (0.45, 0.32, 0.20, 1.0)
_FLOOR_COLOUR = (0.55, 0.57, 0.60, 1.0)


@dataclass(frozen=True, eq=False)
class HeldCarrier:
    """The pose in which a carrier is clamped.

    Attributes:
        pos: (3,) centre of mass of the carrier, m.
        quat: (4,) orientation of the carrier as a quaternion (w, x, y, z).
        mocap: whether the carrier is a mocap body of MuJoCo instead of a static body. The pose of a mocap body is part
            of a world's data, not of the model, so that worlds with different poses can share a model.
    """

    pos: FloatArray
    quat: FloatArray
    mocap: bool = False


def box_name(box: int) -> str:
    """Name of a box's body and of its geom. ``box`` is the number of the box in packing order, from 0."""
    return f"box_{box}"


def build_spec(
    scene: Scene, physics: Physics, held_carrier: HeldCarrier | None = None, n_boxes: int | None = None
) -> mujoco.MjSpec:
    """The exact model of a scene, without unused bodies (docs/rules.md, section 1).

    Bodies are in this order: world (with the floor), carrier, box_0, box_1, … A carrier that is not clamped has the
    first free joint (qpos 0…6, qvel 0…5). The boxes' free joints follow in the order of boxes. The initial poses are
    the poses of the boxes at release. The geoms are the floor, and then the scene's shapes, body after body;
    ``geom_bodies`` returns the body of each geom.

    Args:
        scene: the scene.
        physics: the physics.
        held_carrier: pose in which the carrier is clamped. If ``held_carrier`` is None, the carrier has a free joint.
        n_boxes: the model has this number of boxes, the first ones in packing order. If ``n_boxes`` is None, the model
            has all boxes.

    Raises:
        ValueError: ``n_boxes`` is not between 0 and the number of the scene's boxes.
    """
    count = scene.n_boxes if n_boxes is None else n_boxes
    if not 0 <= count <= scene.n_boxes:
        raise ValueError(f"n_boxes must be 0…{scene.n_boxes}, got {count}")
    spec = mujoco.MjSpec()
    _set_options(spec, physics)
    carrier = scene.carrier
    pose = (carrier.pos, IDENTITY_QUAT) if held_carrier is None else (held_carrier.pos, held_carrier.quat)
    body = spec.worldbody.add_body(name=CARRIER_NAME, pos=pose[0], quat=pose[1])
    if held_carrier is None:
        body.add_freejoint(name=CARRIER_NAME)
    else:
        body.mocap = held_carrier.mocap
    _add_shapes(body, scene, physics, CARRIER, _CARRIER_COLOUR)
    _set_inertia(body, scene, physics, CARRIER)
    _add_geom(
        spec.worldbody,
        FLOOR_NAME,
        mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0.0, 0.0, 0.1),
        friction=scene.floor_friction,
        physics=physics,
        rgba=_FLOOR_COLOUR,
        pos=(0.0, 0.0, scene.floor_z),
    )
    if held_carrier is None:
        of_body = _partners(scene, physics)
        _declare_pairs(spec, physics, scene.pairs, of_body[FLOOR], of_body[CARRIER])
    add_boxes(spec, scene, physics, range(count), held=held_carrier is not None)
    return spec


def add_boxes(
    spec: mujoco.MjSpec,
    scene: Scene,
    physics: Physics,
    boxes: Sequence[int],
    before: Sequence[int] = (),
    held: bool = False,
) -> None:
    """Add the bodies of ``boxes``, in this order, to a spec that already has the boxes ``before``.

    ``held`` is True if the carrier is clamped.
    """
    frames, of_body = scene.frames(scene.start_pos, scene.start_quat), _partners(scene, physics, held)
    partner_shapes = [shape for body in (FLOOR, CARRIER, *before) for shape in of_body[body]]
    for box in boxes:
        body = spec.worldbody.add_body(name=box_name(box), pos=frames[box], quat=scene.start_quat[box])
        body.add_freejoint(name=box_name(box))
        _add_shapes(body, scene, physics, box, BOX_COLOURS[box % len(BOX_COLOURS)])
        _set_inertia(body, scene, physics, box)
        _declare_pairs(spec, physics, scene.pairs, partner_shapes, of_body[box])
        partner_shapes += of_body[box]


def geom_bodies(model: mujoco.MjModel, boxes: Sequence[int] | NDArray[np.integer]) -> NDArray[np.intp]:
    """(ngeom,) the body to which each geom belongs: the number of a box, ``CARRIER`` or ``FLOOR``.

    Args:
        model: the compiled model.
        boxes: the numbers of the boxes, in the order of their bodies, which are the last bodies of the model.
    """
    of_body = np.full(model.nbody, CARRIER, np.intp)
    of_body[0] = FLOOR
    of_body[model.nbody - len(boxes) :] = boxes
    box_of_geom: NDArray[np.intp] = of_body[np.asarray(model.geom_bodyid)]
    return box_of_geom


def geom_surfaces(scene: Scene, bodies: NDArray[np.integer]) -> NDArray[np.intp]:
    """(ngeom,) surface number of each geom (petmjx/world/surface_pairs.py). ``bodies`` is the result of
    ``geom_bodies``."""
    surface = np.zeros(len(bodies), np.intp)
    if scene.surface is not None:
        surface[bodies >= 0] = scene.surface[bodies[bodies >= 0]]
    if scene.carrier.surface is not None:
        surface[bodies == CARRIER] = scene.carrier.surface
    return surface


def contact_values(
    physics: Physics,
    pairs: Pairs,
    friction: FloatArray,
    surface: NDArray[np.intp],
    one: NDArray[np.integer],
    two: NDArray[np.integer],
) -> dict[str, FloatArray]:
    """The values of contacts of rigid bodies: field of MuJoCo's pairs → a row per contact.

    A contact has the larger friction coefficient of its two geoms, unless the tables have one for their surfaces.

    Args:
        pairs: the tables of the scene.
        friction: (g, 3) sliding, torsional and rolling coefficients of g geoms.
        surface: (g,) surface number of each geom.
        one, two: (c,) the two geoms of each contact.
    """
    larger = np.maximum(friction[one], friction[two])
    of_pair = filled_up(pairs, "friction")[surface[one], surface[two]]
    sliding = np.where(of_pair == NOT_GIVEN, larger[:, 0], of_pair)
    of_all = {
        "solref": physics.solref,
        "solreffriction": physics.solreffriction,
        "solimp": physics.solimp + _SOLIMP_TAIL,
    }
    return {
        "friction": np.column_stack([sliding, sliding, larger[:, 1], larger[:, 2], larger[:, 2]]),
        **{name: np.broadcast_to(values, (len(one), len(values))) for name, values in of_all.items()},
    }


@dataclass(frozen=True)
class _Partner:
    """The properties of a geom that determine its contacts with other geoms."""

    name: str
    friction: Triple
    skin_m: float
    surface: int = 0
    face: Face | None = None
    """Properties of the geom's shape that determine how stiff its contacts are (petmjx/world/compliance.py). ``face``
    is None for the floor, and if the scene has no compliant boxes."""


def _declare_pairs(
    spec: mujoco.MjSpec,
    physics: Physics,
    pairs: Pairs,
    these: Sequence[_Partner],
    other_partners: Sequence[_Partner],
) -> None:
    """Declare a contact pair between each geom of ``these`` and each geom of ``other_partners``.

    In MuJoCo, the friction of a contact can have another time constant than the contact's pressure only if the pair of
    geoms is declared. If friction has no time constant of its own, no pairs are declared.
    """
    if not physics.has_own_friction:
        return
    partners = [*these, *other_partners]
    friction = np.array([partner.friction for partner in partners])
    surface = np.array([partner.surface for partner in partners])
    first, second = np.indices((len(these), len(other_partners))).reshape(2, -1)
    columns = contact_values(physics, pairs, friction, surface, first, len(these) + second)
    for (one, two), *row in zip(itertools.product(these, other_partners), *columns.values(), strict=True):
        values = dict(zip(columns, row, strict=True))
        if two.face is not None and (law := law_between(physics, two.face, one.face)) is not None:
            values["solref"], solimp = law
            values["solimp"] = solimp + _SOLIMP_TAIL
        spec.add_pair(geomname1=one.name, geomname2=two.name, margin=-(one.skin_m + two.skin_m), **values)


@lru_cache(maxsize=256)
def _partners(scene: Scene, physics: Physics, held: bool = False) -> dict[int, list[_Partner]]:
    """A dict with the geoms of each body and of the floor. The keys are the numbers of boxes, ``CARRIER`` and
    ``FLOOR``. ``held`` is True if the carrier is clamped."""
    partners = {FLOOR: [_Partner(FLOOR_NAME, scene.floor_friction, 0.0)], CARRIER: []}
    shapes = scene.shapes
    faces = _faces(scene, held)
    rows = zip(shapes.body.tolist(), shapes.friction.tolist(), shapes.surface.tolist(), faces, strict=True)
    for body, friction, surface, face in rows:
        skin_m = physics.carrier_skin_m if body == CARRIER else physics.skin_m
        name = CARRIER_NAME if body == CARRIER else box_name(body)
        partners.setdefault(body, []).append(_Partner(name, tuple(friction), skin_m, surface, face))
    for body, several in partners.items():
        if len(several) > 1:
            partners[body] = [
                replace(partner, name=f"{partner.name}_{number}") for number, partner in enumerate(several)
            ]
    return partners


def _faces(scene: Scene, held: bool) -> list[Face | None]:
    """The ``Face`` of each shape, which determines how stiff the shape's contacts are. If the scene has no compliant
    boxes, every entry is None."""
    if scene.stiffness is None:
        return [None] * len(scene.shapes.body)
    carrier, shapes = scene.carrier, scene.shapes
    # the last entry of each array is for CARRIER
    give = np.append(compliances(scene.stiffness, scene.half_size), 0.0)[shapes.body]
    inverse = np.append(1 / scene.mass, 0.0 if held else 1 / carrier.mass)[shapes.body]
    frame = np.vstack([scene.target - scene.middle, carrier.pos])[shapes.body]
    rows = zip(give.tolist(), (frame + shapes.pos).tolist(), shapes.half_size.tolist(), inverse.tolist(), strict=True)
    return [Face(compliance, tuple(middle), tuple(half), lightness) for compliance, middle, half, lightness in rows]


def _set_options(spec: mujoco.MjSpec, physics: Physics) -> None:
    option = spec.option
    option.timestep = physics.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = _CONE[physics.cone]
    option.impratio = physics.impratio
    option.gravity = np.array([0.0, 0.0, -physics.gravity_m_s2])


def _add_shapes(
    body: mujoco.MjsBody, scene: Scene, physics: Physics, number: int, rgba: tuple[float, float, float, float]
) -> None:
    """Add a body's shapes as geoms. Each geom is larger than its shape on all sides, by a thickness called skin.

    A contact of two geoms begins when the geoms overlap by the sum of their skins. For two faces, the contact begins
    when the shapes themselves touch. Contacts of edges begin earlier by up to √2 − 1 times the sum of the skins,
    contacts of corners by up to √3 − 1 times this sum.

    If two edges cross, MuJoCo's collider returns either the contact of the faces, or the single point at which the
    edges cross. The collider chooses the point if its depth is at least 5 % smaller than the depth of the faces (MuJoCo
    3.17, ``engine_collision_box.c``). At the usual depth of a tenth of a millimetre, the collider's choice changes from
    step to step, and pallets tremble. With skins, both depths are larger by the same amount, so the difference is below
    5 % (benchmarks/notebook/contacts.md).
    """
    shapes = scene.shapes
    walls = range(scene.carrier.n_boards, len(scene.carrier.half_size))
    for row, partner in zip(shapes.of(number), _partners(scene, physics)[number], strict=True):
        half_size = shapes.half_size[row]
        if not (half_size > 0).all():
            raise ValueError(f"half sizes must be positive, got {half_size.tolist()} m for {partner.name}")
        geom = _add_geom(
            body,
            partner.name,
            mujoco.mjtGeom.mjGEOM_BOX,
            size=half_size + partner.skin_m,
            friction=partner.friction,
            physics=physics,
            rgba=rgba if row not in walls else (*rgba[:3], _WALL_OPACITY),
            pos=shapes.pos[row],
        )
        if partner.skin_m:
            geom.margin = -partner.skin_m


def _set_inertia(body: mujoco.MjsBody, scene: Scene, physics: Physics, number: int) -> None:
    """Set the mass and the moments of inertia of a body.

    For a solid box whose geom is not larger than the box (``Physics.skin_m`` is 0), MuJoCo computes the moments, as in
    the reference implementation. MuJoCo's moments differ from petmjx's moments in the last digits.
    """
    mass = scene.carrier.mass if number == CARRIER else float(scene.mass[number])
    carrier = scene.carrier
    # Walls that are open still count for the mass and the centre of mass of a carrier. So even if a carrier has a
    # single shape, the shape may not be at the centre of mass.
    of_one = len(carrier.half_size) == 1 and not carrier.shape_pos.any()
    solid = scene.inertia_box is None and of_one and not scene.pieces
    if solid and scene.mass_center is None and not physics.skin_m:
        body.first_geom().mass = mass
        return
    squares = scene.inertia_boxes[number + 1] ** 2
    body.explicitinertial = True
    body.mass = mass
    body.ipos, body.iquat = np.zeros(3), np.array(IDENTITY_QUAT)
    body.inertia = mass / 3 * (squares.sum() - squares)


def _add_geom(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    *,
    size: Triple | FloatArray,
    friction: Triple,
    physics: Physics,
    rgba: tuple[float, float, float, float],
    pos: Triple | FloatArray,
) -> mujoco.MjsGeom:
    geom = body.add_geom(name=name, type=kind, size=size, pos=pos, rgba=rgba)
    geom.friction = np.array(friction)
    geom.solref = np.array(physics.solref)
    geom.solimp = np.array(physics.solimp + _SOLIMP_TAIL)
    if physics.has_own_friction:
        geom.contype = geom.conaffinity = 0  # only declared pairs of geoms collide (_declare_pairs)
    return geom


_MEMORY_BYTES = 1 << 24
"""Memory that MuJoCo reserves for each box, bytes. A face of a soft box can have a hundred contacts. The operating
system allocates only the used part of the memory."""


def soft_spec(
    scene: Scene, physics: Physics, held_carrier: HeldCarrier | None = None, n_boxes: int | None = None
) -> mujoco.MjSpec:
    """The model of ``build_spec``, in which each soft box is a flex body: 27 bodies instead of one.

    Raises:
        InputError: MuJoCo cannot simulate the soft boxes.
    """
    check_soft(scene)
    count = scene.n_boxes if n_boxes is None else n_boxes
    spec, frictions = build_spec(scene, physics, held_carrier, n_boxes=0), soft_friction(scene)
    rigid: list[int] = []
    for box in range(count):
        if scene.soft is not None and scene.soft[box]:
            sliding, *other_frictions = scene.friction[box].tolist()
            sliding = float(frictions.of_boxes[box])
            rgba = BOX_COLOURS[box % len(BOX_COLOURS)]
            add_soft_box(spec, scene, physics, box, (sliding, other_frictions[0], other_frictions[1]), rgba)
        else:
            add_boxes(spec, scene, physics, [box], before=rigid, held=held_carrier is not None)
            rigid.append(box)
    set_for_soft(spec, scene, physics, frictions)
    spec.memory = _MEMORY_BYTES * (1 + count)
    return spec


def to_mjcf(scene: Scene, physics: Physics) -> str:
    """The model of a scene as MJCF text for MuJoCo's viewer, with every box at its pose of release."""
    spec = build_spec(scene, physics) if scene.soft is None else soft_spec(scene, physics)
    spec.modelname = "petmjx"
    spec.worldbody.add_light(pos=[0.0, 0.0, 4.0], dir=[0.0, 0.0, -1.0])
    spec.compile()
    return str(spec.to_xml())
