"""The protocol of engines: jobs in, outcomes out; and how an engine tells its progress."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

from petmjx.common.errors import InputError
from petmjx.common.machine import device_name
from petmjx.common.units import FloatArray
from petmjx.engines.open_worlds import MOST_BOXES, OpenWorlds
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job
from petmjx.world.scene import Scene

GROUP_WORLDS = {"mjx-jax": 8192, "mjx-warp": 32_768}
"""Worlds whose states mjx-warp has on its device at the same time by default; with 80 boxes each
takes 16 kB. And the most jobs that a worker of either engine is given at once."""


@dataclass
class Progress:
    """Totals that an engine updates while it runs.

    Attributes:
        thread_s: CPU time of ``mujoco``'s threads for worlds that have ended, s.
        message: what it is doing (compiling, …).
        at_hand: so many outcomes follow the last one at once, or more; None where the engine does not say. It is
            believed where the engine's ``run`` is marked with ``says_at_hand``.
        pauses: whether the engine may yield None where no world ends for a while, so that whoever asks it sees to the
            rest of the run.
        notes: lines for the results, each once: what was done otherwise than asked for.
    """

    worlds_done: int = 0
    world_steps: int = 0
    thread_s: float = 0.0
    compile_s: float = 0.0
    message: str = ""
    at_hand: int | None = None
    pauses: bool = False
    extra: dict[str, float] = field(default_factory=dict)
    notes: dict[str, None] = field(default_factory=dict)


Run = TypeVar("Run", bound=Callable[..., Iterator[Outcome]])


def says_at_hand(run: Run) -> Run:
    """Mark a ``run`` that keeps ``Progress.at_hand`` up to date while it waits, and yields None in pauses if asked to.

    It is the method that is marked, not the engine: one that inherits from an engine of petmjx may hold back what that
    yields, for as long as it likes.
    """
    run.says_at_hand = True  # type: ignore[attr-defined]  # a function has room for it
    return run


class RunLock:
    """Allows one run at a time of an engine that keeps data between runs, such as compiled programs.

    Runs are generators. A run begins when its first outcome is asked for, and ends with its last outcome or when the
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


class GrowingJobs(list[Job]):
    """Jobs to which more are appended while an engine simulates them, whenever it has yielded an outcome.

    Only engines that take more are given such a list. They simulate these jobs in the same run, as soon as something is
    free for them; a run ends when none is left.
    """


class JobsInParts(list[Job]):
    """The first part of a run's jobs. An engine may take the next part while it has this one, so that a device has
    worlds up to its last ones; its jobs are numbered on. An engine that does not is given it in another run. An engine
    may clear the list, since worlds that have ended would take memory.

    Args:
        next_part: see below.
    """

    def __init__(self, jobs: Sequence[Job], next_part: Callable[[], Sequence[Job] | None]) -> None:
        super().__init__(jobs)
        self.next_part = next_part
        """The next part, once; None as long as it is being made, and no jobs where none follows now. May be called from
        a thread of the engine. It raises nothing: an engine could take that for an error of its own."""


@runtime_checkable
class MinimalEngine(Protocol):
    """The least that an engine of the user's own has. Outcomes come in any order, as worlds finish; ``Outcome.job`` is
    the index of the job."""

    name: str

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once with ``sim.solver``. Further attempts are made by petmjx/engines/attempt_stream.py."""
        ...


class Engine(MinimalEngine, Protocol):
    """An engine with all that petmjx asks of it. A class that inherits from it has what it does not say itself.

    Several threads may use one engine. An engine that can do only one run at a time, such as the MJX engines, makes the
    other threads wait (``RunLock``).

    Attributes:
        takes_more: whether jobs may be appended while it runs (``GrowingJobs``).
        takes_parts: whether it takes the next part of a run's jobs while it has this one (``JobsInParts``). Then the
            first part is small, so that it begins soon.
        looks: whether it has looked at its outcomes (petmjx/engines/outcome_checks.py).
        devices: GPUs that simulate at the same time: it is given so many times as many worlds at once.
        names_engines: whether it has several engines. Its outcomes then say which made them, and its jobs have the
            states that they start from with the engines that made these (``KeptState``).
    """

    takes_more: bool = False
    takes_parts: bool = False
    looks: bool = False
    devices: int = 1
    names_engines: bool = False

    @property
    def device(self) -> str:
        """The name of the device on which worlds run, for the results."""
        return device_name(self.name)

    @property
    def tells(self) -> bool:
        """Whether its ``run`` is marked with ``says_at_hand``."""
        return getattr(self.run, "says_at_hand", False)

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> OpenWorlds:
        """Worlds that stay open.

        Args:
            most_boxes: of a world, ever. Engines with tables have room for so many.

        Raises:
            InputError: this engine has none.
            ValueError: the schedule is fixed: it sets a world's end before its first box is placed.
        """
        raise InputError(f"engine {self.name} has no worlds that stay open; mujoco, mjx-warp and mjx-warp-cpu have")

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """Boxes that are let go, in worlds without rules and with the contacts and steps of all others.

        Returns:
            (n, s, k, 7) their places, m, and orientations after each of ``bodies.steps``; NaN from where on a world's
            numbers are not finite, or its buffers are too small.

        Raises:
            InputError: this engine cannot.
        """
        raise InputError(f"engine {self.name} lets no boxes go; mujoco, mjx-warp, mjx-warp-cpu and mjx-jax do")

    def retire(self) -> None:
        """Nothing is run any more: begin to free what is held between runs, such as workers. Returns at once."""
        return None

    def close(self) -> None:
        """The same, and wait until it is free."""
        return self.retire()
