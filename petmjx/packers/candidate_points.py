"""Candidates for the next box of a pile (``Candidates``): each shape of box at each corner point of the pile.

A shape is a kind of box in one orientation. The corner points are the extreme points of Crainic, Perboli, Tadei (2008),
as in :mod:`petmjx.packers.baseline_packer`. When a box is placed, the table of candidates is not computed anew, but
updated: the new box is compared with all candidates, and the few new points are compared with all boxes.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.packers.fill_interface import Count
from petmjx.packers.pile_balance import TOUCH_MM

_SLIDING = np.array([1, 0, 0, 1])
_OTHER = 1 - _SLIDING
"""For each of the four points that slide (see ``corner_points``): the axis along which the point slides, and the other
horizontal axis. Axis 0 is x, axis 1 is y."""


class Candidates:
    """The table of candidates: s shapes at p corner points.

    Attributes:
        points: (p, 2) corner points (x, y), mm. All candidates at a point have their lowest x and y at this point.
        base: (s, 2) sides of the shapes along x and y, mm.
        area: (s,) areas of the shapes' bases, mm².
        height: (s,) heights of the shapes, mm.
        z: (p, s) height of each candidate's bottom at rest, mm.
        carried: (p, s) supported area of each candidate's base, mm².
        open: (p, s) whether each candidate can be chosen. A candidate must be inside the carrier's edges. A candidate
            that was refused because it would tip cannot be chosen until another box is placed under it.
    """

    def __init__(self, base: FloatArray, height: FloatArray, extent_mm: tuple[float, float], most_boxes: int) -> None:
        self.base, self.height, self.area = base, height, base.prod(axis=1)
        self.extent_mm = extent_mm
        self.points = np.zeros((0, 2))
        self.z = np.zeros((0, len(height)))
        self.carried = np.zeros((0, len(height)))
        self.open: NDArray[np.bool_] = np.zeros((0, len(height)), dtype=bool)
        self._inside = self.open
        self._low = np.zeros((most_boxes, 3))
        self._high = np.zeros((most_boxes, 3))
        self._n = 0
        self._known: set[tuple[float, float]] = set()
        self._add_points([(0.0, 0.0)])

    def copy(self) -> Self:
        """An independent copy of the table."""
        twin = copy.copy(self)
        # these are changed in place; all other arrays are only replaced by new arrays, so the two tables may share them
        twin.open, twin._known = self.open.copy(), set(self._known)
        twin._low, twin._high = _copied_rows(self._low, self._n), _copied_rows(self._high, self._n)
        return twin

    def write(self, tables: Mapping[str, NDArray[Any]]) -> None:
        """Copy the table into arrays with the layout of :mod:`petmjx.packers.fill_interface`."""
        points, shapes = self.z.shape
        tables["counts"][Count.BOXES], tables["counts"][Count.POINTS] = self._n, points
        tables["base"][:shapes], tables["area"][:shapes], tables["height"][:shapes] = self.base, self.area, self.height
        tables["points"][:points] = self.points
        for name, values in {"z": self.z, "carried": self.carried, "open": self.open, "inside": self._inside}.items():
            tables[name][:points, :shapes] = values
        tables["low"][: self._n], tables["high"][: self._n] = self.placed

    @property
    def placed(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3) lowest and (n, 3) highest corners of the boxes placed so far, mm."""
        return self._low[: self._n], self._high[: self._n]

    def keep_shapes(self, kept: NDArray[np.bool_]) -> None:
        """Remove all shapes except the shapes chosen by the mask ``kept``, (s,)."""
        self.base, self.height, self.area = self.base[kept], self.height[kept], self.area[kept]
        self.z, self.carried = self.z[:, kept], self.carried[:, kept]
        self.open, self._inside = self.open[:, kept], self._inside[:, kept]

    def place(self, point: int, shape: int) -> None:
        """Place a box of shape ``shape`` at corner point ``point``, and update the table."""
        (x, y), z = self.points[point].tolist(), float(self.z[point, shape])
        (width, depth), height = self.base[shape].tolist(), float(self.height[shape])
        ends = (x + width, y + depth, z + height)
        self._low[self._n], self._high[self._n] = (x, y, z), ends
        self._n += 1
        self._cover((x, y), ends)
        points = corner_points(self._low[None, : self._n], self._high[None, : self._n])
        self._add_points([(x, y) for x, y in points[:, 0].tolist()])

    def _cover(self, corner: tuple[float, float], ends: tuple[float, float, float]) -> None:
        """Update the candidates whose base is over the newest box, unless the base is also over a higher box."""
        area = overlap(self.points, self.base, np.array([corner]), np.array([ends[:2]]))[:, :, 0]
        hit, top = area > 0, ends[2]
        higher = hit & (top > self.z + TOUCH_MM)
        level = hit & ~higher & (top >= self.z - TOUCH_MM)
        self.carried = np.where(higher, area, np.where(level, self.carried + area, self.carried))
        self.z = np.where(higher, top, self.z)
        self.open |= (higher | level) & self._inside

    def _add_points(self, corners: Sequence[tuple[float, float]]) -> None:
        """Add new corner points. A point is added only if at least one shape at this point is inside the carrier's
        edges."""
        fresh = [point for point in dict.fromkeys(corners) if point not in self._known]
        self._known.update(fresh)
        points = np.array(fresh, dtype=np.float64).reshape(-1, 2)
        fits = points[:, None] + self.base <= np.array(self.extent_mm) + TOUCH_MM
        inside: NDArray[np.bool_] = np.logical_and(fits[:, :, 0], fits[:, :, 1])
        useful = inside.any(axis=1)
        if not useful.any():
            return
        points, inside = points[useful], inside[useful]
        area = overlap(points, self.base, self._low[: self._n, :2], self._high[: self._n, :2])
        z, carried = let_down(area, self._high[: self._n, 2])
        self.points = np.concatenate([self.points, points])
        self.z = np.concatenate([self.z, z])
        self.carried = np.concatenate([self.carried, np.where(z > 0, carried, self.area)])
        self.open = np.concatenate([self.open, inside])
        self._inside = np.concatenate([self._inside, inside])


