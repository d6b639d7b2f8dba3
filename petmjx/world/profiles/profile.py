"""The protocol of profiles, and functions that all profiles share."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Protocol

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.world.job import Excitation
from petmjx.world.random_streams import WorldKey

MAX_PROFILE_S = 3600.0
"""Longest profile: its samples are held in memory, 24 bytes per step."""


class Strength(StrEnum):
    """The axis of a sweep that makes a profile weaker or stronger."""

    SCALE = "scale"
    """A factor on the unscaled profile. Forces: in units of total mass × 9.81 m/s²."""
    LEVEL = "level"
    """The profile has a peak of 1 g; the factor is the level in g."""
    ANGLE = "angle"
    """None: the profile passes through all its angles and cannot be scaled (``tilt``)."""


class Profile(Protocol):
    """A force on the carrier, or an acceleration of it, as a function of the time since the profile began.

    Attributes:
        name: as in sweep files and results.
        kind: "force" or "acceleration".
        strength: the axis that scales the profile.
        source: origin of its numbers.
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
        """Steps from the profile's beginning to its last sample, for ``start_s`` = 0."""
        ...

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        """Dense samples; row i acts during step i + 1 of the profile.

        Args:
            timestep_s: timestep of the simulation, s.
            start_s: absolute time at which the profile begins, s. Force windows are rounded to steps in absolute time,
                as in the reference implementation; other profiles begin on a step and do not use it.
            world: the world whose random numbers are used; only random profiles need it.
        """
        ...


def allowed_sway_m(profile: Profile) -> float:
    """``Drive.allowed_sway_m`` of a profile, m. While the carrier is tilted no box is lost: a box that slides to the
    edge tips there, although this was not the first failure."""
    return math.inf if profile.strength is Strength.ANGLE else 0.0


def step_averages(antiderivative_at_edges: FloatArray, timestep_s: float) -> FloatArray:
    """(n,) mean over each step of a function whose antiderivative is given at the n + 1 step edges.

    A step applies one constant value. With the mean as the step's value, the integral (the change of velocity) is exact
    for any timestep.
    """
    return np.diff(antiderivative_at_edges) / timestep_s


def steps_to_cover(duration_s: float, timestep_s: float) -> int:
    """Steps that cover a duration, at least one step. A rounding error of a billionth of a step adds none."""
    return max(int(np.ceil(duration_s / timestep_s - 1e-9)), 1)
