"""``petmjx.loads`` compares two forces on the top of each box of a run with the strength of the box: the force at rest,
and the largest force.

petmjx/analysis/stacked_strength.py computes the strength of a box in a stack. petmjx/analysis/crushing.py determines
which boxes are crushed, surely or possibly. Verdicts do not depend on strengths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pandas as pd

from petmjx.analysis.crushing import (
    BOX_UNITS,
    PLAN_UNITS,
    SUSTAINED,
    WAY_UNITS,
    crushed_worlds,
    ways_of,
    with_crush_shares,
)
from petmjx.analysis.stacked_strength import remaining_share, stacked_strengths
from petmjx.common.argument_checks import path_of
from petmjx.common.atomic_write import write_errors
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable, printable_name
from petmjx.options.strength_losses import Stacking
from petmjx.plans.articles import Articles, read_articles
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PathArgument, PlanSource
from petmjx.results.documented_tables import check_tables_free, write_documented_tables
from petmjx.results.plan_lookup import find_plans
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults, is_chain, opened_run

_MOST_NAMED: Final = 8
"""Largest number of articles that a note names."""

_BOX_UNITS: Final = {
    "plan_id": ("", "id of the packing plan"),
    "variant": ("1", "number of the variant (set of changes to the nominal world); 0: the nominal world"),
    "box": ("1", "index of the box in packing order, from 0"),
    "article": ("", "article of the item"),
    "rest_top_force_n": ("N", "force on top of the box at rest"),
    "rest_top_force_low_n": (
        "N",
        "smallest force at rest on top of the box that balance and friction allow; null if unknown",
    ),
    "rest_top_force_high_n": (
        "N",
        "largest force at rest on top of the box that balance and friction allow; null if unknown",
    ),
    SUSTAINED: (
        "N",
        "largest force at rest on top of the box, after the placement or after any leg (stage of a transport "
        "chain); null if the world has no legs",
    ),
    "max_top_force_n": ("N", "largest force on top of the box in any step, also while it is placed or shaken"),
    "press_strength_n": ("N", "strength of the box between the plates of a press; null if unknown"),
    "wall_factor": (
        "1",
        "factor on the box's strength, below 1 if walls of boxes above do not stand on the box's walls",
    ),
    "overhang_factor": ("1", "factor on the box's strength, below 1 if the box's walls hang over nothing"),
    "deck_factor": ("1", "factor on the box's strength, below 1 if the deck on which the box stands has gaps or bends"),
    "humidity_factor": ("1", "factor on the box's strength, below 1 in moist air"),
    "strength_n": (
        "N",
        "strength of the box as stacked: press_strength_n * wall_factor * overhang_factor * deck_factor * "
        "humidity_factor; null if unknown",
    ),
    "time_factor": ("1", "factor on the box's strength against forces at rest, below 1 after days under load"),
    "load_share": ("1", "rest_top_force_n / (strength_n * time_factor)"),
    "peak_share": ("1", "max_top_force_n / strength_n"),
    "load_share_low": ("1", "rest_top_force_low_n / (strength_n * time_factor)"),
    "load_share_high": ("1", "rest_top_force_high_n / (strength_n * time_factor)"),
    **BOX_UNITS,
}
_PLAN_UNITS: Final = {
    "plan_id": _BOX_UNITS["plan_id"],
    "variant": _BOX_UNITS["variant"],
    "verdict": ("", "verdict of the simulation; loads do not change it"),
    "overloaded": ("1", "whether the load_share of any box is above 1; null if unknown"),
    "n_boxes": ("1", "number of boxes of the plan, without sheets"),
    "n_overloaded": ("1", "number of boxes with a load_share above 1"),
    "n_unknown": ("1", "number of boxes whose strength or load is unknown"),
    "surely_overloaded": ("1", "whether the load_share_low of any box is above 1; null if unknown"),
    "possibly_overloaded": ("1", "whether the load_share_high of any box is above 1; null if unknown"),
    "n_surely_overloaded": ("1", "number of boxes with a load_share_low above 1"),
    "n_possibly_overloaded": (
        "1",
        "number of boxes with a load_share_high above 1, including the surely overloaded boxes",
    ),
    "max_load_share": ("1", "largest load_share of any box"),
    "box": ("1", "number (in packing order, from 0) of the box with the largest load_share"),
    "article": ("", "article of the box with the largest load_share"),
    "overloaded_at_peak": ("1", "whether the peak_share of any box is above 1; null if unknown"),
    "n_overloaded_at_peak": ("1", "number of boxes with a peak_share above 1"),
    "max_peak_share": ("1", "largest peak_share of any box"),
    "peak_box": ("1", "number (in packing order, from 0) of the box with the largest peak_share"),
    "peak_article": ("", "article of the box with the largest peak_share"),
    **PLAN_UNITS,
}

_PEAK: Final = "max_top_force_n"

_SHARES: Final = {
    "rest_top_force_n": "load_share",
    "rest_top_force_low_n": "load_share_low",
    "rest_top_force_high_n": "load_share_high",
    _PEAK: "peak_share",
}
"""Name of a column with a force on a box → name of the column with this force as a share of the box's strength. Runs
that did not compute intervals of possible forces lack the columns with the smallest and the largest possible force."""

_OVER: Final = dict(
    zip(("overloaded", "surely_overloaded", "possibly_overloaded", "overloaded_at_peak"), _SHARES.values(), strict=True)
)
"""Name of a column of the table ``plans`` → name of the column of the table ``boxes`` from which it is computed. A
world is overloaded if the force on at least one of its boxes is larger than the strength of this box."""


@dataclass(frozen=True, eq=False)
class Loads:
    """The result of :func:`loads`.

    Attributes:
        run: the run's folder.
        boxes: one row per box of each world, with the box's ``load_share`` (the force on the box as a share of its
            strength), and the values from which this share is computed.
        plans: one row per world (one simulation of one plan): whether any box is ``overloaded`` at rest or
            ``overloaded_at_peak``, and which boxes have the largest ``load_share``. If the run computed intervals of
            possible forces, there are also the columns ``surely_overloaded`` and ``possibly_overloaded``.
        notes: warnings, one per line: about an unfinished run, about articles without a known strength, and about
            forces at rest in stacks that were wrapped in film and then shaken.
        stacking: the options with which these results were computed: how much strength boxes lose by stacking.
        ways: only for the run of a transport chain: one row for each plan and remedy (a change to the chain or the
            load). A row has the share of worlds that arrive, and the share that arrive without crushed boxes. ``ways``
            is None if the run did not simulate a transport chain.
    """

    run: Path
    boxes: pd.DataFrame
    plans: pd.DataFrame
    notes: tuple[str, ...]
    stacking: Stacking = field(default_factory=Stacking)
    ways: pd.DataFrame | None = None

    def __repr__(self) -> str:
        return f"Loads({count_text(len(self.plans), 'world')}, {int(self.plans['overloaded'].sum()):,} overloaded)"

    def write(self, folder: str | Path, overwrite: bool = False) -> None:
        """Write the tables ``box_loads``, ``plan_loads`` and, for the run of a chain, ``way_loads``. Each table is
        written as Parquet, with units, and as CSV.

        Args:
            overwrite: whether tables that petmjx wrote into the folder earlier may be replaced.

        Raises:
            InputError: the folder is not writable, or it has a file of one of these names that must not be replaced.
        """
        folder = path_of(folder, "folder")
        check_loads_free(folder, overwrite)
        with write_errors(folder):
            tables = [("box_loads", self.boxes, _BOX_UNITS), ("plan_loads", self.plans, _PLAN_UNITS)]
            tables += [("way_loads", self.ways, WAY_UNITS)] if self.ways is not None else []
            write_documented_tables(folder, tables)


def check_loads_free(folder: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Check that the tables of loads may be written into a folder. ``inputs`` are the files that the command reads.

    Raises:
        InputError: an existing file must not be replaced (``petmjx.results.documented_tables.check_tables_free``).
    """
    check_tables_free(folder, ("box_loads", "plan_loads", "way_loads"), overwrite=overwrite, inputs=inputs)


