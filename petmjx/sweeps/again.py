"""Finds again what a run was of: its plans in the files that it names, and its sweep from what ``run.json`` says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from petmjx.checked import similar
from petmjx.config import Simulation
from petmjx.errors import InputError
from petmjx.plans.gather import PlanSource, find_plan, gather_plans
from petmjx.plans.plan import Plan
from petmjx.results.files import RUN_FILE
from petmjx.results.manifest import Manifest, plan_digest
from petmjx.results.plans_again import file_again, how_read
from petmjx.results.reader import RunResults
from petmjx.sweeps.confidence import confidence_sweep
from petmjx.sweeps.file import Sweep, load_sweep, nominal_sweep
from petmjx.sweeps.identity import sweep_identity
from petmjx.sweeps.ready import find_sweep
from petmjx.text import counted, printable, shown


def plan_of_run(run: RunResults, plan_id: str, plans: PlanSource | None = None) -> Plan:
    """A plan as the run had it.

    Args:
        plans: where to look for it; None: the file that the run read it from.

    Raises:
        InputError: the run has no such plan, its file is gone, or it has changed since.
    """
    manifest = Manifest.read(run.path, run.info)
    if plan_id not in manifest.plans:
        among = f"is not among its {counted(len(manifest.plans), 'plan')}{similar(plan_id, manifest.plans)}"
        raise InputError(f"{run.path}: plan {shown(plan_id)} {among}")
    known = manifest.plans[plan_id]
    given = plans or _file(run, plan_id, known.source)
    plan = find_plan(gather_plans(given, Simulation(), how_read(run.info)), plan_id)
    if plan_digest(plan) != known.digest:
        raise InputError(f"{plan.source}: plan {shown(plan_id)} is not the one that {run.path} was made of: it changed")
    return plan


def _file(run: RunResults, plan_id: str, source: str) -> Path:
    file = file_again(source)
    if file is None:
        gone = f"plan {shown(plan_id)} came from {printable(source)}, which is not there: name its file"
        raise InputError(f"{run.path}: {gone}")
    return file


def sweep_of_run(run: RunResults) -> Sweep:
    """The sweep of a run; of a score the nominal one.

    Raises:
        InputError: its file is gone or has changed since, or ``run.json`` is damaged.
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
    try:
        named = Path(config["sweep"]["file"])
        found = named if named.is_file() else find_sweep(named.stem)
    except (TypeError, KeyError, InputError):
        raise InputError(f"{run.path}: the sweep file it was made of is not there") from None
    changes = dict(sim)
    worlds = config.get("confidence")
    sweep = confidence_sweep(worlds, found, changes) if worlds else load_sweep(found, True, changes)
    if sweep_identity(sweep) != _identity(run.info):
        raise InputError(f"{found}: is not the sweep that {run.path} was made of: it changed")
    return sweep


def _identity(info: Mapping[str, Any]) -> Any:
    return info["identity"].get("sweep")
