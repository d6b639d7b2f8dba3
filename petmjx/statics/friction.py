"""Force balance with friction: forces in all three directions, and boxes that lean on their neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import MM_PER_M, FloatArray
from petmjx.history import CARRIER
from petmjx.statics.contacts import IntArray, PlanContacts, Sides
from petmjx.statics.largest import Entries, even_share, largest_slack
from petmjx.statics.wrenches import WRENCH, wrenches

_DIRECTIONS = 5
"""Forces at a point: pressure, and friction both ways along the two other axes."""


class Friction(NamedTuple):
    """Coefficients of friction.

    Attributes:
        flat: where a box lies on another one or on the carrier.
        sides: where boxes touch side by side.
    """

    flat: float
    sides: float = 0.0


class _Points(NamedTuple):
    """Points where bodies touch: p rows.

    The force on ``second`` presses along ``axis``; that on ``first`` is its opposite. ``share`` is what it is asked to
    carry per slack, in mean weights.
    """

    first: IntArray
    second: IntArray
    axis: IntArray
    position_m: FloatArray
    share: FloatArray
    friction: FloatArray


def friction_slack(
    contacts: PlanContacts, structure: NDArray[np.bool_], newest: int, friction: Friction, sides: Sides | None = None
) -> float:
    """Slack of a structure with friction: as in ``petmjx.statics.balance``, but all that touches it is in balance, too.

    Friction lies within the pyramid |fx| + |fy| ≤ μ f, inside the cone. So a stack that is balanced here is balanced
    with the cone. At a slack other than 0 friction is within μ times what a corner carries beyond what it is asked to;
    the sign does not depend on that.

    Args:
        structure: (n,) the boxes whose corners are asked to carry.
        newest: the box placed last.
        sides: where boxes lean on each other; None: nowhere.
    """
    boxes = _hanging_together(contacts, structure, newest, sides)
    points = _points(contacts, boxes, structure, friction, sides)
    weight = contacts.mass_kg / contacts.mass_kg.mean()
    loads = np.zeros((int(boxes.sum()), WRENCH))
    loads[:, 2] = weight[boxes]
    share = np.zeros((len(points.share), _DIRECTIONS))
    share[:, 0] = points.share
    possible = np.repeat(points.friction[:, None] > 0, _DIRECTIONS, axis=1)
    possible[:, 0] = True
    chosen = np.flatnonzero(possible)
    row_of = np.append(np.cumsum(boxes) - 1, CARRIER)  # the carrier, the last one, does not move
    first, second = row_of[points.first], row_of[points.second]
    centre_m = contacts.centre_mm[boxes] / MM_PER_M
    forces = _columns(
        wrenches(first, second, points.position_m, _directions(points.axis), centre_m), chosen, possible.size
    )
    limits = _columns(_pyramids(points.friction), chosen, possible.size)
    return largest_slack(forces, share.ravel()[chosen], loads.ravel(), limits)


def _columns(entries: Entries, chosen: IntArray, n: int) -> Entries:
    """The entries in some of n columns, which are counted anew."""
    position = np.full(n, -1)
    position[chosen] = np.arange(len(chosen))
    column = position[entries.column]
    kept = column >= 0
    return Entries(entries.value[kept], entries.row[kept], column[kept])


def _hanging_together(
    contacts: PlanContacts, structure: NDArray[np.bool_], newest: int, sides: Sides | None
) -> NDArray[np.bool_]:
    """(n,) all placed boxes that touch the structure, or boxes that do, and so on."""
    pairs = [np.c_[contacts.upper, contacts.lower]] + ([] if sides is None else [np.c_[sides.first, sides.second]])
    pair = np.concatenate(pairs)
    pair = pair[(pair[:, 1] != CARRIER) & (pair.max(axis=1) <= newest)]
    members = structure.copy()
    count = 0
    while count != members.sum():
        count = int(members.sum())
        members[pair[members[pair].any(axis=1)]] = True
    return members


def _points(
    contacts: PlanContacts,
    boxes: NDArray[np.bool_],
    structure: NDArray[np.bool_],
    friction: Friction,
    sides: Sides | None,
) -> _Points:
    """The corners of all contact areas of these boxes."""
    indices = np.flatnonzero(boxes[contacts.upper])
    upper = contacts.upper[indices]
    height = np.broadcast_to(contacts.corner_mm[upper, None, None, 2], (len(indices), 4, 1))
    corners = np.concatenate([contacts.corners_mm[indices], height], axis=-1)
    carried_share = even_share(contacts, contacts.mass_kg / contacts.mass_kg.mean())[indices] * structure[upper]
    parts = [
        (
            contacts.lower[indices],
            upper,
            np.full(len(indices), 2),
            corners,
            carried_share,
            np.full(len(indices), friction.flat),
        )
    ]
    if sides is not None:
        indices = np.flatnonzero(boxes[sides.first] & boxes[sides.second])
        ends = (sides.first[indices], sides.second[indices], sides.axis[indices], _side_corners(sides, indices))
        parts.append((*ends, np.zeros(len(indices)), np.full(len(indices), friction.sides)))
    first, second, axis, position, share, mu = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    first, second, axis, share, mu = (np.repeat(column, 4) for column in (first, second, axis, share, mu))
    return _Points(first, second, axis, position.reshape(-1, 3) / MM_PER_M, share, mu)


def _side_corners(sides: Sides, indices: IntArray) -> FloatArray:
    """(s, 4, 3) corners of upright rectangles."""
    corners = np.repeat(sides.low_mm[indices][:, None, :], 4, axis=1)
    far, across = sides.high_mm[indices], 1 - sides.axis[indices]
    rows = np.arange(len(indices))[:, None]
    corners[rows, [[1, 2]], across[:, None]] = far[rows, across[:, None]]
    corners[rows, [[2, 3]], 2] = far[:, 2:]
    return corners


def _directions(axis: IntArray) -> FloatArray:
    """(p, 5, 3) unit vectors: along the axis, then both ways along the two others."""
    unit = np.eye(3)
    along, one, other = unit[axis], unit[(axis + 1) % 3], unit[(axis + 2) % 3]
    return np.stack([along, one, -one, other, -other], axis=1)


def _pyramids(friction: FloatArray) -> Entries:
    """(p, 5 p): friction less μ times pressure at each point."""
    values = np.ones((len(friction), _DIRECTIONS))
    values[:, 0] = -friction
    return Entries(values.ravel(), np.repeat(np.arange(len(friction)), _DIRECTIONS), np.arange(values.size))
