"""Contacts that slide: their friction leaves their pressure alone, and may be smaller than that of contacts that stick.

MuJoCo's friction is associated: of a contact that slides, pressure and friction minimise one cost together (its
documentation, chapter Computation, "Constraint model"). With j the acceleration beyond the reference, R the
regularisation, n and t normal and tangent, the minimum of a sliding contact is

    j_n + R_n · f_n = μ · (|j_t| − R_t · |f_t|)

instead of 0 on the right, which Coulomb's law has. So a slip raises the normal force, by μ times the reference
acceleration that would end it, |aref_t| = b · |v_t|: boxes that slide hop, the faster and the shorter friction's time
constant is the higher. De Saxcé's correction takes that out: where a contact slides, its reference acceleration along
the normal is lowered by the right-hand side (G. de Saxcé and Z.-Q. Feng, "The bipotential method", Mathematical and
Computer Modelling 28, 1998; V. Acary and B. Brogliato, "Numerical Methods for Nonsmooth Dynamical Systems", 2008,
section 3.9). Here with the slip at the beginning of the step, and |j_t| ≈ |aref_t| less what a soft onset bears:

    aref_n ← aref_n − μ · max(|aref_t| − ``slack``, 0)

The same on all engines: petmjx/engines/cpu/slip.py, petmjx/engines/batch/slip.py, and ``make_constraint`` in
petmjx/engines/warp/kernel/constraint.py.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.options.physics import Cone, Physics
from petmjx.world.contact import is_stiff

SLACK_M_S2: Final = 5.0
"""Reference acceleration of a slip that is not corrected: of 1 cm/s with friction's time constant of 4 ms. It raises a
contact by less than the hundredth of a millimetre, within its soft onset; and pallets at rest are what they are without
the correction, to the last bit. Stiff contacts have no soft onset, and no slack."""

STICKS_M_S: Final = 0.01
"""Up to this slip a contact has the whole friction; at twice as much it has the kinetic one. So friction does not leap
where boxes creep (petmjx.Quiet calls a box quiet at far smaller speeds)."""


def slack_m_s2(physics: Physics) -> float:
    """Reference acceleration up to which slip is not corrected, m/s²; inf: it never is."""
    if physics.cone is not Cone.ELLIPTIC or not physics.slip_correction:
        return math.inf
    return 0.0 if is_stiff(physics) else SLACK_M_S2


def friction_share(slip_m_s: FloatArray, kinetic: float) -> FloatArray:
    """What contacts have of their friction at rest, by how fast they slide. ``kinetic``: if they slide fast."""
    return 1.0 - (1.0 - kinetic) * np.clip(slip_m_s / STICKS_M_S - 1.0, 0.0, 1.0)
