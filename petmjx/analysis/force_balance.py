"""Force balance: determines whether forces between the boxes can hold a stack in balance, and with how much slack.
docs/criteria.md, section "Force balance", defines the slack.

Sources: Liu, Deng, Wang, Liu, Liu (2024), "StableLego: stability analysis of block stacking assembly", arXiv
2402.10711, and Whiting, Ochsendorf, Durand (2009), "Procedural modeling of structurally-sound masonry buildings", ACM
Transactions on Graphics 28(5). At each corner of each contact area, the bodies may press on each other, with friction
of at most μ times the pressing force. A stack is balanced if these forces can be chosen so that on every box, all
forces (including the weight) add up to zero, and all moments add up to zero.

A newly placed box affects only its structure: the new box and all boxes that contacts connect with it. Three shortcuts
save time without changing the result:

- A box with all four corners on the carrier is in balance for any load on its top, because the carrier can always
  balance the load with vertical forces. Such a box is treated as part of the carrier, so it belongs to no structure.
- Friction, horizontal forces and heights are considered only if vertical forces alone do not balance the boxes. For
example, a box that would tip if it stood alone may be held by friction if a second box lies across this box and a
neighbour. If friction is considered, the slack is the larger one of the slack without friction and the slack with
friction.
- For a structure of one box, a closed form (``_slack_alone``) gives the slack without a linear programme.

With ``lean``, boxes that touch side by side may press on each other, and boxes may press on walls, by default without
friction. ``lean`` is off by default, because two sides that could press on each other need not do so.

petmjx.analysis.force_intervals uses ``least_and_most`` and ``wrenches`` of this module.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.plan_contacts import Hulls, IntArray, PlanContacts, Sides, find_sides
from petmjx.common.linear_programmes import Entries, minimised
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.world.history import CARRIER

WRENCH: Final = 6
"""Number of equations of balance for each body: three for the force on the body, and three for the moment about the
body's centre."""


def wrenches(
    first: IntArray, second: IntArray, position_m: FloatArray, direction: FloatArray, centre_m: FloatArray
) -> Entries:
    """The matrix (6 b, p k) that turns forces at contact points into forces and moments on bodies. Each of b bodies has
    6 rows, three for the force on the body and three for the moment about its centre. Each of k unit forces at each of
    p points has a column.

    Args:
        first, second: (p,) the two bodies that touch at each point, from 0 to b - 1. A negative number stands for a
            body that does not move.
        position_m: (p, 3) the positions of the points, m.
        direction: (p, k, 3) directions of the k forces on the body ``second``. The forces on the body ``first`` are
            opposite.
        centre_m: (b, 3) the centres of the bodies, m.
    """
    n_points, n_forces, _ = direction.shape
    column_of = np.arange(n_points * n_forces).reshape(n_points, n_forces)
    values, rows, columns = [], [], []
    for body, sign in ((second, 1.0), (first, -1.0)):
        at = np.flatnonzero(body >= 0)
        force = sign * direction[at]
        arm = (position_m[at] - centre_m[body[at]])[:, None, :]
        wrench = np.concatenate([force, np.cross(arm, force)], axis=-1)
        row = np.broadcast_to(WRENCH * body[at][:, None, None] + np.arange(WRENCH), wrench.shape)
        values.append(wrench.ravel())
        rows.append(row.ravel())
        columns.append(np.repeat(column_of[at].ravel(), WRENCH))
    return Entries(np.concatenate(values), np.concatenate(rows), np.concatenate(columns))


EVEN: Final = 1.0
"""The largest possible slack. At a slack of 1, all corners under a box carry the same force."""


def even_share(contacts: PlanContacts, weight: FloatArray) -> FloatArray:
    """(c,) for each of c contact areas, the force at each of its four corners at a slack of 1: the weight of the upper
    box, divided by the number of corners of all contact areas under this box."""
    share: FloatArray = weight[contacts.upper] / (4 * contacts.n_supports[contacts.upper])
    return share


