"""Contact law of landing boxes, which stops boxes that arrive fast or lets them bounce.

Twin of petmjx/world/contact_laws.py and petmjx/engines/mujoco/landing.py, which explain the law.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import any_of_all, wait_for_all
from petmjx.engines.warp.kernels.body_dynamics import angular_velocity, linear_velocity
from petmjx.engines.warp.kernels.box_motion import speed_of
from petmjx.engines.warp.kernels.compliance import spring_of_pair
from petmjx.engines.warp.kernels.contact_rows import MAX_IMPEDANCE, MIN_IMPEDANCE, surface_of
from petmjx.engines.warp.kernels.efc import number_of, put_number
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds
from petmjx.world import contact_laws

FAST = wp.constant(contact_laws.FAST_M_S)
AT_REST = wp.constant(contact_laws.AT_REST)
BEGINS = wp.constant(-1)
"""Special value of ``landing_left``: a landing begins now, because one of the box's contacts closes fast.
"""


@wp.func
def _speed(state: Ref[State], work: Ref[Workspace], at: Thread, contact: int, side: int, before: bool) -> float:
    """Speed of a contact's body along the normal, m/s. ``before``: whether the speed of a landing box is the speed that
    it had before the landing.
    """
    free_body = work.contact_bodies[at.block, contact, side]
    if free_body < 0:
        return 0.0
    body = free_body + at.held
    linear = linear_velocity(state, at.world, body)
    spin = angular_velocity(state, at.world, body)
    if before and body > 0:
        if state.landing_left[at.world, body - 1] > 0:
            for i in range(3):
                linear[i] = state.landing_qvel[at.world, body - 1, i]
                spin[i] = state.landing_qvel[at.world, body - 1, 3 + i]
    speed = float(0.0)
    for i in range(3):
        speed += number_of(work.efc, at.block, contact, i) * linear[i]
        speed += number_of(work.efc, at.block, contact, 9 * (1 + side) + i) * spin[i]
    return speed


@wp.func
def _closing_speed(state: Ref[State], work: Ref[Workspace], at: Thread, contact: int, before: bool) -> float:
    """Speed at which the bodies of a contact approach each other, m/s."""
    return _speed(state, work, at, contact, 0, before) - _speed(state, work, at, contact, 1, before)


@wp.func
def _box_of(work: Ref[Workspace], at: Thread, contact: int, side: int) -> int:
    """The box on this side of a contact; negative: the body is the carrier, or does not move."""
    free_body = work.contact_bodies[at.block, contact, side]
    return wp.where(free_body < 0, -1, free_body + at.held - 1)


@wp.func
def _begin(
    # In:
    at: Thread,
    ncon: int,
    lasts: int,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> bool:
    """Find boxes that begin to land. Returns whether any box lands."""
    world = at.world
    for box in range(at.thread, at.placed, at.threads):
        state.landing_left[world, box] = wp.max(state.landing_left[world, box] - 1, 0)
    wait_for_all()
    for contact in range(at.thread, ncon, at.threads):
        if _closing_speed(state, work, at, contact, False) > FAST:
            for side in range(2):
                box = _box_of(work, at, contact, side)
                if box >= 0:
                    if state.landing_left[world, box] == 0:
                        state.landing_left[world, box] = BEGINS
    wait_for_all()
    lands = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        if state.landing_left[world, box] == BEGINS:
            state.landing_left[world, box] = lasts
            for i in range(6):
                state.landing_qvel[world, box, i] = state.qvel[world, box, i]
        lands = lands or state.landing_left[world, box] > 0
    return any_of_all(lands)


@wp.func
def land(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    ncon: int,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> None:
    """Change the contacts of landing boxes. Called after ``make_constraint``."""
    block = at.block
    world = at.world
    fast = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        fast = fast or state.landing_left[world, box] > 0 or speed_of(worlds, state, world, box) > 0.5 * FAST
    if not any_of_all(fast):
        return
    if not _begin(at, ncon, model.landing_lasts, state, work):
        return
    low = wp.clamp(model.solimp[0], MIN_IMPEDANCE, MAX_IMPEDANCE)
    high = wp.clamp(model.solimp[1], MIN_IMPEDANCE, MAX_IMPEDANCE)
    for contact in range(at.thread, ncon, at.threads):
        pair = work.contact_pair[block, contact]
        first = work.pair_geom1[block, pair]
        second = work.pair_geom2[block, pair]
        if at.gives != 0:
            if spring_of_pair(worlds, world, first, second) > 0.0:
                continue
        depth = -work.pair_points[block, pair, contact - work.pair_conadr[block, pair]][3]
        x = wp.min(wp.abs(depth) / model.solimp[2], 1.0)
        impedance = low + (high - low) * wp.where(x <= 0.5, 2.0 * x * x, 1.0 - 2.0 * (1.0 - x) * (1.0 - x))
        stiffer = (1.0 - impedance) / impedance / ((1.0 - high) / high)
        put_number(work.efc, block, contact, 30, stiffer * number_of(work.efc, block, contact, 30))
        lands = bool(False)
        for side in range(2):
            box = _box_of(work, at, contact, side)
            if box >= 0:
                lands = lands or state.landing_left[world, box] > 0
        before = _closing_speed(state, work, at, contact, True)
        if lands and before > FAST:
            one = surface_of(worlds, world, first)
            two = surface_of(worlds, world, second)
            restitution = worlds.pair_landing[world, one, two, 0]
            if restitution < 0.0:
                restitution = model.restitution
            landing_time = worlds.pair_landing[world, one, two, 1]
            if landing_time < 0.0:
                landing_time = model.landing_time
            opening = restitution * before
            if restitution > 0.0:
                fall = wp.abs(number_of(work.efc, block, contact, 2)) * model.gravity
                height = depth - AT_REST * model.solimp[2]
                energy = wp.max(opening * opening + 2.0 * fall * height, 0.0)
                step = 0.5 * fall * model.timestep
                opening = wp.sqrt(step * step + energy) - step
            enough = (_closing_speed(state, work, at, contact, False) + opening) / model.timestep
            if enough > 0.0:
                most = (1.0 + restitution) * before / landing_time
                put_number(work.efc, block, contact, 27, wp.min(enough, most))
    wait_for_all()
