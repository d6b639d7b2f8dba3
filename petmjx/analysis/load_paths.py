"""Criteria of static stability that pass loads down from box to box. docs/criteria.md explains the criteria.

The criteria determine whether the resultant of a box's weight and of the loads on the box acts over the box's supports.
Each box is checked when it is placed, and all boxes below it are checked again. The criteria differ in the rule by
which a box distributes its weight and the load on its top over its supports:

- **lever rule** (criterion ``stacking_tree``): forces at the middles of the contact areas. Source: Zhao, Zhu, Xu,
  Huang, Xu (2022), "Learning practically feasible policies for online 3D bin packing", Science China Information
  Sciences 65, arXiv 2108.13680. If the load acts beyond the middle of the outermost contact area, the lever rule gives
  a negative force on another support.
- **even bedding** (criterion ``equilibrium``): a pressure that is a linear function of x and y. Source of the
  criterion: Ramos, Oliveira, Gonçalves, Lopes (2016), "A container loading algorithm with static mechanical equilibrium
  stability constraints", Transportation Research Part B 91, 565-581. The even bedding is petmjx's choice.

In both rules, forces are linear in the load. So the weight of each box is passed down separately, and the load on a box
after any placement is a sum over the boxes placed so far. Real supports cannot pull: if the pressure of an even bedding
would be negative somewhere, petmjx.world.pushing_forces gives the forces. If a resultant of the even bedding lies
beyond an edge, petmjx.world.balanced_loads determines whether other balancing forces keep all resultants inside the
edges.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from petmjx.analysis.plan_contacts import Hulls, IntArray, PlanContacts
from petmjx.common.units import MM_PER_M, STANDARD_GRAVITY, FloatArray
from petmjx.world.bearings import Bearing, Boxes
from petmjx.world.building_edges import BuildingLoads, balanced_after, building_loads_of, depends_on_sharing
from petmjx.world.history import CARRIER

Sharing = Callable[[PlanContacts], FloatArray]
"""Function that computes a matrix (3, 3) for each of c contacts, as an array (c, 3, 3). The matrix turns the load of
the upper box into the part of this load that the lower body bears. A load is a vector (mass, mass × x, mass × y) in kg
and kg·mm."""


_SAME: Final = 1e-9
"""Largest relative difference between two loads that counts as a rounding error."""


def equilibrium_slack(contacts: PlanContacts, hulls: Hulls) -> FloatArray:
    """(n,) slack of each box, computed as by ``load_slack``, if each box lies on a bed of equal springs (an even
    bedding) and supports can only push. If this slack is negative, but other balancing forces keep all resultants
    inside the edges, the slack of these other forces is used.

    Other forces are considered, since the assumed bedding may be the only reason why a load acts beyond an edge. So
    after each placement with a load beyond an edge, a linear programme searches for forces that keep all loads inside
    the edges. If the programme finds such forces, the box passes. If the programme finds no such forces, the search is
    not repeated after later placements. For a placement without a search, the slack comes from the bed of equal
    springs.
    """
    bearing = bearing_of(contacts)
    built = building_loads_of(bearing, [contacts.n_boxes])
    slack = load_slack(contacts, hulls, even_bedding, built if _pulls(contacts, built) else None)
    edge_mm = built.edge_m * MM_PER_M
    open_ = (edge_mm < 0) & depends_on_sharing(bearing, built)
    surely = np.isin(built.step, built.step[(edge_mm < 0) & ~open_])
    failed = False
    for step in np.unique(built.step[open_ & ~surely]).tolist():
        if failed:
            break
        last, balanced_m = balanced_after(bearing, built, step)
        failed = bool((balanced_m < 0).any())
        changed = built.box[last[built.step[last] == step]]
        least_m = balanced_m.min(where=~np.isnan(balanced_m), initial=np.inf) if failed else balanced_m[changed].min()
        slack[step] = MM_PER_M * least_m
    return slack


def load_slack(
    contacts: PlanContacts, hulls: Hulls, sharing: Sharing, pushed: BuildingLoads | None = None
) -> FloatArray:
    """(n,) for each box, the smallest distance of a load from the edge of the hull of its contact areas, just after the
    box has been placed, mm: positive inside the hull, negative outside.

    A load is the resultant of a box's own weight and of the loads on the box. The distance is computed for the placed
    box and for all boxes that bear a part of its weight. The value is NaN if one of these boxes has no support or is
    lifted.

    Args:
        pushed: the loads for supports that can only push. ``pushed`` is needed if some supports would pull according to
            ``sharing``.
    """
    on_box = _loads_on_boxes(contacts, sharing)
    bears = on_box.any(axis=-1)
    load = on_box.cumsum(axis=1)
    if pushed is not None:
        load[pushed.box, pushed.step] = pushed.load * (1.0, MM_PER_M, MM_PER_M)
    below, placed = np.nonzero(bears)
    total = load[below, placed]
    with np.errstate(divide="ignore", invalid="ignore"):
        point = np.where(total[:, :1] > 0, total[:, 1:] / total[:, :1], np.nan)
    distance = hulls.distance(below, point)
    slack = np.full(contacts.n_boxes, np.inf)
    with np.errstate(invalid="ignore"):
        np.minimum.at(slack, placed, distance)  # without a warning, a NaN among the distances makes the minimum NaN
    return slack


def strength_slack(contacts: PlanContacts, strength_n: FloatArray | None, sharing: Sharing) -> FloatArray:
    """(n,) the smallest value of 1 − load / strength just after each box has been placed, among this box and all boxes
    that bear a part of its weight. The value is NaN if the placed box lies on nothing.

    Args:
        strength_n: (n,) largest force that the top of each box can bear, N; NaN if unknown. If ``strength_n`` is None,
            all strengths are unknown. A box of unknown strength can bear any load.
    """
    slack = np.where(contacts.n_supports > 0, 1.0, np.nan)
    if strength_n is None:
        return slack
    on_box = _loads_on_boxes(contacts, sharing)[..., 0]
    bears, boxes = on_box != 0, np.arange(contacts.n_boxes)
    on_box[boxes, boxes] = 0.0  # the diagonal has the boxes' own weights, which do not press on their own tops
    borne = on_box.cumsum(axis=1)
    built = building_loads_of(bearing_of(contacts), [contacts.n_boxes]) if sharing is even_bedding else None
    if built is not None and _pulls(contacts, built):
        borne[built.box, built.step] = built.load[:, 0] - contacts.mass_kg[built.box]
    left = 1.0 - STANDARD_GRAVITY * borne / strength_n[:, None]
    below, placed = np.nonzero(bears & ~np.isnan(strength_n)[:, None])
    np.minimum.at(slack, placed, left[below, placed])
    return slack


def _loads_on_boxes(contacts: PlanContacts, sharing: Sharing) -> FloatArray:
    """(n, n, 3) the part of the weight of box m (second index) that box j (first index) bears, as a vector (mass, mass
    × x, mass × y) in kg and kg·mm. A box also bears its own weight."""
    n = contacts.n_boxes
    on_box = np.zeros((n, n, 3))
    weights = contacts.mass_kg[:, None] * np.c_[np.ones(n), contacts.centre_mm[:, :2]]
    on_box[np.arange(n), np.arange(n)] = weights
    share = sharing(contacts)
    # The loop runs from the last contact to the first. Contacts are sorted by their upper box, and each box is placed
    # after its supports, so the load of a box is complete before the loop passes it down.
    for contact in range(len(contacts.upper) - 1, -1, -1):
        lower = contacts.lower[contact]
        if lower != CARRIER:
            on_box[lower] += on_box[contacts.upper[contact]] @ share[contact].T
    return on_box


def bearing_of(contacts: PlanContacts) -> Bearing:
    """The contacts of a plan, converted to metres and to the form in which petmjx.world.pushing_forces needs them."""
    n = contacts.n_boxes
    half = contacts.size_mm / 2
    middle = contacts.corner_mm + half
    boxes = Boxes(
        np.array([0, n]),
        middle / MM_PER_M,
        half / MM_PER_M,
        contacts.mass_kg,
        (contacts.centre_mm - middle) / MM_PER_M,
        np.full(n, np.inf),
        np.zeros((n, 2, 2)),
    )
    low, high = contacts.low_mm / MM_PER_M, contacts.high_mm / MM_PER_M
    return Bearing(boxes, contacts.upper, contacts.lower, low, high)


def _pulls(contacts: PlanContacts, built: BuildingLoads) -> bool:
    """Whether an even bedding (a pressure that is linear in x and y) would make any support pull after any placement.
    If so, the loads of the even bedding differ from ``built``, the loads for supports that can only push."""
    linear = _loads_on_boxes(contacts, even_bedding).cumsum(axis=1)[built.box, built.step]
    pushed = built.load * (1.0, MM_PER_M, MM_PER_M)
    return not np.allclose(linear, pushed, rtol=_SAME, atol=_SAME * np.abs(pushed).max(initial=0.0))


def lever_rule(contacts: PlanContacts) -> FloatArray:
    """(c, 3, 3) the matrices of ``Sharing`` for the lever rule: a box presses on each support with a force at the
    middle of the contact area."""
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
    """(c, 3, 3) the matrices of ``Sharing`` for the even bedding: the pressure varies linearly over all areas on which
    the upper box lies."""
    upper = contacts.upper
    # Positions are measured from the upper box's centre, in units of the box's length and width. In these units, the 3
    # × 3 systems of equations are well conditioned.
    origin, scale = contacts.centre_mm[upper, :2], contacts.size_mm[upper, :2]
    moments = _area_moments((contacts.low_mm - origin) / scale, (contacts.high_mm - origin) / scale)
    total_moments = _sums(moments, upper, contacts.n_boxes)[upper]
    share = moments @ np.linalg.inv(total_moments)
    to_global = np.zeros_like(share)
    to_global[:, 0, 0] = 1.0
    to_global[:, 1:, 0] = origin
    to_global[:, [1, 2], [1, 2]] = scale
    passed: FloatArray = to_global @ share @ np.linalg.inv(to_global)
    return passed


def _area_moments(low: FloatArray, high: FloatArray) -> FloatArray:
    """(c, 3, 3) for each of c rectangles, the integral of (1, x, y) ⊗ (1, x, y) over its area."""
    length = high - low
    area = length.prod(axis=1)
    middle = np.c_[np.ones(len(area)), (low + high) / 2]
    moments: FloatArray = area[:, None, None] * middle[:, :, None] * middle[:, None, :]
    moments[:, [1, 2], [1, 2]] += area[:, None] * length**2 / 12
    return moments


def _sums(values: FloatArray, owner: IntArray, n: int) -> FloatArray:
    """(n, …) the sum of the values of each of n owners, such as boxes. ``owner`` has the owner of each value."""
    sums = np.zeros((n, *values.shape[1:]))
    np.add.at(sums, owner, values)
    return sums
