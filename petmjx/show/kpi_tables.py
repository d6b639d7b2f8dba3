"""The tables of ``petmjx kpis``."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd
from rich.console import RenderableType
from rich.text import Text

from petmjx.analysis.kpis import Kpis
from petmjx.show.sweep_tables import FEW_ROWS
from petmjx.show.table_layout import FittedTable, TableColumn, line, number, percent


def kpi_tables(kpis: Kpis, out: str | None = None) -> Iterator[RenderableType]:
    """A table of the plans if there are few; then notes, and a table of mean values and ratings.

    Args:
        kpis: the KPIs of plans.
        out: folder of the written files; None if no files were written.
    """
    if len(kpis.plans) <= FEW_ROWS:
        yield _plans_table(kpis)
        yield ""
    for note in kpis.notes:
        yield line(f"note: {note}", style="yellow")
    yield _summary_table(kpis)
    if out is not None:
        yield line(f"KPIs in {out}")


def _plans_table(kpis: Kpis) -> FittedTable:
    table = FittedTable(
        TableColumn("plan", "left", least=12, middle=True),
        TableColumn("boxes"),
        TableColumn("kpi 1\nleft out"),
        TableColumn("kpi 2\nuse"),
        TableColumn("kpi 3\nm"),
        TableColumn("kpi 4\nsupport"),
        TableColumn("kpi 5\nlocked"),
        TableColumn("kpi 6"),
        TableColumn("verdict", "left"),
        TableColumn("score\nratio", spare=1),
        TableColumn("score\nheight m", spare=2),
        TableColumn("below\n2 m", spare=3),
    )
    for row in kpis.plans.to_dict("records"):
        table.add(
            row["plan_id"],
            f"{row['n_boxes']:,} of {row['n_ordered']:,}",
            *(number(row[name], ".3f") for name in ("kpi_1", "kpi_2", "kpi_3", "kpi_4", "kpi_5")),
            number(row["kpi_6"], ".0f"),
            Text("-" if pd.isna(row["verdict"]) else row["verdict"]),
            number(row["eval_score_pal_ratio"], ".3f"),
            number(row["eval_score_height"], ".3f"),
            number(row["n_pal_items"], ".0f"),
        )
    return table


def _summary_table(kpis: Kpis) -> FittedTable:
    summary, means = kpis.summary, kpis.summary["means"]
    table = FittedTable(TableColumn("over all plans", "left"), TableColumn(""), TableColumn("", "left", least=20))
    table.add("plans", f"{summary['plans']:,}", f"of {summary['orders']:,} orders, {summary['ordered_boxes']:,} boxes")
    for name, form, meaning in (
        ("kpi_1", ".4f", "mean share left out"),
        ("kpi_2", ".4f", "mean use of the space up to the top"),
        ("kpi_3", ".3f", "mean height, m"),
        ("kpi_4", ".4f", "mean support"),
        ("kpi_5", ".4f", "mean share of upper boxes that lock"),
    ):
        table.add(name, number(means[name], form), meaning)
    table.add("kpi_6", percent(means["kpi_6"]), "stable by BED-BPP's rule")
    table.add("stable", percent(means["stable"]), "stable by petmjx's verdict")
    table.add("utilisation_2m", number(means["utilisation_2m"], ".4f"), "mean use of the space up to 2 m")
    table.add("rating", number(summary["rating"], ".4f"), "leaderboard: by kpi_6")
    table.add("", number(summary["rating_by_verdict"], ".4f"), "by petmjx's verdict")
    table.add("", number(summary["rating_if_all_stood"], ".4f"), "if all plans stood")
    return table
