"""Engine ``mjx-warp-cpu``: the kernels of ``mjx-warp`` on CPU threads. Without a GPU, this engine is the fastest one
for a large amount of work."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import warp as wp

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import cpu_threads, device_name, why_no_warp_on_cpu
from petmjx.engines.open_world_protocol import MOST_BOXES
from petmjx.engines.subprocess.attempt_process import serve_attempts
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.kernel_launcher import SLICE_NS
from petmjx.engines.warp.open_worlds import WarpWorlds
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene

CPU_ROWS = 4096
"""Largest number of worlds whose states are in memory at the same time."""


class MjxWarpCpuEngine(MjxWarpEngine):
    """Runs Warp's kernels, compiled for the CPU of this machine. Each thread simulates one world at a time.

    The outcome of a world does not depend on the number of threads.

    Args:
        threads: number of worlds that are simulated at once. If ``threads`` is None, this is the number of CPU threads
            that the process may use.

    Raises:
        EngineUnavailable: Warp is not installed, or JAX uses a GPU in this process. The message names the reason.
    """

    name = "mjx-warp-cpu"
    depth_first = True
    """On a CPU, few worlds run at once, so few threads are idle at the end of a run even if the last worlds are long.
    Therefore, long worlds need not come first. Worlds that follow from outcomes, such as the drives of a settled
    pallet, come first instead, so that an interrupted run keeps more finished worlds."""

    def __init__(self, threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        if problem := why_no_warp_on_cpu():
            raise EngineUnavailable(f"engine {self.name} cannot run here: {problem}")
        self.threads = threads if threads is not None else cpu_threads()
        super().__init__(allow_cpu=True, most_rows=CPU_ROWS, slice_ns=SLICE_NS)
        if jax.default_backend() != "cpu":
            raise EngineUnavailable(
                f"engine {self.name} cannot run here: jax uses a GPU in this process; set JAX_PLATFORMS=cpu, or take "
                "the engine mjx-warp"
            )
        wp.set_device("cpu")

    @property
    def device(self) -> str:
        return device_name(self.name, self.threads)

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> WarpWorlds:
        """See ``Engine.open``."""
        return WarpWorlds(scenes, sim, most_boxes, self.threads)

    def _blocks(self, launch: Launch) -> int:
        return self.threads


def main() -> None:
    """The work of the process that takes over long worlds from a GPU and simulates them to their ends
    (petmjx/engines/warp/gpu_engine.py)."""
    serve_attempts(lambda _: MjxWarpCpuEngine(1))
