"""What a simulated world came to: verdict, reason, flags, metrics per box; and how a verdict is reached."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag, StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.config import Thresholds
from petmjx.units import FloatArray


class Verdict(StrEnum):
    STABLE = "stable"
    UNSTABLE = "unstable"
    INVALID = "invalid"


class Reason(StrEnum):
    """Why a world is not stable. Empty for worlds that are."""

    NONE = ""
    NONFINITE = "nonfinite"
    OVERFLOW = "overflow"
    EXPLOSION = "explosion"
    OUT_OF_MEMORY = "out-of-memory"
    SINKING = "sinking"
    FAILED = "failed"
    TIMEOUT = "timeout"
    DROP = "drop"
    TILT = "tilt"
    SHIFT = "shift"


class Flag(IntFlag):
    """What happened to a world that the metrics alone do not tell. Kept in the results."""

    NONE = 0
    NONFINITE = 1
    CONTACT_OVERFLOW = 2
    CONSTRAINT_OVERFLOW = 4
    EXPLOSION = 8
    EARLY_STOP = 16
    RERUN_AFTER_OVERFLOW = 32
    OUT_OF_MEMORY = 64
    OTHER_OVERFLOW = 128
    FORKED = 256
    """The world started from a settled state that another world had reached."""
    SINKING = 512
    """Boxes sank into what bears them, so far that a verdict may come from it (petmjx.engines.sinking)."""
    FAILED = 1024
    """The simulation ended with an exception; ``Outcome.message`` has its text."""
    TIMEOUT = 2048
    """The world took longer than ``RunOptions.world_timeout_s``."""


@dataclass(eq=False)
class BoxMetrics:
    """Metrics of one world's n boxes, in packing order. What each one is, and its unit: petmjx.metrics.spec.

    ``shift_m`` and ``pos`` are (n, 3), ``quat`` is (n, 4) as (w, x, y, z), all others are (n,). NaN: there is no value.
    """

    shift_m: FloatArray
    max_tilt_deg: FloatArray
    max_lin_acc: FloatArray
    max_ang_acc: FloatArray
    max_top_force_n: FloatArray
    rest_top_force_n: FloatArray
    dropped: NDArray[np.bool_]
    drop_s: FloatArray
    max_sway_m: FloatArray
    pos: FloatArray
    quat: FloatArray


@dataclass(eq=False)
class Outcome:
    """What one simulated world came to. ``culprit`` is a box index (packing order from 0), −1 for none."""

    job: int
    verdict: Verdict
    reason: Reason
    culprit: int
    first_sign_s: float
    n_boxes: int
    n_placed: int
    sim_time_s: float
    n_steps: int
    flags: Flag
    boxes: BoxMetrics
    solver: str = "newton"
    attempt: int = 1
    state: Any = None
    """The settled state, where the job asked for it: opaque to all but the engine that made it."""
    message: str = ""
    """Why there is no result, in one line, where ``reason`` is ``failed``."""


INVALID_FLAGS: Final = (
    (Flag.FAILED, Reason.FAILED),
    (Flag.NONFINITE, Reason.NONFINITE),
    (Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW, Reason.OVERFLOW),
    (Flag.OUT_OF_MEMORY, Reason.OUT_OF_MEMORY),
    (Flag.EXPLOSION, Reason.EXPLOSION),
    (Flag.TIMEOUT, Reason.TIMEOUT),
)
"""Flags that make a world invalid, with their reason, in the order in which they are looked at. ``Flag.SINKING`` is
looked at later, and makes a world invalid with elliptic cones only."""


def judge(flags: Flag, boxes: BoxMetrics, n_placed: int, thresholds: Thresholds) -> tuple[Verdict, Reason]:
    """The verdict of a world, on any engine: is it valid, then did a placed box drop, tilt or shift, in this order.

    Metrics may come from float32. Against the default thresholds the comparison in float64 is the same as in float32:
    20 is a float32, and of 0.02 the nearest float32 lies below, so that no float32 lies between the two.
    """
    for bits, reason in INVALID_FLAGS:
        if flags & bits:
            return Verdict.INVALID, reason
    placed = slice(n_placed)
    if boxes.dropped[placed].any():
        return Verdict.UNSTABLE, Reason.DROP
    if (boxes.max_tilt_deg[placed] > thresholds.tilt_deg).any():
        return Verdict.UNSTABLE, Reason.TILT
    if (np.abs(boxes.shift_m[placed]) > thresholds.shift_m).any():
        return Verdict.UNSTABLE, Reason.SHIFT
    return Verdict.STABLE, Reason.NONE


@dataclass(frozen=True)
class Attempt:
    """One attempt at a world that needed more than one; the last one gave the verdict."""

    attempt: int
    solver: str
    timestep_s: float
    verdict: str
    reason: str
    flags: int
    n_steps: int

    @classmethod
    def of(cls, outcome: Outcome, timestep_s: float) -> Attempt:
        """What is kept of an outcome that was simulated with ``timestep_s`` (s)."""
        return cls(
            attempt=outcome.attempt,
            solver=str(outcome.solver),
            timestep_s=timestep_s,
            verdict=outcome.verdict.value,
            reason=outcome.reason.value,
            flags=int(outcome.flags),
            n_steps=outcome.n_steps,
        )
