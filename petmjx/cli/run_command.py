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
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

from petmjx.cli.console import PRINTED_NOTES, print_tables
from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.options.run_options import RunOptions

if TYPE_CHECKING:
    from petmjx.results.run_reader import RunResults


BURST_S: Final = 2.0
"""Largest time between two signals that count as one, s: someone who presses Ctrl-C six times in a row interrupts the
run once."""


AGAIN_S: Final = 0.05
"""If a signal arrives at a moment at which Python would ignore the signal's exception, the signal is sent again after
this delay, s."""


class RunInterrupted(Exception):
    """Ctrl-C or a signal has ended the run. The message tells how far the run has come. (The exception
    KeyboardInterrupt cannot be used instead, because typer would swallow it and its message.)"""


_last_stop = signal.SIGINT
"""The signal that ended the last block ``with stoppable()``; SIGINT if that block ended without a signal."""


def last_stop() -> signal.Signals:
    """The signal that ended the last block ``with stoppable()``; SIGINT if that block ended without a signal."""
    return _last_stop


@contextmanager
def stoppable() -> Iterator[None]:
    """Context in which SIGTERM and SIGHUP raise an exception, as Ctrl-C does, so that the code in the ``with`` block
    can clean up. Signals in quick succession raise only one exception. A signal that the process ignores, as under
    nohup, remains ignored. Every command runs inside ``stoppable``.

    Python ignores exceptions that are raised while an object is finalised (in ``__del__``), and Ray's objects are
    finalised often. If a signal arrives during a finalisation, the process sends itself the same signal a little later.
    """
    global _last_stop
    last_s = -math.inf

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last_s
        global _last_stop
        if any(caller.f_code.co_name == "__del__" for caller in _frames_of(frame)):
            threading.Timer(AGAIN_S, os.kill, (os.getpid(), number)).start()
            return
        now_s, before_s = time.monotonic(), last_s
        last_s = now_s
        if now_s - before_s >= BURST_S:
            _last_stop = signal.Signals(number)
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _last_stop = signal.SIGINT
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, stop)
        yield
    finally:
        # after a signal, the handlers stay in place: the process is about to end, and further signals must not disturb
        # its end
        if last_s == -math.inf:
            for number, handler in before.items():
                signal.signal(number, handler)


def _frames_of(frame: FrameType | None) -> Iterator[FrameType]:
    """Yield a stack frame and the frames of all its callers."""
    while frame is not None:
        yield frame
        frame = frame.f_back


def run_and_show(run: Callable[..., RunResults], options: Mapping[str, Any], as_json: bool) -> None:
    """Execute a run with a progress bar, and print the results as tables or as JSON. The arguments and errors are as in
    :func:`run_watched`."""
    results = run_watched(run, options)
    if as_json:
        print(json.dumps(brief(results), indent=2))
        return
    from petmjx.show.run_tables import run_tables

    print_tables(run_tables(results, PRINTED_NOTES.get()))


def run_watched(run: Callable[..., RunResults], options: Mapping[str, Any]) -> RunResults:
    """Execute a run with a progress bar.

    Args:
        run: function that executes the run. The keyword arguments of the function are ``watcher`` (the object that is
            told about the progress) and the options, including the folder ``out``.
        options: the options that the user has typed.

    Raises:
        RunInterrupted: Ctrl-C, SIGTERM or SIGHUP ended the run.
    """
    from petmjx.show.progress import BarWatcher

    watcher = BarWatcher()
    with folder_of_run(options) as out:
        earlier = None if options.get("resume") else _version_of_run(out)
        try:
            with watcher:
                return run(watcher=watcher, **{**options, "out": out})
        except KeyboardInterrupt:
            raise RunInterrupted(_how_far(out, watcher, earlier)) from None


@contextmanager
def folder_of_run(options: Mapping[str, Any]) -> Iterator[Path]:
    """Context that yields the folder of a run. If the user named no folder, a new folder is made, whose name is the
    current time. If the run writes nothing, the new folder is deleted at the end. If its parent folder is then empty,
    the parent folder is deleted, too.

    Raises:
        InputError: the folder cannot be made, or a run is to be resumed and the user named no folder.
    """
    named = RunOptions(**{name: options[name] for name in ("out", "resume") if name in options}).out
    if named is not None:
        yield Path(named)
        return
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
    try:
        yield folder
    finally:
        with suppress(OSError):
            folder.rmdir()
            parent.rmdir()


def _version_of_run(folder: Path) -> tuple[int, int] | None:
    """The inode and the time of the last change of the ``run.json`` in a folder; None if the folder has none. The inode
    and the time change whenever a run writes the file."""
    from petmjx.results.run_folder import RUN_FILE

    with suppress(OSError):
        status = (folder / RUN_FILE).stat()
        return status.st_ino, status.st_mtime_ns
    return None


def _how_far(folder: Path, watcher: Any, earlier: tuple[int, int] | None) -> str:
    """A text that tells how far an interrupted run has come.

    Args:
        earlier: the version of the run that was to be overwritten (``_version_of_run``); None if no run was to be
            overwritten.
    """
    from petmjx.results.run_reader import load_run

    nothing = f"before the first {watcher.what} was finished"
    if earlier is not None and _version_of_run(folder) == earlier:
        return f"{nothing}; {folder} still has the earlier run"
    try:
        n_done = load_run(folder).info["counts"]["worlds"]
    except InputError:
        end = "nothing was written" if earlier is None else f"the earlier run in {folder} is deleted"
        return f"{nothing}; {end}"
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
