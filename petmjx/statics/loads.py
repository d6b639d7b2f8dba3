"""Criteria that pass loads down: the resultant of a box's weight and of the loads above stays over what bears it.

Both criteria ask each box at its placement, and all below it again. They differ in how a load is shared out:

- **lever rule** (the stacking tree): each support gets a force at the middle of its contact area. Two share by the
  lever rule; of more, forces of least squares that balance force and moments. Source: Zhao, Zhu, Xu, Huang, Xu (2022),
  "Learning practically feasible policies for online 3D bin packing", Science China Information Sciences 65, arXiv
  2108.13680. A load beyond the last support's middle lifts the other ones, as levers do.
- **even bedding** (mechanical equilibrium): the pressure on the contact areas varies linearly, which balances force and
  moments exactly and has the same answer for any number of supports. Source of the criterion: Ramos, Oliveira,
  Gonçalves, Lopes (2016), "A container loading algorithm with static mechanical equilibrium stability constraints",
  Transportation Research Part B 91, 565-581. Force and moment balance alone do not say how more than two supports
  share; the bedding is ours. (Public re-implementations let each box directly above press with its whole weight, and
  pass nothing further.)

Both are linear in the load. So each box's weight is passed down alone, and the load on a box after any placement is a
sum over the boxes placed so far.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from petmjx.basics.units import STANDARD_GRAVITY, FloatArray
from petmjx.history import CARRIER
from petmjx.statics.contacts import IntArray, PlanContacts
from petmjx.statics.hulls import Hulls

Sharing = Callable[[PlanContacts], FloatArray]
"""From contacts to (c, 3, 3) matrices: load of the upper box (mass, mass × x, mass × y) → that on the lower body, kg
and kg·mm."""


def load_slack(contacts: PlanContacts, hulls: Hulls, sharing: Sharing) -> FloatArray:
    """(n,) how far resultants are inside the edges of the contact hulls after each box's placement, mm.

    It is the least of the box's own and of those of all boxes that bear part of it. NaN where one of these lies on
    nothing, or is lifted.
    """
    on_box = _passed_down(contacts, sharing)
    bears = on_box.any(axis=-1)
    load = on_box.cumsum(axis=1)
    below, placed = np.nonzero(bears)
    total = load[below, placed]
    with np.errstate(divide="ignore", invalid="ignore"):
        point = np.where(total[:, :1] > 0, total[:, 1:] / total[:, :1], np.nan)
    distance = hulls.distance(below, point)
    slack = np.full(contacts.n_boxes, np.inf)
    with np.errstate(invalid="ignore"):
        np.minimum.at(slack, placed, distance)  # NaN wins
    return slack


def strength_slack(contacts: PlanContacts, strength_n: FloatArray | None, sharing: Sharing) -> FloatArray:
    """(n,) the least 1 − load / strength after each box's placement, of it and of all boxes that bear part of it; NaN
    where it lies on nothing.

    Args:
        strength_n: (n,) what a box bears on its top, N; NaN, or None for all: it is not known, and nothing is too much.
    """
    slack = np.where(contacts.n_supports > 0, 1.0, np.nan)
    if strength_n is None:
        return slack
    on_box = _passed_down(contacts, sharing)[..., 0]
    bears, boxes = on_box != 0, np.arange(contacts.n_boxes)
    on_box[boxes, boxes] = 0.0  # its own weight is none of what it bears on its top
    left = 1.0 - STANDARD_GRAVITY * on_box.cumsum(axis=1) / strength_n[:, None]
    below, placed = np.nonzero(bears & ~np.isnan(strength_n)[:, None])
    np.minimum.at(slack, placed, left[below, placed])
    return slack


def _passed_down(contacts: PlanContacts, sharing: Sharing) -> FloatArray:
    """(n, n, 3): what box j (row) bears of the weight of box m (column), as (kg, kg·mm, kg·mm); its own included."""
    n = contacts.n_boxes
    on_box = np.zeros((n, n, 3))
    own = contacts.mass_kg[:, None] * np.c_[np.ones(n), contacts.centre_mm[:, :2]]
    on_box[np.arange(n), np.arange(n)] = own
    share = sharing(contacts)
    # contacts are in the order of the boxes above, and supports are placed earlier: from the last box down
    for contact in range(len(contacts.upper) - 1, -1, -1):
        lower = contacts.lower[contact]
        if lower != CARRIER:
            on_box[lower] += on_box[contacts.upper[contact]] @ share[contact].T
    return on_box


def lever_rule(contacts: PlanContacts) -> FloatArray:
    """(c, 3, 3): a force at the middle of each contact area."""
    upper, n = contacts.upper, contacts.n_boxes
    middle = (contacts.low_mm + contacts.high_mm) / 2
    count = np.maximum(contacts.n_supports, 1)
    mean = _sums(middle, upper, n) / count[:, None]
    arm = middle - mean[upper]
    inverse = np.linalg.pinv(_sums(arm[:, :, None] * arm[:, None, :], upper, n), hermitian=True)
    by_moment = np.einsum("cij,cj->ci", inverse[upper], arm)
    by_mass = 1.0 / count[upper] - (by_moment * mean[upper]).sum(axis=1)
    force = np.c_[by_mass, by_moment]
    acts_at = np.c_[np.ones(len(upper)), middle]
    share: FloatArray = acts_at[:, :, None] * force[:, None, :]
    return share


def even_bedding(contacts: PlanContacts) -> FloatArray:
    """(c, 3, 3): pressure that varies linearly over all contact areas of the box above."""
    upper = contacts.upper
    # about the upper box's centre and in its lengths, which keeps the 3 × 3 systems well conditioned
    origin, scale = contacts.centre_mm[upper, :2], contacts.size_mm[upper, :2]
    moments = _area_moments((contacts.low_mm - origin) / scale, (contacts.high_mm - origin) / scale)
    whole = _sums(moments, upper, contacts.n_boxes)[upper]
    share = moments @ np.linalg.inv(whole)
    to_global = np.zeros_like(share)
    to_global[:, 0, 0] = 1.0
    to_global[:, 1:, 0] = origin
    to_global[:, [1, 2], [1, 2]] = scale
    passed: FloatArray = to_global @ share @ np.linalg.inv(to_global)
    return passed


def _area_moments(low: FloatArray, high: FloatArray) -> FloatArray:
    """(c, 3, 3) integrals of (1, x, y) ⊗ (1, x, y) over rectangles."""
    length = high - low
    area = length.prod(axis=1)
    middle = np.c_[np.ones(len(area)), (low + high) / 2]
    moments: FloatArray = area[:, None, None] * middle[:, :, None] * middle[:, None, :]
    moments[:, [1, 2], [1, 2]] += area[:, None] * length**2 / 12
    return moments


def _sums(values: FloatArray, owner: IntArray, n: int) -> FloatArray:
    """(n, …) sums of the values of each owner."""
    sums = np.zeros((n, *values.shape[1:]))
    np.add.at(sums, owner, values)
    return sums
