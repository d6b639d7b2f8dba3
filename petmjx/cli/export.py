"""``petmjx export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from petmjx.cli import options as opt
from petmjx.errors import InputError
from petmjx.text import counted, printable
from petmjx.whole import check_free


@opt.takes("physics", "size_reduction_mm", "carrier", "units", "anchor")
def export(
    plan_id: Annotated[str, typer.Argument(metavar="PLAN_ID", help="Id of the plan to write.")],
    plans: opt.PlanPaths = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="File to write.", show_default="standard output"),
    ] = None,
    overwrite: opt.Overwrite = False,
    **options: Any,
) -> None:
    """Write the exact MuJoCo model of one plan as MJCF, every box at its place; MuJoCo's viewer opens it."""
    from petmjx.config import Simulation
    from petmjx.plans.gather import find_plan, usable_plans
    from petmjx.run_options import RunOptions
    from petmjx.world.model import to_mjcf
    from petmjx.world.scene import build_scene

    if out is not None:
        check_free(out, overwrite, plans or ())
    read = RunOptions(**{name: options.pop(name) for name in ("units", "anchor") if name in options})
    sim = Simulation(**options)
    plan = find_plan(usable_plans(plans or None, sim, read), plan_id)
    mjcf = to_mjcf(build_scene(plan, sim), sim.physics)
    if out is None:
        print(mjcf)
        return
    try:
        out.write_text(mjcf, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error
    print(printable(f"plan {plan_id}: {counted(plan.n_boxes, 'box', 'boxes')}, MJCF in {out}"))