def loads(
    run: str | Path | RunResults,
    articles: PathArgument | Articles | None = None,
    plans: PlanSource | None = None,
    *,
    stacking: Stacking | Mapping[str, Any] | None = None,
) -> Loads:
    """Compare two forces on the top of each box, the force at rest and the largest force, with the strength that the
    box has in the stack.

    ``petmjx.loads("results", "articles.csv", stacking={"interlocked_loss": 0.4})``

    Args:
        run: a run's folder, or the result of ``petmjx.score``.
        articles: a table of strengths (``petmjx.plans.articles.read_articles``). If this table has no entry for a box,
            the strength of the box comes from the plan. If the plan has no strength either, the strength comes from the
            table of articles with which the run was made. If ``articles`` is None, only the plan and the run's table
            are used.
        plans: the plans of the run, which give the sizes, places and product groups of boxes. If ``plans`` is None,
            plans are read from the files that the run names.
        stacking: how much strength boxes lose by stacking, as a ``petmjx.options.strength_losses.Stacking`` or as a
            mapping that sets some of its fields.

    Raises:
        InputError: there is no run in the folder, the table of articles or an option is unusable, no box has a known
            strength, or a plan differs from the plan that was simulated.
    """
    losses = stacking if isinstance(stacking, Stacking) else Stacking.read(stacking or {})
    results = opened_run(run)
    if articles is None:
        strengths = Articles({}, {})
    else:
        strengths = articles if isinstance(articles, Articles) else read_articles(path_of(articles, "articles"))
    of_run = _plans_of(results, plans)
    known, missing = stacked_strengths(of_run.values(), strengths, losses, results.carrier)
    if articles is None and known["strength_n"].isna().all():
        raise InputError(
            f"{results.path}: the plans have no strengths of boxes (strength_n): give a table of articles that has them"
        )
    shares = {force: share for force, share in _SHARES.items() if force in results.boxes}
    forces = [*shares, *([SUSTAINED] if SUSTAINED in results.boxes else [])]
    boxes = results.boxes[["plan_id", "variant", "box", "article", *forces]].astype(dict.fromkeys(forces, "float64"))
    boxes = boxes.merge(known, on=["plan_id", "box"], how="inner", validate="many_to_one")
    of_time = {force: 1.0 if force == _PEAK else boxes["time_factor"] for force in shares}
    boxes = boxes.assign(
        **{share: boxes[force] / (boxes["strength_n"] * of_time[force]) for force, share in shares.items()}
    )
    spread = losses.loss_spread
    boxes = with_crush_shares(
        boxes, (remaining_share(losses.time_loss, 1 + spread), remaining_share(losses.time_loss, 1 - spread))
    )
    boxes = boxes[[name for name in _BOX_UNITS if name in boxes]]
    notes = (*results.doubts("the run"), *_notes(missing), *_film_notes(results))
    plan_loads = _of_worlds(results, boxes)
    ways = ways_of(results.worlds, plan_loads) if is_chain(results.info) else None
    return Loads(results.path, boxes, plan_loads, notes, losses, ways)


