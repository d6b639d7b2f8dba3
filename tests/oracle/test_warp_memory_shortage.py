"""If memory runs out on mjx-warp, no world is lost, and no world has other results."""

from __future__ import annotations

import gc
import itertools
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.world.job import Drive, Excitation, Job

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.fake_stepper import assert_same, run_all
from support.job_streams import feedback_stream
from support.plans import make_scene
from support.tiny_worlds import (
    CHANGING_NS,
    LONG_NS,
    SHORT,
    SOME_NS,
    STEP_NS,
    TINY,
    assert_equal_worlds,
    engine,
    out_of_memory,
    room_for_one_pool,
    sizes_apart,
    tiny,
    tiny_scenes,
    watched_rollouts,
)
from support.worlds import simulate

from petmjx.engines.warp import contact_buffers, memory_shortage
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import MIN_BLOCKS, BlockPool
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.kernel_launcher import KernelLauncher
from petmjx.engines.warp.time_slices import Rollout
from petmjx.engines.warp.world_arrays import BUFFER_WORDS, axes, buffer_rows
from petmjx.engines.warp.world_table import TableRun, WorldTable

pytestmark = pytest.mark.usefixtures("ranks_may_differ")


@pytest.mark.slow
def test_each_size_alone_may_have_room(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    sizes_apart(monkeypatch, 4)
    tried = room_for_one_pool(monkeypatch)
    scenes = {**tiny_scenes(("hand-one-box", "hand-bridge")), "five": make_scene(5)}
    outcomes = simulate(engine(), scenes, SHORT)
    assert outcomes.pop("five").reason is not Reason.OUT_OF_MEMORY
    assert_equal_worlds(outcomes, crowd)
    assert tried[0] == 2
    assert tried.count(1) == 2


def small_device(monkeypatch: pytest.MonkeyPatch, holds: Callable[[int, int], bool]) -> list[int]:
    """Pretend that the device has 256 blocks and memory as ``holds`` says. Return a list that gets each number of
    blocks that an engine tries.

    Args:
        holds: Function of the number of blocks and the number of contacts per block. The function says whether memory
            suffices.
    """
    tried = []

    def look(n_boxes: int, nconmax: int, blocks: int) -> None:
        tried.append(blocks)
        if not holds(blocks, nconmax):
            raise out_of_memory()

    here = Launch.here
    monkeypatch.setattr(Launch, "here", lambda *args, **options: replace(here(*args, **options), blocks=256))
    watched_rollouts(monkeypatch, look)
    return tried


@pytest.mark.slow
def test_too_many_blocks_are_halved_until_they_fit(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    tried = small_device(monkeypatch, lambda blocks, _: blocks <= 64)
    names = ("hand-one-box", "hand-bridge")
    assert_equal_worlds(simulate(MjxWarpEngine(allow_cpu=True), tiny_scenes(names), SHORT), crowd)
    assert tried == [256, 128, 64]


@pytest.mark.slow
def test_fewer_blocks_than_are_usually_worth_while_are_as_the_user_wants(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    tried = small_device(monkeypatch, lambda *_: True)
    few = MIN_BLOCKS // 4
    outcomes = simulate(MjxWarpEngine(few, allow_cpu=True), tiny_scenes(("hand-one-box",)), SHORT)
    assert_equal_worlds(outcomes, crowd)
    assert tried == [few]


def test_a_device_without_any_room_gives_invalid_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = small_device(monkeypatch, lambda *_: False)
    for outcome in simulate(MjxWarpEngine(allow_cpu=True), tiny_scenes(), SHORT).values():
        assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.OUT_OF_MEMORY)
    assert tried == [256, 128, 64, 32, 16]


@pytest.mark.slow
@pytest.mark.parametrize("grows", [False, True])
def test_memory_that_runs_out_while_buffers_grow_ends_what_is_not_at_its_end(
    grows: bool, monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """One world has its outcome already, one world waits for its drive (motion of the carrier), and one world needs
    more contacts than fit into memory. If no more jobs may come, the next slice is already running when the host sees
    the lack of memory, and the drive ends in this slice."""
    monkeypatch.setattr(contact_buffers, "CONTACTS_PER_BOX", 2)
    small_device(monkeypatch, lambda _, nconmax: nconmax <= 12)
    drive = Drive(Excitation("still", "force", np.zeros((5, 3))), rest_s=0.1)
    one_box = tiny("hand-one-box")
    jobs = (feedback_stream if grows else list)([Job(tiny("brickwork")), Job(one_box, drive), Job(one_box)])
    large, waits, ended = run_all(MjxWarpEngine(allow_cpu=True, slice_ns=LONG_NS), jobs, SHORT)
    assert large.reason is Reason.OUT_OF_MEMORY
    assert (waits.reason is Reason.OUT_OF_MEMORY) == grows
    assert_same(ended, crowd["hand-one-box"])


class FailingRollout(Rollout):
    """A rollout that fails in its third time slice if it has more than ``holds`` worlds. A slice is one step long if
    the rollout may still fail."""

    holds = 2
    error: Callable[[], Exception] = staticmethod(out_of_memory)
    failures = 0
    """Number of failures of all rollouts of a class."""

    def __init__(self, run: TableRun, pools: Sequence[BlockPool], slice_ns: int) -> None:
        super().__init__(run, pools, CHANGING_NS)
        self.waits, self.launcher.slice_ns = 0, STEP_NS

    def wait(self, table: WorldTable) -> Any:
        self.waits += 1
        if len(table.jobs) <= self.holds:
            self.launcher.slice_ns = LONG_NS
        elif self.waits >= 3:
            type(self).failures += 1
            raise self.error()
        return super().wait(table)


@pytest.mark.slow
def test_memory_that_runs_out_midway_loses_nothing(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    monkeypatch.setattr(memory_shortage, "Rollout", FailingRollout)
    monkeypatch.setattr(FailingRollout, "failures", 0)
    outcomes = run_all(engine(), [Job(scene) for scene in tiny_scenes().values()], SHORT)
    assert_equal_worlds(dict(zip(TINY, outcomes, strict=True)), crowd)
    assert FailingRollout.failures == 2, "of all five worlds, and of three of them"


@pytest.mark.slow
def test_tables_are_free_before_their_worlds_are_simulated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """When memory runs out, the worlds of a table are simulated again in two tables of half the size, and so on. Each
    table is deleted before its halves are made."""
    load, tables, alive = MjxWarpEngine._load, list[weakref.ref[WorldTable]](), []

    def watched(self: MjxWarpEngine, *args: Any) -> WorldTable:
        alive.append(sum(table() is not None for table in tables))
        tables.append(weakref.ref(table := load(self, *args)))
        return table

    monkeypatch.setattr(memory_shortage, "Rollout", FailingRollout)
    monkeypatch.setattr(MjxWarpEngine, "_load", watched)
    run_all(engine(), [Job(tiny("hand-one-box"))] * 6, SHORT)
    assert alive == [0] * 7


@pytest.mark.slow
@pytest.mark.parametrize("slice_number", [1, 2, 4])
def test_a_slice_in_which_memory_runs_out_loses_nothing(
    slice_number: int, monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    """If memory runs out in a slice, the memory of the blocks and the tables are lost, too. The next slice may have
    begun already."""
    launch, launched = KernelLauncher.launch, itertools.count(1)

    def fails_once(self: KernelLauncher, arrays: dict[str, Any]) -> None:
        if next(launched) == slice_number:
            raise out_of_memory()
        launch(self, arrays)

    monkeypatch.setattr(KernelLauncher, "launch", fails_once)
    begun = engine(slice_ns=SOME_NS)
    assert_equal_worlds(simulate(begun, tiny_scenes(), SHORT), crowd)
    assert_equal_worlds(simulate(begun, tiny_scenes(TINY[:2]), SHORT), crowd)
    assert next(launched) > slice_number + 2


@pytest.mark.slow
def test_a_world_that_has_not_enough_memory_even_alone_is_invalid(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(FailingRollout):
        holds = 0

    monkeypatch.setattr(memory_shortage, "Rollout", Full)
    two = [Job(tiny("hand-one-box")), Job(tiny("hand-bridge"))]
    for outcome in run_all(engine(), two, SHORT):
        assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.OUT_OF_MEMORY)


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_memory_that_is_short_before_a_table_has_begun_ends_the_run(
    n_jobs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If memory is short before the first table has begun, the run ends instead of trying again for ever."""
    tried = itertools.count(1)

    def none_left(*_: object, **__: object) -> TableRun:
        if next(tried) > 20:
            pytest.fail("tried for ever")
        raise MemoryError("no room for times")

    monkeypatch.setattr(TableRun, "of", none_left)
    with pytest.raises(MemoryError, match="no room for times"):
        run_all(engine(), [Job(tiny("hand-one-box"))] * n_jobs, SHORT)


@pytest.mark.slow
def test_other_errors_are_raised_and_the_engine_goes_on(
    monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]
) -> None:
    class Broken(FailingRollout):
        error = staticmethod(lambda: RuntimeError("INTERNAL: illegal memory access"))

    begun = engine()
    with monkeypatch.context() as patch:
        patch.setattr(memory_shortage, "Rollout", Broken)
        with pytest.raises(RuntimeError, match="illegal memory access"):
            simulate(begun, tiny_scenes(), SHORT)
    assert_equal_worlds(simulate(begun, tiny_scenes(TINY[:2]), SHORT), crowd)


@pytest.mark.slow
def test_blocks_of_the_other_size_make_room(monkeypatch: pytest.MonkeyPatch, crowd: dict[str, Outcome]) -> None:
    """An engine keeps the memory of the blocks of its last run. If the next run needs blocks of another size, the
    engine frees this memory first, so the next run has as many blocks as without an earlier run."""
    tried = []

    def look(n_boxes: int, nconmax: int, blocks: int) -> None:
        tried.append((n_boxes, blocks))
        if any(not other.workspace.is_deleted() for other in made):
            raise out_of_memory()

    sizes_apart(monkeypatch, 4)
    made = watched_rollouts(monkeypatch, look)
    some = engine()
    assert simulate(some, {"five": make_scene(5)}, SHORT)["five"].reason is not Reason.OUT_OF_MEMORY
    outcomes = simulate(some, tiny_scenes(("hand-one-box",)), SHORT)
    assert_same(outcomes["hand-one-box"], crowd["hand-one-box"])
    assert [n_boxes for n_boxes, _ in tried] == [8, 4, 4]
    assert len({blocks for _, blocks in tried}) == 1


@pytest.mark.gpu
def test_a_device_whose_memory_runs_out_goes_on_with_fewer_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    some = {f"{name} {k}": scene for name, scene in tiny_scenes().items() for k in range(20)}
    some["large"] = make_scene(120)
    alone = simulate(MjxWarpEngine(), some, SHORT)
    gc.collect()  # the first engine's memory, which would otherwise become free during the next run
    crowded = MjxWarpEngine()
    blocks, room = Launch.here(120).blocks, 120 + contact_buffers.MORE_BOXES
    sizes = axes(blocks, 120, 1, contact_buffers.PAIRS_PER_BOX * room, contact_buffers.CONTACTS_PER_BOX * room)
    buffer_bytes = 4 * BUFFER_WORDS * buffer_rows(sizes)
    # The memory that should stay free is taken first, in one piece, and freed when all other memory is taken. JAX may
    # have reserved a piece that is up to 128 MB larger.
    left = TABLES_BYTES + buffer_bytes // 2
    rest = block(left)
    ballast = []
    for piece in PIECES:
        with suppress(jax.errors.JaxRuntimeError):  # the free memory may be in smaller pieces
            while free_bytes() > piece:
                ballast.append(block(piece))
    rest.delete()
    while free_bytes() > left + PIECES[-1]:
        ballast.append(block(PIECES[-1]))
    tried = []

    def look(n_boxes: int, nconmax: int, n_blocks: int) -> None:
        if n_boxes == 120:
            tried.append(n_blocks)

    watched_rollouts(monkeypatch, look)
    outcomes = simulate(crowded, some, SHORT)
    for buffer in ballast:
        buffer.delete()
    assert tried[0] == blocks
    assert tried[-1] < blocks
    assert_equal_worlds(outcomes, alone)


PIECES = 1 << 30, 1 << 26, 1 << 22
"""Sizes in bytes of the pieces that fill the device's memory."""

TABLES_BYTES = 192 << 20
"""Bytes: more than tables of some hundred worlds take, together with the memory that JAX needs for them."""


def block(size: int) -> jax.Array:
    """Take ``size`` bytes of the device's memory."""
    return jax.block_until_ready(jnp.zeros(size, jnp.uint8))


def free_bytes() -> int:
    """Return how many bytes of the device's memory JAX can still take."""
    stats = jax.devices()[0].memory_stats()
    return stats["bytes_limit"] - stats["bytes_in_use"]
