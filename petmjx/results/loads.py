"""How much of their strength boxes of a run bear at rest: ``petmjx.loads``. The verdicts stay as they are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.basics.arguments import path_of
from petmjx.basics.errors import InputError
from petmjx.basics.text import counted, first_names, printable, shown
from petmjx.basics.whole import writing
from petmjx.plans.articles import Articles, read_articles
from petmjx.plans.gather import PathArgument, PlanSource
from petmjx.plans.plan import Plan
from petmjx.results.described import check_tables_free, write_described
from petmjx.results.manifest import Manifest
from petmjx.results.plans_again import find_plans
from petmjx.results.reader import RunResults, load_run

_MOST_NAMED: Final = 8
"""Articles that a note names."""

_BOX_UNITS: Final = {
    "plan_id": ("", "id of the packing plan"),
    "variant": ("1", "which set of changes to the plan's nominal world; 0 is nominal"),
    "box": ("1", "index of the box in packing order, from 0"),
    "article": ("", "article of the item"),
    "rest_top_force_n": ("N", "force on top of the box at rest"),
    "rest_top_force_low_n": ("N", "the least that balance and friction allow; null: not known"),
    "rest_top_force_high_n": ("N", "the most that balance and friction allow; null: not known"),
    "strength_n": ("N", "what the box bears; null: not known"),
    "load_share": ("1", "rest_top_force_n / strength_n"),
    "load_share_low": ("1", "rest_top_force_low_n / strength_n"),
    "load_share_high": ("1", "rest_top_force_high_n / strength_n"),
}
_PLAN_UNITS: Final = {
    "plan_id": _BOX_UNITS["plan_id"],
    "variant": _BOX_UNITS["variant"],
    "verdict": ("", "verdict of the simulation; loads do not change it"),
    "overloaded": ("1", "whether a box bears more than it can; null: not known, since strengths are missing"),
    "n_boxes": ("1", "boxes of the plan"),
    "n_overloaded": ("1", "boxes that bear more than they can"),
    "n_unknown": ("1", "boxes whose strength or load is not known"),
    "surely_overloaded": ("1", "whether the least force on a box is more than it can bear; null: not known"),
    "possibly_overloaded": ("1", "whether the most force on a box is more than it can bear; null: not known"),
    "n_surely_overloaded": ("1", "boxes on which the least force is too much"),
    "n_possibly_overloaded": ("1", "boxes on which the most force is too much, with those above"),
    "max_load_share": ("1", "largest load_share of a box"),
    "box": ("1", "the box that has it"),
    "article": ("", "its article"),
}

_SHARES: Final = {
    "rest_top_force_n": "load_share",
    "rest_top_force_low_n": "load_share_low",
    "rest_top_force_high_n": "load_share_high",
}
"""Forces on boxes, and what share of the strength they are; the last two where a run has intervals."""

_OVER: Final = dict(zip(("overloaded", "surely_overloaded", "possibly_overloaded"), _SHARES.values(), strict=True))
"""What is said of worlds where a box has a share above 1."""


@dataclass(frozen=True, eq=False)
class Loads:
    """What :func:`loads` found.

    Attributes:
        run: the run's folder.
        boxes: a row a box of each world: ``load_share`` and what it is made of.
        plans: a row a world: ``overloaded``, and the box that bears most of its strength. Where the run has intervals
            of forces, ``surely_overloaded`` and ``possibly_overloaded``, too.
        notes: a line on a run that is not finished, and one on articles without strength.
    """

    run: Path
    boxes: pd.DataFrame
    plans: pd.DataFrame
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Loads({counted(len(self.plans), 'world')}, {int(self.plans['overloaded'].sum()):,} overloaded)"

    def write(self, folder: str | Path, overwrite: bool = False) -> None:
        """Write ``box_loads`` and ``plan_loads``, as Parquet with units and as CSV.

        Args:
            overwrite: tables that petmjx wrote there before may be replaced.

        Raises:
            InputError: the folder cannot be written, or a file of these names may not be replaced.
        """
        folder = path_of(folder, "folder")
        check_loads_free(folder, overwrite)
        with writing(folder):
            tables = (("box_loads", self.boxes, _BOX_UNITS), ("plan_loads", self.plans, _PLAN_UNITS))
            write_described(folder, tables)


def check_loads_free(folder: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Check that the tables of loads may be written into a folder; ``inputs`` are files that are read.

    Raises:
        InputError: as ``petmjx.results.described.check_tables_free``.
    """
    check_tables_free(folder, ("box_loads", "plan_loads"), overwrite=overwrite, inputs=inputs)


