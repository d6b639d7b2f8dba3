"""Simulates single worlds again (further *attempts*) on threads of this process, beside a run on the same CPUs."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from petmjx.engines.subprocess.attempt_child import engine_with_one_thread
from petmjx.engines.subprocess.attempt_process import AttemptAnswer, AttemptTask, answer_to
from petmjx.engines.subprocess.task_pipe import arrived


class AttemptThreads:
    """Simulates worlds on threads. Each thread has its own engine, which uses this thread only. While the threads of
    the run simulate worlds, the two kinds of threads share the CPUs. Afterwards, the threads of this class have all
    CPUs.

    Args:
        threads: number of threads.
    """

    def __init__(self, threads: int) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="petmjx-attempts")
        self._answers = queue.SimpleQueue[AttemptAnswer]()
        self._unanswered, self._closed = 0, False
        self._of_thread = threading.local()

    def begin(self, task: AttemptTask) -> None:
        """See ``AttemptSimulator.begin``."""
        self._unanswered += 1
        self._pool.submit(self._simulate, task)

    def _simulate(self, task: AttemptTask) -> None:
        self._answers.put(answer_to(task, vars(self._of_thread), engine_with_one_thread, lambda: self._closed))

    def ended(self, *, wait: bool) -> Iterator[AttemptAnswer]:
        """See ``AttemptSimulator.ended``."""
        if self._unanswered:
            for answer in arrived(self._answers, wait=wait):
                self._unanswered -= 1
                yield answer

    def close(self) -> None:
        """See ``AttemptSimulator.close``. Worlds that are being simulated stop after their current time slice (a short
        part of the simulation)."""
        self._closed = True
        self._pool.shutdown(wait=False, cancel_futures=True)
