"""Changed plans in a search for repairs: those that were simulated (``State``), those that may be simulated
(``Candidate``), and those that may be changed further (``Node``). ``Candidates`` proposes changes for the causes of a
failure, ranks them by statics, and has them simulated."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, zip_longest
from typing import Final, NamedTuple

import numpy as np

from petmjx.engines.verdict import Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.repairs.balance import SAFE_MM, Balance, balances
from petmjx.repairs.changes import Change, Kind, Turn, applied, cost_of, longest_move_mm, with_change
from petmjx.repairs.draft_rules import Rules
from petmjx.repairs.drafts import TOLERANCE_MM, Draft, key_of, keys_of
from petmjx.repairs.proposals import MOST_TARGETS, Proposal, Target, proposals, targets
from petmjx.repairs.rebuilds import Failure, rebuilds
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.requests import Steps, Trial, TrialRequest

PILE: Final = 4.0
"""A box that falls is taken off together with all boxes that would lose their support without it. A repair is expected
to need one change for every ``PILE`` boxes that are taken off together (at least one change). The larger the pile, the
more changes are expected: no single place has room for a large pile, and a large pile hides further faults."""

AT_ONCE: Final = 8
"""Number of changed plans that are judged at once. Statics ranks changes well: usually one of the first stands, or
mends a fault. So more changed plans are judged only if the first ones fall."""

PER_ROUND: Final = 0.25
"""Each time some changes of a plan were judged in vain, the expected number of changes of its repair rises by this
value."""


PER_DRIVE: Final = 6
"""A plan that is scored with a drive counts as this many trials. With a drive, every plan is scored, because no short
simulation can judge it."""


@dataclass(frozen=True, eq=False)
class State:
    """A changed plan that was simulated.

    Attributes:
        draft: the changed plan.
        changes: the changes that turned the plan into the draft.
        trial: the simulation of the changed plan in the world without errors.
        errors: number of a world with errors → the trial in this world. The dictionary has only worlds in which the
            plan was judged.
    """

    draft: Draft
    changes: tuple[Change, ...]
    trial: Trial
    errors: Mapping[int, Trial] = field(default_factory=dict)

    @property
    def n_good(self) -> int:
        """Number of worlds with errors in which the plan stands."""
        return sum(trial.stands for trial in self.errors.values())

    @property
    def lost(self) -> dict[int, Trial]:
        """Number of a world with errors in which the plan falls → the trial in this world."""
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
        parent: the node whose plan was changed.
        risk: two numbers by which statics compares plans that stand (``Candidates._risks``).
        unsolved: measure of how much of the failure of ``parent`` remains, computed by statics: 0 (nothing) to 2
            (``Candidates._unsolved``).
    """

    draft: Draft
    changes: tuple[Change, ...]
    proposal: Proposal
    key: float
    parent: Node
    risk: tuple[int, int] = (0, 0)
    unsolved: float = 0.0


class Fault(NamedTuple):
    """A fault of a plan.

    Attributes:
        box: number of the box that falls once the boxes of all earlier faults are taken off.
        weight: expected number of changes that mend the fault.
    """

    box: int
    weight: float

    @classmethod
    def of(cls, box: int, n_boxes: int) -> Fault:
        """The fault of a box that falls. ``n_boxes``: number of boxes that are taken off with it, itself included."""
        return cls(box, max(1.0, n_boxes / PILE))


