"""When the next box is placed: which pallets are quiet, which boxes creep, and that the engines agree."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.plans import Box, make_scene

from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import NEVER, upload_worlds
from petmjx.engines.mjx.world_state import Status, fresh_state
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.rest import QuietRule
from petmjx.engines.verdict import Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

Finder = Callable[[np.ndarray, Simulation, bool], list[bool]]

BOXES = 3
SCENE = make_scene(BOXES)
AT_HOME = np.concatenate([SCENE.start_pos, SCENE.start_quat], axis=1)
QUIET = Simulation().quiet
ADAPTIVE = Simulation()
ANY_PACE = Simulation(quiet={"slow_m_s": 1.0, "still_m_s": 1.0})
"""With these options no box creeps: every quiet box is slow and still."""
ONE_LOOK = Simulation(quiet={"poll_steps": 25})
RARE_LOOKS = Simulation(quiet={"poll_steps": 40})
"""One look (check for quiet) is enough with these options, since looks are rare. A pallet in which a box creeps is not
quiet at the look that finds the box."""


def velocities(pace: np.ndarray) -> np.ndarray:
    """(box, 6) velocities. Every second box slides, the other boxes turn. ``pace`` is the speed of each box in units of
    ``quiet_m_s``."""
    rows = np.zeros((len(pace), 6))
    rows[::2, 1] = pace[::2] * QUIET.quiet_m_s
    rows[1::2, 4] = pace[1::2] * QUIET.quiet_m_s / np.linalg.norm(SCENE.half_size[0])
    return rows


def quiet_on_c(paces: np.ndarray, sim: Simulation, failed: bool) -> list[bool]:
    """Whether the rule of the engine ``mujoco`` finds the pallet quiet, for each look. ``paces``: (look, box)."""
    rule = QuietRule(sim, SCENE)
    return [rule.look(AT_HOME, velocities(pace), failed) for pace in paces]


@functools.cache
def _count_quiet(sim: Simulation) -> Any:
    """The rule of the MJX engines as a compiled function, which is used for all paces."""
    return jax.jit(Rules(sim, build_timetable(sim, BOXES), BOXES, driven=False).count_quiet)


def quiet_on_mjx(paces: np.ndarray, sim: Simulation, failed: bool) -> list[bool]:
    """Whether the rule that the MJX engines share finds the pallet quiet, for each look."""
    worlds = upload_worlds([Job(SCENE)], 1, BOXES, {}, sim)
    state = fresh_state(worlds, all_placed=True, ends=jnp.full(1, NEVER), rest_steps=1)
    tilt = jnp.where(failed, 1.1 * sim.thresholds.tilt_deg, 0.0)
    signs = state.metrics._replace(
        culprit=jnp.array([0], jnp.int32), max_tilt=state.metrics.max_tilt.at[0, 0].set(tilt)
    )
    state = state._replace(status=jnp.array([Status.RUNNING], jnp.int32), metrics=signs)
    flags = []
    count = _count_quiet(sim)
    for pace in paces:
        state = state._replace(qvel=jnp.asarray(velocities(pace), jnp.float32)[None])
        state, quiet = count(state, worlds, jnp.array([True]), jnp.array([True]))
        flags.append(bool(quiet[0]))
    return flags


@pytest.mark.parametrize("sim", [ADAPTIVE, ANY_PACE, ONE_LOOK, RARE_LOOKS])
@pytest.mark.parametrize("failed", [False, True])
def test_the_engines_agree_on_what_is_quiet(sim: Simulation, failed: bool) -> None:
    rng = np.random.default_rng(5)
    seen = set()
    for _ in range(12):
        # Random speeds that pass through all cases of the rules: above the limit, slowing down, steady, at rest.
        steps = rng.normal(-0.12, 0.3, (40, BOXES)) * (rng.random((40, BOXES)) < 0.5)
        paces = 3.0 * np.exp(np.cumsum(steps, axis=0)) * rng.uniform(0.2, 1.0, BOXES)
        on_c = quiet_on_c(paces, sim, failed)
        assert quiet_on_mjx(paces, sim, failed) == on_c
        seen |= set(on_c)
    assert seen == {False, True}


POLLS = 40
STEADY = np.full((POLLS, BOXES), 0.3)
FASTER = 0.05 * np.exp(0.01 * np.arange(POLLS))[:, None] * np.ones(BOXES)
AT_REST = np.full((POLLS, BOXES), 0.05)
FADING = 0.9 * np.exp(-0.2 * np.arange(POLLS))[:, None] * np.ones(BOXES)
ONE_CREEPS = np.where(np.arange(BOXES) == 1, 0.3, FADING)


@pytest.mark.parametrize("find", [quiet_on_c, quiet_on_mjx])
@pytest.mark.parametrize(
    ("paces", "sim", "failed", "first_quiet"),
    [
        # Three looks, 5 steps apart, make up the 15 steps for which all boxes must be slow.
        (AT_REST, ADAPTIVE, False, 2),
        (STEADY, ANY_PACE, False, 2),
        (STEADY, ADAPTIVE, False, None),
        (STEADY, ADAPTIVE, True, 2),
        # the box is slow, but its speed grows: it begins to topple
        (FASTER, ADAPTIVE, False, None),
        (FASTER, ADAPTIVE, True, 2),
        # over two looks the speed falls to exp(−0.4) = 0.67 of its first value, which is below the share of 0.7
        (FADING, ADAPTIVE, False, 2),
        (ONE_CREEPS, ADAPTIVE, False, None),
        (ONE_CREEPS, ANY_PACE, False, 2),
        (np.full((POLLS, BOXES), 1.1), ANY_PACE, False, None),
        (np.full((POLLS, BOXES), 1.1), ADAPTIVE, True, None),
    ],
)
def test_what_creeps_is_waited_for_until_a_box_has_failed(
    find: Finder, paces: np.ndarray, sim: Simulation, failed: bool, first_quiet: int | None
) -> None:
    flags = find(paces, sim, failed)
    assert (flags.index(True) if True in flags else None) == first_quiet


@pytest.mark.parametrize("find", [quiet_on_c, quiet_on_mjx])
def test_pyramidal_cones_creep_by_themselves(find: Finder) -> None:
    flags = find(STEADY, Simulation(physics="reference"), False)
    assert flags.index(True) == 2


def test_a_placement_begins_the_count_anew() -> None:
    rule = QuietRule(Simulation(), SCENE)
    still = np.zeros((BOXES, 6))
    assert [rule.look(AT_HOME, still, False) for _ in range(2)] == [False] * 2
    rule.restart()
    assert [rule.look(AT_HOME, still, False) for _ in range(3)] == [False] * 2 + [True]


def test_a_box_that_begins_to_topple_is_waited_for() -> None:
    """The centre of the upper box is 1 mm beyond the edge of its support. So for half a second, the box is slower than
    the limit for quiet."""
    boxes: tuple[Box, ...] = (((400, 400, 400), (0, 0, 0), 20.0), ((400, 400, 400), (201, 0, 400), 5.0))
    outcomes = {}
    hasty = Simulation(quiet={"quiet_m_s": 1.0, "slow_m_s": 1.0, "still_m_s": 1.0})
    for name, sim in {"adaptive": ADAPTIVE, "hasty": hasty, "fixed": Simulation(schedule="fixed")}.items():
        (outcomes[name],) = MujocoEngine(1).run([Job(make_scene(boxes, sim))], sim)
    assert outcomes["fixed"].verdict is Verdict.UNSTABLE
    assert outcomes["adaptive"].verdict is Verdict.UNSTABLE
    assert outcomes["hasty"].verdict is Verdict.STABLE


@pytest.mark.parametrize("phase_s", np.linspace(-0.12, 0.12, 9))
def test_a_box_that_turns_round_does_not_rest(phase_s: float) -> None:
    """A box rocks by 5 mm with a period of 5 s. At its turning point it is slower than ``still_m_s`` for a moment, and
    its mean speed in a window around this moment is also small."""
    rule = QuietRule(ADAPTIVE, make_scene(1))
    rate, amplitude_m = 2 * math.pi / 5.0, 0.005
    window_s = QUIET.still_steps * ADAPTIVE.physics.timestep_s

    def pose(time_s: float) -> np.ndarray:
        return np.array([[amplitude_m * math.cos(rate * time_s), 0, 0, 1, 0, 0, 0]])

    velocity = np.zeros((1, 6))
    velocity[0, 0] = -amplitude_m * rate * math.sin(rate * phase_s)
    before, after = pose(phase_s - window_s), pose(phase_s)
    assert rule.motion(before, after, velocity, window_s) == (True, True)
    assert rule.motion(after, after, np.zeros((1, 6)), window_s) == (False, False)
    # with the preset reference, whose boxes always creep a little, only the distance that a box moves is tested
    creeps = QuietRule(Simulation(physics="reference"), make_scene(1))
    assert creeps.motion(after, after, np.full((1, 6), 1.0), window_s) == (False, False)
