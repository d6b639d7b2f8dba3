"""Sets up JAX and Warp for petmjx: device memory shared between the two, compiled programs kept between runs.

XLA's programs go to JAX's persistent cache, Warp's kernels to Warp's own. Both live under ``$PETMJX_CACHE_DIR``
(default: ``~/.cache/petmjx``). Where caches are, and that Warp is silent, are settings of the process: the first engine
that is built makes them, they stay, and they also hold for the caller's own JAX and Warp programs. What the caller has
set before wins.
"""

from __future__ import annotations

import functools
import os
from pathlib import Path
from typing import Any

import jax

from petmjx.machine import jax_devices

MIN_COMPILE_S = 0.0
"""Programs that compile faster than this are not kept. A run has some hundred small ones: seconds, together."""

CPU_COMPILER_OPTIONS = {"xla_cpu_enable_concurrency_optimized_scheduler": False}
"""With XLA's CPU scheduler that is optimised for concurrency, programs of stages stop for ever in XLA's thread pool
(jaxlib 0.10.2, two cores: 7 runs of 7; without it 0 of 4)."""


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
    """What ``jax.jit`` is to be given as ``compiler_options`` for large programs on this backend.

    Options go with each program, not into ``XLA_FLAGS``: those are read once, may have been by the time petmjx is
    imported, and end the process where XLA does not know one.
    """
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x + 1).lower(0.0).compile(compiler_options=dict(CPU_COMPILER_OPTIONS))
    except jax.errors.JaxRuntimeError:
        return {}  # this jaxlib has no such option, so nothing that could be switched off
    return dict(CPU_COMPILER_OPTIONS)


def set_up_warp() -> None:
    """Point Warp's kernel cache beside JAX's, and keep Warp from printing into what petmjx prints.

    Each only where it is as Warp has it: a folder is set when the user sets one or Warp has started.
    """
    import warp

    if warp.config.kernel_cache_dir is None and "WARP_CACHE_PATH" not in os.environ:
        warp.config.kernel_cache_dir = str(cache_dir() / "warp")
    if warp.config.log_level == warp.LOG_INFO:
        warp.config.log_level = warp.LOG_ERROR
