"""Speed: the cost of kinds of worlds on each engine, of environments, of large sweeps and of a packer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.commands.app import DEFAULT_OUT, Out, app, known, usable
from petmjx.cli import command_options as opt
from petmjx.options.placing import Way


@app.command()
@opt.takes("limit", "lanes", "threads", "carrier")
def placing(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    way: Annotated[list[Way] | None, typer.Option(metavar="NAME", help="Only this placing; repeatable.")] = None,
    worlds: Annotated[int, typer.Option(metavar="N", help="Number of worlds with errors of each plan.")] = 16,
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
    from benchmarks.result_fields import append_line
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
    from benchmarks.result_fields import append_line
    from petmjx.options.run_options import RunOptions

    limit = RunOptions(**options).limit
    plan_list = [plan for plan in usable(plans, RunOptions()) if plan.n_boxes >= least][:limit]
    line = compared(plan_list, threads, group)
    append_line(out, line)
    print({name: value for name, value in line.items() if name not in ("cpu", "versions")})


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
    """Speed of physics in the loop: candidates per second, time of one candidate, placing compared with scoring,
    memory."""
    from benchmarks.pallets_speed import CASES, Loop, measured
    from benchmarks.result_fields import append_line, environment
    from petmjx.engines.engine_registry import make_engine
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
    """Compares petmjx's estimates of time with real times, for runs of many kinds and sizes."""
    from benchmarks.result_fields import append_line
    from benchmarks.time_estimates import cases, compared
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
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the run and its report.")],
    plans: Annotated[int, typer.Option(metavar="N", min=1, help="Number of plans, of 10 to 14 boxes each.")] = 1000,
    variants: Annotated[int, typer.Option(metavar="N", min=2, help="Worlds of each.")] = 1000,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine; instant: answers at once.")] = "instant",
    kill_at: Annotated[float, typer.Option(metavar="SHARE", min=0, max=0.99, help="Worlds before the kill.")] = 0.5,
    placing: Annotated[str, typer.Option(metavar="exact|hand", help="How boxes come to their places.")] = "exact",
    keep: Annotated[str, typer.Option(metavar="all|worlds", help="Tables that are kept.")] = "worlds",
    threads: Annotated[int | None, typer.Option(metavar="N", help="CPU threads of the engine.")] = None,
    workers: Annotated[str | None, typer.Option(metavar="N|auto", help="Processes that simulate.")] = None,
    out: Out = DEFAULT_OUT,
) -> None:
    """A sweep of a million small worlds, which is killed and resumed: time per world, memory, tables, report."""
    from benchmarks.million_worlds import Million, measured
    from benchmarks.result_fields import append_line, environment

    given = {"keep": keep, "threads": threads, "workers": workers}
    options = {name: value for name, value in given.items() if value is not None}
    case = Million(folder, plans, variants, engine, kill_at, placing, tuple(options.items()))
    for line in measured(case):
        append_line(out, {**line, **environment()})
        print(line, flush=True)


@app.command("physical")
@opt.takes("engine", "threads", "lanes")
def physical_speed(
    n: Annotated[int, typer.Option("-n", metavar="N", min=1, help="Drawn orders.")] = 8,
    seed: Annotated[int, typer.Option("--seed", metavar="SEED", help="Of drawn orders.")] = 33,
    searched: Annotated[
        int, typer.Option(metavar="N", help="Number of orders for which the search alone is measured.")
    ] = 30,
    workers: Annotated[int | None, typer.Option(metavar="N", help="Processes that search.")] = None,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """How fast the packer physical is."""
    from benchmarks.physical_speed import packing_speed, search_speed
    from benchmarks.result_fields import append_line, environment
    from petmjx.common.machine import cpu_threads
    from petmjx.packers.pack import orders_of

    how = {name: value for name, value in options.items() if value is not None}
    parts: dict[str, Any] = {}
    if searched:
        parts["search"] = search_speed(list(orders_of(None, searched, seed)))
    parts["packing"] = packing_speed(list(orders_of(None, n, seed)), workers or cpu_threads(), how)
    for name, part in parts.items():
        print(f"{name}: {part}", flush=True)
    case = {"case": "packer-physical", "engine": how.get("engine", "auto"), "seed": seed}
    append_line(out, {**case, **parts, **environment()})
