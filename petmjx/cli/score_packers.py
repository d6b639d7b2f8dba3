"""Scores of several packers' plans, for ``petmjx score --name``: a run for each packer, and then their comparison."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import PRINTED_NOTES, results_console
from petmjx.cli.run_command import brief, folder_of_run, run_watched
from petmjx.common.errors import InputError
from petmjx.common.text import printable

if TYPE_CHECKING:
    from petmjx.results.run_reader import RunResults


Names = Annotated[
    list[str] | None,
    typer.Option(
        "--name",
        metavar="NAME=PLANS",
        help="Plans of several packers for the same orders: --name A=a.json B=b.json. The results of each packer "
        "go to a subfolder of --out with the packer's name; then the packers are compared.",
    ),
]
"""The option ``--name`` of ``petmjx score``."""


def score_packers(names: Sequence[str], options: Mapping[str, Any], as_json: bool) -> None:
    """Score the plans of each packer into a subfolder of ``out`` with the packer's name, then compare the packers.

    Args:
        names: for each packer, its name and its file or folder of plans: NAME=PLANS.
        options: options of ``petmjx.score``.

    Raises:
        InputError: a text is not of this form, or a name or a path is unusable.
    """
    from petmjx import api
    from petmjx.analysis.packer_comparison import compare_packers
    from petmjx.analysis.packer_runs import check_names, with_engine_of
    from petmjx.results.run_folder import check_run_folder
    from petmjx.show.packer_tables import packer_tables
    from petmjx.show.run_tables import run_tables
    from petmjx.show.table_layout import line, print_renderables

    plans = opt.named_paths(names, "--name")
    if len(plans) < len(names):
        raise InputError("--name: must be NAME=PLANS, such as --name A=a.json B=b.json")
    check_names(plans)
    for path in plans.values():
        if not Path(path).exists():  # all paths are checked before any plan is simulated
            raise InputError(f"{printable(path)}: no such file or folder")
    console = results_console()
    results: dict[str, RunResults] = {}
    with folder_of_run(options) as parent:
        for name in plans:
            check_run_folder(parent / name, options.get("overwrite", False), options.get("resume", False))
        for name, path in plans.items():
            first = next(iter(results.values()), None)
            of_packer = options if first is None else with_engine_of(first, options, parent / name)
            results[name] = run_watched(partial(api.score, path), {**of_packer, "out": parent / name})
            if not as_json:
                print_renderables(
                    [line(f"packer {name}"), *run_tables(results[name], PRINTED_NOTES.get()), ""], console
                )
    compared = compare_packers(results, orders=options.get("orders")) if len(results) > 1 else None
    if as_json:
        runs = {name: brief(run) for name, run in results.items()}
        tables = None if compared is None else compared.to_dict()
        print(json.dumps({"runs": runs, "compared": tables}, indent=2, allow_nan=False))
    elif compared is not None:
        print_renderables(packer_tables(compared), console)
