"""Makes labels, as training data for models that predict stability. A label is a placement of a box on a pile, together
with the result of a simulation of the pile with this box.

Episode i packs order i of a source, box by box. After the last order, the first order is packed again. Each box is put
to a random place, or to a place that a careful packer chooses, and each of these placements is a label. If the pallet
does not stand, the box is removed. A box that was removed from a random place is then tried once at a careful place,
which gives another label. If the pallet does not stand with the careful placement either, the box is left out. An
episode depends only on its number and the seed, so a larger set begins with the labels of a smaller set.
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
from numpy.typing import NDArray

from petmjx.common.argument_checks import integer_of, number_of
from petmjx.common.prefetch import prefetch
from petmjx.common.text import alternatives
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.loop.candidate_places import Places
from petmjx.loop.engine_setup import chooses_gpu
from petmjx.loop.episode_orders import Boxes, Orders
from petmjx.loop.pallets import Pallets
from petmjx.options.run_options import AUTO
from petmjx.options.thresholds import FAILURES
from petmjx.plans.plan import Plan

CAREFUL_SUPPORT: Final = 0.75
"""Smallest share of the base that must be supported at the places of the careful packer."""

LOWEST: Final = 4
"""The careful packer chooses at random from this number of lowest places."""

SCORING_SHARE: Final = 8
"""The next boxes are placed as soon as at most 1 / ``SCORING_SHARE`` of the pallets wait for a label. So a pallet whose
simulation must be repeated does not delay all other pallets."""

MOST_EPISODES: Final = 4
"""Largest number of episodes that are running, or are over but wait for an earlier episode, as a multiple of the number
of pallets."""

SURE_SHARE: Final = 0.8
"""Expected number of labels for each box that is still to be placed. A box without a place gives no label, and a box
that is tried twice gives two labels. The number is chosen a little too small, so that more episodes begin than are
needed. If a further episode had to begin at the end, all other pallets would wait, while the boxes of this episode are
placed one after another."""

GROUPS_ON_GPU: Final = 2
"""Number of groups into which pallets on a GPU are divided. While the GPU simulates one group, the CPU checks the
results of the other group and chooses its next places."""

PALLETS_ON_GPU: Final = 4096
"""Default number of pallets that are packed at the same time on a GPU. Half of these pallets, that is, one of the two
groups (``GROUPS_ON_GPU``), is enough to keep the GPU busy. The two groups take turns on the GPU."""

PALLETS_ON_CPU: Final = 64

PAUSE_S: Final = 0.02
"""Time after which a group of pallets without work checks again whether it can begin an episode, s."""

COLUMNS: Final[dict[str, tuple[pa.DataType, str]]] = {
    "order": (pa.int64(), "number of the order in its source, from 0"),
    "episode": (
        pa.int64(),
        "number of the episode; an order has several episodes if there are fewer orders than episodes",
    ),
    "step": (pa.int32(), "number of the label within its episode"),
    "careful": (pa.bool_(), "whether a careful packer chose the place; if not, the place is random"),
    "size_mm": (
        pa.list_(pa.list_(pa.float64(), 3)),
        "extents of all boxes of the pallet as they stand; the new box is the last",
    ),
    "corner_mm": (
        pa.list_(pa.list_(pa.float64(), 3)),
        "front-left-bottom corners of all boxes of the pallet; the new box is the last",
    ),
    "mass_kg": (pa.list_(pa.float64()), "masses of all boxes of the pallet; the new box is the last"),
    "stands": (pa.bool_(), "whether the pallet with the new box is stable in a score; null if it has no verdict"),
    "reason": (
        pa.string(),
        f"reason why the pallet is not stable ({alternatives(failure.reason for failure in FAILURES)}), or why it has "
        "no verdict",
    ),
    "culprit": (pa.int32(), "number (from 0) of the box that failed first; null if no box failed"),
    "margin": (
        pa.float32(),
        "distance to the nearest threshold, as in the column `margin` of a run; null without a verdict",
    ),
    "share": (
        pa.float32(),
        "share of worlds with errors in which the pallet stands; null if no worlds with errors were simulated",
    ),
    "top_force_n": (
        pa.list_(pa.float32()),
        "force on the top of each box at rest, N; null if the pallet did not come to rest",
    ),
}
"""Name of a column of labels → type and meaning of the column."""

SPLITS: Final = {"train": 0.8, "validation": 0.1, "test": 0.1}
"""Share of the orders in each split (training, validation and test set of models)."""

Label = dict[str, Any]
"""A label, as a dict with a value for each name in ``COLUMNS`` and a value for ``split``. Values with an entry for each
box are NumPy arrays."""

SCHEMA: Final = pa.schema([(name, kind) for name, (kind, _) in COLUMNS.items()])


@dataclass(eq=False)
class Episode:
    """The packing of one order on one pallet.

    Attributes:
        boxes: boxes of the order; ``next``: number of the box to place next; ``again``: whether this box is tried for
            the second time.
        careful: whether the last box was put to a place of the careful packer.
        share: share of the simulations with errors in which the pallet stands with the last box; None if simulations
            with errors were not requested.
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
        """Whether all boxes have been tried."""
        return self.next >= len(self.boxes)

    @property
    def n_expected(self) -> float:
        """Number of labels that the episode is expected to give in all."""
        return len(self.labels) + SURE_SHARE * (len(self.boxes) - self.next)


