"""Action tables of environments. For each episode, a table lists the places at which the next box may be put, and
whether each place is legal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.criteria import SUPPORT_CRITERIA
from petmjx.common.units import FloatArray
from petmjx.gym.environment_options import ALL, CANDIDATES, CENTRE, LOADS, PHYSICS, SURE, PalletizingOptions
from petmjx.loop.candidate_places import Places
from petmjx.loop.episode_orders import Orders
from petmjx.loop.pallets import Pallets
from petmjx.loop.placement_bounds import STANDS

FEATURES: Final = ("box", "turned", "x", "y", "z", "length_x", "length_y", "height", "mass", "support", "margin")
"""Features of a candidate, which is a box at a place: the index of the box among the visible boxes; whether the box is
turned by 90°; its corner and its extents, mm; its mass, kg; and the supported share of its base. If the mask of legal
actions uses physics, the last feature is the pallet's margin of stability with the box; otherwise, the last feature is
0."""

UPRIGHT: Final = "upright"
PALLET: Final = "pallet"
"""Further features of a candidate: which size of the box is vertical (0: height, 1: width, 2: length), and the number
of the pallet. An environment has the feature ``upright`` only if boxes may stand on other sides than the base, and the
feature ``pallet`` only if an episode has several pallets."""

SIDES: Final = np.array([(0, 1, 2), (1, 0, 2), (0, 2, 1), (2, 0, 1), (1, 2, 0), (2, 1, 0)])
"""(6, 3) the six orientations of a box. Each row tells which size is along x, y and z (0: length, 1: width, 2: height).
In each pair of rows, the same size is vertical, and the two rows differ by a turn of 90° about the vertical."""


@dataclass(eq=False)
class Table:
    """The actions of n episodes. Each episode has ``a`` actions. All values of an illegal action are 0.

    Attributes:
        legal: (n, a) mask of legal actions.
        box: (n, a) index of the box among the visible boxes.
        size_mm, corner_mm: (n, a, 3) extents and front-left-bottom corner of the box as placed.
        mass_kg: (n, a) mass of the box.
        side: (n, a) orientation of the box, as an index into ``SIDES``.
        pallet: (n, a) number of the pallet within the episode.
        support: (n, a) supported share of the box's base.
        margin: (n, a) the pallet's margin of stability after the action if the mask uses physics, else 0.
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
        """Make all actions of the episodes in the given rows illegal."""
        for values in vars(self).values():
            values[rows] = 0

    def copy(self, rows: NDArray[np.int64], table: Table, sources: NDArray[np.int64]) -> None:
        """Copy the rows ``sources`` of another table to the given rows of this table."""
        for name, values in vars(self).items():
            values[rows] = getattr(table, name)[sources]

    def features(self, rows: NDArray[np.int64], names: Sequence[str]) -> NDArray[np.float32]:
        """(m, a, f) the features of all actions of m episodes. Every action has the features ``FEATURES``, and the
        further features whose names are in ``names``."""
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
    """The names of the features that each candidate has if the environment has the options ``options``."""
    extra_features = ((UPRIGHT, options.sides == ALL or orders.lie), (PALLET, options.open_pallets > 1))
    return (*FEATURES, *(name for name, is_on in extra_features if is_on))


