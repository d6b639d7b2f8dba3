"""The linear programmes of force balance: the largest slack for which forces balance, and the least and the most of a
sum of forces that balance."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from petmjx.basics.errors import PetmjxError
from petmjx.basics.units import FloatArray
from petmjx.statics.contacts import IntArray, PlanContacts

_INFEASIBLE: Final = 2
"""SciPy's status of a programme without a solution."""

EVEN: Final = 1.0
"""The largest slack there is: all corners carry alike."""


class Entries(NamedTuple):
    """The entries of a sparse matrix that are not 0: (k,) each."""

    value: FloatArray
    row: IntArray
    column: IntArray


def even_share(contacts: PlanContacts, weight: FloatArray) -> FloatArray:
    """(c,) what each corner of a contact is asked to carry per slack: the box's weight over its number of corners."""
    share: FloatArray = weight[contacts.upper] / (4 * contacts.n_supports[contacts.upper])
    return share


def largest_slack(forces: Entries, share: FloatArray, row_sums: FloatArray, limits: Entries | None = None) -> float:
    """The largest s ≤ ``EVEN`` for which ``forces @ (share·s + g) = wanted``, with g ≥ 0 and ``limits @ g ≤ 0``.

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
    rows, n_forces = len(row_sums), len(share)
    by_slack = np.zeros(rows)
    np.add.at(by_slack, forces.row, forces.value * share[forces.column])
    # s is the last column
    parts = [forces, Entries(by_slack, np.arange(rows), np.full(rows, n_forces))]
    n_limits = 0
    if limits is not None:
        parts.append(limits._replace(row=limits.row + rows))
        n_limits = int(limits.row.max(initial=-1)) + 1
    value, row, column = (np.concatenate(entries) for entries in zip(*parts, strict=True))
    least = np.r_[row_sums, np.full(n_limits, -np.inf)]
    solution = _minimised(
        np.r_[np.zeros(n_forces), -1.0],
        Entries(value, row, column),
        (least, np.r_[row_sums, np.zeros(n_limits)]),
        (np.r_[np.zeros(n_forces), -np.inf], np.r_[np.full(n_forces, np.inf), EVEN]),
    )
    return -np.inf if solution is None else float(solution[-1])


def least_and_most(sums: FloatArray, forces: Entries, row_sums: FloatArray) -> FloatArray | None:
    """The least and the most of several sums of forces g ≥ 0 with ``forces @ g = wanted``.

    Args:
        sums: (m, f) factors of the forces in each sum.
        forces: (r, f) what each force adds to each row.
        wanted: (r,) what the rows must add up to.

    Returns:
        (m, 2), or None where no forces balance.

    Raises:
        PetmjxError: HiGHS gave up, or a sum has no bound.
    """
    bounds = (np.zeros(sums.shape[1]), np.full(sums.shape[1], np.inf))
    extremes = np.empty((len(sums), 2))
    for number, factors in enumerate(sums):
        for side, sign in enumerate((1.0, -1.0)):
            balanced = _minimised(sign * factors, forces, (row_sums, row_sums), bounds)
            if balanced is None:
                return None
            extremes[number, side] = factors @ balanced
    return extremes


def _minimised(
    costs: FloatArray, entries: Entries, rows: tuple[FloatArray, FloatArray], bounds: tuple[FloatArray, FloatArray]
) -> FloatArray | None:
    """The x of least ``costs @ x`` whose rows and values lie within bounds; None where there is none.

    Solved by HiGHS. SciPy's ``milp`` without whole numbers is the same programme as ``linprog``, at half the overhead.

    Raises:
        PetmjxError: HiGHS gave up.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csc_array

    matrix = csc_array((entries.value, (entries.row, entries.column)), shape=(len(rows[0]), len(costs)))
    solution = milp(costs, constraints=LinearConstraint(matrix, *rows), bounds=Bounds(*bounds))
    if solution.status == _INFEASIBLE:
        return None
    if solution.x is None:
        raise PetmjxError(f"HiGHS has no answer to a force balance of {len(rows[0])} rows: {solution.message}")
    answer: FloatArray = solution.x
    return answer
