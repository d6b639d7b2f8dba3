"""Starts the libraries that an engine needs on a GPU, and compiles its kernels, before the first world."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from contextlib import suppress

from petmjx.common.garbage_collection import no_collection
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.subprocess.kernel_builds import KernelBuilds, builds_if_missing, note_kept
from petmjx.options.simulation import Simulation


def start_gpu() -> None:
    """Start JAX and Warp, and load the modules of ``mjx-warp``. The call takes a second or two. No garbage is collected
    during the call, which would take a quarter longer if the collector scanned the many new objects. Starting JAX's
    devices is mostly waiting for the driver, so modules are loaded at the same time. Errors are ignored here: the
    engine that needs these libraries reports them."""
    with suppress(Exception), no_collection(lasting=True):
        jax_setup = importlib.import_module("petmjx.engines.mjx.jax_setup")
        devices = threading.Thread(target=_without_errors, args=(jax_setup.set_up_jax,), name="petmjx-devices")
        devices.start()
        set_up_warp()
        importlib.import_module("petmjx.engines.warp.engine")
        devices.join()
        importlib.import_module("warp").init()
        jax = importlib.import_module("jax")
        jax.jit(lambda x: x + 1).lower(0.0).compile()  # loads JAX's modules that lower and compile programs


def _without_errors(start: Callable[[], None]) -> None:
    with suppress(Exception):
        start()


def begin_builds(sim: Simulation) -> KernelBuilds | None:
    """Start processes that compile the kernels of ``mjx-warp`` that most runs need. The result is None if an earlier
    run has compiled these kernels. Errors are ignored here: the engine compiles missing kernels itself, and then
    reports errors."""
    with suppress(Exception):
        return builds_if_missing(sim)
    return None


def compile_ahead(sim: Simulation, builds: KernelBuilds | None) -> None:
    """Load the kernels of ``mjx-warp`` that most runs need, once the processes of ``begin_builds`` have compiled them.
    Call this function after ``start_gpu``. Errors are ignored here: the engine reports them."""
    with suppress(Exception):
        if importlib.import_module("petmjx.engines.warp.compiled_programs").load_usual_kernels(sim, builds):
            note_kept(sim)
