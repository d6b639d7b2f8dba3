"""Parallel reading of large JSON files of plans: several interpreters read a piece of the text each.

The text is cut where a plan seems to end. Each piece is read as a file of its own. If all pieces are sound JSON, all
cuts were between plans, and the plans are those of the whole text. Otherwise the caller reads the text in one go, and
reports its errors.
"""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any, Final, NamedTuple

import numpy as np

from petmjx.common.machine import cpu_threads, own_environment
from petmjx.plans.input_conventions import InputConventions
from petmjx.plans.json_reader import scan_plans
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import UnreadFields
from petmjx.plans.plan_validation import PlanError, parse_plan
from petmjx.plans.plan_warnings import PlanWarnings, check_layout

WORTH_BYTES: Final = 12 << 20
"""Least length of a text that is read in pieces: 10 MB take 0.4 s, and an interpreter takes 0.3 s to start."""

PIECE_BYTES: Final = 4 << 20
"""Least length of a piece."""

_BETWEEN_PLANS: Final = re.compile(rb'\}[ \t\n\r]*+\][ \t\n\r]*+(,)[ \t\n\r]*+"')
"""The end of a plan's last placement, and the beginning of the next id."""

_CODE: Final = "from petmjx.plans.parallel_json import main; main()"

_MARK: Final = b"petmjx pieces\n"
"""Mark before each answer. The user's sitecustomize may print when an interpreter starts; without the mark that output
is not unpickled."""


class ReadEntry(NamedTuple):
    """One entry of a file after reading: a plan, a faulty entry, or an order.

    Attributes:
        plan: the plan; None for a faulty entry or an order.
        layout: warnings about the plan's layout; None: nothing is odd.
        fault: the error of a faulty entry; None for a plan or an order.
    """

    plan_id: str
    plan: Plan | None = None
    layout: PlanWarnings | None = None
    fault: str | None = None


@dataclass(frozen=True)
class PieceOptions:
    """Options for reading pieces: the arguments of ``load_plans`` that apply to a single plan."""

    source: str
    max_boxes: int
    extent_mm: tuple[float, float] | None
    given: InputConventions


