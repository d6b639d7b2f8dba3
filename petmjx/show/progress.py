"""How far a run is: a progress bar in a terminal."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from types import TracebackType
from typing import Final, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.text import Text

from petmjx.api import RunStart
from petmjx.sweeps.run import SweptWorld

REFRESH_S: Final = 0.5
"""The bar is drawn anew this often also while no world finishes: its message changes."""


class ProgressBar:
    """Handle of a running bar, made by :func:`progress`."""

    def __init__(self, bar: RichProgress, task: TaskID) -> None:
        self._bar = bar
        self._task = task

    def update(self, done: int, message: str = "") -> None:
        """Show that ``done`` worlds are finished; ``message`` stands beside the bar (compiling, retrying)."""
        self._bar.update(self._task, completed=done, message=escape(message))


class _RateColumn(ProgressColumn):
    """Finished worlds a second, over the whole run so far."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self._what = what

    def render(self, task: Task) -> Text:
        elapsed_s = task.finished_time if task.finished else task.elapsed
        if not elapsed_s or not task.completed:
            return Text(f"- {self._what}/s")
        return Text(f"{rate(task.completed / elapsed_s)} {self._what}/s")


@contextmanager
def progress(total: int | None, what: str = "plans", console: Console | None = None) -> Iterator[ProgressBar]:
    """A progress bar with worlds a second, time left and a message.

    Args:
        total: worlds there will be; None where that is not known.
        what: what a world is to the user: ``plans``, or ``worlds`` in sweeps.
        console: where it is shown; standard error by default, so that standard output holds results alone.
    """
    bar = RichProgress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _RateColumn(what),
        TimeRemainingColumn(),
        TextColumn("{task.fields[message]}"),
        console=console or Console(stderr=True),
    )
    with bar:
        yield ProgressBar(bar, bar.add_task(what, total=total, message=""))


def rate(per_s: float) -> str:
    """Something a second, in three digits."""
    return f"{per_s:,.0f}" if per_s >= 100 else f"{per_s:.3g}"


class BarWatcher(AbstractContextManager["BarWatcher"]):
    """Tells on standard error what a run is going to do, and draws its progress bar."""

    def __init__(self) -> None:
        self.what = "plan"
        self.total: int | None = None
        self._done = 0
        self._bar_context: AbstractContextManager[ProgressBar] | None = None
        self._stop = threading.Event()
        self._refresher: threading.Thread | None = None

    def begin(self, start: RunStart) -> None:
        self.what, self.total = start.what, start.total
        print(f"{start.size}\nengine {start.choice.name} ({start.choice.reason})", file=sys.stderr)
        self._bar_context = progress(start.total, f"{start.what}s")
        bar = self._bar_context.__enter__()

        def refresh() -> None:
            while True:
                stopped = self._stop.wait(REFRESH_S)
                bar.update(self._done, start.progress.message)
                if stopped:
                    return

        self._refresher = threading.Thread(target=refresh, name="petmjx-progress", daemon=True)
        self._refresher.start()

    def world_done(self, world: SweptWorld) -> None:
        self._done += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        if self._refresher is not None:
            self._refresher.join()
        if self._bar_context is not None:
            self._bar_context.__exit__(None, None, None)
