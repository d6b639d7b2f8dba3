"""Scores with confidence: the share of worlds in which a pallet stands, given the errors of a robot and of its cartons
(docs/confidence.md).

A score with confidence is a sweep. Each axis (varied quantity) of this sweep is one random error, such as a normal
distribution of the errors of boxes' places. With the option ``exact_too``, the sweep also has the axis ``placing``:
whether boxes are carried to their places or appear there. Each plan is simulated once without errors (the nominal
world) and many times with random errors (the replicates). The summary has other columns than the summary of other
sweeps.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.engines.metrics import DIMENSIONLESS
from petmjx.engines.verdict import Flag, Verdict
from petmjx.options.placing import Way
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import summary_table
from petmjx.results.share_statistics import ONE_PLAN, PairedCounts, holm, mcnemar_p, paired_outcomes, share_standing
from petmjx.results.table_parts import Parts
from petmjx.results.world_ranks import frame_in_order
from petmjx.runs.ready_sweeps import find_sweep
from petmjx.runs.sweep_axes import Axis
from petmjx.runs.sweep_file import Sweep, load_sweep
from petmjx.world.error_distributions import Distribution

READY_MADE: Final = "confidence"
"""Name of the sweep file with the errors of a common robot and of corrugated cartons."""

EVEN: Final = 0.5

SIGNIFICANCE: Final = 0.05
"""Accepted probability of at least one false alarm in a run. A false alarm is a plan whose stability seems to depend on
whether boxes are carried to their places or appear there, although in truth the stability does not depend on this."""

PLACING: Final = "placing"
"""Name of the axis, and of the column of ``worlds``, that states how boxes with errors were placed."""

_DESCRIPTIONS: Final = {
    "plan_id": "id of the packing plan",
    "verdict": "verdict of the nominal world, which has no errors",
    "reason": "reason why the nominal world, which has no errors, is not stable; empty if it is stable",
    "margin": "margin of the nominal world, which has no errors; null if this world is invalid",
    "n_worlds": "number of worlds with errors",
    "n_standing": "number of stable worlds with errors",
    "n_not_placed": "number of unstable worlds with errors in which the hand found no room for a box before any box "
    "failed",
    "n_fell": "number of the unstable worlds with errors that the column `n_not_placed` does not count",
    "n_invalid": "number of worlds with errors that have no verdict; the column `share` does not count them",
    "share": "share of stable worlds among the worlds with errors that have a verdict; null if no world has a verdict",
    "low": "lower end of the Wilson 95 % interval of `share`",
    "high": "upper end of the Wilson 95 % interval of `share`",
    "coin_toss": "whether the interval from `low` to `high` contains one half, so that the worlds do not show whether "
    "the pallet stands more often than it falls",
}

_OF_BOTH: Final = {
    "n_standing_exact": "number of stable worlds with errors in which boxes appear at their places",
    "share_exact": "share of stable worlds among the worlds with errors that have a verdict and in which boxes appear "
    "at their places; null if no such world has a verdict",
    "only_carried": "number of sets of random errors with which the pallet stands only if boxes are carried",
    "only_exact": "number of sets of random errors with which the pallet stands only if boxes appear at their places",
    "p_value": "p-value of McNemar's exact two-sided test on `only_carried` and `only_exact`, corrected for the number "
    "of plans by Holm's method",
    "placing_matters": f"whether `p_value` is below {SIGNIFICANCE:g}: `share` and `share_exact` differ beyond chance",
}
"""Additional columns of a run in which each world with errors was simulated twice: once with boxes that are carried to
their places, and once with boxes that appear at their places."""

_TEXTS: Final = frozenset({"plan_id", "verdict", "reason", "coin_toss", "placing_matters"})
"""Columns whose values are texts, not numbers."""


def confidence_sweep(
    n_worlds: int, errors: Path | None, simulation: Mapping[str, Any], *, exact_too: bool = False
) -> Sweep:
    """The sweep with which a score with confidence is made.

    Args:
        n_worlds: number of worlds with errors for each plan, in addition to the nominal world (without errors).
        errors: a sweep file of errors, or the name of a ready-made one. If ``errors`` is None, ``READY_MADE`` is used.
        simulation: fields of ``Simulation`` that replace the fields of the file.
        exact_too: whether to simulate each world with errors twice (``petmjx.options.confidence.Confidence``).

    Raises:
        InputError: the file is unusable, an axis is not a single error, or ``exact_too`` is set although boxes are not
            carried.
    """
    error_sweep = load_sweep(find_sweep(errors or READY_MADE), plans_given=True, simulation=simulation)
    wrong = _error_sweep_fault(error_sweep)
    if wrong:
        raise InputError(f"{error_sweep.file}: {wrong}")
    axes = error_sweep.axes
    if exact_too:
        carried = error_sweep.simulation.placing.for_errors
        if not (error_sweep.simulation.may_carry and carried.carries):
            raise InputError(
                "exact_too compares carried boxes with boxes that are placed exactly, so it needs placing='auto', "
                "'hand' or 'tines'"
            )
        axes = {**axes, PLACING: Axis(PLACING, (carried.name.value, Way.EXACT.value))}
    return error_sweep.model_copy(update={"nominal": True, "replicates": n_worlds, "axes": axes})


def _error_sweep_fault(sweep: Sweep) -> str:
    """The message about the first entry that a sweep file with a robot's errors may not have; "" if all its entries are
    allowed."""
    if sweep.search is not None:
        return "[search] contradicts confidence, which computes a share of worlds: use 'petmjx sweep'"
    if sweep.legs:
        return f"legs contradict {option('--errors')}, which is about pallets at rest: use 'petmjx score' with --chain"
    if sweep.has_drives:
        return "axes.profile contradicts confidence, which is about pallets at rest: use 'petmjx sweep'"
    if sweep.sample is not None:
        return 'mode = "sample" contradicts confidence, in which all worlds have errors from the same distributions'
    for name, axis in sweep.axes.items():
        if not isinstance(axis.values[0], Distribution):
            return f"axes.{name} contradicts confidence: its value is not random, so it is no error"
        if len(axis.values) > 1:
            return f"axes.{name}: confidence needs one error, got {len(axis.values)}"
    if not any(axis.random for axis in sweep.axes.values()):
        return "no axis is random, so every world would be the same"
    return ""


def summarise_confidence(parts: Parts, *, both: bool = False) -> pd.DataFrame:
    """One row per plan, in the order of the input: the verdict without errors, and the share of worlds with errors in
    which the pallet stands.

    docs/confidence.md explains the columns.

    Args:
        parts: files of the run's tables, to which nothing will be added.
        both: whether each world with errors was simulated twice (``exact_too``).
    """
    columns = ["plan_id", "variant", "verdict", "reason", "margin", "flags"]
    columns += [PLACING, "replicate"] if both else []
    worlds = frame_in_order(parts, "worlds", columns)
    nominal = worlds[worlds["variant"] == 0]
    drawn = worlds[worlds["variant"] > 0]
    exact = drawn[PLACING] == Way.EXACT.value if both else pd.Series(False, index=drawn.index)
    summary = nominal.drop(columns=[PLACING, "replicate"] if both else []).merge(
        _shares(drawn[~exact]).merge(_failures(drawn[~exact]), on="plan_id"), on="plan_id", how="left"
    )
    summary["coin_toss"] = (summary["low"] <= EVEN) & (summary["high"] >= EVEN)
    if not both:
        return summary[[*_DESCRIPTIONS]]
    other = _shares(drawn[exact]).rename(columns={"n_standing": "n_standing_exact", "share": "share_exact"})
    summary = summary.merge(other[["plan_id", "n_standing_exact", "share_exact"]], on="plan_id", how="left")
    summary = summary.merge(_paired_draws(drawn[~exact], drawn[exact]), on="plan_id", how="left")
    return summary[[*_DESCRIPTIONS, *_OF_BOTH]]


def _shares(drawn: pd.DataFrame) -> pd.DataFrame:
    """For each plan, the share of worlds with errors in which the pallet stands, and the share's interval."""
    shares = share_standing(drawn.assign(draw=drawn["variant"]), ())
    return shares[shares["scope"] == ONE_PLAN]


