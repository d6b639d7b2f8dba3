"""Parallel map: calls a function for many tasks in several processes. The results come in the order of the tasks, or as
soon as they are ready."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import chain, islice
from typing import TYPE_CHECKING, Final, Generic, Self, TypeVar

from petmjx.common.processes import process_pool, stop

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

ALONE: Final = 256
"""Number of tasks below which all tasks run in this process. If the tasks take milliseconds, starting other processes
would take longer than running the tasks."""

_CHUNK: Final = 16
_CHUNKS_AHEAD: Final = 4
"""Largest number of chunks of tasks, per process, that are computed in advance. Results that are computed in advance
wait in memory until the caller takes them."""

_NICE: Final = 5
"""Niceness (lower priority) that ``UnorderedResults`` adds to its processes. The process that receives the results
keeps its priority, because it must keep a simulation engine busy."""

Task = TypeVar("Task")
Result = TypeVar("Result")


def ordered_results(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    workers: int,
    *,
    alone: int | None = None,
    chunk: int = _CHUNK,
) -> Iterator[Result]:
    """Yield the results of ``function`` for all tasks, in the order of the tasks. The results do not depend on
    ``workers``.

    Args:
        function: a function that is defined in a module, so that other processes can import it, or a
            ``functools.partial`` of such a function.
        tasks: the arguments of the calls. This process takes the next task from the iterable only when another process
            can soon start it.
        workers: number of processes. If ``workers`` is 1, only this process is used. Scripts that use several processes
            need ``if __name__ == "__main__":``.
        alone: number of tasks below which all tasks run in this process. The default is ``ALONE``.
        chunk: number of tasks that another process receives at a time.
    """
    tasks, alone = iter(tasks), ALONE if alone is None else alone
    first = list(islice(tasks, alone)) if workers > 1 else []
    everything = chain(first, tasks)
    if len(first) < alone:
        yield from map(function, everything)
        return
    pool = process_pool(workers, gpu=False)
    try:
        waiting: deque[Future[list[Result]]] = deque()
        while chunk_tasks := list(islice(everything, chunk)):
            waiting.append(pool.submit(_task_results, function, chunk_tasks))
            if len(waiting) >= _CHUNKS_AHEAD * workers:
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _task_results(function: Callable[[Task], Result], tasks: list[Task]) -> list[Result]:
    return [function(task) for task in tasks]


class UnorderedResults(Generic[Task, Result]):
    """Calls ``function`` for all tasks, and returns results in the order in which they become ready (``take``). Use
    objects of this class in a ``with`` block.

    Args:
        function, tasks: arguments of ``ordered_results``, which explains them.
        workers: number of processes. If ``workers`` is 1, only this process is used, and it runs a task when ``take``
            waits for a result.
    """

    def __init__(self, function: Callable[[Task], Result], tasks: Iterable[Task], workers: int) -> None:
        self._function, self._tasks = function, enumerate(tasks)
        self._ahead = _CHUNKS_AHEAD * workers
        self._pool = process_pool(workers, gpu=False, nice=_NICE) if workers > 1 else None
        self._numbers: dict[Future[Result], int] = {}
        self._all_begun = False

    @property
    def ended(self) -> bool:
        """Whether no task is left to start, and the caller has taken all results."""
        return self._all_begun and not self._numbers

    @property
    def alone(self) -> bool:
        """Whether tasks run in this process, because there are no other processes."""
        return self._pool is None

    def take(self, *, waits: bool) -> list[tuple[int, Result]]:
        """Take the results that are ready. Each result comes with the number of its task.

        Args:
            waits: whether to wait until at least one result is ready. If no task is left, the method never waits.
        """
        if self._pool is None:
            results = [(number, self._function(task)) for number, task in islice(self._tasks, int(waits))]
            self._all_begun = waits and not results
            return results
        self._submit(self._pool)
        done_futures, _ = wait(self._numbers, None if waits else 0, FIRST_COMPLETED)
        results = [(self._numbers.pop(future), future.result()) for future in done_futures]
        self._submit(self._pool)
        return results

    def _submit(self, pool: ProcessPoolExecutor) -> None:
        next_tasks = list(islice(self._tasks, self._ahead - len(self._numbers)))
        self._all_begun = len(next_tasks) < self._ahead - len(self._numbers)
        for number, task in next_tasks:
            self._numbers[pool.submit(self._function, task)] = number

    def __enter__(self) -> Self:
        try:
            if self._pool is not None:
                self._submit(self._pool)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, kind: object = None, *_: object) -> None:
        """End the processes. After an error, running tasks are aborted."""
        if self._pool is not None:
            if kind is not None:
                stop(self._pool)
            self._pool.shutdown(cancel_futures=True)
