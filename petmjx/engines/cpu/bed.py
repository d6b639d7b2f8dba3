"""Faces of boxes that give, pressed on one another, in MuJoCo's data. The law: petmjx/world/give.py."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.options.physics import Physics
from petmjx.world.give import FACE_COSINE, LEAST_SHARE, POINTS_PER_BED, gives, spring_laws
from petmjx.world.scene import Scene

PARALLEL: Final = 1e-6
"""Sine below which two edges are parallel; their distance is then that at their middles."""

_LEVEL: Final = 1e-12
"""Slope below which depth is the same everywhere."""

_FAR_M: Final = 1e3
"""How far off the line of depth 0 then is."""

_SIGNS: Final = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
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
"""Of a contact in MuJoCo's data."""


class Beds:
    """Puts contacts of faces of boxes that give in the places where they have the forces and moments of a bed.

    Args:
        bodies: (ngeom,) of the geoms, as ``petmjx.world.model.geom_bodies`` gives them.
    """

    def __init__(self, scene: Scene, physics: Physics, model: mujoco.MjModel, bodies: NDArray[np.intp]) -> None:
        assert scene.stiffness is not None
        self._physics = physics
        self._give = np.append(gives(scene.stiffness, scene.half_size), [0.0, 0.0])[bodies]  # FLOOR, CARRIER
        self._inverse: FloatArray = model.body_invweight0[model.geom_bodyid, 0]
        self._half: FloatArray = model.geom_size + model.geom_margin[:, None]  # without skin
        self._plane = np.asarray(model.geom_type) == mujoco.mjtGeom.mjGEOM_PLANE

    def step(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """As ``mj_step`` with Euler's integrator; all that MuJoCo does between collisions and the solver is in order."""
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
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)
        mujoco.mj_checkAcc(model, data)
        mujoco.mj_Euler(model, data)

    def press(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Replace the collider's contacts of faces, one of which gives, by those of a bed."""
        if not data.ncon:
            return
        contact = data.contact
        geom = np.array(contact.geom)
        first, second = geom[:, 0], geom[:, 1]
        give = self._give[first] + self._give[second]
        concerned = (give > 0) & ~self._plane[first] & ~self._plane[second]
        if not concerned.any():
            return
        # the collider gives a pair's contacts one after the other
        begins = concerned & np.append(True, (geom[1:] != geom[:-1]).any(axis=1))
        rows = np.flatnonzero(begins)
        one, two = first[rows], second[rows]
        frame = np.array(contact.frame[rows, :3])
        place, turn = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        flat, normal, points, depth, area, smaller = pressed(
            place[one], turn[one], self._half[one], place[two], turn[two], self._half[two], frame
        )
        spring = np.maximum(area, LEAST_SHARE * smaller) / give[rows] / POINTS_PER_BED
        solref, impedance = spring_laws(self._physics, spring, self._inverse[one] + self._inverse[two])
        number = np.cumsum(begins) - 1  # of a contact's pair
        beds = concerned & np.append(flat, False)[number]
        source = np.where(beds, 0, 1)
        source[rows[flat]] = np.where(area[flat] > 0, POINTS_PER_BED, 0)
        source = np.repeat(np.arange(len(geom)), source)
        if len(source) != len(geom) or (source != np.arange(len(geom))).any():
            _take(model, data, source)
            contact = data.contact
        if not len(source):
            return
        beds = beds[source]
        number = number[source[beds]]
        corner = np.arange(np.count_nonzero(beds)) % POINTS_PER_BED
        contact.pos[beds] = points[number, corner]
        contact.dist[beds] = contact.includemargin[beds] - depth[number, corner]
        contact.frame[beds] = frames(normal)[number]
        contact.solref[beds] = solref[number]
        contact.solimp[beds, :2] = impedance[number, None]


def _take(model: mujoco.MjModel, data: mujoco.MjData, source: NDArray[np.intp]) -> None:
    """Let contacts be those of these numbers."""
    values = {name: np.array(getattr(data.contact, name))[source] for name in _FIELDS}
    for _ in range(len(source) - data.ncon):
        if mujoco.mj_addContact(model, data, mujoco.MjContact()):
            return  # MuJoCo counts it as a warning, and the world overflows
    data.ncon = len(source)
    for name, value in values.items():
        getattr(data.contact, name)[:] = value


def frames(normal: FloatArray) -> FloatArray:
    """(p, 9) frames of contacts with these normals (p, 3), as MuJoCo's ``mju_makeFrame`` has them."""
    other = np.where((np.abs(normal[:, 1]) < 0.5)[:, None], (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    one = other - (other * normal).sum(axis=1, keepdims=True) * normal
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    return np.concatenate([normal, one, np.cross(normal, one)], axis=1)


def pressed(
    pos_a: FloatArray,
    turn_a: FloatArray,
    half_a: FloatArray,
    pos_b: FloatArray,
    turn_b: FloatArray,
    half_b: FloatArray,
    normal: FloatArray,
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where faces of two boxes press on one another, for p pairs.

    Args:
        pos_a, pos_b: (p, 3) middles, m.
        turn_a, turn_b: (p, 3, 3) rotations.
        half_a, half_b: (p, 3) half sizes, m.
        normal: (p, 3) of the collider, from the first to the second.

    Returns:
        (p,) whether they are faces; (p, 3) unit normals; (p, 4, 3) points, m; (p, 4) depths, m; (p,) area that is
        pressed, m²; (p,) area of the smaller of both faces, m².
    """
    center_a, out_a, edges_a, area_a = _face(pos_a, turn_a, half_a, normal)
    center_b, out_b, edges_b, area_b = _face(pos_b, turn_b, half_b, -normal)
    flat = -(out_a * out_b).sum(axis=1) >= FACE_COSINE
    middle = out_a - out_b
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    x = edges_a[:, 0] - (edges_a[:, 0] * middle).sum(axis=1, keepdims=True) * middle
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    axes = np.stack([x, np.cross(middle, x), middle], axis=2)  # as columns
    # origin: the middle of the second box's face
    at_a = np.einsum("pi,pij->pj", center_a - center_b, axes)
    lines = np.concatenate(
        [
            _sides(at_a[:, :2], np.einsum("pki,pij->pkj", edges_a, axes)[..., :2]),
            _sides(np.zeros_like(at_a[:, :2]), np.einsum("pki,pij->pkj", edges_b, axes)[..., :2]),
        ],
        axis=1,
    )
    slope_a, slope_b = _slope(out_a, axes), _slope(out_b, axes)
    slope = slope_a - slope_b
    depth = np.column_stack([slope, at_a[:, 2] - (slope_a * at_a[:, :2]).sum(axis=1)])
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    level = np.column_stack([np.ones_like(steep), np.zeros_like(steep), np.copysign(_FAR_M, depth[:, 2:])])
    edge = np.where(steep < _LEVEL, level, depth / np.maximum(steep, _LEVEL))
    area, center, root = _moments(np.concatenate([lines, edge[:, None]], axis=1))
    places = center[:, None] + np.einsum("pij,cj->pci", root, _SIGNS)
    depths = np.einsum("pci,pi->pc", places, slope) + depth[:, 2, None]
    height = np.einsum("pci,pi->pc", places, slope_b) + 0.5 * depths
    points = center_b[:, None] + np.einsum("pij,pcj->pci", axes, np.concatenate([places, height[..., None]], axis=2))
    return flat, middle, points, depths, area, np.minimum(area_a, area_b)


def _face(
    pos: FloatArray, turn: FloatArray, half: FloatArray, toward: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(p, 3) middle, (p, 3) outward normal, (p, 2, 3) half edges and (p,) area of the face that looks most this way."""
    along = np.einsum("pij,pi->pj", turn, toward)
    axis = np.abs(along).argmax(axis=1)
    rows = np.arange(len(axis))
    out = turn[rows, :, axis] * np.where(along[rows, axis] < 0, -1.0, 1.0)[:, None]
    one, two = (axis + 1) % 3, (axis + 2) % 3
    edges = np.stack([turn[rows, :, one] * half[rows, one, None], turn[rows, :, two] * half[rows, two, None]], axis=1)
    return pos + out * half[rows, axis, None], out, edges, 4.0 * half[rows, one] * half[rows, two]


def _sides(center: FloatArray, edges: FloatArray) -> FloatArray:
    """(p, 4, 3) the sides of a parallelogram as lines: what x, y and 1 are multiplied by is the distance inside it.

    Args:
        center: (p, 2).
        edges: (p, 2, 2) half edges.
    """
    one, two = edges[:, 0], edges[:, 1]
    cross = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    found = []
    for edge, factor in ((one, -np.sign(cross)), (two, np.sign(cross))):
        length = np.linalg.norm(edge, axis=1)
        across = np.column_stack([edge[:, 1], -edge[:, 0]]) * (factor / length)[:, None]
        offset, reach = (across * center).sum(axis=1), np.abs(cross) / length
        found += [np.column_stack([across, reach - offset]), np.column_stack([-across, reach + offset])]
    return np.stack(found, axis=1)


def _slope(out: FloatArray, axes: FloatArray) -> FloatArray:
    """(p, 2) by how much a face rises along x and y."""
    along = np.einsum("pi,pij->pj", out, axes)
    return -along[:, :2] / along[:, 2:]


def _moments(lines: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(p,) area, (p, 2) centroid and (p, 2, 2) root of the second moments for each area, of the common inside of lines.

    Each edge is a line cut off by all others; area and moments are sums over edges (Green's theorem).

    Args:
        lines: (p, k, 3) as ``_sides`` gives them.
    """
    n = lines.shape[1]
    across, offset = lines[..., :2], lines[..., 2]
    foot, along = -offset[..., None] * across, np.stack([across[..., 1], -across[..., 0]], axis=2)
    sine = np.einsum("pji,pki->pjk", along, across)  # [line j, cut by k]
    inside = np.einsum("pji,pki->pjk", foot, across) + offset[:, None, :]
    parallel = np.abs(sine) < PARALLEL
    same = np.einsum("pji,pki->pjk", across, across) > 0
    apart = offset[:, None, :] + np.where(same, -1.0, 1.0) * offset[:, :, None]
    # of two lines in the same place the first one is an edge
    ties = np.arange(n)[:, None] < np.arange(n)[None, :]
    outside = parallel & ((apart < 0) | (same & (apart == 0) & ~ties))
    outside[:, np.arange(n), np.arange(n)] = False
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = -inside / sine
    low = np.where(~parallel & (sine > 0), cut, -np.inf).max(axis=2)
    high = np.where(~parallel & (sine < 0), cut, np.inf).min(axis=2)
    edge = ~outside.any(axis=2) & (low < high)
    low, high = np.where(edge, low, 0.0), np.where(edge, high, 0.0)
    begin, end = foot + low[..., None] * along, foot + high[..., None] * along
    cross = begin[..., 0] * end[..., 1] - begin[..., 1] * end[..., 0]
    cross = np.where(edge, cross, 0.0)
    area = 0.5 * cross.sum(axis=1)
    there = area > 0
    safe = np.where(there, area, 1.0)
    both = begin + end
    center = np.einsum("pj,pji->pi", cross, both) / (6.0 * safe[:, None])
    second = np.einsum("pj,pji,pjk->pik", cross, both, both)
    second += np.einsum("pj,pji,pjk->pik", cross, begin, begin) + np.einsum("pj,pji,pjk->pik", cross, end, end)
    second = second / (24.0 * safe[:, None, None]) - center[:, :, None] * center[:, None, :]
    root = np.zeros_like(second)
    root[:, 0, 0] = np.sqrt(np.maximum(second[:, 0, 0], 1e-18))
    root[:, 1, 0] = second[:, 0, 1] / root[:, 0, 0]
    root[:, 1, 1] = np.sqrt(np.maximum(second[:, 1, 1] - root[:, 1, 0] ** 2, 0.0))
    return np.where(there, area, 0.0), center, root
