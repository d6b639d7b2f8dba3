"""The laws of contacts: at rest, while sliding, and while landing. docs/rules.md, section 1, states the laws of sliding
and landing exactly.

**At rest.** MuJoCo's contacts are springs. If a contact of stiffness k and impedance d(x) carries the force f at rest,
its depth x follows from this equation (MuJoCo's documentation, chapter Computation, "Solver parameters"):

    k · d(x)² · x / (1 − d(x)) = A · f,   k = 1 / (d₁ · τ · ζ)²

A is the sum of the inverse masses of the two bodies. d₁ is the impedance at depths beyond ``solimp``'s width, τ the
time constant and ζ the damping ratio. At depths x beyond the width of ``solimp``, x = (1 − d₁) · τ² · ζ² · A · f. So
the contacts of a light box give way under a heavy load, even if they are meant to be stiff. With the physics ``pallet``
and four contacts per face, contacts give way by 0.003 mm × (mass on the box) / (mass of the box).

**Sliding.** In Coulomb's law, friction does not change the pressure of a sliding contact. In MuJoCo, the normal force
and the friction of a sliding contact together minimise one cost (associated friction; MuJoCo's documentation, chapter
Computation, "Constraint model"). Let j be the acceleration minus the reference acceleration, R the regularisation, f
the force, and n and t the indices of the normal and the tangent. At the minimum, a sliding contact obeys

    j_n + R_n · f_n = μ · (|j_t| − R_t · |f_t|)

In Coulomb's law, the right-hand side is 0. In MuJoCo, slip raises the normal force, and sliding boxes hop. De Saxcé's
correction lowers the reference acceleration along the normal by the right-hand side of this equation (G. de Saxcé and
Z.-Q. Feng, "The bipotential method", Mathematical and Computer Modelling 28, 1998; V. Acary and B. Brogliato,
"Numerical Methods for Nonsmooth Dynamical Systems", 2008, section 3.9):

    aref_n ← aref_n − μ · e,    e = max(|j_t| − R_t · |f_t| − slack, 0)

The *slip excess* e depends on accelerations and forces, which in turn depend on e. So e is found by iteration. Without
the iteration, the pressure in contacts of landing boxes was too low, and these boxes slid two to three times as far as
with the iteration.

**Landing.** With the law of contacts at rest, a landing box would sink centimetres into its support and would not
bounce. MuJoCo's contacts have reference accelerations: the relative accelerations that the two bodies would have if the
contact were hard. With the physics ``pallet``, contacts are nearly hard, so the bodies have almost the reference
acceleration, whatever their masses. The law of landing sets the reference acceleration to a constant deceleration,
which ends at the velocity of the rebound (Newton's law of impact). During a landing, all contacts of the world have the
stiffness that they have at depths beyond ``solimp``'s width. With the lower stiffness that contacts have at small
depths, boxes below the landing box would be pressed in before their contacts became stiff.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.options.physics import Cone, Physics, Triple
from petmjx.options.simulation import Simulation
from petmjx.world.surface_pairs import NOT_GIVEN

CONTACTS_PER_FACE = 4
"""Number of contacts that MuJoCo makes between two faces: the corners of their common rectangle."""

MOST_IMPEDANCE = 0.9999
"""Largest impedance that MuJoCo accepts (mjMAXIMP). Contacts with an impedance of 0.9999 are 10 times as stiff as with
an impedance of 0.999."""

DEPTHS_M = np.geomspace(1e-9, 1e3, 2000)
"""Depths of a contact at which its force is computed, m. For other depths, the force is interpolated, with an error of
0.02 %."""


def is_stiff(physics: Physics) -> bool:
    """Whether contacts have their full stiffness from depth 0 on. If a world is simulated again because its result was
    doubtful, the sixth and seventh attempts use contacts with full stiffness from depth 0 on."""
    return physics.solimp[0] >= MOST_IMPEDANCE


def depth_m(physics: Physics, pull_m_s2: FloatArray | float) -> FloatArray:
    """Depth of a contact at rest, m, for each given A · f, m/s² (sum of the inverse masses of the two bodies × force).
    If A · f is 0 or negative, the depth is 0."""
    pulls = pulls_m_s2(physics.solref, physics.solimp, physics.timestep_s)
    return np.asarray(np.interp(pull_m_s2, pulls, DEPTHS_M, left=0.0))


@lru_cache(maxsize=16)
def pulls_m_s2(solref: tuple[float, float], solimp: Triple, timestep_s: float) -> FloatArray:
    """A · f (sum of the inverse masses of the two bodies × force), m/s², of a contact at rest at each depth of
    ``DEPTHS_M``."""
    time_s, damping = solref
    low, high = np.minimum(solimp[:2], MOST_IMPEDANCE)
    x = np.minimum(DEPTHS_M / solimp[2], 1.0)
    impedance = low + (high - low) * np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)
    # negative numbers in ``solref`` are −stiffness and −damping
    stiffness = -time_s if time_s < 0 else 1 / (max(time_s, 2 * timestep_s) * damping) ** 2
    pulls: FloatArray = stiffness / high**2 * impedance**2 * DEPTHS_M / (1 - impedance)
    return np.maximum.accumulate(pulls)


def cone_factor(physics: Physics, one: FloatArray | float, two: FloatArray | float) -> FloatArray:
    """The factor by which contacts with pyramidal friction cones are softer than contacts with elliptic cones. ``one``
    and ``two`` are the coefficients of sliding friction of the two shapes.

    Each of the four edges of a pyramid has 2μ²(1 + μ²) times the regularisation of the elliptic cone's normal, and all
    four edges act together.
    """
    if physics.cone is Cone.ELLIPTIC:
        return np.ones(np.broadcast_shapes(np.shape(one), np.shape(two)))
    mu2 = np.maximum(one, two) ** 2
    return np.asarray(2 * mu2 * (1 + mu2) / 4)


SLACK_M_S2: Final = 5.0
"""Part of the slip excess of a sliding contact (see the module's docstring) that is not corrected, m/s². A slip of 1
cm/s has a slip excess of 5 m/s² if the time constant of friction is 4 ms. Boxes at rest slip more slowly, so pallets at
rest are bit-identical with and without the correction. At small depths, where contacts are soft, a slip excess of
``SLACK_M_S2`` that is not corrected raises the box by less than a hundredth of a millimetre. Stiff contacts
(``is_stiff``) are not soft at any depth, so their whole slip excess is corrected."""

STICKS_M_S: Final = 0.01
"""Slip speed up to which a contact has its static friction, m/s. At twice this speed and above, the contact has its
kinetic friction. From ``STICKS_M_S`` to twice this speed, friction falls linearly, so that it does not jump if boxes
move slowly. Boxes at rest are far slower (``petmjx.Quiet``)."""

RELAXATION: Final = 0.8
"""Relaxation factor: the share of the computed change of a slip excess (see the module's docstring) that one iteration
applies. Let p be μ² × (inverse mass along the tangent) / (inverse mass along the normal). If the whole change were
applied, the iteration would converge only if p is below 1. For tall boxes with friction above 0.5, p is larger than 1.
With the factor ``RELAXATION``, the iteration also converges for p up to 1.5, and otherwise takes hardly more rounds
than with the whole change."""

ENOUGH_M_S2: Final = 0.1
"""The iteration that finds the slip excesses (see the module's docstring) ends when no reference acceleration along a
normal changes by more than this value, m/s²: a hundredth of gravity. With a limit of 5 m/s², a box that tipped against
its neighbour slid twice as far as with 0.1 m/s². With a limit of 1 m/s², this box slid 3 % less far than with 0.1
m/s²."""

MOST_ROUNDS: Final = 6
"""Largest number of iterations per step. An iteration updates the slip excesses between two calls of a solver. Bricks
that slide and tip need two iterations on average. In a heap in which all boxes slide at once, the median error of a
slip excess is still 1 m/s² after twenty iterations."""


FIRST_SHARE: Final = 1.1
"""Relaxation factor of the first iteration of a step, if ``next_share`` chooses the factors of later iterations: the
iteration changes a slip excess by this multiple of the computed change. Bricks that slide and tip need 2.4 calls of the
solver per step if the first factor is 1.1; 2.6 calls if it is 0.8; 3.1 calls if all factors are ``RELAXATION``."""

LEAST_M_S2: Final = ENOUGH_M_S2 / 10
"""Smallest change of a slip excess (see the module's docstring) from which the relaxation factor of the next iteration
is estimated, m/s². Smaller changes are within the solver's tolerance."""

MOST_LEFT: Final = 0.6
"""Upper limit of a ratio in ``next_share``: the change of a slip excess (see the module's docstring) that remains after
an iteration, divided by the change that remained before. A larger ratio is a sign that other contacts have changed the
slip excess."""


def slack_m_s2(physics: Physics) -> float:
    """Part of the slip excess of a sliding contact (see the module's docstring) that is not corrected, m/s²; infinite
    if no contact is corrected."""
    if physics.cone is not Cone.ELLIPTIC or not physics.slip_correction:
        return math.inf
    return 0.0 if is_stiff(physics) else SLACK_M_S2


def kinetic_share(physics: Physics) -> float:
    """Kinetic friction as a share of static friction."""
    return physics.kinetic_friction_share if physics.cone is Cone.ELLIPTIC else 1.0


def next_share(share: FloatArray, change: FloatArray, last: FloatArray) -> FloatArray:
    """(k,) relaxation factor of each contact for the next iteration. The iteration applies this share of the computed
    change of the contact's slip excess (see the module's docstring).

    With the returned factor, the last iteration would have left no change, provided that the change is a linear
    function of the slip excess (Aitken's delta-squared process).

    Args:
        share: (k,) share of the change that the last iteration applied.
        change: (k,) change of the slip excess that remains to be made after the last iteration, m/s².
        last: (k,) change that remained to be made before the last iteration, m/s²; 0 before the first iteration.
    """
    left = np.divide(change, last, out=np.zeros_like(change), where=np.abs(last) > LEAST_M_S2)
    return share / (1.0 - np.clip(left, -1.0, MOST_LEFT))


def friction_share(slip_m_s: FloatArray, kinetic: FloatArray | float) -> FloatArray:
    """Friction at the given slip speeds, as a share of static friction. ``kinetic`` is the share at high speeds."""
    return 1.0 - (1.0 - kinetic) * np.clip(slip_m_s / STICKS_M_S - 1.0, 0.0, 1.0)


FAST_M_S: Final = 0.1
"""Closing speed above which a contact counts as a landing, m/s: the speed after a fall from 0.5 mm."""

AT_REST: Final = 2.0
"""Depth of contacts at the end of a landing, as a multiple of ``solimp``'s width. The depth of contacts at rest is 1.3
times the width. At the end of a landing, contacts are deeper than at rest, since they still push a little while the box
rises out of them. With ``AT_REST``, the restitution of boxes that fall 10 mm differs by at most 0.03 from the
restitution that was set (0.1 to 0.3). This is so at whichever moment of a timestep the boxes land. With a restitution
of 0.1, a box that fell 10 mm rises by a tenth of a millimetre."""

_LONGER: Final = 2.0
"""Duration of a landing as a multiple of ``landing_s``. The multiple exceeds 1, since a second corner of the box may
touch down later than the first."""


def lasts_steps(sim: Simulation) -> int:
    """Number of steps for which a box that has touched down counts as landing."""
    longest_s = max([sim.physics.landing_s, *(pair.landing_s or 0.0 for pair in sim.landing_pairs)])
    return math.ceil(_LONGER * longest_s / sim.physics.timestep_s) + 1


def stiffness_ratio(depth_m: FloatArray, solimp: FloatArray) -> FloatArray:
    """(k,) factor by which each contact is stiffer at its largest impedance than at its present depth.

    At the impedance d, MuJoCo's regularisation is (1 − d)/d times the inverse masses (MuJoCo's documentation,
    "Modeling", "Solver parameters").

    Args:
        depth_m: (k,) depths of the contacts, m.
        solimp: (k, 3) impedance at depth 0, impedance beyond the width, and the width, m. MuJoCo's fourth and fifth
            numbers of ``solimp`` are assumed to be 0.5 (midpoint) and 2 (power).
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
    """(k,) reference acceleration of each contact of a landing box, m/s²; positive if it opens the contact; NaN for a
    contact that follows the law of contacts at rest.

    Args:
        closing_m_s: (k,) speeds at which the contacts close, m/s.
        before_m_s: (k,) speeds at which the contacts would close with the velocities before the landing, m/s.
        depth_m: (k,) depths of the contacts, m.
        normal_z: (k,) z components of the contacts' unit normals.
        of_pair: (k, 2) restitution and landing time, s, of each contact. ``NOT_GIVEN`` stands for the value in
            ``physics``.
        physics: the physics, with gravity, timestep and ``solimp``, and with restitution and landing time for contacts
            that have ``NOT_GIVEN``.
    """
    usual, step_s = (physics.restitution, physics.landing_s), physics.timestep_s
    share, landing_s = np.where(of_pair == NOT_GIVEN, usual, of_pair).T
    fall = np.abs(normal_z) * physics.gravity_m_s2
    # each step moves a body with the velocity at the step's end: a body that leaves with the speed v rises by
    # v² / 2g + v · timestep / 2
    energy = np.maximum((share * before_m_s) ** 2 + 2 * fall * (depth_m - AT_REST * physics.solimp[2]), 0.0)
    opening = np.where(share > 0, np.sqrt((fall * step_s / 2) ** 2 + energy) - fall * step_s / 2, 0.0)
    enough = (closing_m_s + opening) / step_s
    most = (1 + share) * before_m_s / landing_s
    lands = (before_m_s > FAST_M_S) & (enough > 0)
    return np.where(lands, np.minimum(enough, most), np.nan)
