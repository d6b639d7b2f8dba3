"""Commands that measure the cost of several kinds of worlds, and the agreement of engines."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, cast

import typer

from benchmarks.commands.app import DEFAULT_OUT, Out, app, known, usable
from petmjx.cli import command_options as opt
from petmjx.options.placing import Way
from petmjx.runs.option_types import EngineName


@app.command()
@opt.takes("limit", "lanes", "threads", "carrier")
def placing(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    way: Annotated[list[Way] | None, typer.Option(metavar="NAME", help="Only this placing; repeatable.")] = None,
    worlds: Annotated[int, typer.Option(metavar="N", help="Worlds with errors of each plan.")] = 16,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mujoco",
    **options: Any,
) -> None:
    """Cost of worlds with errors, and shares that stand, if boxes appear at their places and if a hand carries them."""
    from benchmarks.placing import WAYS, placings
    from petmjx.options.run_options import RunOptions

    limit = {"limit": options.pop("limit")} if "limit" in options else {}
    plan_list = usable(plans, RunOptions(**limit))
    for name, values in placings(plan_list, worlds, way or WAYS, engine=engine, **options):
        print(f"{name}: {', '.join(f'{quantity} {value:g}' for quantity, value in values.items())}", flush=True)


@app.command("real-boxes")
@opt.takes("limit", "lanes", "threads")
def real_boxes(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mjx-warp",
    oracle: Annotated[str, typer.Option(metavar="NAME", help="Engine to compare with.")] = "mujoco",
    soft: Annotated[bool, typer.Option(help="Boxes have the stiffness of their materials, too.")] = False,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Plans of boxes of three materials on epal-1, set down by tines: do two engines agree?"""
    from benchmarks.real_boxes import compared
    from benchmarks.record import append_line
    from petmjx.options.run_options import RunOptions

    limit = {"limit": options.pop("limit")} if "limit" in options else {}
    plan_list = usable(plans, RunOptions(**limit))
    line = compared(plan_list, engine, oracle, gives=soft, **options)
    append_line(out, line)
    print({name: value for name, value in line.items() if name not in ("cpu", "versions")})


