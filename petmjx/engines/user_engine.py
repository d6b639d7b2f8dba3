"""A user's own engine, which may implement only a part of the interface of engines."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import Final

from petmjx.common.machine import device_name
from petmjx.engines.open_world_protocol import MOST_BOXES, OpenWorlds
from petmjx.engines.protocol import Capability, Engine, MinimalEngine, Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.scene import Scene

_OLD_FLAGS: Final = ("takes_more", "takes_parts", "looks", "names_engines")
"""Former attributes of engines, which ``Engine.capabilities`` has replaced."""


class UserEngine(Engine):
    """A user's own engine, with defaults for the parts of ``Engine`` that it leaves out. The engine is never closed,
    since the user owns it.

    Args:
        threads: the option ``threads`` of the run. If the engine does not name its device, ``device_name`` makes the
            name from the engine's name and this number.
    """

    def __init__(self, engine: MinimalEngine, threads: int | None) -> None:
        self.name, self._engine, self._threads = engine.name, engine, threads
        self.devices = int(getattr(engine, "devices", 1))
        if dated := [name for name in _OLD_FLAGS if getattr(engine, name, False)]:
            warnings.warn(
                f"engine {self.name}: {', '.join(dated)} has no effect; use capabilities instead", stacklevel=2
            )

    @property
    def capabilities(self) -> Capability:
        return getattr(self._engine, "capabilities", super().capabilities)

    @property
    def tells(self) -> bool:
        return getattr(self._engine.run, "says_at_hand", False)

    @property
    def streams(self) -> bool:
        return getattr(self._engine.run, "takes_stream", False)

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> OpenWorlds:
        """The open worlds of the user's engine, if it has any; else the default of ``Engine``."""
        opens = getattr(self._engine, "open", None)
        worlds: OpenWorlds = (super().open if opens is None else opens)(scenes, sim, most_boxes)
        return worlds

    @property
    def device(self) -> str:
        return getattr(self._engine, "device", "") or device_name(self.name, self._threads)

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        return self._engine.run(jobs, sim, progress)
