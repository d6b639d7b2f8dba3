"""The table of ``petmjx loads``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
from rich.console import RenderableType

from petmjx.analysis.box_strength import Loads
from petmjx.analysis.crushing import NOT, POSSIBLY, SURELY
from petmjx.common.text import box_label, count_text
from petmjx.show.sweep_tables import FEW_ROWS
from petmjx.show.table_layout import FittedTable, TableColumn, line, number, percent


def load_tables(loads: Loads, out: str | None = None) -> Iterator[RenderableType]:
    """A table of the worlds in which a box has the largest load relative to its strength, and lines with counts.

    Args:
        loads: the loads of a run's boxes.
        out: folder of the written files; None if no files were written.
    """
    yield _table(loads)
    yield ""
    for note in loads.notes:
        yield line(f"note: {note}", style="yellow")
    over, unknown = loads.plans["overloaded"].sum(), loads.plans["overloaded"].isna().sum()
    boxes = count_text(int(loads.plans["n_overloaded"].sum()), "box", "boxes")
    world_count = count_text(len(loads.plans), "world" if (loads.plans["variant"] > 0).any() else "plan")
    yield line(f"{over:,} of {world_count} overloaded ({boxes}), {unknown:,} not known")
    if peak := int(loads.plans["overloaded_at_peak"].sum()):
        boxes = count_text(int(loads.plans["n_overloaded_at_peak"].sum()), "box", "boxes")
        yield line(f"{peak:,} of {world_count} overloaded at the peak ({boxes})")
    if "surely_overloaded" in loads.plans:
        surely, possibly = (int(loads.plans[name].sum()) for name in ("surely_overloaded", "possibly_overloaded"))
        yield line(f"{surely:,} surely, {possibly:,} possibly: by the least and the most force that statics allows")
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
    """A table of the shares of worlds in which pallets arrive at the end of a chain, and arrive without overloaded
    boxes."""
    remedies = ways["remedy"].nunique() > 1
    table = FittedTable(
        TableColumn("plan", "left", least=12, middle=True),
        *([TableColumn("remedy", "left", least=8)] if remedies else []),
        TableColumn("worlds"),
        TableColumn("arrive"),
        TableColumn("possibly\nwhole"),
        TableColumn("surely\nwhole"),
        title="worlds that arrive, and in which no box is surely, or even possibly, overloaded",
        caption=f"{len(ways) - FEW_ROWS:,} more in way_loads" if len(ways) > FEW_ROWS else "",
    )
    for row in ways.head(FEW_ROWS).to_dict("records"):
        shares = (percent(row[name]) for name in ("share", "share_possibly_whole", "share_whole"))
        table.add(row["plan_id"], *([row["remedy"]] if remedies else []), f"{row['n_worlds']:,}", *shares)
    return table


def _table(loads: Loads) -> FittedTable:
    with_variants = (loads.plans["variant"] > 0).any()
    ranked = loads.plans.sort_values(["max_load_share", "plan_id"], ascending=[False, True], na_position="last")
    title = f"the {FEW_ROWS} with the largest loads" if len(ranked) > FEW_ROWS else ""
    table = FittedTable(
        TableColumn("plan", "left", least=12, middle=True),
        *([TableColumn("variant")] if with_variants else []),
        TableColumn("verdict", "left"),
        TableColumn("overloaded", "left"),
        TableColumn("boxes"),
        TableColumn("over"),
        TableColumn("not\nknown", spare=2),
        TableColumn("largest\nload"),
        TableColumn("at\npeak", spare=3),
        TableColumn("of box", "left", least=8, spare=1),
        TableColumn("rest\nforce N", spare=3),
        TableColumn("strength\nN", spare=4),
        title=title,
    )
    forces = loads.boxes.set_index(["plan_id", "variant", "box"])[["rest_top_force_n", "strength_n"]]
    for row in ranked.head(FEW_ROWS).to_dict("records"):
        has_box = not pd.isna(row["box"])
        force = forces.loc[(row["plan_id"], row["variant"], row["box"])] if has_box else None
        table.add(
            row["plan_id"],
            *([str(row["variant"])] if with_variants else []),
            row["verdict"],
            _overload_text(row),
            f"{row['n_boxes']:,}",
            f"{row['n_overloaded']:,}",
            f"{row['n_unknown']:,}",
            percent(row["max_load_share"]),
            percent(row["max_peak_share"]),
            box_label(row["box"], row["article"]) if has_box else "-",
            "-" if force is None else number(force["rest_top_force_n"], "z.0f"),
            "-" if force is None else number(force["strength_n"], ".0f"),
        )
    return table


def _overload_text(row: Mapping[str, Any]) -> str:
    """Text that states whether a box of a world is overloaded and, if forces are given as intervals, whether the
    overload is certain."""
    overloaded: Any = row["overloaded"]
    answer = "-" if pd.isna(overloaded) else "yes" if overloaded else "no"
    if row.get("surely_overloaded") is True:
        return "surely"
    return "possibly" if row.get("possibly_overloaded") is True else answer
