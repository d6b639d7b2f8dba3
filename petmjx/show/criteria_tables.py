"""The tables of ``petmjx criteria``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pandas as pd
from rich.console import RenderableType

from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.analysis.criteria_vs_physics import ARRIVES
from petmjx.common.text import count_text, printable_name, three_digits
from petmjx.engines.metrics import DIMENSIONLESS
from petmjx.show.table_layout import FittedTable, TableColumn, line, number, percent

SHOWN_SKIPPED = 10
"""Largest number of skipped plans that are shown. ``criteria.json`` lists all skipped plans."""


def criteria_tables(results: CriteriaResults, out: str | None = None) -> Iterator[RenderableType]:
    """All tables and lines: the answers of the criteria and, if a run is given, their comparison with the run's
    verdicts.

    Args:
        results: the answers of the criteria.
        out: folder of the written files; None if no files were written.
    """
    skipped = results.info["skipped"]
    for message in skipped[:SHOWN_SKIPPED]:
        yield line(f"skipped: {message}", style="yellow")
    if len(skipped) > SHOWN_SKIPPED:
        yield line(f"skipped: {len(skipped) - SHOWN_SKIPPED:,} more", style="yellow")
    yield _says_table(results)
    if results.judged is not None:
        yield ""
        for doubt in results.info["doubts"]:
            yield line(f"note: {doubt}", style="yellow")
        yield _criteria_vs_physics_table(results.judged)
    if results.thresholds is not None and len(results.thresholds):
        yield ""
        yield _thresholds_table(results.thresholds)
    plans, boxes = count_text(results.info["n_plans"], "plan"), count_text(results.info["n_boxes"], "box", "boxes")
    yield line(f"{plans}, {boxes}, in {three_digits(results.info['wall_s'])} s")
    if out is not None:
        yield line(f"tables in {out}")


def _says_table(results: CriteriaResults) -> FittedTable:
    """A table of the number of plans and boxes that each criterion accepts, and the plan with the smallest slack (how
    far a rule is from being broken)."""
    table = FittedTable(
        TableColumn("criterion", "left"),
        TableColumn("plans\naccepted"),
        TableColumn("%"),
        TableColumn("boxes\naccepted", spare=2),
        TableColumn("median\nslack", spare=3),
        TableColumn("least\nslack"),
        TableColumn("", "left"),
        TableColumn("in plan", "left", least=12, middle=True, spare=1),
        title="answers of the criteria: a plan is accepted if all its boxes are stable at their placement",
    )
    for criterion in results.criteria:
        accepted = results.plans[criterion.name]
        slack = results.plans[f"{criterion.name}_slack"]
        worst = "" if slack.isna().all() else printable_name(str(results.plans["plan_id"][slack.idxmin()]))
        table.add(
            criterion.name,
            f"{int(accepted.sum()):,}",
            number(accepted.mean(), ".1f", "", 100.0),
            percent(results.boxes[criterion.name].mean()),
            number(slack.median()),
            number(slack.min()),
            "" if criterion.unit == DIMENSIONLESS else criterion.unit,
            worst,
        )
    return table


def _criteria_vs_physics_table(judged: pd.DataFrame) -> FittedTable:
    first = judged.iloc[0]
    plan_count = count_text(int(first["n_plans"]), "plan")
    stand, fall = (first[f"accepted_{outcome}"] + first[f"refused_{outcome}"] for outcome in ("stands", "falls"))
    alike = (
        "" if stand and fall else "; all stand, so there is no MCC" if stand else "; none stands, so there is no MCC"
    )
    of_chain = ARRIVES[0] in judged
    table = FittedTable(
        TableColumn("criterion", "left"),
        TableColumn("accepted\nstand", spare=1),
        TableColumn("accepted\nfall"),
        TableColumn("refused\nstand"),
        TableColumn("refused\nfall", spare=2),
        TableColumn("precision", "left", spare=5),
        TableColumn("recall", "left", spare=4),
        TableColumn("MCC", "left"),
        TableColumn("same\nfirst box", spare=3),
        *((TableColumn("P(arrives):\naccepted"), TableColumn("\nrefused")) if of_chain else ()),
        title=f"judged by physics on {plan_count}{alike}",
        caption="precision: share of the accepted that stand; recall: share of the standing that are accepted; "
        "95 % intervals",
    )
    for row in judged.to_dict("records"):
        table.add(
            row["criterion"],
            *(f"{row[cell]:,}" for cell in ("accepted_stands", "accepted_falls", "refused_stands", "refused_falls")),
            *(_with_interval(row, score) for score in ("precision", "recall", "mcc")),
            f"{row['same_first_box']:,}",
            *((number(row[name], ".2f") for name in ARRIVES) if of_chain else ()),
        )
    return table


def _thresholds_table(thresholds: pd.DataFrame) -> FittedTable:
    table = FittedTable(
        TableColumn("criterion", "left"),
        TableColumn("threshold"),
        TableColumn("published"),
        TableColumn("", "left"),
        TableColumn("MCC there", "left"),
        TableColumn("MCC as\npublished"),
        TableColumn("precision", "left", spare=2),
        TableColumn("recall", "left", spare=1),
        title=f"thresholds found on {int(thresholds['n_found_on'].max()):,} of the plans, judged on the other "
        f"{int(thresholds['n_plans'].max()):,}",
    )
    for row in thresholds.to_dict("records"):
        table.add(
            row["criterion"],
            number(row["threshold"]),
            number(row["published"]),
            "" if row["unit"] == DIMENSIONLESS else row["unit"],
            _with_interval(row, "mcc"),
            number(row["mcc_published"], ".2f"),
            *(_with_interval(row, score) for score in ("precision", "recall")),
        )
    return table


def _with_interval(row: dict[str, Any], score: str) -> str:
    """A score and its interval as text, such as "0.95 (0.91 … 0.99)"."""
    if pd.isna(row[score]):
        return "-"
    return f"{row[score]:.2f} ({row[f'{score}_low']:.2f} … {row[f'{score}_high']:.2f})"
