"""The search for the smallest change that makes a plan stand.

A beam of changed plans is simulated, until one stands. Each step changes a plan at the place of its failure: statics
ranks the possible changes, and the best ranked are judged at once, by one short simulation each. Standing plans are
scored. Then needless changes are taken back, so that the plan falls without any one of the remaining changes.

``search`` is a generator: it yields drafts to be simulated and is sent their trials. So the searches of many plans can
share runs of an engine. The simulated plans depend only on the plan and the options, not on time.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.repairs.balance import balances
from petmjx.repairs.changes import Change, Film, Kind, LeaveOut, applied, cost_of, with_change
from petmjx.repairs.drafts import Draft, Rules
from petmjx.repairs.proposals import Limits, Proposal, lifted_with, proposals, targets
from petmjx.repairs.rebuilds import rebuilds
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.trials import Asked, Trial

Asking = Generator[list[Asked], list[Trial], None]

BEAM: Final = 4
"""Number of changed plans that are changed further in each step."""

AT_ONCE: Final = (24, 48, 96)
"""Number of changed plans that are judged at once in a step: the best ranked first, then more until one has more
standing boxes. If one stands, this many more are judged for the choice by errors."""

STEPS_ALONE: Final = 4
"""Steps in which single changes are tried first. A plan that falls even then has faults all over: it is built anew."""

MOST_ANEW: Final = 2
"""Changed plans of a step that are built anew, each in up to sixteen ways, which take a tenth of a second each."""

CONFIRMED_AT_ONCE: Final = 6
"""Plans that stand when judged, and are scored at once."""

MOST_FINALISTS: Final = 4
"""Repairs with the least number of changes that are compared with errors."""

MOST_UNDONE: Final = 8
"""Limit of changes in all compared repairs, each of which is undone and scored: of long repairs fewer are compared."""

PER_DRIVE: Final = 6
"""A plan that is scored with a drive counts as this many trials: no short simulation can judge it."""

PER_WEAKNESS: Final = 1.0
"""Weight of what makes a plan fall with errors only in the ranking, against loads beyond edges."""

PER_COST: Final = 0.3
"""Weight of a change's cost in the ranking, against loads beyond edges."""

SAME_COST: Final = 0.1
"""Repairs whose costs differ by less count as equally cheap: 50 mm of a move. The state that is likelier to stand with
errors is chosen."""

SAME_WEAKNESS: Final = 0.25
"""Plans whose weakness differs by less count as equally weak: the cheaper one is better."""

UNSOLVED: Final = 3.0
"""Weight of the first cause if it remains."""


