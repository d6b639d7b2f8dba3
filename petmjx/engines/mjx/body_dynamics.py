"""Free bodies of one world in MuJoCo's coordinates, in closed form: places, accelerations, contacts, steps.

MJX computes all this for trees of joints of any kind. A pallet consists of free bodies, so few lines are enough, and
programs are half as large. The formulas are from MuJoCo's documentation ("Computation"). A free body has six
velocities: three of its origin, in world axes, and three of its rotation, in its own axes. The origin of a body is its
centre of mass, and the axes of a body are its principal axes, so the mass matrix is diagonal.

The functions are for one world; use them under ``jax.vmap``.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import NDArray

from petmjx.engines.mjx.padded_template import CONTACTS_PER_PAIR, contact_geoms

TINY: Final = mujoco.mjMINVAL
"""The smallest number by which MuJoCo divides (mjMINVAL)."""

Velocities = Float[Array, " velocity"]
Rows = Float[Array, "contact 3"]


class Bodies(NamedTuple):
    """The moving bodies of a world: origins, m; unit quaternions; rotation matrices; and velocities as in MuJoCo's
    qvel. ``mass`` has six values per body: the mass, kg, repeated three times, then the three principal moments of
    inertia, kg·m²."""

    place: Float[Array, "body 3"]
    quat: Float[Array, "body 4"]
    turn: Float[Array, "body 3 3"]
    velocity: Float[Array, "body 6"]
    mass: Velocities

    @classmethod
    def of(cls, model: Any, inputs: dict[str, Array]) -> Bodies:
        """The bodies from the model of a world and from fields of MJX's data (qpos, qvel)."""
        pose, velocity = inputs["qpos"].reshape(-1, 7), inputs["qvel"].reshape(-1, 6)
        quat, first = normalized(pose[:, 3:]), -len(pose)
        mass = jnp.broadcast_to(model.body_mass[first:, None], (len(pose), 3))
        mass = jnp.concatenate([mass, model.body_inertia[first:]], axis=1)
        return cls(pose[:, :3], quat, rotations(quat), velocity, mass.reshape(-1))

    def smooth(self, model: Any, wrenches: Float[Array, "body 6"]) -> Velocities:
        """Accelerations without contacts (MuJoCo's qacc_smooth). ``wrenches``: forces, N, and moments, N·m, on the
        bodies, in world axes."""
        mass = self.mass.reshape(-1, 6)
        spin = self.velocity[:, 3:]
        moment = jnp.einsum("bij,bi->bj", self.turn, wrenches[:, 3:]) - jnp.cross(spin, mass[:, 3:] * spin)
        linear = model.opt.gravity[None] + wrenches[:, :3] / mass[:, :3]
        return jnp.concatenate([linear, moment / mass[:, 3:]], axis=1).reshape(-1)

    def after(self, qacc: Velocities, timestep_s: float) -> tuple[Float[Array, " coordinate"], Velocities]:
        """Coordinates and velocities (qpos, qvel) after a step of semi-implicit Euler with these accelerations."""
        velocity = self.velocity + timestep_s * qacc.reshape(-1, 6)
        spin = velocity[:, 3:]
        speed = jnp.sqrt((spin**2).sum(-1, keepdims=True))
        half = 0.5 * timestep_s * speed
        axis = spin / jnp.where(speed == 0, 1.0, speed)
        w, u = jnp.cos(half), jnp.sin(half) * axis
        quat = jnp.concatenate(
            [
                self.quat[:, :1] * w - (self.quat[:, 1:] * u).sum(-1, keepdims=True),
                self.quat[:, :1] * u + w * self.quat[:, 1:] + jnp.cross(self.quat[:, 1:], u),
            ],
            axis=1,
        )
        pose = jnp.concatenate([self.place + timestep_s * velocity[:, :3], normalized(quat)], axis=1)
        return pose.reshape(-1), velocity.reshape(-1)


class ContactRows(NamedTuple):
    """The rows of a world's contacts: normal and two tangents. The derivatives of the rows of open contacts are zero.

    Attributes:
        jacobian: derivatives of the rows of each pair of geoms with respect to the velocities of the pair's two bodies.
        stiffness: inverse regularisation of each row (MuJoCo's efc_D).
        pull: reference accelerations (MuJoCo's efc_aref), m/s².
        depth: depths of closed contacts, m; 0 if open.
        sliding: coefficients of sliding friction.
    """

    jacobian: Float[Array, "pair constraint 12"]
    stiffness: Rows
    pull: Rows
    depth: Float[Array, " contact"]
    sliding: Float[Array, "contact 2"]


