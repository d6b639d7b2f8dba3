"""Labels of placements for models that predict stability: boxes put onto piles, and the result of a score for each.

Episode i packs order i of a source, box by box, and begins anew with the first order behind the last order. Each box
goes to a random place, or to a place of a careful packer. Each such placement is a label. Where the pallet does not
stand, the box is taken back, tried once at a careful place, which is the next label, and else left out. An episode
depends on its number and the seed alone, so a larger set begins with the labels of a smaller one.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from petmjx.common.argument_checks import integer_of, number_of
from petmjx.common.units import FloatArray
from petmjx.loop.candidate_places import Places
from petmjx.loop.order_sources import Boxes, Orders
from petmjx.loop.pallets import Pallets
from petmjx.plans.plan import Plan
from petmjx.results.run_reader import RunResults

SPLITS: Final = {"train": 0.8, "validation": 0.1, "test": 0.1}
"""Share of the orders in each split."""

CAREFUL_SUPPORT: Final = 0.75
"""Least supported share of the base at careful places."""

LOWEST: Final = 4
"""A careful packer chooses among this many lowest places."""

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
        labels: of the boxes so far.
    """

    number: int
    order: int
    split: str
    boxes: Boxes
    rng: np.random.Generator
    next: int = 0
    again: bool = False
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
        """The first ``count`` labels, in the order of episodes; fewer at the end of all orders."""
        return islice(chain.from_iterable(self.episodes(count)), count)

    def episodes(self, count: int, first: int = 0) -> Iterator[list[Label]]:
        """The labels of whole episodes from number ``first`` on, in order, until there are at least ``count``."""
        running: dict[int, Episode] = {}
        waiting: deque[Episode] = deque()  # episodes in order; the first ones are yielded when they are over
        begun, made, given, barren = first, 0, 0, 0
        while (goes_on := made < count and barren < 2 * self.orders.count) or running:
            for row in range(len(self.pallets)):
                if row not in running and goes_on:
                    running[row] = self._begun(begun)
                    waiting.append(running[row])
                    begun += 1
                    self.pallets.reset(row)
            made += self._step(running)
            for row in [row for row, episode in running.items() if episode.is_over]:
                barren = 0 if running[row].labels else barren + 1
                del running[row]
            while waiting and waiting[0].is_over:
                labels = waiting.popleft().labels
                if given < count:
                    yield labels
                given += len(labels)

    def _begun(self, number: int) -> Episode:
        order = number % self.orders.count
        boxes = self.orders.numbered(order)
        return Episode(number, order, split_of(boxes), boxes, np.random.default_rng([self._seed, number]))

    def _step(self, running: dict[int, Episode]) -> int:
        """Place a box in each running episode, and label it. Returns the number of labels."""
        rows = np.array(list(running), np.int64)
        sizes = np.array([episode.boxes.size_mm[episode.next] for episode in running.values()])
        ways = np.stack([sizes, sizes[:, [1, 0, 2]]], axis=1).reshape(-1, 3)
        places = self.pallets.places(
            size_mm=ways, pallet=np.repeat(rows, 2), max_height_mm=self._highest_mm, hulls=False
        )
        of_row = np.split(np.arange(len(places.row)), np.searchsorted(places.row // 2, np.arange(1, len(rows))))
        chosen, careful, placed = [], [], []
        for row, row_places in zip(rows.tolist(), of_row, strict=True):
            episode = running[row]
            explores = not episode.again and episode.rng.random() < self._explore
            pick = _any_place(row_places, episode.rng) if explores else _careful_place(places, row_places, episode.rng)
            if pick is None:
                episode.next, episode.again = episode.next + 1, False
                continue
            chosen.append(pick)
            careful.append(not explores)
            placed.append(row)
        if not placed:
            return 0
        on, at = np.array(placed), np.array(chosen)
        box = {
            "size_mm": ways[places.row[at]],
            "corner_mm": places.corner_mm[at],
            "mass_kg": np.array([running[row].boxes.mass_kg[running[row].next] for row in placed]),
            "pallet": on,
        }
        shares = np.full(len(on), np.nan)
        if self._errors is not None:
            shares = self.pallets.try_all(**box, errors=self._errors).share
        self.pallets.place(**box)
        results = self.pallets.score(on, to_the_bit=False)
        fallen = []
        labels = _labels_of(results, self.pallets, on, shares)
        for row, is_careful, label in zip(placed, careful, labels, strict=True):
            episode = running[row]
            label |= {"order": episode.order, "episode": episode.number, "step": len(episode.labels)}
            episode.labels.append(label | {"careful": is_careful, "split": episode.split})
            if label["stands"] and not self.pallets.ended[row]:  # a later attempt may stand where the first has fallen
                episode.next, episode.again = episode.next + 1, False
                if self.pallets.n_boxes[row] >= self.pallets.most_boxes:
                    episode.next = len(episode.boxes)
                continue
            fallen.append(row)
            episode.again = not is_careful and not label["stands"]
            episode.next += not episode.again
        if fallen:
            self.pallets.take_back(fallen)
        return len(placed)


def _any_place(some: Any, rng: np.random.Generator) -> int | None:
    return int(rng.choice(some)) if len(some) else None


def _careful_place(places: Places, some: Any, rng: np.random.Generator) -> int | None:
    """One of the lowest places with enough support; None: no such place."""
    borne = some[places.support[some] >= CAREFUL_SUPPORT]
    lowest = borne[np.argsort(places.corner_mm[borne, 2], kind="stable")][:LOWEST]
    return int(rng.choice(lowest)) if len(lowest) else None


def _labels_of(results: RunResults, pallets: Pallets, on: Any, shares: FloatArray) -> Iterator[Label]:
    """The results of a score for pallets."""
    worlds = results.worlds
    forces = {name: rows.to_numpy() for name, rows in results.boxes.groupby("plan_id", sort=False)["rest_top_force_n"]}
    sizes, corners, masses = pallets.boxes(on)
    counts = pallets.n_boxes[on]
    for number, (plan_id, verdict, reason, culprit, margin, share) in enumerate(
        zip(*(worlds[name] for name in ("plan_id", "verdict", "reason", "culprit", "margin")), shares, strict=True)
    ):
        k, force = counts[number], forces[plan_id]
        invalid = verdict == "invalid"
        yield {
            "size_mm": sizes[number, :k].copy(),
            "corner_mm": corners[number, :k].copy(),
            "mass_kg": masses[number, :k].copy(),
            "stands": None if invalid else verdict == "stable",
            "reason": reason or "",
            "culprit": None if pd.isna(culprit) else int(culprit),
            "margin": None if invalid else float(margin),
            "share": None if np.isnan(share) else float(share),
            "top_force_n": None if np.isnan(force).any() else force,
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
