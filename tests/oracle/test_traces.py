"""The rules of a simulation (docs/rules.md) are implemented in each engine. On all engines, the same worlds have the
same events at the same steps.

Events are read from the recorded frames of a world, one frame for each step (``support.traces``). Events are
placements, looks (regular checks of all boxes), drives (motions of the carrier), first signs of a failure, drops,
samples, and the end. Besides, the outcome of each engine must follow from the engine's own frames.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from support.fake_stepper import run_all
from support.plans import Box, make_scene, stack
from support.traces import Seen, every_step
from support.worlds import boxes_by_plan

from petmjx.common.units import STANDARD_GRAVITY
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Flag, Reason
from petmjx.options.quiet import Quiet
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.world.job import ACCELERATION, FORCE, Drive, Excitation, Job

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("ranks_may_differ")]

SHORT = Simulation(settle_s=0.3, rest_window_s=0.1, interval_s=0.3, longest_wait_s=0.6, duration_s=0.5)

SAME_TILT_DEG = 0.05
"""Tolerance of tilts. Frames of the other engines are float32, where the last digit of a quaternion near 0 is 0.01°."""
SAME_FORCE = 1e-5
"""Relative tolerance of forces that are sums in float32."""

LEFT_OUT = 0.93
"""Smallest share of the largest force on a box in all steps that the outcome must have, for forces above the weight of
a box. Engines leave out steps in which no box is accelerated upwards, so the outcome may miss the largest force."""

CAPACITY, BATCH = 2, 4
"""Number of boxes of the largest world on mjx-jax, and number of worlds. Programs take long to compile, and their steps
take long."""

NEAR = {
    ("mjx-warp", "static"): {"corner overhang of 70 %": 1},
    ("mjx-jax", "pushed"): {"corner overhang of 70 %": 1},
}
"""(engine, kind) → worlds whose events may be earlier or later, and by how many looks.

In these worlds a corner lands and slides. Engines know the excess acceleration of its friction only to a tolerance
(petmjx/world/contact_laws.py). On mjx-warp the corner's speed differs by 2 mm/s after that; with a twentieth of the
tolerance it does not. mjx-jax has another collider. On mjx-jax, the corner's position differs by some micrometres while
the box still tips, and then by more.

