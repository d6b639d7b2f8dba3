"""``petmjx score``."""

from __future__ import annotations

from functools import partial
from typing import Any

from petmjx.cli import command_options as opt
from petmjx.cli.run_command import run_and_show
from petmjx.cli.score_packers import Names, score_packers
from petmjx.options.confidence import Confidence
from petmjx.options.transport import Transport


@opt.takes(more=((Confidence, opt.CONFIDENCE_PANEL), (Transport, opt.CONFIDENCE_PANEL)))
def score(plans: opt.PlanPaths = None, names: Names = None, as_json: opt.JsonOption = False, **options: Any) -> None:
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
        score_packers([*names, *map(str, plans or ())], options, as_json)
        return
    run_and_show(partial(api.score, plans or None), options, as_json)
