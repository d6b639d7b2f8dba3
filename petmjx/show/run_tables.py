"""The tables of a run, for scores and sweeps."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from petmjx.common.text import box_label, count_text, first_names, three_digits
from petmjx.engines.knife_edges import KnifeEdge, kept_edges, nearest_edge
from petmjx.engines.verdict import Flag, Reason, Verdict
from petmjx.results.run_reader import RunResults, is_chain, split_warnings
from petmjx.runs.level_search import MODES
from petmjx.show.table_layout import (
    FEW_ROWS,
    VERDICT_STYLES,
    FittedTable,
    Row,
    TableColumn,
    line,
    name_column,
    note_lines,
    number,
    number_of,
    percent,
    skipped_lines,
    text_of,
)

SHOWN_PLANS: Final = 10
"""Largest number of plans that a line names."""


def run_tables(results: RunResults, printed: Collection[str] = ()) -> Iterator[RenderableType]:
    """All tables and lines of a run: the answers of a sweep or of a score with confidence, or else the worlds if there
    are few; then lines about skipped plans, and a table of counts.

    Args:
        printed: warnings that are left out, because the user has already seen them.
    """
    config = results.info["config"]
    sweep = config["command"] == "sweep"
    if results.summary is not None and "coin_toss" in results.summary:
        yield from _confidence_tables(results, results.summary, printed)
        return
    if is_chain(results.info) and len(results.plans) <= FEW_ROWS and (nominal := _nominal(results)) is not None:
        yield nominal
        yield ""
    if results.summary is not None:
        from petmjx.show.sweep_tables import sweep_tables  # imported late: a plain score does not need this code

        for table in sweep_tables(results.summary):
            yield table
            yield ""
    elif not sweep and len(results.worlds) <= FEW_ROWS:
        orders = results.plans if results.info.get("orders") else None
        yield worlds_table(results.worlds.sort_values("plan_id"), results.boxes_if_kept, orders)
        yield ""
    yield from notes(results.info, printed)
    searched = sweep and config["sweep"]["search"] is not None
    if searched and results.summary is not None:
        yield search_table(results.info, results.summary)
    else:
        yield summary_table(results.info, "worlds" if sweep or "sweep" in config else "plans")
    yield line(f"results in {results.path}")


def _nominal(results: RunResults) -> FittedTable | None:
    """The table of the worlds without errors; None if the run has no world without errors."""
    worlds, boxes = (table[table["variant"] == 0] for table in (results.worlds, results.boxes_if_kept))
    orders = results.plans if results.info.get("orders") else None
    return worlds_table(worlds.sort_values("plan_id"), boxes, orders) if len(worlds) else None


def _confidence_tables(
    results: RunResults, summary: pd.DataFrame, printed: Collection[str]
) -> Iterator[RenderableType]:
    """The tables and lines of a score with confidence. One table has the worlds without errors. Another table has, for
    each plan, the share of worlds with errors in which the plan stands. Lines name the plans that need attention, such
    as *coin tosses*: plans whose share may be above or below one half."""
    from petmjx.runs.confidence import contradiction_mask  # imported late: a plain score does not need this code
    from petmjx.show.sweep_tables import confidence_table

    # runs of earlier versions do not have these columns
    since = {name: 0 for name in ("n_not_placed", "n_fell") if name not in summary}
    summary = summary.assign(**since)
    if len(summary) <= FEW_ROWS:
        if (nominal := _nominal(results)) is not None:
            yield nominal
            yield ""
        yield confidence_table(summary)
        yield ""
    yield from notes(results.info, printed)
    against = "most worlds contradict the nominal verdict"
    for label, chosen in (("coin toss", summary["coin_toss"]), (against, contradiction_mask(summary))):
        if chosen.any():
            yield line(f"{label}: {_plan_id_list(summary.loc[chosen, 'plan_id'].tolist())}", style="yellow")
    yield from _why_they_fail(summary)
    yield confidence_counts(results.info, summary)
    yield line(f"results in {results.path}")


def _why_they_fail(summary: pd.DataFrame) -> Iterator[RenderableType]:
    """Lines with the names of two kinds of plans. The first kind are plans whose worlds fail mostly because a box
    cannot be placed. For plans of the second kind, the share of standing worlds depends on how boxes are placed."""
    missed = summary["n_not_placed"] > summary["n_fell"]
    if missed.any():
        plan_names = _plan_id_list(summary.loc[missed, "plan_id"].tolist())
        yield line(
            f"plans whose worlds with errors mostly fail because a box cannot be placed: {plan_names}", style="yellow"
        )
    if "placing_matters" not in summary:
        return
    for placing, way in (("carried", ">"), ("exact", "<")):
        is_significant = summary.eval(f"only_carried {way} only_exact") & summary["placing_matters"]
        if is_significant.any():
            placing_text = "carried to their places" if placing == "carried" else "placed exactly"
            plan_names = _plan_id_list(summary.loc[is_significant, "plan_id"].tolist())
            yield line(
                f"plans that stand more often, beyond chance, if boxes are {placing_text}: {plan_names}", style="yellow"
            )


def _plan_id_list(plan_ids: list[str]) -> str:
    """Text with the ids of the first ``SHOWN_PLANS`` plans, and the number of further plans."""
    return first_names(plan_ids, SHOWN_PLANS) + (", in summary" if len(plan_ids) > SHOWN_PLANS else "")


def notes(info: Mapping[str, Any], printed: Collection[str] = ()) -> Iterator[RenderableType]:
    """Lines about the first ``SHOWN_SKIPPED`` skipped plans, about the number of plans with warnings, about other
    warnings, and about orders.

    Args:
        printed: warnings that are left out, because the user has already seen them.
    """
    skipped = info["skipped"]
    warnings, odd = split_warnings(info)
    yield from skipped_lines([entry["error"] for entry in skipped], len(skipped), ", in run.json")
    if odd:
        plans = count_text(len(odd), "plan")
        yield line(f"{plans} with overlapping, floating or outside boxes, listed in run.json", style="yellow")
    yield from note_lines(warning for warning in warnings if warning not in printed)
    if info.get("orders"):
        yield from order_lines(info)


def order_lines(info: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Lines about orders that were not compared; then lines about boxes that plans leave out, and about orders without
    a plan.

    Args:
        info: content of ``run.json`` of a run that was compared with orders.
    """
    counts = info["counts"]["orders"]
    yield from skipped_lines(
        info["orders"]["unusable"], counts["unusable_orders"], ", in run.json", kind="not compared"
    )
    ordered = count_text(counts["ordered_boxes"], "ordered box", "ordered boxes")
    odd = []
    if counts["left_out"]:
        verb = _verb(counts["plans_leaving_out"], "leaves", "leave")
        odd.append(f"{count_text(counts['plans_leaving_out'], 'plan')} {verb} out {counts['left_out']:,} of {ordered}")
    if counts["orders_without_plan"]:
        boxes = count_text(counts["boxes_without_plan"], "box", "boxes")
        verb = _verb(counts["orders_without_plan"])
        odd.append(f"{count_text(counts['orders_without_plan'], 'order')} ({boxes}) {verb} no usable plan")
    if counts["not_ordered"]:
        verb = _verb(counts["not_ordered"], "was", "were")
        odd.append(f"{count_text(counts['not_ordered'], 'box', 'boxes')} in plans {verb} not ordered")
    if resized := counts.get("resized", 0):  # runs of petmjx 0.2 do not have this count
        differ = "has another size, mass or property" if resized == 1 else "have other sizes, masses or properties"
        odd.append(f"{count_text(resized, 'box', 'boxes')} {differ} than ordered")
    if counts["plans_without_order"]:
        odd.append(
            f"{count_text(counts['plans_without_order'], 'plan')} {_verb(counts['plans_without_order'])} no order"
        )
    if odd:
        yield line(f"{'; '.join(odd)}, in run.json", style="yellow")
    else:
        yield line(f"plans leave out none of {ordered}")
    if unnamed := counts.get("matched_by_size", 0):
        boxes = count_text(unnamed, "box", "boxes")
        yield line(f"{boxes} without id and article {_verb(unnamed, 'is', 'are')} matched by size and mass")
    if counts["orders_without_plan"] is None:
        yield line("orders without a plan are not counted with --limit: not all plans were read")


