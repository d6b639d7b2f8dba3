"""The interface of engines: an engine gets jobs (worlds to simulate), and yields outcomes and progress."""

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
from petmjx.engines.open_world_protocol import MOST_BOXES, OpenWorlds
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job
from petmjx.world.scene import Scene

GPU_WORLDS: Final = 32_768
"""Default number of worlds whose states ``mjx-warp`` keeps on its device at the same time. The state of a world
of 80 boxes takes 23 kB."""


@dataclass
class Progress:
    """Totals that an engine updates during its run.

    Attributes:
        thread_s: CPU time that the threads of the engine ``mujoco`` spent on finished worlds, s.
        message: what the engine does at the moment, such as "compiling".
        caller_message: message of the caller of the engine, which is shown while ``message`` is empty.
        work_share: share of the run's work that is done, from 0 to 1. The run, not the engine, sets ``work_share``. If
            ``work_share`` is None, the share of finished worlds is used.
        at_hand: number of outcomes that will certainly follow the last outcome without delay; None if the engine does
            not report this number. The number is used only if the engine's ``run`` is marked with ``says_at_hand``.
        pauses: whether the engine may yield None while no world ends, so that the caller can do other work.
        notes: notes for the results about deviations from the options. Each note occurs once.
    """

    worlds_done: int = 0
    world_steps: int = 0
    thread_s: float = 0.0
    compile_s: float = 0.0
    message: str = ""
    caller_message: str = ""
    work_share: float | None = None
    at_hand: int | None = None
    pauses: bool = False
    extra: dict[str, float] = field(default_factory=dict)
    notes: dict[str, None] = field(default_factory=dict)

    @property
    def shown_message(self) -> str:
        """The message that a display of the progress shows."""
        return self.message or self.caller_message


Run = TypeVar("Run", bound=Callable[..., Iterator[Outcome]])


def says_at_hand(run: Run) -> Run:
    """Mark a method ``run`` that keeps ``Progress.at_hand`` up to date. If ``Progress.pauses`` is set, this method also
    yields None while it waits.

    The method is marked, and not the engine's class. So if a user's engine inherits from an engine of petmjx but has a
    ``run`` of its own, the user's ``run`` is not marked, since it may delay outcomes.
    """
    run.says_at_hand = True  # type: ignore[attr-defined]  # functions accept further attributes
    return run


def takes_stream(run: Run) -> Run:
    """Mark a method ``run`` that takes jobs from a ``JobStream`` while it simulates other jobs (``StreamEngine``). Any
    other ``run`` gets lists of jobs. The method is marked, and not the engine's class. So if a user's engine inherits
    from an engine of petmjx but has a ``run`` of its own, the user's ``run`` is not marked."""
    run.takes_stream = True  # type: ignore[attr-defined]  # functions accept further attributes
    return run


class RunLock:
    """Allows only one run at a time on an engine. An engine with this lock keeps data between runs, such as compiled
    programs.

    A run is a generator. A run begins when its first outcome is requested, and ends after its last outcome, or when the
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
    """The abilities of an engine."""

    FLOAT64 = enum.auto()
    """The engine computes in double precision."""
    FINE_DISTANCES = enum.auto()
    """Distances at contacts have double precision. In stiffer contacts (attempt 6), boxes sink by less than single
    precision resolves, and would never come to rest."""
    CG = enum.auto()
    """The engine supports the solver ``cg``."""
    SHEETS = enum.auto()
    """The engine supports interlayer sheets, and pallets among the boxes."""
    KINETIC_PAIRS = enum.auto()
    """The engine supports kinetic friction that is given for pairs of materials."""
    SOFT = enum.auto()
    """The engine supports soft boxes, which are flex bodies of MuJoCo."""
    CHECKS = enum.auto()
    """The engine checks its outcomes itself, with petmjx/engines/outcome_checks.py."""
    MIXED = enum.auto()
    """The engine consists of several engines. Each outcome names the engine that simulated it. The start states of jobs
    are ``KeptState`` objects, which name the engine that made the state."""
    PAUSES = enum.auto()
    """A placement can pause (``Job.pauses_after``), and other worlds can start from its state."""
    STIFF_JOBS = enum.auto()
    """Some jobs of a run can have stiffer contacts than the others (``Job.stiff``)."""


_PAIRS: Final = Capability.SHEETS | Capability.KINETIC_PAIRS
_PHYSICS: Final = Capability.FLOAT64 | Capability.FINE_DISTANCES | Capability.CG | _PAIRS
_WARP: Final = Capability.FINE_DISTANCES | _PAIRS | Capability.STIFF_JOBS
PHYSICS: Final[Mapping[str, Capability]] = {
    "mujoco": _PHYSICS | Capability.SOFT,
    "mjx-jax": Capability(0),
    "mjx-warp": _WARP,
    "mjx-warp-cpu": _WARP,
}
"""Name of an engine → its capabilities, also if the engine runs in worker processes. An engine with any other name is
assumed to have all capabilities except soft boxes.
"""


@runtime_checkable
class MinimalEngine(Protocol):
    """The smallest interface of an engine that a user writes. Outcomes may come in any order, as worlds finish.
    ``Outcome.job`` is the index of the job in ``jobs``."""

    name: str

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once, with the solver ``sim.solver``. petmjx/engines/simulation_loop.py repeats a world if
        needed."""
        ...


