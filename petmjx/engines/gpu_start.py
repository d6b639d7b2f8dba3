"""Starts the libraries that an engine needs on a GPU, and compiles its kernels, before the first world."""

from __future__ import annotations

import importlib
from contextlib import suppress

from petmjx.common.warp_setup import set_up_warp
from petmjx.options.simulation import Simulation


def start_gpu() -> None:
    """Start JAX and Warp, and load the modules of ``mjx-warp``. This takes a second or two. Errors are ignored here:
    the engine that needs these libraries reports them."""
    with suppress(Exception):
        importlib.import_module("petmjx.engines.mjx.jax_setup").set_up_jax()
        set_up_warp()
        importlib.import_module("petmjx.engines.warp.engine")
        importlib.import_module("warp").init()
        jax = importlib.import_module("jax")
        jax.jit(lambda x: x + 1).lower(0.0).compile()  # this loads the modules that lower and compile a program


def compile_ahead(sim: Simulation) -> None:
    """Compile the kernels of ``mjx-warp`` that most runs need. Call it after ``start_gpu``. The first time on a
    machine, it takes about twenty seconds. Errors are ignored here: the engine reports them."""
    with suppress(Exception):
        importlib.import_module("petmjx.engines.warp.programs").load_usual_kernels(sim)
