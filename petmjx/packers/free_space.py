"""Measures the free space that a pile leaves for future boxes: how low typical cartons could stand, and how many places
for cartons are level.

A packer that sees only the next box does not know the boxes after it, but it can expect typical cartons. For each
candidate (a place for the next box), the next box is put on a coarse height map of the pile. The map then shows the
lowest place for each typical carton, and the volume of air that would be under the carton.
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
"""Bases of typical cartons, as numbers of cells of 50 mm along x and y, in both orientations. Small cartons have 300 ×
200 and 400 × 300 mm, large ones 550 × 200 and 600 × 400 mm."""

AIR: Final = 0.5
"""Cost of a millimetre of air under a carton, as millimetres of additional height. The height of the air is the mean
height over the carton's base."""

LEVEL_MM: Final = 15.0
"""A place counts as level if the mean height of the air under a carton's base is at most this length, mm."""

NAMES: Final = ("room_small", "room_large", "level_small", "level_large")


def free_space(surface: HeightMap, low: FloatArray, high: FloatArray) -> dict[str, FloatArray]:
    """The free space that remains if the box of a candidate is placed, for each of c candidates.

    Args:
        surface: height map of the pile without the candidates' boxes.
        low, high: (c, 3) lowest and highest corners of each candidate's box on the pile, mm.

    Returns:
        A dict: name in ``NAMES`` → (c,) values. ``room_small`` and ``room_large`` measure how low the next small or
        large carton could stand, m: the smallest cost of any place for a carton, averaged over the small or the large
        cartons. The cost of a place is its height plus the cost of the air below the carton. ``level_small`` and
        ``level_large`` are the shares of places that are level, averaged over the small or the large cartons.
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
    """The largest height in each window (rectangle of cells) of the height map, computed from ``highest``, the largest
    heights in narrower windows. The new windows are wider by ``more`` cells. The narrower windows must be at least
    ``more`` cells wide."""
    wider: Heights = np.maximum(highest[:, : max(highest.shape[1] - more, 0)], highest[:, more:])
    return wider


_DEEPER: Final = {4: (1, 2), 6: (1, 2, 2), 8: (1, 2, 4), 11: (1, 2, 4, 3), 12: (1, 2, 4, 4)}
"""Depth of a window (rectangle of cells) → the steps in which a window grows from a depth of one cell to this depth, as
numbers of added cells. No step adds more cells than the window already has."""

_NOWHERE_MM: Final = 2000.0


def _places(highest: Heights, sums: Heights, wide: int, deep: int) -> tuple[FloatArray, FloatArray]:
    """For each of c height maps, (c,) smallest cost of a place for a carton's base, mm, and (c,) share of places that
    are level.

    The cost of a place is its height plus the cost of the air below the base. The base has ``wide`` × ``deep`` cells.
    """
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
