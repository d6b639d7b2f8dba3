"""The time limit of a world on C MuJoCo. Without a limit, a world in which boxes overlap or collapse may take very
long."""

from __future__ import annotations

import time
from typing import Final

from petmjx.common.text import count_text, duration, time_left
from petmjx.engines.cost_model import MEASURED
from petmjx.options.simulation import Check, Simulation
from petmjx.world.job import Job

LEAST_S: Final = {Check.STATIC: 30.0, Check.ONE_BY_ONE: 300.0}
"""Every world may take at least this CPU time, s. Third-party plans of up to 241 boxes, with all boxes placed at once,
take up to 6 s."""

MOST_TIMES: Final = 32.0
"""Largest CPU time of a world, as a multiple of its expected time. The slowest collapsing plans take fifteen times
their expected time."""

MOST_TIMES_CARRIED: Final = 70.0
"""Largest CPU time of a world in which a hand or tines carry boxes, as a multiple of its expected time. The multiple is
larger than ``MOST_TIMES``, since a carried box may be pressed into a pile that collapses."""

LONG_S: Final = 5.0
"""Wall-clock time after which the user sees the progress of a single world, s."""

SLOW_S: Final = 0.05
"""If at least this time (s) passes between two checks of the budget, all following steps check the budget."""


class Budget:
    """The time limit of one attempt at a world. The thread that simulates the world creates the budget and checks it.

    Args:
        timeout_s: wall-clock time limit, s. If ``timeout_s`` is None, CPU time is limited by ``LEAST_S`` and
            ``MOST_TIMES``. Without ``timeout_s``, worlds with soft boxes have no limit, since their time cannot be
            estimated.

    Attributes:
        slow: whether at least ``SLOW_S`` passed between the last two checks.
    """

    def __init__(self, job: Job, sim: Simulation, timeout_s: float | None = None) -> None:
        self._job, self._sim, self._timeout_s = job, sim, timeout_s
        self._clock = time.monotonic if timeout_s is not None else time.thread_time
        self._begin_s = self._last_s = self._clock()
        self._most_s = LEAST_S[sim.check] if timeout_s is None else timeout_s
        self._is_exact = timeout_s is not None
        self._made_s = time.monotonic()
        self._steps = self._placed = 0
        self.slow = False

    def is_spent(self, steps: int, placed: int) -> bool:
        """Whether the time is used up. ``steps``: number of steps of the world so far; ``placed``: number of placed
        boxes."""
        self._steps, self._placed = steps, placed
        now_s = self._clock()
        self.slow, self._last_s = now_s - self._last_s >= SLOW_S, now_s
        if now_s - self._begin_s <= self._most_s:
            return False
        if not self._is_exact:  # most worlds end within ``LEAST_S``, so the exact limit is computed only now
            self._is_exact = True
            soft = self._job.scene.soft is not None
            expected_s = float(MEASURED.of_jobs([self._job], self._sim)[0])
            most_times = MOST_TIMES_CARRIED if self._job.scene.placing.carries else MOST_TIMES
            self._most_s = float("inf") if soft else max(self._most_s, most_times * expected_s)
        return now_s - self._begin_s > self._most_s

    @property
    def so_far(self) -> str:
        """The progress of a world that takes long, as text for the user. Empty before ``LONG_S``. Any thread may read
        this text."""
        seconds = time.monotonic() - self._made_s
        if seconds < LONG_S:
            return ""
        return f"one world for {time_left(seconds)}: {self._reach}"

    @property
    def words(self) -> str:
        """A message of one line for a world that used up its time."""
        kind = "" if self._timeout_s is not None else " of CPU time"
        return f"no verdict within {duration(self._most_s)}{kind}: {self._reach}; world_timeout_s allows more time"

    @property
    def _reach(self) -> str:
        boxes = count_text(self._job.scene.n_boxes, "box", "boxes")
        return f"{self._placed} of {boxes} placed, {count_text(self._steps, 'step')}"
