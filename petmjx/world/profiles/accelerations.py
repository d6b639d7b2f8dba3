"""Profiles of the carrier's acceleration. In simulations of acceleration profiles, the carrier is clamped, and the
carrier's acceleration is subtracted from gravity.

There are four kinds of acceleration profiles: ramps, tilts and shocks, which are defined here, and random vibration
(petmjx/world/profiles/random_vibration.py). In direction 0, the carrier accelerates along +x, so the load is thrown
towards −x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.world.job import ACCELERATION, Excitation
from petmjx.world.profiles.profile import Profile, Strength, step_averages, steps_to_cover
from petmjx.world.random_streams import WorldKey

EUMOS_RAMP_S = 0.05
"""Longest time that EUMOS 40509 allows for the rise of the acceleration to its level, s."""
EUMOS_HOLD_S = 0.3
"""Shortest time for which EUMOS 40509 requires the acceleration to stay at its level, s."""
EUMOS_SOURCE = "EUMOS 40509:2020, test method for load unit rigidity (ramp at most 50 ms, hold at least 0.3 s)"

EN_12195_FORWARD_G = 0.8
EN_12195_SIDEWAYS_G = 0.5
EN_12195_REARWARD_G = 0.5
EN_12195_SOURCE = "EN 12195-1:2010, coefficients for road transport (0.8 forward, 0.5 sideways and rearward)"


def _horizontal_unit(yaw_deg: float) -> FloatArray:
    """(3,) horizontal unit vector at the angle ``yaw_deg`` from +x towards +y. The vector's components are rounded, so
    that they are exactly 0 and 1 along the axes."""
    yaw = math.radians(yaw_deg)
    return np.round(np.array([math.cos(yaw), math.sin(yaw), 0.0]), 15)


@dataclass(frozen=True)
class Trapezoid:
    """A horizontal acceleration that rises linearly to a plateau, stays there, and falls linearly to 0.

    Attributes:
        level_g: acceleration of the plateau, g.
        ramp_s: duration of the rise, and of the fall, s.
        hold_s: duration of the plateau, s.
        yaw_deg: direction in which the carrier accelerates, degrees from +x towards +y.
    """

    name: str
    source: str
    level_g: float
    ramp_s: float
    hold_s: float
    yaw_deg: float = 0.0
    strength: Strength = Strength.LEVEL
    kind: str = ACCELERATION
    random: bool = False

    def n_steps(self, timestep_s: float) -> int:
        return steps_to_cover(2 * self.ramp_s + self.hold_s, timestep_s)

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        edges_s: FloatArray = np.arange(self.n_steps(timestep_s) + 1, dtype=np.float64) * timestep_s
        fall_s = self.ramp_s + self.hold_s
        covered = self._ramp_integral(edges_s) - self._ramp_integral(edges_s - fall_s)
        magnitude = self.level_g * STANDARD_GRAVITY * step_averages(covered, timestep_s)
        return Excitation(self.name, self.kind, magnitude[:, None] * _horizontal_unit(self.yaw_deg))

    def _ramp_integral(self, time_s: FloatArray) -> FloatArray:
        """Integral over time of a ramp that rises from 0 at time 0 to 1 at ``ramp_s``, and then stays at 1."""
        rising = np.clip(time_s, 0.0, self.ramp_s) ** 2 / (2 * self.ramp_s)
        return rising + np.maximum(time_s - self.ramp_s, 0.0)


def eumos_40509() -> Trapezoid:
    """One acceleration test of EUMOS 40509:2020, with a level of 1 g. A sweep's axis ``level`` multiplies the samples,
    so its values are levels in g; 0.5 g is usual.

    The standard requires that the level is reached within 50 ms and held for at least 0.3 s, and that it ends
    gradually. In this profile, rise and fall take 50 ms each, and the level is held for 0.3 s.
    """
    return Trapezoid("eumos-40509", EUMOS_SOURCE, 1.0, EUMOS_RAMP_S, EUMOS_HOLD_S)


def en_12195_1() -> tuple[Trapezoid, ...]:
    """The four load cases of EN 12195-1:2010 for road transport. The vehicle's front is along +x.

    The standard gives quasi-static coefficients, but no curve over time. In these profiles, the acceleration rises to
    the coefficient within 0.5 s, stays there for 1 s, and returns to 0 within 0.5 s. When the vehicle brakes, the load
    is thrown forward: the carrier accelerates backward. The vertical coefficient is always 1.0. Sideways, the profiles
    have 0.5 g. For goods that may tip, the standard requires 0.6 g sideways: simulate this with a scale of 1.2.
    """
    cases = (
        ("en-12195-1-forward", EN_12195_FORWARD_G, 180.0),
        ("en-12195-1-rearward", EN_12195_REARWARD_G, 0.0),
        ("en-12195-1-left", EN_12195_SIDEWAYS_G, -90.0),
        ("en-12195-1-right", EN_12195_SIDEWAYS_G, 90.0),
    )
    return tuple(
        Trapezoid(name, EN_12195_SOURCE, level_g, 0.5, 1.0, yaw_deg, strength=Strength.SCALE)
        for name, level_g, yaw_deg in cases
    )


@dataclass(frozen=True)
class Tilt:
    """The carrier is slowly tilted about a horizontal axis. Seen from the carrier, gravity turns.

    In direction 0, the load is pulled towards −x, as by an acceleration along +x. The angle grows at ``rate_deg_s`` to
    ``max_deg``, stays there for ``hold_s``, and returns to 0 within ``return_s``. The return is so slow that a pallet
    that stood at the largest angle does not fall during the return. Centrifugal and Euler forces are neglected: at 5°/s
    they are below 0.1 % of gravity.

    petmjx defines this test itself. The results of this test can be checked in closed form: a rigid box begins to slide
    at the angle atan μ, and to topple at atan(width / height). A failure is recognised later, since a box needs time to
    slide as far as the threshold, or to tip. docs/profiles.md lists these delays.
    """

    name: str = "tilt"
    max_deg: float = 45.0
    rate_deg_s: float = 5.0
    hold_s: float = 1.0
    return_s: float = 1.0
    source: str = "definition: tilt test"
    strength: Strength = Strength.ANGLE
    kind: str = ACCELERATION
    random: bool = False

    @property
    def rise_s(self) -> float:
        """Time until the largest angle is reached, s."""
        return self.max_deg / self.rate_deg_s

    def n_steps(self, timestep_s: float) -> int:
        return steps_to_cover(self.rise_s + self.hold_s + self.return_s, timestep_s)

    def _angles_deg(self, time_s: FloatArray) -> FloatArray:
        corners_s = np.cumsum([0.0, self.rise_s, self.hold_s, self.return_s])
        return np.interp(time_s, corners_s, [0.0, self.max_deg, self.max_deg, 0.0])

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        """The acceleration is a = gravity − tilted gravity, including the vertical component. So gravity − a has a
        length of 9.81 m/s² at every angle."""
        ends_s: FloatArray = np.arange(1, self.n_steps(timestep_s) + 1, dtype=np.float64) * timestep_s
        angle = np.radians(self._angles_deg(ends_s))
        samples = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle) - 1.0], axis=1)
        return Excitation(self.name, self.kind, STANDARD_GRAVITY * samples)


@dataclass(frozen=True)
class HalfSine:
    """A shock along ``axis``: half a period of a sine. The peak is 1 g; a sweep's axis ``level`` multiplies the peak.

    Source: pulse shape of IEC 60068-2-27; 11 ms is one of its standard durations.

    Attributes:
        duration_ms: duration of the pulse, ms.
        axis: (3,) direction of the carrier's acceleration, as a vector of any length.
    """

    name: str = "half-sine"
    duration_ms: float = 11.0
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    source: str = "IEC 60068-2-27, half-sine pulse"
    strength: Strength = Strength.LEVEL
    kind: str = ACCELERATION
    random: bool = False

    def n_steps(self, timestep_s: float) -> int:
        return steps_to_cover(self.duration_ms / 1000, timestep_s)

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        """Each sample is the mean of the pulse over one timestep. So the change of velocity, 2/π × peak × duration, is
        exact for any timestep."""
        duration_s = self.duration_ms / 1000
        edges_s = np.minimum(np.arange(self.n_steps(timestep_s) + 1) * timestep_s, duration_s)
        covered = duration_s / math.pi * (1.0 - np.cos(math.pi * edges_s / duration_s))
        magnitude = STANDARD_GRAVITY * step_averages(covered, timestep_s)
        return Excitation(self.name, self.kind, magnitude[:, None] * _unit(self.axis))


def _unit(axis: tuple[float, float, float]) -> FloatArray:
    """(3,) unit vector along an axis of any length. An axis whose square would not fit a float64 is scaled first."""
    vector: FloatArray = np.asarray(axis, dtype=np.float64)
    longest = float(np.abs(vector).max())
    if not 0 < longest < math.inf:
        raise InputError(f"axis must be finite and not zero, got {axis}")
    if not 1e-100 < longest < 1e100:
        vector = vector / longest
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit


QUASI_STATIC_DEG_S: Final = 0.5
"""Rate of the quasi-static tilt, °/s. In measurements at this rate, boxes failed at an angle 0.4 to 0.6° larger than in
theory (docs/profiles.md). At 5°/s, the angle was 2.5 to 2.7° larger than in theory."""


def quasi_static_tilt() -> Tilt:
    """The tilt test at the rate ``QUASI_STATIC_DEG_S``. While the angle grows, the quasi-static test takes ten times as
    many steps as ``Tilt``."""
    return Tilt("tilt-quasi-static", rate_deg_s=QUASI_STATIC_DEG_S, source="definition: quasi-static tilt test")


BUILT_IN_ACCELERATIONS: tuple[Profile, ...] = (
    eumos_40509(),
    *en_12195_1(),
    Tilt(),
    quasi_static_tilt(),
    HalfSine(),
)
"""To add a built-in acceleration: define it above, list it here, and describe it in docs/profiles.md."""
