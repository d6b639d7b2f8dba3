"""Collision detection for one world: MJX's colliders, for two boxes only where their bounding boxes overlap.

``mjx.collision`` passes all pairs of geoms to its colliders. Of the n²/2 pairs of n boxes on a pallet, some 5·n touch.
So pairs of boxes whose bounding boxes overlap are passed to MJX's collider in parts of equal size, until no such pair
is left. Pairs that are not passed to the collider get contacts with a distance of 1 m, which exert no force. As with
MJX, a contact has the same geoms in all steps.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.mjx.mjx_import import mjx

PAIRS_PER_GEOM: Final = 2
"""MJX's collider for two boxes gets several pairs at a time: this number of pairs for each geom of the world."""

NEAR_M: Final = 1e-4
"""Bounding boxes that are less than this distance apart, m, count as overlapping. Rounding errors are far smaller."""

_BOXES: Final = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_BOX)

Contacts = tuple[Float[Array, " contact"], Float[Array, "contact 3"], Float[Array, "contact 3 3"]]
"""Distances (m), places (m) and frames of contacts."""

Collider = Callable[[Int[Array, "pair 2"]], Contacts]


def collision(model: Any, data: Any) -> Any:
    """The data with the contacts that ``mjx.collision`` (MuJoCo 3.17) finds. Another version of MJX may lack the
    private functions that this function needs. In this case, ``mjx.collision`` itself examines all pairs of geoms."""
    try:
        from mujoco.mjx._src.collision_driver import _COLLISION_FUNC, _contact_groups
    except ImportError:
        return mjx.collision(model, data)

    at_once, groups = PAIRS_PER_GEOM * model.ngeom, []
    for key, contact in _contact_groups(model, data).items():
        collider = _COLLISION_FUNC[key.types]
        collide: Collider = partial(collider, model, data, key)
        if key.types == _BOXES and len(contact.geom) > 2 * at_once:
            near = _overlap(model, data, contact.geom, contact.includemargin)
            dist, pos, frame = _contacts_of_near(collide, contact.geom, near, at_once)
        else:
            dist, pos, frame = collide(contact.geom)
        contact = jax.tree.map(partial(jnp.repeat, repeats=collider.ncon, axis=0), contact)
        groups.append(contact.replace(dist=dist, pos=pos, frame=frame))
    contact = jax.tree.map(lambda *values: jnp.concatenate(values), *groups)
    return data.tree_replace({"_impl.contact": contact})


def _overlap(model: Any, data: Any, geoms: Int[Array, "pair 2"], margin: Float[Array, " pair"]) -> Bool[Array, " pair"]:
    """Whether the bounding boxes of two boxes overlap. The sides of bounding boxes are parallel to the world's axes."""
    half = jnp.einsum("gij,gj->gi", jnp.abs(data.geom_xmat), model.geom_size)
    one, two = geoms.T
    apart = jnp.abs(data.geom_xpos[one] - data.geom_xpos[two]) - half[one] - half[two]
    return apart.max(-1) < margin + NEAR_M


def _contacts_of_near(
    collide: Collider, geoms: Int[Array, "pair 2"], near: Bool[Array, " pair"], at_once: int
) -> Contacts:
    """The contacts of all pairs. ``collide`` gets only the pairs that are near, ``at_once`` of them at a time. All
    other pairs get contacts with a distance of 1 m."""
    order = jnp.argsort(~near)  # pairs that are near come first
    count = -(-len(order) // at_once)
    parts = geoms[jnp.resize(order, (count, at_once))]
    opened = jax.tree.map(lambda values: jnp.ones((count, *values.shape)), jax.eval_shape(collide, parts[0]))

    def with_part(carry: tuple[Array, Any]) -> tuple[Array, Any]:
        part, contacts = carry
        return part + 1, jax.tree.map(lambda old, new: old.at[part].set(new), contacts, collide(parts[part]))

    def goes_on(carry: tuple[Array, Any]) -> Bool[Array, ""]:
        return carry[0] * at_once < near.sum()

    _, contacts = jax.lax.while_loop(goes_on, with_part, (jnp.int32(0), opened))
    place = jnp.argsort(order)

    def in_order(values: Array) -> Array:
        of_pairs = values.reshape(count * at_once, -1, *values.shape[2:])
        return of_pairs[place].reshape(-1, *values.shape[2:])

    all_contacts: Contacts = jax.tree.map(in_order, contacts)
    return all_contacts
