"""Attempts at a world (its repeated simulations): their settings, the outcomes that require them, and their engines.

docs/rules.md, section 9, lists the attempts, and tells which engine makes them. docs/batching.md, "Attempts beside a
run", tells where they run.

Attempts 1 to 4 follow the PET-Physics paper: two attempts with Newton's method (attempt 1 with the solver of the run),
then two attempts with conjugate gradients (CG). In the paper's reference implementation, the second attempt with a
solver gives the same result as the first, because the simulation is deterministic. In petmjx, attempts 2 and 4 give the
solver up to ``CAREFUL_ITERATIONS`` iterations and the tolerance ``CAREFUL_TOLERANCE``, which help if the solver stopped
too early.

C MuJoCo is the *fallback* of the MJX engines (``FALLBACKS``). It simulates the worlds that an MJX engine cannot
simulate, and the worlds for which an MJX engine returned no outcome because of an error. ``mujoco`` itself and engines
that users wrote have no fallback.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from petmjx.common.text import count_text
from petmjx.engines.attempt_threads import AttemptThreads
from petmjx.engines.contact_penetration import stiffened
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.protocol import Capability, Engine, Progress
from petmjx.engines.subprocess.attempt_process import AttemptProcess, AttemptSimulator
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.physics import Cone
from petmjx.options.simulation import MOST_ITERATIONS, Attempts, Simulation, Solver
from petmjx.options.thresholds import MOTION_REASONS
from petmjx.world.job import Excitation, Job, KeptState

CAREFUL_ITERATIONS = 400
"""Largest number of solver iterations per step in attempts 2 to 4: four times MuJoCo's default. With MuJoCo's default,
CG stops so early that boxes of the physics preset ``pallet`` slide apart although they should stand."""

CAREFUL_TOLERANCE = 1e-10
"""Solver tolerance of attempts 2 and 4: a hundredth of MuJoCo's default. Engines that compute in single precision use a
larger tolerance."""

NEAR = 0.5
"""If the option ``check_timestep`` is set, worlds whose margin has a magnitude below this value are simulated again
with half the timestep. Invalid worlds have the margin NaN, so this rule does not apply to them."""

# The flags as plain integers: comparing integers is several times as fast as comparing members of ``Flag``.
_EARLY_STOP, _SINKING = int(Flag.EARLY_STOP), int(Flag.SINKING)

STIFF_ATTEMPT: Final = 6
"""Number of the first attempt with stiffer contacts."""

UNSTABLE_NUMERICALLY: Final = (Reason.NONFINITE, Reason.EXPLOSION)
"""Reasons of worlds whose simulation became numerically unstable. Attempt 6 has stiffer contacts, but the timestep of
the run, so it may become unstable if a light box carries a very heavy one. Attempt 7 then follows, with an eighth of
this timestep."""

_COUNTED_IN_STEPS = ("steps", "landing_steps", "poll_steps", "still_steps", "tremble_steps")
"""Fields of ``Quiet`` that count steps."""


@dataclass(frozen=True)
class AttemptRecipe:
    """The settings that one attempt (one simulation of a world) changes; see docs/rules.md, section 9."""

    number: int
    solver: Solver | None
    careful: bool = False
    timestep_divisor: int = 1
    stiff: float | None = None
    """Time constant of contacts, divided by the usual time constant. A smaller time constant makes contacts stiffer.
    An attempt with stiffer contacts is only for worlds whose verdict may come from soft contacts (``Flag.SINKING``)."""
    checks: bool = False
    """If True, the world keeps its verdict, and gets ``Flag.TIMESTEP`` if this attempt has a different verdict."""

    most_boxes: int | None = None
    """Largest number of boxes of a world for this attempt. A larger world keeps its verdict, if it has one, and
    ``Flag.SINKING``. With stiff contacts, a step of a world of hundreds of boxes takes tens of milliseconds. Besides,
    the boxes that soft contacts tilt are only a small part of a large pallet. Attempt 7 at a world of 16 to 20 boxes
    takes 0.3 to 5 s of CPU time."""
    soft: bool = False
    """If True, all boxes are flex bodies from the beginning (petmjx/world/soft_boxes.py)."""

    doubles: bool = False
    """Whether the attempt needs double precision. There are two possible reasons. First, single precision may have made
    the world invalid. Second, contacts may be so stiff (``stiff`` is 0.05) that boxes sink into each other by less than
    single precision resolves."""

    few: bool = False
    """Whether only few of many worlds need the attempt. Worlds with placement errors are an exception: if their plan
    has boxes that may sink into each other, many of these worlds need the attempt."""

    @property
    def needs(self) -> Capability:
        """The precision that an engine needs for this attempt."""
        if self.doubles:
            return Capability.FLOAT64
        return Capability(0) if self.stiff is None else Capability.FINE_DISTANCES

    @property
    def joins(self) -> bool:
        """Whether the attempt differs from the first attempt only in the stiffness of contacts (``Job.stiff``). An
        attempt of this kind can run together with first attempts."""
        return self.stiff is not None and self.timestep_divisor == 1 and not self.doubles

    def is_for(self, outcome: Outcome, sim: Simulation) -> bool:
        """Whether this attempt may give a different result from the previous attempt. A world that ran out of time gets
        no further attempt."""
        if self.checks:
            # If a world ended early, its margin is that of a falling box. This margin does not show how near to the
            # threshold the world was before the fall.
            return sim.check_timestep and abs(outcome.margin) < NEAR and not int(outcome.flags) & _EARLY_STOP
        sinks = bool(int(outcome.flags) & _SINKING) and sim.physics.cone is Cone.ELLIPTIC
        if self.soft:
            invalid = outcome.verdict is Verdict.INVALID and outcome.reason is not Reason.TIMEOUT
            return sim.attempts is Attempts.SOFT and (invalid or sinks)
        if self.stiff is not None or sinks:
            few = self.most_boxes is None or outcome.n_boxes <= self.most_boxes
            # if attempt 6 becomes numerically unstable, it cannot set ``Flag.SINKING``, so the world counts as sinking
            sinks = sinks or (outcome.attempt == STIFF_ATTEMPT and outcome.reason in UNSTABLE_NUMERICALLY)
            return self.stiff is not None and sinks and (few or outcome.verdict is Verdict.INVALID)
        return outcome.verdict is Verdict.INVALID and outcome.reason is not Reason.TIMEOUT

    def apply_to_sim(self, sim: Simulation) -> Simulation:
        """The run's options with the changes of this attempt. A smaller timestep changes options that count steps, but
        no option in seconds.
        """
        update: dict[str, Any] = {}
        if self.solver is not None:
            update["solver"] = self.solver
        if self.careful or self.solver is Solver.CG:
            update["solver_iterations"] = max(sim.solver_iterations or 0, CAREFUL_ITERATIONS)
        if self.careful:
            update["solver_tolerance"] = CAREFUL_TOLERANCE
        if self.timestep_divisor != 1:
            factor = self.timestep_divisor
            # The options are not validated again, since the divided timestep may be below the smallest timestep that
            # users may set.
            update["physics"] = sim.physics.model_copy(update={"timestep_s": sim.physics.timestep_s / factor})
            quiet = {name: getattr(sim.quiet, name) * factor for name in _COUNTED_IN_STEPS}
            update["quiet"] = sim.quiet.model_copy(update=quiet)
            if sim.iteration_limit is not None:
                update["iteration_limit"] = min(sim.iteration_limit * factor, MOST_ITERATIONS)
        changed = sim.changed(**update) if update else sim
        return changed if self.stiff is None else stiffened(changed, self.stiff, self.timestep_divisor)

    def after(self, before: Outcome | None, job: Job) -> Job:
        """The job of this attempt after an outcome of the previous attempt. If the pallet fell while it was built, an
        attempt with stiffer contacts only has to confirm the fall."""
        fell = before is not None and before.reason in MOTION_REASONS and job.drive is None
        return replace(job, confirms=True) if fell and self.stiff is not None else job

    def apply_to_jobs(self, jobs: Sequence[Job]) -> list[Job]:
        """The jobs, with soft boxes if this attempt simulates boxes as soft bodies. Profiles (motions of the carrier)
        are resampled to the attempt's timestep; jobs that share a profile also share the resampled profile."""
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
    AttemptRecipe(STIFF_ATTEMPT, None, stiff=0.5, most_boxes=96, few=True),
    AttemptRecipe(7, None, stiff=0.05, timestep_divisor=8, most_boxes=20, doubles=True),
    AttemptRecipe(8, None, timestep_divisor=2, checks=True),
    AttemptRecipe(9, None, soft=True),
)
"""The attempts, in order. Attempts 1 and 6 to 9 use the solver of the run (Newton by default)."""