def _plans_of(results: RunResults, plans: PlanSource | None) -> Mapping[str, Plan]:
    """The plans of a run, as a mapping from ids to plans.

    Raises:
        InputError: a plan is missing, or differs from the simulated plan.
    """
    records = Manifest.read(results.parts, results.info).plans
    plans_again = find_plans(results, records, set(results.worlds["plan_id"]), plans)
    if plans is None and plans_again.gone and plans_again.missing:
        missing_file = printable(plans_again.gone[0])
        raise InputError(
            f"{results.path}: needs the plans of the run, but their file {missing_file} does not exist: name the file "
            "or folder that has the plans"
        )
    for plan_ids, fault in (
        (plans_again.missing, "is not among the plans that were read"),
        (plans_again.changed, "differs from the simulated one"),
    ):
        if plan_ids:
            raise InputError(f"{results.path}: plan {printable_name(plan_ids[0])} {fault}")
    return plans_again.plans


def _of_worlds(results: RunResults, boxes: pd.DataFrame) -> pd.DataFrame:
    """Make the table ``plans``: one row per world."""
    key = ["plan_id", "variant"]
    shares = {name: share for name, share in _OVER.items() if share in boxes}
    marked = boxes[key].assign(
        **{f"n_{name}": boxes[share] > 1 for name, share in shares.items()},
        **{f"unknown_{name}": boxes[share].isna() for name, share in shares.items()},
    )
    counts = marked.groupby(key, sort=False, as_index=False).sum()
    numbers = boxes.groupby(key, sort=False).size().rename("n_boxes").reset_index()
    table = results.worlds[[*key, "verdict"]].merge(numbers, on=key, how="left").merge(counts, on=key, how="left")
    table = table.fillna({"n_boxes": 0, **{name: 0 for name in counts if name not in key}})
    table = table.astype({"n_boxes": "int32", **{name: "int64" for name in counts if name not in key}})
    for share, names in (("load_share", ("box", "article")), ("peak_share", ("peak_box", "peak_article"))):
        rated_boxes = boxes.dropna(subset=share)
        largest = rated_boxes.loc[rated_boxes.groupby(key, sort=False)[share].idxmax(), [*key, "box", "article", share]]
        largest.columns = pd.Index([*key, *names, f"max_{share}"])
        table = table.merge(largest, on=key, how="left")
    for name in shares:
        over = (table[f"n_{name}"] > 0).astype("boolean")
        over[(table[f"n_{name}"] == 0) & (table[f"unknown_{name}"] > 0)] = pd.NA
        table[name] = over
    table["n_unknown"] = table["unknown_overloaded"]
    table = table.merge(crushed_worlds(boxes), on=key, how="left")
    table = table.astype({"box": "Int32", "peak_box": "Int32"})
    return table[[name for name in _PLAN_UNITS if name in table]]


def _notes(missing: Counter[str]) -> list[str]:
    if not missing:
        return []
    notes = []
    if most := sorted(missing.keys() - {""}, key=lambda name: (-missing[name], name)):
        verb = "has" if len(most) == 1 else "have"
        boxes = count_text(sum(missing[name] for name in most), "box", "boxes")
        notes.append(
            f"{count_text(len(most), 'article')} of {boxes} {verb} no strength: {first_names(most, _MOST_NAMED)}"
        )
    if unnamed := missing[""]:
        verb = "has" if unnamed == 1 else "have"
        notes.append(f"{count_text(unnamed, 'box', 'boxes')} without article {verb} no strength")
    return notes


def _film_notes(results: RunResults) -> list[str]:
    """A list with a note about forces at rest, if the run shook stacks that were wrapped in film. For all other runs,
    the list is empty."""
    wrap = results.info.get("config", {}).get("simulation", {}).get("wrap") or {}
    turns = results.worlds.get("wrap_turns", pd.Series([wrap.get("turns") or 0]))
    if not (turns > 0).any() or "profile" not in results.worlds:
        return []
    return [
        "film presses the boxes together, so after the pallet is shaken, forces at rest also depend on friction "
        "between the layers"
    ]
