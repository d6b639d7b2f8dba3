"""The law of a contact at rest: how deep it is under a load.

MuJoCo's contacts are springs. At rest (its documentation, chapter Computation, solver parameters) a contact of
stiffness k and impedance d(x) under the force f is x deep, with

    k · d(x)² · x / (1 − d(x)) = A · f,   k = 1 / (d₁ · τ · ζ)²

and A the sum of the partners' inverse masses, d₁ the impedance beyond the width, τ the time constant and ζ the damping
ratio. Beyond the width that is x = (1 − d₁) · τ² · ζ² · A · f. So a light box gives way under a heavy load, however
stiff it is meant to be: with the values of ``pallet`` and four contacts a face by 0.003 mm × load / own mass.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.options.physics import Cone, Physics, Triple

CONTACTS_PER_FACE = 4
"""Contacts that MuJoCo makes between two faces: the corners of their common rectangle."""

MOST_IMPEDANCE = 0.9999
"""The largest that MuJoCo takes (mjMAXIMP): contacts 10 times as stiff as with 0.999."""

DEPTHS_M = np.geomspace(1e-9, 1e3, 2000)
"""Depths for which the force is worked out; between them it is interpolated, to 0.02 %."""


def is_stiff(physics: Physics) -> bool:
    """Whether contacts are as stiff from their onset as beyond it, as in attempts 6 and 7."""
    return physics.solimp[0] >= MOST_IMPEDANCE


def depth_m(physics: Physics, pull_m_s2: FloatArray | float) -> FloatArray:
    """Depth of one contact at rest, m, for each A · f in m/s², ≥ 0."""
    pulls = pulls_m_s2(physics.solref, physics.solimp, physics.timestep_s)
    return np.asarray(np.interp(pull_m_s2, pulls, DEPTHS_M, left=0.0))


@lru_cache(maxsize=16)
def pulls_m_s2(solref: tuple[float, float], solimp: Triple, timestep_s: float) -> FloatArray:
    """A · f, m/s², at which a contact is as deep as each of ``DEPTHS_M``."""
    time_s, damping = solref
    low, high = np.minimum(solimp[:2], MOST_IMPEDANCE)
    x = np.minimum(DEPTHS_M / solimp[2], 1.0)
    impedance = low + (high - low) * np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)
    # negative values are stiffness and damping themselves
    stiffness = -time_s if time_s < 0 else 1 / (max(time_s, 2 * timestep_s) * damping) ** 2
    pulls: FloatArray = stiffness / high**2 * impedance**2 * DEPTHS_M / (1 - impedance)
    return np.maximum.accumulate(pulls)


def cone_factor(physics: Physics, one: FloatArray | float, two: FloatArray | float) -> FloatArray:
    """The factor by which pyramidal cones make contacts with these sliding frictions softer.

    A pyramid's four edges have the regularisation 2μ²(1 + μ²) of the elliptic cone's normal each, and act together.
    """
    if physics.cone is Cone.ELLIPTIC:
        return np.ones(np.broadcast_shapes(np.shape(one), np.shape(two)))
    mu2 = np.maximum(one, two) ** 2
    return np.asarray(2 * mu2 * (1 + mu2) / 4)
