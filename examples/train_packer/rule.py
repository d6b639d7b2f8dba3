"""The rule with which the search begins, so that the search does not begin at random, and the spread of features."""

from __future__ import annotations

import numpy as np
from head import believing
from labels import Array
from rollouts import drawn

from petmjx.packers.learned_candidates import FourSidedStream
from petmjx.packers.learned_features import NAMES
from petmjx.packers.learned_packer import CLEARANCE_MM, Policy
from petmjx.packers.policy_network import Network
from petmjx.plans.order_generator import TARGET_EXTENT_MM, stream

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
"""The worth of features, in mm of height: low places near an edge, that leave low and level places for other cartons.
With several visible boxes, large, heavy and tall ones first, as with ``balanced``."""


def by_rule() -> Policy:
    """The rule as a policy, with a head that believes that all placements stand."""
    f = len(NAMES)
    linear = np.array([RULE.get(name, 0.0) for name in NAMES])
    taste = Network.fresh(np.zeros(f), np.ones(f), 0, stream(0))
    return Policy(taste, believing()).with_linear(linear)


def spread(number: int, seed: int) -> Array:
    """(m, f) how far features of candidates are from the means of all candidates of their decisions, in an order that
    the rule packs. Updates count from 0, so that no update has this number."""
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
    """The rule's taste, by features whose candidates spread by 1, with scores that spread by 1."""
    spreads = np.sqrt((rows**2).mean(axis=0))
    scale = np.where(spreads > 1e-6, spreads, 1.0)
    rule = by_rule().taste
    linear = rule.linear * scale / np.sqrt(((rows @ rule.linear) ** 2).mean())
    f = len(NAMES)
    fresh = Network.fresh(np.zeros(f), scale, 0, stream(0))
    return Policy(fresh, believing()).with_linear(linear).taste