def loads(
    run: str | Path | RunResults,
    articles: PathArgument | Articles | None = None,
    plans: PlanSource | None = None,
) -> Loads:
    """Compare the forces on boxes at rest with what the boxes can bear.

    Args:
        run: a run's folder, or what ``petmjx.score`` returned.
        articles: table of strengths (``petmjx.plans.articles.read_articles``). For boxes that it does not cover, the
            plan's own values count, or the table of the run. None: those alone.
        plans: the plans of the run, for sizes and product groups; None: the files that the run names.

    Raises:
        InputError: no run, an unusable table of articles, no strength at all, or plans that are not those of the run.
    """
    results = run if isinstance(run, RunResults) else load_run(run)
    if articles is None:
        strengths = Articles({}, {})
    else:
        strengths = articles if isinstance(articles, Articles) else read_articles(path_of(articles, "articles"))
    of_run = _plans_of(results, plans)
    known, missing = _strengths(of_run.values(), strengths)
    if articles is None and known["strength_n"].isna().all():
        raise InputError(f"{results.path}: the plans have no strengths (strength_n): give a table of articles")
    shares = {force: share for force, share in _SHARES.items() if force in results.boxes}
    boxes = results.boxes[["plan_id", "variant", "box", "article", *shares]].astype(dict.fromkeys(shares, "float64"))
    boxes = boxes.merge(known, on=["plan_id", "box"], how="left", validate="many_to_one")
    boxes = boxes.assign(**{share: boxes[force] / boxes["strength_n"] for force, share in shares.items()})
    boxes = boxes[[name for name in _BOX_UNITS if name in boxes]]
    notes = (*results.doubts("the run"), *_notes(missing))
    return Loads(results.path, boxes, _of_worlds(results, boxes), notes)


def _plans_of(results: RunResults, plans: PlanSource | None) -> Mapping[str, Plan]:
    """The plans of a run by id.

    Raises:
        InputError: a plan is missing or differs.
    """
    records = Manifest.read(results.parts, results.info).plans
    found = find_plans(results, records, set(results.worlds["plan_id"]), plans)
    if plans is None and found.gone and found.missing:
        gone = printable(found.gone[0])
        raise InputError(f"{results.path}: needs the plans of the run, and {gone} is not there: name them")
    for plan_ids, what in (
        (found.missing, "is not among the plans that were read"),
        (found.changed, "differs from the one that was simulated there"),
    ):
        if plan_ids:
            raise InputError(f"{results.path}: plan {shown(plan_ids[0])} {what}")
    return found.plans


def _strengths(plans: Iterable[Plan], articles: Articles) -> tuple[pd.DataFrame, Counter[str]]:
    """The strength of each box, and the articles that have none with their numbers of boxes."""
    rows: dict[str, list[Any]] = {"plan_id": [], "box": [], "strength_n": []}
    missing: Counter[str] = Counter()
    for plan in plans:
        groups = plan.product_groups or ("",) * plan.n_boxes
        sizes = plan.size_mm[:, :2].tolist()
        materials = plan.materials or ("",) * plan.n_boxes
        own = np.full(plan.n_boxes, np.nan) if plan.strength_n is None else plan.strength_n
        names = zip(plan.articles, groups, materials, strict=True)
        for box, (article, group, material) in enumerate(names):
            said = articles.find(article, group, material).strength
            strength_n = float(own[box]) if said is None else said.of_box(*sizes[box])
            if np.isnan(strength_n):
                missing[article] += 1
            rows["plan_id"].append(plan.plan_id)
            rows["box"].append(box)
            rows["strength_n"].append(strength_n)
    return pd.DataFrame(rows).astype({"box": "int32", "strength_n": "float64"}), missing


def _of_worlds(results: RunResults, boxes: pd.DataFrame) -> pd.DataFrame:
    """A row a world."""
    key = ["plan_id", "variant"]
    said = {name: share for name, share in _OVER.items() if share in boxes}
    marked = boxes[key].assign(
        **{f"n_{name}": boxes[share] > 1 for name, share in said.items()},
        **{f"unknown_{name}": boxes[share].isna() for name, share in said.items()},
    )
    counts = marked.groupby(key, sort=False, as_index=False).sum()
    known = boxes.dropna(subset="load_share")
    largest = known.loc[known.groupby(key, sort=False)["load_share"].idxmax()]
    largest = largest[[*key, "box", "article", "load_share"]].rename(columns={"load_share": "max_load_share"})
    worlds = results.worlds[[*key, "verdict", "n_boxes"]]
    found = worlds.merge(counts, on=key, how="left").merge(largest, on=key, how="left")
    for name in said:
        over = (found[f"n_{name}"] > 0).astype("boolean")
        over[(found[f"n_{name}"] == 0) & (found[f"unknown_{name}"] > 0)] = pd.NA
        found[name] = over
    found["n_unknown"] = found["unknown_overloaded"]
    found["box"] = found["box"].astype("Int32")
    return found[[name for name in _PLAN_UNITS if name in found]]


def _notes(missing: Mapping[str, int]) -> list[str]:
    if not missing:
        return []
    most = sorted(missing, key=lambda name: (-missing[name], name))
    verb = "has" if len(most) == 1 else "have"
    boxes = counted(sum(missing.values()), "box", "boxes")
    return [f"{counted(len(most), 'article')} of {boxes} {verb} no strength: {first_names(most, _MOST_NAMED)}"]
