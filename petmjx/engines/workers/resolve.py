"""The workers of a run: joins the cluster, chooses the engine, and starts the pool."""

from __future__ import annotations

from petmjx.basics.text import counted
from petmjx.engines.choose import Choice, check_options, choose, options_of
from petmjx.engines.cost import Costs, Work
from petmjx.engines.workers.actor import Recipe
from petmjx.engines.workers.cluster import Cluster
from petmjx.engines.workers.places import places
from petmjx.engines.workers.pool import WorkerPool
from petmjx.options.run_options import AUTO, RunOptions


def resolve_workers(options: RunOptions, work: Work, costs: Costs) -> tuple[WorkerPool, Choice]:
    """The pool of a run with workers, and why its engine was chosen: ``auto`` counts the CPUs and GPUs of the cluster.

    Raises:
        InputError: unusable options, no cluster at the address, or more workers than it has room for.
        EngineUnavailable: Ray is not installed, or the engine cannot run in a worker.
    """
    workers, asked = options.asked_workers, str(options.engine)
    assert workers is not None
    if asked != AUTO:
        check_options(asked, **options_of(asked, options))
    cluster = Cluster(options.ray)
    try:
        nodes = cluster.nodes
        threads = sum(node.cpus for node in nodes)
        if options.threads is not None and workers != AUTO:
            threads = options.threads * int(workers)
        gpus = sum(node.gpus for node in nodes)
        used = gpus if workers == AUTO else min(gpus, int(workers))
        seconds = costs.seconds(work, max(threads, 1), max(used, 1))

        def why_no_gpu() -> str | None:
            return (
                None if gpus and (workers == AUTO or int(workers) <= gpus) else f"{counted(gpus, 'GPU')} in the cluster"
            )

        def why_no_kernel() -> str | None:
            return "not chosen for workers"  # each would compile the kernels

        name, reason = asked, "as asked for"
        if asked == AUTO:
            name, reason = choose(seconds, threads, used, why_no_gpu, why_no_kernel)
        limits = options_of(name, options)
        found = places(name, nodes, workers, limits.pop("threads", None))
        if name == "mujoco":
            limits["threads"] = 1  # a worker runs as many chunks side by side as it has threads
        elif name == "mjx-warp-cpu":
            limits["threads"] = min(place.cpus for place in found)
        pool = WorkerPool(Recipe(name, limits), found, cluster)
    except BaseException:
        cluster.close()
        raise
    return pool, Choice(name, f"{reason}, in {counted(len(found), 'worker')}", seconds.get(name))
