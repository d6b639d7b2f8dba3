"""The protocol of engines: jobs in, outcomes and progress out."""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, TypeVar, runtime_checkable

from petmjx.common.errors import InputError
from petmjx.common.machine import device_name
from petmjx.common.units import FloatArray
from petmjx.engines.job_stream import JobStream
from petmjx.engines.open_worlds import MOST_BOXES, OpenWorlds
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job
from petmjx.world.scene import Scene

GROUP_WORLDS = {"mjx-jax": 8192, "mjx-warp": 32_768}
"""Default number of worlds whose states an engine keeps on its device at the same time. On mjx-warp, a world of 80
boxes takes 16 kB. A worker with one of these engines also gets at most this number of jobs at once."""


@dataclass
class Progress:
    """Totals that an engine updates while it runs.

    Attributes:
        thread_s: CPU time of ``mujoco``'s threads for finished worlds, s.
        message: what the engine is doing at the moment (compiling, …).
        work_share: share of the run's work that is done, from 0 to 1; None: the share of finished worlds is used. Set
            by the run.
        at_hand: lower bound of the number of outcomes that will follow the last one without delay; None if the engine
            does not report it. The number is used only if the engine's ``run`` is marked with ``says_at_hand``.
        pauses: whether the engine may yield None while no world ends, so that the caller can do other work of the run.
        notes: lines for the results about deviations from the options; each line occurs once.
    """

    worlds_done: int = 0
    world_steps: int = 0
    thread_s: float = 0.0
    compile_s: float = 0.0
    message: str = ""
    work_share: float | None = None
    at_hand: int | None = None
    pauses: bool = False
    extra: dict[str, float] = field(default_factory=dict)
    notes: dict[str, None] = field(default_factory=dict)


Run = TypeVar("Run", bound=Callable[..., Iterator[Outcome]])


def says_at_hand(run: Run) -> Run:
    """Mark a ``run`` that keeps ``Progress.at_hand`` up to date, and yields None while it waits if
    ``Progress.pauses`` is set.

    The method is marked, not the engine, since an engine that inherits from petmjx's engines may delay outcomes.
    """
    run.says_at_hand = True  # type: ignore[attr-defined]  # functions accept further attributes
    return run


def takes_stream(run: Run) -> Run:
    """Mark a ``run`` that takes jobs from a ``JobStream`` while it simulates other jobs (``StreamEngine``). Any other
    ``run`` gets lists of jobs. The method is marked, not the engine, as by ``says_at_hand``."""
    run.takes_stream = True  # type: ignore[attr-defined]  # functions accept further attributes
    return run


class RunLock:
    """Allows only one run at a time on an engine that keeps data between runs, such as compiled programs.

    Runs are generators. A run begins when its first outcome is requested, and ends with its last outcome or when the
    generator is closed.
    """

    def __init__(self, engine: str) -> None:
        self._engine = engine
        self._lock = threading.Lock()
        self._thread: int | None = None

    def __enter__(self) -> None:
        if self._thread == threading.get_ident():
            raise RuntimeError(
                f"engine {self._engine} is busy with another run of this thread: finish or close that run, or "
                "build another engine"
            )
        self._lock.acquire()
        self._thread = threading.get_ident()

    def __exit__(self, *_: object) -> None:
        self._thread = None
        self._lock.release()


class Capability(enum.Flag):
    """What an engine can do."""

    FLOAT64 = enum.auto()
    """The engine computes in double precision."""
    CG = enum.auto()
    """The engine supports the solver ``cg``."""
    SHEETS = enum.auto()
    """The engine supports interlayer sheets, and pallets among the boxes."""
    KINETIC_PAIRS = enum.auto()
    """The engine supports kinetic friction by pairs of materials."""
    SOFT = enum.auto()
    """The engine supports boxes that are flex bodies."""
    CHECKS = enum.auto()
    """The engine checks its outcomes itself (petmjx/engines/outcome_checks.py)."""
    MIXED = enum.auto()
    """The engine consists of several engines. Each outcome names the engine that made it. Start states of jobs are
    ``KeptState`` objects, which name the engine that made the state."""


_PAIRS: Final = Capability.SHEETS | Capability.KINETIC_PAIRS
_PHYSICS: Final = Capability.FLOAT64 | Capability.CG | _PAIRS
PHYSICS: Final[Mapping[str, Capability]] = {
    "mujoco": _PHYSICS | Capability.SOFT,
    "mjx-jax": Capability(0),
    "mjx-warp": _PAIRS,
    "mjx-warp-cpu": _PAIRS,
}
"""Engine → its capabilities, in workers as well. An engine with any other name is assumed to have all capabilities
except soft boxes.
"""


@runtime_checkable
class MinimalEngine(Protocol):
    """The smallest interface of a user's own engine. Outcomes may come in any order, as worlds finish; ``Outcome.job``
    is the index of the job."""

    name: str

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once, with ``sim.solver``. petmjx/engines/attempt_stream.py makes further attempts."""
        ...


class StreamEngine(Protocol):
    """An engine whose ``run`` is marked with ``takes_stream``."""

    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        """See ``MinimalEngine``. The stream number of a job is its position among the jobs that the run takes.

        A run takes jobs while it has capacity. The run ends when it has no job in flight, and ``JobStream.take`` has no
        more jobs for it.
        """
        ...


class Engine(MinimalEngine, Protocol):
    """The full interface of an engine. A class that inherits from ``Engine`` gets defaults for everything that it does
    not define.

    Several threads may use one engine. An engine that can do only one run at a time, such as the MJX engines, lets the
    other threads wait (``RunLock``).

    Attributes:
        devices: number of GPUs that simulate at the same time. The number of worlds that the engine gets at once is
            multiplied by this number.
    """

    devices: int = 1

    @property
    def capabilities(self) -> Capability:
        """The capabilities of this engine. By default, those of the engine with the same name."""
        return PHYSICS.get(self.name, _PHYSICS)

    @property
    def device(self) -> str:
        """The name of the device on which worlds run, for the results."""
        return device_name(self.name)

    @property
    def tells(self) -> bool:
        """Whether the engine's ``run`` is marked with ``says_at_hand``."""
        return getattr(self.run, "says_at_hand", False)

    @property
    def streams(self) -> bool:
        """Whether the engine's ``run`` is marked with ``takes_stream``."""
        return getattr(self.run, "takes_stream", False)

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> OpenWorlds:
        """Make open worlds, to which boxes can be added.

        Args:
            most_boxes: largest number of boxes that a world will ever have. Engines with tables reserve room for this
                number of boxes.

        Raises:
            InputError: this engine has no open worlds.
            ValueError: the schedule is fixed: it sets a world's end before its first box is placed.
        """
        raise InputError(
            f"engine {self.name} has no open worlds, to which boxes can be added; use mujoco, mjx-warp or mjx-warp-cpu"
        )

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """Release boxes in worlds without rules of placement, and follow them. Contacts and steps are the same as in
        all other worlds.

        Returns:
            (n, s, k, 7) places, m, and orientations of the boxes after each of ``bodies.steps``. NaN after a step in
            which numbers were not finite or buffers were too small.

        Raises:
            InputError: this engine cannot release boxes.
        """
        raise InputError(
            f"engine {self.name} cannot simulate released boxes; use mujoco, mjx-warp, mjx-warp-cpu or mjx-jax"
        )

    def retire(self) -> None:
        """Start to free the resources that are held between runs, such as workers. Returns at once. No run may
        follow."""
        return None

    def close(self) -> None:
        """Free the resources as ``retire`` does, and wait until this is done."""
        return self.retire()
