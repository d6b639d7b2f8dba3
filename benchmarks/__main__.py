"""``python -m benchmarks``: run declared cases."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console
from petmjx.cli.main import run_app
from petmjx.config import Schedule
from petmjx.errors import InputError

if TYPE_CHECKING:
    from benchmarks.measure import Result


app = typer.Typer(add_completion=False, context_settings={"help_option_names": ["--help", "-h"]})


@app.command()
@opt.takes("limit", "lanes", "threads")
def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[CASES]...", help="Cases or groups of them; --list shows all.", show_default=False),
    ] = None,
    engines: Annotated[
        str, typer.Option("--engine", metavar="NAMES", help="mujoco, mjx-jax, mjx-warp, or several with commas.")
    ] = "mujoco",
    plans: Annotated[
        Path | None,
        typer.Option(
            "--plans", metavar="FILE", help="The workload's plans.", show_default="samples of seed 0, generated"
        ),
    ] = None,
    skip: Annotated[
        int, typer.Option("--skip", metavar="N", min=0, help="Leave out the workload's first N plans.")
    ] = 0,
    max_seconds: Annotated[
        float | None,
        typer.Option(
            "--max-seconds",
            metavar="S",
            help="Cut a workload off after S seconds (plain loops: begin no further plan).",
            show_default="never; plain loops 60",
        ),
    ] = None,
    repeat: Annotated[
        int,
        typer.Option("--repeat", metavar="N", min=1, help="Run workloads N times; compare each run with the first."),
    ] = 1,
    oracle: Annotated[
        str | None,
        typer.Option(
            "--oracle",
            metavar="NAMES",
            help="Compare with mujoco-fixed, mujoco-adaptive, or both with a comma; run here.",
        ),
    ] = None,
    oracle_limit: Annotated[
        int | None,
        typer.Option(
            "--oracle-limit", metavar="K", min=1, help="The oracles take the first K plans only.", show_default="all"
        ),
    ] = None,
    against: Annotated[
        list[str] | None,
        typer.Option(
            "--against",
            metavar="LABEL=DIR,…",
            help="Compare workloads with earlier runs' folders too. Repeatable.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="JSON lines are appended here.")] = Path(
        "petmjx-results/bench.jsonl"
    ),
    work: Annotated[
        Path | None,
        typer.Option(
            "--work", metavar="DIR", help="Folder that keeps what timed runs write.", show_default="a temporary one"
        ),
    ] = None,
    date: Annotated[
        str | None, typer.Option("--date", metavar="TEXT", help="Date to write into the results.", show_default="now")
    ] = None,
    list_cases: Annotated[bool, typer.Option("--list", help="List the cases and groups, and stop.")] = False,
    **options: Any,
) -> None:
    """Measure speed and agreement: declared cases, one JSON line a result.

    Timed runs go from the plans' file to Parquet; compilation is reported apart from the run.
    """
    from benchmarks.cases import chosen_cases

    if list_cases or not names:
        _list()
        return
    import tempfile

    from benchmarks.measure import Bench, Settings
    from benchmarks.record import append_line
    from petmjx.engines.choose import ENGINES

    engine_names = _words(engines)
    if unknown := [name for name in engine_names if name not in ENGINES]:
        raise InputError(f"unknown engine {unknown[0]!r}; there are {', '.join(ENGINES)}")
    settings = Settings(
        work=work if work is not None else Path(tempfile.mkdtemp(prefix="petmjx-bench-")),
        plans=plans,
        skip=skip,
        **options,
        max_seconds=max_seconds,
        repeat=repeat,
        oracles=tuple(_oracle_schedule(name) for name in _words(oracle or "")),
        oracle_limit=oracle_limit,
        against=dict(_labelled(entry) for entry in against or ()),
        date=date,
    )
    cases = chosen_cases(names)
    measuring = Bench(settings, on_message=lambda text: print(text, file=sys.stderr, flush=True))
    loops_done: set[str] = set()
    for engine in engine_names:
        for case in cases:
            if case.name.startswith("plain-loop"):
                if case.name in loops_done:
                    continue
                loops_done.add(case.name)
            for result in measuring.run(case, engine):
                append_line(out, result)
                print(_brief(result), flush=True)
    print(f"results in {out}, runs in {settings.work}", file=sys.stderr)


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _oracle_schedule(name: str) -> Schedule:
    for schedule in Schedule:
        if name == f"mujoco-{schedule.value}":
            return schedule
    raise InputError(f"unknown oracle {name!r}; there are {', '.join(f'mujoco-{each.value}' for each in Schedule)}")


def _labelled(entry: str) -> tuple[str, tuple[Path, ...]]:
    label, separator, folders = entry.partition("=")
    if not (label and separator and folders):
        raise InputError(f"--against {entry}: must be LABEL=DIR, or several folders with commas")
    return label, tuple(Path(folder) for folder in _words(folders))


def _brief(result: Result) -> str:
    """One line on one result."""
    parts = [
        f"{result['case']} {result['engine']}: {result['plans_per_s']:.4g} plans/s",
        f"{result['world_steps_per_s']:,.0f} steps/s",
        f"run {result['run_s']:.1f} s",
        f"compile {result['compile_s']:.1f} s",
    ]
    for label, found in result["agreement"].items():
        force = found["rest_top_force"]
        text = f"{label} {found['same']}/{found['common']}"
        if force["boxes"]:
            text += f", resting forces {100 * force['median']:.2g} % / {100 * force['p95']:.2g} %"
        parts.append(text)
    return "; ".join([*parts, *([result["note"]] if result["note"] else [])])


def _list() -> None:
    from rich.table import Table

    from benchmarks.cases import CASES, GROUPS

    table = Table(title="Cases", title_justify="left")
    table.add_column("case")
    table.add_column("what it measures")
    for name, case in CASES.items():
        table.add_row(name, case.text)
    table.add_section()
    for name, members in GROUPS.items():
        table.add_row(name, ", ".join(members))
    results_console().print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    return run_app(app, arguments)


if __name__ == "__main__":
    sys.exit(main())
