"""The engine mjx-jax against C MuJoCo, plan by plan."""

from __future__ import annotations

import numpy as np
import pytest
from support.worlds import LANES, MOST_BOXES, boxes_by_plan, exact_outcomes, jax_engine, jax_outcomes

from petmjx.verdict import Reason, Verdict

SAME_PLACE_M = 1e-3
"""MJX-JAX makes at most four contacts a pair of boxes, C up to eight: soft contacts then give way differently."""
SAME_TILT_DEG = 0.2
"""1 mm over the smallest box."""
SAME_FORCE = 0.05
"""At rest the weights above decide, but how they are shared among several supports depends on the contacts."""
SMALL_FORCE_N = 1.0
"""Below this a share of the force says nothing: 0.1 kg."""

PLANS = list(boxes_by_plan())


def test_the_plans_show_every_kind_of_end() -> None:
    reasons = {outcome.reason for outcome in exact_outcomes().values()}
    assert {Reason.NONE, Reason.DROP, Reason.SHIFT} <= reasons
    assert len(PLANS) >= 16
    assert len(PLANS) > jax_engine().lanes  # so that there are several batches


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_verdicts_agree(name: str) -> None:
    found, exact = jax_outcomes()[name], exact_outcomes()[name]
    assert (found.verdict, found.reason, found.culprit) == (exact.verdict, exact.reason, exact.culprit)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_standing_plans_agree_in_place_tilt_and_load(name: str) -> None:
    found, exact = jax_outcomes()[name], exact_outcomes()[name]
    if exact.verdict is not Verdict.STABLE:
        assert found.verdict is not Verdict.STABLE
        return
    np.testing.assert_allclose(found.boxes.pos, exact.boxes.pos, atol=SAME_PLACE_M)
    np.testing.assert_allclose(found.boxes.max_tilt_deg, exact.boxes.max_tilt_deg, atol=SAME_TILT_DEG)
    np.testing.assert_allclose(
        found.boxes.rest_top_force_n, exact.boxes.rest_top_force_n, rtol=SAME_FORCE, atol=SMALL_FORCE_N
    )


@pytest.mark.slow
def test_each_program_was_compiled_once() -> None:
    jax_outcomes()
    # other tests share the engine, with the same options and sizes
    assert [(key.capacity, key.worlds) for key in jax_engine().programs] == [(MOST_BOXES, LANES)]
