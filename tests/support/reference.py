"""Real plans, and the results that the reference implementation printed for them. The plans and the results are stored
in tests/oracle."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.box_motion import tilt_deg
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.simulation import Check
from petmjx.plans.plan import Plan
from support.plans import make_plan

TILT_DEG = 0.1
"""Largest difference of tilts that count as equal, degrees. The reference rounds to 0.1°."""
FORCE_RELATIVE = 0.01
FORCE_N = 0.01
"""Largest difference of forces that count as equal, N. The reference rounds to 0.01 N."""
SHIFT_FLOOR_M = 0.001
"""Both implementations set smaller shift components to 0. So a component near 1 mm may be 0 in only one of them."""


@dataclass(frozen=True)
class ReferenceRun:
    """The results of the reference for one plan: (n, 3) final shifts in m, (n,) largest tilts in degrees, and (n,)
    largest forces on tops in N."""

    steps: int
    stable: bool
    shift_m: FloatArray
    max_tilt_deg: FloatArray
    max_top_force_n: FloatArray


@cache
def _figures() -> dict[str, Any]:
    figures: dict[str, Any] = json.loads((Path(__file__).parents[1] / "oracle/reference_figures.json").read_text())
    return figures


@cache
def real_plans() -> dict[str, Plan]:
    """Plan id → plan: the pallet of the paper, which a robot built, and five pallets packed from orders of BED-BPP."""
    return {
        plan_id: make_plan(plan_id, [(tuple(row[:3]), tuple(row[3:6]), row[6]) for row in rows])
        for plan_id, rows in _figures()["plans"].items()
    }


def reference_run(plan_id: str, check: Check, forces: bool = False) -> ReferenceRun:
    """The results of one run of the reference. ``forces``: whether seven radial profiles shake the carrier after
    placement."""
    (run,) = (r for r in _figures()["runs"] if (r["plan"], r["check"], r["forces"]) == (plan_id, check.value, forces))
    boxes = np.array(run["boxes"], float)
    return ReferenceRun(run["steps"], run["stable"], boxes[:, :3], boxes[:, 3], boxes[:, 4])


def shift_difference(ours: FloatArray, theirs: FloatArray) -> float:
    """Largest difference of a shift component, m. If a component is 0 in only one of the two results, its difference is
    reduced by 1 mm."""
    one_zero = (ours == 0.0) != (theirs == 0.0)
    difference = np.abs(ours - theirs)
    return float(np.where(one_zero, np.maximum(difference - SHIFT_FLOOR_M, 0.0), difference).max())


def assert_matches(outcome: Outcome, run: ReferenceRun, shift_m: float, force_n: float = FORCE_N) -> None:
    """Check the verdict, the number of steps, and the shift, tilt and top force of every box."""
    assert outcome.verdict is not Verdict.INVALID
    assert (outcome.verdict is Verdict.STABLE) == run.stable
    assert outcome.n_steps == run.steps
    assert shift_difference(outcome.boxes.shift_m, run.shift_m) < shift_m
    # The reference measures tilts only at samples. In petmjx, the final pose counts, too, in which boxes may still be
    # falling.
    max_tilt_deg = np.maximum(run.max_tilt_deg, tilt_deg(outcome.boxes.quat))
    assert np.abs(outcome.boxes.max_tilt_deg - max_tilt_deg).max() < TILT_DEG
    np.testing.assert_allclose(outcome.boxes.max_top_force_n, run.max_top_force_n, rtol=FORCE_RELATIVE, atol=force_n)
