"""Commands that compare petmjx with other simulators (referees)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.commands.app import DEFAULT_OUT, Out, app, usable, words
from petmjx.cli import command_options as opt
from petmjx.options.simulation import Check


@app.command()
@opt.takes("limit", "threads")
def crossengine(
    plans: Annotated[
        list[Path] | None, typer.Argument(metavar="PLANS...", help="Plan files; default: bundled.")
    ] = None,
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Name of these plans in the results.")
    ] = "bundled",
    check: Annotated[list[Check] | None, typer.Option(help="Only this check; repeatable.")] = None,
    referees: Annotated[
        str,
        typer.Option(
            metavar="NAMES", help="Names of referees, separated by commas; the first one simulates every plan."
        ),
    ] = "",
    smallest: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Number of plans, those with the fewest boxes.")
    ] = None,
    reference: Annotated[
        bool, typer.Option(help="Also count the plans that only the physics reference calls unstable.")
    ] = False,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Plans in other simulators: does any of petmjx's verdicts stand alone? Needs the extra "referees"."""
    from benchmarks.crossengine import Court, by_softness, summaries
    from benchmarks.referees.referee import REFEREES, referee
    from benchmarks.result_fields import append_line, environment
    from petmjx.options.run_options import RunOptions
    from petmjx.options.simulation import Simulation
    from petmjx.plans.bundled import bundled_path

    chosen = [referee(word) for word in words(referees) or REFEREES]
    chosen_plans = usable(plans or [bundled_path()], RunOptions(**options))
    chosen_plans = sorted(chosen_plans, key=lambda plan: plan.n_boxes)[:smallest] if smallest else chosen_plans
    options.pop("limit", None)
    for check_kind in check or list(Check):
        court = Court(chosen, Simulation(check=check_kind))
        judged = []
        for one in court.judge(chosen_plans, **options):
            judged.append(one)
            if one.trial.verdicts != {one.trial.ours}:
                print(one.record(), file=sys.stderr, flush=True)
        case = {
            "case": f"crossengine-{name}-{check_kind.value}",
            "group": "crossengine",
            "set": name,
            "check": check_kind.value,
        }
        lines = [*summaries(judged, court)]
        if reference:
            lines.append(by_softness(judged, chosen_plans, check_kind, **options))
        for line in lines:
            append_line(out, {**case, **line, **environment()})
            summary = {key: value for key, value in line.items() if key not in ("settings", "differ")}
            print(f"{name}, {check_kind.value}: {summary}", flush=True)


@app.command("cross-forces")
def cross_forces(
    referees: Annotated[str, typer.Option(metavar="NAMES", help="With commas; default: all.")] = "",
    out: Out = DEFAULT_OUT,
) -> None:
    """Forces on boxes of small piles, in other simulators and by statics. Needs the extra "referees"."""
    from benchmarks.referees.referee import REFEREES, referee
    from benchmarks.result_fields import append_line, environment
    from benchmarks.stack_forces import differences

    for line in differences({word: referee(word) for word in words(referees) or REFEREES}):
        append_line(out, {"case": "cross-forces", "group": "crossengine", "engine": "mujoco", **line, **environment()})
        shares = {who: f"{100 * share:.2g} %" for who, share in line["differs"].items()}
        print(f"{line['pile']}, {line['check']}: {shares}", flush=True)
