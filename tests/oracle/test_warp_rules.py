"""The rules of mjx-warp compared with those of the batched engines, on random states. The two implementations are
independent."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds, upload_worlds
from petmjx.engines.mjx.world_state import State, Status, fresh_state
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.world.job import Job

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp
from support.fake_stepper import fake_scene

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp import world_arrays
from petmjx.engines.warp.compiled_programs import constants
from petmjx.engines.warp.kernels.rules import after_step
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import Model, Thread, Workspace, array_types, filled_record

set_up_warp()

WORLDS, BOXES = 1024, 4
SMALL, SMALL_HALF_M = np.arange(WORLDS) % 7 == 3, np.array([0.004, 0.012, 0.03])
"""(WORLDS,) which worlds have small boxes, and the half extents of these boxes, m."""
SAME = 1e-5
"""Tolerance of metrics, relative and absolute. Metrics are float32, and the two sides compute degrees in different
ways."""


@wp.func
def _one(
    model: Model,
    worlds: world_arrays.Worlds,
    state: world_arrays.State,
    work: Workspace,
    world: int,
    presses: bool,
    astray: bool,
) -> None:
    at = Thread()
    at.block = world
    at.thread = 0
    at.threads = 1
    at.world = world
    at.placed = state.placed[world]
    after_step(model, worlds, at, presses, astray, state, work)


def _all(
    model: Model,
    worlds: world_arrays.Worlds,
    state: world_arrays.State,
    work: Workspace,
    presses: wp.array[wp.bool],
    astray: wp.array[wp.bool],
) -> None:
    world = wp.tid()
    if state.status[world] == 0:
        _one(model, worlds, state, work, world, presses[world], astray[world])


@pytest.fixture(scope="module")
def kernel() -> Iterator[Any]:
    """The kernel of these tests, which runs only for moments. Without optimisation, it takes half as long to
    compile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warp.config.optimization_level", 0)
        yield with_cpp(_all, newton.source("block.cuh"))