@dataclass(frozen=True, eq=False)
class State:
    """A changed plan that was simulated.

    Attributes:
        draft: the changed plan.
        changes: the changes.
        trial: its simulation.
    """

    draft: Draft
    changes: tuple[Change, ...]
    trial: Trial

    @property
    def cost(self) -> float:
        """The cost of the changes."""
        return cost_of(self.changes)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A changed plan before its simulation.

    Attributes:
        proposal: the changes that make it of another state's plan.
        key: its rank: smaller is better.
    """

    draft: Draft
    changes: tuple[Change, ...]
    proposal: Proposal
    trouble: float
    key: float


@dataclass(eq=False)
class Search:
    """The search for repairs of one plan.

    Attributes:
        plan: the plan.
        before: the simulation of the plan; None: unknown yet.
        repairs: the repairs with the fewest changes, the best first; empty: there is none. Without any one change of a
            repair the plan falls, or is not allowed.
        n_trials: simulated plans.
        complete: whether the search came to its end. Before, changes of a repair may not be needed.
    """

    plan: Plan
    sim: Simulation
    options: RepairOptions
    film_turns: float = 0.0
    before: Trial | None = None
    repairs: tuple[State, ...] = ()
    n_trials: int = 0
    complete: bool = False

    def __post_init__(self) -> None:
        """Prepare the rules of the plan."""
        options = self.options
        self.rules = Rules(self.plan, self.sim, options.max_height_mm, options.built)
        self._start = Draft.of(self.plan, self.film_turns)
        self._seen: set[bytes] = set()

    def take(self, other: Search) -> None:
        """Take over what the same search has come to in another process."""
        self.before, self.repairs, self.n_trials = other.before, other.repairs, other.n_trials
        self.complete = other.complete

    def begin(self, before: Trial) -> None:
        """Note the simulation of the plan as it is."""
        self.before = before
        if before.stands:
            self.repairs, self.complete = (State(self._start, (), before),), True

    def run(self) -> Asking:
        """Yields drafts to be simulated, and is sent their trials."""
        (before,) = yield from self._simulated([self._start])
        self.begin(before)
        if not before.stands:
            yield from self._mended(State(self._start, (), before))
            self._seen.clear()
            self.complete = True

    def _mended(self, start: State) -> Asking:
        """Search for repairs of a plan that falls."""
        kinds = self.options.kinds
        standing: list[State] = []
        if Kind.FILM in kinds:
            standing = yield from self._wrapped(start)
        beam, kinds_with_all_boxes = [start], kinds - {Kind.FILM, Kind.LEAVE_OUT}
        most = self.options.trials if self.options.profile is None else self.options.trials // PER_DRIVE
        if not standing and self.options.profile is None:
            (judged,) = yield from self._simulated([self._start], judged=True)
            if not judged.stands:
                beam = [State(self._start, (), judged)]
        if not standing and kinds_with_all_boxes:
            standing, beam = yield from self._changed(beam, kinds_with_all_boxes, most)
        if not standing and Kind.LEAVE_OUT in kinds:
            self._seen.clear()
            standing, beam = yield from self._changed(beam, kinds - {Kind.FILM}, most // 2)
            if not standing:
                standing = yield from self._stripped(beam[0])
        if standing:
            self.repairs = tuple(standing)
            yield from self._finished(standing)

    def _simulated(
        self, drafts: Sequence[Draft], *, judged: bool = False
    ) -> Generator[list[Asked], list[Trial], list[Trial]]:
        self.n_trials += len(drafts)
        return (yield [(draft, judged) for draft in drafts])

    # ------------------------------------------------------------------ film

    def _wrapped(self, start: State) -> Generator[list[Asked], list[Trial], list[State]]:
        """The fewest turns of film with which the plan survives the profile; empty: no such number."""
        low, high = math.floor(self.film_turns), self.options.most_turns
        if high <= low:
            return []
        best: State | None = None
        tried = [high]
        while tried:
            films = [Film(float(turns)) for turns in tried]
            drafts = [draft for film in films if (draft := film.applied(start.draft)) is not None]
            trials = yield from self._simulated(drafts)
            for film, draft, trial in zip(films, drafts, trials, strict=True):
                if trial.stands and (best is None or film.turns < high or best is None):
                    best, high = State(draft, (film,), trial), int(film.turns)
                elif not trial.stands:
                    low = max(low, int(film.turns))
            if best is None or high - low <= 1:
                break
            tried = [(low + high) // 2]
        return [] if best is None else [best]

    # ------------------------------------------------------------------ changes

    def _changed(
        self, beam: list[State], kinds: frozenset[Kind], most_trials: int
    ) -> Generator[list[Asked], list[Trial], tuple[list[State], list[State]]]:
        """Plans that stand after changes of these kinds, and without such plans those that stood furthest."""
        options = self.options
        limits = Limits(kinds, options.most_move_mm, options.sheet_mm, options.sheet_kg_m2)
        last = self.n_trials + most_trials
        best = beam
        for step in itertools.count():
            if not beam or self.n_trials >= last:
                break
            tried: list[tuple[State, _Candidate]] = []
            progress = max(state.trial.progress for state in beam)
            for count, queues in self._queues(beam, limits, step):
                batch = _batch(queues, min(count, last - self.n_trials))
                states = yield from self._judged(batch)
                if any(state.trial.stands for state in states):  # further plans may stand more often with errors
                    next_candidates = _batch(queues, min(AT_ONCE[0], last - self.n_trials))
                    batch, states = batch + next_candidates, states + (yield from self._judged(next_candidates))
                    standing = yield from self._confirmed(states)
                    if standing:
                        return standing, best
                tried += zip(states, batch, strict=True)
                if any(state.trial.progress > progress for state, _ in tried):
                    break
            tried.sort(key=lambda p: (tuple(-n for n in p[0].trial.progress), p[1].trouble, p[0].cost))
            beam = _different([state for state, _ in tried if self._is_short(state)], BEAM)
            if beam and beam[0].trial.progress > best[0].trial.progress:
                best = beam
        return [], best

    def _queues(self, beam: Sequence[State], limits: Limits, step: int) -> Iterator[tuple[int, list[list[_Candidate]]]]:
        """Numbers of changed plans to judge, and queues from which to take them: single changes, and plans that are
        built anew; these first where some single changes have not helped."""
        for anew in (True, False) if step >= STEPS_ALONE else (False, True):
            if not anew:
                queues = [self._ranked(state, limits) for state in beam]
                yield from ((count, queues) for count in AT_ONCE)
            elif Kind.PLACE in limits.kinds:
                queues = [self._ranked(state, limits, anew=True) for state in beam[:MOST_ANEW]]
                yield AT_ONCE[-1], queues

    def _judged(self, batch: Sequence[_Candidate]) -> Generator[list[Asked], list[Trial], list[State]]:
        """The states of candidates that are only judged."""
        trials = (yield from self._simulated([c.draft for c in batch], judged=True)) if batch else []
        return [State(c.draft, c.changes, trial) for c, trial in zip(batch, trials, strict=True)]

    def _stripped(self, state: State) -> Generator[list[Asked], list[Trial], list[State]]:
        """The state without the boxes that fall, left out one by one with all boxes on them, until the remaining boxes
        stand; empty: boxes that stand already fall. The loop always ends, since each step leaves out a box."""
        while not state.trial.stands:
            box = state.trial.culprit
            if box is None:
                box = state.draft.order[min(state.trial.n_placed, len(state.draft.order)) - 1]
            lifted = lifted_with(state.draft, box)
            if min(lifted) < self.rules.built or len(lifted) >= len(state.draft.order):
                return []
            changes = state.changes
            for number in lifted:
                changes = (*changes, LeaveOut(number))
            draft = applied(self._start, changes)
            if draft is None:
                return []
            (trial,) = yield from self._simulated([draft])
            state = State(draft, changes, trial)
        return [state]

    def _confirmed(self, states: list[State]) -> Generator[list[Asked], list[Trial], list[State]]:
        """Score states that stand when judged, those with few changes first, until some are confirmed. Returns the
        standing ones; other scored states get the trial of the score. With a drive all trials are scores."""
        ways: Counter[tuple[object, ...]] = Counter()
        queue = []
        numbers = [k for k, state in enumerate(states) if state.trial.stands]
        weakness = dict(zip(numbers, self._weakness([states[k] for k in numbers]), strict=True))
        for k in sorted(numbers, key=lambda k: (len(states[k].changes), weakness[k], states[k].cost)):
            way = _way(states[k])
            queue.append((len(states[k].changes), ways[way], k))  # one change of each way first
            ways[way] += 1
        queue.sort(key=lambda place: place[:2])
        if self.options.profile is not None:
            return [states[k] for _, _, k in queue]
        for begin in range(0, len(queue), CONFIRMED_AT_ONCE):
            chosen = [k for _, _, k in queue[begin : begin + CONFIRMED_AT_ONCE]]
            trials = yield from self._simulated([states[k].draft for k in chosen])
            for k, trial in zip(chosen, trials, strict=True):
                states[k] = replace(states[k], trial=trial)
            confirmed = [states[k] for k in chosen if states[k].trial.stands]
            if confirmed:
                return confirmed
        return []

    def _is_short(self, state: State) -> bool:
        """Whether a state may be changed further."""
        return _n_counted(state.changes) < self.options.most_changes

    def _ranked(self, state: State, limits: Limits, *, anew: bool = False) -> list[_Candidate]:
        """Allowed changes of a plan, or ways to build it anew, the most promising first."""
        (balance,) = balances([state.draft], self.sim)
        trial = state.trial
        causes = targets(state.draft, self.rules, balance, trial.culprit, trial.fallen, trial.n_placed)
        first = next((cause for cause in causes if cause.depth_mm > 0), causes[0]) if causes else None
        if anew:
            leaves_out = Kind.LEAVE_OUT in limits.kinds
            some = rebuilds(state.draft, self.rules, self.sim, causes, trial.n_held, leaves_out=leaves_out)
        else:
            some = (p for cause in causes for p in proposals(state.draft, self.rules, cause, limits))
        drafts: list[Draft] = []
        origins: list[Proposal] = []
        for proposal in some:
            draft = applied(state.draft, proposal)
            if draft is None:
                continue
            key = _key(draft)
            if key not in self._seen:
                self._seen.add(key)
                drafts.append(draft)
                origins.append(proposal)
        allowed = np.flatnonzero(self.rules.allow(drafts)).tolist() if drafts else []
        ranked = []
        for number, after in zip(allowed, balances([drafts[k] for k in allowed], self.sim), strict=True):
            proposal = origins[number]
            changes = state.changes
            for change in proposal:
                changes = with_change(changes, change)
            draft = drafts[number]
            if len(changes) < len(state.changes) + len(proposal):  # some changes became one
                merged = applied(self._start, changes)
                if merged is None or _key(merged) != _key(draft):
                    changes = (*state.changes, *proposal)
            if _n_counted(changes) > self.options.most_changes:
                continue
            unsolved = first is not None and after.depth_of(first.box) > 0
            risk = after.trouble + PER_WEAKNESS * after.weakness
            rank = risk + UNSOLVED * unsolved + PER_COST * cost_of(proposal)
            ranked.append(_Candidate(draft, changes, proposal, after.trouble, rank))
        ranked.sort(key=lambda candidate: candidate.key)
        self._seen.difference_update(_key(candidate.draft) for candidate in ranked[sum(AT_ONCE) :])
        return ranked

    # ------------------------------------------------------------------ the end

    def _finished(self, standing: Sequence[State]) -> Asking:
        """Take back needless changes, and keep the repairs with the fewest changes."""
        fewest = min(len(state.changes) for state in standing)
        short = [state for state in standing if len(state.changes) == fewest]
        pruned = []
        for state in short[: min(MOST_FINALISTS, max(MOST_UNDONE // fewest, 1))]:
            reduced = yield from self._reduced(state)
            pruned.append((yield from self._pruned(reduced)))
        fewest = min(len(state.changes) for state in pruned)
        different = [*{_key(state.draft): state for state in pruned if len(state.changes) == fewest}.values()]
        ranks = zip(self._weakness(different), (math.floor(state.cost / SAME_COST) for state in different), strict=True)
        self.repairs = tuple(state for _, state in sorted(zip(ranks, different, strict=True), key=lambda p: p[0]))

    def _reduced(self, state: State) -> Generator[list[Asked], list[Trial], State]:
        """The state without groups of needless changes: halves first, then smaller groups."""
        size = len(state.changes) // 2
        shorter = state
        while size > 1:
            changes = shorter.changes
            change_lists = [(*changes[:k], *changes[k + size :]) for k in range(0, len(changes), size)]
            standing = [one for one in (yield from self._trials_of(change_lists, judged=True)) if one.trial.stands]
            if standing:
                shorter = min(standing, key=lambda one: one.cost)
            size = min(size if standing else size // 2, len(shorter.changes) // 2)
        if shorter is not state:
            (trial,) = yield from self._simulated([shorter.draft])
            if trial.stands:
                return replace(shorter, trial=trial)
        return state

    def _trials_of(
        self, lists: Sequence[tuple[Change, ...]], *, judged: bool = False
    ) -> Generator[list[Asked], list[Trial], list[State]]:
        """The states with these lists of changes, without impossible and forbidden ones."""
        made = [(draft, changes) for changes in lists if (draft := applied(self._start, changes)) is not None]
        allowed = self.rules.allow([draft for draft, _ in made])
        made = [pair for pair, is_allowed in zip(made, allowed, strict=True) if is_allowed]
        if not made:
            return []
        trials = yield from self._simulated([draft for draft, _ in made], judged=judged)
        return [State(draft, changes, trial) for (draft, changes), trial in zip(made, trials, strict=True)]

    def _pruned(self, state: State) -> Generator[list[Asked], list[Trial], State]:
        """The state without needless changes, tried one by one."""
        while len(state.changes) > 1:
            many = len(state.changes) > MOST_UNDONE  # scores of all of them would take minutes
            change_lists = [(*state.changes[:k], *state.changes[k + 1 :]) for k in range(len(state.changes))]
            trials = yield from self._trials_of(change_lists, judged=many)
            standing = sorted((shorter for shorter in trials if shorter.trial.stands), key=lambda one: one.cost)[:1]
            if standing and many:
                (trial,) = yield from self._simulated([standing[0].draft])
                standing = [replace(standing[0], trial=trial)] if trial.stands else []
            if not standing:
                break
            state = standing[0]
        return state

    def _weakness(self, states: Sequence[State]) -> list[int]:
        """What makes each changed plan fall with errors only, in steps of ``SAME_WEAKNESS``."""
        some = balances([state.draft for state in states], self.sim)
        return [round((balance.weakness + balance.trouble) / SAME_WEAKNESS) for balance in some]


def _n_counted(changes: Sequence[Change]) -> int:
    """Number of changes but for boxes that are left out."""
    return sum(change.kind is not Kind.LEAVE_OUT for change in changes)


def _way(state: State) -> tuple[object, ...]:
    """Equal for repairs that change the same boxes in the same ways by different amounts."""
    return tuple((change.kind, change.boxes) for change in state.changes)


def _batch(queues: Sequence[list[_Candidate]], count: int) -> list[_Candidate]:
    """Take equally many candidates off each ranked queue: the first of each way to change a box, then the second of
    each. The first candidates by statics are often one move by many amounts."""
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


def _different(states: Sequence[State], count: int) -> list[State]:
    """The first states; of states with the same changes by different amounts only one."""
    return [*{_way(state): state for state in reversed(states)}.values()][::-1][:count]


def _key(draft: Draft) -> bytes:
    """Equal for drafts that are the same."""
    order = np.array(draft.order)
    places = np.round(np.hstack([draft.corner_mm, draft.size_mm])[order], 3)
    key: bytes = order.tobytes() + places.tobytes() + np.array(draft.film_turns).tobytes()
    return key
