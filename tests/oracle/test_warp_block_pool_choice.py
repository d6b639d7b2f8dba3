"""The thread blocks in which the worlds of a table are simulated. There are blocks for each size of worlds, for worlds
of few boxes, and for the last worlds of a run. The blocks' buffers for contacts grow if worlds need larger ones.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from petmjx.engines.contact_penetration import stiffened_physics
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.warp import block_pool_choice
from petmjx.engines.warp.block_pool_choice import BlockPools
from petmjx.engines.warp.block_sizes import SIZES
from petmjx.engines.warp.compiled_programs import constants
from petmjx.engines.warp.contact_buffers import CONTACTS_PER_BOX, MAX_GROWTH, MORE_BOXES, PAIRS_PER_BOX, most_room
from petmjx.engines.warp.kernel_features import KernelFeatures
from petmjx.engines.warp.kernel_launcher import KernelLauncher
from petmjx.options.simulation import Simulation

USUAL = Simulation()
STIFF = USUAL.changed(physics=stiffened_physics(USUAL.physics, 0.5))
SMALL, LARGE = (size.most_boxes for size in SIZES)


def group(sim: Simulation = USUAL, widths: dict[int, int] | None = None, boards: int = 1) -> Any:
    """Return a stand-in for a group of three worlds, which begin with 1, 15 and 16 boxes."""
    run = SimpleNamespace(sim=sim, needs=KernelFeatures(widths or {SMALL: 40}))
    table = SimpleNamespace(placed=[1, 15, 16, 0, 0])  # the last two rows are spare
    return SimpleNamespace(run=run, table=table, jobs=[None] * 3, boards=boards)


@pytest.fixture
def few_worlds(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Pretend that this device has blocks for worlds of few boxes. Return the list of the numbers of worlds that asked
    for them."""
    counts: list[int] = []

    def pool_for_few(pool: Any, worlds: int, lanes: int | None) -> Any:
        counts.append(worlds)
        return replace(pool, least=1)

    monkeypatch.setattr(block_pool_choice, "small_world_pool", pool_for_few)
    monkeypatch.setattr(block_pool_choice, "tail_pool", lambda pool, lanes: replace(pool, last=True))
    return counts


def kinds(pools: Any) -> list[str]:
    return ["last" if pool.last else "few" if pool.least else str(pool.n_boxes) for pool in pools]


def test_the_largest_worlds_come_first_behind_the_extra_ones(few_worlds: list[int]) -> None:
    pools = BlockPools(None, lambda launch: 3).of(group(widths={SMALL: 40, LARGE: 120}))
    assert kinds(pools) == ["last", "few", "120", "40"]
    assert [pool.n_boxes for pool in pools] == [40, 40, 120, 40]
    assert few_worlds == [2]
    assert {pool.blocks for pool in pools} == {3}


def test_stiff_contacts_have_no_blocks_for_few_boxes(few_worlds: list[int]) -> None:
    pools = BlockPools(None, lambda launch: 3).of(group(STIFF, {SMALL: 40, LARGE: 120}))
    assert kinds(pools) == ["last", "120", "40"]
    assert pools[0].n_boxes == 40
    assert few_worlds == []


def test_stiffer_contacts_among_others_have_blocks_like_those_for_last_worlds(few_worlds: list[int]) -> None:
    mixed = group(widths={SMALL: 40, LARGE: 120})
    mixed.run.needs |= KernelFeatures({}, stiff=frozenset([0.5]))
    pools = BlockPools(None, lambda launch: 3).of(mixed)
    assert kinds(pools) == ["last", "few", "120", "40", "120", "40"]
    assert [pool.stiff for pool in pools] == [None, None, 0.5, 0.5, None, None]
    assert not pools[3].is_extra, "no other pool has room for these worlds"
    assert replace(pools[3], stiff=None, last=True) == pools[0]
    launcher = KernelLauncher(constants(USUAL, build_timetable(USUAL, 40)), pools, of_stiff={0.5: {"quiet_steps": 99}})
    assert launcher.blocks == 6, "they run in the place of others"
    usual = USUAL.quiet.steps
    assert [model.quiet_steps for model in launcher.models] == [usual, usual, 99, 99, usual, usual]


def test_larger_buffers_are_of_the_size_that_needs_them_and_end_blocks_for_few_boxes(few_worlds: list[int]) -> None:
    both = group(widths={SMALL: 40, LARGE: 120})
    mine = BlockPools(None, lambda launch: 3)
    usual = {pool.n_boxes: pool for pool in mine.of(both)}
    assert mine.buffers.grow(both.run, LARGE) == 2
    assert kinds(mine.of(both)) == ["last", "few", "120", "40"], "the others are of the usual size"
    assert mine.buffers.grow(both.run, SMALL) == 2
    grown = mine.of(both)
    assert kinds(grown) == ["last", "120", "40"]
    for pool in grown:
        assert (pool.npairmax, pool.nconmax) == (
            2 * usual[pool.n_boxes].npairmax, 2 * usual[pool.n_boxes].nconmax
        )  # fmt: skip
    assert mine.buffers.grow(group(STIFF, widths={SMALL: 40}).run, SMALL) == 4, "for the same cones"
    pyramids = USUAL.changed(physics=USUAL.physics.changed(cone="pyramidal"))
    assert kinds(mine.of(group(pyramids))) == ["last", "few", "40"]


def test_buffers_grow_until_a_world_of_the_largest_size_would_have_enough() -> None:
    mine, run = BlockPools(None, lambda launch: 3), group(widths={SMALL: SMALL}).run
    growths = [mine.buffers.grow(run, SMALL) for _ in range(4)]
    assert growths == [2, 4, MAX_GROWTH, None]
    narrow = group(widths={SMALL: 2}).run
    mine = BlockPools(None, lambda launch: 3)
    while mine.buffers.grow(narrow, SMALL):
        pass
    (pool,) = mine.of(group(widths={SMALL: 2}))[-1:]
    assert pool.npairmax == PAIRS_PER_BOX * most_room(SMALL)


@pytest.mark.parametrize("boards", [1, 3])
def test_each_shape_of_a_carrier_has_room_as_a_box_has(boards: int) -> None:
    *_, pool = BlockPools(None, lambda launch: 3).of(group(boards=boards))
    shapes = 40 + MORE_BOXES + boards - 1
    assert (pool.npairmax, pool.nconmax) == (PAIRS_PER_BOX * shapes, CONTACTS_PER_BOX * shapes)
    assert pool.boards == boards
