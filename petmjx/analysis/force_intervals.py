"""Computes how small and how large the force on the top of a box at rest can be, according to balance and friction.

Statics does not determine how three supports share a load, and a simulation's answer depends on the stiffness of its
contacts. In this module, the forces at all points at which boxes touch (``find_touch_points``) are unknowns. The
unknown forces must meet three conditions: contacts can only press, friction is limited to μ times the pressure, and the
total force and moment on every box are zero. Two linear programmes for each box give the smallest and the largest force
on its top. If statics alone determines the force on a box's top, the box needs no linear programme.

Friction is limited by the pyramid around the cone, |f₁|, |f₂| ≤ μ f, so that the interval contains all forces that the
cone allows. (petmjx.analysis.force_balance uses the pyramid inside the cone, so that it never calls a stack balanced by
mistake.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.force_balance import WRENCH, least_and_most, wrenches
from petmjx.analysis.plan_contacts import IntArray
from petmjx.common.errors import InputError, PetmjxError
from petmjx.common.units import FloatArray
from petmjx.engines.metrics import BoxMetrics
from petmjx.options.physics import Physics
from petmjx.world.bearings import TOUCH_M
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene

_EDGES: Final = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
"""The four edges of the pyramid around a friction cone: for each edge, the signs of the components along the two
tangents."""


def need_scipy() -> None:
    """Check that force intervals can be computed. A run that needs these intervals calls this function before it
    starts.

    Raises:
        InputError: SciPy is missing.
    """
    try:
        import scipy  # noqa: F401  # only to see whether it is installed
    except ImportError:
        raise InputError("force_intervals needs SciPy: pip install 'petmjx[packers]'") from None


def intervals_at_rest(scene: Scene, physics: Physics, boxes: BoxMetrics) -> FloatArray | None:
    """The result of :func:`force_intervals` for the final poses of a simulated stack. If the simulation gave no forces
    at rest, the result is None."""
    at_rest = np.column_stack([boxes.rest_top_force_n, boxes.pos, boxes.quat])
    return force_intervals(scene, physics, boxes.pos, boxes.quat) if np.isfinite(at_rest).all() else None


def force_intervals(scene: Scene, physics: Physics, pos: FloatArray, quat: FloatArray) -> FloatArray:
    """(n, 2) smallest and largest possible force on the top of each box, N. The values of a box are NaN if no forces
    balance the boxes that contacts connect with it, or if the solver finds no answer.

    Args:
        scene: sizes, masses and friction of the boxes, and the carrier. The carrier is at its planned place.
        pos, quat: (n, 3) centres of the boxes at rest, m, and (n, 4) their orientations as quaternions (w, x, y, z).
    """
    touching = find_touch_points(scene, physics, pos, quat)
    weight = scene.mass / scene.mass.mean()
    intervals = _without_programme(touching, weight)
    parts = _hanging_together(touching, scene.n_boxes)
    for part in np.unique(parts[np.isnan(intervals[:, 0])]):
        boxes = np.flatnonzero(parts == part)
        intervals[boxes] = _of_part(touching, boxes, intervals[boxes], weight, pos)
    scale: float = scene.mass.mean() * physics.gravity_m_s2
    return intervals * scale


def _without_programme(touching: TouchPoints, weight: FloatArray) -> FloatArray:
    """(n, 2) smallest and largest possible force on the top of those boxes that need no linear programme, in units of
    the mean weight of the boxes. If nothing lies on a box, both bounds are 0. If the boxes above a box have no other
    support, both bounds are the weight of these boxes. For all other boxes, the bounds are NaN."""
    n_boxes = len(weight)
    intervals = np.full((n_boxes, 2), np.nan)
    ends = np.stack([touching.first, touching.second])
    ends[ends == CARRIER] = n_boxes
    for box in range(n_boxes):
        box_contacts = (ends == box).any(axis=0)
        on_top = touching.pressed[box_contacts] == box
        # a group number for each box and for the carrier: bodies have the same number if contacts would connect them
        # even without this box
        group = _groups(ends[:, ~box_contacts], n_boxes + 1)
        other = group[ends[:, box_contacts].sum(axis=0) - box]
        above = np.unique(other[on_top])
        if group[n_boxes] not in above and not np.isin(other[~on_top], above).any():
            intervals[box] = weight[np.isin(group[:n_boxes], above)].sum()
    return intervals


def _hanging_together(touching: TouchPoints, n_boxes: int) -> IntArray:
    """(n,) the number of the group to which each box belongs. A group consists of boxes that contacts connect with each
    other."""
    ends = np.stack([touching.first, touching.second])
    return _groups(ends[:, (ends != CARRIER).all(axis=0)], n_boxes)


def _groups(pairs: IntArray, n: int) -> IntArray:
    """(n,) the number of the connected component to which each node belongs, in a graph of n nodes with the edges
    ``pairs`` (2, e)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(pairs.shape[1], dtype=np.int8), (pairs[0], pairs[1])), shape=(n, n))
    labels: IntArray = connected_components(graph, directed=False)[1]
    return labels


