"""The linear programme of force balance: the largest slack for which forces balance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from petmjx.errors import PetmjxError
from petmjx.statics.contacts import Contacts
from petmjx.units import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csc_array

_INFEASIBLE: Final = 2
"""SciPy's status of a programme without a solution."""

EVEN: Final = 1.0
"""The largest slack there is: all corners carry alike."""


def even_share(contacts: Contacts, weight: FloatArray) -> FloatArray:
    """(c,) what each corner of a contact is asked to carry per slack: the box's weight over its number of corners."""
    share: FloatArray = weight[contacts.upper] / (4 * contacts.n_supports[contacts.upper])
    return share


def largest_slack(
    forces: FloatArray | csc_array, share: FloatArray, wanted: FloatArray, limits: csc_array | None = None
) -> float:
    """The largest s ≤ ``EVEN`` for which ``forces @ (share·s + g) = wanted``, with g ≥ 0 and ``limits @ g ≤ 0``.

    Solved by HiGHS. SciPy's ``milp`` without whole numbers is the same programme as ``linprog``, at half the overhead.

    Args:
        forces: (r, f) what each force adds to each row.
        share: (f,) what each force has to carry per slack.
        wanted: (r,) what the rows must add up to.
        limits: (q, f).

    Returns:
        −inf where no s is small enough.

    Raises:
        PetmjxError: HiGHS gave up.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csc_array, hstack, issparse

    by_slack = (forces @ share)[:, None]
    stacked = hstack([forces, csc_array(by_slack)], format="csc") if issparse(forces) else np.c_[forces, by_slack]
    constraints = [LinearConstraint(stacked, wanted, wanted)]
    if limits is not None:
        rows = limits.shape[0]
        constraints.append(LinearConstraint(hstack([limits, csc_array((rows, 1))], format="csc"), ub=np.zeros(rows)))
    least = np.zeros(len(share) + 1)
    least[-1] = -np.inf
    most = np.full(len(share) + 1, np.inf)
    most[-1] = EVEN
    cost = np.zeros(len(share) + 1)
    cost[-1] = -1.0
    found = milp(cost, constraints=constraints, bounds=Bounds(least, most))
    if found.status == _INFEASIBLE:
        return -np.inf
    if found.x is None:
        raise PetmjxError(f"HiGHS has no answer to a force balance of {forces.shape[0]} rows: {found.message}")
    return float(found.x[-1])