def may_go_on(outcome: Outcome, sim: Simulation) -> bool:
    """Whether a world may need a further attempt. For most worlds the result is False."""
    return outcome.verdict is Verdict.INVALID or bool(int(outcome.flags) & _SINKING) or sim.check_timestep


FALLBACKS: Final = {"mjx-jax": "mujoco", "mjx-warp": "mujoco", "mjx-warp-cpu": "mujoco"}
"""Name of an engine → name of its fallback engine."""

_STIFFER_NOTE: Final = "worlds were simulated again on {}, with stiffer contacts"

_FALLBACK_NOTES: Final = {
    Capability.SOFT: "worlds with soft boxes were simulated on {}",
    Capability.SHEETS: "worlds with interlayer sheets or pallets among their boxes were simulated on {}",
    Capability.KINETIC_PAIRS: "worlds with kinetic friction by pairs of materials were simulated on {}",
    Capability.FLOAT64: "worlds were simulated again on {}, in double precision",
    Capability.FINE_DISTANCES: _STIFFER_NOTE,
    Capability.CG: "worlds were simulated on {}, the only engine with the solver cg",
}
"""Capability that an engine lacks → the note about the worlds that the fallback engine simulated for this reason."""

ATTEMPT_ENGINES: Final = {"mjx-warp": "mjx-warp-cpu"}
"""Name of an engine → name of the engine that makes further attempts on CPU threads at the same time, if few worlds
need further attempts."""

