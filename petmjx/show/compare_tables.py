"""The tables of ``petmjx compare``."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd
from rich.console import RenderableType

from petmjx.analysis.run_comparison import BOX_KEY, FORCE_FLOOR_N, Comparison
from petmjx.common.text import count_text, three_digits
from petmjx.engines.verdict import Verdict
from petmjx.show.table_layout import Cell, FittedTable, Row, TableColumn, count_of, line, note_lines, number, text_of


def comparison_tables(comparison: Comparison, max_rows: int = 40) -> Iterator[RenderableType]:
    """All tables and lines about the comparison of two runs, a and b. At most ``max_rows`` worlds with different
    verdicts are listed, and at most ``max_rows`` worlds that only one run has."""
    yield line(f"a  {comparison.a}")
    yield line(f"b  {comparison.b}")
    yield from note_lines(comparison.notes)
    for name, frame in (("a", comparison.only_a), ("b", comparison.only_b)):
        if len(frame):
            shown = ", ".join(f"{row.plan_id}/{row.variant}" for row in frame.head(max_rows).itertuples())
            more_text = ", …" if len(frame) > max_rows else ""
            yield line(f"{count_text(len(frame), 'world')} only in {name}: {shown}{more_text}")
    yield ""
    yield _confusion_table(comparison)
    if comparison.n_not_stable:
        of = f"of {count_text(comparison.n_not_stable, 'world')} that are stable in neither run"
        yield line(
            f"{of}: {comparison.same_reason:,} with the same reason, {comparison.same_culprit:,} with the same first "
            "box to fail"
        )
    if len(comparison.flips):
        yield ""
        yield _flips_table(comparison.flips, max_rows)
        if comparison.flips_within is not None:
            yield line(
                f"each of these worlds has a margin from -{three_digits(comparison.flips_within)} to "
                f"{three_digits(comparison.flips_within)} in one of the runs"
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
    return FittedTable(
        comparison.confusion.reset_index(names="a").to_dict("records"),
        TableColumn("a ↓   b →", text_of("a"), "left"),
        *(TableColumn(str(name), count_of(name)) for name in comparison.confusion.columns),
        title=f"verdicts: {comparison.n_agree:,} of {count_text(comparison.n_common, 'world')} agree ({share})",
    )


def _flips_table(flips: pd.DataFrame, max_rows: int) -> FittedTable:
    """A table of worlds with different verdicts. Each world has two rows, first for run a and then for run b, since a
    single row would need more than 80 characters."""
    title = f"flipped verdicts ({len(flips):,}), and how far each run is over (+) or under (-) the thresholds"
    if len(flips) > max_rows:
        title += f"; the first {max_rows}"
    margins = [("shift_margin_m", "shift\nmm", 1000.0), ("tilt_margin_deg", "tilt\n°", 1.0)]
    if (flips[["verdict_a", "verdict_b"]] == Verdict.INVALID.value).any(axis=None):
        margins += [("lin_acc_margin_m_s2", "m/s²", 1.0), ("ang_acc_margin_rad_s2", "rad/s²", 1.0)]

    def of_run(name: str) -> Cell:
        return lambda row: "-" if pd.isna(row[f"{name}_{row['run']}"]) else str(row[f"{name}_{row['run']}"])

    def of_world(name: str) -> Cell:
        return lambda row: str(row[name]) if row["run"] == "a" else ""

    def margin(name: str, factor: float) -> Cell:
        return lambda row: number(row[f"{name}_{row['run']}"], factor=factor, sign=True)

    return FittedTable(
        ({**row, "run": run} for row in flips.head(max_rows).to_dict("records") for run in "ab"),
        TableColumn("plan", of_world("plan_id"), "left", least=20, middle=True),
        TableColumn("variant", of_world("variant")),
        TableColumn("run", text_of("run"), "left"),
        TableColumn("verdict", of_run("verdict"), "left"),
        TableColumn("reason", of_run("reason"), "left"),
        TableColumn("box", of_run("culprit")),
        *(TableColumn(header, margin(name, factor)) for name, header, factor in margins),
        title=title,
    )


def _differences_tables(table_name: str, differences: pd.DataFrame) -> Iterator[FittedTable]:
    """A table of the differences of metrics, for each group of metrics that is not empty."""
    key = [column for column in BOX_KEY if column in differences]

    def scaled(name: str) -> Cell:
        return lambda row: number(row[name], factor=_name_and_factor(row)[1])

    def largest_at(row: Row) -> str:
        return "/".join(str(row[column]) for column in key) if row["largest"] > 0 else ""

    def value(side: str) -> Cell:
        return lambda row: number(row[side]) if row["largest"] > 0 else ""

    for group, rows in differences[differences["n"] > 0].groupby("group", sort=False):
        yield FittedTable(
            rows.to_dict("records"),
            TableColumn("metric", lambda row: _name_and_factor(row)[0], "left"),
            TableColumn("n", count_of("n")),
            TableColumn(
                "mean\nb - a",
                lambda row: number(row["mean"], factor=_name_and_factor(row)[1], sign=bool(row["mean"])),
                spare=1,
            ),
            TableColumn("median", scaled("median")),
            TableColumn("95 %", scaled("p95")),
            TableColumn("largest", scaled("largest")),
            TableColumn(
                "at " + "/".join(column.removesuffix("_id") for column in key), largest_at, "left", least=8, middle=True
            ),
            TableColumn("a", value("a"), spare=2),
            TableColumn("b", value("b"), spare=2),
            title=f"differences |b - a| of {table_name}, {group}",
        )


def _name_and_factor(row: Row) -> tuple[str, float]:
    """The name of a metric with its unit, and the factor that converts differences to this unit. Relative differences
    are in per cent."""
    metric, unit = row["metric"], row["unit"]
    if metric.endswith(" relative"):
        return metric.removesuffix("relative") + "%", 100.0
    plain = unit == "1" or metric.endswith(f"_{unit.lower()}")
    return metric if plain else f"{metric} {unit.replace('^2', '²')}", 1.0
