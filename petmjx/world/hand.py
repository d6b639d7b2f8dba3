"""The hand that carries a box to its place: its spring, how it sets the box down, and when it releases the box.

The hand is a spring and a damper that pull the box towards a point. The point moves smoothly along the box's path
(petmjx.world.approach_paths). docs/rules.md, section 4, has all rules. The options in
``petmjx.options.placing.Placing`` limit the hand's force and speed.
"""

from __future__ import annotations

from typing import Final

HAND_RATE_1_S: Final = 50.0
"""Natural angular frequency of the hand's spring with a box, 1/s. The spring is critically damped: a box that is pushed
away returns within about 3 / 50 s. The frequency is the inverse of the time constant that contacts have in the physics
``pallet``. A stiffer hand would work against the contacts. For a box of mass m, the spring's stiffness is m · 50² / s²:
a box that is 1 mm behind on its path is pushed with 2.5 N per kg of its mass."""

MOST_RATE_PER_STEP: Final = 0.1
"""Largest product of the natural frequency of the hand's spring and the timestep. The hand's forces are computed at the
beginning of a step. With semi-implicit Euler, the hand's motion is stable if the product h of natural frequency and
timestep is below 2 (√2 − 1) = 0.83 (Jury's criterion for z² − (2 − 2h − h²) z + 1 − 2h). With a product of 0.1, the
simulated motion differs from the continuous motion by at most a tenth."""

MOST_STUCK_S: Final = 0.5
"""Longest time for which the hand holds a box at the end of its path, waiting for the box to come to rest, s. Setting
the box down may then take another ``MOST_STUCK_S``."""

AT_PLACE_M: Final = 0.0002
"""A box that is nearer to the end of its path than this distance, m, counts as arrived. Contacts give way by a tenth of
a millimetre, so a box might never come nearer to the end of its path than a tenth of a millimetre."""

MISSED_M: Final = 0.01
"""If the hand releases a box farther from its place than this distance, m, the box counts as not placed. If there is
room, boxes are released within 5 mm of their places. If a box comes to stand on the edge of a neighbour, its middle is
too high by the neighbour's height, or, if the box tilts, by half of this height."""

LOWERING_RATE_1_S: Final = 400.0
MOST_LOWERING_PER_STEP: Final = 0.8
"""A damper slows a box while it is set down. Its rate (damping constant / mass) is ``LOWERING_RATE_1_S``, 1/s. The
product of rate and timestep is at most ``MOST_LOWERING_PER_STEP``, since semi-implicit Euler is only stable below
2. The box sinks at 9.81 m/s² / (400 / s) = 25 mm/s. If a box lands at 25 mm/s, a contact of the physics ``pallet``
gives way by a quarter of a millimetre."""

LOWERING_STEPS: Final = 5
"""Smallest number of steps that the hand takes to set a box down. After these steps, a box without a support sinks so
fast that it does not count as quiet (at rest)."""


def rate_1_s(timestep_s: float) -> float:
    """Natural angular frequency of the hand's spring, reduced if the timestep is long, 1/s."""
    return min(HAND_RATE_1_S, MOST_RATE_PER_STEP / timestep_s)


def lowering_rate_1_s(timestep_s: float) -> float:
    """Rate of the damper that sets a box down, reduced if the timestep is long, 1/s."""
    return min(LOWERING_RATE_1_S, MOST_LOWERING_PER_STEP / timestep_s)


def stuck_steps(timestep_s: float) -> int:
    """The hand holds a box at the end of its path for at most this number of steps, and then takes at most this number
    of steps to set the box down."""
    return int(MOST_STUCK_S / timestep_s)
