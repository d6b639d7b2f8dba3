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
    wanted = set(run.worlds["plan_id"].unique())
    found = find_plans(run, records, wanted, list(given) or None)
    return FoundPlans(found.plans, _note(found, len(wanted)))


def _note(found: PlansAgain, wanted: int) -> str:
    not_found = len(found.missing) + len(found.changed)
    if not not_found:
        return ""
    why = [f"{counted(len(found.changed), 'plan')} changed since"] if found.changed else []
    if found.gone:
        why.append(f"gone: {first_names(found.gone, MOST_FILES_NAMED)}")
    told = f" ({'; '.join(why)})" if why else ""
    return f"{counted(not_found, 'plan')} of {wanted:,} not found again{told}"
