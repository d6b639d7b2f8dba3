"""Engine ``mjx-jax``: MJX in pure JAX. For tests and for machines where nothing else runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float, Int

from petmjx.config import Cone, Physics, Simulation
from petmjx.engines.base import Progress
from petmjx.engines.batch.engine import StageEngine
from petmjx.engines.batch.mjx import mjx
from petmjx.engines.batch.template import FLOAT32_TOLERANCE, MAX_ITERATIONS, padded_template
from petmjx.metrics.force_jax import contact_force_z, pressed_box
from petmjx.verdict import Outcome
from petmjx.world.job import Job
from petmjx.world.model import geom_bodies

LINE_SEARCH_ITERATIONS = 30
"""Under ``vmap`` all iterations of a line search are computed, even those not needed. With 10, in 2.2 % of the steps of
small piles a force on a box was more than 50 N from that of C: the solver had given up while boxes land. With 30 it is
in 0.2 %."""


class JaxStepper:
    """Steps lanes with ``mjx.step`` under ``vmap``. Contacts have fixed slots, so nothing can overflow."""

    def __init__(self, template: mujoco.MjModel, capacity: int, lanes: int, physics: Physics) -> None:
        self.template, self.capacity, self.lanes, self.physics = template, capacity, lanes, physics
        self.geom_bodies = jnp.asarray(geom_bodies(template, range(capacity)))
        self.model: Any = mjx.put_model(template, impl="jax")

    def scratch(self) -> Any:
        one = mjx.make_data(self.template, impl="jax")
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (self.lanes, *jnp.shape(leaf))), one)

    def step(self, overrides: dict[str, jax.Array], inputs: dict[str, jax.Array], scratch: Any) -> Any:
        def one_lane(fields: dict[str, jax.Array], data: Any) -> Any:
            model = self.model.tree_replace(fields)
            done = mjx.forward(model, data)
            # MJX's line search takes the root of a squared tangential force. In float32 that can be slightly negative
            # for contacts almost at rest (3.17: solver.py, _LSPoint). Then the accelerations and forces of the last
            # step are used, from which the solver started.
            lost = ~jnp.isfinite(done.qacc).all()
            qacc = jnp.where(lost, data.qacc_warmstart, done.qacc)
            done = done.replace(qacc=qacc, qacc_warmstart=qacc)
            forces = jnp.where(lost, data._impl.efc_force, done._impl.efc_force)
            return mjx.euler(model, done.tree_replace({"_impl.efc_force": forces}))

        return jax.vmap(one_lane)(overrides, scratch.replace(**inputs))

    def top_force(self, overrides: dict[str, jax.Array], scratch: Any) -> Float[Array, "lane box"]:
        contact = scratch._impl.contact
        pyramidal = self.physics.cone is Cone.PYRAMIDAL
        rows_per_contact = 4 if pyramidal else 3
        geom = contact.geom[0]
        # A contact has the same rows in every lane; inactive ones have no force.
        row = jnp.asarray(contact.efc_address)[:, None] + jnp.arange(rows_per_contact)
        rows = scratch._impl.efc_force[:, row]
        rows = jnp.pad(rows, ((0, 0), (0, 0), (0, 4 - rows_per_contact)))
        force = contact_force_z(rows, contact.frame[..., 2], contact.friction[..., :2], pyramidal=pyramidal)
        geom_z = scratch.geom_xpos[..., 2][:, geom]
        body = jnp.broadcast_to(self.geom_bodies[geom], geom_z.shape)
        box, sign, counts = pressed_box(body, geom_z, contact.frame[..., 0, 2])
        lane, capacity = jnp.arange(self.lanes)[:, None], self.capacity
        return (
            jnp.zeros((self.lanes, capacity))
            .at[lane, jnp.where(counts, box, capacity)]
            .add(jnp.where(counts, sign * force, 0.0), mode="drop")
        )

    def overflow(self, scratch: Any) -> Int[Array, " lane"]:
        return jnp.zeros(self.lanes, jnp.int32)

    def usage(self, scratch: Any) -> Int[Array, " 2"]:
        return jnp.zeros(2, jnp.int32)

    def iterations(self, scratch: Any) -> Int[Array, " lane"]:
        return jnp.zeros(self.lanes, jnp.int32)


class MjxJaxEngine(StageEngine):
    """Batched MJX in pure JAX, on any device of JAX.

    Boxes have no skin: MJX's collider always prefers a face to an edge that is almost parallel to it. And it measures
    depths along the face's normal (3.17: ``collision_convex.py``), so that with a skin contacts of edges and corners
    would be deeper than they are.
    """

    name = "mjx-jax"

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """As in the base class."""
        physics = sim.physics.changed(skin_m=0.0)
        return super().run(jobs, sim.changed(physics=physics), progress)

    def make_stepper(
        self, capacity: int, boards: int, lanes: int, sim: Simulation, *, held: bool, growth: int
    ) -> JaxStepper:
        template = padded_template(
            capacity,
            boards,
            sim.physics,
            held=held,
            solver=sim.solver,
            tolerance=max(sim.solver_tolerance or 0.0, FLOAT32_TOLERANCE),
            iterations=sim.solver_iterations or MAX_ITERATIONS,
            line_search_iterations=LINE_SEARCH_ITERATIONS,
        )
        # Nothing is damped. With damping enabled, each step would compute its accelerations twice.
        template.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        return JaxStepper(template, capacity, lanes, sim.physics)
