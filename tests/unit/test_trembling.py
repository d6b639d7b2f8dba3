"""Tests of the rules for boxes that tremble, and for boxes that stay. The rules of C MuJoCo and of the MJX engines
agree. For the kernel of ``mjx-warp``, see ``tests/oracle/test_warp_rules.py``."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.plans import make_scene

from petmjx.common.units import FloatArray
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import NEVER, upload_worlds
from petmjx.engines.mjx.world_state import Status, fresh_state
from petmjx.engines.mujoco.rest import QuietRule
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

BOXES = 4
SCENE = make_scene(BOXES)
SIM = Simulation()
PERIOD = SIM.quiet.tremble_looks
LOOK_S = SIM.quiet.poll_steps * SIM.physics.timestep_s

SHAKEN, SWAYING, SLIDING, TURNING = range(BOXES)


def some_motion(looks: int, rng: np.random.Generator, drift_m_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """(look, box, 7) poses and (look, box, 6) velocities of four boxes at each check of motion (look). The first box
    moves to and fro quickly, with a drift along y. The others move to and fro slowly, slide, or rotate to and fro."""
    poses = np.tile(np.concatenate([SCENE.start_pos, SCENE.start_quat], axis=1), (looks, 1, 1))
    velocities = np.zeros((looks, BOXES, 6))
    time_s = LOOK_S * np.arange(looks)
    poses[:, SHAKEN, 0] += 5e-5 * rng.uniform(-1, 1, looks)
    poses[:, SHAKEN, 1] += drift_m_s * time_s
    velocities[:, SHAKEN, 0] = 0.015 * rng.choice([-1, 1], looks)
    angle = 2 * np.pi * 0.5 * time_s
    poses[:, SWAYING, 0] += 0.005 * np.sin(angle)
    velocities[:, SWAYING, 0] = 0.005 * np.pi * np.cos(angle)
    poses[:, SLIDING, 1] += 0.012 * time_s
    velocities[:, SLIDING, 1] = 0.012
    half = 5e-5 * rng.uniform(-1, 1, looks)
    poses[:, TURNING, 3], poses[:, TURNING, 4] = np.cos(half), np.sin(half)
    velocities[:, TURNING, 3] = 0.1
    return poses, velocities


def on_c(poses: FloatArray, velocities: FloatArray) -> list[list[bool]]:
    """Whether each box trembles after each check of motion, by the rule of C MuJoCo."""
    rule = QuietRule(SIM, SCENE)
    flags = []
    for pose, velocity in zip(poses, velocities, strict=True):
        rule.look(pose, velocity, has_failed=False)
        flags.append(rule.trembling.which(BOXES).tolist())
    return flags


@functools.cache
def _count_quiet() -> Any:
    return jax.jit(Rules(SIM, build_timetable(SIM, BOXES), BOXES, driven=False).count_quiet)


def on_mjx(poses: FloatArray, velocities: FloatArray) -> list[list[bool]]:
    """Whether each box trembles after each check of motion, by the rule of the MJX engines."""
    worlds = upload_worlds([Job(SCENE)], 1, BOXES, {}, SIM)
    state = fresh_state(worlds, all_placed=True, ends=jnp.full(1, NEVER), rest_steps=1)
    state = state._replace(status=jnp.array([Status.RUNNING], jnp.int32))
    yes, flags = jnp.array([True]), []
    for pose, velocity in zip(poses, velocities, strict=True):
        state = state._replace(qpos=jnp.asarray(pose, jnp.float32)[None], qvel=jnp.asarray(velocity, jnp.float32)[None])
        state, _ = _count_quiet()(state, worlds, yes, yes)
        flags.append((np.asarray(state.trembles)[0] == 1).tolist())
    return flags


@pytest.mark.parametrize("find", [on_c, on_mjx])
def test_a_box_that_goes_to_and_fro_and_gets_nowhere_trembles(find: Any) -> None:
    flags = find(*some_motion(2 * PERIOD + 1, np.random.default_rng(3)))
    assert flags[: 2 * PERIOD] == [[False] * BOXES] * (2 * PERIOD)  # while boxes land, trembling is not measured
    assert flags[-1] == [True, False, False, True]


@pytest.mark.parametrize("find", [on_c, on_mjx])
def test_a_box_that_walks_meanwhile_does_not_tremble(find: Any) -> None:
    walks = 1.1 * SIM.quiet.slow_m_s
    flags = find(*some_motion(2 * PERIOD + 1, np.random.default_rng(3), walks))
    assert flags[-1] == [False, False, False, True]


def test_the_engines_agree_on_what_trembles() -> None:
    rng = np.random.default_rng(7)
    poses, velocities = some_motion(4 * PERIOD + 2, rng)
    # the first box trembles, then also moves along y for a while, and trembles again
    poses[2 * PERIOD + 9 : 3 * PERIOD, SHAKEN, 1] += np.linspace(0, 0.002, PERIOD - 9)
    poses[3 * PERIOD :, SHAKEN, 1] += 0.002
    flags = on_c(poses, velocities)
    assert flags == on_mjx(poses, velocities)
    assert [flags[n * PERIOD][SHAKEN] for n in range(5)] == [False, False, True, False, True]


def test_what_trembles_is_not_waited_for() -> None:
    rule = QuietRule(SIM, SCENE)
    poses, velocities = (some[:, :1] for some in some_motion(2 * PERIOD + 3, np.random.default_rng(3)))
    quiet = [rule.look(pose, velocity, has_failed=False) for pose, velocity in zip(poses, velocities, strict=True)]
    assert quiet.index(True) == 2 * PERIOD + SIM.quiet.steps // SIM.quiet.poll_steps - 1
    assert not rule.holds  # if the simulation goes on, the world gets the flag ``moving``
    moved = np.array([[0.5 * SIM.quiet.slow_m_s * 0.1, 0, 0, 0, 0, 0, 0]])
    fast = velocities[-1]
    assert rule.motion(poses[0], poses[0] + moved, fast, 0.1) == (True, False)
    assert rule.motion(poses[0], poses[0] + 3 * moved, fast, 0.1) == (True, True)
    assert rule.motion(poses[0], poses[0], fast, 0.1) == (False, False)
    # when another box is placed, the motion of the first box may change
    assert rule.trembling.which(1).tolist() == [True]
    assert rule.trembling.which(2).tolist() == [False, False]


def test_what_rests_beside_it_does_not_tremble() -> None:
    """A box at rest does not count as trembling, although it also moves to and fro a little: it may begin to topple."""
    poses, velocities = some_motion(2 * PERIOD + 1, np.random.default_rng(3))
    velocities[:, TURNING] *= 0.01
    for find in (on_c, on_mjx):
        assert find(poses, velocities)[-1] == [True, False, False, False]


def some_chatter(looks: int, rng: np.random.Generator, growth_1_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """(look, box, 7) poses and (look, box, 6) velocities. The boxes chatter within 6 µm. At each look, another box is
    fast (0.8 mm/s). With a rate of growth, the last box also topples: its distance, 0.1 µm at first, grows
    exponentially."""
    poses = np.tile(np.concatenate([SCENE.start_pos, SCENE.start_quat], axis=1), (looks, 1, 1))
    poses[:, :, 0] += 3e-6 * rng.uniform(-1, 1, (looks, BOXES))
    velocities = np.zeros((looks, BOXES, 6))
    velocities[:, :, 0] = np.where(np.arange(looks)[:, None] % BOXES == np.arange(BOXES), 8e-4, 5e-5)
    if growth_1_s:
        way = 1e-7 * np.exp(growth_1_s * LOOK_S * np.arange(looks))
        poses[:, -1, 1] += way
        velocities[:, -1, 1] += growth_1_s * way
    return poses, velocities


def looks_on_c(poses: FloatArray, velocities: FloatArray) -> tuple[list[bool], bool]:
    """For each look, whether the rule of C MuJoCo finds the pallet quiet; and whether its last count is a full one."""
    rule = QuietRule(SIM, SCENE)
    looks = [rule.look(pose, velocity, has_failed=False) for pose, velocity in zip(poses, velocities, strict=True)]
    return looks, rule.holds


def looks_on_mjx(poses: FloatArray, velocities: FloatArray) -> tuple[list[bool], bool]:
    """The same by the rule of the MJX engines."""
    worlds = upload_worlds([Job(SCENE)], 1, BOXES, {}, SIM)
    state = fresh_state(worlds, all_placed=True, ends=jnp.full(1, NEVER), rest_steps=1)
    state = state._replace(status=jnp.array([Status.RUNNING], jnp.int32))
    yes, looks = jnp.array([True]), []
    for pose, velocity in zip(poses, velocities, strict=True):
        state = state._replace(qpos=jnp.asarray(pose, jnp.float32)[None], qvel=jnp.asarray(velocity, jnp.float32)[None])
        state, quiet = _count_quiet()(state, worlds, yes, yes)
        looks.append(bool(quiet[0]))
    return looks, int(state.quiet_steps[0]) >= SIM.quiet.steps


@pytest.mark.parametrize("see", [looks_on_c, looks_on_mjx])
def test_boxes_that_chatter_at_their_places_are_not_waited_for_and_the_pallet_is_quiet(see: Any) -> None:
    looks, holds = see(*some_chatter(2 * PERIOD + 6, np.random.default_rng(33332)))
    assert True not in looks[: 2 * PERIOD]  # one of them is always faster than at the beginning
    assert looks[2 * PERIOD + 2 :] == [True] * 4
    assert holds  # the world gets no flag


@pytest.mark.parametrize("see", [looks_on_c, looks_on_mjx])
@pytest.mark.parametrize("growth_1_s", [6.0, 10.0])
def test_a_box_that_begins_to_topple_among_boxes_that_chatter_is_waited_for(see: Any, growth_1_s: float) -> None:
    """By the time at which a box can stay, this box has moved by more than 12.5 µm in a measured period."""
    looks, _ = see(*some_chatter(3 * PERIOD, np.random.default_rng(33332), growth_1_s))
    assert True not in looks


def test_at_the_end_a_box_that_stays_may_be_fast_but_not_away() -> None:
    rule = QuietRule(SIM, SCENE)
    poses, velocities = some_chatter(2 * PERIOD + 1, np.random.default_rng(33332))
    for pose, velocity in zip(poses, velocities, strict=True):
        rule.look(pose, velocity, has_failed=False)
    fast = np.full((BOXES, 6), 3e-4)
    for moved_m, motion in ((9e-6, (False, False)), (11e-6, (True, False)), (14e-6, (True, True))):
        after = poses[0] + np.array([moved_m, 0, 0, 0, 0, 0, 0])
        assert rule.motion(poses[0], after, fast, 0.1) == motion
    assert QuietRule(SIM, SCENE).motion(poses[0], poses[0], fast, 0.1) == (True, True)
