"""Settled placements (simulations in which all boxes are placed and at rest), and the simulations that start from their
states: drives (motions of the carrier), and the legs of a chain. This module also limits the numbers of simulations and
states in memory."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

from petmjx.engines.simulation_loop import MOST_PENDING
from petmjx.engines.verdict import Attempt, Flag, Outcome, Verdict, judge
from petmjx.engines.world_results import World
from petmjx.options.thresholds import Thresholds
from petmjx.options.walls import Side
from petmjx.runs.chain_legs import PLACING
from petmjx.runs.eumos_limits import load_height_m
from petmjx.runs.level_search import LevelSearch, Probe
from petmjx.runs.study import FinishedWorld, LegEnd
from petmjx.runs.sweep_worlds import PlacementGroup
from petmjx.world.scene import Scene
from petmjx.world.variants import LegSpec, Variant


@dataclass(frozen=True)
class Batching:
    """Limits for the numbers of simulations and states of a sweep that are in memory and in the engine at the same
    time. The results of a sweep do not depend on the limits.

    Attributes:
        undriven: for plans that are placed and not shaken, largest number of simulations in one call of the engine. The
            states of these simulations are not stored.
        placements: largest number of stored settled states. A state with 43 boxes takes 10 to 20 KB.
        worlds: largest number of variants that start from stored states at the same time. If a single placement has
            more variants than ``worlds``, all of them start together.
        drives: for searches and chains, largest number of simulations that start from stored states in one call of the
            engine. In a search, only the first tests of each profile and direction are counted; in a chain, all worlds
            are counted.
        histories: largest number of settled states that are stored with their histories. A history with 43 boxes takes
            1 MB.
    """

    undriven: int = MOST_PENDING
    placements: int = 8192
    worlds: int = 65_536
    drives: int = 16_384
    histories: int = 256


@dataclass(frozen=True, eq=False)
class PlacementWorld(World):
    """A simulation in which the boxes of a plan are placed, as a job for the engine."""

    group: PlacementGroup


@dataclass(frozen=True, eq=False)
class SettledPlacement:
    """A simulated placement of boxes that are now at rest: its outcome, with the state from which drives start."""

    group: PlacementGroup
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]
    _of_legs: dict[tuple[float | None, tuple[Side, ...]], Scene] = field(default_factory=dict, init=False)
    """(number of turns of film, open walls) → the scene with this film and these open walls."""

    @cached_property
    def load_height_m(self) -> float:
        """Height of the load at rest, m. All drives that start from this placement are made for this height."""
        return load_height_m(self.outcome.boxes.pos, self.scene.half_size)

    def shaken(self, outcome: Outcome, thresholds: Thresholds) -> Outcome:
        """The outcome of a drive or leg, judged together with the outcome of the placement from which it started. The
        history of the outcome begins with the history of the placement."""
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
        """The finished world of a variant without shaking. A world without shaking gets the outcome of the placement,
        and needs no further simulation."""
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


@dataclass(frozen=True, eq=False)
class PlacementSearch:
    """A search for the largest level that one placement survives, with one profile in one direction.

    Attributes:
        number: index of the profile and direction in ``SweepPlan.search_items``.
        levels: what the search has found so far.
        results: index of a level → result, for the tests of the present round that have ended.
    """

    group: PlacementGroup
    number: int
    levels: LevelSearch
    results: dict[int, Probe] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class DriveWorld(World):
    """A simulation that starts from the settled state of a placement and shakes the carrier, as a job for the engine.

    Attributes:
        search: the search to which this simulation belongs; None outside a search.
        level: index of the level that this simulation tests in ``search``.
    """

    settled: SettledPlacement
    change: Variant
    search: PlacementSearch | None = None
    level: int = -1


@dataclass(frozen=True, eq=False)
class LegStart:
    """The state in which a leg of a chain begins. Several worlds share this state if their journeys have been equal so
    far.

    Attributes:
        changes: variants of the worlds that share this beginning.
        number: index of the leg in the chain, from 0.
        before: the outcome of the previous leg. In the first leg, ``before`` is None.
    """

    settled: SettledPlacement
    changes: tuple[Variant, ...]
    number: int
    before: Outcome | None


@dataclass(frozen=True, eq=False)
class LegWorld(World):
    """A simulation of one leg of a chain, as a job for the engine."""

    begin: LegStart

    @property
    def leg(self) -> LegSpec:
        return self.begin.changes[0].legs[self.begin.number]
