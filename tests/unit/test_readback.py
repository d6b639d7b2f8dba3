"""Readback: rows of the device's tables are copied to the host without any change of their bits, and in the right
order."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.compiles import compiled_programs
from support.plans import make_scene

from petmjx.engines.mjx import readback, scene_rows
from petmjx.engines.mjx.frame_recorder import Recorder
from petmjx.engines.mjx.outcomes import outcomes
from petmjx.engines.mjx.readback import READBACK_ROWS, prepare_readback, readbacks_of, reduce_metrics
from petmjx.engines.mjx.world_constants import NEVER, Worlds, upload_worlds
from petmjx.engines.mjx.world_state import State, fresh_state, take_rows
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

SIM, ROWS, BOXES = Simulation(), 2 * READBACK_ROWS + 5, 3


@pytest.fixture(scope="module")
def tables() -> tuple[Worlds, State]:
    """Worlds, and states with random bits, many of which are NaN."""
    worlds = upload_worlds([Job(make_scene(BOXES))] * ROWS, ROWS, BOXES, {}, SIM)
    state = fresh_state(worlds, all_placed=False, ends=jnp.full(ROWS, NEVER, jnp.int32), rest_steps=1)
    rng = np.random.default_rng(7)

    def random(array: jax.Array) -> jax.Array:
        bits = rng.integers(-(2**31), 2**31, array.shape, np.int64).astype(np.int32)
        return jnp.asarray(bits.view(array.dtype))

    return worlds, jax.tree.map(random, state)


@pytest.mark.parametrize("count", [0, 1, READBACK_ROWS, READBACK_ROWS + 1, ROWS])
def test_they_have_the_bits_of_the_table(count: int, tables: tuple[Worlds, State]) -> None:
    worlds, table = tables
    rows = np.random.default_rng(count).permutation(ROWS)[:count]
    batches = [batch.on_host() for batch in readbacks_of(rows, table, worlds, SIM)]
    assert len(batches) == -(-count // READBACK_ROWS)
    for number, (state, measured) in enumerate(batches):
        some = jnp.asarray(np.resize(rows[number * READBACK_ROWS :][:READBACK_ROWS], READBACK_ROWS))
        chosen = take_rows(table, some)
        jax.tree.map(assert_same_bits, state, chosen)
        # results that are computed from NaN are NaN, but their bits are not defined
        jax.tree.map(np.testing.assert_array_equal, measured, reduce_metrics(chosen, take_rows(worlds, some), SIM))


def test_what_was_prepared_compiles_nothing(tables: tuple[Worlds, State]) -> None:
    worlds, table = (take_rows(record, jnp.arange(READBACK_ROWS + 3)) for record in tables)
    with compiled_programs() as compiled:
        prepare_readback(table, worlds, SIM)
    assert compiled, "the listener hears of programs"
    with compiled_programs() as compiled:
        readbacks_of(np.arange(3), table, worlds, SIM)
        readbacks_of(np.arange(READBACK_ROWS + 3), table, worlds, SIM)
    assert compiled == []


def test_of_a_small_table_no_more_rows_are_picked_than_it_has(tables: tuple[Worlds, State]) -> None:
    worlds, table = (take_rows(record, jnp.arange(5)) for record in tables)
    rows = np.array([4, 0, 2])
    ((state, _),) = (batch.on_host() for batch in readbacks_of(rows, table, worlds, SIM))
    jax.tree.map(assert_same_bits, state, take_rows(table, jnp.asarray([4, 0, 2, 4, 0])))


def test_outcomes_have_their_stream_numbers_in_each_batch(
    tables: tuple[Worlds, State], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readback, "READBACK_ROWS", 2)
    jobs, rows = [Job(make_scene(BOXES))] * 5, np.array([4, 0, 2, 3, 1])
    worlds = take_rows(tables[0], jnp.arange(5))
    table = fresh_state(worlds, all_placed=True, ends=jnp.full(5, NEVER, jnp.int32), rest_steps=1)
    table = table._replace(steps_done=10 * jnp.arange(5, dtype=jnp.int32))
    numbers = [11, 22, 33, 44, 55]
    all_outcomes = outcomes(readbacks_of(rows, table, worlds, SIM), jobs, numbers, SIM, Recorder(jobs, SIM))
    steps = [(outcome.job, outcome.n_steps) for outcome in all_outcomes]
    assert steps == [(55, 40), (11, 0), (33, 20), (44, 30), (22, 10)]


def assert_same_bits(mine: np.ndarray[Any, Any], theirs: jax.Array) -> None:
    assert mine.dtype == theirs.dtype
    np.testing.assert_array_equal(mine.view(np.int32), np.asarray(theirs).view(np.int32))


@pytest.mark.parametrize("count", [scene_rows.MANY - 1, scene_rows.MANY])
def test_rows_that_are_there_many_times_are_the_same_on_threads(count: int) -> None:
    rng = np.random.default_rng(count)
    arrays = [rng.random((7, *shape)) for shape in ((), (3,), (2, 4))]
    source = rng.integers(0, 7, count)
    for array, rows in zip(arrays, scene_rows.gather_rows(iter(arrays), source), strict=True):
        np.testing.assert_array_equal(rows, array[source])
