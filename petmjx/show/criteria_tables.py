"""The tables of ``petmjx criteria``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from rich.console import RenderableType

from petmjx.analysis.criteria import Criterion
from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.analysis.criteria_vs_physics import ARRIVES
from petmjx.common.text import count_text, printable_name, three_digits
from petmjx.engines.metrics import DIMENSIONLESS
from petmjx.show.table_layout import (
    Cell,
    FittedTable,
    Row,
    TableColumn,
    count_of,
    line,
    note_lines,
    number,
    number_of,
    percent,
    skipped_lines,
    text_of,
)


def criteria_tables(results: CriteriaResults, out: Path | None = None) -> Iterator[RenderableType]:
    """All tables and lines: the answers of the criteria and, if a run is given, their comparison with the run's
    verdicts.

    Args:
        out: folder of the written files; None if no files were written.
    """
    skipped = results.info["skipped"]
    yield from skipped_lines(skipped, len(skipped))
    yield _says_table(results)
    if results.judged is not None:
        yield ""
        yield from note_lines(results.info["doubts"])
        yield _criteria_vs_physics_table(results.judged)
    if results.thresholds is not None and len(results.thresholds):
        yield ""
        yield _thresholds_table(results.thresholds)
    plans, boxes = count_text(results.info["n_plans"], "plan"), count_text(results.info["n_boxes"], "box", "boxes")
    yield line(f"{plans}, {boxes}, in {three_digits(results.info['wall_s'])} s")
    if out is not None:
        yield line(f"tables in {out}")


def _says_table(results: CriteriaResults) -> FittedTable:
    """A table with one row for each criterion: how many plans and boxes the criterion accepts; the median and the
    smallest slack of all plans; and the plan with the smallest slack. A slack is a number whose sign shows whether the
    criterion's rule holds."""
    plans, boxes = results.plans, results.boxes

    def slack(criterion: Criterion) -> pd.Series[float]:
        return plans[f"{criterion.name}_slack"]

    def worst(criterion: Criterion) -> str:
        values = slack(criterion)
        return "" if values.isna().all() else printable_name(str(plans["plan_id"][values.idxmin()]))

    return FittedTable(
        results.criteria,
        TableColumn("criterion", lambda criterion: criterion.name, "left"),
        TableColumn("plans\naccepted", lambda criterion: f"{int(plans[criterion.name].sum()):,}"),
        TableColumn("%", lambda criterion: number(plans[criterion.name].mean(), ".1f", factor=100.0)),
        TableColumn("boxes\naccepted", lambda criterion: percent(boxes[criterion.name].mean()), spare=2),
        TableColumn("median\nslack", lambda criterion: number(slack(criterion).median()), spare=3),
        TableColumn("least\nslack", lambda criterion: number(slack(criterion).min())),
        TableColumn("", lambda criterion: _unit(criterion.unit), "left"),
        TableColumn("in plan", worst, "left", least=12, middle=True, spare=1),
        title="answers of the criteria: a plan is accepted if all its boxes are stable at their placement",
    )


def _unit(unit: str) -> str:
    return "" if unit == DIMENSIONLESS else unit


def _criteria_vs_physics_table(judged: pd.DataFrame) -> FittedTable:
    first = judged.iloc[0]
    plan_count = count_text(int(first["n_plans"]), "plan")
    stand, fall = (first[f"accepted_{outcome}"] + first[f"refused_{outcome}"] for outcome in ("stands", "falls"))
    alike = (
        "" if stand and fall else "; all stand, so there is no MCC" if stand else "; none stands, so there is no MCC"
    )
    accepted, refused = ARRIVES
    chances = (
        TableColumn("P(arrives):\naccepted", number_of(accepted, ".2f")),
        TableColumn("\nrefused", number_of(refused, ".2f")),
    )
    return FittedTable(
        judged.to_dict("records"),
        TableColumn("criterion", text_of("criterion"), "left"),
        TableColumn("accepted\nstand", count_of("accepted_stands"), spare=1),
        TableColumn("accepted\nfall", count_of("accepted_falls")),
        TableColumn("refused\nstand", count_of("refused_stands")),
        TableColumn("refused\nfall", count_of("refused_falls"), spare=2),
        TableColumn("precision", _with_interval("precision"), "left", spare=5),
        TableColumn("recall", _with_interval("recall"), "left", spare=4),
        TableColumn("MCC", _with_interval("mcc"), "left"),
        TableColumn("same\nfirst box", count_of("same_first_box"), spare=3),
        *(chances if accepted in judged else ()),
        title=f"judged by physics on {plan_count}{alike}",
        caption="precision: share of the accepted plans that stand; recall: share of the standing plans that are "
        "accepted; 95 % intervals",
    )


def _thresholds_table(thresholds: pd.DataFrame) -> FittedTable:
    return FittedTable(
        thresholds.to_dict("records"),
        TableColumn("criterion", text_of("criterion"), "left"),
        TableColumn("threshold", number_of("threshold")),
        TableColumn("published", number_of("published")),
        TableColumn("", lambda row: _unit(row["unit"]), "left"),
        TableColumn("MCC at\nthreshold", _with_interval("mcc"), "left"),
        TableColumn("MCC at\npublished", number_of("mcc_published", ".2f")),
        TableColumn("precision", _with_interval("precision"), "left", spare=2),
        TableColumn("recall", _with_interval("recall"), "left", spare=1),
        title=f"thresholds found on {int(thresholds['n_found_on'].max()):,} of the plans, judged on the other "
        f"{int(thresholds['n_plans'].max()):,}",
    )


def _with_interval(score: str) -> Cell:
    """A cell with a score and its interval, such as "0.95 (0.91 … 0.99)"."""

    def cell(row: Row) -> str:
        if pd.isna(row[score]):
            return "-"
        return f"{row[score]:.2f} ({row[f'{score}_low']:.2f} … {row[f'{score}_high']:.2f})"

    return cell
