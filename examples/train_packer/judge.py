"""Simulates the policy's plans for orders that are not used for training."""

from __future__ import annotations

from typing import Any

import petmjx
from petmjx.packers.learned_packer import Policy, pack_learned
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.order import TARGET_EXTENT_MM
from petmjx.plans.order_generator import draw_order
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan

CATALOGUE = 4_000_000
ORDERS, WORLDS = 24, 4


def judged(policy: Policy, engine: Any) -> dict[str, float]:
    """The share of plans that stand when placed exactly, and the share of worlds with errors that stand."""
    plans = []
    for number in range(ORDERS):
        order = draw_order(CATALOGUE, number)
        placements = as_placements(pack_learned(order.items, TARGET_EXTENT_MM[order.target], policy=policy))
        plans.append(parse_plan(f"{number}", placements, DecoderOptions("judge")))
    worlds = petmjx.score(plans, confidence=WORLDS, engine=engine).worlds
    exact = worlds.variant == 0
    stable = worlds.verdict == "stable"
    return {"stand": float(stable[exact].mean()), "share": float(stable[~exact].mean())}
