"""Scores the plans of several packers in one command: ``petmjx score --name``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petmjx.cli.console import results_console
from petmjx.cli.run_command import brief, default_folder, remove_empty, run_watched
from petmjx.common.errors import InputError
from petmjx.common.text import printable

if TYPE_CHECKING:
    from petmjx.results.run_reader import RunResults
    from petmjx.runs.simulate import Watcher


def score_named(plans: Mapping[str, str], options: dict[str, Any], as_json: bool) -> None:
    """Score the plans of each packer into a separate folder, then compare the packers.

    Args:
        plans: name of each packer → file or folder with the packer's plans.
        options: options of ``petmjx.score``. Each packer gets a separate folder in ``out``.
    """
    from petmjx.analysis.packer_comparison import compare_packers
    from petmjx.analysis.packer_runs import check_names
    from petmjx.results.run_folder import check_run_folder
    from petmjx.show.packer_tables import packer_tables
    from petmjx.show.run_tables import run_tables
    from petmjx.show.table_layout import line, print_renderables

    check_names(plans)
    for path in plans.values():
        if not Path(path).exists():  # all paths are checked before any plan is simulated
            raise InputError(f"{printable(path)}: no such file or folder")
    new_folder = None if "out" in options or options.get("resume") else default_folder()
    parent = options.get("out", new_folder)
    for name in plans if "out" in options else ():
        check_run_folder(Path(options["out"]) / name, options.get("overwrite", False), options.get("resume", False))
    console = results_console()
    results = {}
    try:
        for name, path in plans.items():
            packer_options = options if parent is None else options | {"out": Path(parent) / name}
            results[name] = run_watched(partial(_score, path), packer_options)
            if not as_json:
                print_renderables([line(f"packer {name}"), *run_tables(results[name]), ""], console)
    finally:
        if new_folder is not None:
            remove_empty(new_folder)
    compared = compare_packers(results, orders=options.get("orders")) if len(results) > 1 else None
    if as_json:
        runs = {name: brief(run) for name, run in results.items()}
        tables = None if compared is None else compared.to_dict()
        print(json.dumps({"runs": runs, "compared": tables}, indent=2, allow_nan=False))
    elif compared is not None:
        print_renderables(packer_tables(compared), console)


def _score(plans: str, watcher: Watcher, options: Mapping[str, Any]) -> RunResults:
    from petmjx import api

    return api.score(plans, watcher=watcher, **options)
