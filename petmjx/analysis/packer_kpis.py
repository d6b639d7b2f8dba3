"""Compares packers' plans with the orders for which the plans were made: finds out which boxes were ordered, and
computes the KPIs (key performance indicators) of BED-BPP, a public benchmark for packing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from petmjx.analysis.kpis import kpis_of
from petmjx.common.text import count_text, first_names, printable, printable_name
from petmjx.plans.articles import Articles, read_articles
from petmjx.plans.order import Order
from petmjx.plans.order_checks import OddBoxes, counts_of
from petmjx.plans.order_matching import match, on_target, with_properties
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan import Plan
from petmjx.results.plan_lookup import find_plans, how_read
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults

KPIS: Final = ("kpi_1", "kpi_2", "kpi_4", "kpi_5", "utilisation_2m")
"""KPIs whose means are shown. Two KPIs are left out: kpi_3 is the height, which is known without orders, and kpi_6
needs a simulation with the check ``static``."""

ORDER_COUNTS: Final = ("left_out", "not_ordered", "resized", "as_ordered")
"""Columns with numbers of boxes. The first three are fields of :class:`petmjx.plans.order_checks.PlanOrderCounts`;
the last is the number of boxes that have the ordered size and mass and lie on the order's target, such as a pallet."""


@dataclass(frozen=True, eq=False)
class OrderComparison:
    """The comparison of packers' plans with orders.

    Attributes:
        sizes: id of each order → number of boxes of the order.
        rows: one row for each plan that has an order, with the columns ``plan_id``, ``packer``, ``ORDER_COUNTS`` and
            ``KPIS`` (float64; null if a KPI has no value).
        notes: lines for the user about each packer's boxes that were not ordered, plans without an order, plans that
            could not be read again, orders without any plan, and unusable orders.
    """

    sizes: Mapping[str, int]
    rows: pd.DataFrame
    notes: tuple[str, ...] = ()


def against_orders(runs: Mapping[str, RunResults], file: Path, articles: Path | None = None) -> OrderComparison:
    """Compare the plans of runs with the orders in a file. The plans are read again, from the tables of the runs or
    from the files of plans.

    Args:
        runs: name of each packer → its run.
        file: file of orders, in BED-BPP's form or in any other form that petmjx reads. An order belongs to the plans
            with the same id.
        articles: a table of articles, from which properties are read that the orders do not state. If ``articles`` is
            None, the table that all runs name is used.

    Raises:
        InputError: a file cannot be read.
    """
    unusable: list[str] = []
    table = _articles_of(runs) if articles is None else read_articles(articles)
    orders = {
        name: with_properties(order, table)
        for name, order in read_orders(file, lambda error: unusable.append(str(error)))
    }
    plans = {name: _plans_of(run, orders) for name, run in runs.items()}
    comparison = compare_with_orders(plans, orders)
    notes = list(comparison.notes)
    if unusable:
        notes.append(
            f"{count_text(len(unusable), 'order')} of {printable(str(file))} unusable; the first: {unusable[0]}"
        )
    for name, run in runs.items():
        ids = dict.fromkeys(run.worlds["plan_id"])
        if without := [plan_id for plan_id in ids if plan_id not in orders]:
            first = first_names(without)
            notes.append(
                f"no KPIs of {count_text(len(without), 'plan')} of {printable_name(name)}: no order was given for "
                f"these ids ({first})"
            )
        if lost := [plan_id for plan_id in ids if plan_id in orders and plan_id not in plans[name]]:
            first = first_names(lost)
            notes.append(
                f"no KPIs of {count_text(len(lost), 'plan')} of {printable_name(name)}: these plans are in no file any "
                f"more, so it is unknown whether their boxes were ordered ({first})"
            )
    packed = {plan_id for run in runs.values() for plan_id in run.worlds["plan_id"]}
    if left := [order_id for order_id in orders if order_id not in packed]:
        verb = "is" if len(left) == 1 else "are"
        boxes = count_text(sum(comparison.sizes[order_id] for order_id in left), "box", "boxes")
        notes.append(f"{count_text(len(left), 'order')} ({boxes}) {verb} packed by nobody: {first_names(left)}")
    return OrderComparison(comparison.sizes, comparison.rows, tuple(notes))


def compare_with_orders(plans: Mapping[str, Mapping[str, Plan]], orders: Mapping[str, Order]) -> OrderComparison:
    """Compare plans with orders that are in memory.

    Args:
        plans: name of each packer → the packer's plans, by id. Plans without an order are ignored.
        orders: the orders, by id.
    """
    rows: list[dict[str, object]] = []
    notes: list[str] = []
    for name, by_id in plans.items():
        odd = OddBoxes()
        for plan_id, plan in by_id.items():
            if (order := orders.get(plan_id)) is None:
                continue
            matching = match(plan, order)
            ordered = counts_of(matching)
            odd.add(plan, order, matching)
            as_ordered = int(np.count_nonzero(matching.as_ordered & on_target(plan, order)))
            kpis = kpis_of(plan, order, matching)
            counts = (ordered.left_out, ordered.not_ordered, ordered.resized, as_ordered)
            rows.append(
                {"packer": name, "plan_id": plan_id}
                | dict(zip(ORDER_COUNTS, counts, strict=True))
                | {kpi: kpis[kpi] for kpi in KPIS}
            )
        notes += odd.lines(f"of {printable_name(name)}")
    table = pd.DataFrame(rows, columns=["plan_id", "packer", *ORDER_COUNTS, *KPIS])
    sizes = {order_id: len(order.items) for order_id, order in orders.items()}
    return OrderComparison(sizes, table.astype(dict.fromkeys((*ORDER_COUNTS, *KPIS), "float64")), tuple(notes))


def _articles_of(runs: Mapping[str, RunResults]) -> Articles | None:
    """The table of articles with which all runs were made; None if the runs had different tables or no table."""
    article_files = {how_read(run.info).articles for run in runs.values()}
    file = article_files.pop() if len(article_files) == 1 else None
    return read_articles(file) if file is not None and file.is_file() else None


def _plans_of(run: RunResults, orders: Mapping[str, Order]) -> Mapping[str, Plan]:
    """Id → plan, for those plans of a run that have an order. Plans that cannot be read again are left out."""
    records = Manifest.read(run.parts, run.info).plans
    plan_ids = [plan_id for plan_id in dict.fromkeys(run.worlds["plan_id"]) if plan_id in orders]
    return find_plans(run, records, plan_ids).plans
