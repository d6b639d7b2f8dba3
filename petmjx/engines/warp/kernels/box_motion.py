"""The motion of a box at a sample: its tilt, speed, excess over thresholds, and whether it has dropped.

Twin of petmjx/engines/mjx/box_motion.py and petmjx/engines/mjx/running_metrics.py.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.metrics import GONE_DESCENT, GONE_TILT, RESTLESS_M_S, RISING_M_S2
from petmjx.engines.warp.kernels.body_dynamics import box_half, center, middle_of, orientation, rotation
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds

JUST_OVER = wp.constant(1.0000001192092896)
"""The next float32 after 1: the smallest excess of a dropped box."""

LAST_BOX = wp.constant(wp.int64(0x7FFFFFFF))
HALF = wp.constant(wp.int64(32))

TILT_OF_GONE = wp.constant(GONE_TILT)
DESCENT_OF_GONE = wp.constant(GONE_DESCENT)
RESTLESS = wp.constant(RESTLESS_M_S)
RISING = wp.constant(RISING_M_S2)

UNBALANCED = wp.constant(10.0)
"""Forces from a solver that was stopped early count only if no body is out of balance by more than this acceleration,
m/s². With this limit, force peaks of rocking towers and stacks agree within 1 % with the peaks of a solver that was not
stopped. With a limit of 60 m/s², peaks were up to a fifth larger; with 1 m/s², they were a hundredth smaller."""


@wp.func
def tilt_of(q: wp.vec4) -> float:
    """Angle between a box's z axis and the world's z axis, degrees. The quaternion gives the half angle. In float32,
    small angles are more exact if they are computed from the half angle than from the cosine of the whole angle.
    """
    return wp.degrees(2.0 * wp.atan2(wp.sqrt(q[1] * q[1] + q[2] * q[2]), wp.sqrt(q[0] * q[0] + q[3] * q[3])))


@wp.func
def length_of(a: wp.array3d[float], world: int, box: int, first: int) -> float:
    """Length of the 3-vector stored for a box from index ``first`` on."""
    x = a[world, box, first]
    y = a[world, box, first + 1]
    z = a[world, box, first + 2]
    return wp.sqrt(x * x + y * y + z * z)


@wp.func
def corner_acceleration(worlds: Ref[Worlds], state: Ref[State], world: int, box: int) -> float:
    """Root mean square of the accelerations that the rotation of a box gives to its eight corners, m/s²."""
    half = box_half(worlds, world, box)
    squares = wp.cw_mul(half, half)
    x = state.qacc[world, box, 3]
    y = state.qacc[world, box, 4]
    z = state.qacc[world, box, 5]
    return wp.sqrt(
        x * x * (squares[1] + squares[2]) + y * y * (squares[0] + squares[2]) + z * z * (squares[0] + squares[1])
    )


@wp.func
def excess_of(
    model: Ref[Model], worlds: Ref[Worlds], world: int, box: int, place: wp.vec3, tilt: float, dropped: bool
) -> float:
    """Excess of a box: the larger of shift / its threshold and tilt / its threshold. The excess of a dropped box is
    above 1."""
    shift = float(0.0)
    for i in range(3):
        moved = wp.abs(place[i] - worlds.target[world, box, i])
        if i == 2 and place[i] < worlds.target[world, box, i]:
            moved = wp.max(moved - worlds.sinks[world, box], 0.0)
        if moved >= model.shift_floor_m:
            shift = wp.max(shift, moved)
    excess = wp.max(shift / model.shift_m, tilt / model.tilt_deg)
    return wp.where(dropped, wp.max(excess, JUST_OVER), excess)


@wp.func
def is_gone(model: Ref[Model], worlds: Ref[Worlds], state: Ref[State], world: int, box: int) -> bool:
    """Whether a box is gone (``petmjx.engines.metrics.GONE_TILT``): its pallet will certainly not stand, so a trial can
    end."""
    q = orientation(state, world, box + 1)
    place = middle_of(worlds, world, box, center(state, world, box + 1), q)
    descent = worlds.target[world, box, 2] - worlds.sinks[world, box] - place[2]
    return tilt_of(q) > TILT_OF_GONE * model.tilt_deg or descent > DESCENT_OF_GONE * model.shift_m


@wp.func
def sway_of(state: Ref[State], world: int, box: int, place: wp.vec3) -> float:
    """Horizontal distance of a box from its place at the start of its drive, m."""
    x = place[0] - state.sway_anchor[world, box, 0]
    y = place[1] - state.sway_anchor[world, box, 1]
    return wp.sqrt(x * x + y * y)


@wp.func
def measure(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    box: int,
    step: int,
    culprit: int,
    sample: bool,
    look: bool,
    driven: bool,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> bool:
    """Measure a box at a sample, at a *look* (a check whether the pallet is quiet) during a drive, or at the end.
    Returns whether the box is lost. With early stop, a lost box ends its world.

    Args:
        culprit: the culprit found at an earlier look.
    """
    world = at.world
    place = wp.vec3(0.0, 0.0, 0.0)
    q = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for i in range(3):
        place[i] = wp.where(sample, work.qpos_before[at.block, box, i], state.qpos[world, box, i])
    for i in range(4):
        q[i] = wp.where(sample, work.qpos_before[at.block, box, 3 + i], state.qpos[world, box, 3 + i])
    place = middle_of(worlds, world, box, place, q)
    tilt = tilt_of(q)
    lowest = place[2] - wp.dot(wp.abs(rotation(q)[2]), box_half(worlds, world, box))
    dropped = place[2] < 0.0 or lowest < model.drop_hull_z_m
    if dropped and state.drop_step[world, box] < 0:
        state.drop_step[world, box] = step
    excess = excess_of(model, worlds, world, box, place, tilt, dropped)
    # the bits of positive floats, read as integers, have the same order as the floats; among equal excesses, the first
    # box counts
    key = (wp.int64(wp.cast(excess, wp.int32)) << HALF) | (LAST_BOX - wp.int64(box))
    wp.atomic_max(work.worst, at.block, key)
    if sample or look:
        state.max_tilt[world, box] = wp.max(state.max_tilt[world, box], tilt)
    if sample:
        state.max_lin_acc[world, box] = wp.max(state.max_lin_acc[world, box], length_of(state.qacc, world, box, 0))
        state.max_ang_acc[world, box] = wp.max(state.max_ang_acc[world, box], length_of(state.qacc, world, box, 3))
    tilts = tilt > model.tilt_deg
    lost = tilts and worlds.ends_when_lost[world]
    if driven:
        sway = sway_of(state, world, box, place)
        state.max_sway[world, box] = wp.max(state.max_sway[world, box], sway)
        lost = lost or (tilts and box == culprit and model.waits_for_rest != 0 and sway >= worlds.allowed_sway[world])
    confirms = sample and box == culprit and excess > 1.0
    confirms = confirms and step - state.sign_step[world] >= worlds.confirm_steps[world]
    if confirms:
        complete = state.placed[world] == worlds.n_boxes[world] and at.carried == 0
        complete = complete and step - state.last_placed_at[world] >= worlds.confirm_steps[world]
        lost = lost or complete or state.placed[world] > state.sign_placed[world] + 1
    return dropped or lost


@wp.func
def press(
    # In:
    world: int,
    block: int,
    box: int,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> None:
    """Record the force on a box's top. Called in steps in which this force counts."""
    state.max_top_force[world, box] = wp.max(state.max_top_force[world, box], work.top_force[block, box])


