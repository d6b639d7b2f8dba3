"""BED-BPP's KPIs of the plans that packers are compared by (:func:`petmjx.rating.kpis.kpis_of`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pandas as pd

from petmjx.basics.text import counted, printable, shown
from petmjx.plans.samples.order_files import read_orders
from petmjx.plans.samples.orders import Order
from petmjx.rating.kpis import kpis_of
from petmjx.results.manifest import Manifest
from petmjx.results.plans_again import find_plans
from petmjx.results.reader import RunResults

KPIS: Final = ("kpi_1", "kpi_2", "kpi_4", "kpi_5", "utilisation_2m")
"""Columns of which means are shown. kpi_3 is the height, which is there without orders; kpi_6 is for a static check."""


def kpis_of_runs(runs: Mapping[str, RunResults], file: Path) -> tuple[pd.DataFrame, list[str]]:
    """The KPIs of the plans of runs, which are read again from their files.

    Args:
        runs: name of each packer → its run.
        file: BED-BPP orders. An order belongs to the plans with its id.

    Returns:
        A row a plan: ``plan_id``, ``packer`` and ``KPIS`` (float64; null where a KPI has no value). Then a line on each
        run of which plans have none, and on unusable orders.

    Raises:
        InputError: the file cannot be read.
    """
    unusable: list[str] = []
    orders = dict(read_orders(file, lambda error: unusable.append(str(error))))
    rows: list[dict[str, object]] = []
    notes = []
    if unusable:
        notes.append(f"{counted(len(unusable), 'order')} of {printable(str(file))} unusable; the first: {unusable[0]}")
    for name, run in runs.items():
        wanted = set(run.worlds["plan_id"])
        found = _rows(run, wanted, orders)
        rows += [{"packer": name, **row} for row in found]
        if len(found) < len(wanted):
            missing = counted(len(wanted) - len(found), "plan")
            notes.append(f"no KPIs of {missing} of {shown(name)}: not found again, or without an order")
    table = pd.DataFrame(rows, columns=["plan_id", "packer", *KPIS])
    return table.astype(dict.fromkeys(KPIS, "float64")), notes


def _rows(run: RunResults, wanted: set[str], orders: Mapping[str, Order]) -> list[dict[str, object]]:
    records = Manifest.read(run.parts, run.info).plans
    plans = find_plans(run, records, wanted & orders.keys()).plans
    each = (kpis_of(plan, orders[plan_id]) for plan_id, plan in plans.items())
    return [{name: row[name] for name in ("plan_id", *KPIS)} for row in each]