class Labeller:
    """Makes labels: placements of boxes, with the results of simulations.

    Args:
        orders: source of the orders (lists of boxes to pack).
        pallets: number of pallets that are packed at the same time. Labels do not depend on the number of pallets. The
            default is ``PALLETS_ON_GPU`` on a GPU, else ``PALLETS_ON_CPU``.
        groups: number of groups into which the pallets are divided. Each group has a thread of its own. The default is
            ``GROUPS_ON_GPU`` on a GPU, else 1.
        explore: share of boxes that are tried at a random place first.
        errors: number of additional simulations of each label in which a robot places the box inexactly. If ``errors``
            is None, no simulations with an inexact robot are made.
        max_height_mm: largest allowed height of a box's top.
        others: options of ``petmjx.Pallets``.

    Attributes:
        n_pallets: number of pallets in all groups.
        groups: the pallets of each group.
        options: the options of this class on which labels depend.

    Raises:
        InputError: an option is unusable.
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
        """The first ``count`` labels, in the order of episodes. There are no labels if there is no place for any
        box."""
        return islice(chain.from_iterable(self.episodes(count)), count)

    def episodes(
        self, count: int, first: int = 0, progress: Callable[[int], object] = lambda n_made: None
    ) -> Iterator[list[Label]]:
        """The labels of finished episodes, from episode ``first`` on, in order, until there are at least ``count``
        labels.

        Args:
            progress: function that is called with the number of labels made so far, including the labels of unfinished
                episodes.
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
        # the last boxes of the remaining episodes gave no labels, because there was no place for them
        yield from schedule.take_ended()

    def begun(self, number: int) -> Episode:
        """The episode with the given number, before its first box is placed."""
        order = number % self.orders.count
        boxes = self.orders.numbered(order)
        return Episode(number, order, split_of(boxes), boxes, np.random.default_rng([self._seed, number]))

    def place(self, pallets: Pallets, running: Mapping[int, Episode]) -> list[int]:
        """Place the next box of each given episode. A box for which there is no place is left out.

        Args:
            running: number of a pallet → the pallet's episode.

        Returns:
            The numbers of the pallets that have a new box.
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
            some = row_places if explores else _careful_places(places, row_places)
            if not len(some):
                episode.next, episode.again = episode.next + 1, False
                continue
            chosen.append(int(episode.rng.choice(some)))
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
    """Begins episodes one after another, and returns their labels in the order of the episodes. All groups of pallets
    share one schedule.

    Args:
        count: number of labels that are needed; ``first``: number of the first episode.

    Attributes:
        n_made: number of labels made so far, including the labels of unfinished episodes.
    """

    def __init__(self, labeller: Labeller, count: int, first: int) -> None:
        self._labeller, self._count = labeller, count
        self._most_waiting = MOST_EPISODES * labeller.n_pallets
        self._waiting: deque[Episode] = deque()
        """Episodes in order that are not over, or that are over but wait for an earlier episode."""
        self._ended: list[list[Label]] = []
        self.n_made = 0
        self._begun, self._n_ended, self._n_barren = first, 0, 0
        self._lock = Lock()

    @property
    def is_complete(self) -> bool:
        """Whether all episodes are over, and no further episode will begin."""
        with self._lock:
            return self._n_lacking() <= 0 and not self._waiting

    def begin(self, most: int) -> list[Episode]:
        """Begin at most ``most`` episodes. No episode begins if the running episodes are expected to give enough
        labels, if no box of any order has a place, or if too many episodes wait for an earlier episode."""
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
        """Count a label that has been made."""
        with self._lock:
            self.n_made += 1

    def take_ended(self) -> list[list[Label]]:
        """The labels of the episodes that are over, in order. The labels of an episode are returned only once."""
        with self._lock:
            self._end_first()
            taken, self._ended = self._ended, []
        return taken

    def _n_lacking(self) -> float:
        """Number of labels that further episodes must give. The number is 0 if there is no place for any box of any
        order."""
        self._end_first()
        if self._n_barren >= 2 * self._labeller.orders.count:
            return 0
        return self._count - self._n_ended - sum(episode.n_expected for episode in self._waiting)

    def _end_first(self) -> None:
        """Move the labels of episodes that are over to ``_ended``, up to the first episode that is not over."""
        while self._waiting and self._waiting[0].is_over:
            labels = self._waiting.popleft().labels
            self._n_barren = 0 if labels else self._n_barren + 1
            self._n_ended += len(labels)
            self._ended.append(labels)


class _Packing:
    """The episodes of one group of pallets.

    Attributes:
        running: number of a pallet → the pallet's episode, for episodes that are not over.
        scoring: numbers of the pallets whose last placement has no label yet.
    """

    def __init__(self, labeller: Labeller, pallets: Pallets, schedule: _Schedule) -> None:
        self.running: dict[int, Episode] = {}
        self.scoring: set[int] = set()
        self._labeller, self._pallets, self._schedule = labeller, pallets, schedule
        self._fallen: list[int] = []

    def steps(self) -> Generator[None]:
        """Pack episodes until all episodes are over and no further episode will begin. Yields after each label and
        after each pause."""
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
        """Place the next boxes on the pallets that do not wait for a label, and return the pallets with a new box. A
        GPU takes as long for few pallets as for many. So no box is placed while more than 1 / ``SCORING_SHARE`` of the
        pallets wait for their label.
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
        """Begin episodes on pallets without an episode, as many as the schedule allows."""
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
        """Make the label of the last placement on a pallet, and prepare the next placement."""
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
        # the label may be from a repeated simulation, in which the pallet may stand although the open pallet has fallen
        if label["stands"] and not pallets.ended[row]:
            episode.next, episode.again = episode.next + 1, False
            if pallets.n_boxes[row] >= pallets.most_boxes:
                episode.next = len(episode.boxes)
        else:
            self._fallen.append(row)
            episode.again = not episode.careful and not label["stands"]
            episode.next += not episode.again
        self._end_over([row])


