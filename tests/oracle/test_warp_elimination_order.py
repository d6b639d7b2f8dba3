"""The order of bodies in the solver of mjx-warp, compared with plain breadth-first searches."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp import world_arrays
from petmjx.engines.warp.kernels.elimination_order import MANY_BOXES, renew_order
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import Thread, Workspace, array_types, filled_record

set_up_warp()

MANY = int(MANY_BOXES)
MOST_PAIRS = 2048


@wp.func
def _one(worlds: world_arrays.Worlds, state: world_arrays.State, work: Workspace, placed: int, pairs: int) -> None:
    at = Thread()
    at.block = 0
    at.thread = 0
    at.threads = 1
    at.world = 0
    at.placed = placed
    renew_order(worlds, at, pairs, state, work)


def _renewal(worlds: world_arrays.Worlds, state: world_arrays.State, work: Workspace, placed: int, pairs: int) -> None:
    _one(worlds, state, work, placed, pairs)


@pytest.fixture(scope="module")
def kernel() -> Any:
    return with_cpp(_renewal, newton.source("block.cuh"))


def zeros(kind: Any, **values: Any) -> Any:
    """Return a record on Warp's device. Arrays without values have one zero."""
    types = array_types(kind)
    arrays = {name: np.zeros((1,) * of.ndim) for name, of in types.items()} | values
    return filled_record(kind, {name: wp.array(arrays[name], dtype=of.dtype) for name, of in types.items()})


def positions(kernel: Any, n_boxes: int, contacts: list[tuple[int, int]]) -> list[int]:
    """The position of each body in the order: first the carrier's, then those of the boxes. ``contacts``: pairs of
    bodies; body -1 is the floor."""
    sizes = world_arrays.axes(1, n_boxes, boards=1, npairmax=MOST_PAIRS, nconmax=MOST_PAIRS)
    with wp.ScopedDevice("cpu"):
        worlds = zeros(world_arrays.Worlds, shape_body=np.arange(n_boxes + 1)[None])
        state = zeros(world_arrays.State, carrier_position=np.zeros(1), position=np.zeros((1, n_boxes)))
        buffer = wp.zeros((world_arrays.buffer_rows(sizes), world_arrays.BUFFER_WORDS), dtype=float)
        work = filled_record(Workspace, world_arrays.in_buffer(buffer, sizes))
        pairs = np.zeros((2, MOST_PAIRS))
        pairs[:, : len(contacts)] = np.array(contacts).T + 1
        work.pair_geom1.assign(pairs[:1])
        work.pair_geom2.assign(pairs[1:])
        work.pair_conadr.assign(np.minimum(np.arange(MOST_PAIRS + 1), len(contacts))[None])
        wp.launch(kernel, dim=1, inputs=[worlds, state, work, n_boxes, len(contacts) + 3])
        return [int(state.carrier_position.numpy()[0]), *state.position.numpy()[0].tolist()]


def distances(neighbours: dict[int, set[int]], root: int) -> dict[int, int]:
    """Distance of each body from the root, in contacts, for the bodies that contacts join with the root."""
    distance, queue = {root: 0}, [root]
    for body in queue:
        for other in neighbours[body] - distance.keys():
            distance[other] = distance[body] + 1
            queue.append(other)
    return distance


def farthest(distance: dict[int, int]) -> int:
    return min(distance, key=lambda body: (-distance[body], body))


def expected_positions(n_boxes: int, contacts: list[tuple[int, int]]) -> list[int]:
    """The positions that plain breadth-first searches give."""
    many, bodies = n_boxes > MANY, range(n_boxes + 1)
    neighbours: dict[int, set[int]] = {body: set() for body in bodies}
    for one, two in contacts:
        if min(one, two) >= (1 if many else 0):
            neighbours[one].add(two)
            neighbours[two].add(one)
    order: list[int] = []
    for body in bodies:
        if body not in order and (many or body == 0):
            distance = distances(neighbours, farthest(distances(neighbours, body)))
            order += sorted(distance, key=lambda other: (distance[other], other))
    order += [body for body in bodies if body not in order]
    if many:
        order.reverse()
    return np.argsort(order).tolist()


def random_contacts(n_boxes: int, share: float, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Random contacts: a share of the boxes stand on one to three earlier bodies each. The other boxes touch
    nothing."""
    contacts = [(-1, 0)]
    for box in range(1, n_boxes + 1):
        if rng.random() < share:
            below = rng.integers(max(0, box - 25), box, rng.integers(1, 4))
            contacts += [(int(other), box) for other in np.unique(below)]
    return [contacts[k] for k in rng.permutation(len(contacts))]


@pytest.mark.parametrize("n_boxes", [1, 5, MANY, MANY + 1, 180])
@pytest.mark.parametrize("share", [0.7, 1.0])
def test_the_order_is_that_of_plain_searches(kernel: Any, n_boxes: int, share: float) -> None:
    rng = np.random.default_rng(33332 + n_boxes)
    for _ in range(5):
        contacts = random_contacts(n_boxes, share, rng)
        assert positions(kernel, n_boxes, contacts) == expected_positions(n_boxes, contacts)


def test_columns_of_many_boxes_come_one_after_another_and_the_carrier_last(kernel: Any) -> None:
    columns, levels = 15, 8
    stacks = [[1 + column + columns * level for level in range(levels)] for column in range(columns)]
    contacts = [pair for stack in stacks for pair in pairwise([0, *stack])]
    place = positions(kernel, columns * levels, contacts)
    assert sorted(place) == list(range(columns * levels + 1))
    assert place[0] == columns * levels
    for stack in stacks:
        assert all(abs(place[upper] - place[lower]) == 1 for lower, upper in pairwise(stack))
