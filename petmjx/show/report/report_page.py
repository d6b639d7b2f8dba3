"""The page of a report: its sections, and the data for its scripts."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from petmjx.analysis.run_comparison import thresholds_of
from petmjx.common.argument_checks import list_of, path_of
from petmjx.common.atomic_write import atomic_write, check_writable
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import count_text, printable
from petmjx.common.units import MM_PER_M
from petmjx.results.input_files import input_files
from petmjx.results.run_reader import RunResults
from petmjx.runs.sweep_axes import AXIS_KINDS
from petmjx.show.pages.html_page import page
from petmjx.show.pages.markup import NOTHING, Content, Markup, element, joined_markup
from petmjx.show.pages.page_arrays import block, integer_column
from petmjx.show.pages.palette import category, ramp
from petmjx.show.report.comparison_section import comparison_section
from petmjx.show.report.distributions import distributions, first_boxes
from petmjx.show.report.report_plan_table import Rows, table_rows
from petmjx.show.report.report_runs import Kind, ReportRun, open_runs
from petmjx.show.report.run_settings import about
from petmjx.show.report.sweep_answers import sweep_answers
from petmjx.show.report.verdict_shares import headline, verdict_table
from petmjx.show.report.world_blocks import WORLDS_PER_BLOCK, box_blocks, replays, simulation_of
from petmjx.world.carrier_boards import floor_z_m

N_CATEGORIES: Final = 21
"""Number of different colours for articles. If a run has more articles, colours repeat."""

Source = str | Path | RunResults


def report(
    runs: Source | Sequence[Source],
    out: str | Path = "report.html",
    *,
    plans: str | Path | Sequence[str | Path] = (),
    overwrite: bool = False,
) -> Path:
    """Write one offline page about one or several runs.

    Args:
        runs: folders of runs, or results of ``petmjx.score``, ``petmjx.sweep`` or ``petmjx.load_run``.
        out: the HTML file to write.
        plans: files or folders with the plans of the runs. If none are given, plans are read from the runs' tables or,
            if the tables do not have them, from the files that the runs name.
        overwrite: whether to replace an existing file.

    Returns:
        The path of the file.

    Raises:
        InputError: a folder has no run, a run is damaged, plans are unreadable, or ``out`` already exists, cannot be
            written or is in a folder that does not exist.
    """
    path = path_of(out, "out")
    check_outputs([path], overwrite=overwrite, inputs=input_files(runs, plans))
    check_writable(path)  # checked before the report is made, since making it may take long
    sources: list[Any] = (
        [runs] if isinstance(runs, str | Path | RunResults) else list_of(runs, "runs", object, "runs or folders")
    )
    files = [plans] if isinstance(plans, str | Path) else list_of(plans, "plans", object, "paths")
    text = report_page(open_runs(sources, [path_of(file, "plans") for file in files]))
    with atomic_write(path) as file:
        file.write_text(text, encoding="utf-8", errors="backslashreplace")
    return path


def report_page(runs: Sequence[ReportRun]) -> str:
    """The HTML text of the page."""
    rows, table = table_rows(runs)
    boxes = box_blocks(runs, table)
    played = replays(runs, table, boxes.drawn)
    arrays = {**rows.arrays, "of": integer_column(table["run"].to_numpy(dtype="int64"))}
    arrays |= {"drawn": integer_column(boxes.drawn), "replay": integer_column(played.number)}
    info = {
        "columns": rows.columns,
        "texts": rows.texts,
        "n": len(table),
        "runs": [_of_run(run) for run in runs],
        "what": runs[0].what,
        "worldsPerBlock": WORLDS_PER_BLOCK,
        "ramp": ramp(),
        "categories": [category(number) for number in range(N_CATEGORIES)],
    }
    title = "petmjx report: " + ", ".join(run.name for run in runs)
    body = _body(runs, _notes(runs, rows, boxes.without_boxes, played.left_out))
    blocks = {"rows": block(arrays), **boxes.blocks, **played.blocks}
    return page(title, body, script="report.js", styles=("report.css",), info=info, blocks=blocks)


def _of_run(run: ReportRun) -> dict[str, Any]:
    """The values of a run that the page's scripts need."""
    limits = thresholds_of(run.info)
    return {
        "name": run.name,
        "command": "sweep" if run.kind.sweeps else "score",
        "floorZ": floor_z_m(simulation_of(run.info)),
        "limits": {"shift_mm": MM_PER_M * limits.shift_m, "tilt_deg": limits.tilt_deg},
        "missing": run.plan_files.note,
        "folder": shlex.quote(printable(str(run.results.path))),
        "nominalSizes": any(kind.changes_sizes and kind.column in run.parameters for kind in AXIS_KINDS.values()),
    }


