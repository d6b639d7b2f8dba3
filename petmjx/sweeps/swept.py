"""What a sweep's runner tells: placements that have settled, answers of searches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from petmjx.options.config import Thresholds
from petmjx.study import FinishedWorld
from petmjx.sweeps.design import SearchItem
from petmjx.sweeps.eumos import load_height_m
from petmjx.sweeps.grid import PlacementGroup
from petmjx.sweeps.search import Found, Probe
from petmjx.verdict import Attempt, Flag, Outcome, Verdict, judge
from petmjx.world.scene import Scene
from petmjx.world.variants import Variant


@dataclass(frozen=True, eq=False)
class Settled:
    """A placement that has settled: its outcome, with the state from which drives start."""

    group: PlacementGroup
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]

    @cached_property
    def load_height_m(self) -> float:
        """Of the load at rest, m: the same for all its drives."""
        return load_height_m(self.outcome.boxes.pos, self.scene.half_size)

    def shaken(self, outcome: Outcome, thresholds: Thresholds) -> Outcome:
        """What a fork came to, judged with its placement. Its history begins with that of the placement."""
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
        """A world with this outcome: no step was simulated for it."""
        outcome = replace(self.outcome, flags=self.outcome.flags | Flag.FORKED, n_steps=0, state=None)
        return FinishedWorld(self.group.plan, variant, self.scene, outcome, self.attempts, self.outcome)


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer of a search for one placement, profile and direction.

    Attributes:
        largest_survived, first_failed: level in g, or scale; None where there is none.
        at_largest, at_failure: what the worlds that say so came to; None where no world was simulated for it.
    """

    group: PlacementGroup
    item: SearchItem
    found: Found
    largest_survived: float | None
    first_failed: float | None
    at_largest: Probe | None
    at_failure: Probe | None
