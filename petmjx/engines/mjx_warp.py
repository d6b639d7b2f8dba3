"""Engine ``mjx-warp``: MJX stepping with NVIDIA Warp's kernels. The fast one; everything private to it is here."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import warp
from jaxtyping import Array, Float, Int
from mujoco import mjx

from petmjx.config import Cone, Physics, SimConfig
from petmjx.devices import why_no_warp
from petmjx.engines import warp_cholesky
from petmjx.engines.jax_setup import set_up_warp
from petmjx.engines.mjx import MIN_LANES, MjxEngine
from petmjx.engines.template import FIRST_BOX_GEOM, FLOAT32_TOLERANCE, padded_template
from petmjx.errors import EngineUnavailable
from petmjx.metrics.force import contact_force_z, pressed_box
from petmjx.outcome import Flag

TOLERANCE = {Cone.ELLIPTIC: FLOAT32_TOLERANCE, Cone.PYRAMIDAL: 1e-2}
"""Relative solver tolerance. With pyramidal cones float32 needs many iterations for digits no verdict depends on;
1e-2 moves a settled full stack by 0.1 mm. With elliptic cones a looser one gains nothing (benchmarks/README.md)."""

ITERATIONS, LINE_SEARCH_ITERATIONS = 5, 10
"""Limits of the Newton solver and its line search. A step lasts as long as its slowest world: in float32 a colliding
one goes on to any limit (MuJoCo's are 100 and 50) without getting closer, while standing ones take 1.3 iterations.
Verdicts against C MuJoCo's full solver: benchmarks/README.md."""

CONTACTS_PER_BOX = 6
"""Contacts reserved per box, averaged over lanes (one pool serves all): full real pallets have 4.5."""

ROWS_PER_BOX = {Cone.ELLIPTIC: 22, Cone.PYRAMIDAL: 30}
"""Constraint rows reserved per box in each lane. Full real pallets have 14 and 19; the fullest of 2,000 sample plans,
collapsing ones among them, took 19 with elliptic cones."""

PREFERRED_LANES = 2048
"""Lanes at which an H100 is as good as full at every capacity (benchmarks/README.md)."""

DEFAULT_MEMORY = 8 << 30
"""Assumed where a device does not tell its memory, bytes."""

# Bits of mujoco_warp's overflow mask (its OverflowType). Reaching an iteration limit is no truncation: the
# accelerations are then less exact, not wrong, as in C MuJoCo.
_ROWS = 0b1 | 0b10 | 1 << 7
_CONTACTS = 1 << 2 | 1 << 3
_LIMITS = 1 << 9 | 1 << 10


class WarpStepper:
    """Steps lanes with MJX's Warp implementation. Contacts of all lanes share one pool.

    Args:
        contacts: size of the pool, all lanes together.
        rows: constraint rows of one lane.
    """

    def __init__(self, template: mujoco.MjModel, lanes: int, physics: Physics, contacts: int, rows: int) -> None:
        self.template = template
        self.lanes = lanes
        self.physics = physics
        self.contacts = contacts
        self.rows = rows
        # Overflow is read from its mask; Warp's kernels would print a line per world and step.
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
        address = pool.contact__efc_address[:, : 4 if pyramidal else 3]
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


def lane_bytes(capacity: int) -> int:
    """Device memory that a lane takes, bytes: its constraint Jacobian with room for every row, and two dense
    matrices of all degrees of freedom (Hessian and factor); everything else is small beside them."""
    dofs = 6 * (capacity + 1)
    return 4 * (max(ROWS_PER_BOX.values()) * (capacity + 2) * dofs + 2 * (dofs + 16) ** 2)


class MjxWarpEngine(MjxEngine):
    """Batched MJX on Warp's kernels.

    Args:
        allow_cpu: run Warp's kernels on the CPU where there is no CUDA device: slow, for tests.

    Raises:
        EngineUnavailable: no CUDA device, or Warp is not installed; the text says which.
    """

    name = "mjx-warp"

    def __init__(self, lanes: int | None = None, *, allow_cpu: bool = False, **options: Any) -> None:
        problem = None if allow_cpu else why_no_warp()
        if problem:
            raise EngineUnavailable(f"engine mjx-warp cannot run here: {problem}")
        set_up_warp()
        warp_cholesky.install()
        super().__init__(lanes, **options)

    def release(self) -> None:
        """Drop captured CUDA graphs: each keeps its solver's workspace, gigabytes of it at large capacities."""
        warp.clear_jax_callable_graph_cache()

    def default_lanes(self, capacity: int) -> int:
        """The fastest number of lanes measured, or what two thirds of the device's free memory hold."""
        stats: dict[str, int] = jax.devices()[0].memory_stats() or {}
        free = stats.get("bytes_limit", DEFAULT_MEMORY) - stats.get("bytes_in_use", 0)
        fit = int(free * 2 / 3 / lane_bytes(capacity))
        return max(MIN_LANES, 1 << (min(PREFERRED_LANES, fit).bit_length() - 1))

    def make_stepper(self, capacity: int, lanes: int, sim: SimConfig, *, held: bool, growth: int) -> WarpStepper:
        template = padded_template(
            capacity,
            sim.physics,
            held=held,
            solver=sim.solver,
            tolerance=max(sim.solver_tolerance or TOLERANCE[sim.physics.cone], FLOAT32_TOLERANCE),
            iterations=sim.solver_iterations or ITERATIONS,
            native_ccd=False,
            line_search_iterations=LINE_SEARCH_ITERATIONS,
        )
        rows = ROWS_PER_BOX[sim.physics.cone] * (capacity + 2) * growth
        contacts = CONTACTS_PER_BOX * (capacity + 2) * lanes * growth
        return WarpStepper(template, lanes, sim.physics, contacts, rows)
