"""Contact laws of compliant boxes, for all worlds of a batch. This module does the same as petmjx/world/compliance.py,
but shares no arithmetic with it."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from petmjx.engines.mjx.world_constants import Worlds
from petmjx.options.physics import Physics
from petmjx.world.bearings import TOUCH_M
from petmjx.world.compliance import LEAST_IMPEDANCE, LEAST_SHARE
from petmjx.world.contact_laws import CONTACTS_PER_FACE


def laws(
    worlds: Worlds,
    model: Any,
    inverse_mass: Float[Array, "world body"],
    physics: Physics,
    rigid_solref: Float[Array | np.ndarray, "... pair 2"],
) -> dict[str, Float[Array, "world ..."]]:
    """Model fields ``pair_solref`` and ``pair_solimp``: the contact laws of all pairs of geoms that the model declares.

    Args:
        inverse_mass: inverse masses, 1/kg; 0 for a held carrier.
        rigid_solref: solref of pairs of which neither geom is compliant.
    """
    one, two = model.pair_geom1, model.pair_geom2
    n, shapes = worlds.shape_give.shape
    boards = shapes - worlds.half.shape[1]
    planned = jnp.concatenate([worlds.carrier_pos[:, None] + worlds.shape_pos[:, :boards], worlds.target], axis=1)
    # the first geom is the floor, which is larger than all bodies and below them
    middle = jnp.concatenate([jnp.full((n, 1, 3), -1e3), planned], axis=1)
    half = jnp.concatenate([jnp.full((n, 1, 3), 1e2), worlds.shape_half], axis=1)
    give = jnp.pad(worlds.shape_give, ((0, 0), (1, 0)))
    of_shape = jnp.take_along_axis(inverse_mass, worlds.shape_body, axis=1)
    inverse = jnp.pad(of_shape, ((0, 0), (1, 0)))
    base = 4.0 * half[..., 0] * half[..., 1]
    smaller = jnp.minimum(base[:, one], base[:, two])
    reach, apart = half[:, one] + half[:, two], jnp.abs(middle[:, one] - middle[:, two])
    low = jnp.maximum(middle[:, one] - half[:, one], middle[:, two] - half[:, two])
    high = jnp.minimum(middle[:, one] + half[:, one], middle[:, two] + half[:, two])
    length = (high - low)[..., :2]
    beside = (apart[..., 2] < reach[..., 2] - TOUCH_M) | (length <= 0).any(-1)
    area = jnp.where(beside, smaller, jnp.maximum(length.prod(-1), LEAST_SHARE * smaller))
    soft = give[:, one] + give[:, two]
    gives = soft > 0
    spring = area / jnp.where(gives, soft, 1.0) / CONTACTS_PER_FACE
    solref, impedance = spring_laws(physics, spring, jnp.maximum(inverse[:, one] + inverse[:, two], 1e-12))
    solimp = jnp.broadcast_to(model.pair_solimp, (n, *model.pair_solimp.shape)).at[..., :2].set(impedance[..., None])
    return {
        "pair_solref": jnp.where(gives[..., None], solref, rigid_solref),
        "pair_solimp": jnp.where(gives[..., None], solimp, model.pair_solimp),
    }


def spring_laws(
    physics: Physics, spring_n_m: Float[Array, ...], inverse_mass: Float[Array, ...]
) -> tuple[Float[Array, "... 2"], Float[Array, ...]]:
    """solref and impedance with which contacts at rest act as springs of the stiffnesses ``spring_n_m``, N/m."""
    time, damping = physics.solref
    time = time if time < 0 else max(time, 2 * physics.timestep_s)
    stiffness = -time if time < 0 else 1 / (time * damping) ** 2
    lack = stiffness / (spring_n_m * inverse_mass)
    impedance = jnp.clip(1 - lack, LEAST_IMPEDANCE, physics.solimp[1])
    longer = jnp.maximum(lack / (1 - LEAST_IMPEDANCE), 1.0)
    if time < 0:
        return jnp.stack([time / longer, damping / jnp.sqrt(longer)], axis=-1), impedance
    return jnp.stack([time * jnp.sqrt(longer), jnp.full_like(longer, damping)], axis=-1), impedance
