"""The solver as a Warp function. The method: petmjx/engines/warp/newton.py."""

from __future__ import annotations

from typing import Any

import warp as wp

from petmjx.engines.warp.newton import PANELS_MACRO
from petmjx.engines.warp.records import PANEL, ROW_WORDS, Model, Workspace


@wp.func_native(
    f"petmjx::newton<{PANELS_MACRO}, {PANEL}, {ROW_WORDS}>"
    "(block, thread, threads, limit, changed, forces, model, work, near.data.ptr, near_words);"
)
def newton(
    block: int,
    thread: int,
    threads: int,
    limit: int,
    changed: bool,
    forces: bool,
    model: Model,
    work: Workspace,
    near: Any,
    near_words: int,
) -> None:
    """Accelerations and contact forces of a block's world, by at most ``limit`` iterations.

    ``changed``: contacts, or the order of bodies, are others than at the last call. ``forces``: those of contacts are
    wanted, too; else ``force`` may be of the accelerations before the last iteration.

    Reads the accelerations to start from, and rows and links of contacts. Writes ``acceleration`` and ``force`` (of
    each contact, in its frame), and the number of iterations. Uses other arrays of the workspace as scratch, and
    ``near``, a tile in shared memory, for rows of the factor and the Hessian if they fit.
    """