def _notes(runs: Sequence[ReportRun], rows: Rows, without_boxes: int, not_played: int) -> Iterator[str]:
    """Notes about worlds that the page does not show."""
    row = "one row per plan: its world with the smallest margin, and the share of its worlds that stand"
    for run in rows.summed_up:
        yield f"{run.name} has {len(run.worlds):,} worlds, too many for a row each. The table has {row}."
    for run in runs:
        if run.plan_files.note:
            yield f"{run.name}: {run.plan_files.note}. These plans have no 3D picture."
    for run in runs:
        if not run.results.keeps_boxes:
            yield f"{run.name} kept no boxes: its worlds have no 3D picture."
    if rows.left_out:
        worlds = count_text(rows.left_out, "world")
        yield f"{worlds} that stand are not in the table, since the table would be too large."
    if without_boxes:
        yield f"{count_text(without_boxes, 'world')} have no 3D picture: the page would be too large."
    if not_played:
        worlds = count_text(not_played, "recorded world")
        yield f"{worlds} cannot be played here: the page would be too large. The command 'petmjx show' plays them."


def _body(runs: Sequence[ReportRun], notes: Iterable[str]) -> Markup:
    several = len(runs) > 1
    sections: list[tuple[str, str, Content]] = []
    if several:
        sections.append(("compared", "The runs compared", comparison_section(runs)))
    else:
        sections.append(("verdicts", "What came out", _outcome_section(runs[0])))
        sections += _details_of(runs[0])
    sections.append(
        ("plans", "All worlds" if any(run.kind.sweeps for run in runs) else "All plans", _table_section(notes))
    )
    if several:
        for number, run in enumerate(runs):
            parts = [element("h3", title) + inner for _, title, inner in _details_of(run) if inner]
            inner = joined_markup(_outcome_section(run), *(Markup(part) for part in parts))
            sections.append((f"run-{number}", run.name, inner))
    links = [element("a", title, href=f"#{name}") for name, title, _ in sections]
    return joined_markup(
        element(
            "header",
            element("p", "petmjx report", class_="faint"),
            element("h1", ", ".join(run.name for run in runs)),
            element("nav", *links, aria_label="Sections"),
        ),
        element("main", *(element("section", element("h2", title), inner, id=name) for name, title, inner in sections)),
    )


def _outcome_section(run: ReportRun) -> Markup:
    """The section with the most important numbers, the verdicts and the settings of a run."""
    empty = element("p", "No world was simulated: there is nothing to show.") if run.worlds.empty else NOTHING
    return joined_markup(
        headline(run),
        empty,
        element(
            "div",
            element("div", verdict_table(run)),
            element("div", element("h3", "What was run"), about(run)),
            class_="two",
        ),
    )


def _details_of(run: ReportRun) -> list[tuple[str, str, Markup]]:
    """(name, title, content) of each section that only some runs have."""
    titles = {Kind.CONFIDENCE: "How sure are the verdicts?", Kind.CHAIN: "How likely do pallets arrive?"}
    title = titles.get(run.kind, "Answers of the sweep")
    sections = [("answers", title, sweep_answers(run))]
    if run.kind is not Kind.SEARCH:  # a search chooses its levels, so charts of its worlds would mislead
        sections.append(("distributions", "Shift, tilt, force, time", distributions(run)))
        sections.append(("first", "What fails first", first_boxes(run)))
    return [section for section in sections if section[2]]


def _table_section(notes: Iterable[str]) -> Markup:
    """The section in which the page's scripts build the table of plans and show the selected plan."""
    lines = [element("p", note, class_="note") for note in notes]
    return joined_markup(
        *lines,
        element("noscript", element("p", "The table and the 3D pictures need JavaScript.", class_="note")),
        element("div", id="filters"),
        element("div", id="table"),
        element("div", id="plan", tabindex="-1"),
    )