def _careful_places(places: Places, some: NDArray[np.intp]) -> NDArray[np.intp]:
    """Indices of the lowest places at which at least the share ``CAREFUL_SUPPORT`` of the base is supported: at most
    ``LOWEST`` places. ``some`` has the indices of the places that may be chosen."""
    borne = some[places.support[some] >= CAREFUL_SUPPORT]
    return borne[np.argsort(places.corner_mm[borne, 2], kind="stable")][:LOWEST]


def _label_of(outcome: Outcome) -> Label:
    """The values of a label that are results of the simulation."""
    invalid, force = outcome.verdict is Verdict.INVALID, outcome.boxes.rest_top_force_n[: outcome.n_placed]
    rests = len(force) == outcome.n_boxes and not np.isnan(force).any()
    return {
        "stands": None if invalid else outcome.verdict is Verdict.STABLE,
        "reason": outcome.reason.value,
        "culprit": None if outcome.culprit < 0 else outcome.culprit,
        "margin": None if invalid else outcome.margin,
        "top_force_n": np.asarray(force, np.float64) if rests else None,
    }


def split_of(boxes: Boxes) -> str:
    """The split to which an order belongs. The split depends only on the sizes and masses of the order's boxes, not on
    their sequence or orientation. So orders with the same boxes are in the same split."""
    rows = np.column_stack([np.sort(boxes.size_mm, axis=1), boxes.mass_kg]).round(3)
    content = rows[np.lexsort(rows.T)].tobytes()
    place = int.from_bytes(hashlib.sha256(content).digest()[:8]) / 2**64
    for name, share in SPLITS.items():
        if place < share:
            return name
        place -= share
    return name


def plans_of_labels(labels: Sequence[Label]) -> list[Plan]:
    """A plan for each label. The id of the plan consists of the label's episode and step."""
    return [
        Plan.from_boxes(
            f"{label['episode']}-{label['step']}",
            size_mm=label["size_mm"],
            corner_mm=label["corner_mm"],
            mass_kg=label["mass_kg"],
        )
        for label in labels
    ]
