"""Forces of film on the boxes of a batch (petmjx/world/film.py). Twin of petmjx/engines/mujoco/film.py."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from petmjx.engines.mjx.world_constants import Worlds
from petmjx.engines.mjx.world_state import State
from petmjx.world.film import SLACK_M, spring_rate_1_s


def hold(state: State, worlds: Worlds, timestep_s: float) -> tuple[Float[Array, "world box 3"], State]:
    """Forces of the film on boxes during the next step, N, and the states with the new anchors of the film. When a
    drive begins, film is put around the boxes at their current places."""
    rate = spring_rate_1_s(timestep_s)
    mass, most = worlds.mass[:, 1:, None], worlds.wrap_hold[..., None]
    place = state.qpos[..., :3] - state.carrier_qpos[:, None, :3]
    of_carrier = jnp.where(worlds.held[:, None], 0.0, state.carrier_qvel[:, :3])
    speed = state.qvel[..., :3] - of_carrier[:, None]
    begins = (state.step == state.driven_from)[:, None, None]
    home = jnp.where(begins, place, state.film_home)
    spring = _limited(mass * rate**2 * (jnp.where(begins, place, state.film_anchor) - place), most)
    drawn_in = (jnp.sign(worlds.wrap_press) * (place - home)).at[..., 2].set(0.0)
    press = worlds.wrap_press * jnp.clip(1.0 - drawn_in / SLACK_M, 0.0, 1.0)
    force = _limited(spring - 2.0 * rate * mass * speed, most) + press
    acts = (state.running & (state.step >= state.driven_from))[:, None, None]
    anchor = jnp.where(acts, place + spring / (mass * rate**2), state.film_anchor)
    return jnp.where(acts, force, 0.0), state._replace(film_anchor=anchor, film_home=home)


def _limited(vector: Float[Array, "world box 3"], most: Float[Array, "world box 1"]) -> Float[Array, "world box 3"]:
    length = jnp.sqrt((vector**2).sum(-1, keepdims=True))
    return jnp.where(length <= most, vector, vector * (most / jnp.maximum(length, 1e-30)))
