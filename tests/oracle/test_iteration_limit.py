"""Tests of ``Simulation.iteration_limit``: a world that needs more iterations of the solver ends, without a verdict
unless a box has failed for good.

``test_warp_rules.py`` compares this rule on random states. ``test_long_worlds.py`` tests worlds that leave a GPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
import pytest
from support.fake_stepper import assert_same, run_all
from support.plans import make_plan, stack
from support.worlds import boxes_by_plan

import petmjx
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import MOST_ITERATIONS, Simulation
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.scene import build_scene

pytest.importorskip("warp", reason="Warp is an extra")

from support.tiny_worlds import SHORT, shared_engine

LIMIT = 150
"""Limit that a pile of four boxes uses up before its last box is placed."""

FALLS = make_plan("falls", [((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (380, 0, 200), 5.0)])
AFTER_THE_FALL = 600
"""Limit that ``FALLS`` uses up when its second box has tilted too far."""

PUSH = Drive(Excitation("push", "force", np.tile([2.1, 0.0, 0.0], (160, 1))), scale=0.5, yaw_rad=0.7, rest_s=0.1)


def outcomes_on_mujoco(jobs: Sequence[Job], sim: Simulation) -> list[Outcome]:
    return run_all(MujocoEngine(1), jobs, sim)


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu", pytest.param("mjx-jax", marks=pytest.mark.slow)])
def test_a_run_tells_which_worlds_used_up_their_iterations(engine: str, tmp_path: Path) -> None:
    plans = [make_plan("pile", stack(4))]
    for resume in (False, True):
        with jax.numpy_rank_promotion("allow"):  # MJX broadcasts as NumPy does
            results = petmjx.score(plans, engine=engine, iteration_limit=LIMIT, out=tmp_path, resume=resume)
        (world,) = results.worlds.to_dict("records")
        assert (world["verdict"], world["reason"], world["flags"]) == ("invalid", "iteration-limit", 131072)
        assert (world["n_placed"], world["attempt"], world["engine"]) == (3, 1, engine)
        assert results.info["config"]["simulation"]["iteration_limit"] == LIMIT
        assert results.info["counts"]["by_reason"]["invalid"] == {"iteration-limit": 1}
        (warning,) = [line for line in results.info["warnings"] if "iteration" in line]
        assert warning == (
            "no verdict for 1 world with iteration_limit=150: shares leave out these worlds, and may be wrong; "
            "a larger limit, or none, allows more iterations"
        )


def test_a_merged_run_has_one_warning_about_the_limit(tmp_path: Path) -> None:
    plans = [make_plan(f"p{number}", stack(2)) for number in range(3)]
    for share in (1, 2):
        petmjx.score(plans, engine="mujoco", iteration_limit=1, shard=f"{share}/2", out=tmp_path / str(share))
    merged = petmjx.merge_runs([tmp_path / "1", tmp_path / "2"], tmp_path / "merged")
    (warning,) = [line for line in merged.info["warnings"] if "iteration" in line]
    assert warning.startswith("no verdict for 3 worlds with iteration_limit=1: ")


def test_what_has_fallen_by_then_is_unstable() -> None:
    """A world in which a box has fallen when its iterations are used up is unstable, also without early stop. Up to its
    end, the world is the same as without a limit."""
    job, patient = Job(build_scene(FALLS, SHORT)), SHORT.changed(early_stop=False, rest_window_s=0.2)
    (whole,) = outcomes_on_mujoco([job], patient)
    (cut,) = outcomes_on_mujoco([job], patient.changed(iteration_limit=AFTER_THE_FALL))
    assert cut.n_steps < whole.n_steps
    assert (cut.verdict, cut.culprit, cut.first_sign_s) == (whole.verdict, whole.culprit, whole.first_sign_s)
    assert (cut.verdict, cut.flags) == (Verdict.UNSTABLE, Flag.EARLY_STOP)


def test_a_limit_that_is_not_reached_changes_nothing() -> None:
    """With a limit, `mujoco` takes steps one by one. Boxes land, slide and fall here."""
    scenes = [build_scene(make_plan(name, boxes), SHORT) for name, boxes in boxes_by_plan().items()]
    jobs = [*map(Job, scenes), Job(scenes[0], PUSH), Job(scenes[3], record=Record(0.02))]
    expected = outcomes_on_mujoco(jobs, SHORT)
    for outcome, plain in zip(
        outcomes_on_mujoco(jobs, SHORT.changed(iteration_limit=MOST_ITERATIONS)), expected, strict=True
    ):
        assert_same(outcome, plain)
        assert outcome.flags == plain.flags


@pytest.mark.parametrize("name", ["mujoco", "mjx-warp"])
def test_a_drive_has_as_many_iterations_again(name: str) -> None:
    """Iterations are counted anew in a drive, so it does not matter whether a drive directly follows its placement, or
    starts from a kept state."""
    engine: Engine = MujocoEngine(1) if name == "mujoco" else shared_engine()
    scene = build_scene(make_plan("bridge", boxes_by_plan()["hand-bridge"]), SHORT)
    sim = SHORT.changed(iteration_limit=250)
    (placement,) = run_all(engine, [Job(scene, keep_state=True)], sim)
    assert placement.verdict is Verdict.STABLE
    directly, fork = run_all(engine, [Job(scene, PUSH), Job(scene, PUSH, start=placement.state)], sim)
    assert directly.reason is fork.reason is Reason.ITERATION_LIMIT
    assert directly.n_steps == placement.n_steps + fork.n_steps
    assert fork.n_steps > 50


@pytest.mark.parametrize("name", ["mujoco", "mjx-warp"])
def test_worlds_of_a_run_may_have_different_limits(name: str) -> None:
    """The smaller of the job's and the run's limit applies."""
    engine: Engine = MujocoEngine(1) if name == "mujoco" else shared_engine()
    scene = build_scene(make_plan("pile", stack(4)), SHORT)
    whole, cut = run_all(engine, [Job(scene), Job(scene, iteration_limit=LIMIT)], SHORT)
    assert (whole.verdict, cut.reason) == (Verdict.STABLE, Reason.ITERATION_LIMIT)
    jobs = [Job(scene, iteration_limit=limit) for limit in (None, LIMIT, MOST_ITERATIONS)]
    for outcome in run_all(engine, jobs, SHORT.changed(iteration_limit=LIMIT)):
        assert_same(outcome, cut)
