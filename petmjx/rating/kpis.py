"""BED-BPP's KPIs of plans, and the leaderboard's rating: ``petmjx.kpis``.

Definitions are those of bed-bpp-env (e7459bf), ``evaluation/packing_plan_evaluator.py``; docs/kpis.md has them, and
says where petmjx has columns of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.basics.arguments import flag_of, path_of
from petmjx.basics.errors import InputError
from petmjx.basics.option_names import option
from petmjx.basics.text import counted, first_names
from petmjx.basics.units import MM_PER_M
from petmjx.options.config import Simulation
from petmjx.options.run_options import RunOptions
from petmjx.plans.conventions import warn
from petmjx.plans.gather import PlanSource, gather_plans
from petmjx.plans.matching import Matching, match
from petmjx.plans.ordered import OddBoxes, counts_of, on_target
from petmjx.plans.plan import Plan
from petmjx.plans.samples.order_files import read_orders
from petmjx.plans.samples.orders import TARGET_EXTENT_MM, Order
from petmjx.rating.columns import COLUMNS, MEANS
from petmjx.rating.stability import Stability, read_stability
from petmjx.rating.support import direct_support

SCORED_HEIGHT_MM: Final = 2_000.0
"""Boxes that begin above this height do not count for the leaderboard."""

_EDGE_MM: Final = 1.0
"""By how much BED-BPP's evaluator reads the height of the pile low: it takes the last whole millimetre of a box."""

Paths = str | PathLike[str] | Sequence[str | PathLike[str]]


@dataclass(frozen=True, eq=False)
class Kpis:
    """What :func:`kpis` found.

    Attributes:
        plans: a row a plan, with the columns of ``petmjx.rating.columns.COLUMNS``. Missing values are null.
        summary: of all plans: ``plans``, ``orders``, ``ordered_boxes``; ``means`` of the columns; the leaderboard's
            rating ``rating`` (by ``kpi_6``), ``rating_by_verdict`` and ``rating_if_all_stood``; None where stability is
            not known.
        notes: a line on all that was left out or is not known.
        skipped: lines on unusable plans and orders.
        found: the plans, by id.
        orders: the orders, by id.
    """

    plans: pd.DataFrame
    summary: dict[str, Any]
    notes: tuple[str, ...]
    skipped: tuple[str, ...]
    found: Mapping[str, Plan]
    orders: Mapping[str, Order]

    def __repr__(self) -> str:
        rating = self.summary["rating"]
        rated = "no rating" if rating is None else f"rating {rating:.4f}"
        return f"Kpis({counted(len(self.plans), 'plan')}, {counted(len(self.orders), 'order')}, {rated})"


def kpis(
    plans: PlanSource,
    orders: str | PathLike[str],
    run: Paths | None = None,
    *,
    assume_stable: bool = False,
    strict: bool = False,
) -> Kpis:
    """BED-BPP's KPIs of each plan, their means, and the leaderboard's rating.

    ``petmjx.kpis("plans.json", "orders.json", run=["static-run", "run"]).plans``

    Args:
        plans: as for ``petmjx.score``.
        orders: BED-BPP's orders file. An order belongs to the plan with its id.
        run: folders of runs of these plans. The verdicts are those of the first one; ``kpi_6`` is BED-BPP's rule on the
            first one with check ``static``.
        assume_stable: take all plans as stable: ``kpi_6`` is 1. Without runs only.
        strict: raise at the first unusable plan or order, instead of leaving it out.

    Raises:
        InputError: no usable plan or order, or a run of other plans.
    """
    flag_of(strict, "strict")
    flag_of(assume_stable, "assume_stable")
    orders = path_of(orders, "orders")
    if assume_stable and run:
        raise InputError(f"give either runs or {option('--assume-stable')}: a run already says which plans stand")
    read = gather_plans(plans, Simulation(), RunOptions(strict=strict))
    warn(read.conventions)
    by_id = {plan.plan_id: plan for plan in read.plans}
    skipped = [str(skipped_plan) for skipped_plan in read.skipped]
    orders_by_id: dict[str, Order] = {}
    for order_id, order in read_orders(Path(orders), None if strict else lambda bad: skipped.append(str(bad))):
        orders_by_id[order_id] = order
    rated = {plan_id: plan for plan_id, plan in by_id.items() if plan_id in orders_by_id}
    if not rated:
        first = f"; the first that is unusable: {skipped[0]}" if skipped else ""
        raise InputError(
            f"no plan has an order: {counted(len(by_id), 'plan')} and {counted(len(orders_by_id), 'usable order')} "
            f"have no id in common{first}"
        )
    stability = Stability.assumed() if assume_stable else read_stability(_as_list(run), rated.values())
    matchings = {plan_id: match(plan, orders_by_id[plan_id]) for plan_id, plan in rated.items()}
    frame = _frame(rated, orders_by_id, matchings, stability)
    odd = _odd_boxes(rated, orders_by_id, matchings)
    notes = (*read.notes, *_notes(by_id, orders_by_id), *odd, *stability.notes, *_unknown(frame, stability))
    return Kpis(frame, _summary(frame, orders_by_id.values()), tuple(notes), tuple(skipped), by_id, orders_by_id)


