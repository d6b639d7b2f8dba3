"""Action tables: places for the boxes that may come next, legal or not, with a row for each episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.gym.environment_options import CANDIDATES, CENTRE, LOADS, PHYSICS, SUPPORT, PalletizingOptions
from petmjx.loop.candidate_places import Places
from petmjx.loop.pallets import Pallets

FEATURES: Final = ("box", "turned", "x", "y", "z", "length_x", "length_y", "height", "mass", "support", "margin")
"""Features of a candidate: its index among the visible boxes, whether it is turned by 90°, its corner and extents, mm,
its mass, kg, the supported share of its base, and the pallet's margin with it if the mask uses physics (else 0)."""


@dataclass(eq=False)
class Table:
    """The table of n episodes × a actions. All values of an illegal action are 0.

    Attributes:
        legal: (n, a) mask of legal actions.
        box: (n, a) index among the visible boxes; ``size_mm``, ``corner_mm``: (n, a, 3); ``mass_kg``: (n, a).
        turned: (n, a) whether length and width are swapped.
        support: (n, a) supported share of the base; ``margin``: (n, a) the pallet's margin if the mask uses physics,
            else 0.
    """

    legal: NDArray[np.bool_]
    box: NDArray[np.int64]
    turned: NDArray[np.bool_]
    size_mm: FloatArray
    corner_mm: FloatArray
    mass_kg: FloatArray
    support: FloatArray
    margin: FloatArray

    @classmethod
    def empty(cls, n: int, a: int) -> Table:
        """A table without legal actions."""
        three, one = (n, a, 3), (n, a)
        return cls(
            np.zeros(one, bool),
            np.zeros(one, np.int64),
            np.zeros(one, bool),
            np.zeros(three),
            np.zeros(three),
            np.zeros(one),
            np.zeros(one),
            np.zeros(one),
        )

    def clear(self, rows: NDArray[np.int64]) -> None:
        """Clear the actions of some episodes."""
        for values in vars(self).values():
            values[rows] = 0

    def features(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(m, a, f) ``FEATURES`` of some episodes."""
        features = np.empty((len(rows), self.legal.shape[1], len(FEATURES)), np.float32)
        at = 0
        for values in (self.box, self.turned, self.corner_mm, self.size_mm, self.mass_kg, self.support, self.margin):
            some = values[rows].reshape(*features.shape[:2], -1)
            features[..., at : at + some.shape[2]] = some
            at += some.shape[2]
        return features


class Actions:
    """Fills in action tables.

    Attributes:
        count: number of actions of an episode.
        strength_n: (n, k) the loads that the boxes on pallets can bear, N; NaN if not given.
    """

    def __init__(self, pallets: Pallets, options: PalletizingOptions) -> None:
        self._pallets, self._options = pallets, options
        self.strength_n: FloatArray = np.full((pallets.n, pallets.most_boxes), np.nan)
        cell, (x, y) = options.action_cell_mm, pallets.extent_mm
        self._cells = int(np.ceil(x / cell - 1e-9)), int(np.ceil(y / cell - 1e-9))
        corners: FloatArray = np.indices(self._cells).reshape(2, -1).T.astype(np.float64) * cell
        self._grid = None if options.actions == CANDIDATES else corners
        most = max(options.n_candidates, options.buffer)  # each box of the buffer has a share
        self.count = most if self._grid is None else 2 * options.buffer * len(corners)

    @property
    def asks_physics(self) -> bool:
        """Whether the mask tries places in physics."""
        return self._options.mask in (PHYSICS, LOADS)

    def fill(self, table: Table, rows: NDArray[np.int64], size_mm: FloatArray, mass_kg: FloatArray) -> None:
        """Find the actions of some episodes.

        Args:
            size_mm: (m, k, 3) of the visible boxes; ``mass_kg``: (m, k), 0 without a box.
        """
        table.clear(rows)
        at, box = np.nonzero(mass_kg[:, : self._options.buffer])
        square = size_mm[at, box, 0] == size_mm[at, box, 1]
        at, box = (np.repeat(values, 2) for values in (at, box))
        turned = np.tile([False, True], len(square))
        kept = ~(turned & np.repeat(square, 2))
        at, box, turned = at[kept], box[kept], turned[kept]
        sizes, masses = size_mm[at, box].copy(), mass_kg[at, box]
        sizes[turned] = sizes[turned][:, [1, 0, 2]]
        if not len(at):
            return
        places = self._pallets.places(
            size_mm=sizes,
            pallet=rows[at],
            max_height_mm=self._options.max_height_mm,
            grid_mm=self._grid,
            least_support=SUPPORT.get(self._options.mask, 0.0),
            hulls=self._options.mask == CENTRE,
        )
        legal = self._geometric(places)
        chosen = np.flatnonzero(legal)
        row, number = self._numbered(places, chosen, at, box, turned)
        chosen, row, number = (values[number < self.count] for values in (chosen, row, number))
        margin = np.zeros(len(chosen))
        stands = np.ones(len(chosen), bool)
        source = places.row[chosen]
        if self.asks_physics and len(chosen):
            candidates = {
                "size_mm": sizes[source],
                "corner_mm": places.corner_mm[chosen],
                "mass_kg": masses[source],
                "pallet": rows[row],
            }
            if self._options.mask == LOADS:
                trials = self._pallets.try_all(**candidates)
                margin = np.nan_to_num(trials.margin)
                stands = trials.stable & ~self._overloads(rows[row], trials.top_force_n)
            else:
                stands, margin = self._pallets.stands(**candidates)
        chosen, row, number, source = (values[stands] for values in (chosen, row, number, source))
        into = rows[row], number
        table.legal[into] = True
        table.box[into], table.turned[into] = box[source], turned[source]
        table.size_mm[into], table.mass_kg[into] = sizes[source], masses[source]
        table.corner_mm[into], table.support[into] = places.corner_mm[chosen], places.support[chosen]
        table.margin[into] = margin[stands]

    def _overloads(self, pallets: NDArray[np.int64], force_n: FloatArray) -> NDArray[np.bool_]:
        """(c,) whether a box on the pallet bears more than its strength. ``force_n``: (c, k), N. The last box is the
        candidate, with nothing on it."""
        return np.asarray((force_n > self.strength_n[pallets, : force_n.shape[1]]).any(axis=1))

    def _geometric(self, places: Places) -> NDArray[np.bool_]:
        """(c,) which places the mask allows before any test in physics."""
        if places.centred is not None:
            return places.centred
        return places.support > 0 if self.asks_physics else np.ones(len(places.row), bool)

    def _numbered(
        self,
        places: Places,
        chosen: NDArray[np.intp],
        at: NDArray[np.intp],
        box: NDArray[np.intp],
        turned: NDArray[np.bool_],
    ) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """(c,) the episode of each chosen place, and the number of its action; ``count`` or more if it has none.
        Candidates are numbered box after box, the lowest places first. Cells are numbered by box, orientation and
        cell."""
        source = places.row[chosen]
        row = at[source]
        if self._grid is not None:
            x, y = np.rint(places.corner_mm[chosen, :2] / self._options.action_cell_mm).astype(np.int64).T
            nx, ny = self._cells
            return row, ((box[source] * 2 + turned[source]) * nx + x) * ny + y
        corner = places.corner_mm[chosen]
        seen = row * self._options.buffer + box[source]  # places of one box are already in order along x
        order = np.lexsort((corner[:, 1], corner[:, 0], corner[:, 2], seen))
        number = np.full(len(row), self.count)
        kept = order[_in_turn(row[order], seen[order], self.count)]
        number[kept] = _ranks(row[kept])
        return row, number


def _in_turn(row: NDArray[np.intp], seen: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Choose at most ``most`` places of each episode: the first place of each box, then the second of each, and so on.
    A box with few places leaves its share to the other boxes.

    Args:
        row: (c,) episode of each place, rising.
        seen: (c,) box of each place, rising; no two episodes have the same number. The best places of a box come first.

    Returns:
        Rising indices of the chosen places.
    """
    turn = np.lexsort((seen, _ranks(seen), row))
    return np.sort(turn[_ranks(row[turn]) < most])


def _ranks(of: NDArray[np.intp]) -> NDArray[np.int64]:
    """0, 1, 2, … within each run of equal values. Equal values are adjacent."""
    first = np.flatnonzero(np.diff(of, prepend=-1))
    return np.arange(len(of)) - np.repeat(first, np.diff(first, append=len(of)))
