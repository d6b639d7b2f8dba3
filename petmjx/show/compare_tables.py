"""The tables of ``petmjx compare``."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import pandas as pd
from rich.console import RenderableType

from petmjx.analysis.run_comparison import BOX_KEY, FORCE_FLOOR_N, Comparison
from petmjx.common.text import count_text, three_digits
from petmjx.engines.verdict import Verdict
from petmjx.show.table_layout import FittedTable, TableColumn, line, number


def comparison_tables(comparison: Comparison, max_rows: int = 40) -> Iterator[RenderableType]:
    """All tables and lines about the comparison of two runs, a and b. At most ``max_rows`` worlds with different
    verdicts are listed, and at most ``max_rows`` worlds that only one run has."""
    yield line(f"a  {comparison.a}")
    yield line(f"b  {comparison.b}")
    for note in comparison.notes:
        yield line(f"note: {note}", style="yellow")
    for name, frame in (("a", comparison.only_a), ("b", comparison.only_b)):
        if len(frame):
            shown = ", ".join(f"{row.plan_id}/{row.variant}" for row in frame.head(max_rows).itertuples())
            more_text = ", …" if len(frame) > max_rows else ""
            yield line(f"{count_text(len(frame), 'world')} only in {name}: {shown}{more_text}")
    yield ""
    yield _confusion_table(comparison)
    if comparison.n_not_stable:
        of = f"of {count_text(comparison.n_not_stable, 'world')} that neither calls stable"
        yield line(f"{of}: same reason {comparison.same_reason:,}, same first box {comparison.same_culprit:,}")
    if len(comparison.flips):
        yield ""
        yield _flips_table(comparison.flips, max_rows)
        if comparison.flips_within is not None:
            yield line(
                f"each has a margin within ±{three_digits(comparison.flips_within)} of a threshold in one of the runs"
            )
    several = (("worlds", comparison.worlds), ("boxes", comparison.boxes))
    tables = [table for table_name, differences in several for table in _differences_tables(table_name, differences)]
    for table in tables:
        yield ""
        yield table
    if tables:
        yield line(f"%: |b - a| / max(a, {FORCE_FLOOR_N:g} N)", style="dim")


def _confusion_table(comparison: Comparison) -> FittedTable:
    share = number(comparison.agreement, ".2f", " %", 100.0)
    table = FittedTable(
        TableColumn("a ↓   b →", "left"),
        *(TableColumn(str(name)) for name in comparison.confusion.columns),
        title=f"verdicts: {comparison.n_agree:,} of {count_text(comparison.n_common, 'world')} agree ({share})",
    )
    for row, counts in comparison.confusion.iterrows():
        table.add(str(row), *(f"{count:,}" for count in counts))
    return table


def _flips_table(flips: pd.DataFrame, max_rows: int) -> FittedTable:
    """A table of worlds with different verdicts. Each world has two rows, first for run a and then for run b, since a
    single row would need more than 80 characters."""
    title = f"flipped verdicts ({len(flips):,}), with margins to the thresholds: + is over"
    if len(flips) > max_rows:
        title += f"; the first {max_rows}"
    margins = [("shift_margin_m", "shift\nmm", 1000.0), ("tilt_margin_deg", "tilt\n°", 1.0)]
    if (flips[["verdict_a", "verdict_b"]] == Verdict.INVALID.value).any(axis=None):
        margins += [("lin_acc_margin_m_s2", "m/s²", 1.0), ("ang_acc_margin_rad_s2", "rad/s²", 1.0)]
    table = FittedTable(
        TableColumn("plan", "left", least=20, middle=True),
        TableColumn("variant"),
        TableColumn("run", "left"),
        *(TableColumn(header, "left") for header in ("verdict", "reason")),
        TableColumn("box"),
        *(TableColumn(header) for _, header, _ in margins),
        title=title,
    )
    signed = partial(number, sign=True)
    for row in flips.head(max_rows).to_dict("records"):
        for side, world in (("a", (str(row["plan_id"]), str(row["variant"]))), ("b", ("", ""))):
            culprit = row[f"culprit_{side}"]
            table.add(
                *world,
                side,
                str(row[f"verdict_{side}"]),
                str(row[f"reason_{side}"]),
                "-" if pd.isna(culprit) else str(culprit),
                *(signed(row[f"{name}_{side}"], factor=factor) for name, _, factor in margins),
            )
    return table


def _differences_tables(table_name: str, differences: pd.DataFrame) -> Iterator[FittedTable]:
    """A table of the differences of metrics, for each group of metrics that is not empty."""
    key = [column for column in BOX_KEY if column in differences]
    for group, rows in differences[differences["n"] > 0].groupby("group", sort=False):
        table = FittedTable(
            TableColumn("metric", "left"),
            TableColumn("n"),
            TableColumn("mean\nb - a", spare=1),
            *(TableColumn(header) for header in ("median", "95 %", "largest")),
            TableColumn("at " + "/".join(column.removesuffix("_id") for column in key), "left", least=8, middle=True),
            *(TableColumn(header, spare=2) for header in "ab"),
            title=f"differences |b - a| of {table_name}, {group}",
        )
        for row in rows.to_dict("records"):
            name, factor = _name_and_factor(row)
            differs = row["largest"] > 0
            table.add(
                name,
                f"{row['n']:,}",
                number(row["mean"], factor=factor, sign=bool(row["mean"])),
                *(number(row[column], factor=factor) for column in ("median", "p95", "largest")),
                "/".join(str(row[column]) for column in key) if differs else "",
                *(number(row[side]) if differs else "" for side in "ab"),
            )
        yield table


def _name_and_factor(row: dict[str, Any]) -> tuple[str, float]:
    """The name of a metric with its unit, and the factor that converts differences to this unit. Relative differences
    are in per cent."""
    metric, unit = row["metric"], row["unit"]
    if metric.endswith(" relative"):
        return metric.removesuffix("relative") + "%", 100.0
    plain = unit == "1" or metric.endswith(f"_{unit.lower()}")
    return metric if plain else f"{metric} {unit.replace('^2', '²')}", 1.0
