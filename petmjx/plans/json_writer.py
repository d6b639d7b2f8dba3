"""Writer of JSON files of plans in BED-BPP's format."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import IO, Any

from petmjx.common.argument_checks import path_of
from petmjx.common.atomic_write import atomic_write, gzip_stream
from petmjx.common.errors import InputError
from petmjx.common.text import printable

Placement = dict[str, Any]
"""One placement in BED-BPP's format: item, orientation, flb_coordinates (mm)."""


def write_plans(
    path: Path | str,
    plans: Iterable[tuple[str, list[Placement]]],
    *,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Write (plan id, placements) pairs as one BED-BPP object, one line per placement.

    The file appears only when it is complete. Its bytes depend only on the plans: the gzip header has no time stamp.

    Raises:
        InputError: there is no plan, or the file cannot be written.
    """
    path = path_of(path, "path")
    coming = iter(plans)
    first = next(coming, None)
    if first is None:
        raise InputError(f"{printable(str(path))}: there is no plan to write")
    with atomic_write(path) as temporary, ExitStack() as stack:
        if isinstance(coming, Generator):
            stack.callback(coming.close)  # closed even after an error: else its worker processes would live on
        out = _open_text(temporary, stack)
        out.write("{")
        for count, (plan_id, placements) in enumerate(chain([first], coming), start=1):
            lines = ",\n".join("  " + json.dumps(placement, ensure_ascii=False) for placement in placements)
            separator = "," if count > 1 else ""
            out.write(f"{separator}\n{json.dumps(plan_id)}: [\n{lines}\n]")
            if progress is not None:
                progress(count)
        out.write("\n}\n")


def _open_text(path: Path, stack: ExitStack) -> IO[str]:
    if path.suffix != ".gz":
        return stack.enter_context(path.open("w", encoding="utf-8", newline="\n"))
    raw = stack.enter_context(path.open("wb"))
    packed = stack.enter_context(gzip_stream(raw))
    return stack.enter_context(io.TextIOWrapper(packed, encoding="utf-8", newline="\n"))