def _copied_rows(rows: FloatArray, n: int) -> FloatArray:
    """A copy of the first n rows, in an array of the same size."""
    twin = np.empty_like(rows)
    twin[:n] = rows[:n]
    return twin


def corner_points(low: FloatArray, high: FloatArray) -> FloatArray:
    """(7, m, 2) corner points (x, y) that the newest box adds to each of m piles, mm.

    Let the newest box extend from (x, y, z) to (x_end, y_end, top). Three points are the corners (x_end, y), (x, y_end)
    and (x, y) of this box. The other four points are found by sliding. A point starts at one of these corners, and
    moves towards x = 0 or y = 0 until it meets another box or the carrier's edge. At the height z, one point slides
    from (x_end, y) towards y = 0, and one from (x, y_end) towards x = 0. At the height ``top``, two points slide from
    (x, y).

    Args:
        low, high: (m, n, 3) lowest and highest corners of the boxes of each pile, mm. The newest box is the last.
    """
    (x, y, z), (x_end, y_end, top) = low[:, -1].T, high[:, -1].T
    start, across = np.array([y, x, x, y]), np.array([x_end, y_end, y, x])
    south, west, west_on_top, south_on_top = _slid(low, high, start, across, np.array([z, z, top, top]))
    beside = [(x_end, y), (x_end, south), (x, y_end), (west, y_end)]
    return np.array([*beside, (x, y), (west_on_top, y), (x, south_on_top)]).swapaxes(1, 2)


def _slid(low: FloatArray, high: FloatArray, start: FloatArray, across: FloatArray, level: FloatArray) -> FloatArray:
    """(4, m) coordinates, mm, at which the four sliding points of each of m piles meet a box, or 0 (the carrier's
    edge). The points slide along −y, −x, −x and −y.

    Args:
        low, high: (m, n, 3) lowest and highest corners of the boxes of each pile, mm.
        start: (4, m) coordinates of the points along the axis on which they slide, mm.
        across: (4, m) coordinates of the points along the other horizontal axis, mm.
        level: (4, m) heights of the points, mm.
    """
    low, high = low.transpose(2, 0, 1), high.transpose(2, 0, 1)
    across, level = across[..., None], level[..., None]
    in_way = (low[_OTHER] <= across) & (across < high[_OTHER]) & (low[2] <= level) & (level < high[2])
    ends = high[_SLIDING]
    reached: FloatArray = np.where(in_way & (ends <= start[..., None] + TOUCH_MM), ends, 0.0).max(axis=2)
    return reached


def let_down(area: FloatArray, tops: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(…) heights of the bottoms of boxes that rest on n placed boxes, mm, and (…) supported areas of their bases, mm².

    Args:
        area: (…, n) area of the overlap of each box with each placed box, seen from above, mm².
        tops: (n,) heights of the placed boxes' tops, mm.
    """
    z = np.where(area > 0, tops, 0.0).max(axis=-1, initial=0.0)
    carried: FloatArray = np.where(np.abs(tops - z[..., None]) <= TOUCH_MM, area, 0.0).sum(axis=-1)
    return z, carried


def overlap(points: FloatArray, base: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """(p, s, n) area of the overlap of s shapes at p points with n boxes, seen from above, mm².

    Args:
        points: (p, 2) corner points (x, y), mm.
        base: (s, 2) sides of the shapes along x and y, mm.
        low, high: (n, 2) lowest and highest corners (x, y) of the boxes, mm.
    """
    sides = []
    for axis in (0, 1):
        start = points[:, None, axis]
        end = np.minimum((start + base[:, axis])[:, :, None], high[:, axis])
        sides.append(end - np.maximum(start, low[:, axis])[:, None])
    x, y = sides
    area: FloatArray = np.where((x > TOUCH_MM) & (y > TOUCH_MM), x * y, 0.0)
    return area
