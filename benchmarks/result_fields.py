"""Fields that every result has beside its numbers: commit, versions, date, memory. This module also writes and reads
files of JSON lines."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from petmjx.common.errors import InputError
from petmjx.common.machine import cpu_name, cpu_threads, package_versions

COMMIT_VARIABLE = "PETMJX_COMMIT"
"""Environment variable that names the commit, for a copy of the source without git history."""

DIGITS = 6
"""Significant digits of numbers in a result."""

_KIB = 1024

Result = dict[str, Any]
"""One line of results. benchmarks/README.md explains its fields."""


def commit() -> str:
    """The commit of the source, followed by "-dirty" if files differ from the commit; "unknown" if there is no git
    history."""
    if named := os.environ.get(COMMIT_VARIABLE):
        return named
    git = ["git", "-C", str(Path(__file__).resolve().parent), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(git, capture_output=True, text=True, check=False)
    except OSError:
        return "unknown"
    return done.stdout.strip() or "unknown"


def environment() -> Result:
    """The fields that every result of this process has."""
    return {
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "cpu": f"{cpu_name()}, {cpu_threads()} threads",
        "versions": {"python": platform.python_version(), **package_versions()},
    }


@dataclass
class Clock:
    """Measured values: seconds, CPU seconds of the whole process, largest memory."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_rss_bytes: int = 0


@contextlib.contextmanager
def timed() -> Iterator[Clock]:
    """Measure the body. The clock is filled at its end."""
    with contextlib.suppress(OSError):  # resets the largest memory, if the system supports this
        Path("/proc/self/clear_refs").write_text("5")
    clock = Clock()
    cpu_s, begin = time.process_time(), time.perf_counter()
    yield clock
    clock.wall_s, clock.cpu_s = time.perf_counter() - begin, time.process_time() - cpu_s
    clock.peak_rss_bytes = _peak_rss_bytes()


def _peak_rss_bytes() -> int:
    """Largest memory of this process since the reset; if that is not possible, since the process began."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        unit = 1 if sys.platform == "darwin" else _KIB
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return next(int(line.split()[1]) * _KIB for line in lines if line.startswith("VmHWM"))


def peak_device_bytes() -> int | None:
    """Largest memory of JAX on its device since the process began (without Warp's own pool)."""
    jax = sys.modules.get("jax")
    if jax is None:
        return None
    stats = jax.devices()[0].memory_stats() or {}
    return stats.get("peak_bytes_in_use")


def append_line(path: Path, result: Result) -> None:
    """Append a result to a file of JSON lines.

    Raises:
        InputError: the file cannot be written.
    """
    exact = json.dumps(result, allow_nan=False)
    short = json.loads(exact, parse_float=lambda text: float(f"{float(text):.{DIGITS}g}"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as out:
            out.write(json.dumps(short, ensure_ascii=False) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def read_lines(paths: Sequence[Path]) -> list[Result]:
    """All results in the files, in their order.

    Raises:
        InputError: a file that cannot be read, or a line that is no JSON object.
    """
    results = []
    for path in paths:
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
        for number, line in enumerate(lines, start=1):
            try:
                result = json.loads(line)
            except ValueError as error:
                raise InputError(f"{path}: line {number}: no JSON: {error}") from error
            if not isinstance(result, dict):
                raise InputError(f"{path}: line {number}: must be a JSON object")
            results.append(result)
    return results
