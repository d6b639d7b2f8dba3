"""The benchmarks' command line: ``python -m benchmarks list | run | agreement | table | drift | sensitivity | placing |
real-boxes | flex | criteria | small-stacks | balance | crossengine | cross-forces | loop``."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import options as opt
from petmjx.cli.main import run_app
from petmjx.config import Check, Schedule
from petmjx.errors import InputError
from petmjx.placing import Way
from petmjx.text import counted

if TYPE_CHECKING:
    from benchmarks.record import Result
    from petmjx.plans.plan import Plan
    from petmjx.run_options import RunOptions

app = typer.Typer(
    help="Measures speed and agreement; benchmarks/README.md says what and how.",
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["--help", "-h"]},
)

Out = Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Results are appended here, a JSON line each.")]
DEFAULT_OUT = Path("petmjx-results/bench.jsonl")


@app.command("list")
def list_cases() -> None:
    """List the cases by group."""
    from benchmarks.cases import GROUPS

    for group, cases in GROUPS.items():
        print(group)
        for case in cases:
            print(f"    {case.name:<28}{case.text}")


@app.command()
@opt.takes("limit", "threads")
def drift(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    variant: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this variant; repeatable.")] = None,
    begin: Annotated[float, typer.Option(metavar="S", help="After settling.")] = 10.0,
    end: Annotated[float, typer.Option(metavar="S", help="After settling.")] = 60.0,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Keeps a Parquet table of all boxes.")] = None,
    **options: Any,
) -> None:
    """How fast the boxes of resting pallets drift, and why."""
    from benchmarks.drift import VARIANTS, Window, describe, summaries
    from petmjx.machine import cpu_threads
    from petmjx.run_options import RunOptions

    limits, window = RunOptions(**options), Window(begin, end)
    chosen = _known(variant or list(VARIANTS), VARIANTS, "variant")
    found = _usable(plans, limits)
    _make_folder(out)
    for name, check, table in summaries(found, chosen, window, limits.threads or cpu_threads()):
        print(f"{name}, {check}: {describe(table)}", flush=True)
        if out is not None:
            table.to_parquet(out / f"{list(VARIANTS).index(name):02}-{check}.parquet")


@app.command()
@opt.takes("limit", "lanes", "threads")
def sensitivity(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    change: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this change; repeatable.")] = None,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mujoco",
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Keeps Parquet tables of all worlds.")] = None,
    **options: Any,
) -> None:
    """How many verdicts change with timestep, tolerance, friction, sizes, masses, …"""
    from benchmarks.sensitivity import CHANGES, describe
    from benchmarks.sensitivity import sensitivity as runs
    from petmjx.run_options import RunOptions

    chosen = _known(change or list(CHANGES), CHANGES, "change")
    found = _usable(plans, RunOptions(**options))
    options.pop("limit", None)
    _make_folder(out)
    for number, (name, before, after) in enumerate(runs(found, chosen, engine=engine, **options)):
        print(f"{name}: {describe(before, after)}", flush=True)
        if out is not None:
            for side, table in (("before", before), ("after", after)):
                table.to_parquet(out / f"{number:02}-{side}.parquet")


@app.command()
@opt.takes("limit", "lanes", "threads", "carrier")
def placing(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    way: Annotated[list[Way] | None, typer.Option(metavar="NAME", help="Only this placing; repeatable.")] = None,
    worlds: Annotated[int, typer.Option(metavar="N", help="Worlds with errors of each plan.")] = 16,
    engine: Annotated[str, typer.Option(metavar="NAME", help="Engine.")] = "mujoco",
    **options: Any,
) -> None:
    """What worlds with errors cost, and how many stand, if boxes appear at their places and if a hand carries them."""
    from benchmarks.placing import WAYS, placings
    from petmjx.run_options import RunOptions

    limit = {"limit": options.pop("limit")} if "limit" in options else {}
    found = _usable(plans, RunOptions(**limit))
    for name, values in placings(found, worlds, way or WAYS, engine=engine, **options):
        print(f"{name}: {', '.join(f'{what} {value:g}' for what, value in values.items())}", flush=True)


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
    from petmjx.run_options import RunOptions

    limit = {"limit": options.pop("limit")} if "limit" in options else {}
    found = _usable(plans, RunOptions(**limit))
    line = compared(found, engine, oracle, gives=soft, **options)
    append_line(out, line)
    print({name: value for name, value in line.items() if name not in ("cpu", "versions")})


@app.command("cpu-engines")
@opt.takes("limit")
def cpu_engines(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    threads: Annotated[int, typer.Option(metavar="N", help="CPU threads.")] = 1,
    least: Annotated[int, typer.Option(metavar="N", help="Plans of so many boxes and more.")] = 0,
    group: Annotated[str, typer.Option(metavar="NAME", help="What the plans are.")] = "",
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """C MuJoCo against the kernels of mjx-warp on CPU threads: time and verdicts."""
    from benchmarks.cpu_engines import compared
    from benchmarks.record import append_line
    from petmjx.run_options import RunOptions

    limit = RunOptions(**options).limit
    found = [plan for plan in _usable(plans, RunOptions()) if plan.n_boxes >= least][:limit]
    line = compared(found, threads, group)
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


@app.command()
def criteria(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    of: Annotated[Path, typer.Option("--run", metavar="DIR", help="Results of petmjx score of these plans.")],
    into: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown file whose tables are replaced; else printed.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Keeps the tables of all boxes and plans.")] = None,
    processes: Annotated[int | None, typer.Option(metavar="N", help="Processes; by default all CPU threads.")] = None,
) -> None:
    """Which closed-form criterion of stability tells what physics tells (docs/criteria.md)."""
    from benchmarks.criteria_study import BEGIN, END, study
    from benchmarks.table import write_between_markers
    from petmjx.machine import cpu_threads
    from petmjx.results.reader import load_run
    from petmjx.statics.run import criteria as ask

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
    """Stacks of two to six boxes that statics decides, and what petmjx says of them."""
    from benchmarks.record import append_line, environment, timed
    from benchmarks.small_stacks import CHECKS, cases, judge, summary

    found = list(cases(count, seed))
    for name in _known(check or list(CHECKS), CHECKS, "check"):
        with timed() as clock:
            told = summary(judge(found, name, engine=engine, **options))
        print(f"{name}: {told}", flush=True)
        case = {"case": f"small-stacks-{name.replace(' ', '-')}", "group": "small-stacks", "engine": engine}
        append_line(out, {**case, "seed": seed, **told, "cpu_s": clock.cpu_s, **environment()})


@app.command()
@opt.takes("limit")
def balance(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS...", help="Plan files.")],
    of: Annotated[Path, typer.Option("--run", metavar="DIR", help="Results of petmjx score of these plans.")],
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Whether the worlds that a run calls stable balance where they have come to rest."""
    from benchmarks.balance import balances, summary
    from benchmarks.record import append_line, environment, timed
    from petmjx.config import Simulation
    from petmjx.results.reader import load_run
    from petmjx.run_options import RunOptions

    run = load_run(of)
    with timed() as clock:
        sim = Simulation(**run.info["config"]["simulation"])
        told = summary(balances(_usable(plans, RunOptions(**options)), run, sim))
    print(told)
    engine = str(run.info["config"]["engine"])
    append_line(
        out, {"case": "balance", "group": "balance", "engine": engine, **told, "cpu_s": clock.cpu_s, **environment()}
    )


