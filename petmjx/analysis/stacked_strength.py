"""The strength of boxes in a stack: the strength in a press, multiplied by factors for each box's place in the stack,
for moist air and for time.

The factors for the place depend on how much of the box's walls is loaded and supported
(petmjx/analysis/carton_walls.py). petmjx/options/strength_losses.py has the losses of strength from which the factors
are computed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Final

import numpy as np
import pandas as pd

from petmjx.analysis.carton_walls import walls_of
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.carriers import Carrier, OwnCarrier, extent_m
from petmjx.options.strength_losses import Stacking
from petmjx.plans.articles import Articles
from petmjx.plans.plan import Plan
from petmjx.world.carrier_boards import pallet

_FACTORS: Final = ("wall_factor", "overhang_factor", "deck_factor", "humidity_factor")
_STRENGTH: Final = ("press_strength_n", *_FACTORS, "strength_n", "time_factor", "strength_low_n", "strength_high_n")


def stacked_strengths(
    plans: Iterable[Plan], articles: Articles, losses: Stacking, carrier: Carrier | OwnCarrier
) -> tuple[pd.DataFrame, Counter[str]]:
    """Return a table with the strength of each box that is not a sheet, and, for each article without a known strength,
    the number of its boxes."""
    parts: list[pd.DataFrame] = []
    missing: Counter[str] = Counter()
    for plan in plans:
        groups = plan.product_groups or ("",) * plan.n_boxes
        sizes = plan.size_mm[:, :2].tolist()
        materials = plan.materials or ("",) * plan.n_boxes
        strength_n = np.full(plan.n_boxes, np.nan) if plan.strength_n is None else plan.strength_n.copy()
        names = zip(plan.articles, groups, materials, strict=True)
        sheets = plan.sheets
        for box, (article, group, material) in enumerate(names):
            if (strength := articles.find(article, group, material).strength) is not None:
                strength_n[box] = strength.of_box(*sizes[box])
            if np.isnan(strength_n[box]) and not sheets[box]:
                missing[article] += 1
        factors, low, high = _factors(plan, losses, carrier)
        borne = (strength_n * np.prod(factor_set, axis=0) for factor_set in (factors, low, high))
        columns = {"press_strength_n": strength_n, **dict(zip(_FACTORS, factors, strict=True))}
        columns |= dict(zip(("strength_n", "strength_low_n", "strength_high_n"), borne, strict=True))
        columns["time_factor"] = np.full(plan.n_boxes, remaining_share(losses.time_loss))
        table = pd.DataFrame({"plan_id": plan.plan_id, "box": np.arange(plan.n_boxes, dtype=np.int32), **columns})
        parts.append(table[~sheets])
    if not parts:
        empty = dict.fromkeys(_STRENGTH, "float64")
        return pd.DataFrame(columns=["plan_id", "box", *_STRENGTH]).astype({"box": "int32", **empty}), missing
    return pd.concat(parts, ignore_index=True), missing


def remaining_share(loss: float, factor: float = 1.0) -> float:
    """The share of a box's strength that remains after the loss ``factor * loss``."""
    return 1.0 - min(factor * loss, 1.0)


def _factors(plan: Plan, losses: Stacking, carrier: Carrier | OwnCarrier) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Three arrays (4, n) with the four factors (``_FACTORS``) by which the strength of each of n boxes in a press is
    multiplied. The first array is for the nominal losses of strength, the second for the largest losses, and the third
    for the smallest losses."""
    extent, boards = extent_m(carrier), pallet(carrier)
    extent_mm = None if extent is None else (MM_PER_M * extent[0], MM_PER_M * extent[1])
    walls = walls_of(plan, extent_mm, None if boards is None else boards.deck_mm, losses.wall_tolerance_mm)
    perimeter_mm = 2 * plan.size_mm[:, :2].sum(axis=1)
    gaps = walls.on_deck & (walls.over_gaps * perimeter_mm > losses.wall_tolerance_mm)

    def factors(spread: float) -> FloatArray:
        scaled_losses = losses.with_losses(spread)
        deck = np.where(gaps, 1 - scaled_losses.gap_loss, 1.0) * np.where(
            walls.on_deck, 1 - scaled_losses.soft_deck_loss, 1.0
        )
        moist = np.full(plan.n_boxes, remaining_share(losses.humidity_loss, spread))
        return np.stack(
            [
                1 - scaled_losses.interlocked_loss * (1 - walls.met),
                1 - scaled_losses.overhang_loss * walls.hanging,
                deck,
                moist,
            ]
        )

    return factors(1.0), factors(1.0 + losses.loss_spread), factors(1.0 - losses.loss_spread)
