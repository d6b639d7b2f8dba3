"""petmjx scores pallet packing plans by physics: it simulates many thousands of plans and finds which of them stand.

Names are imported when first used, so that ``import petmjx`` is quick and reading results never loads a simulator.
"""

from __future__ import annotations

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from petmjx.version import __version__

if TYPE_CHECKING:
    from petmjx.analysis.box_loads import loads
    from petmjx.analysis.criteria_run import CriteriaResults, criteria
    from petmjx.analysis.kpis import kpis
    from petmjx.analysis.packer_comparison import compare_packers
    from petmjx.analysis.run_comparison import compare_runs
    from petmjx.analysis.story import Story
    from petmjx.api import score, sweep
    from petmjx.common.errors import EngineUnavailable, InputError, PetmjxError, PlanWarning
    from petmjx.loop.pallets import Pallets
    from petmjx.loop.placement_results import PlacementResults
    from petmjx.loop.released_boxes import Trajectories, release
    from petmjx.loop.scorer import Scored, Scorer
    from petmjx.options.carriers import Carrier
    from petmjx.options.physics import PHYSICS, Cone, Physics
    from petmjx.options.quiet import Quiet
    from petmjx.options.run_options import RunOptions
    from petmjx.options.simulation import Check, Schedule, Simulation, Solver
    from petmjx.options.thresholds import Thresholds
    from petmjx.packers.learned_packer import placement_stability
    from petmjx.packers.pack import pack
    from petmjx.packers.packed_orders import Packed
    from petmjx.plans.plan import Plan
    from petmjx.plans.plan_reader import load_plans
    from petmjx.plans.plan_set import PlanSet
    from petmjx.plans.plan_writer import save_plans
    from petmjx.repairs.repair import Repaired, Repairs, repair
    from petmjx.results.run_reader import RunResults, load_run
    from petmjx.runs.merge import merge_runs
    from petmjx.show.figures.figure_files import figure
    from petmjx.show.leaderboard.leaderboard import leaderboard
    from petmjx.show.pages.story_page import tell
    from petmjx.show.pictures.picture_files import draw
    from petmjx.show.report.report_page import report
    from petmjx.world.history import History

_HOME = {
    "score": "petmjx.api",
    "sweep": "petmjx.api",
    "criteria": "petmjx.analysis.criteria_run",
    "CriteriaResults": "petmjx.analysis.criteria_run",
    "Carrier": "petmjx.options.carriers",
    "Check": "petmjx.options.simulation",
    "Cone": "petmjx.options.physics",
    "PHYSICS": "petmjx.options.physics",
    "Physics": "petmjx.options.physics",
    "Quiet": "petmjx.options.simulation",
    "RunOptions": "petmjx.options.run_options",
    "Schedule": "petmjx.options.simulation",
    "Simulation": "petmjx.options.simulation",
    "Solver": "petmjx.options.simulation",
    "Thresholds": "petmjx.options.simulation",
    "EngineUnavailable": "petmjx.common.errors",
    "InputError": "petmjx.common.errors",
    "PetmjxError": "petmjx.common.errors",
    "PlanWarning": "petmjx.common.errors",
    "History": "petmjx.world.history",
    "figure": "petmjx.show.figures.figure_files",
    "Pallets": "petmjx.loop.pallets",
    "Scored": "petmjx.loop.scorer",
    "Scorer": "petmjx.loop.scorer",
    "draw": "petmjx.show.pictures.picture_files",
    "report": "petmjx.show.report.report_page",
    "Plan": "petmjx.plans.plan",
    "PlanSet": "petmjx.plans.plan_set",
    "load_plans": "petmjx.plans.plan_reader",
    "placement_stability": "petmjx.packers.learned_packer",
    "compare_packers": "petmjx.analysis.packer_comparison",
    "compare_runs": "petmjx.analysis.run_comparison",
    "Story": "petmjx.analysis.story",
    "tell": "petmjx.show.pages.story_page",
    "save_plans": "petmjx.plans.plan_writer",
    "kpis": "petmjx.analysis.kpis",
    "leaderboard": "petmjx.show.leaderboard.leaderboard",
    "PlacementResults": "petmjx.loop.placement_results",
    "Trajectories": "petmjx.loop.released_boxes",
    "release": "petmjx.loop.released_boxes",
    "loads": "petmjx.analysis.box_loads",
    "Packed": "petmjx.packers.packed_orders",
    "pack": "petmjx.packers.pack",
    "merge_runs": "petmjx.runs.merge",
    "repair": "petmjx.repairs.repair",
    "Repaired": "petmjx.repairs.repair",
    "Repairs": "petmjx.repairs.repair",
    "RunResults": "petmjx.results.run_reader",
    "load_run": "petmjx.results.run_reader",
}
"""Public name → the module that defines it."""

_RENAMED = {"Told": "PlacementResults"}
"""Names of version 0.2 → present names. Old names still work, but issue a warning; the next version removes them."""

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
    "PlacementResults",
    "Plan",
    "PlanSet",
    "PlanWarning",
    "Quiet",
    "Repaired",
    "Repairs",
    "RunOptions",
    "RunResults",
    "Schedule",
    "Scored",
    "Scorer",
    "Simulation",
    "Solver",
    "Story",
    "Thresholds",
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
    "repair",
    "report",
    "save_plans",
    "score",
    "sweep",
    "tell",
]


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        message = f"petmjx.{name} is now petmjx.{_RENAMED[name]}"
        warnings.warn(message, FutureWarning, stacklevel=2)
        name = _RENAMED[name]
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
