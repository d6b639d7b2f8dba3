"""The dynamics and the solver of mjx-jax against MJX's own and against C MuJoCo."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from support.contact_slots import in_slots
from support.plans import make_scene, on_boards, stack

from petmjx.common.units import FloatArray
from petmjx.engines.mjx.body_dynamics import Bodies, Links
from petmjx.engines.mjx.collision import PAIRS_PER_GEOM, collision
from petmjx.engines.mjx.mjx_import import mjx
from petmjx.engines.mjx.newton import BlockSolver, Iterate, Problem
from petmjx.engines.mjx.padded_template import FLOAT32_TOLERANCE, contact_geoms, padded_template
from petmjx.engines.mjx.slip import SlipLaw
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.options.simulation import Simulation
from petmjx.world.contact_laws import ENOUGH_M_S2, slack_m_s2

SIM = Simulation(physics={"skin_m": 0.0})
ROUNDING = 2e-5
"""float32: some operations, and differences of numbers ten times as large."""
SAME_ACCELERATION = 2e-3
"""The solver ends where the cost changes by less than 1e-6 of the masses; as a share of the largest acceleration."""


def single(values: FloatArray) -> jax.Array:
    return jnp.asarray(values, jnp.float32)


def test_bodies_and_rows_are_those_of_mjx(ranks_may_differ: None) -> None:
    """Boxes that lie askew on two boards of a held carrier and on one another, and sink in."""
    template = padded_template(3, 2, SIM, held=True)
    template.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    model, start = mjx.put_model(template, impl="jax"), mjx.make_data(template, impl="jax")
    links, rng = Links(model), np.random.default_rng(7)
    place = rng.uniform(-0.03, 0.03, (3, 3)) * [1.0, 1.0, 0.03] + [[0.0, 0.0, 0.1 + 0.197 * k] for k in range(3)]
    quat = np.array([[1.0, 0.0, 0.0, 0.0]]) + rng.uniform(-0.002, 0.002, (3, 4))
    inputs = {
        "qpos": single(np.hstack([place, quat]).ravel()),
        "qvel": single(rng.uniform(-1.0, 1.0, template.nv)),
        "xfrc_applied": single(rng.normal(size=(template.nbody, 6))),
        "mocap_pos": jnp.array([[0.0, 0.0, -0.07]]),
        "mocap_quat": jnp.array([[1.0, 0.001, 0.002, 0.0]]),
    }
    qacc = single(rng.uniform(-500.0, 500.0, template.nv))

    @jax.jit
    def both(inputs: dict[str, jax.Array]) -> tuple[Any, ...]:
        data = mjx.fwd_velocity(model, mjx.fwd_position(model, start.replace(**inputs)))
        data = mjx.fwd_acceleration(model, data)
        after = mjx.euler(model, data.replace(qacc=qacc))
        rows, bodies = data._impl, Bodies.of(model, inputs)
        of_mjx = (data.geom_xpos, data.geom_xmat, data.qacc_smooth, after.qpos, after.qvel)
        contacts = (rows.contact.geom, rows.efc_J, rows.efc_D, rows.efc_aref, rows.efc_margin - rows.efc_pos)
        smooth = bodies.smooth(model, inputs["xfrc_applied"][-links.bodies :])
        places = links.geom_places(bodies, model, inputs)
        computed = (places["geom_xpos"], places["geom_xmat"], smooth, *bodies.after(qacc, template.opt.timestep))
        return of_mjx, computed, contacts, links.rows(bodies, model, rows.contact)

    of_mjx, computed, (geoms, jacobian, stiffness, pull, depth), rows = both(inputs)
    for expected, values in zip(of_mjx, computed, strict=True):
        np.testing.assert_allclose(values, expected, rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_array_equal(links.geoms, geoms)
    np.testing.assert_array_equal(contact_geoms(model), geoms[::4])
    assert (np.asarray(rows.depth) > 0).sum() >= 12
    np.testing.assert_allclose(rows.depth, depth.reshape(-1, 3)[:, 0], atol=1e-8)
    np.testing.assert_allclose(np.ravel(rows.stiffness), stiffness, rtol=1e-4)
    np.testing.assert_allclose(np.ravel(rows.pull), pull, rtol=1e-4, atol=1e-4 * float(jnp.abs(pull).max()))
    dense = np.zeros((len(links.sides), 12, links.bodies + 1, 6))
    for side in (0, 1):
        blocks = np.asarray(rows.jacobian).reshape(len(links.sides), 12, 2, 6)[:, :, side]
        dense[np.arange(len(links.sides)), :, links.sides[:, side]] += blocks
    np.testing.assert_allclose(dense[:, :, :-1].reshape(jacobian.shape), jacobian, atol=ROUNDING)


def test_contacts_are_those_of_mjx_however_many_boxes_are_near(ranks_may_differ: None) -> None:
    template = padded_template(12, 1, SIM, held=False)
    model, start = mjx.put_model(template, impl="jax"), mjx.make_data(template, impl="jax")
    links, rng = Links(model), np.random.default_rng(11)

    @jax.jit
    def both(qpos: jax.Array) -> tuple[Any, Any]:
        inputs = {"qpos": qpos, "qvel": jnp.zeros(template.nv)}
        data = start.replace(**links.geom_places(Bodies.of(model, inputs), model, inputs))
        return mjx.collision(model, data)._impl.contact, collision(model, data)._impl.contact

    for size_m, least in ((0.3, 2 * PAIRS_PER_GEOM * template.ngeom), (1.5, 0)):  # all boxes meet, or few of them do
        pose = np.hstack([rng.uniform(0.0, size_m, (13, 3)), rng.normal(size=(13, 4))])
        expected, contact = jax.tree.map(np.asarray, both(single(pose.ravel())))
        closed = expected.dist < 0
        assert closed.sum() > least
        np.testing.assert_array_equal(contact.dist < 0, closed)
        np.testing.assert_array_equal(contact.geom, expected.geom)
        for name in ("dist", "pos", "frame"):
            np.testing.assert_allclose(getattr(contact, name)[closed], getattr(expected, name)[closed], atol=1e-5)


def test_the_solver_finds_the_accelerations_and_forces_of_c() -> None:
    """Boxes on two boards: at rest, sliding, landing and rising. The solver starts from the accelerations at rest."""
    world = LiveWorld(on_boards(make_scene(stack(3, kg=6.0), SIM)), SIM, n_boxes=3)
    world.step(150)
    model, data = world.model, world.data
    device = mjx.put_model(model, impl="jax").tree_replace({"opt.tolerance": jnp.float32(FLOAT32_TOLERANCE)})
    links = Links(device)
    solver, at_rest = BlockSolver(links), data.qacc.copy()

    @jax.jit
    def solved(inputs: dict[str, jax.Array], contact: Any) -> tuple[jax.Array, jax.Array]:
        bodies = Bodies.of(device, inputs)
        rows = links.rows(bodies, device, contact)
        smooth = bodies.smooth(device, jnp.zeros((links.bodies, 6)))
        problem = Problem.of(device, bodies.mass, smooth, rows)
        found = solver.improved(problem, solver.begin(problem, rows.pull, inputs["qacc_warmstart"]))
        return found.qacc, found.force

    rng, slid = np.random.default_rng(5), 0.0
    for speed in (0.0, 0.01, 0.1, 0.5):
        data.qvel[:] = speed * rng.uniform(-1.0, 1.0, model.nv)
        data.qacc_warmstart[:] = at_rest
        mujoco.mj_forward(model, data)
        inputs = {name: single(getattr(data, name)) for name in ("qpos", "qvel")} | {"qacc_warmstart": single(at_rest)}
        contact = in_slots(mjx.put_data(model, data, impl="jax")._impl.contact, links)
        with jax.numpy_rank_promotion("allow"):
            qacc, force = map(np.asarray, solved(inputs, contact))
        np.testing.assert_allclose(qacc, data.qacc, atol=SAME_ACCELERATION * max(1.0, np.abs(data.qacc).max()))
        assert force[:, 0].sum() == pytest.approx(data.efc_force[::3].sum(), rel=1e-3)
        slid = max(slid, float(np.hypot(*force[:, 1:].T).max()))
    assert slid > 10.0, "friction acts"


class OneContact(BlockSolver):
    """A solver for worlds of one contact, without physics: friction slows the contact by ``SLOWS`` times the normal
    row's reference acceleration. Unlike Newton's method, it does not depend on where it starts."""

    SLOWS = 0.4

    def __init__(self) -> None:
        self.links = self  # type: ignore[assignment]  # SlipLaw asks the links for ``along``

    def along(self, jacobian: jax.Array, velocity: jax.Array) -> jax.Array:
        """The (1, 3) rows, which are the velocities themselves."""
        return velocity[None]

    def begin(self, problem: Problem, pull: jax.Array, start: jax.Array) -> Iterate:
        """A state whose accelerations are the reference accelerations, without forces."""
        begin = Iterate.unvalued(pull[0], pull.at[:, 1].add(-self.SLOWS * pull[:, 0]))
        return begin._replace(force=jnp.zeros_like(pull))

    def ends(self, problem: Problem, now: Iterate) -> jax.Array:
        return now.iterations > 0

    def improved(self, problem: Problem, begin: Iterate, **_: int) -> Iterate:
        return begin._replace(iterations=jnp.int32(1))


class HalfWay(OneContact):
    """A solver that goes half of the way from its start, so that solving a world again changes its accelerations."""

    def begin(self, problem: Problem, pull: jax.Array, start: jax.Array) -> Iterate:
        return super().begin(problem, pull, start)._replace(qacc=0.5 * (pull[0] + start))


@pytest.mark.parametrize("solver", [OneContact, HalfWay])
def test_a_sliding_contact_is_corrected_alone_as_beside_others(solver: type[OneContact]) -> None:
    friction, normal = 0.5, 5.0
    towed = np.array([30.0, 0.0, 3.0, 8.0, 60.0, 15.0])  # reference accelerations along the ground; 0: at rest
    worlds, law = len(towed), SlipLaw(SIM.physics, solver())
    zeros = jnp.zeros((worlds, 1, 3))
    problem = Problem(
        mass=zeros[:, 0],
        smooth=zeros[:, 0],
        jacobian=jnp.zeros((worlds, 1, 3, 12)),
        stiffness=zeros + 1.0,
        sliding=zeros[..., 1:] + friction,
        mu=zeros[..., 0],
        least=zeros[:, 0, 0],
        iterations=jnp.zeros(worlds, jnp.int32),
        evaluations=jnp.zeros(worlds, jnp.int32),
    )
    solve = jax.jit(lambda pull, start: law.solve(problem, pull, law.begin(problem, pull, start)).now.qacc)

    def corrected(towed: FloatArray) -> FloatArray:
        """(world,) the corrected reference acceleration along the normal."""
        pull = np.stack([np.full(worlds, normal), towed, np.zeros(worlds)], axis=-1)[:, None]
        return np.asarray(solve(single(pull), zeros[:, 0]))[:, 0]

    beside_others = corrected(towed)
    for world in range(worlds):
        alone = np.where(np.arange(worlds) == world, towed, 0.0)
        assert corrected(alone)[world] == beside_others[world]
    if solver is HalfWay:
        return
    # the excess of which a further round changes nothing
    left = np.maximum(towed - slack_m_s2(SIM.physics) - OneContact.SLOWS * normal, 0.0)
    excess = left / (1 - OneContact.SLOWS * friction)
    few_m_s2 = ENOUGH_M_S2 / (1 - OneContact.SLOWS * friction)
    np.testing.assert_allclose(beside_others, normal - friction * excess, atol=few_m_s2)
