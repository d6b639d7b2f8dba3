"""``petmjx figure``, and options for figures, which other commands have, too."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.common.errors import InputError
from petmjx.common.text import printable

_file = partial(opt.file_option, section="A figure for a paper")

Pdf = Annotated[Path | None, _file("--pdf", "Draw the results as a figure: vectors and text, as PDF.")]
Svg = Annotated[Path | None, _file("--svg", "Draw the figure as SVG.")]
Png = Annotated[Path | None, _file("--png", "Draw the figure as a picture (PNG).")]


def figure_files(pdf: Path | None, svg: Path | None, png: Path | None, overwrite: bool, *read: Any) -> list[Path]:
    """The files of figures that the user requested, after checks of their names. Call this function before the figure
    is computed.

    Args:
        read: files and folders that the command reads.

    Raises:
        InputError: a name does not have the suffix of its option, or a file already exists or cannot be written.
    """
    from petmjx.results.input_files import input_files
    from petmjx.show.figures.figure_files import check_figures

    paths = list(opt.files_by_kind(overwrite, input_files(*read), pdf=pdf, svg=svg, png=png).values())
    if paths:
        check_figures(paths)
    return paths


def figure(
    run: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of a sweep, or of a score with --confidence or --chain.")
    ],
    pdf: Pdf = None,
    svg: Svg = None,
    png: Png = None,
    overwrite: opt.Overwrite = False,
) -> None:
    """Draw the results of a run as a figure for a paper.

    For a search for the largest level that plans survive, the figure shows the share of plans that survive each level,
    by direction. For other sweeps, the figure shows the share of simulations in which plans stand, with its 95 %
    interval, for each value that is varied. For a score with --confidence, the figure shows for each plan the share of
    simulations in which the plan stands; for a score with --chain, the share in which the plan arrives.

    The commands "compare --packers" and "criteria" have the same options, and draw figures of their own results.
    """
    from petmjx.results.run_reader import load_run
    from petmjx.show.figures.figure_files import figure as draw

    files = figure_files(pdf, svg, png, overwrite, run)
    if not files:
        raise InputError("figure needs a file to write: --pdf FILE, --svg FILE or --png FILE")
    for path in draw(load_run(run), *files):
        print(f"figure in {printable(str(path))}")