In all other worlds the events are at the same step. Events are at looks, at samples, or at steps that are known
beforehand. So float32 changes a step only if a speed or a pose at a look is within rounding of a threshold.
"""


def push(kind: str, level: float, rest_s: float, steps: int = 60, yaw_rad: float = 0.5) -> Drive:
    return Drive(Excitation("push", kind, np.tile([level, 0.0, 0.0], (steps, 1))), yaw_rad=yaw_rad, rest_s=rest_s)


ROCKS = push(ACCELERATION, 4.5, rest_s=0.1, steps=120, yaw_rad=0.0)
"""A drive that tilts the boxes of ``SLENDER`` by 9.6°, which is 80 mm at their tops. A tilt of 9.6° is about half the
tilt from which the boxes can return."""

SLENDER: dict[str, tuple[Box, ...]] = {
    "slender box": (((200.0, 300.0, 600.0), (500.0, 250.0, 0.0), 10.0),),
    "slender stack": tuple(((200.0, 300.0, 300.0), (500.0, 250.0, 300.0 * k), 10.0) for k in range(2)),
}


KINDS: dict[str, tuple[dict[str, Any], Drive | None]] = {
    "one by one": ({}, None),
    "static": ({"check": Check.STATIC}, None),
    "fixed": ({"schedule": Schedule.FIXED, "interval_s": 0.15}, None),
    "pushed": ({}, push(FORCE, 0.5, rest_s=0.1)),
    "braked": ({}, replace(push(ACCELERATION, 3.0, rest_s=0.5), allowed_sway_m=10.0)),  # a lost box does not end it
    "waited for in vain": ({"longest_wait_s": 0.02}, None),
    "shaken while boxes land": (
        {"schedule": Schedule.FIXED, "settle_s": 0.1, "quiet": Quiet(landing_steps=400)},
        push(FORCE, 0.5, rest_s=0.1),
    ),
    "rocks when time is up": ({"longest_wait_s": 0.3, "carrier": "euro-pallet"}, ROCKS),
}
"""Kind of worlds → (changed options, drive)."""

LARGER: dict[str, tuple[Box, ...]] = {
    "stack of 6": stack(6, kg=4.0),
    "stack of 5, one off": stack(5, 160.0),
    "bricks": tuple(
        ((300.0, 200.0, 150.0), (100.0 * (layer % 2) + 300.0 * k, 0.0, 150.0 * layer), 5.0)
        for layer in range(3)
        for k in range(2)
    ),
}


@dataclass(frozen=True, eq=False)
class Worlds:
    """Worlds of one kind: their options, their names, and their jobs."""

    sim: Simulation
    names: tuple[str, ...]
    jobs: tuple[Job, ...]

    def seen_on(self, engine: Engine) -> dict[str, Seen]:
        outcomes = run_all(engine, list(self.jobs), self.sim)
        return {
            name: Seen(job, self.sim, outcome)
            for name, job, outcome in zip(self.names, self.jobs, outcomes, strict=True)
        }


def worlds_of(kind: str) -> Worlds:
    changes, drive = KINDS[kind]
    sim, plans = SHORT.changed(**changes), SLENDER if drive is ROCKS else boxes_by_plan() | LARGER
    jobs = [Job(make_scene(boxes, sim), drive=drive, record=every_step(sim)) for boxes in plans.values()]
    return Worlds(sim, tuple(plans), tuple(jobs))


def warp_engine() -> Engine:
    from support.tiny_worlds import LONG_NS, engine

    return engine(slice_ns=LONG_NS)


ENGINES: dict[str, Callable[[], Engine]] = {"mujoco": lambda: MujocoEngine(1), "mjx-warp": warp_engine}


@functools.cache
def on_c(kind: str) -> dict[str, Seen]:
    return worlds_of(kind).seen_on(MujocoEngine(1))


@functools.cache
def on_warp(kind: str) -> dict[str, Seen]:
    pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
    return worlds_of(kind).seen_on(warp_engine())


@functools.cache
def on_jax(kind: str) -> dict[str, Seen]:
    """Simulate worlds of one kind on mjx-jax: of the worlds that are small enough, the last ones, as many as fit into
    one batch. Boxes fall and land in most of these worlds.
    """
    from petmjx.engines.mjx.engine import MjxJaxEngine

    worlds = worlds_of(kind)
    small = [k for k, job in enumerate(worlds.jobs) if job.scene.n_boxes <= CAPACITY][-BATCH:]
    some = Worlds(worlds.sim, *(tuple(values[k] for k in small) for values in (worlds.names, worlds.jobs)))
    return some.seen_on(MjxJaxEngine(BATCH))


ON = {"mujoco": on_c, "mjx-warp": on_warp, "mjx-jax": on_jax}
CASES = [(name, kind) for name in ON for kind in (("pushed",) if name == "mjx-jax" else KINDS)]


@pytest.mark.parametrize(("engine", "kind"), [(name, kind) for name, kind in CASES if name != "mujoco"])
def test_events_come_at_the_same_steps_as_on_c(engine: str, kind: str) -> None:
    for name, seen in ON[engine](kind).items():
        trace, exact = seen.trace, on_c(kind)[name].trace
        looks = NEAR.get((engine, kind), {}).get(name, 0)
        if looks:
            assert trace.near(exact, steps=looks * seen.sim.quiet.poll_steps), name
        else:
            assert trace == exact, name


@pytest.mark.parametrize(("engine", "kind"), CASES)
def test_outcomes_follow_from_frames(engine: str, kind: str) -> None:
    for name, seen in ON[engine](kind).items():
        outcome, boxes, trace = seen.outcome, seen.outcome.boxes, seen.trace
        assert (trace.end, trace.end) == (outcome.n_steps, seen.step_of(outcome.sim_time_s)), name
        np.testing.assert_allclose(boxes.max_tilt_deg, seen.tilt_deg(), atol=SAME_TILT_DEG, err_msg=name)
        share = boxes.max_top_force_n / np.fmax(seen.top_force_n(), 1e-6)
        assert (share <= 1 + SAME_FORCE).all(), name
        # On mjx-warp, frames of a drive have the forces of all steps, also of steps whose solver stopped far from
        # balance.
        known_n = np.fmin(seen.top_force_n(), on_c(kind)[name].top_force_n())
        pressed = known_n > seen.job.scene.mass.min() * STANDARD_GRAVITY
        assert (boxes.max_top_force_n[pressed] >= LEFT_OUT * known_n[pressed]).all(), name
        if not outcome.flags & Flag.EARLY_STOP:
            rest = boxes.rest_top_force_n
            np.testing.assert_allclose(rest, seen.rest_force_n(), rtol=SAME_FORCE, atol=1e-3, err_msg=name)
        if outcome.reason is not Reason.NONE:
            assert trace.sign[:2] == seen.first_sign(), name


@pytest.mark.parametrize("engine", ON)
def test_boxes_are_placed_on_quiet_pallets(engine: str) -> None:
    for name, seen in ON[engine]("pushed").items():
        for before, step in zip([0, *seen.placed], seen.placed, strict=False):
            assert step - before >= seen.sim.quiet.steps, name
            patient = not seen.outcome.flags & Flag.MOVING and not 0 < seen.trace.sign[0] < step
            if before and patient:
                assert seen.looks[step] >= seen.sim.quiet.steps, name


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp"])
def test_shift_is_judged_at_rest(engine: str) -> None:
    """Boxes rock far beyond the threshold. If they have enough time they return; if not, the outcome says that they
    move.

    How long they rock depends on the last digits, so it ends some looks earlier or later.
    """
    for name, seen in ON[engine]("rocks when time is up").items():
        outcome = seen.outcome
        assert outcome.boxes.max_sway_m.max() > 2 * seen.sim.thresholds.shift_m, name
        assert Flag.MOVING in outcome.flags, name
        last_s = seen.trace.driven[1] * seen.sim.physics.timestep_s + ROCKS.rest_s
        assert outcome.sim_time_s > last_s + seen.sim.longest_wait_s, name
    patient = worlds_of("rocks when time is up")
    sim = patient.sim.changed(longest_wait_s=5.0)
    jobs = [replace(job, record=None) for job in patient.jobs]
    for outcome in run_all(ENGINES[engine](), jobs, sim):
        assert (outcome.reason, outcome.flags, outcome.culprit, outcome.n_at_sign) == (Reason.NONE, Flag.NONE, -1, 0)
        assert outcome.boxes.max_sway_m.max() > 2 * sim.thresholds.shift_m
        assert np.abs(outcome.boxes.shift_m).max() == 0.0  # shifts below shift_floor_m count as 0


def test_the_worlds_show_what_the_rules_are_about() -> None:
    seen = [world for kind in KINDS for world in on_c(kind).values()]
    assert len(seen) >= 50
    assert {world.outcome.n_boxes for world in seen} >= {2, 3, 4, 5, 6}
    assert {world.outcome.reason for world in seen} >= {Reason.NONE, Reason.DROP, Reason.TILT, Reason.SHIFT}
    flags = [world.outcome.flags for world in seen]
    assert all(any(flag & world_flags for world_flags in flags) for flag in (Flag.EARLY_STOP, Flag.MOVING))
    assert sum(world.trace.driven[0] > 0 for world in seen) >= 20
    rests = [world.trace.end - world.trace.driven[1] for world in on_c("braked").values() if world.trace.driven[0] > 0]
    assert min(rest for rest in rests if rest >= 65) == 65  # some worlds end as soon as the drive allows
    assert max(rests) > 250  # and some end after the time of the drive, since a box moves
