"""Rules and batches of mjx-jax, compared with a plain loop over one world.

The rules and the plain loop use a fake stepper, which has no physics: a box trembles for a number of steps that its
mass gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from support.fake_stepper import (
    CARRIER_KG,
    CREEP_M,
    FALLS_KG,
    SWAYS_KG,
    FakeEngine,
    assert_same,
    fake_scene,
    run_all,
)

from petmjx.engines.mjx.engine import FEWEST_WORLDS, batch_groups
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.world.job import Drive, Excitation, Job

DT = 0.002
SHORT = Simulation(interval_s=0.3, longest_wait_s=0.6, sample_interval_s=0.05, duration_s=0.5, settle_s=0.4)
FORCE_RELATIVE = 1e-5
"""Relative tolerance of forces at rest, which are float32 sums of whole numbers, divided by their count."""


@dataclass
class Plain:
    """The events of one world.

    ``placed_at`` has the step after which each box is placed, and ``end`` the last step. ``moving`` is True if a box
    was placed while another box moved, or if a box moves at the end.
    """

    placed_at: list[int]
    end: int
    moving: bool


def plainly(masses: Sequence[float], sim: Simulation, *, sways: bool = False) -> Plain:
    """Apply the rules step by step to a world of the fake stepper's boxes, in float64 as MuJoCo's clock runs.

    Args:
        sways: If True, boxes return to their places when they come to rest. If False, boxes tremble at their places.
    """
    n, adaptive = len(masses), sim.schedule is not Schedule.FIXED
    static = sim.check is Check.STATIC
    rest_steps = int(sim.rest_window_s / DT)
    placed_at = [0] * n if static else []
    fixed_end = int((sim.duration_s if static else (n + 1) * sim.interval_s) / DT)
    limit_s = sim.duration_s if static else sim.longest_wait_s if adaptive else sim.interval_s
    step, time_s, last_s, last, quiet, moving = 0, 0.0, 0.0, 0, 0, False
    end = None if adaptive else fixed_end
    while True:
        step, time_s = step + 1, time_s + DT
        trembles = [step - at < mass for at, mass in zip(placed_at, masses, strict=False)]
        if static:
            trembles = [step + 200 < mass for mass in masses]
        polled = step % sim.quiet.poll_steps == 0
        if polled:
            quiet = 0 if any(trembles) else quiet + sim.quiet.poll_steps
        in_vain = adaptive and moving and len(placed_at) < n
        due = time_s - last_s >= (sim.interval_s if in_vain else limit_s)
        if adaptive:
            due = due or (polled and quiet >= sim.quiet.steps)
        if due and len(placed_at) < n:
            moving = moving or quiet < sim.quiet.steps
            placed_at.append(step)
            last, last_s, quiet = step, time_s, 0
        elif due and end is None:
            end = max(step, last + sim.quiet.landing_steps) + rest_steps
        if step == end:
            moves = any(trembles)
            if sways:  # a box that has returned since the first look at the end has moved
                since = step - sim.quiet.still_steps
                moves = any(since - at < mass for at, mass in zip(placed_at, masses, strict=True))
            limit_s = sim.duration_s if static else sim.longest_wait_s
            if not moves or time_s - last_s >= limit_s:
                return Plain(placed_at, step, moving or moves)
            # the world goes on until its boxes are quiet, also with the fixed schedule
            adaptive, quiet, end = True, 0, None


def placements(outcome: Outcome, sim: Simulation) -> np.ndarray:
    """Return the steps at which boxes were placed, from their forces at rest.

    With the fake stepper, such a force is the mean age (number of steps since its placement) of a box over the rest
    window.
    """
    mean_age = outcome.boxes.rest_top_force_n
    middle = outcome.n_steps - (int(sim.rest_window_s / DT) - 1) / 2
    return middle - mean_age


LANES = 16


@pytest.fixture(scope="module")
def engine() -> FakeEngine:
    """The engine of all these tests. Programs take long to compile, so batches are as large as the engine makes them.
    The 40 worlds make three batches of two sizes."""
    return FakeEngine(LANES)


MASSES = [
    tuple(float(mass) for mass in np.random.default_rng(world).choice([1, 20, 47, 90, 149, 160, 400], 1 + world % 5))
    for world in range(40)
]


@pytest.mark.parametrize("schedule", list(Schedule))
def test_every_world_follows_the_rules_to_the_step(engine: FakeEngine, schedule: Schedule) -> None:
    sim = SHORT.changed(schedule=schedule)
    for masses, outcome in zip(MASSES, run_all(engine, [Job(fake_scene(*m)) for m in MASSES], sim), strict=True):
        expected = plainly(masses, sim)
        assert outcome.n_steps == expected.end
        assert outcome.n_placed == len(masses)
        assert bool(outcome.flags & Flag.MOVING) is expected.moving
        np.testing.assert_allclose(placements(outcome, sim), expected.placed_at, rtol=FORCE_RELATIVE, atol=0.01)
        assert outcome.verdict is Verdict.STABLE
        assert outcome.sim_time_s == pytest.approx(expected.end * DT)


def test_a_shift_is_judged_at_rest(engine: FakeEngine) -> None:
    """If a moving box is beyond the threshold of shift, the world waits until it rests, as for a box that moves at its
    place."""
    swaying = [tuple(mass + SWAYS_KG * (mass > 47) for mass in masses) for masses in MASSES]
    times = [tuple(float(np.ceil(mass)) for mass in masses) for masses in swaying]
    outcomes = run_all(engine, [Job(fake_scene(*masses)) for masses in swaying], SHORT)
    reasons = set()
    for masses, outcome in zip(times, outcomes, strict=True):
        expected = plainly(masses, SHORT, sways=True)
        ends_aside = any(expected.end - at < mass for at, mass in zip(expected.placed_at, masses, strict=True))
        assert (outcome.n_steps, outcome.reason) == (expected.end, Reason.SHIFT if ends_aside else Reason.NONE)
        assert bool(outcome.flags & Flag.MOVING) is expected.moving
        np.testing.assert_allclose(placements(outcome, SHORT), expected.placed_at, rtol=FORCE_RELATIVE, atol=0.01)
        assert (outcome.culprit >= 0) is ends_aside
        reasons.add(outcome.reason)
    assert reasons == {Reason.NONE, Reason.SHIFT}


def test_fixed_intervals_are_whole_steps_of_the_running_clock() -> None:
    sim = Simulation(schedule=Schedule.FIXED, interval_s=0.5)
    masses = [1.0] * 5
    (outcome,) = run_all(FakeEngine(), [Job(fake_scene(*masses))], sim)
    expected = plainly(masses, sim)
    assert outcome.n_steps == expected.end == int(6 * 0.5 / DT)
    np.testing.assert_allclose(placements(outcome, sim), expected.placed_at, rtol=FORCE_RELATIVE, atol=0.01)


@pytest.mark.parametrize("schedule", list(Schedule))
def test_a_static_world_stands_from_the_soft_start_on(schedule: Schedule) -> None:
    sim = SHORT.changed(check=Check.STATIC, schedule=schedule)
    worlds = [(1.0, 1.0), (300.0, 1.0), (900.0, 1.0, 1.0), (1.0,)]
    outcomes = run_all(FakeEngine(), [Job(fake_scene(*masses)) for masses in worlds], sim)
    for masses, outcome in zip(worlds, outcomes, strict=True):
        assert outcome.n_steps == plainly(masses, sim).end
        # the 200 steps of the soft start count for the age of a box, and not for the time of the world
        np.testing.assert_allclose(placements(outcome, sim), -200, rtol=FORCE_RELATIVE, atol=0.01)


def test_the_shape_of_the_batch_does_not_matter(engine: FakeEngine) -> None:
    jobs = [Job(fake_scene(*masses)) for masses in MASSES if len(masses) <= 4]  # one size: fewer programs to compile
    expected = run_all(engine, jobs, SHORT)
    for jobs_there, lanes in ((jobs[:7], 3), (jobs[4:5], 1)):
        first = jobs.index(jobs_there[0])
        for k, outcome in enumerate(run_all(FakeEngine(lanes), jobs_there, SHORT)):
            assert_same(outcome, expected[first + k])


def test_a_batch_has_worlds_that_are_alike() -> None:
    """The worlds have similar numbers of boxes and the same kind of drive (motion of the carrier).

    Worlds that begin from a kept state, with all boxes placed, are not mixed with others.
    """
    drives = {kind: pushes(kind, 1, 0.1) for kind in ("force", "acceleration")}
    (kept,) = run_all(FakeEngine(), [Job(fake_scene(1.0), keep_state=True)], SHORT)
    jobs = [Job(fake_scene(*[1.0] * n)) for n in (1, 9, 4, 5, 8, 16)]
    jobs += [Job(jobs[0].scene, drive, start=start) for drive in drives.values() for start in (None, kept.state)]
    assert batch_groups(jobs) == [[1, 5], [3, 4], [0, 2], [6], [7], [8], [9]]


def test_a_fall_is_seen_at_the_next_sample_and_ends_the_world(engine: FakeEngine) -> None:
    jobs = LANES // 2 * [Job(fake_scene(1.0, FALLS_KG, 1.0)), Job(fake_scene(1.0, 1.0, 1.0))]
    *_, fallen, standing = run_all(engine, jobs, SHORT)
    assert (fallen.verdict, fallen.reason, fallen.culprit) == (Verdict.UNSTABLE, Reason.DROP, 1)
    assert fallen.flags & Flag.EARLY_STOP
    assert fallen.n_placed == 2
    # the box has shifted by 20 mm after two steps, and the next sample, every 25 steps, shows it
    placed_at = plainly((1.0, FALLS_KG), SHORT).placed_at[1]
    assert placed_at < fallen.first_sign_s / DT <= placed_at + 28
    assert fallen.n_steps % 25 == 0
    assert fallen.boxes.drop_s[1] == pytest.approx(fallen.n_steps * DT)
    assert np.isnan(fallen.boxes.rest_top_force_n).all()
    assert (standing.verdict, standing.culprit) == (Verdict.STABLE, -1)
    assert np.isnan(standing.first_sign_s)
    assert standing.n_steps == plainly((1.0, 1.0, 1.0), SHORT).end, "although others in the batch have ended"
    on = SHORT.changed(early_stop=False)
    (full_run,) = run_all(engine, jobs[:1], on)
    assert full_run.n_placed == 3
    assert (full_run.reason, full_run.culprit) == (Reason.DROP, 1)
    assert np.isfinite(full_run.boxes.rest_top_force_n).all()


# ---------------------------------------------------------------------- drives and forks


def pushes(kind: str, steps: int, level: float, rest_s: float = 0.2) -> Drive:
    return Drive(
        Excitation("push", kind, np.tile([level, 0.0, 0.0], (steps, 1))), scale=2.0, yaw_rad=0.3, rest_s=rest_s
    )


def sway_of(drive: Drive, total_kg: float) -> float:
    """Return how far the fake stepper's boxes move in a drive: along the push, whatever its direction."""
    level = float(np.abs(drive.excitation.samples).sum()) * drive.scale
    return CREEP_M * level * (total_kg * 9.80665 if drive.excitation.kind == "force" else 1.0)


