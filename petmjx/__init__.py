"""petmjx: the stability of pallet packing plans, scored by physics, many thousands at a time.

Names are imported when first used, so that ``import petmjx`` is quick and reading results never loads a simulator.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from petmjx.version import __version__

if TYPE_CHECKING:
    from petmjx.api import score, sweep
    from petmjx.basics.errors import EngineUnavailable, InputError, PetmjxError, PlanWarning
    from petmjx.figures.save import figure
    from petmjx.free_motion import Trajectories, release
    from petmjx.history import History
    from petmjx.loop.pallets import Pallets
    from petmjx.loop.scorer import Scored, Scorer
    from petmjx.loop.told import Told
    from petmjx.options.carrier import Carrier
    from petmjx.options.config import Check, Quiet, Schedule, Simulation, Solver, Thresholds
    from petmjx.options.physics import PHYSICS, Cone, Physics
    from petmjx.options.run_options import RunOptions
    from petmjx.packers.compare import compare_packers
    from petmjx.packing.pack import Packed, pack
    from petmjx.pages.leaderboard.make import leaderboard
    from petmjx.pages.report.make import report
    from petmjx.pages.told import tell
    from petmjx.pictures.save import draw
    from petmjx.plans.plan import Plan
    from petmjx.plans.plan_set import PlanSet
    from petmjx.plans.read import load_plans
    from petmjx.plans.samples.online.placement import placement_stability
    from petmjx.plans.write import save_plans
    from petmjx.rating.kpis import kpis
    from petmjx.results.compare import compare_runs
    from petmjx.results.loads import loads
    from petmjx.results.reader import RunResults, load_run
    from petmjx.statics.record import CriteriaResults
    from petmjx.statics.run import criteria
    from petmjx.story.tell import Story
    from petmjx.sweeps.merge import merge_runs

_HOME = {
    "score": "petmjx.api",
    "sweep": "petmjx.api",
    "criteria": "petmjx.statics.run",
    "CriteriaResults": "petmjx.statics.record",
    "Carrier": "petmjx.options.carrier",
    "Check": "petmjx.options.config",
    "Cone": "petmjx.options.physics",
    "PHYSICS": "petmjx.options.physics",
    "Physics": "petmjx.options.physics",
    "Quiet": "petmjx.options.config",
    "RunOptions": "petmjx.options.run_options",
    "Schedule": "petmjx.options.config",
    "Simulation": "petmjx.options.config",
    "Solver": "petmjx.options.config",
    "Thresholds": "petmjx.options.config",
    "EngineUnavailable": "petmjx.basics.errors",
    "InputError": "petmjx.basics.errors",
    "PetmjxError": "petmjx.basics.errors",
    "PlanWarning": "petmjx.basics.errors",
    "History": "petmjx.history",
    "figure": "petmjx.figures.save",
    "Pallets": "petmjx.loop.pallets",
    "Scored": "petmjx.loop.scorer",
    "Scorer": "petmjx.loop.scorer",
    "Told": "petmjx.loop.told",
    "draw": "petmjx.pictures.save",
    "report": "petmjx.pages.report.make",
    "Plan": "petmjx.plans.plan",
    "PlanSet": "petmjx.plans.plan_set",
    "load_plans": "petmjx.plans.read",
    "placement_stability": "petmjx.plans.samples.online.placement",
    "compare_packers": "petmjx.packers.compare",
    "compare_runs": "petmjx.results.compare",
    "Story": "petmjx.story.tell",
    "tell": "petmjx.pages.told",
    "save_plans": "petmjx.plans.write",
    "kpis": "petmjx.rating.kpis",
    "leaderboard": "petmjx.pages.leaderboard.make",
    "Trajectories": "petmjx.free_motion",
    "release": "petmjx.free_motion",
    "loads": "petmjx.results.loads",
    "Packed": "petmjx.packing.pack",
    "pack": "petmjx.packing.pack",
    "merge_runs": "petmjx.sweeps.merge",
    "RunResults": "petmjx.results.reader",
    "load_run": "petmjx.results.reader",
}
"""Public name → the module that has it."""

__all__ = [
    "PHYSICS",
    "Carrier",
    "Check",
    "Cone",
    "CriteriaResults",
    "EngineUnavailable",
    "History",
    "InputError",
    "Packed",
    "Pallets",
    "PetmjxError",
    "Physics",
    "Plan",
    "PlanSet",
    "PlanWarning",
    "Quiet",
    "RunOptions",
    "RunResults",
    "Schedule",
    "Scored",
    "Scorer",
    "Simulation",
    "Solver",
    "Story",
    "Thresholds",
    "Told",
    "Trajectories",
    "__version__",
    "compare_packers",
    "compare_runs",
    "criteria",
    "draw",
    "figure",
    "kpis",
    "leaderboard",
    "load_plans",
    "load_run",
    "loads",
    "merge_runs",
    "pack",
    "placement_stability",
    "release",
    "report",
    "save_plans",
    "score",
    "sweep",
    "tell",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
