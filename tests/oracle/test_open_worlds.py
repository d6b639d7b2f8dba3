"""Open worlds, which get their boxes one after another: results agree with a run of the whole plan."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from petmjx.common.errors import InputError
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.open_world_protocol import OpenWorlds
from petmjx.engines.verdict import Flag, Outcome, Verdict
from petmjx.options.quiet import Quiet
from petmjx.options.simulation import Schedule, Simulation
from petmjx.world.job import FORCE, Drive, Excitation, Job
from petmjx.world.scene import Scene, build_scene

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.fake_stepper import assert_same
from support.tiny_worlds import engine as warp_engine
from support.worlds import boxes_by_plan, make_plan

from petmjx.engines.mjx.engine import MjxJaxEngine
from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.open_world_functions import OpenState
from petmjx.engines.warp.open_worlds import fork

pytestmark = pytest.mark.usefixtures("ranks_may_differ")

SIM = Simulation()
NAMES = ("hand-one-box", "hand-bridge", "hand-falls-off", "brickwork", "falls 60 mm flat", "corner overhang of 70 %")
GENTLE = ("hand-bridge", "brickwork")
"""Plans whose boxes never press much harder than with their weight."""
NEAR = 0.01
"""Tolerance of the largest force on a box: a box that is placed gently presses up to 0.4 % harder than with its
weight."""
LAST_DIGIT = 2**-22
"""Relative tolerance of tilts in single precision: two units in the last place. A program for tables of one size
measures the tilt of the last pose, and may round differently from the program for another size."""

FLOAT64 = 1e-12
"""Tolerance of positions on C MuJoCo, in m. The model of a whole plan also has the boxes that are not placed yet, and
they count in the solver's tolerance."""


def scenes() -> dict[str, Scene]:
    plans = boxes_by_plan()
    return {name: build_scene(make_plan(name, plans[name]), SIM) for name in NAMES}


def push() -> Drive:
    samples = np.zeros((300, 3))
    samples[:, 0] = 0.3 * np.sin(0.02 * np.arange(300))
    return Drive(Excitation("push", FORCE, samples), rest_s=0.2)


@pytest.fixture(scope="module", params=["mujoco", pytest.param("mjx-warp", marks=pytest.mark.slow)])
def engine(request: pytest.FixtureRequest) -> MujocoEngine | MjxWarpEngine:
    return MujocoEngine(2) if request.param == "mujoco" else warp_engine()


def run(engine: MujocoEngine | MjxWarpEngine, drive: Drive | None = None) -> list[Outcome]:
    outcomes = engine.run([Job(scene, drive) for scene in scenes().values()], SIM)
    return sorted(outcomes, key=lambda outcome: outcome.job)


def assert_same_but_for_a_digit_of_tilts(outcome: Outcome, expected: Outcome) -> None:
    """Assert that outcomes agree to the last bit, apart from the last digit of tilts."""
    tilt = expected.boxes.max_tilt_deg
    np.testing.assert_allclose(outcome.boxes.max_tilt_deg, tilt, rtol=LAST_DIGIT, atol=0.0)
    assert_same(replace(outcome, boxes=replace(outcome.boxes, max_tilt_deg=tilt)), expected)


def everything(worlds: OpenWorlds, drive: Drive | None = None) -> list[Outcome]:
    return worlds.finish(range(len(NAMES)), [drive] * len(NAMES))


def test_a_world_that_pauses_ends_as_one_that_does_not_to_the_last_bit(engine: MujocoEngine | MjxWarpEngine) -> None:
    worlds = engine.open(list(scenes().values()), SIM)
    worlds.go_on()
    for drive in (None, push(), None):  # asking for outcomes does not change the worlds
        for outcome, expected in zip(everything(worlds, drive), run(engine, drive), strict=True):
            assert_same_but_for_a_digit_of_tilts(outcome, expected)
            assert (outcome.flags, outcome.n_at_sign) == (expected.flags, expected.n_at_sign)


def test_boxes_can_be_put_in_one_by_one(engine: MujocoEngine | MjxWarpEngine) -> None:
    plans = list(scenes().values())
    worlds = engine.open([scene.first(0) for scene in plans], SIM)
    for count in range(1, 5):
        worlds.go_on()
        snapshots = worlds.read(range(len(plans)))
        open_ones = [k for k, scene in enumerate(plans) if scene.n_boxes >= count and not snapshots[k].ended]
        worlds.put(open_ones, [plans[k].first(count) for k in open_ones])
    worlds.go_on()
    for name, snapshot, outcome, expected in zip(
        NAMES, worlds.read(range(len(plans))), everything(worlds), run(engine), strict=True
    ):
        assert (outcome.verdict, outcome.reason, outcome.culprit) == (
            expected.verdict,
            expected.reason,
            expected.culprit,
        )
        if not snapshot.ended:
            if isinstance(engine, MjxWarpEngine):
                assert_same_but_for_a_digit_of_tilts(outcome, expected)
            np.testing.assert_allclose(outcome.boxes.pos, expected.boxes.pos, atol=FLOAT64)
            if name in GENTLE:
                weight = expected.boxes.rest_top_force_n
                np.testing.assert_allclose(snapshot.max_top_force_n, weight, rtol=NEAR, atol=NEAR, err_msg=name)
        assert snapshot.ended == (outcome.verdict is Verdict.UNSTABLE and outcome.sim_time_s == snapshot.time_s)


def test_readings_have_the_middles_of_boxes_whose_mass_is_elsewhere(engine: MujocoEngine | MjxWarpEngine) -> None:
    scene = scenes()["brickwork"]
    scene = replace(scene, mass_center=np.tile([0.03, -0.02, 0.01], (scene.n_boxes, 1)))
    worlds = engine.open([scene], SIM)
    worlds.go_on()
    (outcome,) = worlds.finish([0])
    np.testing.assert_allclose(worlds.snapshots([0]).pos[0], outcome.boxes.pos, atol=1e-4)


