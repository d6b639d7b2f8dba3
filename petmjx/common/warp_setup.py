"""Set-up of Warp for petmjx: chooses the folder of compiled kernels (petmjx/common/compile_caches.py), and stops Warp
from printing.

petmjx changes Warp's settings when it first uses Warp. The settings apply to the whole process, including the caller's
own Warp programs. A setting that the caller has already changed stays as it is.
"""

from __future__ import annotations

import functools
import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import ModuleType

from petmjx.common.compile_caches import cache_folder
from petmjx.common.machine import cuda_devices, why_no_warp_on_cpu


def set_up_warp() -> None:
    """Choose a folder beside JAX's cache for the kernels that Warp compiles, stop Warp from printing, and keep Warp's
    tiles (arrays shared by the threads of a block) off the stack.

    A setting is changed only if it still has Warp's default. (The cache folder has the default None until Warp starts.)
    If tiles were on the stack, all threads of an x86 CPU would share one pointer to the tiles, and launches from
    several threads would write into each other's tiles.

    Raises:
        EngineUnavailable: no folder for compiled kernels is writable.
    """
    import warp

    if warp.config.kernel_cache_dir is None:
        warp.config.kernel_cache_dir = str(cache_folder("warp"))
    if warp.config.enable_tiles_in_stack_memory:
        warp.config.enable_tiles_in_stack_memory = None  # with None, Warp keeps tiles off the stack on x86
    if warp.config.log_level == warp.LOG_INFO:
        warp.config.log_level = warp.LOG_ERROR
    if not cuda_devices():
        with _nothing_on_stderr():
            warp.init()


@functools.cache
def machine_code(name: str) -> ModuleType | None:
    """The Python module called ``name``, whose functions launch Warp kernels on a CPU. The module lists these kernels
    in ``KERNELS``. The kernels are compiled, or loaded if an earlier process has compiled them. The result is None if
    Warp is not installed, or cannot compile the kernels."""
    if why_no_warp_on_cpu() is None:
        with suppress(Exception):  # if Warp raises anything, the caller uses NumPy
            import warp

            module = importlib.import_module(name)
            set_up_warp()
            for kernel in module.KERNELS:
                warp.load_module(kernel.module, device="cpu")  # must happen before several threads launch the kernel
            return module
    return None


@contextmanager
def _nothing_on_stderr() -> Iterator[None]:
    """While the body runs, discard what native code writes to standard error. Warp would report a missing CUDA driver,
    which petmjx reports itself."""
    sys.stderr.flush()
    saved_descriptor = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(saved_descriptor, 2)
        os.close(saved_descriptor)