@pytest.mark.parametrize("kind", ["force", "acceleration"])
def test_a_drive_starts_when_the_pallet_is_quiet_and_lasts_as_long_as_its_profile(
    engine: FakeEngine, kind: str
) -> None:
    level = 0.01 if kind == "force" else 5.0
    drives = [pushes(kind, steps, level) for steps in range(30, 30 + 2 * LANES, 2)]
    masses = LANES // 2 * [(1.0, 60.0, 1.0), (1.0, 90.0)]
    jobs = [Job(fake_scene(*m), drive) for m, drive in zip(masses, drives, strict=True)]
    for m, drive, outcome in zip(masses, drives, run_all(engine, jobs, SHORT), strict=True):
        assert outcome.n_steps == plainly(m, SHORT).end + len(drive.excitation.samples) + 100
        np.testing.assert_allclose(outcome.boxes.max_sway_m, sway_of(drive, sum(m) + CARRIER_KG), rtol=0.01)


def plain_drive_end(masses: Sequence[float], drive: Drive, sim: Simulation) -> int:
    """Return the last step of a world with a drive, found step by step with the fake stepper's boxes."""
    placed, window = plainly(masses, sim), int(sim.rest_window_s / DT)
    since = placed.end + len(drive.excitation.samples)
    last = since + int(drive.rest_s / DT)
    latest = last + int(sim.longest_wait_s / DT)
    step, quiet = since, 0
    while True:
        step += 1
        trembles = any(step - at < mass for at, mass in zip(placed.placed_at, masses, strict=True))
        if step == last:
            if not trembles:
                return last
            quiet = 0  # a box moves, so another wait begins
        elif step % sim.quiet.poll_steps == 0:
            quiet = 0 if trembles else quiet + sim.quiet.poll_steps
        # a rest window may begin earlier only if it ends before the last one begins
        waits = step <= last - 2 * window or step > last
        if waits and (quiet >= sim.quiet.steps or step >= latest):
            return step + window


