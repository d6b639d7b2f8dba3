"""Distributions of random errors (``Distribution``)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from petmjx.common.units import FloatArray


class DistributionShape(StrEnum):
    """The family of a distribution of errors."""

    FIXED = "fixed"
    NORMAL = "normal"
    UNIFORM = "uniform"


@dataclass(frozen=True)
class Distribution:
    """The distribution of an error, in the unit of the sweep's axis that sets the error.

    A ``fixed`` error is always ``centre``. A ``normal`` error has the mean ``centre`` and the standard deviation
    ``spread``. A ``uniform`` error is between ``centre − spread`` and ``centre + spread``.
    """

    shape: DistributionShape = DistributionShape.FIXED
    centre: float = 0.0
    spread: float = 0.0

    @property
    def random(self) -> bool:
        return self.shape is not DistributionShape.FIXED and self.spread > 0

    @property
    def zero(self) -> bool:
        return self.centre == 0 and not self.random

    def draw(self, rngs: Iterable[np.random.Generator], shape: tuple[int, ...]) -> FloatArray:
        """(m, …) an array of errors for each of m generators. If the error is not random, the result is a single array,
        (1, …), and no generator is used.

        Standard random numbers are drawn and then scaled. So with the same generator, twice the spread gives each box
        twice the error, and worlds at two levels of a sweep can be compared pair by pair.
        """
        if self.random and self.shape is DistributionShape.NORMAL:
            return self.centre + self.spread * np.array([rng.standard_normal(shape) for rng in rngs])
        if self.random and self.shape is DistributionShape.UNIFORM:
            return self.centre + self.spread * (2.0 * np.array([rng.random(shape) for rng in rngs]) - 1.0)
        return np.full((1, *shape), self.centre)

    def label(self) -> str:
        """Text that stands for the distribution in results, if an axis has distributions of several families."""
        if self.zero:
            return "0"
        if self.shape is DistributionShape.FIXED:
            return f"fixed({self.centre:g})"
        if self.shape is DistributionShape.NORMAL:
            return f"normal({self.centre:g}, {self.spread:g})"
        return f"uniform({self.centre - self.spread:g}, {self.centre + self.spread:g})"
