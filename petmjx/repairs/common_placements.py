"""Worlds with the same first boxes share the simulation of these boxes (``CommonPlacements``).

Changed plans often begin with the same placements, up to the first box that differs. The placement of the common first
boxes is simulated once. The simulation of the common first boxes pauses before the first different box is placed, and
all worlds with the same first boxes start from the state of the paused simulation. The outcomes of the worlds are the
same to the last bit as if each world had been simulated from its beginning.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np

from petmjx.engines.verdict import Outcome
from petmjx.world.job import EngineState, Job

LEAST_SAVED: Final = 40
"""A common placement is simulated in a job of its own only if it saves the placements of at least this many boxes,
because a pause takes as long as the placements of several boxes."""

MOST_KEPT_BYTES: Final = 64 << 20
"""Largest memory for the states of common placements that are kept for further worlds. The states of worlds with errors
may take the same amount of memory in addition. A state of 40 boxes takes 10 kB."""

Tag = TypeVar("Tag")


class World(NamedTuple, Generic[Tag]):
    """A world to be simulated.

    Attributes:
        tag: the mark by which the outcome of the world is recognised.
        keys: the keys of the world's beginnings (``Engine.beginnings``). Two worlds have the same key k if they are the
            same until the box k is placed.
    """

    job: Job
    tag: Tag
    keys: Sequence[bytes]


@dataclass(frozen=True, eq=False)
class Placement(Generic[Tag]):
    """A job, and the worlds that share it. The job simulates the common beginning of several worlds, or a single world
    to its end.

    Attributes:
        job: the job; it pauses if there are several worlds.
        n_boxes: number of boxes that the job places before it pauses.
    """

    job: Job
    worlds: tuple[World[Tag], ...]
    n_boxes: int


class CommonPlacements(Generic[Tag]):
    """Makes jobs from worlds. Worlds with the same first boxes share a job for these boxes.

    All worlds have the same options of the simulation.

    Args:
        most_bytes: largest memory for states that are kept. The state that was used least recently is removed first.
    """

    def __init__(self, *, most_bytes: int = MOST_KEPT_BYTES) -> None:
        self._kept: OrderedDict[bytes, tuple[EngineState, int]] = OrderedDict()
        self._most_bytes, self._bytes = most_bytes, 0

    def begin(self, worlds: Sequence[World[Tag]]) -> Iterator[Placement[Tag]]:
        """The jobs with which the simulation of worlds begins."""
        return self._placements(tuple(worlds), 0, None)

    def go_on(self, placement: Placement[Tag], outcome: Outcome) -> Iterator[Placement[Tag]]:
        """The jobs that follow a placement that has paused."""
        state: Any = outcome.state
        self._keep(placement.worlds[0].keys[placement.n_boxes], state)
        return self._split(placement.worlds, placement.n_boxes, placement.n_boxes, state)

    def _placements(
        self, worlds: tuple[World[Tag], ...], n_placed: int, start: EngineState | None
    ) -> Iterator[Placement[Tag]]:
        """The next jobs of worlds whose first ``n_placed`` boxes are the same.

        Args:
            n_placed: number of boxes that are placed in the state ``start``.
        """
        n_common = _n_common(worlds)
        for n in range(n_common, n_placed, -1):
            if (kept := self._kept.get(worlds[0].keys[n])) is not None:
                self._kept.move_to_end(worlds[0].keys[n])
                n_placed, start = n, kept[0]
                break
        if len(worlds) == 1:
            yield Placement(replace(worlds[0].job, start=start), worlds, worlds[0].job.scene.n_boxes)
        elif (len(worlds) - 1) * (n_common - n_placed) >= LEAST_SAVED:
            # take the job of the world with the most boxes, because it has the largest ``Job.iteration_limit``
            largest = max((world.job for world in worlds), key=lambda job: job.scene.n_boxes)
            job = replace(largest, start=start, pauses_after=n_common)
            yield Placement(job, worlds, n_common)
        else:
            yield from self._split(worlds, n_common, n_placed, start)

    def _split(
        self, worlds: tuple[World[Tag], ...], n_common: int, n_placed: int, start: EngineState | None
    ) -> Iterator[Placement[Tag]]:
        """The next jobs of worlds that have ``n_common`` boxes in common. The worlds are divided into groups that also
        have the next box in common, and each group has its jobs. If this next box is the last box of a world, the world
        has a group of its own."""
        groups: dict[object, list[World[Tag]]] = {}
        for number, world in enumerate(worlds):
            is_last = world.job.scene.n_boxes == n_common + 1
            groups.setdefault(number if is_last else world.keys[n_common + 1], []).append(world)
        for group in groups.values():
            yield from self._placements(tuple(group), n_placed, start)

    def _keep(self, key: bytes, state: EngineState) -> None:
        size = _bytes_of(state)
        if key in self._kept:
            self._bytes -= self._kept.pop(key)[1]
        self._kept[key] = state, size
        self._bytes += size
        while self._bytes > self._most_bytes:
            self._bytes -= self._kept.popitem(last=False)[1][1]


def _n_common(worlds: Sequence[World[Any]]) -> int:
    """The number of first boxes that all worlds have in common. The number is always smaller than the number of boxes
    of any world. The number is −1 if not even the carriers are the same."""
    most = min(len(world.keys) for world in worlds) - 2
    return next((n for n in range(most, -1, -1) if len({world.keys[n] for world in worlds}) == 1), -1)


def _bytes_of(state: Any) -> int:
    """Memory of the arrays in a state, which is a tree of tuples, in bytes."""
    if isinstance(state, tuple):
        return sum(_bytes_of(part) for part in state)
    return int(np.asarray(state).nbytes)
