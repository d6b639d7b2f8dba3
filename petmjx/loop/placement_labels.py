"""Labels of placements for models that predict stability: boxes put onto piles, and the result of a score for each.

Episode i packs order i of a source, box by box, and begins anew with the first order behind the last order. Each box
goes to a random place, or to a place of a careful packer. Each such placement is a label. Where the pallet does not
stand, the box is taken back, tried once at a careful place, which is the next label, and else left out. An episode
depends on its number and the seed alone, so a larger set begins with the labels of a smaller one.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Any, Final

import numpy as np
import pyarrow as pa

from petmjx.common.argument_checks import integer_of, number_of
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.loop.candidate_places import Places
from petmjx.loop.order_sources import Boxes, Orders
from petmjx.loop.pallets import Pallets
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
"""Most episodes that wait for an earlier one, whose labels come first, as a multiple of the pallets."""

COLUMNS: Final[dict[str, tuple[pa.DataType, str]]] = {
    "order": (pa.int64(), "number of the order in its source, from 0"),
    "episode": (pa.int64(), "number of the episode; one order has several if the source has too few"),
    "step": (pa.int32(), "number of the label in its episode"),
    "careful": (pa.bool_(), "whether the place is one of a careful packer's, or any"),
    "size_mm": (
        pa.list_(pa.list_(pa.float32(), 3)),
        "extents of all boxes of the pallet as they stand; the last is new",
    ),
    "corner_mm": (pa.list_(pa.list_(pa.float32(), 3)), "front-left-bottom corners of the same boxes"),
    "mass_kg": (pa.list_(pa.float32()), "masses of the same boxes"),
    "stands": (pa.bool_(), "whether a score says that the pallet with the new box is stable; null: it has no verdict"),
    "reason": (pa.string(), "why it is not: drop, tilt or shift, or why there is no verdict"),
    "culprit": (pa.int32(), "the box that failed first, counted from 0; null: none did"),
    "margin": (pa.float32(), "distance to the nearest threshold, as in the column margin of a run; null: no verdict"),
    "share": (pa.float32(), "share of worlds with errors in which it stands; null: not simulated"),
    "top_force_n": (pa.list_(pa.float32()), "force on the top of each box at rest, N; null: it did not come to rest"),
}
"""Columns of the labels: type, and meaning."""

Label = dict[str, Any]
"""Values by ``COLUMNS``, and ``split``. Lists of boxes are arrays."""

SCHEMA: Final = pa.schema([(name, kind) for name, (kind, _) in COLUMNS.items()])


def split_of(boxes: Boxes) -> str:
    """The split of an order. The split of an order depends on its boxes alone, in any sequence and turned in any way,
    so that orders with the same boxes are in one split."""
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
        labels: of the boxes so far.
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


class Labeller:
    """Makes labels.

    Args:
        orders: source of boxes.
        pallets: number of pallets side by side; labels do not depend on it.
        explore: share of boxes that go to a random place first.
        errors: number of worlds with errors of each label; None: none.
        max_height_mm: highest top of a box.
        others: of ``petmjx.Pallets``.

    Attributes:
        options: all other options on which labels depend.

    Raises:
        InputError: an unusable option.
    """

    def __init__(
        self,
        orders: Orders,
        *,
        pallets: int = 64,
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
        self.pallets = Pallets(integer_of(pallets, "pallets", 1), **others)
        orders.check_sizes(self.pallets.simulation.size_reduction_mm)
        self.options = {
            "seed": self._seed,
            "explore": self._explore,
            "errors": self._errors,
            "max_height_mm": self._highest_mm,
            "most_boxes": self.pallets.most_boxes,
        }

    def labels(self, count: int) -> Iterator[Label]:
        """The first ``count`` labels, in the order of episodes; none if no box has a place."""
        return islice(chain.from_iterable(self.episodes(count)), count)

    def episodes(self, count: int, first: int = 0) -> Iterator[list[Label]]:
        """The labels of whole episodes from number ``first`` on, in order, until there are at least ``count``."""
        packing = _Packing(self, count, first)
        n_yielded = 0
        with closing(self.pallets.outcomes(packing.next_pallets, packing.name)) as outcomes:
            for row, outcome in outcomes:
                packing.add(row, outcome)
                for labels in packing.take_ended():
                    yield labels
                    n_yielded += len(labels)
                    if n_yielded >= count:
                        return
        yield from packing.take_ended()

    def begun(self, number: int) -> Episode:
        """An episode at its beginning."""
        order = number % self.orders.count
        boxes = self.orders.numbered(order)
        return Episode(number, order, split_of(boxes), boxes, np.random.default_rng([self._seed, number]))

    def place(self, running: Mapping[int, Episode]) -> list[int]:
        """Place the next box of each of these episodes. Boxes without a place are left out.

        Args:
            running: pallet → its episode.

        Returns:
            The pallets that have a new box.
        """
        rows = np.array(list(running), np.int64)
        sizes = np.array([episode.boxes.size_mm[episode.next] for episode in running.values()])
        ways = np.stack([sizes, sizes[:, [1, 0, 2]]], axis=1).reshape(-1, 3)
        places = self.pallets.places(
            size_mm=ways, pallet=np.repeat(rows, 2), max_height_mm=self._highest_mm, hulls=False
        )
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
            for row, share in zip(placed, self.pallets.try_all(**box, errors=self._errors).share.tolist(), strict=True):
                running[row].share = share
        self.pallets.place(**box)
        return placed


class _Packing:
    """The episodes of a call of ``Labeller.labels``, each on its pallet.

    Attributes:
        running: pallet → its episode, for episodes that are not over.
        scoring: pallets whose last placement has no label yet.
    """

    def __init__(self, labeller: Labeller, count: int, first: int) -> None:
        self.running: dict[int, Episode] = {}
        self.scoring: set[int] = set()
        self._labeller, self._pallets, self._count = labeller, labeller.pallets, count
        self._waiting: deque[Episode] = deque()
        """Episodes in order; the first ones are taken when they are over."""
        self._begun, self._made, self._barren = first, 0, 0
        self._fallen: list[int] = []

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
            placed = self._labeller.place(free)
            self._end_over(free)
            if placed:
                self.scoring |= {*placed}
                self._made += len(placed)
                return placed

    def _begin(self) -> None:
        """Begin episodes on empty pallets, until the labels are enough or no order has a box with a place. While an
        earlier episode is behind, others go on, but none begins."""
        n_orders = self._labeller.orders.count
        if len(self._waiting) > MOST_EPISODES * len(self._pallets) and not self._waiting[0].is_over:
            return
        rows = []
        for row in range(len(self._pallets)):
            if row not in self.running and self._made < self._count and self._barren < 2 * n_orders:
                self.running[row] = self._labeller.begun(self._begun)
                self._waiting.append(self.running[row])
                self._begun += 1
                rows.append(row)
        if rows:
            self._pallets.reset(rows)

    def _end_over(self, rows: Iterable[int]) -> None:
        for row in rows:
            if row in self.running and self.running[row].is_over:
                self._barren = 0 if self.running[row].labels else self._barren + 1
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

    def take_ended(self) -> Iterator[list[Label]]:
        """The labels of the first episodes, as long as these are over."""
        while self._waiting and self._waiting[0].is_over:
            yield self._waiting.popleft().labels


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
