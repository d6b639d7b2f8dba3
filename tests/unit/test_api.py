"""Scoring from Python."""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import petmjx
from petmjx.api import configure, gather_plans
from petmjx.config import PHYSICS, Physics, Simulation, Thresholds
from petmjx.engines.base import Progress
from petmjx.engines.choose import Choice
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.engines.retry import WorldResult
from petmjx.errors import InputError
from petmjx.plans.plan import Plan, PlanSet
from petmjx.verdict import Outcome
from petmjx.world.job import Job


def stack(plan_id: str, overhang_mm: float, height_mm: float = 200.0) -> Plan:
    """Two cartons, the upper one moved along x: it falls from an overhang of half its 400 mm on."""
    return Plan(
        plan_id=plan_id,
        source="test",
        size_mm=np.array([[400.0, 300.0, height_mm]] * 2),
        corner_mm=np.array([[0.0, 0.0, 0.0], [overhang_mm, 0.0, height_mm]]),
        mass_kg=np.array([5.0, 5.0]),
        item_ids=("1", "2"),
        articles=("lower", "upper"),
        sequence=np.array([1, 2]),
    )


PLANS = [stack("stands", 100.0), stack("falls", 260.0)]


class Witness:
    """A watcher that remembers what it was told."""

    def __init__(self) -> None:
        self.total = 0
        self.engine = ""
        self.done: list[str] = []

    def begin(self, total: int, choice: Choice, progress: Progress) -> None:
        self.total, self.engine = total, choice.name

    def world_done(self, result: WorldResult) -> None:
        self.done.append(result.world.plan.plan_id)


def test_results_are_data_frames() -> None:
    witness = Witness()
    results = petmjx.score(PLANS, engine="mujoco", watcher=witness)
    worlds = results.worlds.set_index("plan_id")
    assert worlds["verdict"].to_dict() == {"stands": "stable", "falls": "unstable"}
    assert worlds.loc["falls", "culprit"] == 1
    assert len(results.boxes) == 4
    assert results.attempts.empty
    assert results.info["counts"]["worlds"] == 2
    assert (witness.total, witness.engine, sorted(witness.done)) == (2, "mujoco", ["falls", "stands"])


def test_the_temporary_folder_goes_with_the_results() -> None:
    results = petmjx.score(PLANS[:1], engine="mujoco")
    folder = results.path
    assert (folder / "run.json").exists()
    del results
    gc.collect()
    assert not folder.exists()


class _Failing(MujocoEngine):
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        raise RuntimeError("no luck")
        yield


def test_the_temporary_folder_goes_when_the_run_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(RuntimeError, match="no luck"):
        petmjx.score(PLANS, engine=_Failing())
    assert list(tmp_path.iterdir()) == []


def test_given_engines_and_physics_are_used(tmp_path: Path) -> None:
    slick = PHYSICS["pallet"].model_copy(update={"name": "slick", "timestep_s": 0.001})
    results = petmjx.score(PLANS[:1], engine=MujocoEngine(1), physics=slick, out=tmp_path / "out")
    assert results.path == tmp_path / "out"
    assert results.info["config"]["sim"]["physics"]["name"] == "slick"
    assert results.info["config"]["engine_reason"] == "given"


def test_thresholds_decide() -> None:
    tilted = petmjx.score(PLANS[1:], engine="mujoco").worlds
    assert tilted["reason"].tolist() == ["tilt"]
    tolerant = Thresholds(shift_m=5.0, tilt_deg=180.0)
    shifted = petmjx.score(PLANS[1:], engine="mujoco", thresholds=tolerant).worlds
    assert shifted["verdict"].tolist() == ["stable"]
    pedantic = Thresholds(shift_m=1e-9, shift_floor_m=0.0)
    results = petmjx.score(PLANS[:1], engine="mujoco", thresholds=pedantic)
    assert results.worlds["reason"].tolist() == ["shift"]
    assert results.info["config"]["sim"]["thresholds"]["shift_m"] == 1e-9


def test_sources_of_plans() -> None:
    assert len(gather_plans(PLANS, limit=1)) == 1
    assert len(gather_plans(PlanSet(PLANS), limit=1)) == 1
    assert len(gather_plans(None)) >= 20
    mixed: list[Any] = [PLANS[0], "plans.json"]
    with pytest.raises(InputError, match="either paths or plans"):
        gather_plans(mixed)
    with pytest.raises(InputError, match="no plan files"):
        gather_plans([])


def test_a_box_that_the_size_reduction_eats_is_named() -> None:
    thin = stack("thin", 0.0, height_mm=0.05)
    results = petmjx.score([PLANS[0], thin], engine="mujoco")
    [skipped] = results.info["skipped"]
    assert skipped["error"] == (
        "test: plan thin, placement 0: a side of 0.05 mm vanishes under the size reduction of 0.1 mm"
    )
    with pytest.raises(InputError, match="no usable plan"):
        petmjx.score([thin], engine="mujoco")
    with pytest.raises(InputError, match="plan thin, placement 0"):
        petmjx.score([PLANS[0], thin], engine="mujoco", strict=True)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"physics": "moon"}, "unknown physics 'moon'; there are pallet, reference"),
        ({"interval_s": -1.0}, "interval_s must be at least the timestep of 0.002 s, got -1"),
        ({"duration_s": math.inf}, "duration_s must be at least"),
        ({"check": "dynamic"}, "check: .*got 'dynamic'"),
        ({"schedule": "slow"}, "schedule: .*got 'slow'"),
    ],
)
def test_unusable_options_are_named(options: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        configure(**options)


def test_unknown_carrier_is_named() -> None:
    with pytest.raises(InputError, match="unknown carrier 'raft'"):
        petmjx.score(PLANS, carrier="raft")


def test_configure_takes_physics_of_ones_own() -> None:
    physics = Physics(name="own", cone=PHYSICS["pallet"].cone, carrier_friction=(0.1, 0.005, 0.0001))
    assert configure(physics=physics).physics is physics
