"""Two shares from the same trials: interval of their difference, exact test, correction for many tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from petmjx.basics.errors import InputError
from petmjx.basics.units import FloatArray
from petmjx.results.shares import DEFAULT_CONFIDENCE, wilson_interval


@dataclass(frozen=True)
class PairedCounts:
    """Trials by what came of them in a and in b.

    Attributes:
        both, only_a, only_b, neither: successes.
    """

    both: int
    only_a: int
    only_b: int
    neither: int

    @property
    def n(self) -> int:
        """Number of trials."""
        return self.both + self.only_a + self.only_b + self.neither

    @property
    def difference(self) -> float:
        """Share of b minus share of a; NaN without trials."""
        return (self.only_b - self.only_a) / self.n if self.n else float("nan")


def newcombe_interval(counts: PairedCounts, confidence: float = DEFAULT_CONFIDENCE) -> tuple[float, float]:
    """Confidence interval of share b − share a: Newcombe's square-and-add interval; (−1, 1) without trials.

    Source: Newcombe (1998), "Improved confidence intervals for the difference between binomial proportions based on
    paired data", Statistics in Medicine 17, 2635–2650, method 10: the Wilson intervals of both shares are put together
    with their correlation, which is made smaller by a correction for continuity where it is positive.
    """
    n = counts.n
    if n == 0:
        return -1.0, 1.0
    hits = np.array([counts.both + counts.only_b, counts.both + counts.only_a])
    low, high = wilson_interval(hits, n, confidence)
    (below_b, below_a), (above_b, above_a) = (hits / n - low).tolist(), (high - hits / n).tolist()
    twice = 2 * _correlation(counts)
    difference = counts.difference
    # rounding may leave a tiny negative number where a bound is the share itself
    down = sqrt(max(0.0, below_b**2 - twice * below_b * above_a + above_a**2))
    up = sqrt(max(0.0, above_b**2 - twice * above_b * below_a + below_a**2))
    return max(-1.0, difference - down), min(1.0, difference + up)


def _correlation(counts: PairedCounts) -> float:
    """Newcombe's corrected φ of the four counts; 0 where one of the two shares is 0 or 1."""
    hits_a, hits_b = counts.both + counts.only_a, counts.both + counts.only_b
    product = hits_a * (counts.n - hits_a) * hits_b * (counts.n - hits_b)
    if product == 0:
        return 0.0
    excess = counts.both * counts.neither - counts.only_a * counts.only_b
    corrected = float(excess) if excess < 0 else max(0.0, excess - counts.n / 2)
    return corrected / sqrt(product)


def mcnemar_p(counts: PairedCounts) -> float:
    """P-value (two-sided) of McNemar's exact test: of the trials in which a and b differ, are as many a's as b's?

    1 where they differ in none.

    Raises:
        InputError: SciPy is not installed.
    """
    differing = counts.only_a + counts.only_b
    if differing == 0:
        return 1.0
    try:
        from scipy.stats import binomtest
    except ImportError:
        raise InputError("a paired test needs SciPy: pip install 'petmjx[packers]'") from None
    return float(binomtest(counts.only_a, differing, 0.5).pvalue)


def holm(p_values: Sequence[float]) -> FloatArray:
    """P-values corrected for their number, so that the chance of any false alarm stays below the level.

    Source: Holm (1979), "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics
    6, 65–70: the smallest of m is multiplied by m, the next one by m − 1, …; none becomes smaller than one before it.
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return corrected