def _verb(number: int, one: str = "has", many: str = "have") -> str:
    return one if number == 1 else many


def summary_table(info: Mapping[str, Any], what: str = "plans") -> Table:
    """The table of counts: numbers of worlds by verdict and reason.

    Args:
        info: content of ``run.json``, or ``RunWriter.info``.
        what: the word for worlds in the table: ``plans``, or ``worlds`` in sweeps.
    """
    counts = info.get("counts", {})
    worlds = int(counts.get("worlds", 0))
    table = _counts_table()
    table.add_row(what, f"{worlds:,}", "")
    for verdict in Verdict:
        _add(table, verdict.value, int(counts.get(verdict.value, 0)), worlds, VERDICT_STYLES[verdict])
        for reason, count in counts.get("by_reason", {}).get(verdict.value, {}).items():
            _add(table, f"  {reason}", int(count), worlds)
            if reason == Reason.SHIFT and (moving := int(counts.get("moving_by_shift", 0))):
                _add(table, "    still moving", moving, worlds, "yellow")
        if verdict is Verdict.STABLE and (moving := int(counts.get("moving", 0))):
            _add(table, "  still moving", moving, worlds, "yellow")
        if verdict is Verdict.STABLE and (leans := int(counts.get("leans", 0))):
            _add(table, "  leans", leans, worlds, "yellow")
    expected = info.get("expected_worlds")
    if expected is not None and expected > worlds:
        table.add_row("not simulated", f"{expected - worlds:,}", str(info.get("status", "")), style="yellow")
    _add_end(table, info, what, worlds)
    return table


