"""Studies of results: drift, sensitivity, criteria, statics, soft boxes, packers, training, reality and repairs."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any, Final, cast

import typer

from benchmarks.commands.app import DEFAULT_OUT, Out, app, known, make_folder, usable
from petmjx.cli import command_options as opt
from petmjx.results.to_json import to_json
from petmjx.runs.option_types import EngineName

DATA: Final = Path(__file__).resolve().parents[3] / "shared" / "data" / "reality"
"""Default folder of measurements, beside the checkout."""


@app.command()
@opt.takes("limit", "threads")
def drift(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    variant: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this variant; repeatable.")] = None,
    begin: Annotated[float, typer.Option(metavar="S", help="After settling.")] = 10.0,
    end: Annotated[float, typer.Option(metavar="S", help="After settling.")] = 60.0,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for a Parquet table of all boxes.")] = None,
    **options: Any,
) -> None:
    """How fast the boxes of resting pallets drift, and why."""
    from benchmarks.drift import VARIANTS, Window, describe, summaries
    from petmjx.common.machine import cpu_threads
    from petmjx.options.run_options import RunOptions

    limits, window = RunOptions(**options), Window(begin, end)
    chosen = known(variant or list(VARIANTS), VARIANTS, "variant")
    plan_list = usable(plans, limits)
    make_folder(out)
    for name, check, table in summaries(plan_list, chosen, window, limits.threads or cpu_threads()):
        print(f"{name}, {check}: {describe(table)}", flush=True)
        if out is not None:
            table.to_parquet(out / f"{list(VARIANTS).index(name):02}-{check}.parquet")


@app.command()
@opt.takes("limit", "lanes", "threads")
def sensitivity(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    change: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this change; repeatable.")] = None,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mujoco",
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for Parquet tables of all worlds.")] = None,
    **options: Any,
) -> None:
    """How many verdicts change with timestep, tolerance, friction, sizes, masses, …"""
    from benchmarks.sensitivity import CHANGES, describe
    from benchmarks.sensitivity import sensitivity as runs
    from petmjx.options.run_options import RunOptions

    chosen = known(change or list(CHANGES), CHANGES, "change")
    plan_list = usable(plans, RunOptions(**options))
    options.pop("limit", None)
    make_folder(out)
    for number, (name, before, after) in enumerate(runs(plan_list, chosen, engine=engine, **options)):
        print(f"{name}: {describe(before, after)}", flush=True)
        if out is not None:
            for side, table in (("before", before), ("after", after)):
                table.to_parquet(out / f"{number:02}-{side}.parquet")


@app.command()
def criteria(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    of: Annotated[Path, typer.Option("--run", metavar="DIR", help="Results of petmjx score of these plans.")],
    into: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown file whose tables are replaced; else printed.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the tables of all boxes and plans.")
    ] = None,
    processes: Annotated[
        int | None, typer.Option(metavar="N", help="Number of processes; by default that of the CPU threads.")
    ] = None,
) -> None:
    """Agreement of closed-form criteria of stability with physics (docs/criteria.md)."""
    from benchmarks.criteria_study import BEGIN, END, study
    from benchmarks.result_tables import write_between_markers
    from petmjx.analysis.criteria_run import criteria as ask
    from petmjx.common.machine import cpu_threads
    from petmjx.results.run_reader import load_run

    physics = load_run(of)
    results = ask(list(plans), run=physics, out=out, overwrite=True, processes=processes or cpu_threads())
    text = study(results, physics)
    if into is None:
        print(text)
    else:
        write_between_markers(into, text, BEGIN, END)


@app.command("small-stacks")
@opt.takes("threads")
def small_stacks(
    count: Annotated[int, typer.Option("--count", "-n", metavar="N", min=1, help="Stacks.")] = 3000,
    seed: Annotated[int, typer.Option(metavar="N", help="Other stacks.")] = 0,
    check: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this check; repeatable.")] = None,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mujoco",
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Stacks of two to six boxes that statics decides, and petmjx's verdicts."""
    from benchmarks.result_fields import append_line, environment, timed
    from benchmarks.small_stacks import CHECKS, cases, judge, summary

    stacks = list(cases(count, seed))
    for name in known(check or list(CHECKS), CHECKS, "check"):
        with timed() as clock:
            counts = summary(judge(stacks, name, engine=engine, **options))
        print(f"{name}: {counts}", flush=True)
        case = {"case": f"small-stacks-{name.replace(' ', '-')}", "group": "small-stacks", "engine": engine}
        append_line(out, {**case, "seed": seed, **counts, "cpu_s": clock.cpu_s, **environment()})


