"""``petmjx sweep``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.run_command import run_and_show


@opt.takes(simulated="Simulation (the sweep file's [simulation] may set other defaults)")
def sweep(
    file: Annotated[
        str,
        typer.Argument(metavar="SWEEP", help="Sweep file (TOML), or the name of a ready-made sweep such as eumos."),
    ],
    plans: Annotated[
        list[Path] | None,
        typer.Argument(metavar="PLANS", help=f"{opt.PLANS_HELP} Without plans: the plans that the sweep file names."),
    ] = None,
    as_json: opt.JsonOption = False,
    **options: Any,
) -> None:
    """Simulate packing plans in many variants, with different forces, levels, friction and placement errors.

    For each plan and each set of placement errors, the command simulates the placement of the boxes once. From the
    state in which the boxes are at rest, it then simulates all profiles (motions of the carrier), levels and
    directions. The command writes a row for each simulation, a row for each box of each simulation, and a summary. The
    summary has the share of simulations in which the plan stands, with a 95 % interval if there are random errors. For
    a search, the summary has the largest level survived and the box that fails first.

    Options of the command replace values in the sweep file's [simulation] table.
    """
    from petmjx import api

    run_and_show(partial(api.sweep, file, plans or None), options, as_json)
