"""The plans of a run for its report, as far as they are found again: pictures and weights need them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from petmjx.basics.errors import InputError
from petmjx.basics.text import counted, first_names
from petmjx.plans.plan import Plan
from petmjx.results.manifest import Manifest
from petmjx.results.plans_again import PlansAgain, find_plans
from petmjx.results.reader import RunResults

MOST_FILES_NAMED: Final = 2


@dataclass(frozen=True, eq=False)
class FoundPlans:
    """Plans of a run by id, and a line about those that were not found; "" where all were."""

    plans: Mapping[str, Plan]
    note: str = ""


def find_plans_again(run: RunResults, given: Sequence[Path] = ()) -> FoundPlans:
    """The plans of a run. A report is also made without them.

    Args:
        given: files or folders to read instead of those that the run names.

    Raises:
        InputError: one of ``given`` cannot be used.
    """
    try:
        records = Manifest.read(run.parts, run.info).plans
    except InputError as error:
        return FoundPlans({}, str(error))
    plan_ids = set(run.worlds["plan_id"].unique())
    plans_again = find_plans(run, records, plan_ids, list(given) or None)
    return FoundPlans(plans_again.plans, _note(plans_again, len(plan_ids)))


def _note(plans_again: PlansAgain, n_plans: int) -> str:
    not_found = len(plans_again.missing) + len(plans_again.changed)
    if not not_found:
        return ""
    why = [f"{counted(len(plans_again.changed), 'plan')} changed since"] if plans_again.changed else []
    if plans_again.gone:
        why.append(f"gone: {first_names(plans_again.gone, MOST_FILES_NAMED)}")
    reasons = f" ({'; '.join(why)})" if why else ""
    return f"{counted(not_found, 'plan')} of {n_plans:,} not found again{reasons}"
