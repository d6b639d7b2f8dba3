"""An engine that fails as planned, and worlds that tell it how often to fail."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.engines.world_results import World
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from support.outcomes import make_outcome
from support.plans import make_plan, make_world, stack


def outcome_of(job: int, verdict: Verdict) -> Outcome:
    if verdict is Verdict.INVALID:
        return make_outcome(1, verdict, Reason.EXPLOSION, job=job, flags=Flag.EXPLOSION)
    return make_outcome(1, verdict, job=job)


@dataclass
class FailingEngine(Engine):
    """Returns outcomes in reverse order. A world whose box weighs k kg is invalid in its first k − 1 attempts."""

    name: str = "failing"
    calls: list[tuple[Simulation, list[Job]]] = field(default_factory=list)
    drop_last: bool = False
    repeat_last: bool = False

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        self.calls.append((sim, list(jobs)))
        for index in reversed(range(len(jobs))):
            if index == 0 and self.drop_last:
                return
            failures = round(float(jobs[index].scene.mass[0])) - 1
            attempt = sum(any(job.scene is jobs[index].scene for job in batch) for _, batch in self.calls)
            yield outcome_of(index, Verdict.INVALID if attempt <= failures else Verdict.STABLE)
        if self.repeat_last:
            yield outcome_of(0, Verdict.STABLE)


def worlds_failing(*failures: int) -> list[World]:
    """One world for each number, which says how many of the world's attempts are invalid."""
    return [make_world(make_plan(f"p{i}", stack(1, kg=k + 1.0))) for i, k in enumerate(failures)]