@wp.func
def speed_of(worlds: Ref[Worlds], state: Ref[State], world: int, box: int) -> float:
    """Upper bound of the speed of a box's fastest point, m/s: the centre's speed + radius × angular speed."""
    radius = wp.length(box_half(worlds, world, box))
    return length_of(state.qvel, world, box, 0) + radius * length_of(state.qvel, world, box, 3)


@wp.func
def is_fast(worlds: Ref[Worlds], state: Ref[State], at: Thread) -> bool:
    """Whether one of a thread's boxes is faster than ``RESTLESS_M_S``."""
    fast = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        fast = fast or speed_of(worlds, state, at.world, box) > RESTLESS
    return fast


@wp.func
def rises(work: Ref[Workspace], at: Thread) -> bool:
    """Whether one of a thread's free bodies is accelerated upwards by more than ``RISING_M_S2`` in this step."""
    up = bool(False)
    for body in range(at.thread, at.placed + 1 - at.held, at.threads):
        up = up or work.qacc[at.block, 6 * body + 2] > wp.float64(RISING)
    return up


@wp.func
def is_unbalanced(work: Ref[Workspace], at: Thread) -> bool:
    """Whether the forces on one of a thread's free bodies are out of balance by more than ``UNBALANCED`` × the body's
    mass. If a solver was stopped while forces are so far out of balance, some forces between bodies may be a hundred
    times too large."""
    unbalanced = bool(False)
    for body in range(at.thread, at.placed + 1 - at.held, at.threads):
        most = wp.float64(UNBALANCED) * wp.float64(work.qM[at.block, 6 * body])
        for i in range(3):
            unbalanced = unbalanced or wp.abs(work.grad[at.block, 6 * body + i]) > most
    return unbalanced
