"""``petmjx repair``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import print_skipped, print_tables
from petmjx.cli.run_command import RunInterrupted
from petmjx.common.atomic_write import check_writable
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import count_text, printable
from petmjx.options.confidence import Confidence
from petmjx.repairs.repair_options import RepairOptions

if TYPE_CHECKING:
    from petmjx.repairs.repair import Repairs

CHANGES_PANEL = "What may be changed"

_OF_RUNS = (
    "workers", "ray", "record", "record_interval_s", "record_details", "orders", "allow_large", "out", "overwrite",
    "resume", "shard", "force_intervals", "keep", "confidence", "exact_too",
)  # fmt: skip
"""Options of runs and of scores that the command ``repair`` does not have, because they have no meaning for a
repair."""


@opt.takes(without=_OF_RUNS, more=((RepairOptions, CHANGES_PANEL), (Confidence, opt.CONFIDENCE_PANEL)))
def repair(
    plans: opt.PlanPaths = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="File for all plans, repaired if a repair was found: *.json, *.csv, *.parquet.",
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE", help="Page that shows each plan before and after its repair."),
    ] = None,
    overwrite: opt.Overwrite = False,
    as_json: opt.JsonOption = False,
    **options: Any,
) -> None:
    """Find the smallest changes that make plans stand.

    Possible changes are a different order of placement, a different place or orientation of a box, moves by some
    millimetres, exchanges of two boxes, tie sheets between layers, turns of stretch film (with --profile) and, as the
    last resort, leaving boxes out. Boxes are named by their numbers in the plan, from 0. Left is −x, front is −y.
    """
    from petmjx.plans.plan_writer import check_plan_file
    from petmjx.repairs.repair import RepairInterrupted
    from petmjx.repairs.repair import repair as repaired
    from petmjx.results.input_files import input_files
    from petmjx.results.plan_lookup import plans_in_place
    from petmjx.results.to_json import to_json
    from petmjx.show.progress import BarWatcher
    from petmjx.show.repair_tables import repair_tables

    if out is not None:
        check_plan_file(out)
    if html is not None and html.suffix.lower() != ".html":
        raise InputError(f"--html {printable(str(html))}: the file's name must end in .html")
    files = [file for file in (out, html) if file is not None]
    check_outputs(files, overwrite=overwrite, inputs=input_files(plans))
    for file in files:
        check_writable(file)
    watcher, interrupted = BarWatcher(), False
    try:
        with watcher:
            result = repaired(plans_in_place(plans, bool(options.get("strict"))), watcher=watcher, **options)
    except RepairInterrupted as stop:
        result, interrupted = stop.repairs, True
        if not result.each:
            raise RunInterrupted("no search for a repair was finished; nothing was written") from None
    print_skipped(result.skipped)
    if out is not None:
        result.save(out)
    if as_json:
        print(json.dumps({"plans": to_json(result.table), "changes": to_json(result.changes)}, indent=2))
    else:
        print_tables(repair_tables(result))
    if html is not None:
        from petmjx.show.pages.repair_page import write_repair_page

        write_repair_page(result, html)
    if not as_json:
        print_tables(_written(result, out, html))
    if interrupted:
        how_far = (
            f"repairs were searched to the end for {len(result.each):,} of {count_text(watcher.total or 0, 'plan')}"
        )
        raise RunInterrupted(f"{how_far}; the results contain only these plans")


def _written(result: Repairs, out: Path | None, html: Path | None) -> Iterator[str]:
    """Yield lines that name the files that the command has written."""
    if out is not None:
        yield f"{count_text(len(result.plans), 'plan')} in {printable(str(out))}"
    if html is not None:
        yield f"page {printable(str(html))}"
