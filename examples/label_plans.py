"""Label many plans: writes a file with one row per plan, with which you can train or test a model.

    python examples/label_plans.py plans.json labels.parquet --run results

You can interrupt the run in the folder ``results``: the same command continues the run. The README gives the time for
10,000 plans under "How fast". With ``--confidence 16`` the label is the share of 16 worlds with errors that stand,
instead of 0 or 1. This takes much longer.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

import petmjx


def labels(results: petmjx.RunResults) -> pd.DataFrame:
    """A table of labels, one row per plan: plan_id, stands (0 or 1, or a share), margin, and the first box to fail.
    Plans without a verdict are left out."""
    worlds = results.worlds
    nominal = worlds[worlds["variant"] == 0] if "variant" in worlds else worlds
    known = nominal[nominal["verdict"] != "invalid"]
    table = known[["plan_id", "margin", "reason", "culprit", "first_sign_s"]].copy()
    table.insert(1, "stands", (known["verdict"] == "stable").astype(float))
    if results.summary is not None:  # a run with --confidence
        table["stands"] = table["plan_id"].map(results.summary.set_index("plan_id")["share"]).astype(float)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plans", type=Path)
    parser.add_argument("labels", type=Path, help="a .parquet or .csv file")
    parser.add_argument("--run", type=Path, default=Path("results"))
    parser.add_argument("--engine", choices=["auto", "mujoco", "mjx-warp"], default="auto")
    parser.add_argument("--confidence", type=int)
    arguments = parser.parse_args()

    results = petmjx.score(
        arguments.plans, engine=arguments.engine, confidence=arguments.confidence, out=arguments.run, resume=True
    )
    table = labels(results)
    if arguments.labels.suffix == ".csv":
        table.to_csv(arguments.labels, index=False)
    else:
        table.to_parquet(arguments.labels, index=False)
    print(f"{len(table):,} labels in {arguments.labels}, {table['stands'].mean():.1%} stand")
    print(f"{len(results.skipped):,} plans were skipped: {arguments.run / 'run.json'} says why")


if __name__ == "__main__":
    main()
