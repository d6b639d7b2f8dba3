"""``petmjx report``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import command_options as opt
from petmjx.common.errors import InputError


def report(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR…", help="Folders of runs.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The page.")] = Path("report.html"),
    plans: Annotated[
        list[Path] | None,
        typer.Option(
            "--plans",
            metavar="PATH",
            help="File or folder with the runs' plans. May be given several times. [default: the plans that are kept "
            "in the runs' folders]",
        ),
    ] = None,
    pdf: Annotated[
        Path | None,
        typer.Option(
            "--pdf",
            metavar="FILE",
            help="For one run of a chain: instead of the page, write a PDF with one page about each plan.",
        ),
    ] = None,
    overwrite: opt.Overwrite = False,
) -> None:
    """Write one offline page about runs: results, charts, and all plans in a table and in 3D.

    For several runs, the page compares their verdicts and their shares of standing plans. The page is a single file and
    needs no server, so it can be sent by e-mail.
    """
    if pdf is not None:
        _write_pdf(runs, pdf, plans or (), overwrite=overwrite)
        return
    from petmjx.show.report.report_page import report as write_report

    path = write_report(list(runs), out, plans=plans or (), overwrite=overwrite)
    print(f"report in {path} ({path.stat().st_size / 1e6:,.1f} MB)")


def _write_pdf(runs: Sequence[Path], pdf: Path, plans: Sequence[Path], *, overwrite: bool) -> None:
    """Write a PDF with one page about each plan of a run of a transport chain."""
    from petmjx.cli.figure import figure_files
    from petmjx.common.text import count_text
    from petmjx.results.run_reader import load_run
    from petmjx.show.figures.load_unit_page import write_load_unit_pages
    from petmjx.show.report.report_runs import find_report_plans

    if len(runs) != 1:
        raise InputError(f"--pdf: takes exactly one run, got {len(runs)}")
    figure_files(pdf, None, None, overwrite, list(runs), list(plans))
    run = load_run(runs[0])
    count = write_load_unit_pages(run, find_report_plans(run, plans).plans, pdf)
    print(f"{count_text(count, 'page')} in {pdf}")
