"""Runs on a GPU for which no kernel is compiled yet: no attempt (simulation of a world with other options) fails."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.plans import make_plan, make_world, stack

import petmjx
from petmjx.engines.attempt_settings import ATTEMPTS
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.simulation_loop import score_worlds
from petmjx.options.simulation import Simulation

LIGHT_UNDER_HEAVY = make_plan("light", stack(2, size_mm=(400, 300, 200), kg=(0.02, 300.0)))
"""A plan whose world needs attempts 1 and 6.

Newton's method solves contacts here. With conjugate gradients attempt 1 would run on C MuJoCo, as mjx-warp does not
have them.
"""

KERNEL_ON_THREADS = """
import sys
import numpy as np
from support.plans import make_plan, make_world, stack
from petmjx.options.simulation import Simulation
from petmjx.engines.attempt_settings import ATTEMPTS
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.warp.cpu_engine import MjxWarpCpuEngine

job = make_world(make_plan("light", stack(2, size_mm=(400, 300, 200), kg=(0.02, 300.0)))).job
(outcome,) = MjxWarpCpuEngine(1).run([job], ATTEMPTS[5].apply_to_sim(Simulation()))
print(outcome.n_steps, *outcome.boxes.pos.ravel())
"""

RUN = """
import sys
import petmjx
from petmjx.engines import simulation_loop, attempt_settings

engine, plans, out, first = sys.argv[1:]
# each further attempt, as if all before had failed
asked = (attempt_settings.ATTEMPTS[0], *attempt_settings.ATTEMPTS[int(first) - 1 :])
simulation_loop.score_worlds.__kwdefaults__["attempts"] = asked
attempt_settings.AttemptRecipe.is_for = lambda self, outcome, sim: self.number == int(first) and outcome.attempt !=
int(first) petmjx.score(plans, engine=engine, out=out)
"""


@pytest.mark.gpu
@pytest.mark.slow
@pytest.mark.parametrize("attempt", range(2, 8))
def test_every_attempt_ends_with_nothing_kept(attempt: int, tmp_path: Path) -> None:
    petmjx.save_plans([LIGHT_UNDER_HEAVY], tmp_path / "plans.json")
    environment = {**os.environ, "PETMJX_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", RUN, "mjx-warp", str(tmp_path / "plans.json"), str(tmp_path / "out"), str(attempt)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    attempts = petmjx.load_run(tmp_path / "out").attempts
    assert attempts["attempt"].tolist() == [1, attempt]
    beside = "mujoco" if ATTEMPTS[attempt - 1].doubles else "mjx-warp-cpu"
    assert attempts["engine"].tolist() == ["mjx-warp", beside]


@pytest.mark.gpu
@pytest.mark.slow
def test_what_is_made_beside_a_gpu_is_the_same_as_without_one() -> None:
    """Results agree to the last bit. Attempt 6 runs in a process beside the run, and that process sees no GPU."""
    (result,) = score_worlds([make_world(LIGHT_UNDER_HEAVY)], Simulation(), make_engine("mjx-warp"))
    assert [attempt.engine for attempt in result.attempts] == ["mjx-warp", "mjx-warp-cpu"]
    path = os.pathsep.join(sys.path)
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": "", "PYTHONPATH": path}
    command = [sys.executable, "-c", KERNEL_ON_THREADS]
    alone = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()
    assert int(alone[0]) == result.outcome.n_steps
    assert [float(coordinate) for coordinate in alone[1:]] == result.outcome.boxes.pos.ravel().tolist()
