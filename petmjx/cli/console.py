"""Standard output and standard error. Standard output and standard error may each be a terminal, a file, a pipe, or
closed."""

from __future__ import annotations

import codecs
import io
import os
import sys
import warnings
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Final

from petmjx.common.errors import PlanWarning
from petmjx.common.text import printable

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from petmjx.plans.readings import AmbiguousFile, Reading

PIPED_WIDTH = 120
"""Width of printed tables if standard output is a file or a pipe, in columns of characters."""

SHOWN_SKIPPED = 10
"""Largest number of skipped plans for which a line is printed."""

_PLAIN: Final = {"…": "~", "≥": ">=", "≤": "<=", "→": ">", "↓": "v", "×": "x", "°": "o", "²": "2", "³": "3"}
"""Characters that an old terminal cannot show → replacements. A character without an entry here becomes "?"."""


def results_console() -> Console:
    """A console of the library rich on standard output. The console is as wide as the terminal, or has ``PIPED_WIDTH``
    columns if the output is not a terminal."""
    from rich.console import Console

    piped = "COLUMNS" not in os.environ and not sys.stdout.isatty()
    return Console(width=PIPED_WIDTH if piped else None)


def print_tables(tables: Iterable[RenderableType], console: Console | None = None) -> None:
    """Print tables and lines, by default on standard output. The terminal itself wraps long lines, so that a path can
    be copied as a whole."""
    from rich.text import Text

    console = console or results_console()
    for table in tables:
        console.print(table, soft_wrap=isinstance(table, Text))


_LEAST_COLUMNS: Final = 20
"""Smallest width that the variable COLUMNS may give, in columns of characters. In a smaller width, no table can be
read; with the width 0, rich prints nothing."""


def prepare_streams() -> None:
    """Make printing safe. Standard output and standard error are opened if they are closed, and replace characters that
    they cannot encode. If the variable COLUMNS gives a width in which nothing could be shown, it is ignored."""
    width = os.environ.get("COLUMNS", "")
    if width.isdecimal() and int(width) < _LEAST_COLUMNS:
        del os.environ["COLUMNS"]
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # the caller has closed the stream (petmjx … >&-)
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  # until the process ends
    codecs.register_error("petmjx", _plainly)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="petmjx")


_STDOUT: Final = frozenset(("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"))


@contextmanager
def lines_beside_data(words: Sequence[str]) -> Iterator[None]:
    """Context in which a command runs. If a word of the command line names standard output as a file, all lines and
    tables are printed on standard error, so that standard output has nothing but the file's content."""
    if _STDOUT.isdisjoint(word.rpartition("=")[2] for word in words):
        yield
        return
    with redirect_stdout(sys.stderr):
        yield


PRINTED_NOTES: ContextVar[Collection[str]] = ContextVar("PRINTED_NOTES", default=())
"""The lines that ``as_notes`` has printed."""


@contextmanager
def as_notes() -> Iterator[None]:
    """Print each ``PlanWarning`` immediately, as one line on standard error, so that a user can stop a long run if, for
    example, a unit is wrong. Each line is printed only once, because commands may read a file several times."""
    seen: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", PlanWarning)
        otherwise = warnings.showwarning

        def show(
            message: Warning | str, category: type[Warning], filename: str, lineno: int, *more: Any, **named: Any
        ) -> None:
            if issubclass(category, PlanWarning):
                if str(message) not in seen:
                    print(f"note: {printable(str(message))}", file=sys.stderr)
                seen.add(str(message))
            else:
                otherwise(message, category, filename, lineno, *more, **named)

        warnings.showwarning = show
        # if only the results are redirected to a file, the file must have the notes, too, so they are printed again
        are_together = sys.stdout is not None and sys.stdout.isatty() and sys.stderr.isatty()
        token = PRINTED_NOTES.set(seen if are_together else ())
        try:
            yield
        finally:
            PRINTED_NOTES.reset(token)


@contextmanager
def asking() -> Iterator[None]:
    """Context in which petmjx asks the person at the terminal whenever a file can be read in several ways, for example
    with different units."""
    if not (sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()):
        yield
        return
    from petmjx.plans.readings import CHOOSER

    token = CHOOSER.set(_ask_reading)
    try:
        yield
    finally:
        CHOOSER.reset(token)


def _ask_reading(source: str, error: AmbiguousFile) -> Reading | None:
    """Ask the person at the terminal which reading of a file is right. Returns None if the person chooses no
    reading."""
    print(f"{source} can be read in {len(error.readings)} ways:", file=sys.stderr)
    for number, reading in enumerate(error.readings, start=1):
        print(f"  {number}  {printable(reading.line())}; {reading.evidence}", file=sys.stderr)
    print("Which one? (a number, or Enter for none) ", end="", file=sys.stderr, flush=True)
    text = sys.stdin.readline().strip()
    return error.readings[int(text) - 1] if text.isdecimal() and 1 <= int(text) <= len(error.readings) else None


def print_skipped(skipped: Sequence[object], most: int | None = None) -> None:
    """Print a line on standard error for each skipped plan or order. With ``most``, only the first ``most`` lines are
    printed, and then the number of all further lines."""
    for reason in skipped[:most]:
        print(f"skipped: {printable(str(reason))}", file=sys.stderr)
    if most is not None and len(skipped) > most:
        print(f"skipped: {len(skipped) - most:,} more", file=sys.stderr)


def _plainly(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_PLAIN.get(character, "?") for character in error.object[error.start : error.end]), error.end
