"""The referee Drake. Its contacts are pressure fields (hydroelastic), and its friction has a stiction tolerance. Drake
is slow, so Drake gets only small piles."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    HalfSpace,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from benchmarks.referees.referee import CARRIER, FIRST_BOX, FLOOR, slab, top_forces
from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics
from petmjx.world.scene import Scene

MODULUS_PA: Final = 1e8
DISSIPATION_S_M: Final = 50.0
TIMESTEP_S: Final = 0.001


class DrakeReferee:
    """The referee Drake, with a timestep of 1 ms and a stiction tolerance of 1e-4 m/s. With fine settings: 0.5 ms and
    1e-5 m/s."""

    name = "drake"
    settings: dict[str, Any] = {  # noqa: RUF012
        "package": "drake",
        "timestep_s": TIMESTEP_S,
        "contact": "lagged",
        "modulus_pa": MODULUS_PA,
        "dissipation_s_m": DISSIPATION_S_M,
        "stiction_m_s": 1e-4,
    }
    most_boxes = 6

    def world(self, scene: Scene, physics: Physics, fine: bool) -> DrakeWorld:
        return DrakeWorld(scene, physics, TIMESTEP_S / 2 if fine else TIMESTEP_S, 1e-5 if fine else 1e-4)


class DrakeWorld:
    """A world in Drake. A plant (Drake's model) has all its bodies from the beginning, so each new box needs a new
    plant."""

    def __init__(self, scene: Scene, physics: Physics, timestep_s: float, stiction_m_s: float) -> None:
        self.timestep_s = timestep_s
        self._scene, self._physics = scene, physics
        self._config = MultibodyPlantConfig(
            time_step=timestep_s,
            contact_model="hydroelastic_with_fallback",
            discrete_contact_approximation="lagged",
            stiction_tolerance=stiction_m_s,
        )
        self._pose = np.array([[*scene.carrier.pos, 1.0, 0.0, 0.0, 0.0]])
        self._velocity = np.zeros((1, 6))
        self._simulator: Any = None

    def place(self, box: int) -> None:
        if self._simulator is not None:
            self._pose, self._velocity = self._all_poses(), self._all_velocities()
            self._simulator = None
        scene = self._scene
        self._pose = np.vstack((self._pose, [[*scene.start_pos[box], *scene.start_quat[box]]]))
        self._velocity = np.vstack((self._velocity, np.zeros((1, 6))))

    def step(self, count: int) -> None:
        if self._simulator is None:
            self._build()
        steps = round(self._simulator.get_context().get_time() / self.timestep_s) + count
        self._simulator.AdvanceTo(steps * self.timestep_s)

    def pose(self) -> FloatArray:
        return (self._pose if self._simulator is None else self._all_poses())[1:]

    def top_forces(self) -> FloatArray:
        contacts = self._plant.get_contact_results_output_port().Eval(self._context)
        bodies, normal_z, force_z = [], [], []
        for number in range(contacts.num_hydroelastic_contacts()):
            info = contacts.hydroelastic_contact_info(number)
            surface = info.contact_surface()
            area_normal = sum(surface.area(k) * surface.face_normal(k) for k in range(surface.num_faces()))
            bodies.append((self._numbers[surface.id_N()], self._numbers[surface.id_M()]))
            normal_z.append(float(area_normal[2] / np.linalg.norm(area_normal)))
            force_z.append(float(info.F_Ac_W().translational()[2]))  # Drake's force acts on the body M of a contact
        return top_forces(bodies, normal_z, force_z, self.pose())

    def close(self) -> None:
        self._simulator = None

    def _build(self) -> None:
        scene = self._scene
        builder = DiagramBuilder()
        self._plant, _ = AddMultibodyPlant(self._config, builder)
        plant = self._plant
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -self._physics.gravity_m_s2])
        floor = plant.RegisterCollisionGeometry(
            plant.world_body(), RigidTransform([0, 0, scene.floor_z]), HalfSpace(), "floor", _floor(scene)
        )
        self._numbers = {floor: FLOOR}
        self._bodies = []
        for number in range(len(self._pose)):
            box = number - 1
            is_carrier = number == 0
            of_box = scene.half_size[box], float(scene.mass[box]), float(scene.friction[box, 0])
            half, mass, friction = slab(scene) if is_carrier else of_box
            body = plant.AddRigidBody(f"body_{number}", SpatialInertia.SolidBoxWithMass(mass, *(2 * half)))
            geometry = plant.RegisterCollisionGeometry(
                body, RigidTransform(), Box(*(2 * half)), f"geometry_{number}", _soft(friction)
            )
            self._numbers[geometry] = CARRIER if is_carrier else FIRST_BOX + box
            self._bodies.append(body)
        plant.Finalize()
        self._simulator = Simulator(builder.Build())
        self._context = plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
        for body, pose, velocity in zip(self._bodies, self._pose, self._velocity, strict=True):
            turned = RotationMatrix(_matrix(pose[3:]))
            plant.SetFreeBodyPose(self._context, body, RigidTransform(turned, pose[:3]))
            plant.SetFreeBodySpatialVelocity(self._context, body, SpatialVelocity(w=velocity[3:], v=velocity[:3]))
        self._simulator.Initialize()

    def _all_poses(self) -> FloatArray:
        poses = [self._plant.EvalBodyPoseInWorld(self._context, body) for body in self._bodies]
        return np.array([[*pose.translation(), *pose.rotation().ToQuaternion().wxyz()] for pose in poses])

    def _all_velocities(self) -> FloatArray:
        velocities = [self._plant.EvalBodySpatialVelocityInWorld(self._context, body) for body in self._bodies]
        return np.array([[*velocity.translational(), *velocity.rotational()] for velocity in velocities])


def _matrix(quat: FloatArray) -> FloatArray:
    """(3, 3) rotation matrix of a quaternion (w, x, y, z)."""
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _soft(friction: float) -> ProximityProperties:
    properties = ProximityProperties()
    AddCompliantHydroelasticProperties(1.0, MODULUS_PA, properties)  # boxes are not divided further
    AddContactMaterial(DISSIPATION_S_M, None, CoulombFriction(friction, friction), properties)
    return properties


def _floor(scene: Scene) -> ProximityProperties:
    friction = scene.floor_friction[0]
    properties = ProximityProperties()
    AddRigidHydroelasticProperties(properties)
    AddContactMaterial(None, None, CoulombFriction(friction, friction), properties)
    return properties


REFEREE: Final = DrakeReferee()
