"""A Dask actor that keeps an engine warm and scores plans on request. It needs ``dask`` and ``distributed``.

python examples/dask_scorer.py plans.json --workers 2
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pandas as pd
from dask.distributed import Client

import petmjx


class ScorerActor:
    """An actor with one engine, which stays warm between calls."""

    def __init__(self, **options: Any) -> None:
        self._scorer = petmjx.Scorer(**options)

    def worlds(self, plans: list[petmjx.Plan]) -> pd.DataFrame:
        """The table ``worlds`` of these plans: one row per plan, in the order of the plans."""
        return self._scorer.score(plans).worlds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plans", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--limit", type=int)
    arguments = parser.parse_args()

    plans = petmjx.load_plans(arguments.plans).plans[: arguments.limit]
    with Client(n_workers=arguments.workers, threads_per_worker=1, dashboard_address=None) as client:
        made = [client.submit(ScorerActor, actor=True, engine="mujoco", threads=1, pure=False) for _ in range(2)]
        actors = [future.result() for future in made]
        futures = [actor.worlds(plans[number :: len(actors)]) for number, actor in enumerate(actors)]
        worlds = pd.concat([answer.result() for answer in futures], ignore_index=True)
    print(worlds[["plan_id", "verdict", "reason", "margin"]].to_string(index=False))


if __name__ == "__main__":
    main()
