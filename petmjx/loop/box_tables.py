"""The boxes on many pallets, as tables. Sizes and places are as the caller requested them, not as simulated."""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.loop.extreme_points import Points
from petmjx.loop.placement_arguments import Placements
from petmjx.plans.plan import Plan
from petmjx.world.growing_scenes import FIRST_COLUMNS, widened_table

_AT_ONCE: Final = 512
"""Largest number of pallets for which extreme points are computed in one call."""


class BoxTable:
    """The boxes on n pallets.

    Attributes:
        count: (n,) number of boxes on each pallet.
        size_mm, corner_mm: (n, k, 3) extents and corners of the boxes. Values after the last box of a pallet are NaN.
        mass_kg: (n, k) masses of the boxes. Values after the last box of a pallet are NaN.
    """

    def __init__(self, n: int) -> None:
        self.count: NDArray[np.int64] = np.zeros(n, np.int64)
        self.size_mm: FloatArray = np.full((n, FIRST_COLUMNS, 3), np.nan)
        self.corner_mm: FloatArray = np.full((n, FIRST_COLUMNS, 3), np.nan)
        self.mass_kg: FloatArray = np.full((n, FIRST_COLUMNS), np.nan)
        self._points = Points(n)

    def add(self, placements: Placements) -> None:
        """Add one box to each of the pallets in ``placements``."""
        rows, at = placements.pallet, self.count[placements.pallet]
        for name in ("size_mm", "corner_mm", "mass_kg"):
            setattr(self, name, widened_table(getattr(self, name), int(at.max(initial=0)) + 1, np.nan))
        self.size_mm[rows, at], self.corner_mm[rows, at] = placements.size_mm, placements.corner_mm
        self.mass_kg[rows, at] = placements.mass_kg
        self.count[rows] += 1

    def cut(self, pallets: NDArray[np.int64], count: NDArray[np.int64]) -> None:
        """Keep only the first ``count`` boxes of each given pallet."""
        beyond = np.arange(self.size_mm.shape[1]) >= count[:, None]
        for name in ("size_mm", "corner_mm", "mass_kg"):
            values = getattr(self, name)
            pallet_rows = values[pallets]
            pallet_rows[beyond] = np.nan
            values[pallets] = pallet_rows
        self.count[pallets] = count
        self._points.cut(pallets, count)

    def copy(self, sources: NDArray[np.int64], into: NDArray[np.int64]) -> None:
        """Copy the boxes of the pallets ``sources`` to the pallets ``into``."""
        for name in ("count", "size_mm", "corner_mm", "mass_kg"):
            values = getattr(self, name)
            values[into] = values[sources]
        self._points.copy(sources, into)

    def find_points(
        self, pallets: NDArray[np.int64], gap_mm: float = 0.0, machine_code: ModuleType | None = None
    ) -> Points:
        """The extreme points (candidate corners of a new box) of the given pallets, updated for all boxes on them.

        Args:
            gap_mm: free space between boxes.
            machine_code: the module ``petmjx.loop.compiled_places``, loaded. If ``machine_code`` is None, NumPy
                computes the points.
        """
        if gap_mm != self._points.gap_mm:
            self._points = Points(len(self.count), gap_mm)
        points, free_mm = self._points, np.array([gap_mm, gap_mm, 0.0])
        is_named = np.zeros(len(self.count), bool)
        is_named[pallets] = True
        rows = np.flatnonzero(is_named & (points.boxes < self.count))
        if machine_code is not None and len(rows):
            points.add_all(rows, self.corner_mm, self.size_mm, self.count, machine_code)
            return points
        # pallets are sorted by number of boxes, so that all pallets of a chunk have similar numbers of points
        rows = rows[np.argsort(self.count[rows], kind="stable")]
        while len(rows := rows[points.boxes[rows] < self.count[rows]]):
            for chunk_rows in np.array_split(rows, -(-len(rows) // _AT_ONCE)):
                low = self.corner_mm[chunk_rows, : int(points.boxes[chunk_rows].max()) + 1]
                points.add(chunk_rows, low, low + self.size_mm[chunk_rows, : low.shape[1]] + free_mm)
        return points

    def box(self, pallets: NDArray[np.int64], number: int | NDArray[np.int64]) -> Placements:
        """One box of each of m given pallets. ``number`` is the number of the box: one number for all pallets, or (m,)
        a number for each pallet."""
        return Placements(
            self.size_mm[pallets, number], self.corner_mm[pallets, number], self.mass_kg[pallets, number], pallets
        )

    def plan(self, pallet: int, plan_id: str, fields: Mapping[str, Any]) -> Plan:
        """A plan with the boxes of a pallet. ``fields`` are further arguments of ``Plan.from_boxes``."""
        k = int(self.count[pallet])
        return Plan.from_boxes(
            plan_id,
            size_mm=self.size_mm[pallet, :k],
            corner_mm=self.corner_mm[pallet, :k],
            mass_kg=self.mass_kg[pallet, :k],
            **fields,
        )
