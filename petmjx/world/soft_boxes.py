"""Soft boxes: boxes as MuJoCo flex bodies of 3 × 3 × 3 points. Tetrahedra (elements) fill the space between the points.
Equality constraints keep the lengths of the tetrahedra's edges.

MuJoCo 3.17 does not allow elasticity in addition to these constraints, so the constraints act as springs. At rest, a
constraint of impedance d and stiffness k (``solref`` −k, −b) is a spring of stiffness κ·μ. Here κ = d²k / (1 − d), and
μ = 1 / (1/m₁ + 1/m₂) is the reduced mass of the edge's two points. The stiffness of the whole box between two plates is
then κ·c, where c follows from the places and masses of the points (``_network_kg``). So a box of stiffness S needs
κ = S / c.

Along each axis, the points' masses are in the proportion 1 : 4 : 1. These are the weights of Simpson's rule. With such
masses, three points have the moments of inertia of a solid box. The stiffness of an edge is proportional to the mass of
its points. So a box of length L also resists tilting like a bed of springs, with the rotational stiffness S·L²/12, and
its own weight compresses it evenly.

MuJoCo gives each element one contact point. On a flat face, an element's contact point jumps from step to step, and
boxes tremble. So each point of a box also has a ball, and contacts of elements begin at a smaller distance than
contacts of balls. Flat faces therefore rest on balls. Elements carry load only where two edges cross.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics, Triple
from petmjx.world.contact_laws import MOST_IMPEDANCE
from petmjx.world.history import CARRIER
from petmjx.world.rotation import rotations
from petmjx.world.scene import IDENTITY_QUAT, Scene
from petmjx.world.surface_pairs import NOT_GIVEN, filled_up

POINTS: Final = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
"""(27, 3) the points of a box whose half sizes are 1."""

ROUNDING_M: Final = 0.001
"""Radius of a box's rounded edges and corners, m. The balls (spheres for contacts) at the points of a box have the same
radius. Without rounding, faces would overlap, and MuJoCo's collider finds no good normals for overlapping faces."""

BALL_M: Final = 0.0002
"""Depth of an element (tetrahedron) in another body, m, at which a contact of the element begins. A contact of a ball
begins at depth 0. ``BALL_M`` is larger than the depth of contacts at rest. MuJoCo adds the margins of the two shapes
that touch: the margin of elements and rigid shapes is minus half of ``BALL_M``, and the margin of balls is plus half of
``BALL_M``."""

MOST_ROUNDING: Final = 0.1
"""Largest radius of rounded edges, as a share of the box's shortest half size."""

IMPEDANCE: Final = 0.99
"""Impedance of the constraints along the edges of elements. With an impedance of 0.95, a box of the same stiffness
trembles four times as much. With an impedance of 0.999, the box takes 0.1 s to give way under a load."""

MOST_RATE: Final = 0.05
"""Largest k·dt² of an edge, where k is the stiffness of the edge's constraint and dt the timestep. MuJoCo integrates
constraints explicitly, so a stiffer edge might be unstable. If a box is stiffer than the largest k allows, the
impedance of the edges' constraints is increased instead."""

CONTACT_SOLREF: Final = (0.004, 1.0)
CONTACT_SOLIMP: Final = (MOST_IMPEDANCE, MOST_IMPEDANCE, 0.001)
"""``solref`` and ``solimp`` of contacts of soft boxes. In MuJoCo, contacts of light bodies are soft, and the lightest
points have only a 216th of the mass of a box. So contacts of soft boxes are made as stiff as the timestep allows. If a
load of 1,000 times a box's own weight presses on the box, its contacts are 0.1 mm deep."""

_ALONE: Final = 1e9
"""Weight (``solmix``) of soft boxes when MuJoCo mixes the contact laws of the two shapes that touch. Rigid shapes have
the weight 1, so the law of the soft box prevails."""

_ELEMENTS: Final = 2
_BALLS: Final = 4
"""Bits of MuJoCo's collision filter. Elements can touch elements, balls and rigid shapes. Balls cannot touch balls."""


