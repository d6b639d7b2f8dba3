"""The command-line application, and code that several commands use."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from petmjx.common.errors import InputError
from petmjx.common.text import count_text

if TYPE_CHECKING:
    from petmjx.options.run_options import RunOptions
    from petmjx.plans.plan import Plan

app = typer.Typer(
    help="Measures speed and agreement; benchmarks/README.md has the details.",
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["--help", "-h"]},
)

Out = Annotated[
    Path, typer.Option("--out", "-o", metavar="FILE", help="File to which results are appended, one JSON line each.")
]
DEFAULT_OUT = Path("petmjx-results/bench.jsonl")


def usable(files: Sequence[Path], options: RunOptions) -> list[Plan]:
    """The plans in the files. The number of unusable plans is printed to standard error.

    Raises:
        InputError: there is no usable plan.
    """
    from petmjx.options.simulation import Simulation
    from petmjx.plans.plan_sources import usable_plans

    plan_set = usable_plans(list(files), Simulation(), options)
    if plan_set.skipped:
        skipped = count_text(len(plan_set.skipped), "unusable plan")
        print(f"{skipped} left out; the first: {plan_set.skipped[0].message}", file=sys.stderr)
    return list(plan_set.plans)


def make_folder(folder: Path | None) -> None:
    """Make a folder for tables, if a folder is requested.

    Raises:
        InputError: the folder cannot be made.
    """
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot write tables there: {error.strerror or error}") from error


def known(names: list[str], choices: Mapping[str, object], noun: str) -> list[str]:
    """The names, after a check that each of them is available.

    Raises:
        InputError: one of the names is not available.
    """
    for name in names:
        if name not in choices:
            raise InputError(f"no {noun} {name!r}; there are: {'; '.join(choices)}")
    return names


def words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]
