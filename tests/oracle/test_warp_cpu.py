"""The engine mjx-warp-cpu, which simulates worlds with the kernels of mjx-warp in several threads of a CPU."""

from __future__ import annotations

import functools
import itertools
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.fake_stepper import assert_same, run_all
from support.plans import make_scene, stack

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import jax
import warp as wp
from support.compiles import compiled_programs
from support.tiny_worlds import SHORT, TINY, assert_equal_worlds, in_one_slice, tiny_scenes
from support.worlds import simulate

import petmjx
from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.verdict import Outcome
from petmjx.engines.warp import block_launch, kernel_launcher
from petmjx.engines.warp.block_launch import Call
from petmjx.engines.warp.cpu_engine import MjxWarpCpuEngine
from petmjx.world.history import Record
from petmjx.world.job import Job

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="jax uses a GPU in this process")

MANY = 40
"""Number of worlds: enough for several threads to take worlds at the same moment."""


@functools.cache
def crowd() -> dict[str, Outcome]:
    return in_one_slice()


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_worlds_are_the_same_to_the_last_bit_on_any_number_of_threads(
    threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each thread of the CPU has a block of one thread."""
    launched: set[tuple[int, int]] = set()

    def launch_all(calls: Sequence[Call], *some: Any) -> None:
        launched.update((call.blocks, call.threads) for call in calls)
        block_launch.launch_all(calls, *some)

    monkeypatch.setattr(kernel_launcher, "launch_all", launch_all)
    scenes = {f"{name} {k}": scene for k in range(MANY // len(TINY)) for name, scene in tiny_scenes().items()}
    outcomes = simulate(MjxWarpCpuEngine(threads), scenes, SHORT)
    assert_equal_worlds(outcomes, {name: crowd()[name.rpartition(" ")[0]] for name in scenes})
    assert launched == {(threads, 1)}


def test_recorded_worlds_of_several_threads_keep_their_own_frames() -> None:
    """All thread blocks write their frames into one shared buffer."""
    boxes = [stack(2), stack(3, 260.0), stack(1), stack(2, 160.0)]
    jobs = [Job(make_scene(some, SHORT), record=Record(0.02)) for some in boxes]
    alone, together = (run_all(MjxWarpCpuEngine(threads), jobs, SHORT) for threads in (1, 3))
    for one, other in zip(alone, together, strict=True):
        assert_same(one, other)
        assert one.history is not None
        assert other.history is not None
        np.testing.assert_array_equal(one.history.pos, other.history.pos)
        np.testing.assert_array_equal(one.history.time_s, other.history.time_s)


def test_open_worlds_go_on_in_several_threads() -> None:
    scenes = list(tiny_scenes().values())
    outcome_lists = []
    for threads in (1, 3):
        worlds = MjxWarpCpuEngine(threads).open(scenes, SHORT)
        worlds.go_on()
        outcome_lists.append(worlds.finish(range(len(scenes))))
    for one, other in zip(*outcome_lists, strict=True):
        assert_same(one, other)
    assert [one.verdict for one in outcome_lists[0]] == [crowd()[name].verdict for name in TINY]


def test_engines_of_several_threads_work_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Engines work at the same time when they make further attempts (simulations with other options) beside a GPU.

    The first slice (launch of the kernel) of one engine waits for the first slice of the other engine. The second slice
    of the same engine cannot come before that, since it needs the states that the first slice leaves.
    """
    met, slices = threading.Barrier(2), itertools.count()
    inner = block_launch.wait

    def wait(*some: Any, **more: Any) -> Any:
        if next(slices) < 2:
            met.wait(timeout=60.0)
        return inner(*some, **more)

    monkeypatch.setattr(block_launch, "wait", wait)
    scenes = tiny_scenes()
    with ThreadPoolExecutor(2) as pool:
        both = [pool.submit(simulate, MjxWarpCpuEngine(1), scenes, SHORT) for _ in range(2)]
        for future in both:
            assert_equal_worlds(future.result(), crowd())


class Blocks:
    """A stand-in for a ``Call``. The first block of the stand-in fails, while its second block goes on to the end of
    the time slice."""

    blocks = 2

    def __init__(self, clock: NDArray[np.int32]) -> None:
        self.clock, self.ended = clock, False

    def launch(self, first: int, blocks: int, **options: Any) -> None:
        if first == 0:
            raise RuntimeError("it failed")
        while not self.clock[0]:
            time.sleep(0.01)
        time.sleep(0.1)
        self.ended = True


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_error_waits_for_blocks_that_still_use_the_memory(
    error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = np.zeros(1, np.int32)
    call, inner = Blocks(clock), block_launch.wait

    def wait(*some: Any, **more: Any) -> Any:
        if error is KeyboardInterrupt and "timeout" in more:
            raise error
        return inner(*some, **more)

    monkeypatch.setattr(block_launch, "wait", wait)
    with wp.ScopedDevice("cpu"), pytest.raises(error):
        block_launch.launch_all([call], SimpleNamespace(numpy=lambda: clock), slice_ns=50_000_000)  # type: ignore[list-item]  # stands in
    assert call.ended


def test_a_score_says_what_it_ran_on_and_agrees_with_mujoco() -> None:
    run, exact = (petmjx.score(limit=8, engine=engine) for engine in ("mjx-warp-cpu", "mujoco"))
    assert run.info["config"]["engine"] == "mjx-warp-cpu"
    assert "thread" in run.info["device"]
    assert run.worlds.verdict.tolist() == exact.worlds.verdict.tolist()


@pytest.mark.parametrize(("options", "match"), [({"lanes": 4}, "lanes"), ({"world_timeout_s": 1.0}, "time of a world")])
def test_options_of_other_engines_are_refused(options: dict[str, Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        make_engine("mjx-warp-cpu", **options)


def test_without_warp_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.warp.cpu_engine.why_no_warp_on_cpu", lambda: "Warp is not installed")
    with pytest.raises(EngineUnavailable, match="cannot run here: Warp is not installed"):
        make_engine("mjx-warp-cpu")
    with pytest.raises(ValueError, match="threads must be at least 1"):
        MjxWarpCpuEngine(0)


def test_pallets_compile_nothing_after_the_first_placements() -> None:
    pallets = petmjx.Pallets(9, engine="mjx-warp-cpu", threads=2, most_boxes=4)
    box = {"size_mm": (400, 300, 200), "mass_kg": 5.0}
    pallets.reset([4])
    pallets.place(**box, corner_mm=[(0, 0, 0)] * 9)
    with compiled_programs() as compiled:
        for rows in ([3], [0, 1, 2, 8], [5, 7], range(8)):
            pallets.reset(list(rows))
            pallets.place(**box, corner_mm=[(400, 300, 0)] * len(rows), pallet=list(rows))
            pallets.results(list(rows))
        assert compiled == []
        jax.jit(lambda x: x + 1)(np.arange(7))
    assert compiled, "the listener hears of programs"
