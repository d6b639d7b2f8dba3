"""Progress of a run on standard error: a bar in a terminal, lines elsewhere."""

from __future__ import annotations

import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from typing import Final, Protocol

from rich.console import Console, RenderableType
from rich.progress import BarColumn, ProgressColumn, Task
from rich.progress import Progress as RichProgress
from rich.text import Text

from petmjx.common.progress_texts import ProgressTexts
from petmjx.common.text import count_text, printable
from petmjx.runs.simulate import RunStart

REFRESH_S: Final = 0.5
"""Time after which the bar is redrawn, s, even if no world has finished, since the bar's message may have changed."""

LINE_S: Final = 10.0
"""Time between two lines if there is no terminal, s."""


class ProgressSink(Protocol):
    """The object that :func:`progress` yields."""

    def update(self, done: int, message: str = "", share: float | None = None) -> None:
        """Show that ``done`` worlds are finished, and a message about the present activity, such as compiling.
        ``share`` has the same meaning as in ``ProgressTexts.update``."""


@contextmanager
def progress(total: int | None, what: str = "plan", console: Console | None = None) -> Iterator[ProgressSink]:
    """Show the number of finished worlds, worlds per second, the time left and a message.

    Args:
        total: number of worlds; None if it is unknown.
        what: the word for a world in messages: ``plan``, or ``world`` in sweeps.
        console: the console to write to. If ``console`` is None, progress is written to standard error, so that
            standard output contains only results.
    """
    console = console or Console(stderr=True, force_interactive=None if _is_terminal() else False)
    if console.is_interactive:
        with _Bar(total, what, console) as bar:
            yield bar
    else:
        lines = ProgressLines(total, what, console.file.write)
        try:
            yield lines
        finally:
            lines.end()


@contextmanager
def progress_when_called(what: str = "plan") -> Iterator[Callable[[int, int], None]]:
    """Context manager that yields a function with two arguments: how many worlds are finished, and how many there are.
    The progress is shown from the first call of the function on."""
    with ExitStack() as until_end:
        shown: list[ProgressSink] = []

        def show(done: int, total: int) -> None:
            if not shown:
                shown.append(until_end.enter_context(progress(total, what)))
            shown[0].update(done)

        yield show


def _is_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _wrapped_line(text: str) -> str:
    """The text, wrapped between words into lines that fit into the terminal."""
    return textwrap.fill(text, shutil.get_terminal_size().columns) if _is_terminal() else text


class ProgressLines:
    """Writes a line every ``LINE_S`` seconds. At the end, it writes a line if worlds have finished since the last line.
    If lines cannot be written, the run continues."""

    def __init__(
        self, total: int | None, what: str, write: Callable[[str], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._texts, self._write, self._clock = ProgressTexts(total, what, clock), write, clock
        self._last = clock()
        self._done = self._written = 0

    def update(self, done: int, message: str = "", share: float | None = None) -> None:
        self._done = done
        self._texts.update(done, share)
        now = self._clock()
        if now - self._last >= LINE_S:
            self._last = now
            self._print(message)

    def end(self) -> None:
        if self._done != self._written:
            self._print()

    def _print(self, message: str = "") -> None:
        self._written = self._done
        parts = self._texts.words + ([printable(message)] if message else [])
        with suppress(OSError):
            self._write(", ".join(parts) + "\n")


class _Words(ProgressColumn):
    """A column that shows a text."""

    def __init__(self, words: Callable[[], str]) -> None:
        super().__init__()
        self._words = words

    def render(self, task: Task) -> Text:
        return Text(self._words())


class _Bar(RichProgress):
    """A progress bar, with a message in the line below."""

    def __init__(self, total: int | None, what: str, console: Console) -> None:
        self._message = ""  # ``super().__init__`` reads this attribute
        texts = self._texts = ProgressTexts(total, what)
        count, rate, left = _Words(lambda: texts.count), _Words(lambda: texts.rate), _Words(lambda: texts.left)
        super().__init__(count, BarColumn(), rate, left, console=console)
        self._task = self.add_task("", total=total)

    def update(  # type: ignore[override]  # its only task
        self, done: int, message: str = "", share: float | None = None
    ) -> None:
        self._message = printable(message)
        self._texts.update(done, share)
        total = self.tasks[0].total
        super().update(self._task, completed=done if share is None or total is None else share * total)

    def get_renderables(self) -> Iterator[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        if self._message:
            yield Text(self._message, style="dim", no_wrap=True, overflow="ellipsis")


class BarWatcher(AbstractContextManager["BarWatcher"]):
    """Prints the numbers of worlds and steps and the engine of a run to standard error, and shows the run's progress.

    Attributes:
        what: the word for a world in messages: "plan", or "world" in sweeps.
        total: number of worlds; None before the run begins, or if the number is unknown.
    """

    def __init__(self) -> None:
        self.what = "plan"
        self.total: int | None = None
        self._done = 0
        self._until_exit = ExitStack()

    def begin(self, start: RunStart) -> None:
        self.what, self.total = start.what, start.total
        lines = [_wrapped_line(start.size), _wrapped_line(f"engine {start.choice.name} ({start.choice.reason})")]
        if start.recorded:
            are = "is" if start.recorded == 1 else "are"
            lines.append(f"{count_text(start.recorded, start.what)} of an earlier run {are} already in the folder")
        for line in lines:
            with suppress(OSError):
                print(line, file=sys.stderr)
        left = None if start.total is None else start.total - start.recorded
        shown = self._until_exit.enter_context(progress(left, start.what))
        stop = threading.Event()

        def refresh() -> None:
            stopped = False
            while not stopped:
                stopped = stop.wait(REFRESH_S)
                shown.update(self._done, start.progress.shown_message, start.progress.work_share)

        refresher = threading.Thread(target=refresh, name="petmjx-progress", daemon=True)
        refresher.start()
        self._until_exit.callback(refresher.join)
        self._until_exit.callback(stop.set)

    def world_done(self, world: object) -> None:
        self._done += 1

    def __exit__(self, *_: object) -> None:
        self._until_exit.close()
