"""How many workers a cluster gets, and what each of them takes. Nothing here knows Ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.text import count_text
from petmjx.options.run_options import AUTO

MOST_SHARING = 4
"""Most workers of a GPU. Each has a context, tables and buffers of its own in its memory. In sweeps of small worlds
four processes kept a GPU hardly busier than two (benchmarks/notebook/performance.md)."""

PARTS = 10_000
"""Ray counts a GPU in so many parts."""


@dataclass(frozen=True)
class Node:
    """What one machine of a cluster has."""

    cpus: int
    gpus: int = 0


@dataclass(frozen=True)
class Place:
    """What one worker takes.

    Attributes:
        cpus: of one node.
        gpus: of that node, or the share of one GPU.
        slots: chunks of jobs that it simulates side by side: the threads of ``mujoco``; MJX engines have one.
    """

    cpus: int
    gpus: float = 0
    slots: int = 1


def places(engine: str, nodes: Sequence[Node], workers: int | str, threads: int | None = None) -> list[Place]:
    """The places of all workers.

    Args:
        workers: their number; ``auto``: one for each GPU, or else one for each node, with all its CPUs. If there are
            more workers than GPUs, as many share each GPU.
        threads: of each worker of ``mujoco``; None: its share of the CPUs.

    Raises:
        InputError: the cluster can never place so many, or not as many on each GPU.
        EngineUnavailable: the engine needs a GPU, and there is none.
    """
    gpus = sum(node.gpus for node in nodes)
    if engine == "mjx-warp" or (engine == "mjx-jax" and gpus):
        if not gpus:
            raise EngineUnavailable(f"engine {engine} cannot run here: {why_no_gpus(nodes, workers)}")
        if why := why_no_gpus(nodes, workers):
            raise InputError(f"workers: {why}")
        number = gpus if workers == AUTO else int(workers)
        # Whole parts, rounded down: so many fit into a GPU, and not one more. All GPUs are then full, whichever of them
        # Ray takes first.
        share = PARTS // _sharing(gpus, number) / PARTS
        return [Place(cpus=1, gpus=share)] * number
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
    return [Place(cpus=count, slots=count if engine == "mujoco" else 1) for count in cpus]


def why_no_gpus(nodes: Sequence[Node], workers: int | str) -> str | None:
    """Why the GPUs cannot be divided among so many workers, in a few words; None if they can.

    A worker takes a whole GPU, or the same share as all others do: with shares of two sizes Ray might leave no room for
    the last one, and with GPUs that are not full it would rather fill one than use them all.
    """
    gpus = sum(node.gpus for node in nodes)
    if not gpus:
        return _has(nodes)
    if workers == AUTO:
        return None
    number = int(workers)
    per_gpu = _sharing(gpus, number)
    if per_gpu > MOST_SHARING:
        return f"at most {MOST_SHARING} share a GPU, so {number} have no room; {_has(nodes)}"
    if number > gpus and number % gpus:
        return f"{number} cannot share {gpus} GPUs evenly, {number - number % gpus} can; {_has(nodes)}"
    if sum(min(node.cpus, per_gpu * node.gpus) for node in nodes) < number:
        return f"no room for {count_text(number, 'worker')} of 1 CPU beside the GPUs; {_has(nodes)}"
    return None


def threads_beside(nodes: Sequence[Node], workers: int) -> int:
    """The fewest CPU threads that each of so many workers with GPUs has, where a machine has as many of them as its
    GPUs have room for."""
    per_gpu = _sharing(sum(node.gpus for node in nodes), workers)
    return min(node.cpus // min(per_gpu * node.gpus, workers) for node in nodes if node.gpus)


def _sharing(gpus: int, workers: int) -> int:
    """How many workers share the GPU that has most of them."""
    return -(-workers // gpus)


def _share(nodes: Sequence[Node], workers: int) -> int:
    """The most CPUs with which so many workers fit, each of them on one node; at least 1."""
    most = max(sum(node.cpus for node in nodes) // workers, 1)
    return next((share for share in range(most, 1, -1) if sum(node.cpus // share for node in nodes) >= workers), 1)


def _has(nodes: Sequence[Node]) -> str:
    cpus, gpus = sum(node.cpus for node in nodes), sum(node.gpus for node in nodes)
    on = "" if len(nodes) == 1 else f" on {count_text(len(nodes), 'node')}"
    return f"there are {count_text(cpus, 'CPU')} and {count_text(gpus, 'GPU')}{on}"
