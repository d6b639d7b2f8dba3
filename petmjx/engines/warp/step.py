"""One physics step of all lanes on Warp's kernels, as a JAX call with few arguments.

``mjx.step`` passes every field of model and data through JAX: about 400 buffers, which Python handles in each call.
Here the model, the contact pool and the workspace belong to the step, and JAX sees only what changes: about 20 arrays.
Collisions come from mujoco_warp, in the copy inside MJX. Contacts' rows, the solver and the integrator are petmjx's.
"""

from __future__ import annotations

import dataclasses
import inspect
import itertools
import weakref
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import warp as wp
from jaxtyping import Array, Float, Int
from mujoco.mjx.third_party import mujoco_warp as mjw
from mujoco.mjx.third_party.mujoco_warp._src.collision_core import create_collision_context

from petmjx.config import Cone
from petmjx.engines.batch.capacities import round_up
from petmjx.engines.batch.template import CARRIER_BODY, ROWS_PER_CONTACT
from petmjx.engines.warp import kernels, newton, records
from petmjx.engines.warp.records import Collisions, Model, Out, State, Workspace, array_types, filled

COLLIDERS = [(mjw.GeomType.PLANE, mjw.GeomType.BOX), (mjw.GeomType.BOX, mjw.GeomType.BOX)]
"""Pairs of shapes that can collide on a pallet."""


class StepResult(NamedTuple):
    """What a step gives, fields named as MJX's data. ``contacts`` counts a lane's, ``top_force`` is in N."""

    qpos: jax.Array
    qvel: jax.Array
    qacc: jax.Array
    top_force: jax.Array
    overflow: jax.Array
    contacts: jax.Array
    iterations: jax.Array

    @property
    def qacc_warmstart(self) -> jax.Array:
        return self.qacc


class Records(NamedTuple):
    """The records of one step, in the order in which kernels take them."""

    model: Any
    state: Any
    collisions: Any
    work: Any
    out: Any


