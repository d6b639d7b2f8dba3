"""Worlds whose verdicts soft contacts may have decided are simulated again with stiffer contacts.

That happens beside a run on mjx-warp.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.plans import make_plan, make_world, stack
from support.tiny_worlds import shared_engine

from petmjx.engines.attempt_stream import score_worlds
from petmjx.engines.attempts import ATTEMPTS
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Verdict
from petmjx.engines.warp.cpu_engine import MjxWarpCpuEngine
from petmjx.engines.world_results import WorldResult
from petmjx.options.simulation import Simulation

SIM = Simulation()

FORCE_SHARE = 0.01
"""Relative tolerance of forces at rest, in single precision with contacts that are 40 times as stiff as usual."""

LIGHT_UNDER_HEAVY = stack(2, size_mm=(400, 300, 200), kg=(0.02, 300.0))

PILES = {
    "stands": LIGHT_UNDER_HEAVY,
    "tips": (*LIGHT_UNDER_HEAVY, ((400, 300, 200), (220, 0, 400), 5.0)),
    "slender": (((131, 300, 402), (0, 0, 0), 0.32), ((131, 300, 800), (64, 0, 402), 7.2)),
}


def scored(engine: Engine) -> dict[str, WorldResult]:
    worlds = [make_world(make_plan(name, boxes), SIM) for name, boxes in PILES.items()]
    return {result.world.plan.plan_id: result for result in score_worlds(worlds, SIM, engine)}


@pytest.mark.slow
def test_the_kernel_s_further_attempts_end_as_c_mujoco_s() -> None:
    expected = scored(MujocoEngine(1))
    alone = MjxWarpCpuEngine(1)
    for name, result in scored(shared_engine()).items():
        assert [(a.attempt, a.engine) for a in result.attempts] == [(1, "mjx-warp"), (6, "mjx-warp-cpu")], name
        (itself,) = alone.run([result.world.job], ATTEMPTS[5].apply_to_sim(SIM))
        np.testing.assert_array_equal(result.outcome.boxes.pos, itself.boxes.pos, err_msg=name)
        oracle = expected[name].outcome
        assert (result.outcome.verdict, result.outcome.culprit) == (oracle.verdict, oracle.culprit), name
        if oracle.verdict is Verdict.STABLE:
            force, exact_force = result.outcome.boxes.rest_top_force_n, oracle.boxes.rest_top_force_n
            np.testing.assert_allclose(
                force, exact_force, rtol=FORCE_SHARE, atol=FORCE_SHARE * exact_force.max(), err_msg=name
            )
    assert {name: result.outcome.verdict for name, result in expected.items()} == {
        "stands": Verdict.STABLE, "tips": Verdict.UNSTABLE, "slender": Verdict.STABLE,
    }  # fmt: skip
