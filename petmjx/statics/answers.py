"""What the criteria say of one plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.plans.plan import Plan
from petmjx.statics.balance import NO_SLACK, balance_slack
from petmjx.statics.base import corner_and_area_slack, corners_supported, support_share
from petmjx.statics.contacts import IntArray, PlanContacts, find_contacts
from petmjx.statics.friction import Friction
from petmjx.statics.hulls import ON_EDGE_MM, Hulls, contact_hulls
from petmjx.statics.load_polygon import load_polygon_slack
from petmjx.statics.loads import even_bedding, lever_rule, load_slack, strength_slack
from petmjx.statics.named import (
    CORNER_AREA_CODE,
    CORNER_AREA_PAPER,
    LEAST_CORNERS,
    STRENGTH,
    SUPPORT_SHARES,
    Criterion,
)
from petmjx.units import FloatArray

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
    share, corners = support_share(contacts), corners_supported(contacts)
    wanted = {criterion.name for criterion in criteria}
    found = _base_slacks(share, corners) | _stack_slacks(contacts, wanted, friction, plan.strength_n)
    slack = np.stack([found[criterion.name] for criterion in criteria], axis=1)
    stable = np.stack([_stable(found[criterion.name], criterion) for criterion in criteria], axis=1)
    return Answers(contacts.n_supports, share, corners, slack, stable)


def _base_slacks(share: FloatArray, corners: IntArray) -> dict[str, FloatArray]:
    """Slacks of the criteria that need nothing but these two."""
    slacks = {f"support_{100 * least:.0f}": share - least for least in SUPPORT_SHARES}
    slacks["three_corners"] = (corners - LEAST_CORNERS).astype(np.float64)
    slacks["corner_area_paper"] = corner_and_area_slack(share, corners, CORNER_AREA_PAPER)
    slacks["corner_area_code"] = corner_and_area_slack(share, corners, CORNER_AREA_CODE)
    return slacks


def _stack_slacks(
    contacts: PlanContacts, wanted: set[str], friction: Friction, strength_n: FloatArray | None
) -> dict[str, FloatArray]:
    """Slacks of those other criteria that are wanted."""
    hulls = contact_hulls(contacts)
    slacks = {}
    if "centre" in wanted:
        slacks["centre"] = _centre_slack(contacts, hulls)
    if "load_polygon" in wanted:
        slacks["load_polygon"] = load_polygon_slack(contacts)
    if "stacking_tree" in wanted:
        slacks["stacking_tree"] = load_slack(contacts, hulls, lever_rule)
    if "equilibrium" in wanted:
        slacks["equilibrium"] = load_slack(contacts, hulls, even_bedding)
    if wanted & {"force_balance", "force_balance_leaning"}:
        lean = "force_balance_leaning" in wanted
        slacks["force_balance"], slacks["force_balance_leaning"] = balance_slack(contacts, hulls, friction, lean)
    if STRENGTH in wanted:
        slacks[STRENGTH] = strength_slack(contacts, strength_n, even_bedding)
    return slacks


def _centre_slack(contacts: PlanContacts, hulls: Hulls) -> FloatArray:
    return hulls.distance(np.arange(contacts.n_boxes), contacts.centre_mm[:, :2])


def _stable(slack: FloatArray, criterion: Criterion) -> NDArray[np.int8]:
    """Yes or no by the sign of the slack. NaN is no; what comes after the end of force balance was not asked."""
    rounding = _ROUNDING[criterion.unit]
    stable = (slack > rounding if criterion.strict else slack >= -rounding).astype(np.int8)
    if criterion.name.startswith("force_balance"):
        stable[np.logical_or.accumulate(np.r_[False, stable[:-1] == NO])] = NOT_ASKED
    return stable
