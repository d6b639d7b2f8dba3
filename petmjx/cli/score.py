"""``petmjx score``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import PRINTED_NOTES, print_tables
from petmjx.cli.run_command import brief, folder_of_run, run_and_show, run_watched
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.options.confidence import Confidence
from petmjx.options.transport import Transport

if TYPE_CHECKING:
    from petmjx.results.run_reader import RunResults


@opt.takes(more=((Confidence, opt.CONFIDENCE_PANEL), (Transport, opt.CONFIDENCE_PANEL)))
def score(
    plans: opt.PlanPaths = None,
    names: Annotated[
        list[str] | None,
        typer.Option(
            "--name",
            metavar="NAME=PLANS",
            help="Plans of several packers for the same orders: --name A=a.json B=b.json. The results of each packer "
            "go to a subfolder of --out with the packer's name; then the packers are compared.",
        ),
    ] = None,
    as_json: opt.JsonOption = False,
    **options: Any,
) -> None:
    """Simulate packing plans, and report which of them stand.

    The command reads the plans, simulates the placement of their boxes, and writes a verdict for each plan and metrics
    for each plan and box, as Parquet. Unusable plans are skipped, counted and listed.

    With --confidence N, the command also reports how certain the verdicts are. It simulates each plan N more times with
    random errors, and reports the share of these simulations in which the plan stands, with a 95 % interval. The
    command also reports plans whose interval contains one half, since such a plan may as well stand as fall.

    With --chain NAME, the command also reports how likely each plan is to arrive at the end of a transport chain. It
    reports the share of simulations in which the plan stands after all legs (stages of the transport), the weakest leg,
    and remedies.
    """
    from petmjx import api

    if names:
        _score_packers([*names, *map(str, plans or ())], options, as_json)
    else:
        run_and_show(partial(api.score, plans or None), options, as_json)


def _score_packers(names: Sequence[str], options: Mapping[str, Any], as_json: bool) -> None:
    """Score the plans of each packer into a subfolder of ``out`` with the packer's name, then compare the packers.

    Args:
        names: for each packer, its name and its file or folder of plans: NAME=PLANS.

    Raises:
        InputError: a text is not of this form, or a name or a path is unusable.
    """
    from petmjx import api
    from petmjx.analysis.packer_comparison import compare_packers
    from petmjx.analysis.packer_runs import check_names, with_engine_of
    from petmjx.results.run_folder import check_run_folder
    from petmjx.show.packer_tables import packer_tables
    from petmjx.show.run_tables import run_tables
    from petmjx.show.table_layout import line

    plans = opt.named_paths(names, "--name")
    if len(plans) < len(names):
        raise InputError("--name: must be NAME=PLANS, such as --name A=a.json B=b.json")
    check_names(plans)
    for path in plans.values():
        if not Path(path).exists():  # all paths are checked before any plan is simulated
            raise InputError(f"{printable(path)}: no such file or folder")
    results: dict[str, RunResults] = {}
    with folder_of_run(options) as parent:
        for name in plans:
            check_run_folder(parent / name, options.get("overwrite", False), options.get("resume", False))
        for name, path in plans.items():
            first = next(iter(results.values()), None)
            of_packer = options if first is None else with_engine_of(first, options, parent / name)
            results[name] = run_watched(partial(api.score, path), {**of_packer, "out": parent / name})
            if not as_json:
                print_tables([line(f"packer {name}"), *run_tables(results[name], PRINTED_NOTES.get()), ""])
    compared = compare_packers(results, orders=options.get("orders")) if len(results) > 1 else None
    if as_json:
        runs = {name: brief(run) for name, run in results.items()}
        tables = None if compared is None else compared.to_dict()
        print(json.dumps({"runs": runs, "compared": tables}, indent=2, allow_nan=False))
    elif compared is not None:
        print_tables(packer_tables(compared))
