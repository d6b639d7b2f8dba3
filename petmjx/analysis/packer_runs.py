"""Joins the runs of several packers into one table, with a row for each order and packer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.analysis.packer_kpis import OrderComparison
from petmjx.common.argument_checks import list_of, text_of
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.common.units import FloatArray
from petmjx.engines.engine_registry import ENGINES, has_option
from petmjx.options.carriers import CARRIER_EXTENT_M, TARGETS, Carrier, OwnCarrier, extent_m
from petmjx.options.run_options import AUTO
from petmjx.results.resume import engine_of_earlier_run
from petmjx.results.run_reader import RunResults, RunSource, is_chain, opened_run
from petmjx.runs.chain_summary import arrivals

LONGEST_NAME: Final = 200
"""Largest number of bytes in a packer's name. File systems allow 255 bytes for the name of a folder."""

MISSING: Final = "missing"
"""The text in the column ``verdict`` if a packer has no plan for an order."""

MEASURES: Final[Mapping[str, str]] = {
    "boxes": "boxes placed",
    "left_out": "boxes left out",
    "volume_m3": "volume, m³",
    "height_m": "height, m",
    "kpi_2": "kpi_2, volume over area × height",
}
"""Name of a column with a property of plans → heading of the column. Tables show the means of these columns beside the
shares of standing plans. To add a column, add an entry to this mapping, and add the column to :func:`plans_of`."""

ARRIVES: Final = "p_arrives"
"""Column with the share of a plan's simulations in which the pallet arrives at the end of the transport chain. The
column exists if all runs simulated transport chains."""


