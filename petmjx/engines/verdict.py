"""The outcome of a world (verdict, reason, flags, metrics of its boxes), and ``judge``, which decides the verdict.
petmjx/options/thresholds.py lists the reasons."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntFlag, StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.engines.metrics import BoxMetrics
from petmjx.options.thresholds import FAILURES, Thresholds
from petmjx.options.thresholds import Reason as Reason
from petmjx.world.history import History
from petmjx.world.job import EngineState, KeptState


class Verdict(StrEnum):
    STABLE = "stable"
    UNSTABLE = "unstable"
    INVALID = "invalid"


class Flag(IntFlag):
    """Events in a world that the metrics do not show. Each flag is a bit of the column ``flags``."""

    NONE = 0
    NONFINITE = 1
    CONTACT_OVERFLOW = 2
    CONSTRAINT_OVERFLOW = 4
    EXPLOSION = 8
    EARLY_STOP = 16
    RERUN_AFTER_OVERFLOW = 32
    """An engine simulated the world again with larger buffers. Whether buffers overflow depends on the worlds that are
    simulated at the same time, so petmjx.engines.outcome_checks removes this flag from all results."""
    OUT_OF_MEMORY = 64
    OTHER_OVERFLOW = 128
    FORKED = 256
    """The world started from a settled state that the simulation of another world had reached."""
    SINKING = 512
    """Boxes sank into their supports so far that the depth may have decided the verdict
    (petmjx.engines.contact_penetration)."""
    FAILED = 1024
    """The simulation ended with an exception. ``Outcome.message`` has the text of the exception."""
    TIMEOUT = 2048
    """The world took longer than ``RunOptions.world_timeout_s``."""
    MOVING = 4096
    """Boxes were still moving when the time was up, at the end of the world or before the next box was placed. So a
    longer simulation might give another verdict."""
    KNIFE_EDGE = 8192
    """The load of a box acts within half a millimetre of an edge of the box's supports, or within one millimetre if the
    verdict contradicts statics (petmjx.engines.knife_edges)."""
    TIMESTEP = 16384
    """With half the timestep, the verdict is different (``Simulation.check_timestep``)."""
    LEANS = 32768
    """The world is stable, but a box leans or lies lower than planned (petmjx.engines.outcome_checks)."""
    NOT_PLACED = 65536
    """A hand (the force that carries a box to its place) found no room for a box, and released the box farther than
    ``MISSED_M`` from its place (petmjx.world.hand). The flag is set only if no box had crossed a threshold before."""
    ITERATION_LIMIT = 131072
    """The world used up its iterations (``Simulation.iteration_limit``) before any box had failed."""


@dataclass(eq=False)
class Outcome:
    """The outcome of one world. ``culprit`` is the number of a box in packing order, from 0, or −1 if there is no
    culprit."""

    job: int
    """The stream number of the job (``JobStream``). If the jobs are a list, the stream number is the index of the job
    in the list."""
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
    n_at_sign: int = 0
    """Number of boxes that had been placed when the culprit (the box that failed first) crossed a threshold. The number
    is 0 if no box crossed a threshold before the world's end."""
    solver: str = "newton"
    attempt: int = 1
    engine: str = ""
    """Name of the engine that made this attempt. Set by petmjx.engines.attempt_with_fallback."""
    state: KeptState | EngineState | None = None
    """The settled state, if the job requests it. Outside the engine, the type is ``KeptState``."""
    margin: float = math.nan
    """The margin (``petmjx.engines.margin.margin_of``). petmjx.engines.outcome_checks sets it for all engines."""
    plan_edge_m: float = math.nan
    plan_edge_box: int = -1
    rest_edge_m: float = math.nan
    rest_edge_box: int = -1
    build_edge_m: float = math.nan
    build_edge_box: int = -1
    build_edge_step: int = -1
    """The fields from ``plan_edge_m`` to ``build_edge_step`` have the smallest distances of loads from edges (m), and
    the numbers of the boxes that have these loads. ``build_edge_step`` is the number of the box after whose placement
    ``build_edge_m`` occurs, or -1 if there is no such box. petmjx.engines.outcome_checks sets these fields, and the
    distances of all boxes."""
    message: str = ""
    """One line that says why there is no result, if ``reason`` is ``failed`` or ``timeout``."""
    history: History | None = None
    """The recorded frames, if the job requests them."""


