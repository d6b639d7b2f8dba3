"""Hands that carry boxes to their places, for all worlds of a batch (docs/rules.md, section 4).

All functions of this module are pure functions of states. Twin of petmjx/engines/mujoco/hand.py. The carried box of a
world is always the box that was placed last.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx.body_dynamics import rotations
from petmjx.engines.mjx.world_constants import NEVER, Worlds
from petmjx.engines.mjx.world_state import State
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Simulation
from petmjx.world.approach_paths import CLEARANCE_M, FREE_M, MOST_SIDESTEPS, MOST_WAY_S
from petmjx.world.hand import AT_PLACE_M, LOWERING_STEPS, MISSED_M, lowering_rate_1_s, rate_1_s, stuck_steps

Vector = Float[Array, "world 3"]


def carried_worlds(state: State) -> Bool[Array, " world"]:
    """Whether the last box of each world is in a hand."""
    return state.carried_from != NEVER


def take_up(state: State, worlds: Worlds, where: Bool[Array, " world"], timestep_s: float) -> State:
    """Move the last box from its release pose to the start of its path. If the path has at least one step, a hand
    carries the box. A box whose path has no steps falls from the start of the path."""
    box = jnp.maximum(state.placed - 1, 0)
    where = where & ~worlds.appears
    pose, offset, steps = (_values_of_box(values, box) for values in (state.qpos, worlds.way_offset, worlds.way_steps))
    middles, reaches = motion.middles(state.qpos, worlds.middle), _reaches(state.qpos, worlds.half)
    stands = jnp.arange(state.qpos.shape[1])[None] < box[:, None]
    planned = _values_of_box(middles, box) + offset
    most_aside = _values_of_box(worlds.way_aside, box)
    aside = _free_begin(planned, _values_of_box(reaches, box), middles, reaches, stands, most_aside) - planned
    length = _length(offset + aside)
    seconds = jnp.maximum(
        1.5 * length / worlds.hand_speed,
        jnp.sqrt(12.0 * _values_of_box(worlds.mass[:, 1:], box) * length / worlds.hand_force),
    )
    longer = jnp.ceil(jnp.minimum(seconds, MOST_WAY_S) / timestep_s).astype(jnp.int32)
    steps = jnp.where((steps > 0) & (aside != 0).any(-1), jnp.maximum(longer, 1), steps)
    begin = pose.at[:, :3].add(offset + aside)
    here = ((jnp.arange(state.qpos.shape[1])[None] == box[:, None]) & where[:, None])[..., None]
    takes = where & (steps > 0)
    return state._replace(
        qpos=jnp.where(here, begin[:, None], state.qpos),
        still_qpos=jnp.where(here, begin[:, None], state.still_qpos),
        carried_from=jnp.where(takes, state.step, state.carried_from),
        carried_steps=jnp.where(takes, steps, state.carried_steps),
        way_begin=jnp.where(takes[:, None], begin[:, :3], state.way_begin),
        way_end=jnp.where(takes[:, None], pose[:, :3], state.way_end),
    )


def carry_on(state: State, worlds: Worlds, where: Bool[Array, " world"], sim: Simulation) -> State:
    """After a step in which boxes were carried: carry them farther, or release them. A box that has arrived and is at
    rest is set down first, unless it is meant to fall from its release pose."""
    box = jnp.maximum(state.placed - 1, 0)
    patience = stuck_steps(sim.physics.timestep_s)
    slow = _values_of_box(motion.speed(state.qvel, worlds.half), box) < sim.quiet.quiet_m_s
    lowered = state.lowered_from != NEVER
    since = state.step - state.lowered_from
    is_down = lowered & ((since >= patience) | (slow & (since >= LOWERING_STEPS)))
    elapsed = state.step - state.carried_from
    arrived = ~lowered & (elapsed >= state.carried_steps + jnp.where(slow, 0, patience))
    short = _length(state.way_end - _values_of_box(state.qpos, box)[:, :3])
    falls = arrived & _values_of_box(worlds.falls, box) & (short <= AT_PLACE_M)
    opens, lowers = where & (is_down | falls), where & arrived & ~falls
    missed = opens & (short > MISSED_M) & (state.metrics.culprit < 0)
    here = ((jnp.arange(state.qpos.shape[1])[None] == box[:, None]) & opens[:, None])[..., None]
    return state._replace(
        flags=state.flags | jnp.where(missed, int(Flag.NOT_PLACED), 0),
        still_qpos=jnp.where(here, state.qpos, state.still_qpos),
        carried_from=jnp.where(opens, NEVER, state.carried_from),
        lowered_from=jnp.where(opens, NEVER, jnp.where(lowers, state.step, state.lowered_from)),
        last_placed_at=jnp.where(opens, state.step, state.last_placed_at),
        waits_since=jnp.where(opens, state.step, state.waits_since),
        quiet_steps=jnp.where(opens, 0, state.quiet_steps),
    )


def wrenches(state: State, worlds: Worlds, sim: Simulation) -> Float[Array, "world box 6"]:
    """Forces, N, and moments, N·m, of hands on boxes during the next step, in world axes."""
    timestep, gravity = sim.physics.timestep_s, sim.physics.gravity_m_s2
    box = jnp.maximum(state.placed - 1, 0)
    pose, vel, half, start = (
        _values_of_box(values, box) for values in (state.qpos, state.qvel, worlds.half, worlds.start)
    )
    mass, equal = _values_of_box(worlds.mass[:, 1:], box)[:, None], _values_of_box(worlds.inertia_box[:, 1:], box)
    inertia = mass / 3.0 * ((equal**2).sum(-1, keepdims=True) - equal**2)
    most, weight = worlds.hand_force[:, None], mass * jnp.array([[0.0, 0.0, gravity]])
    rate, damping = rate_1_s(timestep), lowering_rate_1_s(timestep)
    elapsed, steps = state.step - state.carried_from, jnp.maximum(state.carried_steps, 1)
    before, now, after = (_progress(elapsed + k, steps)[:, None] for k in (-1, 0, 1))
    way = state.way_end - state.way_begin
    ahead = state.way_begin + now * way - pose[:, :3]
    lag = (now - before) / timestep * way - vel[:, :3]
    along = ((after - now) - (now - before)) / timestep**2 * way
    askew = _rotation_vectors(pose[:, 3:], start[:, 3:])
    lowered = (state.lowered_from != NEVER)[:, None]
    force = jnp.where(
        lowered,
        _limited(-mass * damping * vel[:, :3], most + mass * gravity),
        _limited(mass * (along + rate**2 * ahead + 2.0 * rate * lag), most) + weight,
    )
    moment = inertia * jnp.where(lowered, -damping * vel[:, 3:], rate**2 * askew - 2.0 * rate * vel[:, 3:])
    moment = _limited(moment, most * half.max(-1, keepdims=True))
    moment = jnp.einsum("wij,wj->wi", rotations(pose[:, 3:]), moment)
    here = (jnp.arange(state.qpos.shape[1])[None] == box[:, None]) & (carried_worlds(state) & state.running)[:, None]
    return jnp.where(here[..., None], jnp.concatenate([force, moment], -1)[:, None], 0.0)


def _free_begin(
    begin: Vector,
    reach: Vector,
    middles: Float[Array, "world box 3"],
    reaches: Float[Array, "world box 3"],
    stands: Bool[Array, "world box"],
    most_aside: Float[Array, "world 2 2"],
) -> Vector:
    """The place, m, at which the carried box of each world starts without overlapping a standing box: ``begin`` if this
    place is free, else a free place beside ``begin``, else a place above ``begin``."""

    def overlap(place: Vector) -> tuple[Float[Array, "world box 3"], Bool[Array, "world box"]]:
        shared = reaches + reach[:, None] - jnp.abs(middles - place[:, None])
        return shared, stands & (shared > FREE_M).all(-1)

    def sidestep(
        _: Int[Array, ""], before: tuple[Vector, Bool[Array, " world"]]
    ) -> tuple[Vector, Bool[Array, " world"]]:
        place, far = before
        shared, in_way = overlap(place)
        first = in_way.argmax(-1)
        length, other = _values_of_box(shared, first), _values_of_box(middles, first)
        axis = jnp.where(length[:, 0] <= length[:, 1], 0, 1)
        along = jnp.arange(3)[None] == axis[:, None]
        moves = (in_way.any(-1) & ~far)[:, None] & along
        place = place + jnp.where(moves, jnp.where(place >= other, length, -length), 0.0)
        way = (place - begin)[:, :2]
        return place, far | (-way > most_aside[:, 0]).any(-1) | (way > most_aside[:, 1]).any(-1)

    aside, far = jax.lax.fori_loop(0, MOST_SIDESTEPS, sidestep, (begin, jnp.zeros(len(begin), bool)))
    free = ~far & ~overlap(aside)[1].any(-1)

    def met(place: Vector) -> Bool[Array, ""]:
        return overlap(place)[1].any()

    def rise(place: Vector) -> Vector:
        in_way = overlap(place)[1]
        top = jnp.where(in_way, middles[..., 2] + reaches[..., 2], -jnp.inf).max(-1)
        return place.at[:, 2].set(jnp.where(in_way.any(-1), top + reach[:, 2] + CLEARANCE_M, place[:, 2]))

    above = jax.lax.while_loop(met, rise, begin)
    return jnp.where(free[:, None], aside, above)


def _values_of_box(values: Array, box: Int[Array, " world"]) -> Array:
    """For each world, the values of one of its boxes."""
    return values[jnp.arange(len(box)), box]


def _reaches(pose: Float[Array, "world box 7"], half: Float[Array, "world box 3"]) -> Float[Array, "world box 3"]:
    """Half extents of the axis-aligned bounding boxes of rotated boxes, m."""
    return jnp.einsum("wbij,wbj->wbi", jnp.abs(rotations(pose[..., 3:])), half)


def _progress(step: Int[Array, " world"], steps: Int[Array, " world"]) -> Float[Array, " world"]:
    """Share of a path of ``steps`` steps covered by step ``step``, with a smooth start and stop."""
    share = jnp.clip(step / steps, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _length(vector: Vector) -> Float[Array, " world"]:
    return jnp.sqrt((vector**2).sum(-1))


def _limited(vector: Vector, most: Float[Array, "world 1"]) -> Vector:
    """The vectors, shortened to the length ``most`` if they are longer."""
    length = _length(vector)[:, None]
    return jnp.where(length <= most, vector, vector * (most / jnp.maximum(length, 1e-30)))


def _rotation_vectors(quat: Float[Array, "world 4"], target_quat: Float[Array, "world 4"]) -> Vector:
    """Rotations from ``quat`` to ``target_quat``, as rotation vectors in the axes of ``quat``, rad; exact only for
    small angles.
    """
    w, u, v = quat[:, :1], quat[:, 1:], target_quat[:, 1:]
    real = w * target_quat[:, :1] + (u * v).sum(-1, keepdims=True)
    imaginary = w * v - target_quat[:, :1] * u - jnp.cross(u, v)
    return jnp.where(real >= 0, 2.0, -2.0) * imaginary
