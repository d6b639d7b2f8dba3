"""On mjx-warp, the last worlds of a run have separate thread blocks. Results are the same, to the last bit, as without
these blocks."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.plans import heap, make_scene
from support.tiny_worlds import SHORT, STEP_NS, TINY, assert_equal_worlds, engine, tiny_scenes, watched_queues
from support.worlds import simulate

from petmjx.engines.verdict import Outcome
from petmjx.engines.warp import block_launch, block_pool_choice, tail_blocks
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import LAST, SIZES
from petmjx.engines.warp.compiled_programs import programs
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.solver.newton import DRIVER_BYTES, own_bytes
from petmjx.engines.warp.tail_blocks import MOST_EXPECTED, expected_tail, tail_pool, tail_queues
from petmjx.options.simulation import Simulation

ONE = BlockPool(Launch(4, SIZES[0].threads, 2, 0, 37), 4, 40, 1, 420, 336)
TWO_LAST = replace(ONE, blocks=2, last=True)

_expected_tail = jax.jit(expected_tail, static_argnums=3)
"""Compiled as a whole. If the function were not compiled as a whole, JAX would compile each of its operations for
each number of worlds."""


def expected(steps: list[int], ended: list[int], lanes: int = 1, spare: int = 0) -> list[int]:
    """Return the numbers of the worlds that are expected to be last.

    Args:
        steps: Number of steps of each world so far.
        ended: Numbers of worlds that have ended.
        spare: Number of rows behind the worlds that are in no queue.
    """
    queued, n = len(steps), len(steps) + spare
    order = jnp.array([[*range(1, queued), -1], [0, *[-1] * (queued - 1)]], jnp.int32)
    running = jnp.array(~np.isin(np.arange(n), ended))
    return np.flatnonzero(_expected_tail(order, jnp.array(steps + [0] * spare, jnp.int32), running, lanes)).tolist()


def test_worlds_that_have_taken_many_times_the_usual_steps_are_expected_to_be_last() -> None:
    assert expected([9, 21, 20, 10, 400, 95, 12], ended=[3]) == [1, 4, 5]
    assert expected([500, 3, 1, 0], ended=[]) == [], "none has ended"
    assert expected([500, 99, 1, 10, 90], ended=[3, 4]) == [0], "50 in the mean"
    assert expected([9, 400, 10, 10, 10, 10, 500], ended=[2, 3, 4, 5, 6]) == [1], "the last one has ended"
    many = [70_000] * 32_768  # the sum of these steps exceeds an int32
    assert expected([*many, 80_000, 300_000], ended=list(range(len(many)))) == [len(many) + 1]


def test_a_long_world_is_not_the_last_one_as_long_as_many_wait() -> None:
    steps = [100, 10] + [0] * 198  # so 1,980 steps are left
    assert expected(steps, ended=[1], lanes=3, spare=28) == [0]
    assert expected(steps, ended=[1], lanes=2, spare=28) == []


def test_of_many_long_worlds_those_that_have_taken_most_steps_are_expected_to_be_last() -> None:
    assert expected([10, *[100] * MOST_EXPECTED], ended=[0]) == list(range(1, 1 + MOST_EXPECTED))
    assert len(expected([10, *[100] * (MOST_EXPECTED + 1)], ended=[0])) == MOST_EXPECTED
    assert expected([10, 100, *range(101, 101 + MOST_EXPECTED)], ended=[0]) == list(range(2, 2 + MOST_EXPECTED))


ORDER = [[3, -1, -1, -1, -1], [0, 4, 2, 1, -1]]
"""Two queues of five worlds. The fourth world is large. Two rows behind the worlds are in no queue."""


def with_last(running: list[int], steps: list[int], pool: BlockPool = TWO_LAST) -> list[list[int]]:
    states = np.array(steps, np.int32), np.isin(np.arange(7), [*running, 5, 6])
    return jax.jit(partial(tail_queues, pool, lanes=2))(np.array(ORDER, np.int32), *states).tolist()


def test_when_no_more_worlds_are_left_than_multiprocessors_each_has_one() -> None:
    assert with_last([1, 4], [9] * 7) == [[4, 1, -1, -1, -1], ORDER[0], [0, 2, -1, -1, -1]]
    assert with_last([3, 4], [9] * 7)[0] == [4, -1, -1, -1, -1], "a large one has a multiprocessor anyway"
    assert with_last([1, 3, 4], [9] * 7) == [[-1] * 5, *ORDER]


def test_before_those_have_one_that_are_expected_to_be_last() -> None:
    steps = [10, 100, 10, 10, 0, 0, 0]
    assert with_last([1, 3, 4], steps) == [[1, -1, -1, -1, -1], ORDER[0], [0, 4, 2, -1, -1]]
    steps = [10, 100, 100, 10, 100, 0, 0]
    assert with_last([1, 2, 3, 4], steps) == [[-1] * 5, *ORDER], "more than have room"
    assert with_last([1, 2, 3, 4], steps, replace(TWO_LAST, blocks=3))[0] == [4, 2, 1, -1, -1]


def test_no_other_block_has_room_beside_one_for_a_last_world(monkeypatch: pytest.MonkeyPatch) -> None:
    for shared_bytes in (227 << 10, 163 << 10, 99 << 10, 64 << 10):  # H100, A100, consumer cards, Turing
        device = SimpleNamespace(is_cuda=True, max_shared_memory_per_block=shared_bytes, sm_count=3)
        monkeypatch.setattr(block_launch, "launch_device", lambda device=device: device)
        usual = Launch.of(SIZES[0])
        pool = tail_pool(replace(ONE, launch=usual))
        assert pool is not None
        assert (pool.last, pool.lanes, pool.launch.threads) == (True, 3, LAST.threads)
        both = sum(4 * one.shared_words + own_bytes(one.panels) + DRIVER_BYTES for one in (usual, pool.launch))
        assert both > shared_bytes + DRIVER_BYTES  # shared memory of a multiprocessor
        assert tail_pool(replace(ONE, launch=usual), lanes=2) == replace(pool, blocks=2)
        assert tail_pool(replace(ONE, launch=Launch.of(SIZES[1]))) is None, "they have it to themselves anyway"


def test_on_a_cpu_there_are_none() -> None:
    if block_launch.launch_device().is_cuda:
        pytest.skip("this is a GPU")
    assert tail_pool(BlockPool(Launch.of(SIZES[0]), 8, 4, 1, 1, 1)) is None


def test_a_world_goes_on_in_blocks_for_the_last_ones(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """On a CPU, all blocks have the same size. One block simulates the worlds. When two worlds are left, two other
    blocks take them. Slices of one step take long, so there are only three worlds."""
    queue_counts = watched_queues(monkeypatch)
    monkeypatch.setattr(block_pool_choice, "tail_pool", lambda pool, lanes: replace(pool, blocks=2, last=True))
    assert_equal_worlds(simulate(engine(slice_ns=STEP_NS), tiny_scenes(TINY[:3]), SHORT), crowd)
    of_last, of_others = np.array(queue_counts).T
    assert (of_last[0], of_others[0]) == (0, 1)
    assert of_last.max() == 2


def test_worlds_go_on_where_there_are_blocks_for_few_boxes_too(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    queue_counts = watched_queues(monkeypatch)
    monkeypatch.setattr(
        block_pool_choice, "small_world_pool", lambda pool, *_: replace(pool, blocks=2, n_boxes=1, least=1)
    )
    monkeypatch.setattr(block_pool_choice, "tail_pool", lambda pool, _: replace(pool, blocks=2, last=True))
    assert_equal_worlds(simulate(engine(slice_ns=STEP_NS), tiny_scenes(TINY[:3]), SHORT), crowd)
    of_last, of_few, of_others = np.array(queue_counts).max(axis=0)
    assert min(of_last, of_few, of_others) > 0


@pytest.mark.gpu
def test_blocks_for_the_last_worlds_give_what_others_give(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this test each world changes between both kinds of blocks."""
    scenes = {f"heap of {n}, {k}": make_scene(heap(n)) for n in (5, 15, 24, 40, 70, 96) for k in range(60)}
    sim = Simulation(interval_s=0.1, rest_window_s=0.1, settle_s=0.3)
    queue_counts = watched_queues(monkeypatch)
    monkeypatch.setattr(tail_blocks, "LONG", 0.0)
    monkeypatch.setattr(tail_blocks, "GOES_ON", np.inf)
    monkeypatch.setattr(tail_blocks, "MOST_EXPECTED", 10**6)
    programs.cache_clear()
    outcomes = simulate(MjxWarpEngine(slice_ns=3_000_000), scenes, sim)
    most = np.array(queue_counts).max(0)
    assert len(most) == 2
    assert min(most) > 50
    monkeypatch.undo()
    programs.cache_clear()
    monkeypatch.setattr(block_pool_choice, "tail_pool", lambda *_: None)
    assert_equal_worlds(simulate(MjxWarpEngine(), scenes, sim), outcomes)