def search_table(info: Mapping[str, Any], summary: pd.DataFrame) -> Table:
    """The table of counts of a search: numbers of placements (finished pallets before they are shaken); numbers of
    answers (one for each search on a placement that stands); and numbers of tests (levels that were simulated).

    The verdicts of tests are not counted, since they depend on the levels that the search tried.

    Args:
        info: content of ``run.json``.
        summary: the run's table ``summary``, with one row per search.
    """
    placements = summary.drop_duplicates(["plan_id", "placement"])
    answers = summary[summary["stands_at_rest"]]
    largest = answers.filter(regex="^largest_").iloc[:, 0]
    failed = answers.filter(regex="^first_failed_").iloc[:, 0]
    tests = int(summary["n_tests"].sum())
    collapsed = placements["stands_at_rest"] | placements["mode"].isin(MODES.values())
    table = _counts_table()
    table.add_row("placements", f"{len(placements):,}", "")
    _add(table, "  stand", int(placements["stands_at_rest"].sum()), len(placements), "green")
    _add(table, "  invalid", int((~collapsed).sum()), len(placements), "yellow")
    table.add_row("answers", f"{len(answers):,}", "")
    _add(table, "  survive no level", int((~(largest > 0)).sum()), len(answers))
    _add(table, "  survive all levels", int(failed.isna().sum()), len(answers))
    table.add_row("tests simulated", f"{tests:,}", "")
    _add(table, "  invalid", int(summary["n_invalid"].sum()), tests, "yellow")
    if "n_moving" in summary and (moving := int(summary["n_moving"].sum())):
        _add(table, "  still moving", moving, tests, "yellow")
    _add_end(table, info, "tests", tests)
    return table


def confidence_counts(info: Mapping[str, Any], summary: pd.DataFrame) -> Table:
    """The table of counts of a score with confidence: numbers of plans by their share of standing worlds, and numbers
    of worlds.

    Args:
        info: content of ``run.json``.
        summary: the run's table ``summary``, with one row per plan.
    """
    plans, worlds = len(summary), int(info.get("counts", {}).get("worlds", 0))
    table = _counts_table()
    table.add_row("plans", f"{plans:,}", "")
    _add(table, "  nominally stable", int((summary["verdict"] == Verdict.STABLE.value).sum()), plans, "green")
    _add(table, "  stand in all worlds", int((summary["share"] == 1).sum()), plans, "green")
    _add(table, "  stand in no world", int((summary["share"] == 0).sum()), plans, "red")
    _add(table, "  in between", int(summary["share"].between(0, 1, inclusive="neither").sum()), plans)
    _add(table, "  coin toss", int(summary["coin_toss"].sum()), plans, "yellow")
    table.add_row("worlds", f"{worlds:,}", "")
    _add(table, "  could not be placed", int(summary["n_not_placed"].sum()), worlds, "red")
    _add(table, "  fell", int(summary["n_fell"].sum()), worlds, "red")
    _add(table, "  invalid", int(info.get("counts", {}).get(Verdict.INVALID.value, 0)), worlds, "yellow")
    _add_end(table, info, "worlds", worlds)
    return table


