"""The rule with which the search for weights begins, so that it does not begin with random weights, and the spread of
the features."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from head import believing, fresh_network
from labels import Array
from rollouts import drawn, with_linear

from petmjx.packers.learned_candidates import FourSidedStream
from petmjx.packers.learned_features import NAMES
from petmjx.packers.learned_packer import CLEARANCE_MM, Policy
from petmjx.packers.policy_network import Network
from petmjx.plans.order import TARGET_EXTENT_MM
from petmjx.plans.order_generator import stream

RULE = {
    "z": -1000.0,
    "support": 40.0,
    "from_side_x": -12.0,
    "from_side_y": -8.0,
    "room_small": -300.0,
    "room_large": -300.0,
    "level_small": 200.0,
    "level_large": 200.0,
    "base": 230.0,
    "log_mass": 80.0,
    "height": 125.0,
}
"""Worth of each feature, in mm of height. The rule prefers low places near an edge, which leave low and level places
for other cartons. If several boxes are visible, it prefers large, heavy and tall boxes, like ``balanced``."""


def by_rule() -> Policy:
    """The rule as a policy, with a head that estimates that all placements stand."""
    f = len(NAMES)
    linear = np.array([RULE.get(name, 0.0) for name in NAMES])
    taste = fresh_network(np.zeros(f), np.ones(f), 0, stream(0))
    return with_linear(Policy(taste, believing()), linear)


def spread(number: int, seed: int) -> Array:
    """(m, f) differences of the candidates' features from the means over all candidates of the same decision, in an
    order that the rule packs. No update of the training has the number ``number``, since updates count from 0."""
    order, sequence, look_ahead = drawn(seed, -1 % 2**31, number)
    items = [order.items[i] for i in sequence]
    boxes, policy = FourSidedStream(items, TARGET_EXTENT_MM[order.target], CLEARANCE_MM, look_ahead), by_rule()
    row_blocks = [np.zeros((0, len(NAMES)))]
    while boxes.seen:
        decision = policy.decide(boxes)
        if decision is None:
            boxes.skip()
            continue
        row_blocks.append(decision.rows - decision.rows.mean(axis=0))
        boxes.put(decision.chosen.next)
    return np.concatenate(row_blocks)


def scaled(rows: Array) -> Network:
    """The scores of the rule as a network. Its inputs are features scaled to a spread of 1, and its scores have a
    spread of 1."""
    spreads = np.sqrt((rows**2).mean(axis=0))
    scale = np.where(spreads > 1e-6, spreads, 1.0)
    rule = by_rule().taste
    linear = rule.linear * scale / np.sqrt(((rows @ rule.linear) ** 2).mean())
    return replace(fresh_network(np.zeros(len(NAMES)), scale, 0, stream(0)), linear=linear)
