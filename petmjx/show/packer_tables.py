"""The tables of ``petmjx compare --packers``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pandas as pd
from rich.console import RenderableType
from rich.padding import Padding

from petmjx.analysis.packer_comparison import ALL_SIZES, LEAST_P, PackerComparison
from petmjx.analysis.packer_kpis import KPIS
from petmjx.analysis.packer_runs import ARRIVES, MISSING
from petmjx.common.text import count_text, printable_name
from petmjx.show.table_layout import FittedTable, TableColumn, line, number, percent


def packer_tables(comparison: PackerComparison, max_rows: int = 40) -> Iterator[RenderableType]:
    """All tables and lines about a comparison of packers. For each pair of packers, at most ``max_rows`` orders are
    named in which the plan of only one packer stands."""
    for name, folder in comparison.runs.items():
        yield line(f"{printable_name(name)}  {folder}")
    for note in comparison.notes:
        yield line(f"note: {note}", style="yellow")
    yield from _not_compared(comparison)
    if not comparison.packers["n"].any():
        return  # one of the notes gives the reason
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


def _not_compared(comparison: PackerComparison) -> Iterator[RenderableType]:
    all_sizes = comparison.packers[comparison.packers["size"] == ALL_SIZES]
    first = all_sizes.iloc[0]
    left = int(first["n_orders"] - first["n"])
    if not left:
        return
    parts = [
        f"{printable_name(row['packer'])} {row[column]:,} {status}"
        for row in all_sizes.to_dict("records")
        for column, status in (("n_invalid", "invalid"), ("n_missing", MISSING))
        if row[column]
    ]
    of = count_text(int(first["n_orders"]), "order")
    yield line(f"{left:,} of {of} {'is' if left == 1 else 'are'} not compared: {', '.join(parts)}", style="yellow")
    worst = ", ".join(
        f"{printable_name(row['packer'])} {percent(row['share_at_worst'])}" for row in all_sizes.to_dict("records")
    )
    yield line(f"share that stands if these plans count as unstable: {worst}")


def _packers_table(comparison: PackerComparison) -> FittedTable:
    all_sizes = comparison.packers[comparison.packers["size"] == ALL_SIZES]
    left_out = _left_out(comparison)
    table = FittedTable(
        TableColumn("packer", "left", least=8, middle=True),
        TableColumn("stand"),
        TableColumn("share"),
        TableColumn(_interval_header(comparison)),
        TableColumn("boxes\nplaced", spare=2),
        *left_out,
        TableColumn("volume\nm³", spare=1),
        TableColumn("height\nm"),
        TableColumn("kpi_2"),
        title=f"{count_text(int(all_sizes['n'].iloc[0]), 'order')} compared; boxes, volume, height and kpi_2 are means",
    )
    for row in all_sizes.to_dict("records"):
        table.add(
            row["packer"],
            f"{row['n_stable']:,}",
            percent(row["share"]),
            _interval(row, ".1f"),
            number(row["boxes"], ".1f"),
            *(number(row["left_out"], ".2f") for _ in left_out),
            *(number(row[name], ".3f") for name in ("volume_m3", "height_m", "kpi_2")),
        )
    return table


def _kpis_table(comparison: PackerComparison) -> FittedTable:
    all_sizes = comparison.packers[comparison.packers["size"] == ALL_SIZES]
    columns = [TableColumn(name.replace("_2m", "\nbelow 2 m")) for name in KPIS]
    table = FittedTable(TableColumn("packer", "left", least=8, middle=True), *columns, title="KPIs of BED-BPP, means")
    for row in all_sizes.to_dict("records"):
        table.add(row["packer"], *(number(row[name], ".4f") for name in KPIS))
    return table


def _pairs_table(comparison: PackerComparison) -> FittedTable:
    all_sizes = comparison.pairs[comparison.pairs["size"] == ALL_SIZES]
    several = len(all_sizes) > 1
    test = "p\nHolm" if several else "p\nMcNemar"
    table = FittedTable(
        TableColumn("a", "left", least=8, middle=True),
        TableColumn("b", "left", least=8, middle=True),
        TableColumn("both\nstand", spare=2),
        TableColumn("only\na"),
        TableColumn("only\nb"),
        TableColumn("neither", spare=1),
        TableColumn("b - a\npoints"),
        TableColumn(_interval_header(comparison)),
        TableColumn(test),
        title="differences, in percentage points" + (f"; p corrected for {len(all_sizes)} pairs" if several else ""),
    )
    for row in all_sizes.to_dict("records"):
        counts = [f"{row[name]:,}" for name in ("both", "only_a", "only_b", "neither")]
        difference = number(row["difference"], "+.2f", factor=100.0)
        table.add(row["a"], row["b"], *counts, difference, _interval(row, "+.2f"), _p(row["p_holm"]))
    return table


def _arrival_tables(comparison: PackerComparison) -> Iterator[RenderableType]:
    """Tables for runs of chains (a pallet's whole journey): for each packer the share of worlds in which plans arrive,
    and for each pair of packers the difference of this share."""
    table = FittedTable(
        TableColumn("packer", "left", least=8, middle=True),
        TableColumn("P"),
        TableColumn(_interval_header(comparison)),
        title="share of worlds that arrive, mean over orders",
    )
    for row in comparison.packers[comparison.packers["size"] == ALL_SIZES].to_dict("records"):
        table.add(row["packer"], percent(row[ARRIVES]), f"{percent(row['p_low'])} to {percent(row['p_high'])}")
    yield table
    pairs = FittedTable(
        TableColumn("a", "left", least=8, middle=True),
        TableColumn("b", "left", least=8, middle=True),
        TableColumn("b - a\npoints"),
        TableColumn(_interval_header(comparison)),
    )
    for row in comparison.pairs[comparison.pairs["size"] == ALL_SIZES].to_dict("records"):
        points = [number(row[name], "+.1f", factor=100.0) for name in ("p_gain", "p_gain_low", "p_gain_high")]
        pairs.add(row["a"], row["b"], points[0], f"{points[1]} to {points[2]}")
    yield pairs


def _sizes_table(comparison: PackerComparison, sized: pd.DataFrame) -> FittedTable:
    left_out = _left_out(comparison)
    table = FittedTable(
        TableColumn("boxes of\nthe order", "left"),
        TableColumn("packer", "left", least=8, middle=True),
        TableColumn("orders"),
        TableColumn("stand"),
        TableColumn("share"),
        TableColumn(_interval_header(comparison)),
        *left_out,
        TableColumn("kpi_2"),
        title="by size of the order",
    )
    last = None
    for row in sized.to_dict("records"):
        size, last = ("" if row["size"] == last else row["size"]), row["size"]
        shares = (percent(row["share"]), _interval(row, ".1f"))
        means = (*(number(row["left_out"], ".2f") for _ in left_out), number(row["kpi_2"], ".3f"))
        table.add(size, row["packer"], f"{row['n']:,}", f"{row['n_stable']:,}", *shares, *means)
    return table


def _reasons_table(reasons: pd.DataFrame) -> FittedTable:
    several = len(reasons[["a", "b"]].drop_duplicates()) > 1
    table = FittedTable(
        TableColumn("lost by", "left", least=8, middle=True),
        TableColumn("won by", "left", least=8, middle=True),
        TableColumn("reason", "left"),
        TableColumn("orders"),
        title="orders that stand with only one packer" + (", for each two" if several else ""),
    )
    for row in reasons.to_dict("records"):
        winner = row["a"] if row["lost_by"] == row["b"] else row["b"]
        table.add(row["lost_by"], winner, row["reason"], f"{row['n']:,}")
    return table


def _decided_lines(decided: pd.DataFrame, max_rows: int) -> Iterator[RenderableType]:
    for (winner, loser), rows in decided.groupby(["won_by", "lost_by"], sort=False):
        ids = ", ".join(map(printable_name, rows["plan_id"].head(max_rows)))
        more_text = f" and {len(rows) - max_rows:,} more (all with -o)" if len(rows) > max_rows else ""
        yield line(f"{printable_name(winner)} stands, {printable_name(loser)} does not: {ids}{more_text}")


def _left_out(comparison: PackerComparison) -> list[TableColumn]:
    """A list with the column of the number of boxes left out. The list is empty if no run was compared with orders."""
    return [TableColumn("left\nout", spare=3)] if comparison.packers["left_out"].notna().any() else []


def _interval_header(comparison: PackerComparison) -> str:
    return f"{100 * comparison.confidence:g} %\ninterval"


def _interval(row: dict[str, Any], form: str) -> str:
    """The interval of a row as text, such as "57.1 to 79.4", in per cent or percentage points."""
    return f"{number(row['low'], form, factor=100.0)} to {number(row['high'], form, factor=100.0)}"


def _p(value: float) -> str:
    return f"<{LEAST_P:.4f}" if value < LEAST_P else number(value, ".4f")
