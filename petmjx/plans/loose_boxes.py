"""Properties of plans from which simulation times are estimated: loose boxes, whose centre of mass is not over their
supports, and ties, which are the further supports of a box after its first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import shared_length

MOST_LOOKED_AT: Final = 200
"""Largest number of plans of a run that are examined. The examined plans are evenly spread over all plans. Without this
limit, a run of 10,003 plans would be delayed."""

_LEVEL_MM: Final = 3.0
"""A box is borne by the highest top under it, and by all tops that are lower than this top by at most this length,
mm."""

_BESIDE_MM: Final = 1.0
"""If two boxes overlap by at most this length along x or y, mm, they stand beside each other."""


class Statics(NamedTuple):
    """Properties of plans from which simulation times are estimated. ``petmjx.engines.cost_model.Work`` has the same
    fields.

    Attributes:
        placed_share: (n,) the share of each plan's boxes up to and including its first loose box; 1 if there is none.
        ties: (n,) for each plan, the mean, over its boxes, of the number of supports after a box's first support.
        giving: (n,) number of compliant boxes of each plan.
    """

    placed_share: FloatArray
    ties: FloatArray
    giving: FloatArray


def statics_of(plans: Sequence[Plan]) -> Statics:
    """The properties of each plan from which its simulation time is estimated.

    If there are more than ``MOST_LOOKED_AT`` plans, only this number is examined, evenly spread over all plans. The
    values of the examined plans are then repeated, in their order, until there is a value for each plan. So the value
    of a plan usually is that of another plan.
    """
    examined = (
        [plans[k] for k in np.unique(np.linspace(0, len(plans) - 1, MOST_LOOKED_AT).astype(int))] if plans else []
    )
    columns = np.zeros((3, len(examined)))
    for column, plan in enumerate(examined):
        loose, ties = loose_and_ties(plan)
        giving = 0 if plan.stiffness_n_mm is None else int(np.isfinite(plan.stiffness_n_mm).sum())
        columns[:, column] = min((loose + 1) / plan.n_boxes, 1.0), ties / plan.n_boxes, giving
    return Statics(*(np.resize(values, len(plans)) for values in columns))


def loose_and_ties(plan: Plan) -> tuple[int, int]:
    """The first loose box, in packing order; n if there is none. The function also returns the number of ties: all
    supports of all boxes, without the first support of each box.

    A box is loose if its centre of mass is not over its supports. The supports of a box are the highest tops of earlier
    boxes under it, or the carrier. The centre of mass is over the supports if it lies within the bounding rectangle of
    their contact areas. The convex hull of the contact areas can be smaller than their bounding rectangle, so a rule
    with the hull would find more loose boxes.
    """
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    along = [shared_length(low[:, axis], high[:, axis]) for axis in (0, 1)]
    numbers = np.arange(plan.n_boxes)
    under = (along[0] > _BESIDE_MM) & (along[1] > _BESIDE_MM) & (numbers[None, :] < numbers[:, None])
    under &= high[None, :, 2] <= low[:, None, 2] + _LEVEL_MM
    tops = np.where(under, high[None, :, 2], 0.0)
    rest_mm = tops.max(axis=1, initial=0.0)
    bears = under & (tops >= rest_mm[:, None] - _LEVEL_MM)
    centre = (low + high) / 2 if plan.mass_center_mm is None else (low + high) / 2 + plan.mass_center_mm
    over = np.ones(plan.n_boxes, bool)
    for axis in (0, 1):
        begins = np.where(bears, np.maximum(low[:, None, axis], low[None, :, axis]), np.inf).min(axis=1, initial=np.inf)
        ends = np.where(bears, np.minimum(high[:, None, axis], high[None, :, axis]), -np.inf).max(
            axis=1, initial=-np.inf
        )
        over &= (centre[:, axis] >= begins) & (centre[:, axis] <= ends)
    loose = np.flatnonzero(~over & (rest_mm > 0))
    ties = int(np.maximum(bears.sum(axis=1) - 1, 0).sum())
    return int(loose[0]) if len(loose) else plan.n_boxes, ties
