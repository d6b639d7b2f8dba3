"""Settled placements, and the worlds that start from them: drives (motions of the carrier), and the legs of a chain."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

from petmjx.engines.verdict import Attempt, Flag, Outcome, Verdict, judge
from petmjx.engines.world_results import World
from petmjx.options.simulation import Thresholds
from petmjx.options.walls import Side
from petmjx.runs.chain_legs import PLACING
from petmjx.runs.study import FinishedWorld, LegEnd
from petmjx.runs.sweep_worlds import PlacementGroup
from petmjx.runs.transport_limits import load_height_m
from petmjx.world.scene import Scene
from petmjx.world.variants import LegSpec, Variant


@dataclass(frozen=True, eq=False)
class PlacementWorld(World):
    """The placement of a plan's boxes, as a world that the engine simulates."""

    group: PlacementGroup


@dataclass(frozen=True, eq=False)
class SettledPlacement:
    """A placement that has settled: its outcome, with the state from which drives start."""

    group: PlacementGroup
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]
    _of_legs: dict[tuple[float | None, tuple[Side, ...]], Scene] = field(default_factory=dict, init=False)
    """(turns of film, open walls) → the scene with this film and these open walls."""

    @cached_property
    def load_height_m(self) -> float:
        """Height of the load at rest, m. It is the same for all drives of the placement."""
        return load_height_m(self.outcome.boxes.pos, self.scene.half_size)

    def shaken(self, outcome: Outcome, thresholds: Thresholds) -> Outcome:
        """The outcome of a drive or leg, judged together with the outcome of its placement. Its history begins with the
        history of the placement."""
        placed = self.outcome
        if outcome.verdict is Verdict.STABLE and placed.verdict is not Verdict.STABLE:
            judge_args = outcome.flags, outcome.boxes, outcome.n_placed, thresholds
            verdict, reason = judge(*judge_args, placement=(placed.verdict, placed.reason))
            outcome = replace(
                outcome,
                verdict=verdict,
                reason=reason,
                culprit=placed.culprit,
                first_sign_s=placed.first_sign_s,
                margin=min(outcome.margin, placed.margin),
            )
        if outcome.history is None or placed.history is None:
            return outcome
        return replace(outcome, history=placed.history.then(outcome.history))

    def undriven(self, variant: Variant) -> FinishedWorld:
        """A world that is not shaken. It has the outcome of the placement, and nothing more is simulated."""
        outcome = replace(self.outcome, flags=self.outcome.flags | Flag.FORKED, n_steps=0, state=None)
        end = LegEnd(PLACING, 0.0) if variant.legs else None
        return FinishedWorld(self.group.plan, variant, self.scene, outcome, self.attempts, self.outcome, ended_in=end)

    def scene_of(self, leg: LegSpec) -> Scene:
        """The scene during a leg: with the film of the leg around the pallet, and without the walls that the leg
        opens."""
        key = leg.wrap_turns, leg.open_walls
        if key == (None, ()):
            return self.scene
        if key not in self._of_legs:
            scene = self.scene
            if leg.wrap_turns is not None:
                scene = replace(scene, wrap=scene.wrap.changed(turns=leg.wrap_turns))
            # The carrier of the scene already lacks the walls that the options open.
            closed = [side for side in leg.open_walls if side in scene.carrier.walls]
            self._of_legs[key] = scene.with_open_walls(closed) if closed else scene
        return self._of_legs[key]


Test = tuple[int, int]
"""(number of an item of a search, index of the tested level), as in `Bisection`."""


@dataclass(frozen=True, eq=False)
class DriveWorld(World):
    """A drive from a settled placement, as a world that the engine simulates. ``test``: the test of a search for which
    the drive is simulated. (-1, -1): no search."""

    settled: SettledPlacement
    change: Variant
    test: Test = (-1, -1)


@dataclass(frozen=True, eq=False)
class LegStart:
    """The state from which a leg of a chain begins.

    Attributes:
        changes: variants of the worlds that begin this leg together. Their chains are equal up to this leg.
        number: index of the leg in these chains.
        before: the outcome of the previous leg. None in the first leg.
    """

    settled: SettledPlacement
    changes: tuple[Variant, ...]
    number: int
    before: Outcome | None


@dataclass(frozen=True, eq=False)
class LegWorld(World):
    """A leg of a chain, as a world that the engine simulates."""

    begin: LegStart

    @property
    def leg(self) -> LegSpec:
        return self.begin.changes[0].legs[self.begin.number]
