"""Searches of many plans: parts of a search run side by side, and searches run in several processes.

To propose drafts and to compute their static balance takes at least as long as to simulate them on a GPU. So searches
are distributed over processes. Each process sends the drafts that its searches need, and gets the trials of each
request as soon as they are known. The process that has the engine simulates the drafts of all searches in one stream.
Which worlds are simulated at the same time changes no result: the outcome of a world does not depend on other worlds.
"""

from __future__ import annotations

import math
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Protocol

import numpy.ma  # noqa: F401  # ``numpy.unique`` needs it, and each copy of the process would import it anew

from petmjx.engines.subprocess.task_pipe import Child, Forks, PipedProcess, next_of, own_pipes
from petmjx.repairs.requests import OutOfTime, Steps, Together, TrialAnswer, TrialRequest
from petmjx.repairs.search import Search

LEAST_PLANS: Final = 8
"""Fewer plans are not worth further processes: the first process needs half a second of CPU time to start."""

PER_THREAD: Final = 8
"""Largest number of processes per CPU thread, if a GPU simulates, on systems that can copy processes. Each process runs
its searches in turn, and searches differ much in length. With more processes than threads, the operating system shares
the threads among the searches that are left, and threads do not wait while searches wait for trials. The processes are
copies of one process (``Forks``), so a further process starts within some hundredths of a second, and needs only a few
MB of memory."""

PER_THREAD_UNCOPIED: Final = 3
"""As ``PER_THREAD``, on systems that cannot copy processes. There, each process is a new interpreter: it needs half a
second of CPU time to start, and about 30 MB of memory."""

PLANS_EACH_UNCOPIED: Final = 4
"""Smallest number of plans per process, on systems that cannot copy processes."""

REQUEST_WAIT_S: Final = 0.005
"""While all processes are busy, and the engine is idle, messages are looked for at intervals of this length, s."""


OnEnd = Callable[[str], object]
"""A function that is called with the plan id of each search that has ended. If a process dies, its searches begin anew,
so the function may be called twice for them."""


class Simulator(Protocol):
    """Simulates drafts while further ones are requested (``TrialStream``)."""

    def put(self, ticket: Any, requests: Sequence[TrialRequest]) -> None:
        """Request the trials of drafts."""

    def answers(self) -> Iterator[TrialAnswer | None]:
        """The answers, until no batch of requests is left. Raises ``OutOfTime`` if the time is up."""
        ...


@dataclass(eq=False)
class _Task:
    """A search, or a part of one.

    Attributes:
        whole: the task of which this task is a part; None for a whole search.
        place: position of this part among the parts of ``whole``; position of a whole search among all searches.
        results: the results of the parts of this task that run side by side.
        n_running: number of the parts of this task that have not ended.
    """

    steps: Steps[Any]
    whole: _Task | None = None
    place: int = 0
    results: list[Any] = field(default_factory=list)
    n_running: int = 0


class Tasks:
    """Runs searches in turns: a search, or a part of a search, runs until it needs trials, and continues when these
    trials are known.

    Args:
        on_end: function that is called with the number of each search that has ended.

    Attributes:
        batches: (ticket, requests) of each batch of requests that was not sent to a simulator yet. The ticket is the
            number of the batch.
    """

    def __init__(self, searches: Iterable[Steps[Any]], on_end: Callable[[int], object] = lambda number: None) -> None:
        self.batches: list[tuple[int, list[TrialRequest]]] = []
        self._on_end = on_end
        self._waiting: dict[int, _Task] = {}
        self._n_batches = 0
        for number, steps in enumerate(searches):
            self._go_on(_Task(steps, place=number), None)

    def take(self, answer: TrialAnswer) -> None:
        """Continue the task whose requests are answered."""
        self._go_on(self._waiting.pop(answer.ticket), answer.trials)

    def send_to(self, simulator: Simulator) -> None:
        """Send the requests that were not sent yet."""
        batches, self.batches = self.batches, []
        for ticket, requests in batches:
            simulator.put(ticket, requests)

    def _go_on(self, task: _Task, results: Any) -> None:
        """Continue a task with the trials or results for which it waits, until it waits for further trials or results.
        A task whose last part has ended continues at once. Ready tasks are kept in a stack. (If this method called
        itself instead, many rounds without simulations could exceed Python's limit of nested calls.)"""
        ready = [(task, results)]
        while ready:
            task, results = ready.pop()
            try:
                wants = task.steps.send(results)
                while isinstance(wants, Together) and not wants.parts:
                    wants = task.steps.send([])
            except StopIteration as end:
                whole = task.whole
                if whole is None:
                    self._on_end(task.place)
                else:
                    whole.results[task.place] = end.value
                    whole.n_running -= 1
                    if not whole.n_running:
                        ready.append((whole, whole.results))
                continue
            if isinstance(wants, Together):
                task.results, task.n_running = [None] * len(wants.parts), len(wants.parts)
                parts = [(_Task(part, task, place), None) for place, part in enumerate(wants.parts)]
                ready += reversed(parts)
            else:
                self._waiting[self._n_batches] = task
                self.batches.append((self._n_batches, wants))
                self._n_batches += 1


