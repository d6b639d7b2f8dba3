"""The capacities of a run's stages, chosen from the sizes of its plans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

GRANULE = 4
"""Capacities are multiples of this, so that runs with different plans can use the same compiled programs."""

FIXED_COST_BOXES = 6.0
"""A step at capacity C costs about (C + this)²: it grows with the square of the boxes, and it costs something without
any box too (docs/performance.md)."""


def step_cost(capacity: int) -> float:
    """Relative cost of one step of one lane at a capacity."""
    return (capacity + FIXED_COST_BOXES) ** 2


def growing_capacities(sizes: Sequence[int], max_stages: int) -> list[int]:
    """Capacities of the stages through which every plan grows, smallest first; the last holds the largest plan.

    The work up to a capacity is the number of boxes, over all plans, that are placed until then.

    Args:
        sizes: number of boxes of each plan.
        max_stages: most stages; each is one compiled program.
    """
    counts = np.asarray(sizes)
    top = round_up(int(counts.max()))
    work = {capacity: int(np.minimum(counts, capacity).sum()) for capacity in range(0, top + 1, GRANULE)}
    return _cheapest_chain(work, max_stages)


def class_capacities(sizes: Sequence[int], max_classes: int) -> list[int]:
    """Capacities for stages in which a world stays from its start to its end (static check, profiles).

    The work up to a capacity is the number of plans that fit into it.
    """
    counts = np.asarray(sizes)
    work = {capacity: int((counts <= capacity).sum()) for capacity in {0, *map(round_up, counts.tolist())}}
    return _cheapest_chain(work, max_classes)


def _cheapest_chain(work: dict[int, int], max_stages: int) -> list[int]:
    """Capacities up to the largest that minimise Σ (work between two neighbours) × (cost of a step at the upper one).

    Dynamic programming over (stages used, last capacity). ``work`` maps each candidate capacity, and 0, to the
    cumulative work up to it.
    """
    ordered = sorted(work)
    best: dict[int, tuple[float, list[int]]] = {ordered[0]: (0.0, [])}
    finished: list[tuple[float, list[int]]] = []
    for _ in range(max_stages):
        best = {
            upper: min(
                (cost + (work[upper] - work[lower]) * step_cost(upper), [*chain, upper])
                for lower, (cost, chain) in best.items()
                if lower < upper
            )
            for upper in ordered
            if any(lower < upper for lower in best)
        }
        if ordered[-1] in best:
            finished.append(best[ordered[-1]])
    return min(finished)[1]


def round_up(n: int, granule: int = GRANULE) -> int:
    """The least multiple of a granule that holds n."""
    return -(-n // granule) * granule
