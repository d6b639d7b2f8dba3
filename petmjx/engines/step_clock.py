"""The simulated time after each step, exactly as MuJoCo counts it."""

from __future__ import annotations

import numpy as np


class Clock:
    """MuJoCo's time after each step: the running sum of the timestep, in float64."""

    def __init__(self, timestep_s: float) -> None:
        self._dt = timestep_s
        self._time = np.zeros(1)

    def time_s(self, step: int) -> float:
        if step >= len(self._time):
            # cumsum adds step by step, as mj_step does. The product step × dt would differ in the last digits.
            self._time = np.concatenate(([0.0], np.cumsum(np.full(2 * step + 1000, self._dt))))
        return float(self._time[step])

    def first_after(self, step: int, interval_s: float) -> int:
        """The first step after which at least ``interval_s`` seconds have passed since the step ``step``."""
        start = self.time_s(step)
        candidate = step + max(int(interval_s / self._dt) - 2, 0)
        while self.time_s(candidate) - start < interval_s:
            candidate += 1
        return candidate
