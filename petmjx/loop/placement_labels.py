"""Labels of placements for models that predict stability: boxes put onto piles, and the result of a score for each.

Episode i packs order i of a source, box by box, and begins anew with the first order behind the last order. Each box
goes to a random place, or to a place of a careful packer. Each such placement is a label. Where the pallet does not
stand, the box is taken back, tried once at a careful place, which is the next label, and else left out. An episode
depends on its number and the seed alone, so a larger set begins with the labels of a smaller one.
"""

from __future__ import annotations

import hashlib
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import chain, islice
from threading import Lock
from typing import Any, Final

import numpy as np
import pyarrow as pa

from petmjx.common.argument_checks import integer_of, number_of
from petmjx.common.prefetch import prefetch
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.loop.candidate_places import Places
from petmjx.loop.engine_setup import chooses_gpu
from petmjx.loop.order_sources import Boxes, Orders
from petmjx.loop.pallets import Pallets
from petmjx.options.run_options import AUTO
from petmjx.plans.plan import Plan

SPLITS: Final = {"train": 0.8, "validation": 0.1, "test": 0.1}
"""Share of the orders in each split."""

CAREFUL_SUPPORT: Final = 0.75
"""Least supported share of the base at careful places."""

LOWEST: Final = 4
"""A careful packer chooses among this many lowest places."""

SCORING_SHARE: Final = 8
"""Boxes are placed when fewer than one in this many pallets waits for a label: a pallet that needs a further attempt
holds up no other."""

MOST_EPISODES: Final = 4
"""Largest number of episodes that run or wait for an earlier one, as a multiple of the pallets."""

SURE_SHARE: Final = 0.8
"""Labels that are counted on for each box that is left. Some boxes have no place, and others are tried twice. If an
episode began because another one gave too few labels, all would wait for its boxes, one after another."""

GROUPS_ON_GPU: Final = 2
"""Number of groups of pallets on a GPU. While the GPU simulates one group, the host checks and places the other."""

PALLETS_ON_GPU: Final = 4096
"""Number of pallets side by side on a GPU. Half as many keep it busy, and the groups take turns."""

PALLETS_ON_CPU: Final = 64

PAUSE_S: Final = 0.02
"""Time between two looks of a group that waits for episodes of another group, s."""

COLUMNS: Final[dict[str, tuple[pa.DataType, str]]] = {
    "order": (pa.int64(), "number of the order in its source, from 0"),
    "episode": (pa.int64(), "number of the episode; one order has several if the source has too few"),
    "step": (pa.int32(), "number of the label in its episode"),
    "careful": (pa.bool_(), "whether the place is one of a careful packer's, or any"),
    "size_mm": (
        pa.list_(pa.list_(pa.float64(), 3)),
        "extents of all boxes of the pallet as they stand; the last is new",
    ),
    "corner_mm": (pa.list_(pa.list_(pa.float64(), 3)), "front-left-bottom corners of the same boxes"),
    "mass_kg": (pa.list_(pa.float64()), "masses of the same boxes"),
    "stands": (pa.bool_(), "whether a score says that the pallet with the new box is stable; null: it has no verdict"),
    "reason": (pa.string(), "why it is not: drop, tilt or shift, or why there is no verdict"),
    "culprit": (pa.int32(), "the box that failed first, counted from 0; null: none did"),
    "margin": (pa.float32(), "distance to the nearest threshold, as in the column margin of a run; null: no verdict"),
    "share": (pa.float32(), "share of worlds with errors in which it stands; null: not simulated"),
    "top_force_n": (pa.list_(pa.float32()), "force on the top of each box at rest, N; null: it did not come to rest"),
}
"""Columns of the labels: type, and meaning."""

Label = dict[str, Any]
"""A label as a dict: a value for each name in ``COLUMNS``, and the value of ``split``. Values with an entry for each
box are arrays."""

SCHEMA: Final = pa.schema([(name, kind) for name, (kind, _) in COLUMNS.items()])


def split_of(boxes: Boxes) -> str:
    """The split to which an order belongs. It depends only on the sizes and masses of the order's boxes, not on their
    sequence or orientation. So orders with the same boxes are in the same split."""
    rows = np.column_stack([np.sort(boxes.size_mm, axis=1), boxes.mass_kg]).round(3)
    content = rows[np.lexsort(rows.T)].tobytes()
    place = int.from_bytes(hashlib.sha256(content).digest()[:8]) / 2**64
    for name, share in SPLITS.items():
        if place < share:
            return name
        place -= share
    return name


