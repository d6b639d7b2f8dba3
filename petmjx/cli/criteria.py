"""``petmjx criteria``."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console
from petmjx.machine import cpu_threads
from petmjx.statics.options import CriteriaOptions

ASKED = "What is asked"
"""Heading of the options of the criteria."""


@opt.takes(
    "limit",
    "strict",
    "units",
    "anchor",
    "friction",
    "side_friction",
    "carrier",
    "tolerance_mm",
    "seed",
    more=((CriteriaOptions, ASKED),),
)
def criteria(
    plans: opt.PlanPaths = None,
    run: Annotated[
        Path | None,
        typer.Option("--run", metavar="DIR", help="Results of petmjx score of these plans, to judge the criteria by."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder for the tables, as Parquet and CSV.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace tables that are there.")] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="NAME",
            help="Ask this criterion, such as support_75; may be given several times. Without it: all.",
            rich_help_panel=ASKED,
        ),
    ] = None,
    processes: Annotated[
        int | None, typer.Option("--processes", metavar="N", help="Processes. [default: one for each CPU thread]")
    ] = None,
    as_json: opt.JsonOption = False,
    **options: Any,
) -> None:
    """Ask closed-form criteria of static stability of packing plans, and physics about them.

    Support of the base, corners, centre of gravity, load-bearable polygons, stacking tree, mechanical equilibrium and
    force balance: of each box at its placement, with which box fails first. With --run it says what physics says to
    that, and which threshold says it best.
    """
    from petmjx.results.plain import plain
    from petmjx.show.criteria_tables import criteria_tables
    from petmjx.show.layout import print_each
    from petmjx.show.progress import progress
    from petmjx.statics.run import criteria as ask

    bar = None
    with ExitStack() as until_done:

        def show(done: int, total: int) -> None:
            nonlocal bar
            bar = bar or until_done.enter_context(progress(total))
            bar.update(done)

        results = ask(
            plans or None,
            run=run,
            out=out,
            overwrite=overwrite,
            only=only or None,
            processes=cpu_threads() if processes is None else processes,
            progress=show,
            **options,
        )
    if as_json:
        tables = {"judged": results.judged, "thresholds": results.thresholds}
        print(json.dumps(plain(results.info | tables), indent=2, allow_nan=False))
        return
    print_each(criteria_tables(results, None if out is None else str(out)), results_console())
