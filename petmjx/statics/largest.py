"""The linear programme of force balance: the largest slack for which forces balance."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from petmjx.errors import PetmjxError
from petmjx.statics.contacts import Contacts, IntArray
from petmjx.units import FloatArray

_INFEASIBLE: Final = 2
"""SciPy's status of a programme without a solution."""

EVEN: Final = 1.0
"""The largest slack there is: all corners carry alike."""


class Entries(NamedTuple):
    """The entries of a sparse matrix that are not 0: (k,) each."""

    value: FloatArray
    row: IntArray
    column: IntArray


def even_share(contacts: Contacts, weight: FloatArray) -> FloatArray:
    """(c,) what each corner of a contact is asked to carry per slack: the box's weight over its number of corners."""
    share: FloatArray = weight[contacts.upper] / (4 * contacts.n_supports[contacts.upper])
    return share


def largest_slack(forces: Entries, share: FloatArray, wanted: FloatArray, limits: Entries | None = None) -> float:
    """The largest s ≤ ``EVEN`` for which ``forces @ (share·s + g) = wanted``, with g ≥ 0 and ``limits @ g ≤ 0``.

    Solved by HiGHS. SciPy's ``milp`` without whole numbers is the same programme as ``linprog``, at half the overhead.

    Args:
        forces: (r, f) what each force adds to each row.
        share: (f,) what each force has to carry per slack.
        wanted: (r,) what the rows must add up to.
        limits: (q, f); None: there are none.

    Returns:
        −inf where no s is small enough.

    Raises:
        PetmjxError: HiGHS gave up.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csc_array

    rows, n_forces = len(wanted), len(share)
    by_slack = np.zeros(rows)
    np.add.at(by_slack, forces.row, forces.value * share[forces.column])
    # s is the last column
    parts = [forces, Entries(by_slack, np.arange(rows), np.full(rows, n_forces))]
    n_limits = 0
    if limits is not None:
        parts.append(limits._replace(row=limits.row + rows))
        n_limits = int(limits.row.max(initial=-1)) + 1
    value, row, column = (np.concatenate(entries) for entries in zip(*parts, strict=True))
    matrix = csc_array((value, (row, column)), shape=(rows + n_limits, n_forces + 1))
    least = np.r_[wanted, np.full(n_limits, -np.inf)]
    found = milp(
        np.r_[np.zeros(n_forces), -1.0],
        constraints=LinearConstraint(matrix, least, np.r_[wanted, np.zeros(n_limits)]),
        bounds=Bounds(np.r_[np.zeros(n_forces), -np.inf], np.r_[np.full(n_forces, np.inf), EVEN]),
    )
    if found.status == _INFEASIBLE:
        return -np.inf
    if found.x is None:
        raise PetmjxError(f"HiGHS has no answer to a force balance of {rows} rows: {found.message}")
    return float(found.x[-1])