@dataclass(eq=False)
class Episode:
    """The packing of one order on one pallet.

    Attributes:
        boxes: boxes of the order, of which those from ``next`` on are not placed yet; ``again``: the second try of the
            next box.
        careful: whether the last box went to a place of a careful packer.
        share: share of worlds with errors in which the last box stands; None: not simulated.
        labels: the labels of the boxes that were tried so far.
    """

    number: int
    order: int
    split: str
    boxes: Boxes
    rng: np.random.Generator
    next: int = 0
    again: bool = False
    careful: bool = False
    share: float | None = None
    labels: list[Label] = field(default_factory=list)

    @property
    def is_over(self) -> bool:
        """Whether all boxes were tried."""
        return self.next >= len(self.boxes)

    @property
    def n_expected(self) -> float:
        """Number of labels that are counted on."""
        return len(self.labels) + SURE_SHARE * (len(self.boxes) - self.next)


class Labeller:
    """Makes labels.

    Args:
        orders: source of boxes.
        pallets: number of pallets side by side, on which labels do not depend; None: ``PALLETS_ON_GPU`` or
            ``PALLETS_ON_CPU``.
        groups: number of groups into which the pallets are divided, each with a thread of its own; None:
            ``GROUPS_ON_GPU`` on a GPU, else one.
        explore: share of boxes that go to a random place first.
        errors: number of worlds with errors of each label; None: none.
        max_height_mm: highest top of a box.
        others: of ``petmjx.Pallets``.

    Attributes:
        n_pallets: number of pallets in all groups.
        groups: the pallets of each group.
        options: all other options on which labels depend.

    Raises:
        InputError: an unusable option.
    """

    def __init__(
        self,
        orders: Orders,
        *,
        pallets: int | None = None,
        groups: int | None = None,
        seed: int = 0,
        explore: float = 0.5,
        errors: int | None = None,
        max_height_mm: float = 1800.0,
        **others: Any,
    ) -> None:
        self.orders, self._seed = orders, integer_of(seed, "seed", 0)
        self._explore = number_of(explore, "explore", 0.0, 1.0)
        self._errors = None if errors is None else integer_of(errors, "errors", 1, 100_000)
        self._highest_mm = number_of(max_height_mm, "max_height_mm", 1.0, 20_000.0)
        engine = others.get("engine", AUTO)
        if pallets is None:
            pallets = PALLETS_ON_GPU if chooses_gpu(engine, PALLETS_ON_GPU) else PALLETS_ON_CPU
        self.n_pallets = n_pallets = integer_of(pallets, "pallets", 1)
        if groups is None:
            groups = GROUPS_ON_GPU if chooses_gpu(engine, n_pallets // GROUPS_ON_GPU) else 1
        n_groups = min(integer_of(groups, "groups", 1), n_pallets)
        sizes = [n_pallets // n_groups + (group < n_pallets % n_groups) for group in range(n_groups)]
        self.groups = [Pallets(size, **others) for size in sizes]
        self.simulation, self.engine = self.groups[0].simulation, self.groups[0].engine
        orders.check_sizes(self.simulation.size_reduction_mm)
        self.options = {
            "seed": self._seed,
            "explore": self._explore,
            "errors": self._errors,
            "max_height_mm": self._highest_mm,
            "most_boxes": self.groups[0].most_boxes,
        }

    def labels(self, count: int) -> Iterator[Label]:
        """The first ``count`` labels, in the order of episodes; none if no box has a place."""
        return islice(chain.from_iterable(self.episodes(count)), count)

    def episodes(
        self, count: int, first: int = 0, progress: Callable[[int], object] = lambda n_made: None
    ) -> Iterator[list[Label]]:
        """The labels of whole episodes from number ``first`` on, in order, until there are at least ``count``.

        Args:
            progress: called with the number of labels so far, those of unfinished episodes included.
        """
        schedule = _Schedule(self, count, first)
        packings = [_Packing(self, pallets, schedule).steps() for pallets in self.groups]
        n_yielded = 0
        with closing(prefetch(*packings, most=self.n_pallets)) as steps:
            for _ in steps:
                progress(schedule.n_made)
                for labels in schedule.take_ended():
                    yield labels
                    n_yielded += len(labels)
                    if n_yielded >= count:
                        return
        yield from schedule.take_ended()  # episodes whose last boxes have no place

    def begun(self, number: int) -> Episode:
        """An episode at its beginning."""
        order = number % self.orders.count
        boxes = self.orders.numbered(order)
        return Episode(number, order, split_of(boxes), boxes, np.random.default_rng([self._seed, number]))

    def place(self, pallets: Pallets, running: Mapping[int, Episode]) -> list[int]:
        """Place the next box of each of these episodes. Boxes without a place are left out.

        Args:
            running: row of ``pallets`` → its episode.

        Returns:
            The rows that have a new box.
        """
        rows = np.array(list(running), np.int64)
        sizes = np.array([episode.boxes.size_mm[episode.next] for episode in running.values()])
        ways = np.stack([sizes, sizes[:, [1, 0, 2]]], axis=1).reshape(-1, 3)
        places = pallets.places(size_mm=ways, pallet=np.repeat(rows, 2), max_height_mm=self._highest_mm, hulls=False)
        of_row = np.split(np.arange(len(places.row)), np.searchsorted(places.row // 2, np.arange(1, len(rows))))
        chosen, placed = [], []
        for row, row_places in zip(rows.tolist(), of_row, strict=True):
            episode = running[row]
            explores = not episode.again and episode.rng.random() < self._explore
            pick = _any_place(row_places, episode.rng) if explores else _careful_place(places, row_places, episode.rng)
            if pick is None:
                episode.next, episode.again = episode.next + 1, False
                continue
            chosen.append(pick)
            placed.append(row)
            episode.careful = not explores
        if not placed:
            return []
        at = np.array(chosen)
        box = {
            "size_mm": ways[places.row[at]],
            "corner_mm": places.corner_mm[at],
            "mass_kg": np.array([running[row].boxes.mass_kg[running[row].next] for row in placed]),
            "pallet": np.array(placed),
        }
        if self._errors is not None:
            for row, share in zip(placed, pallets.try_all(**box, errors=self._errors).share.tolist(), strict=True):
                running[row].share = share
        pallets.place(**box)
        return placed


class _Schedule:
    """Begins episodes one after another, and returns their labels in this order. All groups of pallets share it.

    Args:
        count: number of labels that are needed; ``first``: number of the first episode.

    Attributes:
        n_made: number of labels so far, those of unfinished episodes included.
    """

    def __init__(self, labeller: Labeller, count: int, first: int) -> None:
        self._labeller, self._count = labeller, count
        self._most_waiting = MOST_EPISODES * labeller.n_pallets
        self._waiting: deque[Episode] = deque()
        """Episodes in order that are not over, or that wait for an earlier one."""
        self._ended: list[list[Label]] = []
        self.n_made = 0
        self._begun, self._n_ended, self._n_barren = first, 0, 0
        self._lock = Lock()

    @property
    def is_complete(self) -> bool:
        """Whether all episodes are over, and none will begin."""
        with self._lock:
            return self._n_lacking() <= 0 and not self._waiting

    def begin(self, most: int) -> list[Episode]:
        """Begin at most this many episodes. None begins if running episodes are expected to give enough labels, if no
        order has a box with a place, or if too many episodes wait for an earlier one."""
        begun: list[Episode] = []
        with self._lock:
            n_lacking = self._n_lacking()
            while len(begun) < most and n_lacking > 0 and len(self._waiting) <= self._most_waiting:
                begun.append(self._labeller.begun(self._begun))
                n_lacking -= begun[-1].n_expected
                self._begun += 1
                self._waiting.append(begun[-1])
        return begun

    def note_label(self) -> None:
        """Count a label."""
        with self._lock:
            self.n_made += 1

    def take_ended(self) -> list[list[Label]]:
        """The labels of episodes that are over, in order, each episode once."""
        with self._lock:
            self._end_first()
            taken, self._ended = self._ended, []
        return taken

    def _n_lacking(self) -> float:
        """Number of labels that further episodes have to give. 0: no order has a box with a place."""
        self._end_first()
        if self._n_barren >= 2 * self._labeller.orders.count:
            return 0
        return self._count - self._n_ended - sum(episode.n_expected for episode in self._waiting)

    def _end_first(self) -> None:
        """Move the labels of the first episodes that are over to ``_ended``."""
        while self._waiting and self._waiting[0].is_over:
            labels = self._waiting.popleft().labels
            self._n_barren = 0 if labels else self._n_barren + 1
            self._n_ended += len(labels)
            self._ended.append(labels)


class _Packing:
    """The episodes of one group of pallets.

    Attributes:
        running: row of the pallets → its episode, for episodes that are not over.
        scoring: rows whose last placement has no label yet.
    """

    def __init__(self, labeller: Labeller, pallets: Pallets, schedule: _Schedule) -> None:
        self.running: dict[int, Episode] = {}
        self.scoring: set[int] = set()
        self._labeller, self._pallets, self._schedule = labeller, pallets, schedule
        self._fallen: list[int] = []

    def steps(self) -> Generator[None]:
        """Pack episodes, and yield after each label and each pause, until the schedule is complete."""
        while True:
            with closing(self._pallets.outcomes(self.next_pallets, self.name)) as outcomes:
                for row, outcome in outcomes:
                    self.add(row, outcome)
                    yield
            if self._schedule.is_complete:
                return
            time.sleep(PAUSE_S)
            yield

    def name(self, row: int) -> str:
        """The name of a pallet in messages."""
        episode = self.running[row]
        return f"order {episode.order}, box {episode.next}"

    def next_pallets(self) -> list[int]:
        """Place boxes on the pallets whose placements have labels, and return these pallets. A GPU takes as long for
        few pallets as for many: nothing is placed while more than one pallet in ``SCORING_SHARE`` waits for its label.
        """
        if SCORING_SHARE * len(self.scoring) > len(self._pallets):
            return []
        if self._fallen:
            self._pallets.take_back(self._fallen)
            self._fallen = []
        while True:
            self._begin()
            free = {row: episode for row, episode in self.running.items() if row not in self.scoring}
            if not free:
                return []
            placed = self._labeller.place(self._pallets, free)
            self._end_over(free)
            if placed:
                self.scoring |= {*placed}
                return placed

    def _begin(self) -> None:
        """Begin episodes on empty pallets, as the schedule allows."""
        empty = [row for row in range(len(self._pallets)) if row not in self.running]
        if empty and (episodes := self._schedule.begin(len(empty))):
            rows = empty[: len(episodes)]
            self.running |= zip(rows, episodes, strict=True)
            self._pallets.reset(rows)

    def _end_over(self, rows: Iterable[int]) -> None:
        for row in rows:
            if row in self.running and self.running[row].is_over:
                del self.running[row]

    def add(self, row: int, outcome: Outcome) -> None:
        """Label the last placement on a pallet."""
        episode, pallets = self.running[row], self._pallets
        (size_mm,), (corner_mm,), (mass_kg,) = pallets.boxes(row)
        label = _label_of(outcome) | {
            "size_mm": size_mm.copy(),
            "corner_mm": corner_mm.copy(),
            "mass_kg": mass_kg.copy(),
        }
        label |= {"order": episode.order, "episode": episode.number, "step": len(episode.labels)}
        label |= {"careful": episode.careful, "split": episode.split, "share": episode.share}
        episode.labels.append(label)
        self._schedule.note_label()
        self.scoring.discard(row)
        if label["stands"] and not pallets.ended[row]:  # a later attempt may stand where the first has fallen
            episode.next, episode.again = episode.next + 1, False
            if pallets.n_boxes[row] >= pallets.most_boxes:
                episode.next = len(episode.boxes)
        else:
            self._fallen.append(row)
            episode.again = not episode.careful and not label["stands"]
            episode.next += not episode.again
        self._end_over([row])


def _any_place(some: Any, rng: np.random.Generator) -> int | None:
    return int(rng.choice(some)) if len(some) else None


def _careful_place(places: Places, some: Any, rng: np.random.Generator) -> int | None:
    """One of the lowest places with enough support; None: no such place."""
    borne = some[places.support[some] >= CAREFUL_SUPPORT]
    lowest = borne[np.argsort(places.corner_mm[borne, 2], kind="stable")][:LOWEST]
    return int(rng.choice(lowest)) if len(lowest) else None


def _label_of(outcome: Outcome) -> Label:
    """The columns of a label that are results of a score."""
    invalid, force = outcome.verdict is Verdict.INVALID, outcome.boxes.rest_top_force_n[: outcome.n_placed]
    rests = len(force) == outcome.n_boxes and not np.isnan(force).any()
    return {
        "stands": None if invalid else outcome.verdict is Verdict.STABLE,
        "reason": outcome.reason.value,
        "culprit": None if outcome.culprit < 0 else outcome.culprit,
        "margin": None if invalid else outcome.margin,
        "top_force_n": np.asarray(force, np.float64) if rests else None,
    }


def plans_of_labels(labels: Sequence[Label]) -> list[Plan]:
    """The plan of each label, whose id is its episode and step."""
    return [
        Plan.from_boxes(
            f"{label['episode']}-{label['step']}",
            size_mm=label["size_mm"],
            corner_mm=label["corner_mm"],
            mass_kg=label["mass_kg"],
        )
        for label in labels
    ]
