"""Properties of plans from which simulation times are estimated: loose boxes, ties, and how far piles of compliant
boxes sway. A box is loose if its centre of mass is not over its supports. The ties of a box are its second and further
supports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import shared_length

MOST_LOOKED_AT: Final = 200
"""Largest number of plans of a run that are examined. The examined plans are evenly spread over all plans. If all plans
were examined, the start of a run with thousands of plans would be delayed."""

_LEVEL_MM: Final = 3.0
"""A box is borne by the highest top under it, and by all tops that are lower than this top by at most this length,
mm."""

_BESIDE_MM: Final = 1.0
"""If two boxes overlap by at most this length along x or y, mm, they stand beside each other."""


class Statics(NamedTuple):
    """Properties of plans from which simulation times are estimated. ``petmjx.engines.expected_work.Work`` has the same
    fields.

    Attributes:
        placed_share: (n,) the share of each plan's boxes up to and including its first loose box; 1 if there is none.
        ties: (n,) for each plan, the mean number of supports that a box has in addition to its first support.
        giving: (n,) number of compliant boxes of each plan.
        sway_mm: (n,) estimate of how far the top of each plan's load moves sideways if compliant boxes sink on one side
            of it, mm. The estimate is the boxes' mean sinking (``mean_sink_mm``), times the ratio of the load's height
            to a box's width (1 / ``tipping_g``); 0 without compliant boxes.
    """

    placed_share: FloatArray
    ties: FloatArray
    giving: FloatArray
    sway_mm: FloatArray


def statics_of(plans: Sequence[Plan], deck_mm_of: Callable[[Plan], FloatArray | None] = lambda _: None) -> Statics:
    """The properties of each plan from which its simulation time is estimated.

    If there are more than ``MOST_LOOKED_AT`` plans, only this number is examined, evenly spread over all plans. The
    values of the examined plans are then repeated, in their order, until there is a value for each plan. So a plan
    usually gets the value of another plan.

    Args:
        deck_mm_of: function that returns the carrier's boards under a plan, in the form of the argument ``deck_mm`` of
            ``loose_and_ties``.
    """
    examined = (
        [plans[k] for k in np.unique(np.linspace(0, len(plans) - 1, MOST_LOOKED_AT).astype(int))] if plans else []
    )
    columns = np.zeros((4, len(examined)))
    for column, plan in enumerate(examined):
        loose, ties = loose_and_ties(plan, deck_mm_of(plan))
        giving = 0 if plan.stiffness_n_mm is None else int(np.isfinite(plan.stiffness_n_mm).sum())
        sway_mm = mean_sink_mm(plan) / tipping_g(plan) if giving else 0.0
        columns[:, column] = min((loose + 1) / plan.n_boxes, 1.0), ties / plan.n_boxes, giving, sway_mm
    return Statics(*(np.resize(values, len(plans)) for values in columns))


def loose_and_ties(plan: Plan, deck_mm: FloatArray | None = None) -> tuple[int, int]:
    """The first loose box, in packing order; n if there is none. The function also returns the number of ties: all
    supports of all boxes, without the first support of each box.

    A box is loose if its centre of mass is not over its supports. The supports of a box are the highest tops of earlier
    boxes under it, or the boards of the carrier. The centre of mass is over the supports if it lies within the bounding
    rectangle of their contact areas. The convex hull of the contact areas can be smaller than their bounding rectangle,
    so a rule with the hull would find more loose boxes.

    Args:
        deck_mm: (b, 2, 2) lowest and highest corner (x, y) of each board on which boxes may stand, mm. If ``deck_mm``
            is None, the carrier is a slab under all boxes.
    """
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    bears, rest_mm, _ = _supports(plan)
    centre = (low + high) / 2 if plan.mass_center_mm is None else (low + high) / 2 + plan.mass_center_mm
    over = _is_over(centre, low, high, bears, low[:, :2], high[:, :2])
    stands = rest_mm <= 0
    if deck_mm is None:
        over |= stands
    else:
        board_low, board_high = deck_mm[:, 0], deck_mm[:, 1]
        along = [
            np.minimum(high[:, None, axis], board_high[:, axis]) - np.maximum(low[:, None, axis], board_low[:, axis])
            for axis in (0, 1)
        ]
        touches = (along[0] > _BESIDE_MM) & (along[1] > _BESIDE_MM)
        over = np.where(stands, _is_over(centre, low, high, touches, board_low, board_high), over)
    loose = np.flatnonzero(~over)
    ties = int(np.maximum(bears.sum(axis=1) - 1, 0).sum())
    return int(loose[0]) if len(loose) else plan.n_boxes, ties


def mean_sink_mm(plan: Plan) -> float:
    """Mean length by which the boxes of a plan sink because compliant boxes are compressed, mm.

    The boxes that bear a box share its load in proportion to the areas that touch. A compliant box is compressed by the
    mean of the loads on its two faces, divided by its stiffness. A box sinks by its own compression, and by the mean
    sinking of the boxes that bear it.
    """
    bears, _, area_mm2 = _supports(plan)
    borne_mm2 = np.where(bears, area_mm2, 0.0)
    share = borne_mm2 / np.maximum(borne_mm2.sum(axis=1, keepdims=True), 1.0)
    weight_n = STANDARD_GRAVITY * plan.mass_kg
    load_n, sink_mm = weight_n.copy(), np.zeros(plan.n_boxes)
    for box in reversed(range(plan.n_boxes)):  # from the last box, since a box comes after the boxes that bear it
        load_n += share[box] * load_n[box]
    stiffness_n_mm = np.inf if plan.stiffness_n_mm is None else plan.stiffness_n_mm
    compression_mm = np.nan_to_num((load_n - weight_n / 2) / stiffness_n_mm)
    for box in range(plan.n_boxes):
        sink_mm[box] = compression_mm[box] + share[box] @ sink_mm
    return float(sink_mm.mean())


def tipping_g(plan: Plan) -> float:
    """A rough estimate of the horizontal acceleration at which boxes fall off a plan's load, in units of 9.81 m/s².

    The result is the mean of the boxes' shorter horizontal sides, divided by the height of the load. A column of such
    boxes tips over at this acceleration if no neighbour holds the column.
    """
    height_mm = float((plan.corner_mm + plan.size_mm)[:, 2].max())
    return float(plan.size_mm[:, :2].min(axis=1).mean()) / height_mm


def _supports(plan: Plan) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    """Three arrays: (n, n) whether the box of a row lies on the box of a column; (n,) height of the highest top of an
    earlier box under each box, mm (0: there is none); and (n, n) area in which two boxes overlap if seen from above,
    mm²."""
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    along = [shared_length(low[:, axis], high[:, axis]) for axis in (0, 1)]
    numbers = np.arange(plan.n_boxes)
    under = (along[0] > _BESIDE_MM) & (along[1] > _BESIDE_MM) & (numbers[None, :] < numbers[:, None])
    under &= high[None, :, 2] <= low[:, None, 2] + _LEVEL_MM
    tops = np.where(under, high[None, :, 2], 0.0)
    rest_mm = tops.max(axis=1, initial=0.0)
    return under & (tops >= rest_mm[:, None] - _LEVEL_MM), rest_mm, along[0] * along[1]


def _is_over(
    centre: FloatArray,
    low: FloatArray,
    high: FloatArray,
    bears: NDArray[np.bool_],
    bearing_low: FloatArray,
    bearing_high: FloatArray,
) -> NDArray[np.bool_]:
    """(n,) whether each box's centre of mass is over the bounding rectangle of the box's contact areas; False for a box
    without contact areas.

    Args:
        centre, low, high: (n, 3) centre of mass, lowest and highest corner of each box, mm.
        bears: (n, b) whether each box lies on each of b surfaces.
        bearing_low, bearing_high: (b, 2) lowest and highest corner (x, y) of each surface, mm.
    """
    over = np.ones(len(centre), bool)
    for axis in (0, 1):
        begins = np.where(bears, np.maximum(low[:, None, axis], bearing_low[:, axis]), np.inf)
        ends = np.where(bears, np.minimum(high[:, None, axis], bearing_high[:, axis]), -np.inf)
        over &= centre[:, axis] >= begins.min(axis=1, initial=np.inf)
        over &= centre[:, axis] <= ends.max(axis=1, initial=-np.inf)
    return over