class PalletStepper:
    """Steps lanes of a padded template with Newton's method; a ``Stepper`` of stages.

    Args:
        pool: contacts of all lanes together.
        room: most contacts of one lane; rounded up to a multiple of ``kernels.SEARCH``.
        friction_damping: of contacts' tangents, 1/s; 0: as much as of their normals.
    """

    def __init__(
        self, template: mujoco.MjModel, lanes: int, pool: int, room: int, friction_damping: float = 0.0
    ) -> None:
        room = round_up(room, kernels.SEARCH)
        self.lanes, self.pool, self.room = lanes, pool, room
        self.held = int(template.nmocap)
        self.n_blocks = template.nbody - 1 - self.held
        if 6 * self.n_blocks > newton.MAX_DOFS:
            raise ValueError(f"{self.n_blocks} bodies are more than the solver has room for")
        self.pyramidal = int(template.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL)
        self.n_geoms, self.floor_z = template.ngeom, float(template.geom_pos[0, 2])
        self.timestep, self.tolerance = float(template.opt.timestep), float(template.opt.tolerance)
        self.limit, self.trials = int(template.opt.iterations), int(template.opt.ls_iterations)
        self.slack = float(template.opt.impratio) ** -0.5
        self.friction_damping = friction_damping
        # template.override_fields makes per-world fields from these; the shapes are those of MJX-Warp.
        self.model = SimpleNamespace(
            geom_size=jnp.asarray(template.geom_size, jnp.float32),
            geom_rbound=jnp.asarray(template.geom_rbound, jnp.float32),
            geom_aabb=jnp.asarray(template.geom_aabb.reshape(-1, 2, 3), jnp.float32),
        )
        self.sizes = records.axes(lanes, self.n_blocks, room, n_boxes=self.n_geoms - 2)
        self.out_shapes = records.array_shapes(Out, self.sizes)
        # Data of one world, except the pool: collision reads only the poses of geoms, and those are replaced.
        self.warp_model = mjw.put_model(template)
        data = mjw.make_data(template, nworld=1, naconmax=pool, njmax=1)
        self.data = dataclasses.replace(
            data,
            nworld=lanes,
            geom_xpos=wp.empty((lanes, self.n_geoms), dtype=wp.vec3),
            geom_xmat=wp.empty((lanes, self.n_geoms), dtype=wp.mat33),
        )
        self.context = create_collision_context(pool)
        self.id = next(_IDS)
        _STEPS[self.id] = self

    def scratch(self) -> StepResult:
        types = array_types(Out)
        blank = [np.zeros(shape, wp.dtype_to_numpy(types[name].dtype)) for name, shape in self.out_shapes.items()]
        return StepResult(*jax.device_put(blank))

    def step(self, overrides: dict[str, jax.Array], inputs: dict[str, jax.Array], scratch: StepResult) -> StepResult:
        carrier = inputs["qpos"][:, :7]
        if self.held:
            carrier = jnp.concatenate([inputs["mocap_pos"][:, 0], inputs["mocap_quat"][:, 0]], -1)
        given = overrides | {
            "qpos": inputs["qpos"],
            "qvel": inputs["qvel"],
            "warmstart": inputs["qacc_warmstart"],
            "carrier_force": inputs["xfrc_applied"][:, CARRIER_BODY, :3],
            "gravity": overrides["opt.gravity"],
            "carrier_pose": carrier,
        }
        # XLA captures the kernels into its command buffer and replays it without Python, for any addresses of arrays.
        # Graphs captured by Warp failed here ("unknown capture stream", Warp 1.18, JAX 0.11).
        call = wp.jax_callable(_step, num_outputs=len(_OUTPUTS), graph_mode=wp.JaxCallableGraphMode.JAX)
        shapes = self.out_shapes | {"workspace": records.buffer_shape(self.sizes)}
        *result, _ = call(self.id, *(given[name] for name in _INPUTS), output_dims=shapes)
        return StepResult(*result)

    def top_force(self, overrides: dict[str, jax.Array], scratch: StepResult) -> Float[Array, "lane box"]:
        return scratch.top_force

    def overflow(self, scratch: StepResult) -> Int[Array, " lane"]:
        return scratch.overflow

    def usage(self, scratch: StepResult) -> Int[Array, " 2"]:
        rows = ROWS_PER_CONTACT[Cone.PYRAMIDAL if self.pyramidal else Cone.ELLIPTIC]
        return jnp.stack([scratch.contacts.sum(), rows * scratch.contacts.max()])

    def iterations(self, scratch: StepResult) -> Int[Array, " lane"]:
        return scratch.iterations

    # ------------------------------------------------------------------ kernels, phase by phase

    def launch(self, arrays: dict[str, Any]) -> None:
        """Launch the step's kernels on Warp arrays, given by the names in ``_INPUTS`` and ``_OUTPUTS``."""
        r = Records(
            model=filled(Model, vars(self) | arrays),  # its numbers are attributes of this object
            state=filled(State, arrays),
            collisions=filled(Collisions, vars(self.data) | vars(self.data.contact)),
            work=filled(Workspace, records.in_buffer(arrays["workspace"], self.sizes)),
            out=filled(Out, arrays),
        )
        self._begin(r)
        self._collide(arrays)
        self._make_rows(r)
        self._solve(r)
        self._end(r)

    def _begin(self, r: Records) -> None:
        """Poses of geoms, inertia, and accelerations without contacts."""
        wp.launch(kernels.begin_step, dim=(self.lanes, self.n_geoms), inputs=[*r])

    def _collide(self, arrays: dict[str, Any]) -> None:
        """mujoco_warp's ``collision`` for planes and boxes, without its memory allocations.

        A graph with allocations could not be replayed by XLA.
        """
        own = {name: arrays[name] for name in array_types(Model) if name.startswith("geom_")}
        model = dataclasses.replace(self.warp_model, **own)
        self.data.nacon.zero_()
        self.data.ncollision.zero_()
        mjw.nxn_broadphase(model, self.data, self.context)
        mjw.primitive_narrowphase(model, self.data, self.context, COLLIDERS)

    def _make_rows(self, r: Records) -> None:
        """Each lane's contacts in a fixed order, their rows, and the contacts of each block."""
        wp.launch(kernels.list_contacts, dim=self.pool, inputs=[r.model, r.collisions, r.work, r.out])
        wp.launch(kernels.make_rows, dim=(self.lanes, self.room), inputs=[*r])
        wp.launch(kernels.link_blocks, dim=(self.lanes, self.n_blocks + 1), inputs=[r.model, r.work, r.out])

    def _solve(self, r: Records) -> None:
        """Accelerations and contact forces."""
        threads, together = newton.block_size(self.lanes)
        inputs = [threads, r.model, r.state, r.work, r.out]
        wp.launch(newton.solver(threads, together), dim=(self.lanes, threads), inputs=inputs, block_dim=threads)

    def _end(self, r: Records) -> None:
        """Next poses and velocities, forces on boxes' tops, and overflow flags."""
        wp.launch(kernels.end_step, dim=(self.lanes, self.n_blocks), inputs=[*r])
        wp.launch(kernels.note_overflow, dim=self.lanes, inputs=[r.model, r.collisions, r.out])


_INPUTS = array_types(State) | array_types(Model)
_OUTPUTS = array_types(Out) | {"workspace": wp.array2d[float]}
"""Name → type of the arrays that JAX sees."""

_IDS = itertools.count()
_STEPS: weakref.WeakValueDictionary[int, PalletStepper] = weakref.WeakValueDictionary()
"""Steps by number. JAX never frees a function that it calls, so the function must not hold a step's memory."""


def _step(step: int, *arrays: Any) -> None:
    """Launch a step's kernels. JAX calls this with the arrays of ``_INPUTS`` and ``_OUTPUTS``."""
    _STEPS[step].launch(dict(zip(_INPUTS | _OUTPUTS, arrays, strict=True)))


# Warp reads the types of the buffers from the signature, and loads the kernels of this module before the call.
_step.__module__ = kernels.__name__
_step.__annotations__ = {"step": int} | _INPUTS | _OUTPUTS
_step.__signature__ = inspect.Signature(  # type: ignore[attr-defined]  # what inspect reads
    [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in _step.__annotations__]
)
