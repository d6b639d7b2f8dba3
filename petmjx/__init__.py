"""petmjx: the stability of pallet packing plans, scored by physics, many thousands at a time.

Names are imported when first used, so that ``import petmjx`` is quick and reading results never loads a simulator.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from petmjx.api import score, sweep
    from petmjx.errors import EngineUnavailable, InputError, PetmjxError
    from petmjx.plans.plan import Plan, PlanSet
    from petmjx.plans.read import load_plans
    from petmjx.results.compare import compare_runs
    from petmjx.results.reader import RunResults, load_run

__version__ = "0.1.0"

__all__ = [
    "EngineUnavailable",
    "InputError",
    "PetmjxError",
    "Plan",
    "PlanSet",
    "RunResults",
    "__version__",
    "compare_runs",
    "load_plans",
    "load_run",
    "score",
    "sweep",
]

_HOME = {
    "EngineUnavailable": "petmjx.errors",
    "InputError": "petmjx.errors",
    "PetmjxError": "petmjx.errors",
    "Plan": "petmjx.plans",
    "PlanSet": "petmjx.plans",
    "RunResults": "petmjx.results.reader",
    "compare_runs": "petmjx.results.compare",
    "load_plans": "petmjx.plans",
    "load_run": "petmjx.results.reader",
    "score": "petmjx.api",
    "sweep": "petmjx.api",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
