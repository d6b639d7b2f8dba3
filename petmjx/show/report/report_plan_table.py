"""The table of all plans in a report: its columns, and its values as compact arrays. The script ``static/table.js``
displays the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.analysis.run_comparison import KEY
from petmjx.common.text import printable
from petmjx.common.units import MM_PER_M
from petmjx.engines.verdict import Verdict
from petmjx.results.share_statistics import ONE_PLAN
from petmjx.runs.chain_summary import arrivals
from petmjx.runs.sweep_axes import AXIS_KINDS
from petmjx.show.pages.page_arrays import PackedArray, integer_column
from petmjx.show.report.report_runs import Kind, ReportRun

MOST_ROWS: Final = 200_000
"""Largest number of worlds in the table, over all runs. A row takes about 40 bytes. If there are more worlds, worlds
that stand are left out first."""

MOST_OF_SWEEP: Final = 100_000
"""Largest number of worlds of a sweep for which each world gets a row. In a sweep with more worlds, each plan gets a
row."""

PLAN: Final = "plan"
OTHER: Final = "other"
"""Names of two columns in the page: id of the plan, and verdict of the same world in the other run."""


@dataclass(frozen=True)
class NumberColumn:
    """A column with numbers in the table of plans.

    Attributes:
        column: name of the column in ``ReportRun.worlds``.
        key: name of the column in the page, and in the page's address.
        label: heading of the column.
        unit: unit of the column's values.
        digits: number of decimals that are shown.
        factor: factor that converts values to the unit.
        meaning: text that appears when the mouse is over the heading.
    """

    column: str
    key: str
    label: str
    unit: str = ""
    digits: int = 0
    factor: float = 1.0
    meaning: str = ""


NUMBERS: Final = (
    NumberColumn(
        "margin", "margin", "margin", digits=2, meaning="1: nothing moved; 0: on a threshold; below 0: beyond it"
    ),
    NumberColumn("share", "share", "stand", "%", 1, 100.0, meaning="share of worlds with errors that stand or arrive"),
    NumberColumn(
        "low",
        "low",
        "from",
        "%",
        1,
        100.0,
        meaning="lower end of the Wilson 95 % interval of the share of standing or arriving worlds",
    ),
    NumberColumn(
        "high",
        "high",
        "to",
        "%",
        1,
        100.0,
        meaning="upper end of the Wilson 95 % interval of the share of standing or arriving worlds",
    ),
    NumberColumn("n_boxes", "boxes", "boxes"),
    NumberColumn("n_placed", "placed", "placed", meaning="number of boxes placed before the world ended"),
    NumberColumn("n_dropped", "dropped", "dropped", meaning="number of boxes that fell"),
    NumberColumn(
        "culprit",
        "first",
        "first box",
        meaning="number of the box that first crossed a threshold (in packing order, from 0)",
    ),
    NumberColumn(
        "first_sign_s", "sign", "first sign", "s", 2, meaning="time at which the first box crossed a threshold"
    ),
    NumberColumn(
        "max_shift_m", "shift", "shift", "mm", 1, MM_PER_M, meaning="largest component of any box’s final shift"
    ),
    NumberColumn("max_tilt_deg", "tilt", "tilt", "°", 1, meaning="largest tilt of any box"),
    NumberColumn("max_top_force_n", "force", "force", "N", 0, meaning="largest force on top of any box"),
    NumberColumn("rest_top_force_n", "rest", "at rest", "N", 0, meaning="largest force on top of any box at rest"),
    NumberColumn("height_m", "height", "height", "m", 2),
    NumberColumn("mass_kg", "weight", "weight", "kg", 0),
)
"""The columns with numbers. A column is left out if no world has a value."""


@dataclass
class Rows:
    """The table of plans in the form that the page uses.

    Attributes:
        columns: key, label, unit, kind (``text``, ``choice`` or ``number``), digits and meaning of each column, in
            order.
        texts: key of a column of kind ``text`` or ``choice`` → its texts. The column's array has indices of these
            texts, or −1 if there is no text.
        arrays: key of a column → one value per row.
        left_out: number of worlds that are not in the table.
        summed_up: the runs for which the table has one row per plan instead of one row per world.
    """

    columns: list[dict[str, Any]] = field(default_factory=list)
    texts: dict[str, list[str]] = field(default_factory=dict)
    arrays: dict[str, NDArray[Any] | PackedArray] = field(default_factory=dict)
    left_out: int = 0
    summed_up: list[ReportRun] = field(default_factory=list)


def table_rows(runs: Sequence[ReportRun], most: int = MOST_ROWS) -> tuple[Rows, pd.DataFrame]:
    """The table of plans, and a data frame with the same rows in the same order. In the data frame, the column ``run``
    has the number of the run."""
    summed_up = [run for run in runs if run.kind is Kind.GRID and len(run.worlds) > MOST_OF_SWEEP]
    frames = [_of_run(at, run, run in summed_up) for at, run in enumerate(runs)]
    frames = _with_other_verdicts(frames, runs) if len(frames) == 2 else frames
    frame = pd.concat(frames, ignore_index=True)
    rows = Rows(left_out=max(0, len(frame) - most), summed_up=summed_up)
    if rows.left_out:
        falls_first = (frame["verdict"] == Verdict.STABLE.value).sort_values(kind="stable").index[:most]
        frame = frame.loc[np.sort(falls_first)].reset_index(drop=True)
    _add_choice(rows, "run", "run", frame["run"].map(dict(enumerate(run.name for run in runs))), len(runs) > 1)
    _add_texts(rows, PLAN, "plan", frame["plan_id"])
    rows.arrays["variant"] = integer_column(frame["variant"].to_numpy(np.int64))
    if frame["variant"].nunique() > 1:
        rows.columns.append(_column("variant", "variant", "number"))
    of_variants = {"replicate", *(kind.column for kind in AXIS_KINDS.values())}
    _add_parameters(rows, runs, frame, lambda name: name in of_variants)
    _add_choice(rows, "verdict", "verdict", frame["verdict"], True)
    _add_choice(rows, "reason", "reason", frame["reason"], True)
    if OTHER in frame:
        _add_choice(rows, OTHER, "in the other", frame[OTHER], True, "verdict of the same world in the other run")
    for shown in NUMBERS:
        _add_number(rows, shown, frame)
        if shown.column == "culprit":
            _add_choice(rows, "article", "first article", frame["first_article"], True)
    _add_parameters(rows, runs, frame, lambda name: name not in of_variants)
    return rows, frame


def _of_run(at: int, run: ReportRun, summed_up: bool) -> pd.DataFrame:
    worlds = run.worlds.assign(run=at)
    summary = run.results.summary
    if summed_up:
        worlds = _worst(worlds)
        if run.shares is not None:
            of_plans = run.shares[(run.shares["scope"] == ONE_PLAN) & (run.shares["axis"] == "")]
            worlds = worlds.merge(of_plans[["plan_id", "share", "low", "high"]], on="plan_id", how="left")
    if run.kind in (Kind.CONFIDENCE, Kind.CHAIN) and summary is not None:
        summary = arrivals(summary) if run.kind is Kind.CHAIN else summary
        worlds = worlds.merge(summary[["plan_id", "share", "low", "high"]], on="plan_id", how="left")
    return worlds


def _worst(worlds: pd.DataFrame) -> pd.DataFrame:
    """For each plan, the world with the smallest margin."""
    margin = worlds["margin"].fillna(np.inf)
    return worlds.loc[margin.groupby(worlds["plan_id"], sort=False).idxmin()].reset_index(drop=True)


def _with_other_verdicts(frames: Sequence[pd.DataFrame], runs: Sequence[ReportRun]) -> list[pd.DataFrame]:
    """The worlds of two runs with an additional column ``OTHER``: the verdict of the same world in the other run, or ""
    if the other run does not have this world."""
    tables = []
    for one, two in zip(frames, runs[::-1], strict=True):
        other = one[KEY].merge(two.worlds[[*KEY, "verdict"]], on=KEY, how="left")["verdict"].fillna("")
        tables.append(one.assign(**{OTHER: other.to_numpy()}))
    return tables


def _add_parameters(
    rows: Rows, runs: Sequence[ReportRun], frame: pd.DataFrame, condition: Callable[[str], bool]
) -> None:
    """Add those columns that only sweeps have (such as the values of axes) and whose names fulfil ``condition``."""
    units = {name: unit for run in runs for name, unit in run.results.units("worlds").items()}
    column_names = {shown.column for shown in NUMBERS}
    for name in dict.fromkeys(name for run in runs for name in run.parameters):
        if not condition(name) or name not in frame or name in column_names or frame[name].nunique() == 0:
            continue
        unit = units.get(name, "")
        label = name.removesuffix(f"_{unit}").replace("_", " ")
        if pd.api.types.is_numeric_dtype(frame[name]) and not pd.api.types.is_bool_dtype(frame[name]):
            shown = NumberColumn(name, _key(name), label, "°" if unit == "deg" else unit.strip("1"), 3)
            _add_number(rows, shown, frame)
        else:
            _add_choice(rows, _key(name), label, frame[name].map(_cell_text), True)


def _key(name: str) -> str:
    """The key of a parameter's column in the page, which differs from the keys of all other columns."""
    return f"x-{name}"


