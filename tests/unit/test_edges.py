"""Verdicts on a knife's edge, and those that the timestep decides, say so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.outcomes import make_outcome
from support.plans import Box, make_plan, make_scene
from test_stand_in import Scripted, never, scored

import petmjx
from petmjx.engines.attempts import ATTEMPTS
from petmjx.engines.looked_at import note_edges
from petmjx.options.config import Simulation
from petmjx.verdict import Flag, Outcome, Reason, Verdict
from petmjx.world.job import Job

MM = 1e-3


@pytest.mark.parametrize(("overhang_mm", "flagged"), [(199.4, False), (199.6, True), (200.0, True), (200.6, False)])
def test_a_load_within_half_a_millimetre_of_an_edge_is_on_a_knife_s_edge(overhang_mm: float, flagged: bool) -> None:
    """A box of 400 mm, whose size is reduced by 0.1 mm at its far end, as the edge below is."""
    boxes: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (overhang_mm, 0, 200), 5.0))
    worlds = petmjx.score(make_plan("edge", boxes), engine="mujoco", size_reduction_mm=0.0).worlds
    assert worlds.plan_edge_m[0] == pytest.approx((200 - overhang_mm) * MM, abs=1e-9)
    assert bool(worlds["flags"][0] & Flag.KNIFE_EDGE) is flagged
    if worlds.verdict[0] == "stable":
        assert worlds.rest_edge_m[0] == pytest.approx(worlds.plan_edge_m[0], abs=2e-4)
    else:
        assert worlds.isna().rest_edge_m[0]


def test_what_a_box_bears_counts_and_so_does_its_own_weight_alone() -> None:
    """The plank would fall when it is placed; the weight on its inner end holds it afterwards."""
    plank: Box = ((1000, 300, 100), (0, 0, 300), 5.0)
    weight: Box = ((200, 300, 200), (0, 0, 400), 50.0)
    scene = make_scene([((400, 300, 300), (0, 0, 0), 5.0), plank, weight], Simulation(size_reduction_mm=0.0))
    outcome = replace(make_outcome(3, Verdict.UNSTABLE, Reason.DROP), n_placed=3)
    first = replace(outcome, n_placed=1)
    note_edges([outcome, first], [Job(scene), Job(scene)])
    assert outcome.plan_edge_m == pytest.approx(-0.1)
    assert first.plan_edge_m == pytest.approx(0.15)  # a box alone on the carrier


def near(margin: float, **changes: Any) -> Outcome:
    """One box that used its threshold but for this margin."""
    return make_outcome(1, shift_m=np.array([[0.02 * (1 - margin), 0.0, 0.0]]), **changes)


@pytest.mark.parametrize(("margin", "checked"), [(0.6, False), (0.4, True)])
def test_worlds_near_a_threshold_are_checked_at_half_the_timestep(
    margin: float, checked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Near(Scripted):
        def run(self, jobs: Any, sim: Any, progress: Any = None) -> Any:
            self.sims.append(sim)
            half = sim.physics.timestep_s < 0.002
            for index in range(len(jobs)):
                changed = half and index == 1
                falls = {"verdict": Verdict.UNSTABLE, "reason": Reason.SHIFT} if changed else {}
                yield near(-0.1 if changed else margin, job=index, **falls)

    own = Near("mjx-warp", never)
    results, notes = scored(own, Near("mujoco", never), monkeypatch, Simulation(check_timestep=True))
    assert {result.outcome.verdict for result in results} == {Verdict.STABLE}
    assert [a.attempt for a in results[0].attempts] == ([1, 8] if checked else [1])
    changed = [result.world.plan.plan_id for result in results if result.outcome.flags & Flag.TIMESTEP]
    assert changed == (["p1"] if checked else [])
    assert ("p1: stable, and unstable at half the timestep" in notes) is checked
    assert [sim.physics.timestep_s for sim in own.sims] == ([0.002, 0.001] if checked else [0.002])


def test_a_world_that_ended_on_its_way_down_is_near_nothing() -> None:
    (check,) = (recipe for recipe in ATTEMPTS if recipe.checks)
    falling = near(-0.1, verdict=Verdict.UNSTABLE, reason=Reason.TILT)
    sim = Simulation(check_timestep=True)
    assert check.is_for(falling, sim)
    assert not check.is_for(replace(falling, flags=Flag.EARLY_STOP), sim)


def test_nothing_is_checked_unless_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    c_engine = Scripted("mujoco", never)
    scored(Scripted("mjx-warp", never), c_engine, monkeypatch)
    assert c_engine.sims == []


def test_an_engine_computes_what_is_checked() -> None:
    floats: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (0, 0, 212), 5.0))
    results = petmjx.score(make_plan("floats", floats), engine="mujoco", check_timestep=True)
    assert 0 < results.worlds.margin[0] < 0.5
    assert results.attempts.attempt.tolist() == [1, 8]
    assert results.attempts.timestep_s.tolist() == [0.002, 0.001]
