"""``petmjx score``."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.packer_scores import score_packers
from petmjx.cli.run_command import run_and_show
from petmjx.common.errors import InputError
from petmjx.options.confidence import Confidence
from petmjx.options.transport import Transport

Names = Annotated[
    list[str] | None,
    typer.Option(
        "--name",
        metavar="NAME=PLANS",
        help="Plans of several packers for the same orders: --name A=a.json B=b.json. The results of each packer "
        "go to a subfolder of --out with the packer's name; then the packers are compared.",
    ),
]


@opt.takes(more=((Confidence, opt.CONFIDENCE_PANEL), (Transport, opt.CONFIDENCE_PANEL)))
def score(plans: opt.PlanPaths = None, names: Names = None, as_json: opt.JsonOption = False, **options: Any) -> None:
    """Simulate packing plans, and report which of them stand.

    The command reads the plans, simulates the placement of their boxes, and writes a verdict for each plan and metrics
    for each plan and box, as Parquet. Unusable plans are skipped, counted and listed.

    With --confidence N, the command also reports how certain the verdicts are: it simulates each plan N more times with
    random errors, and reports the share of these simulations in which the plan stands, with a 95 % interval. The
    command also reports plans whose interval contains one half, since such a plan may as well stand as fall.

    With --chain NAME, the command also reports how likely each plan is to arrive at the end of a transport chain: the
    share of simulations in which the plan stands after all legs (stages of the transport), the weakest leg, and
    remedies.
    """
    from petmjx import api

    if names:
        texts = [*names, *map(str, plans or ())]
        packers = opt.named_paths(texts, "--name")
        if len(packers) < len(texts):
            raise InputError("--name: must be NAME=PLANS, such as --name A=a.json B=b.json")
        score_packers(packers, options, as_json)
        return
    run_and_show(partial(api.score, plans or None), options, as_json)
