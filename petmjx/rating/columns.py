"""The columns of the table of KPIs: name, type, unit, meaning."""

from __future__ import annotations

from typing import Final, NamedTuple


class KpiColumn(NamedTuple):
    """One column. ``pandas`` is the type in a data frame, which has nulls where ``missing`` says so."""

    name: str
    pandas: str
    unit: str
    meaning: str
    mean: bool = True


def _text(name: str, meaning: str) -> KpiColumn:
    return KpiColumn(name, "object", "", meaning, mean=False)


COLUMNS: Final = (
    _text("plan_id", "id of the packing plan and of its order"),
    _text("target", "the order's target: euro-pallet 1200 × 800 mm, rollcontainer 800 × 700 mm"),
    KpiColumn("n_ordered", "int64", "1", "boxes of the order"),
    KpiColumn("n_boxes", "int64", "1", "boxes of the plan"),
    KpiColumn("n_not_ordered", "int64", "1", "boxes of the plan that were not ordered, or not so often"),
    KpiColumn("n_resized", "int64", "1", "boxes of the plan that were ordered with another size or mass"),
    KpiColumn("kpi_1", "float64", "1", "share of the ordered boxes that is left out"),
    KpiColumn("kpi_2", "float64", "1", "volume of the boxes / (area of the target × greatest height)"),
    KpiColumn("kpi_3", "float64", "m", "greatest height"),
    KpiColumn("kpi_4", "float64", "1", "mean share of the base that lies on other boxes; 1 on the target"),
    KpiColumn(
        "kpi_5", "float64", "1", "share of the upper boxes that hold the pile together; null where there are none"
    ),
    KpiColumn(
        "kpi_6", "Int64", "1", "1: no box moved by more than 0.01 m along z in the static check; null: not known"
    ),
    KpiColumn(
        "eval_score_pal_ratio", "Float64", "1", "kpi_6 × share of the ordered boxes that begin at or below 2.0 m"
    ),
    KpiColumn(
        "eval_score_height", "float64", "m", "greatest height of boxes below 2.0 m, as BED-BPP reads it (1 mm low)"
    ),
    KpiColumn(
        "eval_score_absolute_n_stable_pal_items", "Int64", "1", "kpi_6 × ordered boxes that begin at or below 2.0 m"
    ),
    KpiColumn(
        "n_pal_items",
        "int64",
        "1",
        "boxes as they were ordered, each once, on the target, that begin at or below 2.0 m",
    ),
    KpiColumn("height_below_2m_m", "float64", "m", "greatest height of boxes that end at or below 2.0 m"),
    KpiColumn("volume_m3", "float64", "m^3", "volume of the boxes"),
    KpiColumn(
        "utilisation_2m", "float64", "1", "volume of boxes that end at or below 2.0 m / (area of the target × 2.0 m)"
    ),
    _text("verdict", "petmjx's verdict; null: not known"),
    KpiColumn("stable", "Int64", "1", "1: the verdict is stable; null: not known, or invalid"),
    KpiColumn("stable_pal_ratio", "Float64", "1", "stable × share of the ordered boxes that begin at or below 2.0 m"),
    KpiColumn("n_stable_pal_items", "Int64", "1", "stable × ordered boxes that begin at or below 2.0 m"),
)
"""First BED-BPP's own, then petmjx's."""

MEANS: Final = tuple(column.name for column in COLUMNS if column.mean)
"""Columns of which the mean is shown."""
