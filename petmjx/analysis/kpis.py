"""Computes the KPIs (key performance indicators) of BED-BPP, a public benchmark for packing, and the rating on its
leaderboard: ``petmjx.kpis``.

The definitions of the KPIs, and the rule of ``direct_support``, come from bed-bpp-env (e7459bf):
``evaluation/packing_plan_evaluator.py``, ``environment/space_3d.py`` and ``environment/cuboid.py``. docs/kpis.md lists
the KPIs and the columns that petmjx adds, and explains the rule. ``COLUMNS`` lists the columns of the table.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.analysis.kpi_stability import Stability, read_stability
from petmjx.common.argument_checks import flag_of, list_of, path_of
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.convention_checks import warn
from petmjx.plans.order import Order, target_extent_mm
from petmjx.plans.order_checks import OddBoxes, counts_of
from petmjx.plans.order_matching import Matching, match, on_target
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PlanSource, gather_plans
from petmjx.results.plan_lookup import plans_in_place
from petmjx.results.run_reader import RunResults, RunSource


class KpiColumn(NamedTuple):
    """One column of the table of KPIs. ``pandas`` is the type of the column in a data frame. ``mean`` tells whether
    petmjx shows the mean of the column."""

    name: str
    pandas: str
    unit: str
    meaning: str
    mean: bool = True


def _text(name: str, meaning: str) -> KpiColumn:
    return KpiColumn(name, "object", "", meaning, mean=False)


COLUMNS: Final = (
    _text("plan_id", "id of the packing plan and of its order"),
    _text("target", "the order's target: 'euro-pallet' (1200 × 800 mm) or 'rollcontainer' (800 × 700 mm)"),
    KpiColumn("n_ordered", "int64", "1", "number of boxes of the order"),
    KpiColumn("n_boxes", "int64", "1", "number of boxes of the plan"),
    KpiColumn(
        "n_not_ordered",
        "int64",
        "1",
        "number of boxes of the plan that were not ordered, or that occur more often than ordered",
    ),
    KpiColumn("n_resized", "int64", "1", "number of boxes that were ordered with another size, mass or property"),
    KpiColumn("kpi_1", "float64", "1", "share of the ordered boxes that is left out"),
    KpiColumn("kpi_2", "float64", "1", "volume of the boxes / (area of the target × greatest height)"),
    KpiColumn("kpi_3", "float64", "m", "greatest height"),
    KpiColumn(
        "kpi_4", "float64", "1", "mean share of a box's base that lies on other boxes; 1 for a box on the target"
    ),
    KpiColumn(
        "kpi_5",
        "float64",
        "1",
        "among the boxes that lie on other boxes, share of those that tie the pile together (lie on several boxes, or "
        "are turned otherwise than the plan's first box); null if no box lies on a box",
    ),
    KpiColumn(
        "kpi_6",
        "Int64",
        "1",
        "1: no box moved by more than 0.01 m along z in the static check; 0: a box did; null: unknown",
    ),
    KpiColumn(
        "eval_score_pal_ratio",
        "Float64",
        "1",
        "kpi_6 × share of the ordered boxes that are placed with their bottom at or below 2.0 m",
    ),
    KpiColumn(
        "eval_score_height",
        "float64",
        "m",
        "height of the highest box top at or below 2.0 m, as BED-BPP computes it (1 mm too low)",
    ),
    KpiColumn(
        "eval_score_absolute_n_stable_pal_items",
        "Int64",
        "1",
        "kpi_6 × number of ordered boxes that are placed with their bottom at or below 2.0 m",
    ),
    KpiColumn(
        "n_pal_items",
        "int64",
        "1",
        "number of boxes on the target that are as ordered and have their bottom at or below 2.0 m; each ordered box "
        "counts once",
    ),
    KpiColumn("height_below_2m_m", "float64", "m", "height of the highest box top at or below 2.0 m"),
    KpiColumn("volume_m3", "float64", "m^3", "volume of the boxes"),
    KpiColumn(
        "utilisation_2m",
        "float64",
        "1",
        "volume of the boxes whose top is at or below 2.0 m / (area of the target × 2.0 m)",
    ),
    _text("verdict", "petmjx's verdict; null if unknown"),
    KpiColumn("stable", "Int64", "1", "1: the verdict is stable; 0: it is unstable; null: it is invalid or unknown"),
    KpiColumn(
        "stable_pal_ratio",
        "Float64",
        "1",
        "`stable` × share of the ordered boxes that are placed with their bottom at or below 2.0 m",
    ),
    KpiColumn(
        "n_stable_pal_items",
        "Int64",
        "1",
        "`stable` × number of ordered boxes that are placed with their bottom at or below 2.0 m",
    ),
)
"""The columns of the table of KPIs."""

MEANS: Final = tuple(column.name for column in COLUMNS if column.mean)
"""Names of the columns of KPIs whose means are shown."""


HEIGHT_TOLERANCE_MM: Final = 5.0
"""Largest gap between the top of a box and the bottom of a new box that still lies on this box, mm."""


class Support(NamedTuple):
    """How n boxes are supported, according to BED-BPP's method: the supported shares of their bases, and the numbers of
    boxes directly below them.

    Attributes:
        share: (n,) supported share of each box's base; 1 for a box on the target.
        n_below: (n,) number of boxes on which each box lies; 0 for a box on the target.
    """

    share: FloatArray
    n_below: NDArray[np.int64]


def direct_support(corner_mm: FloatArray, size_mm: FloatArray, extent_mm: tuple[float, float]) -> Support:
    """Determine, by BED-BPP's method, the boxes on which each box of a plan lies directly.

    BED-BPP's evaluator divides the target into cells of one square millimetre. This function uses larger cells, from
    one edge of a box to the next edge of any box, so that all points of a cell are under the same boxes.

    Args:
        corner_mm, size_mm: (n, 3) corners and sizes of the boxes as placed, mm, in packing order.
        extent_mm: extents of the target along x and y; the target's corner is at the origin. The parts of boxes that
            lie outside the target support nothing.
    """
    low, high = corner_mm[:, :2], corner_mm[:, :2] + size_mm[:, :2]
    x, y = (_cells(low[:, axis], high[:, axis], extent_mm[axis]) for axis in (0, 1))
    last = np.full((x.number, y.number), -1)
    reached = np.zeros((x.number, y.number))
    tops = corner_mm[:, 2] + size_mm[:, 2]
    share, n_below = np.ones(len(low)), np.zeros(len(low), dtype=np.int64)
    for box, bottom in enumerate(corner_mm[:, 2]):
        under = slice(x.first[box], x.end[box]), slice(y.first[box], y.end[box])
        top_boxes = last[under]
        met = np.zeros(len(low), dtype=bool)
        met[top_boxes[(top_boxes >= 0) & (reached[under] >= bottom - HEIGHT_TOLERANCE_MM)]] = True
        below = np.flatnonzero(met)
        if len(below):
            shared = np.minimum(high[box], high[below]) - np.maximum(low[box], low[below])
            share[box] = (shared[:, 0] * shared[:, 1]).sum() / (size_mm[box, 0] * size_mm[box, 1])
            n_below[box] = len(below)
        last[under], reached[under] = box, tops[box]
    return Support(share, n_below)


class _Cells(NamedTuple):
    """The division of the target into cells along one axis: the number of cells, and for each box the first cell under
    the box and the first cell beyond the box."""

    number: int
    first: NDArray[np.int64]
    end: NDArray[np.int64]


def _cells(low: FloatArray, high: FloatArray, extent: float) -> _Cells:
    low, high = np.clip(low, 0, extent), np.clip(high, 0, extent)
    edges = np.unique(np.concatenate((low, high)))
    return _Cells(len(edges) - 1, np.searchsorted(edges, low), np.searchsorted(edges, high))


SCORED_HEIGHT_MM: Final = 2_000.0
"""The leaderboard of BED-BPP ignores boxes whose bottom is above this height, mm."""

_EDGE_MM: Final = 1.0
"""BED-BPP's evaluator measures a height up to the last whole millimetre inside a box, so its heights are too small by
this length, mm."""


@dataclass(frozen=True, eq=False)
class Kpis:
    """The result of :func:`kpis`.

    Attributes:
        plans: one row per plan, with the columns of ``petmjx.analysis.kpis.COLUMNS``. Missing values are null.
        summary: values about all plans: the numbers of ``plans``, ``orders`` and ``ordered_boxes``, the ``means`` of
            the columns, and the leaderboard's rating in three forms. ``rating`` uses ``kpi_6`` to decide which plans
            stand, ``rating_by_verdict`` uses petmjx's verdict, and ``rating_if_all_stood`` assumes that all plans
            stand. A rating is None if it is unknown which plans stand.
        notes: lines for the user about missing and unknown values.
        skipped: lines for the user about unusable plans and orders.
        plans_by_id: the plans, by id.
        orders: the orders, by id.
    """

    plans: pd.DataFrame
    summary: dict[str, Any]
    notes: tuple[str, ...]
    skipped: tuple[str, ...]
    plans_by_id: Mapping[str, Plan]
    orders: Mapping[str, Order]

    @property
    def found(self) -> Mapping[str, Plan]:
        """``plans_by_id`` under its name in version 0.2."""
        warnings.warn("Kpis.found is now Kpis.plans_by_id", DeprecationWarning, stacklevel=2)
        return self.plans_by_id

    def __repr__(self) -> str:
        rating = self.summary["rating"]
        rated = "no rating" if rating is None else f"rating {rating:.4f}"
        return f"Kpis({count_text(len(self.plans), 'plan')}, {count_text(len(self.orders), 'order')}, {rated})"


def kpis(
    plans: PlanSource,
    orders: str | PathLike[str],
    run: RunSource | Sequence[RunSource] | None = None,
    *,
    assume_stable: bool = False,
    strict: bool = False,
) -> Kpis:
    """Compute BED-BPP's KPIs of each plan, the means of the KPIs, and the leaderboard's rating.

    ``petmjx.kpis("plans.json", "orders.json", run=["static-run", "run"]).plans``

    Args:
        plans: as for ``petmjx.score``.
        orders: file of orders, in BED-BPP's form or in any other form that petmjx reads. An order belongs to the plan
            with the same id.
        run: one or several runs in which these plans were simulated, as folders or as results of ``petmjx.score``. The
            verdicts come from the first run. ``kpi_6`` comes from BED-BPP's rule, applied to the first run with check
            ``static``.
        assume_stable: whether all plans count as stable, so that ``kpi_6`` is 1; allowed only without runs.
        strict: whether an unusable plan or order raises an error instead of being left out.

    Raises:
        InputError: there is no usable plan or order, or a plan in a run differs from the given plan with the same id.
    """
    flag_of(strict, "strict")
    flag_of(assume_stable, "assume_stable")
    orders = path_of(orders, "orders")
    if assume_stable and run:
        raise InputError(f"give either runs or {option('--assume-stable')}: a run already says which plans stand")
    read = gather_plans(plans_in_place(plans, strict), Simulation(), RunOptions(strict=strict))
    warn(read.conventions)
    by_id = {plan.plan_id: plan for plan in read.plans}
    skipped = [str(skipped_plan) for skipped_plan in read.skipped]
    orders_by_id: dict[str, Order] = {}
    for order_id, order in read_orders(Path(orders), None if strict else lambda bad: skipped.append(str(bad))):
        orders_by_id[order_id] = order
    rated = {plan_id: plan for plan_id, plan in by_id.items() if plan_id in orders_by_id}
    if not rated:
        first = f"; the first unusable order: {skipped[0]}" if skipped else ""
        raise InputError(
            f"no plan has an order: {count_text(len(by_id), 'plan')} and "
            f"{count_text(len(orders_by_id), 'usable order')} "
            f"have no id in common{first}"
        )
    stability = Stability.assumed() if assume_stable else read_stability(_as_list(run), rated.values())
    matchings = {plan_id: match(plan, orders_by_id[plan_id]) for plan_id, plan in rated.items()}
    frame = _frame(rated, orders_by_id, matchings, stability)
    odd = _odd_boxes(rated, orders_by_id, matchings)
    notes = (*read.notes, *_notes(by_id, orders_by_id), *odd, *stability.notes, *_unknown(frame, stability))
    return Kpis(frame, _summary(frame, orders_by_id.values()), tuple(notes), tuple(skipped), by_id, orders_by_id)


def kpis_of(plan: Plan, order: Order, matching: Matching | None = None) -> dict[str, Any]:
    """Column → value, for one plan and all columns of KPIs that do not depend on whether the plan stands.

    Args:
        matching: which ordered item each box of the plan is. If ``matching`` is None, it is computed.
    """
    matching = matching or match(plan, order)
    ordered = counts_of(matching)
    extent = target_extent_mm(order.target)
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
        "kpi_5": _interlocked_share(plan, support.n_below),
        "eval_score_height": _their_height(tops),
        "n_pal_items": int(np.count_nonzero(counts)),
        "height_below_2m_m": float(tops[below].max(initial=0.0)) / MM_PER_M,
        "volume_m3": float(volumes.sum()) / MM_PER_M**3,
        "utilisation_2m": float(volumes[below].sum()) / (area * SCORED_HEIGHT_MM),
    }


def _interlocked_share(plan: Plan, n_below: np.ndarray[Any, np.dtype[np.int64]]) -> float | None:
    """The share of boxes that hold the pile together, among the boxes that lie on other boxes. A box holds the pile
    together if it lies on several boxes, or if it lies on one box and is turned differently from the plan's first box.
    The share is None if all boxes stand on the target."""
    turned = plan.turned != plan.turned[0]
    n_above = int(np.count_nonzero(n_below))
    interlocked = (n_below > 1) | ((n_below == 1) & turned)
    return int(np.count_nonzero(interlocked)) / n_above if n_above else None


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
        plans_without = count_text(len(without_order), "plan")
        notes.append(f"{plans_without} {verb} no order and no KPIs ({first_names(without_order)})")
    if without_plan:
        verb = "has no plan, and counts" if len(without_plan) == 1 else "have no plan, and count"
        boxes = count_text(sum(len(orders[order_id].items) for order_id in without_plan), "box", "boxes")
        these = f"{count_text(len(without_plan), 'order')} ({boxes})"
        notes.append(f"{these} {verb} as not stable in the ratings ({first_names(without_plan)})")
    return notes


def _odd_boxes(
    plans: Mapping[str, Plan], orders: Mapping[str, Order], matchings: Mapping[str, Matching]
) -> Iterator[str]:
    """Yield up to two lines for the user. One is about boxes that were not ordered, and names the first plan that has
    such boxes. The other is about boxes that were matched with ordered items by size alone."""
    odd = OddBoxes()
    for name, matching in matchings.items():
        odd.add(plans[name], orders[name], matching)
    return odd.lines()


def _unknown(frame: pd.DataFrame, stability: Stability) -> list[str]:
    """Lines for the user about plans for which no run says whether they stand. If this is unknown for every plan, there
    are no lines."""
    notes = []
    for column, known in (("kpi_6", stability.their_rule), ("stable", stability.stable)):
        missing = frame.loc[frame[column].isna(), "plan_id"].tolist()
        if known and missing:
            verb = "is" if len(missing) == 1 else "are"
            unknown = (
                f"{count_text(len(missing), 'plan')} {verb} not in the run, or {verb} invalid there, so the column "
                f"{column} is empty"
            )
            notes.append(f"{unknown}, which counts as not stable in the rating ({first_names(missing)})")
    return notes


def _as_list(run: RunSource | Sequence[RunSource] | None) -> list[RunResults | Path]:
    """The runs, as results or folders.

    Raises:
        InputError: a run is neither a result nor the path of a folder.
    """
    if run is None:
        return []
    several = [run] if isinstance(run, RunResults | str | PathLike) else list_of(run, "run", object, "runs or folders")
    return [one if isinstance(one, RunResults) else path_of(one, "run") for one in several]
