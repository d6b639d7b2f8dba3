"""Adam (Kingma, Ba 2015, "Adam: a method for stochastic optimization"), as a method that maximises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Adam:
    """State of the optimiser.

    Attributes:
        first, second: (d,) first and second moments of the slopes; ``count``: number of steps so far.
    """

    first: Array
    second: Array
    count: int

    @classmethod
    def fresh(cls, size: int) -> Self:
        """The state before the first step."""
        return cls(np.zeros(size), np.zeros(size), 0)

    def stepped(self, values: Array, slope: Array, rate: float) -> tuple[Array, Adam]:
        """The values after a step uphill, and the state after the step."""
        count = self.count + 1
        first, second = 0.9 * self.first + 0.1 * slope, 0.99 * self.second + 0.01 * slope**2
        step = first / (1 - 0.9**count) / (np.sqrt(second / (1 - 0.99**count)) + 1e-8)
        return values + rate * step, Adam(first, second, count)
