"""What every engine is: simulates jobs, answers with outcomes, tells its progress."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from petmjx.config import Simulation
from petmjx.verdict import Outcome
from petmjx.world.job import Job


@dataclass
class Progress:
    """Running totals that an engine reports while it works; ``message`` says what it is doing (compiling, …)."""

    worlds_done: int = 0
    world_steps: int = 0
    compile_s: float = 0.0
    message: str = ""
    extra: dict[str, float] = field(default_factory=dict)


class Engine(Protocol):
    """Simulates worlds. Outcomes come in any order, as they finish; ``Outcome.job`` says whose they are."""

    name: str

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once with ``sim.solver``. Retries are made by petmjx/engines/retry.py."""
        ...