def test_a_drive_ends_when_the_pallet_is_quiet_and_later_than_its_time_only_if_a_box_moves(engine: FakeEngine) -> None:
    """The longest wait ends before the boxes are quiet, so they still tremble when the drive begins."""
    last_masses, shaken, rest_s = (1.0, 460.0, 500.0, 620.0, 660.0, 800.0), 30, (0.2, 0.4, 0.5, 1.0)
    cases = [((1.0, mass), pushes("force", shaken, 0.01, rest)) for mass in last_masses for rest in rest_s]
    outcomes = run_all(engine, [Job(fake_scene(*masses), drive) for masses, drive in cases], SHORT)
    saved = []
    for (masses, drive), outcome in zip(cases, outcomes, strict=True):
        assert outcome.n_steps == plain_drive_end(masses, drive, SHORT)
        placed = plainly(masses, SHORT)
        in_time = placed.end + shaken + int(drive.rest_s / DT)
        saved.append(in_time - outcome.n_steps)
        assert (saved[-1] < 0) is (in_time - placed.placed_at[-1] < masses[-1])
    assert min(saved) < 0 < max(saved)
    assert len(set(saved)) > 4


@pytest.mark.parametrize("kind", ["force", "acceleration"])
def test_forks_share_one_settled_state_and_equal_whole_runs(engine: FakeEngine, kind: str) -> None:
    level = 0.01 if kind == "force" else 5.0
    scene = fake_scene(1.0, 60.0, 30.0)
    (kept,) = run_all(engine, [Job(scene, keep_state=True)], SHORT)
    assert kept.state is not None
    drives = [pushes(kind, 20 + steps, level) for steps in range(20)]
    full_runs = run_all(engine, [Job(scene, drive) for drive in drives], SHORT)
    forks = run_all(engine, [Job(scene, drive, start=kept.state) for drive in drives], SHORT)
    for drive, fork, one_run in zip(drives, forks, full_runs, strict=True):
        assert fork.flags & Flag.FORKED
        assert fork.n_steps == len(drive.excitation.samples) + 100
        assert fork.sim_time_s == one_run.sim_time_s
        for name in ("pos", "max_sway_m", "rest_top_force_n", "max_top_force_n"):
            np.testing.assert_array_equal(getattr(fork.boxes, name), getattr(one_run.boxes, name))


