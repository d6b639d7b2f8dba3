"""A function over many tasks in several processes, results in the order of the tasks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from itertools import chain, islice
from typing import Final, TypeVar

from petmjx.basics.processes import process_pool

ALONE: Final = 256
"""Fewer tasks of milliseconds are done in this process: other processes would take longer to start."""

_CHUNK: Final = 16
_CHUNKS_AHEAD: Final = 4
"""Chunks for each process that are under way, which bounds the memory."""

Task = TypeVar("Task")
Result = TypeVar("Result")


def in_order(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    workers: int,
    *,
    alone: int | None = None,
    chunk: int = _CHUNK,
) -> Iterator[Result]:
    """``function`` of each task. What comes out does not depend on ``workers``.

    Args:
        function: a function of a module (or ``functools.partial`` of one), since other processes import it.
        tasks: read as far ahead as is needed, in this process.
        workers: how many processes; 1: this one. Scripts that ask for more need ``if __name__ == "__main__":``.
        alone: fewer tasks than this are done in this process; None: ``ALONE``.
        chunk: tasks that another process gets at a time.
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
        while some := list(islice(everything, chunk)):
            waiting.append(pool.submit(_each, function, some))
            if len(waiting) >= _CHUNKS_AHEAD * workers:
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _each(function: Callable[[Task], Result], tasks: list[Task]) -> list[Result]:
    return [function(task) for task in tasks]
