"""``petmjx leaderboard``."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.common.text import printable, printable_name

if TYPE_CHECKING:
    from petmjx.runs.simulate import Watcher

_OF_RUNS = (
    "limit", "record", "record_interval_s", "record_details", "orders", "out", "overwrite", "resume", "shard",
)  # fmt: skip
"""Options of runs that this command does not have, because the leaderboard sets them itself, or because runs with
different values could not be compared."""


@opt.takes(without=_OF_RUNS)
def leaderboard(
    packers: Annotated[
        list[str],
        typer.Argument(metavar="PACKER…", help="A run's folder or a file of plans for each packer, also as NAME=PATH."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder of the site.")] = Path("leaderboard"),
    orders: Annotated[
        Path | None,
        typer.Option(
            "--orders",
            metavar="FILE",
            help="Orders of the plans, in any form; with orders, the site also shows KPIs and how many boxes are left "
            "out.",
        ),
    ] = None,
    baselines: Annotated[
        bool, typer.Option("--baselines", help="Also rate petmjx's own packers on these orders; needs --orders.")
    ] = False,
    repairs: Annotated[
        list[str] | None,
        typer.Option(
            "--repair",
            metavar="NAME",
            help="Also repair the plans of this packer, and rate them as the entry NAME-repaired; repeatable.",
        ),
    ] = None,
    stories: Annotated[
        int, typer.Option("--stories", metavar="N", min=0, help="Make playable pages of N plans of each packer.")
    ] = 3,
    replays: Annotated[
        int,
        typer.Option(
            "--replays",
            metavar="N",
            min=0,
            help="Number of plans of each run that are simulated again, to confirm the run.",
        ),
    ] = 8,
    overwrite: opt.Overwrite = False,
    **options: Any,
) -> None:
    """Rate packers by physics, and write a website about them: one folder that can be read offline.

    The site has the rating of each packer with its interval, statistical tests, KPIs, pages on which simulations can be
    played, the plans, and the command that makes the site again. The options apply to the plans that the command
    scores. If an entry is the folder of a run, the command uses the verdicts of the run, and simulates some of the
    plans again. If the new simulations contradict the run, the entry is not rated.
    """
    from petmjx.show.leaderboard.leaderboard import leaderboard as make

    paths = opt.named_paths(packers, "leaderboard") or packers
    page = make(
        paths,
        out,
        orders=orders,
        baselines=baselines,
        repairs=repairs or [],
        stories=stories,
        replays=replays,
        watch=_bar,
        overwrite=overwrite,
        **options,
    )
    print(f"leaderboard in {printable(str(page.parent))}: open {printable_name(page.name)}")


@contextmanager
def _bar(name: str) -> Iterator[Watcher]:
    """Print the packer whose plans are being scored, and show the progress."""
    from petmjx.show.progress import BarWatcher

    print(f"packer {printable_name(name)}", file=sys.stderr)
    with BarWatcher() as bar:
        yield bar
