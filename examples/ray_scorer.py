"""Ray actors that each hold a warm engine and score plans on request: needs the extra ``ray``.

    python examples/ray_scorer.py plans.json --actors 2

On GPUs, give each actor a GPU: ``ScorerActor.options(num_gpus=1).remote(engine="mjx-warp")``.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pandas as pd
import ray

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
    parser.add_argument("--actors", type=int, default=2)
    parser.add_argument("--limit", type=int)
    arguments = parser.parse_args()

    plans = petmjx.load_plans(arguments.plans).plans[: arguments.limit]
    ray.init("local", include_dashboard=False, log_to_driver=False)  # on a cluster: ray.init("auto")
    actors: list[Any] = [
        ray.remote(ScorerActor).options(num_cpus=1).remote(engine="mujoco", threads=1) for _ in range(arguments.actors)
    ]
    shares = [plans[number :: len(actors)] for number in range(len(actors))]
    futures: list[Any] = [actor.worlds.remote(share) for actor, share in zip(actors, shares, strict=True) if share]
    worlds = pd.concat(ray.get(futures), ignore_index=True)
    print(worlds[["plan_id", "verdict", "reason", "margin"]].to_string(index=False))
    ray.shutdown()


if __name__ == "__main__":
    main()
