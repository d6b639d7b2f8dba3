"""Throughput of a run in words: finished worlds, rate and time left, for all displays of progress."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from petmjx.common.text import count_text, three_digits, time_left

MARK_S = 0.1
"""Smallest time between two marks, s. This minimum limits the number of stored times, even for a million worlds."""


class Throughput:
    """Counts finished worlds, and reports their number, their rate, and the time that the remaining worlds will take.

    Args:
        total: number of worlds; None if it is unknown.
        what: the noun for a world in messages: ``plan``; or ``world`` in sweeps.
        clock: function that returns the present time, s.
    """

    def __init__(self, total: int | None, what: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._total, self._what, self._clock = total, what, clock
        self._done, self._work = 0, 0.0
        self._begin = clock()
        self._marks = deque([(0.0, self._begin)])
        """Pairs: an amount of work, in worlds, and the time at which it was first reached, s. The time window of
        ``left`` begins at the oldest pair."""

    def update(self, done: int, share: float | None = None) -> None:
        """Set the number of finished worlds.

        Args:
            share: share of the work that is done, 0 to 1; None: the share of finished worlds.
        """
        work = float(done) if share is None or self._total is None else share * self._total
        if (done, work) == (self._done, self._work):
            return
        self._done, self._work = done, work
        mark = work, self._clock()
        if len(self._marks) > 2 and mark[1] - self._marks[-2][1] < MARK_S:
            self._marks[-1] = mark
        else:
            self._marks.append(mark)
        work_left = (self._total or 0) - work
        while work_left > 0 and len(self._marks) > 1 and self._marks[1][0] <= work - work_left:
            self._marks.popleft()

    @property
    def count(self) -> str:
        """Finished worlds: "5 of 12 plans", or "5 plans"."""
        if self._total is None:
            return count_text(self._done, self._what)
        return f"{self._done:,} of {count_text(self._total, self._what)}"

    @property
    def rate(self) -> str:
        """Finished worlds per second, over the whole run so far: "12.3 plans/s". Empty before the first world."""
        until = self._marks[-1][1] if self._done == self._total else self._clock()
        seconds = until - self._begin
        return f"{three_digits(self._done / seconds)} {self._what}s/s" if self._done and seconds > 0 else ""

    @property
    def left(self) -> str:
        """How long the remaining worlds will take: "1 min 20 s left". Empty if the remaining time is unknown, and at
        the end.

        If the work of n worlds remains, the estimate is the time in which the most recent work of n worlds was done.
        The rate of the whole run would be misleading near the end, when few worlds are left and these are long.
        """
        if not self._work or self._total is None or self._done >= self._total:
            return ""
        work_left = self._total - self._work
        seconds = (self._clock() - self._marks[0][1]) * max(work_left / self._work, 1.0)
        return f"{time_left(max(seconds, 1.0))} left"

    @property
    def words(self) -> list[str]:
        """The count, the rate and the time left, except those that are empty."""
        return [part for part in (self.count, self.rate, self.left) if part]
