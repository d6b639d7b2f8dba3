"""The referee PhysX 5 (package ``sapien``). Its solver is projected Gauss-Seidel, because with its other solver (TGS)
resting piles creep."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import sapien
from sapien import physx

from benchmarks.referees.referee import CARRIER, FIRST_BOX, FLOOR, box_inertia, slab, top_forces
from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics
from petmjx.world.scene import Scene

VELOCITY_ITERATIONS: Final = 1
CONTACT_OFFSET_M: Final = 0.002
"""Distance at which PhysX finds contacts, m. Contacts act only when faces touch."""

_PLANE_UP = (math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0)
"""PhysX's planes face along x."""


class PhysxReferee:
    """The referee PhysX, with timesteps of 2 ms and 100 iterations. With fine settings: 1 ms and 200 iterations."""

    name = "physx"
    settings: dict[str, Any] = {"package": "sapien", "timestep_s": 0.002, "iterations": 100, "solver": "pgs"}  # noqa: RUF012
    most_boxes = 100_000

    def world(self, scene: Scene, physics: Physics, fine: bool) -> PhysxWorld:
        return PhysxWorld(scene, physics, 0.001 if fine else 0.002, 200 if fine else 100)


class PhysxWorld:
    def __init__(self, scene: Scene, physics: Physics, timestep_s: float, iterations: int) -> None:
        self.timestep_s = timestep_s
        self._scene = scene
        physx.set_scene_config(
            gravity=np.array([0.0, 0.0, -physics.gravity_m_s2], np.float32),
            enable_tgs=False,
            enable_enhanced_determinism=True,
        )
        physx.set_shape_config(contact_offset=CONTACT_OFFSET_M, rest_offset=0.0)
        physx.set_body_config(
            solver_position_iterations=iterations,
            solver_velocity_iterations=VELOCITY_ITERATIONS,
            sleep_threshold=0.0,
        )
        self._system = physx.PhysxCpuSystem()
        self._system.timestep = timestep_s
        self._world = sapien.Scene([self._system])
        self._numbers: dict[Any, int] = {}
        self._boxes: list[Any] = []
        floor = physx.PhysxRigidStaticComponent()
        floor.attach(physx.PhysxCollisionShapePlane(_material(scene.floor_friction[0])))
        self._add(floor, FLOOR, np.array([0.0, 0.0, scene.floor_z]), np.array(_PLANE_UP))
        self._add_box(
            CARRIER,
            *slab(scene),
            scene.carrier.pos,
            np.array([1.0, 0.0, 0.0, 0.0]),
        )

    def place(self, box: int) -> None:
        scene = self._scene
        body = self._add_box(
            FIRST_BOX + box,
            scene.half_size[box],
            float(scene.mass[box]),
            float(scene.friction[box, 0]),
            scene.start_pos[box],
            scene.start_quat[box],
        )
        self._boxes.append(body)

    def step(self, count: int) -> None:
        for _ in range(count):
            self._system.step()

    def pose(self) -> FloatArray:
        poses = [body.entity_pose for body in self._boxes]
        return np.array([[*pose.p, *pose.q] for pose in poses], float).reshape(-1, 7)

    def top_forces(self) -> FloatArray:
        bodies, normal_z, force_z = [], [], []
        for contact in self._system.get_contacts():
            pair = (self._numbers[contact.bodies[0].entity], self._numbers[contact.bodies[1].entity])
            for point in contact.points:
                bodies.append(pair)
                normal_z.append(float(point.normal[2]))
                # PhysX's force acts on the first body
                force_z.append(-float(point.impulse[2]) / self.timestep_s)
        return top_forces(bodies, normal_z, force_z, self.pose())

    def close(self) -> None:
        self._boxes.clear()
        self._numbers.clear()
        self._world.clear()

    def _add(self, body: Any, number: int, pos: FloatArray, quat: FloatArray) -> None:
        entity = sapien.Entity()
        entity.add_component(body)
        entity.set_pose(sapien.Pose(pos, quat))
        self._world.add_entity(entity)
        self._numbers[entity] = number

    def _add_box(
        self, number: int, half_size: FloatArray, mass: float, friction: float, pos: FloatArray, quat: FloatArray
    ) -> Any:
        body = physx.PhysxRigidDynamicComponent()
        body.attach(physx.PhysxCollisionShapeBox(half_size.astype(np.float32), _material(friction)))
        body.set_mass(mass)
        body.set_inertia(box_inertia(mass, half_size).astype(np.float32))
        body.set_linear_damping(0.0)
        body.set_angular_damping(0.0)
        self._add(body, number, pos, quat)
        return body


def _material(friction: float) -> Any:
    return physx.PhysxMaterial(static_friction=friction, dynamic_friction=friction, restitution=0.0)


REFEREE: Final = PhysxReferee()
