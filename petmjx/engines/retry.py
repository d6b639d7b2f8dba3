"""Runs worlds through an engine, runs the invalid ones again, and hands on each world's last outcome.

The procedure is that of the PET-Physics paper (Newton, then CG, up to two attempts each), with half the timestep
after it. The reference implementation repeats a deterministic run bit for bit on its second attempts; here they
differ: the solver gets up to ``CAREFUL_ITERATIONS`` iterations and ``CAREFUL_TOLERANCE``, so that an attempt
that failed because the solver stopped early has another chance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from petmjx.config import Simulation, Solver
from petmjx.engines.base import Engine, Progress
from petmjx.plans.plan import Plan
from petmjx.verdict import Attempt, Outcome, Verdict
from petmjx.world.job import Excitation, Job

CAREFUL_ITERATIONS = 400
"""Most solver iterations a step in a second attempt: four times MuJoCo's default, which CG often exhausts."""

CAREFUL_TOLERANCE = 1e-10
"""Solver tolerance of a second attempt: a hundredth of MuJoCo's default. Engines clip it to their precision."""

DEFAULT_CHUNK_WORLDS = 32_768
"""Worlds handed to an engine at once. Scenes of 43 boxes take 160 MB then, whatever the number of plans; a smaller
chunk would have the MJX engines choose (and compile) their shapes more often than they need to."""


@dataclass(frozen=True)
class AttemptRecipe:
    """One row of the retry procedure."""

    number: int
    solver: Solver | None
    careful: bool = False
    timestep_divisor: int = 1

    def apply_to_sim(self, sim: Simulation) -> Simulation:
        """The run's configuration, changed as this attempt asks. Durations in seconds stay what they were."""
        update: dict[str, Any] = {}
        if self.solver is not None:
            update["solver"] = self.solver
        if self.careful:
            update |= {"solver_iterations": CAREFUL_ITERATIONS, "solver_tolerance": CAREFUL_TOLERANCE}
        if self.timestep_divisor != 1:
            factor = self.timestep_divisor
            # not checked again: a fraction of the smallest timestep may be below what users may give
            update["physics"] = sim.physics.model_copy(update={"timestep_s": sim.physics.timestep_s / factor})
            quiet = {name: getattr(sim.quiet, name) * factor for name in ("steps", "min_steps", "poll_steps")}
            update["quiet"] = sim.quiet.model_copy(update=quiet)
        return sim.changed(**update)

    def apply_to_jobs(self, jobs: Sequence[Job]) -> list[Job]:
        """The same jobs, their force profiles resampled to this attempt's timestep (and still shared)."""
        if self.timestep_divisor == 1:
            return list(jobs)
        resampled: dict[int, Excitation] = {}
        out = []
        for job in jobs:
            if job.drive is None:
                out.append(job)
                continue
            old = job.drive.excitation
            if id(old) not in resampled:
                resampled[id(old)] = replace(old, samples=np.repeat(old.samples, self.timestep_divisor, axis=0))
            out.append(replace(job, drive=replace(job.drive, excitation=resampled[id(old)])))
        return out


ATTEMPTS: tuple[AttemptRecipe, ...] = (
    AttemptRecipe(1, None),
    AttemptRecipe(2, Solver.NEWTON, careful=True),
    AttemptRecipe(3, Solver.CG),
    AttemptRecipe(4, Solver.CG, careful=True),
    AttemptRecipe(5, Solver.NEWTON, timestep_divisor=2),
)
"""The retry procedure, in order. Attempt 1 takes the run's own solver (Newton unless configured otherwise)."""


@dataclass(frozen=True, eq=False)
class World:
    """One plan × one variant: what is simulated once (again where it turns out invalid)."""

    plan: Plan
    variant: int
    job: Job


@dataclass(frozen=True, eq=False)
class WorldResult:
    """A world, the outcome of its last attempt, and all its attempts in order (one where it was valid at once)."""

    world: World
    outcome: Outcome
    attempts: tuple[Attempt, ...]


@dataclass(frozen=True, eq=False)
class _Pending:
    """A world that waits for its next attempt, with the records of those it has had."""

    world: World
    attempts: tuple[Attempt, ...] = ()


def score_worlds(
    worlds: Iterable[World],
    sim: Simulation,
    engine: Engine,
    *,
    progress: Progress | None = None,
    chunk_worlds: int = DEFAULT_CHUNK_WORLDS,
    attempts: Sequence[AttemptRecipe] = ATTEMPTS,
) -> Iterator[WorldResult]:
    """Simulate worlds and yield each one's result once, as it becomes final, in any order.

    Worlds are drawn and simulated ``chunk_worlds`` at a time; invalid ones gather and run again as one
    batch, at the end or when there is a chunk of them. So memory does not grow with the number of worlds.

    Raises:
        RuntimeError: the engine did not answer every job exactly once.
    """
    progress = progress or Progress()
    first, *retries = attempts
    source = iter(worlds)
    invalid: list[_Pending] = []
    while chunk := [_Pending(world) for world in islice(source, chunk_worlds)]:
        for pending, outcome in _run_attempt(chunk, first, sim, engine, progress):
            if retries and outcome.verdict is Verdict.INVALID:
                invalid.append(pending)
            else:
                yield WorldResult(pending.world, outcome, pending.attempts)
        if len(invalid) >= chunk_worlds:
            yield from _retry(invalid, retries, sim, engine, progress)
            invalid = []
    yield from _retry(invalid, retries, sim, engine, progress)


def _retry(
    invalid: list[_Pending], attempts: Sequence[AttemptRecipe], sim: Simulation, engine: Engine, progress: Progress
) -> Iterator[WorldResult]:
    """Take invalid worlds through the attempts, all of them at one attempt before the next begins."""
    for attempt in attempts:
        if not invalid:
            return
        progress.message = f"{len(invalid)} invalid again, attempt {attempt.number} of {attempts[-1].number}"
        still_invalid = []
        for pending, outcome in _run_attempt(invalid, attempt, sim, engine, progress):
            if outcome.verdict is Verdict.INVALID and attempt is not attempts[-1]:
                still_invalid.append(pending)
            else:
                yield WorldResult(pending.world, outcome, pending.attempts)
        invalid = still_invalid


def _run_attempt(
    batch: Sequence[_Pending], attempt: AttemptRecipe, sim: Simulation, engine: Engine, progress: Progress
) -> Iterator[tuple[_Pending, Outcome]]:
    """One attempt at each world of a batch: yields the world with this attempt's record added, and the outcome."""
    attempt_sim = attempt.apply_to_sim(sim)
    unanswered = set(range(len(batch)))
    for outcome in engine.run(attempt.apply_to_jobs([p.world.job for p in batch]), attempt_sim, progress):
        if outcome.job not in unanswered:
            raise RuntimeError(f"engine {engine.name} answered job {outcome.job} twice, or it was never asked")
        unanswered.remove(outcome.job)
        outcome.attempt = attempt.number
        outcome.solver = attempt_sim.solver.value
        pending = batch[outcome.job]
        record = Attempt.of(outcome, attempt_sim.physics.timestep_s)
        yield replace(pending, attempts=(*pending.attempts, record)), outcome
    if unanswered:
        raise RuntimeError(f"engine {engine.name} did not answer {len(unanswered)} of {len(batch)} jobs")
