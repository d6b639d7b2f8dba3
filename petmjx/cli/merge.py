"""``petmjx merge``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import print_tables


def merge(
    shards: Annotated[list[Path], typer.Argument(metavar="DIR…", help="Folders of all shards, in any order.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for the whole run.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the results that the folder holds.")] = False,
    as_json: opt.JsonOption = False,
) -> None:
    """Join the shards of a run (score or sweep with --shard I/N) into one run.

    All N shards must exist, be finished, and have the same plans and options. If two shards have the same world
    (simulation of a plan), nothing is written.
    """
    from petmjx.cli.run_command import brief
    from petmjx.runs.merge import merge_runs
    from petmjx.show.run_tables import run_tables

    results = merge_runs(shards, out, overwrite=overwrite)
    if as_json:
        print(json.dumps(brief(results), indent=2))
        return
    print_tables(run_tables(results))
