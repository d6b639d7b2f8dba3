"""Faces of compressible boxes are beds of springs. The beds are compared with an integral over a grid, and the
implementations in NumPy and JAX with each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from support.plans import make_scene

from petmjx.common.units import FloatArray
from petmjx.engines.mjx.face_contacts import Beds as JaxBeds
from petmjx.engines.mjx.face_contacts import Faces, bed_of
from petmjx.engines.mjx.mjx_import import mjx
from petmjx.engines.mjx.padded_template import override_fields, padded_template
from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.engines.mujoco.face_contacts import Beds, face_pressure
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.options.simulation import Check, Simulation
from petmjx.world.compliance import EDGE_SHARE
from petmjx.world.job import Job
from petmjx.world.mujoco_model import geom_bodies

GRID = 321
OF_GRID = 0.02
"""Relative error of the integral over the grid, caused by the grid's cells along the edges of the pressed area."""
SINGLE_M = 3e-5
"""Error of single precision in points and depths of boxes about a metre away from the origin, m."""
HALF = np.array([[0.2, 0.15, 0.1], [0.15, 0.2, 0.1]])
SIM = Simulation(check=Check.STATIC)


@pytest.fixture(autouse=True)
def broadcasts() -> Iterator[None]:
    """Let JAX broadcast arrays of different ranks, as NumPy does. MJX needs this."""
    with jax.numpy_rank_promotion("allow"):
        yield


