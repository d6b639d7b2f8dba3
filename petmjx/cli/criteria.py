"""``petmjx criteria``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from petmjx.analysis.criteria import CriteriaOptions
from petmjx.cli import command_options as opt
from petmjx.cli.console import print_tables
from petmjx.cli.figure import Pdf, Png, Svg, figure_files
from petmjx.common.errors import InputError
from petmjx.common.machine import cpu_threads

CRITERIA_PANEL = "What is asked"
"""Heading of the options that change what the criteria require."""


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
    "p_arrives",
    more=((CriteriaOptions, CRITERIA_PANEL),),
)
def criteria(
    plans: opt.PlanPaths = None,
    run: Annotated[
        Path | None,
        typer.Option(
            "--run",
            metavar="DIR",
            help="Folder of a run of these plans, to compare the criteria with. Without PLANS: the plans of the run.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder for the tables, as Parquet and CSV.")
    ] = None,
    overwrite: opt.Overwrite = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="NAME",
            help="Evaluate this criterion, such as support_75. May be given several times. [default: all but "
            "'strength', 'tolerable_acceleration' and 'load_points']",
            rich_help_panel=CRITERIA_PANEL,
        ),
    ] = None,
    processes: Annotated[
        int | None,
        typer.Option("--processes", metavar="N", help="Number of processes. [default: one for each CPU thread]"),
    ] = None,
    pdf: Pdf = None,
    svg: Svg = None,
    png: Png = None,
    as_json: opt.JsonOption = False,
    **options: Any,
) -> None:
    """Evaluate closed-form criteria of static stability, and compare them with a simulation.

    By default, the criteria are support of the base, corners, centre of gravity, load-bearable polygons, stacking tree,
    mechanical equilibrium and force balance. Each criterion is evaluated for each box at the moment of its placement.
    With --run, the criteria are compared with the verdicts of a run, and the command determines the threshold of each
    criterion that agrees best with the simulation.
    """
    from petmjx.analysis.criteria_run import criteria as ask
    from petmjx.results.to_json import to_json
    from petmjx.show.criteria_tables import criteria_tables
    from petmjx.show.progress import progress_when_called
    from petmjx.show.table_layout import line

    files = figure_files(pdf, svg, png, overwrite, plans, run)
    if files and run is None:
        raise InputError(f"{files[0]}: a figure needs --run DIR, because it compares criteria with a run")
    with progress_when_called() as show:
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
    if files:
        from petmjx.show.figures.figure_files import figure

        figure(results, *files)
    if as_json:
        tables = {"judged": results.judged, "thresholds": results.thresholds}
        print(json.dumps(to_json(results.info | tables), indent=2, allow_nan=False))
        return
    written = [line(f"figure in {file}") for file in files]
    print_tables([*criteria_tables(results, out), *written])
