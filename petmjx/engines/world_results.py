"""The worlds of a run, and their results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from petmjx.engines.verdict import Attempt, Outcome
from petmjx.plans.plan import Plan
from petmjx.world.job import Job


@dataclass(frozen=True, eq=False)
class World:
    """One plan in one of its variants. A world is simulated once, and again if the outcome is invalid."""

    plan: Plan
    variant: int
    job: Job


AnyWorld = TypeVar("AnyWorld", bound=World)


@dataclass(frozen=True, eq=False)
class WorldResult(Generic[AnyWorld]):
    """A world, the outcome of its last attempt, and all its attempts in order (often only one)."""

    world: AnyWorld
    outcome: Outcome
    attempts: tuple[Attempt, ...]
