"""MJX's own Warp step and solver, for conjugate gradients."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float, Int

from petmjx.config import Cone, Physics
from petmjx.engines.batch.mjx import mjx
from petmjx.engines.batch.template import FIRST_BOX_GEOM, ROWS_PER_CONTACT
from petmjx.metrics.force_jax import contact_force_z, pressed_box
from petmjx.verdict import Flag

# Bits of mujoco_warp's overflow mask (its OverflowType). An iteration limit is no overflow: the accelerations are
# then less exact, but nothing is lost, as in C MuJoCo.
_ROWS = 0b1 | 0b10 | 1 << 7
_CONTACTS = 1 << 2 | 1 << 3
_LIMITS = 1 << 9 | 1 << 10


class StockStepper:
    """Steps lanes with MJX's Warp implementation. Contacts of all lanes share one pool.

    Args:
        contacts: size of the pool, all lanes together.
        rows: constraint rows of one lane.
    """

    def __init__(self, template: mujoco.MjModel, lanes: int, physics: Physics, contacts: int, rows: int) -> None:
        self.template, self.lanes, self.physics = template, lanes, physics
        self.contacts, self.rows = contacts, rows
        # Overflow is read from the mask; otherwise Warp's kernels print a line per world and step.
        self.model: Any = mjx.put_model(template, impl="warp").tree_replace({"opt._impl.warn_overflow": 0})

    def scratch(self) -> Any:
        one = mjx.make_data(self.template, impl="warp", naconmax=self.contacts, njmax=self.rows)
        return jax.jit(jax.vmap(lambda _: one))(jnp.arange(self.lanes))

    def step(self, overrides: dict[str, jax.Array], inputs: dict[str, jax.Array], scratch: Any) -> Any:
        def one_lane(fields: dict[str, jax.Array], data: Any) -> Any:
            return mjx.step(self.model.tree_replace(fields), data)

        clean = scratch.replace(**inputs).tree_replace({"_impl.overflow": jnp.zeros(self.lanes, jnp.int32)})
        return jax.vmap(one_lane)(overrides, clean)

    def top_force(self, overrides: dict[str, jax.Array], scratch: Any) -> Float[Array, "lane box"]:
        pool = scratch._impl
        pyramidal = self.physics.cone is Cone.PYRAMIDAL
        address = pool.contact__efc_address[:, : ROWS_PER_CONTACT[self.physics.cone]]
        used = (jnp.arange(self.contacts) < pool.nacon[0]) & (address[:, 0] >= 0)
        lane = jnp.where(used, pool.contact__worldid, 0)
        rows = pool.efc__force[lane[:, None], jnp.clip(address, 0, self.rows - 1)]
        rows = jnp.pad(rows, ((0, 0), (0, 4 - address.shape[1])))
        frame_z = pool.contact__frame[..., 2]
        force = contact_force_z(rows, frame_z, pool.contact__friction[:, :2], pyramidal=pyramidal)
        geom = jnp.where(used[:, None], pool.contact__geom, 0)
        geom_z = scratch.geom_xpos[lane[:, None], geom, 2]
        box, sign, counts = pressed_box(geom, geom_z, frame_z[:, 0], FIRST_BOX_GEOM)
        counts = counts & used
        capacity = self.template.ngeom - FIRST_BOX_GEOM
        flat = jnp.where(counts, lane * capacity + box, self.lanes * capacity)
        total = jax.ops.segment_sum(jnp.where(counts, sign * force, 0.0), flat, self.lanes * capacity + 1)
        return total[:-1].reshape(self.lanes, capacity)

    def overflow(self, scratch: Any) -> Int[Array, " lane"]:
        mask = scratch._impl.overflow
        flags = jnp.where(mask & _ROWS, int(Flag.CONSTRAINT_OVERFLOW), 0)
        flags |= jnp.where(mask & _CONTACTS, int(Flag.CONTACT_OVERFLOW), 0)
        other = mask & ~(_ROWS | _CONTACTS | _LIMITS)
        return flags | jnp.where(other, int(Flag.OTHER_OVERFLOW), 0)

    def usage(self, scratch: Any) -> Int[Array, " 2"]:
        return jnp.stack([scratch._impl.nacon[0], scratch._impl.nefc.max()])

    def iterations(self, scratch: Any) -> Int[Array, " lane"]:
        niter: jax.Array = scratch._impl.solver_niter
        return niter
