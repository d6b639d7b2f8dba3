"""When the next box is placed: what is quiet, what creeps, and that the engines agree on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.plans import make_scene

from benchmarks.cases import SEED
from petmjx.config import Schedule, Simulation
from petmjx.engines.batch.rules import Rules
from petmjx.engines.batch.state import NEVER, Status, fresh_state, upload_worlds
from petmjx.engines.batch.timetable import build_timetable
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.engines.cpu.quiet import QuietRule
from petmjx.plans.read import load_plans
from petmjx.plans.samples import generate_one, write_plans
from petmjx.verdict import Verdict
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

Finder = Callable[[np.ndarray, Simulation, bool], list[bool]]

BOXES = 3
QUIET = Simulation().quiet


def velocities(pace: np.ndarray) -> np.ndarray:
    """(box, 6): every second box slides, the others turn, at a pace given in units of the limits."""
    rows = np.zeros((len(pace), 6))
    rows[::2, 1] = pace[::2] * QUIET.lin_vel_m_s
    rows[1::2, 4] = pace[1::2] * QUIET.ang_vel_rad_s
    return rows


def quiet_on_c(paces: np.ndarray, sim: Simulation, sign: bool) -> list[bool]:
    """Whether the C engine calls the pallet quiet at each poll. ``paces``: (poll, box)."""
    rule = QuietRule(sim)
    return [rule.is_quiet(velocities(pace), sign) for pace in paces]


def quiet_on_mjx(paces: np.ndarray, sim: Simulation, sign: bool) -> list[bool]:
    """The same of the rules that the MJX engines share."""
    worlds = upload_worlds([Job(make_scene(BOXES))], 1, BOXES, {}, sim.physics.timestep_s)
    state = fresh_state(worlds, all_placed=True, ends=jnp.full(1, NEVER), rest_steps=1)
    culprit = jnp.array([0 if sign else -1], jnp.int32)
    state = state._replace(
        status=jnp.array([Status.RUNNING], jnp.int32), metrics=state.metrics._replace(culprit=culprit)
    )
    rules = Rules(sim, build_timetable(sim, BOXES), BOXES, driven=False)
    found = []
    count = jax.jit(rules.count_quiet)
    for pace in paces:
        state = state._replace(vel=jnp.asarray(velocities(pace), jnp.float32)[None])
        state = count(state, jnp.array([True]))
        found.append(bool(state.quiet_steps[0] >= QUIET.steps))
    return found


@pytest.mark.parametrize("schedule", [Schedule.ADAPTIVE, Schedule.BRISK])
@pytest.mark.parametrize("sign", [False, True])
def test_the_engines_agree_on_what_is_quiet(schedule: Schedule, sign: bool) -> None:
    sim = Simulation(schedule=schedule)
    rng = np.random.default_rng(5)
    seen = set()
    for _ in range(12):
        # Paces that wander through all that matters: above the limit, slowing, steady, at rest.
        steps = rng.normal(-0.12, 0.3, (40, BOXES)) * (rng.random((40, BOXES)) < 0.5)
        paces = 3.0 * np.exp(np.cumsum(steps, axis=0)) * rng.uniform(0.2, 1.0, BOXES)
        on_c = quiet_on_c(paces, sim, sign)
        assert quiet_on_mjx(paces, sim, sign) == on_c
        seen |= set(on_c)
    assert seen == {False, True}


POLLS = 40
STEADY = np.full((POLLS, BOXES), 0.3)
AT_REST = np.full((POLLS, BOXES), 0.05)
FADING = 0.9 * np.exp(-0.2 * np.arange(POLLS))[:, None] * np.ones(BOXES)
ONE_CREEPS = np.where(np.arange(BOXES) == 1, 0.3, FADING)


@pytest.mark.parametrize("find", [quiet_on_c, quiet_on_mjx])
@pytest.mark.parametrize(
    ("paces", "schedule", "sign", "first_quiet"),
    [
        # Five polls of five steps make the 25 that all must be slow.
        (AT_REST, Schedule.ADAPTIVE, False, 4),
        (STEADY, Schedule.BRISK, False, 4),
        (STEADY, Schedule.ADAPTIVE, False, None),
        (STEADY, Schedule.ADAPTIVE, True, 4),
        # exp(−0.8) = 0.45 over four polls is slower than half.
        (FADING, Schedule.ADAPTIVE, False, 4),
        (ONE_CREEPS, Schedule.ADAPTIVE, False, None),
        (ONE_CREEPS, Schedule.BRISK, False, 4),
        (np.full((POLLS, BOXES), 1.1), Schedule.BRISK, False, None),
        (np.full((POLLS, BOXES), 1.1), Schedule.ADAPTIVE, True, None),
    ],
)
def test_what_creeps_is_waited_for_until_a_box_crosses_a_threshold(
    find: Finder, paces: np.ndarray, schedule: Schedule, sign: bool, first_quiet: int | None
) -> None:
    found = find(paces, Simulation(schedule=schedule), sign)
    assert (found.index(True) if True in found else None) == first_quiet


@pytest.mark.parametrize("find", [quiet_on_c, quiet_on_mjx])
def test_pyramidal_cones_creep_by_themselves(find: Finder) -> None:
    found = find(STEADY, Simulation(physics="reference"), False)
    assert found.index(True) == 4


def test_a_placement_begins_the_count_anew() -> None:
    rule = QuietRule(Simulation())
    still = np.zeros((BOXES, 6))
    assert [rule.is_quiet(still, False) for _ in range(4)] == [False] * 4
    rule.restart()
    assert [rule.is_quiet(still, False) for _ in range(5)] == [False] * 4 + [True]


def test_a_plan_that_creeps_until_it_fails_stands_only_on_the_brisk_schedule(tmp_path: Path) -> None:
    """Box 20 of this generated plan moves at 4 mm/s whenever the next box comes: below the limit of quiet."""
    path = tmp_path / "plans.json"
    write_plans(path, [generate_one(432, SEED)])
    scene = build_scene(load_plans(path).plans[0], Simulation())
    verdicts = {}
    for schedule in Schedule:
        outcome = next(iter(MujocoEngine(1).run([Job(scene)], Simulation(schedule=schedule))))
        verdicts[schedule] = outcome.verdict, outcome.n_steps
    assert verdicts[Schedule.FIXED][0] is Verdict.UNSTABLE
    assert verdicts[Schedule.ADAPTIVE][0] is Verdict.UNSTABLE
    assert verdicts[Schedule.BRISK][0] is Verdict.STABLE
    assert verdicts[Schedule.BRISK][1] < verdicts[Schedule.ADAPTIVE][1] < verdicts[Schedule.FIXED][1]
