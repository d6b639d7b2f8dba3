"""``petmjx loads``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from petmjx.basics.text import printable
from petmjx.cli import options as opt
from petmjx.cli.console import results_console


def loads(
    run: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the run.")],
    plans: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PLANS",
            help="The plans of the run, if its plan files were moved.",
            show_default=False,
        ),
    ] = None,
    *,
    articles: Annotated[
        Path | None,
        typer.Option(
            "--articles",
            metavar="FILE",
            help="How much articles, groups or materials can bear: CSV, Parquet or TOML; default: what plans say.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Folder for box_loads and plan_loads, as Parquet and CSV."),
    ] = None,
    overwrite: opt.Overwrite = False,
    as_json: opt.JsonOption = False,
) -> None:
    """Say which boxes bear more than they can: force on top at rest / strength.

    A strength is given in newtons, or by McKee's formula from the carton's board. Verdicts stay as they are.
    """
    from petmjx.results.loads import check_loads_free
    from petmjx.results.loads import loads as compare
    from petmjx.results.plain import plain
    from petmjx.results.sources import source_files
    from petmjx.show.layout import print_each
    from petmjx.show.load_tables import load_tables

    if out is not None:
        check_loads_free(out, overwrite, source_files(run, plans, articles))
    found = compare(run, articles, plans or None)
    if out is not None:
        found.write(out, overwrite)
    if as_json:
        print(json.dumps({"plans": plain(found.plans), "notes": found.notes}, indent=2))
        return
    print_each(load_tables(found, None if out is None else printable(str(out))), results_console())