def largest_slack(forces: Entries, share: FloatArray, row_sums: FloatArray, limits: Entries | None = None) -> float:
    """The largest slack s ≤ ``EVEN`` for which numbers g ≥ 0 exist with ``forces @ (share·s + g) = row_sums`` and
    ``limits @ g ≤ 0``. g is the part of each force that exceeds the required force share·s.

    Args:
        forces: (r, f) contribution of each of f forces to each of r equations of balance (rows).
        share: (f,) value that each force must have per unit of slack.
        row_sums: (r,) right-hand side of each equation of balance.
        limits: (q, f) the factors of the f numbers g in each of the q conditions ``limits @ g ≤ 0``. If ``limits`` is
            None, only the condition on ``forces`` must hold.

    Returns:
        The slack s; −inf if no s fulfils the conditions, not even an arbitrarily negative s.

    Raises:
        PetmjxError: the solver HiGHS found no answer.
    """
    rows, n_forces = len(row_sums), len(share)
    by_slack = np.zeros(rows)
    np.add.at(by_slack, forces.row, forces.value * share[forces.column])
    # The slack s is the last unknown, so the last column has its factors.
    parts = [forces, Entries(by_slack, np.arange(rows), np.full(rows, n_forces))]
    n_limits = 0
    if limits is not None:
        parts.append(limits._replace(row=limits.row + rows))
        n_limits = int(limits.row.max(initial=-1)) + 1
    value, row, column = (np.concatenate(entries) for entries in zip(*parts, strict=True))
    least = np.r_[row_sums, np.full(n_limits, -np.inf)]
    solution = minimised(
        np.r_[np.zeros(n_forces), -1.0],
        Entries(value, row, column),
        (least, np.r_[row_sums, np.zeros(n_limits)]),
        (np.r_[np.zeros(n_forces), -np.inf], np.r_[np.full(n_forces, np.inf), EVEN]),
    )
    return -np.inf if solution is None else float(solution[-1])


def least_and_most(sums: FloatArray, forces: Entries, row_sums: FloatArray) -> FloatArray | None:
    """The smallest and the largest possible value of each of m weighted sums of f forces. All forces g ≥ 0 with
    ``forces @ g = row_sums`` are possible.

    Args:
        sums: (m, f) factor of each force in each sum.
        forces: (r, f) contribution of each of f forces to each of r equations of balance (rows).
        row_sums: (r,) right-hand side of each equation of balance.

    Returns:
        (m, 2) smallest and largest value of each sum; None if no possible forces exist.

    Raises:
        PetmjxError: the solver HiGHS found no answer, or a sum is unbounded.
    """
    bounds = (np.zeros(sums.shape[1]), np.full(sums.shape[1], np.inf))
    extremes = np.empty((len(sums), 2))
    for number, factors in enumerate(sums):
        for side, sign in enumerate((1.0, -1.0)):
            balanced = minimised(sign * factors, forces, (row_sums, row_sums), bounds)
            if balanced is None:
                return None
            extremes[number, side] = factors @ balanced
    return extremes


NO_SLACK: Final = -1e-6
"""Smallest slack of a balanced stack. The limit is below 0 because the solver has a tolerance of 1e-7 of the mean
weight of the boxes."""


def balance_slack(
    contacts: PlanContacts, hulls: Hulls, friction: Friction, lean: bool = False
) -> tuple[FloatArray, FloatArray]:
    """The slack of force balance after the placement of each box, for the structure of this box (the group of boxes
    that contacts connect with it). Returns two arrays (n,): slacks without leaning on neighbours, and slacks with
    leaning.

    If the stack is not balanced after the placement of a box, the slacks of all later boxes are NaN. The slack of a box
    without support is also NaN. A box without support is never balanced, although its neighbours could hold it by
    pressing on its sides.

    Args:
        friction: coefficients of friction.
        lean: whether the slack with leaning is also computed: the slack if boxes may press on neighbours that they
            touch side by side. If ``lean`` is False, the second array is NaN.
    """
    without = _Stack(contacts, friction)
    ways = [without, _Stack(contacts, friction, find_sides(contacts))] if lean else [without]
    structures = _Structures(contacts, hulls)
    for box in range(contacts.n_boxes):
        going = [way for way in ways if way.balanced]
        if not going or not contacts.n_supports[box]:
            break
        vertical = structures.with_box(box)
        for way in going:
            way.place(box, vertical, structures)
    return without.slack, ways[-1].slack if lean else np.full(contacts.n_boxes, np.nan)


class _Stack:
    """A stack that is built box by box. After each placement, the stack is checked for balance, until it is not
    balanced any more. Either boxes may lean on their neighbours in all checks, or in none."""

    def __init__(self, contacts: PlanContacts, friction: Friction, sides: Sides | None = None) -> None:
        self.slack = np.full(contacts.n_boxes, np.nan)
        self.balanced = True
        self._contacts, self._friction, self._sides = contacts, friction, sides

    def place(self, box: int, vertical: float, structures: _Structures) -> None:
        """Place a box and compute its slack. ``vertical`` is the slack of the box's structure if only vertical forces
        act."""
        slack = vertical
        if slack < NO_SLACK:
            structure = structures.of(box)
            slack = max(slack, friction_slack(self._contacts, structure, box, self._friction, self._sides))
        self.slack[box] = slack
        self.balanced = slack >= NO_SLACK


