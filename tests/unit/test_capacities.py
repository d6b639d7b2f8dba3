"""Chains of capacities: they hold every plan, are as few as asked for, and no other chain is cheaper."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from petmjx.engines.batch.capacities import GRANULE, class_capacities, growing_capacities, step_cost

RNG = np.random.default_rng(7)
SIZES = [
    [1],
    [8] * 10,
    [3, 43, 43, 43],
    RNG.normal(43, 14, 300).clip(1, 90).astype(int).tolist(),
    RNG.integers(1, 13, 50).tolist(),
]


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("stages", [1, 3, 8])
def test_chains_grow_and_hold_the_largest_plan(sizes: list[int], stages: int) -> None:
    for choose in (growing_capacities, class_capacities):
        chain = choose(sizes, stages)
        assert chain == sorted(set(chain))
        assert 1 <= len(chain) <= stages
        assert max(sizes) <= chain[-1] < max(sizes) + GRANULE
        assert all(capacity % GRANULE == 0 for capacity in chain)


def growing_cost(chain: tuple[int, ...], sizes: list[int]) -> float:
    """Every box of every plan is placed, and waited for, at the first capacity that holds it."""
    return sum(step_cost(next(c for c in chain if c >= box)) for size in sizes for box in range(1, size + 1))


def class_cost(chain: tuple[int, ...], sizes: list[int]) -> float:
    """Every plan runs at the first capacity that holds it."""
    return sum(step_cost(next(c for c in chain if c >= size)) for size in sizes)


@pytest.mark.parametrize("sizes", [SIZES[2], SIZES[4], [4, 9, 17, 17, 26]])
@pytest.mark.parametrize("stages", [1, 2, 3])
def test_no_chain_is_cheaper(sizes: list[int], stages: int) -> None:
    top = -(-max(sizes) // GRANULE) * GRANULE
    inner = range(GRANULE, top, GRANULE)
    chains = [(*some, top) for n in range(stages) for some in itertools.combinations(inner, n)]
    for choose, cost in ((growing_capacities, growing_cost), (class_capacities, class_cost)):
        best = min(cost(chain, sizes) for chain in chains)
        assert cost(tuple(choose(sizes, stages)), sizes) == pytest.approx(best)
