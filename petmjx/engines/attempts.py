"""The attempts at a world: what each changes, for which outcomes it is, and which engine makes it.

The rules: docs/rules.md, section 9.

They are those of the PET-Physics paper (Newton, then CG, up to two attempts each), and then one with half the timestep.
Worlds whose verdict may come from soft contacts (``petmjx.engines.contact_penetration``) have two attempts of their
own. If asked for, the last attempt has soft boxes, as the third one of the reference implementation. The second
attempts of the reference implementation repeat the same deterministic run. Here they differ: the solver gets up to
``CAREFUL_ITERATIONS`` iterations and ``CAREFUL_TOLERANCE``, which helps if it had stopped too early.

The MJX engines work in single precision, and ``mjx-warp`` has Newton's method alone. So C MuJoCo, their *stand-in*,
makes the attempts that want double precision and worlds with soft boxes, simulates with conjugate gradients, and takes
over what an error of theirs left unanswered. ``mujoco`` itself and an engine of the user's own have no stand-in.

A single world takes a GPU as long as many. So of a run on ``mjx-warp`` further attempts that few worlds need are made
beside it, on CPU threads (petmjx/engines/subprocess): those of C MuJoCo, and with stiffer contacts those of
``mjx-warp-cpu``, the same kernels. Who makes an attempt depends on the world and the options alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from petmjx.common.text import count_text
from petmjx.engines.contact_penetration import stiffened_physics
from petmjx.engines.engine_choice import make_engine
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.subprocess.attempt_host import SideSimulator, SubprocessSimulator
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.physics import Cone
from petmjx.options.simulation import Attempts, Simulation, Solver
from petmjx.world.job import Excitation, Job, KeptState

CAREFUL_ITERATIONS = 400
"""Most solver iterations per step in a second attempt: four times MuJoCo's default, with which CG stops so
early that boxes of ``pallet`` slide apart which should stand."""

CAREFUL_TOLERANCE = 1e-10
"""Solver tolerance of a second attempt: a hundredth of MuJoCo's default. Engines clip it to their precision."""

NEAR = 0.5
"""Worlds whose margin is smaller are checked at half the timestep. ``Outcome.margin`` of invalid ones is NaN."""

STIFF_QUIET_STEPS = 25
"""``Quiet.steps`` in stiff contacts, where less than a millimetre decides. Of 6,000 small stacks that statics decides
5 fell with 15 that should stand, 4 with 25, and 3 with 50, with which pallets that tremble take three times as long."""

_EARLY_STOP, _SINKING = int(Flag.EARLY_STOP), int(Flag.SINKING)  # numbers are compared several times as fast

_COUNTED_IN_STEPS = ("steps", "landing_steps", "poll_steps", "still_steps", "tremble_steps")
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
    """With all boxes as flex bodies (petmjx/world/soft_boxes.py), from the beginning."""

    doubles: bool = False
    """Whether it wants double precision: an invalid world may be so by single precision, and in contacts of a twentieth
    of the time constant boxes sink by less than it resolves."""

    few: bool = False
    """Whether few worlds need it, among many: but for those with errors of a plan whose boxes may sink."""

    def is_for(self, outcome: Outcome, sim: Simulation) -> bool:
        """Whether this attempt may give what the one before did not. More time is not given to a world."""
        if self.checks:
            # of a world that ended early it is the margin of a box on its way down
            return sim.check_timestep and abs(outcome.margin) < NEAR and not int(outcome.flags) & _EARLY_STOP
        sinks = bool(int(outcome.flags) & _SINKING) and sim.physics.cone is Cone.ELLIPTIC
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
            update["physics"] = stiffened_physics(update.get("physics", sim.physics), self.stiff)
            quiet = update.get("quiet", sim.quiet)
            update["quiet"] = quiet.model_copy(
                update={"steps": max(quiet.steps, STIFF_QUIET_STEPS * self.timestep_divisor)}
            )
        return sim.changed(**update) if update else sim

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

STAND_INS: Final = {"mjx-jax": "mujoco", "mjx-warp": "mujoco", "mjx-warp-cpu": "mujoco"}
"""Engine → its stand-in."""

BESIDE: Final = {"mjx-warp": "mjx-warp-cpu"}
"""Engine → that which makes further attempts on CPU threads beside it, if few worlds need them."""


@dataclass(eq=False)
class Engines:
    """The engine of a run and its stand-in, which is built when a world needs it."""

    own: Engine
    progress: Progress

    @cached_property
    def stand_in(self) -> Engine | None:
        name = STAND_INS.get(self.own.name)
        return make_engine(name) if name is not None else None

    def for_job(self, job: Job, sim: Simulation, *, doubles: bool, soft: bool = False) -> Engine:
        """Who simulates a job; ``doubles``: at an attempt that wants double precision; ``soft``: with soft boxes."""
        if soft and self.stand_in is not None:
            self.note(f"worlds with soft boxes were simulated on {self.stand_in.name}")
            return self.stand_in
        cut = bool(job.scene.pieces) and self.own.name == "mjx-jax"
        if cut and self.stand_in is not None:
            self.note(f"worlds with interlayer sheets were simulated on {self.stand_in.name}")
            return self.stand_in
        foreign = isinstance(job.start, KeptState) and job.start.engine != self.own.name
        if (doubles or foreign or sim.solver is Solver.CG) and self.stand_in is not None:
            if doubles:
                self.note(f"worlds were simulated again on {self.stand_in.name}, in double precision")
            elif sim.solver is Solver.CG:
                self.note(f"worlds were simulated on {self.stand_in.name}: only it has the solver cg")
            return self.stand_in
        return self.own

    def beside(self, job: Job, sim: Simulation, *, doubles: bool, soft: bool, few: bool) -> str | None:
        """Who makes a further attempt at a job beside the engine of the run; None: it is not made beside it.

        Args:
            few: whether few worlds need that attempt. It is made by the engine of the run, too, where a drive or a
                state that others start from belongs to it: of these there may be many.
        """
        if self.own.name not in BESIDE:
            return None
        maker = self.for_job(job, sim, doubles=doubles, soft=soft)
        if maker is not self.own:
            return maker.name
        if not few or job.settles:
            return None
        name = BESIDE[self.own.name]
        self.note(f"worlds were simulated again on {name}, in stiffer contacts")
        return name

    @cached_property
    def helper(self) -> SideSimulator:
        """Makes attempts beside the engine of the run."""
        return SubprocessSimulator()

    def note_failure(self, engine: str, attempt: int, worlds: int, message: str) -> None:
        """Say that an error ended an engine's attempt, and what becomes of the worlds that it left unanswered."""
        other = self.stand_in
        then = "invalid by failed" if other is None or engine == other.name else f"went to {other.name}"
        self.note(f"attempt {attempt}: {engine} failed ({message}); {count_text(worlds, 'world')}: {then}")

    def note(self, text: str) -> None:
        """A line for ``run.json``."""
        self.progress.notes[text] = None


def ready_for(engine: str, job: Job) -> Job:
    """A job as an engine takes it: with a state of its own to start from. From another engine's state it does not
    start: it takes the world through its placement again."""
    if not isinstance(job.start, KeptState):
        return job
    start = job.start.state if job.start.engine == engine else None
    return Job(**{**vars(job), "start": start})  # ``replace`` takes three times as long; a Job keeps nothing but fields
