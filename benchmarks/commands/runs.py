"""Commands that run cases, compare runs of engines, and make tables of the results."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmarks.commands.app import DEFAULT_OUT, Out, app, words
from petmjx.cli import command_options as opt
from petmjx.common.errors import InputError
from petmjx.options.simulation import Schedule

if TYPE_CHECKING:
    from benchmarks.result_fields import Result


@app.command("list")
def list_cases() -> None:
    """List the cases by group."""
    from benchmarks.cases import GROUPS

    for group, cases in GROUPS.items():
        print(group)
        for case in cases:
            print(f"    {case.name:<28}{case.text}")


@app.command()
@opt.takes("limit", "lanes", "threads")
def run(
    names: Annotated[list[str], typer.Argument(metavar="CASES...", help="Cases, or groups of them.")],
    engine: Annotated[str, typer.Option(metavar="NAMES", help="Engines, several with commas.")] = "mujoco",
    plans: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of generated samples.")] = None,
    skip: Annotated[int, typer.Option(metavar="N", min=0, help="Leave out the first N plans.")] = 0,
    max_seconds: Annotated[float | None, typer.Option(metavar="S", help="Cut runs off (plain loops: 60 s).")] = None,
    repeat: Annotated[int, typer.Option(metavar="N", min=1, help="Run all cases N times, in turns.")] = 1,
    oracle: Annotated[str, typer.Option(metavar="NAMES", help="Run and compare with mujoco-fixed, …")] = "",
    against: Annotated[list[str] | None, typer.Option(metavar="LABEL=DIR,…", help="Compare with earlier runs.")] = None,
    work: Annotated[Path | None, typer.Option(metavar="DIR", help="Keeps the files of runs.")] = None,
    out: Out = DEFAULT_OUT,
    **options: Any,
) -> None:
    """Run cases and append a line of results each."""
    import tempfile

    from benchmarks.cases import chosen_cases
    from benchmarks.measure import Bench
    from benchmarks.result_fields import append_line

    bench = Bench(
        work=work or Path(tempfile.mkdtemp(prefix="petmjx-bench-")),
        plans=plans,
        skip=skip,
        max_seconds=max_seconds,
        repeat=repeat,
        oracles=[_oracle_schedule(name) for name in words(oracle)],
        against=dict(_labelled(entry) for entry in against or ()),
        say=lambda text: print(text, file=sys.stderr, flush=True),
        **options,
    )
    for result in bench.run(chosen_cases(names), words(engine)):
        append_line(out, result)
        print(_brief(result), flush=True)
    print(f"results in {out}, runs in {bench.work}", file=sys.stderr)


@app.command("agreement")
def compare(
    oracle: Annotated[str, typer.Option(metavar="LABEL=DIR,…", help="Label and folders of the reference run.")],
    runs: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of the run that is judged.")],
    case: Annotated[str, typer.Option(metavar="NAME", help="Name of the case, for the tables.")],
    out: Out = DEFAULT_OUT,
) -> None:
    """Compare runs that were made earlier, also in several pieces, and append a line."""
    from benchmarks.agreement import agreement, joint_run
    from benchmarks.cases import chosen_cases
    from benchmarks.result_fields import append_line, environment

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
    readme: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown file; the tables are written between its markers.")
    ] = None,
) -> None:
    """Make Markdown tables from results."""
    from benchmarks.result_fields import read_lines
    from benchmarks.result_tables import tables, write_between_markers

    text = tables(read_lines(files))
    if readme is None:
        print(text)
    else:
        write_between_markers(readme, text)


def _oracle_schedule(name: str) -> Schedule:
    known = {f"mujoco-{schedule.value}": schedule for schedule in Schedule}
    if name not in known:
        raise InputError(f"unknown oracle {name!r}; there are {', '.join(known)}")
    return known[name]


def _labelled(entry: str) -> tuple[str, list[Path]]:
    label, _, folders = entry.partition("=")
    if not (label and folders):
        raise InputError(f"{entry}: must be LABEL=DIR, or several folders with commas")
    return label, [Path(folder) for folder in words(folders)]


def _brief(result: Result) -> str:
    """One line on one result."""
    parts = [f"{result['case']} {result['engine']}"]
    if "run_s" in result:
        parts[0] += f": {result['plans_per_s']:.4g} plans/s"
        parts += [f"{result['world_steps_per_s']:,.0f} steps/s", f"run {result['run_s']:.1f} s"]
        parts += [f"compile {result['compile_s']:.1f} s"]
    parts += [
        f"{label} {agreement['same']} of {agreement['common']}" for label, agreement in result["agreement"].items()
    ]
    return "; ".join(part for part in [*parts, result.get("note")] if part)
