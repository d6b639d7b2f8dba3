"""The metrics in JAX are compared with those in NumPy and with MuJoCo, in float32 and without rank promotion."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from support.outcomes import make_plan
from support.plans import make_scene

from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx import rules
from petmjx.engines.mjx import top_forces as force
from petmjx.engines.mjx.readback import reduce_metrics
from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.engines.mjx.world_state import fresh_state
from petmjx.engines.mujoco import box_motion, running_metrics, top_forces
from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.world.job import Job
from petmjx.world.mujoco_model import geom_bodies
from petmjx.world.scene import build_scene

RNG = np.random.default_rng(3)
LANES, BOXES = 8, 25

DEGREES = 1e-4
"""Tolerance of angles, degrees. The resolution of a quaternion's component in float32 is 6e-8, and the sine of half the
angle is computed from squares close to one."""
METRES = 1e-6
"""Tolerance of positions, m: the resolution of float32 at a few metres."""


def quaternions(shape: tuple[int, ...]) -> np.ndarray:
    values = RNG.normal(size=(*shape, 4))
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def test_tilt_is_the_oracles() -> None:
    quat = quaternions((LANES, BOXES))
    expected = box_motion.tilt_deg(quat.reshape(-1, 4)).reshape(LANES, BOXES)
    tilts = motion.tilt_deg(jnp.asarray(quat, jnp.float32))
    # near 180°, the arcsin of the NumPy version is inaccurate, so only tilts below 179° are compared
    inside = expected < 179.0
    assert inside.mean() > 0.9
    np.testing.assert_allclose(np.asarray(tilts)[inside], expected[inside], atol=DEGREES)


@pytest.mark.parametrize("tilt_deg", [0.0, 0.001, 0.02, 1.0, 20.0, 90.0, 180.0])
def test_small_tilts_are_not_lost(tilt_deg: float) -> None:
    half = np.radians(tilt_deg) / 2
    yaw = np.array([np.cos(0.4), 0.0, 0.0, np.sin(0.4)])
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, yaw, np.array([np.cos(half), np.sin(half), 0.0, 0.0]))
    tilts = motion.tilt_deg(jnp.asarray(quat, jnp.float32)[None, None])
    assert float(tilts[0, 0]) == pytest.approx(tilt_deg, rel=1e-4, abs=1e-5)


def test_lowest_points_are_the_oracles() -> None:
    pos, half = RNG.normal(size=(LANES, BOXES, 3)), RNG.uniform(0.05, 0.3, (LANES, BOXES, 3))
    quat = quaternions((LANES, BOXES))
    expected = box_motion.lowest_z(pos.reshape(-1, 3), quat.reshape(-1, 4), half.reshape(-1, 3))
    lowest = motion.lowest_z(*(jnp.asarray(a, jnp.float32) for a in (pos, quat, half)))
    np.testing.assert_allclose(np.asarray(lowest).ravel(), expected, atol=METRES)


def test_drops_and_signs() -> None:
    limits = Thresholds()
    upright = jnp.tile(jnp.array([1.0, 0, 0, 0]), (1, 4, 1))
    half = jnp.full((1, 4, 3), 0.15)
    pos = jnp.zeros((1, 4, 3)).at[0, :, 2].set(jnp.array([0.2, 0.051, 0.049, -0.01]))
    # the lowest points are at +0.05, −0.099, −0.101 and −0.16 m; the last box's centre is also below the carrier's top
    dropped = motion.has_dropped(pos, upright, half, limits)
    assert dropped.tolist() == [[False, False, True, True]]
    shift = jnp.zeros((1, 4, 3)).at[0, :, 1].set(jnp.array([0.019, -0.021, 0.0, 0.1]))
    excess = rules.excess(shift, jnp.array([[21.0, 0.0, 0.0, 0.0]]), dropped, limits)
    assert (np.asarray(excess) > 1).tolist() == [[True, True, True, True]]
    np.testing.assert_allclose(excess, [[1.05, 1.05, 1.0, 5.0]], rtol=1e-5)
    none = rules.excess(shift[:, :1], jnp.array([[19.9]]), dropped[:, :1], limits)
    assert float(none[0, 0]) < 1


def test_drops_signs_and_shifts_are_the_oracles() -> None:
    limits = Thresholds()
    target, half = RNG.normal(size=(LANES, BOXES, 3)), RNG.uniform(0.05, 0.3, (LANES, BOXES, 3))
    target[..., 2] = half[..., 2]
    pos = target + RNG.normal(scale=[0.01, 0.01, 0.3], size=target.shape)
    quat = quaternions((LANES, BOXES))
    flat = [array.reshape(-1, array.shape[-1]) for array in (pos, quat, half, target)]
    single = [jnp.asarray(array, jnp.float32) for array in (pos, quat, half, target)]

    dropped = box_motion.has_dropped(*flat[:3], limits)
    assert 20 < dropped.sum() < 180
    assert motion.has_dropped(*single[:3], limits).ravel().tolist() == dropped.tolist()
    shift = box_motion.shift(flat[0], flat[3], limits.shift_floor_m)
    shifts = motion.shift(single[0], single[3], limits.shift_floor_m)
    np.testing.assert_allclose(np.asarray(shifts).reshape(-1, 3), shift, atol=METRES)
    tilt = box_motion.tilt_deg(flat[1]) / 5
    excess = running_metrics.excess(shift, tilt, dropped, limits)
    tilt_32, dropped_32 = (jnp.asarray(a).reshape(LANES, BOXES) for a in (tilt.astype(np.float32), dropped))
    np.testing.assert_allclose(rules.excess(shifts, tilt_32, dropped_32, limits).ravel(), excess, rtol=1e-3)


@pytest.mark.parametrize("limit", [0.02, 0.03, 0.0007, 20.0])
def test_an_excess_above_one_is_a_shift_above_its_limit(limit: float) -> None:
    """The excess (shift / threshold) is above 1 exactly if the shift is above its threshold, in spite of rounding. The
    engine ``mujoco`` uses the excess, the verdict uses the shift."""
    shifts = np.array([np.nextafter(limit, 0), limit, np.nextafter(limit, 99)])
    shift_m = np.stack([shifts, np.zeros(3), np.zeros(3)], axis=1)
    excess = running_metrics.excess(shift_m, np.zeros(3), np.zeros(3, bool), Thresholds(shift_m=limit))
    assert (excess > 1).tolist() == [False, False, True]


def test_shifts_under_the_floor_are_none() -> None:
    pos = jnp.array([[[0.0009, -0.0011, 0.5]]])
    np.testing.assert_allclose(motion.shift(pos, jnp.zeros((1, 1, 3)), 0.001), [[[0.0, -0.0011, 0.5]]])


def test_a_displacement_under_the_floor_is_no_sign_on_any_engine() -> None:
    limits = Thresholds(shift_m=0.0005, shift_floor_m=0.001)
    scene = build_scene(make_plan(n=2), Simulation(thresholds=limits))
    metrics = OracleMetrics(scene, limits)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    for offset_m, culprit in ((0.0008, -1), (0.0011, 1)):
        pos = scene.target + np.array([[0.0, 0.0, 0.0], [offset_m, 0.0, 0.0]])
        metrics.add_pose(1.0, pos, upright)
        assert metrics.culprit == culprit
        shift = motion.shift(jnp.asarray(pos)[None], jnp.asarray(scene.target, jnp.float32)[None], limits.shift_floor_m)
        excess = rules.excess(shift, jnp.zeros((1, 2)), jnp.zeros((1, 2), bool), limits)
        assert (np.asarray(excess[0]) > 1).tolist() == [False, culprit == 1]


def test_a_box_is_as_fast_as_its_fastest_point_may_be() -> None:
    """The speed of a box is the largest speed that any of its points can have. The boxes have the half sizes (0.2, 0.2,
    0.1) m, so their corners are 0.3 m from their centres."""
    half = np.tile([0.2, 0.2, 0.1], (3, 1))
    vel = np.array([[0.009, 0, 0, 0, 0, 0.05], [0.003, 0.004, 0, 0, 0, 0], [0, 0, 0, 0.03, 0.04, 0]])
    expected = [0.024, 0.005, 0.015]
    np.testing.assert_allclose(motion.speed(jnp.asarray(vel)[None], jnp.asarray(half)[None])[0], expected, rtol=1e-5)
    np.testing.assert_allclose(box_motion.speed(vel, np.full(3, 0.3)), expected, rtol=1e-12)


def test_how_far_points_have_moved_is_path_and_turn() -> None:
    """The largest distance by which points of a box have moved follows from its translation and rotation: here, 5 mm
    along x, and a rotation by 0.01 rad."""
    half = np.tile([0.2, 0.2, 0.1], (2, 1))
    before = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (2, 1))
    after = before.copy()
    after[0, 0] = 0.005
    after[1, 3:] = [np.cos(0.005), np.sin(0.005), 0.0, 0.0]
    expected = [0.005, 0.3 * 0.01]
    distances = motion.moved(*(jnp.asarray(array)[None] for array in (before, after, half)))
    np.testing.assert_allclose(distances[0], expected, rtol=1e-4)
    np.testing.assert_allclose(box_motion.moved(before, after, np.full(2, 0.3)), expected, rtol=1e-5)


# ---------------------------------------------------------------------- contact forces


def heap(cone: str, seed: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A model and its data with rotated boxes that fell onto a carrier and onto each other. Geoms are in the order of
    the models of MJX."""
    rng = np.random.default_rng(seed)
    bodies = "".join(
        f'<body pos="{x:.3f} {y:.3f} {0.12 + 0.16 * k:.3f}" euler="{a:.1f} {b:.1f} {c:.1f}"><freejoint/>'
        f'<geom type="box" size="0.1 0.08 0.07" mass="{2 + k}" friction="0.5 0.005 0.0001"/></body>'
        for k, (x, y, a, b, c) in enumerate(rng.uniform([-0.1, -0.1, -30, -30, 0], [0.1, 0.1, 30, 30, 90], (6, 5)))
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.002" cone="{cone}"/><worldbody><geom type="plane" size="0 0 1" pos="0 0 -0.144"/>'
        f'<body pos="0 0 -0.072"><freejoint/><geom type="box" size="0.3 0.3 0.072" mass="25"/></body>{bodies}'
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=60 + 40 * seed)
    return model, data


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_top_forces_are_mujocos(cone: str, seed: int) -> None:
    model, data = heap(cone, seed)
    pyramidal = cone == "pyramidal"
    contact = data.contact
    address = np.asarray(contact.efc_address)
    has_rows = address >= 0
    rows = np.zeros((data.ncon, 4), np.float32)
    k = 4 if pyramidal else 3
    rows[has_rows, :k] = data.efc_force[address[has_rows, None] + np.arange(k)]
    frame_z = np.asarray(contact.frame).reshape(-1, 3, 3)[:, :, 2].astype(np.float32)
    forces = force.contact_force_z(
        jnp.asarray(rows),
        jnp.asarray(frame_z),
        jnp.asarray(np.asarray(contact.friction)[:, :2], jnp.float32),
        pyramidal=pyramidal,
    )
    expected, wrench, total = [], np.zeros(6), np.zeros(model.nbody - 2)
    for c in range(data.ncon):
        mujoco.mj_contactForce(model, data, c, wrench)
        expected.append(float(wrench[:3] @ np.asarray(contact.frame[c]).reshape(3, 3)[:, 2]))
    assert data.ncon > 8
    np.testing.assert_allclose(forces, expected, rtol=1e-4, atol=1e-3)

    geom, bodies = np.asarray(contact.geom), geom_bodies(model, range(model.nbody - 2))
    box, sign, counts = force.pressed_box(jnp.asarray(bodies[geom]), jnp.asarray(frame_z[:, 0]))
    np.add.at(total, np.asarray(box)[np.asarray(counts)], np.asarray(sign * forces)[np.asarray(counts)])
    np.testing.assert_allclose(
        total, top_forces.top_forces(data, bodies, model.nbody - 2, pyramidal), rtol=1e-4, atol=1e-3
    )


