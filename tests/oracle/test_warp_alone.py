"""On mjx-warp long worlds share no multiprocessor: results stay the same to the last bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.plans import heap, make_scene
from support.tiny_worlds import SHORT, STEP_NS, assert_equal_worlds, engine, tiny_scenes
from support.worlds import simulate

from petmjx.engines.warp import alone
from petmjx.engines.warp.alone import MOST_ALONE, expected_last
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.group import Group
from petmjx.engines.warp.launch import Launch, Size
from petmjx.engines.warp.programs import programs
from petmjx.engines.warp.rollout import Rollout, Slice
from petmjx.options.config import Simulation
from petmjx.verdict import Outcome


def expected(steps: list[int], ended: list[int], lanes: int = 1, spare: int = 0) -> list[int]:
    """With rows that no queue has behind the worlds."""
    queued, n = len(steps), len(steps) + spare
    order = jnp.array([[*range(1, queued), -1], [0, *[-1] * (queued - 1)]], jnp.int32)
    running = jnp.array([world not in ended for world in range(n)])
    return np.flatnonzero(expected_last(order, jnp.array(steps + [0] * spare, jnp.int32), running, lanes)).tolist()


def test_worlds_that_have_taken_many_times_the_usual_steps_are_expected_to_be_last() -> None:
    assert expected([9, 31, 30, 10, 400, 95, 12], ended=[3]) == [1, 4, 5]
    assert expected([500, 3, 1, 0], ended=[]) == [], "none has ended"
    assert expected([500, 3, 1, 10, 90], ended=[3, 4]) == [0], "50 in the mean"
    assert expected([9, 400, 10, 10, 10, 10, 500], ended=[2, 3, 4, 5, 6]) == [1], "the last one has ended"
    many = [70_000] * 32_768  # more steps in all than an int32 holds
    assert expected([*many, 80_000, 300_000], ended=list(range(len(many)))) == [len(many) + 1]


def test_a_long_world_is_not_the_last_one_as_long_as_many_wait() -> None:
    steps = [100, 10] + [0] * 98  # so 980 steps are left
    assert expected(steps, ended=[1], lanes=3, spare=28) == [0]
    assert expected(steps, ended=[1], lanes=2, spare=28) == []


def test_where_many_are_long_none_is_an_exception() -> None:
    assert expected([10, *[100] * MOST_ALONE], ended=[0]) == list(range(1, 1 + MOST_ALONE))
    assert expected([10, *[100] * (MOST_ALONE + 1)], ended=[0]) == []


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[int, int]]]:
    """Every long world is to be alone. Most blocks that came to a multiprocessor, and worlds that were to have one to
    themselves, slice after slice."""
    counts: list[tuple[int, int]] = []
    wait = Rollout.wait

    def watched(self: Rollout, group: Group) -> tuple[Any, Slice]:
        status, ended = wait(self, group)
        arrived, alone_on = (np.asarray(ended.counts[name]) for name in ("arrived", "alone_on"))
        counts.append((int(arrived.max()), int(alone_on.sum())))
        return status, ended

    monkeypatch.setattr(Rollout, "wait", watched)
    monkeypatch.setattr(alone, "LONG", 0.0)
    monkeypatch.setattr(alone, "GOES_ON", np.inf)
    monkeypatch.setattr(alone, "MOST_ALONE", 10**6)
    programs.cache_clear()
    yield counts
    programs.cache_clear()


def test_blocks_that_give_way_change_no_bit(
    found: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """On a CPU all blocks are on one multiprocessor. The first one goes on, so that worlds come to their end."""
    of = Launch.of

    def sharing(size: Size, *traits: bool) -> Launch:
        return replace(of(size, *traits), blocks=4, per_sm=4)

    monkeypatch.setattr(Launch, "of", sharing)
    assert_equal_worlds(simulate(engine(slice_ns=STEP_NS), tiny_scenes(), SHORT), crowd)
    arrived, alone_on = np.array(found).T
    assert arrived.max() == 4
    assert alone_on.max() > 0


@pytest.mark.gpu
def test_which_worlds_share_a_multiprocessor_changes_no_bit(
    found: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes = {f"heap of {n}, {k}": make_scene(heap(n)) for n in (15, 24, 40) for k in range(120)}
    sim = Simulation(interval_s=0.1, rest_window_s=0.1, settle_s=0.3)
    alone_in_some = simulate(MjxWarpEngine(slice_ns=3_000_000), scenes, sim)
    arrived, alone_on = np.array(found).T
    assert alone_on.max() > MOST_ALONE
    assert arrived.max() == 2, "two blocks for these worlds fit on a multiprocessor"
    monkeypatch.undo()
    programs.cache_clear()
    assert_equal_worlds(simulate(MjxWarpEngine(slice_ns=3_000_000), scenes, sim), alone_in_some)
