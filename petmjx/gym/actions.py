"""Action tables: one row per episode, with places for the boxes that may come next and whether each place is legal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.gym.environment_options import ALL, CANDIDATES, CENTRE, LOADS, PHYSICS, SUPPORT, SURE, PalletizingOptions
from petmjx.loop.candidate_places import Places
from petmjx.loop.order_sources import Orders
from petmjx.loop.pallets import Pallets
from petmjx.loop.placement_bounds import STANDS

FEATURES: Final = ("box", "turned", "x", "y", "z", "length_x", "length_y", "height", "mass", "support", "margin")
"""Features of a candidate: its index among the visible boxes, whether it is turned by 90°, its corner and extents in
mm, its mass in kg, the supported share of its base, and the margin that the pallet has with it if the mask uses physics
(else 0)."""

UPRIGHT: Final = "upright"
PALLET: Final = "pallet"
"""Further features, in environments in which actions choose them: which size is vertical (0: height, 1: width, 2:
length), and the number of the pallet."""

SIDES: Final = np.array([(0, 1, 2), (1, 0, 2), (0, 2, 1), (2, 0, 1), (1, 2, 0), (2, 1, 0)])
"""(6, 3) for each side on which a box can stand, the sizes along x, y and z (0: length, 1: width, 2: height). The two
rows of a pair differ by a turn about the vertical."""


@dataclass(eq=False)
class Table:
    """The table of n episodes × a actions. All values of an illegal action are 0.

    Attributes:
        legal: (n, a) mask of legal actions.
        box: (n, a) index among the visible boxes; ``size_mm``, ``corner_mm``: (n, a, 3) size and corner as placed;
            ``mass_kg``: (n, a).
        side: (n, a) index into ``SIDES``; ``pallet``: (n, a) number of the pallet in its episode.
        support: (n, a) supported share of the base; ``margin``: (n, a) the pallet's margin if the mask uses physics,
            else 0.
    """

    legal: NDArray[np.bool_]
    box: NDArray[np.int64]
    side: NDArray[np.int64]
    pallet: NDArray[np.int64]
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
            legal=np.zeros(one, bool),
            box=np.zeros(one, np.int64),
            side=np.zeros(one, np.int64),
            pallet=np.zeros(one, np.int64),
            size_mm=np.zeros(three),
            corner_mm=np.zeros(three),
            mass_kg=np.zeros(one),
            support=np.zeros(one),
            margin=np.zeros(one),
        )

    def clear(self, rows: NDArray[np.int64]) -> None:
        """Clear the actions of some episodes."""
        for values in vars(self).values():
            values[rows] = 0

    def copy(self, rows: NDArray[np.int64], table: Table, sources: NDArray[np.int64]) -> None:
        """Copy the episodes ``sources`` of another table to the given rows of this one."""
        for name, values in vars(self).items():
            values[rows] = getattr(table, name)[sources]

    def features(self, rows: NDArray[np.int64], names: Sequence[str]) -> NDArray[np.float32]:
        """(m, a, f) features of some episodes: ``FEATURES``, and further ones if ``names`` has them."""
        features = np.empty((len(rows), self.legal.shape[1], len(names)), np.float32)
        extra_columns = {UPRIGHT: self.side // 2, PALLET: self.pallet}
        at = 0
        for values in (
            *(self.box, self.side % 2, self.corner_mm, self.size_mm, self.mass_kg, self.support, self.margin),
            *(extra_columns[name] for name in names[len(FEATURES) :]),
        ):
            feature_rows = values[rows].reshape(*features.shape[:2], -1)
            features[..., at : at + feature_rows.shape[2]] = feature_rows
            at += feature_rows.shape[2]
        return features


def features_of(options: PalletizingOptions, orders: Orders) -> tuple[str, ...]:
    """The names of the features that a candidate has with these options."""
    extra_features = ((UPRIGHT, options.sides == ALL or orders.lie), (PALLET, options.open_pallets > 1))
    return (*FEATURES, *(name for name, is_on in extra_features if is_on))


class Actions:
    """Fills action tables. Episode i has ``open_pallets`` pallets, of which the first is i × ``open_pallets``.

    Attributes:
        count: number of actions of an episode.
        strength_n: (n, k) the loads that the boxes on the pallets can bear, N; NaN if unknown.
    """

    def __init__(self, pallets: Pallets, options: PalletizingOptions, orders: Orders) -> None:
        self._pallets, self._options = pallets, options
        self.strength_n: FloatArray = np.full((pallets.n, pallets.most_boxes), np.nan)
        cell, (x, y) = options.action_cell_mm, pallets.extent_mm
        self._cells = int(np.ceil(x / cell - 1e-9)), int(np.ceil(y / cell - 1e-9))
        corners: FloatArray = np.indices(self._cells).reshape(2, -1).T.astype(np.float64) * cell
        self._grid = None if options.actions == CANDIDATES else corners
        self._sides = SIDES if options.sides == ALL or orders.lie else SIDES[:2]
        # at least one action for each box of the buffer
        most = max(options.n_candidates, options.buffer)
        ways = options.open_pallets * options.buffer * len(self._sides)
        self.count = most if self._grid is None else ways * len(corners)

    @property
    def asks_physics(self) -> bool:
        """Whether the mask depends on whether the pallets would stand after a placement."""
        return self._options.mask in (SURE, PHYSICS, LOADS)

    def fill(
        self,
        table: Table,
        rows: NDArray[np.int64],
        size_mm: FloatArray,
        mass_kg: FloatArray,
        upright: NDArray[np.bool_],
        episodes: NDArray[np.int64] | None = None,
    ) -> None:
        """Fill some rows of a table with the actions of their episodes.

        Args:
            rows: (m,) rows of the table; ``episodes``: (m,) the episodes on whose pallets the boxes are placed; None:
                the same numbers as ``rows``.
            size_mm: (m, k, 3) sizes of the visible boxes; ``mass_kg``: (m, k), 0 if there is no box; ``upright``: (m,
                k, 3) which of the sizes may be vertical.
        """
        table.clear(rows)
        at, box = np.nonzero(mass_kg[:, : self._options.buffer])
        stands = self._sides_of(size_mm[at, box], upright[at, box])
        of, side, pallet = np.nonzero(np.repeat(stands[..., None], self._options.open_pallets, axis=2))
        at, box = at[of], box[of]
        on = (rows if episodes is None else episodes)[at] * self._options.open_pallets + pallet
        room = self._pallets.n_boxes[on] < self._pallets.most_boxes
        at, box, side, pallet, on = (values[room] for values in (at, box, side, pallet, on))
        sizes, masses = np.take_along_axis(size_mm[at, box], self._sides[side], axis=1), mass_kg[at, box]
        if not len(at):
            return
        places = self._pallets.places(
            size_mm=sizes,
            pallet=on,
            max_height_mm=self._options.max_height_mm,
            grid_mm=self._grid,
            least_support=SUPPORT.get(self._options.mask, 0.0),
            gap_mm=self._options.gap_mm,
            hulls=self._options.mask == CENTRE,
        )
        legal = self._geometric(places)
        chosen = np.flatnonzero(legal)
        row, number = self._numbered(places, chosen, at, box, side, pallet)
        chosen, row, number = (values[number < self.count] for values in (chosen, row, number))
        margin = np.zeros(len(chosen))
        stands = np.ones(len(chosen), bool)
        source = places.row[chosen]
        if self.asks_physics and len(chosen):
            candidates = {
                "size_mm": sizes[source],
                "corner_mm": places.corner_mm[chosen],
                "mass_kg": masses[source],
                "pallet": on[source],
            }
            if self._options.mask == LOADS:
                trials = self._pallets.try_all(**candidates)
                margin = np.nan_to_num(trials.margin)
                stands = trials.stable & ~self._overloads(on[source], trials.top_force_n)
            elif self._options.mask == SURE:
                stands = self._pallets.decided(**candidates) == STANDS
                margin = np.ones(len(stands))
            else:
                stands, margin = self._pallets.stands(**candidates)
        chosen, row, number, source = (values[stands] for values in (chosen, row, number, source))
        into = rows[row], number
        table.legal[into] = True
        table.box[into], table.side[into], table.pallet[into] = box[source], side[source], pallet[source]
        table.size_mm[into], table.mass_kg[into] = sizes[source], masses[source]
        table.corner_mm[into], table.support[into] = places.corner_mm[chosen], places.support[chosen]
        table.margin[into] = margin[stands]

    def _sides_of(self, size_mm: FloatArray, upright: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(b, s) the sides on which boxes may stand. Sides that give the same sizes as an earlier one are left out."""
        sizes = size_mm[:, self._sides]
        may = np.ones(sizes.shape[:2], bool)
        if self._options.sides != ALL:
            may &= upright[:, self._sides[:, 2]]
        for side in range(1, len(self._sides)):
            is_same = (sizes[:, :side] == sizes[:, side, None]).all(axis=2)
            may[:, side] &= ~(is_same & may[:, :side]).any(axis=1)
        return may

    def _overloads(self, pallets: NDArray[np.int64], force_n: FloatArray) -> NDArray[np.bool_]:
        """(c,) whether a box on the pallet would bear more than its strength. ``force_n``: (c, k), N. The last box is
        the candidate, whose top is free."""
        return np.asarray((force_n > self.strength_n[pallets, : force_n.shape[1]]).any(axis=1))

    def _geometric(self, places: Places) -> NDArray[np.bool_]:
        """(c,) whether the mask allows a place before physics is tested."""
        if places.centred is not None:
            return places.centred
        return places.support > 0 if self.asks_physics else np.ones(len(places.row), bool)

    def _numbered(
        self,
        places: Places,
        chosen: NDArray[np.intp],
        at: NDArray[np.intp],
        box: NDArray[np.intp],
        side: NDArray[np.intp],
        pallet: NDArray[np.intp],
    ) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """Two arrays (c,): the episode of each place, and the number of its action. A number of ``count`` or more means
        that the place has no action. Candidates are numbered box by box, the lowest places first. Cells are numbered by
        pallet, box, side and cell."""
        source = places.row[chosen]
        row = at[source]
        if self._grid is not None:
            x, y = np.rint(places.corner_mm[chosen, :2] / self._options.action_cell_mm).astype(np.int64).T
            nx, ny = self._cells
            way = (pallet[source] * self._options.buffer + box[source]) * len(self._sides) + side[source]
            return row, (way * nx + x) * ny + y
        corner = places.corner_mm[chosen]
        box_number = row * self._options.buffer + box[source]  # within a box, places are already sorted along x
        order = np.lexsort((corner[:, 1], corner[:, 0], corner[:, 2], box_number))
        number = np.full(len(row), self.count)
        selected = order[_in_turn(row[order], box_number[order], self.count)]
        number[selected] = _ranks(row[selected])
        return row, number


def _in_turn(row: NDArray[np.intp], seen: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Choose at most ``most`` places of each episode: first one place for each box, then a second one for each, and so
    on. If a box has few places, the other boxes get more.

    Args:
        row: (c,) episode of each place, in ascending order.
        seen: (c,) box of each place, in ascending order. Boxes of different episodes have different numbers. For each
            box the best places come first.

    Returns:
        Indices of the chosen places, in ascending order.
    """
    turn = np.lexsort((seen, _ranks(seen), row))
    return np.sort(turn[_ranks(row[turn]) < most])


def _ranks(of: NDArray[np.intp]) -> NDArray[np.int64]:
    """The ranks 0, 1, 2, … of the entries within each group of equal values. Equal values must be adjacent."""
    first = np.flatnonzero(np.diff(of, prepend=-1))
    return np.arange(len(of)) - np.repeat(first, np.diff(first, append=len(of)))
