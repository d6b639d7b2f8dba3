"""The law of landings: what a contact does to boxes that arrive fast.

At rest a contact is a spring with a damper (docs/rules.md, section 1). Boxes that land would pass by centimetres into
what they land on, and would not bounce. So while a box lands its contacts follow another law. MuJoCo's contacts have
reference accelerations: what they would make of the relative motion if they were hard. In ``pallet`` they nearly are,
so that two bodies in contact accelerate relative to one another by just that, whatever their masses. The law:

- A box begins to land in the step in which one of its contacts closes faster than ``FAST_M_S``. What it lands on, if it
  is a box, lands, too. For ``lasts_steps`` their velocities before that step are remembered.
- A contact that closes by v, and closed by v₀ with the velocities before, is to open by e·v₀ in the end (Newton's law
  of impact; e is ``restitution``, or that of the pair of materials), and in addition by as much as takes the box out of
  the depth that it has reached. It is decelerated by (1 + e)·v₀ / ``landing_s``, or by less if that is enough in this
  step. So the force is the same in all of a landing, and does not depend on the timestep; and a box comes by
  v₀·``landing_s`` / 2 / (1 + e) deep, and by what it passes in a step before.
- Meanwhile all contacts of the world are as stiff as beyond the width of ``solimp``. Else boxes below, whose contacts
  carry little, would be pressed in before these became stiff.

Nothing that rests is changed: its contacts close by less.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.options.config import Simulation
from petmjx.options.physics import Physics
from petmjx.world.pairs import USUAL

FAST_M_S: Final = 0.1
"""A contact that closes faster is a landing: one from a height of 0.5 mm."""

AT_REST: Final = 2.0
"""How deep contacts are that a rebound leaves behind, as a multiple of the width of ``solimp``: those at rest are 1.3
times as deep, and press a little while a box rises through them. With this, rebounds from 10 mm are met within 0.03
for a restitution of 0.1, which lifts a box by a tenth of a millimetre, to 0.3, in whatever part of a step it lands."""

_LONGER: Final = 2.0
"""A landing is remembered for so many times ``landing_s``: the second corner of a box may come down later."""


def lasts_steps(sim: Simulation) -> int:
    """Steps for which a box that has touched counts as landing."""
    longest_s = max([sim.physics.landing_s, *(pair.landing_s or 0.0 for pair in sim.landing_pairs)])
    return math.ceil(_LONGER * longest_s / sim.physics.timestep_s) + 1


def stiffening(depth_m: FloatArray, solimp: FloatArray) -> FloatArray:
    """(k,) by which factor contacts are stiffer at the largest of their impedances than at their depths.

    MuJoCo's regularisation is (1 − d)/d times the inverse masses (its documentation, "Modeling", "Solver parameters").

    Args:
        depth_m: (k,).
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
    """(k,) reference accelerations of contacts in a landing, m/s², positive apart; NaN: that of rest counts.

    Args:
        closing_m_s: (k,) how fast the contacts close.
        before_m_s: (k,) how fast they would with the velocities before the landing.
        depth_m: (k,).
        normal_z: (k,) z component of the unit normal.
        of_pair: (k, 2) as in ``petmjx.world.scene.Scene.pair_landing``.
    """
    usual, step_s = (physics.restitution, physics.landing_s), physics.timestep_s
    share, landing_s = np.where(of_pair == USUAL, usual, of_pair).T
    fall = np.abs(normal_z) * physics.gravity_m_s2
    # a step moves by the velocity at its end, so that what leaves with v rises by v² / 2g + v · timestep / 2
    energy = np.maximum((share * before_m_s) ** 2 + 2 * fall * (depth_m - AT_REST * physics.solimp[2]), 0.0)
    opening = np.where(share > 0, np.sqrt((fall * step_s / 2) ** 2 + energy) - fall * step_s / 2, 0.0)
    enough = (closing_m_s + opening) / step_s
    most = (1 + share) * before_m_s / landing_s
    lands = (before_m_s > FAST_M_S) & (enough > 0)
    return np.where(lands, np.minimum(enough, most), np.nan)