@app.command("cpu-engines")
@opt.takes("limit")
def cpu_engines(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    threads: Annotated[int, typer.Option(metavar="N", help="CPU threads.")] = 1,
    least: Annotated[int, typer.Option(metavar="N", help="Plans of at least this many boxes.")] = 0,
    group: Annotated[str, typer.Option(metavar="NAME", help="Kind of the plans.")] = "",
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """C MuJoCo against the kernels of mjx-warp on CPU threads: time and verdicts."""
    from benchmarks.cpu_engines import compared
    from benchmarks.record import append_line
    from petmjx.options.run_options import RunOptions

    limit = RunOptions(**options).limit
    plan_list = [plan for plan in usable(plans, RunOptions()) if plan.n_boxes >= least][:limit]
    line = compared(plan_list, threads, group)
    append_line(out, line)
    print({name: value for name, value in line.items() if name not in ("cpu", "versions")})


@app.command()
def flex(out: Out = DEFAULT_OUT) -> None:
    """How deep a load sinks into a box that gives, by the contact law and as a flex body; stacks both ways."""
    from itertools import chain

    from benchmarks.flex import compared, piles, stacks
    from benchmarks.record import append_line

    for line in chain(compared(), stacks(), (piles() for _ in range(1))):
        append_line(out, line)
        print({name: value for name, value in line.items() if name not in ("cpu", "versions")}, flush=True)


@app.command(name="soft-columns")
def soft_columns(
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mujoco",
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Columns.")] = 40,
    seed: Annotated[int, typer.Option(metavar="N", help="Which columns are drawn.")] = 55,
    threads: Annotated[int, typer.Option(metavar="N", help="CPU threads.")] = 1,
) -> None:
    """Columns of boxes that give, against the bed of springs: buckling, and the lean of standing columns."""
    from benchmarks.soft_columns import compared

    for line in compared(cast(EngineName, engine), count, seed, threads):
        print(line, flush=True)


@app.command()
@opt.takes("lanes", "threads")
def loop(
    names: Annotated[list[str] | None, typer.Argument(metavar="CASES...", help="Cases; default: all.")] = None,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mujoco",
    plans: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of generated samples.")] = None,
    pallets: Annotated[int, typer.Option(metavar="N", min=1, help="Pallets.")] = 1024,
    candidates: Annotated[int, typer.Option(metavar="N", min=1, help="Candidates of each pallet.")] = 16,
    count: Annotated[int, typer.Option(metavar="N", min=1, help="Plans placed, placements, or episodes.")] = 2000,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Physics in the loop: candidates a second, one candidate's time, placing against scoring, memory."""
    from benchmarks.loop import CASES, Loop, measured
    from benchmarks.record import append_line, environment
    from petmjx.engines.engine_choice import make_engine
    from petmjx.options.run_options import RunOptions

    chosen = known(names or list(CASES), CASES, "case")
    plan_list = None if plans is None else usable([plans], RunOptions())
    case = Loop(make_engine(engine, **options), plan_list, pallets, candidates, count)
    for line in measured(case, chosen):
        append_line(out, {**line, **environment()})
        print(line, flush=True)


@app.command()
@opt.takes("limit")
def estimates(
    plans: Annotated[
        list[Path] | None, typer.Argument(metavar="PLANS...", help="Plan files scored beside generated plans.")
    ] = None,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mjx-warp-cpu",
    threads: Annotated[int, typer.Option(metavar="N", help="CPU threads.")] = 1,
    only: Annotated[list[str] | None, typer.Option(metavar="WHAT", help="Only runs of this kind; repeatable.")] = None,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """petmjx's estimates for runs of many kinds and sizes, and their real times."""
    from benchmarks.estimates import cases, compared
    from benchmarks.record import append_line
    from petmjx.options.run_options import RunOptions

    given = usable(plans, RunOptions(**options)) if plans else ()
    kinds = known(only or [], dict.fromkeys(kind for kind, *_ in cases()), "kind of run")
    for line in compared(engine, threads, given, kinds):
        append_line(out, line)
        ratio = line["estimate_s"] / line["cpu_s"]
        print(
            f"{line['what']:<16}{line['plans']:<8}{line['cpu_s']:>8.1f} s, estimated {line['estimate_s']:>8.1f} s "
            f"({ratio:.2f}); steps {line['steps_estimate'] / line['steps']:.2f}",
            flush=True,
        )


@app.command()
def million(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where the run and its report are written.")],
    plans: Annotated[int, typer.Option(metavar="N", min=1, help="Plans of 10 to 14 boxes.")] = 1000,
    variants: Annotated[int, typer.Option(metavar="N", min=2, help="Worlds of each.")] = 1000,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine; instant: answers at once.")] = "instant",
    kill_at: Annotated[float, typer.Option(metavar="SHARE", min=0, max=0.99, help="Worlds before the kill.")] = 0.5,
    placing: Annotated[str, typer.Option(metavar="exact|hand", help="How boxes come to their places.")] = "exact",
    keep: Annotated[str, typer.Option(metavar="all|worlds", help="Tables that are kept.")] = "worlds",
    threads: Annotated[int | None, typer.Option(metavar="N", help="CPU threads of the engine.")] = None,
    workers: Annotated[str | None, typer.Option(metavar="N|auto", help="Processes that simulate.")] = None,
    out: Out = DEFAULT_OUT,
) -> None:
    """A sweep of a million small worlds, killed and resumed: time for each, memory, tables, report."""
    from benchmarks.million import Million, measured
    from benchmarks.record import append_line, environment

    given = {"keep": keep, "threads": threads, "workers": workers}
    options = {name: value for name, value in given.items() if value is not None}
    case = Million(folder, plans, variants, engine, kill_at, placing, tuple(options.items()))
    for line in measured(case):
        append_line(out, {**line, **environment()})
        print(line, flush=True)