class _Structures:
    """The structures of placed boxes. A structure is a group of boxes that are connected by contacts. A box with all
    four corners on the carrier counts as part of the carrier, so it belongs to no structure."""

    def __init__(self, contacts: PlanContacts, hulls: Hulls) -> None:
        self._contacts = contacts
        self._alone = _slack_alone(contacts, hulls)
        self._joined = np.arange(contacts.n_boxes)
        self._starts = np.searchsorted(contacts.upper, np.arange(contacts.n_boxes + 1))
        self._grounded = contacts.grounded
        self._system = _VerticalSystem(contacts)

    def of(self, box: int) -> NDArray[np.bool_]:
        """(n,) whether each box belongs to the structure of the given box."""
        joined: NDArray[np.bool_] = self._joined == self._joined[box]
        return joined

    def with_box(self, box: int) -> float:
        """Place a box, and return the slack of its structure if only vertical forces act."""
        if self._grounded[box]:
            return 1.0
        supports = self._contacts.lower[self._starts[box] : self._starts[box + 1]]
        free = supports[(supports != CARRIER) & ~self._grounded[supports]]
        if not len(free):
            return float(self._alone[box])
        for name in {int(self._joined[support]) for support in free}:
            self._joined[self._joined == name] = box
        return self._system.slack(np.flatnonzero(self.of(box)))


def _slack_alone(contacts: PlanContacts, hulls: Hulls) -> FloatArray:
    """(n,) slack of each box under vertical forces alone, if nothing lies on the box.

    Take the ray that starts in the middle of the corners of the box's contact areas, passes through the box's centre of
    mass and ends at the edge of the corners' convex hull. The slack is 1 minus the position of the centre of mass on
    this ray, where 0 is the start of the ray and 1 is the end.
    """
    n = contacts.n_boxes
    middle = np.full((n, 2), np.nan)
    count = np.maximum(contacts.n_supports, 1)
    for axis in range(2):
        centres = (contacts.low_mm[:, axis] + contacts.high_mm[:, axis]) / 2
        middle[:, axis] = np.bincount(contacts.upper, weights=centres, minlength=n) / count
    return 1.0 - hulls.reach(np.arange(n), middle, contacts.centre_mm[:, :2])


class _VerticalSystem:
    """The equations of balance for vertical forces at the corners of contact areas. The slack of a structure (a group
    of boxes connected by contacts) is computed from the equations of its boxes.

    The force at a corner presses the upper box upwards and the lower body downwards. Each box has three equations
    (rows): one for the vertical force, and two for the moments about the box's centre along x and y. The unit of forces
    is the mean weight of the boxes, and the unit of moments is this weight times one metre.
    """

    def __init__(self, contacts: PlanContacts) -> None:
        self._upper = contacts.upper
        self._weight = contacts.mass_kg / contacts.mass_kg.mean()
        self._share = even_share(contacts, self._weight)
        # (2, c) the upper and the lower body of each contact. In ``_body``, CARRIER stands for all bodies without
        # equations: for the carrier, and for boxes with all four corners on the carrier.
        body = np.stack([contacts.upper, contacts.lower])
        self._body = np.where((body == CARRIER) | contacts.grounded[body], CARRIER, body)
        arm = (contacts.corners_mm - contacts.centre_mm[self._body, None, :2]) / MM_PER_M
        # (2, c, 3, 4) coefficients of the corner forces in the equations, indexed by body, contact, equation and corner
        self._value = np.stack([np.ones(arm.shape[:-1]), arm[..., 0], arm[..., 1]], axis=2)
        self._value[1] *= -1

    def slack(self, boxes: IntArray) -> float:
        """The slack of a structure of two or more placed boxes if only vertical forces act."""
        place = np.full(len(self._weight), -1)
        place[boxes] = np.arange(len(boxes))
        chosen = np.flatnonzero(place[self._upper] >= 0)
        body = self._body[:, chosen]
        side, contact = np.nonzero(body != CARRIER)
        value = self._value[side, chosen[contact]]
        row = 3 * place[body[side, contact]][:, None, None] + np.arange(3)[:, None]
        column = 4 * contact[:, None, None] + np.arange(4)
        row, column = np.broadcast_arrays(row, column)
        loads = np.zeros((len(boxes), 3))
        loads[:, 0] = self._weight[boxes]
        forces = Entries(value.ravel(), row.ravel(), column.ravel())
        return largest_slack(forces, np.repeat(self._share[chosen], 4), loads.ravel())


_DIRECTIONS = 5
"""Number of unknown forces at a contact point: one of pressure and four of friction. The forces of friction act in both
directions along two axes that are perpendicular to the pressure."""


class Friction(NamedTuple):
    """Coefficients of friction.

    Attributes:
        flat: coefficient of friction between a box and the box or carrier on which it lies.
        sides: coefficient of friction between boxes that touch side by side.
    """

    flat: float
    sides: float = 0.0


