"""Simulates worlds with an engine, repeats the invalid ones with other settings, and yields each world's last outcome.

The attempts are those of the PET-Physics paper (Newton, then CG, up to two attempts each), and then one with half the
timestep. Worlds that sank (``petmjx.engines.sinking``) have an attempt of their own. The second attempts of the
reference implementation repeat the same deterministic run. Here they differ: the solver gets up to
``CAREFUL_ITERATIONS`` iterations and ``CAREFUL_TOLERANCE``, which helps if it had stopped too early.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Generic, TypeVar

import numpy as np

from petmjx.config import Simulation, Solver
from petmjx.engines.base import Engine, GrowingJobs, Progress
from petmjx.engines.sinking import note_sinking, stiffened
from petmjx.plans.plan import Plan
from petmjx.verdict import Attempt, Outcome, Reason, Verdict, margin_of
from petmjx.world.job import Excitation, Job

CAREFUL_ITERATIONS = 400
"""Most solver iterations per step in a second attempt: four times MuJoCo's default, with which CG stops so
early that boxes of ``pallet`` slide apart which should stand."""

CAREFUL_TOLERANCE = 1e-10
"""Solver tolerance of a second attempt: a hundredth of MuJoCo's default. Engines clip it to their precision."""

DEFAULT_CHUNK_WORLDS = 32_768
"""Worlds given to an engine at once. With 43 boxes each their scenes take 160 MB, for any number of plans. With smaller
chunks the MJX engines would choose (and compile) their shapes more often."""


@dataclass(frozen=True)
class AttemptRecipe:
    """One attempt: the settings that it changes (docs/rules.md, section 9)."""

    number: int
    solver: Solver | None
    careful: bool = False
    timestep_divisor: int = 1
    stiff: bool = False
    """With contacts that bear light boxes under heavy ones: for worlds that sank, and for no others."""

    def is_for(self, outcome: Outcome) -> bool:
        """Whether this attempt may give what the one before did not. More time is not given to a world."""
        if outcome.verdict is not Verdict.INVALID or outcome.reason is Reason.TIMEOUT:
            return False
        return self.stiff == (outcome.reason is Reason.SINKING)

    def apply_to_sim(self, sim: Simulation) -> Simulation:
        """The run's options with this attempt's changes. Times in seconds stay the same."""
        update: dict[str, Any] = {}
        if self.solver is not None:
            update["solver"] = self.solver
        if self.careful or self.solver is Solver.CG:
            update["solver_iterations"] = max(sim.solver_iterations or 0, CAREFUL_ITERATIONS)
        if self.careful:
            update["solver_tolerance"] = CAREFUL_TOLERANCE
        if self.timestep_divisor != 1:
            factor = self.timestep_divisor
            # not checked again: a fraction of the smallest timestep may be below what users may give
            update["physics"] = sim.physics.model_copy(update={"timestep_s": sim.physics.timestep_s / factor})
            quiet = {name: getattr(sim.quiet, name) * factor for name in ("steps", "min_steps", "poll_steps")}
            update["quiet"] = sim.quiet.model_copy(update=quiet)
        if self.stiff:
            update["physics"] = stiffened(sim.physics)
        return sim.changed(**update)

    def apply_to_jobs(self, jobs: Sequence[Job]) -> list[Job]:
        """The same jobs, with profiles resampled to this attempt's timestep (and still shared)."""
        if self.timestep_divisor == 1:
            return list(jobs)
        profiles = {id(job.drive.excitation): job.drive.excitation for job in jobs if job.drive}
        finer: dict[int, Excitation] = {
            key: replace(profile, samples=np.repeat(profile.samples, self.timestep_divisor, axis=0))
            for key, profile in profiles.items()
        }
        return [
            replace(job, drive=replace(job.drive, excitation=finer[id(job.drive.excitation)])) if job.drive else job
            for job in jobs
        ]


ATTEMPTS: tuple[AttemptRecipe, ...] = (
    AttemptRecipe(1, None),
    AttemptRecipe(2, Solver.NEWTON, careful=True),
    AttemptRecipe(3, Solver.CG),
    AttemptRecipe(4, Solver.CG, careful=True),
    AttemptRecipe(5, Solver.NEWTON, timestep_divisor=2),
    AttemptRecipe(6, None, stiff=True),
)
"""The attempts, in order. Attempts 1 and 6 use the run's own solver (Newton by default)."""


@dataclass(frozen=True, eq=False)
class World:
    """One plan in one variant. It is simulated once, and again if it is invalid."""

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


