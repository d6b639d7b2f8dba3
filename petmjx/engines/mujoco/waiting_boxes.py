"""Waiting boxes with pyramidal cones (physics ``reference``): one small body on a stop represents them.

Newton's method starts either from the accelerations of the last step or from the unconstrained ones, whichever have the
lower cost in the *whole* world. The method stops at a tolerance, so the choice of the start is visible in the results:
up to 100 N in single sampled impacts. In the reference implementation, the waiting boxes stand on the floor and take
part in this choice. The stop adds exactly their part of the difference in cost, with a single constraint row.
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
"""Constraint weight of the stop per kg: impedance / (1 − impedance) at solimp 0.99."""
_FLOOR_STIFFNESS = 396.0
"""Sum of the constraint weights of a box's four pyramidal contacts with the floor (solimp 0.99, friction 1), per kg."""


def add_waiting(spec: mujoco.MjSpec, physics: Physics) -> None:
    """Add the body that represents waiting boxes. The body's stop comes before all boxes in the model."""
    body = spec.worldbody.add_body(name=_NAME, pos=[0.0, 0.0, -_PARKING_M])
    body.mass = _MASS_KG
    body.inertia = np.ones(3)
    body.explicitinertial = True
    stop = body.add_joint(name=_NAME, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
    stop.range = np.array([0.0, 1.0])
    stop.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    stop.solimp_limit[:3] = physics.solimp


def press_waiting(model: mujoco.MjModel, data: mujoco.MjData, waiting_kg: float, gravity_m_s2: float) -> None:
    """Press on the stop with a force that makes its cost equal to the cost of the waiting boxes standing on the floor.

    Let a mass m be at rest on constraints of summed weight D, pulled by g. With the unconstrained acceleration, its
    cost is higher by (D + m)·g²/2 than with the true acceleration. For both stop and boxes, D is proportional to m.
    """
    share = (_FLOOR_STIFFNESS + 1.0) * waiting_kg / ((_STOP_STIFFNESS + 1.0) * _MASS_KG)
    data.xfrc_applied[model.body(_NAME).id, 2] = _MASS_KG * gravity_m_s2 * (1.0 - sqrt(share))
