"""Contact law of landing boxes, for all worlds of a batch.

petmjx/world/contact_laws.py explains the law. This module does the same as petmjx/engines/mujoco/landing.py, but shares
no arithmetic with it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from petmjx.engines.mjx.body_dynamics import ContactRows, Links, Velocities
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.engines.mjx.world_state import State
from petmjx.options.simulation import Simulation
from petmjx.world.contact_laws import AT_REST, FAST_M_S, lasts_steps
from petmjx.world.surface_pairs import NOT_GIVEN


class Landing(NamedTuple):
    """Landing boxes (``landing_left`` and ``landing_qvel`` of ``State``), the surfaces of geoms, and the landing laws
    by pair of surfaces."""

    left: Int[Array, "*world box"]
    before: Float[Array, "*world box 6"]
    surface: Int[Array, "*world geom"]
    pair: Float[Array, "*world surface surface 2"]

    @classmethod
    def of(cls, state: State, worlds: Worlds) -> Landing:
        """The landing boxes, surfaces and landing laws of all worlds. Geom 0 is the floor, which has surface 0."""
        surface = jnp.pad(worlds.shape_surface, ((0, 0), (1, 0)))
        return cls(state.landing_left, state.landing_qvel, surface, worlds.pairs["landing"])


def act(
    rows: ContactRows,
    velocity: Velocities,
    boxes: Int[np.ndarray, "contact 2"],
    contact: Any,
    landing: Landing,
    links: Links,
    sim: Simulation,
) -> tuple[ContactRows, Landing]:
    """Change the constraint rows at the contacts of landing boxes in one world. Call this function between collision
    detection and solver.

    Args:
        velocity: velocities of all bodies (MuJoCo's qvel).
        boxes: the box to which each geom of a contact belongs; negative: no box.
        contact: MJX's contacts.

    Returns:
        The rows and landings after the change.
    """
    physics = sim.physics
    n = len(landing.left)
    place = jnp.where(boxes < 0, n, boxes)
    speeds = velocity[-6 * n :].reshape(n, 6)
    closing = -links.along(rows.jacobian, velocity)[:, 0]
    fast = jnp.broadcast_to((closing > FAST_M_S)[:, None], boxes.shape)
    hit = jnp.zeros(n, bool).at[place].max(fast, mode="drop")
    left = jnp.maximum(landing.left - 1, 0)
    begins = hit & (left == 0)
    left = jnp.where(begins, lasts_steps(sim), left)
    before = jnp.where(begins[:, None], speeds, landing.before)
    lands = jnp.pad(left > 0, (0, 1))[place].any(-1)

    low, high, width = (contact.solimp[:, i] for i in range(3))
    x = jnp.clip(rows.depth / width, 0.0, 1.0)
    impedance = low + (high - low) * jnp.where(x <= 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)
    stiffer = jnp.where((left > 0).any(), (1 - impedance) / impedance / ((1 - high) / high), 1.0)

    old = velocity.at[-6 * n :].set(jnp.where((left > 0)[:, None], before, speeds).reshape(-1))
    approach = -links.along(rows.jacobian, old)[:, 0]
    usual, step_s = jnp.array([physics.restitution, physics.landing_s]), physics.timestep_s
    surface = landing.surface[links.geoms]
    of_pair = landing.pair[surface[:, 0], surface[:, 1]]
    share, landing_s = jnp.where(of_pair == NOT_GIVEN, usual[None], of_pair).T
    fall = jnp.abs(contact.frame[:, 0, 2]) * physics.gravity_m_s2
    energy = jnp.maximum((share * approach) ** 2 + 2 * fall * (rows.depth - AT_REST * physics.solimp[2]), 0.0)
    opening = jnp.where(share > 0, jnp.sqrt((fall * step_s / 2) ** 2 + energy) - fall * step_s / 2, 0.0)
    enough = (closing + opening) / step_s
    most = (1 + share) * approach / landing_s
    rigid = contact.solimp[:, 1] >= physics.solimp[1] * (1 - 1e-6)
    acts = lands & rigid & (approach > FAST_M_S) & (enough > 0)
    pull = rows.pull.at[:, 0].set(jnp.where(acts, jnp.minimum(enough, most), rows.pull[:, 0]))
    changed = rows._replace(pull=pull, stiffness=rows.stiffness * stiffer[:, None])
    return changed, landing._replace(left=left, before=before)
