"""A policy that does what ``balanced`` would do, so that nothing begins at random."""

from __future__ import annotations

from functools import partial

import numpy as np
from labels import Array
from numpy.typing import NDArray
from optimiser import Adam
from rollouts import drawn

from petmjx.plans.samples.online.features import features
from petmjx.plans.samples.online.learned import CLEARANCE_MM, lowest
from petmjx.plans.samples.online.network import Network
from petmjx.plans.samples.online.stream import Stream, by_taste
from petmjx.plans.samples.orders import TARGET_EXTENT_MM, stream

STREAM = 104
HIDDEN = 24

Numbers = NDArray[np.int64]

Decisions = list[tuple[Array, int]]
"""Features of the candidates, and which one was taken."""


def decisions(number: int, seed: int) -> Decisions:
    """What the rule does with one order. Updates count from 0, so that no update has this order."""
    order, sequence, look_ahead = drawn(seed, -1 % 2**31, number)
    items = [order.items[i] for i in sequence]
    boxes = Stream(items, TARGET_EXTENT_MM[order.target], CLEARANCE_MM, look_ahead)
    found: Decisions = []
    while boxes.seen:
        places = lowest(boxes.places())
        chosen = by_taste(boxes)
        if chosen is None:
            boxes.skip()
            continue
        taken = np.flatnonzero((places.point == chosen.point) & (places.shape == chosen.shape))
        if len(taken):  # else it is none of the lowest
            found.append((features(boxes, places).astype(np.float32), int(taken[0])))
        boxes.put(chosen)
    return found


def imitate(each: list[Decisions], seed: int, steps: int) -> Network:
    """The policy that is likeliest to have decided so."""
    every = [decision for some in each for decision in some]
    rows = np.concatenate([row for row, _ in every]).astype(np.float64)
    sizes = np.array([len(row) for row, _ in every])
    first = np.cumsum(sizes) - sizes
    owner = np.repeat(np.arange(len(sizes)), sizes)
    taken = first + np.array([row for _, row in every])
    scale = rows.std(axis=0)
    fresh = Network.fresh(rows.mean(axis=0), np.where(scale > 1e-3, scale, 1.0), HIDDEN, stream(seed, STREAM))
    # hidden units that say nothing yet learn nothing from a zero; a little of each
    values = fresh.learned
    values[-1 - HIDDEN : -1] = 0.05 * stream(seed, STREAM, 1).standard_normal(HIDDEN)
    slope = partial(_slope, rows=rows, first=first, owner=owner, taken=taken)
    adam = Adam.fresh(values.size)
    for step in range(steps):
        up = slope(fresh.with_learned(values)) - 1e-3 * values
        values, adam = adam.stepped(values, up, 0.05 / (1 + 4 * step / steps))
    return fresh.with_learned(values)


def _slope(network: Network, *, rows: Array, first: Numbers, owner: Numbers, taken: Numbers) -> Array:
    scores = network.scores(rows)
    scores -= np.maximum.reduceat(scores, first)[owner]
    weight = np.exp(scores)
    back = -weight / np.add.reduceat(weight, first)[owner]
    back[taken] += 1
    return network.slope(rows, back / len(first))
