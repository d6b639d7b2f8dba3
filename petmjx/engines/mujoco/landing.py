"""Contact law of landing boxes on C MuJoCo. The law stops boxes that arrive fast, or lets them bounce.

petmjx/world/contact_laws.py explains the law.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.simulation import Simulation
from petmjx.world.contact_laws import FAST_M_S, lasts_steps, pull, stiffness_ratio
from petmjx.world.mujoco_model import geom_surfaces
from petmjx.world.scene import Scene
from petmjx.world.surface_pairs import filled_up

CALM_M_S2 = 0.5
"""Many steps are taken in one call while the norm of all accelerations (m/s² and rad/s²) is at most this value. With
accelerations below this limit, the speed of a box grows by at most 5 mm/s in five steps."""


class MovingWorld(Protocol):
    """The members of ``petmjx.engines.mujoco.live_world.LiveWorld`` that ``Landings`` uses."""

    model: mujoco.MjModel
    data: mujoco.MjData
    n_placed: int

    @property
    def geom_bodies(self) -> NDArray[np.integer]: ...

    @property
    def velocity(self) -> FloatArray: ...

    def with_velocities(self, boxes: NDArray[np.bool_], velocity: FloatArray) -> FloatArray: ...


class Landings:
    """The landing boxes of a world, and their velocities before they landed.

    Attributes:
        left: (n,) number of further steps for which each box counts as landing, or 0 if the box is not landing.
        before: (n, 6) velocities of the landing boxes before they touched anything, m/s and rad/s.
    """

    def __init__(self, scene: Scene, sim: Simulation) -> None:
        n_boxes = scene.n_boxes
        self._scene, self._sim = scene, sim
        self._physics, self._lasts = sim.physics, lasts_steps(sim)
        self._table = filled_up(scene.pairs, "landing")
        self.left: NDArray[np.intp] = np.zeros(n_boxes, np.intp)
        self.before: FloatArray = np.zeros((n_boxes, 6))
        self._placed = 0

    def fork(self) -> Landings:
        """A copy of this object, for a copy (*fork*) of the world."""
        twin = Landings(self._scene, self._sim)
        twin.left[:], twin.before[:], twin._placed = self.left, self.before, self._placed
        return twin

    def extended(self, scene: Scene) -> Landings:
        """A copy of this object, for the same world with additional boxes."""
        twin = Landings(scene, self._sim)
        twin.left[: len(self.left)], twin.before[: len(self.left)] = self.left, self.before
        return twin

    def over(self, live: MovingWorld) -> bool:
        """Whether no box is landing, and no box can land in the next few steps."""
        data = live.data
        placed, self._placed = self._placed, live.n_placed
        # a box that was just placed has no acceleration yet, but may begin to fall
        if placed != live.n_placed or self.left.any():
            return False
        acceleration = data.qacc
        return _is_slow(data.qvel) and bool(acceleration.dot(acceleration) < CALM_M_S2**2)

    def act(self, live: MovingWorld) -> None:
        """Find boxes that begin to land, and change the contacts while any box is landing. Must be called after
        collision detection and before the solver."""
        data, left = live.data, self.left
        landing = bool(left.any())
        if landing:
            np.maximum(left - 1, 0, out=left)
            landing = bool(left.any())
        elif _is_slow(data.qvel):
            return
        contact = data.contact
        address = np.asarray(contact.efc_address)
        these = np.flatnonzero(address >= 0)
        row = address[these]
        closing = -data.efc_vel[row]
        fast = closing > FAST_M_S
        if not landing and not fast.any():
            return
        geoms = np.asarray(contact.geom)[these]
        boxes = live.geom_bodies[geoms]
        hit = boxes[fast].ravel()
        hit = hit[hit >= 0]
        fresh = hit[left[hit] == 0]
        if len(fresh):
            self.before[fresh] = live.velocity[fresh]
            left[fresh] = self._lasts
        if not left.any():
            return
        physics = self._physics
        depth = data.efc_margin[row] - data.efc_pos[row]
        impedances = np.asarray(contact.solimp)[these, :3]
        stiffer = stiffness_ratio(depth, impedances)
        for part in range(3):
            data.efc_R[row + part] /= stiffer
            data.efc_D[row + part] *= stiffer
        lands = ((boxes >= 0) & (left[np.maximum(boxes, 0)] > 0)).any(axis=1) & (impedances[:, 1] >= physics.solimp[1])
        speeds = np.zeros(data.nefc)
        mujoco.mj_mulJacVec(live.model, data, speeds, live.with_velocities(left > 0, self.before))
        normal_z = np.asarray(contact.frame)[these, 2]
        surface = geom_surfaces(self._scene, live.geom_bodies)[geoms]
        of_pair = self._table[surface[:, 0], surface[:, 1]]
        acceleration = pull(closing, -speeds[row], depth, normal_z, of_pair, physics)
        acts = lands & np.isfinite(acceleration)
        data.efc_aref[row[acts]] = acceleration[acts]


def _is_slow(velocity: FloatArray) -> bool:
    """Whether all bodies are too slow for a landing. ``velocity``: (nv,) velocities of all bodies, m/s and rad/s."""
    return bool(velocity.dot(velocity) < (0.5 * FAST_M_S) ** 2)