@lru_cache(maxsize=1)
def tetrahedra() -> NDArray[np.intp]:
    """(40, 4) numbers of the points of each element. The points form eight cells of five elements each. The elements of
    neighbouring cells are mirror images, so that a box does not twist when it is compressed."""
    elements = []
    for cell in product(range(2), repeat=3):
        corners = [tuple(np.add(cell, offset)) for offset in product(range(2), repeat=3)]
        even = [cell_corner for cell_corner in corners if sum(cell_corner) % 2 == 0]
        elements.append(even)
        for corner in corners:
            if corner not in even:
                elements.append(
                    [corner, *(neighbour for neighbour in even if np.abs(np.subtract(neighbour, corner)).sum() == 1)]
                )
    numbers = np.array(elements) @ np.array([9, 3, 1])
    for element in numbers:
        sides = POINTS[element[1:]] - POINTS[element[0]]
        if np.linalg.det(sides) < 0:
            element[:2] = element[1::-1]
    return np.asarray(numbers, np.intp)


@lru_cache(maxsize=1)
def _edges() -> NDArray[np.intp]:
    """(e, 2) numbers of the two points of each edge."""
    return np.unique(np.sort(np.concatenate([tetrahedra()[:, pair] for pair in combinations(range(4), 2)])), axis=0)


def rounding_m(half_size: FloatArray) -> float:
    """Radius of a box's rounded edges, m."""
    return min(ROUNDING_M, MOST_ROUNDING * float(half_size.min()))


def points_of(half_size: FloatArray) -> FloatArray:
    """(27, 3) places of a box's points, relative to the box's middle, m."""
    points_m: FloatArray = POINTS * (half_size - rounding_m(half_size))
    return points_m


def shares() -> FloatArray:
    """(27,) share of a box's mass that each point has: the weights of Simpson's rule."""
    along = np.array([1.0, 4.0, 1.0]) / 6.0
    return np.asarray(np.einsum("i,j,k->ijk", along, along, along).ravel())


def check_soft(scene: Scene) -> None:
    """Check that MuJoCo can simulate the soft boxes of a scene.

    Raises:
        InputError: MuJoCo cannot simulate the soft boxes.
    """
    if scene.soft is None:
        return
    if not scene.placing.appears:
        raise InputError("soft: soft boxes appear at their places, so placing must be exact")
    if scene.mass_center is not None and scene.mass_center[scene.soft].any():
        box = int(np.flatnonzero(scene.soft & scene.mass_center.any(axis=1))[0])
        raise InputError(f"soft: the centre of mass of a soft box must be in its middle, but that of box {box} is not")
    soft_friction(scene)


@dataclass(frozen=True)
class EdgeLaw:
    """``solref`` and ``solimp`` of the constraints along a box's edges."""

    solref: tuple[float, float]
    solimp: Triple


def edge_law(half_size: FloatArray, mass: float, stiffness_n_m: float, timestep_s: float) -> EdgeLaw:
    """The constraint law with which a box that is pressed between two plates acts like a spring of the given stiffness.
    If the stiffness is infinite, the box is as stiff as the timestep allows."""
    most = MOST_RATE / timestep_s**2
    kappa = _mujocos_share() * stiffness_n_m / (mass * _network_kg(*half_size.tolist()))
    impedance, rate = IMPEDANCE, min(kappa * (1 - IMPEDANCE) / IMPEDANCE**2, most)
    if rate == most:
        # this impedance solves kappa = most · impedance² / (1 − impedance)
        impedance = min(2 / (1 + (1 + 4 * most / kappa) ** 0.5), MOST_IMPEDANCE)
    return EdgeLaw((-rate, -2 * rate**0.5), (impedance, impedance, 0.001))


@lru_cache(maxsize=1)
def _mujocos_share() -> float:
    """Inverse mass that MuJoCo assigns to an edge, as a share of the summed inverse masses of the edge's two points.

    In MuJoCo 3.17, the share is 1/2 if the bodies of points have only slide joints, so that edges are twice as stiff as
    documented. The share is read from a compiled model, since a new version of MuJoCo may change it.
    """
    spec = mujoco.MjSpec()
    mass = shares()
    _add_points(spec, "probe", POINTS, mass)
    flex = _add_flex(spec, "probe")
    flex.radius = MOST_ROUNDING
    spec.add_equality(type=mujoco.mjtEq.mjEQ_FLEX, name1=flex.name)
    model = spec.compile()
    one, two = model.flex_edge[0]
    return float(model.flexedge_invweight0[0] / (1 / mass[one] + 1 / mass[two]))