@app.command()
@opt.takes("limit")
def balance(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    of: Annotated[Path, typer.Option("--run", metavar="DIR", help="Results of petmjx score of these plans.")],
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Whether the worlds that a run calls stable balance at their places of rest."""
    from benchmarks.rest_balance import balances, summary
    from benchmarks.result_fields import append_line, environment, timed
    from petmjx.options.run_options import RunOptions
    from petmjx.options.simulation import Simulation
    from petmjx.results.run_reader import load_run

    run = load_run(of)
    with timed() as clock:
        sim = Simulation(**run.info["config"]["simulation"])
        counts = summary(balances(usable(plans, RunOptions(**options)), run, sim))
    print(counts)
    engine = str(run.info["config"]["engine"])
    append_line(
        out, {"case": "balance", "group": "balance", "engine": engine, **counts, "cpu_s": clock.cpu_s, **environment()}
    )


@app.command()
def flex(out: Out = DEFAULT_OUT) -> None:
    """How deep a load sinks into a box that gives, by the contact law and as a flex body; stacks both ways."""
    from itertools import chain

    from benchmarks.flex import compared, piles, stacks
    from benchmarks.result_fields import append_line

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


@app.command("packers")
@opt.takes("engine", "threads")
def packers(
    n: Annotated[int, typer.Option("-n", metavar="N", help="Drawn orders; 0: none.")] = 100,
    seed: Annotated[int, typer.Option("--seed", metavar="SEED", help="Of drawn orders.")] = 11,
    orders: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="A further set of orders: a file of BED-BPP, one of RoboBPP's sets, or a table."
        ),
    ] = None,
    worlds: Annotated[int, typer.Option(metavar="N", help="Number of worlds with errors of each plan.")] = 8,
    judged: Annotated[
        int, typer.Option(metavar="N", help="Number of orders of each set whose plans are simulated.")
    ] = 100,
    physical: Annotated[
        int, typer.Option(metavar="N", help="Number of orders of each set that the packer physical packs.")
    ] = 100,
    shaken: Annotated[
        int, typer.Option(metavar="N", help="Number of orders of each set whose plans are shaken.")
    ] = 100,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Name of a packer; all packers if none is named.")
    ] = None,
    other: Annotated[
        list[str] | None, typer.Option(metavar="NAME=FILE", help="Plans of another packer, for some of the orders.")
    ] = None,
    weights: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Policy of the packer learned, instead of the published policy.")
    ] = None,
    workers: Annotated[int | None, typer.Option(metavar="N", help="Processes that pack.")] = None,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """How dense, sure and firm the plans of packers are, on the same orders (docs/packers.md)."""
    from benchmarks.packer_study import StudySettings, read_set, study
    from benchmarks.result_fields import append_line
    from petmjx.common.machine import cpu_threads
    from petmjx.packers.learned_packer import Policy
    from petmjx.packers.pack import orders_of

    sets = {f"seed {seed}": list(orders_of(None, n, seed))} if n else {}
    for path in orders or ():
        sets[path.name] = list(read_set(path) if path.suffix in (".xlsx", ".txt", ".csv") else orders_of(path, None, 0))
    settings = StudySettings(
        judged=judged,
        physical=physical,
        worlds=worlds,
        shaken=shaken,
        only=only or None,
        others={name: Path(path) for name, _, path in (text.partition("=") for text in other or ())},
        policy=None if weights is None else Policy.load(weights),
        workers=workers or cpu_threads(),
        engine=options.get("engine", "auto"),
        threads=options.get("threads"),
    )
    for line in study(sets, settings):
        append_line(out, line)
        for part in ("packers", "differences"):
            for name, row in line[part].items():
                print(f"{line['source']}: {name}: {row}")
        print(line["from_best_to_worst"], line["as_many_boxes_as_balanced"])


@app.command()
def training(
    out_dir: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the policies and their plans.")],
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mjx-warp",
    seeds: Annotated[int, typer.Option(metavar="N", min=1, help="Seeds, side by side.")] = 3,
    pallets: Annotated[int, typer.Option(metavar="N", min=1, help="Pallets of each seed.")] = 1024,
    boxes: Annotated[int, typer.Option(metavar="N", min=1, help="Largest number of boxes of a pallet.")] = 80,
    packed: Annotated[
        int, typer.Option(metavar="N", min=1, help="Number of held-out orders whose plans are written.")
    ] = 200,
    most_s: Annotated[float, typer.Option(metavar="S", help="Training ends after this time.")] = 400.0,
    out: Out = DEFAULT_OUT,
) -> None:
    """Curves of the recipe in JAX, with held-out orders, and plans for python -m benchmarks packers --other."""
    from benchmarks.result_fields import append_line, environment
    from benchmarks.training_curves import Training, train

    of = Training(engine, seeds=seeds, pallets=pallets, boxes=boxes, packed=packed, most_s=most_s)
    result = train(of, out_dir, lambda line: print(line, flush=True))
    append_line(out, {"case": "train-in-jax", **result, **environment()})
    print(f"{out_dir}: policies.npz, plans-0.json …; mean returns {result['returns']}")


@app.command()
def reality(
    data: Annotated[
        Path, typer.Option(metavar="PATH", help="Folder with the file of tosses, or that file itself.")
    ] = DATA,
    part: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this part; repeatable.")] = None,
    engine: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Engine; repeatable.")] = None,
    tosses: Annotated[int | None, typer.Option(metavar="N", min=8, help="Number of tosses, the first ones.")] = None,
    write: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown file whose table is replaced; else printed.")
    ] = None,
    out: Out = DEFAULT_OUT,
) -> None:
    """Measurements, petmjx's values, and the differences (docs/reality-measured.md)."""
    from benchmarks.reality import BEGIN, END, PARTS, TOSSES, gallery, present, table
    from benchmarks.result_fields import append_line
    from benchmarks.result_tables import write_between_markers
    from petmjx.engines.engine_registry import check_options

    engines = engine or ["mujoco"]
    for name in engines:
        check_options(name)
    all_parts = {TOSSES: "", **PARTS}
    parts = known(part or [name for name in all_parts if present(name)], all_parts, "part")
    results = []
    for result in gallery(parts, engines, data, tosses):
        append_line(out, result)
        results.append(result)
        print(f"{result['case']}, {result['engine']}: {len(result['rows'])} rows", file=sys.stderr, flush=True)
    if write is None:
        print(table(results))
    else:
        write_between_markers(write, table(results), BEGIN, END)


@app.command()
@opt.takes("engine", "threads")
def repair(
    plans: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[PLANS...]", help="Third-party plans; one box of each plan is moved so that the plan falls."
        ),
    ] = None,
    n: Annotated[int, typer.Option(metavar="N", help="Plans at most.")] = 60,
    seed: Annotated[int, typer.Option(metavar="SEED", help="Seed of the generated plans, or of the moves.")] = 0,
    least_boxes: Annotated[int, typer.Option(metavar="N", help="Of a generated plan.")] = 1,
    most_boxes: Annotated[int, typer.Option(metavar="N", help="Of a plan.")] = 512,
    worlds: Annotated[int, typer.Option(metavar="N", help="Worlds with errors.")] = 8,
    most_s: Annotated[float, typer.Option(metavar="S", help="Time after which no further plan is begun.")] = 1e9,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to which a line of JSON is appended for each plan.")
    ] = None,
    **options: Any,
) -> None:
    """How many plans that fall can be repaired, with how many changes, and how long it takes."""
    import time
    from itertools import islice

    from benchmarks.repair_study import describe, disturbed, generated, repaired_rows, share_of
    from petmjx.options.run_options import RunOptions

    begin, rows = time.monotonic(), []
    neighbours: list[Any] = []
    if plans:
        small = [plan for plan in usable(plans, RunOptions()) if plan.n_boxes <= most_boxes]
        chosen: Any = islice(disturbed(small, seed, **options), n)
    else:
        chosen, neighbours = generated(n, seed, (least_boxes, most_boxes), **options)
    for row, result in repaired_rows(chosen, worlds=worlds, **options):
        rows.append(row)
        seconds = f"{row['wall_s']:.0f} s, {row['trials']} trials"
        print(f"{result.headline} ({seconds}): {'; '.join(result.words)}", flush=True)
        if out is not None:
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(to_json(row)) + "\n")
        if time.monotonic() - begin > most_s:
            break
    print(describe(rows))
    if worlds and neighbours:
        print(f"plans of the same seed that stand as they are: {share_of(neighbours, worlds, **options)}")
