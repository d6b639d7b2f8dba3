"""What a simulated world came to: verdict, reason, flags, metrics per box; and how a verdict is reached."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag, StrEnum
from typing import Any

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


@dataclass(eq=False)
class BoxMetrics:
    """Per-box results of one world, in packing order. Definitions: docs/metrics.md.

    Attributes:
        shift_m: (n, 3) final centre − planned centre; components under the floor are 0.
        max_tilt_deg: (n,) over samples since the box was placed.
        max_lin_acc: (n,) m/s², max_ang_acc: (n,) rad/s².
        max_top_force_n: (n,) N; rest_top_force_n: (n,) N, NaN where the world never came to rest.
        dropped: (n,) bool; drop_s: (n,) s, NaN where the box did not drop.
        max_sway_m: (n,) largest horizontal displacement from the start of the force profile, m; NaN without one.
        pos: (n, 3) final centres, m; quat: (n, 4) final orientations (w, x, y, z).
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


def judge(flags: Flag, boxes: BoxMetrics, n_placed: int, thresholds: Thresholds) -> tuple[Verdict, Reason]:
    """The verdict over the placed boxes, in the order of spec section 5."""
    if flags & Flag.NONFINITE:
        return Verdict.INVALID, Reason.NONFINITE
    if flags & (Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW):
        return Verdict.INVALID, Reason.OVERFLOW
    if flags & Flag.EXPLOSION:
        return Verdict.INVALID, Reason.EXPLOSION
    if boxes.dropped[:n_placed].any():
        return Verdict.UNSTABLE, Reason.DROP
    if (boxes.max_tilt_deg[:n_placed] > thresholds.tilt_deg).any():
        return Verdict.UNSTABLE, Reason.TILT
    if (np.abs(boxes.shift_m[:n_placed]) > thresholds.shift_m).any():
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