def read_in_pieces(data: bytes | bytearray, options: PieceOptions, unread: UnreadFields) -> list[ReadEntry] | None:
    """The entries of a large text, in order; None if the caller must read it in one go.

    Args:
        unread: gets the counts of fields that petmjx does not read.
    """
    pieces = _cut(data, min(cpu_threads(), len(data) // PIECE_BYTES))
    if len(pieces) < 2:
        return None
    read: list[tuple[list[ReadEntry], UnreadFields] | None] = []
    children: list[subprocess.Popen[bytes]] = []
    try:
        with ThreadPoolExecutor(len(pieces), thread_name_prefix="petmjx-read") as pool:
            try:
                children += (_reader_process() for _ in pieces)
                read += pool.map(lambda child, piece: _answer(child, options, piece), children, pieces)
            finally:  # inside the pool's block: after ctrl-C its exit waits for threads, and these for whole pieces
                for child in children:
                    with suppress(OSError):
                        child.kill()
    except (OSError, RuntimeError):  # no memory for a process or a thread, or Python is embedded in another program
        return None
    finally:
        for child in children:
            child.wait()
    if any(answer is None for answer in read):
        return None
    for _, counts in filter(None, read):
        unread.update(counts)
    return [entry for entries, _ in filter(None, read) for entry in entries]


def _cut(data: bytes | bytearray, count: int) -> list[list[memoryview | bytes]]:
    """At most ``count`` pieces of a text. Each piece is a JSON object if the text was cut between plans."""
    cuts: list[int] = []
    for number in range(1, count):
        match = _BETWEEN_PLANS.search(data, max(len(data) * number // count, cuts[-1] if cuts else 0))
        if match is not None:
            cuts.append(match.start(1))
    view, begins, ends = memoryview(data), [0, *(cut + 1 for cut in cuts)], [*cuts, len(data)]
    last = len(cuts)
    return [
        [*([b"{"] if number else []), view[begin:end], *([b"}"] if number < last else [])]
        for number, (begin, end) in enumerate(zip(begins, ends, strict=True))
    ]


def _reader_process() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", _CODE],
        env={**own_environment(), "OPENBLAS_NUM_THREADS": "1"},  # further threads are not used, and take time to start
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def _answer(
    child: subprocess.Popen[bytes], options: PieceOptions, piece: Sequence[memoryview | bytes]
) -> tuple[list[ReadEntry], UnreadFields] | None:
    """The entries that an interpreter read from a piece, and counts of unread fields.

    None: the piece is no sound JSON, or the interpreter died, or its output does not start with the mark.
    """
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        with child.stdin as pipe:
            pickle.dump(options, pipe)
            for some in piece:
                pipe.write(some)
        with child.stdout as pipe:
            answer = pickle.load(pipe) if pipe.read(len(_MARK)) == _MARK else None
    except (OSError, EOFError, pickle.UnpicklingError):
        return None
    return None if answer is None else (list(_unpacked_entries(*answer[:-1])), answer[-1])


def main() -> None:
    """Read a piece from standard input, and write its entries to standard output."""
    options: PieceOptions = pickle.load(sys.stdin.buffer)
    answer = None
    with suppress(Exception):  # the caller then reads the whole text, and reports its errors
        unread = UnreadFields()
        answer = *_packed_entries(list(_entries(sys.stdin.buffer.read(), options, unread))), unread
    sys.stdout.buffer.write(_MARK)
    pickle.dump(answer, sys.stdout.buffer, protocol=pickle.HIGHEST_PROTOCOL)


def _entries(data: bytes, options: PieceOptions, unread: UnreadFields) -> Iterator[ReadEntry]:
    names: dict[str, str] = {}
    for entry in scan_plans(data):
        if isinstance(entry.value, dict) and "item_sequence" in entry.value:
            yield ReadEntry(entry.plan_id)
            continue
        try:
            plan = parse_plan(
                entry.plan_id, options.source, entry.value, options.max_boxes, names, unread, options.given
            )
        except PlanError as error:
            yield ReadEntry(entry.plan_id, fault=str(error))
        else:
            layout = check_layout(plan.plan_id, plan.source, plan.corner_mm, plan.size_mm, options.extent_mm)
            yield ReadEntry(plan.plan_id, plan, layout if layout.any else None)


_FIELDS: Final = tuple(field.name for field in fields(Plan))
_ARRAYS: Final = ("size_mm", "corner_mm", "mass_kg", "sequence", "orientation")
"""Arrays that every plan of a file has. Those of all plans of a piece are concatenated for the transfer."""

_OTHERS: Final = tuple(name for name in _FIELDS if name not in _ARRAYS)


def _packed_entries(entries: Sequence[ReadEntry]) -> tuple[list[Any], dict[str, Any]]:
    """Entries in the form of the transfer: a row for each entry, and the concatenated arrays of all plans."""
    plans = [entry.plan for entry in entries if entry.plan is not None]
    rows = [
        (*entry[2:], entry.plan_id, None)
        if entry.plan is None
        else (*entry[2:], entry.plan.n_boxes, tuple(getattr(entry.plan, name) for name in _OTHERS))
        for entry in entries
    ]
    return rows, {name: np.concatenate([getattr(plan, name) for plan in plans]) for name in _ARRAYS if plans}


def _unpacked_entries(rows: Sequence[Any], arrays: dict[str, Any]) -> Iterator[ReadEntry]:
    begin = 0
    for layout, fault, of_plan, others in rows:
        if others is None:
            yield ReadEntry(of_plan, None, layout, fault)
            continue
        plan, end = object.__new__(Plan), begin + of_plan  # no check: the interpreter that read it has checked it
        for name, value in zip(_OTHERS, others, strict=True):
            object.__setattr__(plan, name, value)
        for name, values in arrays.items():
            object.__setattr__(plan, name, values[begin:end])
        begin = end
        yield ReadEntry(plan.plan_id, plan, layout, fault)
