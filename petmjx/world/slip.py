"""Contacts that slide: their friction leaves their pressure alone, and may be smaller than that of contacts that stick.

MuJoCo's friction is associated: of a contact that slides, pressure and friction minimise one cost together (its
documentation, chapter Computation, "Constraint model"). With j the acceleration beyond the reference, R the
regularisation, n and t normal and tangent, the minimum of a sliding contact is

    j_n + R_n · f_n = μ · (|j_t| − R_t · |f_t|)

instead of 0 on the right, which Coulomb's law has. |j_t| is about the reference acceleration that would end the slip,
|aref_t| = |v_t| · 2 / time constant of friction. So a slip raises the normal force: boxes that slide hop, the faster
and the shorter that time constant is the higher. De Saxcé's correction takes it out: the reference acceleration along
the normal is lowered by the right-hand side (G. de Saxcé and Z.-Q. Feng, "The bipotential method", Mathematical and
Computer Modelling 28, 1998; V. Acary and B. Brogliato, "Numerical Methods for Nonsmooth Dynamical Systems", 2008,
section 3.9),

    aref_n ← aref_n − μ · e,    e = max(|j_t| − R_t · |f_t| − ``slack``, 0)

Accelerations and forces depend on the excess e in turn, which is found by iteration. It begins with the accelerations
of the step before; boxes that slide steadily need no more. While a box lands and slides, friction ends a part of the
slip, and e is smaller. Without the iteration pressure was too low then, and boxes slid two and three times as far.

The same on all engines: petmjx/engines/cpu/slip.py, petmjx/engines/batch/slip.py, and in the kernels
petmjx/engines/warp/kernel/constraint.py and ``respond`` in petmjx/engines/warp/contact.cuh.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.options.physics import Cone, Physics
from petmjx.world.contact import is_stiff

SLACK_M_S2: Final = 5.0
"""Excess that is not corrected: that of a slip of 1 cm/s with friction's time constant of 4 ms. It raises a contact by
less than the hundredth of a millimetre, within its soft onset; and pallets at rest are what they are without the
correction, to the last bit. Stiff contacts have no soft onset, and no slack."""

STICKS_M_S: Final = 0.01
"""Up to this slip a contact has the whole friction; at twice as much it has the kinetic one. So friction does not leap
where boxes creep (petmjx.Quiet calls a box quiet at far smaller speeds)."""

RELAXATION: Final = 0.8
"""Share of an excess's change that an iteration takes. The whole change converges while μ² times the ratio of the
inverse masses along tangent and normal is below 1: not for tall boxes on a friction above 0.5. This share does up to
1.5, and is nearly as quick."""

ENOUGH_M_S2: Final = 0.1
"""Iteration ends where no pressure's reference acceleration changes by more: a hundredth of gravity. With 5 a box that
tipped against its neighbour slid twice as far; with 1, 3 % less far."""

MOST_ROUNDS: Final = 6
"""Changes of the excess in a step between calls of a solver, at most. Bricks that slide and tip need two in the mean;
a heap in which everything slides at once has not converged after twenty, by 1 m/s² in the median."""


FIRST_SHARE: Final = 1.1
"""Share of an excess's first change in a step, where each contact has a share of its own after that (``next_share``).
Bricks that slide and tip are then solved 2.4 times a step; with 0.8 2.6 times, with ``RELAXATION`` alone 3.1 times."""

LEAST_M_S2: Final = ENOUGH_M_S2 / 10
"""Smaller changes of an excess say nothing about the next one: the solver's own tolerance is in them."""

MOST_LEFT: Final = 0.6
"""Of a change, after a share of it was taken. Where the excess is worked out as if more were left, other contacts have
moved it."""


def slack_m_s2(physics: Physics) -> float:
    """Excess up to which contacts that slide are not corrected, m/s²; inf: none is."""
    if physics.cone is not Cone.ELLIPTIC or not physics.slip_correction:
        return math.inf
    return 0.0 if is_stiff(physics) else SLACK_M_S2


def kinetic_share(physics: Physics) -> float:
    """Friction of contacts that slide fast, as a share of that at rest."""
    return physics.kinetic_friction_share if physics.cone is Cone.ELLIPTIC else 1.0


def next_share(share: FloatArray, change: FloatArray, last: FloatArray) -> FloatArray:
    """Shares of an excess's change that the next iteration takes, of contacts by themselves: those with which the last
    one would have left no change, if the excess is linear (Aitken's delta-squared process).

    Args:
        share: (k,) taken of the last change. change: (k,) what is left, m/s². last: (k,) the last one, 0 at first.
    """
    left = np.divide(change, last, out=np.zeros_like(change), where=np.abs(last) > LEAST_M_S2)
    return share / (1.0 - np.clip(left, -1.0, MOST_LEFT))


def friction_share(slip_m_s: FloatArray, kinetic: float) -> FloatArray:
    """What contacts have of their friction at rest, by how fast they slide. ``kinetic``: if they slide fast."""
    return 1.0 - (1.0 - kinetic) * np.clip(slip_m_s / STICKS_M_S - 1.0, 0.0, 1.0)
