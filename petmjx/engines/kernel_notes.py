"""Notes in Warp's cache that tell which kernels of mjx-warp are compiled. Only Warp can tell whether a kernel is in its
cache, and Warp needs a second or two to start. A note can be read without Warp."""

from __future__ import annotations

import functools
import hashlib
from contextlib import suppress
from pathlib import Path
from typing import Final

from petmjx.common.compile_caches import cache_folder
from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import package_versions

CPU_KERNEL: Final = "cpu-kernel"
"""The name of the kernel for CPUs."""


def note_kernels(name: str) -> None:
    """Write a note that the kernels called ``name`` are now in Warp's cache. If the cache cannot be written, no note is
    written."""
    with suppress(OSError, EngineUnavailable):
        _file_of(name).touch()


def are_noted(name: str) -> bool:
    """Whether there is a note that the kernels called ``name`` are compiled from the current sources."""
    with suppress(OSError, EngineUnavailable):
        return _file_of(name).exists()
    return False


def _file_of(name: str) -> Path:
    """The file of a note. The file is in Warp's cache, so it is deleted together with the kernels."""
    return cache_folder("warp") / f"{name}-{kernel_code()}"


@functools.cache
def kernel_code() -> str:
    """A digest of what determines the kernels: their sources, and the versions of packages."""
    digest = hashlib.sha256(repr(sorted(package_versions().items())).encode())
    for file in sorted((Path(__file__).parent / "warp").rglob("*")):
        if file.suffix in _SOURCES:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


_SOURCES: Final = (".py", ".cu", ".cuh")
