"""``petmjx compare``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console


def compare(
    a: Annotated[Path, typer.Argument(metavar="DIR_A", help="Folder of the reference run.")],
    b: Annotated[Path, typer.Argument(metavar="DIR_B", help="Folder of the other run.")],
    rows: Annotated[
        int, typer.Option("--rows", metavar="N", min=1, help="Show at most so many worlds with differing verdicts.")
    ] = 40,
    as_json: opt.JsonOption = False,
) -> None:
    """Compare two runs of the same plans: verdicts that agree, and differences of each metric.

    Differences are |b - a| with median, 95th percentile and largest; the largest one with its plan and box.
    """
    from petmjx.results.compare import compare_runs
    from petmjx.show.compare_tables import comparison_tables
    from petmjx.show.layout import print_each

    comparison = compare_runs(a, b)
    if as_json:
        print(json.dumps(comparison.to_dict(), indent=2, allow_nan=False))
        return
    print_each(comparison_tables(comparison, max_rows=rows), results_console())
