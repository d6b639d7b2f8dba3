"""Declares the constraint solver, which is CUDA C++, as a Warp function. For the method see
petmjx/engines/warp/solver/newton.py."""

from __future__ import annotations

from typing import Any

import warp as wp

from petmjx.engines.warp.solver.newton import PANELS_MACRO
from petmjx.engines.warp.world_arrays import EFC_WORDS, PANEL, Model, Workspace


@wp.func_native(
    f"petmjx::newton<{PANELS_MACRO}, {PANEL}, {EFC_WORDS}>"
    "(model, block, thread, threads, changed, forces,"
    " petmjx::begin_of(shared), shared_words, work);"
)
def newton(
    # Model:
    model: Model,
    # In:
    block: int,
    thread: int,
    threads: int,
    changed: bool,
    forces: bool,
    shared: Any,
    shared_words: int,
    # Data out:
    work: Workspace,
) -> None:
    """Compute the accelerations and contact forces of the world that a lane simulates, in at most ``model.iterations``
    iterations. A lane is a thread block, or one warp of a block.

    ``changed``: whether contacts, or the order of bodies, have changed since the last call. ``forces``: whether contact
    forces are needed, too. If ``forces`` is False, ``contact_force`` may belong to the accelerations before the last
    iteration.

    Reads the accelerations to start from, and the constraints and bodies of contacts. Writes ``qacc``,
    ``contact_force``, ``solver_niter`` and ``solver_paused``. If ``solver_paused`` is not zero, the solver has paused,
    and the next call continues. Other arrays of the workspace are scratch. ``shared`` is a tile in shared memory with
    ``shared_words`` numbers for each world of a block. The tile holds rows of the factor and, if it fits, the Hessian.
    """


@wp.func_native("return PETMJX_PAUSE_AFTER > 0 && paused.data[lane] != 0;")
def in_pause(paused: wp.array[int], lane: int) -> bool:
    """Whether a lane's solver has paused; ``paused`` is the array ``solver_paused``. In kernels without pauses, the
    result is a constant, so the compiler leaves out the code for pauses."""
