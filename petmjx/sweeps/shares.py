"""Shares of worlds that stand, with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from petmjx.units import FloatArray
from petmjx.verdict import Verdict

DEFAULT_CONFIDENCE = 0.95

ALL_PLANS = "*"
"""``plan_id`` of summary rows over all plans together."""


def wilson_interval(
    successes: ArrayLike, n: ArrayLike, confidence: float = DEFAULT_CONFIDENCE
) -> tuple[FloatArray, FloatArray]:
    """Wilson's score interval of a share, element by element; (0, 1) where n is 0.

    Source: Wilson (1927), J. Am. Stat. Assoc. 22, 209-212. It is always inside [0, 1], and it has a width at shares of
    0 and 1 too, where the usual ± interval has none.

    Raises:
        ValueError: successes outside 0 … n, or a confidence outside (0, 1).
    """
    k, total = np.broadcast_arrays(np.asarray(successes, dtype=np.float64), np.asarray(n, dtype=np.float64))
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must be between 0 and 1, got {confidence}")
    if np.any(k < 0) or np.any(k > total):
        raise ValueError("successes must be between 0 and n")
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    known = np.maximum(total, 1.0)
    share = k / known
    centre = (share + z * z / (2 * known)) / (1 + z * z / known)
    half = z / (1 + z * z / known) * np.sqrt(share * (1 - share) / known + z * z / (4 * known * known))
    # At shares of 0 and 1 the bound is exactly that share; rounding must not move it.
    low = np.where((total == 0) | (k == 0), 0.0, centre - half)
    high = np.where((total == 0) | (k == total), 1.0, centre + half)
    return low, high


def by_plan_and_axis(worlds: pd.DataFrame, axes: Sequence[str], **columns: tuple[str, str]) -> pd.DataFrame:
    """Worlds in groups: over all plans (``plan_id`` "*") and for each plan; all of them (axis "") and by axis value.

    Args:
        columns: what is computed of each group, as pandas' ``agg`` takes it: name=(column, function).

    Returns:
        Columns plan_id, axis, value (text), and those asked for.
    """
    parts = []
    for scope in (worlds.assign(plan_id=ALL_PLANS), worlds):
        for axis in ("", *axes):
            keys = ["plan_id", axis] if axis else ["plan_id"]
            part = scope.groupby(keys, sort=True, observed=True).agg(**columns).reset_index()
            value = [_text(entry) for entry in part[axis]] if axis else ""
            part = part.assign(axis=axis, value=value)[["plan_id", "axis", "value", *columns]]
            parts.append(part.astype({"axis": object, "value": object}))
    return pd.concat(parts, ignore_index=True)


def share_standing(worlds: pd.DataFrame, axes: Sequence[str]) -> pd.DataFrame:
    """The share of worlds that stand, for every value of every axis, with its Wilson 95 % interval.

    Invalid worlds say nothing about the pallet: they are counted separately and are not in the share. Worlds without a
    value on an axis (the nominal one) do not count there.

    Args:
        worlds: rows with ``plan_id``, ``verdict`` and a column for each axis.
        axes: parameter columns; a row of the summary is about one value of one of them, over all the others.

    Returns:
        Columns plan_id, axis, value (text), n_worlds, n_standing, n_invalid, share, low, high; a row with
        axis "" sums over everything.
    """
    verdict = worlds["verdict"].astype(str)
    judged = worlds.assign(standing=verdict == str(Verdict.STABLE), invalid=verdict == str(Verdict.INVALID))
    counts = {"n_worlds": ("standing", "size"), "n_standing": ("standing", "sum"), "n_invalid": ("invalid", "sum")}
    summary = by_plan_and_axis(judged, axes, **counts).astype(dict.fromkeys(counts, "int64"))
    n_standing = summary["n_standing"].to_numpy()
    n_judged = summary["n_worlds"].to_numpy() - summary["n_invalid"].to_numpy()
    low, high = wilson_interval(n_standing, n_judged)
    with np.errstate(invalid="ignore"):
        share = n_standing / np.where(n_judged > 0, n_judged, np.nan)
    return summary.assign(share=share, low=low, high=high)


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