def test_pallets_that_tremble_end_as_a_run_of_all_their_boxes_does(engine: MujocoEngine | MjxWarpEngine) -> None:
    """The first wait takes the longest allowed time, and the boxes tremble to its end. Of the later waits, only the
    last one is long."""
    sim = SIM.changed(interval_s=0.1, longest_wait_s=0.5, quiet=Quiet(quiet_m_s=1e-30))
    scene = build_scene(make_plan("bridge", boxes_by_plan()["hand-bridge"]), sim)
    worlds = engine.open([scene.first(1)], sim)
    times = []
    for count in range(1, 4):
        if count > 1:
            worlds.put([0], [scene.first(count)])
        worlds.go_on()
        times.append(worlds.read([0])[0].time_s)
    np.testing.assert_allclose(np.diff(times, prepend=0.03), [0.5, 0.1, 0.1], atol=0.003)
    outcome, (expected,) = worlds.finish([0])[0], engine.run([Job(scene)], sim)
    assert outcome.n_steps == expected.n_steps
    assert outcome.flags == expected.flags == Flag.MOVING
    assert outcome.n_steps * sim.physics.timestep_s > times[-1] + 0.4


def test_forks_go_their_own_ways(engine: MujocoEngine | MjxWarpEngine) -> None:
    scene = build_scene(make_plan("stack", boxes_by_plan()["stack of 4"]), SIM)
    worlds = engine.open([scene.first(2)] * 3, SIM)
    worlds.go_on()
    before = worlds.read([0])[0]
    worlds.fork([0, 0], [1, 2])
    place = scene.target.copy()
    place[2, 0] += 0.25
    aside = replace(scene, start_pos=place, target=place)
    worlds.put([1, 2], [scene.first(3), aside.first(3)])
    worlds.go_on()
    stays, stands, falls = worlds.read(range(3))
    np.testing.assert_array_equal(stays.pos, before.pos)
    assert (len(stays.pos), len(stands.pos)) == (2, 3)
    np.testing.assert_allclose(stands.top_force_n[1], 6.0 * SIM.physics.gravity_m_s2, rtol=0.01)
    assert (stands.culprit, falls.culprit) == (-1, 2)
    worlds.reset([2], [scene.first(1)])
    worlds.go_on()
    assert len(worlds.read([2])[0].pos) == 1


def test_other_engines_say_that_they_have_none() -> None:
    with pytest.raises(InputError, match="engine mjx-jax has no open worlds"):
        MjxJaxEngine().open([], SIM)


def test_what_cannot_be_is_refused(engine: MujocoEngine | MjxWarpEngine) -> None:
    scene = build_scene(make_plan("stack", boxes_by_plan()["stack of 4"]), SIM)
    worlds = engine.open([scene.first(0)], SIM)
    worlds.go_on()
    with pytest.raises(ValueError, match="without boxes"):
        worlds.finish([0])
    with pytest.raises(ValueError, match="more than 0 boxes"):
        worlds.put([0], [scene.first(0)])
    for wrong, message in (([1], "no world 1"), ([-1], "no world -1"), ([0, 0], "named twice")):
        with pytest.raises(ValueError, match=message):
            worlds.put(wrong, [scene.first(1)] * len(wrong))
        with pytest.raises(ValueError, match=message):
            worlds.fork([0] * len(wrong), wrong)
    with pytest.raises(ValueError, match="expected 1 scenes, one for each world, got 0"):
        worlds.put([0], [])
    worlds.put([0], [scene.first(1)])
    for other, message in (
        (replace(scene, mass=2 * scene.mass), "first 1 boxes"),
        (replace(scene, mass_center=np.full_like(scene.target, 0.01)), "first 1 boxes"),
        (replace(scene, carrier=replace(scene.carrier, mass=1.0)), "same carrier as the world"),
    ):
        with pytest.raises(ValueError, match=message):
            worlds.put([0], [other.first(2)])
    worlds.go_on()
    assert len(worlds.read([0])[0].pos) == 1, "what was refused changed nothing"
    with pytest.raises(ValueError, match="at least one world"):
        engine.open([], SIM)
    with pytest.raises(ValueError, match="fixed schedule"):
        engine.open([scene], Simulation(schedule=Schedule.FIXED))


@pytest.mark.slow
def test_a_jitted_program_goes_on_with_them() -> None:
    """A jitted program places boxes, forks worlds and places boxes again.

    Results are the same to the last bit as with separate calls.
    """
    scene = build_scene(make_plan("stack", boxes_by_plan()["stack of 4"]), SIM)
    worlds, twin = (warp_engine().open([scene.first(1)] * 2, SIM, most_boxes=4) for _ in range(2))
    still, simulator = jnp.zeros((1, 1, 3)), worlds.simulator
    more = upload_worlds([Job(scene.first(3))], 1, 4, {}, SIM)._replace(pauses=jnp.ones(1, bool))

    @jax.jit
    def program(open_: OpenState) -> OpenState:
        settled = fork(simulator.go_on(open_, still), jnp.array([0]), jnp.array([1]))
        return simulator.go_on(simulator.put(settled, jnp.array([1]), more), still)

    next_worlds = program(worlds.open)
    twin.go_on()
    twin.fork([0], [1])
    twin.put([1], [scene.first(3)])
    twin.go_on()
    assert next_worlds.state.placed.tolist() == [1, 3]
    for one, other in zip(jax.tree.leaves(next_worlds), jax.tree.leaves(twin.open), strict=True):
        np.testing.assert_array_equal(one, other)
