"""Where the boxes of a world touch at rest: the points at which MuJoCo's collider finds them in their last poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.history import CARRIER
from petmjx.options.physics import Physics
from petmjx.statics.contacts import IntArray
from petmjx.world.bearing import TOUCH_M
from petmjx.world.scene import Scene

LYING_GAP_M: Final = TOUCH_M
"""Gap up to which a box lies on another one, as in the criteria. Which of three supports of one height bears is a
matter of micrometres, which no two simulators and no two pallets share."""

SIDE_GAP_M: Final = 1e-5
"""Gap up to which boxes touch side by side: what rounds a pose in float32, and little more. Neighbours that are planned
side by side stand 0.1 mm apart, and do not press on each other before something moves."""


@dataclass(frozen=True, eq=False)
class Touching:
    """The points where boxes touch each other, the carrier or the floor: p rows.

    Attributes:
        first, second: (p,) the two bodies, boxes from 0; ``CARRIER`` stands for the floor, too: neither moves.
        position_m: (p, 3).
        frame: (p, 3, 3) rows: the normal from first to second, and the two tangents.
        friction: (p, 2) coefficients along the tangents.
        pressed: (p,) the box whose top the point is on (docs/metrics.md, "The force on a box's top"), or ``CARRIER``.
        sign: (p,) 1 where the force on ``second`` presses down on ``pressed``, else -1.
    """

    first: IntArray
    second: IntArray
    position_m: FloatArray
    frame: FloatArray
    friction: FloatArray
    pressed: IntArray
    sign: FloatArray

    def some(self, which: NDArray[np.bool_]) -> Touching:
        """Some of the points."""
        return Touching(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


def find_touching(scene: Scene, physics: Physics, pos: FloatArray, quat: FloatArray) -> Touching:
    """Where boxes touch in these poses. The carrier is where it is planned.

    Args:
        pos, quat: (n, 3) centres, m, and (n, 4) orientations (w, x, y, z).
    """
    import mujoco

    from petmjx.metrics.force_np import VERTICAL_COSINE, pressed_box
    from petmjx.world.model import build_spec, geom_bodies

    model = build_spec(scene, physics).compile()
    model.pair_margin[:] += LYING_GAP_M
    model.geom_margin[:] += LYING_GAP_M / 2  # those of two geoms add up
    data = mujoco.MjData(model)
    poses = data.qpos.reshape(-1, 7)[1:]  # the first is the carrier's
    poses[:, :3], poses[:, 3:] = scene.frames(pos, quat), quat
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    contact = data.contact
    geom = np.asarray(contact.geom).astype(np.int64)
    frame = np.asarray(contact.frame).reshape(-1, 3, 3)
    centre_z = data.geom_xpos[:, 2].copy()
    centre_z[0] = -np.inf  # the floor is lower than everything
    body = geom_bodies(model, range(scene.n_boxes))[geom]
    lower, sign, on_top = pressed_box(body, centre_z[geom], frame[:, 0, 2])
    gap_m = np.asarray(contact.dist) - np.asarray(contact.includemargin) + LYING_GAP_M
    lying = np.abs(frame[:, 0, 2]) >= VERTICAL_COSINE
    body = np.maximum(body, CARRIER)
    touching = Touching(
        first=body[:, 0],
        second=body[:, 1],
        position_m=np.array(contact.pos),
        frame=frame.copy(),
        friction=np.array(contact.friction)[:, :2],
        pressed=np.where(on_top, lower, CARRIER),
        sign=sign,
    )
    return touching.some((body.max(axis=1) >= 0) & (gap_m <= np.where(lying, LYING_GAP_M, SIDE_GAP_M)))
