"""Room for boxes whose places and sizes have errors, where they appear: the nearest places at which none is in another.

Boxes that appeared in one another would be thrown apart by their contacts, the faster the stiffer these are and the
shorter the timestep is: whether the pallet stands would then depend on numbers that are no property of boxes. So they
are moved apart before, level, by the least translations.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray

CLEAR_M: Final = 0.0002
"""How far apart boxes are once they were in one another: contacts of edges begin up to 0.14 mm before they touch, 0.7
times the skins of two boxes (docs/rules.md, section 1)."""

_KNOWN_TO_M: Final = 1e-6
"""How much of it may be missing: a hundredth of the depth of contacts at rest."""

_MOST_ROUNDS: Final = 500
"""A row of 12 boxes takes 200; then what is missing is left to contacts."""


def make_room(
    place: FloatArray,
    half_size: FloatArray,
    yaw: FloatArray,
    planned: FloatArray,
    planned_half: FloatArray,
    beside: NDArray[np.bool_],
    movable: NDArray[np.bool_],
    reach_m: float,
) -> FloatArray:
    """(m, n, 2) level places nearest to those of m worlds at which no box is in one beside it, m.

    Nearest: the sum of the squares of all translations is the least. Two boxes are kept apart along that axis of one of
    them along which they overlap least, by ``CLEAR_M``, or by less, or not quite, if the plan has them so. Each pair
    then bounds the translations by one linear inequality; the least ones are found by Hildreth's method (Hildreth 1957,
    "A quadratic programming procedure", Naval Research Logistics Quarterly 4, 79-85), pair by pair. A world's places do
    not depend on the others.

    Args:
        place: (m, n, 2) level places of the boxes' middles, m; half_size: (m or 1, n, 3); yaw: (m or 1, n), rad.
        planned, planned_half: (n, 2) and (n, 3) of the plan, whose boxes are not turned.
        beside: (n, n) symmetric: pairs of which neither is above the other.
        movable: (n,) others stay where they are.
        reach_m: pairs that are further apart in the plan are not looked at.
    """
    apart = _apart(planned, planned_half)
    first, second = np.nonzero(np.triu(beside & (apart < reach_m) & (movable[:, None] | movable), k=1))
    if not len(first):
        return place
    normal, gap = _widest(place, half_size, yaw, first, second)
    missing = np.minimum(apart[first, second], CLEAR_M) - gap
    open_worlds = np.flatnonzero((missing > _KNOWN_TO_M).any(axis=1))
    if not len(open_worlds):
        return place
    normal, missing = normal[open_worlds], missing[open_worlds]
    moved = np.zeros((len(open_worlds), place.shape[1], 2))
    pressure = np.zeros_like(missing)
    yields = movable.astype(float)
    resistance = yields[first] + yields[second]
    some = _independent(first, second)
    running = np.arange(len(open_worlds))
    for _ in range(_MOST_ROUNDS):
        worst = np.zeros(len(running))
        for pairs in some:
            i, j = first[pairs], second[pairs]
            n = normal[running][:, pairs]
            away = moved[running][:, j] - moved[running][:, i]
            lacks = missing[running][:, pairs] - (n[..., 0] * away[..., 0] + n[..., 1] * away[..., 1])
            before = pressure[running][:, pairs]
            more = np.maximum(before + lacks / resistance[pairs], 0.0) - before
            worst = np.maximum(worst, lacks.max(axis=1))
            worst = np.maximum(worst, np.abs(more).max(axis=1))
            pressure[running[:, None], pairs] = before + more
            moved[running[:, None], i] -= (yields[i] * more)[..., None] * n
            moved[running[:, None], j] += (yields[j] * more)[..., None] * n
        running = running[worst > _KNOWN_TO_M]
        if not len(running):
            break
    new_place = place.copy()
    new_place[open_worlds] += moved
    return new_place


def _apart(place: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n, n) how far boxes that are not turned are apart along the axis along which they are further; negative: they
    overlap by that much, m."""
    along = [
        np.abs(place[:, None, axis] - place[:, axis]) - (half_size[:, None, axis] + half_size[:, axis])
        for axis in range(2)
    ]
    return np.asarray(np.maximum(*along))


def _widest(
    place: FloatArray, half_size: FloatArray, yaw: FloatArray, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """(m, p, 2) the axis of each pair along which its boxes are furthest apart, from the first one to the second, and
    (m, p) how far, m: rectangles are apart where one of their four axes separates them."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    between = place[:, second] - place[:, first]
    widest = np.full(between.shape[:2], -np.inf)
    normal = np.zeros(between.shape)
    for box in (first, second):
        for x, y in ((cos[:, box], sin[:, box]), (-sin[:, box], cos[:, box])):
            reach = sum(
                half_size[:, other, 0] * np.abs(x * cos[:, other] + y * sin[:, other])
                + half_size[:, other, 1] * np.abs(y * cos[:, other] - x * sin[:, other])
                for other in (first, second)
            )
            along = x * between[..., 0] + y * between[..., 1]
            gap = np.abs(along) - reach
            wider = gap > widest
            sign = np.where(along < 0, -1.0, 1.0)
            widest = np.where(wider, gap, widest)
            normal = np.where(wider[..., None], np.stack([sign * x, sign * y], axis=-1), normal)
    return normal, widest


def _independent(first: NDArray[np.intp], second: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Pairs in groups of which none has a box twice, so that a group's can be worked on together."""
    groups: list[list[int]] = []
    boxes: list[set[int]] = []
    for pair, both in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        group = next((k for k, some in enumerate(boxes) if not some.intersection(both)), len(groups))
        if group == len(groups):
            groups.append([])
            boxes.append(set())
        groups[group].append(pair)
        boxes[group].update(both)
    return [np.array(group) for group in groups]
