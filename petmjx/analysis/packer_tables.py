"""Writes the tables of a comparison of packers as files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from petmjx.analysis.kpis import COLUMNS
from petmjx.analysis.packer_comparison import TABLES, PackerComparison
from petmjx.common.atomic_write import write_errors
from petmjx.engines.metrics import DIMENSIONLESS, TEXT
from petmjx.results.documented_tables import Described, check_tables_free, write_documented_tables

_COUNTS: Final = {
    "n": "compared orders; in reasons those that are lost",
    "n_stable": "compared orders whose plan stands",
    "n_orders": "orders",
    "n_invalid": "orders with an invalid world",
    "n_missing": "orders without a plan",
    "both": "orders of which both plans stand",
    "only_a": "orders of which the plan of a alone stands",
    "only_b": "orders of which the plan of b alone stands",
    "neither": "orders of which neither plan stands",
    "boxes": "boxes placed; in packers the mean",
    "left_out": "boxes left out; in packers the mean",
    "order_boxes": "boxes of the order",
    "as_ordered": "boxes that were ordered, each once, with the order's size and mass, on its target; null: not known",
}
_NUMBERS: Final = {
    "share": "share of the compared orders whose plan stands",
    "low": "lower end of its interval",
    "high": "upper end of its interval",
    "share_at_worst": "share that stands if orders without a valid plan count as unstable",
    "difference": "share of b - share of a",
    "p": "of McNemar's exact test; null where it is not tested",
    "p_holm": "the same, corrected for the number of pairs",
    "p_arrives": "share of worlds with errors that arrive at the end of a chain; in packers the mean",
    "p_low": "lower end of the interval of that mean over orders",
    "p_high": "upper end of it",
    "p_gain": "mean over orders of p_arrives of b - that of a",
    "p_gain_low": "lower end of its interval over orders",
    "p_gain_high": "upper end of it",
    "margin": "distance to the nearest threshold as a share of it",
}
_TEXTS: Final = {
    "size": "boxes of the orders, from and to; all: of any size",
    "packer": "name of the packer",
    "a": "name of the first packer",
    "b": "name of the second packer",
    "won_by": "packer whose plan stands",
    "lost_by": "packer whose plan does not stand",
    "plan_id": "id of the order and of its plans",
    "verdict": "verdict of the simulation; missing: there is no plan",
    "reason": "why a plan does not stand; in decided that of the loser",
    "digest": "of everything in the plan that affects results",
}

DESCRIBED: Final[Described] = {
    **{column.name: (column.unit, column.meaning) for column in COLUMNS},
    "height_m": ("m", "highest top of the plan; in packers the mean"),
    **{name: (DIMENSIONLESS, meaning) for name, meaning in (_COUNTS | _NUMBERS).items()},
    **{name: (TEXT, meaning) for name, meaning in _TEXTS.items()},
    "listed": (DIMENSIONLESS, "whether the order is one of those given; true for all where none are given"),
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
