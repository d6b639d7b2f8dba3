"""Shares of worlds that stand, with confidence intervals.

For two shares from the same trials, this module also computes the interval of their difference, an exact test, and a
correction for many tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict

DEFAULT_CONFIDENCE = 0.95

ALL_PLANS = "all"
ONE_PLAN = "plan"
"""Values of the column ``scope`` of the summary. ``ALL_PLANS`` is for rows about all plans together, whose ``plan_id``
is null; ``ONE_PLAN`` is for rows about one plan."""

KEYS = ("scope", "plan_id", "axis", "value")
"""Columns of the table ``summary`` that state which worlds a row is about."""


def wilson_interval(
    successes: ArrayLike, n: ArrayLike, confidence: float = DEFAULT_CONFIDENCE
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of Wilson's score intervals of the shares successes / n, for each element of the arrays.
    If n is 0, the bounds are 0 and 1.

    Source: Wilson (1927), J. Am. Stat. Assoc. 22, 209-212. The interval always lies inside [0, 1]. For shares of 0 and
    1, the interval has a width above 0, whereas the usual ± interval has the width 0.

    Raises:
        ValueError: successes are not in 0 … n, or the confidence is not in (0, 1).
    """
    k, total = np.broadcast_arrays(np.asarray(successes, dtype=np.float64), np.asarray(n, dtype=np.float64))
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must be between 0 and 1, got {confidence}")
    if np.any(k < 0) or np.any(k > total):
        raise ValueError("successes must be between 0 and n")
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    n_or_one = np.maximum(total, 1.0)
    share = k / n_or_one
    centre = (share + z * z / (2 * n_or_one)) / (1 + z * z / n_or_one)
    half = z / (1 + z * z / n_or_one) * np.sqrt(share * (1 - share) / n_or_one + z * z / (4 * n_or_one * n_or_one))
    # for a share of 0 or 1, one bound must be exactly the share; rounding could change it
    low = np.where((total == 0) | (k == 0), 0.0, centre - half)
    high = np.where((total == 0) | (k == total), 1.0, centre + half)
    return low, high


def by_plan_and_axis(worlds: pd.DataFrame, axes: Sequence[str], **columns: tuple[str, str]) -> pd.DataFrame:
    """Aggregate worlds in groups. Groups are made twice: from the worlds of all plans together, and from the worlds of
    each plan. In both cases, there is one group with all worlds (axis ""), and one group for each value of each axis.

    Args:
        columns: the values to compute for each group, as keyword arguments of pandas' ``agg``: name=(column, function).

    Returns:
        Data frame with the columns ``KEYS`` and the aggregates. Rows about all plans come first. The column ``scope``
        distinguishes rows about all plans from rows about one plan.
    """
    parts = []
    for scope, rows in ((ALL_PLANS, worlds.assign(plan_id="")), (ONE_PLAN, worlds)):
        for axis in ("", *axes):
            keys = ["plan_id", axis] if axis else ["plan_id"]
            groups = rows.groupby(keys, sort=True, observed=True)
            # for small tables, ``groups.agg(**columns)`` takes three times as long
            aggregates = {name: groups[column].agg(kind) for name, (column, kind) in columns.items()}
            part = pd.DataFrame(aggregates).reset_index()
            value = [_text(entry) for entry in part[axis]] if axis else ""
            parts.append(part.assign(scope=scope, axis=axis, value=value)[[*KEYS, *columns]])
    summary = pd.concat(parts, ignore_index=True).astype(dict.fromkeys(KEYS, object))
    summary.loc[summary["scope"] == ALL_PLANS, "plan_id"] = None
    return summary


