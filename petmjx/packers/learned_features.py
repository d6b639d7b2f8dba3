"""Features of candidates for the packer ``learned``. A candidate is a box that the packer sees, at a place on the pile.

Features describe the place, its neighbours, and the pile with the box. All features are scaled to a magnitude of about
1. No feature depends on boxes that the packer does not see.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.free_space import NAMES as ROOM
from petmjx.packers.free_space import free_space
from petmjx.packers.height_map import CELL_MM, HeightMap
from petmjx.packers.item_stream import Places
from petmjx.packers.learned_candidates import FourSidedStream
from petmjx.packers.pile_balance import TOUCH_MM

LATE: Final = ("z", "support", "rougher", "room_small", "room_large")
"""Features that appear a second time, multiplied by the pile's mean height in m. A feature and its product with the
mean height have separate weights, so the effect of the feature on the score can depend on the height of the pile."""

NAMES: Final = (
    *("z", "grows", "below_top"),
    *("support", "overhang_area", "waste", "n_supports", "column", "one_support"),
    *("touch", "edge", "flush", "deeper"),
    *("near_x", "near_y", "far_x", "far_y", "sliver_x", "sliver_y", "above_ring", "ring_rough"),
    *("mean_after", "rough_after", "rougher"),
    *("length_x", "length_y", "height", "slim", "base", "volume", "log_mass", "density"),
    *("from_side_x", "from_side_y", "from_middle", "off_centre"),
    *ROOM,
    *(f"{name}_late" for name in LATE),
    *("comes_first", "volume_of_seen", "height_of_seen", "mass_of_seen"),
)
"""Names of the features, in order. docs/packers.md explains them."""

NEAR_MM: Final = 8.0
"""Tolerance, mm: two sides with at most this gap count as touching, and two tops whose heights differ by at most this
length count as level."""

SLIVER_MM: Final = 100.0
"""Width below which a gap is too narrow for most cartons, mm."""

MOST_GAP_MM: Final = 400.0

_RING: Final = 3
"""Width of the ring around a base, in cells of the height map. The heights in this ring are compared with the box's
top."""

_LEVEL_MM: Final = 500.0
"""Length, mm, by which heights and lengths are divided to get a feature."""


def features(stream: FourSidedStream, places: Places) -> FloatArray:
    """(c, f) features of c candidates, in the order of ``NAMES``."""
    low, high = stream.boxes
    surface, extent = stream.surface, np.array(stream.extent_mm)
    start, size, mass = places.corner_mm, places.size_mm, places.mass_kg
    end = start + size
    z, top, height = start[:, 2], end[:, 2], size[:, 2]
    top_before = float(high[:, 2].max(initial=0.0))
    volume = places.own_mm2 * height
    middle = (start + size / 2)[:, :2] - extent / 2
    aside = np.minimum(start[:, :2], extent - end[:, :2]) / extent
    columns: dict[str, FloatArray | float] = {
        "z": z / MM_PER_M,
        "grows": np.maximum(top - top_before, 0) / _LEVEL_MM,
        "below_top": np.maximum(top_before - top, 0) / _LEVEL_MM,
        "support": places.support,
        "overhang_area": (1 - places.support) * places.own_mm2 / 1e5,
        "length_x": size[:, 0] / _LEVEL_MM,
        "length_y": size[:, 1] / _LEVEL_MM,
        "height": height / _LEVEL_MM,
        "slim": height / size[:, :2].min(axis=1),
        "base": places.own_mm2 / 1e5,
        "volume": volume / 2e7,
        "log_mass": np.log(mass) / 2,
        "density": mass / volume * 2e6,
        "from_side_x": aside[:, 0],
        "from_side_y": aside[:, 1],
        "from_middle": np.abs(middle / extent).sum(axis=1),
        "off_centre": _off_centre(low, high, volume, middle, extent),
        "comes_first": (places.kind == stream.seen[0]).astype(np.float64),
        "volume_of_seen": np.log(volume / volume.mean()),
        "height_of_seen": height / height.mean() - 1,
        "mass_of_seen": np.log(mass / mass.mean()),
    }
    _neighbour_features(columns, start, end, low, high, extent)
    _heights(columns, start, end, surface)
    columns |= free_space(stream.coarse, start, end)
    columns |= {f"{name}_late": columns[name] * (surface.mean / MM_PER_M) for name in LATE}
    rows = np.empty((len(NAMES), len(places)))
    for row, name in zip(rows, NAMES, strict=True):
        row[:] = columns[name]
    return np.ascontiguousarray(rows.T)


def _off_centre(
    low: FloatArray, high: FloatArray, volume: FloatArray, middle: FloatArray, extent: FloatArray
) -> FloatArray:
    """(c,) distance of the centre of volume from the target's middle, if the candidate's box is added. The distances
    along x and y are each divided by the target's extent along the same axis, and added. The sum is multiplied by 4.

    Args:
        low, high: (n, 3) lowest and highest corners of the placed boxes, mm.
        volume: (c,) volume of each candidate's box, mm³.
        middle: (c, 2) vector from the target's middle to the middle of each candidate's box, mm.
        extent: (2,) length and width of the target, mm.
    """
    sides = high - low
    weight = sides[:, 0] * sides[:, 1] * sides[:, 2]
    moment = weight @ ((low + high)[:, :2] / 2 - extent / 2) + volume[:, None] * middle
    shift: FloatArray = np.abs(moment / (weight.sum() + volume)[:, None] / extent).sum(axis=1) * 4
    return shift


def _deviation(mean_square: FloatArray | float, mean: FloatArray | float) -> FloatArray:
    deviation: FloatArray = np.sqrt(np.maximum(mean_square - np.square(mean), 0.0))
    return deviation


def _neighbour_features(
    columns: dict[str, FloatArray | float],
    start: FloatArray,
    end: FloatArray,
    low: FloatArray,
    high: FloatArray,
    extent: FloatArray,
) -> None:
    """Add to ``columns`` the features that depend on placed boxes beside and below the candidates.

    Args:
        columns: name of a feature → values.
        start, end: (c, 3) lowest and highest corners of the candidates, mm.
        low, high: (n, 3) lowest and highest corners of the placed boxes, mm.
        extent: (2,) length and width of the target, mm.
    """
    size = end - start
    # Three arrays (3, c, n), for axes, candidates and boxes. ``before``: the gap if the box is before the candidate.
    # ``after``: the gap if the box is after the candidate. ``shared``: the overlap.
    starts, ends, lows, highs = start.T[:, :, None], end.T[:, :, None], low.T[:, None, :], high.T[:, None, :]
    before, after = starts - highs, lows - ends
    shared = -np.maximum(np.maximum(before, after), np.maximum(lows - highs, starts - ends))
    along, upwards = shared[:2], shared[2]
    is_beside = along[::-1] > TOUCH_MM  # two boxes are neighbours along x if they overlap along y, or vice versa
    is_facing = is_beside & (upwards > NEAR_MM)
    level = highs[2] - ends[2]
    is_level, is_deeper = np.abs(level) <= NEAR_MM, level > NEAR_MM
    face = np.maximum(upwards, 0.0)
    perimeter = 2 * (size[:, 0] + size[:, 1])
    touch, flush, deeper, edge = np.zeros((4, len(start)))
    narrow = []
    for axis, name in enumerate("xy"):
        gaps = []
        for away, to_edge in ((before[axis], start[:, axis]), (after[axis], extent[axis] - end[:, axis])):
            length = np.where((np.abs(away) <= NEAR_MM) & is_beside[axis], along[1 - axis], 0.0)
            touch += (length * face).sum(axis=1)
            flush += (length * is_level).sum(axis=1)
            deeper += (length * is_deeper).sum(axis=1)
            edge += np.where(to_edge <= NEAR_MM, size[:, 1 - axis], 0.0)
            gap = np.where(is_facing[axis] & (away >= -NEAR_MM), away, MOST_GAP_MM).min(axis=1, initial=MOST_GAP_MM)
            gap = np.maximum(np.minimum(gap, to_edge), 0.0)
            narrow.append(((gap > NEAR_MM) & (gap < SLIVER_MM)).astype(np.float64))
            gaps.append(gap / MOST_GAP_MM)
        columns[f"near_{name}"], columns[f"far_{name}"] = np.minimum(*gaps), np.maximum(*gaps)
    columns["touch"] = touch / (perimeter * size[:, 2])
    columns["edge"], columns["flush"] = edge / perimeter, flush / perimeter
    columns["deeper"] = np.minimum(deeper / perimeter, 1.0)
    columns["sliver_x"], columns["sliver_y"] = narrow[0] + narrow[1], narrow[2] + narrow[3]
    bears = (along > TOUCH_MM).all(axis=0) & (np.abs(before[2]) <= TOUCH_MM)
    area = np.where(bears, along[0] * along[1], 0.0)
    base, tops = size[:, 0] * size[:, 1], (high - low)[:, :2].prod(axis=1)
    columns["n_supports"] = bears.sum(axis=1) / 4
    columns["column"] = (area / np.maximum(base[:, None], tops)).max(axis=1, initial=0.0)
    columns["one_support"] = area.max(axis=1, initial=0.0) / base


def _heights(columns: dict[str, FloatArray | float], start: FloatArray, end: FloatArray, surface: HeightMap) -> None:
    """Add to ``columns`` the features that depend on the height map: on the cells under the box, on the cells around
    the box, and on the map with the box."""
    low, high = surface.lines(start), surface.lines(end)
    count, under, under_square = surface.over(low, high)
    n_outer, outer, outer_square = surface.over(low - _RING, high + _RING)
    z, top = start[:, 2], end[:, 2]
    columns["waste"] = np.maximum(z * count - under, 0.0) * CELL_MM**2 / 2e7
    around = np.maximum(n_outer - count, 1.0)
    ring, ring_square = (outer - under) / around, (outer_square - under_square) / around
    columns["above_ring"] = np.clip((top - ring) / _LEVEL_MM, -2, 2)
    columns["ring_rough"] = _deviation(ring_square, ring) / _LEVEL_MM
    mean = surface.mean + (top * count - under) / surface.cells
    square = surface.mean_square + (top**2 * count - under_square) / surface.cells
    rough = _deviation(square, mean)
    columns["mean_after"] = mean / MM_PER_M
    columns["rough_after"] = rough / _LEVEL_MM
    columns["rougher"] = (rough - _deviation(surface.mean_square, surface.mean)) / 50
