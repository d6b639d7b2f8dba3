"""One physics step of all lanes on Warp's kernels, as a JAX call with few arguments.

``mjx.step`` hands every field of model and data through JAX, some 400 buffers that Python looks at in each call.
Here the model, the contact pool and the workspace belong to the step, and JAX sees what changes: about 20 arrays.
Collisions are mujoco_warp's as MJX carries it; contacts' rows, the solver and the integrator are petmjx's own.
"""

from __future__ import annotations

import dataclasses
import itertools
import weakref
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
from petmjx.engines.warp import cholesky as warp_cholesky
from petmjx.engines.warp import contacts as warp_contacts
from petmjx.engines.warp import newton as warp_newton
from petmjx.verdict import Flag

CONTACT_OVERFLOW = int(Flag.CONTACT_OVERFLOW)

COLLIDERS = [(mjw.GeomType.PLANE, mjw.GeomType.BOX), (mjw.GeomType.BOX, mjw.GeomType.BOX)]
"""Pairs of shapes that meet on a pallet."""

PER_WORLD = (
    "body_mass",
    "body_inertia",
    "body_invweight0",
    "geom_size",
    "geom_rbound",
    "geom_aabb",
    "geom_friction",
)
"""Model fields that the step takes per world, in the order of its arguments."""


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


class GeomDefaults(NamedTuple):
    """Geom fields of the template, which stand for geoms that no world changes."""

    geom_size: jax.Array
    geom_rbound: jax.Array
    geom_aabb: jax.Array


@wp.kernel(enable_backward=False)
def _note_overflow(
    nacon: wp.array(dtype=int),
    ncollision: wp.array(dtype=int),
    pool: int,
    room: int,
    flag: int,
    n_contacts: wp.array(dtype=int),
    overflow: wp.array(dtype=int),
):
    """A full pool may have cost any world a contact."""
    world = wp.tid()
    overflow[world] = 0
    if nacon[0] > pool or ncollision[0] > pool or n_contacts[world] > room:
        overflow[world] = flag


