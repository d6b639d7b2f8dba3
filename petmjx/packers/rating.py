"""A rating of packers by physics: which share of the boxes that were ordered lies on plans that stand.

It is the form of BED-BPP's rating (docs/kpis.md), with the verdict of the simulation. A plan that does not stand counts
nothing, and so does an order without a plan or with an invalid world; a box that was left out counts nothing either. So
neither daring plans nor timid ones win.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from petmjx.basics.units import FloatArray
from petmjx.packers.compare import ALL_SIZES, PackerComparison
from petmjx.results.shares import wilson_interval
from petmjx.verdict import Verdict


def rate(found: PackerComparison) -> pd.DataFrame:
    """The rating of each packer, the best first.

    Args:
        found: packers compared.

    Returns:
        A row for each packer: ``rank``, from 1, the same for equal ratings; ``packer``; ``rating`` with the bounds
        ``low`` and ``high`` of its interval (:func:`rating_interval`); ``n_orders``, of which ``n_stable`` stand,
        ``n_invalid`` have no verdict and ``n_missing`` no plan; ``ordered_boxes``, of which ``standing_boxes`` lie on
        plans that stand.
    """
    names = list(found.runs)
    plans = found.plans
    stands = (plans["verdict"] == Verdict.STABLE.value).to_numpy()
    boxes = plans.assign(standing=np.where(stands, plans["boxes"].fillna(0), 0.0))
    standing = boxes.pivot(index="plan_id", columns="packer", values="standing")[names].to_numpy(np.float64)
    ordered = plans.groupby("plan_id")["order_boxes"].max().to_numpy(np.float64)
    ratings = standing.sum(axis=0) / ordered.sum()
    low, high = rating_interval(ratings, ordered, found.confidence)
    rows = []
    whole = found.packers[found.packers["size"] == ALL_SIZES].set_index("packer")
    for at, name in enumerate(names):
        rows.append(
            {
                "packer": name,
                "rating": ratings[at],
                "low": low[at],
                "high": high[at],
                "n_orders": len(ordered),
                "n_stable": int(stands[(plans["packer"] == name).to_numpy()].sum()),
                "n_invalid": int(whole.loc[name, "n_invalid"]),
                "n_missing": int(whole.loc[name, "n_missing"]),
                "ordered_boxes": int(ordered.sum()),
                "standing_boxes": int(standing[:, at].sum()),
            }
        )
    table = pd.DataFrame(rows).sort_values(["rating", "packer"], ascending=[False, True], ignore_index=True)
    table.insert(0, "rank", table["rating"].rank(method="min", ascending=False).astype(int))
    return table


def rating_interval(rating: FloatArray, ordered: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Intervals of ratings: Wilson's interval for as many orders as the weights leave.

    A rating is a mean over orders, weighted by their boxes, of values from 0 to 1. Large orders make it vary as if
    there were fewer orders: Kish's effective number, (Σ w)² / Σ w² (Kish 1965, "Survey Sampling", section 11.7). Such a
    mean varies no more than a share does, so the interval is wide enough. It also has a width where all plans stand, or
    none, unlike that of a bootstrap.

    Args:
        rating: (p,) from 0 to 1.
        ordered: (o,) boxes of each order, the weights.

    Returns:
        (p,) lower and (p,) upper bounds.
    """
    effective = float(ordered.sum() ** 2 / np.square(ordered).sum())
    return wilson_interval(np.clip(rating, 0.0, 1.0) * effective, effective, confidence)
