"""The free space that a pile leaves for future boxes: how low typical cartons could stand, and how many places are
level.

A policy that sees one box does not know the boxes after it, but it can expect typical cartons. For each candidate, the
box is placed on a coarse height map of the pile. The map then shows the lowest place for each typical carton, and the
air under the carton at that place.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.height_map import HeightMap

Heights = NDArray[np.float32]

SMALL: Final = ((6, 4), (4, 6)), ((8, 6), (6, 8))
LARGE: Final = ((11, 4), (4, 11)), ((12, 8), (8, 12))
"""Bases of typical cartons in cells of 50 mm, in both orientations: 300 × 200 and 400 × 300 mm; 550 × 200 and
600 × 400 mm."""

AIR: Final = 0.5
"""Cost of a millimetre of air under the carton (the mean over its base), in mm of height."""

LEVEL_MM: Final = 15.0
"""A place with less air than this counts as level."""

NAMES: Final = ("room_small", "room_large", "level_small", "level_large")


def free_space(surface: HeightMap, low: FloatArray, high: FloatArray) -> dict[str, FloatArray]:
    """The free space that c candidates would leave.

    Args:
        low, high: (c, 3) corners of each candidate's box on the pile, mm.

    Returns:
        Name, of ``NAMES`` → (c,) values. ``room_…``: height and air of the lowest place, m, as the mean over cartons.
        ``level_…``: share of places that are level, as the mean over cartons.
    """
    lines = np.concatenate([surface.lines(low), surface.lines(high)], axis=1)[:, :, None]
    x, y = (np.arange(n) for n in surface.height.shape)
    along_x, along_y = (x >= lines[:, 0]) & (x < lines[:, 2]), (y >= lines[:, 1]) & (y < lines[:, 3])
    under = along_x[:, :, None] & along_y[:, None, :]
    height = np.where(under, high[:, 2, None, None].astype(np.float32), surface.height.astype(np.float32))
    sums = np.zeros((len(low), len(x) + 1, len(y) + 1), np.float32)
    height.cumsum(axis=1).cumsum(axis=2, out=sums[:, 1:, 1:])
    highest: dict[int, Heights] = {1: height}
    for wide, parts in ((2, 1), (4, 2), (6, 4), (8, 4), (11, 8), (12, 8)):
        highest[wide] = _wider(highest[parts], wide - parts)
    features = {}
    for name, cartons in (("small", SMALL), ("large", LARGE)):
        lowest = level = np.zeros(len(low))
        for turns in cartons:
            places = [_places(highest[wide], sums, wide, deep) for wide, deep in turns]
            lowest = lowest + np.minimum(places[0][0], places[1][0]) / len(cartons)
            level = level + (places[0][1] + places[1][1]) / (2 * len(cartons))
        features[f"room_{name}"], features[f"level_{name}"] = lowest / MM_PER_M, level
    return features


def _wider(highest: Heights, more: int) -> Heights:
    """Maxima over windows that are wider by ``more`` cells. The result is computed from ``maxima`` over narrower
    windows, which must be at least ``more`` cells wide."""
    wider: Heights = np.maximum(highest[:, : max(highest.shape[1] - more, 0)], highest[:, more:])
    return wider


_DEEPER: Final = {4: (1, 2), 6: (1, 2, 2), 8: (1, 2, 4), 11: (1, 2, 4, 3), 12: (1, 2, 4, 4)}
"""Depth of a window → steps by which the window grows from one cell to this depth. No step is longer than the depth
before the step."""

_NOWHERE_MM: Final = 2000.0


def _places(highest: Heights, sums: Heights, wide: int, deep: int) -> tuple[FloatArray, FloatArray]:
    """Two arrays: (c,) cost of the lowest place of a base, computed from height and air, mm; and (c,) share of places
    that are level."""
    for more in _DEEPER[deep]:
        highest = np.maximum(highest[:, :, : max(highest.shape[2] - more, 0)], highest[:, :, more:])
    if not highest.size:
        nothing = np.zeros(len(highest))
        return nothing + _NOWHERE_MM, nothing
    inside = sums[:, wide:, deep:] - sums[:, :-wide, deep:] - sums[:, wide:, :-deep] + sums[:, :-wide, :-deep]
    air = (highest - inside * np.float32(1 / (wide * deep))).reshape(len(highest), -1)
    cost = highest.reshape(air.shape) + np.float32(AIR) * air
    level = np.count_nonzero(air < LEVEL_MM, axis=1) / air.shape[1]
    return cost.min(axis=1).astype(np.float64), level
