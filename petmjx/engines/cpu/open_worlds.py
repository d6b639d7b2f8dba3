"""Many open worlds on threads of C MuJoCo."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from petmjx.engines.cpu.log import QUIET_MUJOCO
from petmjx.engines.cpu.models import Templates
from petmjx.engines.cpu.open_world import OpenWorld
from petmjx.engines.open import OpenWorlds, Reading, Readings
from petmjx.options.config import Simulation
from petmjx.verdict import Outcome
from petmjx.world.job import Drive
from petmjx.world.next_boxes import NextBoxes
from petmjx.world.scene import Scene

Given = TypeVar("Given")
Made = TypeVar("Made")


class MujocoWorlds(OpenWorlds):
    """Open worlds on CPU threads.

    Args:
        scenes: of the worlds, which begin at once.
        threads: worlds simulated at the same time.
    """

    def __init__(self, scenes: Sequence[Scene], sim: Simulation, threads: int) -> None:
        super().__init__(scenes, sim)
        self._sim, self._threads = sim, threads
        self._stop, self._templates = threading.Event(), Templates.of(sim)
        self._worlds = self._each(self._begin, scenes)

    def go_on(self) -> None:
        """As for all engines."""
        self._each(OpenWorld.go_on, [world for world in self._worlds if not (world.paused or world.ended)])

    def _reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        for world, begun in zip(worlds, self._each(self._begin, scenes), strict=True):
            self._worlds[world] = begun

    def _ended(self, worlds: Sequence[int]) -> list[bool]:
        return [self._worlds[world].ended for world in worlds]

    def _put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        for world, scene in zip(worlds, scenes, strict=True):
            self._worlds[world].put(scene)

    def _fork(self, sources: Sequence[int], into: Sequence[int]) -> None:
        twins = [self._worlds[world].fork() for world in sources]
        for world, twin in zip(into, twins, strict=True):
            self._worlds[world] = twin

    def _read(self, worlds: Sequence[int]) -> list[Reading]:
        return [self._worlds[world].read() for world in worlds]

    def _try_next(self, worlds: Sequence[int], boxes: NextBoxes) -> Readings:
        def tried(row: int, world: int) -> tuple[Reading, Scene]:
            scene = self._blank.with_box(self._scenes[world], boxes, row)
            return self._worlds[world].tried(scene), scene

        trials = self._each(lambda pair: tried(*pair), enumerate(worlds))
        return Readings.of([reading for reading, _ in trials], [scene for _, scene in trials])

    def _try_scenes(
        self, worlds: Sequence[int], scenes: Sequence[Scene], drives: Sequence[Drive | None]
    ) -> list[Outcome]:
        def end(number: int, world: int, scene: Scene, drive: Drive | None) -> Outcome:
            twin = self._worlds[world].fork()
            twin.put(scene)
            return twin.finish(number, drive)

        numbered = zip(range(len(worlds)), worlds, scenes, drives, strict=True)
        return self._each(lambda pair: end(*pair), numbered)

    def _finish(self, worlds: Sequence[int], drives: Sequence[Drive | None]) -> list[Outcome]:
        def end(number: int, world: int, drive: Drive | None) -> Outcome:
            return self._worlds[world].fork().finish(number, drive)

        numbered = zip(range(len(worlds)), worlds, drives, strict=True)
        return self._each(lambda pair: end(*pair), numbered)

    def _begin(self, scene: Scene) -> OpenWorld:
        return OpenWorld(scene, self._sim, self._stop.is_set, self._templates)

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
