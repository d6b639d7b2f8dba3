"""Packs orders by a policy, and computes the worth of the packings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from labels import Array

from petmjx.packers.learned_candidates import FourSidedStream
from petmjx.packers.learned_packer import CLEARANCE_MM, Policy
from petmjx.plans.order import TARGET_EXTENT_MM, Order
from petmjx.plans.order_generator import draw_order, stream

STREAM = 103
CATALOGUES, VALIDATION = 1_000_000, 2_000_000
"""First seeds of the orders for training and for validation. No other set of petmjx uses these seeds, and orders for
validation are not used for training."""

PER_CATALOGUE = 8
"""Number of generations that draw their orders from the same catalogue of articles."""

LEFT_OUT = 0.5
"""Loss of a packing whose whole volume is left out, in units of utilisation."""

LEAST_CHANCE, SHORT = 0.9, 2.0
"""Required mean chance that a policy's plans stand, and the loss per unit by which the chance is below it."""


@dataclass(frozen=True)
class Outcome:
    """Result of packing one order.

    Attributes:
        worth: utilisation − ``LEFT_OUT`` · share of volume left out.
        chance: estimated chance that the plan stands, which is the product of the chances of its placements.
    """

    worth: float
    utilisation: float
    left_out: float
    chance: float


def drawn(seed: int, generation: int, number: int) -> tuple[Order, list[int], int]:
    """An order of a generation, the sequence of its boxes, and the number of boxes that the packer sees."""
    rng = stream(seed, STREAM, generation, number)
    order = draw_order(CATALOGUES + 1000 * seed + generation // PER_CATALOGUE, int(rng.integers(100_000)))
    sequence = list(range(len(order.items)))
    if rng.random() < 0.3:
        sequence = rng.permutation(len(order.items)).tolist()
    look_ahead = 1 if rng.random() < 0.8 else int(rng.integers(2, 7))
    return order, sequence, look_ahead


def with_linear(policy: Policy, weights: Array) -> Policy:
    """The policy with other linear weights in the network that scores candidates."""
    return replace(policy, taste=replace(policy.taste, linear=weights))


def outcomes(task: tuple[int, int, int], policy: Policy, candidates: Array) -> list[Outcome]:
    """The results of all candidates for one order.

    Args:
        task: seed, generation, number of the order.
        candidates: (n, d) linear weights of the policy's scores.
    """
    order, sequence, look_ahead = drawn(*task)
    return [outcome(with_linear(policy, linear), order, sequence, look_ahead) for linear in candidates]


def validated(number: int, policy: Policy, look_ahead: int) -> Outcome:
    """The packer's result for an order that is not used for training."""
    order = draw_order(VALIDATION, number)
    return outcome(policy, order, list(range(len(order.items))), look_ahead)


def outcome(policy: Policy, order: Order, sequence: list[int], look_ahead: int) -> Outcome:
    """The result of packing one order by a policy."""
    length, width = TARGET_EXTENT_MM[order.target]
    boxes = FourSidedStream([order.items[i] for i in sequence], (length, width), CLEARANCE_MM, look_ahead)
    log_chance = 0.0
    while boxes.seen:
        decision = policy.decide(boxes)
        if decision is None:
            boxes.skip()
        else:
            log_chance += np.log(max(decision.chosen.chance, 1e-6))
            boxes.put(decision.chosen.next)
    utilisation = boxes.volume_m3 * 1e9 / (length * width * boxes.top_mm) if boxes.placed else 0.0
    left_out = 1 - boxes.volume_m3 / sum(item.volume_m3 for item in order.items)
    chance = float(np.exp(log_chance))
    return Outcome(utilisation - LEFT_OUT * left_out, utilisation, left_out, chance)


def policy_worth(outcomes: Sequence[Outcome]) -> float:
    """The worth of a policy, from its results: the mean worth of packings, minus a loss if its plans stand too
    rarely."""
    chance = float(np.mean([outcome.chance for outcome in outcomes]))
    return float(np.mean([outcome.worth for outcome in outcomes])) - SHORT * max(LEAST_CHANCE - chance, 0.0)
