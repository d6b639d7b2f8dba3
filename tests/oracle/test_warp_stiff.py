"""If soft contacts may have decided the verdict of a world, the world is simulated again with stiffer contacts, beside
the run on mjx-warp.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.fake_stepper import assert_same
from support.job_streams import feedback_stream
from support.plans import make_plan, make_world, stack
from support.tiny_worlds import devices, engine, shared_engine

import petmjx
from petmjx.engines.attempt_settings import ATTEMPTS, AttemptRecipe
from petmjx.engines.contact_penetration import STIFF_INTERVAL_S, stiffened
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Flag, Verdict
from petmjx.engines.warp.compiled_programs import constants, contact_constants
from petmjx.engines.warp.cpu_engine import MjxWarpCpuEngine
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.world_table import TableRun, WorldTable
from petmjx.engines.world_results import WorldResult
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

SIM = Simulation()

FORCE_SHARE = 0.01
"""Relative tolerance of forces at rest, in single precision with contacts that are 40 times as stiff as usual."""

LIGHT_UNDER_HEAVY = stack(2, size_mm=(400, 300, 200), kg=(0.02, 300.0))

PILES = {
    "stands": LIGHT_UNDER_HEAVY,
    "tips": (*LIGHT_UNDER_HEAVY, ((400, 300, 200), (220, 0, 400), 5.0)),
    "slender": (((131, 300, 402), (0, 0, 0), 0.32), ((131, 300, 800), (64, 0, 402), 7.2)),
}


def scored(engine: Engine) -> dict[str, WorldResult]:
    worlds = [make_world(make_plan(name, boxes), SIM) for name, boxes in PILES.items()]
    return {result.world.plan.plan_id: result for result in score_worlds(worlds, SIM, engine)}


@pytest.mark.slow
def test_the_kernel_s_further_attempts_end_as_c_mujoco_s() -> None:
    expected = scored(MujocoEngine(1))
    alone = MjxWarpCpuEngine(1)
    for name, result in scored(shared_engine()).items():
        assert [(a.attempt, a.engine) for a in result.attempts] == [(1, "mjx-warp"), (6, "mjx-warp-cpu")], name
        (itself,) = alone.run([result.world.job], ATTEMPTS[5].apply_to_sim(SIM))
        np.testing.assert_array_equal(result.outcome.boxes.pos, itself.boxes.pos, err_msg=name)
        oracle = expected[name].outcome
        assert (result.outcome.verdict, result.outcome.culprit) == (oracle.verdict, oracle.culprit), name
        if oracle.verdict is Verdict.STABLE:
            force, exact_force = result.outcome.boxes.rest_top_force_n, oracle.boxes.rest_top_force_n
            np.testing.assert_allclose(
                force, exact_force, rtol=FORCE_SHARE, atol=FORCE_SHARE * exact_force.max(), err_msg=name
            )
    assert {name: result.outcome.verdict for name, result in expected.items()} == {
        "stands": Verdict.STABLE, "tips": Verdict.UNSTABLE, "slender": Verdict.STABLE,
    }  # fmt: skip


STEPS_SHARE = 0.15
"""Relative tolerance of the steps that a tower needs until it is at rest: a wait ends at a look, every 5 steps, after
some 40 steps."""


def test_towers_come_to_rest_in_stiff_contacts_as_on_c_mujoco() -> None:
    """In stiff contacts, boxes sink by less than single precision resolves. With distances in single precision, the
    same towers need 1.6 to 5.6 times as many steps, and two of the five still move at the end."""
    rng, worlds = np.random.default_rng(33631), []
    for tower in range(5):
        size_mm, height_mm, boxes = rng.uniform(150, 350, 2).astype(int), 0, []
        for _ in range(8):
            size = (*size_mm.tolist(), int(rng.uniform(100, 250)))
            corner = (*rng.uniform(275, 325, 2).astype(int).tolist(), height_mm)
            boxes.append((size, corner, float(rng.uniform(1, 20))))
            height_mm += size[2]
        worlds.append(make_world(make_plan(f"tower {tower}", boxes), SIM))
    jobs, sim = [world.job for world in worlds], ATTEMPTS[5].apply_to_sim(SIM)
    steps = []
    for outcome, expected in zip(MjxWarpCpuEngine(1).run(jobs, sim), MujocoEngine(1).run(jobs, sim), strict=True):
        assert outcome.verdict is expected.verdict is Verdict.STABLE
        assert not outcome.flags & Flag.MOVING
        steps.append((outcome.n_steps, expected.n_steps))
    np.testing.assert_allclose(*np.transpose(steps), rtol=STEPS_SHARE)


RESTLESS = SIM.changed(longest_wait_s=0.8, quiet={"quiet_m_s": 1e-9})
"""With these options no pallet is ever quiet, so all waits but the first and the last are short."""


@pytest.mark.slow
@devices
@pytest.mark.parametrize("sim", [SIM, RESTLESS], ids=["usual", "restless"])
def test_worlds_in_stiffer_contacts_among_others_are_as_they_are_alone(device: str, sim: Simulation) -> None:
    jobs = [replace(make_world(make_plan(name, boxes), sim).job, keep_state=True) for name, boxes in PILES.items()]
    mixing = engine()
    usual = {outcome.job: outcome for outcome in mixing.run(jobs, sim)}
    stiff = {outcome.job: outcome for outcome in mixing.run(jobs, stiffened(sim, 0.5))}
    mixed = [job for alone in jobs for job in (alone, replace(alone, stiff=0.5))]
    together = {outcome.job: outcome for outcome in mixing.run(feedback_stream(mixed), sim)}
    assert len(together) == len(mixed)
    for number, outcome in together.items():
        expected = (stiff if number % 2 else usual)[number // 2]
        assert_same(replace(outcome, job=number // 2), expected)
        assert outcome.n_steps == expected.n_steps
    assert any(usual[number].n_steps != stiff[number].n_steps for number in usual)


@pytest.mark.parametrize("options", [{}, {"quiet": {"steps": 40}}, {"physics": {"slip_correction": False}}])
def test_all_constants_that_stiffer_contacts_change_are_those_of_contacts(options: dict[str, Any]) -> None:
    sim = SIM.changed(**options)
    stiff = ATTEMPTS[5].apply_to_sim(sim)
    timetable, of_stiff = build_timetable(sim, 4), build_timetable(stiff, 4)
    assert (timetable.most_boxes, of_stiff.due_steps) == (4, 100)
    expected, mixed = constants(stiff, of_stiff), {**constants(sim, timetable), **contact_constants(stiff, of_stiff)}
    assert not np.array_equal(timetable.due, of_stiff.due)
    del expected["settled_nominally"], mixed["settled_nominally"]  # only the fixed schedule uses it
    assert {name: str(value) for name, value in mixed.items()} == {name: str(value) for name, value in expected.items()}


def test_only_the_adaptive_schedule_waits_less_in_stiffer_contacts() -> None:
    assert stiffened(SIM, 0.5).interval_s == STIFF_INTERVAL_S < SIM.interval_s
    assert stiffened(SIM.changed(interval_s=0.1), 0.5).interval_s == 0.1
    assert stiffened(SIM.changed(schedule="fixed"), 0.5).interval_s == SIM.interval_s


@pytest.mark.filterwarnings("ignore:.*kg/m³")
@pytest.mark.slow
def test_drives_after_an_attempt_in_stiffer_contacts_do_not_depend_on_when_it_ran(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The attempt and its drives run in the table of the other worlds, with the same results as in separate tables."""
    plans = [make_plan(name, boxes) for name, boxes in {"usual": stack(2), **PILES}.items()]
    tables: list[list[Job]] = []
    load = MjxWarpEngine._load

    def noted_load(self: MjxWarpEngine, run: TableRun, jobs: list[Job], *others: Any) -> WorldTable:
        tables.append(jobs.copy())
        return load(self, run, jobs, *others)

    monkeypatch.setattr(MjxWarpEngine, "_load", noted_load)
    file = tmp_path / "sweep.toml"
    file.write_text('[axes]\nprofile = "eumos-40509"\nlevel = [0.1, 0.3]\n')
    joined = petmjx.sweep(file, plans, engine="mjx-warp-cpu", threads=2)
    assert [[job.stiff for job in jobs] for jobs in tables] == [[None] * 4]
    tables.clear()
    monkeypatch.setattr(AttemptRecipe, "joins", False)
    apart = petmjx.sweep(file, plans, engine="mjx-warp-cpu", threads=2)
    are_drives = [[job.drive is not None for job in jobs] for jobs in tables]
    assert list(map(set, are_drives)) == [{False}, {False}, {True}, {True}], (
        "attempts at placements and at their drives"
    )
    for name in ("worlds", "boxes", "attempts"):
        mine, theirs = (getattr(run, name) for run in (joined, apart))
        pd.testing.assert_frame_equal(mine, theirs)
    n_driven = joined.worlds.query("plan_id == 'stands'").n_steps.gt(0).sum()
    assert n_driven == 2
