"""Many plans joined into a few long arrays (``JoinedPlans``), one for each field of all their boxes.

The arrays of plans that were read together are slices of the same long arrays. Sending a few long arrays to another
process is several times as fast as sending thousands of plans, each with an array for each field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import accumulate, chain, pairwise
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.plans.plan import Plan

_ARRAYS: Final = ("size_mm", "corner_mm", "mass_kg", "sequence", "orientation")
_TEXTS: Final = ("item_ids", "articles", "product_groups")
"""Text fields that plans in BED-BPP's JSON usually have."""

_DEFAULTS: Final[dict[str, Any]] = {field.name: field.default for field in fields(Plan)}
_RARE_FIELDS: Final = tuple(name for name in _DEFAULTS if name not in (*_ARRAYS, *_TEXTS, "plan_id", "source"))
"""Fields that few plans have."""

_SET_FIELD: Final = object.__setattr__  # the only means of setting a field of a ``Plan``, which is frozen


def plan_of_rows(
    plan_id: str,
    source: str,
    rows: slice,
    arrays: Mapping[str, NDArray[Any]],
    texts: Mapping[str, Sequence[str]],
) -> Plan:
    """The plan whose boxes are the given rows of long columns. The checks of the constructor of ``Plan`` are skipped,
    because these checks were made for all plans together.

    Args:
        arrays, texts: name of a field of ``Plan`` → values of all boxes.
    """
    values = _DEFAULTS | {"plan_id": plan_id, "source": source}
    for name, array in arrays.items():
        values[name] = array[rows]
    for name, column in texts.items():
        values[name] = tuple(column[rows])
    if not any(values["product_groups"]):
        values["product_groups"] = ()
    plan = object.__new__(Plan)
    for name, value in values.items():
        _SET_FIELD(plan, name, value)
    return plan


class JoinedPlans(NamedTuple):
    """Plans as columns: one long array, or list of texts, for each field.

    Attributes:
        plan_ids, sources, box_counts: a value for each plan that has only the usual fields.
        arrays, texts: name of a field → the values of all boxes of these plans, plan after plan.
        others: position among all plans → a plan that also has rare fields.
    """

    plan_ids: list[str]
    sources: list[str]
    box_counts: list[int]
    arrays: dict[str, NDArray[Any]]
    texts: dict[str, list[str]]
    others: dict[int, Plan]

    @classmethod
    def of(cls, plans: Sequence[Plan]) -> Self:
        """The columns of plans."""
        others = {number: plan for number, plan in enumerate(plans) if not _is_usual(plan)}
        usual = [plan for number, plan in enumerate(plans) if number not in others] if others else plans
        return cls(
            [plan.plan_id for plan in usual],
            [plan.source for plan in usual],
            [plan.n_boxes for plan in usual],
            {name: np.concatenate([getattr(plan, name) for plan in usual]) for name in _ARRAYS} if usual else {},
            {
                name: list(chain.from_iterable(getattr(plan, name) or ("",) * plan.n_boxes for plan in usual))
                for name in _TEXTS
            },
            others,
        )

    @property
    def plans(self) -> list[Plan]:
        """The plans, in order. The arrays of plans with only the usual fields are slices of the same long arrays."""
        bounds = pairwise(accumulate(self.box_counts, initial=0))
        usual = (
            plan_of_rows(plan_id, source, slice(begin, end), self.arrays, self.texts)
            for plan_id, source, (begin, end) in zip(self.plan_ids, self.sources, bounds, strict=True)
        )
        total = len(self.plan_ids) + len(self.others)
        return [self.others[number] if number in self.others else next(usual) for number in range(total)]


def _is_usual(plan: Plan) -> bool:
    """Whether a plan has only the fields that the plans of BED-BPP's JSON usually have."""
    return plan.orientation is not None and all(getattr(plan, name) is _DEFAULTS[name] for name in _RARE_FIELDS)
