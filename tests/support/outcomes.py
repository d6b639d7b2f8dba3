"""Outcomes made by hand, for tests of code that handles results."""

from __future__ import annotations

from typing import Any

import numpy as np

from petmjx.engines.margin import margin_of
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.thresholds import Thresholds
from petmjx.plans.plan import Plan
from support import plans


def make_plan(plan_id: str = "00000001", n: int = 3) -> Plan:
    """A plan of n boxes."""
    return plans.make_plan(plan_id, n)


def make_boxes(n: int = 3, **changes: Any) -> BoxMetrics:
    """Metrics of n upright boxes at rest. The metrics of box k are multiples of k + 1 (shift in mm). ``changes``:
    replaces some of them."""
    k = np.arange(1.0, n + 1)
    metrics = {
        "shift_m": np.stack([k, -2 * k, np.zeros(n)], axis=1) / 1000,
        "max_tilt_deg": k,
        "max_lin_acc": 10 * k,
        "max_ang_acc": 20 * k,
        "max_top_force_n": 100 * k,
        "rest_top_force_n": 50 * k,
        "dropped": np.zeros(n, dtype=bool),
        "drop_s": np.full(n, np.nan),
        "max_sway_m": np.full(n, np.nan),
        "pos": np.stack([k, k, k], axis=1),
        "quat": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
    }
    return BoxMetrics.measured(n, **metrics | changes)


def make_outcome(
    n: int = 3, verdict: Verdict = Verdict.STABLE, reason: Reason = Reason.NONE, **changes: Any
) -> Outcome:
    """The outcome of a world. ``changes`` may also name fields of its boxes' metrics (``make_boxes``)."""
    of_boxes = {name: changes.pop(name) for name in tuple(changes) if name in BoxMetrics.__dataclass_fields__}
    values: dict[str, Any] = {
        "job": 0,
        "verdict": verdict,
        "reason": reason,
        "culprit": -1,
        "first_sign_s": float("nan"),
        "n_boxes": n,
        "n_placed": n,
        "sim_time_s": 1.5,
        "n_steps": 750,
        "flags": Flag.NONE,
        "boxes": make_boxes(n, **of_boxes),
        "engine": "mujoco",
    }
    outcome = Outcome(**values | changes)
    outcome.margin = margin_of(outcome.verdict, outcome.boxes, outcome.n_placed, Thresholds())
    return outcome


def dropped_outcome() -> Outcome:
    """An outcome in which box 1 of three failed first at 0.4 s and dropped at 0.8 s, before box 2 was placed."""
    return make_outcome(
        verdict=Verdict.UNSTABLE,
        reason=Reason.DROP,
        culprit=1,
        first_sign_s=0.4,
        n_placed=2,
        flags=Flag.EARLY_STOP,
        dropped=np.array([False, True, False]),
        drop_s=np.array([np.nan, 0.8, np.nan]),
        rest_top_force_n=np.full(3, np.nan),
    )
