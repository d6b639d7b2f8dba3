"""Which worlds a run makes of its plans, and what it says of them.

A score's are here: one a plan, the plan as it is. What has variants is in petmjx.sweeps, and stands on this.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from petmjx.config import Simulation
from petmjx.engines.base import Engine, Progress
from petmjx.engines.cost import Work
from petmjx.engines.retry import World, score_worlds
from petmjx.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import Skipped
from petmjx.results.recorded import Recorded
from petmjx.results.recording import Recording
from petmjx.results.schema import Param
from petmjx.results.writer import RunWriter
from petmjx.run_options import RunOptions
from petmjx.text import counted, duration, rounded
from petmjx.verdict import Attempt, Outcome
from petmjx.world.job import Job
from petmjx.world.scene import Scene, build_scene
from petmjx.world.variants import UNCHANGED, Variant

MAX_WORLDS: Final = 1_000_000
"""More worlds than this are refused, unless the user allows them (``allow_large``)."""

NOMINAL: Final = Variant(0, UNCHANGED)


@dataclass(frozen=True, eq=False)
class FinishedWorld:
    """One world with its final outcome.

    Attributes:
        placement: what the placement came to from which it was forked; None for a world that was simulated from its
            beginning.
        driven: whether its drive was simulated. If the placement does not stand, the world has its outcome; without
            early stop it is shaken, too, but is not stable.
    """

    plan: Plan
    variant: Variant
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]
    placement: Outcome | None = None
    driven: bool = False


class Study(ABC):
    """Which worlds a run makes of its plans, and what it says of them.

    What is not abstract is that of a run with one world a plan.

    Attributes:
        command: "score" or "sweep", as the results name it.
        sim: the options of every world, before attempts change them.
        everything: the plans that can be simulated, also those of other shards.
        plans: those of this run.
        skipped: plans that this study cannot take.
        what: the user's word for a world.
        params: columns of ``worlds`` that tell a plan's worlds apart.
        dynamic: whether worlds have drives.
    """

    command: str = "score"
    sim: Simulation
    everything: Sequence[Plan]
    plans: Sequence[Plan]
    skipped: Sequence[Skipped] = ()
    what: str = "plan"
    params: Sequence[Param] = ()
    dynamic: bool = False

    @property
    def n_worlds(self) -> int:
        """Number of worlds, at most."""
        return len(self.plans)

    @property
    def total(self) -> int | None:
        """Number of worlds; None if it is not known."""
        return self.n_worlds

    @property
    def amount(self) -> str:
        """What is simulated, in words."""
        return counted(len(self.plans), "plan")

    @abstractmethod
    def work(self) -> Work:
        """What all worlds cost, for estimates of time."""

    @abstractmethod
    def worlds(
        self, engine: Engine, recorded: Recorded, recording: Recording, progress: Progress
    ) -> Iterator[FinishedWorld]:
        """Simulate what is missing; yield each world when it is final, in any order.

        Args:
            recorded: the worlds that the run already has.
            recording: which worlds' histories are recorded.
            progress: kept up to date.
        """

    def size(self, seconds: float | None) -> str:
        """One line with the number of worlds and steps, and the expected time (``seconds``; None: not known)."""
        long = "" if seconds is None else f", about {duration(seconds)}"
        return f"{self.amount}, about {rounded(float(self.work().steps.sum()))} steps{long}"

    def values(self, world: FinishedWorld) -> Mapping[str, Any] | None:
        """The world's values of ``params``."""
        return None

    def identity(self) -> dict[str, Any]:
        """What its worlds depend on, beside plans and ``sim``."""
        return {}

    def config(self) -> dict[str, Any]:
        """What ``run.json`` says of it, beside options."""
        return {}

    def notes(self) -> Iterable[str]:
        """Warnings about the whole run."""
        return ()

    def timings(self) -> Mapping[str, float]:
        """What has taken how long, once all worlds are there."""
        return {}

    def summarise(self, writer: RunWriter) -> None:
        """Write the table ``summary`` of a run whose worlds are all there."""
        return None


class Nominal(Study):
    """One world a plan, the plan as it is: a score.

    Raises:
        InputError: more than a million plans, without ``allow_large``.
    """

    def __init__(self, sim: Simulation, plans: Sequence[Plan], options: RunOptions) -> None:
        if len(plans) > MAX_WORLDS and not options.allow_large:
            raise InputError(f"{len(plans):,} plans, more than {MAX_WORLDS:,}: pass --yes if that is meant")
        self.sim, self.everything = sim, plans
        self.plans = [plan for plan in plans if options.takes(plan.plan_id)]

    def work(self) -> Work:
        return Work(self.sim, [plan.n_boxes for plan in self.plans])

    def worlds(
        self, engine: Engine, recorded: Recorded, recording: Recording, progress: Progress
    ) -> Iterator[FinishedWorld]:
        missing = (plan for plan in self.plans if (plan.plan_id, NOMINAL.index) not in recorded)
        asked = (
            World(plan, NOMINAL.index, Job(build_scene(plan, self.sim), record=recording.of(plan))) for plan in missing
        )
        for found in score_worlds(asked, self.sim, engine, progress=progress):
            world = found.world
            yield FinishedWorld(world.plan, NOMINAL, world.job.scene, found.outcome, found.attempts)
