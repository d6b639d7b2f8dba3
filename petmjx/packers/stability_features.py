"""Features from which a network predicts whether a box stands if a robot places it inexactly.

The network was trained with simulations in which all boxes are placed with the errors of a robot
(examples/train_packer). The plans were made by rules, and partly at random. A box counts as standing if it stands until
the end of the simulation, or if another box fails first. So the product of the probabilities over all boxes of a plan
is the probability that the whole plan stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.pile_balance import TOUCH_MM, Balance, Margins, Rest

NAMES: Final = (
    *("own_margin", "own_share", "pile_margin", "support", "one_support", "n_supports", "floor"),
    *("gap_x", "gap_y", "tight_x", "tight_y", "gap_all", "hit", "face"),
    *("z", "height", "narrow", "wide", "slim", "log_mass", "density", "mass_on", "support_slim", "n_below", "placed"),
)

MOST_GAP_MM: Final = 15.0
"""In the features, a gap between a box and a neighbour is at most this length, mm; larger gaps count as this length.
The errors of a robot are some millimetres, so neighbours at larger distances have no effect."""

_MARGIN_M: Final = 0.05


@dataclass(frozen=True, eq=False)
class PlacementState:
    """A box that is about to be placed on a pile.

    Attributes:
        corner_mm, size_mm: (3,) lowest corner of the box, and its size along x, y and z, mm.
        mass_kg: mass of the box.
        low, high: (n, 3) lowest and highest corners of the boxes of the pile, mm.
        masses: (n,) masses of the boxes of the pile, kg.
        margins: margins against tipping that the pile has with this box.
    """

    corner_mm: FloatArray
    size_mm: FloatArray
    mass_kg: float
    low: FloatArray
    high: FloatArray
    masses: FloatArray
    margins: Margins


def placement_state(
    pile: Balance,
    low: FloatArray,
    high: FloatArray,
    masses: FloatArray,
    corner_mm: FloatArray,
    size_mm: FloatArray,
    mass_kg: float,
    rest: Rest | None = None,
) -> PlacementState:
    """The state in which a box is placed on a pile.

    Args:
        pile: static balance of the pile.
        low, high, masses, corner_mm, size_mm, mass_kg: as in ``PlacementState``.
        rest: effect of the box on the balance; None if this effect was not computed before.
    """
    (x, y, z), (length, width, _) = corner_mm.tolist(), size_mm.tolist()
    margins = pile.margins_m((x, y, z), (length, width), mass_kg, rest)
    return PlacementState(corner_mm, size_mm, mass_kg, low, high, masses, margins)


def stability_features(box: PlacementState) -> FloatArray:
    """(f,) features of a box that is about to be placed, in the order of ``NAMES``."""
    start, size, low, high = box.corner_mm, box.size_mm, box.low, box.high
    end = start + size
    away = np.maximum(start - high, low - end)  # (n, 3) gaps along x, y and z; a negative value is an overlap
    x, y, z = away.T
    shared = np.minimum(end, high) - np.maximum(start, low)
    over = (x < -TOUCH_MM) & (y < -TOUCH_MM)
    under = over & (np.abs(high[:, 2] - start[2]) <= TOUCH_MM)
    area = np.where(under, shared[:, 0] * shared[:, 1], 0.0)
    base = float(size[0] * size[1])
    on_floor = start[2] <= TOUCH_MM
    gaps = [np.full(2, MOST_GAP_MM) for _ in range(2)]
    faces = [0.0, 0.0]
    for axis, across in ((0, 1), (1, 0)):
        facing = (away[:, across] < -TOUCH_MM) & (z < -TOUCH_MM) & (away[:, axis] > -MOST_GAP_MM)
        for side, free in enumerate((start[axis] - high[:, axis], low[:, axis] - end[axis])):
            is_near = facing & (free > -MOST_GAP_MM)
            gaps[axis][side] = np.where(is_near, free, MOST_GAP_MM).min(initial=MOST_GAP_MM)
        is_close = facing & (away[:, axis] < MOST_GAP_MM)
        faces[axis] = float(np.where(is_close, shared[:, across] * shared[:, 2], 0.0).sum() / (size[across] * size[2]))
    sides = high[:, :2] - low[:, :2]
    slim = (high[:, 2] - low[:, 2]) / sides.min(axis=1) if len(sides) else np.zeros(0)
    mass_below = float(box.masses[under].sum())
    narrow, wide = float(size[:2].min()), float(size[:2].max())
    own_m = box.margins.own_m
    close = [gap / MOST_GAP_MM for gap in gaps]
    return np.array(
        [
            _clipped_number(own_m / _MARGIN_M),
            _clipped_number(own_m * MM_PER_M / narrow * 4),
            _clipped_number(box.margins.pile_m / _MARGIN_M),
            1.0 if on_floor else area.sum() / base,
            1.0 if on_floor else area.max(initial=0.0) / base,
            under.sum() / 4,
            float(on_floor),
            close[0].min(),
            close[1].min(),
            close[0].sum() / 2,
            close[1].sum() / 2,
            min(close[0].min(), close[1].min()),
            float((gaps[0] <= TOUCH_MM).sum() + (gaps[1] <= TOUCH_MM).sum()) / 4,
            min(faces[0] + faces[1], 4.0) / 4,
            start[2] / MM_PER_M,
            size[2] / 300,
            narrow / 300,
            wide / 300,
            size[2] / narrow,
            np.log(box.mass_kg) / 2,
            box.mass_kg / (base * size[2]) * 2e6,
            0.0 if on_floor else _clipped_number(np.log(box.mass_kg / max(mass_below, 1e-3))),
            slim[under].max(initial=0.0),
            over.sum() / 8,
            len(low) / 40,
        ]
    )


def _clipped_number(value: float) -> float:
    return float(min(max(value, -4.0), 4.0))
