"""Score plans on a Ray cluster, or on the GPUs or CPUs of this machine: needs the extra ``ray``.

    python examples/ray_cluster.py plans.json results --ray head:6379

Every machine needs the same versions of petmjx and of its simulation packages. If a worker dies, other workers
simulate its worlds. If this process dies, the same command continues the run.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import petmjx


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plans", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--ray", help="HOST:PORT of the cluster's head; without it: workers on this machine")
    parser.add_argument("--workers", type=int, help="by default one for each GPU, or for each machine")
    parser.add_argument("--engine", choices=["auto", "mujoco", "mjx-warp"], default="auto")
    arguments = parser.parse_args()

    results = petmjx.score(
        arguments.plans,
        engine=arguments.engine,
        ray=arguments.ray,
        workers=arguments.workers or "auto",
        out=arguments.results,
        resume=True,
    )
    print(results)


if __name__ == "__main__":  # workers also import this file
    main()
