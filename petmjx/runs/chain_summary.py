"""The summary of a chain: how likely a pallet is to arrive, the weakest leg, and what each remedy gains.

A chain is the journey of a pallet in parts, called legs.

docs/chains.md explains the columns to users.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from petmjx.engines.metrics import DIMENSIONLESS
from petmjx.engines.verdict import Verdict
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import summary_table
from petmjx.results.share_statistics import (
    ALL_PLANS,
    ONE_PLAN,
    PairedCounts,
    newcombe_interval,
    paired_outcomes,
    wilson_interval,
)
from petmjx.results.world_ranks import frame_in_order
from petmjx.runs.chain_legs import AS_IS, PLACING
from petmjx.runs.sweep_worlds import SweepPlan

WHOLE_WAY: Final = ""
"""Value of the column ``leg`` in rows about the whole journey, from the placement of boxes to the end of the last
leg."""

OF_WORLDS: Final = ("plan_id", "variant", "verdict", "culprit", "leg", "remedy")
"""The columns of the table ``worlds`` from which the summary is computed."""

_KEYS: Final = ["scope", "plan_id", "remedy", "leg"]
_COUNTS: Final = ["n_worlds", "n_standing", "n_invalid"]

_DESCRIPTIONS: Final = {
    "scope": "`all`: the row is about all plans together; `plan`: the row is about one plan",
    "plan_id": "id of the packing plan; null if the row is about all plans",
    "remedy": "name of the remedy (a change of one leg of the chain); empty: the row is about the unchanged chain",
    "leg": "name of the leg of the chain; empty: the row is about the whole journey",
    "n_worlds": "number of worlds that reached the leg; in rows about the whole journey: number of all worlds",
    "n_standing": "number of worlds that stand after the leg; in rows about the whole journey: number of worlds that "
    "arrive",
    "n_invalid": "number of worlds without a verdict, which the column `share` does not count",
    "share": "n_standing / (n_worlds - n_invalid); null if no world has a verdict",
    "low": "lower end of the Wilson 95 % interval of `share`; null if nothing is drawn at random",
    "high": "upper end of the Wilson 95 % interval of `share`; null if nothing is drawn at random",
    "weakest_leg": "in rows about the whole journey: leg with the most failures; empty if no world failed",
    "box": "number of the box that most often failed first in the leg `weakest_leg`; null if the row is about all "
    "plans",
    "only_with": "in rows about the whole journey with a remedy: number of worlds that arrive only with the remedy; "
    "each world is simulated with and without the remedy, with the same random numbers",
    "only_without": "in rows about the whole journey with a remedy: number of worlds that arrive only without the "
    "remedy; each world is simulated with and without the remedy, with the same random numbers",
    "gain": "share of worlds that arrive with the remedy, minus the share that arrive without it; only worlds that "
    "have a verdict both with and without the remedy count",
    "gain_low": "lower end of the 95 % interval of `gain` (Newcombe's interval for paired shares); null if nothing is "
    "drawn at random",
    "gain_high": "upper end of the 95 % interval of `gain` (Newcombe's interval for paired shares); null if nothing is "
    "drawn at random",
}

_TEXTS: Final = frozenset({"scope", "plan_id", "remedy", "leg", "weakest_leg"})


@dataclass(frozen=True)
class ChainColumns:
    """The properties of a chain that its summary needs. ``run.json`` stores this record, so that shards of a run
    can be merged.

    Attributes:
        legs: names of the legs that shake the pallet or open walls, in order.
        remedies: names of the remedies (changes of a leg that are tried), in order.
        random: whether the worlds of a plan differ by random numbers.
    """

    legs: Sequence[str]
    remedies: Sequence[str]
    random: bool

    @classmethod
    def of(cls, plan: SweepPlan) -> ChainColumns:
        """The record of the chain that a sweep simulates."""
        first, *remedies = plan.ways
        return cls([leg.name for leg in plan.ways[first]], remedies, bool(plan.draws()))


def summarise_chain(worlds: pd.DataFrame, chain: ChainColumns) -> pd.DataFrame:
    """The summary of a chain. Some rows are about all plans together, the others about one plan. For all plans and for
    each plan, there is a row for the whole journey and a row for each leg. The table has each of these rows for the
    chain without remedies, and for the chain with each remedy (a change of one leg).

    The worlds (simulations) of a plan have independent random numbers, so each share has a Wilson interval. To compute
    the gain from a remedy, each world with the remedy is compared with the world that has the same random numbers but
    no remedy.

    Args:
        worlds: the columns ``OF_WORLDS`` of all worlds of the run, in the order of the run.
    """
    ways, legs = [AS_IS, *chain.remedies], [WHOLE_WAY, PLACING, *chain.legs]
    worlds = worlds[worlds["variant"] > 0]
    worlds = worlds.assign(verdict=worlds["verdict"].astype(str), draw=(worlds["variant"] - 1) // len(ways))
    parts = pd.concat(
        [worlds.assign(scope=ALL_PLANS, plan_id="", pair=worlds["plan_id"]), worlds.assign(scope=ONE_PLAN, pair="")],
        ignore_index=True,
    )
    for name, order in (("plan_id", ["", *worlds["plan_id"].unique()]), ("remedy", ways), ("leg", legs)):
        parts[name] = pd.Categorical(parts[name], categories=order)
    summary = _leg_counts(parts, legs)
    judged = (summary["n_worlds"] - summary["n_invalid"]).to_numpy()
    drawn = (judged > 0) & chain.random
    low, high = wilson_interval(summary["n_standing"], judged)
    summary["share"] = np.where(judged > 0, summary["n_standing"] / np.maximum(judged, 1), np.nan)
    summary["low"], summary["high"] = np.where(drawn, low, np.nan), np.where(drawn, high, np.nan)
    summary = summary.merge(_weakest_legs(summary, parts), on=_KEYS, how="left")
    summary = summary.merge(_gains(parts, random=chain.random), on=_KEYS, how="left")
    for name in ("plan_id", "remedy", "leg"):
        summary[name] = summary[name].astype(object)
    summary.loc[summary["scope"] == ALL_PLANS, "plan_id"] = None
    is_whole_way = summary["leg"] == WHOLE_WAY
    weakest = summary["weakest_leg"].astype(object)
    summary["weakest_leg"] = weakest.where(weakest.notna(), "").where(is_whole_way, None)
    for name in ("box", "only_with", "only_without"):
        summary[name] = summary[name].astype("Int32")
    return summary[[*_DESCRIPTIONS]]


def _leg_counts(worlds: pd.DataFrame, legs: Sequence[str]) -> pd.DataFrame:
    """The rows of the summary, with the columns ``_KEYS`` and ``_COUNTS``: how many worlds reached each leg, and how
    many of these worlds stand, or are invalid, after the leg."""
    invalid = worlds["verdict"] == Verdict.INVALID.value
    arrives = worlds["leg"] == WHOLE_WAY
    end = worlds["leg"].cat.codes.where(~arrives, len(legs))
    parts = []
    for number, leg in enumerate(legs):
        reached = pd.Series(True, index=worlds.index) if leg == WHOLE_WAY else end >= number
        counted = {
            "n_worlds": reached,
            "n_standing": arrives if leg == WHOLE_WAY else end > number,
            "n_invalid": invalid if leg == WHOLE_WAY else invalid & (end == number),
        }
        part = worlds[["scope", "plan_id", "remedy"]].assign(leg=pd.Categorical([leg] * len(worlds), legs), **counted)
        parts.append(part)
    by_leg = pd.concat(parts, ignore_index=True).groupby(_KEYS, sort=True, observed=True)[_COUNTS]
    return by_leg.sum().astype("int64").reset_index()


def _weakest_legs(summary: pd.DataFrame, worlds: pd.DataFrame) -> pd.DataFrame:
    """For each row about the whole journey, the leg with the most failures, and the box that failed most often in this
    leg. In a tie, the first leg or box is taken."""
    way = _KEYS[:3]
    failed = summary.assign(n=summary["n_worlds"] - summary["n_standing"] - summary["n_invalid"])
    failed = failed[(failed["leg"] != WHOLE_WAY) & (failed["n"] > 0)]
    weakest = failed.sort_values("n", ascending=False, kind="stable").drop_duplicates(way)
    falls = worlds[(worlds["verdict"] == Verdict.UNSTABLE.value) & (worlds["scope"] == ONE_PLAN)]
    boxes = falls.groupby([*_KEYS, "culprit"], observed=True).size().rename("n").reset_index()
    boxes = boxes.sort_values("n", ascending=False, kind="stable").drop_duplicates(_KEYS)
    weakest = weakest[_KEYS].merge(boxes[[*_KEYS, "culprit"]], on=_KEYS, how="left")
    weakest = weakest.rename(columns={"leg": "weakest_leg", "culprit": "box"})
    return weakest.assign(leg=WHOLE_WAY)


def _gains(worlds: pd.DataFrame, *, random: bool) -> pd.DataFrame:
    """The columns about the gain from a remedy, for those rows of the summary that are about the whole journey."""
    judged = worlds[worlds["verdict"] != Verdict.INVALID.value]
    pairs = ["scope", "plan_id", "pair", "draw"]
    without = judged.loc[judged["remedy"] == AS_IS, [*pairs, "verdict"]]
    paired = judged.loc[judged["remedy"] != AS_IS, [*pairs, "remedy", "verdict"]].merge(
        without, on=pairs, suffixes=("", "_without")
    )
    stands = paired["verdict"] == Verdict.STABLE.value
    stood = paired["verdict_without"] == Verdict.STABLE.value
    way, outcomes = _KEYS[:3], paired_outcomes(stood, stands)
    counts = paired[way].assign(**outcomes).groupby(way, observed=True).sum().astype("int64").reset_index()
    trials = [PairedCounts(*numbers) for numbers in counts[[*outcomes]].itertuples(index=False, name=None)]
    ends = [newcombe_interval(of_way) if random and of_way.n else (np.nan, np.nan) for of_way in trials]
    low, high = np.reshape(ends, (-1, 2)).T
    gains = {"gain": np.array([of_way.difference for of_way in trials], float), "gain_low": low, "gain_high": high}
    counts = counts.rename(columns={"only_a": "only_without", "only_b": "only_with"})
    return counts[[*way, "only_with", "only_without"]].assign(leg=WHOLE_WAY, **gains)


def write_chain(writer: RunWriter, chain: ChainColumns) -> None:
    """Write the table ``summary`` of a chain. All other tables of the run must be complete.

    Raises:
        PetmjxError: the file cannot be written.
    """
    summary = summarise_chain(frame_in_order(writer.parts, "worlds", OF_WORLDS), chain)
    units = {name: DIMENSIONLESS for name in summary if name not in _TEXTS}
    writer.write_summary(summary_table(summary, units, _DESCRIPTIONS))


def arrivals(summary: pd.DataFrame) -> pd.DataFrame:
    """Those rows of the summary that are about the whole journey of a single plan without remedies, in the order
    of the run."""
    chosen = (summary["scope"] == ONE_PLAN) & (summary["leg"] == WHOLE_WAY) & (summary["remedy"] == AS_IS)
    return summary[chosen].reset_index(drop=True)


def shares_by_leg(summary: pd.DataFrame) -> pd.DataFrame:
    """Share of the pallets that stand after a leg, among the pallets that reached the leg, for the chain without
    remedies. One row per plan, and one column per leg in the order of the legs."""
    chosen = summary[(summary["scope"] == ONE_PLAN) & (summary["remedy"] == AS_IS) & (summary["leg"] != WHOLE_WAY)]
    return chosen.pivot(index="plan_id", columns="leg", values="share")[chosen["leg"].unique().tolist()]