def most_processes(threads: int, *, is_wide: bool) -> int:
    """Largest number of processes that run searches.

    Args:
        threads: number of CPU threads.
        is_wide: whether a GPU simulates.
    """
    per_thread = PER_THREAD if Forks.are_possible else PER_THREAD_UNCOPIED
    return threads * per_thread if is_wide else threads


class SearchProcesses:
    """Processes that run searches.

    Args:
        n_searches: largest number of searches. If there are fewer than ``LEAST_PLANS``, this process runs all searches.
            Otherwise, on systems that can copy processes, a first process starts at once, while this process can do
            other work. The number of further processes follows from the number of searches.
        most: largest number of processes (``most_processes``).
    """

    def __init__(self, n_searches: int, most: int) -> None:
        self._n_searches, self._most = n_searches, most
        self._has_processes = most > 1 and n_searches >= LEAST_PLANS
        self._forks = Forks(__name__) if Forks.are_possible and self._has_processes else None
        self._children: list[Child] = []
        self._working: list[PipedProcess] = []
        self._parts: list[list[Search]] = []

    def begin(self, searches: Sequence[Search]) -> None:
        """Let processes begin these searches. Each process goes on until its searches need trials. Plans with many
        boxes take longest, so they are in different processes, and begin first. Further searches may begin later: they
        get processes of their own, in proportion to their number."""
        most = math.ceil(self._most * len(searches) / self._n_searches)
        by_number = len(searches) if Forks.are_possible else len(searches) // PLANS_EACH_UNCOPIED
        n_processes = max(min(most, by_number), 1)
        searches = sorted(searches, key=lambda search: -search.plan.n_boxes)
        parts = [searches[k::n_processes] for k in range(n_processes)]
        self._parts += parts
        if self._has_processes:
            children = [self._child() for _ in parts]
            for child, part in zip(children, parts, strict=True):
                child.tasks.put(pickle.dumps(part))
            self._working += children

    def run(self, simulator: Simulator, on_end: OnEnd = lambda plan_id: None) -> None:
        """Run the searches to their ends, or until the time is up."""
        if not self._working:
            _run_here([search for part in self._parts for search in part], simulator, on_end)
            return
        for number in _Server(self._working, self._parts, simulator, on_end).serve():
            _run_here(self._parts[number], simulator, on_end)

    def close(self) -> None:
        """End the processes."""
        if self._forks is not None:
            self._forks.end()
        for child in self._children:
            child.end()

    def _child(self) -> PipedProcess:
        if self._forks is not None:
            return self._forks.fork()
        self._children.append(Child(__name__))
        return self._children[-1]


def _run_here(searches: Sequence[Search], simulator: Simulator, on_end: OnEnd) -> None:
    """Run searches side by side in this process."""
    open_ones = [search for search in searches if not search.complete]
    tasks = Tasks((search.run() for search in open_ones), lambda number: on_end(open_ones[number].plan.plan_id))
    tasks.send_to(simulator)
    with suppress(OutOfTime):
        for answer in simulator.answers():
            if answer is not None:
                tasks.take(answer)
                tasks.send_to(simulator)


