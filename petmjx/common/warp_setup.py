"""Sets up Warp for petmjx: where it keeps compiled kernels, and that it prints nothing.

Where they are: petmjx/common/compile_caches.py. These are settings of the process. Who needs Warp first makes them;
they stay, and they also apply to the caller's own Warp programs. If the caller has set one of them before, it is not
changed.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from petmjx.common.compile_caches import cache_folder
from petmjx.common.machine import cuda_devices


def set_up_warp() -> None:
    """Put Warp's kernel cache beside JAX's, and stop Warp from printing. Raises EngineUnavailable: no folder for it.

    Each setting is changed only if it still has Warp's default. (Warp sets its cache folder when it starts.) If tiles
    are on the stack, Warp has one pointer to them for all threads of an x86 CPU: launches in several threads would
    write through one another's.
    """
    import warp

    if warp.config.kernel_cache_dir is None:
        warp.config.kernel_cache_dir = str(cache_folder("warp"))
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
