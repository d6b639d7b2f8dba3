"""``petmjx show``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console
from petmjx.errors import InputError
from petmjx.pictures.options import PictureOptions
from petmjx.text import printable

if TYPE_CHECKING:
    from petmjx.pictures.save import Progress
    from petmjx.story import Story

DRAWN = "What is drawn"
LOOK = "How it looks"

_OF_RUNS = (
    "shard", "resume", "workers", "ray", "out", "overwrite", "limit", "record", "record_interval_s", "record_details",
    "orders", "yes", "strict", "part_size",
)  # fmt: skip
"""Options of runs that have no meaning for one plan."""


def _file(name: str, text: str) -> Any:
    return Annotated[
        list[Path] | None,
        typer.Option(name, metavar="FILE", help=text, show_default=False, rich_help_panel=DRAWN),
    ]


@opt.takes(without=_OF_RUNS, more=((PictureOptions, LOOK),))
def show(
    plan_id: Annotated[str, typer.Argument(metavar="PLAN_ID", help="Id of the plan.")],
    source: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PLANS|DIR",
            help=f"{opt.PLANS_HELP} Or the folder of a run, whose options are then taken. Without any: the bundled samples.",
            show_default=False,
        ),
    ] = None,
    html: _file("--html", "A page to play it: one file, which needs no network.") = None,
    png: _file("--png", "A picture, or a row of pictures.") = None,
    pdf: _file("--pdf", "A row of pictures as a figure; labels are text.") = None,
    svg: _file("--svg", "The same, as SVG.") = None,
    gif: _file("--gif", "A film.") = None,
    mp4: _file("--mp4", "A film.") = None,
    rrd: _file("--rrd", "A recording for rerun's viewer; needs the extra rerun.") = None,
    viewer: Annotated[
        bool, typer.Option("--viewer", help="Play it in MuJoCo's viewer, on a display.", rich_help_panel=DRAWN)
    ] = False,
    variant: Annotated[
        int | None,
        typer.Option(
            "--variant", metavar="N", help="Of a sweep's run: which world of the plan, as in its table worlds."
        ),
    ] = None,
    **options: Any,
) -> None:
    """Show what happens to one plan: in words, as pictures, as a film, as a page.

    Simulates the plan as a run in the folder DIR did, to the last bit; or with the options given here. Without an option
    of what is drawn it tells the story in the terminal.
    """
