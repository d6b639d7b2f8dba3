"""What is written beside every number: commit, device, versions, date; and the file that takes the lines."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import resource
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from petmjx.errors import InputError
from petmjx.machine import cpu_name, cpu_threads, cuda_devices, package_versions

COMMIT_VARIABLE = "PETMJX_COMMIT"
"""Environment variable that names the commit where the source stands without its history."""

DIGITS = 6
"""Significant digits of numbers in a result."""

_KIB = 1024


def commit() -> str:
    """The source's commit, "-dirty" where files differ from it, or "unknown"."""
    named = os.environ.get(COMMIT_VARIABLE)
    if named:
        return named
    git = ["git", "-C", str(Path(__file__).resolve().parent), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(git, capture_output=True, text=True, check=False)
    except OSError:
        return "unknown"
    return done.stdout.strip() or "unknown"


def environment(date: str | None = None) -> dict[str, Any]:
    """The fields that every result of this process has."""
    return {
        "commit": commit(),
        "date": date or datetime.now(UTC).isoformat(timespec="seconds"),
        "cpu": f"{cpu_name()}, {cpu_threads()} threads",
        "versions": {"python": platform.python_version(), **package_versions()},
    }


def device_of(engine: str) -> str:
    """What an engine steps on, in words."""
    if engine == "mjx-warp" and cuda_devices():
        return cuda_devices()[0]
    if engine == "mjx-jax":
        import jax

        device = jax.devices()[0]
        return str(device.device_kind) if device.platform != "cpu" else cpu_name()
    return cpu_name()


def reset_peak_memory() -> None:
    """Start the high-water mark of this process anew, where the system can."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory_bytes() -> int:
    """Most memory that this process has held since ``reset_peak_memory`` (where that works; else since its start)."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        unit = 1 if sys.platform == "darwin" else _KIB
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return next(int(line.split()[1]) * _KIB for line in lines if line.startswith("VmHWM"))


def peak_device_bytes() -> int | None:
    """Most memory that JAX has held on its device since the process began (Warp's own pool is not in it)."""
    jax = sys.modules.get("jax")
    if jax is None:
        return None
    stats = jax.devices()[0].memory_stats() or {}
    return stats.get("peak_bytes_in_use")


def append_line(path: Path, result: dict[str, Any]) -> None:
    """Append a result to a file of JSON lines.

    Raises:
        InputError: the file cannot be written.
    """
    line = json.dumps(rounded(result), ensure_ascii=False, allow_nan=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as out:
            out.write(line + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def rounded(value: Any) -> Any:
    """The value with its floats cut to ``DIGITS`` significant digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    return value
