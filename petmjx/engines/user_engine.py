"""A user's own engine, which may implement only a part of the interface of engines."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import Any, Final

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.machine import device_name
from petmjx.engines.open_world_protocol import MOST_BOXES, OpenWorlds
from petmjx.engines.protocol import Capability, Engine, MinimalEngine, Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.run_options import RunOptions
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
                f"engine {self.name}: {', '.join(dated)} has no effect; set the attribute 'capabilities' instead",
                stacklevel=2,
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
        """What the method ``open`` of the user's engine returns. If the user's engine has no such method, the result of
        ``Engine.open``."""
        opens = getattr(self._engine, "open", None)
        worlds: OpenWorlds = (super().open if opens is None else opens)(scenes, sim, most_boxes)
        return worlds

    @property
    def device(self) -> str:
        return getattr(self._engine, "device", "") or device_name(self.name, self._threads)

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        return self._engine.run(jobs, sim, progress)


def user_engine(engine: Any, options: RunOptions) -> UserEngine:
    """The engine object that is given as the option ``engine``, with the defaults of ``UserEngine``.

    Raises:
        InputError: the object is not an engine, or workers are requested.
    """
    if isinstance(engine, type) or not isinstance(engine, MinimalEngine):
        raise InputError(
            f"engine must be a name or an object with an attribute 'name' and a method 'run', {shown_value(engine)}"
        )
    if options.asked_workers is not None:
        raise InputError("workers need the name of an engine, not an engine object: each worker builds its own engine")
    return UserEngine(engine, options.threads)