@lru_cache(maxsize=4096)
def _network_kg(length: float, width: float, height: float) -> float:
    """The ratio c of a box's stiffness to κ (see the module's docstring), in kg, for a box of mass 1 kg between two
    plates that do not slip.

    Args:
        length, width, height: half sizes of the box, m.
    """
    points, mass, edges = points_of(np.array([length, width, height])), shares(), _edges()
    along = points[edges[:, 1]] - points[edges[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    spring = 1 / (1 / mass[edges]).sum(axis=1)
    jacobian = np.zeros((len(edges), len(points), 3))
    rows = np.arange(len(edges))
    jacobian[rows, edges[:, 1]], jacobian[rows, edges[:, 0]] = along, -along
    flat = jacobian.reshape(len(edges), -1)
    matrix = flat.T @ (spring[:, None] * flat)
    fixed = np.zeros((len(points), 3), bool)
    fixed[POINTS[:, 2] != 0] = True
    down = np.zeros((len(points), 3))
    down[POINTS[:, 2] > 0, 2] = -1.0
    free, moved = ~fixed.ravel(), down.ravel()
    moved[free] = np.linalg.solve(matrix[np.ix_(free, free)], -(matrix @ moved)[free])
    return float(moved @ matrix @ moved)


def point_name(box: str, point: int) -> str:
    """Name of the MuJoCo body for one point of a box."""
    return f"{box}_point_{point}"


def _add_points(spec: mujoco.MjSpec, box: str, places: FloatArray, mass: FloatArray) -> list[mujoco.MjsBody]:
    """Append a body for each point of a box to the bodies of ``spec``. Each body has three slide joints."""
    bodies = []
    for number, place in enumerate(places):
        body = spec.worldbody.add_body(name=point_name(box, number), pos=place)
        body.explicitinertial = True
        body.mass = mass[number]
        body.ipos, body.iquat = np.zeros(3), np.array(IDENTITY_QUAT)
        body.inertia = np.full(3, mass[number] * ROUNDING_M**2)  # the value has no effect, since the body cannot rotate
        for axis in np.eye(3):
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        bodies.append(body)
    return bodies


def _add_flex(spec: mujoco.MjSpec, box: str) -> mujoco.MjsFlex:
    flex = spec.add_flex(name=box)
    flex.dim = 3
    flex.vertbody = [point_name(box, number) for number in range(len(POINTS))]
    flex.elem = tetrahedra().ravel().tolist()
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE
    return flex


def add_soft_box(
    spec: mujoco.MjSpec, scene: Scene, physics: Physics, box: int, friction: Triple, rgba: Sequence[float]
) -> None:
    """Add a soft box to a MuJoCo model, at the box's release place. The box becomes 27 bodies with three slide joints
    each, which follow all bodies that ``spec`` has so far."""
    half, name = scene.half_size[box], f"box_{box}"
    (turn,) = rotations(scene.start_quat[box, None])
    places = scene.start_pos[box] + points_of(half) @ turn.T
    radius = rounding_m(half)
    for number, body in enumerate(_add_points(spec, name, places, float(scene.mass[box]) * shares())):
        if POINTS[number].any():
            ball = body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], rgba=rgba)
            ball.contype, ball.conaffinity = _BALLS, 0
            ball.margin = BALL_M / 2
            _set_contact(ball, friction)
    flex = _add_flex(spec, name)
    flex.radius, flex.margin = radius, -BALL_M / 2
    flex.rgba = np.array(rgba)
    flex.contype, flex.conaffinity = _ELEMENTS, _ELEMENTS | _BALLS
    _set_contact(flex, friction)
    stiffness = np.inf if scene.stiffness is None else float(scene.stiffness[box])
    law = edge_law(half, float(scene.mass[box]), stiffness, physics.timestep_s)
    edge_lengths = spec.add_equality(type=mujoco.mjtEq.mjEQ_FLEX, name1=flex.name)
    edge_lengths.active = True
    edge_lengths.solref = np.array(law.solref)
    edge_lengths.solimp[:3] = law.solimp


