"""Runs made by hand for tests of reports. No world is simulated, so the outcome of each world is known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.results.plan_digests import records_of
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_writer import RunWriter
from petmjx.world.scene import build_scene
from support.outcomes import make_outcome
from support.plan_files import placement

ARTICLES = ("tea", "milk", "rice", "soap", "jam")
PER_LAYER = 6
CONFIG = {"command": "score", "simulation": Simulation().model_dump(mode="json"), "engine": "mujoco"}


def write_plans(file: Path, ids: Sequence[str], n_boxes: int = 12) -> list[Plan]:
    """Plans of cartons in layers of six, written to a file and read by petmjx. Plan k has k % 3 boxes fewer than
    ``n_boxes``."""
    entries = {plan_id: [_carton(box, k) for box in range(n_boxes - k % 3)] for k, plan_id in enumerate(ids)}
    file.write_text(json.dumps(entries), encoding="utf-8")
    return load_plans(file).plans


def _carton(box: int, plan: int) -> dict[str, Any]:
    layer, place = divmod(box, PER_LAYER)
    corner = (400 * (place % 3), 300 * (place // 3), 200 * layer)
    article = ARTICLES[(box + plan) % len(ARTICLES)]
    more = {"article": article, "id": f"{article}-{box}", "weight/kg": 2.0 + (box + plan) % 7}
    return placement(corner=corner, size=(400, 300, 200), sequence=box + 1, **more)


def standing(plan: Plan, seed: int = 0) -> Outcome:
    """An outcome in which every box moved by less than a tenth of a millimetre."""
    return _ended(plan, np.random.default_rng(seed), 1e-4, 1e-4)


def fallen(plan: Plan, seed: int = 0, *, reason: Reason = Reason.DROP, first: int | None = None) -> Outcome:
    """An outcome in which box ``first`` (by default the last box) failed first at 3.2 s and lies on the floor. The
    other boxes moved a little."""
    box = plan.n_boxes - 1 if first is None else first
    outcome = _ended(plan, np.random.default_rng(seed), 0.01, 0.05)
    outcome.boxes.pos[box] = [1.6, 0.4, -0.1]
    outcome.boxes.shift_m[box] = [0.9, 0.1, -0.5]
    outcome.boxes.max_tilt_deg[box] = 87.0
    if reason is Reason.DROP:
        outcome.boxes.dropped[box] = True
        outcome.boxes.drop_s[box] = 3.6
    return replace(outcome, verdict=Verdict.UNSTABLE, reason=reason, culprit=box, first_sign_s=3.2, margin=-0.5)


def invalid(plan: Plan) -> Outcome:
    """An invalid outcome, in which all metrics are missing."""
    n = plan.n_boxes
    nothing = {"shift_m": np.full((n, 3), np.nan), "pos": np.full((n, 3), np.nan), "quat": np.full((n, 4), np.nan)}
    names = ("max_tilt_deg", "max_lin_acc", "max_ang_acc", "max_top_force_n", "rest_top_force_n")
    nothing |= {name: np.full(n, np.nan) for name in names}
    return replace(make_outcome(n, Verdict.INVALID, Reason.FAILED, **nothing), n_placed=0)


def _ended(plan: Plan, random: np.random.Generator, move_m: float, turn: float) -> Outcome:
    """An outcome in which all boxes are a little displaced and turned."""
    n = plan.n_boxes
    moved = random.normal(0, move_m, (n, 3))
    quat = np.column_stack([np.ones(n), random.normal(0, turn, (n, 3))])
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    return make_outcome(
        n,
        pos=build_scene(plan, Simulation()).target + moved,
        quat=quat,
        shift_m=np.where(np.abs(moved) < 0.001, 0.0, moved),
        max_tilt_deg=np.degrees(2 * np.arcsin(np.linalg.norm(quat[:, 1:3], axis=1))),
        max_top_force_n=random.lognormal(4.0, 1.0, n),
        rest_top_force_n=random.lognormal(3.5, 1.0, n),
    )


def write_run(folder: Path, plans: Sequence[Plan], outcomes: Sequence[Outcome], **options: Any) -> Path:
    """Write the folder of a finished score of these plans. ``options``: arguments of ``RunWriter``."""
    config = options.pop("config", CONFIG)
    manifest = Manifest({"command": "score"}, records_of(plans))
    more: dict[str, Any] = {"manifest": manifest, "expected_worlds": len(plans), "device": "two threads"}
    with RunWriter(folder, config, **more | options) as run:
        for plan, outcome in zip(plans, outcomes, strict=True):
            run.add(plan, 0, "adaptive", outcome)
    return folder


def scored(folder: Path, n: int = 30, n_boxes: int = 12) -> Path:
    """A run of n plans "plan-0" … in the folder ``run``. Of each ten plans, numbers 3 and 7 fall (7 by a tilt), and
    number 9 is invalid."""
    plans = write_plans(folder / "plans.json", [f"plan-{k}" for k in range(n)], n_boxes)
    return write_run(folder / "run", plans, [_outcome(plan, k) for k, plan in enumerate(plans)])


def _outcome(plan: Plan, number: int) -> Outcome:
    if number % 10 == 3:
        return fallen(plan, number)
    if number % 10 == 7:
        return fallen(plan, number, reason=Reason.TILT, first=2)
    return invalid(plan) if number % 10 == 9 else standing(plan, number)
