"""Chooses and starts the worker processes of a run: it joins the cluster, chooses the engine, and starts the workers.

If possible, the workers start while plans are read.
"""

from __future__ import annotations

import atexit
import threading
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace

from petmjx.common.text import count_text
from petmjx.engines.cost_model import Costs
from petmjx.engines.engine_choice import Choice, choose
from petmjx.engines.engine_registry import check_options, options_of
from petmjx.engines.expected_work import Work
from petmjx.engines.remote.ray_actor import Recipe
from petmjx.engines.remote.ray_cluster import END_S, Cluster
from petmjx.engines.remote.worker_pool import WorkerPool
from petmjx.engines.remote.worker_resources import Node, threads_beside, why_no_gpus, worker_resources
from petmjx.engines.subprocess.check_pool import max_check_processes
from petmjx.options.run_options import AUTO, RunOptions

Begun = tuple[Cluster, WorkerPool | None]
"""A cluster, and the pool of workers that uses it, if the pool has been started."""


class WorkerStartup:
    """Starts workers in a thread while plans are read. This thread starts or joins the cluster, and starts the pool of
    workers if the engine is known early.

    The caller must call ``take`` or ``give_up``.

    Args:
        worth_gpus: whether the engine ``auto`` would use the GPUs of a cluster.
    """

    def __init__(self, options: RunOptions, *, worth_gpus: bool) -> None:
        self._options, self._worth_gpus = options, worth_gpus
        self._begun: Future[Begun] = Future()
        self._decided = threading.Event()
        self._taken = False
        self._thread = threading.Thread(target=self._live, name="petmjx-workers-ahead", daemon=True)
        self._thread.start()

    def take(self) -> Begun:
        """The started cluster and pool of workers. The caller must close the cluster and the worker pool.

        Raises:
            InputError, EngineUnavailable: see ``resolve_workers``.
        """
        try:
            begun = self._begun.result()
            self._taken = True
            return begun
        finally:
            self._decided.set()

    def give_up(self) -> None:
        """Close the cluster and the worker pool as soon as they have started, in the thread that starts them. Returns
        at once. If this process ends before they are closed, it waits for that thread, at most ``END_S`` seconds."""
        self._decided.set()

    def _live(self) -> None:
        try:
            self._begun.set_result(self._begin())
        except BaseException as error:
            self._begun.set_exception(error)
        else:
            self._settle()
        atexit.unregister(self._end_with_process)

    def _settle(self) -> None:
        """Wait until the workers are taken or given up. If they are given up, close them."""
        self._decided.wait()
        if not self._taken:
            cluster, pool = self._begun.result()
            with suppress(Exception):  # nobody waits for the result, so the error is not reported
                (pool or cluster).close()

    def _end_with_process(self) -> None:
        self.give_up()
        with suppress(KeyboardInterrupt):
            self._thread.join(END_S)

    def _begin(self) -> Begun:
        cluster = _run_cluster(self._options)
        # if the process ends now, this thread must stop using Ray before Ray ends
        atexit.register(self._end_with_process)
        try:
            name = None if self._decided.is_set() else self._engine(cluster.nodes)
            return cluster, _pool(name, self._options, cluster) if name is not None else None
        except BaseException:
            cluster.close()
            raise

    def _engine(self, nodes: list[Node]) -> str | None:
        """The engine of the run, if it is known before the plans are known; otherwise None."""
        if self._options.engine != AUTO:
            return str(self._options.engine)
        workers = self._options.asked_workers
        assert workers is not None
        return "mjx-warp" if self._worth_gpus and why_no_gpus(nodes, workers) is None else None


def resolve_workers(
    options: RunOptions, work: Work, costs: Costs, startup: WorkerStartup | None = None
) -> tuple[WorkerPool, Choice]:
    """The pool of workers for a run, and the reason for the choice of its engine. ``auto`` chooses the engine that
    suits the CPUs and GPUs of the cluster.

    Args:
        startup: workers that have already been started for these options.

    Raises:
        InputError: the options are unusable, there is no cluster at the address, or the cluster does not have enough
            CPUs or GPUs for this number of workers.
        EngineUnavailable: Ray is not installed, or the engine cannot run in a worker.
    """
    cluster, pool = startup.take() if startup is not None else (_run_cluster(options), None)
    try:
        choice = _pool_choice(options, cluster.nodes, work, costs)
        if pool is not None and pool.name != choice.name:
            pool.dismiss()
            pool = None
        pool = pool or _pool(choice.name, options, cluster)
        pool.wait_for_first()
    except BaseException:
        (pool or cluster).close()
        raise
    return pool, replace(choice, reason=f"{choice.reason}, in {count_text(pool.size, 'worker')}")


def _run_cluster(options: RunOptions) -> Cluster:
    """The cluster of a run. Raises InputError if the options are unusable."""
    engine = str(options.engine)
    if engine != AUTO:
        check_options(engine, **options_of(engine, options))
    return Cluster(options.ray)


def _pool_choice(options: RunOptions, nodes: list[Node], work: Work, costs: Costs) -> Choice:
    """The engine of the workers, the reason for this choice, and the expected time."""
    workers, engine = options.asked_workers, str(options.engine)
    assert workers is not None
    threads = sum(node.cpus for node in nodes)
    if options.threads is not None and workers != AUTO:
        threads = options.threads * int(workers)
    gpus = sum(node.gpus for node in nodes)
    used = gpus if workers == AUTO else min(gpus, int(workers))  # a GPU that several workers share is counted once
    seconds = costs.seconds(work, max(threads, 1), max(used, 1))

    name, reason = engine, "as asked for"
    if engine == AUTO:
        name, reason = choose(
            seconds,
            threads,
            used,
            why_no_gpu=lambda: why_no_gpus(nodes, workers),
            why_no_kernel=lambda: "each worker would have to compile the kernels",
        )
    return Choice(name, reason, seconds.get(name))


def _pool(name: str, options: RunOptions, cluster: Cluster) -> WorkerPool:
    """A pool of workers, which start immediately."""
    assert options.asked_workers is not None
    limits = options_of(name, options)
    resources = worker_resources(name, cluster.nodes, options.asked_workers, limits.pop("threads", None))
    # on CPUs, all threads simulate, so no processes are started that check outcomes
    threads = threads_beside(cluster.nodes, len(resources)) if name == "mjx-warp" else 0
    return WorkerPool(Recipe(name, limits), resources, cluster, max_check_processes(threads))
