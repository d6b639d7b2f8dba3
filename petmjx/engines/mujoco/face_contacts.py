"""Contacts between faces of compliant boxes, computed as beds of springs and written into MuJoCo's data.

The law of the springs is in petmjx/world/compliance.py.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics
from petmjx.world.compliance import (
    EDGE_SHARE,
    FACE_COSINE,
    LEAST_SHARE,
    OUTWARD,
    POINTS_PER_BED,
    compliances,
    spring_laws,
)
from petmjx.world.scene import Scene

PARALLEL: Final = 1e-6
"""Two edges count as parallel if the sine of the angle between them is below this value. The distance of parallel edges
is measured at their middles."""

_LEVEL: Final = 1e-12
"""Smallest slope of the depth over the pressed area. With a smaller slope, the depth counts as the same at all points
of the area."""

_FAR_M: Final = 1e3
"""Assumed distance, m, from the middle of the pressed area to the line on which the depth is 0, if the depth is the
same at all points of the area."""

_LEAST_MOMENT_M2: Final = 1e-18
"""Smallest second moment of the pressed area, divided by the area, m². With a smaller moment, the area counts as a
line."""

_TRUE: Final = np.ones(1, bool)
_Y: Final = np.array([0.0, 1.0, 0.0])
_Z: Final = np.array([0.0, 0.0, 1.0])
_EAST: Final = np.array([1.0, 0.0, 0.0])
_NEXT: Final = [1, 2, 0]
_LAST: Final = [2, 0, 1]
_FACES: Final = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])
"""One row per axis of a box. The first number is the axis, which is the normal of a face. The other two numbers are the
axes along the edges of this face."""
_SIGNS: Final = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
_ASIDE: Final = np.array([1.0, -1.0])
_WAYS: Final = np.array([-1.0, 1.0])
_LATER: Final = np.tri(9, k=-1, dtype=bool)
_FIELDS: Final = (
    "dist",
    "pos",
    "frame",
    "includemargin",
    "friction",
    "solref",
    "solreffriction",
    "solimp",
    "mu",
    "H",
    "dim",
    "geom1",
    "geom2",
    "geom",
    "flex",
    "elem",
    "vert",
    "exclude",
    "efc_address",
)
"""The names of the fields of a contact in MuJoCo's data."""


