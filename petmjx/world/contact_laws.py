"""The laws of contacts: at rest, while sliding, and while landing.

**At rest.** MuJoCo's contacts are springs. A contact of stiffness k and impedance d(x) that carries the force f at rest
has the depth x given by (MuJoCo's documentation, chapter Computation, solver parameters)

    k · d(x)² · x / (1 − d(x)) = A · f,   k = 1 / (d₁ · τ · ζ)²

A is the sum of the partners' inverse masses, d₁ the impedance beyond the width, τ the time constant and ζ the damping
ratio. Beyond the width this gives x = (1 − d₁) · τ² · ζ² · A · f. So a light box gives way under a heavy load, however
stiff it is meant to be: with the values of ``pallet`` and four contacts per face, by 0.003 mm × load / own mass.

**Sliding.** The friction of a sliding contact should not change the contact's pressure. The coefficient of kinetic
friction may be smaller than that of static friction.

MuJoCo's friction is associated: pressure and friction of a sliding contact together minimise one cost (MuJoCo's
documentation, chapter Computation, "Constraint model"). Let j be the acceleration beyond the reference, R the
regularisation, and n and t the normal and the tangent. Then the minimum of a sliding contact is

    j_n + R_n · f_n = μ · (|j_t| − R_t · |f_t|)

In Coulomb's law the right-hand side is 0. |j_t| is about the reference acceleration that would end the slip,
|aref_t| = |v_t| · 2 / time constant of friction. So a slip raises the normal force, and sliding boxes hop. Boxes hop
higher the faster they slide, and the shorter the contact's time constant is. De Saxcé's correction removes this effect:
it lowers the reference acceleration along the normal by the right-hand side (G. de Saxcé and Z.-Q. Feng, "The
bipotential method", Mathematical and Computer Modelling 28, 1998; V. Acary and B. Brogliato, "Numerical Methods for
Nonsmooth Dynamical Systems", 2008, section 3.9):

    aref_n ← aref_n − μ · e,    e = max(|j_t| − R_t · |f_t| − slack, 0)

The excess e depends on accelerations and forces, and these depend on e. So e is found by iteration. The iteration
starts from the accelerations of the previous step, which is enough for boxes that slide steadily. While a box lands and
slides, friction ends part of the slip, so e is smaller. Without the iteration, the pressure in such contacts was too
low, and boxes slid two to three times as far.

The correction is the same on all engines: petmjx/engines/mujoco/slip.py, petmjx/engines/mjx/slip.py, and in the kernels
petmjx/engines/warp/kernels/constraint.py and ``respond`` in petmjx/engines/warp/solver/contact.cuh.

**Landing.** At rest, a contact is a spring with a damper (docs/rules.md, section 1). With this law, a landing box would
sink centimetres into its support and would not bounce. So while a box lands, its contacts follow another law. MuJoCo's
contacts have reference accelerations: the relative accelerations that the two bodies would have if the contact were
hard. In ``pallet``, contacts are nearly hard. So two bodies in contact accelerate relative to one another by the
reference acceleration, whatever their masses. The law:

- A box begins to land in the step in which one of its contacts closes faster than ``FAST_M_S``. If a box lands on
  another box, the box below lands, too. The velocities of both boxes before that step are remembered for
  ``lasts_steps``.
- v is the speed at which a contact closes. v₀ is the speed at which it would close with the remembered velocities. At
  the end of a landing, the contact should open at e·v₀ (Newton's law of impact; e is ``restitution``, or the value for
  the pair of materials), plus the speed that lifts the box out of the depth that it has reached. The contact is
  decelerated by (1 + e)·v₀ / ``landing_s``, or by less if that is enough in this step. So the force is constant during
  a landing and does not depend on the timestep. A box sinks v₀·``landing_s`` / 2 / (1 + e) deep, plus the distance that
  it travels in the step before.
- Meanwhile, all contacts of the world are as stiff as beyond the width of ``solimp``. Otherwise, boxes below, whose
  contacts carry little, would be pressed in before these contacts became stiff.

Bodies at rest are not affected: their contacts close more slowly than ``FAST_M_S``.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.options.physics import Cone, Physics, Triple
from petmjx.options.simulation import Simulation
from petmjx.world.friction_pairs import USUAL

CONTACTS_PER_FACE = 4
"""Number of contacts that MuJoCo makes between two faces: the corners of their common rectangle."""

MOST_IMPEDANCE = 0.9999
"""Largest impedance that MuJoCo accepts (mjMAXIMP): contacts are 10 times as stiff as with 0.999."""

DEPTHS_M = np.geomspace(1e-9, 1e3, 2000)
"""Depths at which the force is computed, m. Between them the force is interpolated, with an error of 0.02 %."""


def is_stiff(physics: Physics) -> bool:
    """Whether contacts are as stiff at their onset as beyond the width. Attempts 6 and 7 have such contacts."""
    return physics.solimp[0] >= MOST_IMPEDANCE


def depth_m(physics: Physics, pull_m_s2: FloatArray | float) -> FloatArray:
    """Depth of a contact at rest, m, for each value of A · f ≥ 0, m/s²."""
    pulls = pulls_m_s2(physics.solref, physics.solimp, physics.timestep_s)
    return np.asarray(np.interp(pull_m_s2, pulls, DEPTHS_M, left=0.0))


@lru_cache(maxsize=16)
def pulls_m_s2(solref: tuple[float, float], solimp: Triple, timestep_s: float) -> FloatArray:
    """A · f at each of ``DEPTHS_M``, m/s²."""
    time_s, damping = solref
    low, high = np.minimum(solimp[:2], MOST_IMPEDANCE)
    x = np.minimum(DEPTHS_M / solimp[2], 1.0)
    impedance = low + (high - low) * np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)
    # negative values of solref are stiffness and damping themselves
    stiffness = -time_s if time_s < 0 else 1 / (max(time_s, 2 * timestep_s) * damping) ** 2
    pulls: FloatArray = stiffness / high**2 * impedance**2 * DEPTHS_M / (1 - impedance)
    return np.maximum.accumulate(pulls)


def cone_factor(physics: Physics, one: FloatArray | float, two: FloatArray | float) -> FloatArray:
    """The factor by which pyramidal cones make contacts softer, for these coefficients of sliding friction.

    Each of the four edges of a pyramid has 2μ²(1 + μ²) times the regularisation of the elliptic cone's normal, and all
    four edges act together.
    """
    if physics.cone is Cone.ELLIPTIC:
        return np.ones(np.broadcast_shapes(np.shape(one), np.shape(two)))
    mu2 = np.maximum(one, two) ** 2
    return np.asarray(2 * mu2 * (1 + mu2) / 4)


SLACK_M_S2: Final = 5.0
"""Excess that stays uncorrected, m/s²: that of a slip of 1 cm/s with a time constant of friction of 4 ms. This excess,
left uncorrected, raises a contact by less than a hundredth of a millimetre, which is within the contact's soft onset.
With this slack, pallets at rest are bit-identical with and without the correction. Stiff contacts have no soft onset,
and therefore no slack."""

STICKS_M_S: Final = 0.01
"""Up to this slip speed, a contact has its full friction; from twice this speed on, it has the kinetic friction. So
friction does not jump if boxes creep (petmjx.Quiet calls a box quiet at far smaller speeds)."""

RELAXATION: Final = 0.8
"""Share of the change of an excess that one iteration applies. Applying the whole change converges only if μ² times the
ratio of the inverse masses along tangent and normal is below 1. So it would not converge for tall boxes with friction
above 0.5. With this share, the iteration converges if this product is at most 1.5, and nearly as quickly."""

ENOUGH_M_S2: Final = 0.1
"""The iteration ends when no normal reference acceleration changes by more than this: a hundredth of gravity. With a
value of 5, a box that tipped against its neighbour slid twice as far; with 1, it slid 3 % less far."""

MOST_ROUNDS: Final = 6
"""Largest number of iterations per step. An iteration updates the excess between two calls of a solver. Bricks that
slide and tip need two on average. A heap in which everything slides at once is still off by a median of 1 m/s² after
twenty."""


FIRST_SHARE: Final = 1.1
"""Share of the first change of an excess that is applied in a step, if ``next_share`` chooses the later shares for each
contact. With this value, bricks that slide and tip need 2.4 solves per step; with 0.8 they need 2.6, and with
``RELAXATION`` alone 3.1."""

LEAST_M_S2: Final = ENOUGH_M_S2 / 10
"""Smallest change of an excess from which the next share is estimated, m/s². Smaller changes are within the solver's
own tolerance."""

MOST_LEFT: Final = 0.6
"""Largest part of a change that may remain after a share of it was applied. If more seems to remain, other contacts
have changed the excess."""


def slack_m_s2(physics: Physics) -> float:
    """The slack: excess up to which a sliding contact is not corrected, m/s²; inf: contacts are never corrected."""
    if physics.cone is not Cone.ELLIPTIC or not physics.slip_correction:
        return math.inf
    return 0.0 if is_stiff(physics) else SLACK_M_S2


def kinetic_share(physics: Physics) -> float:
    """Friction of fast-sliding contacts, as a share of the friction at rest."""
    return physics.kinetic_friction_share if physics.cone is Cone.ELLIPTIC else 1.0


def next_share(share: FloatArray, change: FloatArray, last: FloatArray) -> FloatArray:
    """(k,) share of the change of an excess that the next iteration applies, computed for each contact separately.

    If the excess is linear, this share in the last iteration would have left no change (Aitken's delta-squared
    process).

    Args:
        share: (k,) share of the last change that was applied.
        change: (k,) change that remains, m/s².
        last: (k,) the last change, m/s²; 0 before the first iteration.
    """
    left = np.divide(change, last, out=np.zeros_like(change), where=np.abs(last) > LEAST_M_S2)
    return share / (1.0 - np.clip(left, -1.0, MOST_LEFT))


def friction_share(slip_m_s: FloatArray, kinetic: FloatArray | float) -> FloatArray:
    """Friction at these slip speeds, as a share of friction at rest. ``kinetic``: the share for fast contacts."""
    return 1.0 - (1.0 - kinetic) * np.clip(slip_m_s / STICKS_M_S - 1.0, 0.0, 1.0)


FAST_M_S: Final = 0.1
"""A contact that closes faster than this counts as a landing, m/s: the speed after a fall from 0.5 mm."""

AT_REST: Final = 2.0
"""Depth of contacts at the end of a rebound, as a multiple of the width of ``solimp``. Contacts at rest are 1.3 times
the width deep. Contacts still push a little while a box rises out of them. With this value, restitutions from 0.1 to
0.3 are met within 0.03 for falls from 10 mm, in whatever part of a step the box lands. A restitution of 0.1 lifts the
box by a tenth of a millimetre."""

_LONGER: Final = 2.0
"""A landing is remembered for this multiple of ``landing_s``, since the second corner of a box may come down later."""


def lasts_steps(sim: Simulation) -> int:
    """Number of steps for which a box that has touched down counts as landing."""
    longest_s = max([sim.physics.landing_s, *(pair.landing_s or 0.0 for pair in sim.landing_pairs)])
    return math.ceil(_LONGER * longest_s / sim.physics.timestep_s) + 1


def stiffness_ratio(depth_m: FloatArray, solimp: FloatArray) -> FloatArray:
    """(k,) factors by which contacts are stiffer at their largest impedance than at these depths.

    MuJoCo's regularisation is (1 − d)/d times the inverse masses (its documentation, "Modeling", "Solver parameters").

    Args:
        depth_m: (k,) depths of the contacts.
        solimp: (k, 3) impedances at the onset and beyond the width, and the width, m; with MuJoCo's
            midpoint 0.5 and power 2.
    """
    low, high, width = np.clip(solimp[:, 0], 1e-4, 0.9999), np.clip(solimp[:, 1], 1e-4, 0.9999), solimp[:, 2]
    x = np.clip(np.abs(depth_m) / width, 0.0, 1.0)
    d = low + (high - low) * np.where(x <= 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)
    factor: FloatArray = (1 - d) / d / ((1 - high) / high)
    return factor


def pull(
    closing_m_s: FloatArray,
    before_m_s: FloatArray,
    depth_m: FloatArray,
    normal_z: FloatArray,
    of_pair: FloatArray,
    physics: Physics,
) -> FloatArray:
    """(k,) reference accelerations of contacts in a landing, m/s², positive when opening; NaN: the law at rest applies.

    Args:
        closing_m_s: (k,) speeds at which the contacts close.
        before_m_s: (k,) speeds at which the contacts would close with the velocities before the landing.
        depth_m: (k,) depths of the contacts.
        normal_z: (k,) z components of the unit normals.
        of_pair: (k, 2) restitution and landing time of each contact, as in ``petmjx.world.scene.Scene.pair_landing``.
    """
    usual, step_s = (physics.restitution, physics.landing_s), physics.timestep_s
    share, landing_s = np.where(of_pair == USUAL, usual, of_pair).T
    fall = np.abs(normal_z) * physics.gravity_m_s2
    # a step moves by the velocity at its end, so a body that leaves with speed v rises by v² / 2g + v · timestep / 2
    energy = np.maximum((share * before_m_s) ** 2 + 2 * fall * (depth_m - AT_REST * physics.solimp[2]), 0.0)
    opening = np.where(share > 0, np.sqrt((fall * step_s / 2) ** 2 + energy) - fall * step_s / 2, 0.0)
    enough = (closing_m_s + opening) / step_s
    most = (1 + share) * before_m_s / landing_s
    lands = (before_m_s > FAST_M_S) & (enough > 0)
    return np.where(lands, np.minimum(enough, most), np.nan)
