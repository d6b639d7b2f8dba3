"""Which boxes of a plan lie on which, and on which rectangles; which touch side by side."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.history import CARRIER
from petmjx.plans.overlap import meets, shared
from petmjx.plans.plan import Plan
from petmjx.plans.warnings import DEFAULT_TOLERANCE_MM

IntArray = NDArray[np.int64]

N_CORNERS: Final = 4
"""Of a box's base."""


@dataclass(frozen=True, eq=False)
class PlanContacts:
    """The contacts of one plan: c rectangles on which a box lies, in the order of the boxes above.

    A box lies on the carrier if its bottom is not above the carrier's top. It lies there with its whole base, since
    the carrier is taken to reach under all boxes. On a carrier made of boards it lies on those boards of the deck that
    it overlaps along x and y; each is an area of its own. It lies on another box if that one was placed before, its
    top is at the height of
    the bottom, and the two overlap along x and y. A box that is pushed in under another one later bears nothing:
    what hangs in the air until then has fallen.

    Attributes:
        size_mm, corner_mm: (n, 3) of the boxes, as in the plan.
        mass_kg: (n,).
        upper: (c,) the box above.
        lower: (c,) the box below, placed earlier, or ``CARRIER``.
        low_mm, high_mm: (c, 2) corners of the rectangle along x and y.
        under_low_mm, under_high_mm: (c, 2) corners of all of what bears there: the top of the box below, a deck board.
        tolerance_mm: gaps and overlaps up to this count as touching.
        mass_center_mm: (n, 3) as in ``Plan``.
    """

    size_mm: FloatArray
    corner_mm: FloatArray
    mass_kg: FloatArray
    upper: IntArray
    lower: IntArray
    low_mm: FloatArray
    high_mm: FloatArray
    under_low_mm: FloatArray
    under_high_mm: FloatArray
    tolerance_mm: float
    mass_center_mm: FloatArray | None = None

    @property
    def n_boxes(self) -> int:
        return len(self.mass_kg)

    @cached_property
    def centre_mm(self) -> FloatArray:
        """(n, 3) centres of gravity: in the middles, unless the plan has others."""
        centre: FloatArray = self.corner_mm + self.size_mm / 2
        return centre if self.mass_center_mm is None else centre + self.mass_center_mm

    @cached_property
    def corners_mm(self) -> FloatArray:
        """(c, 4, 2) corners of the rectangles, counter-clockwise."""
        return rectangle_corners(self.low_mm, self.high_mm)

    @cached_property
    def n_supports(self) -> IntArray:
        """(n,) on how many areas each box lies: one a box below, and of the carrier one or one a board."""
        return np.bincount(self.upper, minlength=self.n_boxes)

    @cached_property
    def grounded(self) -> NDArray[np.bool_]:
        """(n,) whether a box lies on the carrier with all four corners, so that nothing tips it."""
        n_corners: IntArray = self.borne_corners(self.lower == CARRIER).sum(axis=1)
        on_carrier: NDArray[np.bool_] = np.equal(n_corners, N_CORNERS)
        return on_carrier

    def borne_corners(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(n, 4) whether a bottom corner lies on something, within the tolerance; edges count.

        Args:
            chosen: (c,) which contacts are looked at.
        """
        base = self.corner_mm[:, :2]
        corners = rectangle_corners(base, base + self.size_mm[:, :2])[self.upper[chosen]]
        near = self.under_low_mm[chosen] - self.tolerance_mm
        far = self.under_high_mm[chosen] + self.tolerance_mm
        inside = ((corners >= near[:, None]) & (corners <= far[:, None])).all(axis=-1)
        borne = np.zeros((self.n_boxes, N_CORNERS), dtype=bool)
        np.logical_or.at(borne, self.upper[chosen], inside)
        return borne


@dataclass(frozen=True, eq=False)
class Sides:
    """Where boxes touch side by side: s rectangles, each upright.

    Attributes:
        first, second: (s,) the boxes; the second is on the positive side along the axis.
        axis: (s,) 0 for x, 1 for y.
        low_mm, high_mm: (s, 3) corners of the rectangle, which has no extent along its axis.
    """

    first: IntArray
    second: IntArray
    axis: IntArray
    low_mm: FloatArray
    high_mm: FloatArray


def rectangle_corners(low: FloatArray, high: FloatArray) -> FloatArray:
    """(…, 4, 2) corners of rectangles from (…, 2) low and high ones, counter-clockwise."""
    x0, y0, x1, y1 = low[..., 0], low[..., 1], high[..., 0], high[..., 1]
    corners: FloatArray = np.stack(
        [np.stack([x0, y0], -1), np.stack([x1, y0], -1), np.stack([x1, y1], -1), np.stack([x0, y1], -1)], axis=-2
    )
    return corners


def find_contacts(
    plan: Plan, tolerance_mm: float = DEFAULT_TOLERANCE_MM, deck_mm: FloatArray | None = None
) -> PlanContacts:
    """What the boxes of a plan lie on.

    Args:
        tolerance_mm: gaps and overlaps in height up to this count as touching, and contacts that are narrower than this
            do not count. By default that of the warnings about a plan: half of the last digit of whole millimetres.
        deck_mm: (b, 2, 2) lowest and highest corner along x and y of each board of the carrier's deck; None: the
            carrier reaches under all boxes.
    """
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    below, above = np.nonzero(_rests(low, high, tolerance_mm))
    on_carrier = np.flatnonzero(low[:, 2] <= tolerance_mm)
    carrier_low, carrier_high = low[on_carrier, :2], high[on_carrier, :2]
    if deck_mm is not None:
        lying, board = np.nonzero(_overlap(carrier_low, carrier_high, deck_mm, tolerance_mm))
        on_carrier, carrier_low, carrier_high = on_carrier[lying], deck_mm[board, 0], deck_mm[board, 1]
    upper = np.concatenate([on_carrier, above])
    lower = np.concatenate([np.full(len(on_carrier), CARRIER), below])
    under_low = np.concatenate([carrier_low, low[below, :2]])
    under_high = np.concatenate([carrier_high, high[below, :2]])
    order = np.lexsort((lower, upper))
    upper, lower, under_low, under_high = upper[order], lower[order], under_low[order], under_high[order]
    return PlanContacts(
        size_mm=plan.size_mm,
        corner_mm=plan.corner_mm,
        mass_kg=plan.mass_kg,
        upper=upper,
        lower=lower,
        low_mm=np.maximum(low[upper, :2], under_low),
        high_mm=np.minimum(high[upper, :2], under_high),
        under_low_mm=under_low,
        under_high_mm=under_high,
        tolerance_mm=tolerance_mm,
        mass_center_mm=plan.mass_center_mm,
    )


def _overlap(low: FloatArray, high: FloatArray, deck_mm: FloatArray, tolerance_mm: float) -> NDArray[np.bool_]:
    """(k, b): whether rectangles share more than the tolerance with boards along x and y."""
    shares = np.minimum(high[:, None], deck_mm[:, 1]) - np.maximum(low[:, None], deck_mm[:, 0]) > tolerance_mm
    return shares[..., 0] & shares[..., 1]


def _rests(low: FloatArray, high: FloatArray, tolerance_mm: float) -> NDArray[np.bool_]:
    """(n, n): whether the box of the column lies on that of the row."""
    touching = meets(low[:, 2], high[:, 2], tolerance_mm)
    for axis in range(2):
        touching &= shared(low[:, axis], high[:, axis]) > tolerance_mm
    return np.triu(touching, k=1)


def find_sides(contacts: PlanContacts) -> Sides:
    """Where the boxes of a plan touch side by side."""
    low, high = contacts.corner_mm, contacts.corner_mm + contacts.size_mm
    tolerance_mm = contacts.tolerance_mm
    pairs_by_axis = []
    for axis in range(2):
        touching = meets(low[:, axis], high[:, axis], tolerance_mm)
        for across in (1 - axis, 2):
            touching &= shared(low[:, across], high[:, across]) > tolerance_mm
        first, second = np.nonzero(touching)
        pairs_by_axis.append((first, second, np.full(len(first), axis)))
    first, second, axes = (np.concatenate(parts) for parts in zip(*pairs_by_axis, strict=True))
    near, far = np.maximum(low[first], low[second]), np.minimum(high[first], high[second])
    rows = np.arange(len(axes))
    near[rows, axes] = far[rows, axes] = (near[rows, axes] + far[rows, axes]) / 2
    return Sides(first, second, axes, near, far)
