"""Stretch film: on all engines, the forces with which film presses and holds boxes agree with closed forms."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from support.plans import Box, make_plan
from support.tiny_worlds import shared_engine

from petmjx.common.units import STANDARD_GRAVITY
from petmjx.engines.mjx.film import hold
from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.engines.mjx.world_state import fresh_state
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.film import ActingFilm
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.world.film import film_of
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.scene import Scene, build_scene

WITHIN = 0.05
"""Required accuracy of the level at which a wrapped box slides: at 5 % below the closed form, the box holds; at 5 %
above, it slides."""
WRAP = {"turns": 3, "force_n": 20, "friction": 0.4}
MASS_KG, HEIGHT_M, FRICTION = 10.0, 0.2, 0.5
HOLD_N = 0.4 * 4 * 2 * 20 * 3 * HEIGHT_M / 0.5
"""Friction of the film on a box, N: the coefficient of friction times the pressing force 2·T on each of four sides,
where T = force · turns · height / width of the film. The result is 76.8 N."""
SLIDES_G = FRICTION + HOLD_N / (MASS_KG * STANDARD_GRAVITY)
BOX: list[Box] = [((400.0, 300.0, 200.0), (400.0, 250.0, 0.0), MASS_KG)]
AGREES_M = 1e-4
"""Tolerance of places between engines, m. Differences come from single precision over a thousand steps in which boxes
slide. The measured difference was 0.03 mm."""


def simulation(**wrap: Any) -> Simulation:
    options = {"check": Check.STATIC, "schedule": Schedule.FIXED, "settle_s": 0.4, "carrier": "euro-pallet"}
    return Simulation(**options, wrap=wrap, early_stop=False)


def accelerated(scene: Scene, level_g: float) -> Job:
    """A job with an acceleration along x that reaches its level in 0.2 s and keeps it for 1 s."""
    rows = np.zeros((600, 3))
    rows[:, 0] = STANDARD_GRAVITY * level_g * np.concatenate((np.linspace(0.0, 1.0, 100), np.ones(500)))
    return Job(scene, Drive(Excitation("test", "acceleration", rows), rest_s=0.2))


def pushed(scene: Scene) -> Job:
    """A job in which a force of half the weight pushes a carrier that can move, for 0.1 s."""
    rows = np.zeros((100, 3))
    rows[:50, 0] = 0.5
    return Job(scene, Drive(Excitation("push", "force", rows), rest_s=0.2))


def boxed(boxes: list[Box], **wrap: Any) -> Scene:
    """The scene of these boxes with film. The boxes are explicitly rigid, so that the same compiled kernel serves this
    file and test_stiffness.py."""
    return replace(build_scene(make_plan(boxes=boxes), simulation(**wrap)), stiffness=np.full(len(boxes), np.inf))


def jobs() -> dict[str, Job]:
    single = boxed(BOX, **WRAP)
    two = boxed([*BOX, ((400.0, 300.0, 200.0), (400.0, 250.0, 200.0), 5.0)], **WRAP, hat_n=60)
    return {
        "holds": accelerated(single, (1 - WITHIN) * SLIDES_G),
        "slides": accelerated(single, (1 + WITHIN) * SLIDES_G),
        "bare": accelerated(boxed(BOX), (1 - WITHIN) * SLIDES_G),
        "two": accelerated(two, 0.9),
        "pushed": pushed(two),
    }


@functools.cache
def simulated(engine: str) -> dict[str, Outcome]:
    made: Engine = MujocoEngine(1) if engine == "mujoco" else shared_engine()
    worlds = jobs()
    outcomes = made.run(list(worlds.values()), simulation(**WRAP))
    return {list(worlds)[outcome.job]: outcome for outcome in outcomes}


def test_a_wrapped_box_slides_at_friction_and_hold() -> None:
    outcomes = simulated("mujoco")
    assert film_of(boxed(BOX, **WRAP)).hold == pytest.approx([HOLD_N])
    assert [outcomes[name].verdict for name in ("holds", "slides", "bare")] == [
        Verdict.STABLE,
        Verdict.UNSTABLE,
        Verdict.UNSTABLE,
    ]


def test_film_holds_alike_on_mjx_warp() -> None:
    for name, outcome in simulated("mjx-warp").items():
        expected = simulated("mujoco")[name]
        assert (outcome.verdict, outcome.reason) == (expected.verdict, expected.reason)
        if expected.verdict is Verdict.STABLE:
            np.testing.assert_allclose(outcome.boxes.pos, expected.boxes.pos, atol=AGREES_M)


def test_film_of_mjx_jax_acts_as_that_of_mujoco() -> None:
    """The film's forces on three boxes are compared along a path on which the boxes stick, slip and are pulled in. A
    simulation would take minutes to compile."""
    size = (300.0, 300.0, 400.0)
    scene = boxed([(size, (400.0 * x, 0.0, 0.0), 5.0) for x in range(3)], **WRAP, hat_n=30)
    rng = np.random.default_rng(7)
    path = np.cumsum(rng.normal(0.0, 2e-4, (40, 3, 3)), axis=0)
    speeds = rng.normal(0.0, 0.05, (40, 3, 3))
    job = accelerated(scene, 0.1)
    on_device = upload_worlds([job], 1, 4, {id(job.drive.excitation): 0}, simulation(**WRAP))  # type: ignore[union-attr]
    state = fresh_state(on_device, all_placed=True, ends=jnp.zeros(1, jnp.int32), rest_steps=1)
    state = state._replace(driven_from=jnp.zeros(1, jnp.int32), carrier_qpos=0 * state.carrier_qpos)
    acting = ActingFilm(scene, 0.002, path[0])
    for step in range(40):
        qpos = state.qpos.at[0, :3, :3].set(path[step])
        qvel = state.qvel.at[0, :3, :3].set(speeds[step])
        state = state._replace(qpos=qpos, qvel=qvel, step=jnp.full(1, step, jnp.int32))
        film_forces, state = hold(state, on_device, 0.002)
        np.testing.assert_allclose(film_forces[0, :3], acting.forces(path[step], speeds[step]), rtol=1e-4, atol=1e-2)


def test_film_presses_on_outer_faces_alike_from_all_sides() -> None:
    """Each of four boxes in a square has two outer faces. A fifth box in the hole between them has no outer face."""
    size = (300.0, 300.0, 400.0)
    square: list[Box] = [(size, (x, y, 0.0), 5.0) for x in (0.0, 400.0) for y in (0.0, 400.0)]
    scene = boxed([*square, ((100.0, 100.0, 400.0), (300.0, 300.0, 0.0), 1.0)], **WRAP, hat_n=40)
    film = film_of(scene)
    side_n = 2 * 20 * 3 * 0.4 / 0.5
    np.testing.assert_allclose(film.press[:4, :2], [[+1, +1], [+1, -1], [-1, +1], [-1, -1]] * np.array(side_n / 2))
    np.testing.assert_array_equal(film.press[4, :2], 0.0)
    assert film.hold == pytest.approx([0.4 * side_n] * 4 + [0.0])
    assert film.press[:, 2].sum() == pytest.approx(-40.0)


def test_film_between_boxes_and_a_carrier_that_moves_adds_no_momentum() -> None:
    """On a floor without friction, a push with half of the total weight for 0.1 s must give the speed that follows from
    the momentum."""
    scene = boxed([*BOX, ((400.0, 300.0, 200.0), (400.0, 250.0, 200.0), 5.0)], **WRAP)
    smooth = replace(scene.carrier, friction=np.full_like(scene.carrier.friction, 1e-4))
    job = pushed(replace(scene, floor_friction=(1e-4, 1e-6, 1e-6), carrier=smooth))
    sim = simulation(**WRAP).changed(longest_wait_s=0)  # boxes on a carrier that keeps sliding are never at rest
    (outcome,) = MujocoEngine(1).run([replace(job, record=Record(0.01))], sim)
    history = outcome.history
    assert history is not None
    first, last = np.flatnonzero(history.time_s > history.time_s[-1] - 0.1)[[0, -1]]
    moments = [
        history.pos[frame][:, 0] @ scene.mass + history.carrier_pos[frame][0] * scene.carrier.mass
        for frame in (first, last)
    ]
    speed = (moments[1] - moments[0]) / (history.time_s[last] - history.time_s[first]) / scene.total_mass
    assert speed == pytest.approx(0.5 * STANDARD_GRAVITY * 0.1, rel=0.02)


def test_after_a_drive_with_film_friction_at_sides_bears_part_of_the_weight() -> None:
    """The forces on the tops of a layer are not equal to the weight of the layers above. The forces equal the weight if
    the friction between the sides of two layers is added, except for the part of the weight that the film bears by
    friction (docs/wrap.md). The sides of two layers touch in narrow strips, because boxes have sunk a little."""
    size, rows, layers, kg = (400.0, 400.0, 250.0), (3, 2), 4, 8.0
    per_layer = rows[0] * rows[1]
    boxes: list[Box] = [
        (size, (400.0 * x, 400.0 * y, 250.0 * z), kg)
        for z in range(layers)
        for x in range(rows[0])
        for y in range(rows[1])
    ]
    options = {"check": Check.STATIC, "carrier": "epal-1", "wrap": {"turns": 4, "force_n": 50}}
    sim = Simulation(**options)
    scene = build_scene(make_plan(boxes=boxes), sim)
    pulse = np.concatenate((np.linspace(0.0, 0.7, 25), np.full(175, 0.7), np.linspace(0.7, 0.0, 25), np.zeros(75)))
    acceleration = np.zeros((len(pulse), 3))
    acceleration[:, 0] = STANDARD_GRAVITY * pulse
    job = Job(
        scene, Drive(Excitation("test", "acceleration", acceleration), rest_s=0.4), record=Record(0.1, details=True)
    )
    (outcome,) = MujocoEngine(1).run([job], sim)
    assert outcome.verdict is Verdict.STABLE
    assert outcome.history is not None
    contacts = outcome.history.contacts
    assert contacts is not None
    last = (contacts.frame == contacts.frame.max()) & (contacts.body >= 0).all(axis=1)
    layer = contacts.body // per_layer
    film_n = film_of(scene).hold.reshape(layers, per_layer).sum(axis=1)
    for upper in range(1, layers):
        across = last & (layer.min(axis=1) == upper - 1) & (layer.max(axis=1) == upper)
        sign = np.where(layer[across, 1] == upper, 1.0, -1.0)
        up_n = sign * contacts.force[across, 2]
        on_top = np.abs(contacts.normal[across, 2]) > 0.7
        weight_n = (layers - upper) * per_layer * kg * STANDARD_GRAVITY
        tops_n = float(np.sum(outcome.boxes.rest_top_force_n.reshape(layers, per_layer)[upper - 1]))
        assert up_n[on_top].sum() == pytest.approx(tops_n, rel=0.02)
        # the difference is the weight that the film bears, which is far less than it could bear
        assert abs(up_n.sum() - weight_n) < 0.1 * film_n[upper:].sum()
        level_m = 0.25 * upper
        slivers = contacts.point[across, 2][~on_top]
        assert (np.abs(slivers - level_m) < 1e-3).all()
        pressed_n = np.abs((contacts.force[across] * contacts.normal[across]).sum(axis=1))[~on_top].sum()
        assert abs(up_n[~on_top].sum()) <= sim.physics.box_friction[0] * pressed_n + 1e-6