class Links:
    """Which geoms and which moving bodies touch in each contact of MJX. A contact has the same geoms and bodies in all
    steps.

    Args:
        model: the MJX model of all worlds. All contacts have three rows.
        contacts: number of contacts of each pair of geoms.

    Attributes:
        geoms: (contact, 2) geoms in contact.
        sides: (pair, 2) indices of the moving bodies of each pair of geoms. For a body that does not move, the index is
            ``bodies``, which is beyond the last moving body.
        bodies: number of moving bodies.
    """

    def __init__(self, model: Any, contacts: int = CONTACTS_PER_PAIR) -> None:
        pairs = contact_geoms(model)
        self.bodies = int(model.nv) // 6
        self.geoms: NDArray[np.int64] = np.repeat(pairs, contacts, axis=0)
        self._body_of_geom = np.asarray(model.geom_bodyid)
        moving = np.where(model.body_dofnum > 0, model.body_dofadr // 6, self.bodies)
        self.sides: NDArray[np.int64] = moving[self._body_of_geom[pairs]]
        self._contact_sides = moving[self._body_of_geom[self.geoms]]

    def geom_places(self, bodies: Bodies, model: Any, inputs: dict[str, Array]) -> dict[str, Array]:
        """Places and rotation matrices of all geoms, as fields of MJX's data. A held carrier has its pose in
        ``inputs``."""
        place, quat = jnp.zeros((1, 3)), jnp.array([[1.0, 0.0, 0.0, 0.0]])
        if "mocap_pos" in inputs:
            place = jnp.concatenate([place, inputs["mocap_pos"]])
            quat = jnp.concatenate([quat, normalized(inputs["mocap_quat"])])
        place, turn = jnp.concatenate([place, bodies.place]), jnp.concatenate([rotations(quat), bodies.turn])
        place, turn = place[self._body_of_geom], turn[self._body_of_geom]
        return {"geom_xpos": place + jnp.einsum("gij,gj->gi", turn, model.geom_pos), "geom_xmat": turn}

    def along(self, jacobian: Float[Array, "pair constraint 12"], velocities: Velocities) -> Rows:
        """The Jacobian times these velocities or accelerations, that is, the rates of change of all rows."""
        of_bodies = jnp.pad(velocities.reshape(-1, 6), ((0, 1), (0, 0)))
        of_pairs = of_bodies[self.sides].reshape(-1, 12)
        return jnp.einsum("prv,pv->pr", jacobian, of_pairs).reshape(-1, 3)

    def rows(self, bodies: Bodies, model: Any, contact: Any) -> ContactRows:
        """The rows of MJX's contacts."""
        apart = contact.dist - contact.includemargin
        closed = apart < 0
        jacobian = self._jacobian(bodies, contact, closed)
        stiffness, damping, impedance = _springs(contact, model.opt.timestep)
        inverse_mass = model.body_invweight0[self._body_of_geom[self.geoms], 0].sum(-1)
        weight = inverse_mass[:, None] * jnp.stack([jnp.float32(1.0), *[1 / model.opt.impratio] * 2])[None]
        soft = jnp.maximum(weight * ((1 - impedance) / impedance)[:, None], TINY)
        depth = jnp.where(closed, -apart, 0.0)
        pull = -damping * self.along(jacobian, bodies.velocity.reshape(-1))
        return ContactRows(
            jacobian, 1 / soft, pull.at[:, 0].add(stiffness * impedance * depth), depth, contact.friction[:, :2]
        )

    def _jacobian(
        self, bodies: Bodies, contact: Any, closed: Bool[Array, " contact"]
    ) -> Float[Array, "pair constraint 12"]:
        sides = self._contact_sides
        place = jnp.pad(bodies.place, ((0, 1), (0, 0)))[sides]
        turn = jnp.pad(bodies.turn, ((0, 1), (0, 0), (0, 0)))[sides]
        sign = np.array([-1.0, 1.0], np.float32)[None] * (sides < self.bodies)
        axes = contact.frame[:, None]
        arms = jnp.cross((contact.pos[:, None] - place)[:, :, None], axes)
        both = jnp.concatenate([jnp.broadcast_to(axes, arms.shape), jnp.einsum("csri,csij->csrj", arms, turn)], axis=-1)
        both *= jnp.where(closed[:, None], sign, 0.0)[:, :, None, None]
        return both.swapaxes(1, 2).reshape(len(self.sides), -1, 12)


def _springs(
    contact: Any, timestep_s: Float[Array, ""]
) -> tuple[Float[Array, " contact"], Rows, Float[Array, " contact"]]:
    """Stiffness along the normal (1/s²), damping of each row (1/s), and impedance of contacts. The formulas are from
    MuJoCo's documentation, "Modeling", section "Solver parameters"."""
    differs = (contact.solreffriction != 0).any(-1, keepdims=True)
    tangent = jnp.where(differs, contact.solreffriction, contact.solref)
    law = jnp.stack([contact.solref, tangent, tangent], axis=1)
    low, high = (jnp.clip(contact.solimp[:, i], mujoco.mjMINIMP, mujoco.mjMAXIMP) for i in range(2))
    time, ratio = jnp.maximum(law[..., 0], 2 * timestep_s), law[..., 1]
    damping = jnp.where(ratio > 0, 2 / (high[:, None] * time), -ratio / high[:, None])
    spring = jnp.where(law[:, 0, 0] > 0, 1 / (high * time[:, 0] * ratio[:, 0]) ** 2, -law[:, 0, 0] / high**2)
    x = jnp.minimum(jnp.abs(contact.dist - contact.includemargin) / jnp.maximum(contact.solimp[:, 2], TINY), 1.0)
    # the curve of the impedance over the depth has midpoint 0.5 and power 2 in all of petmjx's worlds
    return spring, damping, low + (high - low) * jnp.where(x <= 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)


def normalized(quat: Float[Array, "k 4"]) -> Float[Array, "k 4"]:
    """The quaternions, divided by their lengths."""
    return quat / jnp.sqrt((quat**2).sum(-1, keepdims=True))


def rotations(quat: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices of unit quaternions."""
    w, x, y, z = (quat[..., i] for i in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)
