"""One padded MJX model for all worlds of a batch, and one step of all these worlds."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.mjx.body_dynamics import Bodies, Links
from petmjx.engines.mjx.collision import collision
from petmjx.engines.mjx.face_contacts import Beds, Faces
from petmjx.engines.mjx.landing import Landing, act
from petmjx.engines.mjx.mjx_import import mjx
from petmjx.engines.mjx.newton import BlockSolver, Problem
from petmjx.engines.mjx.padded_template import padded_template
from petmjx.engines.mjx.slip import SlipLaw, Solution
from petmjx.engines.mjx.top_forces import contact_force_z, pressed_box
from petmjx.options.physics import Cone
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.mujoco_model import CARRIER_NAME, geom_bodies


class Memory(NamedTuple):
    """The data that the solver of a batch keeps from one pass to the next. A pass is one call of ``PaddedModel.step``.
    A world whose solver pauses needs several passes for one step.

    Attributes:
        forces: forces of all constraints in the last step.
        solution: the solutions so far of the present step, for solvers that pause; None if no solver may pause.
    """

    forces: Float[Array, "world constraint"]
    solution: Solution | None = None


class StepResult(NamedTuple):
    """The result of a step: MuJoCo's coordinates, and values for samples and for the next step.

    ``qacc_warmstart``: accelerations from which the solver starts in the next step; ``iterations``: number of the
    solver's iterations; ``pauses``: whether the solver needs another pass to complete the world's step. ``pauses`` is
    None if no solver may pause.
    """

    qpos: Float[Array, "world coordinate"]
    qvel: Float[Array, "world velocity"]
    qacc: Float[Array, "world velocity"]
    qacc_warmstart: Float[Array, "world velocity"]
    memory: Memory
    top_force: Float[Array, "world box"]
    iterations: Int[Array, " world"]
    landing: Landing | None = None
    pauses: Bool[Array, " world"] | None = None


class PaddedModel:
    """Steps worlds of up to ``capacity`` boxes under ``vmap``.

    With elliptic cones, MJX finds the contacts, and the rest of the step is petmjx's own (body_dynamics.py, newton.py).
    With pyramidal cones, the functions of which ``mjx.step`` consists do the whole step.

    Model fields that differ between worlds are passed to each step. Contacts have fixed slots, so nothing can overflow.

    Attributes:
        carrier: index of the carrier's body.
        bodies: number of bodies.

    Args:
        capacity: largest number of boxes of a world.
        boards: number of shapes of each carrier.
        held: whether the carrier cannot move, as in profiles of accelerations. The pose of a held carrier is in the
            data of its world.
        pausing: whether the solver of a batch may pause (elliptic cones only). While other worlds take their next
            step, a world that pauses repeats its step, and its solver continues.
    """

    def __init__(self, capacity: int, boards: int, sim: Simulation, *, held: bool, pausing: bool = False) -> None:
        template = padded_template(capacity, boards, sim, held=held)
        # Nothing is damped. If damping were enabled, MJX would compute the accelerations of each step twice.
        template.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        self.capacity, self.held = capacity, held
        self.pyramidal = sim.physics.cone is Cone.PYRAMIDAL
        # runs with the solver ``cg`` use the engine ``mujoco`` (petmjx/engines/attempt_settings.py)
        assert self.pyramidal or sim.solver is Solver.NEWTON
        self.model: Any = mjx.put_model(template, impl="jax")
        self.carrier, self.bodies = template.body(CARRIER_NAME).id, template.nbody
        self._data: Any = mjx.make_data(template, impl="jax")
        self._sim = sim
        self._links = Links(self.model)
        self._pausing = pausing and not self.pyramidal
        self._slip = SlipLaw(sim.physics, BlockSolver(self._links))
        self._beds = Beds(self.model, sim.physics)
        self._boxes = geom_bodies(template, range(capacity))[self._links.geoms]
        """(contact, 2) the box to which each geom of a contact belongs; negative: no box"""

    def blank_memory(self, worlds: int) -> Memory:
        """The memory before the first step. All forces are zero."""
        forces = jnp.zeros((worlds, *self._data._impl.efc_force.shape))
        if not self._pausing:
            return Memory(forces)
        rows, velocities = jnp.zeros((worlds, len(self._boxes), 3)), jnp.zeros((worlds, self.model.nv))
        return Memory(forces, Solution.finished(velocities, rows))

    def step(
        self,
        fields: dict[str, Float[Array, "world ..."]],
        inputs: dict[str, Float[Array, "world ..."]],
        memory: Memory,
        faces: Faces | None = None,
        landing: Landing | None = None,
    ) -> StepResult:
        """Simulate one step of all worlds. If the solver of a world pauses, the world's results have no meaning.

        Between stiff contacts, accelerations may become NaN in float32. If accelerations are NaN, the step uses the
        accelerations from which the solver started, and the forces of the previous step.

        Args:
            fields: model fields that differ between worlds.
            inputs: fields of the data: qpos, qvel, qacc_warmstart, xfrc_applied, and the place of a held carrier.
            memory: the data that the solver has kept from the previous pass.
            faces: the faces of the geoms, needed for compliant boxes.
            landing: the landing boxes (petmjx/engines/mjx/landing.py), if the physics has a law of landing.
        """
        if self.pyramidal:
            return self._step_of_mjx(fields, inputs, memory.forces)
        contact, bodies, problem, pull, landing = jax.vmap(self._ready)(fields, inputs, faces, landing)
        start = inputs["qacc_warmstart"]
        solution = self._slip.begin(problem, pull, start, memory.solution)
        solve = self._slip.solve_in_part if self._pausing else self._slip.solve
        solution = solve(problem, pull, solution)
        qacc, force = solution.now.qacc, solution.now.force
        lost = ~jnp.isfinite(qacc).all(-1, keepdims=True)
        forces = jnp.where(lost | ~solution.done[:, None], memory.forces, force.reshape(len(force), -1))
        qacc = jnp.where(lost, start, qacc)
        qpos, qvel = jax.vmap(lambda bodies, qacc: bodies.after(qacc, self._sim.physics.timestep_s))(bodies, qacc)
        top_force = self._top_force(contact, forces)
        memory, pauses = (Memory(forces, solution), ~solution.done) if self._pausing else (Memory(forces), None)
        return StepResult(qpos, qvel, qacc, qacc, memory, top_force, solution.iterations, landing, pauses)

    def _ready(
        self, fields: dict[str, jax.Array], inputs: dict[str, jax.Array], faces: Faces | None, landing: Landing | None
    ) -> tuple[Any, Bodies, Problem, Float[Array, "contact 3"], Landing | None]:
        """What the solver needs to know about one world: contacts, bodies, the ``Problem``, the reference
        accelerations of contacts, and the landing boxes."""
        model, links = self.model.tree_replace(fields), self._links
        bodies = Bodies.of(model, inputs)
        data = collision(model, self._data.replace(**links.geom_places(bodies, model, inputs)))
        if faces is not None:
            data = self._beds.pressed(data, faces)
        contact, velocity = data._impl.contact, inputs["qvel"]
        rows = links.rows(bodies, model, contact)
        if landing is not None:
            rows, landing = act(rows, velocity, self._boxes, contact, landing, links, self._sim)
        rows = self._slip.with_friction(rows, velocity)
        smooth = bodies.smooth(model, inputs["xfrc_applied"][-links.bodies :])
        return contact, bodies, Problem.of(model, bodies.mass, smooth, rows), rows.pull, landing

    def _step_of_mjx(
        self,
        fields: dict[str, Float[Array, "world ..."]],
        inputs: dict[str, Float[Array, "world ..."]],
        forces: Float[Array, "world constraint"],
    ) -> StepResult:
        """A step with the solver of MJX."""

        def stepped(fields: dict[str, jax.Array], inputs: dict[str, jax.Array], forces: jax.Array) -> tuple[Any, Any]:
            model, data = self.model.tree_replace(fields), self._data.replace(**inputs)
            data = mjx.solve(model, mjx.fwd_acceleration(model, mjx.fwd_velocity(model, mjx.fwd_position(model, data))))
            lost = ~jnp.isfinite(data.qacc).all()
            qacc = jnp.where(lost, data.qacc_warmstart, data.qacc)
            forces = jnp.where(lost, forces, data._impl.efc_force)
            return mjx.euler(model, data.replace(qacc=qacc, qacc_warmstart=qacc)), forces

        data, forces = jax.vmap(stepped)(fields, inputs, forces)
        top_force = self._top_force(data._impl.contact, forces)
        iterations = data._impl.solver_niter.reshape(len(forces))
        return StepResult(data.qpos, data.qvel, data.qacc, data.qacc_warmstart, Memory(forces), top_force, iterations)

    def _top_force(self, contact: Any, forces: Float[Array, "world constraint"]) -> Float[Array, "world box"]:
        """Force that presses on each box's top in the step, N."""
        # each contact has fixed entries in ``forces``, the same in every world; the forces of inactive contacts are 0
        rows = forces.reshape(len(forces), len(self._boxes), -1)
        rows = jnp.pad(rows, ((0, 0), (0, 0), (0, 4 - rows.shape[-1])))
        force = contact_force_z(rows, contact.frame[..., 2], contact.friction[..., :2], pyramidal=self.pyramidal)
        normal_z = contact.frame[..., 0, 2]
        box, sign, counts = pressed_box(jnp.broadcast_to(self._boxes, (*normal_z.shape, 2)), normal_z)
        pressed = counts[..., None] & (box[..., None] == jnp.arange(self.capacity))
        return jnp.where(pressed, (sign * force)[..., None], 0.0).sum(1)