def random_worlds(sim: Simulation, rng: np.random.Generator) -> tuple[Worlds, State, State]:
    """Return worlds of one to four boxes, their states after some step, and their states (poses) before that step."""
    jobs = [
        Job(fake_scene(*[1.0] * (1 + k % BOXES)), keep_state=k % 3 == 0, has_errors=k % 5 == 0) for k in range(WORLDS)
    ]
    worlds = upload_worlds(jobs, WORLDS, BOXES, {}, sim)
    aside = rng.normal(0, 0.02, (WORLDS, BOXES, 3)) * (np.arange(WORLDS) % 2)[:, None, None]
    drive_steps = rng.choice([20, 21, 300], WORLDS).astype(np.int32)
    allowed = jnp.asarray(rng.choice([0.0, 0.05], WORLDS), jnp.float32)
    confirm_steps = np.where(np.arange(WORLDS) % 4 == 1, CONFIRM_STEPS, NEVER).astype(np.int32)
    half = np.where(SMALL[:, None, None], SMALL_HALF_M, worlds.half)
    worlds = worlds._replace(
        half=jnp.asarray(half, jnp.float32),
        middle=jnp.asarray(aside, jnp.float32),
        drive_steps=jnp.asarray(drive_steps),
        allowed_sway=allowed,
        confirm_steps=jnp.asarray(confirm_steps),
    )
    table = fresh_state(worlds, all_placed=False, ends=jnp.full(WORLDS, NEVER, jnp.int32), rest_steps=1)

    def some(share: float, shape: Any = WORLDS) -> Any:
        return rng.random(shape) < share

    def pick(*values: int) -> Any:
        return rng.choice(values, WORLDS).astype(np.int32)

    n_boxes = np.asarray(worlds.n_boxes)
    every = sim.quiet.poll_steps
    step = pick(-150, 0, 1, every, 35, 37, 50, 100, 150, 200, 205, 250, 700, 710, 713)
    poses = []
    for _ in range(2):
        qpos = np.array(worlds.start)
        qpos[..., :3] += rng.normal(0, 1, qpos[..., :3].shape) * np.where(some(0.2, (WORLDS, 1, 1)), 0.05, 1e-4)
        qpos[..., 2] -= np.where(some(0.03, (WORLDS, BOXES)), 0.4, 0.0)
        turn = rng.normal(0, 1, (WORLDS, BOXES, 3)) * np.where(some(0.2, (WORLDS, 1, 1)), 0.2, 1e-4)
        quat = np.concatenate([np.ones((WORLDS, BOXES, 1)), turn], -1)
        qpos[..., 3:] = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
        poses.append(jnp.asarray(qpos, jnp.float32))
    # the boxes of some worlds are slow enough to be still, those of others only to be quiet, and the rest are fast
    slow = rng.choice([0.002, 0.05, 3.0], (WORLDS, 1, 1), p=[0.35, 0.35, 0.3]) * sim.quiet.quiet_m_s
    hard = np.where(some(0.3, (WORLDS, 1, 1)), 1000.0, 1.0) * np.ones(6)
    # small boxes turn fast: some of their corners are accelerated by more than gravity, and some are not
    distance_m = np.sqrt((SMALL_HALF_M**2).sum() - SMALL_HALF_M**2)  # of the corners from the three axes
    hard[SMALL] = np.concatenate([np.ones(3), 0.6 * sim.physics.gravity_m_s2 / distance_m])
    landed = np.maximum(step - pick(0, 5, 40, 90, 149, 150, 151), 0)
    if sim.check is Check.STATIC:
        landed[:] = 0
    driven = some(0.3)
    went = np.where(some(0.5, (WORLDS, 1, 1)), 1e-7, 1e-4)
    short = rng.choice([0.001, 1.0], (WORLDS, BOXES))  # boxes on short paths may stay, those on long ones may tremble
    placed = np.where(some(0.5) | driven, n_boxes, rng.integers(0, n_boxes + 1))
    end = np.where(some(0.3), step + pick(0, 1, 2, 30), NEVER)
    two_windows = 2 * build_timetable(sim, BOXES).rest_steps
    end = np.where(driven & some(0.4), step + pick(0, two_windows - 1, two_windows, 300), end)
    end = np.where((placed < n_boxes) & (end <= step), step + 30, end)  # no world ends before all boxes are placed
    culprit = np.where(some(0.2) | (driven & some(0.5)), 0, -1)
    after = table._replace(
        qpos=poses[0],
        qvel=jnp.asarray(rng.normal(0, 1, (WORLDS, BOXES, 6)) * slow, jnp.float32),
        qacc=jnp.asarray(rng.normal(0, 1, (WORLDS, BOXES, 6)) * hard, jnp.float32),
        qacc_warmstart=jnp.asarray(rng.normal(0, 1, (WORLDS, BOXES, 6)), jnp.float32),
        step=jnp.asarray(step),
        placed=jnp.asarray(placed, jnp.int32),
        last_placed_at=jnp.asarray(landed, jnp.int32),
        quiet_steps=jnp.asarray(pick(0, every, sim.quiet.steps - every, sim.quiet.steps)),
        waits_since=jnp.asarray(np.where(some(0.6), landed, np.maximum(landed, step - pick(0, 5, 20, 60))), jnp.int32),
        quiet_speed=jnp.asarray(0.01 * rng.random((WORLDS, BOXES)), jnp.float32),
        still_qpos=poses[0].at[..., :3].add(rng.normal(0, 1, (WORLDS, BOXES, 3)) * went),
        tremble_looks=jnp.asarray(pick(0, 3, 4, 5, 8)),
        trembles=jnp.asarray(rng.choice(3, (WORLDS, BOXES), p=[0.6, 0.2, 0.2]), jnp.int32),
        tremble_path=jnp.asarray(0.002 * rng.random((WORLDS, BOXES)) * short, jnp.float32),
        tremble_away=jnp.asarray(0.0005 * rng.random((WORLDS, BOXES)) * short, jnp.float32),
        tremble_qpos=poses[0].at[..., :3].add(rng.normal(0, 1, (WORLDS, BOXES, 3)) * went),
        violent_since=jnp.asarray(np.where(some(0.5), NEVER, step - pick(5, 49, 50, 100)), jnp.int32),
        driven_from=jnp.asarray(np.where(driven, step - 20, NEVER), jnp.int32),
        rest_from=jnp.asarray(np.where(end == NEVER, NEVER, step + pick(-9, -1, 0, 1)), jnp.int32),
        end=jnp.asarray(end, jnp.int32),
        metrics=table.metrics._replace(
            culprit=jnp.asarray(culprit, jnp.int32),
            sign_step=jnp.asarray(step - pick(0, CONFIRM_STEPS - 1, CONFIRM_STEPS, 90), jnp.int32),
            sign_placed=jnp.asarray(np.where(culprit < 0, 0, rng.integers(0, placed + 1)), jnp.int32),
            sway_anchor=jnp.asarray(poses[1][..., :2] + rng.normal(0, 0.03, (WORLDS, BOXES, 2)), jnp.float32),
        ),
    )
    stands = np.arange(BOXES) < placed[:, None]
    max_tilt = stands * rng.choice([0.1, 0.9, 1.1], stands.shape, p=[0.7, 0.2, 0.1]) * sim.thresholds.tilt_deg
    drop_step = np.where(stands & some(0.02, stands.shape), 1, -1)
    metrics = after.metrics._replace(
        max_tilt=jnp.asarray(max_tilt, jnp.float32), drop_step=jnp.asarray(drop_step, jnp.int32)
    )
    after = after._replace(metrics=metrics)
    return worlds, after, after._replace(qpos=poses[1])


