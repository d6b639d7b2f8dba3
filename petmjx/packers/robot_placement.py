"""``petmjx.placement_stability`` predicts how probably each box of a plan stands if a robot places the boxes."""

from __future__ import annotations

import numpy as np

from petmjx.common.argument_checks import instance_of
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.learned_packer import published_policy
from petmjx.packers.pile_balance import TOUCH_MM, Balance, Rest
from petmjx.packers.placement_stability import likely, placement_state, stability_features
from petmjx.plans.plan import Plan


def placement_stability(plan: Plan) -> FloatArray:
    """(n,) probability of each box of a plan to stand if a robot places all boxes inexactly.

    A box counts as standing if it stands to the end of the simulation, or if another box fails before it. So the
    product of all probabilities is the probability that the whole plan stands. The probability of a box is 0 if nothing
    touches its bottom, or if its bottom is below the carrier's top.

    A network estimates the probabilities without a simulation, in a millisecond per box. To simulate the plan instead,
    call ``petmjx.score(plan, confidence=64)``. docs/packers.md states how reliable the estimate is.

    Raises:
        InputError: ``plan`` is not a plan.
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
