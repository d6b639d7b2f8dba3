"""The worlds in which packings are simulated (``WorldsOfPlans``): the same worlds as in ``petmjx.score`` with
``confidence``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from petmjx.engines.cost_model import Work
from petmjx.engines.world_results import World
from petmjx.options.run_options import Confidence, RunOptions, sorted_options
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import without_narrow_walls, without_vanishing_boxes
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.sweep_worlds import PlacementGroup, SweepPlan
from petmjx.world.job import Job
from petmjx.world.scene import build_scene


class WorldsOfPlans:
    """Makes the worlds of plans. Variant 0 of a plan is the nominal (unchanged) world. All other variants have errors.

    Attributes:
        sim: options of the simulation of every world.
        run: options of the run.

    Args:
        n_worlds: number of worlds with errors for each plan.
        how: options of ``petmjx.score``.

    Raises:
        InputError: the options are unusable.
    """

    def __init__(self, n_worlds: int, how: Mapping[str, Any]) -> None:
        of_simulation, of_run, errors = sorted_options(how, Confidence)
        self.run = RunOptions(**of_run)
        sure = Confidence(**errors, **({"confidence": n_worlds} if n_worlds else {}))
        self._sweep = confidence_sweep(n_worlds, sure.errors, of_simulation) if n_worlds else None
        self.sim = self._sweep.simulation if self._sweep else Simulation(**of_simulation)
        self._variants: SweepPlan | None = None

    @property
    def work(self) -> Work:
        """The amount of work for one plan. The amount for all plans is not needed: only the engine ``auto`` would
        depend on it, but packers always name an engine."""
        return Work(self.sim, [1])

    def of(self, plan: Plan, variants: Iterable[int]) -> Iterator[World]:
        """The worlds of the given variants of a plan.

        Raises:
            InputError: a box has no extent left after the size reduction, or walls leave no room.
        """
        without_vanishing_boxes(PlanSet([plan]), self.sim.size_reduction_mm, strict=True)
        without_narrow_walls(PlanSet([plan]), self.sim.carrier, self.sim.walls, strict=True)
        if self._sweep is None:
            yield from (World(plan, number, Job(build_scene(plan, self.sim))) for number in variants)
            return
        if self._variants is None:  # the variants are made only once, since they are the same for all plans
            self._variants = SweepPlan(self._sweep, [plan])
        placements = [*self._variants.placements()]
        groups = (PlacementGroup(plan, number, *placements[number]) for number in variants)
        for group, scene in self._variants.scenes(groups):
            yield World(plan, group.index, self._variants.job(group, scene))
