"""CMA-ES (Hansen, Ostermeier 2001, "Completely derandomized self-adaptation in evolution strategies"), as a method that
maximises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Search:
    """State of the search: the normal distribution from which candidates are drawn.

    Attributes:
        mean: (d,) mean; ``sigma``: () step size; ``cov``: (d, d) covariance; ``path``, ``path_sigma``: (d,) evolution
            paths.
        count: number of generations so far.
    """

    mean: Array
    sigma: Array
    cov: Array
    path: Array
    path_sigma: Array
    count: Array

    @classmethod
    def fresh(cls, mean: Array, sigma: float) -> Self:
        """The state before the first generation."""
        d = len(mean)
        return cls(mean, np.array(sigma), np.eye(d), np.zeros(d), np.zeros(d), np.array(0))

    def drawn(self, n: int, rng: np.random.Generator) -> Array:
        """(n, d) candidates, drawn at random."""
        values, axes = self._axes()
        steps = rng.standard_normal((n, len(self.mean))) * np.sqrt(values) @ axes.T
        weights: Array = self.mean + self.sigma * steps
        return weights

    def told(self, candidates: Array, worth: Array) -> Search:
        """The state after a generation, from the worth of its candidates."""
        d, n = len(self.mean), len(candidates)
        best = candidates[np.argsort(-worth, kind="stable")[: n // 2]]
        weights = np.log(n / 2 + 0.5) - np.log(np.arange(1, len(best) + 1))
        weights /= weights.sum()
        mass = 1 / float((weights**2).sum())
        steps = (best - self.mean) / self.sigma
        step = weights @ steps
        c_sigma, d_sigma = (mass + 2) / (d + mass + 5), 1 + (mass + 2) / (d + mass + 5)
        c_path = (4 + mass / d) / (d + 4 + 2 * mass / d)
        c_one = 2 / ((d + 1.3) ** 2 + mass)
        c_mass = min(1 - c_one, 2 * (mass - 2 + 1 / mass) / ((d + 2) ** 2 + mass))
        values, axes = self._axes()
        white = axes @ ((axes.T @ step) / np.sqrt(values))
        path_sigma = (1 - c_sigma) * self.path_sigma + np.sqrt(c_sigma * (2 - c_sigma) * mass) * white
        usual = np.sqrt(d) * (1 - 1 / (4 * d) + 1 / (21 * d**2))
        length = float(np.linalg.norm(path_sigma))
        path = (1 - c_path) * self.path + np.sqrt(c_path * (2 - c_path) * mass) * step
        cov = (1 - c_one - c_mass) * self.cov + c_one * np.outer(path, path)
        cov += c_mass * (steps.T * weights) @ steps
        sigma = self.sigma * np.exp(min(c_sigma / d_sigma * (length / usual - 1), 0.3))
        mean: Array = self.mean + self.sigma * step
        return Search(mean, sigma, (cov + cov.T) / 2, path, path_sigma, self.count + 1)

    def _axes(self) -> tuple[Array, Array]:
        values, axes = np.linalg.eigh(self.cov)
        return np.maximum(values, 1e-12), axes

    @property
    def arrays(self) -> dict[str, Array]:
        """The state as named arrays, for a file."""
        return {name: np.asarray(getattr(self, name)) for name in self.__dataclass_fields__}