def _set_contact(shape: mujoco.MjsGeom | mujoco.MjsFlex, friction: Triple) -> None:
    """Set the contact law of soft boxes, which does not depend on the physics. If two shapes touch, MuJoCo takes the
    mean of their laws, weighted with their ``solmix``."""
    shape.condim = 3
    shape.friction = np.array(friction)
    shape.solref, shape.solmix = np.array(CONTACT_SOLREF), _ALONE
    shape.solimp[:3] = CONTACT_SOLIMP


def set_for_soft(spec: mujoco.MjSpec, scene: Scene, physics: Physics, frictions: SoftFriction) -> None:
    """Set margin, friction and collision filter of the rigid shapes in a world with soft boxes, after all boxes are
    added."""
    for geom in spec.geoms:
        if geom.contype == _BALLS:
            continue
        geom.conaffinity |= _ELEMENTS | _BALLS
        sliding = frictions.of_geom(geom.parent.name)
        # The values set here do not act between two rigid shapes: rigid shapes touch only as declared pairs, which have
        # their own values.
        if physics.has_own_friction:
            geom.margin -= BALL_M / 2
            geom.friction[0] = geom.friction[0] if sliding is None else sliding


@dataclass(frozen=True, eq=False)
class SoftFriction:
    """Coefficients of sliding friction for contacts with soft boxes. In a contact, MuJoCo uses the larger coefficient
    of the two shapes that touch.

    Attributes:
        of_boxes: (n,) coefficients of the boxes.
        of_carrier: coefficient of the carrier. If ``of_carrier`` is None, each board keeps its own coefficient.
    """

    of_boxes: FloatArray
    of_carrier: float | None

    def of_geom(self, body: str) -> float | None:
        """Coefficient of sliding friction of the geoms of the body with this name. If the result is None, each geom
        keeps its own coefficient."""
        if body == "carrier":
            return self.of_carrier
        return float(self.of_boxes[int(body.removeprefix("box_"))]) if body.startswith("box_") else None


def soft_friction(scene: Scene) -> SoftFriction:
    """Friction coefficients of boxes and carrier. With the returned coefficients, each contact of a soft box has the
    friction that the scene's table lists for the two surfaces that touch.

    Raises:
        InputError: MuJoCo would use another coefficient than the table for some pair of surfaces. For soft boxes,
            MuJoCo always uses the larger of the coefficients of the two surfaces.
    """
    box_friction = scene.friction[:, 0].copy()
    if "friction" not in scene.pairs or scene.surface is None or scene.soft is None:
        return SoftFriction(box_friction, None)
    table, surface = filled_up(scene.pairs, "friction"), scene.surface
    shapes = scene.shapes
    boards = np.flatnonzero(shapes.body == CARRIER)
    soft = np.flatnonzero(scene.soft)
    alike = table[surface, surface]
    box_friction = np.where(alike == NOT_GIVEN, box_friction, alike)
    with_boards = table[np.ix_(surface[soft], shapes.surface[boards])]
    bare = with_boards == NOT_GIVEN
    board_friction = np.where(bare, np.maximum(box_friction[soft][:, None], shapes.friction[boards, 0]), with_boards)
    of_carrier = float(np.where(board_friction > box_friction[soft][:, None] + 1e-9, board_friction, 0.0).max())
    pair_friction = table[np.ix_(surface[soft], surface)]
    pair_friction = np.where(
        pair_friction == NOT_GIVEN, np.maximum(scene.friction[soft, 0][:, None], scene.friction[:, 0]), pair_friction
    )
    np.putmask(pair_friction, np.arange(scene.n_boxes) == soft[:, None], box_friction[soft])
    larger = np.maximum(box_friction[soft][:, None], box_friction), np.maximum(box_friction[soft], of_carrier)[:, None]
    if not (np.allclose(larger[0], pair_friction) and np.allclose(larger[1], board_friction)):
        raise InputError(
            "soft: between soft boxes, MuJoCo always uses the larger of their coefficients of friction, but some pairs "
            "of these materials have a smaller one: leave materials out, or set other friction_pairs"
        )
    return SoftFriction(box_friction, of_carrier)
