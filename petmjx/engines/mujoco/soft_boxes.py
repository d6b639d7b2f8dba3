"""A MuJoCo world with soft boxes (petmjx/world/soft_boxes.py), which are deformable bodies made of points.

Shifts and tilts are measured on the rigid box that best fits the points of a soft box. The rigid box that fits best has
the centre of mass, the momentum and the angular momentum of the points. The rotation of the rigid box is the best fit
by least squares (Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.engines.mujoco.open_models import ModelInstance, set_options
from petmjx.engines.mujoco.top_forces import contact_force_z, contact_normal_and_tangents, pressed_box
from petmjx.options.simulation import Simulation
from petmjx.plans.plan_warnings import shared_length
from petmjx.world.bearings import TOUCH_M
from petmjx.world.history import CARRIER, FLOOR
from petmjx.world.mujoco_model import CARRIER_NAME, HeldCarrier, box_name, soft_spec
from petmjx.world.rotation import rotated_vectors, rotations
from petmjx.world.scene import Scene
from petmjx.world.soft_boxes import POINTS, point_name, points_of, rounding_m, shares

COUNT = len(POINTS)


@dataclass(frozen=True, eq=False)
class SoftState:
    """State of a world with a free carrier: qpos, qvel and solver warm start of the carrier and of all boxes."""

    pos: FloatArray
    velocity: FloatArray
    warmstart: FloatArray


class SoftWorld(LiveWorld):
    """A ``LiveWorld`` with soft boxes. In MuJoCo, a soft box consists of many bodies, so its state does not fit into
    the single row that ``LiveWorld`` has for each box.

    A box is added to the model when it is placed. Boxes are placed without placement errors.
    """

    def _build(self, capacity: int, contacts: NDArray[np.integer] | None = None) -> None:
        spec = soft_spec(self.scene, self._sim.physics, self._held, capacity)
        self.order = np.arange(capacity)
        model = spec.compile()
        set_options(model, self._sim)
        self._take(ModelInstance(model, mujoco.MjData(model)))

    def _take(self, instance: ModelInstance) -> None:
        self.model, self.data = instance
        self.capacity = count = len(self.order)
        self._has_waiting = False
        self._warnings = self.data.warning.number
        self._carrier = self.model.body(CARRIER_NAME).id
        scene, free = self.scene, 0 if self._held is not None else 1
        assert scene.soft is not None
        self._soft = np.flatnonzero(scene.soft[:count])
        self._rigid = np.flatnonzero(~scene.soft[:count])
        sizes = np.where(scene.soft[:count], 3 * COUNT, 7), np.where(scene.soft[:count], 3 * COUNT, 6)
        first_q, first_v = (np.concatenate([[0], np.cumsum(size)]) for size in sizes)
        self._first_q, self._first_v = 7 * free, 6 * free
        self._q_of = self._first_q + first_q[self._soft, None] + np.arange(3 * COUNT)
        self._v_of = self._first_v + first_v[self._soft, None] + np.arange(3 * COUNT)
        self._rigid_q = self._first_q + first_q[self._rigid, None] + np.arange(7)
        self._rigid_v = self._first_v + first_v[self._rigid, None] + np.arange(6)
        names = [point_name(box_name(box), point) for box in self._soft.tolist() for point in range(COUNT)]
        self._point_bodies = np.array([self.model.body(name).id for name in names], np.intp).reshape(-1, COUNT)
        names = [box_name(box) for box in self._rigid.tolist()]
        self._rigid_bodies = np.array([self.model.body(name).id for name in names], np.intp)
        self._home = self.model.body_pos[self._point_bodies]
        self._points = np.array([points_of(scene.half_size[box]) for box in self._soft]).reshape(-1, COUNT, 3)
        self._weight = shares()[None, :, None]
        of_body = np.full(self.model.nbody, CARRIER, np.intp)
        of_body[0] = FLOOR
        of_body[self._rigid_bodies] = self._rigid
        of_body[self._point_bodies] = self._soft[:, None]
        self.geom_bodies = of_body[np.asarray(self.model.geom_bodyid)]

    # ------------------------------------------------------------------ measurements

    def _now(self) -> FloatArray:
        """(s, 27, 3) positions of the 27 points of each of the s soft boxes after the last step, m."""
        points: FloatArray = self._home + self.data.qpos[self._q_of].reshape(-1, COUNT, 3)
        return points

    def _joined(self, soft: FloatArray, rigid: FloatArray) -> FloatArray:
        """(capacity, k) one row for each box, from the rows of the soft boxes and the rows of the rigid boxes."""
        rows = np.empty((self.capacity, rigid.shape[-1]))
        rows[self._soft], rows[self._rigid] = soft, rigid
        return rows

    def _fit(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(s, 3) centres (m) and (s, 3, 3) rotation matrices of the soft boxes whose points are at ``points``."""
        middle = (self._weight * points).sum(axis=1)
        spread = np.einsum("spi,spj->sij", self._weight * self._points, points - middle[:, None])
        left, _, right = np.linalg.svd(spread)
        right[:, 2] *= np.linalg.det(left @ right)[:, None]
        return middle, np.swapaxes(left @ right, 1, 2)

    def _poses_of(self, points: FloatArray) -> FloatArray:
        """(s, 7) centres (m) and quaternions of the soft boxes whose points are at ``points``. The result is NaN for a
        box with a point that is not finite."""
        poses = np.full((len(points), 7), np.nan)
        sound = np.isfinite(points).all(axis=(1, 2))
        if not sound.all():
            return poses
        poses[:, :3], turns = self._fit(points)
        for pose, turn in zip(poses, turns, strict=True):
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, turn.ravel())
            pose[3:] = quat
        return poses

    @property
    def pose(self) -> FloatArray:
        rigid = self.data.qpos[self._rigid_q]
        return self._in_order(self._poses_of(self._now()), rigid)

    def _in_order(self, soft: FloatArray, rigid: FloatArray) -> FloatArray:
        poses = self._joined(soft, rigid)
        poses[:, :3] = self.scene.middles(poses[:, :3], poses[:, 3:])
        return poses

    def sampled_pose(self) -> tuple[FloatArray, FloatArray]:
        data, bodies = self.data, self._rigid_bodies
        rigid = np.hstack([data.xpos[bodies], data.xquat[bodies]])
        poses = self._in_order(self._poses_of(data.xpos[self._point_bodies]), rigid)
        return poses[:, :3], poses[:, 3:]

    def _turning(self, points: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(s, 3) linear and (s, 3) angular part of the rates of change of the points, in world axes. ``rate``: (s, 27,
        3) these rates of change."""
        linear = (self._weight * rate).sum(axis=1)
        arm = points - (self._weight * points).sum(axis=1)[:, None]
        moment = (self._weight * np.cross(arm, rate)).sum(axis=1)
        squares = np.einsum("spi,spj->sij", self._weight * arm, arm)
        inertia = np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3) - squares
        if not np.isfinite(moment).all():
            return linear, np.full_like(moment, np.nan)
        return linear, np.linalg.solve(inertia, moment[..., None])[..., 0]

    def _rates(self, values: FloatArray, points: FloatArray) -> FloatArray:
        """(capacity, 6) linear and angular rates of all boxes: in world axes for soft boxes, in MuJoCo's axes for rigid
        boxes."""
        soft = np.hstack(self._turning(points, values[self._v_of].reshape(-1, COUNT, 3)))
        return self._joined(soft, values[self._rigid_v])

    @property
    def velocity(self) -> FloatArray:
        return self._rates(self.data.qvel, self._now())

    @property
    def qacc(self) -> FloatArray:
        return self._sampled_rates(self.data.qacc)

    def sampled_velocity(self) -> FloatArray:
        return self._sampled_rates(self.data.qvel - self.model.opt.timestep * self.data.qacc)

    def _sampled_rates(self, values: FloatArray) -> FloatArray:
        """(capacity, 6) linear and angular rates of all boxes at the beginning of the last step, in the axes of the
        boxes. ``values``: the rates of all degrees of freedom."""
        points = self.data.xpos[self._point_bodies]
        rates = self._rates(values, points)
        to_box_axes = self._poses_of(points)[:, 3:] * [1.0, -1.0, -1.0, -1.0]
        rates[self._soft, 3:] = rotated_vectors(to_box_axes, rates[self._soft, 3:])
        return rates

    def accelerations(self) -> tuple[FloatArray, FloatArray]:
        acceleration = self._rates(self.data.qacc, self.data.xpos[self._point_bodies])
        turns = self.data.xmat[self._rigid_bodies].reshape(-1, 3, 3)
        acceleration[self._rigid, 3:] = np.einsum("kij,kj->ki", turns, acceleration[self._rigid, 3:])
        return acceleration[:, :3], acceleration[:, 3:]

    def contact_bodies(self) -> NDArray[np.intp]:
        contact = self.data.contact
        geom, flex = (np.reshape(ids, (-1, 2)) for ids in (contact.geom, contact.flex))
        bodies: NDArray[np.intp] = np.where(geom >= 0, self.geom_bodies[geom], np.append(self._soft, 0)[flex])
        return bodies

    def top_forces(self) -> FloatArray:
        total, data = np.zeros(self.capacity), self.data
        if not data.ncon:
            return total
        index, force = contact_normal_and_tangents(data, self.pyramidal)
        frame = np.asarray(data.contact.frame)[index].reshape(-1, 3, 3)
        bodies = self.contact_bodies()[index]
        box, sign, counts = pressed_box(bodies, frame[:, 0, 2])
        np.add.at(total, box[counts], (sign * contact_force_z(force, frame[:, :, 2]))[counts])
        return total

    # ------------------------------------------------------------------ placing and forces

    def place_next(self) -> None:
        box, state = self.n_placed, self._state()
        time_s = self.data.time
        place = self.scene.start_pos[box].copy()
        place[2] += self._top_of_supports(box)
        self._build(box + 1)
        self._put(state)
        self.data.time = time_s
        if self.scene.soft is not None and self.scene.soft[box]:
            self.data.qpos[self._q_of[-1]] = np.tile(place - self.scene.start_pos[box], COUNT)
        else:
            quat = self.scene.start_quat[box]
            self.data.qpos[self._rigid_q[-1]] = np.concatenate([self.scene.frame(box, place, quat), quat])
        self.n_placed += 1

    def _top_of_supports(self, box: int) -> float:
        """How much higher than planned the surface below a box is now, m. The surface is at the highest point of the
        box's supports within the areas that overlap the box."""
        scene = self.scene
        low, high = scene.target - scene.half_size, scene.target + scene.half_size
        if self._sim.physics.falls_into_place:
            return 0.0
        rises = [float(self.carrier_pose[2] - scene.carrier.pos[2])] if low[box, 2] <= TOUCH_M else []
        poses, points = self.pose, self._now()
        for below in range(box):
            sides = [shared_length(low[[below, box], axis], high[[below, box], axis])[0, 1] for axis in range(2)]
            if abs(high[below, 2] - low[box, 2]) > TOUCH_M or min(sides) <= 0:
                continue
            if below in self._soft:
                row = int(np.searchsorted(self._soft, below))
                top = points[row, POINTS[:, 2] > 0] + [0.0, 0.0, rounding_m(scene.half_size[below])]
            else:
                (turn,) = rotations(poses[below, None, 3:])
                top = poses[below, :3] + (POINTS[POINTS[:, 2] > 0] * scene.half_size[below]) @ turn.T
            plane = np.linalg.lstsq(np.column_stack([np.ones(len(top)), top[:, :2]]), top[:, 2], rcond=None)[0]
            corners = np.column_stack([np.maximum(low[below], low[box]), np.minimum(high[below], high[box])])[:2]
            heights = [plane @ (1.0, x, y) for x in corners[0] for y in corners[1]]
            rises.append(max(heights) - float(low[box, 2]))
        return max(rises, default=0.0)

    def set_box_forces(self, force_n: FloatArray) -> None:
        self.data.xfrc_applied[self._point_bodies, :3] = self._weight * force_n[self._soft, None]
        self.data.xfrc_applied[self._rigid_bodies, :3] = force_n[self._rigid]

    def from_carrier(self) -> tuple[FloatArray, FloatArray]:
        speed = np.zeros(3) if self._held is not None else self.data.qvel[:3]
        frames = self._joined(self._poses_of(self._now()), self.data.qpos[self._rigid_q])
        return frames[:, :3] - self.carrier_pose[:3], self.velocity[:, :3] - speed

    # ------------------------------------------------------------------ state

    def _state(self) -> SoftState:
        return SoftState(self.data.qpos.copy(), self.data.qvel.copy(), self.data.qacc_warmstart.copy())

    def _put(self, state: SoftState, skip_q: int = 0, skip_v: int = 0) -> None:
        """Use the state of a world that has the boxes of this world, or only the first of them. ``skip_q``, ``skip_v``:
        number of values of that world's carrier that are left out of qpos and qvel."""
        data = self.data
        data.qpos[: len(state.pos) - skip_q] = state.pos[skip_q:]
        data.qvel[: len(state.velocity) - skip_v] = state.velocity[skip_v:]
        data.qacc_warmstart[: len(state.warmstart) - skip_v] = state.warmstart[skip_v:]

    def hold_carrier(self) -> None:
        state, time_s = self._state(), self.data.time
        self._held = HeldCarrier(pos=state.pos[:3], quat=state.pos[3:7])
        self._build(self.capacity)
        self._put(state, skip_q=7, skip_v=6)
        self.data.time = time_s

    def body_state(self) -> SoftState:  # type: ignore[override]  # WorldRun passes it only to ``resume``
        return self._state()

    @classmethod
    def resume(  # type: ignore[override]  # takes the result of ``body_state``
        cls, scene: Scene, sim: Simulation, state: SoftState, time_s: float
    ) -> SoftWorld:
        live = cls(scene, sim, n_boxes=scene.n_boxes, shaken=True)
        live._put(state)
        live.data.time = time_s
        return live
