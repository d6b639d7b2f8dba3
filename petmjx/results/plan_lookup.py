"""Finds the plans of a run again, in the run's table ``placements`` or in the files from which the plans were read.

Other tables of a run do not have the sizes of boxes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeGuard

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.options.run_options import READING, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.bundled import bundled_path
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet, Skipped
from petmjx.plans.plan_sources import PlanSource, gather_plans
from petmjx.results.plan_digests import PlanRecord, plan_digest
from petmjx.results.run_folder import RUN_FILE
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults, load_run
from petmjx.results.stored_plans import kept_plans


@dataclass(frozen=True, eq=False)
class PlanLookup:
    """Which plans of a run were found, which are missing, and which have changed since the run.

    Attributes:
        plans: plan id → plan, for the plans that were found and are equal to the simulated plans.
        missing: ids of the plans that were not found, sorted.
        changed: ids of the plans that exist but differ from the simulated plan, sorted.
        gone: files from which the run read plans, but which no longer exist.
    """

    plans: Mapping[str, Plan]
    missing: tuple[str, ...]
    changed: tuple[str, ...]
    gone: tuple[str, ...]


def find_plans(
    run: RunResults,
    records: Mapping[str, PlanRecord],
    wanted: Collection[str],
    given: PlanSource | None = None,
) -> PlanLookup:
    """Find the plans of a run. A plan counts as found only if it is equal to the plan that the run simulated.

    Args:
        records: plan id → the run's record of the plan. A plan without a record is accepted without a check.
        wanted: ids of the plans to find.
        given: the source from which the plans are read now. If ``given`` is None, plans are taken from the first of
            these sources that has them: the plan objects of the run, the run's table ``placements``, the files that the
            table ``plans`` names.

    Raises:
        InputError: the source ``given`` is unusable.
    """
    plans: dict[str, Plan] = {}
    gone: list[str] = []
    if given is None:
        plans = {plan_id: run.plans_in_memory[plan_id] for plan_id in wanted if plan_id in run.plans_in_memory}
        if len(plans) < len(wanted):
            plans |= kept_plans(run.parts, records, [plan_id for plan_id in wanted if plan_id not in plans])
        left = [records[plan_id] for plan_id in wanted if plan_id not in plans and plan_id in records]
        files = {source: plan_file(source) for source in dict.fromkeys(record.source for record in left)}
        gone = [source for source, file in files.items() if file is None]
        given = [file for file in files.values() if file is not None]
    if not isinstance(given, list) or given:
        plans = {plan.plan_id: plan for plan in gather_plans(given, Simulation(), how_read(run.info))} | plans
    plans = {plan_id: plans[plan_id] for plan_id in wanted if plan_id in plans}
    changed = {name for name, plan in plans.items() if name in records and records[name].digest != plan_digest(plan)}
    return PlanLookup(
        plans={plan_id: plan for plan_id, plan in plans.items() if plan_id not in changed},
        missing=tuple(sorted(set(wanted) - plans.keys())),
        changed=tuple(sorted(changed)),
        gone=tuple(gone),
    )


def plans_in_place(plans: PlanSource | None, strict: bool = False) -> PlanSource | None:
    """The argument ``plans``, in which folders of runs are replaced by plans: if ``plans`` is a run's folder, or a list
    of such folders, the result is the plans that these runs simulated. Any other source is returned unchanged.

    Raises:
        InputError: a run cannot be read, or none of its plans can be found in its tables or in a file. With ``strict``,
            a single missing plan is an error, too.
    """
    several: Any = [plans] if isinstance(plans, str | PathLike) else plans
    if not isinstance(several, list | tuple) or not several or not all(map(is_run, several)):
        return plans
    sets = [plans_of(load_run(path), strict) for path in several]
    if len(sets) == 1:
        return sets[0]
    return PlanSet(
        [plan for plan_set in sets for plan in plan_set], [skip for plan_set in sets for skip in plan_set.skipped]
    )


def is_run(source: object) -> TypeGuard[str | PathLike[str]]:
    """Whether a source of plans is the folder of a run."""
    try:
        return isinstance(source, str | PathLike) and (Path(source) / RUN_FILE).is_file()
    except (OSError, ValueError):  # the function that reads the source reports the error
        return False


def plans_of(run: RunResults, strict: bool = False) -> PlanSet:
    """The plans that a run simulated. Plans that cannot be found are listed as skipped.

    Raises:
        InputError: the run lists no plans, or none of them can be found. With ``strict``, a single missing plan is an
            error, too.
    """
    records = Manifest.read(run.parts, run.info).plans
    simulated = set(run.worlds["plan_id"])
    lookup = find_plans(run, records, [plan_id for plan_id in records if plan_id in simulated])
    skipped = [
        Skipped(records[plan_id].source, plan_id, f"{run.path}: plan {printable_name(plan_id)} {reason}")
        for plan_ids, reason in (
            (lookup.missing, "is neither in the run nor in a file any more"),
            (lookup.changed, "has changed since the run simulated it"),
        )
        for plan_id in plan_ids
    ]
    if strict and skipped:
        raise InputError(skipped[0].message)
    if not lookup.plans:
        first = f"; the first: {skipped[0].message}" if skipped else ""
        raise InputError(f"{run.path}: none of the run's plans can be found{first}")
    return PlanSet([lookup.plans[plan_id] for plan_id in records if plan_id in lookup.plans], skipped)


def how_read(info: Mapping[str, Any]) -> RunOptions:
    """The options with which a run read its plans, such as units, anchor and articles.

    Raises:
        InputError: the options are damaged.
    """
    config = info.get("config", {})
    return RunOptions(**{name: config[name] for name in (*READING, "articles") if name in config})


def plan_file(source: str) -> Path | None:
    """The file from which a plan was read; None if the file no longer exists. For a bundled plan, the result is the
    path of the bundled file on this machine."""
    file, bundled = Path(source), bundled_path()
    if file.is_file():
        return file
    return bundled if file.name == bundled.name else None
