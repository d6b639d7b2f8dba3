"""``petmjx loads``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import print_tables
from petmjx.options.strength_losses import Stacking


@opt.takes(*Stacking.model_fields, more=((Stacking, "How boxes lose strength"),))
def loads(
    run: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the run.")],
    plans: Annotated[
        list[Path] | None, typer.Argument(metavar="PLANS", help="The plans of the run, if its plan files were moved.")
    ] = None,
    *,
    articles: Annotated[
        Path | None,
        typer.Option(
            "--articles",
            metavar="FILE",
            help="File with the loads that articles, groups or materials can bear: CSV, Parquet or TOML. "
            "[default: the strengths in the plans]",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Folder for the tables of loads, as Parquet and CSV."),
    ] = None,
    overwrite: opt.Overwrite = False,
    as_json: opt.JsonOption = False,
    **losses: float,
) -> None:
    """Find overloaded boxes: compare the force on the top of each box with the box's strength, both for the force at
    rest and for the largest force (the peak).

    Strengths are given in newtons, or are computed by McKee's formula from the carton's board. A box loses a part of
    its strength if the walls of the boxes above do not stand on its walls, if its walls stick out beyond the box below,
    or if its walls are over gaps of the carrier's deck. Loads do not change verdicts.
    """
    from petmjx.analysis.box_loads import check_loads_free
    from petmjx.analysis.box_loads import loads as compare
    from petmjx.results.input_files import input_files
    from petmjx.results.to_json import to_json
    from petmjx.show.load_tables import load_tables

    if out is not None:
        check_loads_free(out, overwrite, input_files(run, plans, articles))
    comparison = compare(run, articles, plans or None, stacking=losses)
    if out is not None:
        comparison.write(out, overwrite)
    if as_json:
        ways = {} if comparison.ways is None else {"ways": to_json(comparison.ways)}
        print(json.dumps({"plans": to_json(comparison.plans), **ways, "notes": comparison.notes}, indent=2))
        return
    print_tables(load_tables(comparison, out))
