"""Plans for which petmjx once gave a wrong answer, as users reported them. Each now has the right answer.

Similar reports that do not concern single plans have tests in other files: commands that replaced files
(test_overwrite_guard.py, test_overwriting.py), leaderboards (test_packer_rating.py), outcomes held back
(test_outcomes_held_back.py), Parquet (test_parquet_bounds.py), read-only homes (test_compile_caches.py), Gymnasium
(test_gym.py), strength (test_box_loads.py), rocking, landings and soft boxes (tests/physics).
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import petmjx
from petmjx.common.errors import PlanWarning
from petmjx.engines.verdict import Flag

CASES = Path(__file__).parents[3] / "shared/cases"
FILES = ("counterweight_last", "edge_hidden", "edge_springs_pull", "tipped_but_stable", "turned_twice")

pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="needs ../shared/cases")

MM = 1e-3
EDGE_MM = 0.05
"""Tolerance of distances from edges at rest, mm. Contacts give way by some hundredths of a millimetre."""


@pytest.fixture(scope="module")
def results() -> petmjx.RunResults:
    with pytest.warns(PlanWarning, match="turned by their orientation look swapped"):
        return petmjx.score([CASES / f"{name}.csv" for name in FILES], engine="mujoco", threads=2)


@pytest.fixture(scope="module")
def worlds(results: petmjx.RunResults) -> pd.DataFrame:
    return results.worlds.set_index("plan_id")


@pytest.mark.parametrize(
    ("plan_id", "expected"),
    [
        # the beam with a box on its end tips over from step 2 on, before the counterweight, box 3, is placed
        ("counterweight-last", {"verdict": "unstable", "build_edge_mm": -58.8, "of": (1, 2)}),
        ("counterweight-first", {"verdict": "stable", "plan_edge_mm": 19.95}),
        # a load is 0.25 mm inside an edge, on a plan of its own or beside five other boxes
        ("edge-only", {"verdict": "stable", "plan_edge_mm": 0.25, "box": 1, "flags": Flag.KNIFE_EDGE}),
        ("both", {"verdict": "stable", "plan_edge_mm": 0.25, "box": 1, "flags": Flag.KNIFE_EDGE}),
        # with supports that can pull, this load was computed to be 338.6 mm beyond an edge; real supports only push
        ("pull", {"verdict": "stable", "plan_edge_mm": 19.95, "rest_edge_mm": 19.95, "flags": Flag.NONE}),
        # the lid tips by 11 degrees onto its neighbour, and stays there
        ("tips-onto-neighbour", {"verdict": "stable", "tilt_deg": 11.4, "flags": Flag.LEANS}),
        ("flat", {"verdict": "stable", "tilt_deg": 0.0, "flags": Flag.NONE}),
    ],
)
def test_a_plan(plan_id: str, expected: dict[str, Any], worlds: pd.DataFrame) -> None:
    world = worlds.loc[plan_id]
    assert world["verdict"] == expected["verdict"]
    for name in ("plan_edge", "rest_edge", "build_edge"):
        if f"{name}_mm" in expected:
            assert world[f"{name}_m"] / MM == pytest.approx(expected[f"{name}_mm"], abs=EDGE_MM)
    if "of" in expected:
        assert (world["build_edge_box"], world["build_edge_step"]) == expected["of"]
    if "box" in expected:
        assert world["plan_edge_box"] == expected["box"]
    if "flags" in expected:
        assert world["flags"] == int(expected["flags"])
    if "tilt_deg" in expected:
        assert world["max_tilt_deg"] == pytest.approx(expected["tilt_deg"], abs=0.2)


def test_sizes_that_were_turned_already_are_named(results: petmjx.RunResults) -> None:
    """The sizes in the file are those of the rotated boxes, but the file also gives an orientation. With the sizes as
    given, the pallet stands. If boxes are rotated once more, as the file states, it is another pallet."""
    (note,) = (line for line in results.info["warnings"] if "look swapped" in line)
    assert "turned by their orientation look swapped: in plan mixed-turned 9 pairs of boxes overlap" in note
    frame = pd.read_csv(CASES / "turned_twice.csv").drop(columns="orientation")
    assert petmjx.score(frame, engine="mujoco", threads=2).worlds["verdict"].tolist() == ["stable"]


@pytest.mark.parametrize("factor", [0.9, 1.0])
def test_the_nearest_loads_are_looked_at_in_stiffer_contacts(factor: float) -> None:
    """The load is 0.39 or 0.44 mm inside the edge. With soft contacts the box tips, with stiff contacts it does not."""
    lines = (CASES / "edge_at_0_39_mm.py").read_text().splitlines()
    size, corner, mass = (
        np.array(ast.literal_eval(line.partition("np.array(")[2].removesuffix(")")))
        for letter in "SCM"
        for line in lines
        if line.startswith(f"{letter} = ")
    )
    plan = petmjx.Plan.from_boxes("p", size_mm=size * factor, corner_mm=corner * factor, mass_kg=mass)
    (world,) = petmjx.score(plan, engine="mujoco", threads=1).worlds.to_dict("records")
    assert (world["verdict"], world["flags"] & int(Flag.KNIFE_EDGE) > 0) == ("stable", True)
    assert 0 < world["rest_edge_m"] < 0.5 * MM
