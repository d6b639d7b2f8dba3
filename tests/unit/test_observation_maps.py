"""Arrays that the vector environment observes: the next boxes, and height and load maps of pallets."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="gymnasium is not installed (extra: gym)")

import petmjx.gym.observation_maps
from petmjx.gym.item_queues import Queues
from petmjx.gym.observation_maps import Maps
from petmjx.loop.episode_orders import Boxes


def test_queues_are_lists_of_boxes() -> None:
    rng, n, seen = np.random.default_rng(0), 3, 4
    queues = Queues(n, seen)
    lists: list[list[tuple[float, ...]]] = []
    for row, k in enumerate((2, 37, 120)):
        boxes = Boxes(rng.uniform(100, 600, (k, 3)), rng.uniform(1, 20, k), rng.uniform(100, 900, k))
        queues.begin(row, boxes)
        lists.append([(*boxes.size_mm[i], boxes.mass_kg[i], boxes.strength_n[i]) for i in range(k)])
    left_out = np.zeros(n, int)
    while any(lists):
        np.testing.assert_array_equal(queues.counts, [len(remaining) for remaining in lists])
        size, mass, _ = queues.seen(np.arange(n))
        for row, queue in enumerate(lists):
            expected = np.zeros((seen, 4))
            expected[: len(queue)] = np.reshape([box[:4] for box in queue[:seen]], (-1, 4))
            np.testing.assert_array_equal(np.column_stack([size[row], mass[row]]), expected)
        rows = np.array([row for row in rng.permutation(n) if lists[row]])
        if rng.random() < 0.2:
            before = queues.kept(rows)
            for _ in range(10):
                queues.leave_out(rows, seen)
            queues.restore(rows, before)
            queues.leave_out(rows, 3)
            for row in rows:
                left_out[row] += len(lists[row][:3])
                del lists[row][:3]
        else:
            places = np.array([rng.integers(min(len(lists[row]), seen)) for row in rows])
            strengths = queues.take(rows, places)
            assert strengths.tolist() == [lists[row].pop(place)[4] for row, place in zip(rows, places, strict=True)]
    assert not queues.counts.any()
    np.testing.assert_array_equal(queues.left_out, left_out)


@pytest.mark.parametrize("compiled", [False, True])
def test_maps_have_the_highest_top_and_the_largest_force_over_each_cell(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if compiled:
        pytest.importorskip("petmjx.gym.compiled_maps", reason="warp-lang is not installed (extra: warp)")
    rng, n, cells, cell_mm = np.random.default_rng(1), 4, (12, 8), 100.0
    monkeypatch.setattr(petmjx.gym.observation_maps, "_AT_ONCE", 3)
    monkeypatch.setattr(petmjx.gym.observation_maps, "_WORTH_COMPILING", n if compiled else n + 1)
    maps, boxes = Maps(n, cells, cell_mm), [[] for _ in range(n)]
    assert (maps._code is not None) == compiled
    for step in range(20):
        rows = np.flatnonzero(rng.random(n) < 0.8)
        corner, size = rng.integers(0, 700, (len(rows), 3)).astype(float), rng.integers(50, 500, (len(rows), 3)) * 1.0
        number = np.array([len(boxes[row]) for row in rows], int)
        for row, low, high in zip(rows, corner, corner + size, strict=True):
            boxes[row].append((low, high))
        maps.add(rows, number, size, corner)
        force = np.full((len(rows), 20), np.nan)
        for at, row in enumerate(rows):
            force[at, : len(boxes[row])] = rng.choice([0.0, 1.0], len(boxes[row])) * rng.uniform(1, 500)
        maps.load(rows, force)
        for at, row in enumerate(rows):
            heights, loads = np.zeros(cells), np.zeros(cells)
            for (low, high), newtons in zip(boxes[row], force[at], strict=False):
                x, y = (slice(int(low[axis] // cell_mm), int(-(-high[axis] // cell_mm))) for axis in range(2))
                heights[x, y] = np.maximum(heights[x, y], high[2])
                loads[x, y] = np.maximum(loads[x, y], newtons)
            np.testing.assert_array_equal(maps.heights[row], heights.astype(np.float32))
            np.testing.assert_array_equal(maps.loads[row], loads.astype(np.float32))
        if step == 9:
            maps.clear(np.array([1]))
            boxes[1] = []
            assert not maps.heights[1].any()
            assert not maps.loads[1].any()
