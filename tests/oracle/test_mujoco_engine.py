"""Mechanics of the engine mujoco: contacts, growth of the model, forks, threads, interruption, and broken numbers.

A fork is a world that continues from a kept state of another world.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Generator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from support.job_streams import feedback_stream, put
from support.plans import falling, make_scene, stack
from support.worlds import run_one

from petmjx.engines.job_stream import JobStream
from petmjx.engines.metrics import BoxSample
from petmjx.engines.mujoco import live_world as mujoco_live
from petmjx.engines.mujoco.box_motion import lowest_z, tilt_deg
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.engines.mujoco.top_forces import contact_normal_and_tangents
from petmjx.engines.protocol import Progress
from petmjx.engines.step_clock import Clock
from petmjx.engines.verdict import Flag, Reason, Verdict, judge
from petmjx.options.carriers import Carrier
from petmjx.options.physics import PHYSICS, Cone
from petmjx.options.simulation import Schedule, Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.mujoco_model import build_spec, to_mjcf
from petmjx.world.scene import Scene

SAME_M = 1e-9
"""Tolerance in m between worlds that differ only in the layout of their model, so only by rounding."""


def leaning(n: int = 5, overhang_mm: float = 20.0, physics: str = "pallet") -> Scene:
    """Return a tower that stands. Every other box sits ``overhang_mm`` further along x."""
    boxes = stack(n, overhang_mm, size_mm=(300, 200, 150), kg=np.linspace(8.0, 3.0, n).tolist(), at_mm=(100, 100))
    return make_scene(boxes, Simulation(physics=physics, carrier=Carrier.EURO_PALLET))


def push(n_steps: int = 50, level: float = 0.3, kind: str = "force") -> Drive:
    return Drive(Excitation("push", kind, np.tile([level, 0.0, 0.0], (n_steps, 1))), rest_s=0.3)


# ---------------------------------------------------------------------- model


def test_the_model_has_the_bodies_masses_and_frictions_of_the_scene() -> None:
    scene = leaning(3, physics="reference")
    model = build_spec(scene, PHYSICS["reference"]).compile()
    assert [model.body(k).name for k in range(model.nbody)] == ["world", "carrier", "box_0", "box_1", "box_2"]
    np.testing.assert_allclose(model.body_mass[1:], [25.0, *scene.mass])
    np.testing.assert_allclose(model.geom("carrier").friction, [3.0, 0.005, 0.0001])
    np.testing.assert_allclose(model.geom("box_1").size, scene.half_size[1])
    np.testing.assert_allclose(model.geom_solimp[:, :3], np.tile([0.99, 0.99, 0.01], (model.ngeom, 1)))
    assert model.opt.timestep == 0.002
    assert model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL


def test_exported_mjcf_loads_and_stands_as_planned() -> None:
    scene = leaning(3)
    model = mujoco.MjModel.from_xml_string(to_mjcf(scene, PHYSICS["pallet"]))
    np.testing.assert_allclose(model.qpos0.reshape(-1, 7)[1:, :3], scene.target)
    np.testing.assert_allclose(model.body_mass[2:], scene.mass)
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_a_model_of_more_boxes_than_the_scene_has_is_refused() -> None:
    with pytest.raises(ValueError, match="n_boxes must be"):
        build_spec(leaning(3), PHYSICS["pallet"], n_boxes=4)


# ---------------------------------------------------------------------- metrics


@pytest.mark.parametrize("physics", list(PHYSICS))
def test_contact_forces_are_those_mujoco_reports(physics: str) -> None:
    model = build_spec(leaning(5, overhang_mm=90, physics=physics), PHYSICS[physics]).compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=60)
    index, force = contact_normal_and_tangents(data, PHYSICS[physics].cone is Cone.PYRAMIDAL)
    assert len(index) > 10
    wrench = np.zeros(6)
    for contact, ours in zip(index, force, strict=True):
        mujoco.mj_contactForce(model, data, int(contact), wrench)
        np.testing.assert_allclose(ours, wrench[:3], rtol=1e-12, atol=1e-12)


def test_tilt_and_lowest_point_of_turned_boxes() -> None:
    half_angle = np.radians(30.0) / 2
    quat = np.array([[1.0, 0, 0, 0], [np.cos(half_angle), np.sin(half_angle), 0, 0], [np.cos(0.7), 0, 0, np.sin(0.7)]])
    np.testing.assert_allclose(tilt_deg(quat), [0.0, 30.0, 0.0], atol=1e-12)
    half_size = np.tile([0.1, 0.2, 0.3], (3, 1))
    turned = 1.0 - 0.3 * np.cos(np.radians(30)) - 0.2 * np.sin(np.radians(30))
    np.testing.assert_allclose(lowest_z(np.array([[0, 0, 1.0]] * 3), quat, half_size), [0.7, turned, 0.7])


def sample_of(
    scene: Scene, offset_m: float = 0.0, ang_acc: float = 0.0, time_s: float = 1.0
) -> tuple[float, BoxSample]:
    n = scene.n_boxes
    acc = np.repeat([[0.0, ang_acc]], 3, axis=1).repeat(n, axis=0)
    pos, at_rest = scene.target + np.array([offset_m, 0, 0]), np.zeros((n, 6))
    return time_s, BoxSample(pos, scene.start_quat, at_rest, acc, np.zeros(n), scene.target)


def test_a_violent_sample_counts_only_before_the_first_sign() -> None:
    scene = leaning(2)
    metrics = OracleMetrics(scene, Thresholds())
    assert not metrics.add_sample(*sample_of(scene))
    assert metrics.add_sample(*sample_of(scene, ang_acc=100.0))
    assert not metrics.add_sample(*sample_of(scene, offset_m=0.021, ang_acc=100.0, time_s=2.0))
    assert not metrics.add_sample(*sample_of(scene, ang_acc=100.0, time_s=3.0))
    assert metrics.first_sign_s == 2.0


@pytest.mark.parametrize("gravity_m_s2", [9.81, 100.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("size_mm", [(20, 20, 20), (20, 20, 600), (30, 10, 20), (600, 20, 10)])
def test_small_boxes_that_turn_as_fast_as_gravity_turns_them_are_not_violent(
    size_mm: tuple[float, float, float], axis: int, gravity_m_s2: float
) -> None:
    """Each box stands on an edge, and its centre is level with the edge: its weight turns it as fast as possible.
    Accelerations 1.4 times as large come from something else."""
    scene = make_scene([(size_mm, (0, 0, 0), 0.02)], Simulation(size_reduction_mm=0))
    half_m = np.delete(np.array(size_mm) / 2000, axis)
    arm_m = np.hypot(*half_m)
    inertia_per_kg = (half_m**2).sum() / 3 + arm_m**2
    fall = gravity_m_s2 * arm_m / inertia_per_kg
    for factor in (1.0, 1.4):
        metrics = OracleMetrics(scene, Thresholds(ang_acc_rad_s2=10.0), gravity_m_s2)
        time_s, sample = sample_of(scene)
        sample.acceleration[0, 3 + axis] = factor * fall
        assert metrics.add_sample(time_s, sample) is (factor > 1)


def test_a_large_box_is_violent_above_the_threshold() -> None:
    """A box whose smallest face has a diagonal of 179 mm or more is not spared, whatever its axis."""
    scene = make_scene([((127, 127, 127), (0, 0, 0), 2.0)], Simulation(size_reduction_mm=0))
    for acceleration, is_violent in ((109.0, False), (111.0, True)):
        time_s, sample = sample_of(scene)
        sample.acceleration[0, 3] = acceleration
        assert OracleMetrics(scene, Thresholds()).add_sample(time_s, sample) is is_violent


def test_verdicts_come_in_their_order() -> None:
    scene = leaning(2)
    metrics = OracleMetrics(scene, Thresholds())
    metrics.add_sample(*sample_of(scene))
    boxes = metrics.finish(scene.target + np.array([0.03, 0, 0]), scene.start_quat, 2, came_to_end=True)
    verdicts = [judge(Flag.NONE, boxes, 2, Thresholds())]
    boxes.max_tilt_deg[1] = 21.0
    verdicts.append(judge(Flag.NONE, boxes, 2, Thresholds()))
    boxes.dropped[0] = True
    verdicts.append(judge(Flag.NONE, boxes, 2, Thresholds()))
    flags = Flag.NONE
    for flag in (Flag.EXPLOSION, Flag.CONTACT_OVERFLOW, Flag.NONFINITE):
        flags |= flag
        verdicts.append(judge(flags, boxes, 2, Thresholds()))
    assert [reason for _, reason in verdicts] == [
        Reason.SHIFT,
        Reason.TILT,
        Reason.DROP,
        Reason.EXPLOSION,
        Reason.OVERFLOW,
        Reason.NONFINITE,
    ]


# ---------------------------------------------------------------------- schedules


def test_the_clock_is_mujocos_running_sum() -> None:
    clock, time_s, placed_s, steps = Clock(0.002), 0.0, 0.0, list[int]()
    for step in range(1, 2000):
        time_s += 0.002
        if time_s - placed_s >= 0.5:
            placed_s = time_s
            steps.append(step)
        assert clock.time_s(step) == time_s
    step, counted_steps = 0, list[int]()
    while len(counted_steps) < len(steps):
        step = clock.first_after(step, 0.5)
        counted_steps.append(step)
    assert counted_steps == steps
    assert set(np.diff([0, *steps])) <= {250, 251}


def test_fixed_and_adaptive_agree_and_adaptive_is_shorter() -> None:
    scene = leaning()
    fixed = run_one(Job(scene), Simulation(schedule=Schedule.FIXED))
    adaptive = run_one(Job(scene), Simulation(schedule=Schedule.ADAPTIVE))
    assert fixed.verdict is adaptive.verdict is Verdict.STABLE
    assert fixed.n_steps == int(6 * 0.7 / 0.002)
    assert adaptive.n_steps < fixed.n_steps / 2
    # on a real pallet both schedules differ by 0.1 mm
    np.testing.assert_allclose(adaptive.boxes.pos, fixed.boxes.pos, atol=1e-4)


@pytest.mark.parametrize(("physics", "ordered_from"), [("pallet", 100), ("pallet", 1), ("reference", 1)])
def test_how_the_world_grows_does_not_matter(physics: str, ordered_from: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco_live, "ORDERED_FROM", ordered_from)
    sim = Simulation(physics=PHYSICS[physics])
    scene = leaning(7, physics=physics)
    outcomes = []
    for block in (1, 3, 7):
        monkeypatch.setattr(mujoco_live, "GROWTH_BLOCK", block)
        outcomes.append(run_one(Job(scene), sim))
    monkeypatch.setattr(mujoco_live, "ORDERED_FROM", 100)
    outcomes.append(run_one(Job(scene), sim))
    for other in outcomes[1:]:
        assert other.n_steps == outcomes[0].n_steps
        np.testing.assert_allclose(other.boxes.pos, outcomes[0].boxes.pos, atol=SAME_M)
        np.testing.assert_allclose(other.boxes.rest_top_force_n, outcomes[0].boxes.rest_top_force_n, rtol=1e-6)


# ---------------------------------------------------------------------- forking


@pytest.mark.parametrize("kind", ["force", "acceleration"])
@pytest.mark.parametrize("schedule", list(Schedule))
def test_a_fork_equals_the_world_it_was_forked_from(schedule: Schedule, kind: str) -> None:
    sim = Simulation(schedule=schedule, settle_s=0.5, interval_s=0.3)
    scene = leaning(4)
    drive = push(level=0.3 if kind == "force" else 3.0, kind=kind)
    full_run = run_one(Job(scene, drive), sim)
    kept = run_one(Job(scene, keep_state=True), sim)
    fork = run_one(Job(scene, drive, start=kept.state), sim)
    assert fork.n_steps == 50 + 150
    assert kept.state.step + fork.n_steps == full_run.n_steps
    assert fork.flags & Flag.FORKED
    assert fork.verdict is full_run.verdict
    for name in ("pos", "max_tilt_deg", "max_sway_m", "max_top_force_n", "rest_top_force_n"):
        np.testing.assert_allclose(getattr(fork.boxes, name), getattr(full_run.boxes, name), rtol=1e-6, atol=SAME_M)


def test_64_forks_cost_one_placement() -> None:
    sim = Simulation(settle_s=0.5)
    scene = leaning(3)
    progress = Progress()
    kept = run_one(Job(scene, keep_state=True), sim)
    jobs = [Job(scene, push(20 + k), start=kept.state) for k in range(64)]
    outcomes = list(MujocoEngine(2).run(jobs, sim, progress))
    assert sorted(outcome.job for outcome in outcomes) == list(range(64))
    assert progress.worlds_done == 64
    assert progress.world_steps == sum(20 + k + 150 for k in range(64))
    # All forks share the kept state, so a fork must not change it for the next one.
    again = run_one(jobs[0], sim)
    first = next(outcome for outcome in outcomes if outcome.job == 0)
    np.testing.assert_array_equal(again.boxes.pos, first.boxes.pos)


def test_forks_of_a_collapse_have_its_outcome() -> None:
    scene = falling()
    kept = run_one(Job(scene, keep_state=True), Simulation())
    fork = run_one(Job(scene, push(), start=kept.state), Simulation())
    assert (fork.verdict, fork.reason, fork.culprit) == (kept.verdict, kept.reason, kept.culprit)
    assert fork.n_steps == 0


# ---------------------------------------------------------------------- threads and failure


def test_outcomes_do_not_depend_on_the_number_of_threads() -> None:
    jobs = [Job(leaning(n, overhang_mm=shift)) for n in (2, 4, 6) for shift in (10, 90, 280)]
    alone = {outcome.job: outcome for outcome in MujocoEngine(1).run(jobs, Simulation())}
    together = {outcome.job: outcome for outcome in MujocoEngine(4).run(jobs, Simulation())}
    assert alone.keys() == together.keys() == set(range(len(jobs)))
    for job, outcome in alone.items():
        assert outcome.n_steps == together[job].n_steps
        np.testing.assert_array_equal(outcome.boxes.pos, together[job].boxes.pos)
        np.testing.assert_array_equal(outcome.boxes.max_top_force_n, together[job].boxes.max_top_force_n)


def test_closing_the_run_stops_it_and_jobs_are_taken_as_needed() -> None:
    before = threading.active_count()
    stream = JobStream.of([Job(leaning(2))] * 10_000)
    outcomes = MujocoEngine(2).run(stream, Simulation())
    assert isinstance(outcomes, Generator)
    next(outcomes)
    assert stream.taken <= 8
    outcomes.close()
    assert threading.active_count() == before


INTERRUPTED = """
import sys
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.world.job import Job
from support.plans import make_scene, stack
sim = Simulation(check=Check.STATIC, schedule=Schedule.FIXED, duration_s=600)
short, long = Job(make_scene(stack(3, -200.0))), Job(make_scene(40))
try:
    for outcome in MujocoEngine(2).run([short, long, long, long], sim):
        # the other thread steps a long world meanwhile
        print(f"job {outcome.job} is done", flush=True)
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("threads", [1, 3])
def test_jobs_that_are_appended_while_it_runs_are_simulated_too(threads: int) -> None:
    job, sim = Job(make_scene(1)), Simulation(check="static", duration_s=0.2)
    stream, numbers, n_jobs = feedback_stream([job]), [], 1
    for outcome in MujocoEngine(threads).run(stream, sim):
        numbers.append(outcome.job)
        more = n_jobs if n_jobs < 6 else 0
        put(stream, *[job] * more)
        n_jobs += more
    assert sorted(numbers) == list(range(n_jobs)) == list(range(8))


