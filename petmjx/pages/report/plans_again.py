"""The plans of a run, found again: its tables have no sizes of boxes, which pictures and weights need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from petmjx.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.plans.read import load_plans
from petmjx.plans.samples import bundled_path
from petmjx.results.manifest import Manifest, plan_digest
from petmjx.results.reader import RunResults
from petmjx.text import counted, shown

MOST_FILES_NAMED: Final = 2


@dataclass(frozen=True, eq=False)
class FoundPlans:
    """Plans of a run by id, and a line about those that were not found; "" where all were."""

    plans: Mapping[str, Plan]
    note: str = ""


def find_plans_again(run: RunResults, given: Sequence[Path] = ()) -> FoundPlans:
    """Read the plans of a run from the files that it names. Only plans that are what the run simulated are taken.

    Args:
        given: files or folders to read instead.

    Raises:
        InputError: one of ``given`` cannot be used.
    """
    try:
        manifest = Manifest.read(run.path, run.info)
    except InputError as error:
        return FoundPlans({}, str(error))
    named = dict.fromkeys(record.source for record in manifest.plans.values())
    sources = list(given) or [Path(source) for source in named]
    if not given:
        # bundled plans may have been elsewhere, on another machine
        bundled = bundled_path()
        sources = [bundled if source.name == bundled.name and not source.is_file() else source for source in sources]
    there = [source for source in sources if given or source.is_file()]
    read = load_plans(there).plans if there else []
    known = {plan_id: record.digest for plan_id, record in manifest.plans.items()}
    same = {plan.plan_id: plan for plan in read if known.get(plan.plan_id) == plan_digest(plan)}
    wanted = set(run.worlds["plan_id"])
    missing = len(wanted - same.keys())
    if not missing:
        return FoundPlans(same)
    changed = sum(plan.plan_id in wanted and plan.plan_id not in same for plan in read)
    gone = [shown(str(source)) for source in sources if source not in there]
    why = [f"{counted(changed, 'plan')} changed since"] if changed else []
    if gone:
        more = f" and {len(gone) - MOST_FILES_NAMED:,} more" if len(gone) > MOST_FILES_NAMED else ""
        why.append(f"gone: {', '.join(gone[:MOST_FILES_NAMED])}{more}")
    told = f" ({'; '.join(why)})" if why else ""
    return FoundPlans(same, f"{counted(missing, 'plan')} of {len(wanted):,} not found again{told}")
