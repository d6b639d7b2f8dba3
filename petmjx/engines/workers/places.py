"""How many workers a cluster gets, and what each of them takes. Nothing here knows Ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from petmjx.basics.errors import EngineUnavailable, InputError
from petmjx.basics.text import counted
from petmjx.options.run_options import AUTO


@dataclass(frozen=True)
class Node:
    """What one machine of a cluster has."""

    cpus: int
    gpus: int = 0


@dataclass(frozen=True)
class Place:
    """What one worker takes.

    Attributes:
        cpus, gpus: of one node.
        slots: chunks of jobs that it simulates side by side: the threads of ``mujoco``; MJX engines have one.
    """

    cpus: int
    gpus: int = 0
    slots: int = 1


def places(engine: str, nodes: Sequence[Node], workers: int | str, threads: int | None = None) -> list[Place]:
    """The places of all workers.

    Args:
        workers: their number; ``auto``: one for each GPU, or else one for each node, with all its CPUs.
        threads: of each worker of ``mujoco``; None: its share of the CPUs.

    Raises:
        InputError: the cluster can never place so many.
        EngineUnavailable: the engine needs a GPU, and there is none.
    """
    gpus = sum(node.gpus for node in nodes)
    if engine == "mjx-warp" or (engine == "mjx-jax" and gpus):
        if not gpus:
            raise EngineUnavailable(f"engine {engine} cannot run here: {_has(nodes)}")
        number = gpus if workers == AUTO else int(workers)
        if number > gpus:
            raise InputError(f"workers: {number} of engine {engine} need a GPU each; {_has(nodes)}")
        return [Place(cpus=1, gpus=1)] * number
    if workers == AUTO:
        sizes = [(node.cpus, threads or node.cpus) for node in nodes if node.cpus]
        cpus = [each for whole, each in sizes for _ in range(whole // each)]
        fit = bool(cpus)
    else:
        each = threads or _share(nodes, int(workers))
        cpus = [each] * int(workers)
        fit = sum(node.cpus // each for node in nodes) >= len(cpus)
    if not fit:
        asked = "a worker" if workers == AUTO else counted(int(workers), "worker")
        raise InputError(f"workers: no room for {asked} of {counted(threads or 1, 'CPU')}; {_has(nodes)}")
    return [Place(cpus=each, slots=each if engine == "mujoco" else 1) for each in cpus]


def _share(nodes: Sequence[Node], workers: int) -> int:
    """The most CPUs with which so many workers fit, each of them on one node; at least 1."""
    most = max(sum(node.cpus for node in nodes) // workers, 1)
    return next((each for each in range(most, 1, -1) if sum(node.cpus // each for node in nodes) >= workers), 1)


def _has(nodes: Sequence[Node]) -> str:
    cpus, gpus = sum(node.cpus for node in nodes), sum(node.gpus for node in nodes)
    on = "" if len(nodes) == 1 else f" on {counted(len(nodes), 'node')}"
    return f"there are {counted(cpus, 'CPU')} and {counted(gpus, 'GPU')}{on}"
