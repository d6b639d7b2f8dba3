"""The margin of a world (``margin_of``): its distance from the nearest threshold, as a share of the threshold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.thresholds import FAILURES, Thresholds, largest_excess

_EPSILON: Final = float(np.finfo(np.float64).eps)


def margin_of(verdict: Verdict, boxes: BoxMetrics, n_placed: int, thresholds: Thresholds) -> float:
    """Distance of a world from the nearest threshold, as a share of this threshold: 1 minus the largest excess of any
    placed box.

    The margin is 1 if nothing moved, 0 on the threshold, and negative beyond the threshold. If a box dropped, the
    margin is at most -1. The margin is never negative in a stable world, always negative in an unstable world, and NaN
    in an invalid world. See docs/metrics.md, section "Margin".
    """
    return _margins([(verdict, boxes, n_placed)], thresholds)[0]


def margins_of(outcomes: Sequence[Outcome], thresholds: Thresholds) -> list[float]:
    """The result of ``margin_of`` for each of many outcomes, computed together."""
    return _margins([(outcome.verdict, outcome.boxes, outcome.n_placed) for outcome in outcomes], thresholds)


def _margins(worlds: Sequence[tuple[Verdict, BoxMetrics, int]], thresholds: Thresholds) -> list[float]:
    margins = [math.nan] * len(worlds)
    valid = [k for k, (verdict, _, placed) in enumerate(worlds) if placed and verdict is not Verdict.INVALID]
    if not valid:
        return margins
    placed = [worlds[k][2] for k in valid]
    placed_boxes = [(worlds[k][1], slice(worlds[k][2])) for k in valid]
    columns = {
        metric: np.concatenate([getattr(boxes, metric)[rows] for boxes, rows in placed_boxes], dtype=np.float64)
        for metric in (failure.metric for failure in FAILURES)
    }
    begins = np.cumsum(placed) - np.array(placed)
    largest = np.maximum.reduceat(largest_excess(SimpleNamespace(**columns), thresholds), begins)
    stable = np.array([worlds[k][0] is Verdict.STABLE for k in valid])
    for k, margin in zip(valid, margin_of_excess(largest, stable).tolist(), strict=True):
        margins[k] = margin
    return margins


def margin_of_excess(largest: FloatArray, stable: NDArray[np.bool_]) -> FloatArray:
    """(m,) margin of each valid world from the largest excess of its boxes. ``results`` in petmjx/jax/device_pallets.py
    computes the same in JAX.

    Whether a world is stable decides the sign of its margin. Near a threshold, the sign of the computed margin may be
    wrong, because `judge` may have compared float32 numbers, and the excess is a rounded quotient.
    """
    margin = 1.0 - largest
    return np.where(stable, np.maximum(margin, 0.0), np.minimum(margin, -_EPSILON))
