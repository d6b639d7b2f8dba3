"""Compares packers (programs that make packing plans) by simulations of their plans: whose plans stand more often, by
how much, and with which confidence.

The comparison is paired by orders, since every packer packs the same orders. An order is compared only if the plan of
every packer has a valid verdict. For each packer, orders without a plan and orders with an invalid simulation are
counted separately. ``share_at_worst`` is the share of standing plans if an order without a plan, or with an invalid
simulation, counts as a plan that falls.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.analysis.kpis import COLUMNS
from petmjx.analysis.packer_kpis import KPIS, against_orders
from petmjx.analysis.packer_runs import ARRIVES, MEASURES, MISSING, doubts, plans_of, runs_by_packer
from petmjx.common.atomic_write import write_errors
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.engines.metrics import DIMENSIONLESS, TEXT
from petmjx.engines.verdict import Verdict
from petmjx.results.documented_tables import Described, check_tables_free, write_documented_tables
from petmjx.results.notebook_tables import ShownColumn, block_as_html, table_as_html
from petmjx.results.run_reader import RunResults, RunSource
from petmjx.results.share_statistics import (
    DEFAULT_CONFIDENCE,
    PairedCounts,
    holm,
    mcnemar_p,
    newcombe_interval,
    wilson_interval,
)
from petmjx.results.to_json import to_json

LEAST_P: Final = 1e-4
"""Smallest p-value that is shown as a number. A smaller p-value is shown as "p < 0.0001"."""


def p_in_words(p: float) -> str:
    """A p-value as text, such as "p = 0.0020" or "p < 0.0001"."""
    return f"p < {LEAST_P:.4f}" if p < LEAST_P else f"p = {p:.4f}"


def pair_in_words(row: Mapping[str, Any], confidence: float, pairs: int) -> str:
    """One sentence that compares two packers on the same orders: whose plans stand more often, and by how much.

    Args:
        row: a row of ``PackerComparison.pairs`` for orders of all sizes, with at least one compared order.
        confidence: confidence of the row's interval. The difference is called significant if its p-value is at most 1 −
            confidence.
        pairs: number of pairs of packers. The p-value is corrected for this number of tests.
    """
    better, worse = (row["b"], row["a"]) if row["difference"] > 0 else (row["a"], row["b"])
    bounds = (row["low"], row["high"]) if row["difference"] > 0 else (-row["high"], -row["low"])
    low, high = (f"{100 * bound + 0.0:+.2f}" for bound in bounds)
    orders = count_text(int(row["n"]), "order")
    level = f"{100 * confidence:g} % interval"
    test = f"McNemar's exact test, {p_in_words(row['p_holm'])}" + (
        f", corrected for {pairs} pairs" if pairs > 1 else ""
    )
    if row["difference"] == 0:
        equal = f"Plans of {printable_name(row['a'])} and {printable_name(row['b'])} stand equally often on {orders}"
        return f"{equal}; a difference of {low} to {high} percentage points is possible ({level}; {test})."
    comparison_text = f"lans of {printable_name(better)} stand more often than plans of {printable_name(worse)}"
    points = f"{100 * abs(row['difference']):.2f} percentage points"
    sure = f"({level} {low} to {high}; {test})"
    if row["p_holm"] <= 1 - confidence:
        return f"P{comparison_text}: by {points} on {orders} {sure}."
    return f"On these {orders} p{comparison_text}, by {points}, but that may be luck {sure}."


SIZE_BINS: Final = (0, 20, 40, 60, 80)
"""Limits of the size classes of orders, as numbers of boxes: 1 to 20, 21 to 40, …, more than 80."""

ALL_SIZES: Final = "all"

_PAIR_COLUMNS: Final = (
    "size", "a", "b", "n", "both", "only_a", "only_b", "neither", "difference", "low", "high", "p", "p_holm",
)  # fmt: skip

SHOWN: Final = (
    ShownColumn("packer", "packer"),
    ShownColumn("n", "orders"),
    ShownColumn("n_stable", "stand"),
    ShownColumn("share", "share %", 1, 100.0),
    ShownColumn("low", "from %", 1, 100.0),
    ShownColumn("high", "to %", 1, 100.0),
    ShownColumn("boxes", "boxes placed", 1),
    ShownColumn("height_m", "height m", 3),
    ShownColumn("kpi_2", "kpi_2", 3),
)
"""Columns of the table ``packers`` that a notebook shows."""


_ARRIVAL_PAIR: Final = ("p_gain", "p_gain_low", "p_gain_high")
"""Additional columns of the table ``pairs`` if the runs simulated transport chains."""

TABLES: Final = ("packers", "pairs", "reasons", "decided", "plans")
"""Names of the tables of a comparison."""


@dataclass(frozen=True, eq=False)
class PackerComparison:
    """The result of :func:`compare_packers`.

    Attributes:
        runs: name of each packer → folder of its run.
        confidence: confidence of all intervals.
        packers: one row for each packer and size class of orders; the class ``all``, of all orders, comes first.
            Columns: ``size``; ``packer``; ``n``, the number of compared orders; ``n_stable``, the number of these
            orders whose plan stands; ``share`` (n_stable / n) with its Wilson interval ``low``, ``high``; and the means
            of ``MEASURES`` over the compared orders. If orders are given, the means of ``KPIS`` are added. ``n_orders``
            is the number of all orders in the size class: ``n_invalid`` of them have an invalid simulation, and
            ``n_missing`` have no plan. The last column is ``share_at_worst``. Runs of transport chains also have the
            mean of ``p_arrives`` (the probability of arrival), with its interval ``p_low``, ``p_high`` over orders.
        pairs: one row for each pair of packers and size class. Columns: ``a``, ``b``, ``n``; the numbers of orders
            whose plans stand for ``both`` packers, ``only_a``, ``only_b`` or ``neither``; and ``difference`` (share of
            b − share of a) with Newcombe's interval ``low``, ``high``. ``p`` is the p-value of McNemar's exact test;
            ``p_holm`` is ``p``, corrected for the number of pairs. ``p`` and ``p_holm`` exist only for the class
            ``all``, because the other classes are not meant for tests. Runs of chains also have ``p_gain``, the mean
            over orders of (``p_arrives`` of b − ``p_arrives`` of a), with its interval ``p_gain_low``, ``p_gain_high``.
        reasons: why a plan of one packer falls although the other packer's plan for the same order stands. Columns: the
            pair ``a``, ``b``; the packer ``lost_by`` whose plans fall; the ``reason``; and the number ``n`` of orders
            with this reason.
        decided: one row for each order and pair of packers for which only one of the two plans stands. Columns:
            ``plan_id``, ``a``, ``b``, ``won_by``, ``lost_by``, ``reason``, ``order_boxes``.
        plans: one row for each order and packer (:func:`petmjx.analysis.packer_runs.plans_of`).
        notes: reasons to doubt the comparison, one line each.
    """

    runs: Mapping[str, str]
    confidence: float
    packers: pd.DataFrame
    pairs: pd.DataFrame
    reasons: pd.DataFrame
    decided: pd.DataFrame
    plans: pd.DataFrame
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        rows = self.packers[self.packers["size"] == ALL_SIZES]
        shares = ", ".join(f"{row.packer} {100 * row.share:.1f} %" for row in rows.itertuples())
        return f"PackerComparison({shares} of {count_text(int(rows['n'].iloc[0]), 'order')})"

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence for each pair of packers: whose plans stand more often, by how much, and with which confidence.
        If no order is compared, there are no sentences."""
        rows = self.pairs[(self.pairs["size"] == ALL_SIZES) & (self.pairs["n"] > 0)]
        return tuple(pair_in_words(row, self.confidence, len(rows)) for row in rows.to_dict("records"))

    def _repr_html_(self) -> str:
        """HTML for notebooks: the sentences about pairs, and a table with a row for each packer."""
        rows = self.packers[self.packers["size"] == ALL_SIZES]
        return block_as_html([repr(self), *self.sentences, *self.notes], [table_as_html(rows, SHOWN, "packers")])

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables, by name."""
        return {name: getattr(self, name) for name in TABLES}

    def to_dict(self) -> dict[str, Any]:
        """The comparison without the table ``plans``, as plain JSON values. Missing numbers are None."""
        return dict(to_json({name: value for name, value in vars(self).items() if name != "plans"}))


def compare_packers(
    runs: Sequence[RunSource] | Mapping[str, RunSource],
    confidence: float = DEFAULT_CONFIDENCE,
    *,
    orders: str | PathLike[str] | None = None,
) -> PackerComparison:
    """Compare packers by runs of their plans. Plans are paired by id.

    Args:
        runs: two or more runs or their folders; or a mapping from names of packers to runs. If no names are given,
            packers are named after the folders.
        confidence: confidence of the intervals.
        orders: a file with the orders of the plans, in any form that petmjx reads. If orders are given, the plans are
            read again, their boxes are compared with the orders, and KPIs are added. An order without any plan then
            counts as missing for all packers.

    Raises:
        InputError: there are fewer than two runs, a folder has no run, a run is a sweep, two runs have the same name,
            orders are unreadable, or SciPy is missing.
    """
    if not 0 < confidence < 1:
        raise InputError(f"confidence must be between 0 and 1, got {confidence}")
    return comparison_of(runs_by_packer(runs), confidence, None if orders is None else Path(orders))


def comparison_of(
    runs: Mapping[str, RunResults], confidence: float, orders: Path | None, articles: Path | None = None
) -> PackerComparison:
    """Compare packers by runs that are already loaded. With a single packer, the tables of pairs are empty.

    Args:
        articles: a table of articles, from which properties are read that the orders do not state. If ``articles`` is
            None, the table that all runs name is used.

    Raises:
        InputError: orders are unreadable, or SciPy is missing.
    """
    against = None if orders is None else against_orders(runs, orders, articles)
    plans = plans_of(runs, against)
    notes = doubts(runs, plans)
    if against is not None:
        plans, notes = _with_kpis(plans, against.rows), [*notes, *against.notes]
    sized = plans.assign(size=size_names(plans["order_boxes"]))
    sizes = [ALL_SIZES, *(size for size in _bin_names() if (sized["size"] == size).any())]
    parts = {size: sized if size == ALL_SIZES else sized[sized["size"] == size] for size in sizes}
    packers = [_packer_row(size, name, rows, confidence) for size, rows in parts.items() for name in runs]
    pairs = [_pair_row(size, a, b, rows, confidence) for size, rows in parts.items() for a, b in combinations(runs, 2)]
    pair_table = pd.DataFrame(pairs, columns=[*_PAIR_COLUMNS, *(_ARRIVAL_PAIR if ARRIVES in plans else ())])
    overall = pair_table["size"] == ALL_SIZES
    pair_table.loc[overall, "p_holm"] = holm(pair_table.loc[overall, "p"].tolist())
    decided = _decided_orders(plans, list(runs))
    by = ["a", "b", "lost_by", "reason"]
    reasons = decided.groupby(by, sort=False).size().rename("n").reset_index()
    return PackerComparison(
        runs={name: str(run.path) for name, run in runs.items()},
        confidence=confidence,
        packers=pd.DataFrame(packers),
        pairs=pair_table,
        reasons=reasons.sort_values([*by[:3], "n"], ascending=[True, True, True, False]).reset_index(drop=True),
        decided=decided,
        plans=plans,
        notes=tuple(notes),
    )


def _with_kpis(plans: pd.DataFrame, kpis: pd.DataFrame) -> pd.DataFrame:
    """Add the columns ``KPIS`` to the plans. ``kpi_2`` (volume utilisation) refers to the target of the order, such as
    a pallet, if the target is known."""
    kpis = kpis[["plan_id", "packer", *KPIS]]
    merged = plans.drop(columns="kpi_2").merge(kpis, on=["plan_id", "packer"], how="left", validate="one_to_one")
    return merged.assign(kpi_2=merged["kpi_2"].combine_first(plans["kpi_2"]))


def _bin_names() -> list[str]:
    upper = [*SIZE_BINS[1:], None]
    return [f"{low + 1} to {high}" if high else f"over {low}" for low, high in zip(SIZE_BINS, upper, strict=True)]


def size_names(boxes: pd.Series) -> pd.Series:
    """The name of the size class of each order, from the number of its boxes."""
    names = np.array(_bin_names())
    return pd.Series(names[np.searchsorted(SIZE_BINS, boxes.to_numpy(), side="left") - 1], index=boxes.index)


def _packer_row(size: str, name: str, rows: pd.DataFrame, confidence: float) -> dict[str, Any]:
    mine = rows[rows["packer"] == name]
    compared = mine[mine["compared"]]
    stable = int((compared["verdict"] == Verdict.STABLE.value).sum())
    low, high = wilson_interval(stable, len(compared), confidence)
    measures = [*MEASURES, *(column for column in KPIS if column in rows and column not in MEASURES)]
    means = {column: float(compared[column].mean()) for column in measures}
    standing = int((mine["verdict"] == Verdict.STABLE.value).sum())
    if ARRIVES in rows:
        means |= dict(zip((ARRIVES, "p_low", "p_high"), _mean_interval(compared[ARRIVES], confidence), strict=True))
    return {
        "size": size,
        "packer": name,
        "n": len(compared),
        "n_stable": stable,
        "share": stable / len(compared) if len(compared) else float("nan"),
        "low": float(low),
        "high": float(high),
        **means,
        "n_orders": len(mine),
        "n_invalid": int((mine["verdict"] == Verdict.INVALID.value).sum()),
        "n_missing": int((mine["verdict"] == MISSING).sum()),
        "share_at_worst": standing / len(mine) if len(mine) else float("nan"),
    }


def _pair_row(size: str, a: str, b: str, rows: pd.DataFrame, confidence: float) -> dict[str, Any]:
    wide = _standing_table(rows)
    counts = PairedCounts.of(wide[a].to_numpy(bool), wide[b].to_numpy(bool))
    low, high = newcombe_interval(counts, confidence)
    test = mcnemar_p(counts) if size == ALL_SIZES else float("nan")
    shares = {"difference": counts.difference, "low": low, "high": high, "p": test, "p_holm": float("nan")}
    if ARRIVES in rows:
        of = rows[rows["compared"]].pivot(index="plan_id", columns="packer", values=ARRIVES)
        gains = of[b] - of[a] if len(of) else pd.Series(dtype="float64")
        shares |= dict(zip(_ARRIVAL_PAIR, _mean_interval(gains, confidence), strict=True))
    # This dictionary must have the order of _PAIR_COLUMNS.
    return {"size": size, "a": a, "b": b, "n": counts.n, **vars(counts), **shares}


def _mean_interval(values: pd.Series, confidence: float) -> tuple[float, float, float]:
    """The mean of values over orders, and the bounds of its Student interval. The bounds are computed from the spread
    of the values, so they take account of the differences between orders and of the randomness of each value. The
    bounds are NaN if there are fewer than two orders, or if all orders have the same value."""
    valid_values = values.dropna()
    mean, n = float(valid_values.mean()), len(valid_values)
    if n < 2 or valid_values.std() == 0:
        return mean, float("nan"), float("nan")
    from scipy.stats import t

    half = float(t.ppf(0.5 + confidence / 2, n - 1) * valid_values.std() / np.sqrt(n))
    return mean, mean - half, mean + half


def _standing_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A table that tells which plans stand, with a row for each compared order and a column for each packer."""
    compared = rows[rows["compared"]]
    stands = compared.assign(stands=compared["verdict"] == Verdict.STABLE.value)
    return stands.pivot(index="plan_id", columns="packer", values="stands").reindex(columns=rows["packer"].unique())