def kpis_of(plan: Plan, order: Order, matching: Matching | None = None) -> dict[str, Any]:
    """The columns of one plan that do not depend on its stability.

    Args:
        matching: its boxes and the order's, where they are matched already.
    """
    matching = matching or match(plan, order)
    ordered = counts_of(matching)
    extent = TARGET_EXTENT_MM[order.target]
    support = direct_support(plan.corner_mm, plan.size_mm, extent)
    tops = plan.corner_mm[:, 2] + plan.size_mm[:, 2]
    height_mm, area = float(tops.max()), extent[0] * extent[1]
    volumes = plan.size_mm.prod(axis=1)
    counts = (plan.corner_mm[:, 2] <= SCORED_HEIGHT_MM) & matching.as_ordered & on_target(plan, order)
    below = tops <= SCORED_HEIGHT_MM
    return {
        "plan_id": plan.plan_id,
        "target": order.target,
        "n_ordered": len(order.items),
        "n_boxes": plan.n_boxes,
        "n_not_ordered": ordered.not_ordered,
        "n_resized": ordered.resized,
        "kpi_1": ordered.left_out / ordered.ordered_boxes,
        "kpi_2": float(volumes.sum()) / (area * height_mm) if height_mm > 0 else None,
        "kpi_3": height_mm / MM_PER_M,
        "kpi_4": float(support.share.mean()),
        "kpi_5": _interlocked(plan, support.n_below),
        "eval_score_height": _their_height(tops),
        "n_pal_items": int(np.count_nonzero(counts)),
        "height_below_2m_m": float(tops[below].max(initial=0.0)) / MM_PER_M,
        "volume_m3": float(volumes.sum()) / MM_PER_M**3,
        "utilisation_2m": float(volumes[below].sum()) / (area * SCORED_HEIGHT_MM),
    }


def _interlocked(plan: Plan, n_below: np.ndarray[Any, np.dtype[np.int64]]) -> float | None:
    """Of the boxes that are not on the target, the share that lies on several boxes, or on one and is turned otherwise
    than the first box of the plan; None where all are on the target."""
    turned = plan.turned != plan.turned[0]
    n_above = int(np.count_nonzero(n_below))
    held = (n_below > 1) | ((n_below == 1) & turned)
    return int(np.count_nonzero(held)) / n_above if n_above else None


def _their_height(tops_mm: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    read = tops_mm - _EDGE_MM
    return round(float(read[read <= SCORED_HEIGHT_MM].max(initial=0.0)) / MM_PER_M, 3)


def _frame(
    rated: Mapping[str, Plan], orders: Mapping[str, Order], matchings: Mapping[str, Matching], stability: Stability
) -> pd.DataFrame:
    frame = pd.DataFrame([kpis_of(plan, orders[name], matchings[name]) for name, plan in rated.items()])
    ids = frame["plan_id"]
    frame["kpi_6"] = stability.column(stability.their_rule, ids)
    frame["verdict"] = [stability.verdicts.get(plan_id) for plan_id in ids]
    frame["stable"] = stability.column(stability.stable, ids)
    for flag, ratio, number in (
        ("kpi_6", "eval_score_pal_ratio", "eval_score_absolute_n_stable_pal_items"),
        ("stable", "stable_pal_ratio", "n_stable_pal_items"),
    ):
        frame[number] = (frame[flag] * frame["n_pal_items"]).astype("Int64")
        frame[ratio] = frame[number].astype("Float64") / frame["n_ordered"]
    kinds = {column.name: column.pandas for column in COLUMNS}
    return frame[list(kinds)].astype(kinds)


def _summary(frame: pd.DataFrame, orders: Collection[Order]) -> dict[str, Any]:
    ordered = sum(len(order.items) for order in orders)

    def rating(column: str) -> float | None:
        values = frame[column]
        return None if values.isna().all() else int(values.sum()) / ordered

    means = {name: None if frame[name].isna().all() else float(frame[name].mean()) for name in MEANS}
    return {
        "plans": len(frame),
        "orders": len(orders),
        "ordered_boxes": ordered,
        "means": means,
        "rating": rating("eval_score_absolute_n_stable_pal_items"),
        "rating_by_verdict": rating("n_stable_pal_items"),
        "rating_if_all_stood": rating("n_pal_items"),
    }


def _notes(plans: Mapping[str, Plan], orders: Mapping[str, Order]) -> list[str]:
    without_order = [plan_id for plan_id in plans if plan_id not in orders]
    without_plan = [order_id for order_id in orders if order_id not in plans]
    notes = []
    if without_order:
        verb = "has" if len(without_order) == 1 else "have"
        plans_without = counted(len(without_order), "plan")
        notes.append(f"{plans_without} {verb} no order and no KPIs ({first_names(without_order)})")
    if without_plan:
        verb = "has no plan, and counts" if len(without_plan) == 1 else "have no plan, and count"
        boxes = counted(sum(len(orders[order_id].items) for order_id in without_plan), "box", "boxes")
        these = f"{counted(len(without_plan), 'order')} ({boxes})"
        notes.append(f"{these} {verb} as not stable in the ratings ({first_names(without_plan)})")
    return notes


def _odd_boxes(
    plans: Mapping[str, Plan], orders: Mapping[str, Order], matchings: Mapping[str, Matching]
) -> Iterator[str]:
    """A line on boxes that are not the orders', with the first plan that has some, and on boxes known by size alone."""
    odd = OddBoxes()
    for name, matching in matchings.items():
        odd.add(plans[name], orders[name], matching)
    return odd.lines()


def _unknown(frame: pd.DataFrame, stability: Stability) -> list[str]:
    """Plans whose stability is not known though the run has that of others."""
    notes = []
    for column, known in (("kpi_6", stability.their_rule), ("stable", stability.stable)):
        missing = frame.loc[frame[column].isna(), "plan_id"].tolist()
        if known and missing:
            verb = "is" if len(missing) == 1 else "are"
            unknown = f"{counted(len(missing), 'plan')} {verb} not in the run or invalid there, so {column} is empty"
            notes.append(f"{unknown}, which counts as not stable in the rating ({first_names(missing)})")
    return notes


def _as_list(run: Paths | None) -> list[Path]:
    if run is None:
        return []
    return [Path(run)] if isinstance(run, str | PathLike) else [Path(folder) for folder in run]