def share_standing(worlds: pd.DataFrame, axes: Sequence[str]) -> pd.DataFrame:
    """The share of worlds that stand, for every value of every axis. If the worlds have random draws, the share has a
    Wilson 95 % interval.

    Invalid worlds say nothing about the pallet: they are counted separately and are not part of the share. The nominal
    world, in which the plan is unchanged, has no value on any axis, so it is counted only in the row for all worlds.

    A world without random values always has the same outcome, so a row with such a world has no interval. Worlds with
    the same random numbers (a draw) are not independent of each other, so the number of trials is the number of draws.
    An interval for this number of trials is wide enough, because the mean over the worlds of a draw varies no more than
    the outcome of a single world.

    Args:
        worlds: data frame with the columns ``plan_id`` and ``verdict``, and a column for each axis. The data frame may
            have the column ``draw``, which has the same value for all worlds with the same random numbers, and null for
            worlds without random numbers.
        axes: names of the columns that have the values of the axes. A row of the result is about all worlds that have
            one value on one axis, whatever their values on the other axes.

    Returns:
        Data frame with the columns ``KEYS``, ``n_worlds``, ``n_standing``, ``n_invalid``, ``share``, ``n_draws`` (0 if
        the row has no interval), ``low`` and ``high``. A row with axis "" is about all worlds.
    """
    verdict = worlds["verdict"].astype(str)
    invalid = verdict == str(Verdict.INVALID)
    draw = worlds["draw"] if "draw" in worlds else pd.Series(np.nan, index=worlds.index)
    judged = worlds.assign(
        standing=verdict == str(Verdict.STABLE), invalid=invalid, drawn=draw.notna(), draw=draw.where(~invalid)
    )
    counts = {"n_worlds": ("standing", "size"), "n_standing": ("standing", "sum"), "n_invalid": ("invalid", "sum")}
    counts |= {"n_draws": ("draw", "nunique"), "drawn": ("drawn", "all")}
    summary = by_plan_and_axis(judged, axes, **counts)
    n_worlds, n_standing, n_invalid, n_draws = (summary[name].to_numpy(np.int64) for name in [*counts][:4])
    n_draws = np.where(summary["drawn"].astype(bool), n_draws, 0)
    n_judged = n_worlds - n_invalid
    n_or_one = np.where(n_judged > 0, n_judged, 1)
    bounds = wilson_interval(n_standing * n_draws / n_or_one, n_draws)
    low, high = (np.where(n_draws > 0, bound, np.nan) for bound in bounds)
    share = np.where(n_judged > 0, n_standing / n_or_one, np.nan)
    world_counts = {"n_worlds": n_worlds, "n_standing": n_standing, "n_invalid": n_invalid}
    return summary[[*KEYS]].assign(**world_counts, share=share, n_draws=n_draws, low=low, high=high)


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class PairedCounts:
    """Counts of trials by their four possible outcomes. In each trial, the two alternatives ``a`` and ``b`` were both
    tried.

    Attributes:
        both, only_a, only_b, neither: numbers of trials that succeeded with both alternatives, only with ``a``, only
            with ``b``, or with neither.
    """

    both: int
    only_a: int
    only_b: int
    neither: int

    @classmethod
    def of(cls, a: ArrayLike, b: ArrayLike) -> Self:
        """Count trials. The (n,) masks ``a`` and ``b`` state in which trials each alternative succeeded."""
        return cls(**{name: int(trials.sum()) for name, trials in paired_outcomes(a, b).items()})

    @property
    def n(self) -> int:
        """Number of trials."""
        return self.both + self.only_a + self.only_b + self.neither

    @property
    def difference(self) -> float:
        """Share of the trials that succeed with ``b`` minus the share that succeed with ``a``; NaN if there are no
        trials."""
        return (self.only_b - self.only_a) / self.n if self.n else float("nan")


def paired_outcomes(a: ArrayLike, b: ArrayLike) -> dict[str, NDArray[np.bool_]]:
    """For each field of ``PairedCounts``, the (n,) mask of the trials with this outcome. The (n,) masks ``a`` and ``b``
    state in which trials each alternative succeeded."""
    in_a, in_b = np.asarray(a, bool), np.asarray(b, bool)
    return {"both": in_a & in_b, "only_a": in_a & ~in_b, "only_b": ~in_a & in_b, "neither": ~in_a & ~in_b}


def newcombe_interval(counts: PairedCounts, confidence: float = DEFAULT_CONFIDENCE) -> tuple[float, float]:
    """Newcombe's square-and-add confidence interval of the difference (share of ``b`` − share of ``a``); (−1, 1) if
    there are no trials.

    Source: Newcombe (1998), "Improved confidence intervals for the difference between binomial proportions based on
    paired data", Statistics in Medicine 17, 2635–2650, method 10. The method combines the Wilson intervals of both
    shares with their correlation. A positive correlation is reduced by a continuity correction.
    """
    n = counts.n
    if n == 0:
        return -1.0, 1.0
    hits = np.array([counts.both + counts.only_b, counts.both + counts.only_a])
    low, high = wilson_interval(hits, n, confidence)
    (below_b, below_a), (above_b, above_a) = (hits / n - low).tolist(), (high - hits / n).tolist()
    twice = 2 * _correlation(counts)
    difference = counts.difference
    # if a bound equals the share itself, rounding may leave a tiny negative number
    down = sqrt(max(0.0, below_b**2 - twice * below_b * above_a + above_a**2))
    up = sqrt(max(0.0, above_b**2 - twice * above_b * below_a + below_a**2))
    return max(-1.0, difference - down), min(1.0, difference + up)


def _correlation(counts: PairedCounts) -> float:
    """The correlation φ of the four counts, with Newcombe's continuity correction; 0 if one of the two shares is 0 or
    1."""
    hits_a, hits_b = counts.both + counts.only_a, counts.both + counts.only_b
    product = hits_a * (counts.n - hits_a) * hits_b * (counts.n - hits_b)
    if product == 0:
        return 0.0
    excess = counts.both * counts.neither - counts.only_a * counts.only_b
    corrected = float(excess) if excess < 0 else max(0.0, excess - counts.n / 2)
    return corrected / sqrt(product)


def mcnemar_p(counts: PairedCounts) -> float:
    """Two-sided p-value of McNemar's exact test. The null hypothesis is that ``a`` and ``b`` succeed equally often in
    the trials in which only one of them succeeds. If there are no such trials, the p-value is 1.

    Raises:
        InputError: SciPy, which the test needs, is not installed.
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
    """P-values corrected for the number of tests. If corrected p-values are compared with a level such as 0.05, the
    probability of at least one false alarm stays below the level.

    Source: Holm (1979), "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics
    6, 65–70. The smallest of m p-values is multiplied by m, the next one by m − 1, and so on. A corrected value is
    never below the corrected value of a smaller p-value, and never above 1.
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)))
    return corrected
