"""Open worlds: an engine's interface for packers, which place boxes one by one and try places in copies of worlds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import judged_samples
from petmjx.engines.verdict import Flag, Outcome
from petmjx.options.materials import PAIR_TABLES
from petmjx.options.simulation import Schedule, Simulation
from petmjx.world.growing_scenes import EmptyCarrier, NextBoxes, OpenScenes
from petmjx.world.job import Drive
from petmjx.world.scene import OF_BOXES, Scene
from petmjx.world.surface_pairs import filled_up

MOST_BOXES: Final = 96
"""Default number of boxes for which an open world reserves memory. The value is also the largest number of boxes that a
small world on mjx-warp has."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The current state of an open world with k placed boxes.

    Attributes:
        time_s: simulated time since the end of the world's soft start, s.
        ended: True if a box has dropped or the simulation was given up. The world then no longer changes.
        flags: flags of the world. ``MOVING`` is also set if boxes were still moving when the time for coming to rest
            was up, and the world paused for this reason.
        pos, quat: (k, 3) centres of the placed boxes, m, and (k, 4) their orientations as quaternions (w, x, y, z).
        top_force_n: (k,) force on each box's top in the last step, N.
        culprit: number of the first box that was beyond a threshold at a sample (a measurement every 0.2 s), or -1 if
            there is none.
        max_tilt_deg: (k,) largest tilt so far, degrees.
        max_top_force_n: (k,) largest force on the top so far, N: in the steps that count (docs/rules.md, section 7), or
            ``top_force_n`` if that is larger, since steps in which all boxes are slow do not count.
        dropped: (k,) whether each box had dropped at a sample.
        sampled: name of each metric of ``judged_samples`` → (k,) values so far.
    """

    time_s: float
    ended: bool
    flags: Flag
    pos: FloatArray
    quat: FloatArray
    top_force_n: FloatArray
    culprit: int
    max_tilt_deg: FloatArray
    max_top_force_n: FloatArray
    dropped: NDArray[np.bool_]
    sampled: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Snapshots:
    """The ``Snapshot`` of each of m open worlds, as arrays with k columns. k is the largest number of boxes of a world.

    In columns beyond a world's placed boxes, numbers are NaN and ``dropped`` is False.

    Attributes:
        placed: (m,) number of placed boxes of each world.
        target, half_size: (m, k, 3) planned centres and half extents of the boxes, m.
    """

    placed: NDArray[np.int64]
    time_s: FloatArray
    ended: NDArray[np.bool_]
    flags: NDArray[np.int64]
    culprit: NDArray[np.int64]
    pos: FloatArray
    quat: FloatArray
    target: FloatArray
    half_size: FloatArray
    top_force_n: FloatArray
    max_tilt_deg: FloatArray
    max_top_force_n: FloatArray
    dropped: NDArray[np.bool_]
    sampled: Mapping[str, FloatArray]

    @classmethod
    def of(cls, snapshots: Sequence[Snapshot], scenes: Sequence[Scene]) -> Snapshots:
        """Several snapshots as arrays. ``scenes``: the scene of each snapshot's world."""
        placed = np.array([len(snapshot.pos) for snapshot in snapshots], np.int64)
        width = int(placed.max(initial=0))

        def padded(
            rows: Sequence[NDArray[Any]], fill: float | bool = np.nan, more: tuple[int, ...] = ()
        ) -> NDArray[Any]:
            shape = rows[0].shape[1:] if rows else more
            table = np.full((len(rows), width, *shape), fill)
            for row, values in enumerate(rows):
                table[row, : placed[row]] = values[: placed[row]]
            return table

        return cls(
            placed=placed,
            time_s=np.array([snapshot.time_s for snapshot in snapshots]),
            ended=np.array([snapshot.ended for snapshot in snapshots], bool),
            flags=np.array([snapshot.flags for snapshot in snapshots], np.int64),
            culprit=np.array([snapshot.culprit for snapshot in snapshots], np.int64),
            pos=padded([snapshot.pos for snapshot in snapshots], more=(3,)),
            quat=padded([snapshot.quat for snapshot in snapshots], more=(4,)),
            target=padded([scene.target for scene in scenes], more=(3,)),
            half_size=padded([scene.half_size for scene in scenes], more=(3,)),
            top_force_n=padded([snapshot.top_force_n for snapshot in snapshots]),
            max_tilt_deg=padded([snapshot.max_tilt_deg for snapshot in snapshots]),
            max_top_force_n=padded([snapshot.max_top_force_n for snapshot in snapshots]),
            dropped=padded([snapshot.dropped for snapshot in snapshots], False),
            sampled={name: padded([snapshot.sampled[name] for snapshot in snapshots]) for name in judged_samples()},
        )

    def of_world(self, row: int) -> Snapshot:
        """The snapshot of one world."""
        of_boxes = ("pos", "quat", "top_force_n", "max_tilt_deg", "max_top_force_n", "dropped")
        return Snapshot(
            time_s=float(self.time_s[row]),
            ended=bool(self.ended[row]),
            flags=Flag(int(self.flags[row])),
            culprit=int(self.culprit[row]),
            sampled={name: values[row, : self.placed[row]] for name, values in self.sampled.items()},
            **{name: getattr(self, name)[row, : self.placed[row]] for name in of_boxes},
        )

    @classmethod
    def joined(cls, parts: Sequence[Snapshots]) -> Snapshots:
        """The snapshots of the worlds of all parts, part after part."""
        return cls(**joined_records(parts, max(part.pos.shape[1] for part in parts)))


