"""Contacts that slide, between MJX's contacts and its solver. The law: petmjx/world/slip.py."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from petmjx.options.physics import Physics
from petmjx.world.slip import STICKS_M_S, slack_m_s2


def corrected(data: Any, physics: Physics) -> Any:
    """MJX's data of one world with the contacts that slide changed; elliptic cones only. Contacts that are open have
    rows of zeros, and stay as they are."""
    contact = data._impl.contact
    normal = np.asarray(contact.efc_address)
    aref, friction = data._impl.efc_aref, contact.friction
    if physics.kinetic_friction_share < 1:
        velocity = data._impl.efc_J @ data.qvel
        ramp = jnp.clip(jnp.hypot(velocity[normal + 1], velocity[normal + 2]) / STICKS_M_S - 1.0, 0.0, 1.0)
        share = 1.0 - (1.0 - physics.kinetic_friction_share) * ramp
        friction = friction.at[:, :2].multiply(share[:, None])
    excess = jnp.maximum(jnp.hypot(aref[normal + 1], aref[normal + 2]) - slack_m_s2(physics), 0.0)
    aref = aref.at[normal].add(-friction[:, 0] * excess)
    return data.tree_replace({"_impl.efc_aref": aref, "_impl.contact.friction": friction})
