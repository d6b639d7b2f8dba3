"""Texts about the progress of a run, for all displays of progress: the number of finished worlds (simulations of one
plan each), their rate, and the time left."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from petmjx.common.text import count_text, three_digits, time_left

MARK_S = 0.1
"""Smallest time between two entries of ``ProgressTexts._marks``, s. Without this smallest time, a million worlds would
add a million entries."""


class ProgressTexts:
    """Counts finished worlds (simulations of one plan each), and reports their number, their rate, and the time that
    the remaining worlds will take.

    Args:
        total: number of worlds; None if it is unknown.
        what: the noun for a world in messages: ``plan``, or ``world`` in sweeps.
        clock: function that returns the present time, s.
    """

    def __init__(self, total: int | None, what: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._total, self._what, self._clock = total, what, clock
        self._done, self._work = 0, 0.0
        self._begin = clock()
        self._marks = deque([(0.0, self._begin)])
        """Pairs of numbers. Each pair has an amount of finished work, in worlds, and the time at which this amount was
        reached, s. ``left`` computes the rate of work from the time since the oldest pair."""

    def update(self, done: int, share: float | None = None) -> None:
        """Set the number of finished worlds.

        Args:
            share: finished share of the whole work, 0 to 1. If ``share`` is None, every world counts as the same amount
                of work.
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
        """The number of finished worlds as text, such as "5 of 12 plans", or "5 plans" if the total is unknown."""
        if self._total is None:
            return count_text(self._done, self._what)
        return f"{self._done:,} of {count_text(self._total, self._what)}"

    @property
    def rate(self) -> str:
        """The number of finished worlds per second since the start of the run, as text: "12.3 plans/s". The text is
        empty before the first world is finished."""
        until = self._marks[-1][1] if self._done == self._total else self._clock()
        seconds = until - self._begin
        return f"{three_digits(self._done / seconds)} {self._what}s/s" if self._done and seconds > 0 else ""

    @property
    def left(self) -> str:
        """The time that the remaining worlds will take, as text such as "1 min 20 s left". The text is empty at the end
        of the run, and if the remaining time is unknown.

        If n worlds remain, the estimate is the time that the last n finished worlds took. Near the end, the rate of the
        whole run would be misleading, because the last few worlds take long.
        """
        if not self._work or self._total is None or self._done >= self._total:
            return ""
        work_left = self._total - self._work
        seconds = (self._clock() - self._marks[0][1]) * max(work_left / self._work, 1.0)
        return f"{time_left(max(seconds, 1.0))} left"

    @property
    def words(self) -> list[str]:
        """Those of the three texts ``count``, ``rate`` and ``left`` that are not empty."""
        return [part for part in (self.count, self.rate, self.left) if part]
