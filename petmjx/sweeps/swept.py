"""What a sweep's runner tells: placements that have settled, worlds with their outcomes, answers of searches."""

from __future__ import annotations

from dataclasses import dataclass

from petmjx.plans.plan import Plan
from petmjx.sweeps.design import SearchItem
from petmjx.sweeps.grid import PlacementGroup
from petmjx.sweeps.search import Found, Probe
from petmjx.verdict import Attempt, Outcome
from petmjx.world.scene import Scene
from petmjx.world.variants import Variant


@dataclass(frozen=True, eq=False)
class Settled:
    """A placement that has settled: its outcome, with the state from which drives start."""

    group: PlacementGroup
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]


@dataclass(frozen=True, eq=False)
class SweptWorld:
    """One world of a sweep with its final outcome.

    Attributes:
        settled: the placement it was forked from; None for a world that was simulated from its beginning.
        driven: whether its drive was simulated. If the placement does not stand, the world has its outcome; without
            early stop it is shaken, too, but is not stable.
    """

    plan: Plan
    variant: Variant
    scene: Scene
    outcome: Outcome
    attempts: tuple[Attempt, ...]
    settled: Settled | None = None
    driven: bool = False


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
