"""Forces of film around a shaken pallet (petmjx/world/film.py). Twin of petmjx/engines/mujoco/film.py."""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import wait_for_all
from petmjx.engines.warp.kernels.body_dynamics import center, linear_velocity
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds
from petmjx.world.film import SLACK_M

SLACK = wp.constant(SLACK_M)
_TINY = wp.constant(1.0e-30)


@wp.func
def _limited(vector: wp.vec3, most: float) -> wp.vec3:
    """The vector ``vector``, shortened to the length ``most`` if it is longer."""
    length = wp.length(vector)
    if length <= most:
        return vector
    return vector * (most / wp.max(length, _TINY))


@wp.func
def _spring(model: Ref[Model], worlds: Ref[Worlds], state: Ref[State], world: int, box: int, begins: bool) -> wp.vec3:
    """Force of the spring that pulls a box back to its anchor on the film, N."""
    place = center(state, world, box + 1) - center(state, world, 0)
    anchor = place
    if not begins:
        for i in range(3):
            anchor[i] = state.film_anchor[world, box, i]
    stiffness = worlds.mass[world, box + 1] * model.film_rate * model.film_rate
    return _limited(stiffness * (anchor - place), worlds.wrap_hold[world, box])


@wp.func
def _force(
    model: Ref[Model], worlds: Ref[Worlds], state: Ref[State], world: int, box: int, spring: wp.vec3, begins: bool
) -> wp.vec3:
    """Force of the film on a box, N."""
    speed = linear_velocity(state, world, box + 1)
    if not worlds.held[world]:
        speed = speed - linear_velocity(state, world, 0)
    damping = 2.0 * model.film_rate * worlds.mass[world, box + 1]
    force = _limited(spring - damping * speed, worlds.wrap_hold[world, box])
    place = center(state, world, box + 1) - center(state, world, 0)
    for i in range(3):
        press = worlds.wrap_press[world, box, i]
        if i < 2 and not begins:
            drawn_in = wp.sign(press) * (place[i] - state.film_home[world, box, i])
            press = press * wp.clamp(1.0 - drawn_in / SLACK, 0.0, 1.0)
        force[i] = force[i] + press
    return force


@wp.func
def hold(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> None:
    """Let film act during the next step of a world with a drive. Called after ``begin_step``. The opposite force acts
    on a moving carrier."""
    world = at.world
    begins = state.step[world] == state.driven_from[world]
    if at.held == 0 and at.thread == 0:
        back = wp.vec3(0.0, 0.0, 0.0)
        for box in range(at.placed):
            spring = _spring(model, worlds, state, world, box, begins)
            back += _force(model, worlds, state, world, box, spring, begins)
        for i in range(3):
            work.qacc_smooth[at.block, i] = work.qacc_smooth[at.block, i] - back[i] / worlds.mass[world, 0]
    wait_for_all()
    for box in range(at.thread, at.placed, at.threads):
        spring = _spring(model, worlds, state, world, box, begins)
        force = _force(model, worlds, state, world, box, spring, begins)
        mass = worlds.mass[world, box + 1]
        dof = 6 * (box + 1 - at.held)
        place = center(state, world, box + 1) - center(state, world, 0)
        for i in range(3):
            if begins:
                state.film_home[world, box, i] = place[i]
            state.film_anchor[world, box, i] = place[i] + spring[i] / (mass * model.film_rate * model.film_rate)
            work.qacc_smooth[at.block, dof + i] = work.qacc_smooth[at.block, dof + i] + force[i] / mass
    wait_for_all()
