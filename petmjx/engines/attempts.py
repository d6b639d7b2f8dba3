"""The attempts at a world: what each changes, and for which outcomes it is (docs/rules.md, section 9).

They are those of the PET-Physics paper (Newton, then CG, up to two attempts each), and then one with half the timestep.
Worlds whose verdict may come from soft contacts (``petmjx.engines.sinking``) have two attempts of their own.
If asked for, the last attempt has soft boxes, as the third one of the reference implementation.
The second attempts of the reference implementation repeat the same deterministic run. Here they differ: the solver gets
up to ``CAREFUL_ITERATIONS`` iterations and ``CAREFUL_TOLERANCE``, which helps if it had stopped too early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from petmjx.config import Attempts, Simulation, Solver
from petmjx.engines.sinking import stiffened
from petmjx.physics import Cone
from petmjx.verdict import Flag, Outcome, Reason, Verdict
from petmjx.world.job import Excitation, Job

CAREFUL_ITERATIONS = 400
"""Most solver iterations per step in a second attempt: four times MuJoCo's default, with which CG stops so
early that boxes of ``pallet`` slide apart which should stand."""

CAREFUL_TOLERANCE = 1e-10
"""Solver tolerance of a second attempt: a hundredth of MuJoCo's default. Engines clip it to their precision."""

NEAR = 0.5
"""Worlds whose margin is smaller are checked at half the timestep. ``Outcome.margin`` of invalid ones is NaN."""

_COUNTED_IN_STEPS = ("steps", "min_steps", "poll_steps", "still_steps")
"""Fields of ``Quiet``."""


@dataclass(frozen=True)
class AttemptRecipe:
    """One attempt: the settings that it changes (docs/rules.md, section 9)."""

    number: int
    solver: Solver | None
    careful: bool = False
    timestep_divisor: int = 1
    stiff: float | None = None
    """With stiffer contacts, of this share of the time constant: for worlds whose verdict may come from soft ones
    (``Flag.SINKING``), and for no others."""
    checks: bool = False
    """Whether it leaves the verdict as it is, and says whether it would be another one (``Flag.TIMESTEP``)."""

    most_boxes: int | None = None
    """Worlds of more boxes that have a verdict keep it, and the flag: steps of hundreds of boxes in stiff contacts take
    tens of milliseconds, and what leans there is a small part of the pallet."""
    soft: bool = False
    """With all boxes as flex bodies (petmjx/world/soft.py), from the beginning."""

    doubles: bool = False
    """Whether it wants double precision: an invalid world may be so by single precision, and in contacts of a twentieth
    of the time constant boxes sink by less than it resolves."""

    few: bool = False
    """Whether few worlds need it, among many of a run."""

    def is_for(self, outcome: Outcome, sim: Simulation) -> bool:
        """Whether this attempt may give what the one before did not. More time is not given to a world."""
        if self.checks:
            return sim.check_timestep and abs(outcome.margin) < NEAR
        sinks = bool(outcome.flags & Flag.SINKING) and sim.physics.cone is Cone.ELLIPTIC
        if self.soft:
            invalid = outcome.verdict is Verdict.INVALID and outcome.reason is not Reason.TIMEOUT
            return sim.attempts is Attempts.SOFT and (invalid or sinks)
        if self.stiff is not None or sinks:
            few = self.most_boxes is None or outcome.n_boxes <= self.most_boxes
            return self.stiff is not None and sinks and (few or outcome.verdict is Verdict.INVALID)
        return outcome.verdict is Verdict.INVALID and outcome.reason is not Reason.TIMEOUT

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
            quiet = {name: getattr(sim.quiet, name) * factor for name in _COUNTED_IN_STEPS}
            update["quiet"] = sim.quiet.model_copy(update=quiet)
        if self.stiff is not None:
            update["physics"] = stiffened(update.get("physics", sim.physics), self.stiff)
        return sim.changed(**update)

    def apply_to_jobs(self, jobs: Sequence[Job]) -> list[Job]:
        """The same jobs, with this attempt's boxes, and with profiles resampled to its timestep (and still shared)."""
        if self.soft:
            jobs = [replace(job, scene=job.scene.all_soft, start=None, keep_state=False) for job in jobs]
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
    AttemptRecipe(2, Solver.NEWTON, careful=True, doubles=True),
    AttemptRecipe(3, Solver.CG, doubles=True),
    AttemptRecipe(4, Solver.CG, careful=True, doubles=True),
    AttemptRecipe(5, Solver.NEWTON, timestep_divisor=2, doubles=True),
    AttemptRecipe(6, None, stiff=0.5, most_boxes=96, few=True),
    AttemptRecipe(7, None, stiff=0.05, timestep_divisor=8, most_boxes=12, doubles=True),
    AttemptRecipe(8, None, timestep_divisor=2, checks=True),
    AttemptRecipe(9, None, soft=True),
)
"""The attempts, in order. Attempts 1 and 6 to 9 use the run's own solver (Newton by default)."""