class Beds:
    """Replaces the contacts between two faces by four contact points, if one of the two boxes is compliant. Together,
    the points have the force and the moments of a bed of springs.

    Args:
        bodies: (ngeom,) the body to which each geom belongs (``petmjx.world.mujoco_model.geom_bodies``).
    """

    def __init__(self, scene: Scene, physics: Physics, model: mujoco.MjModel, bodies: NDArray[np.intp]) -> None:
        assert scene.stiffness is not None
        self._physics = physics
        self._give = np.append(compliances(scene.stiffness, scene.half_size), [0.0, 0.0])[bodies]  # 0: FLOOR, CARRIER
        self._inverse: FloatArray = model.body_invweight0[model.geom_bodyid, 0]
        self._half: FloatArray = model.geom_size + model.geom_margin[:, None]  # margin = −skin
        self._plane = np.asarray(model.geom_type) == mujoco.mjtGeom.mjGEOM_PLANE

    def step1(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """``mj_step1`` of MuJoCo with beds of springs. All results except the contacts of compliant boxes are
        bit-identical to the results of ``mj_step1``.
        """
        mujoco.mj_checkPos(model, data)
        mujoco.mj_checkVel(model, data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_factorM(model, data)
        mujoco.mj_collision(model, data)
        self.press(model, data)
        mujoco.mj_makeConstraint(model, data)
        mujoco.mj_island(model, data)
        mujoco.mj_projectConstraint(model, data)
        mujoco.mj_fwdVelocity(model, data)

    def press(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Replace the contacts that MuJoCo found between two faces by the contacts of a bed, if one of the boxes is
        compliant."""
        count = data.ncon
        if not count:
            return
        geom = data.contact.geom
        # MuJoCo lists all contacts of a pair of geoms one after another
        begin = np.flatnonzero(np.concatenate([_TRUE, (geom[1:] != geom[:-1]).any(axis=1)]))
        length = np.diff(begin, append=count)
        one, two = geom[begin].T
        give = self._give[one] + self._give[two]
        concerned = (give > 0) & ~self._plane[one] & ~self._plane[two]
        if not concerned.any():
            return
        begin, length, one, two, give = (values[concerned] for values in (begin, length, one, two, give))
        flat, normal, points, depth, area, least = face_pressure(
            data.geom_xpos, data.geom_xmat, self._half, one, two, data.contact.frame[begin, :3]
        )
        spring = np.maximum(area, least) / give / POINTS_PER_BED
        solref, impedance = spring_laws(self._physics, spring, self._inverse[one] + self._inverse[two])
        beds = np.arange(len(begin))
        if not ((length == POINTS_PER_BED) & flat & (area > 0)).all():
            beds = np.flatnonzero(flat & (area > 0))
            repeats = np.ones(count, np.intp)
            for first, contacts, is_bed, has_area in zip(begin, length, flat, area > 0, strict=True):
                if is_bed:
                    repeats[first : first + contacts] = 0
                    repeats[first] = POINTS_PER_BED * has_area
            if not _take(model, data, np.repeat(np.arange(count), repeats)):
                return  # a full buffer makes MuJoCo count a warning, and the world gets an overflow flag
            begin = (np.cumsum(repeats) - repeats)[begin[beds]]
        rows, contact = begin[:, None] + np.arange(POINTS_PER_BED), data.contact
        contact.pos[rows] = points[beds]
        contact.dist[rows] = contact.includemargin[rows] - depth[beds]
        contact.frame[rows] = frames(normal)[beds, None]
        contact.solref[rows] = solref[beds, None]
        contact.solimp[rows, :2] = impedance[beds, None, None]


def _take(model: mujoco.MjModel, data: mujoco.MjData, source: NDArray[np.intp]) -> bool:
    """Replace the contacts in MuJoCo's data by copies of the contacts with the numbers ``source``. Returns whether the
    buffer has room for them."""
    values = {name: np.array(getattr(data.contact, name))[source] for name in _FIELDS}
    for _ in range(len(source) - data.ncon):
        if mujoco.mj_addContact(model, data, mujoco.MjContact()):
            return False
    data.ncon = len(source)
    for name, value in values.items():
        getattr(data.contact, name)[:] = value
    return True


def frames(normal: FloatArray) -> FloatArray:
    """(p, 9) contact frames for (p, 3) unit normals, the same as from MuJoCo's ``mju_makeFrame``."""
    other = np.where(np.abs(normal[:, 1:2]) < 0.5, _Y, _Z)
    one = _unit(other - (other * normal).sum(axis=1, keepdims=True) * normal)
    return np.concatenate([normal, one, _cross(normal, one)], axis=1)


def face_pressure(
    pos: FloatArray,
    turn: FloatArray,
    half: FloatArray,
    one: NDArray[np.integer],
    two: NDArray[np.integer],
    normal: FloatArray,
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The pressure between the faces of p pairs of boxes, as four contact points for each pair.

    Args:
        pos: (n, 3) centres of the boxes, m.
        turn: (n, 9) rotation matrices of the boxes, flattened row by row.
        half: (n, 3) half sizes of the boxes, m.
        one, two: (p,) numbers of the two boxes of each pair.
        normal: (p, 3) contact normals that MuJoCo found, from the first box to the second box.

    Returns:
        Six arrays: (p,) whether two faces meet; (p, 3) unit normals; (p, 4, 3) contact points, m; (p, 4) their depths,
        m; (p,) pressed area, m²; (p,) area from which the stiffness is computed if the pressed area is smaller, m².
    """
    count = len(one)
    boxes, toward = np.concatenate([one, two]), np.concatenate([normal, -normal])
    columns = turn[boxes].reshape(-1, 3, 3).transpose(0, 2, 1)
    along = (columns @ toward[:, :, None])[:, :, 0]
    rows = np.arange(2 * count)[:, None]
    order = _FACES[np.abs(along).argmax(axis=1)]
    reach = half[boxes][rows, order]
    # the half axes of the face whose normal is nearest to the contact normal: one outward, two along the edges
    directions = columns[rows, order]
    directions[:, 0] *= np.copysign(1.0, along[rows, order[:, :1]])
    axes = directions * reach[:, :, None]
    center = pos[boxes] + axes[:, 0]
    out_a, out_b = directions[:count, 0], directions[count:, 0]
    middle = _unit(out_a - out_b)
    plane = np.empty((count, 3, 3))
    edge = axes[:count, 1]
    plane[:, 0] = _unit(edge - (edge * middle).sum(axis=1, keepdims=True) * middle)
    plane[:, 1], plane[:, 2] = _cross(middle, plane[:, 0]), middle
    vectors = np.empty((count, 7, 3))
    # the origin is the middle of the second box's face
    vectors[:, 0] = center[:count] - center[count:]
    vectors[:, 1:3], vectors[:, 3:5] = axes[:count, 1:], axes[count:, 1:]
    vectors[:, 5], vectors[:, 6] = out_a, out_b
    seen_vectors = vectors @ plane.transpose(0, 2, 1)
    lines = np.empty((count, 9, 3))
    _sides(seen_vectors[:, 1:5, :2].reshape(count, 2, 2, 2), seen_vectors[:, 0, :2], lines)
    rise = -seen_vectors[:, 5:, :2] / seen_vectors[:, 5:, 2:]
    depth = np.empty((count, 3))
    depth[:, :2] = rise[:, 0] - rise[:, 1]
    depth[:, 2] = seen_vectors[:, 0, 2] - (rise[:, 0] * seen_vectors[:, 0, :2]).sum(axis=1)
    steep = np.sqrt((depth[:, :2] ** 2).sum(axis=1))
    lines[:, 8] = depth / np.maximum(steep, _LEVEL)[:, None]
    level = steep < _LEVEL
    if level.any():
        lines[level, 8] = _EAST
        lines[level, 8, 2] = np.copysign(_FAR_M, depth[level, 2])
    area, common, deepest, centroid, root = _moments(lines)
    places = np.empty((count, POINTS_PER_BED, 3))
    places[..., :2] = centroid[:, None] + _SIGNS @ root.transpose(0, 2, 1)
    depths = (places[..., :2] @ depth[:, :2, None])[..., 0] + depth[:, 2:]
    outward = np.clip(OUTWARD * (EDGE_SHARE * common / np.maximum(area, _LEAST_MOMENT_M2) - 1.0), 0.0, 1.0)
    if outward.any():
        away = lines[:, 8, :2, None]
        short = deepest[:, None] - (places[..., :2] @ away)[..., 0] - lines[:, 8, 2:]
        places[..., :2] += (outward[:, None] * short)[..., None] * away[:, None, :, 0]
    places[..., 2] = (places[..., :2] @ rise[:, 1, :, None])[..., 0] + 0.5 * depths
    points = center[count:, None] + places @ plane
    of_face = 4.0 * reach[:, 1] * reach[:, 2]
    flat = -(out_a * out_b).sum(axis=1) >= FACE_COSINE
    least = np.maximum(EDGE_SHARE * common, LEAST_SHARE * np.minimum(of_face[:count], of_face[count:]))
    return flat, middle, points, depths, area, least


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=1, keepdims=True)))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """The cross products of a few vectors, in a tenth of the time of ``np.cross``."""
    return np.asarray(a[:, _NEXT] * b[:, _LAST] - a[:, _LAST] * b[:, _NEXT])


def _sides(edges: FloatArray, at: FloatArray, lines: FloatArray) -> None:
    """Write the sides of two parallelograms into ``lines``. A line has three coefficients: of x, of y, and a constant.
    The sum a·x + b·y + c is the distance of the point (x, y) from the line, positive inside the parallelogram.

    Args:
        edges: (p, 2, 2, 2) half edges. The axes are pair, parallelogram, edge and coordinate.
        at: (p, 2) middle of the first parallelogram. The origin is the middle of the second parallelogram.
        lines: (p, 9, 3) room for nine lines for each pair. This function writes the first eight.
    """
    cross = edges[:, :, :1, 0] * edges[:, :, 1:, 1] - edges[:, :, :1, 1] * edges[:, :, 1:, 0]
    length = np.sqrt((edges * edges).sum(axis=3))
    across = edges[..., ::-1] * _ASIDE * (np.copysign(1.0, cross) * _WAYS / length)[..., None]
    reach = np.abs(cross) / length
    offset = (across[:, 0] @ at[:, :, None])[..., 0]
    lines[:, 0:2, :2], lines[:, 2:4, :2] = across[:, 0], -across[:, 0]
    lines[:, 4:6, :2], lines[:, 6:8, :2] = across[:, 1], -across[:, 1]
    lines[:, 0:2, 2], lines[:, 2:4, 2] = reach[:, 0] - offset, reach[:, 0] + offset
    lines[:, 4:6, 2] = lines[:, 6:8, 2] = reach[:, 1]


def _moments(lines: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Properties of the region that is inside all lines. Returns five arrays: (p,) area of the region; (p,) area that
    the region would have without the last line; (p,) largest distance of a point of the region from the last line; (p,
    2) centroid of the region; and (p, 2, 2) square root (Cholesky factor) of the region's second moments per area.

    An edge of the region is the part of a line that is on the inner side of all other lines. The area and the moments
    are sums over the edges, by Green's theorem.

    Args:
        lines: (p, k, 3) lines with three coefficients each, as ``_sides`` writes them.
    """
    across, offset = lines[:, :, :2], lines[:, :, 2]
    along = across[:, :, ::-1] * _ASIDE
    turned = across.transpose(0, 2, 1)
    sine, cosine = along @ turned, across @ turned  # the element [j, k] belongs to line j, cut by line k
    parallel = np.abs(sine) < PARALLEL
    inside = offset[:, None, :] - offset[:, :, None] * np.where(parallel, np.rint(cosine), cosine)
    cut = -inside / np.where(parallel, 1.0, sine)
    # if two lines coincide, only the first line is an edge
    outside = parallel & ((inside < 0) | ((inside == 0) & _LATER))
    low = np.where(sine >= PARALLEL, cut, -_FAR_M)
    high = np.where(sine <= -PARALLEL, cut, np.where(outside, -np.inf, _FAR_M))
    length = np.maximum(high[:, :-1, :-1].min(axis=2) - low[:, :-1, :-1].max(axis=2), 0.0)
    common = 0.5 * np.where(length > 0, length * offset[:, :-1], 0.0).sum(axis=1)
    low, high = low.max(axis=2), high.min(axis=2)
    length = np.maximum(high - low, 0.0)
    is_edge = length > 0
    share = np.where(is_edge, length * offset, 0.0)  # twice the area of the triangle between the edge and the origin
    area = 0.5 * share.sum(axis=1)
    share /= np.where(area > 0, area, 1.0)[:, None]
    half_way = np.where(is_edge, 0.5 * (low + high), 0.0)
    middle = half_way[:, :, None] * along - offset[:, :, None] * across
    reach = (middle @ across[:, -1, :, None])[..., 0] + offset[:, -1:] + 0.5 * length * np.abs(sine[:, :, -1])
    reach = np.where(is_edge, reach, 0.0).max(axis=1)
    centroid = (share[:, None] @ middle)[:, 0] / 3.0
    second = (share[:, :, None] * middle).transpose(0, 2, 1) @ middle / 4.0
    second += ((share * length**2)[:, :, None] * along).transpose(0, 2, 1) @ along / 48.0
    second -= centroid[:, :, None] * centroid[:, None, :]
    root = np.zeros_like(second)
    root[:, 0, 0] = np.sqrt(np.maximum(second[:, 0, 0], _LEAST_MOMENT_M2))
    root[:, 1, 0] = second[:, 0, 1] / root[:, 0, 0]
    root[:, 1, 1] = np.sqrt(np.maximum(second[:, 1, 1] - root[:, 1, 0] ** 2, 0.0))
    return np.maximum(area, 0.0), common, reach, centroid, root
