"""What the commands ``score`` and ``sweep`` have in common: the folder of the run, the progress bar, Ctrl-C, and the
tables at the end."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

from petmjx.cli.console import results_console
from petmjx.common.errors import InputError
from petmjx.common.text import count_text

if TYPE_CHECKING:
    from petmjx.results.run_reader import RunResults
    from petmjx.runs.simulate import Watcher


BURST_S: Final = 2.0
"""Largest time between two signals that count as one, s: someone who presses Ctrl-C six times in a row interrupts the
run once."""


AGAIN_S: Final = 0.05
"""Delay before a signal is sent again, s, if it arrived at a moment at which Python would ignore its exception."""


class RunInterrupted(Exception):
    """Ctrl-C or a signal has ended the run. The message tells how far the run has come. (The exception
    KeyboardInterrupt cannot be used instead, because typer would swallow it and its message.)

    Attributes:
        number: number of the signal.
    """

    def __init__(self, how_far: str, number: int) -> None:
        super().__init__(how_far)
        self.number = number


class _StopSignal(KeyboardInterrupt):
    """The exception that a signal raises in the main thread to end a run."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


_STATE = SimpleNamespace(is_stoppable=False, number=None)
"""``is_stoppable``: whether a block ``with stoppable()`` is running. ``number``: number of the signal that ended the
last such block."""


def last_stop() -> int | None:
    """The number of the signal that ended the last block ``with stoppable()``; None if the block ended without a
    signal."""
    number: int | None = _STATE.number
    return number


@contextmanager
def stoppable() -> Iterator[None]:
    """Context in which SIGTERM and SIGHUP raise an exception, as Ctrl-C does, so that the code in the ``with`` block
    can clean up. Signals in quick succession raise only one exception. A signal that the process ignores, as under
    nohup, remains ignored. Every command runs inside ``stoppable``; a second ``stoppable`` inside it does nothing.

    Python ignores exceptions that are raised while an object is finalised (in ``__del__``), and Ray's objects are
    finalised often. If a signal arrives during a finalisation, the process sends itself the same signal a little later.
    """
    last_s = -math.inf

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last_s
        if any(caller.f_code.co_name == "__del__" for caller in _frames_of(frame)):
            threading.Timer(AGAIN_S, os.kill, (os.getpid(), number)).start()
            return
        now_s, before_s = time.monotonic(), last_s
        last_s = now_s
        if now_s - before_s >= BURST_S:
            _STATE.number = number
            raise _StopSignal(number)

    if _STATE.is_stoppable or threading.current_thread() is not threading.main_thread():
        yield
        return
    _STATE.is_stoppable, _STATE.number = True, None
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, stop)
        yield
    finally:
        _STATE.is_stoppable = False
        # after a signal, the handlers stay in place: the process is about to end, and further signals must not disturb
        # that
        if last_s == -math.inf:
            for number, handler in before.items():
                signal.signal(number, handler)


def _frames_of(frame: FrameType | None) -> Iterator[FrameType]:
    """Yield a stack frame and the frames of all its callers."""
    while frame is not None:
        yield frame
        frame = frame.f_back


def run_and_show(
    run: Callable[[Watcher, Mapping[str, Any]], RunResults], options: dict[str, Any], as_json: bool
) -> None:
    """Execute a run with a progress bar, and print the results as tables or as JSON.

    Args:
        run: function that executes the run. The arguments of ``run`` are a watcher (the object that is told about the
            progress) and the options, including the folder.

    Raises:
        RunInterrupted: Ctrl-C, SIGTERM or SIGHUP ended the run.
    """
    results = run_watched(run, options)
    if as_json:
        print(json.dumps(brief(results), indent=2))
        return
    from petmjx.show.run_tables import run_tables
    from petmjx.show.table_layout import print_renderables

    print_renderables(run_tables(results), results_console())


def run_watched(run: Callable[[Watcher, Mapping[str, Any]], RunResults], options: dict[str, Any]) -> RunResults:
    """Execute a run with a progress bar, as :func:`run_and_show` does, but print no results."""
    from petmjx.show.progress import BarWatcher

    watcher = BarWatcher()
    with stoppable():
        new_folder = None if "out" in options or options.get("resume") else default_folder()
        if new_folder is not None:
            options["out"] = new_folder
        try:
            with watcher:
                return run(watcher, options)
        except KeyboardInterrupt as stop:
            raise RunInterrupted(
                _how_far(Path(options["out"]), watcher), getattr(stop, "number", signal.SIGINT)
            ) from None
        finally:
            if new_folder is not None:
                remove_empty(new_folder)


def default_folder() -> Path:
    """Make a new folder for a run, named after the current time.

    Raises:
        InputError: the folder cannot be made.
    """
    parent = Path("petmjx-results")
    name = datetime.now().strftime("%Y%m%d-%H%M%S")
    try:
        parent.mkdir(exist_ok=True)
        for number in itertools.count(1):
            folder = parent / (name if number == 1 else f"{name}-{number}")
            with suppress(FileExistsError):
                folder.mkdir()
                break
    except OSError as error:
        raise InputError(f"{parent}: cannot write results there: {error.strerror or error}") from error
    return folder


def remove_empty(folder: Path) -> None:
    """Delete a folder in which a run has written nothing, and then the parent folder if that is empty, too."""
    with suppress(OSError):
        folder.rmdir()
        folder.parent.rmdir()


def _how_far(folder: Path, watcher: Any) -> str:
    """A text that tells how far an interrupted run has come."""
    from petmjx.results.run_reader import load_run

    try:
        n_done = load_run(folder).info["counts"]["worlds"]
    except InputError:
        return f"before the first {watcher.what} was finished; nothing was written"
    of = (
        count_text(n_done, watcher.what)
        if watcher.total is None
        else f"{n_done:,} of {count_text(watcher.total, watcher.what)}"
    )
    return f"{of} {'is' if n_done == 1 else 'are'} done and in {folder}"


def brief(results: RunResults) -> dict[str, Any]:
    """What the option --json prints about a run: status, counts, timings, warnings, and the table ``summary``."""
    names = ("status", "counts", "timings", "device", "skipped", "warnings")
    brief = {"out": str(results.path), **{name: results.info[name] for name in names}}
    if results.info.get("orders"):
        brief["orders"] = results.info["orders"]
    if results.summary is not None:
        brief["summary"] = json.loads(results.summary.to_json(orient="records"))
    return brief
