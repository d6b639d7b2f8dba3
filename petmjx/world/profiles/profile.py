"""The protocol of profiles, and functions that all profiles use."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Protocol

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.world.job import Excitation
from petmjx.world.random_streams import WorldKey

MAX_PROFILE_S = 3600.0
"""Longest duration of a profile, s. All samples of a profile are in memory at once, with 24 bytes per step."""


class Strength(StrEnum):
    """The axis of a sweep that makes a profile weaker or stronger."""

    SCALE = "scale"
    """The axis ``scale``: its values multiply the profile. The unit of force profiles is total mass × 9.81 m/s²."""
    LEVEL = "level"
    """The axis ``level``: its values multiply a profile with a peak of 1 g, so they are levels in g."""
    ANGLE = "angle"
    """The strength of a tilt, which is no axis of a sweep: a tilt passes through all angles up to its largest angle
    anyway."""


class Profile(Protocol):
    """A force on the carrier, or an acceleration of the carrier, as a function of time since the profile began.

    Attributes:
        name: name of the profile in sweep files and results.
        kind: "force" or "acceleration".
        strength: the axis of a sweep that multiplies the profile.
        source: where the profile's numbers come from, such as a standard.
        random: whether each repetition of a world gets different samples.
    """

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def strength(self) -> Strength: ...
    @property
    def source(self) -> str: ...
    @property
    def random(self) -> bool: ...

    def n_steps(self, timestep_s: float) -> int:
        """Number of steps from the profile's beginning to its last sample, if the profile begins at time 0."""
        ...

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        """The profile as one sample per step. Row i of the samples acts during step i + 1 of the profile.

        Args:
            timestep_s: timestep of the simulation, s.
            start_s: simulated time at which the profile begins, s. The ends of force windows, in simulated time, are
                rounded to whole steps, as in the reference implementation. Other profiles ignore ``start_s``.
            world: the world whose random numbers a random profile uses. Other profiles ignore ``world``.
        """
        ...


def allowed_sway_m(profile: Profile) -> float:
    """Distance by which a culprit may sway under a profile before it counts as lost, m (``Drive.allowed_sway_m``). The
    distance is infinite if the profile tilts the carrier, so that no box counts as lost. A box may slide to the edge of
    the tilted carrier and tip over this edge. It must not count as tilted, since it first failed by sliding. With all
    other profiles, the distance is 0."""
    return math.inf if profile.strength is Strength.ANGLE else 0.0


def step_averages(antiderivative_at_edges: FloatArray, timestep_s: float) -> FloatArray:
    """(n,) mean of a function over each of n steps, given the function's antiderivative at the n + 1 ends of the steps.

    A step applies a constant acceleration. If this acceleration is the mean over the step, the change of velocity is
    exact for any timestep.
    """
    return np.diff(antiderivative_at_edges) / timestep_s


def steps_to_cover(duration_s: float, timestep_s: float) -> int:
    """Smallest number of steps, at least 1, that together last ``duration_s`` or longer. A remainder of up to a
    billionth of a step counts as rounding and adds no step."""
    return max(int(np.ceil(duration_s / timestep_s - 1e-9)), 1)
