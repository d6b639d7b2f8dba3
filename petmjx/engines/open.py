"""Worlds that stay open: what an engine offers to those who ask about one placement after the other."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from petmjx.config import Schedule, Simulation
from petmjx.units import FloatArray
from petmjx.verdict import Flag, Outcome
from petmjx.world.job import Drive
from petmjx.world.scene import OF_BOXES, Scene

MOST_BOXES: Final = 96
"""Boxes for which an open world has room, unless it is told otherwise: those of the smaller worlds of mjx-warp."""


@dataclass(frozen=True, eq=False)
class Reading:
    """An open world as it is now.

    Attributes:
        time_s: since its soft start.
        ended: it has failed and does not go on: a box has dropped, or the simulation was given up.
        pos, quat: (k, 3) middles of the placed boxes, m, and (k, 4) orientations (w, x, y, z).
        top_force_n: (k,) force on each box's top in the last step, N.
        culprit: the first box that has crossed a threshold; -1: none has.
    """

    time_s: float
    ended: bool
    flags: Flag
    pos: FloatArray
    quat: FloatArray
    top_force_n: FloatArray
    culprit: int


def _check_worlds(worlds: Sequence[int], count: int, *, distinct: bool = True) -> None:
    """Whether these are worlds that there are.

    Raises:
        ValueError: one is not, or is named twice where each must be another one.
    """
    for world in worlds:
        if not isinstance(world, int | np.integer) or not 0 <= world < count:
            raise ValueError(f"there are worlds 0 to {count - 1}, and no {world!r}")
    if distinct and len(set(worlds)) < len(worlds):
        raise ValueError(f"a world is named twice: {list(worlds)}")


def _check_as_many(worlds: Sequence[int], others: Sequence[object], what: str) -> None:
    """Raises ValueError unless there is one of these for each world."""
    if len(worlds) != len(others):
        raise ValueError(f"{len(worlds)} worlds need as many {what}, and there are {len(others)}")


def _check_grown(before: Scene, after: Scene) -> None:
    """Whether a scene has the boxes of another one, on the same carrier, and more.

    Raises:
        ValueError: it has not.
    """
    n = before.n_boxes
    if after.n_boxes <= n:
        raise ValueError(f"the scene must have more than {n} boxes, and has {after.n_boxes}")
    same = after.first(n)
    if not all(np.array_equal(getattr(before, name), getattr(same, name)) for name in OF_BOXES):
        raise ValueError(f"the first {n} boxes of the scene must be those that the world has")
    if any(not np.array_equal(value, getattr(after.carrier, name)) for name, value in vars(before.carrier).items()):
        raise ValueError("the scene must have the world's carrier")


class OpenWorlds(ABC):
    """Worlds that go on independently, and keep their states between calls. Called by one thread at a time.

    Worlds are named by their numbers, from 0. What is refused (ValueError: a world that there is not, or is named
    twice, a scene too few) changes nothing.

    A world goes on by the rules of the placement (docs/rules.md): each of its boxes is placed when those before it
    rest, and when the last one rests it pauses. Then more boxes can be put into it. What a world does depends on its
    scene alone: neither on other worlds, nor on how many calls its boxes came in.

    Here is what all engines refuse; each says how it does the rest.

    Args:
        scenes: of the worlds, which may have no boxes yet.

    Raises:
        ValueError: there are none, or the schedule is fixed: it sets a world's end before its first box is placed.
    """

    def __init__(self, scenes: Sequence[Scene], sim: Simulation) -> None:
        if sim.schedule is Schedule.FIXED:
            raise ValueError("worlds with the fixed schedule do not stay open")
        if not scenes:
            raise ValueError("there must be a world at least")
        self._scenes = list(scenes)

    def __len__(self) -> int:
        return len(self._scenes)

    def reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Begin worlds anew with these scenes, which may have no boxes yet."""
        _check_worlds(worlds, len(self))
        _check_as_many(worlds, scenes, "scenes")
        if len(worlds):
            self._reset(worlds, scenes)
            self._keep(worlds, scenes)

    def put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Put boxes into worlds: their scenes, with more boxes behind those that they had.

        Raises:
            ValueError: a world has ended, or has no more boxes.
        """
        _check_worlds(worlds, len(self))
        _check_as_many(worlds, scenes, "scenes")
        for world, scene, ended in zip(worlds, scenes, self._ended(worlds), strict=True):
            if ended:
                raise ValueError("the world has ended: nothing can be put into it")
            _check_grown(self._scenes[world], scene)
        if len(worlds):
            self._put(worlds, scenes)
            self._keep(worlds, scenes)

    @abstractmethod
    def go_on(self) -> None:
        """Let all worlds go on until they pause or end."""

    def fork(self, sources: Sequence[int], into: Sequence[int]) -> None:
        """Give worlds the states of others, of which some may be named more than once; they go on by themselves."""
        _check_worlds(sources, len(self), distinct=False)
        _check_worlds(into, len(self))
        _check_as_many(sources, into, "worlds to fork into")
        if len(sources):
            self._fork(sources, into)
            self._keep(into, [self._scenes[world] for world in sources])

    def read(self, worlds: Sequence[int]) -> list[Reading]:
        """How worlds are now."""
        _check_worlds(worlds, len(self), distinct=False)
        return self._read(worlds)

    def finish(self, worlds: Sequence[int], drives: Sequence[Drive | None] | None = None) -> list[Outcome]:
        """What becomes of worlds when nothing more is put into them, by all the rules, with or without a drive. The
        worlds themselves stay as they are. ``Outcome.job`` counts the worlds asked for.

        It is one simulation, as of ``Engine.run``: no world is simulated again with other settings, as a score does
        (docs/rules.md, section 9). Before a drive a placement that has failed, but has dropped nothing, is waited for
        as without one, which may be some steps shorter than in a run.

        Raises:
            ValueError: a world has no boxes.
        """
        _check_worlds(worlds, len(self), distinct=False)
        if drives is not None:
            _check_as_many(worlds, drives, "drives")
        if any(not self._scenes[world].n_boxes for world in worlds):
            raise ValueError("a world without boxes has no verdict")
        return self._finish(worlds, drives or [None] * len(worlds)) if len(worlds) else []

    def _keep(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        for world, scene in zip(worlds, scenes, strict=True):
            self._scenes[world] = scene

    @abstractmethod
    def _reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None: ...

    @abstractmethod
    def _ended(self, worlds: Sequence[int]) -> list[bool]:
        """Which of them have failed and do not go on."""

    @abstractmethod
    def _put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None: ...

    @abstractmethod
    def _fork(self, sources: Sequence[int], into: Sequence[int]) -> None: ...

    @abstractmethod
    def _read(self, worlds: Sequence[int]) -> list[Reading]: ...

    @abstractmethod
    def _finish(self, worlds: Sequence[int], drives: Sequence[Drive | None]) -> list[Outcome]: ...
