"""The hand that carries boxes has the same starting places, forces and decisions on the batched engines as on C
MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.plans import Box, make_scene

from petmjx.common.units import FloatArray
from petmjx.engines.mjx import hand
from petmjx.engines.mjx.world_constants import NEVER, Worlds, upload_worlds
from petmjx.engines.mjx.world_state import State, fresh_state
from petmjx.engines.mujoco.hand import Hand
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.options.simulation import Simulation
from petmjx.world.approach_paths import approach_path_of, way_steps
from petmjx.world.job import Job
from petmjx.world.scene import Scene

SIM = Simulation(placing="hand")
DT = SIM.physics.timestep_s
SIZE = (300.0, 300.0, 300.0)
SINGLE = {"rtol": 2e-4, "atol": 2e-4}
"""Tolerances of forces in single precision. The spring's force is a difference of positions, which are some decimetres,
times up to 2,500 kg/s²."""


def crowded(sim: Simulation) -> Scene:
    """A scene whose last box overlaps one neighbour by 3 mm in the plan, and is beside another neighbour."""
    boxes: list[Box] = [
        (SIZE, (0.0, 0.0, 0.0), 6.0),
        (SIZE, (0.0, 300.0, 0.0), 6.0),
        (SIZE, (297.0, 150.0, 0.0), 4.0),
    ]
    scene = make_scene(boxes, sim)
    return replace(scene, approach=np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]]))


@dataclass
class Pair:
    """The same world on C MuJoCo (``live``) and on a batched engine, directly after its last box was placed."""

    live: LiveWorld
    worlds: Worlds
    state: State

    @property
    def of_c(self) -> Hand:
        assert self.live.hand is not None
        return self.live.hand


@pytest.fixture
def pair() -> Pair:
    return placed(SIM)


def placed(sim: Simulation) -> Pair:
    scene = crowded(sim)
    live = LiveWorld(scene, sim)
    for _ in range(scene.n_boxes):
        live.hand = None
        live.place_next()
        if live.n_placed < scene.n_boxes:  # all boxes except the last one are at their planned places
            live._poses[live.n_placed - 1, :3] = scene.target[live.n_placed - 1]
    worlds = upload_worlds([Job(scene)], 1, scene.n_boxes, {}, sim)
    state = fresh_state(worlds, all_placed=True, ends=jnp.full(1, NEVER, jnp.int32), rest_steps=1)
    poses = jnp.asarray(np.column_stack([scene.target, scene.start_quat]), jnp.float32)[None]
    state = state._replace(qpos=poses.at[:, -1].set(worlds.start[:, -1]), step=jnp.full(1, 70, jnp.int32))
    return Pair(live, worlds, hand.take_up(state, worlds, jnp.ones(1, bool), DT))


def test_boxes_begin_at_the_same_place(pair: Pair) -> None:
    path = approach_path_of(pair.live.scene, SIM)
    assert path is not None
    place = pair.live.pose[2, :3]
    planned = pair.live.release.pos[2] + path.offset[2]
    assert np.abs(place - planned).max() > 0.002  # the box's start was moved aside
    np.testing.assert_allclose(pair.state.qpos[0, 2, :3], place, atol=1e-6)
    assert int(pair.state.carried_steps[0]) == pair.of_c.steps
    length = np.linalg.norm(pair.of_c.end - pair.of_c.begin)
    assert pair.of_c.steps == way_steps(length, 4.0, SIM.placing, DT)


@pytest.mark.parametrize(("gap_mm", "goes"), [(0.0, "up"), (8.0, "aside")])
def test_a_box_goes_aside_no_further_than_to_a_wall(gap_mm: float, goes: str) -> None:
    """A neighbour is in the way by 3 mm. The start of the box's path is moved aside, but at most to the wall. If there
    is too little space, the start is moved up."""
    pair = placed(SIM.changed(walls={"sides": ["right"], "gap_mm": gap_mm}))
    place = pair.live.pose[2, :3]
    np.testing.assert_allclose(pair.state.qpos[0, 2, :3], place, atol=1e-6)
    assert place[0] + 0.15 <= 0.597 + gap_mm / 1000
    planned = 0.15 + SIM.placing.height_mm / 1000
    assert (place[2] > planned + 0.1) == (goes == "up")


def random_motion(rng: np.random.Generator, quat: FloatArray) -> tuple[FloatArray, FloatArray]:
    turned = quat + rng.normal(0.0, 0.05, 4)
    return turned / np.linalg.norm(turned), rng.normal(0.0, [0.05] * 3 + [0.2] * 3)


@pytest.mark.parametrize("lowered", [False, True])
def test_hands_press_alike(pair: Pair, lowered: bool) -> None:
    rng = np.random.default_rng(5)
    of_c = pair.of_c
    for n_steps in (0, 1, of_c.steps // 2, of_c.steps, of_c.steps + 40):
        quat, velocity = random_motion(rng, of_c.quat)
        pose = np.concatenate([of_c.begin + rng.normal(0.0, 0.01, 3), quat])
        of_c.taken, of_c.lowered_from = n_steps, (n_steps if lowered else type(of_c).lowered_from)
        step = pair.state.carried_from + n_steps
        state = pair.state._replace(
            step=step,
            lowered_from=step if lowered else pair.state.lowered_from,
            qpos=pair.state.qpos.at[0, 2].set(jnp.asarray(pose, jnp.float32)),
            qvel=pair.state.qvel.at[0, 2].set(jnp.asarray(velocity, jnp.float32)),
        )
        wrenches = jax.jit(hand.wrenches, static_argnames="sim")(state, pair.worlds, sim=SIM)
        expected = of_c.wrench(pose, velocity)
        bears_n = 4.0 * SIM.physics.gravity_m_s2 if lowered else 0.0
        assert np.linalg.norm(expected[:2]) <= SIM.placing.force_n + bears_n + 1e-9
        np.testing.assert_allclose(wrenches[0, 2], expected, **SINGLE)
        assert not np.asarray(wrenches[0, :2]).any()


def test_hands_let_go_alike(pair: Pair) -> None:
    """Both hands release boxes in the same situations: boxes at rest on their path, at its end, or before its end;
    boxes that are fast; and boxes that are being set down."""
    of_c, pose = pair.of_c, np.concatenate([pair.of_c.end, pair.of_c.quat])
    state = pair.state._replace(qpos=pair.state.qpos.at[0, 2].set(jnp.asarray(pose, jnp.float32)))
    speeds = [0.0, 0.5]
    let_go = []
    for n_steps in range(1, of_c.steps + 20):
        speed = speeds[n_steps in range(of_c.steps, of_c.steps + 4)]
        state = state._replace(step=state.carried_from + n_steps, qvel=state.qvel.at[0, 2, 0].set(jnp.float32(speed)))
        state = hand.carry_on(state, pair.worlds, jnp.ones(1, bool), SIM)
        opens = of_c.has_let_go(pose, speed < SIM.quiet.quiet_m_s)
        assert bool(state.carried_from[0] == NEVER) == opens
        if opens:
            let_go.append(n_steps)
            break
        assert (int(state.lowered_from[0]) != NEVER) == (of_c.lowered_from != type(of_c).lowered_from)
    assert let_go == [of_c.steps + 4 + 5]
    assert int(state.last_placed_at[0]) == 70 + let_go[0]
