"""Force balance: whether forces exist that hold a stack, and how much is left.

Sources: Liu, Deng, Wang, Liu, Liu (2024), "StableLego: stability analysis of block stacking assembly", arXiv
2402.10711, and Whiting, Ochsendorf, Durand (2009), "Procedural modeling of structurally-sound masonry buildings", ACM
Transactions on Graphics 28(5). At each corner of each contact area there is a force that presses, and friction of at
most μ times that force. A stack is balanced if there are such forces whose sum and moment are zero on every box.

The slack is a pure number. Let each of the n corners under a box be asked to carry at least s times the n-th part of
the box's own weight; the slack is the largest s for which the stack is balanced. With 1 every box rests on all its
corners alike; with 0 some box is about to tip; below 0 it would have to be glued, and -s tells how strongly. For a box
with nothing on it the slack is 1 less how far its centre is on the way from the middle of the corners to the hull's
edge.

After each placement only what hangs together with the new box can change: its structure. Three things are used, each
exact:

- A box that has all four corners on the carrier is in balance whatever presses on its top: vertical forces there always
  have an answer below. It is taken as part of the carrier, and separates structures.
- Vertical forces that balance are forces that balance. So friction, and with it horizontal forces and heights, is
  looked at only where there are no such forces. It may then help: a box is held by what lies across it and its
  neighbour. The slack is then that with friction, if it is larger.
- A structure of one box has the closed form above, without a linear programme.

Boxes that touch side by side may lean on each other: press, by default without friction. Forces that merely exist are
not forces that come about: with friction at its sides any box could hang between two neighbours that press on it,
though nothing makes them press when it is set down.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import MM_PER_M, FloatArray
from petmjx.history import CARRIER
from petmjx.statics.contacts import IntArray, PlanContacts, Sides, find_sides
from petmjx.statics.friction import Friction, friction_slack
from petmjx.statics.hulls import Hulls
from petmjx.statics.largest import Entries, even_share, largest_slack

NO_SLACK: Final = -1e-6
"""Slacks from here on are balanced: the solver's own tolerance is 1e-7 of the mean weight."""


def balance_slack(
    contacts: PlanContacts, hulls: Hulls, friction: Friction, lean: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Slack of each box's structure just after its placement, without and with leaning on neighbours: twice (n,).

    Each ends with the first box after which the stack is not balanced: later ones are NaN. NaN is also a box that lies
    on nothing; it is not balanced, though friction at its sides could hold it if its neighbours pressed on it.

    Args:
        friction: coefficients.
        lean: whether boxes may press on neighbours that they touch side by side; without it the second answer is NaN.
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
    """One way to balance a stack, placement by placement, until it fails."""

    def __init__(self, contacts: PlanContacts, friction: Friction, sides: Sides | None = None) -> None:
        self.slack = np.full(contacts.n_boxes, np.nan)
        self.balanced = True
        self._contacts, self._friction, self._sides = contacts, friction, sides

    def place(self, box: int, vertical: float, structures: _Structures) -> None:
        """Put a box down, where vertical forces alone have a slack."""
        slack = vertical
        if slack < NO_SLACK:
            structure = structures.of(box)
            slack = max(slack, friction_slack(self._contacts, structure, box, self._friction, self._sides))
        self.slack[box] = slack
        self.balanced = slack >= NO_SLACK


class _Structures:
    """The boxes placed so far that hang together, boxes on the carrier apart."""

    def __init__(self, contacts: PlanContacts, hulls: Hulls) -> None:
        self._contacts = contacts
        self._alone = _slack_alone(contacts, hulls)
        self._joined = np.arange(contacts.n_boxes)
        self._starts = np.searchsorted(contacts.upper, np.arange(contacts.n_boxes + 1))
        self._grounded = contacts.grounded
        self._system = _VerticalSystem(contacts)

    def of(self, box: int) -> NDArray[np.bool_]:
        """(n,) which boxes hang together with this one."""
        joined: NDArray[np.bool_] = self._joined == self._joined[box]
        return joined

    def with_box(self, box: int) -> float:
        """Slack of the box's structure by vertical forces, after it has been placed."""
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
    """(n,) slack of each box with nothing on it."""
    n = contacts.n_boxes
    middle = np.full((n, 2), np.nan)
    count = np.maximum(contacts.n_supports, 1)
    for axis in range(2):
        centres = (contacts.low_mm[:, axis] + contacts.high_mm[:, axis]) / 2
        middle[:, axis] = np.bincount(contacts.upper, weights=centres, minlength=n) / count
    return 1.0 - hulls.reach(np.arange(n), middle, contacts.centre_mm[:, :2])


class _VerticalSystem:
    """Force and moments of every box by the vertical forces at corners, of which structures take parts.

    Each corner of a contact presses the box above upwards and the body below downwards. Rows of a box are its force and
    two moments about its own centre, in mean weights and metres.
    """

    def __init__(self, contacts: PlanContacts) -> None:
        self._upper = contacts.upper
        self._weight = contacts.mass_kg / contacts.mass_kg.mean()
        self._share = even_share(contacts, self._weight)
        # (2, c) the bodies that must balance: neither the carrier nor boxes on it
        body = np.stack([contacts.upper, contacts.lower])
        self._body = np.where((body == CARRIER) | contacts.grounded[body], CARRIER, body)
        arm = (contacts.corners_mm - contacts.centre_mm[self._body, None, :2]) / MM_PER_M
        # (2, c, 3, 4) by body, contact, row and corner
        self._value = np.stack([np.ones(arm.shape[:-1]), arm[..., 0], arm[..., 1]], axis=2)
        self._value[1] *= -1

    def slack(self, boxes: IntArray) -> float:
        """The largest slack of a structure of several boxes, all placed."""
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
