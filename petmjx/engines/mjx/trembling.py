"""Finds boxes that tremble or stay (docs/rules.md, section 5), for all worlds of a batch. Twin:
petmjx/engines/mujoco/trembling.py."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.engines.mjx.world_state import State
from petmjx.options.simulation import Simulation

TREMBLES, STAYS = 1, 2
"""Values of ``State.trembles`` for a box that trembled, or stayed at its place, in the last complete period of
measurement. In both cases, the box stayed near the pose that it had when the period began. A box that trembled moved
along a longer path than a box that stayed."""


def trembling_mask(state: State, sim: Simulation) -> Bool[Array, "world box"]:
    """Whether each box trembles. Right after a placement, no box counts as trembling, since the boxes have been checked
    too few times."""
    return (state.trembles == TREMBLES) & (state.tremble_looks > 2 * sim.quiet.tremble_looks)[:, None]


def stay_mask(
    state: State, sim: Simulation, moved: Float[Array, "world box"] | float = 0.0
) -> Bool[Array, "world box"]:
    """Whether each box counts as staying at its place. Two conditions must hold: in the last complete period of
    measurement, the box always was near the place that it had when the period began; and the same is true of the
    present period so far. Right after a placement, no box counts as staying, since the boxes have been checked too few
    times. ``moved``: distances by which boxes moved in the last ``still_steps`` steps, m, if the world is at its end; 0
    if the caller only checks whether the pallet is quiet (a look). The larger of this distance and ``tremble_away``
    must be below the limit of ``_most_away``."""
    stayed = (state.trembles != 0) & (state.tremble_looks > 2 * sim.quiet.tremble_looks)[:, None]
    return stayed & (jnp.maximum(state.tremble_away, moved) < _most_away(state.tremble_path, sim))


def _most_away(path: Float[Array, "world box"], sim: Simulation) -> Float[Array, "world box"]:
    """Limits of distances, m. A box trembles or stays only if, during the whole period of measurement, its distance
    from its pose at the beginning of the period has been below the limit. ``path``: length of each box's path in the
    period, m."""
    rule = sim.quiet
    still = rule.still_m_s * rule.tremble_looks * rule.poll_steps * sim.physics.timestep_s
    return rule.tremble_share * jnp.maximum(path, still)


def after_look(
    state: State, worlds: Worlds, looks: Bool[Array, " world"], speed: Float[Array, "world box"], sim: Simulation
) -> State:
    """The states after a check for trembling boxes in the worlds marked by ``looks``. ``speed``: speeds of the boxes'
    fastest points, m/s."""
    rule = sim.quiet
    period, look_s = rule.tremble_looks, rule.poll_steps * sim.physics.timestep_s
    look = state.tremble_looks
    measures = (looks & (look > period))[:, None]
    path = jnp.where(measures, state.tremble_path + speed * look_s, state.tremble_path)
    away = jnp.maximum(state.tremble_away, motion.moved(state.tremble_qpos, state.qpos, worlds.half))
    away = jnp.where(measures, away, state.tremble_away)
    begins = (looks & (look >= period) & (look % period == 0))[:, None]
    least = rule.slow_m_s * period * look_s
    stays = away < jnp.minimum(_most_away(path, sim), least)
    kind = jnp.where(stays, jnp.where(path >= least, TREMBLES, STAYS), 0)
    return state._replace(
        tremble_looks=look + looks,
        trembles=jnp.where(begins & measures, kind.astype(jnp.int32), state.trembles),
        tremble_path=jnp.where(begins, 0.0, path),
        tremble_away=jnp.where(begins, 0.0, away),
        tremble_qpos=jnp.where(begins[..., None], state.qpos, state.tremble_qpos),
    )
