"""The packer ``baseline``, which puts each box at the lowest extreme point of the pile at which the box's base is
sufficiently supported.

The extreme points are as in Crainic, Perboli, Tadei (2008), "Extreme point-based heuristics for three-dimensional
bin packing", INFORMS Journal on Computing 20(3), 368–384. At the x and y of an extreme point, a box is lowered until it
rests on the carrier or on boxes. So every box can be placed from above, in packing order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.packers.candidate_points import corner_points, let_down
from petmjx.packers.pile_balance import SHARE_SLACK, TOUCH_MM
from petmjx.plans.order import Item

MAX_HEIGHT_MM = 2000.0
ATTEMPTS = 3


@dataclass(frozen=True)
class PackRules:
    """The rules of the packer ``baseline``. Different plans may be packed with different rules.

    Attributes:
        min_support: smallest share of a box's base that must rest on the carrier or on other boxes (0 to 1).
        centre_supported: whether the centre of the base must be inside the convex hull of the contact areas under the
            base. If the centre is not supported, a box may tip as soon as it is placed.
        max_height_mm: greatest allowed height of a box's top, mm.
        y_first: which of several equally low places is chosen. If ``y_first`` is True, it is the place with the
            smallest y, and then with the smallest x. If ``y_first`` is False, it is the place with the smallest x, and
            then with the smallest y.
        sort_noise: standard deviation of the random number that is added to the sorting key, one number per article.
            The sorting key is the natural logarithm of base area × weight ** ``weight_exponent``.
        weight_exponent: exponent of the weight in the sorting key.
    """

    min_support: float = 0.75
    centre_supported: bool = True
    max_height_mm: float = MAX_HEIGHT_MM
    y_first: bool = True
    sort_noise: float = 0.15
    weight_exponent: float = 0.3


@dataclass(frozen=True)
class PlacedBox:
    """A box at its place. If ``orientation`` is 1, length and width are swapped. ``corner_mm`` is the front-left-bottom
    corner of the box."""

    item: Item
    orientation: int
    corner_mm: tuple[float, float, float]


def pack_best(
    items: Sequence[Item], extent_mm: tuple[float, float], rules: PackRules, rng: np.random.Generator
) -> list[PlacedBox]:
    """The best of up to ``ATTEMPTS`` packings, that is, the packing with the most boxes. For each packing, the boxes
    are sorted with other random numbers."""
    best: list[PlacedBox] = []
    for _ in range(ATTEMPTS):
        placed = pack(items, extent_mm, rules, rng)
        if len(placed) > len(best):
            best = placed
        if len(best) == len(items):
            break
    return best


def pack(
    items: Sequence[Item],
    extent_mm: tuple[float, float],
    rules: PackRules,
    rng: np.random.Generator,
    *,
    as_they_come: bool = False,
) -> list[PlacedBox]:
    """Place the items on a target of length and width ``extent_mm``. Returns the placed boxes in packing order. Items
    for which there is no place are left out.

    Args:
        items: the items.
        extent_mm: length (along x) and width (along y) of the target, mm.
        rules: the rules.
        rng: random numbers for the sorting of items.
        as_they_come: whether to place the items in the given order, instead of sorting them by base area and weight.
    """
    pile = _Pile(len(items), extent_mm, rules)
    placed = []
    for item in items if as_they_come else _sorted_items(items, rules, rng):
        place = pile.find(item)
        if place is not None:
            orientation, corner = place
            pile.add(_base(item, orientation), item.height_mm, corner)
            placed.append(PlacedBox(item, orientation, corner))
    return placed


def _sorted_items(items: Sequence[Item], rules: PackRules, rng: np.random.Generator) -> list[Item]:
    """The items, sorted so that large and heavy boxes come first. All items of an article get the same random number,
    so equal boxes stay together."""
    key: dict[str, float] = {}
    for item in items:
        if item.item_id not in key:
            base = item.length_mm * item.width_mm
            noise = rules.sort_noise * float(rng.standard_normal())
            key[item.item_id] = float(np.log(base) + rules.weight_exponent * np.log(item.weight_kg) + noise)
    return sorted(items, key=lambda item: (-key[item.item_id], item.item_id))


def _base(item: Item, orientation: int) -> tuple[float, float]:
    return (item.length_mm, item.width_mm) if orientation == 0 else (item.width_mm, item.length_mm)


class _Pile:
    """The boxes placed so far, and their extreme points (x and y in mm)."""

    def __init__(self, capacity: int, extent_mm: tuple[float, float], rules: PackRules) -> None:
        self.extent_mm = extent_mm
        self.rules = rules
        self.n = 0
        self._low = np.zeros((capacity, 3))
        self._high = np.zeros((capacity, 3))
        self._points: dict[tuple[float, float], None] = {(0.0, 0.0): None}

    def find(self, item: Item) -> tuple[int, tuple[float, float, float]] | None:
        """The best place for an item: orientation, and front-left-bottom corner in mm. The result is None if there is
        no place for the item."""
        points = np.array(list(self._points))
        allowed_orientations = (0, 1) if item.length_mm != item.width_mm else (0,)
        corners = np.concatenate([points] * len(allowed_orientations))
        orientations = np.repeat(allowed_orientations, len(points))
        bases = np.array([_base(item, o) for o in allowed_orientations])[orientations]
        inside = (corners + bases <= np.array(self.extent_mm) + TOUCH_MM).all(axis=1)
        corners, bases, orientations = corners[inside], bases[inside], orientations[inside]

        z, share = self._rest(corners, bases)
        least_share, y_first = self.rules.min_support - SHARE_SLACK, self.rules.y_first
        legal = (z + item.height_mm <= self.rules.max_height_mm + TOUCH_MM) & (share >= least_share)
        minor, major = (corners[:, 0], corners[:, 1]) if y_first else (corners[:, 1], corners[:, 0])
        for i in np.lexsort((orientations, minor, major, z)):
            if legal[i] and (not self.rules.centre_supported or self._centre_supported(corners[i], bases[i], z[i])):
                return int(orientations[i]), (float(corners[i, 0]), float(corners[i, 1]), float(z[i]))
        return None

    def add(self, base_mm: tuple[float, float], height_mm: float, corner_mm: tuple[float, float, float]) -> None:
        """Place a box and record its extreme points."""
        self._low[self.n] = corner_mm
        self._high[self.n] = self._low[self.n] + np.array([*base_mm, height_mm])
        self.n += 1
        points = corner_points(self._low[None, : self.n], self._high[None, : self.n])
        self._points |= dict.fromkeys((x, y) for x, y in points[:, 0].tolist())

    def _rest(self, corners: FloatArray, bases: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(c,) height z of the bottom of each box after the box has been lowered, mm, and (c,) supported share of each
        box's base.

        Args:
            corners, bases: (c, 2) lowest x and y of the boxes, and (c, 2) sides of their bases along x and y, mm.
        """
        z, carried = let_down(self._overlap(corners, bases), self._high[: self.n, 2])
        share: FloatArray = np.where(z > 0, carried / bases.prod(axis=1), 1.0)
        return z, share

    def _overlap(self, corners: FloatArray, bases: FloatArray) -> FloatArray:
        """(c, n) area of the overlap of each base with each placed box, seen from above, mm²."""
        low, high = self._low[: self.n], self._high[: self.n]
        ends = corners + bases
        x = np.minimum(ends[:, :1], high[:, 0]) - np.maximum(corners[:, :1], low[:, 0])
        y = np.minimum(ends[:, 1:], high[:, 1]) - np.maximum(corners[:, 1:], low[:, 1])
        area: FloatArray = np.where((x > TOUCH_MM) & (y > TOUCH_MM), x * y, 0.0)
        return area

    def _centre_supported(self, corner: FloatArray, base: FloatArray, z: float) -> bool:
        """Whether the centre of a base is inside the convex hull of the base's contact areas."""
        if z <= 0:
            return True
        under = (self._overlap(corner[None], base[None])[0] > 0) & (np.abs(self._high[: self.n, 2] - z) <= TOUCH_MM)
        low = np.maximum(self._low[: self.n, :2][under], corner)
        high = np.minimum(self._high[: self.n, :2][under], corner + base)
        return in_hull_of_rectangles(corner + base / 2, low, high)


def in_hull_of_rectangles(point: FloatArray, low: FloatArray, high: FloatArray) -> bool:
    """Whether a (2,) point lies in the convex hull of n rectangles with the (n, 2) lowest and (n, 2) highest corners.

    The point is outside if all corners of the rectangles are on one side of a line through the point. If the point is
    outside, the directions from the point to the corners leave a gap of more than 180°.
    """
    corners = np.concatenate([low, high, np.c_[low[:, 0], high[:, 1]], np.c_[high[:, 0], low[:, 1]]]) - point
    if not len(corners):
        return False
    angles = np.sort(np.arctan2(corners[:, 1], corners[:, 0]))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    return bool(gaps.max() <= np.pi + 1e-9)
