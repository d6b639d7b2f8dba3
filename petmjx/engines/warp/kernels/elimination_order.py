"""The elimination order: the order of a world's bodies in the solver's system.

Bodies are ordered by their distance, counted in contacts, from the body that is farthest from the carrier. Bodies that
touch should be near one another in this order, so that the Hessian's envelope is narrow (Cuthill and McKee, "Reducing
the bandwidth of sparse symmetric matrices", 1969). In packing order the factor takes twice the operations
(benchmarks/notebook/performance.md). The order is part of a world's state, and is renewed at fixed steps. So the order
does not depend on the thread blocks that have simulated the world.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_threads import any_of_all, wait_for_all
from petmjx.engines.warp.kernels.motion import body_of
from petmjx.engines.warp.world_arrays import Ref, State, Thread, Workspace, Worlds

RENEWED_EVERY = wp.constant(25)
"""Steps between two renewals. Contacts change when a box is placed, about every 60 steps, and while boxes fall."""

UNREACHED = wp.constant(1 << 30)


@wp.func
def body_position(state: Ref[State], world: int, body: int) -> int:
    """Position of a body among all placed bodies. Body 0 is the carrier, then come the boxes."""
    if body == 0:
        return state.carrier_position[world]
    return state.position[world, body - 1]


@wp.func
def free_position(state: Ref[State], at: Thread, free_body: int) -> int:
    """Position of a free body among all free bodies. A held carrier is no free body."""
    position = body_position(state, at.world, free_body + at.held)
    if at.held != 0 and position > state.carrier_position[at.world]:
        position -= 1
    return position


@wp.func
def _find_levels(
    # Model:
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    npair: int,
    root: int,
    # Data out:
    work: Ref[Workspace],
) -> None:
    """Find each body's distance from the root, counted in contacts."""
    block = at.block
    for body in range(at.thread, at.placed + 1, at.threads):
        work.body_level[block, body] = wp.where(body == root, 0, UNREACHED)
    wait_for_all()
    for level in range(at.placed + 1):
        any_reached = bool(False)
        for pair in range(at.thread, npair, at.threads):
            one = body_of(worlds, at.world, work.pair_geom1[block, pair])
            if one >= 0 and work.pair_conadr[block, pair + 1] > work.pair_conadr[block, pair]:
                two = body_of(worlds, at.world, work.pair_geom2[block, pair])
                of_one = work.body_level[block, one]
                of_two = work.body_level[block, two]
                if of_one == level and of_two == UNREACHED:
                    work.body_level[block, two] = level + 1
                    any_reached = True
                if of_two == level and of_one == UNREACHED:
                    work.body_level[block, one] = level + 1
                    any_reached = True
        if not any_of_all(any_reached):
            break


@wp.func
def renew_order(
    # Model:
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    npair: int,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> None:
    """Renew the order of bodies from the contacts of this step. Bodies of one level stay in packing order."""
    block = at.block
    n = at.placed + 1
    _find_levels(worlds, at, npair, 0, work)
    root = int(0)
    for body in range(n):
        level = work.body_level[block, body]
        if level != UNREACHED and level > work.body_level[block, root]:
            root = body
    wait_for_all()
    _find_levels(worlds, at, npair, root, work)
    for body in range(at.thread, n, at.threads):
        level = work.body_level[block, body]
        position = int(0)
        for other in range(n):
            its = work.body_level[block, other]
            if its < level or (its == level and other < body):
                position += 1
        if body == 0:
            state.carrier_position[at.world] = position
        else:
            state.position[at.world, body - 1] = position
    wait_for_all()
