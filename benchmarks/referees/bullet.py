"""The referee Bullet 3 (package ``pybullet``). Its method is sequential impulses. A contact is kept until its points
are half a millimetre apart."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient

from benchmarks.referees.referee import CARRIER, FIRST_BOX, FLOOR, box_inertia, slab, top_forces
from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics
from petmjx.world.scene import Scene

BREAKING_M: Final = 0.0005
"""Distance at which a contact breaks, m. With Bullet's default of 20 mm, contacts that no longer touch hold boxes."""

_NORMAL, _FORCE, _ALONG_1, _SLIP_1, _ALONG_2, _SLIP_2 = 7, 9, 11, 10, 13, 12
"""Fields of a contact of Bullet. The normal points to the first body."""


class BulletReferee:
    """The referee Bullet, with timesteps of 1 ms and 200 iterations. With fine settings: 0.5 ms and 400 iterations."""

    name = "bullet"
    settings: dict[str, Any] = {  # noqa: RUF012
        "package": "pybullet",
        "timestep_s": 0.001,
        "iterations": 200,
        "contact_breaking_m": BREAKING_M,
    }
    most_boxes = 100_000

    def world(self, scene: Scene, physics: Physics, fine: bool) -> BulletWorld:
        return BulletWorld(scene, physics, 0.0005 if fine else 0.001, 400 if fine else 200)


class BulletWorld:
    def __init__(self, scene: Scene, physics: Physics, timestep_s: float, iterations: int) -> None:
        self.timestep_s = timestep_s
        self._scene = scene
        self._boxes: list[int] = []
        self._client = client = BulletClient(pybullet.DIRECT)
        client.setGravity(0, 0, -physics.gravity_m_s2)
        client.setPhysicsEngineParameter(
            fixedTimeStep=timestep_s,
            numSolverIterations=iterations,
            solverResidualThreshold=0.0,
            contactBreakingThreshold=BREAKING_M,
            deterministicOverlappingPairs=1,
        )
        plane = client.createCollisionShape(pybullet.GEOM_PLANE)
        floor = client.createMultiBody(0, plane, basePosition=[0, 0, scene.floor_z])
        client.changeDynamics(floor, -1, lateralFriction=_own(scene.floor_friction[0]))
        carrier = self._add_box(
            *slab(scene),
            scene.carrier.pos,
            np.array([1.0, 0.0, 0.0, 0.0]),
        )
        self._numbers = {floor: FLOOR, carrier: CARRIER}

    def place(self, box: int) -> None:
        scene = self._scene
        body = self._add_box(
            scene.half_size[box],
            float(scene.mass[box]),
            float(scene.friction[box, 0]),
            scene.start_pos[box],
            scene.start_quat[box],
        )
        self._numbers[body] = FIRST_BOX + box
        self._boxes.append(body)

    def step(self, count: int) -> None:
        for _ in range(count):
            self._client.stepSimulation()

    def pose(self) -> FloatArray:
        poses = np.zeros((len(self._boxes), 7))
        for row, body in zip(poses, self._boxes, strict=True):
            row[:3], quat = self._client.getBasePositionAndOrientation(body)
            row[3:] = np.roll(quat, 1)
        return poses

    def top_forces(self) -> FloatArray:
        bodies, normal_z, force_z = [], [], []
        for point in self._client.getContactPoints():
            normal, along_1, along_2 = point[_NORMAL], point[_ALONG_1], point[_ALONG_2]
            on_first = point[_FORCE] * normal[2] + point[_SLIP_1] * along_1[2] + point[_SLIP_2] * along_2[2]
            bodies.append((self._numbers[point[1]], self._numbers[point[2]]))
            normal_z.append(normal[2])
            force_z.append(-on_first)
        return top_forces(bodies, normal_z, force_z, self.pose())

    def close(self) -> None:
        self._client.disconnect()

    def _add_box(self, half_size: FloatArray, mass: float, friction: float, pos: FloatArray, quat: FloatArray) -> int:
        client = self._client
        shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half_size.tolist())
        body: int = client.createMultiBody(
            mass, shape, basePosition=pos.tolist(), baseOrientation=np.roll(quat, -1).tolist()
        )
        client.changeDynamics(
            body,
            -1,
            lateralFriction=_own(friction),
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            localInertiaDiagonal=box_inertia(mass, half_size).tolist(),
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        )
        return body


def _own(friction: float) -> float:
    """The coefficient of friction that each of two bodies needs, since Bullet multiplies the two coefficients."""
    return math.sqrt(friction)


REFEREE: Final = BulletReferee()