@dataclass(eq=False)
class Node:
    """A changed plan that may be changed further.

    Attributes:
        faults: the faults of the plan, in the order of time; None: not counted yet.
        queue: the allowed changes of the plan that were not judged yet, the most promising first; None: no changes were
            proposed yet.
        n_rounds: number of times that changes of the plan were judged.
        is_anew: whether ways to build the plan anew were already proposed.
        rank: rank by statics of the candidate that became this plan; smaller is better.
    """

    state: State
    faults: tuple[Fault, ...] | None = None
    queue: list[Candidate] | None = None
    n_rounds: int = 0
    is_anew: bool = False
    rank: float = 0.0

    @property
    def n_faults(self) -> float:
        """Expected number of changes that are still needed; infinite: the faults are not counted yet."""
        return math.inf if self.faults is None else sum(fault.weight for fault in self.faults)

    @property
    def n_expected(self) -> float:
        """Expected number of changes of a repair that begins with this plan's changes: these changes plus those that
        are still needed."""
        return len(self.state.changes) + self.n_faults

    @property
    def n_promised(self) -> float:
        """Expected number of changes of a repair that begins with the next change of this plan. The number grows with
        each round in which changes of the plan were judged in vain. It is also larger if the next change hardly helps
        according to statics."""
        unsolved = self.queue[0].unsolved if self.queue else 0.0
        return self.n_expected + PER_ROUND * self.n_rounds + unsolved

    @property
    def key(self) -> tuple[float, float, int, int, float]:
        """Rank of the plan; smaller is better."""
        n_held, n_standing = self.state.trial.progress
        return self.n_promised, self.rank, -n_held, -n_standing, self.state.cost


def n_counted(changes: Sequence[Change]) -> int:
    """Number of changes. Boxes that are left out do not count as changes."""
    return sum(change.kind is not Kind.LEAVE_OUT for change in changes)


def shortest(states: Sequence[State]) -> list[State]:
    """The states with the fewest changes."""
    fewest = min((len(state.changes) for state in states), default=0)
    return [state for state in states if len(state.changes) == fewest]


def way_of(state: State) -> tuple[object, ...]:
    """A key that is equal for repairs that change the same boxes in the same ways, even if by different amounts."""
    return tuple((change.kind, change.boxes) for change in state.changes)


def batch_of(queues: Sequence[list[Candidate]], count: int) -> list[Candidate]:
    """Take the most promising candidates off the ranked queues, equally many off each queue."""
    batch = []
    for queue in queues:
        n_taken = max(count, 0) // len(queues)
        batch += queue[:n_taken]
        del queue[:n_taken]
    return batch


def spread(ranked: Sequence[Candidate]) -> list[Candidate]:
    """Candidates, ranked anew. Of the candidates that change the same box in the same way by different amounts, the
    best keeps its rank, and each further one gets a worse rank. Statics gives such candidates similar ranks, but often
    all of their plans fall in the same way."""
    ways: Counter[tuple[object, ...]] = Counter()
    keys = []
    for candidate in ranked:
        change = candidate.proposal[-1]
        way = change.kind, change.boxes[:1], len(candidate.proposal) > 1
        keys.append(candidate.key + PER_REPETITION * ways[way])
        ways[way] += 1
    return [ranked[k] for k in sorted(range(len(ranked)), key=keys.__getitem__)]


PER_REPETITION: Final = 0.5
"""A candidate's rank rises by this number for each better candidate that changes the same box in the same way by
another amount. For comparison: a load that is surely beyond an edge of its supports adds 1 to 2 to the rank."""

HELD: Final = 0.15
"""In the ranking, the weight of a load beyond an edge is multiplied by this number if simulations have shown that the
box with this load does not fall, because it leans on something."""

MOST_RANKED: Final = 168
"""Of the allowed changes of a plan, at most this number are kept: the most promising ones."""

PER_WEAKNESS: Final = 1.0
"""Weight of ``Balance.weakness``, the risk that a plan falls with errors, in the ranking of changes. The weight of
``Balance.trouble``, the sum over all loads beyond an edge, is 1."""

PER_COST: Final = 0.3
"""Weight of a change's cost in the ranking of changes. The weight of ``Balance.trouble``, the sum over all loads beyond
an edge, is 1."""

UNSOLVED: Final = 3.0
"""Weight of ``Candidates._unsolved`` in the ranking of changes: a measure of how much of the failure remains after a
change."""

SAME_COST: Final = 0.1
"""Costs of repairs are rounded down to multiples of this value, which is the cost of a move by 50 mm. Repairs with the
same rounded cost count as equally cheap. Of equally cheap repairs, the one that is likelier to stand with errors is
chosen."""

SAME_WEAKNESS: Final = 0.25
"""Weaknesses of plans are rounded to multiples of this value. Plans with the same rounded weakness count as equally
weak. Of equally weak plans, the one whose changes cost less is better."""


