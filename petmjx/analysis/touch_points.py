"""Finds the points at which boxes touch when a simulation has come to rest (``find_touch_points``), from the final
poses of the boxes and with MuJoCo's collision detection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.plan_contacts import IntArray
from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics
from petmjx.world.bearings import TOUCH_M
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene

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
