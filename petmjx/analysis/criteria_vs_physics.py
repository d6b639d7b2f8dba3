"""Compares the answers of criteria with the verdicts of a simulation, and finds the threshold with which a criterion
agrees best with the simulation. A criterion accepts a plan if all boxes of the plan are stable.

docs/criteria.md defines precision, recall and Matthews' correlation coefficient (MCC; Matthews 1975, Biochimica et
Biophysica Acta 405, 442-451).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.analysis.criteria import Criterion
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict
from petmjx.results.share_statistics import DEFAULT_CONFIDENCE

N_BOOTSTRAP: Final = 4000
"""Number of bootstrap samples of the plans. With 4,000 samples, the bounds of an interval differ between two bootstraps
by about 1 % of the interval's width."""

CELLS: Final = ("accepted_stands", "accepted_falls", "refused_stands", "refused_falls")
"""The cells of the confusion matrix. The first part of a name is the answer of the criterion, the second part the
verdict of the simulation."""

SCORES: Final = ("precision", "recall", "mcc")

ARRIVES: Final = ("arrives_accepted", "arrives_refused")
"""Names of two columns for the run of a transport chain: the mean probability of arrival of the plans that a criterion
accepts, and of the plans that the criterion refuses."""


def judge(plans: pd.DataFrame, worlds: pd.DataFrame, criteria: Sequence[Criterion], seed: int = 0) -> pd.DataFrame:
    """Compare every criterion with a simulation.

    Args:
        plans: one row per plan, in the form of ``CriteriaResults.plans``.
        worlds: one row per plan of a run, with the columns ``plan_id``, ``verdict`` and ``culprit`` (the first box that
            fails). Plans whose verdict is invalid are left out.
        seed: seed of the bootstrap.

    Returns:
        One row per criterion: ``criterion``, ``n_plans``, the counts named in ``CELLS``, and the scores named in
        ``SCORES``. Each score has two more columns, ``_low`` and ``_high``, with the bounds of its 95 % bootstrap
        interval over plans. ``same_first_box`` is the number of plans that the criterion refuses, that fall in the
        simulation, and for which criterion and simulation name the same first box. If ``worlds`` has the column
        ``share`` (the share of simulations that reach the end of a transport chain), each row also has the columns
        ``ARRIVES``.
    """
    judged = with_physics(plans, worlds)
    stands = judged["stands"].to_numpy(dtype=bool)
    rows = []
    for criterion in criteria:
        accepted = judged[criterion.name].to_numpy(dtype=bool)
        first = judged[f"{criterion.name}_first"]
        names_same_box = (first == judged["culprit"]).fillna(False).to_numpy(dtype=bool) & ~accepted & ~stands
        row = {"criterion": criterion.name, "n_plans": len(judged)} | score_columns(accepted, stands, seed)
        row["same_first_box"] = int(names_same_box.sum())
        if "share" in judged:
            plans_by_answer = zip(ARRIVES, (accepted, ~accepted), strict=True)
            row |= {name: judged["share"][chosen].mean() for name, chosen in plans_by_answer}
        rows.append(row)
    return pd.DataFrame(rows)


def with_physics(plans: pd.DataFrame, worlds: pd.DataFrame) -> pd.DataFrame:
    """The plans for which the run has a valid verdict, with the columns ``stands``, ``culprit``, ``reason`` and
    ``margin`` from the simulation. For the run of a transport chain, there is also the column ``share``: the share of
    simulations in which the plan reaches the end of the chain."""
    judged = worlds[worlds["verdict"] != Verdict.INVALID.value]
    of_chain = ["share"] if "share" in judged else []
    physics = judged[["plan_id", "culprit", "reason", "margin", *of_chain]].assign(
        stands=judged["verdict"] == Verdict.STABLE.value
    )
    return plans.merge(physics, on="plan_id")


def score_columns(accepted: NDArray[np.bool_], stands: NDArray[np.bool_], seed: int) -> dict[str, float]:
    """The counts of the confusion matrix, and the scores with their intervals.

    The bootstrap draws plans at random, with replacement. The scores depend only on the four counts of a bootstrap
    sample, so the counts are drawn directly from a multinomial distribution.
    """
    cells = confusion(accepted, stands)
    row: dict[str, float] = {name: int(count) for name, count in zip(CELLS, cells, strict=True)}
    total = int(cells.sum())
    if not total:
        return row | {f"{name}{end}": np.nan for name in SCORES for end in ("", "_low", "_high")}
    drawn = np.random.default_rng(seed).multinomial(total, cells / total, size=N_BOOTSTRAP)
    tail = (1 - DEFAULT_CONFIDENCE) / 2
    for name, value, values in zip(SCORES, scores(cells), scores(drawn), strict=True):
        finite = values[~np.isnan(values)]
        low, high = np.quantile(finite, [tail, 1 - tail]) if len(finite) else (np.nan, np.nan)
        row |= {name: float(value), f"{name}_low": float(low), f"{name}_high": float(high)}
    return row


