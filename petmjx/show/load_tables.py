"""The table of ``petmjx loads``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from rich.console import RenderableType

from petmjx.analysis.box_loads import Loads
from petmjx.analysis.crushing import NOT, POSSIBLY, SURELY
from petmjx.common.text import box_label, count_text
from petmjx.show.table_layout import (
    FEW_ROWS,
    FittedTable,
    Row,
    TableColumn,
    count_of,
    line,
    name_column,
    note_lines,
    number_of,
    percent_of,
    text_of,
)


def load_tables(loads: Loads, out: Path | None = None) -> Iterator[RenderableType]:
    """A table of the worlds in which a box has the largest load relative to its strength, and lines with counts.

    Args:
        out: folder of the written files; None if no files were written.
    """
    yield _table(loads)
    yield ""
    yield from note_lines(loads.notes)
    over, unknown = loads.plans["overloaded"].sum(), loads.plans["overloaded"].isna().sum()
    boxes = count_text(int(loads.plans["n_overloaded"].sum()), "box", "boxes")
    world_count = count_text(len(loads.plans), "world" if (loads.plans["variant"] > 0).any() else "plan")
    yield line(f"{over:,} of {world_count} overloaded ({boxes}), {unknown:,} not known")
    if peak := int(loads.plans["overloaded_at_peak"].sum()):
        boxes = count_text(int(loads.plans["n_overloaded_at_peak"].sum()), "box", "boxes")
        yield line(f"{peak:,} of {world_count} overloaded at the peak ({boxes})")
    if "surely_overloaded" in loads.plans:
        surely, possibly = (int(loads.plans[name].sum()) for name in ("surely_overloaded", "possibly_overloaded"))
        yield line(
            f"{surely:,} surely overloaded (by the smallest force that statics allows), {possibly:,} possibly (by the "
            "largest force)"
        )
    counts = {name: int((loads.plans["crushed"] == name).sum()) for name in (SURELY, POSSIBLY, NOT)}
    unsure = len(loads.plans) - sum(counts.values())
    count_words = ", ".join(f"{count:,} {name}" for name, count in counts.items())
    yield line(f"crushed: {count_words}, {unsure:,} not known")
    if loads.ways is not None:
        yield ""
        yield _ways_table(loads.ways)
    if out is not None:
        yield line(f"loads in {out}")


def _ways_table(ways: pd.DataFrame) -> FittedTable:
    """A table with one row for each plan and remedy (a change of one leg of the chain, such as more film). The row has
    three shares: the share of worlds in which the pallet arrives at the end of a chain; the share in which it arrives
    and no box is surely overloaded; and the share in which it arrives and no box is even possibly overloaded."""
    remedies = ways["remedy"].nunique() > 1
    return FittedTable(
        ways.head(FEW_ROWS).to_dict("records"),
        name_column("plan", "plan_id", least=12),
        *([TableColumn("remedy", text_of("remedy"), "left", least=8)] if remedies else []),
        TableColumn("worlds", count_of("n_worlds")),
        TableColumn("arrive", percent_of("share")),
        TableColumn("possibly\nwhole", percent_of("share_possibly_whole")),
        TableColumn("surely\nwhole", percent_of("share_whole")),
        title="shares of worlds that arrive; whole: no box of the pallet is crushed",
        caption=f"{len(ways) - FEW_ROWS:,} more in way_loads" if len(ways) > FEW_ROWS else "",
    )


def _table(loads: Loads) -> FittedTable:
    with_variants = (loads.plans["variant"] > 0).any()
    ranked = loads.plans.sort_values(["max_load_share", "plan_id"], ascending=[False, True], na_position="last")
    forces = loads.boxes[["plan_id", "variant", "box", "rest_top_force_n", "strength_n"]]
    rows = ranked.head(FEW_ROWS).merge(forces, how="left", on=["plan_id", "variant", "box"])
    return FittedTable(
        rows.to_dict("records"),
        name_column("plan", "plan_id", least=12),
        *([TableColumn("variant", text_of("variant"))] if with_variants else []),
        TableColumn("verdict", text_of("verdict"), "left"),
        TableColumn("overloaded", _overload_text, "left"),
        TableColumn("boxes", count_of("n_boxes")),
        TableColumn("over", count_of("n_overloaded")),
        TableColumn("not\nknown", count_of("n_unknown"), spare=2),
        TableColumn("largest\nload", percent_of("max_load_share")),
        TableColumn("at\npeak", percent_of("max_peak_share"), spare=3),
        TableColumn(
            "of box",
            lambda row: "-" if pd.isna(row["box"]) else box_label(row["box"], row["article"]),
            "left",
            least=8,
            spare=1,
        ),
        TableColumn("rest\nforce N", number_of("rest_top_force_n", "z.0f"), spare=3),
        TableColumn("strength\nN", number_of("strength_n", ".0f"), spare=4),
        title=f"the {FEW_ROWS} with the largest loads" if len(ranked) > FEW_ROWS else "",
    )


def _overload_text(row: Row) -> str:
    """Whether a box of a world is overloaded and, if forces are given as intervals, whether the overload is certain."""
    if row.get("surely_overloaded") is True:
        return "surely"
    if row.get("possibly_overloaded") is True:
        return "possibly"
    return "-" if pd.isna(row["overloaded"]) else "yes" if row["overloaded"] else "no"
