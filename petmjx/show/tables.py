"""The tables of a run, for scores and sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import pandas as pd
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from petmjx.results.reader import RunResults
from petmjx.show.layout import Column, FittedTable, line, number, percent
from petmjx.show.sweep_tables import FEW_ROWS, sweep_tables
from petmjx.text import counted, three_digits
from petmjx.verdict import Verdict

SHOWN_SKIPPED: Final = 10
"""Most skipped plans that are shown; ``run.json`` has all of them."""

_STYLES: Final = {Verdict.STABLE.value: "green", Verdict.UNSTABLE.value: "red", Verdict.INVALID.value: "yellow"}


def run_tables(results: RunResults) -> Iterator[RenderableType]:
    """All tables and lines: a sweep's answers, or the worlds if there are few; skipped plans; the counts."""
    sweep = results.info["config"]["command"] == "sweep"
    if results.summary is not None:
        for table in sweep_tables(results.summary):
            yield table
            yield ""
    elif not sweep and len(results.worlds) <= FEW_ROWS:
        yield worlds_table(results.worlds.sort_values("plan_id"), results.boxes)
        yield ""
    yield from notes(results.info)
    yield summary_table(results.info, "worlds" if sweep else "plans")
    yield line(f"results in {results.path}")


def notes(info: Mapping[str, Any]) -> Iterator[RenderableType]:
    """One line for each of the first ``SHOWN_SKIPPED`` skipped plans, and the number of plans with warnings."""
    skipped, odd = info["skipped"], len(info["warnings"])
    for entry in skipped[:SHOWN_SKIPPED]:
        yield line(f"skipped: {entry['error']}", style="yellow")
    if len(skipped) > SHOWN_SKIPPED:
        yield line(f"skipped: {len(skipped) - SHOWN_SKIPPED:,} more, in run.json", style="yellow")
    if odd:
        yield line(f"{counted(odd, 'plan')} with overlapping, floating or outside boxes, in run.json", style="yellow")


def summary_table(info: Mapping[str, Any], what: str = "plans") -> Table:
    """The table of counts.

    Args:
        info: ``run.json``, or ``RunWriter.info``.
        what: the user's word for worlds: ``plans``, or ``worlds`` in sweeps.
    """
    counts = info.get("counts", {})
    worlds = int(counts.get("worlds", 0))
    table = Table(show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_column(justify="right")

    def add(label: str, count: int, style: str = "") -> None:
        share = percent(count / worlds) if worlds else ""
        table.add_row(label, f"{count:,}", share, style=style if count else "dim")

    table.add_row(what, f"{worlds:,}", "")
    for verdict in Verdict:
        add(verdict.value, int(counts.get(verdict.value, 0)), _STYLES[verdict.value])
        for reason, count in counts.get("by_reason", {}).get(verdict.value, {}).items():
            add(f"  {reason}", int(count))
    expected = info.get("expected_worlds")
    if expected is not None and expected > worlds:
        table.add_row("not simulated", f"{expected - worlds:,}", str(info.get("status", "")), style="yellow")
    if skipped := counts.get("skipped_plans"):
        table.add_row("skipped plans", f"{skipped:,}", "", style="yellow")
    if retried := counts.get("retried"):
        table.add_row("run more than once", f"{retried:,}", "")
    table.add_section()
    seconds = float(info.get("timings", {}).get("wall_s") or 0.0)
    if seconds > 0:
        table.add_row(f"{what}/s", three_digits(worlds / seconds), f"{seconds:,.1f} s")
    return table


def worlds_table(worlds: pd.DataFrame, boxes: pd.DataFrame) -> FittedTable:
    """One row per plan of a score: its verdict, the first box to fail and when, and its largest metrics."""
    table = FittedTable(
        Column("plan", "left", least=24, middle=True),
        Column("boxes", spare=2),
        Column("verdict", "left"),
        Column("reason", "left"),
        Column("first box", "left", least=8, spare=1),
        Column("at\ns", spare=3),
        Column("shift\nmm"),
        Column("tilt\n°"),
        Column("rest\nforce N", spare=4),
    )
    articles = boxes.set_index(["plan_id", "box"])["article"].to_dict()
    for row in worlds.to_dict("records"):
        first = "" if pd.isna(row["culprit"]) else f"{row['culprit']} {articles[row['plan_id'], row['culprit']]}"
        verdict = str(row["verdict"])
        placed = "" if row["n_placed"] == row["n_boxes"] else f"{row['n_placed']} of "
        table.add(
            str(row["plan_id"]),
            f"{placed}{row['n_boxes']}",
            Text(verdict, style=_STYLES.get(verdict, "")),
            str(row["reason"]),
            first,
            number(row["first_sign_s"], ".2f"),
            number(row["max_shift_m"], ".1f", factor=1000.0),
            number(row["max_tilt_deg"], ".1f"),
            number(row["rest_top_force_n"], ".1f"),
        )
    return table