ENGINE_WITH_ATTEMPT_THREADS: Final = "mjx-warp-cpu"
"""Name of the engine that makes further attempts itself if few worlds need them: on additional threads of the same
process, while the run goes on. Without additional threads, further attempts would begin only when all first attempts
have ended. While the last first attempt runs, most threads of the engine would be idle."""


@dataclass(eq=False)
class Engines:
    """The engine of a run, and its fallback engine, which is created when the first world needs it."""

    primary: Engine
    progress: Progress

    @property
    def has_fallback(self) -> bool:
        """Whether the engine of the run has a fallback engine. This property does not create the fallback engine."""
        return self.primary.name in FALLBACKS

    @cached_property
    def fallback(self) -> Engine | None:
        name = FALLBACKS.get(self.primary.name)
        return make_engine(name) if name is not None else None

    def for_job(self, job: Job, sim: Simulation, attempt: AttemptRecipe, *, soft: bool = False) -> Engine:
        """The engine that simulates a job at an attempt.

        Args:
            soft: whether the attempt has soft boxes.
        """
        if not self.has_fallback:
            return self.primary
        needs = {
            Capability.SOFT: soft,
            Capability.SHEETS: bool(job.scene.pieces),
            Capability.KINETIC_PAIRS: "kinetic" in job.scene.pairs,
            attempt.needs: True,
            Capability.CG: sim.solver is Solver.CG,
        }
        missing = [need for need, needed in needs.items() if needed and need not in self.primary.capabilities]
        foreign = isinstance(job.start, KeptState) and job.start.engine != self.primary.name
        if not missing and not foreign:
            return self.primary
        assert self.fallback is not None
        if missing:
            self.note(_FALLBACK_NOTES[missing[0]].format(self.fallback.name))
        return self.fallback

    def attempt_engine(self, job: Job, sim: Simulation, attempt: AttemptRecipe, *, soft: bool, few: bool) -> str | None:
        """Name of the engine that makes a further attempt at a job while the engine of the run simulates other jobs. If
        the result is None, the engine of the run itself makes the attempt.

        Args:
            few: whether few worlds need the attempt. If the engine of the run can make the attempt, and many worlds
                need it, the engine of the run makes it. The engine of the run also makes the attempt if the job has a
                drive (a motion of the carrier), or if its settled state is kept, since there may be many jobs of these
                two kinds.
        """
        if self.primary.name not in (*ATTEMPT_ENGINES, ENGINE_WITH_ATTEMPT_THREADS):
            return None
        engine = self.for_job(job, sim, attempt, soft=soft)
        if self.primary.name == ENGINE_WITH_ATTEMPT_THREADS:
            return ENGINE_WITH_ATTEMPT_THREADS if engine is self.primary and few and not job.settles else None
        if engine is not self.primary:
            return engine.name
        if not few or job.settles:
            return None
        name = ATTEMPT_ENGINES[self.primary.name]
        self.note(_STIFFER_NOTE.format(name))
        return name

    @cached_property
    def attempt_simulator(self) -> AttemptSimulator:
        """The processes or threads that make attempts at the same time as the engine of the run."""
        if (
            isinstance(threads := getattr(self.primary, "threads", None), int)
            and self.primary.name == ENGINE_WITH_ATTEMPT_THREADS
        ):
            return AttemptThreads(threads)
        return AttemptProcess("petmjx.engines.subprocess.attempt_child")

    def note_failure(self, engine: str, attempt: int, worlds: int, message: str) -> None:
        """Add a note that an error ended an attempt on an engine. The note also says what happens to the worlds without
        an outcome: they become invalid, or go to the fallback engine."""
        other = self.fallback
        then = "invalid (failed)" if other is None or engine == other.name else f"went to {other.name}"
        tail = f"; {count_text(worlds, 'world')}: {then}" if worlds else ""
        self.note(f"attempt {attempt}: {engine} failed ({message}){tail}")

    def note(self, text: str) -> None:
        """Add a note to ``run.json``."""
        self.progress.notes[text] = None


def ready_for(engine: str, job: Job) -> Job:
    """The job in a form that an engine can run. An engine can start only from its own states, so a state of another
    engine is removed. The engine then simulates the placement of the boxes again."""
    if not isinstance(job.start, KeptState):
        return job
    start = job.start.state if job.start.engine == engine else None
    return Job(**{**vars(job), "start": start})  # this is three times as fast as ``replace``
