"""Which engine simulates a world: that of the run, or its stand-in, C MuJoCo, where that cannot.

The MJX engines work in single precision, and ``mjx-warp`` has Newton's method alone. So C MuJoCo makes the attempts
that want double precision and worlds with soft boxes, simulates with conjugate gradients, and takes over what an error
of theirs left unanswered.
``mujoco`` itself and an engine of the user's own have no stand-in.

A single world takes a GPU as long as many. So of a run on ``mjx-warp`` further attempts that few worlds need are made
beside it, on CPU threads (petmjx/engines/beside): those of C MuJoCo, and with stiffer contacts those of
``mjx-warp-cpu``, the same kernels. Who makes an attempt depends on the world and the options alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from petmjx.config import Simulation, Solver
from petmjx.engines.base import Engine, Progress
from petmjx.engines.beside.host import Beside, InProcess
from petmjx.engines.choose import make_engine
from petmjx.text import counted
from petmjx.world.job import Job, KeptState

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
                self.note(f"worlds were simulated on {self.stand_in.name}: the solver cg is its")
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
        if not few or job.drive is not None or job.keep_state:
            return None
        name = BESIDE[self.own.name]
        self.note(f"worlds were simulated again on {name}, in stiffer contacts")
        return name

    @cached_property
    def helper(self) -> Beside:
        """Makes attempts beside the engine of the run."""
        return InProcess()

    def note_failure(self, engine: str, attempt: int, worlds: int, message: str) -> None:
        """Say that an error ended an engine's attempt, and what becomes of the worlds that it left unanswered."""
        other = self.stand_in
        then = "invalid by failed" if other is None or engine == other.name else f"went to {other.name}"
        self.note(f"attempt {attempt}: {engine} failed ({message}); {counted(worlds, 'world')}: {then}")

    def note(self, text: str) -> None:
        """A line for ``run.json``."""
        self.progress.notes[text] = None


def ready_for(engine: str, job: Job) -> Job:
    """A job as an engine takes it: with a state of its own to start from. From another engine's state it does not
    start: it takes the world through its placement again."""
    if not isinstance(job.start, KeptState):
        return job
    return replace(job, start=job.start.state if job.start.engine == engine else None)
