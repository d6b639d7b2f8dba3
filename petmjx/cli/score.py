"""``petmjx score``."""

from __future__ import annotations

from typing import Any

from petmjx.cli import options as opt
from petmjx.cli.runs import run_and_show
from petmjx.run_options import Confidence


@opt.takes(more=((Confidence, opt.HOW_SURE),))
def score(plans: opt.PlanPaths = None, as_json: opt.JsonOption = False, **options: Any) -> None:
    """Simulate packing plans and say which of them stand.

    Reads the plans, places their boxes in a simulated world, and writes a verdict and metrics per plan and per
    box as Parquet. Unusable plans are skipped, counted and listed.

    With --confidence N it says how sure the verdicts are: which share of N worlds with errors stands, with a 95 %
    interval, and which plans are a coin toss.
    """
    from petmjx import api

    run_and_show(lambda watcher, given: api.score(plans or None, watcher=watcher, **given), options, as_json)
