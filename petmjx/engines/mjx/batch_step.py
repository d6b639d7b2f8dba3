"""One padded MJX model for all worlds of a batch, and one step of all these worlds."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from petmjx.engines.mjx.bed import Beds, Faces
from petmjx.engines.mjx.landing import Landing, act
from petmjx.engines.mjx.mjx_import import mjx
from petmjx.engines.mjx.newton import BlockSolver
from petmjx.engines.mjx.padded_template import FLOAT32_TOLERANCE, MAX_ITERATIONS, contact_geoms, padded_template
from petmjx.engines.mjx.slip import SlipLaw
from petmjx.engines.mjx.top_forces import contact_force_z, pressed_box
from petmjx.options.physics import Cone
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.mujoco_model import CARRIER_NAME, geom_bodies

LINE_SEARCH_ITERATIONS = 30
"""Number of line search iterations. Under ``vmap``, all branches are computed, also unneeded ones. With 10
iterations, the force on a box differed from that in C MuJoCo by more than 50 N in 2.2 % of the steps of small piles:
the solver had given up while boxes landed. With 30 iterations, this happens in 0.2 % of the steps."""


class StepResult(NamedTuple):
    """The result of a step: MuJoCo's coordinates, and values for samples and for the next step.

    ``qacc_warmstart``: accelerations from which the solver starts in the next step; ``forces``: forces of all
    constraints.
    """

    qpos: Float[Array, "world coordinate"]
    qvel: Float[Array, "world velocity"]
    qacc: Float[Array, "world velocity"]
    qacc_warmstart: Float[Array, "world velocity"]
    forces: Float[Array, "world constraint"]
    top_force: Float[Array, "world box"]
    landing: Landing | None = None


class PaddedModel:
    """Steps worlds of up to ``capacity`` boxes with the parts of ``mjx.step`` under ``vmap``.

    Model fields that differ between worlds are passed to each step. Contacts have fixed slots, so nothing can overflow.

    Attributes:
        carrier, bodies: index of the carrier's body, and number of bodies.

    Args:
        capacity: largest number of boxes of a world.
        boards: number of shapes of each carrier.
        held: whether the carrier is held at the pose in its world's data (acceleration profiles).
    """

    def __init__(self, capacity: int, boards: int, sim: Simulation, *, held: bool) -> None:
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
        self.capacity, self.held = capacity, held
        self.pyramidal = sim.physics.cone is Cone.PYRAMIDAL
        self.model: Any = mjx.put_model(template, impl="jax")
        self._slip: SlipLaw | None = None
        if not self.pyramidal:
            solver = BlockSolver(self.model, contact_geoms(self.model), conjugate=sim.solver is Solver.CG)
            self._slip = SlipLaw(sim.physics, solver, self._model_of)
        self.carrier, self.bodies = template.body(CARRIER_NAME).id, template.nbody
        self._geom_bodies = jnp.asarray(geom_bodies(template, range(capacity)))
        self._data: Any = mjx.make_data(template, impl="jax")
        self._physics, self._sim = sim.physics, sim
        self._beds: Beds | None = None

    def lay_beds(self) -> None:
        """Allow compliant boxes from now on. Call this outside of compiled programs."""
        self._beds = Beds(self.model, self._data, self._physics)

    def _model_of(self, fields: dict[str, jax.Array]) -> Any:
        """The model of one world."""
        return self.model.tree_replace(fields)

    def no_forces(self, worlds: int) -> Float[Array, "world constraint"]:
        """Constraint forces before the first step: all zero."""
        return jnp.zeros((worlds, *self._data._impl.efc_force.shape))

    def step(
        self,
        fields: dict[str, Float[Array, "world ..."]],
        inputs: dict[str, Float[Array, "world ..."]],
        forces: Float[Array, "world constraint"],
        faces: Faces | None = None,
        landing: Landing | None = None,
    ) -> StepResult:
        """Simulate one step of all worlds.

        Args:
            fields: model fields that differ between worlds.
            inputs: fields of the data: qpos, qvel, qacc_warmstart, xfrc_applied, and the place of a held carrier.
            forces: constraint forces of the previous step.
            faces: the faces of the geoms, needed for compliant boxes (``lay_beds``).
            landing: the landing boxes, if a law of landing is in use.
        """

        def ready(
            fields: dict[str, jax.Array], inputs: dict[str, jax.Array], faces: Faces | None, landing: Landing | None
        ) -> tuple[Any, Landing | None]:
            # These are the steps of mjx.forward up to the solver.
            model, data = self._model_of(fields), self._data.replace(**inputs)
            if self._beds is None or faces is None:
                data = mjx.fwd_position(model, data)
            else:
                data = self._beds.fwd_position(model, data, faces)
            if landing is not None:
                data, landing = act(data, self._geom_bodies[data._impl.contact.geom], landing, self._sim)
            data = mjx.fwd_actuation(model, mjx.fwd_velocity(model, data))
            return mjx.fwd_acceleration(model, data), landing

        def ended(fields: dict[str, jax.Array], data: Any, forces: jax.Array) -> Any:
            # Between stiff contacts, the solver's matrix may become NaN in float32. Then use the accelerations from
            # which the solver started, and the forces of the previous step.
            lost = ~jnp.isfinite(data.qacc).all()
            qacc = jnp.where(lost, data.qacc_warmstart, data.qacc)
            forces = jnp.where(lost, forces, data._impl.efc_force)
            ended_data = data.replace(qacc=qacc, qacc_warmstart=qacc).tree_replace({"_impl.efc_force": forces})
            return mjx.euler(self._model_of(fields), ended_data)

        data, landing = jax.vmap(ready)(fields, inputs, faces, landing)
        if self._slip is not None:
            data = self._slip.solve(fields, data)
        else:
            data = jax.vmap(lambda fields, data: mjx.solve(self._model_of(fields), data))(fields, data)
        data = jax.vmap(ended)(fields, data, forces)
        start, forces = data.qacc_warmstart, data._impl.efc_force
        return StepResult(data.qpos, data.qvel, data.qacc, start, forces, self._top_force(data), landing)

    def _top_force(self, data: Any) -> Float[Array, "world box"]:
        """Force that presses on each box's top in the step, N."""
        contact = data._impl.contact
        rows_per_contact = 4 if self.pyramidal else 3
        geom = contact.geom[0]
        # A contact has the same rows in every world. Inactive contacts have no force.
        row = jnp.asarray(contact.efc_address)[:, None] + jnp.arange(rows_per_contact)
        rows = data._impl.efc_force[:, row]
        rows = jnp.pad(rows, ((0, 0), (0, 0), (0, 4 - rows_per_contact)))
        force = contact_force_z(rows, contact.frame[..., 2], contact.friction[..., :2], pyramidal=self.pyramidal)
        geom_z = data.geom_xpos[..., 2][:, geom]
        body = jnp.broadcast_to(self._geom_bodies[geom], geom_z.shape)
        box, sign, counts = pressed_box(body, geom_z, contact.frame[..., 0, 2])
        world = jnp.arange(len(force))[:, None]
        return (
            jnp.zeros((len(force), self.capacity))
            .at[world, jnp.where(counts, box, self.capacity)]
            .add(jnp.where(counts, sign * force, 0.0), mode="drop")
        )
