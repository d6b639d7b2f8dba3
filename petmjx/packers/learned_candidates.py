"""Candidates of the packer ``learned``: extreme points seen from all four corners of the target.

At an extreme point (Crainic, Perboli, Tadei 2008), a box touches its neighbours on the sides that face the origin. If
only extreme points seen from one corner were used, the pile would grow from this corner and leave narrow free strips
along the opposite edges of the target. In this module, the pile is also mirrored, so that there are extreme points for
the three other corners as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.packers.baseline_packer import MAX_HEIGHT_MM
from petmjx.packers.candidate_points import Candidates, corner_points, let_down, overlap
from petmjx.packers.height_map import HeightMap
from petmjx.packers.item_stream import ItemStream, Places
from petmjx.packers.packing_state import NextCandidate
from petmjx.packers.pile_balance import SHARE_SLACK, TOUCH_MM
from petmjx.plans.order import Item

LEAST_SUPPORT: Final = 0.2
"""Smallest supported share of a base. This share can be low, because a box is placed only where the pile stays in
static balance, and where a network predicts that the box is likely to stand."""

COARSE_MM: Final = 50.0

OVERHANG_MM: Final = 40.0
"""Cost of a base without any support, as mm of additional height. The cost of a partly supported base is proportional
to its unsupported share."""

MIRRORS: Final = ((False, False), (True, False), (False, True), (True, True))
"""For each corner of the target, whether x, and whether y, is mirrored."""

_DECIMALS: Final = 9
"""Number of decimals to which corners and costs in mm are rounded, because the last digits of a sum depend on the
sequence in which numbers are added."""


class MirroredCandidates(Candidates):
    """The table of candidates for ``Packing``, at the corner points of the pile as seen from all four corners of the
    target.

    Unlike ``Candidates``, this table does not store candidates: the method ``candidates`` computes candidates on
    request.

    Attributes:
        corners: (c, 2) lowest corners (x, y) of the candidates that the last call of ``candidates`` returned, mm.
        rests: (c,) heights of these candidates' bottoms, mm.
    """

    def __init__(self, base: FloatArray, height: FloatArray, extent_mm: tuple[float, float], most_boxes: int) -> None:
        super().__init__(base, height, extent_mm, most_boxes)
        self.corners, self.rests = np.zeros((0, 2)), np.zeros(0)
        # ``_lows``, ``_highs``: corners of the boxes in each mirror image. ``_points``: the corner points of all mirror
        # images. ``_in``: for each point, whether x and y are mirrored in the mirror image to which the point belongs.
        self._lows, self._highs = np.zeros((2, len(MIRRORS), most_boxes, 3))
        self._points = np.zeros((len(MIRRORS), 2))
        self._in = np.array(MIRRORS)

    def copy(self) -> Self:
        """An independent copy of the table."""
        twin = super().copy()
        twin._lows, twin._highs = self._lows.copy(), self._highs.copy()
        return twin

    def candidates(self, shapes: NDArray[np.intp]) -> tuple[NDArray[np.intp], FloatArray, FloatArray, FloatArray]:
        """The c candidates for boxes of the given shapes (kinds of boxes in one orientation).

        Returns:
            (c,) numbers of the shapes; (c, 2) lowest corners (x, y), mm; (c,) heights of the bottoms, mm; (c,)
            supported shares of the bases.
        """
        extent, (low, high) = np.array(self.extent_mm), self.placed
        parts = []
        for shape in shapes.tolist():
            base = self.base[shape]
            at = np.round(np.where(self._in, extent - self._points - base, self._points), _DECIMALS) + 0.0
            at = at[((at >= 0) & (at + base <= extent + TOUCH_MM)).all(axis=1)]
            once = np.unique(at[:, 0] + 1j * at[:, 1])
            corner = np.stack([once.real, once.imag], axis=1)
            area = overlap(corner, base[None], low[:, :2], high[:, :2])[:, 0]
            z, carried = let_down(area, high[:, 2])
            parts.append((np.full(len(z), shape), corner, z, np.where(z > 0, carried / self.area[shape], 1.0)))
        arrays_of_parts: list[Any] = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
        shape, self.corners, self.rests, support = arrays_of_parts
        return shape, self.corners, self.rests, support

    def keep_shapes(self, kept: NDArray[np.bool_]) -> None:
        """Remove all shapes except the shapes chosen by the mask ``kept``, (s,)."""
        self.base, self.height, self.area = self.base[kept], self.height[kept], self.area[kept]

    def place(self, point: int, shape: int) -> None:
        """Place a box of shape ``shape`` at candidate ``point`` of the last call of ``candidates``."""
        (x, y), z = self.corners[point].tolist(), float(self.rests[point])
        (length, width), height = self.base[shape].tolist(), float(self.height[shape])
        low, high, n = np.array([x, y, z]), np.array([x + length, y + width, z + height]), self._n
        self._low[n], self._high[n] = low, high
        mirrored, extent = np.array(MIRRORS), np.array(self.extent_mm)
        self._lows[:, n], self._highs[:, n] = low, high
        self._lows[:, n, :2] = np.where(mirrored, extent - high[:2], low[:2])
        self._highs[:, n, :2] = np.where(mirrored, extent - low[:2], high[:2])
        self._n += 1
        self._add_corners()

    def _add_corners(self) -> None:
        """Add the corner points of the newest box, in each mirror image of the pile."""
        points = corner_points(self._lows[:, : self._n], self._highs[:, : self._n])
        inside = (points < np.array(self.extent_mm)).all(axis=2)
        self._points = np.concatenate([self._points, points[inside]])
        self._in = np.concatenate([self._in, np.broadcast_to(np.array(MIRRORS), points.shape)[inside]])


class FourSidedStream(ItemStream):
    """A stream of boxes. At a candidate place, a box may touch other boxes with any of its four sides.

    Attributes:
        coarse: height map of the pile with cells of ``COARSE_MM``.
    """

    _Table = MirroredCandidates
    _table: MirroredCandidates

    def __init__(
        self, items: Sequence[Item], extent_mm: tuple[float, float], clearance_mm: float = 0.0, look_ahead: int = 1
    ) -> None:
        super().__init__(items, extent_mm, clearance_mm, look_ahead)
        self.coarse = HeightMap(self.extent_mm, COARSE_MM)
        self._refused: set[int] = set()

    def copy(self) -> Self:
        """An independent copy of the stream."""
        twin = super().copy()
        twin.coarse, twin._refused = self.coarse.copy(), set(self._refused)
        return twin

    def places(self, least_support: float = LEAST_SUPPORT) -> Places:
        """The candidates for the boxes that the packer sees. A candidate is left out if it has too little support, is
        too high, or was refused by ``keeps_balance`` before.

        Whether the pile keeps its balance with a candidate is checked later, by ``keeps_balance``.

        Args:
            least_support: smallest allowed supported share of a base.
        """
        table, kinds = self._table, set(self.seen)
        visible_columns = np.array(
            [column for column, kind in enumerate(self._kind_of.tolist()) if kind in kinds], np.intp
        )
        shape, corner, z, support = table.candidates(visible_columns)
        fits = (z + table.height[shape] <= MAX_HEIGHT_MM + TOUCH_MM) & (support >= least_support - SHARE_SLACK)
        fits[list(self._refused)] = False
        rows = np.flatnonzero(fits)
        shape = shape[rows]
        return Places(
            rows,
            shape,
            self._kind_of[shape],
            np.concatenate([corner[rows], z[rows, None]], axis=1),
            np.concatenate([table.base[shape], table.height[shape, None]], axis=1),
            self._weight[shape],
            support[rows],
            self._base[shape].prod(axis=1),
        )

    def keeps_balance(self, places: Places, row: int) -> NextCandidate | None:
        """The candidate in a row of ``places``, or None if a box would lose its balance with this candidate."""
        point, shape = int(places.point[row]), int(places.shape[row])
        x, y, z = places.corner_mm[row].tolist()
        length, width = self._base[shape].tolist()
        rest = self._pile.rest((x, y, z), (length, width), float(places.mass_kg[row]))
        if rest is None:
            self._refused.add(point)
            return None
        return NextCandidate(point, shape, (x, y, z), rest)

    def still_open(self, places: Places) -> NDArray[np.bool_]:
        """(c,) whether each candidate is still possible. A candidate is possible until ``keeps_balance`` refuses it."""
        return np.array([point not in self._refused for point in places.point.tolist()], dtype=bool)

    def put(self, chosen: NextCandidate) -> None:
        """Place the box of a candidate."""
        super().put(chosen)
        low, high = self.boxes
        self.coarse.put(low[-1], high[-1])
        self._refused.clear()

    def skip(self) -> None:
        """Leave out the next box."""
        super().skip()
        self._refused.clear()


def cost_mm(stream: ItemStream, places: Places) -> FloatArray:
    """(c,) cost of candidates, mm: height of the bottom + cost of the overhang + cost of the distance from the nearest
    edges of the target."""
    start, size = places.corner_mm[:, :2], places.size_mm[:, :2]
    aside = np.minimum(start, np.array(stream.extent_mm) - start - size).sum(axis=1)
    cost: FloatArray = places.corner_mm[:, 2] + OVERHANG_MM * (1 - places.support) + 0.01 * aside
    return np.round(cost, _DECIMALS)


def lowest_first(stream: FourSidedStream) -> NextCandidate | None:
    """Choose the candidate of least cost with which the pile keeps its balance, as a simple packer does in each step.
    The result is None if there is no candidate.

    The value of a candidate's box (``ItemStream.worth``), in mm of height, is subtracted from the cost of the
    candidate, mm. This subtraction makes a difference only if the packer sees several boxes.
    """
    places = stream.places()
    cost = cost_mm(stream, places) - stream.worth(places)
    for row in np.argsort(cost, kind="stable").tolist():
        if (candidate := stream.keeps_balance(places, row)) is not None:
            return candidate
    return None
