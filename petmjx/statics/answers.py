"""What the criteria say of one plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.plans.plan import Plan
from petmjx.statics.asked import Asked
from petmjx.statics.balance import NO_SLACK
from petmjx.statics.contacts import IntArray, find_contacts
from petmjx.statics.friction import Friction
from petmjx.statics.hulls import ON_EDGE_MM
from petmjx.statics.named import LEANING, Criterion

YES: Final = 1
NO: Final = 0
NOT_ASKED: Final = -1

_ROUNDING: Final = {"mm": ON_EDGE_MM, "1": -NO_SLACK}
"""Slacks this far below 0 are 0, by unit. Shares of areas in mm² have rounding errors of 1e-16."""


@dataclass(frozen=True, eq=False)
class Answers:
    """What c criteria say of n boxes at their placement.

    Attributes:
        n_supports: (n,) areas on which a box lies (``PlanContacts.n_supports``).
        share: (n,) borne share of the base.
        corners: (n,) bottom corners that lie on something.
        slack: (n, c) NaN where there is none.
        stable: (n, c) ``YES``, ``NO``, or ``NOT_ASKED``: force balance ends with the first box that fails.
    """

    n_supports: IntArray
    share: FloatArray
    corners: IntArray
    slack: FloatArray
    stable: NDArray[np.int8]


def answer(
    plan: Plan,
    criteria: Sequence[Criterion],
    friction: Friction,
    tolerance_mm: float,
    deck_mm: FloatArray | None = None,
) -> Answers:
    """Ask the criteria of one plan.

    Args:
        friction: coefficients, for force balance.
        tolerance_mm, deck_mm: see ``petmjx.statics.contacts.find_contacts``.
    """
    contacts = find_contacts(plan, tolerance_mm, deck_mm)
    inputs = Asked(contacts, friction, any(criterion.name == LEANING for criterion in criteria), plan.strength_n)
    slacks = [criterion.slack_of(inputs) for criterion in criteria]
    stable = [_stable(slack, criterion) for slack, criterion in zip(slacks, criteria, strict=True)]
    return Answers(
        contacts.n_supports, inputs.share, inputs.corners, np.stack(slacks, axis=1), np.stack(stable, axis=1)
    )


def _stable(slack: FloatArray, criterion: Criterion) -> NDArray[np.int8]:
    """Yes or no by the sign of the slack. NaN is no; what comes after an end was not asked."""
    rounding = _ROUNDING[criterion.unit]
    stable = (slack > rounding if criterion.strict else slack >= -rounding).astype(np.int8)
    if criterion.ends:
        stable[np.logical_or.accumulate(np.r_[False, stable[:-1] == NO])] = NOT_ASKED
    return stable