class Actions:
    """Finds the legal actions of episodes, and writes them into tables. Each episode has ``open_pallets`` pallets. The
    first pallet of episode i has the number i × ``open_pallets``.

    Attributes:
        count: number of actions of each episode, legal or not.
        strength_n: (n, k) largest load that each box on each pallet can bear, N; NaN if unknown.
    """

    def __init__(self, pallets: Pallets, options: PalletizingOptions, orders: Orders) -> None:
        self._pallets, self._options = pallets, options
        self.strength_n: FloatArray = np.full((pallets.n, pallets.most_boxes), np.nan)
        cell, (x, y) = options.action_cell_mm, pallets.extent_mm
        self._cells = int(np.ceil(x / cell - 1e-9)), int(np.ceil(y / cell - 1e-9))
        corners: FloatArray = np.indices(self._cells).reshape(2, -1).T.astype(np.float64) * cell
        self._grid = None if options.actions == CANDIDATES else corners
        self._sides = SIDES if options.sides == ALL or orders.lie else SIDES[:2]
        # each box that may come next needs at least one action
        most = max(options.n_candidates, options.buffer)
        ways = options.open_pallets * options.buffer * len(self._sides)
        self.count = most if self._grid is None else ways * len(corners)

    @property
    def asks_physics(self) -> bool:
        """Whether an action is legal only if the pallet stands after the action."""
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
            rows: (m,) rows of the table.
            episodes: (m,) for each row, the episode on whose pallets the boxes are placed. If ``episodes`` is None,
                each row belongs to the episode of the same number.
            size_mm: (m, k, 3) sizes of the visible boxes.
            mass_kg: (m, k) masses of the boxes, 0 if there is no box.
            upright: (m, k, 3) whether each size may be vertical.
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
            least_support=SUPPORT_CRITERIA.get(self._options.mask, 0.0),
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
        """(b, s) which of s orientations each of b boxes may have. If a box has the same extents in two orientations,
        only the first of the two is allowed."""
        sizes = size_mm[:, self._sides]
        may = np.ones(sizes.shape[:2], bool)
        if self._options.sides != ALL:
            may &= upright[:, self._sides[:, 2]]
        for side in range(1, len(self._sides)):
            is_same = (sizes[:, :side] == sizes[:, side, None]).all(axis=2)
            may[:, side] &= ~(is_same & may[:, :side]).any(axis=1)
        return may

    def _overloads(self, pallets: NDArray[np.int64], force_n: FloatArray) -> NDArray[np.bool_]:
        """(c,) for each candidate, whether a box on the pallet would bear more than its strength. ``force_n`` (c, k) is
        the force on the top of each box, N. The last of the k boxes is the candidate itself, on which nothing lies."""
        return np.asarray((force_n > self.strength_n[pallets, : force_n.shape[1]]).any(axis=1))

    def _geometric(self, places: Places) -> NDArray[np.bool_]:
        """(c,) whether each place is legal according to geometry. If the mask uses physics, legal places are later
        tested by simulations."""
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
        """Two arrays (c,): the row of each place's episode, and the number of the place's action. If the number is
        ``count`` or more, the place has no action. If actions are candidates, they are numbered box by box. The places
        of a box are sorted by height, the lowest first, then by x, then by y. If actions are cells, they are numbered
        by pallet, box, orientation and cell."""
        source = places.row[chosen]
        row = at[source]
        if self._grid is not None:
            x, y = np.rint(places.corner_mm[chosen, :2] / self._options.action_cell_mm).astype(np.int64).T
            nx, ny = self._cells
            way = (pallet[source] * self._options.buffer + box[source]) * len(self._sides) + side[source]
            return row, (way * nx + x) * ny + y
        corner = places.corner_mm[chosen]
        box_number = row * self._options.buffer + box[source]
        order = np.lexsort((corner[:, 1], corner[:, 0], corner[:, 2], box_number))
        number = np.full(len(row), self.count)
        selected = order[_in_turn(row[order], box_number[order], self.count)]
        number[selected] = ranks(row[selected])
        return row, number


def _in_turn(row: NDArray[np.intp], seen: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Choose at most ``most`` places for each episode: first the best place of each box, then the second-best place of
    each box, and so on. If a box has only few places, more places of the other boxes are chosen.

    Args:
        row: (c,) episode of each place, in ascending order.
        seen: (c,) number of the box of each place, in ascending order. Boxes of different episodes have different
            numbers. The places of a box are sorted, with the best place first.

    Returns:
        Indices of the chosen places, in ascending order.
    """
    is_chosen = np.bincount(row)[row] <= most
    many = np.flatnonzero(~is_chosen)
    turn = many[np.lexsort((seen[many], ranks(seen[many]), row[many]))]
    is_chosen[turn[ranks(row[turn]) < most]] = True
    return np.flatnonzero(is_chosen)


def ranks(of: NDArray[np.intp]) -> NDArray[np.int64]:
    """For each entry of an array, the position (0, 1, 2, …) of the entry within the group of entries with the same
    value. Entries with the same value must be adjacent."""
    first = np.flatnonzero(np.diff(of, prepend=-1))
    return np.arange(len(of)) - np.repeat(first, np.diff(first, append=len(of)))