class _Points(NamedTuple):
    """The p points at which bodies touch each other. Each field has one row per point.

    At each point, the pressure on the body ``second`` acts along ``axis``; the pressure on the body ``first`` is
    opposite. ``share`` is the force that a point must carry at a slack of 1, in units of the mean weight of the boxes.
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
    """The slack of a structure (a group of boxes connected by contacts) if forces of friction may act. Boxes that touch
    the structure must also be in balance.

    The friction (fx, fy) at a point is limited by the pyramid |fx| + |fy| ≤ μ f, which is inside the friction cone. So
    a stack that is balanced with the pyramid is also balanced with the cone. In the limit μ f, the force f is not the
    whole pressure at the point, but only its part above the least pressure that the slack requires there (see
    ``structure``). If the limit were computed with the whole pressure, the slack would have the same sign.

    Args:
        structure: (n,) whether each box belongs to the structure. Each contact corner under these boxes must carry at
            least this force: the slack times the force of an even load on the corner (``even_share``).
        newest: number of the box placed last. Later boxes are ignored.
        sides: the places at which boxes may lean on each other or on walls. If ``sides`` is None, boxes may not lean.
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
    row_of = np.append(np.cumsum(boxes) - 1, CARRIER)  # the last entry is for the carrier, whose number is −1
    first, second = row_of[points.first], row_of[points.second]
    centre_m = contacts.centre_mm[boxes] / MM_PER_M
    forces = _columns(
        wrenches(first, second, points.position_m, _directions(points.axis), centre_m), chosen, possible.size
    )
    limits = _columns(_pyramids(points.friction), chosen, possible.size)
    return largest_slack(forces, share.ravel()[chosen], loads.ravel(), limits)


def _columns(entries: Entries, chosen: IntArray, n: int) -> Entries:
    """Those entries of a sparse matrix with n columns that lie in the columns ``chosen``. In the result, the chosen
    columns are numbered from 0."""
    position = np.full(n, -1)
    position[chosen] = np.arange(len(chosen))
    column = position[entries.column]
    is_column = column >= 0
    return Entries(entries.value[is_column], entries.row[is_column], column[is_column])


def _hanging_together(
    contacts: PlanContacts, structure: NDArray[np.bool_], newest: int, sides: Sides | None
) -> NDArray[np.bool_]:
    """(n,) whether each box has been placed and is connected with the structure: by contacts or, if ``sides`` is given,
    by sides that touch. The result is also True for the boxes of the structure."""
    pairs = [np.c_[contacts.upper, contacts.lower]] + ([] if sides is None else [np.c_[sides.first, sides.second]])
    pair = np.concatenate(pairs)
    pair = pair[(pair != CARRIER).all(axis=1) & (pair.max(axis=1) <= newest)]
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
    """The points at which forces act on the given boxes: the corners of the contact areas under these boxes and, if
    ``sides`` is given, the corners of the rectangles at which boxes touch side by side."""
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
        stands = np.append(boxes, True)  # the last entry is for the walls, whose number is CARRIER (−1)
        indices = np.flatnonzero(stands[sides.first] & stands[sides.second])
        ends = (sides.first[indices], sides.second[indices], sides.axis[indices], _side_corners(sides, indices))
        parts.append((*ends, np.zeros(len(indices)), np.full(len(indices), friction.sides)))
    first, second, axis, position, share, mu = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    first, second, axis, share, mu = (np.repeat(column, 4) for column in (first, second, axis, share, mu))
    return _Points(first, second, axis, position.reshape(-1, 3) / MM_PER_M, share, mu)


def _side_corners(sides: Sides, indices: IntArray) -> FloatArray:
    """(s, 4, 3) corners of the vertical rectangles at which boxes touch side by side."""
    corners = np.repeat(sides.low_mm[indices][:, None, :], 4, axis=1)
    far, across = sides.high_mm[indices], 1 - sides.axis[indices]
    rows = np.arange(len(indices))[:, None]
    corners[rows, [[1, 2]], across[:, None]] = far[rows, across[:, None]]
    corners[rows, [[2, 3]], 2] = far[:, 2:]
    return corners


def _directions(axis: IntArray) -> FloatArray:
    """(p, 5, 3) directions of the unknown forces at each point: along the point's axis, then both directions along each
    of the two other axes."""
    unit = np.eye(3)
    along, one, other = unit[axis], unit[(axis + 1) % 3], unit[(axis + 2) % 3]
    return np.stack([along, one, -one, other, -other], axis=1)


def _pyramids(friction: FloatArray) -> Entries:
    """The matrix (p, 5 p) that turns all unknown forces into one number for each of p points: friction minus μ times
    pressure."""
    values = np.ones((len(friction), _DIRECTIONS))
    values[:, 0] = -friction
    return Entries(values.ravel(), np.repeat(np.arange(len(friction)), _DIRECTIONS), np.arange(values.size))
