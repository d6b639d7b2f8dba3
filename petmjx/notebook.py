"""The progress of a run in a notebook: a bar below the cell, which the results then follow."""

from __future__ import annotations

import html
import sys
import time
from collections.abc import Callable
from typing import Any, Final

from petmjx.basics.pace import Pace
from petmjx.simulate import RunStart
from petmjx.study import FinishedWorld

REFRESH_S: Final = 0.25
"""Least time between two drawings of the bar, s. Each goes to the browser."""


class NotebookBar:
    """Watches a run from a notebook.

    Args:
        display: shows HTML and returns what changes it: ``update(html)``.
    """

    def __init__(self, display: Callable[[str], Callable[[str], None]], clock: Callable[[], float] = time.monotonic):
        self._display, self._clock = display, clock
        self._update: Callable[[str], None] | None = None
        self._start: RunStart | None = None
        self._last = clock()
        self._done = 0

    def begin(self, start: RunStart) -> None:
        self._start, self._done = start, 0
        self._pace = Pace(self._left, start.what, self._clock)
        self._update = self._display(self._as_html())

    def world_done(self, world: FinishedWorld) -> None:
        self._done += 1
        now = self._clock()
        if now - self._last >= REFRESH_S or self._done == self._left:
            self._last = now
            if self._update is not None:
                self._update(self._as_html())

    @property
    def _left(self) -> int | None:
        """Worlds that this run simulates; None if their number is not known."""
        start = self._start
        return None if start is None or start.total is None else start.total - start.recorded

    def _as_html(self) -> str:
        start, left = self._start, self._left
        assert start is not None  # the run begins before it shows anything
        self._pace.update(self._done)
        parts = self._pace.words
        if self._done != left and start.progress.message:
            parts.append(start.progress.message)
        value = "" if left is None else f' value="{self._done}" max="{max(left, 1)}"'
        about = f"{start.size}; engine {start.choice.name} ({start.choice.reason})"
        bar = f'<progress{value} style="width: 16em"></progress> {html.escape(", ".join(parts))}'
        return f"<div><div>{html.escape(about)}</div><div>{bar}</div></div>"


def notebook_bar() -> NotebookBar | None:
    """A bar for the notebook that this process is the kernel of; None elsewhere. IPython is not imported for it."""
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):  # a terminal's IPython has none
        return None
    from IPython.display import HTML, display

    def show(text: str) -> Callable[[str], None]:
        handle = display(HTML(text), display_id=True)
        return lambda new: handle.update(HTML(new))

    return NotebookBar(show)
