"""Agreement between runs of the same plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from petmjx.analysis.run_comparison import BOX_KEY, KEY, compare_runs
from petmjx.engines.verdict import Reason, Verdict
from petmjx.results.run_reader import RunResults, load_run
from petmjx.results.share_statistics import ONE_PLAN, share_standing
from petmjx.results.to_json import to_json

LOADED_N = 1.0
"""Smallest resting force that is compared, N."""

_FLIP_FIELDS = ("verdict", "reason", "culprit", "first_sign_s", "n_dropped", "shift_margin_m", "tilt_margin_deg")


@dataclass(frozen=True, eq=False)
class JointRun(RunResults):
    """Several runs with the same options, joined to one run. A world that is in several runs counts once."""

    runs: tuple[RunResults, ...] = ()

    @cached_property
    def worlds(self) -> pd.DataFrame:
        """One row per world."""
        return pd.concat([run.worlds for run in self.runs]).drop_duplicates(KEY)

    @cached_property
    def boxes(self) -> pd.DataFrame:
        """One row per box of each world."""
        return pd.concat([run.boxes for run in self.runs]).drop_duplicates(BOX_KEY)


def joint_run(folders: Sequence[Path]) -> JointRun:
    """The runs in these folders, joined to one run that has the path and the options of the first run."""
    runs = tuple(load_run(folder) for folder in folders)
    return JointRun(runs[0].parts, runs[0].info, runs=runs)


def agreement(oracle: Sequence[Path], run: Sequence[Path]) -> dict[str, Any]:
    """How well the verdicts and the forces at rest of a run agree with those of its oracle, in the worlds that both
    runs have.

    Returns:
        The fields that benchmarks/README.md lists ("How to read a result"); the field ``shares`` is the result of
        :func:`compare_shares`.
    """
    oracle_run, here = joint_run(oracle), joint_run(run)
    comparison = compare_runs(oracle_run, here)
    parameters = [parameter["name"] for parameter in here.info.get("params", [])]
    worlds = [*KEY, *parameters]
    sides = {"oracle": "a", "here": "b"}
    flips = [
        {name: row[name] for name in worlds}
        | {label: {name: row[f"{name}_{side}"] for name in _FLIP_FIELDS} for label, side in sides.items()}
        for row in to_json(comparison.flips.merge(here.worlds[worlds], on=KEY, how="left"))
    ]
    plans = set(oracle_run.worlds["plan_id"]) & set(here.worlds["plan_id"])
    return {
        "common": comparison.n_common,
        "same": comparison.n_agree,
        "share": comparison.agreement,
        "same_reason": comparison.same_reason,
        "same_culprit": comparison.same_culprit,
        "not_stable": comparison.n_not_stable,
        "plans": len(plans),
        "plans_all_the_same": len(plans - {flip["plan_id"] for flip in flips}),
        "stable_here_dropped_there": [
            flip["plan_id"]
            for flip in flips
            if flip["here"]["verdict"] == Verdict.STABLE.value and flip["oracle"]["reason"] == Reason.DROP.value
        ],
        "rest_top_force": rest_force_differences(oracle_run, here),
        **({"shares": compare_shares(oracle_run, here)} if "replicate" in parameters else {}),
        "flips": flips,
    }


def rest_force_differences(oracle: RunResults, run: RunResults) -> dict[str, Any]:
    """Relative differences of ``rest_top_force_n`` between the two runs, |force in ``run`` − force in ``oracle``| /
    force in ``oracle``, for boxes with a force of more than ``LOADED_N`` in plans that stand."""
    stands = [results.worlds.loc[results.worlds["verdict"] == Verdict.STABLE.value, KEY] for results in (oracle, run)]
    worlds = stands[0].merge(stands[1], on=KEY)
    columns = [*BOX_KEY, "rest_top_force_n"]
    boxes = oracle.boxes[columns].merge(run.boxes[columns], on=BOX_KEY, suffixes=("_a", "_b")).merge(worlds, on=KEY)
    oracle_n = boxes["rest_top_force_n_a"].to_numpy(float)
    here = boxes["rest_top_force_n_b"].to_numpy(float)
    counted = (oracle_n > LOADED_N) & np.isfinite(here)
    if not counted.any():
        return {"boxes": 0, "median": None, "p95": None}
    median, p95 = np.percentile(np.abs(here - oracle_n)[counted] / oracle_n[counted], [50, 95]).tolist()
    return {"boxes": int(counted.sum()), "median": median, "p95": p95}


def compare_shares(oracle: RunResults, run: RunResults) -> dict[str, Any]:
    """Compare, for each plan, the share of standing worlds in both runs. Invalid worlds do not count.

    Returns:
        ``plans``; ``agree``: plans whose share in each run is in the Wilson 95 % interval of the other run;
        ``intervals_overlap``; ``differ``: the plans that do not agree, with both shares.
    """
    drawn = (results.worlds.assign(draw=results.worlds["replicate"]) for results in (oracle, run))
    shares = (share_standing(worlds, ()) for worlds in drawn)
    a, b = (share[share["scope"] == ONE_PLAN].set_index("plan_id") for share in shares)
    both = a.add_suffix("_a").join(b.add_suffix("_b"), how="inner")
    here_in_there = both["share_b"].between(both["low_a"], both["high_a"])
    agree = here_in_there & both["share_a"].between(both["low_b"], both["high_b"])
    overlap = (both["low_a"] <= both["high_b"]) & (both["low_b"] <= both["high_a"])
    differ = both[~agree].reset_index().rename(columns={"share_a": "oracle", "share_b": "here"})
    return {
        "plans": len(both),
        "agree": int(agree.sum()),
        "intervals_overlap": int(overlap.sum()),
        "differ": to_json(differ[["plan_id", "oracle", "here"]]),
    }
