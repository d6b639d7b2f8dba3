"""``petmjx export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import options as opt
from petmjx.config import Carrier
from petmjx.errors import InputError


def export(
    plan_id: Annotated[str, typer.Argument(metavar="PLAN_ID", help="Id of the plan to write.")],
    plans: opt.PlanPaths = None,
    physics: opt.PhysicsOption = opt.PhysicsName.PALLET,
    size_reduction_mm: opt.SizeReductionOption = 0.1,
    carrier: opt.CarrierOption = Carrier.FOOTPRINT,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="File to write.", show_default="standard output"),
    ] = None,
) -> None:
    """Write the exact MuJoCo model of one plan as MJCF, every box at its place; MuJoCo's viewer opens it."""
    from petmjx.api import gather_plans, without_vanishing_boxes
    from petmjx.config import PHYSICS
    from petmjx.world.model import to_mjcf
    from petmjx.world.scene import build_scene

    found = without_vanishing_boxes(gather_plans(plans or None, carrier=carrier), size_reduction_mm)
    plan = next((plan for plan in found.plans if plan.plan_id == plan_id), None)
    if plan is None:
        reasons = [skipped.message for skipped in found.skipped if skipped.plan_id == plan_id]
        raise InputError(reasons[0] if reasons else f"plan {plan_id} is not among the {len(found.plans)} plans read")
    world = PHYSICS[physics.value]
    mjcf = to_mjcf(build_scene(plan, world, carrier, size_reduction_mm), world)
    if out is None:
        print(mjcf)
        return
    try:
        out.write_text(mjcf, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error
    print(f"plan {plan_id}: {plan.n_boxes} boxes, MJCF in {out}")
