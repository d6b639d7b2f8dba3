"""Tiny worlds for tests of mjx-warp on a CPU, where its kernel is slow, and what tests watch of its engine."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from petmjx.engines.verdict import Outcome
from petmjx.engines.warp import block_launch
from petmjx.engines.warp import engine as mjx_warp
from petmjx.engines.warp.block_launch import Launch, size_for
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.kernel_launcher import BlockPool
from petmjx.engines.warp.time_slices import Rollout, Slice
from petmjx.engines.warp.world_arrays import most_panels
from petmjx.engines.warp.world_table import Run, WorldTable
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene, build_scene
from support.fake_stepper import assert_same
from support.worlds import boxes_by_plan, make_plan, simulate

TINY = ("hand-one-box", "hand-overhang-45", "hand-bridge", "hand-falls-off", "corner overhang of 30 %")

SHORT = Simulation(interval_s=0.1, rest_window_s=0.04, settle_s=0.3)

LONG_NS = 10**15
"""A time slice in which all worlds of a test end."""
SOME_NS, STEP_NS = 100_000, 0
"""One that the host ends, at the soonest after 0.1 ms: on a fast CPU tiny worlds take a few of them. And one in which
each block takes a step, so that they take hundreds."""

CHANGING_NS = 1
"""Programs are kept by the length of their slices. Those of this length belong to tests that set the length as they go
on, which each of them does from the first slice on."""

devices = pytest.mark.parametrize("device", ["here", pytest.param("gpu", marks=pytest.mark.gpu)])


def tiny_scenes(names: Sequence[str] = TINY) -> dict[str, Scene]:
    plans = boxes_by_plan()
    return {name: build_scene(make_plan(name, plans[name]), Simulation()) for name in names}


def tiny(name: str) -> Scene:
    return tiny_scenes((name,))[name]


def engine(**options: Any) -> MjxWarpEngine:
    return MjxWarpEngine(16, allow_cpu=True, **options)


@functools.cache
def shared_engine() -> MjxWarpEngine:
    return engine()


def in_one_slice() -> dict[str, Outcome]:
    return simulate(engine(slice_ns=LONG_NS), tiny_scenes(), SHORT)


def assert_equal_worlds(outcomes: dict[str, Outcome], expected: dict[str, Outcome]) -> None:
    """To the last bit."""
    for name, outcome in outcomes.items():
        assert_same(outcome, expected[name])
        assert outcome.flags == expected[name].flags


def watched_rollouts(monkeypatch: pytest.MonkeyPatch, look: Callable[[int, int, int], None]) -> list[Rollout]:
    """Before programs and buffers are made ``look`` sees each pool: most boxes, most contacts, blocks. It may raise.
    Returns a list of what is made."""
    made: list[Rollout] = []

    def rollout(run: Run, pools: Sequence[BlockPool], slice_ns: int) -> Rollout:
        for pool in pools:
            look(pool.n_boxes, pool.nconmax, pool.blocks)
        made.append(Rollout(run, pools, slice_ns))
        return made[-1]

    monkeypatch.setattr(mjx_warp, "Rollout", rollout)
    return made


def room_for_one_pool(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A device that holds blocks of one size, however few of them, but not of two. Returns a list of how many sizes
    were tried."""
    tried: list[int] = []

    def rollout(run: Run, pools: Sequence[BlockPool], slice_ns: int) -> Rollout:
        tried.append(len(pools))
        if len(pools) > 1:
            raise out_of_memory()
        return Rollout(run, pools, slice_ns)

    monkeypatch.setattr(mjx_warp, "Rollout", rollout)
    return tried


def sizes_apart(monkeypatch: pytest.MonkeyPatch, most_boxes: int) -> None:
    """Blocks of two sizes also for tiny worlds, with as many threads each."""
    small, large = block_launch.SIZES
    alike = replace(small, most_boxes=most_boxes), replace(small, most_boxes=large.most_boxes)
    monkeypatch.setattr(block_launch, "SIZES", alike)
    here = Launch.here

    def sized(n_boxes: int, *features: bool) -> Launch:
        return replace(here(n_boxes, *features), panels=most_panels(size_for(n_boxes).most_boxes))

    monkeypatch.setattr(Launch, "here", sized)


def watched_queues(monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """Worlds that each pool has taken, slice after slice, with those that have ended."""
    queue_counts: list[list[int]] = []
    wait = Rollout.wait

    def watched(self: Rollout, table: WorldTable) -> tuple[NDArray[np.int32], Slice]:
        status, ended = wait(self, table)
        requests, in_vain = (np.asarray(ended.counts[name]) for name in ("taken", "idle"))
        queue_counts.append((requests - in_vain).tolist())
        return status, ended

    monkeypatch.setattr(Rollout, "wait", watched)
    return queue_counts


def out_of_memory() -> RuntimeError:
    return RuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 12884901888 bytes.")