def _of_part(
    touching: TouchPoints, boxes: IntArray, known: FloatArray, weight: FloatArray, centre_m: FloatArray
) -> FloatArray:
    """(b, 2) smallest and largest possible force on the top of each of the b boxes of a group, in units of the mean
    weight of all boxes. The boxes of a group are connected with each other by contacts.

    Args:
        known: (b, 2) the smallest and largest forces that are known without a linear programme; NaN for the other
            boxes.
    """
    place = np.full(len(weight) + 1, CARRIER)  # CARRIER is -1, so as an index it refers to the last entry
    place[boxes] = np.arange(len(boxes))
    contacts = touching.some(np.maximum(place[touching.first], place[touching.second]) != CARRIER)
    # (p, 4, 3) at each point, a force along each edge of the friction pyramid
    direction = contacts.frame[:, :1] + np.einsum("ks,ps,psx->pkx", _EDGES, contacts.friction, contacts.frame[:, 1:])
    forces = wrenches(place[contacts.first], place[contacts.second], contacts.position_m, direction, centre_m[boxes])
    loads = np.zeros((len(boxes), WRENCH))
    loads[:, 2] = weight[boxes]
    unknown = np.isnan(known[:, 0])
    pressing = (contacts.sign[:, None] * direction[:, :, 2])[None] * (contacts.pressed == boxes[unknown, None])[
        :, :, None
    ]
    try:
        bounds = least_and_most(pressing.reshape(int(unknown.sum()), -1), forces, loads.ravel())
    except PetmjxError:  # a run should not stop because one interval is missing
        bounds = None
    intervals = known.copy()
    if bounds is not None:
        intervals[unknown] = np.sort(bounds, axis=1)  # rounding errors of the solver may swap bounds that are equal
    return intervals


LYING_GAP_M: Final = TOUCH_M
"""Largest gap, m, between a box and another box that lies on it, as in the criteria. A smaller limit would ignore some
supports. If three supports have the same planned height, differences of micrometres determine which of them bear the
load. These differences vary between simulators, and between real pallets."""

SIDE_GAP_M: Final = 1e-5
"""Largest gap between two boxes that touch side by side, m: slightly more than the rounding error of a pose in float32.
Boxes that are planned side by side are placed 0.1 mm apart, so they touch only after they have moved."""


@dataclass(frozen=True, eq=False)
class TouchPoints:
    """The p points at which boxes touch each other, the carrier or the floor. Each field has one row per point.

    Attributes:
        first, second: (p,) the two bodies that touch, as indices of boxes, or ``CARRIER`` for the carrier and for the
            floor, which do not move.
        position_m: (p, 3) positions of the points, m.
        frame: (p, 3, 3) three unit vectors at each point, one per row: the normal from the first body to the second,
            then the two tangents.
        friction: (p, 2) coefficients of friction along the two tangents.
        pressed: (p,) index of the box on whose top the point is (docs/metrics.md, "The force on a box's top"), or
            ``CARRIER`` if the point is on no box's top.
        sign: (p,) 1 or −1: the vertical force on ``second``, multiplied by this sign, is the force that presses down on
            ``pressed``.
    """

    first: IntArray
    second: IntArray
    position_m: FloatArray
    frame: FloatArray
    friction: FloatArray
    pressed: IntArray
    sign: FloatArray

    def some(self, which: NDArray[np.bool_]) -> TouchPoints:
        """The points for which the mask ``which`` (p,) is true."""
        return TouchPoints(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


def find_touch_points(scene: Scene, physics: Physics, pos: FloatArray, quat: FloatArray) -> TouchPoints:
    """Find the points at which boxes touch in given poses. The carrier is at its planned place.

    Args:
        pos, quat: (n, 3) centres of the boxes, m, and (n, 4) their orientations as quaternions (w, x, y, z).
    """
    import mujoco

    from petmjx.engines.mujoco.top_forces import VERTICAL_COSINE, pressed_box
    from petmjx.world.mujoco_model import build_spec, geom_bodies

    model = build_spec(scene, physics).compile()
    model.pair_margin[:] += LYING_GAP_M
    model.geom_margin[:] += LYING_GAP_M / 2  # half of the gap, because MuJoCo adds the margins of two geoms
    data = mujoco.MjData(model)
    poses = data.qpos.reshape(-1, 7)[1:]  # the first row is the pose of the carrier
    poses[:, :3], poses[:, 3:] = scene.frames(pos, quat), quat
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    contact = data.contact
    geom = np.asarray(contact.geom).astype(np.int64)
    frame = np.asarray(contact.frame).reshape(-1, 3, 3)
    body = geom_bodies(model, range(scene.n_boxes))[geom]
    lower, sign, on_top = pressed_box(body, frame[:, 0, 2])
    gap_m = np.asarray(contact.dist) - np.asarray(contact.includemargin) + LYING_GAP_M
    lying = np.abs(frame[:, 0, 2]) >= VERTICAL_COSINE
    body = np.maximum(body, CARRIER)
    touching = TouchPoints(
        first=body[:, 0],
        second=body[:, 1],
        position_m=np.array(contact.pos),
        frame=frame.copy(),
        friction=np.array(contact.friction)[:, :2],
        pressed=np.where(on_top, lower, CARRIER),
        sign=sign,
    )
    return touching.some((body.max(axis=1) >= 0) & (gap_m <= np.where(lying, LYING_GAP_M, SIDE_GAP_M)))