def _decided_orders(plans: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    compared = plans[plans["compared"]]
    of = {name: compared[compared["packer"] == name].reset_index(drop=True) for name in names}
    parts = []
    for a, b in combinations(names, 2):
        stands = {name: (of[name]["verdict"] == Verdict.STABLE.value).to_numpy() for name in (a, b)}
        for winner, loser in ((b, a), (a, b)):
            won = stands[winner] & ~stands[loser]
            part = of[loser].loc[won, ["plan_id", "reason", "order_boxes"]]
            parts.append(part.assign(a=a, b=b, won_by=winner, lost_by=loser))
    columns = ["a", "b", "won_by", "lost_by", "plan_id", "reason", "order_boxes"]
    return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)


_COUNTS: Final = {
    "n": "number of compared orders; in the table `reasons`: number of orders for which the plan of the packer "
    "`lost_by` failed for this reason, while the other packer's plan stood",
    "n_stable": "number of compared orders whose plan stands",
    "n_orders": "number of orders",
    "n_invalid": "number of orders whose plan has an invalid verdict",
    "n_missing": "number of orders without a plan",
    "both": "number of orders for which the plans of both packers stand",
    "only_a": "number of orders for which only the plan of packer `a` stands",
    "only_b": "number of orders for which only the plan of packer `b` stands",
    "neither": "number of orders for which the plan of neither packer stands",
    "boxes": "number of boxes placed; in the table `packers`: mean over orders",
    "left_out": "number of boxes left out; in the table `packers`: mean over orders",
    "order_boxes": "number of boxes of the order",
    "as_ordered": "number of boxes on the order's target that have the ordered size and mass, each ordered box counted "
    "once; null if unknown",
}
_NUMBERS: Final = {
    "share": "share of the compared orders whose plan stands",
    "low": "lower end of the confidence interval of `share`; in the table `pairs`: of `difference`",
    "high": "upper end of the confidence interval of `share`; in the table `pairs`: of `difference`",
    "share_at_worst": "share of all orders whose plan stands, if missing and invalid plans count as unstable",
    "difference": "share of the compared orders for which the plan of packer `b` stands, minus the same share for "
    "packer `a`",
    "p": "p-value of McNemar's exact test; null if there is no test",
    "p_holm": "p-value of McNemar's exact test, corrected for the number of pairs (Holm)",
    "p_arrives": "share of a plan's worlds, each with random errors, that arrive at the end of a chain; in the table "
    "`packers`: mean over orders",
    "p_low": "lower end of the interval of the mean of `p_arrives` over orders",
    "p_high": "upper end of the interval of the mean of `p_arrives` over orders",
    "p_gain": "`p_arrives` of packer `b` minus `p_arrives` of packer `a`, as a mean over orders",
    "p_gain_low": "lower end of the interval of `p_gain`, a mean over orders",
    "p_gain_high": "upper end of the interval of `p_gain`, a mean over orders",
    "margin": "distance to the nearest threshold as a share of that threshold",
}
_TEXTS: Final = {
    "size": "size of the orders, as a range of the number of boxes; 'all': orders of any size",
    "packer": "name of the packer",
    "a": "name of the first packer",
    "b": "name of the second packer",
    "won_by": "name of the packer whose plan of the order stands, while the other packer's plan does not",
    "lost_by": "name of the packer whose plan of the order does not stand, while the other packer's plan does",
    "plan_id": "id of the order and of its plans",
    "verdict": "verdict of the simulation; 'missing': there is no plan",
    "reason": "reason why a plan does not stand; in the tables `reasons` and `decided`: why the plan of the packer "
    "`lost_by` does not stand",
    "digest": "digest of everything in the plan that affects results",
}

