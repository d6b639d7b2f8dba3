"""A rating of packers by physics: the share of ordered boxes that lie on plans that stand.

The rating has the form of BED-BPP's rating (docs/kpis.md), with the verdict of the simulation. A plan that does not
stand adds nothing. An order without a plan or with an invalid world adds nothing, nor does a box that was left out.
So neither daring nor timid plans win. A box counts once, if it was ordered and has the order's size and mass. With
orders, a packer's rating depends only on its own plans and the orders.
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
    """The rating of each packer, the best first, in the form of :func:`ratings`."""
    return ratings(comparison.plans, list(comparison.runs), comparison.confidence)


def ratings(plans: pd.DataFrame, packers: Sequence[str], confidence: float) -> pd.DataFrame:
    """The rating of each packer, the best first.

    Args:
        plans: a row for each order and packer (:func:`petmjx.analysis.packer_runs.plans_of`); rows of orders that are
            not ``listed`` do not count.

    Returns:
        A row for each packer: ``rank``, from 1, the same for equal ratings; ``packer``; ``rating``, from 0 to 1, with
        the bounds ``low`` and ``high`` of its interval (:func:`rating_interval`); ``n_orders``, of which ``n_stable``
        stand, ``n_invalid`` have no verdict and ``n_missing`` no plan; ``ordered_boxes``, of which ``standing_boxes``
        lie on plans that stand, as they were ordered.
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
    """Intervals of ratings: Wilson's interval for the effective number of orders.

    A rating is a mean of values from 0 to 1 over orders, weighted by their boxes. Large orders make it vary as if there
    were fewer orders: Kish's effective number, (Σ w)² / Σ w² (Kish 1965, "Survey Sampling", section 11.7). Such a mean
    varies at most as much as a share, so the interval is wide enough. Unlike a bootstrap interval, it also has a width
    if all plans stand, or none.

    Args:
        rating: (p,) ratings from 0 to 1.
        ordered: (o,) number of boxes of each order: the weights.

    Returns:
        (p,) lower and (p,) upper bounds.
    """
    effective = float(ordered.sum() ** 2 / np.square(ordered).sum())
    return wilson_interval(np.clip(rating, 0.0, 1.0) * effective, effective, confidence)
