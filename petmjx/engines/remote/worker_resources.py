"""The number of workers on a cluster, and the number of CPUs and GPUs of each worker. This module does not need Ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.text import count_text
from petmjx.options.run_options import AUTO

MOST_SHARING = 4
"""Largest number of workers that share a GPU. Each worker has its own context, tables and buffers in the GPU's memory.
For sweeps of small worlds, four processes used a GPU hardly better than two (benchmarks/notebook/performance.md)."""

PARTS = 10_000
"""Number of equal parts into which Ray divides a GPU."""


@dataclass(frozen=True)
class Node:
    """The CPUs and GPUs of one machine of a cluster."""

    cpus: int
    gpus: int = 0


@dataclass(frozen=True)
class WorkerResources:
    """The CPUs and GPUs of one worker.

    Attributes:
        cpus: number of CPUs of the worker, all on one machine. Without a GPU, the engine of the worker has this number
            of threads.
        gpus: number of GPUs on the same machine, or the share of one GPU.
    """

    cpus: int
    gpus: float = 0


def worker_resources(
    engine: str, nodes: Sequence[Node], workers: int | str, threads: int | None = None
) -> list[WorkerResources]:
    """The CPUs and GPUs of all workers.

    Args:
        workers: number of workers. ``auto``: one per GPU, or, without GPUs, one per machine with all its CPUs. If there
            are more workers than GPUs, each GPU is shared by the same number of workers.
        threads: number of threads of each worker of ``mujoco``. If ``threads`` is None, the number is the worker's
            share of the CPUs.

    Raises:
        InputError: the cluster does not have enough CPUs, or cannot put the same number of workers on each GPU.
        EngineUnavailable: the engine needs a GPU, and the cluster has none.
    """
    gpus = sum(node.gpus for node in nodes)
    if engine == "mjx-warp" or (engine == "mjx-jax" and gpus):
        if not gpus:
            raise EngineUnavailable(f"engine {engine} cannot run here: {why_no_gpus(nodes, workers)}")
        if fault := why_no_gpus(nodes, workers):
            raise InputError(f"workers: {fault}")
        number = gpus if workers == AUTO else int(workers)
        # A worker's share of a GPU is rounded down to a whole number of ``PARTS``-ths. Then exactly the intended number
        # of workers fits on each GPU. So each GPU gets this number, whichever GPU Ray fills first.
        share = PARTS // _sharing(gpus, number) / PARTS
        return [WorkerResources(cpus=1, gpus=share)] * number
    if workers == AUTO:
        sizes = [(node.cpus, threads or node.cpus) for node in nodes if node.cpus]
        cpus = [part for total, part in sizes for _ in range(total // part)]
        fit = bool(cpus)
    else:
        worker_cpus = threads or _share(nodes, int(workers))
        cpus = [worker_cpus] * int(workers)
        fit = sum(node.cpus // worker_cpus for node in nodes) >= len(cpus)
    if not fit:
        crew = "a worker" if workers == AUTO else count_text(int(workers), "worker")
        raise InputError(f"workers: no room for {crew} of {count_text(threads or 1, 'CPU')}; {_has(nodes)}")
    return [WorkerResources(cpus=count) for count in cpus]


def why_no_gpus(nodes: Sequence[Node], workers: int | str) -> str | None:
    """The reason why the GPUs cannot be divided among this number of workers, in a few words; None if the GPUs can be
    divided.

    A worker gets a whole GPU, or the same share of a GPU as all other workers. With shares of two sizes, Ray might
    leave no room for the last worker. If the shares of a GPU did not add up to a whole GPU, Ray might put too many
    workers on one GPU and leave another GPU idle.
    """
    gpus = sum(node.gpus for node in nodes)
    if not gpus:
        return _has(nodes)
    if workers == AUTO:
        return None
    number = int(workers)
    per_gpu = _sharing(gpus, number)
    if per_gpu > MOST_SHARING:
        return f"at most {MOST_SHARING} workers share a GPU, so there is no room for {number}; {_has(nodes)}"
    if number > gpus and number % gpus:
        return f"{number} workers cannot share {gpus} GPUs evenly, {number - number % gpus} can; {_has(nodes)}"
    if sum(min(node.cpus, per_gpu * node.gpus) for node in nodes) < number:
        return (
            f"the machines with GPUs have too few CPUs for {count_text(number, 'worker')} with 1 CPU each; "
            f"{_has(nodes)}"
        )
    return None


def threads_beside(nodes: Sequence[Node], workers: int) -> int:
    """The smallest number of CPU threads per worker, if each machine has as many workers as its GPUs allow."""
    per_gpu = _sharing(sum(node.gpus for node in nodes), workers)
    return min(node.cpus // min(per_gpu * node.gpus, workers) for node in nodes if node.gpus)


def _sharing(gpus: int, workers: int) -> int:
    """The largest number of workers on one GPU."""
    return -(-workers // gpus)


def _share(nodes: Sequence[Node], workers: int) -> int:
    """The largest number of CPUs per worker with which there is room for all workers, if each worker has all its CPUs
    on one machine. The result is at least 1.
    """
    most = max(sum(node.cpus for node in nodes) // workers, 1)
    return next((share for share in range(most, 1, -1) if sum(node.cpus // share for node in nodes) >= workers), 1)


def _has(nodes: Sequence[Node]) -> str:
    cpus, gpus = sum(node.cpus for node in nodes), sum(node.gpus for node in nodes)
    on = "" if len(nodes) == 1 else f" on {count_text(len(nodes), 'node')}"
    return f"there are {count_text(cpus, 'CPU')} and {count_text(gpus, 'GPU')}{on}"
