"""Sets up JAX and Warp for petmjx: device memory shared between the two, compiled programs kept between runs.

XLA's programs go to JAX's persistent cache, Warp's kernels to Warp's own. Both live under ``$PETMJX_CACHE_DIR``
(default: ``~/.cache/petmjx``); a user's own JAX or Warp setting wins.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jax

MIN_COMPILE_S = 0.5
"""Programs that compile faster than this are not worth a file."""


def cache_dir() -> Path:
    """Where compiled programs are kept."""
    named = os.environ.get("PETMJX_CACHE_DIR")
    return Path(named) if named else Path.home() / ".cache" / "petmjx"


def set_up_jax() -> None:
    """Turn on JAX's persistent compilation cache, unless the user has set one. Call before the first computation."""
    # Warp takes device memory beside XLA: the pool that XLA would grab at its start has to be left to both.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None:
        config.update("jax_compilation_cache_dir", str(cache_dir() / "jax"))
        config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_S)


def set_up_warp() -> None:
    """Point Warp's kernel cache beside JAX's, and keep Warp from printing into what petmjx prints."""
    import warp

    if "WARP_CACHE_PATH" not in os.environ:
        warp.config.kernel_cache_dir = str(cache_dir() / "warp")
    warp.config.log_level = warp.LOG_ERROR
