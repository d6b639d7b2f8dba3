"""Attempts at a world: the changed settings of each attempt, the outcomes that require it, and its engine.

The rules: docs/rules.md, section 9.

The first attempts are those of the PET-Physics paper (Newton, then CG, up to two attempts each). An attempt with half
the timestep follows. Worlds whose verdict may come from soft contacts (``petmjx.engines.contact_penetration``) have two
attempts of their own. An optional last attempt has soft boxes, like the third attempt of the reference implementation.
The second attempts of the reference implementation repeat the same deterministic run. Here, a second attempt gives the
solver up to ``CAREFUL_ITERATIONS`` iterations and ``CAREFUL_TOLERANCE``. This helps if the solver had stopped too
early.

The MJX engines work in single precision, and ``mjx-warp`` has only Newton's method. So C MuJoCo is their *fallback*
(``FALLBACKS``). C MuJoCo makes the attempts that need double precision, simulates worlds with soft boxes and with
conjugate gradients, and simulates worlds that got no answer because of an error. ``mujoco`` itself and a user's own
engine have no fallback.

A GPU takes as long for a single world as for many. So in a run on ``mjx-warp``, rare further attempts are made beside
the engine, on CPU threads (petmjx/engines/subprocess). These are the attempts of C MuJoCo, and attempts with stiffer
contacts, which ``mjx-warp-cpu`` makes with the same kernels. A run on ``mjx-warp-cpu`` makes attempts with stiffer
contacts on additional threads (petmjx/engines/attempt_threads.py). The engine of an attempt depends only on the world
and the options.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from petmjx.common.text import count_text
from petmjx.engines.attempt_threads import ThreadSimulator
from petmjx.engines.contact_penetration import stiffened_physics
from petmjx.engines.engine_choice import make_engine
from petmjx.engines.protocol import Capability, Engine, Progress
from petmjx.engines.subprocess.attempt_host import SideSimulator, SubprocessSimulator
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.physics import Cone
from petmjx.options.simulation import Attempts, Simulation, Solver
from petmjx.world.job import Excitation, Job, KeptState

CAREFUL_ITERATIONS = 400
"""Largest number of solver iterations per step in a second attempt: four times MuJoCo's default. With the default, CG
stops so early that ``pallet`` boxes that should stand slide apart."""

CAREFUL_TOLERANCE = 1e-10
"""Solver tolerance of a second attempt: a hundredth of MuJoCo's default. Engines of lower precision use a larger
tolerance."""

NEAR = 0.5
"""Worlds with a smaller absolute margin are checked at half the timestep. The margin of invalid worlds is NaN, so they
are not checked."""

STIFF_QUIET_STEPS = 25
"""``Quiet.steps`` for attempts with stiff contacts, whose verdicts depend on movements of less than a millimetre. Of
6,000 small stacks whose verdicts follow from statics, some fell although they should stand: 5 with 15 steps, 4 with 25,
and 3 with 50. With 50 steps, pallets that tremble take three times as long."""

# Numbers are compared several times as fast as members of ``Flag``.
_EARLY_STOP, _SINKING = int(Flag.EARLY_STOP), int(Flag.SINKING)

_COUNTED_IN_STEPS = ("steps", "landing_steps", "poll_steps", "still_steps", "tremble_steps")
"""Fields of ``Quiet`` that are numbers of steps."""


@dataclass(frozen=True)
class AttemptRecipe:
    """One attempt: the settings that it changes (docs/rules.md, section 9)."""

    number: int
    solver: Solver | None
    careful: bool = False
    timestep_divisor: int = 1
    stiff: float | None = None
    """Time constant of contacts, as a share of the usual one. A smaller time constant makes contacts stiffer. Used only
    for worlds whose verdict may come from soft contacts (``Flag.SINKING``)."""
    checks: bool = False
    """True: the attempt keeps the verdict, and only sets ``Flag.TIMESTEP`` if it finds a different one."""

    most_boxes: int | None = None
    """Worlds with more boxes than this do not make the attempt: they keep their verdict, if they have one, and
    ``Flag.SINKING``. With stiff contacts, steps of hundreds of boxes take tens of milliseconds, and the leaning boxes
    are only a small part of the pallet."""
    soft: bool = False
    """True: all boxes are flex bodies from the beginning (petmjx/world/soft_boxes.py)."""

    doubles: bool = False
    """Whether the attempt needs double precision. One reason: a world may be invalid because of single precision.
    Another reason: in contacts with a twentieth of the time constant, boxes sink by less than single precision
    resolves."""

    few: bool = False
    """Whether only few of many worlds need the attempt. Worlds with errors are an exception, if the plan has boxes that
    may sink."""

    def is_for(self, outcome: Outcome, sim: Simulation) -> bool:
        """Whether this attempt may give another result than the previous one. No attempt gives a world more time."""
        if self.checks:
            # a world that ended early has the margin of a falling box, which is not a near miss
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
        """The run's options with the changes of this attempt. Times in seconds stay the same."""
        update: dict[str, Any] = {}
        if self.solver is not None:
            update["solver"] = self.solver
        if self.careful or self.solver is Solver.CG:
            update["solver_iterations"] = max(sim.solver_iterations or 0, CAREFUL_ITERATIONS)
        if self.careful:
            update["solver_tolerance"] = CAREFUL_TOLERANCE
        if self.timestep_divisor != 1:
            factor = self.timestep_divisor
            # The options are not validated again, since a fraction of the smallest timestep may be below the limit for
            # users.
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
        """The same jobs with the boxes of this attempt. Profiles are resampled to its timestep and still shared."""
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


