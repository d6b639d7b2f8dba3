"""A rating of packers by physics: the share of all ordered boxes that are part of a plan that stands.

The rating has the same form as the rating of the benchmark BED-BPP (docs/kpis.md), but uses petmjx's verdict.
docs/packers.md states which boxes and which orders count.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from petmjx.analysis.packer_comparison import PackerComparison
from petmjx.analysis.packer_runs import MISSING
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict
from petmjx.results.share_statistics import wilson_interval


def rate(comparison: PackerComparison) -> pd.DataFrame:
    """The rating of each packer, best first, in the form of :func:`ratings`."""
    return ratings(comparison.plans, list(comparison.runs), comparison.confidence)


def ratings(plans: pd.DataFrame, packers: Sequence[str], confidence: float) -> pd.DataFrame:
    """The rating of each packer, best first.

    Args:
        plans: one row for each order and packer (:func:`petmjx.analysis.packer_runs.plans_of`). Rows whose column
            ``listed`` is false are ignored.

    Returns:
        One row for each packer. Columns: ``rank``, which begins at 1 and is equal for equal ratings; ``packer``; and
        ``rating``, from 0 to 1, with the bounds ``low`` and ``high`` of its interval (:func:`rating_interval`). Of
        ``n_orders`` orders, ``n_stable`` have a plan that stands, ``n_invalid`` have no verdict, and ``n_missing`` have
        no plan. Of ``ordered_boxes`` boxes, ``standing_boxes`` lie as ordered on plans that stand.
    """
    listed = plans[plans["listed"]]
    verdicts, as_ordered, boxes = (
        listed.pivot(index="plan_id", columns="packer", values=name)[list(packers)]
        for name in ("verdict", "as_ordered", "order_boxes")
    )
    ordered = boxes.max(axis=1).to_numpy(np.float64)
    stands = (verdicts == Verdict.STABLE.value).to_numpy()
    standing = np.where(stands, np.minimum(as_ordered.fillna(0).to_numpy(np.float64), ordered[:, None]), 0.0)
    shares = standing.sum(axis=0) / ordered.sum()
    low, high = rating_interval(shares, ordered, confidence)
    table = pd.DataFrame(
        {
            "packer": list(packers),
            "rating": shares,
            "low": low,
            "high": high,
            "n_orders": len(ordered),
            "n_stable": stands.sum(axis=0),
            "n_invalid": (verdicts == Verdict.INVALID.value).to_numpy().sum(axis=0),
            "n_missing": (verdicts == MISSING).to_numpy().sum(axis=0),
            "ordered_boxes": int(ordered.sum()),
            "standing_boxes": standing.sum(axis=0).astype(int),
        }
    )
    table = table.sort_values(["rating", "packer"], ascending=[False, True], ignore_index=True)
    table.insert(0, "rank", table["rating"].rank(method="min", ascending=False).astype(int))
    return table


def rating_interval(rating: FloatArray, ordered: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Confidence intervals of ratings, computed as Wilson's intervals for an effective number of orders.

    A rating is a weighted mean over orders. The value of an order is a share from 0 to 1, and its weight w is its
    number of boxes. Because the weights differ, the rating varies as much as a mean over fewer orders with equal
    weights. The number of these fewer orders is Kish's effective number, (Σ w)² / Σ w² (Kish 1965, "Survey Sampling",
    section 11.7). Wilson's interval is made for shares of yes-or-no values. The values of orders lie between 0 and 1,
    and vary no more than yes-or-no values with the same mean, so Wilson's interval is wide enough for them. Unlike a
    bootstrap interval, this interval has a width above 0 even if all plans stand or all plans fall.

    Args:
        rating: (p,) ratings of p packers, from 0 to 1.
        ordered: (o,) number of boxes of each order.

    Returns:
        Two arrays (p,): the lower and the upper bounds of the intervals of p packers.
    """
    effective = float(ordered.sum() ** 2 / np.square(ordered).sum())
    return wilson_interval(np.clip(rating, 0.0, 1.0) * effective, effective, confidence)
