"""The record of a plan in a run (``PlanRecord``): the digest of the plan, and its outer dimensions."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import mm_to_m
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import SPARSE

DIGEST_BYTES: Final = 8
"""Length of the digest of a plan, bytes. A digest of 8 bytes has 2^64 possible values. In a run of a million plans, the
probability that two different plans have the same digest is one in 37 million."""


def plan_digest(plan: Plan) -> str:
    """Hexadecimal digest (BLAKE2b) of everything in a plan that affects the results."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    digest.update(repr((plan.plan_id, plan.item_ids, plan.articles)).encode("utf-8", "backslashreplace"))
    for values in (plan.size_mm, plan.corner_mm, plan.mass_kg, plan.sequence):
        digest.update(values.tobytes())
    if plan.materials:
        digest.update(repr(plan.materials).encode("utf-8", "backslashreplace"))
    if plan.mass_center_mm is not None:
        digest.update(plan.mass_center_mm.tobytes())
    for name, field in SPARSE.items():
        if field.reaches_results and (values := getattr(plan, name)) is not None:
            digest.update(name.encode() + values.tobytes())
    if plan.kinds:
        digest.update(repr(("kinds", plan.kinds)).encode())
    return digest.hexdigest()


class PlanRecord(NamedTuple):
    """What a run stores about one plan, besides its placements.

    Attributes:
        digest: digest of everything in the plan that affects the results.
        source: file from which the plan was read.
        volume_m3: total volume of the plan's boxes, m³.
        extent_x_m, extent_y_m: extents of the bounding box of all boxes, m.
        height_m: height of the top of the highest box above the carrier, m.
        number: position of the plan in the input, where skipped plans also have a position; None if the position is
            unknown.
    """

    digest: str
    source: str
    volume_m3: float
    extent_x_m: float
    extent_y_m: float
    height_m: float
    number: int | None = None


def records_of(plans: Sequence[Plan], numbers: Mapping[str, int] | None = None) -> dict[str, PlanRecord]:
    """Plan id → record of the plan, in the order of the input.

    Args:
        numbers: plan id → position of the plan in the input. If no plan was skipped, ``numbers`` can be None: the
            positions are then 0, 1, 2, …
    """
    if not plans:
        return {}
    numbers = numbers or {plan.plan_id: number for number, plan in enumerate(plans)}
    ends = np.cumsum([plan.n_boxes for plan in plans])
    begins = [0, *ends.tolist()[:-1]]
    size, low = (mm_to_m(np.concatenate([getattr(plan, name) for plan in plans])) for name in ("size_mm", "corner_mm"))
    high = low + size
    highest = np.maximum.reduceat(high, begins)
    extent = (highest - np.minimum.reduceat(low, begins)).tolist()
    volume_of_box = size.prod(axis=1)
    return {
        plan.plan_id: PlanRecord(
            plan_digest(plan),
            plan.source,
            # a separate sum for each plan: ``np.add.reduceat`` would add in another order than ``sum``, and round
            # differently
            float(volume_of_box[begin:end].sum()),
            extent_x,
            extent_y,
            height,
            numbers.get(plan.plan_id),
        )
        for plan, begin, end, (extent_x, extent_y, _), height in zip(
            plans, begins, ends.tolist(), extent, highest[:, 2].tolist(), strict=True
        )
    }
