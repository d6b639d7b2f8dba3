"""Set-up of Warp for petmjx: the folder of its compiled kernels (petmjx/common/compile_caches.py), and silence.

The settings apply to the whole process. petmjx makes these settings when it first uses Warp. The settings remain, so
they also affect the caller's own Warp programs. A setting that the caller has changed earlier is not touched.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from petmjx.common.compile_caches import cache_folder
from petmjx.common.machine import cuda_devices


def set_up_warp() -> None:
    """Place Warp's kernel cache beside JAX's, stop Warp from printing, and keep its tiles off the stack.

    A setting is changed only if it still has Warp's default. (Warp sets its cache folder when it starts.) With tiles on
    the stack, all threads of an x86 CPU would share one pointer to them, so launches in several threads would write
    into each other's tiles.

    Raises:
        EngineUnavailable: no folder for compiled kernels is writable.
    """
    import warp

    if warp.config.kernel_cache_dir is None:
        warp.config.kernel_cache_dir = str(cache_folder("warp"))
    if warp.config.enable_tiles_in_stack_memory:
        warp.config.enable_tiles_in_stack_memory = None  # Warp then decides; on x86 it keeps tiles off the stack
    if warp.config.log_level == warp.LOG_INFO:
        warp.config.log_level = warp.LOG_ERROR
    if not cuda_devices():
        with _nothing_on_stderr():
            warp.init()


@contextmanager
def _nothing_on_stderr() -> Iterator[None]:
    """Discard what native code writes to standard error. Warp reports a missing CUDA driver there, but petmjx checks
    for the driver itself."""
    sys.stderr.flush()
    saved_descriptor = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(saved_descriptor, 2)
        os.close(saved_descriptor)
