"""Finds trembling boxes: boxes that move to and fro without getting anywhere (docs/rules.md, section 5).

Twin of petmjx/engines/mjx/trembling.py.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.mjx import trembling
from petmjx.engines.warp.kernels.body_dynamics import box_half
from petmjx.engines.warp.kernels.box_motion import speed_of
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Worlds

TREMBLES = wp.constant(trembling.TREMBLES)
STAYS = wp.constant(trembling.STAYS)


@wp.func
def distance_since(worlds: Ref[Worlds], state: Ref[State], home: wp.array3d[float], world: int, box: int) -> float:
    """Upper bound of the distance by which any point of a box has moved since ``home``, m."""
    shifted = float(0.0)
    turned = float(0.0)
    for i in range(3):
        change = state.qpos[world, box, i] - home[world, box, i]
        shifted += change * change
    for i in range(3, 7):
        change = state.qpos[world, box, i] - home[world, box, i]
        turned += change * change
    return wp.sqrt(shifted) + 2.0 * wp.length(box_half(worlds, world, box)) * wp.sqrt(turned)


@wp.func
def _most_away(model: Ref[Model], path: float) -> float:
    """Limit of a distance, m. A box trembles or stays only if, during the whole measured period, its distance from its
    pose at the beginning of the period has been below the limit. ``path``: length of the box's path in the period,
    m."""
    still = model.still_speed * float(model.tremble_looks * model.poll_steps) * model.timestep
    return model.tremble_share * wp.max(path, still)


@wp.func
def find_trembling(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    look: int,
    # Data out:
    state: Ref[State],
) -> None:
    """At a *look* (a check whether the pallet is quiet), decide for each box whether it trembles (moves to and fro),
    stays (keeps its place), or does neither (docs/rules.md, section 5). Motion is measured in periods of
    ``tremble_looks`` looks. The first period after a placement is not measured.

    Args:
        look: number of the look since the last placement, from 0.
    """
    world = at.world
    period = model.tremble_looks
    if look < period:
        return
    look_s = float(model.poll_steps) * model.timestep
    begins = look % period == 0
    for box in range(at.thread, at.placed, at.threads):
        path = state.tremble_path[world, box] + speed_of(worlds, state, world, box) * look_s
        away = wp.max(state.tremble_away[world, box], distance_since(worlds, state, state.tremble_qpos, world, box))
        if begins and look > period:
            least = model.slow_speed * float(period) * look_s
            stays = away < wp.min(_most_away(model, path), least)
            kind = wp.where(path >= least, TREMBLES, STAYS)
            state.trembles[world, box] = wp.where(stays, kind, 0)
        if begins:
            path = 0.0
            away = 0.0
            for i in range(7):
                state.tremble_qpos[world, box, i] = state.qpos[world, box, i]
        state.tremble_path[world, box] = path
        state.tremble_away[world, box] = away


@wp.func
def is_trembling(model: Ref[Model], state: Ref[State], looks: int, world: int, box: int) -> bool:
    """Whether a box trembles. Until a first measurement after a placement is complete, no box counts as trembling.

    Args:
        looks: number of looks since the last placement.
    """
    return looks > 2 * model.tremble_looks and state.trembles[world, box] == TREMBLES


@wp.func
def has_stayed(model: Ref[Model], state: Ref[State], looks: int, world: int, box: int, moved: float) -> bool:
    """Whether a box stays: it stayed in the last measured period, and has stayed since. As with ``is_trembling``, no
    box counts as staying right after a placement.

    Args:
        looks: number of looks since the last placement.
        moved: a distance by which the box has moved, m. The larger of ``moved`` and ``State.tremble_away`` must be
            below the limit of ``_most_away``.
    """
    if looks <= 2 * model.tremble_looks or state.trembles[world, box] == 0:
        return False
    return wp.max(state.tremble_away[world, box], moved) < _most_away(model, state.tremble_path[world, box])


@wp.func
def speed_without_trembling(
    model: Ref[Model], worlds: Ref[Worlds], state: Ref[State], looks: int, world: int, box: int
) -> float:
    """Speed of a box's fastest point, m/s; 0 if it trembles."""
    if is_trembling(model, state, looks, world, box):
        return float(0.0)
    return speed_of(worlds, state, world, box)
