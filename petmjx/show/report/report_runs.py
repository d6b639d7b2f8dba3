"""The runs of a report: their plans, and their tables with additional columns that are computed from the plans."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pandas as pd

from petmjx.analysis.run_comparison import KEY
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable
from petmjx.common.units import MM_PER_M
from petmjx.plans.plan import Plan
from petmjx.results.plan_lookup import PlanLookup, find_plans
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults, boxes_of_worlds, is_chain, opened_run
from petmjx.results.share_statistics import ALL_PLANS, share_standing
from petmjx.runs.chain_legs import AS_IS

MOST_FILES_NAMED: Final = 2


@dataclass(frozen=True, eq=False)
class ReportPlans:
    """The plans of a run by their ids, and a note about plans that were not found; "" if all plans were found."""

    plans: Mapping[str, Plan]
    note: str = ""


def find_report_plans(run: RunResults, paths: Sequence[Path] = ()) -> ReportPlans:
    """Find the plans of a run. A report can also be made without plans.

    Args:
        paths: files or folders with the plans. If none are given, the files that the run names are read.

    Raises:
        InputError: one of ``paths`` is unusable.
    """
    try:
        records = Manifest.read(run.parts, run.info).plans
    except InputError as error:
        return ReportPlans({}, str(error))
    plan_ids = set(run.worlds["plan_id"].unique())
    plans_again = find_plans(run, records, plan_ids, list(paths) or None)
    return ReportPlans(plans_again.plans, _note(plans_again, len(plan_ids)))


def _note(plans_again: PlanLookup, n_plans: int) -> str:
    not_found = len(plans_again.missing) + len(plans_again.changed)
    if not not_found:
        return ""
    why = [f"{count_text(len(plans_again.changed), 'plan')} changed since"] if plans_again.changed else []
    if plans_again.gone:
        why.append(f"gone: {first_names(plans_again.gone, MOST_FILES_NAMED)}")
    reasons = f" ({'; '.join(why)})" if why else ""
    return f"{count_text(not_found, 'plan')} of {n_plans:,} not found again{reasons}"


class Kind(StrEnum):
    """The kind of a run: a score of plans, a sweep over variants of plans, a search for the largest level survived, and
    so on."""

    SCORE = "score"
    CONFIDENCE = "confidence"
    GRID = "sweep"
    SEARCH = "search"
    CHAIN = "chain"

    @property
    def sweeps(self) -> bool:
        """Whether the report shows several worlds of each plan."""
        return self in (Kind.GRID, Kind.SEARCH, Kind.CHAIN)


@dataclass(frozen=True, eq=False)
class ReportRun:
    """A run in a report.

    Attributes:
        name: name of the run in the report.
        results: results of the run.
        plan_files: plans of the run that were found.
    """

    name: str
    results: RunResults
    plan_files: ReportPlans

    @property
    def info(self) -> dict[str, Any]:
        """The content of ``run.json``."""
        return self.results.info

    @cached_property
    def kind(self) -> Kind:
        """The kind of the run."""
        config = self.info.get("config", {})
        if is_chain(self.info):
            return Kind.CHAIN
        if config.get("command") == "sweep":
            return Kind.SEARCH if (config.get("sweep") or {}).get("search") is not None else Kind.GRID
        return Kind.CONFIDENCE if config.get("confidence") is not None else Kind.SCORE

    @property
    def what(self) -> str:
        """The word for a world in texts for users: "plan" for scores, "world" for sweeps and chains."""
        return "plan" if self.kind in (Kind.SCORE, Kind.CONFIDENCE) else "world"

    @cached_property
    def worlds(self) -> pd.DataFrame:
        """The worlds that the report shows, with a row for each world, sorted by plan and variant.

        Usually, the report shows all worlds of the run. For a score with confidence, the report shows the nominal
        worlds (without errors). For a chain, the report shows the worlds without a remedy.

        There are three additional columns. ``height_m`` and ``mass_kg`` describe the plan's load (NaN if the plan was
        not found). ``first_article`` is the article of the first box to fail ("" if no box failed).
        """
        worlds = self.results.worlds
        if self.kind is Kind.CONFIDENCE:
            worlds = worlds[worlds["variant"] == 0]
        if self.kind is Kind.CHAIN:
            worlds = worlds[worlds["remedy"] == AS_IS]
        worlds = worlds.sort_values(KEY, kind="stable", ignore_index=True)
        plan_id, plans = worlds["plan_id"], self.plan_files.plans
        heights_mm = {name: float((plan.corner_mm + plan.size_mm)[:, 2].max()) for name, plan in plans.items()}
        masses_kg = {name: float(plan.mass_kg.sum()) for name, plan in plans.items()}
        return worlds.assign(
            height_m=plan_id.map(heights_mm).astype("float64") / MM_PER_M,
            mass_kg=plan_id.map(masses_kg).astype("float64"),
            first_article=self._first_articles(worlds),
        )

    def _first_articles(self, worlds: pd.DataFrame) -> list[str]:
        """The article of the first box to fail in each world; "" if no box failed."""
        articles = self.articles(set(worlds.loc[worlds["culprit"].notna(), "plan_id"]))
        culprits = worlds["culprit"].fillna(-1).astype("int64")
        return [
            articles[plan_id][box] if box >= 0 and plan_id in articles else ""
            for plan_id, box in zip(worlds["plan_id"], culprits, strict=True)
        ]

    def articles(self, plan_ids: Collection[str]) -> dict[str, Sequence[str]]:
        """Id of a plan → articles of the plan's boxes, in packing order. Articles come from the plan or, if the plan
        was not found, from the table ``boxes``. An id is missing in the result if its plan was not found and the table
        has no rows of it."""
        articles_by_plan: dict[str, Sequence[str]] = {
            plan_id: plan.articles for plan_id, plan in self.plan_files.plans.items() if plan_id in plan_ids
        }
        missing = {*plan_ids} - {*articles_by_plan}
        if missing and self.results.keeps_boxes:
            worlds = self.results.worlds[KEY]
            first = worlds[worlds["plan_id"].isin(missing)].drop_duplicates("plan_id")
            boxes = boxes_of_worlds(self.results, first, ("plan_id", "article"))
            articles_by_plan |= {str(plan_id): rows.tolist() for plan_id, rows in boxes.groupby("plan_id")["article"]}
        return articles_by_plan

    @cached_property
    def axes(self) -> list[str]:
        """Names of the columns of ``worlds`` with those axes that have several values in the sweep."""
        if self.shares is None:
            return []
        overall = self.shares[self.shares["scope"] == ALL_PLANS]
        several = overall["axis"].value_counts()
        return [axis for axis in overall["axis"].unique() if axis and several[axis] > 1]

    @cached_property
    def shares(self) -> pd.DataFrame | None:
        """The shares of worlds that stand in a sweep, from the run's table ``summary``. The result is None for any
        other kind of run."""
        summary = self.results.summary
        if self.kind is not Kind.GRID or summary is None or "scope" in summary:
            return summary if self.kind is Kind.GRID else None
        # The table of petmjx 0.1 has no column "scope", so the shares are computed from the worlds.
        axes = [axis for axis in summary["axis"].unique() if axis in self.worlds]
        return share_standing(self.worlds, axes)

    @property
    def parameters(self) -> list[str]:
        """Names of the columns that ``worlds`` has because of the variants of this run."""
        return [str(param["name"]) for param in self.info.get("params", [])]


def open_runs(folders: Sequence[str | Path | RunResults], plans: Sequence[Path] = ()) -> list[ReportRun]:
    """Open the runs of a report.

    Args:
        folders: folders of runs, or results.
        plans: files with the plans of the runs. If none are given, the files that the runs name are read.

    Raises:
        InputError: there is no folder, a folder has no run, the same run is given twice, or a run is damaged.
    """
    if not folders:
        raise InputError("no run to report on: name the folders of runs")
    results = [opened_run(folder) for folder in folders]
    paths = [run.path.resolve() for run in results]
    for at, path in enumerate(paths):
        if path in paths[:at]:
            raise InputError(f"{results[at].path}: named twice")
    for run in results:
        if run.worlds.duplicated(KEY).any():
            raise InputError(
                f"{run.path}: the run has the same plan and variant more than once, so it cannot be reported"
            )
    names = distinct_path_ends(paths)
    return [
        ReportRun(printable(name), run, find_report_plans(run, plans)) for name, run in zip(names, results, strict=True)
    ]


def distinct_path_ends(paths: Sequence[Path]) -> list[str]:
    """The last parts of each path, such as "fast/run" and "slow/run". Each name has as few parts as needed to make all
    names different."""
    names: list[str] = []
    for depth in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(names):
            break
    return names