@app.command()
@opt.takes("limit", "threads")
def crossengine(
    plans: Annotated[
        list[Path] | None, typer.Argument(metavar="PLANS...", help="Plan files; default: bundled.")
    ] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="Of these plans, for results.")] = "bundled",
    check: Annotated[list[Check] | None, typer.Option(help="Only this check; repeatable.")] = None,
    referees: Annotated[str, typer.Option(metavar="NAMES", help="With commas; the first is the sieve.")] = "",
    smallest: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Only the plans with the fewest boxes.")
    ] = None,
    reference: Annotated[bool, typer.Option(help="Also physics reference: what it alone calls unstable.")] = False,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Plans in other simulators: does any of petmjx's verdicts stand alone? Needs the extra "referees"."""
    from benchmarks.crossengine import Court, by_softness, summaries
    from benchmarks.record import append_line, environment
    from benchmarks.referees.base import REFEREES, referee
    from petmjx.config import Simulation
    from petmjx.plans.samples import bundled_path
    from petmjx.run_options import RunOptions

    asked = [referee(each) for each in _words(referees) or REFEREES]
    found = _usable(plans or [bundled_path()], RunOptions(**options))
    found = sorted(found, key=lambda plan: plan.n_boxes)[:smallest] if smallest else found
    options.pop("limit", None)
    for each in check or list(Check):
        court = Court(asked, Simulation(check=each))
        judged = []
        for one in court.judge(found, **options):
            judged.append(one)
            if one.trial.verdicts != {one.trial.ours}:
                print(one.record(), file=sys.stderr, flush=True)
        case = {"case": f"crossengine-{name}-{each.value}", "group": "crossengine", "set": name, "check": each.value}
        lines = [*summaries(judged, court)]
        if reference:
            lines.append(by_softness(judged, found, each, **options))
        for line in lines:
            append_line(out, {**case, **line, **environment()})
            told = {key: value for key, value in line.items() if key not in ("settings", "differ")}
            print(f"{name}, {each.value}: {told}", flush=True)


