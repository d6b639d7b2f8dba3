"""Contacts that slide, on C MuJoCo. The law: petmjx/world/slip.py.

MuJoCo takes a step in two halves. Between them contacts have their reference accelerations, and the solver has not
begun.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.options.physics import Cone, Physics
from petmjx.world.slip import STICKS_M_S, friction_share, slack_m_s2

LOOK_STEPS = 5
"""Steps from one look whether anything moves to the next. A pallet at rest takes them in one call of C, without the
interpreter's lock. What begins to slip between two looks has at most 0.1 m/s at the second one, which lifts no contact
out of its soft onset."""

SLOW_M_S = STICKS_M_S / 4
"""Of the norm of all velocities: a point of a body less than 1.7 m from its centre is then slower than half of
``STICKS_M_S``, and no contact slides by its law."""


class SlipLaw:
    """The law of contacts that slide, for worlds with these physics."""

    def __init__(self, physics: Physics) -> None:
        self._slack = slack_m_s2(physics)
        self._share = physics.kinetic_friction_share
        self.acts = physics.cone is Cone.ELLIPTIC and (math.isfinite(self._slack) or self._share < 1)
        """Whether it changes anything."""

    def may_slide(self, velocity: FloatArray) -> bool:
        """Whether a contact may slide. ``velocity``: (nv,) of all bodies."""
        return self.acts and bool(velocity.dot(velocity) > SLOW_M_S**2)

    def step(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take one step."""
        mujoco.mj_step1(model, data)
        if self.acts and data.nefc:
            self._correct(data)
        mujoco.mj_step2(model, data)

    def _correct(self, data: mujoco.MjData) -> None:
        """Change the contacts that slide, between the halves of a step."""
        contact = data.contact
        active = np.flatnonzero((contact.efc_address >= 0) & (contact.dim >= 3))
        row = contact.efc_address[active]
        if self._share < 1:
            slip = np.hypot(data.efc_vel[row + 1], data.efc_vel[row + 2])
            share = friction_share(slip, self._share)
            contact.friction[active, :2] *= share[:, None]
            contact.mu[active] *= share
        aref = data.efc_aref
        excess = np.hypot(aref[row + 1], aref[row + 2]) - self._slack
        slides = excess > 0
        if slides.any():
            aref[row[slides]] -= contact.friction[active[slides], 0] * excess[slides]
