"""Shows the progress of a run started from Python: in a notebook, as a bar below the cell; in a script, as lines on
standard error."""

from __future__ import annotations

import html
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final, TypeVar

from petmjx.common.argument_checks import flag_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.progress_texts import ProgressTexts
from petmjx.common.text import printable
from petmjx.runs.simulate import RunStart

LINE_S: Final = 5.0
"""Time between two lines that a script prints, s."""

REFRESH_S: Final = 0.25
"""Shortest time between two drawings of the progress bar, s. Each drawing is sent to the browser, so more frequent
drawings would cause much traffic."""

AnyWatcher = TypeVar("AnyWatcher")


class NotebookBar:
    """Shows the progress of a run as a bar in a notebook.

    Args:
        display: function that shows HTML, and returns a function ``update(html)`` that replaces this HTML.
    """

    def __init__(self, display: Callable[[str], Callable[[str], None]], clock: Callable[[], float] = time.monotonic):
        self._display, self._clock = display, clock
        self._update: Callable[[str], None] | None = None
        self._start: RunStart | None = None
        self._last = clock()
        self._done = 0

    def begin(self, start: RunStart) -> None:
        self._start, self._done = start, 0
        self._texts = ProgressTexts(self._left, start.what, self._clock)
        self._update = self._display(self._as_html())

    def world_done(self, world: object) -> None:
        self._done += 1
        now = self._clock()
        if now - self._last >= REFRESH_S or self._done == self._left:
            self._last = now
            if self._update is not None:
                self._update(self._as_html())

    @property
    def _left(self) -> int | None:
        """Number of worlds that this run simulates, without the worlds of an earlier run; None if the number is
        unknown."""
        start = self._start
        return None if start is None or start.total is None else start.total - start.recorded

    def _as_html(self) -> str:
        start, left = self._start, self._left
        assert start is not None  # ``begin`` is called before the first drawing
        share = start.progress.work_share
        self._texts.update(self._done, share)
        parts = self._texts.words
        if self._done != left and start.progress.shown_message:
            parts.append(start.progress.shown_message)
        drawn = self._done if share is None or left is None else round(share * left, 1)
        value = "" if left is None else f' value="{drawn}" max="{max(left, 1)}"'
        about = f"{start.size}; engine {start.choice.name} ({start.choice.reason})"
        bar = f'<progress{value} style="width: 16em"></progress> {html.escape(", ".join(parts))}'
        return f"<div><div>{html.escape(about)}</div><div>{bar}</div></div>"


class ScriptLines:
    """Shows the progress of a run in a script: one line at the start, one every ``LINE_S`` seconds, and one at the end.
    A thread writes the lines, so that lines appear even if no world ends for a while.

    Args:
        write: function that receives each line. Without ``write``, lines go to standard error.
    """

    def __init__(self, write: Callable[[str], object] | None = None, line_s: float = LINE_S) -> None:
        self._write, self._line_s = write, line_s
        self._done, self._ended = 0, threading.Event()
        self._total: int | None = None

    def begin(self, start: RunStart) -> None:
        self._done, self._ended = 0, threading.Event()
        self._total = None if start.total is None else start.total - start.recorded
        self._texts, self._progress = ProgressTexts(self._total, start.what), start.progress
        self._say(f"{start.size}; engine {start.choice.name} ({start.choice.reason})")
        threading.Thread(target=self._follow, args=(self._ended,), name="petmjx-lines", daemon=True).start()

    def world_done(self, world: object) -> None:
        self._done += 1
        if self._done == self._total:
            self.end()

    def end(self) -> None:
        """Write the last line, unless this has already been done."""
        if not self._ended.is_set():
            self._ended.set()
            self._say_progress()

    def _follow(self, ended: threading.Event) -> None:
        while not ended.wait(self._line_s):
            self._say_progress()

    def _say_progress(self) -> None:
        self._texts.update(self._done, self._progress.work_share)
        message = "" if self._done == self._total else self._progress.shown_message
        self._say(", ".join(filter(None, (*self._texts.words, message))))

    def _say(self, line: str) -> None:
        with suppress(OSError, ValueError, AttributeError):  # standard error may be closed or missing
            if self._write is not None:
                self._write(line)
            else:
                print(printable(line), file=sys.stderr, flush=True)


def notebook_bar() -> NotebookBar | None:
    """A progress bar if this process is the kernel of a notebook, otherwise None. This function never loads IPython."""
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):  # IPython in a terminal has no kernel
        return None
    from IPython.display import HTML, display

    def show(text: str) -> Callable[[str], None]:
        handle = display(HTML(text), display_id=True)
        return lambda new: handle.update(HTML(new))

    return NotebookBar(show)


@contextmanager
def watching(watcher: AnyWatcher | None, progress: bool) -> Iterator[AnyWatcher | NotebookBar | ScriptLines | None]:
    """Yield the watcher of a run: the object that is told about the run's progress. A watcher from the caller is used
    unchanged. If the caller gives none, a new watcher is used: in a notebook, it shows a progress bar; in a script with
    ``progress``, it prints lines on standard error. In other scripts, the watcher is None.

    Raises:
        InputError: the given watcher lacks a method that watchers must have.
    """
    flag_of(progress, "progress")
    if watcher is not None and not all(callable(getattr(watcher, name, None)) for name in ("begin", "world_done")):
        raise InputError(f"watcher must have the methods 'begin' and 'world_done', {shown_value(watcher)}")
    bar = watcher if watcher is not None else notebook_bar()
    if bar is not None or not progress:
        yield bar
        return
    lines = ScriptLines()
    try:
        yield lines
    finally:
        lines.end()
