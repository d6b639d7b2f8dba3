"""A rating of packers by physics: the share of all ordered boxes that lie on plans that stand.

The rating has the same form as BED-BPP's (docs/kpis.md), but uses the verdict of the simulation. Three things add
nothing to the rating: a plan that does not stand, an order that has no plan or whose world is invalid, and a box that
was left out. So neither risky nor overly cautious plans win. A box counts once, if it was ordered and has the size and
mass in the order. With orders, the rating of a packer depends only on its own plans and on the orders.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from petmjx.analysis.packer_comparison import PackerComparison
from petmjx.analysis.packer_runs import MISSING
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict
from petmjx.results.share_intervals import wilson_interval


def rate(comparison: PackerComparison) -> pd.DataFrame:
    """The rating of each packer, best first, in the form of :func:`ratings`."""
    return ratings(comparison.plans, list(comparison.runs), comparison.confidence)


def ratings(plans: pd.DataFrame, packers: Sequence[str], confidence: float) -> pd.DataFrame:
    """The rating of each packer, best first.

    Args:
        plans: a row for each order and packer (:func:`petmjx.analysis.packer_runs.plans_of`). Rows of orders that are
            not ``listed`` are ignored.

    Returns:
        A row for each packer: ``rank``, from 1, the same for equal ratings; ``packer``; ``rating``, from 0 to 1, with
        the bounds ``low`` and ``high`` of its interval (:func:`rating_interval`); ``n_orders``, of which ``n_stable``
        stand, ``n_invalid`` have no verdict and ``n_missing`` have no plan; and ``ordered_boxes``, of which
        ``standing_boxes`` lie as ordered on plans that stand.
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
    """Intervals of ratings: Wilson's interval, with the effective number of orders.

    A rating is a mean over orders of values from 0 to 1, weighted by their numbers of boxes. Large orders make the
    rating vary as if there were fewer orders: Kish's effective number, (Σ w)² / Σ w² (Kish 1965, "Survey Sampling",
    section 11.7). A mean of values from 0 to 1 varies at most as much as a share of yes-or-no values, so the interval
    is wide enough. Unlike a bootstrap interval, it has a width above 0 even if all plans stand or all fall.

    Args:
        rating: (p,) ratings from 0 to 1.
        ordered: (o,) the weights: the number of boxes of each order.

    Returns:
        (p,) lower and (p,) upper bounds.
    """
    effective = float(ordered.sum() ** 2 / np.square(ordered).sum())
    return wilson_interval(np.clip(rating, 0.0, 1.0) * effective, effective, confidence)
