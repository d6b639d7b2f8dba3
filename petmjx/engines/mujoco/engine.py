"""The engine ``mujoco``: simulates the exact model of each plan on C MuJoCo, one world per thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Any, Final

from petmjx.common.machine import cpu_threads, device_name
from petmjx.common.text import one_line
from petmjx.common.units import FloatArray
from petmjx.engines.failed_world import failed_outcome
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mujoco.free_bodies import paths
from petmjx.engines.mujoco.message_log import QUIET_MUJOCO
from petmjx.engines.mujoco.open_worlds import MujocoWorlds
from petmjx.engines.mujoco.world_run import WorldCancelled, WorldRun
from petmjx.engines.mujoco.world_timeout import Budget
from petmjx.engines.open_world_protocol import MOST_BOXES
from petmjx.engines.protocol import Engine, Progress, says_at_hand, takes_stream
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job
from petmjx.world.scene import Scene

WORLD_WAIT_S: Final = 0.25
"""Longest uninterrupted wait for a world, s. This wait may delay the reaction to a signal, such as Ctrl-C."""


class MujocoEngine(Engine):
    """Simulates each world alone, on its exact model. Tests compare the other engines with this engine. Without a GPU,
    this engine is the fastest one for a small amount of work.

    ``mj_step`` takes all steps up to the next event without Python's global interpreter lock, so the speed grows with
    the number of CPU cores. The outcome of a world does not depend on the number of threads.

    If the simulation of a world raises an exception, the world is invalid and the other worlds continue. Possible
    reasons are a model that does not compile, a lack of memory, or an error in MuJoCo.

    Args:
        threads: number of worlds that are simulated at once. If ``threads`` is None, this is the number of CPU threads
            that the process may use.
        world_timeout_s: longest wall-clock time of one attempt at a world, s. If ``world_timeout_s`` is None, the limit
            follows from the world's expected time (petmjx/engines/mujoco/world_timeout.py).
    """

    name = "mujoco"

    def __init__(self, threads: int | None = None, world_timeout_s: float | None = None) -> None:
        if threads is not None and threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        self.threads = threads if threads is not None else cpu_threads()
        self.world_timeout_s = world_timeout_s

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> MujocoWorlds:
        """See ``Engine.open``. The worlds run on this engine's threads, and may get any number of boxes."""
        return MujocoWorlds(scenes, sim, self.threads)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """See ``Engine.paths``. The worlds run on this engine's threads."""
        return paths(bodies, sim, self.threads)

    @property
    def device(self) -> str:
        return device_name(self.name, self.threads)

    @says_at_hand
    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        """Simulate each job once. An outcome is yielded when its world ends.

        If the generator is closed, or an exception such as KeyboardInterrupt is raised, the threads stop within a few
        dozen steps. At most two jobs per thread wait or run at a time, so memory does not grow with the number of jobs.
        """
        stop = threading.Event()
        progress = progress if progress is not None else Progress()
        n_begun, last_line, most = 0, "", 2 * self.threads
        stream = JobStream.of(jobs)
        running: dict[int, Budget] = {}
        pending: set[Future[tuple[Outcome, float]]] = set()
        with QUIET_MUJOCO, ThreadPoolExecutor(self.threads, thread_name_prefix="petmjx-mujoco") as pool:
            try:
                while True:
                    new = stream.take(most - len(pending), least=1 if pending else most, wait=not pending)
                    if not new and not pending:
                        break
                    for job in new:
                        timeout_s = self.world_timeout_s
                        pending.add(pool.submit(_simulate, n_begun, job, sim, stop, timeout_s, running))
                        n_begun += 1
                    finished, pending = wait(pending, WORLD_WAIT_S, FIRST_COMPLETED)
                    last_line = _say(progress, last_line, "" if finished else _oldest(running))
                    if not finished and progress.pauses:
                        yield None  # type: ignore[misc]  # None is allowed only with ``Progress.pauses``
                    outcomes = [future.result() for future in finished]
                    for n_more, (outcome, thread_s) in zip(reversed(range(len(outcomes))), outcomes, strict=True):
                        progress.at_hand = n_more
                        progress.worlds_done += 1
                        progress.thread_s += thread_s
                        progress.world_steps += outcome.n_steps
                        yield outcome
            finally:
                stop.set()
                pool.shutdown(wait=True, cancel_futures=True)


def _oldest(running: Mapping[int, Budget]) -> str:
    """The progress of the running world that began first, as text. The text is empty if this world has not taken long
    yet.
    """
    with suppress(ValueError, KeyError, RuntimeError):  # other threads change ``running`` at the same time
        return running[min(running)].so_far
    return ""


def _say(progress: Progress, last_line: str, words: str) -> str:
    """Show the progress of a world, unless the progress line shows another message. Returns the line that this function
    showed last.

    Args:
        last_line: the line that this function showed last.
        words: the line to show now.
    """
    if progress.message != last_line:
        return last_line
    progress.message = words
    return words


def _simulate(
    stream_number: int,
    job: Job,
    sim: Simulation,
    stop: threading.Event,
    timeout_s: float | None,
    running: dict[int, Budget],
) -> tuple[Outcome, float]:
    """The outcome of a world, and the CPU time that this thread spent on the world, s. ``running``: the time budgets of
    all running worlds, by stream number."""
    begin_s = time.thread_time()
    try:
        running[stream_number] = budget = Budget(job, sim, timeout_s)
        outcome = WorldRun(stream_number, job, sim, stop.is_set, budget).run()
    except WorldCancelled:
        raise
    except Exception as error:
        outcome = failed_outcome(stream_number, job, sim, one_line(error))
    finally:
        running.pop(stream_number, None)
    return outcome, time.thread_time() - begin_s
