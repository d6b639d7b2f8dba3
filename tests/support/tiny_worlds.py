"""Tiny worlds for tests of mjx-warp on a CPU, where its kernel is slow, and helpers that observe the engine."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from petmjx.engines.verdict import Outcome
from petmjx.engines.warp import block_sizes, memory_shortage
from petmjx.engines.warp.block_launch import Features, Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import size_for
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.time_slices import Rollout, Slice
from petmjx.engines.warp.world_arrays import most_panels
from petmjx.engines.warp.world_table import TableRun, WorldTable
from petmjx.options.quiet import Quiet
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene, build_scene
from support.fake_stepper import assert_same
from support.worlds import boxes_by_plan, make_plan, simulate

TINY = ("hand-one-box", "hand-overhang-45", "hand-bridge", "hand-falls-off", "corner overhang of 30 %")

SHORT = Simulation(interval_s=0.1, rest_window_s=0.04, settle_s=0.3, quiet=Quiet(landing_steps=10))
"""Options with which a tiny world that stands takes 45 to 80 steps."""

LONG_NS = 10**15
"""Length of a time slice in which all worlds of a test end, ns."""
SOME_NS, STEP_NS = 100_000, 0
"""Lengths of time slices, ns. The first slice ends after 0.1 ms at the earliest: on a fast CPU, tiny worlds take a few
such slices. In a slice of the second length, each block takes one step, so tiny worlds take hundreds of slices."""

CHANGING_NS = 1
"""A length of time slices that only some tests use: tests that change the length of the engine's slices, from the first
slice on. Programs are kept for each length, so these tests do not share programs with other tests."""

devices = pytest.mark.parametrize("device", ["here", pytest.param("gpu", marks=pytest.mark.gpu)])


def tiny_scenes(names: Sequence[str] = TINY) -> dict[str, Scene]:
    plans = boxes_by_plan()
    return {name: build_scene(make_plan(name, plans[name]), Simulation()) for name in names}


def tiny(name: str) -> Scene:
    return tiny_scenes((name,))[name]


def engine(**options: Any) -> MjxWarpEngine:
    """The tables of the engine have at least eight rows. For each smaller number, programs would be compiled anew."""
    made = MjxWarpEngine(16, allow_cpu=True, **options)
    made.least_rows = 8
    return made


@functools.cache
def shared_engine() -> MjxWarpEngine:
    return engine()


def in_one_slice() -> dict[str, Outcome]:
    return simulate(engine(slice_ns=LONG_NS), tiny_scenes(), SHORT)


def assert_equal_worlds(outcomes: dict[str, Outcome], expected: dict[str, Outcome]) -> None:
    """Check that outcomes and flags are equal to the last bit."""
    for name, outcome in outcomes.items():
        assert_same(outcome, expected[name])
        assert outcome.flags == expected[name].flags


def watched_rollouts(monkeypatch: pytest.MonkeyPatch, look: Callable[[int, int, int], None]) -> list[Rollout]:
    """Call ``look`` for each block pool (largest number of boxes, largest number of contacts, number of blocks) before
    programs and buffers are made. ``look`` may raise an error. Returns a list of the rollouts (buffers) that are
    made."""
    made: list[Rollout] = []

    def rollout(run: TableRun, pools: Sequence[BlockPool], slice_ns: int) -> Rollout:
        for pool in pools:
            look(pool.n_boxes, pool.nconmax, pool.blocks)
        made.append(Rollout(run, pools, slice_ns))
        return made[-1]

    monkeypatch.setattr(memory_shortage, "Rollout", rollout)
    return made


def room_for_one_pool(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Simulate a device with memory for blocks of one size, but not of two sizes, however few blocks there are. Returns
    a list of the numbers of sizes that were tried."""
    tried: list[int] = []

    def rollout(run: TableRun, pools: Sequence[BlockPool], slice_ns: int) -> Rollout:
        tried.append(len(pools))
        if len(pools) > 1:
            raise out_of_memory()
        return Rollout(run, pools, slice_ns)

    monkeypatch.setattr(memory_shortage, "Rollout", rollout)
    return tried


def sizes_apart(monkeypatch: pytest.MonkeyPatch, most_boxes: int) -> None:
    """Use blocks of two sizes for tiny worlds, too. Both sizes have the same number of threads. The kernel of the small
    blocks is compiled without optimisation, since compiling takes longer than these worlds."""
    monkeypatch.setattr("warp.config.optimization_level", 0)
    small, large = block_sizes.SIZES
    alike = replace(small, most_boxes=most_boxes), replace(small, most_boxes=large.most_boxes)
    monkeypatch.setattr(block_sizes, "SIZES", alike)
    here = Launch.here

    def sized(n_boxes: int, features: Features) -> Launch:
        return replace(here(n_boxes, features), panels=most_panels(size_for(n_boxes).most_boxes))

    monkeypatch.setattr(Launch, "here", sized)


def watched_queues(monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """A list with the numbers of worlds that each pool has taken, slice after slice. Ended worlds are included."""
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