class TrialsSpent(Exception):
    """With the next simulations, the search would exceed the number of simulations that it may make."""


@dataclass(eq=False)
class Candidates:
    """Changes of one plan.

    Methods that simulate are generators: they yield drafts to be simulated and are sent their trials.

    Attributes:
        plan: the plan.
        film_turns: number of turns of film around the plan.
        is_wide: whether many plans are judged at once, for an engine that judges many as fast as a few.
        n_trials: number of simulations of changed plans.
        invalid: reason → number of simulations of changed plans that were invalid for this reason. Invalid simulations
            count as falls.
    """

    plan: Plan
    sim: Simulation
    options: RepairOptions
    film_turns: float = 0.0
    is_wide: bool = False
    n_trials: int = 0
    invalid: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        """Prepare the limits that all changed plans must keep (``Rules``)."""
        options = self.options
        self.rules = Rules(self.plan, self.sim, options.max_height_mm, options.built)
        self._start = Draft.of(self.plan, self.film_turns)
        self._most_trials = options.trials if options.profile is None else max(options.trials // PER_DRIVE, 1)
        self._seen: set[bytes] = set()
        self._known: dict[bytes, Trial] = {}  # key of each draft that was judged → its trial
        self._falls: dict[bytes, Trial] = {}  # key of the placements up to an early fall → the trial
        # box → largest depth, mm, by which its load acted beyond an edge although the box did not fall
        self._held_mm: dict[int, float] = {}
        self._in_worlds: dict[bytes, dict[int, Trial]] = {}  # key of a draft → number of a world → trial
        self._balances: dict[bytes, Balance] = {}  # key of a draft → its balance, for drafts that may be judged

    # ------------------------------------------------------------------ proposals

    def _changes(self, node: Node, kinds: frozenset[Kind]) -> list[Candidate]:
        """Allowed changes of a plan, the most promising first."""
        causes = self._causes(node.state)
        some = proposals(node.state.draft, self.rules, causes, kinds, self.options)
        return self._ranked(node, causes, some)

    def _anew(self, nodes: Sequence[Node], kinds: frozenset[Kind]) -> list[list[Candidate]]:
        """For each plan, ways to build it anew, the most promising first."""
        causes = [self._causes(node.state) for node in nodes]
        failures = [
            Failure(node.state.draft, some, node.state.trial.n_held) for node, some in zip(nodes, causes, strict=True)
        ]
        ways = rebuilds(failures, self.rules, self.sim, leaves_out=Kind.LEAVE_OUT in kinds)
        return [self._ranked(*row) for row in zip(nodes, causes, ways, strict=True)]

    def _ranked(self, node: Node, causes: Sequence[Target], some: Iterable[Proposal]) -> list[Candidate]:
        """The candidates that result from proposals, the most promising first. Candidates that are not allowed, or not
        new, are left out."""
        state = node.state
        failing = {cause.box: cause.depth_mm for cause in causes if cause.depth_mm > 0}
        pairs = [(draft, p) for p in some if (draft := applied(state.draft, p)) is not None]
        boxes = [{box for change in proposal for box in change.boxes} for _, proposal in pairs]
        allowed = self.rules.allow([draft for draft, _ in pairs], boxes, state.draft)
        pairs = [pairs[number] for number in np.flatnonzero(allowed).tolist()]
        new: dict[bytes, tuple[Draft, Proposal, tuple[Change, ...]]] = {}
        for key, (draft, proposal) in zip(keys_of([draft for draft, _ in pairs]), pairs, strict=True):
            if key in new or key in self._seen or self._falls_early(key):
                continue
            changes = state.changes
            for change in proposal:
                changes = with_change(changes, change, self._start)
            if len(changes) < len(state.changes) + len(proposal):  # several changes became one
                merged = applied(self._start, changes)
                if merged is None or key_of(merged) != key:
                    changes = (*state.changes, *proposal)
                else:  # a turn forgets the direction of approach of its box, but the move that it became does not
                    draft = merged
            if self._may_make(changes):
                new[key] = draft, proposal, changes
        self._seen.update(new)
        ranked = []
        balances_of_new = balances([draft for draft, *_ in new.values()], self.sim, parent=state.draft)
        for (draft, proposal, changes), after in zip(new.values(), balances_of_new, strict=True):
            unsolved = self._unsolved(after, failing, state.trial.culprit)
            risk = self._expected_trouble(after, {box for change in proposal for box in change.boxes})
            rank = risk + PER_WEAKNESS * after.weakness + UNSOLVED * unsolved + PER_COST * cost_of(proposal)
            rank = round(rank, 9)  # so that the order of equal ranks does not depend on rounding errors
            ranked.append(Candidate(draft, changes, proposal, rank, node, _risk(after, cost_of(changes)), unsolved))
        ranked.sort(key=lambda candidate: candidate.key)
        ranked = spread(ranked)
        self._seen.difference_update(key_of(candidate.draft) for candidate in ranked[MOST_RANKED:])
        of_key = dict(zip(new, balances_of_new, strict=True))
        self._balances.update((key, of_key[key]) for one in ranked[:MOST_RANKED] for key in [key_of(one.draft)])
        return ranked[:MOST_RANKED]

    def _may_make(self, changes: Sequence[Change]) -> bool:
        """Whether the options allow these changes together. Two changes of one box may have become a change of another
        kind. A box that is turned twice is only moved, so it is a move that was not recognised."""
        turned = [change.box for change in changes if isinstance(change, Turn)]
        has_allowed_kinds = self.options.kinds.issuperset(change.kind for change in changes)
        return (
            len(changes) > 0
            and n_counted(changes) <= self.options.most_changes
            and has_allowed_kinds
            and len(turned) == len({*turned})
            and self._moves_little(changes)
        )

    def _moves_little(self, changes: Sequence[Change]) -> bool:
        """Whether no box is moved farther than the options allow."""
        return longest_move_mm(changes, self._start) <= self.options.most_move_mm + TOLERANCE_MM

    def _unsolved(self, after: Balance, failing: Mapping[int, float], culprit: int | None) -> float:
        """How much of a failure remains after a change, from 0 to 2. The plan fails because loads are beyond an edge of
        their supports. The remaining share of each of these loads is its distance beyond the edge after the change,
        divided by its distance before the change, at most 1. The result is the mean of the remaining shares of all
        these loads, plus the remaining share of the load of the box that fell first.

        Args:
            failing: box → distance of its load beyond the edge before the change, mm.
        """
        beyond: dict[int, float] = dict(zip(after.box.tolist(), after.depth_mm.tolist(), strict=True))
        shares = {box: min(beyond.get(box, 0.0) / depth_mm, 1.0) for box, depth_mm in failing.items()}
        of_culprit = 0.0 if culprit is None else shares.get(culprit, float(culprit in beyond))
        return sum(shares.values()) / max(len(shares), 1) + of_culprit

    def _expected_trouble(self, after: Balance, changed: Collection[int]) -> float:
        """The trouble (``Balance``) of a changed plan. A load counts little if its box leans on something: a simulation
        has shown that the box does not fall although the load is this far beyond an edge. A load of one of the boxes
        ``changed`` always counts in full."""
        held_mm = [0.0 if box in changed else self._held_mm.get(box, 0.0) for box in after.box.tolist()]
        return float((after.weight * np.where(after.depth_mm <= held_mm, HELD, 1.0)).sum())

    def _learn(self, drafts: Sequence[Draft], trials: Sequence[Trial]) -> None:
        """Record, for boxes that did not fall in these trials, how far their loads were beyond an edge."""
        for draft, trial, balance in zip(drafts, trials, self._balances_of(drafts), strict=True):
            lost, last = {*trial.fallen}, trial.n_placed
            if not trial.stands:
                if trial.culprit is None:
                    continue
                lost |= {trial.culprit, *draft.below(trial.culprit)}
                last -= 1  # effects of the last placement may not have ended: do not learn from it
            for box, step, depth_mm in zip(balance.box.tolist(), balance.step, balance.depth_mm.tolist(), strict=True):
                if step < last and box not in lost:
                    self._held_mm[box] = max(self._held_mm.get(box, 0.0), depth_mm)

    def _causes(self, state: State) -> list[Target]:
        """Why a plan fails, the likeliest causes first. For a plan that falls only with errors, these are the causes of
        its falls in worlds with errors; the causes that occur in the most worlds come first. If the plan falls only
        with errors, loads that are nearer to an edge than ``SAFE_MM`` also count as beyond the edge."""
        lost = sorted(state.lost.values(), key=lambda trial: trial.n_held) or [state.trial]
        drafts = [state.draft]
        (balance,) = balances(drafts, self.sim, spare_mm=SAFE_MM) if state.lost else self._balances_of(drafts)
        often = Counter(trial.culprit for trial in lost)
        trials = {trial.culprit: trial for trial in lost}
        of_each = [
            targets(state.draft, self.rules, balance, culprit, trials[culprit].fallen, trials[culprit].n_placed)
            for culprit, _ in often.most_common()
        ]
        different: dict[int, Target] = {}
        for target in chain.from_iterable(zip_longest(*of_each)):
            if target is not None:
                is_squeezed = bool(state.lost) and target.box in balance.squeezed
                different.setdefault(target.box, target._replace(is_squeezed=is_squeezed))
        return [*different.values()][:MOST_TARGETS]

    def _balances_of(self, drafts: Sequence[Draft]) -> list[Balance]:
        """The balance of each draft. A balance is computed only once."""
        unknown = {key: draft for draft in drafts if (key := key_of(draft)) not in self._balances}
        self._balances.update(zip(unknown, balances([*unknown.values()], self.sim), strict=True))
        return [self._balances[key_of(draft)] for draft in drafts]

    def _safest(self, states: Sequence[State]) -> list[int]:
        """Numbers of the states, sorted. States are grouped by the way in which the plan was changed (``way_of``).
        The best state of each group comes first, then the second best of each group, and so on. A state is better if it
        is less weak or, if equally weak, cheaper."""
        ways: Counter[tuple[object, ...]] = Counter()
        ranks = []
        risks = self._risks(states)
        for k in sorted(range(len(states)), key=risks.__getitem__):
            way = way_of(states[k])
            ranks.append((ways[way], k))
            ways[way] += 1
        return [k for _, k in sorted(ranks, key=lambda rank: rank[0])]

    def _risks(self, states: Sequence[State]) -> list[tuple[int, int]]:
        """Two numbers for each changed plan, by which plans are compared. The first number is the plan's weakness plus
        its trouble (``Balance``), divided by ``SAME_WEAKNESS`` and rounded. The second number is the cost of the
        changes, divided by ``SAME_COST`` and rounded down. So plans that differ little count as equal."""
        some = self._balances_of([state.draft for state in states])
        return [_risk(balance, state.cost) for state, balance in zip(states, some, strict=True)]

    # ------------------------------------------------------------------ simulations

    @property
    def _n_left(self) -> int:
        """Number of changed plans that may still be simulated."""
        return self._most_trials - self.n_trials

    def _spend(self, count: int) -> None:
        """Count simulations before they are requested. Raises ``TrialsSpent`` if there would be too many. Parts of a
        search that run side by side must together request so few simulations that none of them raises
        ``TrialsSpent``."""
        if count > self._n_left:
            raise TrialsSpent
        self.n_trials += count

    def _simulated(self, drafts: Sequence[Draft], *, judged: bool = False) -> Steps[list[Trial]]:
        """The trials of drafts. If the drafts are only judged (``judged``), drafts that were judged before are not
        simulated again."""
        if not judged:
            self._spend(len(drafts))
            return self._noted((yield [TrialRequest(draft, False) for draft in drafts])) if drafts else []
        keys = [key_of(draft) for draft in drafts]
        for key in keys:
            if key not in self._known and self._falls_early(key):
                self._known[key] = next(trial for begin, trial in self._falls.items() if key.startswith(begin))
        unknown = {key: draft for key, draft in zip(keys, drafts, strict=True) if key not in self._known}
        self._spend(len(unknown))
        if unknown:
            trials = self._noted((yield [TrialRequest(draft, True) for draft in unknown.values()]))
            self._remember([*unknown.values()], trials)
        return [self._known[key] for key in keys]

    def _noted(self, trials: list[Trial]) -> list[Trial]:
        """Count invalid trials; returns the trials."""
        self.invalid.update(trial.reason for trial in trials if trial.verdict == Verdict.INVALID.value)
        return trials

    def _remember(self, drafts: Sequence[Draft], trials: Sequence[Trial]) -> None:
        """Record the trials of drafts that were judged."""
        self._learn(drafts, trials)
        for draft, trial in zip(drafts, trials, strict=True):
            self._known[key_of(draft)] = trial
            # a box that was still in the hand does not count as placed, but may have pushed other boxes
            n_known = trial.n_placed + int(self.sim.placing.carries)
            if trial.verdict == Verdict.UNSTABLE.value and n_known < len(draft.order):
                self._falls.setdefault(key_of(draft, n_known), trial)

    def _falls_early(self, key: bytes) -> bool:
        """Whether a draft with this key must fall like a draft that was judged before: both begin with the same
        placements, and the judged draft fell before its next box was placed."""
        # A draft without a further box after these placements need not fall in the same way, because the wait after the
        # last box is longer than other waits. The last byte of the key is left out, and then the key of such a draft
        # does not match.
        longer = key[:-1]
        return longer.startswith((*self._falls,))

    def _scored(self, states: Sequence[State]) -> Steps[list[State]]:
        """The states with new trials: their drafts, which were only judged before, are now simulated as in a score."""
        self._spend(len(states))
        requests = [TrialRequest(state.draft, is_judged=False, judged=state.trial) for state in states]
        trials = self._noted((yield requests)) if requests else []
        return [replace(state, trial=trial) for state, trial in zip(states, trials, strict=True)]

    def _judged(self, batch: Sequence[Candidate]) -> Steps[list[State]]:
        """Judge candidates: simulate each of them once, at most until a box tilts too far (``TrialRequest.is_judged``).
        Returns their states."""
        trials = yield from self._simulated([c.draft for c in batch], judged=True)
        return [State(c.draft, c.changes, trial) for c, trial in zip(batch, trials, strict=True)]

    def _trials_of(self, lists: Sequence[tuple[Change, ...]], *, judged: bool = False) -> Steps[list[State]]:
        """The simulated states with these lists of changes. Lists with an impossible change, lists whose result is
        not allowed, and lists that move a box too far, are left out."""
        made = [
            (draft, changes)
            for changes in lists
            if (draft := applied(self._start, changes)) is not None and self._moves_little(changes)
        ]
        allowed = self.rules.allow([draft for draft, _ in made])
        made = [pair for pair, is_allowed in zip(made, allowed, strict=True) if is_allowed]
        if not made:
            return []
        trials = yield from self._simulated([draft for draft, _ in made], judged=judged)
        return [State(draft, changes, trial) for (draft, changes), trial in zip(made, trials, strict=True)]

    def _judged_in(self, states: Sequence[State], worlds: Iterable[int]) -> Steps[list[State]]:
        """The states with their trials in the given worlds with errors. A world in which a state was judged before is
        not simulated again."""
        known = [{**self._in_worlds.get(key_of(state.draft), {}), **state.errors} for state in states]
        pairs = [(k, world) for k in range(len(states)) for world in worlds if world not in known[k]]
        self._spend(len(pairs))
        requests = [TrialRequest(states[k].draft, True, world) for k, world in pairs]
        trials = self._noted((yield requests)) if requests else []
        for (k, world), trial in zip(pairs, trials, strict=True):
            known[k][world] = trial
        self._in_worlds.update((key_of(state.draft), errors) for state, errors in zip(states, known, strict=True))
        return [replace(state, errors=errors) for state, errors in zip(states, known, strict=True)]


def _risk(balance: Balance, cost: float) -> tuple[int, int]:
    """The two numbers of ``Candidates._risks`` for a plan with this balance and this cost of all changes."""
    return round((balance.weakness + balance.trouble) / SAME_WEAKNESS), math.floor(cost / SAME_COST)