def _cell_text(value: object) -> str:
    return "" if pd.isna(value) else str(value)


def _column(key: str, label: str, kind: str, unit: str = "", digits: int = 0, meaning: str = "") -> dict[str, Any]:
    return {"key": key, "label": label, "kind": kind, "unit": unit, "digits": digits, "meaning": meaning}


def _add_number(rows: Rows, shown: NumberColumn, frame: pd.DataFrame) -> None:
    if shown.column not in frame:
        return
    values = frame[shown.column].astype("float64").to_numpy() * shown.factor
    if not np.isfinite(values).any():
        return
    rows.columns.append(_column(shown.key, shown.label, "number", shown.unit, shown.digits, shown.meaning))
    rows.arrays[shown.key] = values.astype(np.float32)


def _add_texts(rows: Rows, key: str, label: str, values: pd.Series, kind: str = "text", meaning: str = "") -> None:
    places, texts = pd.factorize(values)
    rows.columns.append(_column(key, label, kind, meaning=meaning))
    rows.texts[key] = [printable(str(text)) for text in texts]
    rows.arrays[key] = integer_column(places.astype(np.int64))


def _add_choice(rows: Rows, key: str, label: str, values: pd.Series, is_shown: bool, meaning: str = "") -> None:
    """Add a column with few different texts, from which the user of the page can choose. "" means no value."""
    if is_shown and (values.fillna("") != "").any():
        _add_texts(rows, key, label, values.where(values != ""), "choice", meaning)
