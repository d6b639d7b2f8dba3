"""``petmjx.placement_stability``: how likely the boxes of a plan stand when a robot places them."""

from __future__ import annotations

import numpy as np

from petmjx.common.argument_checks import instance_of
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.learned_packer import published_policy
from petmjx.packers.pile_balance import TOUCH_MM, Balance, Rest
from petmjx.packers.placement_stability import likely, placement_state, stability_features
from petmjx.plans.plan import Plan


def placement_stability(plan: Plan) -> FloatArray:
    """(n,) how likely each box of a plan stands when a robot places all boxes inexactly: to the end, or until another
    one fails first. The product is how likely the whole plan stands.

    A network's estimate in a millisecond a box, not a simulation: ``petmjx.score(plan, confidence=64)`` simulates it.
    docs/packers.md says how far it can be trusted. A box that touches no top below it has 0, as one
    that begins below the carrier's.

    Raises:
        InputError: something else than a plan.
    """
    instance_of(plan, "plan", Plan, "a plan")
    pile = Balance(plan.n_boxes)
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    rows, floats = [], []
    for i, (corner, size, mass) in enumerate(zip(low, plan.size_mm, plan.mass_kg.tolist(), strict=True)):
        box = placement_state(pile, low[:i], high[:i], plan.mass_kg[:i], corner, size, mass)
        rows.append(stability_features(box))
        floats.append(box.margins.rest is None or corner[2] < -TOUCH_MM)
        x, y, z = corner.tolist()
        length, width, height = size.tolist()
        middle = np.array([1.0, (x + length / 2) / MM_PER_M, (y + width / 2) / MM_PER_M])
        rest = box.margins.rest or Rest(mass * middle, None, np.zeros((0, 3)))
        pile.add((x, y, z), (length, width, height), rest)
    chances = likely(published_policy().head, np.array(rows))
    return np.where(floats, 0.0, chances)