class _Server:
    """Simulates the drafts that processes request, until all of their searches have ended.

    An interrupt ends the searches as if the time were up. When the processes have sent the results of the searches that
    have ended, the interrupt is raised again. A second interrupt is raised at once.
    """

    def __init__(
        self, children: Sequence[PipedProcess], parts: Sequence[list[Search]], simulator: Simulator, on_end: OnEnd
    ) -> None:
        self._children, self._parts, self._simulator, self._on_end = children, parts, simulator, on_end
        self._working = set(range(len(children)))
        self._dead: list[int] = []

    def serve(self) -> list[int]:
        """Returns the numbers of the processes that have died: their searches begin anew."""
        try:
            while self._working:
                self._collect(wait=True)
                for answer in self._simulator.answers():
                    if answer is not None:
                        number, ticket = answer.ticket
                        self._send(number, TrialAnswer(ticket, answer.trials))
                    self._collect()
        except OutOfTime:
            self._end()
        except KeyboardInterrupt:
            self._end()
            raise
        return self._dead

    def _collect(self, *, wait: bool = False) -> None:
        """Take the messages of all processes.

        Args:
            wait: whether to wait for a message.
        """
        while not self._take_messages() and wait and self._working:
            time.sleep(REQUEST_WAIT_S)

    def _take_messages(self) -> bool:
        """Take the messages that have arrived; returns whether there was any."""
        any_message = False
        for number in sorted(self._working):
            answers = self._children[number].answers
            while number in self._working and not answers.empty():
                self._take(number, answers.get_nowait())
                any_message = True
        return any_message

    def _take(self, number: int, message: _Message | None) -> None:
        if message is None:  # the process has died
            self._dead.append(number)
            self._working.discard(number)
            return
        for ticket, requests in message.batches:
            self._simulator.put((number, ticket), requests)
        for plan_id in message.ended:
            self._on_end(plan_id)
        if message.searches is not None:
            for search, ended in zip(self._parts[number], message.searches, strict=True):
                search.take(ended)
            self._working.discard(number)

    def _send(self, number: int, message: TrialAnswer | None) -> None:
        self._children[number].tasks.put(pickle.dumps(message))

    def _end(self) -> None:
        """Let the processes end, and take the results of their searches."""
        for number in self._working:
            self._send(number, None)
        while self._working:
            self._collect(wait=True)


class _Message(NamedTuple):
    """A message from a process that runs searches.

    Attributes:
        batches: (ticket, requests) of each batch of requests since the last message.
        ended: plan ids of the searches that have ended since the last message.
        searches: all searches of the process, in the last message; None before.
    """

    batches: Sequence[tuple[int, Sequence[TrialRequest]]]
    ended: Sequence[str]
    searches: Sequence[Search] | None


class _PipedSimulator:
    """The simulator in a process that runs searches. The simulator sends drafts to the process that has the engine, and
    receives the trials of these drafts.

    Attributes:
        ended: plan ids of the searches that have ended since the last message.
    """

    def __init__(self) -> None:
        self._tasks, self._answers = own_pipes()
        self._batches: list[tuple[int, Sequence[TrialRequest]]] = []
        self.ended: list[str] = []
        self._n_open = 0

    def searches(self) -> list[Search] | None:
        """Receive the searches that this process is to run; None if the pipe has ended."""
        searches: list[Search] | None = next_of(self._tasks)
        return searches

    def put(self, ticket: Any, requests: Sequence[TrialRequest]) -> None:
        """See ``Simulator``."""
        self._batches.append((ticket, requests))
        self._n_open += 1

    def answers(self) -> Iterator[TrialAnswer]:
        """See ``Simulator``."""
        while self._n_open:
            if self._batches or self.ended:
                self.send(None)
            answer: TrialAnswer | None = next_of(self._tasks)
            if answer is None:
                raise OutOfTime
            self._n_open -= 1
            yield answer

    def send(self, searches: Sequence[Search] | None) -> None:
        """Send a message. ``searches``: see ``_Message``."""
        pickle.dump(_Message(self._batches, self.ended, searches), self._answers)
        self._answers.flush()
        self._batches.clear()
        self.ended.clear()


def main() -> None:
    """The program of a process that runs searches. The first message to the process has the searches; all later
    messages have answers to requests of the searches."""
    simulator = _PipedSimulator()
    searches = simulator.searches()
    if searches is not None:
        _run_here(searches, simulator, simulator.ended.append)
        simulator.send(searches)
