"""Sets up JAX and Warp for petmjx: device memory shared between the two, compiled programs kept between runs.

XLA's programs are kept in JAX's persistent cache, Warp's kernels in Warp's cache. Both are under ``$PETMJX_CACHE_DIR``
(default: ``~/.cache/petmjx``). The folders of the caches, and that Warp prints nothing, are settings of the process.
The first engine makes them; they stay, and they also apply to the caller's own JAX and Warp programs. If the caller has
set one of them before, it is not changed.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax

from petmjx.basics.machine import cuda_devices, jax_devices

MIN_COMPILE_S = 0.0
"""Programs that compile faster than this are not kept. A run has about a hundred small ones, together some seconds."""

CPU_COMPILER_OPTIONS = {"xla_cpu_enable_concurrency_optimized_scheduler": False}
"""With XLA's CPU scheduler that is optimised for concurrency, programs of mjx-jax hang in XLA's thread pool (jaxlib
0.10.2, two cores: 7 runs of 7; without it 0 of 4)."""


def cache_dir() -> Path:
    """Where compiled programs are kept."""
    named = os.environ.get("PETMJX_CACHE_DIR")
    return Path(named) if named else Path.home() / ".cache" / "petmjx"


def set_up_jax() -> None:
    """Start JAX's devices and turn on its persistent compilation cache, unless the user has set one."""
    jax_devices()
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None:
        config.update("jax_compilation_cache_dir", str(cache_dir() / "jax"))
        config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_S)


@functools.cache
def compiler_options() -> dict[str, bool]:
    """The ``compiler_options`` of ``jax.jit`` for large programs on this backend.

    They are given with each program and not in ``XLA_FLAGS``. XLA reads those flags once, perhaps before petmjx is
    imported, and ends the process if it does not know one of them.
    """
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x + 1).lower(0.0).compile(compiler_options=dict(CPU_COMPILER_OPTIONS))
    except jax.errors.JaxRuntimeError:
        return {}  # this jaxlib has no such option, so there is nothing to switch off
    return dict(CPU_COMPILER_OPTIONS)


def set_up_warp() -> None:
    """Put Warp's kernel cache beside JAX's, and stop Warp from printing.

    Each setting is changed only if it still has Warp's default. (Warp sets its cache folder when it starts.) If tiles
    are on the stack, Warp has one pointer to them for all threads of an x86 CPU: launches in several threads would
    write through one another's.
    """
    import warp

    if warp.config.kernel_cache_dir is None and "WARP_CACHE_PATH" not in os.environ:
        warp.config.kernel_cache_dir = str(cache_dir() / "warp")
    if warp.config.enable_tiles_in_stack_memory:
        warp.config.enable_tiles_in_stack_memory = None  # by architecture: on x86 they are not
    if warp.config.log_level == warp.LOG_INFO:
        warp.config.log_level = warp.LOG_ERROR
    if not cuda_devices():
        with _nothing_on_stderr():
            warp.init()


@contextmanager
def _nothing_on_stderr() -> Iterator[None]:
    """Keep off the terminal what native code writes there: that there is no CUDA driver, which is known."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
