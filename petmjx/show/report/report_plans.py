"""Finds the plans of a run again. A report needs the plans for 3D pictures and for the weights of loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names
from petmjx.plans.plan import Plan
from petmjx.results.plan_lookup import PlanLookup, find_plans
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults

MOST_FILES_NAMED: Final = 2


@dataclass(frozen=True, eq=False)
class ReportPlans:
    """The plans of a run by their ids, and a note about plans that were not found; "" if all plans were found."""

    plans: Mapping[str, Plan]
    note: str = ""


def find_report_plans(run: RunResults, paths: Sequence[Path] = ()) -> ReportPlans:
    """Find the plans of a run. A report can also be made without plans.

    Args:
        run: the run.
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
