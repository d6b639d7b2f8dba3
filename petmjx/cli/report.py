"""``petmjx report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import command_options as opt


def report(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR…", help="Folders of runs.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The page.")] = Path("report.html"),
    plans: Annotated[
        list[Path] | None,
        typer.Option(
            "--plans",
            metavar="PATH",
            help="File or folder with the runs' plans; can be given again. By default what the runs have kept.",
        ),
    ] = None,
    overwrite: opt.Overwrite = False,
) -> None:
    """Write one offline page about runs: what came out, charts, all plans in a table and in 3D.

    Of several runs it says where their verdicts differ, and whose plans stand. The page is one file and asks nothing of
    any server, so it can be sent by mail.
    """
    from petmjx.show.report.report_page import report as write_report

    path = write_report(list(runs), out, plans=plans or (), overwrite=overwrite)
    print(f"report in {path} ({path.stat().st_size / 1e6:,.1f} MB)")