CONFIRM_STEPS = 20
"""Number of steps after the first sign from which the fall is confirmed in some worlds."""

LIMIT = 1000
"""Largest number of solver iterations of a world in one of the cases."""

PER_BOX = "quiet_speed", "still_qpos", "trembles", "tremble_path", "tremble_away", "tremble_qpos"

CASES = [
    {},
    {"early_stop": False, "schedule": Schedule.FIXED},
    {"check": Check.STATIC, "duration_s": 0.3},
    {"check": Check.STATIC, "duration_s": 0.3, "schedule": Schedule.FIXED},
    {"physics": "reference"},
    {"iteration_limit": LIMIT},
    {"physics": {"gravity_m_s2": 20.0}},
]


@pytest.mark.slow
@pytest.mark.parametrize("changes", CASES, ids=lambda changes: "-".join(map(str, changes)) or "default")
def test_every_world_is_as_the_batched_rules_leave_it(kernel: Any, changes: dict[str, Any]) -> None:
    quiet = {"tremble_steps": 20}
    sim = Simulation(interval_s=0.3, sample_interval_s=0.05, settle_s=0.4, quiet=quiet).changed(**changes)
    timetable = build_timetable(sim, BOXES)
    rng = np.random.default_rng(5)
    worlds, after, before = random_worlds(sim, rng)
    top_force = jnp.asarray(rng.random((WORLDS, BOXES)), jnp.float32)
    # A world that goes astray has no finite numbers. The carrier of a world that goes astray has a velocity that no
    # real world has.
    astray, presses = rng.random(WORLDS) < 0.05, rng.random(WORLDS) < 0.5
    counts = np.random.default_rng(6)
    after = after._replace(iterations_done=jnp.asarray(counts.integers(0, LIMIT + LIMIT // 20, WORLDS, np.int32)))
    iterations = counts.integers(0, 5, WORLDS, np.int32)  # of the last step
    after = after._replace(carrier_qvel=after.carrier_qvel.at[:, 2].set(jnp.where(astray, 1e12, 0.0)))
    expected = as_batched(sim, worlds, after, before, top_force, jnp.asarray(presses))

    sizes = world_arrays.axes(WORLDS, BOXES, boards=1, npairmax=1, nconmax=1)
    with wp.ScopedDevice("cpu"):
        model = filled_record(
            Model,
            {
                **constants(sim, timetable),
                "queue": 0,
                "most_idle": NEVER,
                "most_placed": NEVER,
                "npairmax": 1,
                "nconmax": 1,
            },
        )
        flat = after.flat()
        flat["step"] = after.step - 1
        flat["iterations_done"] = after.iterations_done - iterations
        flat_worlds = worlds.flat() | {"profiles": np.zeros((1, 1, 3)), "order": np.zeros((1, 1))}
        state = device_record(world_arrays.State, flat)
        buffer = wp.zeros((world_arrays.buffer_rows(sizes), world_arrays.BUFFER_WORDS), dtype=float)
        work = filled_record(Workspace, world_arrays.in_buffer(buffer, sizes))
        work.qpos_before.assign(np.asarray(before.qpos))
        work.top_force.assign(np.asarray(top_force))
        work.solver_niter.assign(iterations)
        inputs = [model, device_record(world_arrays.Worlds, flat_worlds), state, work]
        steps = np.asarray(after.step)
        samples = (steps > 0) & (steps % timetable.sample_every == 0)  # forces of samples count (world_loop.py)
        inputs += [wp.array(mask, dtype=wp.bool) for mask in (presses | samples, astray)]
        wp.launch(kernel, dim=WORLDS, inputs=inputs)
        fields = {name: getattr(state, name).numpy() for name in flat}

    expected_fields = expected.flat()
    # the still poses of worlds that have ended are never read
    ended = (fields["status"] != Status.RUNNING)[:, None, None]
    fields["still_qpos"], expected_fields["still_qpos"] = (
        np.where(ended, 0.0, poses) for poses in (fields["still_qpos"], expected_fields["still_qpos"])
    )
    is_placed = np.arange(BOXES) < np.asarray(after.placed)[:, None]
    for name, values in expected_fields.items():
        if name in PER_BOX:  # numbers of boxes that are not placed mean nothing
            these = is_placed.reshape(*is_placed.shape, *[1] * (values.ndim - 2))
            fields[name], values = np.where(these, fields[name], 0.0), np.where(these, values, 0.0)
        if values.dtype == np.int32:
            np.testing.assert_array_equal(fields[name], values, err_msg=name)
        else:
            np.testing.assert_allclose(fields[name], values, rtol=SAME, atol=SAME, err_msg=name)
    # The states lead to all that the rules can do.
    adapts = sim.schedule is Schedule.ADAPTIVE and sim.waits_for_rest
    assert set(np.unique(fields["status"]).tolist()) == {Status.RUNNING, Status.SETTLED, Status.FINISHED}
    assert (fields["placed"] > np.asarray(after.placed)).any()
    assert (fields["rest_from"] != np.asarray(after.rest_from)).any()
    # Some boxes begin to tremble or to stay, and some boxes stop.
    trembled = np.asarray(after.trembles)
    assert {-2, -1, 1, 2} <= set(np.unique((fields["trembles"] - trembled)[is_placed])) or not adapts
    # In drives (motions of the carrier), some worlds rest before the end, and some worlds that rested move again.
    was, now = np.asarray(after.end), fields["end"]
    assert ((now < was) & (was != NEVER)).any() == adapts
    assert ((now > was) & (now != NEVER)).any() == sim.waits_for_rest
    # Some worlds go on at their end although no box has moved since its pose was kept.
    last = (np.asarray(after.step) > 0) & (was <= np.asarray(after.step)) & (fields["status"] == Status.RUNNING)
    way = np.asarray(motion.moved(after.still_qpos, after.qpos, worlds.half))
    has_moved = (is_placed & (way > sim.quiet.still_m_s * timetable.still_steps * sim.physics.timestep_s)).any(axis=1)
    assert (last & ~has_moved).any() == sim.waits_for_rest
    for flag in (Flag.EXPLOSION, Flag.NONFINITE, *((Flag.EARLY_STOP,) if sim.early_stop else ())):
        assert (fields["flags"] & int(flag)).any(), flag
    over = (fields["iterations_done"] >= LIMIT) & (sim.iteration_limit is not None)
    spent = fields["flags"] & int(Flag.ITERATION_LIMIT) != 0
    assert spent.any() == (sim.iteration_limit is not None)
    assert (fields["status"] == Status.FINISHED)[spent].all()
    assert not spent[~over].any()
    stopped = ~over & (fields["flags"] & int(Flag.EARLY_STOP) != 0)
    dropped = (fields["drop_step"] >= 0).any(axis=1)
    lost, driven = stopped & ~dropped, np.asarray(after.driven_from) != NEVER
    by_culprit = driven & (np.asarray(after.metrics.culprit) >= 0)
    with_errors, confirms = np.asarray(worlds.ends_when_lost), np.asarray(worlds.confirm_steps) != NEVER
    assert not lost[~(with_errors | by_culprit | confirms)].any()
    assert (lost & with_errors).any() == sim.early_stop
    assert (lost & ~with_errors & ~confirms).any() == (sim.early_stop and sim.waits_for_rest)
    assert (lost & confirms & ~with_errors & ~driven).any() == sim.early_stop
    # In other worlds the culprit (box 0) has tilted beyond the threshold at a look, and its sway is still allowed.
    tilted = np.asarray(motion.tilt_deg(after.qpos[..., 3:]))[:, 0] > sim.thresholds.tilt_deg
    step = np.asarray(after.step)
    looked = (step > 0) & (step % sim.quiet.poll_steps == 0) & (step % timetable.sample_every != 0)
    held = by_culprit & tilted & looked & (fields["status"] == Status.RUNNING) & (np.asarray(worlds.allowed_sway) > 0)
    assert held.any()


def device_record(kind: Any, values: Any) -> Any:
    """Return a record on Warp's device, filled with arrays by name."""
    types = array_types(kind)
    return filled_record(kind, {name: wp.array(np.asarray(values[name]), dtype=types[name].dtype) for name in types})


def as_batched(sim: Simulation, worlds: Worlds, after: State, before: State, *pressing: Any) -> State:
    """Return the states that the batched rules give for the same worlds.

    One set of rules is for worlds that place boxes, and another for settled worlds with a drive.
    """
    timetable = build_timetable(sim, BOXES)
    with jax.numpy_rank_promotion("allow"):
        placing, driving = (
            Rules(sim, timetable, BOXES, driven=driven).after_step(after, worlds, before.qpos, after.qacc, *pressing)
            for driven in (False, True)
        )
    is_driven = after.driven_from != NEVER

    def chosen(one: jax.Array, other: jax.Array) -> jax.Array:
        return jnp.where(is_driven.reshape(-1, *[1] * (one.ndim - 1)), one, other)

    state: State = jax.tree.map(chosen, driving, placing)
    return state
