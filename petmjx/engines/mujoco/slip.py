"""The law of sliding contacts on C MuJoCo. petmjx/world/contact_laws.py explains the law.

MuJoCo's step has two halves. Between the halves, the reference accelerations of contacts are known and the solver has
not started yet, so the law changes the contacts there.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.physics import Cone, Physics
from petmjx.world.contact_laws import (
    ENOUGH_M_S2,
    FIRST_SHARE,
    MOST_ROUNDS,
    STICKS_M_S,
    friction_share,
    kinetic_share,
    next_share,
    slack_m_s2,
)
from petmjx.world.surface_pairs import NOT_GIVEN

LOOK_STEPS = 5
"""Number of steps between two checks whether bodies move. At rest, these steps are taken in one call of C, without
Python's global interpreter lock. A body that begins to slip between two checks is at most 0.1 m/s fast at the second
check. Until the second check, the body's contacts keep their static friction."""

SLOW_M_S = STICKS_M_S / 4
"""While the norm of all velocities (m/s and rad/s) is below this value, no contact slides. If the norm is smaller, all
points within 1.7 m of a body's centre are slower than half of ``STICKS_M_S``."""


class SlipLaw:
    """Applies the law of sliding contacts in worlds with this physics.

    Args:
        pair_kinetic: kinetic shares of friction for pairs of surfaces: the table "kinetic" of a scene's ``pairs``.
        surfaces: (ngeom,) number of the surface of each geom in the model. Needed with ``pair_kinetic``.
    """

    def __init__(
        self,
        physics: Physics,
        pair_kinetic: FloatArray | None = None,
        surfaces: NDArray[np.intp] | None = None,
    ) -> None:
        self._slack = slack_m_s2(physics)
        self._share = kinetic_share(physics)
        self._of_pairs, self._surfaces = pair_kinetic, surfaces
        self._slows = self._share < 1 or pair_kinetic is not None
        self.acts = physics.cone is Cone.ELLIPTIC and (math.isfinite(self._slack) or self._slows)
        """Whether the law of sliding contacts has any effect with the world's options."""

    def may_slide(self, velocity: FloatArray) -> bool:
        """Whether any contact may be sliding. ``velocity``: (nv,) velocities of all bodies, m/s and rad/s."""
        return self.acts and bool(velocity.dot(velocity) > SLOW_M_S**2)

    def step2(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take the second half of a step, as ``mj_step2`` with Euler's integrator, and apply the law of sliding
        contacts. All contacts must have three constraint rows (``condim`` 3), which follow the rows of other
        constraints."""
        first = data.ne + data.nf + data.nl
        if not self.acts or data.nefc == first:
            mujoco.mj_step2(model, data)
            return
        if self._slows:
            slip = data.efc_vel[first:].reshape(-1, 3)[:, 1:]
            active = data.efc_id[first::3]
            share = friction_share(np.hypot(*slip.T), self._kinetic(data, active))
            data.contact.friction[active, :2] *= share[:, None]
            data.contact.mu[active] *= share
        aref = data.efc_aref[first:]
        one, two = aref[1::3], aref[2::3]
        reference = one * one + two * two
        slides = (reference > self._slack**2).nonzero()[0]
        if not len(slides):
            mujoco.mj_step2(model, data)
            return
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        self._solve(model, data, first + 3 * slides, np.sqrt(reference[slides]))
        mujoco.mj_checkAcc(model, data)
        mujoco.mj_Euler(model, data)

    def _kinetic(self, data: mujoco.MjData, active: NDArray[np.integer]) -> FloatArray | float:
        """Kinetic friction divided by static friction. If pairs of surfaces have their own values, the result is an
        array (k,) with one value per contact."""
        if self._of_pairs is None or self._surfaces is None:
            return self._share
        of_pair: FloatArray = self._of_pairs[tuple(self._surfaces[np.asarray(data.contact.geom)[active]].T)]
        return np.where(of_pair == NOT_GIVEN, self._share, of_pair)

    def _solve(
        self, model: mujoco.MjModel, data: mujoco.MjData, normal: NDArray[np.integer], reference: FloatArray
    ) -> None:
        """Find accelerations and forces of the bodies that agree with the law at the k sliding contacts.

        Args:
            normal: (k,) number of the constraint row of each contact's normal. The rows of the two tangents follow the
                row of the normal.
            reference: (k,) tangential reference acceleration of each contact, m/s².
        """
        one, two = normal + 1, normal + 2
        aref, along = data.efc_aref, np.zeros(data.nefc)
        friction = data.contact.friction[data.efc_id[normal], 0]
        lag = 1.0 / data.efc_D[one]
        before, aref_one, aref_two = aref[normal], aref[one], aref[two]

        def excess_at(qacc: FloatArray, dragged: FloatArray | float) -> FloatArray:
            """(k,) slip excess of each contact at the given accelerations, m/s². ``dragged``: R_t · |f_t| of each
            contact (regularisation times tangential force), m/s².
            """
            mujoco.mj_mulJacVec(model, data, along, qacc)
            beyond = np.hypot(along[one] - aref_one, along[two] - aref_two)
            excess: FloatArray = np.maximum(beyond - dragged - self._slack, 0.0)
            return excess

        excess: FloatArray = np.minimum(excess_at(data.qacc_warmstart, 0.0), reference - self._slack)
        force, share = data.efc_force, np.full(len(normal), FIRST_SHARE)
        last, iterations = np.zeros(len(normal)), 0
        for rounds in range(MOST_ROUNDS + 1):
            aref[normal] = before - friction * excess
            mujoco.mj_fwdConstraint(model, data)
            # ``solver_niter`` has a number for each island; islands are disabled, so the first number is the total
            iterations += int(data.solver_niter[0])
            if rounds == MOST_ROUNDS:
                break
            change = excess_at(data.qacc, lag * np.hypot(force[one], force[two])) - excess
            if (friction * np.abs(change)).max() <= ENOUGH_M_S2:
                break
            share = next_share(share, change, last)
            excess += share * change
            last = change
            data.qacc_warmstart[:] = data.qacc
        data.solver_niter[0] = iterations  # the iterations of all rounds together
