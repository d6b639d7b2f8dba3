"""Failures on a device: numbers that are not finite, and memory that runs out."""

from __future__ import annotations

import itertools
import threading
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fake_stepper import FakeEngine, FakeStepper, assert_same, fake_scene, run_all
from support.histories import assert_equal

from petmjx.common.errors import is_out_of_memory
from petmjx.engines.mjx.batch_step import Memory, PaddedModel, StepResult
from petmjx.engines.mjx.engine import Program
from petmjx.engines.mjx.host_to_device import Batch
from petmjx.engines.mjx.padded_template import FIRST_BOX_BODY
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.history import Record
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job

SHORT = Simulation(interval_s=0.3, sample_interval_s=0.05)
MARKED_KG = 13.0
"""Mass of the boxes to which something happens in these tests."""
HAPPENS_AT_AGE = 7

PLAIN = Job(fake_scene(1.0, 60.0, 1.0))
MARKED = Job(fake_scene(1.0, MARKED_KG, 1.0))
JOBS = [MARKED if world % 8 == 3 else PLAIN for world in range(40)]


class PoisonedStepper(FakeStepper):
    """A fake stepper (a step without physics) that turns the poses of marked boxes into NaN."""

    def step(
        self, fields: dict[str, jax.Array], inputs: dict[str, jax.Array], memory: Memory, *others: None
    ) -> StepResult:
        after = super().step(fields, inputs, memory)
        marked = fields["body_mass"][:, FIRST_BOX_BODY:] == MARKED_KG
        happens = (marked & (after.top_force == HAPPENS_AT_AGE)).any(-1, keepdims=True)
        return after._replace(qpos=jnp.where(happens, jnp.nan, after.qpos))


class PoisonedEngine(FakeEngine):
    def make_model(self, capacity: int, boards: int, sim: Simulation, *, held: bool, pausing: bool) -> PaddedModel:
        return PoisonedStepper(capacity, held=held)


@pytest.fixture(scope="module")
def healthy() -> list[Outcome]:
    """Outcomes of the same worlds without failures."""
    return run_all(FakeEngine(16), JOBS, SHORT)


def test_no_number_is_invalid_and_harms_no_other_world(healthy: list[Outcome]) -> None:
    outcomes = run_all(PoisonedEngine(16), JOBS, SHORT)
    for job, outcome, expected in zip(JOBS, outcomes, healthy, strict=True):
        if job is MARKED:
            assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.NONFINITE)
            assert outcome.n_steps < expected.n_steps
        else:
            assert_same(outcome, expected)  # bit for bit, since all tolerances are 0


# ---------------------------------------------------------------------- threads of a CPU


@pytest.fixture
def one_by_one(monkeypatch: pytest.MonkeyPatch) -> FakeEngine:
    """An engine that simulates worlds one by one on any device, as it does by default on a CPU."""
    engine = FakeEngine()
    monkeypatch.setattr(engine, "_one_by_one", True)
    return engine


def test_worlds_one_by_one_are_the_same_and_share_programs(one_by_one: FakeEngine) -> None:
    jobs = [Job(fake_scene(*masses)) for masses in ([1.0], [60.0, 1.0], [2.0, 1.0, 60.0])]
    for k, samples in ((0, 100), (2, 900)):
        excitation = Excitation(f"profile of {samples}", ACCELERATION, np.zeros((samples, 3)))
        jobs[k] = replace(jobs[k], drive=Drive(excitation, rest_s=0.1))
    outcomes = run_all(one_by_one, jobs, SHORT)
    for outcome, expected in zip(outcomes, run_all(FakeEngine(1), jobs, SHORT), strict=True):
        assert_same(outcome, expected)
    assert {(key.worlds, key.drive) for key in one_by_one.programs} == {(1, None), (1, ACCELERATION)}
    assert len(one_by_one.programs) == 2, "profiles of any length share one"


def test_a_run_that_is_closed_leaves_no_thread(one_by_one: FakeEngine) -> None:
    def simulating() -> list[str]:
        return [thread.name for thread in threading.enumerate() if thread.name.startswith("petmjx-mjx-jax")]

    run = one_by_one.run(JOBS, SHORT)
    next(run)
    assert simulating()
    run.close()
    assert not simulating()


# ---------------------------------------------------------------------- memory


def out_of_memory() -> RuntimeError:
    return RuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate 12884901888 bytes.")


class SmallDevice(FakeEngine):
    """An engine on a device that holds ``holds`` worlds at once. With more worlds its memory runs out after some
    steps."""

    def __init__(self, holds: int, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.holds = holds
        self.tried: list[int] = []

    def _program(self, batch: Batch, *args: Any) -> Program:
        program, worlds, calls = super()._program(batch, *args), len(batch.table.status), itertools.count()
        self.tried.append(worlds)

        def chunk(*given: Any) -> Any:
            if worlds > self.holds and next(calls) >= 3:
                raise out_of_memory()
            return program.chunk(*given)

        return replace(program, chunk=chunk)


def test_too_large_batches_are_halved_until_they_fit_and_the_next_run_begins_with_large_ones(
    healthy: list[Outcome],
) -> None:
    engine = SmallDevice(16, 64)
    for holds, tried in ((16, [64, 32, 16]), (64, [64])):
        engine.holds = holds
        engine.tried.clear()
        outcomes = run_all(engine, JOBS, SHORT)
        assert engine.tried == tried
        for outcome, expected in zip(outcomes, healthy, strict=True):
            assert_same(outcome, expected)


def test_memory_that_runs_out_midway_leaves_no_frames() -> None:
    jobs = [replace(job, record=Record(0.02)) for job in JOBS[:12]]
    roomy, small = (run_all(SmallDevice(holds, 16), jobs, SHORT) for holds in (16, 8))
    for outcome, expected in zip(small, roomy, strict=True):
        assert outcome.history is not None
        assert expected.history is not None
        assert_equal(outcome.history, expected.history)


def test_a_device_without_any_room_gives_invalid_worlds() -> None:
    engine = SmallDevice(0, 2)
    outcomes = run_all(engine, JOBS[:3], SHORT)  # programs are compiled anew after each lack of memory
    assert engine.tried == [2, *[1] * 3]
    for outcome in outcomes:
        assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.OUT_OF_MEMORY)
        assert outcome.flags & Flag.OUT_OF_MEMORY
        assert np.isnan(outcome.boxes.rest_top_force_n).all()


def test_other_errors_are_not_taken_for_lack_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> Any:
        raise RuntimeError("INVALID_ARGUMENT: shapes do not match")

    engine = FakeEngine(16)
    monkeypatch.setattr(engine, "make_model", broken)
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
