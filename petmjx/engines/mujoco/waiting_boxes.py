"""A small body that represents the boxes that wait for their placement, in worlds with pyramidal friction cones.

Pyramidal cones are part of the physics preset ``reference``.

Newton's method starts either from the accelerations of the last step or from the accelerations without constraints. The
method chooses the start at which its cost function has the lower value, summed over the *whole* world. The method stops
at a tolerance, so this choice influences the results: single sampled impacts change by up to 100 N. In the reference
implementation, the waiting boxes stand on the floor, and their cost is part of the sum. In petmjx, a small body presses
on a stop with a single constraint row. The small body changes the difference between the costs of the two starts by
exactly as much as the waiting boxes would.
"""

from __future__ import annotations

from math import sqrt

import mujoco
import numpy as np

from petmjx.options.physics import Physics

_NAME = "waiting"
_MASS_KG = 1.0
_PARKING_M = 100.0
_STOP_STIFFNESS = 99.0
"""Weight of the stop's constraint in the solver, divided by the mass of the body that the stop holds: impedance / (1 −
impedance) with solimp 0.99."""
_FLOOR_STIFFNESS = 396.0
"""Sum of the constraint weights of the four pyramidal contacts of a box with the floor (solimp 0.99, friction 1),
divided by the box's mass."""


def add_waiting(spec: mujoco.MjSpec, physics: Physics) -> None:
    """Add the body that represents the waiting boxes, and its stop (the lower limit of its sliding joint). In the
    model, the constraint of the stop comes before the constraints of all boxes."""
    body = spec.worldbody.add_body(name=_NAME, pos=[0.0, 0.0, -_PARKING_M])
    body.mass = _MASS_KG
    body.inertia = np.ones(3)
    body.explicitinertial = True
    stop = body.add_joint(name=_NAME, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
    stop.range = np.array([0.0, 1.0])
    stop.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    stop.solimp_limit[:3] = physics.solimp


def press_waiting(model: mujoco.MjModel, data: mujoco.MjData, waiting_kg: float, gravity_m_s2: float) -> None:
    """Press the small body on its stop. The force is chosen so that the solver's cost is the same as with the waiting
    boxes on the floor.

    Let a mass m rest on constraints under the gravity g, and let D be the sum of the constraints' weights in the
    solver's cost. The cost of the mass is larger in free fall than at rest, by (D + m)·g²/2. For the stop and for the
    boxes, D is proportional to m.
    """
    share = (_FLOOR_STIFFNESS + 1.0) * waiting_kg / ((_STOP_STIFFNESS + 1.0) * _MASS_KG)
    data.xfrc_applied[model.body(_NAME).id, 2] = _MASS_KG * gravity_m_s2 * (1.0 - sqrt(share))