def joined_records(parts: Sequence[Any], width: int) -> dict[str, Any]:
    """The fields of several records about worlds, one record after another, padded to ``width`` boxes per world. Fields
    are arrays or dictionaries of arrays."""

    def joined(values: Sequence[Any]) -> Any:
        if isinstance(values[0], Mapping):
            return {name: joined([value[name] for value in values]) for name in values[0]}
        return np.concatenate([widened_rows(value, width) for value in values])

    return {field.name: joined([getattr(part, field.name) for part in parts]) for field in fields(parts[0])}


def widened_rows(values: NDArray[Any], width: int) -> NDArray[Any]:
    """An array with one column per box, padded to ``width`` boxes with NaN or False."""
    if values.ndim == 1 or values.shape[1] == width:
        return values
    fill = False if values.dtype == bool else np.nan
    padding = np.full((len(values), width - values.shape[1], *values.shape[2:]), fill)
    return np.concatenate([values, padding], axis=1)


def _check_worlds(worlds: Sequence[int], count: int, *, distinct: bool = True) -> None:
    """Check that worlds with these numbers exist.

    Raises:
        ValueError: a world does not exist, or a number occurs twice although ``distinct`` is set.
    """
    numbers = np.asarray(worlds)  # NumPy checks thousands of numbers quickly; the loop only names the wrong one
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu" or ((numbers < 0) | (numbers >= count)).any():
        for world in worlds:
            if not isinstance(world, int | np.integer) or not 0 <= world < count:
                raise ValueError(f"there is no world {world!r}: worlds have the numbers 0 to {count - 1}")
    if distinct and len(np.unique(numbers)) < len(worlds):
        raise ValueError(f"a world is named twice: {list(worlds)}")


def _check_as_many(worlds: Sequence[int], others: Sized, noun: str) -> None:
    """Raise ValueError unless ``others`` has one entry for each world."""
    if len(worlds) != len(others):
        raise ValueError(f"expected {len(worlds)} {noun}, one for each world, got {len(others)}")


def _check_grown(before: Scene, after: Scene) -> None:
    """Check that the scene ``after`` has all boxes of the scene ``before``, on the same carrier, and further boxes.

    Raises:
        ValueError: ``after`` lacks a box of ``before``, has no further box, has a different carrier, or has different
            values for pairs of surfaces.
    """
    n = before.n_boxes
    if after.n_boxes <= n:
        raise ValueError(f"the scene must have more than {n} boxes, but has {after.n_boxes}")
    earlier_part = after.first(n)
    if not all(np.array_equal(getattr(before, name), getattr(earlier_part, name)) for name in OF_BOXES):
        raise ValueError(f"the first {n} boxes of the scene must be the boxes that the world already has")
    if any(not np.array_equal(value, getattr(after.carrier, name)) for name, value in vars(before.carrier).items()):
        raise ValueError("the scene must have the same carrier as the world")
    for table in PAIR_TABLES:
        if not np.array_equal(filled_up(before.pairs, table.name), filled_up(after.pairs, table.name)):
            raise ValueError(f"the scene must have the same {table.noun} for pairs of surfaces as the world")


