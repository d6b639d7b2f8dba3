"""Many open worlds on threads of C MuJoCo."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from petmjx.config import Simulation
from petmjx.engines.cpu.log import QUIET_MUJOCO
from petmjx.engines.cpu.open_world import OpenWorld
from petmjx.engines.open import Reading, check_as_many, check_worlds
from petmjx.verdict import Outcome
from petmjx.world.job import Drive
from petmjx.world.scene import Scene

Given = TypeVar("Given")
Made = TypeVar("Made")


class MujocoWorlds:
    """The protocol ``OpenWorlds`` on CPU threads. Called by one thread at a time.

    Args:
        scenes: of the worlds, which begin at once.
        threads: worlds simulated at the same time.
    """

    def __init__(self, scenes: Sequence[Scene], sim: Simulation, threads: int) -> None:
        if not scenes:
            raise ValueError("there must be a world at least")
        self._sim, self._threads = sim, threads
        self._stop = threading.Event()
        self._worlds = self._each(self._begin, scenes)

    def __len__(self) -> int:
        return len(self._worlds)

    def reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """As in the protocol."""
        check_worlds(worlds, len(self))
        check_as_many(worlds, scenes, "scenes")
        for world, begun in zip(worlds, self._each(self._begin, scenes), strict=True):
            self._worlds[world] = begun

    def put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """As in the protocol."""
        check_worlds(worlds, len(self))
        check_as_many(worlds, scenes, "scenes")
        for world, scene in zip(worlds, scenes, strict=True):
            self._worlds[world].check_put(scene)
        for world, scene in zip(worlds, scenes, strict=True):
            self._worlds[world].put(scene)

    def go_on(self) -> None:
        """As in the protocol."""
        self._each(OpenWorld.go_on, self._worlds)

    def fork(self, sources: Sequence[int], into: Sequence[int]) -> None:
        """As in the protocol."""
        check_worlds(sources, len(self), distinct=False)
        check_worlds(into, len(self))
        check_as_many(sources, into, "worlds to fork into")
        twins = [self._worlds[world].fork() for world in sources]
        for world, twin in zip(into, twins, strict=True):
            self._worlds[world] = twin

    def read(self, worlds: Sequence[int]) -> list[Reading]:
        """As in the protocol."""
        check_worlds(worlds, len(self), distinct=False)
        return [self._worlds[world].read() for world in worlds]

    def finish(self, worlds: Sequence[int], drives: Sequence[Drive | None] | None = None) -> list[Outcome]:
        """As in the protocol."""
        check_worlds(worlds, len(self), distinct=False)
        if drives is not None:
            check_as_many(worlds, drives, "drives")

        def end(number: int, world: int, drive: Drive | None) -> Outcome:
            return self._worlds[world].fork().finish(number, drive)

        numbered = zip(range(len(worlds)), worlds, drives or [None] * len(worlds), strict=True)
        return self._each(lambda each: end(*each), numbered)

    def _begin(self, scene: Scene) -> OpenWorld:
        return OpenWorld(scene, self._sim, self._stop.is_set)

    def _each(self, work: Callable[[Given], Made], of: Iterable[Given]) -> list[Made]:
        """The work on each, on threads. An interruption stops worlds within a few dozen steps; they can go on later."""
        try:
            with QUIET_MUJOCO, ThreadPoolExecutor(self._threads, thread_name_prefix="petmjx-world") as pool:
                try:
                    return list(pool.map(work, of))
                except BaseException:
                    self._stop.set()
                    raise
        finally:
            self._stop.clear()
