"""``petmjx compare``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import print_tables
from petmjx.cli.figure import Pdf, Png, Svg, figure_files
from petmjx.common.errors import InputError


def compare(
    runs: Annotated[
        list[str],
        typer.Argument(
            metavar="DIR",
            help="Folders of two runs, a and b. With --packers: folders of two or more runs, also as NAME=DIR.",
        ),
    ],
    packers: Annotated[
        bool, typer.Option("--packers", help="Compare packers: the runs are of different plans for the same orders.")
    ] = False,
    orders: Annotated[
        Path | None,
        typer.Option(
            "--orders",
            metavar="FILE",
            help="With --packers: orders of the plans, in any form; with orders, the tables also have KPIs.",
        ),
    ] = None,
    rows: Annotated[
        int, typer.Option("--rows", metavar="N", min=1, help="List at most N plans with different verdicts.")
    ] = 40,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="DIR", help="With --packers: also write all tables to this folder (Parquet, CSV)."
        ),
    ] = None,
    pdf: Pdf = None,
    svg: Svg = None,
    png: Png = None,
    overwrite: opt.Overwrite = False,
    as_json: opt.JsonOption = False,
) -> None:
    """Compare two runs of the same plans: whether their verdicts agree, and by how much each metric differs.

    For each metric, the command prints the median, the 95th percentile and the largest value of |b - a|, and the plan
    and the box with the largest value. If the sign of b - a has a meaning, the command also prints the mean of b - a.
    If a plan is not the same in both runs, only its verdicts are compared.

    With --packers, packers are compared on the same orders (plans with the same ids). For each packer, the command
    prints the share of plans that stand, with an interval, and the utilisation; with --orders, also KPIs. For each pair
    of packers, it prints the difference of the shares with an interval, McNemar's exact test, and the orders for which
    only one packer's plan stands.
    """
    files = figure_files(pdf, svg, png, overwrite, runs, orders)
    if packers:
        _compare_packers(runs, orders, rows, out, overwrite, files, as_json)
        return
    if len(runs) != 2:
        raise InputError(f"compare takes two runs, got {len(runs)}; --packers takes more")
    if out is not None:
        raise InputError("--out needs --packers; without --packers, --json prints the comparison of two runs")
    if orders is not None:
        raise InputError("--orders needs --packers")
    if files:
        raise InputError(f"{files[0]}: a figure needs --packers, because it compares packers")
    from petmjx.analysis.run_comparison import compare_runs
    from petmjx.show.compare_tables import comparison_tables

    comparison = compare_runs(*runs)
    if as_json:
        print(json.dumps(comparison.to_dict(), indent=2, allow_nan=False))
        return
    print_tables(comparison_tables(comparison, max_rows=rows))


def _compare_packers(
    runs: list[str],
    orders: Path | None,
    rows: int,
    out: Path | None,
    overwrite: bool,
    files: list[Path],
    as_json: bool,
) -> None:
    from petmjx.analysis.packer_comparison import check_comparison_free, compare_packers, write_comparison
    from petmjx.results.input_files import input_files
    from petmjx.show.packer_tables import packer_tables
    from petmjx.show.table_layout import line

    paths = opt.named_paths(runs, "compare --packers") or runs
    if out is not None:
        check_comparison_free(out, overwrite, input_files(paths, orders))
    comparison = compare_packers(paths, orders=orders)
    if out is not None:
        write_comparison(comparison, out, overwrite)
    if files:
        from petmjx.show.figures.figure_files import figure

        figure(comparison, *files)
    if as_json:
        print(json.dumps(comparison.to_dict(), indent=2, allow_nan=False))
        return
    written = [] if out is None else [line(f"tables in {out}")]
    written += [line(f"figure in {file}") for file in files]
    print_tables([*packer_tables(comparison, max_rows=rows), *written])
