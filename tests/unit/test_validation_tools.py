"""The measurements of docs/validation.md: how boxes that should rest drift, why they drift, and how verdicts depend on
details."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.plans import Box, make_plan, make_scene, stack

from benchmarks.__main__ import main
from benchmarks.drift import VARIANTS, Window, cause, describe, drift_table
from benchmarks.rest_balance import BALANCED, left_over
from benchmarks.sensitivity import CHANGES, sensitivity
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.plans.bundled import bundled_path

SHORT = Window(0.2, 0.6)


def seen(**values: float) -> dict[str, object]:
    """Measured values of a box that creeps for no visible reason; the arguments change some of the values."""
    calm = {"drift_um_s": 5.0, "vertical_um_s": 0.0, "used": 0.1, "changes": 0.0, "pushed": 0.0, "askew_deg": 0.0}
    return {"plan_id": "a", "box": 0, **calm, **values}


@pytest.mark.parametrize(
    ("row", "name"),
    [
        (seen(drift_um_s=0.1), "rests"),
        (seen(vertical_um_s=4.0), "sinks or tips"),
        (seen(used=1.0), "slides: a contact has no friction left"),
        (seen(changes=0.5), "contacts come and go"),
        (seen(pushed=0.3), "a neighbour pushes"),
        (seen(askew_deg=0.3), "stands askew"),
        (seen(), "friction gives way"),
    ],
)
def test_each_cause_has_its_sign(row: dict[str, object], name: str) -> None:
    assert cause(row) == name


def test_a_tower_rests_and_a_plan_that_falls_has_no_rows() -> None:
    boxes: tuple[Box, ...] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (300, 0, 200), 5.0))
    plans = [make_plan("tower", stack(3)), make_plan("falls", boxes)]
    table = drift_table(plans, Simulation(), SHORT, threads=1)
    assert list(table.plan_id) == ["tower"] * 3
    assert set(table.cause) == {"rests"}
    assert (table.askew_deg < 0.01).all()
    assert "1 plan, 3 boxes" in describe(table)
    assert describe(table[:0]) == "no plan stands"


def test_friction_gives_way_as_the_law_says() -> None:
    """A box on a slope of 6° creeps at v = R · f / b. R is proportional to 1 / impratio, and 1 / b to the time
    constant."""

    def creep(**values: Any) -> float:
        sim = Simulation(physics={"name": "pallet", "impratio": 1.0, **values}, thresholds={"tilt_deg": 90.0})
        table = drift_table([make_plan("wedge", WEDGE)], sim.changed(check="static"), SHORT, threads=1)
        return float(table.drift_um_s.max())

    fast = creep(solreffriction=(0.0, 0.0))
    assert fast / creep(solreffriction=(0.0, 0.0), impratio=20.0) == pytest.approx(20.0, rel=0.3)
    assert fast / creep(solreffriction=(0.004, 1.0)) == pytest.approx(0.02 / 0.004, rel=0.3)


WEDGE: tuple[Box, ...] = (
    ((400, 300, 20), (0, 0, 0), 5.0),
    ((400, 300, 200), (200, 0, 20), 10.0),
)
"""The upper box stands on the carrier with one edge and leans on the plate with another."""


def test_changes_of_plans_keep_what_they_should() -> None:
    plan = make_plan("tower", stack(4))
    rng = np.random.default_rng(0)
    masses = CHANGES["masses ± 2 %"].plans(plan, rng)
    assert (np.abs(masses.mass_kg / plan.mass_kg - 1) <= 0.02).all()
    assert (masses.mass_kg != plan.mass_kg).all()
    shuffled = CHANGES["order of the boxes in memory (static)"].plans(plan, rng)
    assert sorted(map(tuple, shuffled.corner_mm)) == sorted(map(tuple, plan.corner_mm))
    assert shuffled.item_ids != plan.item_ids or not np.array_equal(shuffled.corner_mm, plan.corner_mm)


def test_verdicts_are_compared_plan_by_plan() -> None:
    plans = [make_plan("tower", stack(3)), make_plan("low", stack(1))]
    names = ["masses ± 2 %", "order of the boxes in memory (static)"]
    tables = {name: (before, after) for name, before, after in sensitivity(plans, names, engine="mujoco", threads=1)}
    assert list(tables) == names
    for before, after in tables.values():
        assert list(after.index) == list(before.index)
        assert (after.verdict == "stable").all()


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plans = str(bundled_path())
    short = ["--limit", "1", "--threads", "1", "--out", str(tmp_path)]
    assert main(["drift", plans, *short, "--variant", "pallet", "--begin", "0.1", "--end", "0.3"]) == 0
    assert main(["sensitivity", plans, *short, "--change", "friction 0.45"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("pallet, ") == 2
    assert "friction 0.45: 0 of 1 verdicts change" in printed
    assert len(list(tmp_path.glob("*.parquet"))) == 4
    assert main(["drift", plans, "--variant", "none"]) == 2
    assert f"there are: {next(iter(VARIANTS))}" in capsys.readouterr().err


@pytest.mark.parametrize(("overhang_mm", "stands"), [(150.0, True), (230.0, False)])
def test_a_pose_balances_or_not(overhang_mm: float, stands: bool) -> None:
    """The centre of a box is 30 mm beyond the edge. The moment of its weight about the edge cannot be balanced."""
    scene = make_scene([((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (overhang_mm, 0, 200), 2.0)])
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    residual = left_over(scene, PHYSICS["pallet"], scene.target, quat)
    if stands:
        assert residual <= 1e-6
    else:
        assert BALANCED < residual < 0.2