class StreamEngine(Protocol):
    """An engine whose method ``run`` is marked with ``takes_stream``."""

    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        """See ``MinimalEngine``. The stream number of a job is its position among the jobs that the run takes.

        The run takes jobs while it has capacity. The run ends when all its jobs have outcomes, and ``JobStream.take``
        returns no further jobs.
        """
        ...


class Engine(MinimalEngine, Protocol):
    """The full interface of an engine. A class that inherits from ``Engine`` gets a default for each member that it
    does not define.

    Several threads may use one engine. An engine that can do only one run at a time, such as an MJX engine, lets the
    other threads wait (``RunLock``).

    Attributes:
        devices: number of GPUs that simulate at the same time. A run multiplies its limits on waiting jobs and waiting
            worlds by ``devices``.
    """

    devices: int = 1

    @property
    def capabilities(self) -> Capability:
        """The capabilities of this engine. The default: the capabilities of petmjx's engine with the same name."""
        return PHYSICS.get(self.name, _PHYSICS)

    @property
    def device(self) -> str:
        """The name of the device on which the engine simulates, for the results."""
        return device_name(self.name)

    @property
    def tells(self) -> bool:
        """Whether the engine's ``run`` is marked with ``says_at_hand``."""
        return getattr(self.run, "says_at_hand", False)

    @property
    def streams(self) -> bool:
        """Whether the engine's ``run`` is marked with ``takes_stream``."""
        return getattr(self.run, "takes_stream", False)

    def beginnings(self, scenes: Sequence[Scene], sim: Simulation) -> list[list[bytes]]:
        """For each scene of n boxes, the keys 0 to n of its world. Key k stands for the carrier and the first k boxes.
        If two worlds have the same key k, they are the same to the last bit until the next box is placed. So the two
        worlds can start from the same state (``Job.pauses_after``).

        Raises:
            InputError: this engine does not have ``Capability.PAUSES``.
        """
        raise InputError(f"engine {self.name} cannot pause placements")

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> OpenWorlds:
        """Make open worlds, which are worlds to which boxes can be added.

        Args:
            most_boxes: largest number of boxes that a world will ever have. Engines with fixed tables reserve memory
                for this number of boxes.

        Raises:
            InputError: this engine has no open worlds.
            ValueError: the schedule is ``fixed``. The fixed schedule sets the end of a world before its first box is
                placed.
        """
        raise InputError(
            f"engine {self.name} has no open worlds, to which boxes can be added; use mujoco, mjx-warp or mjx-warp-cpu"
        )

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """Release all boxes of worlds at once, without the rules of placement, and record their motion. Contacts and
        steps are computed as in all other worlds.

        Returns:
            (n, s, k, 7) positions (m) and quaternions of the k boxes of n worlds, after each of the s steps in
            ``bodies.steps``. The values of a world are NaN from the first step on in which numbers were not finite or
            buffers were too small.

        Raises:
            InputError: this engine cannot release boxes.
        """
        raise InputError(
            f"engine {self.name} cannot simulate released boxes; use mujoco, mjx-warp, mjx-warp-cpu or mjx-jax"
        )

    def retire(self) -> None:
        """Start to free the resources that are kept between runs, such as worker processes. Returns at once. No further
        run may begin."""
        return None

    def close(self) -> None:
        """Free the resources as ``retire`` does, and wait until they are free."""
        return self.retire()
