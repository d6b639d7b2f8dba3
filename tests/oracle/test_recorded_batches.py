"""Histories (recorded frames of worlds) of the MJX engines.

The frames come from batches of a fake stepper, which has no physics, and from mjx-warp on the CPU.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from support.fake_stepper import FakeEngine, assert_same, fake_scene, run_all
from support.histories import assert_equal, history_of
from support.plans import make_scene, stack

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Check, Simulation
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.release_places import release_of

pytestmark = pytest.mark.usefixtures("ranks_may_differ")

RECORD = Record(0.05)
EVERY = 25
"""Number of steps between two frames."""
SIM = Simulation(interval_s=0.3, settle_s=0.3, rest_window_s=0.1, duration_s=0.5)
SHAKE = Drive(Excitation("shake", "force", np.tile([0.5, 0.0, 0.0], (60, 1))), scale=2.0, yaw_rad=0.5, rest_s=0.1)

SCENES = [fake_scene(*masses) for masses in ([30.0, 70.0, 10.0], [10.0], [20.0, 1000.0, 5.0], [5.0] * 5)]
"""Boxes of the fake stepper tremble for as many steps as their mass in kg. The box with 1000 kg falls."""

SAME_PLACE_M = 1e-3
"""Tolerance of positions. The contacts are the same as in C MuJoCo. Soft contacts give way, and in float32 boxes settle
elsewhere within that distance."""
SAME_FORCE = 0.05
SMALL_FORCE_N = 5.0
"""Tolerance of forces of impacts. A box weighs 49 N."""


FRAME_M = 1.2e-7
"""Largest difference between a position in a frame and in an outcome, m: frames are in single precision."""


@functools.cache
def fake() -> FakeEngine:
    """The engine of all these tests, since programs take long to compile."""
    return FakeEngine()


@functools.cache
def found() -> list[Outcome]:
    """Outcomes of all scenes, with frames."""
    return run_all(fake(), recorded([Job(scene) for scene in SCENES]), SIM)


def recorded(jobs: list[Job]) -> list[Job]:
    return [Job(job.scene, drive=job.drive, keep_state=job.keep_state, record=RECORD) for job in jobs]


def frame_steps(outcome: Outcome) -> list[int]:
    steps: list[int] = np.round(history_of(outcome).time_s / SIM.physics.timestep_s).astype(int).tolist()
    return steps


def assert_ends(outcome: Outcome) -> None:
    """Assert that the last frame is the last state of the world."""
    history, placed = history_of(outcome), slice(outcome.n_placed)
    np.testing.assert_allclose(history.pos[-1, placed], outcome.boxes.pos[placed], rtol=0, atol=FRAME_M)
    np.testing.assert_array_equal(history.quat[-1, placed], outcome.boxes.quat[placed])
    assert (history.n_placed[-1], history.time_s[-1]) == (outcome.n_placed, outcome.sim_time_s)


def test_a_recorded_batch_is_the_same_to_the_last_bit() -> None:
    plain = run_all(fake(), [Job(scene) for scene in SCENES], SIM)
    jobs = [Job(scene, record=RECORD if k != 1 else None) for k, scene in enumerate(SCENES)]
    for some in (found(), run_all(fake(), jobs, SIM)):
        for one, other in zip(some, plain, strict=True):
            assert_same(one, other)
            assert one.flags == other.flags
            if one.history is not None:
                assert_ends(one)
    assert [outcome.history is None for outcome in some] == [False, True, False, False]


def test_frames_come_in_time() -> None:
    for scene, outcome in zip(SCENES, found(), strict=True):
        history, steps = history_of(outcome), frame_steps(outcome)
        placements = [steps[int(np.argmax(history.n_placed > box))] for box in range(outcome.n_placed)]
        regular = range(-(-steps[0] // EVERY) * EVERY, steps[-1] + 1, EVERY)
        assert steps == sorted({*placements, *regular, steps[-1]})
        for box, begin in enumerate(placements):
            frames = slice(steps.index(begin), None)
            # with the fake stepper the force on a box's top is its age in steps
            np.testing.assert_array_equal(history.top_force_n[frames, box], np.array(steps[frames]) - begin)
            np.testing.assert_allclose(history.pos[frames][0, box], release_of(scene, SIM).pos[box], rtol=1e-6)
            assert np.isnan(history.top_force_n[: steps.index(begin), box]).all()


def test_a_static_world_is_seen_from_its_beginning_on() -> None:
    (outcome,) = run_all(fake(), recorded([Job(SCENES[3])]), SIM.changed(check=Check.STATIC))
    assert frame_steps(outcome)[:3] == [0, EVERY, 2 * EVERY]
    assert_ends(outcome)


def test_a_fork_goes_on_from_the_frames_of_its_placement() -> None:
    """A fork (a world that continues from a kept state) has frames from the end of the placements on.

    With the fake stepper a drive moves boxes along by as much as it pushes.
    """
    scene = SCENES[3]
    (placed,) = run_all(fake(), [Job(scene, keep_state=True, record=RECORD)], SIM)
    fork, full_run = (
        run_all(fake(), [Job(scene, start=start, drive=SHAKE, record=RECORD)], SIM)[0] for start in (placed.state, None)
    )
    began = history_of(fork)
    assert np.isnan(began.top_force_n[0]).all()
    assert began.time_s[0] == history_of(placed).time_s[-1]
    joined = history_of(placed).then(began)
    assert_equal(joined, history_of(full_run))
    pushed = joined.drive.any(axis=1)
    expected = 2.0 * 0.5 * SHAKE.unit(scene.total_mass) * np.array([np.cos(0.5), np.sin(0.5), 0.0])
    np.testing.assert_allclose(joined.drive[pushed], np.tile(expected, (pushed.sum(), 1)))
    assert 0 < pushed.sum() < len(pushed)
    assert_ends(fork)


# ---------------------------------------------------------------------- mjx-warp


def warp_engine(**options: Any) -> Any:
    pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
    from petmjx.engines.warp.engine import MjxWarpEngine

    return MjxWarpEngine(16, allow_cpu=True, **options)


@functools.cache
def piles() -> list[Job]:
    """Return jobs with a pile that stands, a pile that falls, and a box that is shaken."""
    boxes = [stack(2), stack(3, 260.0), stack(1)]
    scenes = [make_scene(some, SIM) for some in boxes]
    return [Job(scenes[0]), Job(scenes[1]), Job(scenes[2], drive=SHAKE)]


@functools.cache
def plain_piles() -> list[Outcome]:
    return run_all(warp_engine(slice_ns=10**15), piles(), SIM)


@pytest.mark.slow
@pytest.mark.parametrize("device", ["here", pytest.param("gpu", marks=pytest.mark.gpu)])
@pytest.mark.parametrize("room", [None, 2], ids=["room", "little room"])
def test_recorded_worlds_of_warp_are_the_same_to_the_last_bit(
    room: int | None, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = warp_engine(slice_ns=300_000)
    from petmjx.engines.warp import frame_buffers

    if room is not None:
        monkeypatch.setattr(frame_buffers, "FRAMES_PER_WORLD", 0)
        monkeypatch.setattr(frame_buffers, "FRAMES_PER_LANE", room)
    batched = run_all(engine, recorded(piles()), SIM)
    exact = run_all(MujocoEngine(1), recorded(piles()), SIM)
    for one, plain, twin in zip(batched, plain_piles(), exact, strict=True):
        assert_same(one, plain)
        assert one.flags == plain.flags
        assert_ends(one)
        compare(one, twin)
    (alone,) = run_all(engine, recorded(piles())[1:2], SIM)
    assert_equal(history_of(alone), history_of(batched[1]))


def compare(outcome: Outcome, twin: Outcome) -> None:
    """Compare frames with those on C MuJoCo, until boxes slide or fall.

    Boxes that slide or fall cannot be compared in detail.
    """
    ours, theirs = history_of(outcome), history_of(twin)
    begins_s = [history.time_s[history.drive.any(axis=1)].min(initial=np.inf) for history in (ours, theirs)]
    until_s = np.nanmin([outcome.first_sign_s, *begins_s])
    k = int((ours.time_s < until_s - 0.1).sum())
    assert k > 1
    np.testing.assert_allclose(ours.time_s[:k], theirs.time_s[:k], atol=1e-9)
    np.testing.assert_array_equal(ours.n_placed[:k], theirs.n_placed[:k])
    np.testing.assert_allclose(ours.pos[:k], theirs.pos[:k], atol=SAME_PLACE_M)
    np.testing.assert_allclose(ours.top_force_n[:k], theirs.top_force_n[:k], rtol=SAME_FORCE, atol=SMALL_FORCE_N)
    np.testing.assert_allclose(ours.drive.max(axis=0), theirs.drive.max(axis=0))


@pytest.mark.slow
def test_room_is_next_to_nothing_where_no_world_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = warp_engine()
    rollout = pytest.importorskip("petmjx.engines.warp.time_slices").Rollout
    wait, rooms = rollout.wait, []

    def watched(self: Any, group: Any) -> Any:
        status, ended = wait(self, group)
        rooms.append((len(ended.frames["of"]), int(ended.frames["used"][0])))
        return status, ended

    monkeypatch.setattr(rollout, "wait", watched)
    run_all(engine, piles()[:1], SIM)
    assert set(rooms) == {(1, 0)}