DESCRIBED: Final[Described] = {
    **{column.name: (column.unit, column.meaning) for column in COLUMNS},
    "height_m": ("m", "height of the highest top of a box; in the table `packers`: mean over orders"),
    **{name: (DIMENSIONLESS, meaning) for name, meaning in (_COUNTS | _NUMBERS).items()},
    **{name: (TEXT, meaning) for name, meaning in _TEXTS.items()},
    "listed": (DIMENSIONLESS, "whether the order is in the file of orders; true for all orders if no file is given"),
    "compared": (DIMENSIONLESS, "whether the order has a valid verdict from every packer"),
}
"""Units and descriptions of the columns of all tables. In the table ``packers``, the columns with KPIs and with
properties of plans are means over orders."""


def check_comparison_free(folder: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Check, before packers are compared, that the tables may be written into a folder. ``inputs`` are the files that
    the command reads. Raises InputError if an existing file must not be replaced
    (``petmjx.results.documented_tables.check_tables_free``).
    """
    check_tables_free(folder, TABLES, overwrite=overwrite, inputs=inputs)


def write_comparison(comparison: PackerComparison, folder: Path, overwrite: bool = False) -> None:
    """Write each table into a folder, as NAME.parquet with units and as NAME.csv.

    Args:
        overwrite: whether tables that petmjx wrote into the folder earlier may be replaced.

    Raises:
        InputError: the folder or a file is not writable, or the folder has a file of one of these names that must not
            be replaced.
    """
    check_comparison_free(folder, overwrite)
    with write_errors(folder):
        write_documented_tables(folder, ((name, table, DESCRIBED) for name, table in comparison.tables.items()))