def with_engine_of(run: RunResults, options: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The options for scoring a further packer. They name the engine of another packer's run: verdicts near a threshold
    may differ between engines, so plans that are compared need the same engine.

    Args:
        run: another packer's run, made with the same options on this machine.
        options: options of ``petmjx.score``. An engine that the options name is kept. If the options name no engine,
            options that the engine of the run does not have (``threads`` or ``lanes``) are left out. The engine
            ``auto`` also ignores the options that the chosen engine does not have.
        folder: folder of the packer's run. A run that is already in the folder, and that the options do not replace,
            goes on with its own engine.
    """
    engine = run.info["config"]["engine"]
    goes_on = not options.get("overwrite", False) and engine_of_earlier_run(folder) is not None
    if options.get("engine", AUTO) != AUTO or engine not in ENGINES or goes_on:
        return {**options}
    of_others = {option for name in ENGINES for option in ENGINES[name][2] if not has_option(engine, option)}
    return {name: value for name, value in options.items() if name not in of_others} | {"engine": engine}


def runs_by_packer(runs: Sequence[RunSource] | Mapping[str, RunSource]) -> dict[str, RunResults]:
    """Name of each packer → its run. If no names are given, packers are named after the folders of the runs.

    Raises:
        InputError: there are fewer than two runs, two runs have the same name, or a folder has no run.
    """
    if isinstance(runs, str | PathLike | RunResults):
        runs = [runs]  # a string is a single run, and must not be taken as a sequence of letters
    runs_by_name = runs if isinstance(runs, Mapping) else None
    sources: list[Any] = (
        list(runs_by_name.values()) if runs_by_name else list_of(runs, "runs", object, "runs or folders")
    )
    loaded_runs = [opened_run(run) for run in sources]
    if len(loaded_runs) < 2:
        raise InputError("give at least two runs to compare")
    names = (
        [text_of(name, "runs") for name in runs_by_name] if runs_by_name else _names([run.path for run in loaded_runs])
    )
    for name in names:
        if not name or not name.isprintable():
            raise InputError(f"runs: a name must be text that can be printed, got {printable_name(name)!r}")
    for run in loaded_runs:
        if run.info.get("config", {}).get("command") == "sweep":
            raise InputError(f"{run.path}: is a sweep; packers are compared by runs of 'petmjx score'")
        if run.worlds.duplicated(["plan_id", "variant"]).any():
            raise InputError(
                f"{run.path}: the run has the same plan and variant more than once, so it cannot be compared"
            )
    return dict(zip(names, loaded_runs, strict=True))


def _names(folders: Sequence[Path]) -> list[str]:
    short = [folder.resolve().name for folder in folders]
    names = short if len(set(short)) == len(short) else [str(folder) for folder in folders]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise InputError(f"{printable_name(name)}: this run is given twice; give runs of different packers")
    return names


def check_names(names: Iterable[str]) -> None:
    """Check that the names of packers can be used as names of folders.

    Raises:
        InputError: a name cannot be the name of a folder.
    """
    for name in names:
        if not isinstance(name, str):
            raise InputError(f"a packer's name must be text, got {type(name).__name__}")
        if len(name.encode()) > LONGEST_NAME:
            raise InputError(f"packer {printable_name(name)!r}: the name must have at most {LONGEST_NAME} bytes")
        if not name or name in (".", "..") or "/" in name or "\\" in name or not name.isprintable():
            raise InputError(f"packer {printable_name(name)!r}: the name must be usable as the name of a folder")


def plans_of(runs: Mapping[str, RunResults], against: OrderComparison | None = None) -> pd.DataFrame:
    """A table with one row for each order and packer, sorted by order. The table has the orders that the caller gave,
    and all orders for which any packer has a plan.

    Args:
        against: the comparison of the plans with the caller's orders. If ``against`` is None, the caller gave no
            orders, and the numbers of ordered boxes that the runs state are used. If the runs do not state the numbers
            of ordered boxes either, an order is assumed to have as many boxes as its largest plan.

    Returns:
        The columns ``plan_id``, ``packer``, ``order_boxes`` (number of boxes of the order), ``verdict`` (possibly
        ``missing``), ``reason``, ``margin``, ``digest``, and the columns of ``MEASURES``. ``as_ordered`` is the number
        of boxes of the plan that were ordered, have the ordered size and mass, and lie on the order's target. Each
        ordered box is counted at most once. ``as_ordered`` is null if this number is unknown. ``listed`` tells whether
        the order enters ratings. ``compared`` tells whether every packer's plan for the order has a valid verdict. If
        all runs are of transport chains, there is also the column ``p_arrives``.
    """
    table = _worlds_of(runs)
    sizes = None if against is None else against.sizes
    ids = sorted({*table["plan_id"], *(sizes or ())})
    every = pd.MultiIndex.from_product([ids, list(runs)], names=["plan_id", "packer"])
    table = table.set_index(["plan_id", "packer"]).reindex(every).reset_index()
    table["verdict"] = table["verdict"].fillna(MISSING)
    table["reason"] = table["reason"].fillna("")
    by_order = table.groupby("plan_id", sort=False)
    table["order_boxes"] = by_order["ordered_boxes"].transform("max").fillna(by_order["boxes"].transform("max"))
    if against is None or sizes is None:
        table["listed"] = True
        n_as_ordered = table["ordered_boxes"] - table["left_out"] - table["resized"].fillna(0)
        table["as_ordered"] = n_as_ordered.fillna(table["boxes"]).clip(upper=table["order_boxes"])
    else:
        table["listed"] = table["plan_id"].isin(sizes.keys())
        table["order_boxes"] = table["plan_id"].map(sizes).fillna(table["order_boxes"])
        goods = against.rows.set_index(["plan_id", "packer"]).reindex(every).reset_index()
        table[["left_out", "as_ordered"]] = goods[["left_out", "as_ordered"]]
    table["order_boxes"] = table["order_boxes"].astype(np.int64)
    area = _target_area_m2(by_order, _carrier(runs))
    with np.errstate(divide="ignore", invalid="ignore"):
        table["kpi_2"] = table["volume_m3"] / (area * table["height_m"])
    table["compared"] = table["verdict"].isin(["stable", "unstable"])
    table["compared"] = table.groupby("plan_id", sort=False)["compared"].transform("all")
    first = ["plan_id", "packer", "order_boxes", "listed", "compared", "verdict", "reason", "margin"]
    arrives = [ARRIVES] if ARRIVES in table else []
    return table[[*first, *MEASURES, *arrives, "as_ordered", "digest"]]


_OF_PLAN: Final = ("volume_m3", "extent_x_m", "extent_y_m", "height_m", "ordered_boxes", "left_out", "resized")
"""Columns that are read from the table ``plans`` of a run. Older runs, and runs without orders, lack some of these
columns."""


def _worlds_of(runs: Mapping[str, RunResults]) -> pd.DataFrame:
    """One row for each plan and packer: the verdict of the nominal world (the simulation without errors), and columns
    of the table ``plans`` of the packer's run."""
    of_world = ["plan_id", "verdict", "reason", "n_boxes", "margin"]
    worlds = [run.worlds[run.worlds["variant"] == 0].reindex(columns=of_world) for run in runs.values()]
    plans = [run.plans.reindex(columns=["plan_id", "digest", *_OF_PLAN]) for run in runs.values()]
    joined = [
        pd.concat(parts, ignore_index=True).assign(packer=np.repeat(list(runs), list(map(len, parts))))
        for parts in (worlds, plans)
    ]
    table = joined[0].rename(columns={"n_boxes": "boxes"}).merge(joined[1], on=["packer", "plan_id"], how="left")
    if all(is_chain(run.info) for run in runs.values()):
        shares = [arrivals(run.summary)[["plan_id", "share"]] for run in runs.values() if run.summary is not None]
        share_table = pd.concat(shares, keys=list(runs), names=["packer", None]).reset_index("packer")
        table = table.merge(share_table.rename(columns={"share": ARRIVES}), on=["packer", "plan_id"], how="left")
    return table.astype(dict.fromkeys(("boxes", "margin", *_OF_PLAN), np.float64))


def _carrier(runs: Mapping[str, RunResults]) -> Carrier | OwnCarrier:
    """The carrier of all runs; ``footprint`` if the runs have different carriers."""
    carriers = [run.carrier for run in runs.values()]
    return carriers[0] if all(carrier == carriers[0] for carrier in carriers) else Carrier.FOOTPRINT


def _target_area_m2(by_order: Any, carrier: Carrier | OwnCarrier) -> FloatArray:
    """(n,) for each row of the table, the area of the order's target (such as a pallet), m². All packers' plans for an
    order have the same target. Usually, the target is the carrier. For the carrier ``footprint``, the target is the
    smallest target of the benchmark BED-BPP that is large enough for all packers' plans. If no target is large enough,
    the result is the area of the smallest rectangle that is large enough.
    """
    x, y = (by_order[f"extent_{axis}_m"].transform("max").to_numpy(np.float64) for axis in "xy")
    area: FloatArray = x * y
    target_extents = [extent for target in TARGETS if (extent := CARRIER_EXTENT_M[target]) is not None]
    if (carrier_extent := extent_m(carrier)) is not None:
        return np.full(len(area), np.prod(carrier_extent))
    for length, width in sorted(target_extents, key=lambda extent: -extent[0] * extent[1]):
        room = (x <= length + 1e-9) & (y <= width + 1e-9)
        area = np.where(room, length * width, area)
    return area


def doubts(runs: Mapping[str, RunResults], table: pd.DataFrame) -> list[str]:
    """Reasons to doubt the comparison, as lines for the user."""
    lines = [line for name, run in runs.items() for line in run.doubts(printable_name(name))]
    settings = {name: run.info.get("config", {}).get("simulation") for name, run in runs.items()}
    first, *other_settings = settings
    for name in other_settings:
        differing = _different_options(settings[first], settings[name])
        if differing:
            lines.append(
                f"{printable_name(name)} was simulated with other options than {printable_name(first)}: "
                f"{', '.join(differing)}"
            )
    if any(is_chain(run.info) for run in runs.values()):
        ways = {name: run.info.get("identity", {}).get("sweep") for name, run in runs.items()}
        for name in (name for name in other_settings if ways[name] != ways[first]):
            lines.append(f"{printable_name(name)} was not taken through the same chain as {printable_name(first)}")
    engines = {str(run.info.get("config", {}).get("engine")) for run in runs.values()}
    if len(engines) > 1:
        lines.append(f"simulated by different engines: {', '.join(sorted(engines))}")
    unknown = [printable_name(name) for name in runs if table.loc[table["packer"] == name, "volume_m3"].isna().all()]
    if unknown:
        lines.append(
            f"the utilisation of {', '.join(unknown)} is unknown: an earlier version of petmjx wrote the run; score "
            "its plans again"
        )
    if not table["compared"].any():
        lines.append("no order has a valid verdict from every packer")
    lines += _same_plans(table, list(runs))
    return lines


def _same_plans(table: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """A list with a line about orders for which all packers have the same plan; an empty list if there are no such
    orders."""
    compared = table[table["compared"]].groupby("plan_id")["digest"].agg(["nunique", "count"])
    n_same = int(((compared["nunique"] == 1) & (compared["count"] == len(names))).sum())
    verb = "is" if n_same == 1 else "are"
    return [f"{count_text(n_same, 'plan')} of {len(compared):,} {verb} the same in all runs"] if n_same else []


def _different_options(a: Any, b: Any) -> list[str]:
    """The names of the options that differ between two records of options."""
    if not isinstance(a, Mapping) or not isinstance(b, Mapping):
        return []
    return [str(name) for name in sorted({*a, *b}) if a.get(name) != b.get(name)]
