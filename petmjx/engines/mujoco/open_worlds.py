"""Open worlds on C MuJoCo: boxes are added one by one, and worlds can be copied (*forked*) to try places.

``OpenWorld`` is one world; ``MujocoWorlds`` simulates many worlds on CPU threads.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Self, TypeVar

import numpy as np

from petmjx.engines.metrics import judged_samples
from petmjx.engines.mujoco.message_log import QUIET_MUJOCO
from petmjx.engines.mujoco.open_models import Templates
from petmjx.engines.mujoco.world_run import WorldRun
from petmjx.engines.open_world_protocol import OpenWorlds, Snapshot, Snapshots
from petmjx.engines.verdict import Flag, Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.growing_scenes import NextBoxes
from petmjx.world.job import Drive, Job
from petmjx.world.scene import Scene


class OpenWorld(WorldRun):
    """A world that pauses when all its boxes are placed and at rest. While the world pauses, more boxes can be added.

    A new ``OpenWorld`` is at the end of its soft start, with no box placed (in a static check, with all boxes placed).

    Attributes:
        paused: whether boxes can be put into the world.
        ended: whether the world has failed and no longer changes.
    """

    def __init__(
        self, scene: Scene, sim: Simulation, cancelled: Callable[[], bool], templates: Templates | None = None
    ) -> None:
        super().__init__(0, Job(scene), sim, cancelled)
        self._templates = templates
        self._pauses, self._until_gone = True, False
        self.ended = not self._start()

    def go_on(self) -> None:
        """Place the boxes that are not placed yet, and wait until they are at rest, by the rules of placement.

        Raises:
            WorldCancelled: the run was interrupted.
        """
        if not self.ended and not self.paused:
            self.ended = not self._loop()

    def put(self, scene: Scene) -> None:
        """Put boxes into a world that has not ended.

        Args:
            scene: a scene with the boxes of the world, followed by the new boxes.
        """
        self._scene, self._job = scene, replace(self._job, scene=scene)
        self._live.extend(scene)
        self._metrics.extend(scene)
        self._quiet.extend(scene)
        self._still_pose = np.vstack((self._still_pose, np.zeros((scene.n_boxes - len(self._still_pose), 7))))
        self._leave_pause()

    def fork(self, *, grows: bool = False) -> Self:
        """A copy of the world in the same state, which is then independent of the original.

        Args:
            grows: whether the next change of the copy is an additional box.
        """
        twin = copy.copy(self)
        twin._live, twin._metrics = self._live.fork(grows=grows), self._metrics.fork()
        twin._quiet = copy.copy(self._quiet)
        twin._waits, twin._still_pose = copy.copy(self._waits), self._still_pose.copy()
        twin._explosion, twin._stepper = copy.copy(self._explosion), copy.copy(self._stepper)
        return twin

    def tried(self, scene: Scene, *, until_lost: bool = False) -> Snapshot:
        """Put the additional boxes of this scene into a copy (*fork*), simulate it until they are at rest, and return
        its state. With ``until_lost``, the simulation already ends when a box is tilted too far at a sample, or is gone
        (fallen for certain) at a check whether the pallet is quiet."""
        twin = self.fork(grows=self.paused)
        twin._job, twin._until_gone = replace(twin._job, until_lost=until_lost), until_lost
        twin.put(scene)
        twin.go_on()
        snapshot = twin.read()
        twin._live.give_back()
        return snapshot

    def _observe(self) -> bool:
        if not super()._observe():
            return False
        if not self._until_gone or self._step % self._sim.quiet.poll_steps:
            return True
        pose = self._live.pose[: self._live.n_free]
        if self._sim.early_stop and self._metrics.any_gone(pose[:, :3], pose[:, 3:]):
            self._flags |= Flag.EARLY_STOP
            return False
        return True

    def finish(self, index: int, drive: Drive | None = None) -> Outcome:
        """Simulate a world with boxes to its end: through the rest window (the last 0.2 s, in which resting forces are
        measured), and through the drive (motion of the carrier), if any.

        Afterwards, no boxes can be added to the world.

        Raises:
            WorldCancelled: the run was interrupted.
        """
        self.go_on()
        self._stream_number, self._pauses = index, False
        self._job = replace(self._job, drive=drive)
        self._waits.settles = self._job.settles
        if self.paused and self._lingers():
            self.paused = False
            self._waits.begin(self._waits.since, self._scene.n_boxes, all_placed=True, restless=False)
        elif not self.ended:
            self._leave_pause()
        return self._outcome(came_to_end=not self.ended and self._loop())

    def _lingers(self) -> bool:
        """Whether the world may get a longer last wait: it paused because its time was up, although boxes were still
        moving."""
        return not (self._quiet.holds or self._metrics.has_failed) and self._waits.lasts_longer(self._step)

    def _leave_pause(self) -> None:
        if self.paused:
            self.paused = False
            self._proceed()
            self._keep_still_pose()

    def read(self) -> Snapshot:
        """The state of the world, with ``Flag.MOVING`` if the world paused because its time was up, although boxes were
        still moving."""
        live, k = self._live, self._live.n_placed
        pose, top_force_n = live.pose[:k], live.top_forces()
        moves = self.paused and not (self._quiet.holds or self._metrics.has_failed)
        return Snapshot(
            time_s=self._clock.time_s(self._step),
            ended=self.ended,
            flags=self._flags | (Flag.MOVING if moves else Flag.NONE),
            pos=pose[:, :3],
            quat=pose[:, 3:],
            top_force_n=top_force_n,
            culprit=self._metrics.culprit,
            max_tilt_deg=self._metrics.max_tilt_deg[:k].copy(),
            max_top_force_n=np.fmax(self._metrics.max_top_force_n[:k], top_force_n),
            dropped=np.isfinite(self._metrics.drop_s[:k]),
            sampled={name: self._metrics.sampled[name][:k].copy() for name in judged_samples()},
        )


Item = TypeVar("Item")
Result = TypeVar("Result")


class MujocoWorlds(OpenWorlds):
    """Open worlds that are simulated on CPU threads.

    Args:
        scenes: the scene of each world. The worlds begin when the object is made.
        threads: number of worlds that are simulated at the same time.
    """

    def __init__(self, scenes: Sequence[Scene], sim: Simulation, threads: int) -> None:
        super().__init__(scenes, sim)
        self._sim, self._threads = sim, threads
        self._stop, self._templates = threading.Event(), Templates.of(sim)
        self._worlds = self._map(self._begin, scenes)

    def go_on(self) -> None:
        """See ``OpenWorlds.go_on``."""
        self._map(OpenWorld.go_on, [world for world in self._worlds if not (world.paused or world.ended)])

    def _reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        for world, begun in zip(worlds, self._map(self._begin, scenes), strict=True):
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

    def _snapshots(self, worlds: Sequence[int]) -> Snapshots:
        return Snapshots.of([self._worlds[world].read() for world in worlds], [self._scenes[world] for world in worlds])

    def _try_next(self, worlds: Sequence[int], boxes: NextBoxes, *, until_lost: bool) -> Snapshots:
        def tried(row: int) -> tuple[Snapshot, Scene]:
            scene = self._blank.with_box(self._scenes[worlds[row]], boxes, row)
            return self._worlds[worlds[row]].tried(scene, until_lost=until_lost), scene

        trials = self._map(tried, range(len(worlds)))
        return Snapshots.of([snapshot for snapshot, _ in trials], [scene for _, scene in trials])

    def _try_scenes(
        self, worlds: Sequence[int], scenes: Sequence[Scene], drives: Sequence[Drive | None]
    ) -> list[Outcome]:
        return self._ends([*zip(worlds, scenes, drives, strict=True)])

    def _finish(self, worlds: Sequence[int], drives: Sequence[Drive | None]) -> list[Outcome]:
        return self._ends([(world, None, drive) for world, drive in zip(worlds, drives, strict=True)])

    def _ends(self, forks: Sequence[tuple[int, Scene | None, Drive | None]]) -> list[Outcome]:
        """The outcomes of copies (*forks*) of worlds, which first get the additional boxes of a scene, if any."""

        def end(number: int) -> Outcome:
            world, scene, drive = forks[number]
            twin = self._worlds[world].fork()
            if scene is not None:
                twin.put(scene)
            return twin.finish(number, drive)

        return self._map(end, range(len(forks)))

    def _begin(self, scene: Scene) -> OpenWorld:
        return OpenWorld(scene, self._sim, self._stop.is_set, self._templates)

    def _map(self, work: Callable[[Item], Result], of: Iterable[Item]) -> list[Result]:
        """``work(item)`` for each item of ``of``, computed on threads. If the work on an item fails, or Ctrl-C
        interrupts it, the worlds stop within a few dozen steps. Later calls continue the simulation of these worlds."""
        try:
            with QUIET_MUJOCO, ThreadPoolExecutor(self._threads, thread_name_prefix="petmjx-mujoco") as pool:
                try:
                    return list(pool.map(work, of))
                except BaseException:
                    self._stop.set()
                    raise
        finally:
            self._stop.clear()
