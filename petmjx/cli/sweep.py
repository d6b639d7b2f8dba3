"""``petmjx sweep``."""

from __future__ import annotations

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
        typer.Argument(
            metavar="PLANS", help=f"{opt.PLANS_HELP} Without any: those that the sweep file names.", show_default=False
        ),
    ] = None,
    as_json: opt.JsonOption = False,
    **options: Any,
) -> None:
    """Simulate packing plans in many variants: forces, levels, friction, placement errors.

    The command simulates each placement of a plan once, and starts all profiles, levels and directions from its settled
    state. It writes every world and box, and a summary: the share that stands, with a 95 % interval if worlds are drawn
    at random. For a search, the summary has the largest level survived and the box that fails first.

    Options of the command replace values in the sweep file's [simulation] table.
    """
    from petmjx import api

    run_and_show(
        lambda watcher, run_options: api.sweep(file, plans or None, watcher=watcher, **run_options), options, as_json
    )