def may_go_on(outcome: Outcome, sim: Simulation) -> bool:
    """Whether any further attempt may be needed for a world. For most worlds of a run the answer is no."""
    return outcome.verdict is Verdict.INVALID or bool(int(outcome.flags) & _SINKING) or sim.check_timestep


FALLBACKS: Final = {"mjx-jax": "mujoco", "mjx-warp": "mujoco", "mjx-warp-cpu": "mujoco"}
"""Engine → its fallback engine."""

_FALLBACK_NOTES: Final = {
    Capability.SOFT: "worlds with soft boxes were simulated on {}",
    Capability.SHEETS: "worlds with interlayer sheets or pallets among their boxes were simulated on {}",
    Capability.KINETIC_PAIRS: "worlds with kinetic friction by pairs of materials were simulated on {}",
    Capability.FLOAT64: "worlds were simulated again on {}, in double precision",
    Capability.CG: "worlds were simulated on {}, the only engine with the solver cg",
}
"""Capability that an engine lacks → the note about worlds that its fallback simulated."""

BESIDE: Final = {"mjx-warp": "mjx-warp-cpu"}
"""Engine → the engine that makes rare further attempts beside it, on CPU threads."""

BESIDE_ITSELF: Final = "mjx-warp-cpu"
"""The engine whose runs make rare further attempts on additional threads. Otherwise, while the last world is simulated,
most of the engine's own threads would be idle."""


@dataclass(eq=False)
class Engines:
    """The engine of a run, and its fallback, which is built once a world needs it."""

    primary: Engine
    progress: Progress

    @property
    def has_fallback(self) -> bool:
        """Whether the engine of the run has a fallback. The fallback is not built for this answer."""
        return self.primary.name in FALLBACKS

    @cached_property
    def fallback(self) -> Engine | None:
        name = FALLBACKS.get(self.primary.name)
        return make_engine(name) if name is not None else None

    def for_job(self, job: Job, sim: Simulation, *, doubles: bool, soft: bool = False) -> Engine:
        """The engine of a job. ``doubles``: whether the attempt needs double precision; ``soft``: whether it has soft
        boxes."""
        if not self.has_fallback:
            return self.primary
        needs = {
            Capability.SOFT: soft,
            Capability.SHEETS: bool(job.scene.pieces),
            Capability.KINETIC_PAIRS: job.scene.pair_kinetic is not None,
            Capability.FLOAT64: doubles,
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

    def beside(self, job: Job, sim: Simulation, *, doubles: bool, soft: bool, few: bool) -> str | None:
        """The engine that makes a further attempt at a job beside the engine of the run; None: no such engine.

        Args:
            few: whether few worlds need the attempt. A job with a drive, or with a state from which other worlds start,
                stays with the engine of the run, since there may be many such jobs.
        """
        if self.primary.name not in (*BESIDE, BESIDE_ITSELF):
            return None
        engine = self.for_job(job, sim, doubles=doubles, soft=soft)
        if self.primary.name == BESIDE_ITSELF:
            return BESIDE_ITSELF if engine is self.primary and few and not job.settles else None
        if engine is not self.primary:
            return engine.name
        if not few or job.settles:
            return None
        name = BESIDE[self.primary.name]
        self.note(f"worlds were simulated again on {name}, with stiffer contacts")
        return name

    @cached_property
    def helper(self) -> SideSimulator:
        """The processes or threads that make attempts beside the engine of the run."""
        if isinstance(threads := getattr(self.primary, "threads", None), int) and self.primary.name == BESIDE_ITSELF:
            return ThreadSimulator(threads)
        return SubprocessSimulator()

    def note_failure(self, engine: str, attempt: int, worlds: int, message: str) -> None:
        """Note that an error ended an attempt on an engine, and what happens to the worlds without an answer."""
        other = self.fallback
        then = "invalid by failed" if other is None or engine == other.name else f"went to {other.name}"
        self.note(f"attempt {attempt}: {engine} failed ({message}); {count_text(worlds, 'world')}: {then}")

    def note(self, text: str) -> None:
        """Add a line for ``run.json``."""
        self.progress.notes[text] = None


def ready_for(engine: str, job: Job) -> Job:
    """The job in a form that an engine can run: a start state of another engine is removed, since an engine can use
    only its own states. Then the engine simulates the placement again."""
    if not isinstance(job.start, KeptState):
        return job
    start = job.start.state if job.start.engine == engine else None
    return Job(**{**vars(job), "start": start})  # three times as fast as ``replace``; a Job has only fields