class Workspace:
    """Where the arrays that live for one step lie in one buffer, lane after lane within each array.

    Args:
        room: contacts of a lane, at most.
    """

    def __init__(self, lanes: int, n_blocks: int, room: int) -> None:
        dofs = 6 * n_blocks
        padded = round_up(dofs, warp_cholesky.PANEL)
        real, single, integer = wp.float64, wp.float32, wp.int32
        # Those of eight bytes first, so that every one is aligned.
        self.arrays: dict[str, tuple[Any, tuple[int, ...]]] = {
            "acceleration": (real, (lanes, dofs)),
            "direction": (real, (lanes, dofs)),
            "gradient": (real, (lanes, dofs)),
            "residual": (real, (lanes, room, 3)),
            "slope": (real, (lanes, room, 3)),
            "force": (real, (lanes, room, 3)),
            "contact_key": (wp.int64, (lanes, room)),
            "hessian": (single, (lanes, padded, padded)),
            "rows": (single, (lanes, room, warp_contacts.ROW_WORDS)),
            "curvature": (single, (lanes, room, 6)),
            "inertia": (single, (lanes, dofs)),
            "smooth": (single, (lanes, dofs)),
            "blocks": (integer, (lanes, room, 2)),
            "links": (integer, (lanes, 2 * room)),
            "link_begin": (integer, (lanes, n_blocks + 1)),
            "lowest": (integer, (lanes, n_blocks)),
            "pair_begin": (integer, (lanes, room)),
            "n_blocks": (integer, (lanes,)),
        }
        self.shape = lanes, -(-sum(_words(dtype, shape) for dtype, shape in self.arrays.values()) // lanes)

    def slices(self, buffer: Any) -> dict[str, Any]:
        """The arrays, as views of a buffer of 32-bit words of this ``shape``."""
        views, offset = {}, 0
        for name, (dtype, shape) in self.arrays.items():
            views[name] = wp.array(ptr=buffer.ptr + 4 * offset, dtype=dtype, shape=shape, device=buffer.device)
            offset += _words(dtype, shape)
        return views


def lane_bytes(n_blocks: int, room: int) -> int:
    """Device memory that a lane takes, bytes: nearly all of it is the workspace."""
    return 4 * Workspace(1, n_blocks, room).shape[1]


def _words(dtype: Any, shape: tuple[int, ...]) -> int:
    words = wp.types.type_size_in_bytes(dtype) // 4
    for extent in shape:
        words *= extent
    return words + words % 2


class PalletStepper:
    """Steps lanes of a padded template with Newton's method; a ``Stepper`` of stages.

    Args:
        pool: contacts of all lanes together.
        room: contacts of one lane, at most; rounded up to what the kernels search at a time.
    """

    def __init__(self, template: mujoco.MjModel, lanes: int, pool: int, room: int) -> None:
        room = round_up(room, warp_contacts.SEARCH)
        self.lanes, self.pool, self.room = lanes, pool, room
        self.held = int(template.nmocap)
        self.n_blocks = template.nbody - 1 - self.held
        if 6 * self.n_blocks > warp_newton.MAX_DOFS:
            raise ValueError(f"{self.n_blocks} bodies are more than the solver has room for")
        self.pyramidal = int(template.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL)
        self.limit, self.trials = int(template.opt.iterations), int(template.opt.ls_iterations)
        self.tolerance = float(template.opt.tolerance)
        self.timestep = float(template.opt.timestep)
        self.floor_z = float(template.geom_pos[0, 2])
        self.n_geoms = template.ngeom
        # What per-world fields are made from (template.override_fields), in MJX-Warp's shapes.
        self.model = GeomDefaults(
            jnp.asarray(template.geom_size, jnp.float32),
            jnp.asarray(template.geom_rbound, jnp.float32),
            jnp.asarray(template.geom_aabb.reshape(-1, 2, 3), jnp.float32),
        )
        self.workspace = Workspace(lanes, self.n_blocks, room)
        # One world's data but for the pool: collision reads geoms' poses alone, and those are replaced.
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
        dofs = 6 * self.n_blocks
        widths = {"qpos": 7 * self.n_blocks, "qvel": dofs, "qacc": dofs, "top_force": self.n_geoms - 2}
        real = {name: np.zeros((self.lanes, width), np.float32) for name, width in widths.items()}
        counts = {name: np.zeros(self.lanes, np.int32) for name in ("overflow", "contacts", "iterations")}
        return jax.device_put(StepResult(**real, **counts))

    def step(self, overrides: dict[str, jax.Array], inputs: dict[str, jax.Array], scratch: StepResult) -> StepResult:
        carrier = inputs["qpos"][:, :7]
        if self.held:
            carrier = jnp.concatenate([inputs["mocap_pos"][:, 0], inputs["mocap_quat"][:, 0]], -1)
        *result, _ = _step_callable()(
            self.id,
            inputs["qpos"],
            inputs["qvel"],
            inputs["qacc_warmstart"],
            inputs["xfrc_applied"][:, CARRIER_BODY, :3],
            overrides["opt.gravity"],
            carrier,
            *(overrides[name] for name in PER_WORLD),
            output_dims={
                "next_qpos": scratch.qpos.shape,
                "next_qvel": scratch.qvel.shape,
                "qacc": scratch.qacc.shape,
                "top_force": scratch.top_force.shape,
                "overflow": (self.lanes,),
                "contacts": (self.lanes,),
                "iterations": (self.lanes,),
                "workspace": self.workspace.shape,
            },
        )
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

    def launch(self, arrays: dict[str, Any]) -> None:
        """Launch the step's kernels on Warp arrays, named as ``_step``'s arguments."""
        lanes, room, data = self.lanes, self.room, self.data
        work = self.workspace.slices(arrays["workspace"])
        wp.launch(
            warp_contacts.begin_step,
            dim=(lanes, self.n_geoms),
            inputs=[
                self.held,
                self.floor_z,
                arrays["qpos"],
                arrays["qvel"],
                arrays["carrier_force"],
                arrays["gravity"],
                arrays["carrier_pose"],
                arrays["body_mass"],
                arrays["body_inertia"],
            ],
            outputs=[
                data.geom_xpos,
                data.geom_xmat,
                work["inertia"],
                work["smooth"],
                arrays["contacts"],
                work["n_blocks"],
            ],
        )
        model = dataclasses.replace(
            self.warp_model,
            geom_size=arrays["geom_size"],
            geom_rbound=arrays["geom_rbound"],
            geom_aabb=arrays["geom_aabb"],
            geom_friction=arrays["geom_friction"],
        )
        # mujoco_warp's ``collision`` for planes and boxes, without its allocations: XLA may replay graphs without any.
        data.nacon.zero_()
        data.ncollision.zero_()
        mjw.nxn_broadphase(model, data, self.context)
        mjw.primitive_narrowphase(model, data, self.context, COLLIDERS)
        contact = data.contact
        wp.launch(
            warp_contacts.list_contacts,
            dim=self.pool,
            inputs=[data.nacon, contact.worldid, contact.geom, self.n_geoms],
            outputs=[arrays["contacts"], work["contact_key"]],
        )
        wp.launch(
            warp_contacts.make_rows,
            dim=(lanes, room),
            inputs=[
                self.held,
                self.pyramidal,
                self.timestep,
                arrays["qvel"],
                arrays["body_invweight"],
                data.geom_xpos,
                data.geom_xmat,
                contact.geom,
                contact.dist,
                contact.pos,
                contact.frame,
                contact.friction,
                contact.solref,
                contact.solimp,
                arrays["contacts"],
                work["contact_key"],
            ],
            outputs=[work["rows"], work["blocks"], work["n_blocks"]],
        )
        wp.launch(
            warp_contacts.link_blocks,
            dim=(lanes, self.n_blocks + 1),
            inputs=[arrays["contacts"], work["n_blocks"], work["blocks"]],
            outputs=[work["link_begin"], work["links"], work["lowest"]],
        )
        # On a CPU Warp runs a block's threads one after the other, which a barrier does not survive.
        device = wp.get_device()
        threads, together = 1, 1
        if device.is_cuda:
            few = lanes <= warp_newton.FEW_LANES * device.sm_count
            threads, together = warp_newton.FEW if few else warp_newton.MANY
        wp.launch(
            warp_newton.solver(threads, together),
            dim=(lanes, threads),
            inputs=[
                threads,
                self.pyramidal,
                self.limit,
                self.trials,
                self.tolerance,
                work["rows"],
                work["blocks"],
                arrays["contacts"],
                work["n_blocks"],
                work["link_begin"],
                work["links"],
                work["lowest"],
                work["pair_begin"],
                work["inertia"],
                work["smooth"],
                arrays["warmstart"],
            ],
            outputs=[
                work["acceleration"],
                work["direction"],
                work["gradient"],
                work["residual"],
                work["slope"],
                work["force"],
                work["curvature"],
                work["hessian"],
                arrays["iterations"],
            ],
            block_dim=threads,
        )
        wp.launch(
            warp_contacts.end_step,
            dim=(lanes, self.n_blocks),
            inputs=[
                self.held,
                self.timestep,
                arrays["qpos"],
                arrays["qvel"],
                data.geom_xpos,
                work["smooth"],
                work["acceleration"],
                work["force"],
                work["rows"],
                work["blocks"],
                work["n_blocks"],
                work["link_begin"],
                work["links"],
            ],
            outputs=[arrays["next_qpos"], arrays["next_qvel"], arrays["qacc"], arrays["top_force"]],
        )
        wp.launch(
            _note_overflow,
            dim=lanes,
            inputs=[data.nacon, data.ncollision, self.pool, room, CONTACT_OVERFLOW, arrays["contacts"]],
            outputs=[arrays["overflow"]],
        )


_IDS = itertools.count()
_STEPS: weakref.WeakValueDictionary[int, PalletStepper] = weakref.WeakValueDictionary()
"""Steps by number: JAX keeps what it calls for ever, and is not to keep their memory."""


def _step(
    step: int,
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    warmstart: wp.array2d(dtype=float),
    carrier_force: wp.array2d(dtype=float),
    gravity: wp.array2d(dtype=float),
    carrier_pose: wp.array2d(dtype=float),
    body_mass: wp.array2d(dtype=float),
    body_inertia: wp.array3d(dtype=float),
    body_invweight: wp.array3d(dtype=float),
    geom_size: wp.array2d(dtype=wp.vec3),
    geom_rbound: wp.array2d(dtype=float),
    geom_aabb: wp.array3d(dtype=wp.vec3),
    geom_friction: wp.array2d(dtype=wp.vec3),
    next_qpos: wp.array2d(dtype=float),
    next_qvel: wp.array2d(dtype=float),
    qacc: wp.array2d(dtype=float),
    top_force: wp.array2d(dtype=float),
    overflow: wp.array(dtype=int),
    contacts: wp.array(dtype=int),
    iterations: wp.array(dtype=int),
    workspace: wp.array2d(dtype=float),
):
    _STEPS[step].launch(locals())


def _step_callable() -> Any:
    # XLA captures the kernels into its own command buffer and replays that without Python, whatever the addresses.
    # Graphs captured by Warp failed here ("unknown capture stream", Warp 1.18, JAX 0.11).
    return wp.jax_callable(_step, num_outputs=8, graph_mode=wp.JaxCallableGraphMode.JAX)
