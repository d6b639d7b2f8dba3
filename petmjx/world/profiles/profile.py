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
"""Longest duration of a profile, s. The samples of a profile are held in memory: 24 bytes per step."""


class Strength(StrEnum):
    """The axis of a sweep that makes a profile weaker or stronger."""

    SCALE = "scale"
    """The strength is a factor on the unscaled profile. For forces, the unit is total mass × 9.81 m/s²."""
    LEVEL = "level"
    """The unscaled profile has a peak of 1 g, so the factor is the level in g."""
    ANGLE = "angle"
    """No axis scales the profile: it passes through all its angles anyway (``tilt``)."""


class Profile(Protocol):
    """A force on the carrier, or an acceleration of the carrier, as a function of time since the profile began.

    Attributes:
        name: name used in sweep files and results.
        kind: "force" or "acceleration".
        strength: the axis that scales the profile.
        source: source of the profile's numbers.
        random: whether replicates have different samples.
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
        """Number of steps from the profile's beginning to its last sample, for ``start_s`` = 0."""
        ...

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        """Dense samples; row i acts during step i + 1 of the profile.

        Args:
            timestep_s: timestep of the simulation, s.
            start_s: absolute time at which the profile begins, s. Force windows are rounded to steps in absolute time,
                as in the reference implementation. Other profiles begin on a step and ignore this value.
            world: the world whose random numbers are used; only random profiles need it.
        """
        ...


def allowed_sway_m(profile: Profile) -> float:
    """``Drive.allowed_sway_m`` of a profile, m. While the carrier is tilted, no box counts as lost: a box that slides
    to the edge tips there, although tipping was not the first failure."""
    return math.inf if profile.strength is Strength.ANGLE else 0.0


def step_averages(antiderivative_at_edges: FloatArray, timestep_s: float) -> FloatArray:
    """(n,) mean of a function over each step, given its antiderivative at the n + 1 edges of the steps.

    A step applies one constant value. If this value is the mean, the integral (the change of velocity) is exact for any
    timestep.
    """
    return np.diff(antiderivative_at_edges) / timestep_s


def steps_to_cover(duration_s: float, timestep_s: float) -> int:
    """Number of steps that cover a duration, at least 1. An excess of up to a billionth of a step counts as rounding
    and adds no step."""
    return max(int(np.ceil(duration_s / timestep_s - 1e-9)), 1)
