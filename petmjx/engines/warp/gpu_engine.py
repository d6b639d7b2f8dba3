"""Engine ``mjx-warp`` on a GPU, which hands its long worlds to CPU threads."""

from __future__ import annotations

from petmjx.engines.protocol import Progress
from petmjx.engines.subprocess.attempt_process import AttemptProcess
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.long_worlds import LongWorlds
from petmjx.options.simulation import Simulation


class MjxWarpGpuEngine(MjxWarpEngine):
    """The engine ``mjx-warp``, as runs use it on a GPU. Long worlds leave the GPU, and CPU threads simulate them to
    their ends (``long_worlds``).

    Args:
        lanes: see ``MjxWarpEngine``.
    """

    def __init__(self, lanes: int | None = None) -> None:
        super().__init__(lanes)

    def _long_worlds(self, sim: Simulation, progress: Progress) -> LongWorlds | None:
        """See ``MjxWarpEngine._long_worlds``."""
        return LongWorlds(AttemptProcess("petmjx.engines.warp.cpu_engine"), sim, progress)
