"""The tables that the command line shows of a comparison of two runs."""

from __future__ import annotations

from functools import partial
from typing import Any

import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from petmjx.results.compare import BOX_KEY, FORCE_FLOOR_N, Comparison
from petmjx.verdict import Verdict


def print_comparison(found: Comparison, console: Console, max_rows: int = 40) -> None:
    """Print the tables; of flipped worlds and of those one run alone has, ``max_rows`` at most."""
    console.print(f"a  {found.a}\nb  {found.b}", highlight=False, markup=False)
    for note in found.notes:
        console.print(f"note: {note}", style="yellow", highlight=False, markup=False)
    for name, frame in (("a", found.only_a), ("b", found.only_b)):
        if len(frame):
            shown = ", ".join(f"{row.plan_id}/{row.variant}" for row in frame.head(max_rows).itertuples())
            more = ", …" if len(frame) > max_rows else ""
            console.print(f"{len(frame)} worlds only in {name}: {shown}{more}", highlight=False, markup=False)
    console.print(_confusion_table(found))
    if found.n_not_stable:
        console.print(
            f"of {found.n_not_stable} worlds that neither calls stable: same reason {found.same_reason}, "
            f"same first box {found.same_culprit}",
            highlight=False,
        )
    if len(found.flips):
        console.print(_flips_table(found.flips, max_rows))
    console.print(_differences_table("Differences |b - a| of worlds", found.worlds))
    console.print(_differences_table("Differences |b - a| of boxes", found.boxes))
    console.print(f"relative: |b - a| / max(a, {FORCE_FLOOR_N:g} N)", highlight=False)


def _confusion_table(found: Comparison) -> Table:
    share = "-" if found.agreement is None else f"{100 * found.agreement:.2f} %"
    table = Table(title=f"Verdicts: {found.n_agree} of {found.n_common} worlds agree ({share})", title_justify="left")
    table.add_column("a ↓   b →")
    for column in found.confusion.columns:
        table.add_column(str(column), justify="right")
    for row, counts in found.confusion.iterrows():
        table.add_row(str(row), *(str(count) for count in counts))
    return table


def _number(value: Any, factor: float = 1.0, sign: bool = False) -> str:
    if pd.isna(value):
        return "-"
    return f"{factor * float(value):+.3g}" if sign else f"{factor * float(value):.3g}"


def _flips_table(flips: pd.DataFrame, max_rows: int) -> Table:
    invalid = (flips[["verdict_a", "verdict_b"]] == Verdict.INVALID.value).any(axis=None)
    title = f"Flipped verdicts ({len(flips)}); margins to the thresholds, + is over"
    if len(flips) > max_rows:
        title += f"; the first {max_rows}"
    table = Table(title=title, title_justify="left")
    for header in ("plan", "variant"):
        table.add_column(header)
    margins = [("shift_margin_m", "shift mm", 1000.0), ("tilt_margin_deg", "tilt °", 1.0)]
    if invalid:
        margins += [("lin_acc_margin_m_s2", "m/s²", 1.0), ("ang_acc_margin_rad_s2", "rad/s²", 1.0)]
    for side in "ab":
        table.add_column(side)
        table.add_column("box", justify="right")
        for _, header, _ in margins:
            table.add_column(header, justify="right")
    number = partial(_number, sign=True)
    for row in flips.head(max_rows).to_dict("records"):
        cells = [escape(str(row["plan_id"])), str(row["variant"])]
        for side in "ab":
            culprit = row[f"culprit_{side}"]
            cells.append(f"{row[f'verdict_{side}']} {row[f'reason_{side}']}".strip())
            cells.append("-" if pd.isna(culprit) else str(culprit))
            cells += [number(row[f"{name}_{side}"], factor) for name, _, factor in margins]
        table.add_row(*cells)
    return table


def _differences_table(title: str, differences: pd.DataFrame) -> Table:
    # without lines, and with the place as the one column that may break: the numbers stay in one piece
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1), pad_edge=False, collapse_padding=True)
    for header in ("metric", "worlds"):
        table.add_column(header, no_wrap=True)
    for header in ("n", "median", "95 %", "largest"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    key = [column for column in BOX_KEY if column in differences]
    table.add_column("at " + "/".join(column.removesuffix("_id") for column in key))
    for header in ("a", "b"):
        table.add_column(header, justify="right", no_wrap=True)
    for row in differences.to_dict("records"):
        if not row["n"]:
            continue
        relative = row["metric"].endswith(" relative")
        factor, unit = (100.0, "%") if relative else (1.0, "" if row["unit"] == "1" else row["unit"])
        differs = row["largest"] > 0
        place = escape("/".join(str(row[column]) for column in key)) if differs else ""
        table.add_row(
            row["metric"],
            row["group"],
            str(row["n"]),
            *(_number(row[name], factor) for name in ("median", "p95", "largest")),
            unit,
            place,
            *(_number(row[side]) if differs else "" for side in "ab"),
        )
    return table