@app.command("cross-forces")
def cross_forces(
    referees: Annotated[str, typer.Option(metavar="NAMES", help="With commas; default: all.")] = "",
    out: Out = DEFAULT_OUT,
) -> None:
    """Forces on boxes of small piles, in other simulators and by statics. Needs the extra "referees"."""
    from benchmarks.record import append_line, environment
    from benchmarks.referees.base import REFEREES, referee
    from benchmarks.stack_forces import differences

    for line in differences({each: referee(each) for each in _words(referees) or REFEREES}):
        append_line(out, {"case": "cross-forces", "group": "crossengine", "engine": "mujoco", **line, **environment()})
        told = {who: f"{100 * share:.2g} %" for who, share in line["differs"].items()}
        print(f"{line['pile']}, {line['check']}: {told}", flush=True)


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
    from petmjx.engines.choose import make_engine
    from petmjx.run_options import RunOptions

    chosen = _known(names or list(CASES), CASES, "case")
    found = None if plans is None else _usable([plans], RunOptions())
    case = Loop(make_engine(engine, **options), found, pallets, candidates, count)
    for line in measured(case, chosen):
        append_line(out, {**line, **environment()})
        print(line, flush=True)


@app.command()
@opt.takes("limit", "lanes", "threads")
def run(
    names: Annotated[list[str], typer.Argument(metavar="CASES...", help="Cases, or groups of them.")],
    engine: Annotated[str, typer.Option(metavar="NAMES", help="Engines, several with commas.")] = "mujoco",
    plans: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of generated samples.")] = None,
    skip: Annotated[int, typer.Option(metavar="N", min=0, help="Leave out the first N plans.")] = 0,
    max_seconds: Annotated[float | None, typer.Option(metavar="S", help="Cut runs off (plain loops: 60 s).")] = None,
    repeat: Annotated[int, typer.Option(metavar="N", min=1, help="Run all N times, in turns.")] = 1,
    oracle: Annotated[str, typer.Option(metavar="NAMES", help="Run and compare with mujoco-fixed, …")] = "",
    against: Annotated[list[str] | None, typer.Option(metavar="LABEL=DIR,…", help="Compare with earlier runs.")] = None,
    work: Annotated[Path | None, typer.Option(metavar="DIR", help="Keeps what runs write.")] = None,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Run cases and append a line of results each."""
    import tempfile

    from benchmarks.cases import chosen_cases
    from benchmarks.measure import Bench
    from benchmarks.record import append_line

    bench = Bench(
        work=work or Path(tempfile.mkdtemp(prefix="petmjx-bench-")),
        plans=plans,
        skip=skip,
        max_seconds=max_seconds,
        repeat=repeat,
        oracles=[_oracle_schedule(name) for name in _words(oracle)],
        against=dict(_labelled(entry) for entry in against or ()),
        say=lambda text: print(text, file=sys.stderr, flush=True),
        **options,
    )
    for result in bench.run(chosen_cases(names), _words(engine)):
        append_line(out, result)
        print(_brief(result), flush=True)
    print(f"results in {out}, runs in {bench.work}", file=sys.stderr)


@app.command("agreement")
def compare(
    oracle: Annotated[str, typer.Option(metavar="LABEL=DIR,…", help="The reference run: its label and folders.")],
    runs: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of the run that is judged.")],
    case: Annotated[str, typer.Option(metavar="NAME", help="Name of the case, for the tables.")],
    out: Out = DEFAULT_OUT,
) -> None:
    """Compare runs that were made earlier, also in several pieces, and append a line."""
    from benchmarks.agreement import agreement, joint_run
    from benchmarks.cases import chosen_cases
    from benchmarks.record import append_line, environment

    [of] = chosen_cases([case])
    label, folders = _labelled(oracle)
    info = joint_run(runs).info
    result: Result = {
        "case": of.name,
        "group": of.group,
        "way": "agreement",
        **environment(),
        "engine": info["config"]["engine"],
        "device": info["device"],
        "agreement": {label: agreement(folders, runs)},
    }
    append_line(out, result)
    print(_brief(result))


@app.command("table")
def make_tables(
    files: Annotated[list[Path], typer.Argument(metavar="FILES...", help="Files of results.")],
    readme: Annotated[Path | None, typer.Option(metavar="FILE", help="Write between this file's markers.")] = None,
) -> None:
    """Make Markdown tables from results."""
    from benchmarks.record import read_lines
    from benchmarks.table import tables, write_between_markers

    text = tables(read_lines(files))
    if readme is None:
        print(text)
    else:
        write_between_markers(readme, text)


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _oracle_schedule(name: str) -> Schedule:
    known = {f"mujoco-{schedule.value}": schedule for schedule in Schedule}
    if name not in known:
        raise InputError(f"unknown oracle {name!r}; there are {', '.join(known)}")
    return known[name]


def _labelled(entry: str) -> tuple[str, list[Path]]:
    label, _, folders = entry.partition("=")
    if not (label and folders):
        raise InputError(f"{entry}: must be LABEL=DIR, or several folders with commas")
    return label, [Path(folder) for folder in _words(folders)]


def _usable(files: Sequence[Path], options: RunOptions) -> list[Plan]:
    """The plans of files; what cannot be used is counted on standard error.

    Raises:
        InputError: no usable plan.
    """
    from petmjx.config import Simulation
    from petmjx.plans.gather import usable_plans

    found = usable_plans(list(files), Simulation(), options)
    if found.skipped:
        skipped = counted(len(found.skipped), "unusable plan")
        print(f"{skipped} left out; the first: {found.skipped[0].message}", file=sys.stderr)
    return list(found.plans)


def _make_folder(folder: Path | None) -> None:
    """Make a folder for tables, if there is to be one.

    Raises:
        InputError: it cannot be made.
    """
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot write tables there: {error.strerror or error}") from error


def _known(names: list[str], there: Mapping[str, object], what: str) -> list[str]:
    """The names, which must be there.

    Raises:
        InputError: one is not.
    """
    for name in names:
        if name not in there:
            raise InputError(f"no {what} {name!r}; there are: {'; '.join(there)}")
    return names


def _brief(result: Result) -> str:
    """One line on one result."""
    parts = [f"{result['case']} {result['engine']}"]
    if "run_s" in result:
        parts[0] += f": {result['plans_per_s']:.4g} plans/s"
        parts += [f"{result['world_steps_per_s']:,.0f} steps/s", f"run {result['run_s']:.1f} s"]
        parts += [f"compile {result['compile_s']:.1f} s"]
    parts += [f"{label} {found['same']} of {found['common']}" for label, found in result["agreement"].items()]
    return "; ".join(part for part in [*parts, result.get("note")] if part)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    return run_app(app, arguments)


if __name__ == "__main__":
    sys.exit(main())
