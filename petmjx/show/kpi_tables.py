"""The tables of ``petmjx kpis``."""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path

import pandas as pd
from rich.console import RenderableType

from petmjx.analysis.kpis import Kpis
from petmjx.show.table_layout import (
    FEW_ROWS,
    FittedTable,
    TableColumn,
    line,
    name_column,
    note_lines,
    number,
    number_of,
    percent,
)


def kpi_tables(kpis: Kpis, out: Path | None = None) -> Iterator[RenderableType]:
    """A table of the plans if there are few; then notes, and a table of mean values and ratings.

    Args:
        out: folder of the written files; None if no files were written.
    """
    if len(kpis.plans) <= FEW_ROWS:
        yield _plans_table(kpis)
        yield ""
    yield from note_lines(kpis.notes)
    yield _summary_table(kpis)
    if out is not None:
        yield line(f"KPIs in {out}")


def _plans_table(kpis: Kpis) -> FittedTable:
    return FittedTable(
        kpis.plans.to_dict("records"),
        name_column("plan", "plan_id", least=12),
        TableColumn("boxes", lambda row: f"{row['n_boxes']:,} of {row['n_ordered']:,}"),
        TableColumn("kpi 1\nleft out", number_of("kpi_1", ".3f")),
        TableColumn("kpi 2\nuse", number_of("kpi_2", ".3f")),
        TableColumn("kpi 3\nm", number_of("kpi_3", ".3f")),
        TableColumn("kpi 4\nsupport", number_of("kpi_4", ".3f")),
        TableColumn("kpi 5\nlocked", number_of("kpi_5", ".3f")),
        TableColumn("kpi 6", number_of("kpi_6", ".0f")),
        TableColumn("verdict", lambda row: "-" if pd.isna(row["verdict"]) else row["verdict"], "left"),
        TableColumn("score\nratio", number_of("eval_score_pal_ratio", ".3f"), spare=1),
        TableColumn("score\nheight m", number_of("eval_score_height", ".3f"), spare=2),
        TableColumn("below\n2 m", number_of("n_pal_items", ".0f"), spare=3),
    )


def _summary_table(kpis: Kpis) -> FittedTable:
    summary, means = kpis.summary, kpis.summary["means"]
    return FittedTable(
        (
            ("plans", f"{summary['plans']:,}", f"of {summary['orders']:,} orders, {summary['ordered_boxes']:,} boxes"),
            ("kpi_1", number(means["kpi_1"], ".4f"), "mean share of ordered boxes left out"),
            ("kpi_2", number(means["kpi_2"], ".4f"), "mean use of the space below the highest top"),
            ("kpi_3", number(means["kpi_3"], ".3f"), "mean height, m"),
            ("kpi_4", number(means["kpi_4"], ".4f"), "mean support"),
            ("kpi_5", number(means["kpi_5"], ".4f"), "mean share of stacked boxes that tie the pile together"),
            ("kpi_6", percent(means["kpi_6"]), "stable by BED-BPP's rule"),
            ("stable", percent(means["stable"]), "stable by petmjx's verdict"),
            ("utilisation_2m", number(means["utilisation_2m"], ".4f"), "mean use of the space up to 2 m"),
            ("rating", number(summary["rating"], ".4f"), "leaderboard: by kpi_6"),
            ("", number(summary["rating_by_verdict"], ".4f"), "by petmjx's verdict"),
            ("", number(summary["rating_if_all_stood"], ".4f"), "if all plans stood"),
        ),
        TableColumn("over all plans", itemgetter(0), "left"),
        TableColumn("", itemgetter(1)),
        TableColumn("", itemgetter(2), "left", least=20),
    )
