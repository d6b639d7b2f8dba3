"""The tables of ``petmjx compare --packers``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pandas as pd
from rich.console import RenderableType
from rich.padding import Padding

from petmjx.analysis.packer_comparison import ALL_SIZES, LEAST_P, PackerComparison
from petmjx.analysis.packer_kpis import KPIS
from petmjx.analysis.packer_runs import ARRIVES, MISSING
from petmjx.common.text import count_text, printable_name
from petmjx.show.table_layout import (
    Cell,
    FittedTable,
    Row,
    TableColumn,
    count_of,
    line,
    name_column,
    note_lines,
    number,
    number_of,
    percent,
    percent_of,
    text_of,
)


def packer_tables(comparison: PackerComparison, max_rows: int = 40) -> Iterator[RenderableType]:
    """All tables and lines about a comparison of packers. For each pair of packers, the orders for which only one
    packer's plan stands are named, but at most ``max_rows`` of them."""
    for name, folder in comparison.runs.items():
        yield line(f"{printable_name(name)}  {folder}")
    yield from note_lines(comparison.notes)
    yield from _not_compared(comparison)
    if not comparison.packers["n"].any():
        return  # no plan is compared, and one of the notes says why
    yield ""
    yield _packers_table(comparison)
    if KPIS[0] in comparison.packers:
        yield ""
        yield _kpis_table(comparison)
    yield ""
    yield _pairs_table(comparison)
    if ARRIVES in comparison.packers:
        yield ""
        yield from _arrival_tables(comparison)
    yield ""
    # with padding, rich wraps lines between words; without it, the terminal would break words
    yield from (Padding(line(sentence), 0, expand=False) for sentence in comparison.sentences)
    sized = comparison.packers[(comparison.packers["size"] != ALL_SIZES) & (comparison.packers["n"] > 0)]
    if sized["size"].nunique() > 1:
        yield ""
        yield _sizes_table(comparison, sized)
    if len(comparison.reasons):
        yield ""
        yield _reasons_table(comparison.reasons)
        yield ""
        yield from _decided_lines(comparison.decided, max_rows)


def _all_sizes(table: pd.DataFrame) -> list[Row]:
    """The rows about orders of all sizes together."""
    rows: list[Row] = table[table["size"] == ALL_SIZES].to_dict("records")
    return rows


def _not_compared(comparison: PackerComparison) -> Iterator[RenderableType]:
    packers = _all_sizes(comparison.packers)
    left = int(packers[0]["n_orders"] - packers[0]["n"])
    if not left:
        return
    parts = [
        f"{printable_name(row['packer'])} {row[column]:,} {status}"
        for row in packers
        for column, status in (("n_invalid", "invalid"), ("n_missing", MISSING))
        if row[column]
    ]
    of = count_text(int(packers[0]["n_orders"]), "order")
    yield line(f"{left:,} of {of} {'is' if left == 1 else 'are'} not compared: {', '.join(parts)}", style="yellow")
    worst = ", ".join(f"{printable_name(row['packer'])} {percent(row['share_at_worst'])}" for row in packers)
    yield line(f"share that stands if missing and invalid plans count as unstable: {worst}")


_PACKER: Final = name_column("packer", "packer", least=8)
_PAIR: Final = (name_column("a", "a", least=8), name_column("b", "b", least=8))


def _packers_table(comparison: PackerComparison) -> FittedTable:
    packers = _all_sizes(comparison.packers)
    return FittedTable(
        packers,
        _PACKER,
        TableColumn("stand", count_of("n_stable")),
        TableColumn("share", percent_of("share")),
        _interval_column(comparison, ".1f"),
        TableColumn("boxes\nplaced", number_of("boxes", ".1f"), spare=2),
        *_left_out(comparison),
        TableColumn("volume\nm³", number_of("volume_m3", ".3f"), spare=1),
        TableColumn("height\nm", number_of("height_m", ".3f")),
        TableColumn("kpi_2", number_of("kpi_2", ".3f")),
        title=f"{count_text(int(packers[0]['n']), 'order')} compared; boxes, volume, height and kpi_2 are means",
    )


def _kpis_table(comparison: PackerComparison) -> FittedTable:
    columns = [TableColumn(name.replace("_2m", "\nbelow 2 m"), number_of(name, ".4f")) for name in KPIS]
    return FittedTable(_all_sizes(comparison.packers), _PACKER, *columns, title="KPIs of BED-BPP, means")


