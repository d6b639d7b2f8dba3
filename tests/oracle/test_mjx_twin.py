"""The engine mjx-jax compared with C MuJoCo, plan by plan. The tests also show that the outcome of a world does not
depend on its batch.

Both kinds of tests are in one file, so that one process computes the outcomes only once.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.worlds import (
    BRISK,
    LANES,
    MOST_BOXES,
    boxes_by_plan,
    exact_outcomes,
    jax_engine,
    jax_outcomes,
    scenes,
    simulate,
)

from petmjx.engines.verdict import Outcome, Reason, Verdict

SAME_PLACE_M = 1e-3
"""Tolerance of positions. MJX-JAX makes at most four contacts for a pair of boxes, C MuJoCo up to eight, so soft
contacts give way differently."""
SAME_TILT_DEG = 0.2
"""Tolerance of tilts: 1 mm over the length of the smallest box."""
SAME_FORCE = 0.05
"""Relative tolerance of forces at rest. The weights above a box decide the sum of forces, but the contacts decide how
several supports share it."""
SMALL_FORCE_N = 1.0
"""Absolute tolerance of forces, the weight of 0.1 kg. Smaller forces say nothing about how a load is shared."""

PLANS = list(boxes_by_plan())


def test_the_plans_show_every_kind_of_end() -> None:
    reasons = {outcome.reason for outcome in exact_outcomes().values()}
    assert {Reason.NONE, Reason.DROP, Reason.SHIFT} <= reasons
    assert len(PLANS) >= 16
    assert len(PLANS) > jax_engine().lanes  # so that there are several batches


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_verdicts_agree(name: str) -> None:
    outcome, exact = jax_outcomes()[name], exact_outcomes()[name]
    assert (outcome.verdict, outcome.reason, outcome.culprit) == (exact.verdict, exact.reason, exact.culprit)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_standing_plans_agree_in_place_tilt_and_load(name: str) -> None:
    outcome, exact = jax_outcomes()[name], exact_outcomes()[name]
    if exact.verdict is not Verdict.STABLE:
        assert outcome.verdict is not Verdict.STABLE
        return
    np.testing.assert_allclose(outcome.boxes.pos, exact.boxes.pos, atol=SAME_PLACE_M)
    np.testing.assert_allclose(outcome.boxes.max_tilt_deg, exact.boxes.max_tilt_deg, atol=SAME_TILT_DEG)
    np.testing.assert_allclose(
        outcome.boxes.rest_top_force_n, exact.boxes.rest_top_force_n, rtol=SAME_FORCE, atol=SMALL_FORCE_N
    )


@pytest.mark.slow
def test_each_program_was_compiled_once() -> None:
    jax_outcomes()
    # other tests share the engine, with the same options and sizes
    assert [(key.capacity, key.worlds) for key in jax_engine().programs] == [(MOST_BOXES, LANES)]


# Worlds in different batches, and at different places in them.

SAME_WORLD_M = 5e-5
"""Tolerance of positions of the same world in another batch. float32 rounds a position on the pallet to 6e-8 m, and the
order in which XLA adds a world's numbers depends on the world's place in its batch. Some hundred steps of contacts at
rest may make micrometres of that. For a box that rocks while it lands (the overhang) they may make 30 micrometres,
since its friction then sticks a step earlier or later. A box counts as shifted from 1,000 micrometres on."""
SAME_WORLD_DEG = 0.01
SAME_WORLD_FORCE = 0.01
"""Relative tolerance of forces. How several contacts share a force depends on the last micrometres of their depths."""
LANDED_M = 0.01
"""Tolerance of positions of boxes that fell: a fall multiplies differences that were there before."""


def assert_alike(outcome: Outcome, expected: Outcome) -> None:
    for name in ("verdict", "reason", "culprit", "n_placed"):
        assert getattr(outcome, name) == getattr(expected, name)
    np.testing.assert_equal(outcome.first_sign_s, expected.first_sign_s)
    if outcome.verdict is not Verdict.STABLE:
        np.testing.assert_allclose(outcome.boxes.pos, expected.boxes.pos, atol=LANDED_M)
        return
    assert outcome.n_steps == expected.n_steps
    np.testing.assert_allclose(outcome.boxes.pos, expected.boxes.pos, atol=SAME_WORLD_M)
    np.testing.assert_allclose(outcome.boxes.max_tilt_deg, expected.boxes.max_tilt_deg, atol=SAME_WORLD_DEG)
    np.testing.assert_allclose(
        outcome.boxes.rest_top_force_n, expected.boxes.rest_top_force_n, rtol=SAME_WORLD_FORCE, atol=0.1
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hand-overhang-45", "hand-falls-off", "uneven pile"])
def test_alone_as_in_a_full_batch(name: str) -> None:
    alone = simulate(jax_engine(), {name: scenes()[name]}, BRISK)[name]
    assert_alike(alone, jax_outcomes()[name])


@pytest.mark.slow
def test_in_any_place_of_any_batch() -> None:
    names = ["hand-overhang-45", "hand-one-box", "hand-falls-off"]
    crowd = {f"{name} {k}": scenes()[name] for k in range(LANES // 2) for name in reversed(names)}
    assert len(crowd) > LANES
    outcomes = simulate(jax_engine(), crowd, BRISK)
    for name in names:
        for k in (0, LANES // 2 - 1):
            assert_alike(outcomes[f"{name} {k}"], jax_outcomes()[name])