def confusion(accepted: NDArray[np.bool_], stands: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(4,) numbers of plans in the four cells of the confusion matrix, in the order of ``CELLS``."""
    return np.bincount(2 * ~accepted + ~stands, minlength=len(CELLS))


def scores(cells: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Precision, recall and MCC, three arrays (…), from the counts of confusion matrices (…, 4).

    Precision is NaN if no plan is accepted, and recall is NaN if no plan stands. MCC is 0 if the criterion gives the
    same answer for all plans, because such a criterion is useless. MCC is NaN if the simulation gives the same verdict
    for all plans, because MCC is then undefined.
    """
    hit, false, miss, right = np.moveaxis(np.asarray(cells, dtype=np.float64), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        precision, recall = hit / (hit + false), hit / (hit + miss)
        # two square roots are multiplied, because the product of all four sums would not be exact in float64
        below = np.sqrt((hit + false) * (hit + miss)) * np.sqrt((right + false) * (right + miss))
        mcc = np.where(below > 0, (hit * right - false * miss) / np.where(below > 0, below, 1.0), 0.0)
    mcc = np.where((hit + miss == 0) | (false + right == 0), np.nan, mcc)
    return precision, recall, mcc


def best_thresholds(
    plans: pd.DataFrame, worlds: pd.DataFrame, criteria: Sequence[Criterion], seed: int = 0
) -> pd.DataFrame:
    """For each criterion that has a threshold, the threshold that agrees best with the simulation. Each threshold is
    fitted on one half of the plans and tested on the other half.

    The half to which a plan belongs depends only on the plan's id and the seed.

    Returns:
        One row per criterion: ``criterion``, ``number``, ``unit``, ``threshold`` (a lower limit) and ``published`` (the
        published threshold). ``n_found_on`` is the number of plans in the half with which the threshold is fitted, and
        ``mcc_found_on`` is the MCC in this half. The row also has the columns of ``judge`` and ``mcc_published`` (the
        MCC of the published threshold), computed on the half on which the threshold is tested.
    """
    joined_plans = with_physics(plans, worlds)
    stands = joined_plans["stands"].to_numpy(dtype=bool)
    first_half = in_first_half(joined_plans["plan_id"].tolist(), seed)
    rows = []
    for criterion in criteria:
        if not criterion.number:
            continue
        published = criterion.threshold
        number = joined_plans[f"{criterion.name}_slack"].to_numpy(dtype=np.float64) + published
        threshold, mcc = best_threshold(number[first_half], stands[first_half])
        # without a threshold (NaN), no plan of the second half is judged
        judged = ~first_half if np.isfinite(threshold) else np.zeros_like(first_half)
        as_published = confusion(joined_plans[criterion.name].to_numpy(dtype=bool)[~first_half], stands[~first_half])
        row: dict[str, object] = {"criterion": criterion.name, "number": criterion.number, "unit": criterion.unit}
        row |= {"threshold": threshold, "published": published}
        row |= {"n_found_on": int(first_half.sum()), "mcc_found_on": mcc, "n_plans": int((~first_half).sum())}
        row |= score_columns(number[judged] >= threshold, stands[judged], seed)
        rows.append(row | {"mcc_published": float(scores(as_published)[2])})
    return pd.DataFrame(rows)


def in_first_half(plan_ids: Sequence[str], seed: int) -> NDArray[np.bool_]:
    """(n,) whether each plan belongs to the first half. A hash of a plan's id and the seed acts like a fair coin, and
    decides to which half the plan belongs."""
    key = seed.to_bytes(8, "little")
    coins = [hashlib.blake2b(name.encode(), digest_size=1, key=key).digest()[0] & 1 for name in plan_ids]
    return np.array(coins, dtype=bool)


def best_threshold(number: FloatArray, stands: NDArray[np.bool_]) -> tuple[float, float]:
    """The threshold t for which the rule ``number >= t`` has the largest MCC, and this MCC. The rule never accepts a
    number that is NaN.

    The threshold lies halfway between two neighbouring numbers. If several thresholds are equally good, the middle one
    is used. The threshold is NaN if no threshold has MCC > 0: if all numbers are equal, all plans stand, all plans
    fall, or plans with larger numbers fall.
    """
    has_number = ~np.isnan(number)
    values, owner = np.unique(number[has_number], return_inverse=True)
    if len(values) < 2:
        return float("nan"), 0.0
    standing = np.bincount(owner, weights=stands[has_number], minlength=len(values))
    falling = np.bincount(owner, minlength=len(values)) - standing
    # each threshold that is tried lies between two values, and accepts all values above the threshold
    hit, false = (counts[::-1].cumsum()[::-1][1:] for counts in (standing, falling))
    n_standing = int(stands.sum())
    cells = np.stack([hit, false, n_standing - hit, len(stands) - n_standing - false], axis=-1)
    mcc = scores(cells.astype(np.int64))[2]
    if not mcc.max() > 0:  # "not >" is used instead of "<=", so that the function also returns here if the MCC is NaN
        return float("nan"), 0.0
    best = np.flatnonzero(mcc >= mcc.max() - 1e-12)
    cut = int(best[len(best) // 2])
    return float((values[cut] + values[cut + 1]) / 2), float(mcc[cut])
