"""The bundled plans: the hand-made ones, then plans of the generator, chosen by their number.

Make the file again with ``python -m petmjx.plans.samples.bundled``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from petmjx.plans.samples import bundled_path, generate_one, write_plans
from petmjx.plans.samples.handmade import HANDMADE

BUNDLED_SEED = 0

BUNDLED_INDICES = (3, 7, 13, 16, 38, 46, 92, 152, 189, 430, 443, 1349, 1784, 2112)
"""Seven stand and seven collapse (16, 46, 430, 443, 1349, 1784, 2112). Three have 41 to 45 boxes, three about 30
and eight 14 to 20, so that a demo is quick."""


def bundled_plans() -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """(plan id, placements) of each bundled plan."""
    for plan in HANDMADE:
        yield plan.plan_id, list(plan.placements)
    for index in BUNDLED_INDICES:
        yield generate_one(index, BUNDLED_SEED)


if __name__ == "__main__":
    write_plans(bundled_path(), bundled_plans())
