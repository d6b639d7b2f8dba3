"""The worlds of a run, and their results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from petmjx.engines.verdict import Attempt, Outcome
from petmjx.plans.plan import Plan
from petmjx.world.job import Job


class NamedJob(Protocol):
    """A world of any run: its job (the input of the engine), and its name in notes."""

    @property
    def job(self) -> Job: ...

    @property
    def name(self) -> str: ...

    @property
    def variant(self) -> int:
        """Number of the variant. 0 means the plan without errors and other changes."""
        ...


@dataclass(frozen=True, eq=False)
class World:
    """One plan in one of its variants."""

    plan: Plan
    variant: int
    job: Job

    @property
    def name(self) -> str:
        """The name of the world in notes."""
        return f"{self.plan.plan_id}, variant {self.variant}" if self.variant else self.plan.plan_id


AnyWorld = TypeVar("AnyWorld", bound=NamedJob)


@dataclass(frozen=True, eq=False)
class WorldResult(Generic[AnyWorld]):
    """A world, the outcome of its last attempt, and the records of all its attempts in order (often only one)."""

    world: AnyWorld
    outcome: Outcome
    attempts: tuple[Attempt, ...]
