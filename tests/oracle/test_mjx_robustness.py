"""What can go wrong on a device: buffers that overflow, numbers that are none, memory that runs out."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fake_stepper import FakeData, FakeEngine, FakeStepper, assert_same, fake_scene, run_all

from petmjx.config import Simulation
from petmjx.engines.base import Progress
from petmjx.engines.batch import engine as mjx
from petmjx.engines.batch.groups import MAX_GROWTH, MIN_LANES, is_out_of_memory
from petmjx.engines.batch.stage import Stage
from petmjx.verdict import Flag, Outcome, Reason, Verdict
from petmjx.world.job import Job

SHORT = Simulation(interval_s=0.3, sample_interval_s=0.05)
MARKED_KG = 13.0
"""Boxes of this mass are those that something happens to."""
HAPPENS_AT_AGE = 7

PLAIN = Job(fake_scene(1.0, 60.0, 1.0))
MARKED = Job(fake_scene(1.0, MARKED_KG, 1.0))
JOBS = [MARKED if world % 8 == 3 else PLAIN for world in range(40)]


def happens(stepper: FakeStepper, data: FakeData) -> jax.Array:
    """Lanes with a marked box of the age at which something happens."""
    return ((data.mass == MARKED_KG) & (stepper.ages(data) == HAPPENS_AT_AGE)).any(-1)


class OverflowingStepper(FakeStepper):
    """A buffer is too small for marked boxes."""

    def overflow(self, scratch: FakeData) -> jax.Array:
        return jnp.where(happens(self, scratch), int(Flag.CONTACT_OVERFLOW), 0)


class OverflowingEngine(FakeEngine):
    """Buffers have to be ``enough`` times as large for marked boxes."""

    def __init__(self, enough: float, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.enough = enough
        self.growths: list[int] = []

    def make_stepper(self, capacity: int, boards: int, lanes: int, sim: Simulation, *, held: bool, growth: int) -> Any:
        self.growths.append(growth)
        kind = OverflowingStepper if growth < self.enough else FakeStepper
        return kind(capacity, lanes, held=held)


class PoisonedStepper(FakeStepper):
    """Marked boxes turn into no number."""

    def step(self, overrides: dict[str, jax.Array], inputs: dict[str, jax.Array], scratch: FakeData) -> FakeData:
        after = super().step(overrides, inputs, scratch)
        return after._replace(qpos=jnp.where(happens(self, after)[:, None], jnp.nan, after.qpos))


class PoisonedEngine(FakeEngine):
    def make_stepper(self, capacity: int, boards: int, lanes: int, sim: Simulation, *, held: bool, growth: int) -> Any:
        return PoisonedStepper(capacity, lanes, held=held)


@pytest.fixture(scope="module")
def healthy() -> list[Outcome]:
    """The same worlds where nothing happens."""
    return run_all(FakeEngine(16, capacities=(3,)), JOBS, SHORT)


def test_overflowed_worlds_run_again_in_larger_buffers(healthy: list[Outcome]) -> None:
    engine, progress = OverflowingEngine(3, 16, capacities=(3,)), Progress()
    outcomes = run_all(engine, JOBS, SHORT, progress)
    assert engine.growths == [1, 2, 4]
    for job, found, expected in zip(JOBS, outcomes, healthy, strict=True):
        assert bool(found.flags & Flag.RERUN_AFTER_OVERFLOW) == (job is MARKED)
        assert not found.flags & Flag.CONTACT_OVERFLOW
        assert_same(found, expected)
    # The next run begins with buffers that are large enough.
    again = run_all(engine, JOBS, SHORT)
    assert engine.growths == [1, 2, 4]
    assert not any(outcome.flags & Flag.RERUN_AFTER_OVERFLOW for outcome in again)


def test_an_overflow_in_a_later_stage_runs_that_stage_again() -> None:
    late = [Job(fake_scene(1.0, 1.0, MARKED_KG)), Job(fake_scene(1.0, 1.0, 1.0))]
    engine = OverflowingEngine(2, 16, capacities=(2, 3))
    found, other = run_all(engine, late, SHORT)
    assert found.flags & Flag.RERUN_AFTER_OVERFLOW
    assert not other.flags & Flag.RERUN_AFTER_OVERFLOW
    for rerun, healthy in zip((found, other), run_all(FakeEngine(16, capacities=(2, 3)), late, SHORT), strict=True):
        assert_same(rerun, healthy)


def test_what_overflows_for_ever_is_invalid(healthy: list[Outcome]) -> None:
    engine = OverflowingEngine(float("inf"), 16, capacities=(3,))
    outcomes = run_all(engine, JOBS, SHORT)
    assert max(engine.growths) == MAX_GROWTH
    for job, found, expected in zip(JOBS, outcomes, healthy, strict=True):
        if job is MARKED:
            assert (found.verdict, found.reason) == (Verdict.INVALID, Reason.OVERFLOW)
            assert found.flags & Flag.CONTACT_OVERFLOW
        else:
            assert_same(found, expected)


def test_no_number_is_invalid_and_harms_no_other_world(healthy: list[Outcome]) -> None:
    outcomes = run_all(PoisonedEngine(16, capacities=(3,)), JOBS, SHORT)
    for job, found, expected in zip(JOBS, outcomes, healthy, strict=True):
        if job is MARKED:
            assert (found.verdict, found.reason) == (Verdict.INVALID, Reason.NONFINITE)
            assert found.n_steps < expected.n_steps
        else:
            assert_same(found, expected)  # bit for bit: tolerances are 0


# ---------------------------------------------------------------------- memory


def out_of_memory() -> RuntimeError:
    return RuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 12884901888 bytes.")


class SmallDevice(FakeEngine):
    """Holds so many lanes."""

    def __init__(self, holds: int, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.holds = holds
        self.tried: list[int] = []

    def make_stepper(self, capacity: int, boards: int, lanes: int, sim: Simulation, *, held: bool, growth: int) -> Any:
        self.tried.append(lanes)
        if lanes > self.holds:
            raise out_of_memory()
        return super().make_stepper(capacity, boards, lanes, sim, held=held, growth=growth)


def test_too_many_lanes_are_halved_until_they_fit(healthy: list[Outcome]) -> None:
    engine, progress = SmallDevice(16, 64, capacities=(3,)), Progress()
    outcomes = run_all(engine, JOBS, SHORT, progress)
    assert engine.tried == [64, 32, 16]
    for found, expected in zip(outcomes, healthy, strict=True):
        assert_same(found, expected)


def test_a_run_that_found_little_memory_does_not_bind_the_next(healthy: list[Outcome]) -> None:
    engine = SmallDevice(16, 64, group_size=20, capacities=(3,))
    run_all(engine, JOBS, SHORT)
    assert engine.tried == [32, 16]  # the second group of 20 knows what the first one found
    engine.holds = 64
    engine.tried.clear()
    outcomes = run_all(engine, JOBS, SHORT)
    assert engine.tried[0] == 32
    for found, expected in zip(outcomes, healthy, strict=True):
        assert_same(found, expected)


def test_memory_that_runs_out_midway_loses_nothing(healthy: list[Outcome], monkeypatch: pytest.MonkeyPatch) -> None:
    class FailingStage(Stage):
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            compiled, calls = self.run_chunk, iter(range(1_000_000))

            def run_chunk(*given: Any) -> Any:
                if self.lanes > 16 and next(calls) >= 3:
                    raise out_of_memory()
                return compiled(*given)

            self.run_chunk = run_chunk

    monkeypatch.setattr(mjx, "Stage", FailingStage)
    outcomes = run_all(FakeEngine(32, capacities=(3,)), JOBS, SHORT)
    for found, expected in zip(outcomes, healthy, strict=True):
        assert_same(found, expected)


def test_a_device_without_any_room_gives_invalid_worlds() -> None:
    engine = SmallDevice(0, 64, capacities=(3,))
    outcomes = run_all(engine, JOBS[:6], SHORT)
    assert engine.tried == [MIN_LANES]
    for outcome in outcomes:
        assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.OUT_OF_MEMORY)
        assert outcome.flags & Flag.OUT_OF_MEMORY
        assert np.isnan(outcome.boxes.rest_top_force_n).all()


def test_other_errors_are_not_taken_for_lack_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> Any:
        raise RuntimeError("INVALID_ARGUMENT: shapes do not match")

    engine = FakeEngine(16, capacities=(3,))
    monkeypatch.setattr(engine, "make_stepper", broken)
    with pytest.raises(RuntimeError, match="shapes do not match"):
        run_all(engine, JOBS, SHORT)


@pytest.mark.parametrize(
    ("text", "is_memory"),
    [
        ("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 1 bytes", True),
        ("Failed to allocate 1073741824 bytes on device 'cuda:0'", True),
        ("CUDA error 2: out of memory", True),
        ("INTERNAL: illegal memory access", False),
    ],
)
def test_errors_that_mean_lack_of_memory(text: str, is_memory: bool) -> None:
    assert is_out_of_memory(RuntimeError(text)) == is_memory
