"""On mjx-warp, worlds of few boxes may have thread blocks of their own. Results stay the same to the last bit."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.plans import heap, make_scene
from support.tiny_worlds import (
    SHORT,
    SOME_NS,
    TINY,
    assert_equal_worlds,
    engine,
    room_for_one_pool,
    tiny_scenes,
    watched_queues,
)
from support.worlds import simulate

from petmjx.engines.mjx.world_constants import NEVER
from petmjx.engines.verdict import Outcome
from petmjx.engines.warp import block_launch, block_pool_choice
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import FEW_BOXES, SIZES
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.small_world_blocks import small_world_pool, small_world_queues
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import PANEL

FEW = Launch(4, 256, 2, 0, 6, worlds=8)
ONE = BlockPool(Launch(4, SIZES[0].threads, 2, 0, 37), 4, 40, 1, 420, 336)


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """Return the numbers of worlds that each pool of blocks takes, slice after slice. No blocks are for last worlds."""
    monkeypatch.setattr(block_pool_choice, "tail_pool", lambda *_: None)
    return watched_queues(monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("most", [1, 4])
def test_a_world_goes_on_in_other_blocks_when_few_such_worlds_are_left(
    most: int, monkeypatch: pytest.MonkeyPatch, taken: list[list[int]], crowd: dict[str, Outcome]
) -> None:
    few = {"n_boxes": most, "blocks": 2, "least": 1 if most == 1 else 2}
    monkeypatch.setattr(block_pool_choice, "small_world_pool", lambda pool, worlds, lanes: replace(pool, **few))
    scenes = tiny_scenes()
    assert_equal_worlds(simulate(engine(slice_ns=SOME_NS), scenes, SHORT), crowd)
    of_few, of_one = np.array(taken).T
    if most == 1:
        assert of_few[0] > 0
        assert of_one.max() > 0
    else:
        assert max(scene.n_boxes for scene in scenes.values()) <= most
        assert of_one[0] == 0
        assert of_one[-1] > 0, "the last worlds"


def test_worlds_of_few_boxes_have_a_queue_of_their_own_while_they_are_enough() -> None:
    running, placed = jnp.array([1, 1, 0, 1, 1, 1], bool), jnp.array([2, 9, 2, 3, 1, 1])
    order = jnp.array([[5, -1, -1, -1, -1, -1], [3, 1, 2, 0, 4, -1]], jnp.int32)
    few = replace(ONE, n_boxes=2, least=2)
    queues = small_world_queues(few, order, placed, running)
    assert queues.tolist() == [[0, 4, -1, -1, -1, -1], [5, -1, -1, -1, -1, -1], [3, 1, 2, -1, -1, -1]]
    queues = small_world_queues(replace(few, least=3), order, placed, running)
    assert queues.tolist() == [[-1] * 6, *order.tolist()]


@pytest.mark.parametrize(
    ("worlds", "lanes", "pool", "blocks"),
    [
        (24, None, ONE, 4),
        (23, None, ONE, None),  # fewer than three quarters of the lanes
        (12, 17, ONE, 2),
        (100, 7, ONE, None),  # not one block
        (100, None, replace(ONE, launch=replace(ONE.launch, threads=SIZES[1].threads)), None),  # blocks of large worlds
    ],
)
def test_they_have_blocks_if_these_are_worth_while(
    worlds: int, lanes: int | None, pool: BlockPool, blocks: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Launch, "of", lambda *_: FEW)
    few = small_world_pool(pool, worlds, lanes)
    assert (few and few.blocks) == blocks
    if few:
        assert (few.lanes, few.least, few.most_idle) == (8 * few.blocks, 2 * few.blocks, 6 * few.blocks)
        assert (few.n_boxes, few.nconmax) == (15, pool.nconmax)
    assert pool.most_idle == NEVER


def test_on_a_cpu_there_are_none() -> None:
    if block_launch.launch_device().is_cuda:
        pytest.skip("this is a GPU")
    assert (
        small_world_pool(BlockPool(replace(Launch.of(SIZES[0]), threads=SIZES[0].threads), 8, 4, 1, 1, 1), 10**6)
        is None
    )


def test_memory_without_room_for_them_has_room_for_others(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    tried = room_for_one_pool(monkeypatch)
    monkeypatch.setattr(block_pool_choice, "small_world_pool", lambda pool, *_: replace(pool, n_boxes=1, least=1))
    assert_equal_worlds(simulate(engine(), tiny_scenes(TINY[:1]), SHORT), crowd)
    assert tried == [2, 1]


def test_a_solver_that_pauses_takes_the_same_steps(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    """Steps of these worlds take up to a dozen iterations of the solver. On a GPU each of their blocks has many
    worlds."""
    made = Launch.of
    monkeypatch.setattr(Launch, "of", lambda *of: replace(made(*of), pause_after=2))
    monkeypatch.setattr("warp.config.optimization_level", 0)  # compiling takes longer than these worlds
    assert_equal_worlds(simulate(engine(), tiny_scenes(), SHORT), crowd)


@pytest.mark.parametrize(
    ("shared_bytes", "worlds", "tiles"),
    [
        (227 << 10, 16, 6),  # H100
        (163 << 10, 16, 5),  # A100
        (99 << 10, 16, 1),  # consumer cards
        (64 << 10, 8, 3),  # Turing
    ],
)
def test_a_block_has_as_many_worlds_as_shared_memory_has_room_for(
    shared_bytes: int, worlds: int, tiles: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = SimpleNamespace(is_cuda=True, max_shared_memory_per_block=shared_bytes, sm_count=3)
    monkeypatch.setattr(block_launch, "launch_device", lambda: device)
    launch = Launch.of(FEW_BOXES)
    assert (launch.worlds, launch.threads, launch.lanes) == (worlds, 32 * worlds, 3 * worlds)
    assert launch.shared_words == tiles * PANEL**2
    assert 4 * launch.tile_words + 4 * launch.threads + newton.DRIVER_BYTES <= shared_bytes


@pytest.mark.gpu
@pytest.mark.parametrize("check", ["one-by-one", "static"])
def test_blocks_of_many_worlds_give_what_blocks_of_one_give(
    check: str, monkeypatch: pytest.MonkeyPatch, taken: list[list[int]]
) -> None:
    """Worlds have 1 to 24 boxes, some fall, and the worlds beside them change."""
    sim = SHORT.changed(check=check)
    scenes = {f"{name} {k}": scene for name, scene in tiny_scenes().items() for k in range(440)}
    scenes |= {f"heap of {n}, {k}": make_scene(heap(n)) for n in (6, 15, 24) for k in range(60)}
    together = simulate(MjxWarpEngine(slice_ns=3_000_000), scenes, sim)
    assert len(taken[0]) == 2
    assert min(np.array(taken).max(0)) > 100
    monkeypatch.setattr(block_pool_choice, "small_world_pool", lambda *_: None)
    assert_equal_worlds(simulate(MjxWarpEngine(), scenes, sim), together)
    assert len(taken[-1]) == 1
