"""Criteria that look at a box's base alone: how much of it is borne, and how many of its corners."""

from __future__ import annotations

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.statics.contacts import N_CORNERS, IntArray, PlanContacts


def support_share(contacts: PlanContacts) -> FloatArray:
    """(n,) borne area / base area; 0 for a box that lies on nothing.

    Where supports overlap each other, as in illegal plans, shared area counts once.
    """
    area = (contacts.high_mm - contacts.low_mm).prod(axis=1)
    borne = np.bincount(contacts.upper, weights=area, minlength=contacts.n_boxes)
    for box in _with_overlaps(contacts):
        borne[box] = _union_area(contacts, box)
    share: FloatArray = borne / contacts.size_mm[:, :2].prod(axis=1)
    return np.minimum(share, 1.0)


def _with_overlaps(contacts: PlanContacts) -> IntArray:
    """Boxes of which two contact rectangles overlap."""
    if not (contacts.n_supports > 1).any():
        return np.zeros(0, dtype=np.int64)
    same = np.equal.outer(contacts.upper, contacts.upper)
    for axis in range(2):
        low, high = contacts.low_mm[:, axis], contacts.high_mm[:, axis]
        same &= np.minimum.outer(high, high) > np.maximum.outer(low, low)
    return np.unique(contacts.upper[np.triu(same, k=1).any(axis=1)])


def _union_area(contacts: PlanContacts, box: int) -> float:
    import shapely

    box_contacts = contacts.upper == box
    return float(
        shapely.union_all(shapely.box(*contacts.low_mm[box_contacts].T, *contacts.high_mm[box_contacts].T)).area
    )


def corners_supported(contacts: PlanContacts) -> IntArray:
    """(n,) how many of the four bottom corners lie on something, within the tolerance; edges count."""
    count: IntArray = contacts.borne_corners(np.ones(len(contacts.upper), dtype=bool)).sum(axis=1)
    return count


def corner_and_area_slack(share: FloatArray, corners: IntArray, least: tuple[float, float, float]) -> FloatArray:
    """(n,) the share by which the borne area exceeds what is asked with so many corners.

    Args:
        least: shares asked for with four corners, with three, and with fewer.
    """
    four, three, fewer = least
    least_share: FloatArray = np.select([corners >= N_CORNERS, corners == N_CORNERS - 1], [four, three], fewer)
    return share - least_share
