"""Makes the plans and the sweep of an earlier run again, from the files that the run names or from the run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from petmjx.common.checked_records import similar
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PlanSource, find_plan, gather_plans
from petmjx.results.plan_digests import plan_digest
from petmjx.results.plan_lookup import how_read, plan_file
from petmjx.results.run_folder import RUN_FILE
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults, is_chain
from petmjx.results.stored_plans import kept_plans
from petmjx.runs.confidence import PLACING, confidence_sweep
from petmjx.runs.ready_sweeps import find_sweep
from petmjx.runs.sweep_design import sweep_identity
from petmjx.runs.sweep_file import Sweep, chain_sweep, load_sweep, nominal_sweep, sweep_of_tables
from petmjx.runs.sweep_worlds import SweepPlan


def plan_of_run(run: RunResults, plan_id: str, plans: PlanSource | None = None) -> Plan:
    """A plan, exactly as the run simulated it.

    Args:
        plans: source of the plan. If ``plans`` is None, the plan is taken from the first of these sources that has it:
            the plan objects that the run holds, the run's table of plans, the input file.

    Raises:
        InputError: the run has no such plan, or the plan's file no longer exists or has changed.
    """
    manifest = Manifest.read(run.parts, run.info)
    if plan_id not in manifest.plans:
        among = f"is not among its {count_text(len(manifest.plans), 'plan')}{similar(plan_id, manifest.plans)}"
        raise InputError(f"{run.path}: plan {printable_name(plan_id)} {among}")
    record = manifest.plans[plan_id]
    if plans is None:
        of_run = run.plans_in_memory
        stored_plans = of_run if plan_id in of_run else kept_plans(run.parts, manifest.plans, [plan_id])
        if plan_id in stored_plans:
            return stored_plans[plan_id]
        plans = _file(run, plan_id, record.source)
    plan = find_plan(gather_plans(plans, Simulation(), how_read(run.info)), plan_id)
    if plan_digest(plan) != record.digest:
        raise InputError(f"{plan.source}: plan {printable_name(plan_id)} has changed since {run.path} simulated it")
    return plan


def _file(run: RunResults, plan_id: str, source: str) -> Path:
    file = plan_file(source)
    if file is None:
        name = printable_name(plan_id)
        missing_text = (
            f"plan {name} came from {printable(source)}, which no longer exists: give the file that now has the plan, "
            "or the plan itself"
        )
        raise InputError(f"{run.path}: {missing_text}")
    return file


def worlds_of_run(
    run: RunResults, plan_id: str, plans: PlanSource | None = None, variant: int | None = None
) -> tuple[SweepPlan, int]:
    """The sweep of a run, restricted to one plan, and the number of the requested variant. If ``variant`` is None, the
    number is 0 (the nominal world, which is the unchanged plan).

    Raises:
        InputError: the variant does not exist, or :func:`plan_of_run` or :func:`sweep_of_run` raises an error.
    """
    sweep, plan = sweep_of_run(run), plan_of_run(run, plan_id, plans)
    if variant is None and not sweep.nominal:
        raise InputError(
            f"{run.path}: plan {printable_name(plan_id)} has several worlds: name a variant (column `variant` of "
            "the table `worlds`)"
        )
    worlds = SweepPlan(sweep, [plan])
    if variant is not None:
        try:
            worlds.find(plan_id, variant)
        except InputError as error:  # the message of ``find`` names a sweep file, which a score does not have
            raise InputError(f"{run.path}: plan {printable_name(plan_id)} has no variant {variant}") from error
    return worlds, variant or 0


def sweep_of_run(run: RunResults) -> Sweep:
    """The sweep of a run. For a plain score, this is a sweep whose only variant is the unchanged plan.

    Raises:
        InputError: the file of the sweep no longer exists or has changed, or ``run.json`` is damaged.
    """
    config, file = run.info["config"], run.path / RUN_FILE
    if not isinstance(config.get("simulation"), Mapping):
        raise InputError(f"{file}: damaged: config.simulation is missing")
    try:
        sim = Simulation.read(config["simulation"])
    except InputError as error:
        raise InputError(f"{file}: damaged: config.simulation.{error}") from None
    if "sweep" not in config:
        return nominal_sweep(sim)
    changes, worlds = dict(sim), config.get("confidence")
    try:
        sweep_path, tables = Path(config["sweep"]["file"]), config["sweep"].get("tables")
    except (TypeError, KeyError, AttributeError):
        raise InputError(f"{file}: damaged: config.sweep.file is missing") from None
    if isinstance(tables, dict):
        # The stored tables cannot be used if the file of a profile is gone. Then the sweep's own file is tried below.
        with suppress(InputError):
            stored_sweep = sweep_of_tables(tables, sweep_path, True, changes)
            stored_sweep = (
                stored_sweep.model_copy(update={"nominal": True, "replicates": worlds}) if worlds else stored_sweep
            )
            if sweep_identity(stored_sweep) == _identity(run.info):
                return stored_sweep
    try:
        sweep_file = sweep_path if sweep_path.is_file() else find_sweep(sweep_path.stem)
    except InputError:
        raise InputError(f"{run.path}: the sweep file from which the run was made no longer exists") from None
    has_both_ways = PLACING in config["sweep"].get("axes", {})  # the option ``exact_too`` adds the axis ``placing``
    sweep = (
        chain_sweep(sweep_file, worlds, changes)
        if is_chain(run.info) and worlds
        else confidence_sweep(worlds, sweep_file, changes, exact_too=has_both_ways)
        if worlds
        else load_sweep(sweep_file, True, changes)
    )
    if sweep_identity(sweep) != _identity(run.info):
        raise InputError(f"{sweep_file}: the sweep file has changed since the run {run.path} was made")
    return sweep


def _identity(info: Mapping[str, Any]) -> Any:
    return info["identity"].get("sweep")
