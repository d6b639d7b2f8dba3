"""Engine ``mjx-warp``: batches of worlds on NVIDIA Warp's kernels. The fast one."""

from __future__ import annotations

from typing import Any

import jax
import warp

from petmjx.config import Simulation, Solver
from petmjx.engines.batch.engine import MIN_LANES, MjxEngine
from petmjx.engines.batch.setup import set_up_warp
from petmjx.engines.batch.stage import Stepper
from petmjx.engines.batch.template import FLOAT32_TOLERANCE, MAX_ITERATIONS, ROWS_PER_CONTACT, padded_template
from petmjx.engines.warp.records import lane_bytes
from petmjx.engines.warp.step import PalletStepper
from petmjx.engines.warp.stock import StockStepper
from petmjx.errors import EngineUnavailable
from petmjx.machine import why_no_warp

TOLERANCE = 1e-8
"""MuJoCo's default. Forces and residuals are double, so that it is reached, and in as many iterations as C's."""

ITERATIONS, LINE_SEARCH_ITERATIONS = 6, 20
"""Limits of the Newton solver and its line search; MuJoCo's are 100 and 50. A step lasts as long as its slowest world:
colliding ones take up to 16 iterations, in C as here, and stopped after 6 go on in the next step from where they are.
Of 2,000 verdicts as many are C's as with 8 or 30; with 5 a search's level of toppling moves by 0.01 g, with 3 or 4 more
plans stand that drop on C (benchmarks/README.md)."""

CONTACTS_PER_BOX = 6
"""Contacts reserved per box, averaged over lanes (one pool serves all): full real pallets have 4.5."""

LANE_CONTACTS_PER_BOX = 8
"""Contacts reserved per box in each lane; the fullest of 2,000 sample plans, collapsing ones among them, took 6.4."""

PREFERRED_LANES = 2048
"""Lanes at which an H100 is as good as full at every capacity (benchmarks/README.md)."""

DEFAULT_MEMORY = 8 << 30
"""Assumed where a device does not tell its memory, bytes."""


class MjxWarpEngine(MjxEngine):
    """Batched worlds on Warp's kernels.

    Args:
        allow_cpu: run Warp's kernels on the CPU where there is no CUDA device: slow, for tests.

    Raises:
        EngineUnavailable: no CUDA device, or Warp is not installed; the text says which.
    """

    name = "mjx-warp"

    def __init__(self, lanes: int | None = None, *, allow_cpu: bool = False, **options: Any) -> None:
        problem = None if allow_cpu else why_no_warp()
        if problem:
            raise EngineUnavailable(f"engine mjx-warp cannot run here: {problem}")
        set_up_warp()
        super().__init__(lanes, **options)

    def release(self) -> None:
        """Drop the CUDA graphs that Warp captured of MJX's own step: each keeps its solver's workspace."""
        warp.clear_jax_callable_graph_cache()

    def default_lanes(self, capacity: int) -> int:
        """The fastest number of lanes measured, or what two thirds of the device's free memory hold."""
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
            return PalletStepper(template, lanes, pool, room)
        return StockStepper(template, lanes, sim.physics, pool, ROWS_PER_CONTACT[sim.physics.cone] * room)
