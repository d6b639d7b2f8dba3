"""Sets up JAX for petmjx. After this set-up, JAX leaves device memory for Warp, and keeps the programs that it compiles
in a cache on disk (JAX's persistent compilation cache).

The folder of this cache is a setting of the whole process. The first engine that is built sets the folder. The setting
remains, and also applies to the caller's own JAX programs. A folder that the caller has already set is not changed.
petmjx/common/warp_setup.py has the corresponding settings for Warp.
"""

from __future__ import annotations

import functools
import os
from typing import Any

import jax

from petmjx.common.compile_caches import VARIABLES, cache_folder, why_not_written
from petmjx.common.machine import jax_devices

MIN_COMPILE_S = 0.0
"""Programs that compile in less than this time (s) are not cached. With 0, all programs are cached, since a run has
about a hundred small programs, which together take some seconds to compile."""

CPU_COMPILER_OPTIONS = {
    # With the scheduler that is optimised for concurrency, programs of mjx-jax hang in XLA's thread pool. With jaxlib
    # 0.10.2 on two cores, 7 of 7 runs hung with this scheduler, and none of 4 runs without it.
    "xla_cpu_enable_concurrency_optimized_scheduler": False,
    # With the newer emitters of fused loops, compiling the programs of 12 plans takes 91 s of CPU time. Without these
    # emitters, compiling takes 59 s (jaxlib 0.10.2). The programs run equally fast.
    "xla_cpu_use_fusion_emitters": False,
}
"""XLA's options for large programs on a CPU. An option is left out if the installed jaxlib does not have it."""


def set_up_jax() -> None:
    """Start JAX's devices. If the user has not set a usable folder for JAX's cache of compiled programs, turn on the
    cache in petmjx's own folder."""
    jax_devices()
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None or (VARIABLES["jax"] in os.environ and why_not_written("jax")):
        config.update("jax_compilation_cache_dir", str(cache_folder("jax")))
        config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_S)


@functools.cache
def compiler_options() -> dict[str, bool]:
    """The ``compiler_options`` of ``jax.jit`` for large programs on JAX's default backend (CPU or GPU).

    The options are passed with each program and not in ``XLA_FLAGS``. XLA reads those flags only once, perhaps before
    petmjx is imported, and ends the process if a flag is unknown.
    """
    if jax.default_backend() != "cpu":
        return {}
    return {option: value for option, value in CPU_COMPILER_OPTIONS.items() if _has_option(option, value)}


def _has_option(option: str, value: bool) -> bool:
    try:
        jax.jit(lambda x: x + 1).lower(0.0).compile(compiler_options={option: value})
    except jax.errors.JaxRuntimeError:
        return False
    return True
