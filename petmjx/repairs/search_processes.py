"""Searches of many plans in several processes, whose trials share runs of one engine.

Proposals and statics take as long as a GPU takes for the trials, and more. So searches are dealt out to processes. Each
process sends what its searches ask for; this process gives the engine what all that wait have asked for, while the
others go on. Which searches share a run changes no result: the outcome of a world does not depend on those beside it.
"""

from __future__ import annotations

import pickle
import queue
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from petmjx.engines.subprocess.task_pipe import Child, next_of, own_pipes
from petmjx.repairs.search import Asking, Search
from petmjx.repairs.trials import Asked, OutOfTime, Trial

PLANS_EACH: Final = 4
"""Plans for which a process is worth its start, of two seconds."""

LOOK_S: Final = 0.05
"""Seconds to wait for further processes before the engine starts."""

Ask = Callable[[list[Asked]], list[Trial]]
"""Simulates drafts. Raises ``OutOfTime`` if the time is up."""


def run_searches(searches: Sequence[Search], ask: Ask, processes: int) -> None:
    """Run searches to their ends.

    Args:
        ask: simulates drafts.
        processes: number of processes at most; this one alone if there are few searches for each.
    """
    processes = min(processes, len(searches) // PLANS_EACH)
    if processes < 2:
        _run_here(searches, ask)
        return
    parts = [list(searches[k::processes]) for k in range(processes)]
    children = [Child(__name__) for _ in parts]
    try:
        for child, part in zip(children, parts, strict=True):
            child.tasks.put(pickle.dumps(part))
        _serve(children, parts, ask)
    finally:
        for child in children:
            child.end()


def _run_here(searches: Sequence[Search], ask: Ask) -> None:
    """Run searches side by side in this process."""
    running: list[tuple[Asking, list[Asked]]] = []
    for search in searches:
        steps = search.run()
        running.append((steps, next(steps)))
    while running:
        try:
            trials = ask([asked for _, drafts in running for asked in drafts])
        except OutOfTime:
            return
        left, begin = [], 0
        for steps, drafts in running:
            with suppress(StopIteration):
                left.append((steps, steps.send(trials[begin : begin + len(drafts)])))
            begin += len(drafts)
        running = left


def _serve(children: Sequence[Child], parts: Sequence[list[Search]], ask: Ask) -> None:
    """Simulate what processes ask for, until all of their searches have ended.

    An interrupt ends them as if the time were up, so that searches that have ended are known here; then it is raised. A
    second one is raised at once.
    """
    working = set(range(len(children)))
    stop: KeyboardInterrupt | None = None
    while working:
        asked: dict[int, list[Asked]] = {}
        while not asked and working:
            for number in sorted(working):
                try:
                    answer = children[number].answers.get(timeout=LOOK_S)
                except queue.Empty:
                    continue
                except KeyboardInterrupt as interrupt:
                    if stop is not None:
                        raise
                    stop = interrupt
                    continue
                if answer is None:  # the process has died: its searches begin anew here
                    if stop is None:
                        _run_here(parts[number], ask)
                    working.discard(number)
                elif answer[1]:
                    for search, ended in zip(parts[number], answer[0], strict=True):
                        search.take(ended)
                    working.discard(number)
                else:
                    asked[number] = answer[0]
        trials: list[Trial] | None = None
        try:
            if stop is None:
                trials = ask([one for some in asked.values() for one in some]) if asked else []
        except OutOfTime:
            pass
        except KeyboardInterrupt as interrupt:
            stop = interrupt
        begin = 0
        for number, some in asked.items():
            part = None if trials is None else trials[begin : begin + len(some)]
            children[number].tasks.put(pickle.dumps((part,)))
            begin += len(some)
    if stop is not None:
        raise stop


def main() -> None:
    """The process: searches come first, then the trials of what they ask for."""
    tasks, answers = own_pipes(0)

    def send(answer: Any, has_ended: bool) -> None:
        pickle.dump((answer, has_ended), answers)
        answers.flush()

    def ask(asked: list[Asked]) -> list[Trial]:
        send(asked, False)
        message = next_of(tasks)
        if message is None or message[0] is None:
            raise OutOfTime
        trials: list[Trial] = message[0]
        return trials

    searches = next_of(tasks)
    if searches is not None:
        _run_here(searches, ask)
        send(searches, True)
