"""A world's outcome does not depend on the company it is simulated in (mjx-jax)."""

from __future__ import annotations

import numpy as np
import pytest
from support.worlds import LANES, jax_engine, jax_outcomes, scenes, simulate

from petmjx.engines.batch.mjx_jax import MjxJaxEngine
from petmjx.options.config import Simulation
from petmjx.verdict import Outcome, Verdict

pytestmark = pytest.mark.slow

SAME_M = 5e-5
"""float32 rounds a position on the pallet to 6e-8 m, and a world's place in its batch decides how XLA adds its numbers;
some hundred steps of contacts at rest may carry that to micrometres, and a box that rocks while it lands (the overhang)
to 30 of them, since its friction then sticks a step earlier or later. What counts as a shift begins at 1,000."""
SAME_DEG = 0.01
SAME_FORCE = 0.01
"""What is shared among several contacts depends on the last micrometres of their depths."""
LANDED_M = 0.01
"""A fall multiplies what it started from."""
NAMES = ("hand-overhang-45", "brickwork", "uneven pile", "hand-falls-off")


def assert_alike(found: Outcome, expected: Outcome) -> None:
    for name in ("verdict", "reason", "culprit", "n_placed"):
        assert getattr(found, name) == getattr(expected, name)
    np.testing.assert_equal(found.first_sign_s, expected.first_sign_s)
    if found.verdict is not Verdict.STABLE:
        np.testing.assert_allclose(found.boxes.pos, expected.boxes.pos, atol=LANDED_M)
        return
    np.testing.assert_allclose(found.boxes.pos, expected.boxes.pos, atol=SAME_M)
    np.testing.assert_allclose(found.boxes.max_tilt_deg, expected.boxes.max_tilt_deg, atol=SAME_DEG)
    np.testing.assert_allclose(found.boxes.rest_top_force_n, expected.boxes.rest_top_force_n, rtol=SAME_FORCE, atol=0.1)


@pytest.mark.parametrize("name", ["hand-overhang-45", "hand-falls-off", "uneven pile"])
def test_alone_as_in_a_full_batch(name: str) -> None:
    alone = simulate(jax_engine(), {name: scenes()[name]}, Simulation())[name]
    assert_alike(alone, jax_outcomes()[name])


def test_in_any_place_of_any_batch() -> None:
    names = ["hand-overhang-45", "hand-one-box", "hand-falls-off"]
    crowd = {f"{name} {k}": scenes()[name] for k in range(LANES // 2) for name in reversed(names)}
    assert len(crowd) > LANES
    found = simulate(jax_engine(), crowd, Simulation())
    for name in names:
        for k in (0, LANES // 2 - 1):
            assert_alike(found[f"{name} {k}"], jax_outcomes()[name])


def test_in_smaller_batches() -> None:
    few = simulate(MjxJaxEngine(2), {name: scenes()[name] for name in NAMES}, Simulation())
    for name in NAMES:
        assert_alike(few[name], jax_outcomes()[name])