INVALID_FLAGS: Final = (
    (Flag.FAILED, Reason.FAILED),
    (Flag.NONFINITE, Reason.NONFINITE),
    (Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW, Reason.OVERFLOW),
    (Flag.OUT_OF_MEMORY, Reason.OUT_OF_MEMORY),
    (Flag.EXPLOSION, Reason.EXPLOSION),
    (Flag.TIMEOUT, Reason.TIMEOUT),
    (Flag.ITERATION_LIMIT, Reason.ITERATION_LIMIT),
)
"""The flags that make a world invalid, each with its reason. If several flags are set, the first in this order
decides."""

_INVALID_BITS: Final = sum(int(bits) for bits, _ in INVALID_FLAGS)


def failures(boxes: Any, thresholds: Thresholds) -> Iterator[tuple[Reason, Any]]:
    """Yield, for each reason, the reason and an array (…, n) that tells whether each box fails for this reason. Reasons
    come in the order in which they are checked.

    Args:
        boxes: an object with the metrics of ``FAILURES`` for (…, n) boxes, as arrays of NumPy or JAX.
    """
    for failure in FAILURES:
        yield failure.reason, failure.has_happened(boxes, thresholds)


def judge(
    flags: Flag,
    boxes: BoxMetrics,
    n_placed: int,
    thresholds: Thresholds,
    *,
    sank: bool = False,
    placement: tuple[Verdict, Reason] = (Verdict.STABLE, Reason.NONE),
) -> tuple[Verdict, Reason]:
    """The verdict of a world, and its reason. All verdicts come from this function (docs/metrics.md, section
    "Verdict").

    An engine calls this function with its measurements. Later checks that change the measurements or flags of the world
    call this function again.

    Metrics may be float32 numbers. With the default thresholds, comparisons in float32 and in float64 agree. The
    threshold of the tilt, 20°, is exact in float32. The float32 nearest to the threshold of the shift, 0.02 m, is below
    0.02, and no other float32 lies between the two.

    Args:
        sank: whether boxes sank so far into their supports that the world is invalid. ``Flag.SINKING`` alone does not
            make a world invalid, because worlds that may have tipped over on soft contacts also have this flag.
        placement: for a world that was shaken, its verdict and reason before the shaking. A world that had failed
            before the shaking stays failed, even if its boxes end at their planned places.
    """
    for bits, reason in INVALID_FLAGS if int(flags) & _INVALID_BITS else ():
        if flags & bits:
            return Verdict.INVALID, reason
    if sank:
        return Verdict.INVALID, Reason.SINKING
    for reason, failed in failures(boxes, thresholds):
        if failed[:n_placed].any():
            return Verdict.UNSTABLE, reason
    return placement


def judge_all(
    flags: NDArray[np.int64], boxes: BoxMetrics, thresholds: Thresholds
) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """The verdicts and reasons of many worlds, as ``judge`` returns them for each world.

    Args:
        flags: (m,) flags of the worlds.
        boxes: metrics with one row per world: (m, n) instead of (n,). Boxes that are not placed have NaN or False.
    """
    invalid = [(Verdict.INVALID, reason, (flags & int(bits)) != 0) for bits, reason in INVALID_FLAGS]
    unstable = [(Verdict.UNSTABLE, reason, failed.any(axis=1)) for reason, failed in failures(boxes, thresholds)]
    verdicts, reasons, box_masks = zip(*invalid, *unstable, strict=True)
    verdict = np.select(box_masks, [str(label) for label in verdicts], str(Verdict.STABLE))
    return verdict, np.select(box_masks, [str(reason) for reason in reasons], str(Reason.NONE))


@dataclass(frozen=True)
class Attempt:
    """The record of one attempt (simulation) of a world. The last attempt gives the verdict."""

    attempt: int
    engine: str
    solver: str
    timestep_s: float
    verdict: Verdict
    reason: Reason
    flags: Flag
    n_steps: int

    @classmethod
    def of(cls, outcome: Outcome, timestep_s: float) -> Attempt:
        """The record of an outcome that was simulated with the timestep ``timestep_s``, s."""
        return cls(
            outcome.attempt,
            outcome.engine,
            outcome.solver,
            timestep_s,
            outcome.verdict,
            outcome.reason,
            outcome.flags,
            outcome.n_steps,
        )
