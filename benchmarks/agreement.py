"""Whether runs of the same plans say the same. Also by hand, for runs made elsewhere or in several pieces:

python -m benchmarks.agreement --label mujoco-fixed --oracle DIR [DIR …] --run DIR [DIR …] [--out FILE]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.record import append_line, environment, rounded
from petmjx.results.compare import BOX_KEY, KEY, compare_runs
from petmjx.results.reader import RunResults, load_run
from petmjx.verdict import Reason, Verdict

LOADED_N = 1.0
"""Boxes that carry less than this, N, have no resting force to compare."""

_FLIP_FIELDS = ("verdict", "reason", "culprit", "first_sign_s", "n_dropped", "shift_margin_m", "tilt_margin_deg")


def merged(folders: Sequence[Path]) -> RunResults:
    """Runs of different plans under one configuration, as one run. Worlds that are in several count once."""
    runs = [load_run(folder) for folder in folders]
    whole = RunResults(runs[0].path, runs[0].info)
    if len(runs) > 1:
        # fills the cached tables, which are then not read from the first folder
        vars(whole)["worlds"] = pd.concat([run.worlds for run in runs]).drop_duplicates(KEY)
        vars(whole)["boxes"] = pd.concat([run.boxes for run in runs]).drop_duplicates(BOX_KEY)
    return whole


def agreement(oracle: Sequence[Path], run: Sequence[Path]) -> dict[str, Any]:
    """How a run's verdicts and resting forces agree with the yardstick's, over the worlds that both have.

    Returns:
        ``common``, ``same``, ``share``, ``flips`` (each with both verdicts and by how much shift and tilt are over
        (+) or under their thresholds), ``stable_here_dropped_there``, and ``rest_top_force``: relative differences
        over single boxes of plans that stand in both.
    """
    there, here = merged(oracle), merged(run)
    found = compare_runs(there, here)
    flips = [
        {
            "plan_id": row["plan_id"],
            "oracle": {name: row[f"{name}_a"] for name in _FLIP_FIELDS},
            "here": {name: row[f"{name}_b"] for name in _FLIP_FIELDS},
        }
        for row in found.to_dict()["flips"]
    ]
    missed = [
        flip["plan_id"]
        for flip in flips
        if flip["here"]["verdict"] == Verdict.STABLE.value and flip["oracle"]["reason"] == Reason.DROP.value
    ]
    return {
        "common": found.n_common,
        "same": found.n_agree,
        "share": found.agreement,
        "same_reason": found.same_reason,
        "same_culprit": found.same_culprit,
        "not_stable": found.n_not_stable,
        "stable_here_dropped_there": missed,
        "rest_top_force": rest_force_differences(there, here),
        "flips": flips,
    }


def rest_force_differences(oracle: RunResults, run: RunResults) -> dict[str, Any]:
    """|here − there| / there of ``rest_top_force_n``, over boxes with more than ``LOADED_N`` of standing plans."""
    stands = [results.worlds.loc[results.worlds["verdict"] == Verdict.STABLE.value, KEY] for results in (oracle, run)]
    worlds = stands[0].merge(stands[1], on=KEY)
    columns = [*BOX_KEY, "rest_top_force_n"]
    boxes = oracle.boxes[columns].merge(run.boxes[columns], on=BOX_KEY, suffixes=("_a", "_b")).merge(worlds, on=KEY)
    there = boxes["rest_top_force_n_a"].to_numpy(float)
    here = boxes["rest_top_force_n_b"].to_numpy(float)
    counted = (there > LOADED_N) & np.isfinite(here)
    if not counted.any():
        return {"boxes": 0, "median": None, "p95": None}
    difference = np.abs(here - there)[counted] / there[counted]
    median, p95 = (float(value) for value in np.percentile(difference, [50, 95]))
    return {"boxes": int(counted.sum()), "median": median, "p95": p95}


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line of the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--label", required=True, help="name of the yardstick, such as mujoco-fixed")
    parser.add_argument("--oracle", type=Path, nargs="+", required=True, help="folders of the yardstick's runs")
    parser.add_argument("--run", type=Path, nargs="+", required=True, help="folders of the runs that are judged")
    parser.add_argument("--case", default="", help="name of the case, for the table")
    parser.add_argument("--out", type=Path, help="file of JSON lines; without: print")
    options = parser.parse_args(arguments)
    info = load_run(options.run[0]).info
    result = {
        "benchmark": "agreement",
        "case": options.case,
        **environment(),
        "engine": info["config"]["engine"],
        "device": info["device"],
        "agreement": {options.label: agreement(options.oracle, options.run)},
    }
    if options.out is None:
        print(json.dumps(rounded(result), ensure_ascii=False, indent=1))
    else:
        append_line(options.out, result)


if __name__ == "__main__":
    main()
