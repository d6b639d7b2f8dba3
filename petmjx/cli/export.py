"""``petmjx export``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.common.atomic_write import atomic_write
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import count_text, printable
from petmjx.options.run_options import READING

if TYPE_CHECKING:
    from petmjx.options.physics import Physics
    from petmjx.world.scene import Scene


@opt.takes("physics", "size_reduction_mm", "carrier", "soft", "friction_pairs", *READING, "articles")
def export(
    plan_id: Annotated[str, typer.Argument(metavar="PLAN_ID", help="Id of the plan to write.")],
    source: opt.PlansOrRun = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="File to write.", show_default="standard output"),
    ] = None,
    overwrite: opt.Overwrite = False,
    variant: opt.Variant = None,
    **options: Any,
) -> None:
    """Write the exact MuJoCo model of one plan as MJCF, with every box at its place. MuJoCo's viewer can open the
    model.

    If DIR, the folder of a run, is given, the model is the one that the run simulated. Without DIR, the options
    determine the model.
    """
    from petmjx.results.input_files import input_files
    from petmjx.world.mujoco_model import to_mjcf

    if out is not None:
        check_outputs([out], overwrite=overwrite, inputs=input_files(source, options.get("articles")))
    scene, physics = _scene(plan_id, source or [], variant, options)
    mjcf = to_mjcf(scene, physics)
    if out is None:
        print(mjcf)
        return
    with atomic_write(out) as file:
        file.write_text(mjcf, encoding="utf-8")
    print(printable(f"plan {plan_id}: {count_text(scene.n_boxes, 'box', 'boxes')}, MJCF in {out}"))


def _scene(plan_id: str, source: list[Path], variant: int | None, options: dict[str, Any]) -> tuple[Scene, Physics]:
    from petmjx.options.run_options import RunOptions
    from petmjx.options.simulation import Simulation
    from petmjx.plans.plan_sources import find_plan, usable_plans
    from petmjx.results.plan_lookup import is_run
    from petmjx.world.scene import build_scene

    if source and is_run(source[0]):
        from petmjx.results.run_reader import load_run
        from petmjx.runs.worlds_of_earlier_run import worlds_of_run

        if options:
            raise InputError(f"{next(iter(options))}: a world of a run has the run's options; drop this option")
        worlds, index = worlds_of_run(load_run(source[0]), plan_id, source[1:] or None, variant)
        return worlds.scene(worlds.find(plan_id, index)[0]), worlds.sweep.simulation.physics
    if variant is not None:
        raise InputError("the option variant selects a world of a run: name the run's folder")
    read = RunOptions(**{name: options.pop(name) for name in (*READING, "articles") if name in options})
    sim = Simulation(**options)
    return build_scene(find_plan(usable_plans(source or None, sim, read), plan_id), sim), sim.physics
