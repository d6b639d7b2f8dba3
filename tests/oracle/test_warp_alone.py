"""On mjx-warp long worlds share no multiprocessor: results stay the same to the last bit."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.plans import heap, make_scene
from support.tiny_worlds import assert_equal_worlds
from support.worlds import simulate

from petmjx.engines.warp import alone
from petmjx.engines.warp.alone import MOST_ALONE, expected_last
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.group import Group
from petmjx.engines.warp.programs import programs
from petmjx.engines.warp.rollout import Rollout, Slice
from petmjx.options.config import Simulation


def found(steps: list[int], ended: list[int], lanes: int = 1, spare: int = 0) -> list[int]:
    """With rows that no queue has behind the worlds."""
    queued, n = len(steps), len(steps) + spare
    order = jnp.array([[*range(1, queued), -1], [0, *[-1] * (queued - 1)]], jnp.int32)
    running = jnp.array([world not in ended for world in range(n)])
    return np.flatnonzero(expected_last(order, jnp.array(steps + [0] * spare, jnp.int32), running, lanes)).tolist()


def test_worlds_that_have_taken_many_times_the_usual_steps_are_expected_to_be_last() -> None:
    assert found([9, 31, 30, 10, 400, 95, 12], ended=[3]) == [1, 4, 5]
    assert found([500, 3, 1, 0], ended=[]) == [], "none has ended"
    assert found([500, 3, 1, 10, 90], ended=[3, 4]) == [0], "50 in the mean"
    assert found([9, 400, 10, 10, 10, 10, 500], ended=[2, 3, 4, 5, 6]) == [1], "the last one has ended"
    many = [70_000] * 32_768  # more steps in all than an int32 holds
    assert found([*many, 80_000, 300_000], ended=list(range(len(many)))) == [len(many) + 1]


def test_a_long_world_is_not_the_last_one_as_long_as_many_wait() -> None:
    steps = [100, 10] + [0] * 98  # so 980 steps are left
    assert found(steps, ended=[1], lanes=3, spare=28) == [0]
    assert found(steps, ended=[1], lanes=2, spare=28) == []


def test_where_many_are_long_none_is_an_exception() -> None:
    assert found([10, *[100] * MOST_ALONE], ended=[0]) == list(range(1, 1 + MOST_ALONE))
    assert found([10, *[100] * (MOST_ALONE + 1)], ended=[0]) == []


@pytest.mark.gpu
def test_which_worlds_share_a_multiprocessor_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = {f"heap of {n}, {k}": make_scene(heap(n)) for n in (15, 24, 40) for k in range(120)}
    sim = Simulation(interval_s=0.1, rest_window_s=0.1, settle_s=0.3)
    shared = simulate(MjxWarpEngine(slice_ns=3_000_000), scenes, sim)
    counts: list[np.ndarray[Any, Any]] = []
    wait = Rollout.wait

    def watched(self: Rollout, group: Group) -> tuple[Any, Slice]:
        status, ended = wait(self, group)
        counts.append(np.array([np.asarray(ended.counts[name]) for name in ("arrived", "alone_on")]))
        return status, ended

    monkeypatch.setattr(Rollout, "wait", watched)
    monkeypatch.setattr(alone, "LONG", 0.0)
    monkeypatch.setattr(alone, "GOES_ON", np.inf)
    monkeypatch.setattr(alone, "MOST_ALONE", 10**6)
    programs.cache_clear()
    assert_equal_worlds(simulate(MjxWarpEngine(slice_ns=3_000_000), scenes, sim), shared)
    programs.cache_clear()
    arrived, alone_on = np.array(counts).swapaxes(0, 1)
    assert alone_on.sum(1).max() > MOST_ALONE
    assert arrived.max() == 2, "two blocks for these worlds fit on a multiprocessor"
