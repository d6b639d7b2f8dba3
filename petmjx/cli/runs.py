"""The common part of ``score`` and ``sweep``: the folder, the progress bar, Ctrl-C, and the tables at the end."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petmjx.cli.console import results_console
from petmjx.errors import InputError
from petmjx.text import counted

if TYPE_CHECKING:
    from petmjx.api import Watcher
    from petmjx.results.reader import RunResults


class Interrupted(Exception):
    """Ctrl-C, with the number of finished worlds. (typer would end on a KeyboardInterrupt without a message.)"""


def run_and_show(
    run: Callable[[Watcher, Mapping[str, Any]], RunResults], options: dict[str, Any], as_json: bool
) -> None:
    """Run something with a progress bar and print its tables, or JSON.

    Args:
        run: called with a watcher and the options, which have the folder.

    Raises:
        Interrupted: Ctrl-C.
    """
    from petmjx.show.progress import BarWatcher

    folder = Path(options.setdefault("out", default_folder()))
    watcher = BarWatcher()
    try:
        with watcher:
            results = run(watcher, options)
    except KeyboardInterrupt:
        raise Interrupted(_how_far(folder, watcher)) from None
    if as_json:
        print(json.dumps(_brief(results), indent=2))
        return
    from petmjx.show.layout import print_each
    from petmjx.show.tables import run_tables

    print_each(run_tables(results), results_console())


def default_folder() -> Path:
    """A folder named after date and time."""
    return Path("petmjx-results") / datetime.now().strftime("%Y%m%d-%H%M%S")


def _how_far(folder: Path, watcher: Any) -> str:
    """How far an interrupted run came, as text."""
    from petmjx.results.reader import load_run

    try:
        done = load_run(folder).info["counts"]["worlds"]
    except InputError:
        return f"before the first {watcher.what}; nothing was written"
    of = counted(done, watcher.what) if watcher.total is None else f"{done:,} of {counted(watcher.total, watcher.what)}"
    return f"{of} {'is' if done == 1 else 'are'} done and in {folder}"


def _brief(results: RunResults) -> dict[str, Any]:
    names = ("status", "counts", "timings", "device", "skipped", "warnings")
    brief = {"out": str(results.path), **{name: results.info[name] for name in names}}
    if results.summary is not None:
        brief["summary"] = json.loads(results.summary.to_json(orient="records"))
    return brief