def test_a_world_that_fell_skips_its_drive(engine: FakeEngine) -> None:
    jobs = [Job(fake_scene(FALLS_KG), pushes("force", steps, 0.01)) for steps in range(30, 30 + LANES)]
    for outcome in run_all(engine, jobs, SHORT):
        assert outcome.reason is Reason.DROP
        assert np.isnan(outcome.boxes.max_sway_m).all()


# ---------------------------------------------------------------------- compilation


def test_one_program_a_shape() -> None:
    """Other jobs, another number of jobs and another run all use the same program."""
    fresh = FakeEngine(LANES)
    for masses in (MASSES[:32], [m[::-1] for m in MASSES[:25]]):
        run_all(fresh, [Job(fake_scene(*m)) for m in masses], SHORT)
    shapes = [(key.capacity, key.worlds, key.drive) for key in fresh.programs]
    assert sorted(shapes) == [(4, LANES, None), (8, FEWEST_WORLDS, None)]


def test_one_placement_program_and_few_for_drives() -> None:
    """All drives whose lengths are similar share a program."""
    fresh = FakeEngine()
    for steps in (30, 61, 1000):
        run_all(fresh, [Job(fake_scene(1.0), pushes("force", steps, 0.01))], SHORT)
    assert [key.drive for key in fresh.programs] == [None, "force", "force"]