class OpenWorlds(ABC):
    """Worlds that are simulated independently and keep their states between calls. Only one thread at a time may use
    them.

    Each world has a number, from 0. A call with wrong arguments raises ValueError and changes nothing. Examples of
    wrong arguments are a number without a world, a number that occurs twice, and a missing scene.

    A world follows the rules of placement (docs/rules.md): a box is placed when all boxes before it are at rest. When
    the last box is at rest, the world pauses, and more boxes can be added. What happens in a world depends only on its
    scene, not on other worlds, and not on how many calls added its boxes. A world whose last boxes do not come to rest
    pauses after a short wait, since more boxes may follow; ``finish`` waits longer.

    This class checks the arguments for all engines; each engine implements the abstract methods.

    Args:
        scenes: the scenes of the worlds. A scene may have no boxes yet.

    Raises:
        ValueError: there are no scenes, or the schedule is ``fixed``. The fixed schedule sets the end of a world before
            the world's first box is placed.
    """

    def __init__(self, scenes: Sequence[Scene], sim: Simulation) -> None:
        if sim.schedule is Schedule.FIXED:
            raise ValueError("open worlds need the adaptive schedule, not the fixed schedule")
        if not scenes:
            raise ValueError("there must be at least one world")
        self._blank = EmptyCarrier(sim)
        self._scenes = OpenScenes(scenes, self._blank)

    def __len__(self) -> int:
        return len(self._scenes)

    def reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Start worlds anew with these scenes, which may have no boxes yet."""
        _check_worlds(worlds, len(self))
        _check_as_many(worlds, scenes, "scenes")
        if len(worlds):
            self._reset(worlds, scenes)
            self._scenes.set(worlds, scenes)

    def put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Put boxes into worlds. Each scene has the boxes that its world already has, followed by the new boxes.

        Raises:
            ValueError: one of these worlds has ended, or its scene has no new boxes.
        """
        _check_worlds(worlds, len(self))
        _check_as_many(worlds, scenes, "scenes")
        self._check_open(worlds)
        for world, scene in zip(worlds, scenes, strict=True):
            _check_grown(self._scenes[world], scene)
        if len(worlds):
            self._put(worlds, scenes)
            self._scenes.set(worlds, scenes)

    def put_next(self, worlds: Sequence[int], boxes: NextBoxes) -> None:
        """Put one box into each of these worlds. Only the extents, places and masses of the boxes are given.

        Raises:
            ValueError: one of these worlds has ended.
        """
        _check_worlds(worlds, len(self))
        _check_as_many(worlds, boxes, "boxes")
        self._check_open(worlds)
        if len(worlds):
            self._put_next(worlds, boxes)
            self._scenes.add(worlds, boxes)

    def try_next(self, worlds: Sequence[int], boxes: NextBoxes, *, until_lost: bool = False) -> Snapshots:
        """Put one box into a copy (*fork*) of each world, simulate until the box is at rest, and return the states of
        the forks. The forks are then discarded, and the worlds do not change. A world may be named several times. Each
        world must have paused.

        Args:
            until_lost: if True, a fork ends as soon as the pallet certainly does not stand: a box is tilted too far at
                a sample, or a box is gone (``petmjx.engines.metrics.GONE_TILT``). A fork that ends so early does not
                show how it would have continued.

        Raises:
            ValueError: one of these worlds has ended.
        """
        _check_worlds(worlds, len(self), distinct=False)
        _check_as_many(worlds, boxes, "boxes")
        self._check_open(worlds)
        return self._try_next(worlds, boxes, until_lost=until_lost)

    def try_scenes(
        self, worlds: Sequence[int], scenes: Sequence[Scene], drives: Sequence[Drive | None] | None = None
    ) -> list[Outcome]:
        """Copy worlds, give these scenes to the copies (*forks*), and simulate the copies to their ends as ``finish``
        does. A scene may have other friction than its world, and may place its new boxes in another way (carried
        instead of appearing, for example).

        Raises:
            ValueError: one of these worlds has ended.
        """
        _check_worlds(worlds, len(self), distinct=False)
        _check_as_many(worlds, scenes, "scenes")
        self._check_open(worlds)
        return self._try_scenes(worlds, scenes, drives or [None] * len(worlds)) if len(worlds) else []

    def with_next(self, worlds: Sequence[int], boxes: NextBoxes) -> list[Scene]:
        """The scenes that worlds would have with one more box each."""
        return [self._blank.with_box(self._scenes[world], boxes, row) for row, world in enumerate(worlds)]

    def scene(self, world: int) -> Scene:
        """The scene of one world."""
        return self._scenes[world]

    def _check_open(self, worlds: Sequence[int]) -> None:
        if any(self._ended(worlds)):
            raise ValueError("the world has ended: nothing can be put into it")

    @abstractmethod
    def go_on(self) -> None:
        """Simulate all worlds until each pauses or ends."""

    def fork(self, sources: Sequence[int], into: Sequence[int]) -> None:
        """Copy the states of the worlds ``sources`` into the worlds ``into``. A source may be named several times.
        After the copy, the worlds are independent."""
        _check_worlds(sources, len(self), distinct=False)
        _check_worlds(into, len(self))
        _check_as_many(sources, into, "worlds to fork into")
        if len(sources):
            self._fork(sources, into)
            self._scenes.copy(sources, into)

    def read(self, worlds: Sequence[int]) -> list[Snapshot]:
        """The ``Snapshot`` of each of these worlds."""
        snapshots = self.snapshots(worlds)
        return [snapshots.of_world(row) for row in range(len(worlds))]

    def snapshots(self, worlds: Sequence[int]) -> Snapshots:
        """The snapshots of these worlds, as arrays."""
        _check_worlds(worlds, len(self), distinct=False)
        return self._snapshots(worlds) if len(worlds) else Snapshots.of([], [])

    def finish(self, worlds: Sequence[int], drives: Sequence[Drive | None] | None = None) -> list[Outcome]:
        """The outcomes that worlds have if no further boxes follow. If ``drives`` has a drive for a world, the world is
        also shaken. The worlds themselves do not change. ``Outcome.job`` is the index into ``worlds``.

        Each outcome is the result of one simulation, as in ``Engine.run``. Unlike in ``petmjx.score``, no world is
        simulated again with other settings (docs/rules.md, section 9). If a placement before a drive has failed without
        a dropped box, the world gets the same time to come to rest as without a drive. The time that a world gets to
        come to rest may be some steps shorter than in ``Engine.run``.

        Raises:
            ValueError: a world has no boxes.
        """
        _check_worlds(worlds, len(self), distinct=False)
        if drives is not None:
            _check_as_many(worlds, drives, "drives")
        if any(not self._scenes[world].n_boxes for world in worlds):
            raise ValueError("a world without boxes has no verdict")
        return self._finish(worlds, drives or [None] * len(worlds)) if len(worlds) else []

    @abstractmethod
    def _reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None: ...

    @abstractmethod
    def _ended(self, worlds: Sequence[int]) -> list[bool]:
        """For each of these worlds, whether it has failed and no longer changes."""

    @abstractmethod
    def _put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None: ...

    def _put_next(self, worlds: Sequence[int], boxes: NextBoxes) -> None:
        self._put(worlds, self.with_next(worlds, boxes))

    @abstractmethod
    def _snapshots(self, worlds: Sequence[int]) -> Snapshots: ...

    @abstractmethod
    def _try_next(self, worlds: Sequence[int], boxes: NextBoxes, *, until_lost: bool) -> Snapshots: ...

    @abstractmethod
    def _try_scenes(
        self, worlds: Sequence[int], scenes: Sequence[Scene], drives: Sequence[Drive | None]
    ) -> list[Outcome]: ...

    @abstractmethod
    def _fork(self, sources: Sequence[int], into: Sequence[int]) -> None: ...

    @abstractmethod
    def _finish(self, worlds: Sequence[int], drives: Sequence[Drive | None]) -> list[Outcome]: ...