def test_metrics_are_strict_about_ranks() -> None:
    assert jax.config.jax_numpy_rank_promotion == "raise"
    with pytest.raises(ValueError, match="rank_promotion"):
        jnp.zeros((2, 3, 3)) - jnp.zeros(3)


def test_the_final_pose_and_the_force_at_rest_enter_the_maxima() -> None:
    """The final pose and the force at rest are included in the maxima, for placed boxes in worlds that have ended."""
    scene = make_scene(3)
    worlds = upload_worlds([Job(scene)] * 2, 2, 3, {}, Simulation())
    fresh = fresh_state(worlds, all_placed=False, ends=jnp.array([10, 10]), rest_steps=5)
    lying = jnp.array([np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0], jnp.float32)
    state = fresh._replace(
        qpos=fresh.qpos.at[:, 1:, 3:].set(lying),
        placed=jnp.array([2, 2]),
        step=jnp.array([10, 7]),
        metrics=fresh.metrics._replace(
            max_tilt=fresh.metrics.max_tilt.at[:, 0].set(4.0),
            max_top_force=jnp.full((2, 3), 50.0),
            rest_force_sum=jnp.array([[400.0, 100.0, 0.0]] * 2),
            rest_samples=jnp.array([5, 5]),
        ),
    )
    metrics = reduce_metrics(state, worlds, Simulation())
    np.testing.assert_allclose(metrics.max_tilt, [[4.0, 90.0, 0.0]] * 2, atol=1e-4)
    np.testing.assert_allclose(metrics.max_top_force, [[80.0, 50.0, 50.0], [50.0] * 3])
    np.testing.assert_allclose(metrics.rest_force[0], [80.0, 20.0, 0.0])
    assert np.isnan(metrics.rest_force[1]).all()