def _failures(drawn: pd.DataFrame) -> pd.DataFrame:
    """For each plan, the number of unstable worlds in which a box could not be placed, and the number of the other
    unstable worlds, in which boxes fell."""
    fails = drawn["verdict"].astype(str) == Verdict.UNSTABLE.value
    missed = (drawn["flags"].to_numpy(np.int64) & int(Flag.NOT_PLACED)) != 0
    counted = pd.DataFrame({"plan_id": drawn["plan_id"], "n_not_placed": fails & missed, "n_fell": fails & ~missed})
    return counted.groupby("plan_id", observed=True).sum().reset_index()


def _paired_draws(carried: pd.DataFrame, exact: pd.DataFrame) -> pd.DataFrame:
    """Compare, for each plan, carried boxes with boxes that appear at their places. For each of the two cases, the
    function counts the sets of random errors with which the pallet stands only in this case. Then the function tests
    whether the two counts differ. If a set of errors gives an invalid world in one of the two cases, the set is not
    counted."""
    pairs = carried.merge(exact, on=["plan_id", "replicate"], suffixes=("_carried", "_exact"))
    one, other = (pairs[f"verdict_{way}"].astype(str) for way in ("carried", "exact"))
    stands, stands_exact = one == Verdict.STABLE.value, other == Verdict.STABLE.value
    judged = (one != Verdict.INVALID.value) & (other != Verdict.INVALID.value)
    outcomes = paired_outcomes(stands, stands_exact)
    counted = pd.DataFrame({"plan_id": pairs["plan_id"], **{name: judged & row for name, row in outcomes.items()}})
    pair_counts = counted.groupby("plan_id", observed=True).sum().reset_index()
    trials = pair_counts[[*outcomes]].astype(int).itertuples(index=False, name=None)
    pair_counts["p_value"] = holm([mcnemar_p(PairedCounts(*counts)) for counts in trials])
    pair_counts["placing_matters"] = pair_counts["p_value"] < SIGNIFICANCE
    columns = {"only_a": "only_carried", "only_b": "only_exact"}
    return pair_counts.drop(columns=["both", "neither"]).rename(columns=columns)


def write_confidence(writer: RunWriter, axes: Collection[str] = ()) -> None:
    """Write the table ``summary`` of a run with confidence. All other tables of the run must be complete.

    Args:
        axes: names of the axes of the sweep. With ``PLACING``, each world with errors was simulated twice.

    Raises:
        PetmjxError: the file cannot be written.
    """
    summary = summarise_confidence(writer.parts, both=PLACING in axes)
    units = {name: DIMENSIONLESS for name in summary if name not in _TEXTS}
    writer.write_summary(summary_table(summary, units, _DESCRIPTIONS | _OF_BOTH))


def contradiction_mask(summary: pd.DataFrame) -> pd.Series[bool]:
    """For each plan, whether the worlds with errors contradict the verdict without errors: whether, beyond chance, more
    than half of these worlds have the opposite verdict."""
    stands = summary["verdict"] == Verdict.STABLE.value
    falls = summary["verdict"] == Verdict.UNSTABLE.value
    return (stands & (summary["high"] < EVEN)) | (falls & (summary["low"] > EVEN))