def test_ctrl_c_ends_long_worlds_at_once(repository: Path) -> None:
    environment = os.environ | {"PYTHONPATH": f"{repository}{os.pathsep}{repository / 'tests'}"}
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED], env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "job 0 is done\n"
        process.send_signal(signal.SIGINT)
        # A world checks for the interruption at every event, here every 100 steps, which take milliseconds. Each long
        # world would take minutes.
        assert process.wait(timeout=120.0) == 130


def test_broken_numbers_are_invalid_and_leave_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    samples = np.full((5, 3), np.nan)
    drive = Drive(Excitation("broken", "force", samples), rest_s=0.1)
    outcome = run_one(Job(leaning(2), drive), Simulation(settle_s=0.1))
    assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.NONFINITE)
    assert list(tmp_path.iterdir()) == []


def test_fewer_than_one_thread_is_refused() -> None:
    with pytest.raises(ValueError, match="threads must be at least 1"):
        MujocoEngine(0)


def test_a_tilt_between_samples_and_the_end_is_seen() -> None:
    """A box tips over within a second. At most one sample sees it before it lies."""
    scene = make_scene(stack(2, 220.0, size_mm=(400, 300, 200)))
    for interval_s in (0.2, 30.0):
        sim = Simulation(sample_interval_s=interval_s, early_stop=False, thresholds={"shift_m": 10.0})
        outcome = run_one(Job(scene), sim)
        assert outcome.verdict is Verdict.UNSTABLE
        assert outcome.boxes.max_tilt_deg[1] >= tilt_deg(outcome.boxes.quat)[1] > 20.0


def test_the_largest_force_is_not_below_the_force_at_rest() -> None:
    sim = Simulation(sample_interval_s=30.0)
    outcome = run_one(Job(leaning()), sim)
    assert outcome.verdict is Verdict.STABLE
    assert outcome.boxes.rest_top_force_n[0] > 100.0
    assert (outcome.boxes.max_top_force_n >= outcome.boxes.rest_top_force_n).all()
