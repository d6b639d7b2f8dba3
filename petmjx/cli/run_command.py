"""The common parts of ``score`` and ``sweep``: the folder, the progress bar, Ctrl-C, and the tables at the end."""

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
"""Signals that follow each other within this time count as one: Ctrl-C pressed six times in a row interrupts once."""


AGAIN_S: Final = 0.05
"""A signal is sent again after this time, s, in case the exception that it raised was lost."""


class RunInterrupted(Exception):
    """Ctrl-C or a signal has ended the run. The message describes the state of the run. (typer would swallow a bare
    KeyboardInterrupt, without any message.)

    Attributes:
        number: number of the signal.
    """

    def __init__(self, how_far: str, number: int) -> None:
        super().__init__(how_far)
        self.number = number


class _StopSignal(KeyboardInterrupt):
    """Raised inside the run when a signal ends it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


_STATE = SimpleNamespace(is_stoppable=False, number=None)
"""Whether a body can be stopped at the moment, and the number of the last signal that stopped a body."""


def last_stop() -> int | None:
    """The number of the signal that stopped the last stoppable body; None if none did."""
    number: int | None = _STATE.number
    return number


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the body like Ctrl-C, once per burst of signals, so that the body can clean up.
    A signal that is ignored remains ignored (nohup). Every command already runs inside ``stoppable``, so a nested use
    does nothing.

    Python ignores exceptions that are raised while an object is finalised, as Ray's objects often are. In that case,
    the signal is sent again.
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
        if last_s == -math.inf:  # after a signal, the process is about to end, and more may follow
            for number, handler in before.items():
                signal.signal(number, handler)


def _frames_of(frame: FrameType | None) -> Iterator[FrameType]:
    """A frame and all its callers."""
    while frame is not None:
        yield frame
        frame = frame.f_back


def run_and_show(
    run: Callable[[Watcher, Mapping[str, Any]], RunResults], options: dict[str, Any], as_json: bool
) -> None:
    """Execute a run with a progress bar, and print its tables or JSON.

    Args:
        run: function that executes the run. Its arguments are a watcher and the options, including the folder.

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
    """Execute a run with a progress bar, like :func:`run_and_show`, but without printing tables."""
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
    """Make a new folder, named after the current time, that no other run uses.

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
    """Delete the empty folder of a run that did not begin, and its parent folder if that is empty."""
    with suppress(OSError):
        folder.rmdir()
        folder.parent.rmdir()


def _how_far(folder: Path, watcher: Any) -> str:
    """How far an interrupted run has come, as text."""
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
    """A run in the form that --json prints."""
    names = ("status", "counts", "timings", "device", "skipped", "warnings")
    brief = {"out": str(results.path), **{name: results.info[name] for name in names}}
    if results.info.get("orders"):
        brief["orders"] = results.info["orders"]
    if results.summary is not None:
        brief["summary"] = json.loads(results.summary.to_json(orient="records"))
    return brief
