"""Estimates of time and steps are compared with records of runs of many kinds, with 5 to 140 boxes, on all engines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.result_fields import read_lines
from benchmarks.time_estimates import OF_PLANS
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.expected_work import Work
from petmjx.options.simulation import SOFT_START_STEPS, Simulation

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
RECORDS = [
    line
    for line in read_lines([RESULTS / "cpu-0.3.jsonl", RESULTS / "h200-0.3.jsonl"])
    if line["case"] == "estimates" and not line.get("left_out")
]

SHORTEST_S = 0.2
"""Runs that take less CPU time than this are not compared: reading plans and writing results takes as long."""


def work_of(line: dict[str, Any]) -> Work:
    """The work of a recorded run. If a run had many plans, the record has a few sizes that represent all plans."""
    values = dict(line["work"])
    if (options := values.pop("sim", None)) is None:  # records on GPUs
        options = {name: values.pop(name) for name in ("check", "schedule", "carrier") if name in values}
    n_plans = values.pop("n_plans", len(values["boxes"]))
    given = [name for name in ("boxes", *OF_PLANS) if values.get(name)]
    of_plans = {name: np.resize(values.pop(name), n_plans).tolist() for name in given}
    return Work(Simulation(**options), **of_plans, **values)


def name_of(line: dict[str, Any]) -> str:
    return f"{line['engine']}, {line['what']}, {line['plans']}"


@pytest.mark.parametrize("line", RECORDS, ids=map(name_of, RECORDS))
def test_estimates_are_within_a_factor_of_two(line: dict[str, Any]) -> None:
    work, engine = work_of(line), line["engine"]
    costs = MEASURED.slowed(line.get("slowness", 1.0))
    start_s = costs.seconds(Work(work.sim, []), 1)[engine]
    expected_s = costs.seconds(work, line["threads"])[engine] - start_s
    seconds = line["cpu_s" if "cpu_s" in line else "seconds"]
    assert seconds < SHORTEST_S or 1 / 2 < expected_s / seconds < 2
    if "steps" in line and not work.share.min() < 1:
        soft_starts = 2 * SOFT_START_STEPS * work.placements * len(work.boxes)
        assert 1 / 2 < work.steps.sum() / (line["steps"] + soft_starts) < 2


def test_records_are_of_all_kinds() -> None:
    assert {line["engine"] for line in RECORDS} == {"mujoco", "mjx-warp-cpu", "mjx-warp"}
    for engine in ("mujoco", "mjx-warp-cpu"):
        kinds = {line["what"] for line in RECORDS if line["engine"] == engine}
        errors = {"confidence 4", "confidence 4 exact", "placement-error"}
        assert kinds >= errors | {"score", "static", "eumos", "eumos-search", "tilt"}
    boxes = [n for line in RECORDS for n in line["work"]["boxes"]]
    assert min(boxes) == 5
    assert max(boxes) > 120
