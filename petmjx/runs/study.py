"""``Study``: defines which worlds (simulations) a run makes from its plans, and how it summarises them. This module
also has the study of a plain score, ``Nominal``: one unchanged world per plan. Studies with several variants of each
plan are in petmjx.runs.sweep_study.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, duration, rounded_text
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.expected_work import Work
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Attempt, Outcome
from petmjx.engines.world_results import World
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import Skipped
from petmjx.plans.plan_workload import statics_of
from petmjx.results.recording import Recording
from petmjx.results.resume import CompletedWorlds
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import Param
from petmjx.world.edge_distances import EdgeRisk
from petmjx.world.job import Job
from petmjx.world.scene import Scene, build_scenes
from petmjx.world.supports import deck_mm
from petmjx.world.variants import UNCHANGED, Variant

MAX_WORLDS: Final = 1_000_000
"""Largest number of worlds of a run, unless the user allows more (``allow_large``)."""

NOMINAL: Final = Variant(0, UNCHANGED)


@dataclass(frozen=True)
class LegEnd:
    """The leg (part of the journey) in which a world of a chain ended, and when the leg began.

    Attributes:
        began_s: simulated time at which the leg began, s; 0 for the placement of boxes.
    """

    leg: str
    began_s: float


@dataclass(frozen=True, eq=False)
class FinishedWorld:
    """One world (simulation of a plan) with its final outcome.

    Attributes:
        placement: outcome of the settled placement from which the world started; None if the world placed the boxes
            itself.
        driven: whether the drive (motion of the carrier) was simulated. If the placement does not stand and early stop
            is on, the drive is skipped, and the world gets the outcome of the placement. Without early stop, the drive
            is simulated even if the placement does not stand, but the world cannot be stable.
        ended_in: the leg in which a world of a chain ended; None if the pallet arrived, or if the world has no chain.
    """

    plan: Plan
    variant: Variant
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]
    placement: Outcome | None = None
    driven: bool = False
    ended_in: LegEnd | None = None


@dataclass(eq=False, kw_only=True)
class Study(ABC):
    """Defines which worlds (simulations) a run makes from its plans, and how it summarises them.

    Attributes:
        sim: options of every world. Further attempts at a world may use other options.
        everything: all plans that can be simulated, including the plans of other shards.
        plans: the plans that this run simulates.
        work: numbers of placements and drives of all worlds, for estimates of time.
        n_worlds: largest possible number of worlds.
        variants: numbers of the variants of each plan; None in a search, in which outcomes determine the worlds.
        amount: text with the numbers of plans and worlds, for messages.
        command: the command in ``run.json``, "score" or "sweep".
        what: the noun for a world in messages.
        skipped: plans that this study cannot simulate.
        notes: warnings about the whole run.
        params: columns of ``worlds`` that distinguish the worlds of a plan.
        dynamic: whether worlds have drives (motions of the carrier).
        legs: whether worlds pass through several legs of a chain.
        axes: names of the axes of a sweep.
        has_errors: whether positions or sizes have errors in some worlds.
        identity: settings on which worlds depend, besides the plans and ``sim``.
        config: entries of ``run.json`` about the study, in addition to the options.
        edge_risks: plan id → ``EdgeRisk`` of the plan, for the plans whose ``EdgeRisk`` was computed before the run
            began.
    """

    sim: Simulation
    everything: Sequence[Plan]
    plans: Sequence[Plan]
    work: Work
    n_worlds: int
    variants: range | None
    amount: str
    command: str = "score"
    what: str = "plan"
    skipped: Sequence[Skipped] = ()
    notes: Sequence[str] = ()
    params: Sequence[Param] = ()
    dynamic: bool = False
    legs: bool = False
    axes: Collection[str] = ()
    has_errors: bool = False
    identity: Mapping[str, Any] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    edge_risks: Mapping[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int | None:
        """Number of worlds of the run; None if the number is unknown."""
        return None if self.variants is None else self.n_worlds

    def size(self, seconds: float | None, recorded: int = 0) -> str:
        """One line with the number of worlds, the expected number of steps, and the expected time.

        Args:
            seconds: expected time of all worlds, s; None if it is unknown.
            recorded: number of worlds that are already completed. The line gives the steps and the time of the worlds
                that are still to be simulated.
        """
        share = 1 - recorded / max(self.n_worlds, 1)
        left = " left" if recorded else ""
        long = "" if seconds is None else f", about {duration(share * seconds)}"
        return f"{self.amount}, about {rounded_text(share * float(self.work.steps.sum()))} steps{left}{long}"

    @abstractmethod
    def worlds(
        self, engine: Engine, recorded: CompletedWorlds, recording: Recording, progress: Progress
    ) -> Iterator[FinishedWorld]:
        """Simulate the missing worlds. Yields each world when its outcome is final, in any order.

        Args:
            recorded: the completed worlds of the run.
            recording: determines for which worlds histories are recorded.
            progress: progress of the run, which is updated during the simulation.
        """

    def values(self, world: FinishedWorld) -> Mapping[str, Any]:
        """The values of a world in the columns ``params``: column → value."""
        return {}

    def timings(self) -> Mapping[str, float]:
        """Facts about the simulation of all worlds: name → a time in s, or a count such as a number of steps. The
        values are final when all worlds have ended."""
        return {}

    def summarise(self, writer: RunWriter) -> None:
        """Write the table ``summary``, after all worlds of the run have been written."""
        return None


class Nominal(Study):
    """The study of a plain score: one unchanged world per plan.

    Raises:
        InputError: there are more than a million plans, and ``allow_large`` is not set.
    """

    def __init__(self, sim: Simulation, plans: Sequence[Plan], options: RunOptions) -> None:
        if len(plans) > MAX_WORLDS and not options.allow_large:
            raise InputError(
                f"{len(plans):,} plans, more than {MAX_WORLDS:,}: "
                f"pass {option('--yes', 'True', python='allow_large')} to confirm"
            )
        shard_plans = [plan for plan in plans if options.takes(plan.plan_id)]
        super().__init__(
            sim=sim,
            everything=plans,
            plans=shard_plans,
            work=Work(
                sim,
                [plan.n_boxes for plan in shard_plans],
                **statics_of(shard_plans, partial(deck_mm, sim=sim))._asdict(),
            ),
            n_worlds=len(shard_plans),
            variants=range(1),
            amount=count_text(len(shard_plans), "plan"),
        )

    def worlds(
        self, engine: Engine, recorded: CompletedWorlds, recording: Recording, progress: Progress
    ) -> Iterator[FinishedWorld]:
        missing = [plan for plan in self._longest_first() if (plan.plan_id, NOMINAL.index) not in recorded]
        worlds = (
            World(plan, NOMINAL.index, self.job(plan, scene, recording))
            for plan, scene in zip(missing, build_scenes(missing, self.sim), strict=True)
        )
        expected_s = dict(
            zip((plan.plan_id for plan in self.plans), MEASURED.kernel.placing_s(self.work).tolist(), strict=True)
        )
        total_s, done_s = sum(expected_s[plan.plan_id] for plan in missing), 0.0
        for scored_world in score_worlds(worlds, self.sim, engine, progress=progress):
            world = scored_world.world
            # the share of the work, not of worlds: long worlds come first, so the share of worlds would be too small
            done_s += expected_s[world.plan.plan_id]
            progress.work_share = done_s / total_s
            yield FinishedWorld(world.plan, NOMINAL, world.job.scene, scored_world.outcome, scored_world.attempts)

    def job(self, plan: Plan, scene: Scene, recording: Recording) -> Job:
        """The job of a plan's world. ``recording``: see ``worlds``."""
        return Job(scene, record=recording.of(plan), edge_risk=self.edge_risks.get(plan.plan_id))

    def _longest_first(self) -> Iterator[Plan]:
        """The plans, sorted by their ``EdgeRisk`` and then by the number of boxes that are expected to be placed, the
        largest number first. In this order, long worlds begin early, so that the run need not wait for a long world at
        its end."""
        placed = np.asarray(self.work.boxes) * self.work.share
        risk = np.array([self.edge_risks.get(plan.plan_id, EdgeRisk.INSIDE) for plan in self.plans], int)
        return (self.plans[number] for number in np.lexsort((-placed, -risk)).tolist())