def _counts_table() -> Table:
    table = Table(show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_column(justify="right")
    return table


def _add(table: Table, label: str, count: int, of: int, style: str = "") -> None:
    """Add a row with a count, and the count as a share of ``of``."""
    table.add_row(label, f"{count:,}", percent(count / of) if of else "", style=style if count else "dim")


def _add_end(table: Table, info: Mapping[str, Any], what: str, done: int) -> None:
    """Add the last rows of every table of counts: skipped plans, worlds that were run more than once, and the speed of
    the run."""
    counts = info.get("counts", {})
    if skipped := counts.get("skipped_plans"):
        table.add_row("skipped plans", f"{skipped:,}", "", style="yellow")
    if retried := counts.get("retried"):
        table.add_row("run more than once", f"{retried:,}", "")
    table.add_section()
    seconds = float(info.get("timings", {}).get("wall_s") or 0.0)
    if seconds > 0:
        table.add_row(f"{what}/s", three_digits(done / seconds), f"{seconds:,.1f} s")


def _critical_edge(row: Mapping[Any, Any], of_boxes: pd.DataFrame | None) -> KnifeEdge | None:
    """The load (force on a box's supports) because of which a world has the flag ``knife-edge``. If the world does not
    have this flag, the result is the load with the smallest distance from an edge of its box's supports; this distance
    is negative beyond the edge.

    Args:
        row: the world's row of the table ``worlds``.
        of_boxes: the world's rows of the table ``boxes``; None if the run does not have this table.
    """
    flagged = bool(int(row["flags"]) & Flag.KNIFE_EDGE)
    plan_edge_m, rest_edge_m = (
        None if not flagged or of_boxes is None or name not in of_boxes
        else of_boxes.sort_values("box")[name].to_numpy(float, na_value=np.nan)
        for name in ("plan_edge_m", "rest_edge_m")
    )  # fmt: skip
    edges = kept_edges(row, plan_edge_m, rest_edge_m)
    if flagged:
        return nearest_edge(edges, Verdict(row["verdict"]))
    return min(edges, key=lambda edge: edge.edge_m, default=None)


def worlds_table(worlds: pd.DataFrame, boxes: pd.DataFrame, orders: pd.DataFrame | None = None) -> FittedTable:
    """A table with one row per plan of a score: the verdict, the first box to fail and the time of its failure, and the
    largest shift, tilt and force. If any world has the flag ``knife-edge``, two more columns state the distance of a
    box's load from the edge of the box's supports, and the number of this box.

    Args:
        worlds, boxes: tables of the run. If ``boxes`` is empty, the article of the first box to fail is not shown.
        orders: the run's table ``plans``, if it has the number of boxes left out. The number of boxes left out then
            becomes a column of the printed table.
    """
    left_out = {} if orders is None else orders.set_index("plan_id")["left_out"].to_dict()
    articles = boxes.set_index(["plan_id", "box"])["article"].to_dict()
    rows = worlds.to_dict("records")
    on_edge = any(int(flags) & Flag.KNIFE_EDGE for flags in worlds["flags"])
    if on_edge:
        by_plan = dict(iter(boxes.groupby("plan_id"))) if len(boxes) else {}
        rows = [row | {"edge": _critical_edge(row, by_plan.get(row["plan_id"]))} for row in rows]

    def placed(row: Row) -> str:
        return str(row["n_boxes"]) if row["n_placed"] == row["n_boxes"] else f"{row['n_placed']} of {row['n_boxes']}"

    def first_box(row: Row) -> str:
        box = row["culprit"]
        return "" if pd.isna(box) else box_label(box, articles.get((row["plan_id"], box), ""))

    def edge_mm(row: Row) -> str:
        return "" if row["edge"] is None else number(row["edge"].edge_m, "z.1f", factor=1000.0)

    def edge_box(row: Row) -> str:
        return "" if row["edge"] is None or row["edge"].box < 0 else str(row["edge"].box)

    edges = (TableColumn("edge\nmm", edge_mm, spare=6), TableColumn("of\nbox", edge_box, spare=6)) if on_edge else ()
    return FittedTable(
        rows,
        name_column("plan", "plan_id", least=20),
        TableColumn("boxes", placed, spare=3),
        *([] if orders is None else [TableColumn("left\nout", lambda row: number(left_out[row["plan_id"]]))]),
        TableColumn("verdict", lambda row: Text(row["verdict"], style=VERDICT_STYLES.get(row["verdict"], "")), "left"),
        TableColumn("reason", text_of("reason"), "left"),
        TableColumn("margin", lambda row: number(row.get("margin"), ".2f"), spare=1),
        TableColumn("first box", first_box, "left", least=8, spare=2),
        TableColumn("at\ns", number_of("first_sign_s", ".2f"), spare=4),
        TableColumn("shift\nmm", number_of("max_shift_m", ".1f", factor=1000.0)),
        TableColumn("tilt\n°", number_of("max_tilt_deg", ".1f")),
        *edges,
        TableColumn("rest\nforce N", number_of("rest_top_force_n", "z.1f"), spare=5),
    )
