"""Engine ``mjx-warp``: batches of worlds on NVIDIA Warp's kernels. The fastest engine."""

from __future__ import annotations

from typing import Any

import jax
import warp

from petmjx.config import Physics, Simulation, Solver
from petmjx.engines.batch.engine import MIN_LANES, MjxEngine
from petmjx.engines.batch.setup import set_up_warp
from petmjx.engines.batch.stage import Stepper
from petmjx.engines.batch.template import FLOAT32_TOLERANCE, MAX_ITERATIONS, ROWS_PER_CONTACT, padded_template
from petmjx.engines.sinking import MOST_IMPEDANCE
from petmjx.engines.warp.records import lane_bytes
from petmjx.engines.warp.step import PalletStepper
from petmjx.engines.warp.stock import StockStepper
from petmjx.errors import EngineUnavailable
from petmjx.machine import why_no_warp

TOLERANCE = 1e-8
"""MuJoCo's default. It is reached, in as many iterations as on C MuJoCo, since forces and residuals are double."""

ITERATIONS, LINE_SEARCH_ITERATIONS = 20, 20
"""Limits of the Newton solver and of its line search; MuJoCo's are 100 and 50. The slowest world decides how long a
step takes. A world that is stopped goes on in the next step, but with stiff friction it takes more steps to come to
rest then. docs/performance.md ("How many iterations") has the speed and the verdicts with other limits."""

CONTACTS_PER_BOX = 6
"""Contacts reserved per box, mean over lanes (all lanes share one pool). Full real pallets have 4.5."""

LANE_CONTACTS_PER_BOX = 8
"""Contacts reserved per box in each lane. The most that any of 2,000 sample plans needed was 6.4, in a collapse."""

PREFERRED_LANES = 2048
"""Lanes that nearly fill an H100 at every capacity: 4,096 are not faster (docs/performance.md)."""

DEFAULT_MEMORY = 8 << 30
"""Assumed if a device does not tell its memory, bytes."""


def friction_damping(physics: Physics) -> float:
    """Damping of friction, 1/s, as MuJoCo has it (its documentation, "Modeling", "Solver parameters"); 0 if it is that
    of contacts."""
    if not physics.has_own_friction:
        return 0.0
    time_s, damping = physics.solreffriction
    high = min(physics.solimp[1], MOST_IMPEDANCE)
    return -damping / high if time_s < 0 else 2 / (high * max(time_s, 2 * physics.timestep_s))


class MjxWarpEngine(MjxEngine):
    """Batched worlds on Warp's kernels.

    Args:
        allow_cpu: run Warp's kernels on the CPU if there is no CUDA device: slow, for tests.

    Raises:
        EngineUnavailable: no CUDA device, or Warp is not installed; the line says which.
    """

    name = "mjx-warp"

    def __init__(self, lanes: int | None = None, *, allow_cpu: bool = False, **options: Any) -> None:
        problem = None if allow_cpu else why_no_warp()
        if problem:
            raise EngineUnavailable(f"engine mjx-warp cannot run here: {problem}")
        set_up_warp()
        super().__init__(lanes, **options)

    def release(self) -> None:
        """Drop the CUDA graphs that Warp captured of MJX's own step: each one keeps the workspace of its solver."""
        warp.clear_jax_callable_graph_cache()

    def default_lanes(self, capacity: int) -> int:
        """``PREFERRED_LANES``, or as many as fit into two thirds of the device's free memory."""
        stats: dict[str, int] = jax.devices()[0].memory_stats() or {}
        free = stats.get("bytes_limit", DEFAULT_MEMORY) - stats.get("bytes_in_use", 0)
        fit = int(free * 2 / 3 / lane_bytes(capacity + 1, LANE_CONTACTS_PER_BOX * (capacity + 2)))
        return max(MIN_LANES, 1 << (min(PREFERRED_LANES, fit).bit_length() - 1))

    def make_stepper(self, capacity: int, lanes: int, sim: Simulation, *, held: bool, growth: int) -> Stepper:
        newton = sim.solver is Solver.NEWTON
        template = padded_template(
            capacity,
            sim.physics,
            held=held,
            solver=sim.solver,
            tolerance=sim.solver_tolerance or (TOLERANCE if newton else FLOAT32_TOLERANCE),
            iterations=sim.solver_iterations or (ITERATIONS if newton else MAX_ITERATIONS),
            native_ccd=False,
            line_search_iterations=LINE_SEARCH_ITERATIONS,
        )
        pool = CONTACTS_PER_BOX * (capacity + 2) * lanes * growth
        room = LANE_CONTACTS_PER_BOX * (capacity + 2) * growth
        if newton:
            return PalletStepper(template, lanes, pool, room, friction_damping(sim.physics))
        return StockStepper(template, lanes, sim.physics, pool, ROWS_PER_CONTACT[sim.physics.cone] * room)