def turned(rotation: FloatArray) -> FloatArray:
    """(9,) rotation matrix of a rotation vector."""
    angle = float(np.linalg.norm(rotation))
    quat, matrix = np.empty(4), np.empty(9)
    mujoco.mju_axisAngle2Quat(quat, rotation / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix


def drawn(count: int, seed: int, turn_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Random pairs of boxes, in which the second box lies on the first: (2 count, 3) their centres, (2 count, 9) their
    rotations and (2 count, 3) their half sizes."""
    rng = np.random.default_rng(seed)
    lean = rng.normal(0.0, turn_rad, (count, 2, 3)) * (1.0, 1.0, 20.0)
    above = np.column_stack([rng.normal(0.0, 0.08, (count, 2)), np.full(count, 0.197)])
    pos = np.stack([np.zeros((count, 3)), above], axis=1).reshape(-1, 3) + rng.normal(size=(count, 1, 3)).repeat(
        2, 1
    ).reshape(-1, 3)
    turn = np.array([turned(vector) for vector in lean.reshape(-1, 3)])
    return pos, turn, np.tile(HALF, (count, 1))


def test_points_of_a_bed_have_its_force_and_moments() -> None:
    """The pairs are random, so the pressed parts of the faces have many shapes."""
    pos, turn, half = drawn(12, 1, 0.01)
    one, two = np.arange(0, 24, 2), np.arange(1, 24, 2)
    flat, normal, points, depth, area, least = face_pressure(
        pos, turn, half, one, two, turn[one].reshape(-1, 3, 3)[:, :, 2]
    )
    assert flat.all()
    wide = area > least
    assert wide.sum() > 6, "on narrower ones the pressure goes outward"
    for k in np.flatnonzero(wide).tolist():
        a, b = turn[2 * k].reshape(3, 3), turn[2 * k + 1].reshape(3, 3)
        top, base = pos[2 * k] + a[:, 2] * HALF[0, 2], pos[2 * k + 1] - b[:, 2] * HALF[1, 2]
        n = normal[k]
        x = np.cross([0.0, 1.0, 0.0], n) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], n))
        side = np.linspace(-0.4, 0.4, GRID)
        at = base + side[:, None, None] * x + side[None, :, None] * np.cross(n, x)
        deep, inside = np.zeros((GRID, GRID)), np.ones((GRID, GRID), bool)
        for sign, face, pose, middle, size in (
            (1, top, a, pos[2 * k], HALF[0]),
            (-1, base, b, pos[2 * k + 1], HALF[1]),
        ):
            height = (face - at) @ pose[:, 2] / (n @ pose[:, 2])
            deep += sign * height
            local = (at + height[..., None] * n - middle) @ pose
            inside &= (np.abs(local[..., :2]) < size[:2]).all(axis=-1)
        pressure = np.where(inside, np.maximum(deep, 0.0), 0.0) * (side[1] - side[0]) ** 2
        force = area[k] / 4 * depth[k]
        assert force.sum() == pytest.approx(pressure.sum(), rel=OF_GRID)
        center = np.tensordot(pressure, at, 2) / pressure.sum()
        mine = force @ points[k] / force.sum()
        assert np.linalg.norm(np.cross(n, center - mine)) < OF_GRID * 0.1


@pytest.mark.parametrize(
    ("lean", "lever"),
    # in the last three cases, one side lifts off: the force moves outwards, up to the edge
    [(1.0, 1 / 12), (2.0, 1 / 6), (4.0, 0.5 - 0.5**0.5 / 3), (8.0, 0.5 - 0.2 / 3), (12.0, 0.5)],
)
def test_the_force_goes_to_the_edge_as_one_side_lifts_off(lean: float, lever: float) -> None:
    """Closed form for a lean about one axis. The lean is in units of F/(k·L), and the lever arm of the force in units
    of L."""
    length, force = 0.4, 1e-3
    half = np.array([[length / 2, 0.15, 0.1]] * 2)
    turn = turned(np.array([0.0, lean * force / length, 0.0]))
    share = min((2.0 / lean) ** 0.5, 1.0)
    if share < EDGE_SHARE:
        share = 2.0 / (lean * EDGE_SHARE)
    depth_m = lean * force * (share - 0.5) if lean > 2.0 else force
    rotation = turn.reshape(3, 3)
    pos = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1 - depth_m] + rotation @ [0.0, 0.0, 0.1]])
    up = np.array([[0.0, 0.0, 1.0]])
    bed = face_pressure(pos, np.array([np.eye(3).ravel(), turn]), half, np.array([0]), np.array([1]), up)
    _, _, points, depth, area, least = bed
    spring = max(float(area[0]), float(least[0])) / (length * 0.3) / 4
    forces = spring * depth[0]
    assert forces.sum() == pytest.approx(force, rel=1e-3)
    assert forces @ points[0, :, 0] / force / length == pytest.approx(lever, abs=2e-3)


def test_faces_that_only_meet_or_stand_apart_do_not_press() -> None:
    eye = np.eye(3).ravel()
    pos = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.201], [0.5, 0.0, 0.199]])
    up = np.array([[0.0, 0.0, 1.0]] * 2)
    area = face_pressure(pos, np.array([eye] * 3), np.array([HALF[0]] * 3), np.array([0, 0]), np.array([1, 2]), up)[4]
    assert area.tolist() == [0.0, 0.0]


def test_mjx_jax_has_the_same_beds() -> None:
    """The beds are the same also if only a strip at an edge or a corner is pressed."""
    pos, turn, half = drawn(200, 2, 0.02)
    one, two = np.arange(0, 400, 2), np.arange(1, 400, 2)
    up = turn[one].reshape(-1, 3, 3)[:, :, 2]
    flat, normal, points, depth, area, least = face_pressure(pos, turn, half, one, two, up)
    arguments = (pos[one], turn[one].reshape(-1, 3, 3), half[one], pos[two], turn[two].reshape(-1, 3, 3), half[two], up)
    bed = jax.jit(jax.vmap(bed_of))(*(jnp.asarray(argument, jnp.float32) for argument in arguments))
    np.testing.assert_array_equal(bed.flat, flat)
    np.testing.assert_allclose(bed.normal, normal, atol=1e-6)
    np.testing.assert_allclose(bed.area, area, atol=1e-5)
    np.testing.assert_allclose(bed.least, least, atol=1e-5)
    firm = area > 1e-3
    assert firm.sum() > 150
    assert (area < least).sum() > 20
    np.testing.assert_allclose(bed.points[firm], points[firm], atol=SINGLE_M)
    np.testing.assert_allclose(bed.depth[firm], depth[firm], atol=SINGLE_M / 10)


def test_contacts_in_mjx_jax_and_mujoco_are_alike() -> None:
    """The contacts of a leaning column are compared after the collision detection of one step."""
    rows = [((300.0, 300.0, 250.0), (40.0 * level, 0.0, 250.0 * level), 6.0) for level in range(3)]
    scene = replace(make_scene(rows, SIM), stiffness=np.array([30e3, 60e3, np.inf]))
    world = LiveWorld(scene, SIM, scene.n_boxes)
    world.step(150)
    model, data = world.model, world.data
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    Beds(scene, SIM.physics, model, geom_bodies(model, world.order)).press(model, data)
    physics = SIM.physics.changed(skin_m=0.0)
    template = padded_template(3, 1, SIM.changed(physics=physics), held=False)
    mjx_model, start = mjx.put_model(template, impl="jax"), mjx.make_data(template, impl="jax")
    beds = JaxBeds(mjx_model, physics)
    worlds = upload_worlds([Job(scene)], 1, 3, {}, SIM)

    @jax.jit
    def contacts(qpos: jax.Array) -> tuple[jax.Array, ...]:
        fields = override_fields(worlds, mjx_model, held=False, physics=physics, gives=True)
        faces = jax.tree.map(lambda values: values[0], Faces.of(worlds, fields["body_invweight0"][:, 1:, 0]))
        changed = mjx_model.tree_replace({name: values[0] for name, values in fields.items()})
        collision = mjx.collision(changed, mjx.kinematics(changed, start.replace(qpos=qpos)))
        collision = beds.pressed(collision, faces)._impl.contact
        return collision.geom, collision.dist, collision.pos, collision.solref, collision.solimp, collision.frame

    geom, distance, place, solref, solimp, frame = map(np.asarray, contacts(jnp.asarray(data.qpos, jnp.float32)))
    of_beds = np.asarray(data.contact.geom)[:, 0] > 0
    assert of_beds.sum() == 12, "four of each pair"
    for row in np.flatnonzero(of_beds).tolist():
        contact = data.contact[row]
        alike = np.flatnonzero((geom == contact.geom).all(axis=1) & (distance < 0))
        near = alike[np.linalg.norm(place[alike] - contact.pos, axis=1).argmin()]
        np.testing.assert_allclose(place[near], contact.pos, atol=SINGLE_M)
        assert distance[near] == pytest.approx(contact.dist - contact.includemargin, abs=SINGLE_M / 10)
        np.testing.assert_allclose(frame[near].ravel(), contact.frame, atol=1e-5)
        np.testing.assert_allclose(solref[near], contact.solref, rtol=1e-4)
        np.testing.assert_allclose(solimp[near], contact.solimp, rtol=1e-4)