_Pending = tuple[AnyWorld, Outcome | None, tuple[Attempt, ...]]
"""A world between two attempts: with the outcome of the last one, and the records of all before."""


def score_worlds(
    worlds: Iterable[AnyWorld],
    sim: Simulation,
    engine: Engine,
    *,
    progress: Progress | None = None,
    chunk_worlds: int = DEFAULT_CHUNK_WORLDS,
    attempts: Sequence[AttemptRecipe] = ATTEMPTS,
    more: Callable[[], Iterable[AnyWorld]] | None = None,
) -> Iterator[WorldResult[AnyWorld]]:
    """Simulate worlds and yield the result of each one when it is final, in any order.

    ``chunk_worlds`` worlds are taken and simulated at a time. Invalid ones are collected and simulated again together,
    at the end or when a chunk is full. So memory does not grow with the number of worlds.

    ``more`` gives worlds that follow from the results so far, each once. An engine with ``takes_more`` simulates them
    beside those that still run, any other one when these have ended.

    Raises:
        RuntimeError: the engine did not answer every job exactly once.
    """
    progress = progress or Progress()
    first, *retries = attempts
    source = iter(worlds)
    waiting: list[_Pending[AnyWorld]] = []

    def attempt_at(
        batch: list[_Pending[AnyWorld]], attempt: AttemptRecipe, later: Sequence[AttemptRecipe]
    ) -> Generator[WorldResult[AnyWorld], None, list[_Pending[AnyWorld]]]:
        """Yield results that are final; return the worlds for which there is a later attempt."""
        again: list[_Pending[AnyWorld]] = []
        arriving = more if attempt is first else None
        for world, outcome, records in _run_attempt(batch, attempt, sim, engine, progress, arriving):
            if any(each.is_for(outcome) for each in later):
                again.append((world, outcome, records))
            else:
                yield WorldResult(world, outcome, records)
        return again

    def retry(batch: Sequence[_Pending[AnyWorld]]) -> Iterator[WorldResult[AnyWorld]]:
        for number, attempt in enumerate(retries, start=1):
            chosen: list[_Pending[AnyWorld]] = []
            others: list[_Pending[AnyWorld]] = []
            for pending in batch:
                fits = pending[1] is not None and attempt.is_for(pending[1])
                (chosen if fits else others).append(pending)
            if chosen:
                progress.message = f"{len(chosen)} invalid again, attempt {attempt.number} of {attempts[-1].number}"
                batch = others + (yield from attempt_at(chosen, attempt, retries[number:]))

    while True:
        chunk = list(islice(source, chunk_worlds)) or list(more() if more else ())
        if chunk:
            waiting += yield from attempt_at([(world, None, ()) for world in chunk], first, retries)
        elif not waiting:
            return
        if len(waiting) >= chunk_worlds or not chunk:
            invalid, waiting = waiting, []
            yield from retry(invalid)  # from whose results more may follow


def _run_attempt(
    batch: list[_Pending[AnyWorld]],
    attempt: AttemptRecipe,
    sim: Simulation,
    engine: Engine,
    progress: Progress,
    more: Callable[[], Iterable[AnyWorld]] | None = None,
) -> Iterator[tuple[AnyWorld, Outcome, tuple[Attempt, ...]]]:
    """Make one attempt at each world of a batch: yield world, outcome, and its records with this attempt's record.

    Worlds of ``more`` are appended to the batch, if the engine takes them while it runs.
    """
    attempt_sim = attempt.apply_to_sim(sim)
    unanswered = set(range(len(batch)))
    jobs = attempt.apply_to_jobs([pending[0].job for pending in batch])
    if not getattr(engine, "takes_more", False):
        more = None
    if more:
        jobs = GrowingJobs(jobs)
    for answer in engine.run(jobs, attempt_sim, progress):
        if answer.job not in unanswered:
            raise RuntimeError(f"engine {engine.name} answered job {answer.job} twice, or it was never asked")
        unanswered.remove(answer.job)
        world, _, records = batch[answer.job]
        outcome = note_sinking(answer, world.job.scene, attempt_sim)
        outcome.attempt = attempt.number
        outcome.solver = attempt_sim.solver.value
        outcome.margin = margin_of(outcome.verdict, outcome.boxes, outcome.n_placed, attempt_sim.thresholds)
        yield world, outcome, (*records, Attempt.of(outcome, attempt_sim.physics.timestep_s))
        for each in more() if more else ():
            unanswered.add(len(batch))
            batch.append((each, None, ()))
            jobs.append(each.job)
    if unanswered:
        raise RuntimeError(f"engine {engine.name} did not answer {len(unanswered)} of {len(batch)} jobs")
