"""``petmjx sweep``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console
from petmjx.cli.score import BarWatcher, Interrupted, brief, default_folder, how_far, print_notes

if TYPE_CHECKING:
    from petmjx.results.reader import RunResults


class _SweepWatcher(BarWatcher):
    """The progress bar, with the size of the sweep said before it."""

    def __init__(self) -> None:
        super().__init__("worlds")

    def planned(self, estimate: str) -> None:
        print(estimate, file=sys.stderr)


def sweep(
    file: Annotated[
        str,
        typer.Argument(metavar="SWEEP", help="Sweep file (TOML), or the name of a ready-made sweep such as eumos."),
    ],
    plans: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[PLANS]...",
            help="BED-BPP packing plans: JSON files (also gzipped) or folders of them. Without any: those that the "
            "sweep file names.",
            show_default=False,
        ),
    ] = None,
    engine: opt.EngineOption = opt.EngineName.AUTO,
    limit: opt.LimitOption = None,
    strict: opt.StrictOption = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Run sweeps of more than a million worlds too.")] = False,
    threads: opt.ThreadsOption = None,
    lanes: opt.LanesOption = None,
    out: opt.OutOption = None,
    overwrite: opt.OverwriteOption = False,
    as_json: opt.JsonOption = False,
) -> None:
    """Simulate packing plans in many variants: forces, levels, friction, placement errors.

    Places every plan once per placement variant and forks the settled pallet into all profiles, levels and
    directions. Writes every world and box, and a summary: the share that stands with its 95 % interval, or for a
    search the largest level survived and what fails first.
    """
    import petmjx.api as api

    folder = out if out is not None else default_folder()
    watcher = _SweepWatcher()
    try:
        with watcher:
            results = api.sweep(
                file,
                plans or None,
                engine=engine.value,
                limit=limit,
                strict=strict,
                allow_large=yes,
                threads=threads,
                lanes=lanes,
                out=folder,
                overwrite=overwrite,
                watcher=watcher,
            )
    except KeyboardInterrupt:
        raise Interrupted(how_far(folder, watcher.total, "worlds")) from None
    _show(results, as_json)


def _show(results: RunResults, as_json: bool) -> None:
    if as_json:
        summary = results.summary
        records = [] if summary is None else json.loads(summary.to_json(orient="records"))
        print(json.dumps({"out": str(results.path), **brief(results.info), "summary": records}, indent=2))
        return
    from petmjx.show.sweep_tables import sweep_tables
    from petmjx.show.tables import summary_table

    console = results_console()
    if results.summary is not None:
        for table in sweep_tables(results.summary):
            console.print(table)
            console.print()
    print_notes(console, results.info)
    console.print(summary_table(results.info, results.path, "worlds"))
