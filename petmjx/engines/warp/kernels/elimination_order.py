"""The elimination order: the order of a world's bodies in the solver's system.

Bodies that touch should be near one another in this order, so that the Hessian's envelope is narrow. So bodies are
ordered by their distance, counted in contacts, from a root at the rim of the pile (Cuthill and McKee, "Reducing the
bandwidth of sparse symmetric matrices", 1969). In packing order the factor takes twice the operations
(benchmarks/notebook/performance.md).

In a world of few boxes the root is the body that is farthest from the carrier. In a world of more than ``MANY_BOXES``
boxes, the carrier comes last in the order, and contacts with the carrier do not count in distances. (The carrier
touches the whole lowest layer. If its contacts counted, the boxes at two opposite ends of a pallet would be near one
another.) A component is a set of boxes that are joined by contacts, directly or through other boxes of the set. Each
component has a root of its own. With more than ``MANY_BOXES`` boxes, the order is also reversed, so that each component
ends with its root. A reversed order never has a wider envelope (Liu and Sherman, "Comparative analysis of the
Cuthill-McKee and the reverse Cuthill-McKee ordering algorithms for sparse matrices", 1976).

The order is part of a world's state, and is renewed at fixed steps. So the order does not depend on the thread blocks
that have simulated the world.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import any_of_all, wait_for_all
from petmjx.engines.warp.kernels.body_dynamics import body_of
from petmjx.engines.warp.world_arrays import Ref, State, Thread, Workspace, Worlds

RENEWED_EVERY = wp.constant(25)
"""Steps between two renewals. Contacts change when a box is placed, about every 60 steps, and while boxes fall."""

MANY_BOXES = wp.constant(96)
"""Largest number of placed boxes with which the carrier is ordered by its distance from the root, like the boxes,
instead of coming last. In generated plans of 10 to 80 boxes, few boxes stand on the carrier. For these plans, computing
the Cholesky factor takes fewer operations if the carrier does not come last."""

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
def _pair_of_bodies(worlds: Ref[Worlds], at: Thread, work: Ref[Workspace], pair: int, least: int) -> tuple[int, int]:
    """The two bodies of a pair of geoms that touch; (-1, -1) if they do not touch, or if the number of either body is
    less than ``least``."""
    if work.pair_conadr[at.block, pair + 1] == work.pair_conadr[at.block, pair]:
        return -1, -1
    one = body_of(worlds, at.world, work.pair_geom1[at.block, pair])
    two = body_of(worlds, at.world, work.pair_geom2[at.block, pair])
    if wp.min(one, two) < least:
        return -1, -1
    return one, two


@wp.func
def _find_components(
    # Model:
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    npair: int,
    # Data out:
    work: Ref[Workspace],
) -> None:
    """Find the number of the component of each box. A component is a set of boxes that are joined by contacts, and its
    number is the number of its first box. Contacts with the carrier do not count.

    Two threads may write the component's number of the same box at the same time, and the larger number may remain.
    This does no harm: the next round finds the smaller number again.
    """
    block = at.block
    for body in range(at.thread, at.placed + 1, at.threads):
        work.body_component[block, body] = body
    wait_for_all()
    changes = bool(True)
    while changes:
        any_changed = bool(False)
        for pair in range(at.thread, npair, at.threads):
            one, two = _pair_of_bodies(worlds, at, work, pair, 1)
            if one >= 0:
                of_one = work.body_component[block, one]
                of_two = work.body_component[block, two]
                if of_one < of_two:
                    work.body_component[block, two] = of_one
                    any_changed = True
                if of_two < of_one:
                    work.body_component[block, one] = of_two
                    any_changed = True
        changes = any_of_all(any_changed)


@wp.func
def _find_levels(
    # Model:
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    npair: int,
    least: int,
    # Data out:
    work: Ref[Workspace],
) -> None:
    """Find each body's level: its distance from the root of its component, counted in contacts. Only contacts between
    bodies with numbers of at least ``least`` count."""
    block = at.block
    for body in range(at.thread, at.placed + 1, at.threads):
        work.body_level[block, body] = wp.where(work.body_root[block, body] == body, 0, UNREACHED)
    wait_for_all()
    for level in range(at.placed + 1):
        any_reached = bool(False)
        for pair in range(at.thread, npair, at.threads):
            one, two = _pair_of_bodies(worlds, at, work, pair, least)
            if one >= 0:
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
    """Renew the order of bodies from the contacts of this step. Within a component, bodies are sorted by their level
    (their distance from the root, counted in contacts); bodies of equal level are in packing order. With more than
    ``MANY_BOXES`` boxes, the whole order is then reversed."""
    block = at.block
    n = at.placed + 1
    many = at.placed > MANY_BOXES
    least = wp.where(many, 1, 0)
    if many:
        _find_components(worlds, at, npair, work)
    for body in range(at.thread, n, at.threads):
        if not many:
            work.body_component[block, body] = 0
        work.body_root[block, body] = work.body_component[block, body]
    # Distances are first counted from the component's first body. The body that is farthest from the first body then
    # becomes the root.
    _find_levels(worlds, at, npair, least, work)
    for body in range(at.thread, n, at.threads):
        root = work.body_component[block, body]
        for other in range(root, n):
            level = work.body_level[block, other]
            if work.body_component[block, other] == work.body_component[block, body] and level != UNREACHED:
                if level > work.body_level[block, root]:
                    root = other
        work.body_root[block, body] = root
    wait_for_all()
    _find_levels(worlds, at, npair, least, work)
    for body in range(at.thread, n, at.threads):
        component = work.body_component[block, body]
        level = work.body_level[block, body]
        position = int(0)
        for other in range(n):
            its_component = work.body_component[block, other]
            its = work.body_level[block, other]
            nearer = its < level or (its == level and other < body)
            if its_component < component or (its_component == component and nearer):
                position += 1
        if many:
            position = n - 1 - position
        if body == 0:
            state.carrier_position[at.world] = position
        else:
            state.position[at.world, body - 1] = position
    wait_for_all()
