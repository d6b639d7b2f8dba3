"""A single world never ends a run. A world with an exception, or without end, gets an invalid outcome, and all other
worlds are simulated."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from support.plans import make_plan, make_scene, stack

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.mujoco import world_run as cpu_world
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Job
from petmjx.world.scene import Scene

SIM = Simulation()


def in_one_place(n: int) -> Plan:
    return make_plan("crowded", [((400, 300, 200), (0, 0, 0), 5.0)] * n)


def simulate(scenes: list[Scene], **engine: float) -> list[Outcome]:
    jobs = [Job(scene) for scene in scenes]
    return sorted(MujocoEngine(2, **engine).run(jobs, SIM), key=lambda outcome: outcome.job)


def test_a_world_that_cannot_be_built_is_invalid_and_the_others_go_on() -> None:
    good = make_scene(3)
    impossible = replace(good, half_size=np.zeros_like(good.half_size))
    first, failed, last = simulate([good, impossible, good])
    assert first.verdict is last.verdict is Verdict.STABLE
    assert (failed.verdict, failed.reason, failed.flags) == (Verdict.INVALID, Reason.FAILED, Flag.FAILED)
    assert (failed.n_placed, failed.n_steps, failed.culprit) == (0, 0, -1)
    assert failed.message.startswith("ValueError: ")
    assert "half sizes must be positive" in failed.message
    assert "\n" not in failed.message
    assert first.message == ""


def test_an_error_of_mujoco_is_kept_with_its_message() -> None:
    """If MuJoCo raises an error, the outcome contains the error's message. In this test, 160 boxes at the same place
    have 50,000 contacts, for which the solver has no memory."""
    run = petmjx.score([make_plan("a", stack(3)), in_one_place(160), make_plan("z", stack(2))], check="static")
    worlds = run.worlds.set_index("plan_id")
    assert worlds["verdict"].to_dict() == {"a": "stable", "crowded": "invalid", "z": "stable"}
    crowded = worlds.loc["crowded"]
    assert (crowded["reason"], crowded["n_placed"], crowded["flags"]) == ("failed", 0, 1024)
    assert pd.isna(crowded["max_tilt_deg"])
    assert run.boxes.query("plan_id == 'crowded'")["pos_x_m"].isna().all()
    assert run.attempts["attempt"].tolist() == [1, 2, 3, 4, 5]
    (warning,) = [text for text in run.info["warnings"] if "failed" in text]
    assert warning.startswith("plan crowded: failed: FatalError: mj_stackAlloc")


def test_memory_that_runs_out_costs_one_world(monkeypatch: pytest.MonkeyPatch) -> None:
    made = threading.local()
    plain = cpu_world.LiveWorld

    def no_room(scene: Scene, *args: object, **more: object) -> object:
        made.scene = scene
        if scene.n_boxes == 4:
            raise MemoryError
        return plain(scene, *args, **more)

    monkeypatch.setattr(cpu_world, "LiveWorld", no_room)
    small, failed = simulate([make_scene(2), make_scene(4)])
    assert small.verdict is Verdict.STABLE
    assert (failed.reason, failed.message) == (Reason.FAILED, "MemoryError:")


@pytest.mark.parametrize("check", ["static", "one-by-one"])
def test_a_world_that_takes_for_ever_is_given_up(check: str) -> None:
    plan = in_one_place(60) if check == "static" else make_plan("tower", stack(40, size_mm=(400, 300, 50)))
    timeout_s = 0.1 if check == "static" else 0.001
    run = petmjx.score([plan], engine="mujoco", check=check, world_timeout_s=timeout_s)
    (world,) = run.worlds.to_dict("records")
    assert (world["verdict"], world["reason"], world["attempt"]) == ("invalid", "timeout", 1)
    assert world["flags"] & int(Flag.TIMEOUT)
    assert run.info["config"]["world_timeout_s"] == timeout_s


def test_a_timeout_that_is_not_reached_changes_nothing() -> None:
    scenes = [make_scene(stack(3, 20.0)), make_scene(stack(2, 220.0))]
    for plain, timed in zip(simulate(scenes), simulate(scenes, world_timeout_s=600.0), strict=True):
        assert (plain.verdict, plain.n_steps) == (timed.verdict, timed.n_steps)
        for name, values in vars(plain.boxes).items():
            np.testing.assert_array_equal(values, getattr(timed.boxes, name))


def test_only_the_engine_mujoco_has_a_timeout() -> None:
    with pytest.raises(InputError, match="only the engine mujoco can limit the time of a world"):
        make_engine("mjx-jax", world_timeout_s=5.0)
    with pytest.raises(InputError, match="world_timeout_s"):
        petmjx.score([make_plan()], world_timeout_s=0)
