"""Changed plans in a search for repairs: simulated ones (``State``), those to be simulated (``Candidate``), and those
that may be changed further (``Node``)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from petmjx.repairs.changes import Change, Kind, cost_of
from petmjx.repairs.drafts import Draft
from petmjx.repairs.proposals import Proposal
from petmjx.repairs.trials import Trial

AT_ONCE: Final = 24
"""Number of changed plans that are judged at once. If one of them stands, as many again are judged, so that worlds with
errors can choose from more plans."""

PER_BATCH: Final = 0.25
"""Each time ``AT_ONCE`` changes of a plan were judged in vain, the plan counts as if its repair needed this much of a
change more."""


@dataclass(frozen=True, eq=False)
class State:
    """A changed plan that was simulated.

    Attributes:
        draft: the changed plan.
        changes: the changes.
        trial: its simulation.
        faults: an estimate of the changes that are still needed.
        errors: number of a world with errors → the trial in this world. Only worlds in which the plan was judged.
    """

    draft: Draft
    changes: tuple[Change, ...]
    trial: Trial
    faults: float = math.inf
    errors: Mapping[int, Trial] = field(default_factory=dict)

    @property
    def n_good(self) -> int:
        """Number of worlds with errors in which the plan stands."""
        return sum(trial.stands for trial in self.errors.values())

    @property
    def lost(self) -> dict[int, Trial]:
        """The trials in worlds with errors in which the plan falls, by the number of the world."""
        return {world: trial for world, trial in self.errors.items() if not trial.stands}

    @property
    def cost(self) -> float:
        """The cost of the changes."""
        return cost_of(self.changes)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A changed plan before its simulation.

    Attributes:
        proposal: the changes that turn the plan of ``parent`` into this plan.
        key: rank of the plan; smaller is better.
        parent: the state whose plan was changed.
    """

    draft: Draft
    changes: tuple[Change, ...]
    proposal: Proposal
    trouble: float
    key: float
    parent: State


@dataclass(eq=False)
class Node:
    """A changed plan that may be changed further.

    Attributes:
        queue: the allowed changes of the plan that were not judged yet, the most promising first; None: no changes were
            proposed yet.
        n_judged: number of the plan's changes that were judged.
        is_anew: whether ways to build the plan anew were already proposed.
    """

    state: State
    queue: list[Candidate] | None = None
    n_judged: int = 0
    is_anew: bool = False

    @property
    def n_expected(self) -> float:
        """Expected number of changes of a repair that begins with this plan's changes: these changes plus the estimated
        faults."""
        return len(self.state.changes) + self.state.faults

    @property
    def key(self) -> tuple[float, int, int, float]:
        """Rank of the plan; smaller is better. A plan of which many changes were judged in vain has a worse rank."""
        state = self.state
        n_held, n_standing = state.trial.progress
        return self.n_expected + PER_BATCH * (self.n_judged // AT_ONCE), -n_held, -n_standing, state.cost


def n_counted(changes: Sequence[Change]) -> int:
    """Number of changes. A box that is left out does not count."""
    return sum(change.kind is not Kind.LEAVE_OUT for change in changes)


def shortest(states: Sequence[State]) -> list[State]:
    """The states with the fewest changes."""
    fewest = min((len(state.changes) for state in states), default=0)
    return [state for state in states if len(state.changes) == fewest]


def way_of(state: State) -> tuple[object, ...]:
    """A key that is equal for repairs that change the same boxes in the same ways, even if by different amounts."""
    return tuple((change.kind, change.boxes) for change in state.changes)


def batch_of(queues: Sequence[list[Candidate]], count: int) -> list[Candidate]:
    """Take equally many candidates off each ranked queue: the first of each way to change a box, then the second of
    each. Otherwise, a batch would often be one move by many amounts, because statics ranks these candidates side by
    side."""
    batch = []
    for queue in queues:
        ways: Counter[tuple[object, ...]] = Counter()
        turns = []
        for rank, candidate in enumerate(queue):
            change = candidate.proposal[-1]
            way = change.kind, change.boxes[:1], len(candidate.proposal) > 1
            turns.append((ways[way], rank))
            ways[way] += 1
        chosen = [rank for _, rank in sorted(turns)[: max(count, 0) // len(queues)]]
        batch += [queue[rank] for rank in chosen]
        for rank in sorted(chosen, reverse=True):
            del queue[rank]
    return batch


def key_of(draft: Draft) -> bytes:
    """Equal for drafts that are the same."""
    order = np.array(draft.order)
    places = np.round(np.hstack([draft.corner_mm, draft.size_mm])[order], 3)
    key: bytes = order.tobytes() + places.tobytes() + np.array(draft.film_turns).tobytes()
    return key