def _pairs_table(comparison: PackerComparison) -> FittedTable:
    pairs = _all_sizes(comparison.pairs)
    several = len(pairs) > 1
    return FittedTable(
        pairs,
        *_PAIR,
        TableColumn("both\nstand", count_of("both"), spare=2),
        TableColumn("only\na", count_of("only_a")),
        TableColumn("only\nb", count_of("only_b")),
        TableColumn("neither", count_of("neither"), spare=1),
        TableColumn("b - a\npoints", number_of("difference", "+.2f", factor=100.0)),
        _interval_column(comparison, "+.2f"),
        TableColumn("p\nHolm" if several else "p\nMcNemar", lambda row: _p(row["p_holm"])),
        title="differences, in percentage points" + (f"; p corrected for {len(pairs)} pairs" if several else ""),
    )


def _arrival_tables(comparison: PackerComparison) -> Iterator[RenderableType]:
    """Tables for runs of chains (a pallet's whole journey). One table has, for each packer, the share of worlds in
    which plans arrive. Another table has the difference of this share for each pair of packers."""
    header = _interval_header(comparison)
    yield FittedTable(
        _all_sizes(comparison.packers),
        _PACKER,
        TableColumn("P", percent_of(ARRIVES)),
        TableColumn(header, lambda row: f"{percent(row['p_low'])} to {percent(row['p_high'])}"),
        title="share of worlds that arrive, mean over orders",
    )
    yield FittedTable(
        _all_sizes(comparison.pairs),
        *_PAIR,
        TableColumn("b - a\npoints", number_of("p_gain", "+.1f", factor=100.0)),
        TableColumn(header, _points_to_points("p_gain_low", "p_gain_high", "+.1f")),
    )


def _sizes_table(comparison: PackerComparison, sized: pd.DataFrame) -> FittedTable:
    repeated = sized["size"] == sized["size"].shift()
    return FittedTable(
        sized.assign(size=sized["size"].mask(repeated, "")).to_dict("records"),
        TableColumn("boxes of\nthe order", text_of("size"), "left"),
        _PACKER,
        TableColumn("orders", count_of("n")),
        TableColumn("stand", count_of("n_stable")),
        TableColumn("share", percent_of("share")),
        _interval_column(comparison, ".1f"),
        *_left_out(comparison),
        TableColumn("kpi_2", number_of("kpi_2", ".3f")),
        title="by size of the order",
    )


def _reasons_table(reasons: pd.DataFrame) -> FittedTable:
    several = len(reasons[["a", "b"]].drop_duplicates()) > 1
    return FittedTable(
        reasons.assign(won_by=reasons["a"].where(reasons["lost_by"] == reasons["b"], reasons["b"])).to_dict("records"),
        name_column("lost by", "lost_by", least=8),
        name_column("won by", "won_by", least=8),
        TableColumn("reason", text_of("reason"), "left"),
        TableColumn("orders", count_of("n")),
        title="orders of which only one packer's plan stands" + (", for each pair" if several else ""),
    )


def _decided_lines(decided: pd.DataFrame, max_rows: int) -> Iterator[RenderableType]:
    for (winner, loser), rows in decided.groupby(["won_by", "lost_by"], sort=False):
        ids = ", ".join(map(printable_name, rows["plan_id"].head(max_rows)))
        more_text = f" and {len(rows) - max_rows:,} more (all with -o)" if len(rows) > max_rows else ""
        yield line(f"{printable_name(winner)} stands, {printable_name(loser)} does not: {ids}{more_text}")


def _left_out(comparison: PackerComparison) -> list[TableColumn]:
    """A list with one column: the number of boxes left out. The list is empty if no run was compared with orders."""
    if comparison.packers["left_out"].isna().all():
        return []
    return [TableColumn("left\nout", number_of("left_out", ".2f"), spare=3)]


def _interval_header(comparison: PackerComparison) -> str:
    return f"{100 * comparison.confidence:g} %\ninterval"


def _interval_column(comparison: PackerComparison, form: str) -> TableColumn:
    return TableColumn(_interval_header(comparison), _points_to_points("low", "high", form))


def _points_to_points(low: str, high: str, form: str) -> Cell:
    """A cell with an interval, such as "57.1 to 79.4", in per cent or percentage points."""
    return lambda row: f"{number(row[low], form, factor=100.0)} to {number(row[high], form, factor=100.0)}"


def _p(value: float) -> str:
    return f"<{LEAST_P:.4f}" if value < LEAST_P else number(value, ".4f")
