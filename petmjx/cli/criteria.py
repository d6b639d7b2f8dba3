"""``petmjx criteria``."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console
from petmjx.machine import cpu_threads

ASKED = "What is asked"
"""Heading of the options of the criteria."""


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
            "--only", metavar="NAME", help="Ask this criterion; may be given several times.", rich_help_panel=ASKED
        ),
    ] = None,
    friction: Annotated[
        float | None,
        typer.Option(
            "--friction", metavar="MU", help="Friction where boxes lie. [default: 0.5]", rich_help_panel=ASKED
        ),
    ] = None,
    side_friction: Annotated[
        float | None,
        typer.Option(
            "--side-friction",
            metavar="MU",
            help="Friction where boxes touch side by side. [default: 0]",
            rich_help_panel=ASKED,
        ),
    ] = None,
    tolerance_mm: Annotated[
        float | None,
        typer.Option(
            "--tolerance-mm",
            metavar="MM",
            help="Gaps and overlaps up to this count as touching. [default: 0.5]",
            rich_help_panel=ASKED,
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="SEED", help="Of the halves of the plans and intervals.")] = 0,
    limit: Annotated[int | None, typer.Option("--limit", metavar="N", help="At most so many plans.")] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Stop at the first unusable plan.")] = False,
    processes: Annotated[
        int | None, typer.Option("--processes", metavar="N", help="Processes. [default: one for each CPU thread]")
    ] = None,
    as_json: opt.JsonOption = False,
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

    given = {"friction": friction, "side_friction": side_friction, "tolerance_mm": tolerance_mm, "only": only}
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
            limit=limit,
            strict=strict,
            processes=cpu_threads() if processes is None else processes,
            seed=seed,
            progress=show,
            **{name: value for name, value in given.items() if value is not None},
        )
    if as_json:
        tables = {"judged": results.judged, "thresholds": results.thresholds}
        print(json.dumps(plain(results.info | tables), indent=2, allow_nan=False))
        return
    print_each(criteria_tables(results, None if out is None else str(out)), results_console())
