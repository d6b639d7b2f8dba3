"""The search for the smallest change that makes a plan stand.

A beam of changed plans is simulated, until one stands. Each step changes a plan where it fails: statics ranks what may
help there, and the best ranked changes are simulated at once. Then changes that are not needed are taken back, so that
without any one of those that are left the plan falls.

``search`` is a generator: it yields drafts to be simulated and is sent their trials. So the searches of many plans can
share runs of an engine. What is simulated depends on the plan and the options alone, not on the time that it takes.
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
from petmjx.packers.robot_placement import placement_stability
from petmjx.plans.plan import Plan
from petmjx.repairs.balance import balances
from petmjx.repairs.changes import Change, Film, Kind, LeaveOut, applied, cost_of, with_change
from petmjx.repairs.drafts import Draft, Rules
from petmjx.repairs.proposals import Limits, Proposal, Target, lifted_with, proposals, relocation, targets
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.trials import Asked, Trial

Asking = Generator[list[Asked], list[Trial], None]

BEAM: Final = 2
"""Changed plans that are changed further in each step."""

TRIALS: Final = (6, 10, 20)
"""Changes of a plan that are simulated at once: the first ones, then more as long as none helps."""

MOST_OF_KIND: Final = 4
MOST_OF_BOX: Final = 3
"""Changes of one kind, and of one box by one kind, among those that are simulated at once: what statics ranks first are
often many ways to do the same."""

CONFIRMED_AT_ONCE: Final = 6
"""Plans that stand on forks and are scored at once."""

MOST_FINALISTS: Final = 3
"""Repairs with the least number of changes that are compared with errors."""

PER_COST: Final = 0.3
"""Weight of a change's cost in the ranking, against loads beyond edges."""

SAME_COST: Final = 0.1
"""Repairs whose costs differ by less count as equally cheap: 50 mm of a way. The one that is likelier to stand with
errors is taken."""

UNSOLVED: Final = 3.0
"""Weight of the first cause if it is still there."""

WITHOUT_PROGRESS: Final = 3
"""Steps without a further standing box after which a search ends."""


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
        culprit: the box that fell first without the changes; None: not known.
    """

    draft: Draft
    changes: tuple[Change, ...]
    proposal: Proposal
    trouble: float
    key: float
    culprit: int | None

    def helped(self, trial: Trial) -> bool:
        """Whether the box that fell first stands now, or is left out."""
        if self.culprit is None:
            return True
        rank = self.draft.rank[self.culprit]
        return not math.isfinite(rank) or (rank < trial.n_placed and self.culprit not in trial.fallen)


@dataclass(eq=False)
class Search:
    """The search for repairs of one plan.

    Attributes:
        plan: the plan.
        before: its simulation; None: not known yet.
        repairs: the repairs with the fewest changes, the best first; empty: there is none. Undoing any one change of a
            repair gives a plan that falls, or that is not allowed.
        n_trials: simulated plans.
    """

    plan: Plan
    sim: Simulation
    options: RepairOptions
    film_turns: float = 0.0
    before: Trial | None = None
    repairs: tuple[State, ...] = ()
    n_trials: int = 0

    def __post_init__(self) -> None:
        """Prepare the rules of the plan."""
        options = self.options
        self.rules = Rules(self.plan, self.sim, options.max_height_mm, options.built)
        self._start = Draft.of(self.plan, self.film_turns)
        self._seen: set[bytes] = set()

    def run(self) -> Asking:
        """Yields drafts to be simulated, and is sent their trials."""
        (self.before,) = yield from self._simulated([self._start])
        start = State(self._start, (), self.before)
        if start.trial.stands:
            self.repairs = (start,)
            return
        kinds = self.options.kinds
        standing: list[State] = []
        if Kind.FILM in kinds:
            standing = yield from self._wrapped(start)
        best = start
        if not standing and kinds - {Kind.FILM, Kind.LEAVE_OUT}:
            standing, best = yield from self._changed(start, kinds - {Kind.FILM, Kind.LEAVE_OUT}, self.options.trials)
        if not standing and Kind.LEAVE_OUT in kinds:
            left = self.options.trials // 2
            self._seen.clear()
            standing, _ = yield from self._changed(best, kinds - {Kind.FILM}, left)
            if not standing and best is not start:
                self._seen.clear()
                standing, _ = yield from self._changed(start, frozenset({Kind.LEAVE_OUT}), left)
            if not standing:
                standing = yield from self._stripped(best)
        if standing:
            yield from self._finished(standing)

    def _simulated(
        self, drafts: Sequence[Draft], parents: Sequence[Draft] | None = None
    ) -> Generator[list[Asked], list[Trial], list[Trial]]:
        self.n_trials += len(drafts)
        return (yield [(draft, None if parents is None else parents[k]) for k, draft in enumerate(drafts)])

    # ------------------------------------------------------------------ film

    def _wrapped(self, start: State) -> Generator[list[Asked], list[Trial], list[State]]:
        """The fewest turns of film with which the plan survives the profile; empty: there is no such number."""
        low, high = math.floor(self.film_turns), self.options.most_turns
        if high <= low:
            return []
        kept: State | None = None
        tried = [high]
        while tried:
            films = [Film(float(turns)) for turns in tried]
            drafts = [draft for film in films if (draft := film.applied(start.draft)) is not None]
            trials = yield from self._simulated(drafts)
            for film, draft, trial in zip(films, drafts, trials, strict=True):
                if trial.stands and (kept is None or film.turns < high or kept is None):
                    kept, high = State(draft, (film,), trial), int(film.turns)
                elif not trial.stands:
                    low = max(low, int(film.turns))
            if kept is None or high - low <= 1:
                break
            tried = [(low + high) // 2]
        return [] if kept is None else [kept]

    # ------------------------------------------------------------------ changes

    def _changed(
        self, start: State, kinds: frozenset[Kind], most_trials: int
    ) -> Generator[list[Asked], list[Trial], tuple[list[State], State]]:
        """Plans that stand after changes of these kinds, and the one with the most standing boxes if none does."""
        options = self.options
        limits = Limits(kinds, options.most_move_mm, options.sheet_mm, options.sheet_kg_m2)
        beam, best, last = [start], start, self.n_trials + most_trials
        idle = 0
        while beam and self.n_trials < last and idle < WITHOUT_PROGRESS:
            ranked = [self._ranked(state, limits) for state in beam]
            tried: list[tuple[State, _Candidate]] = []
            progress = max(state.trial.n_standing for state in beam)
            for count in TRIALS:
                batch = [
                    (c, state.draft) for state, some in zip(beam, ranked, strict=True) for c in _diverse(some, count)
                ]
                for candidates in ranked:
                    candidates[:] = [c for c in candidates if all(c is not other for other, _ in batch)]
                batch = batch[: max(last - self.n_trials, 0)]
                if not batch:
                    break
                trials = yield from self._simulated([c.draft for c, _ in batch], [parent for _, parent in batch])
                states = [State(c.draft, c.changes, trial) for (c, _), trial in zip(batch, trials, strict=True)]
                standing = yield from self._confirmed(states)
                if standing:
                    return standing, best
                tried += [(state, c) for state, (c, _) in zip(states, batch, strict=True)]
                if any(c.helped(state.trial) and state.trial.n_standing > progress for state, c in tried):
                    break
            tried.sort(key=lambda p: (not p[1].helped(p[0].trial), -p[0].trial.n_standing, p[1].trouble, p[0].cost))
            beam = [state for state, _ in tried if self._is_short(state)][:BEAM]
            if beam and tried[0][1].helped(beam[0].trial) and beam[0].trial.n_standing > best.trial.n_standing:
                best, idle = beam[0], 0
            else:
                idle += 1
        return [], best

    def _stripped(self, state: State) -> Generator[list[Asked], list[Trial], list[State]]:
        """The state without the boxes that fall, left out one after the other with all that stands on them, until the
        rest stands; empty: boxes that stand already fall. It always ends, since each step leaves out a box."""
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
        """Score states that stand on forks, the cheapest first, until some are confirmed. Returns those; the others
        that were scored get the trial of the score."""
        ways: Counter[tuple[object, ...]] = Counter()
        queue = []
        for k in sorted((k for k, state in enumerate(states) if state.trial.stands), key=lambda k: _size(states[k])):
            queue.append((ways[_way(states[k])], k))
            ways[_way(states[k])] += 1
        queue.sort(key=lambda pair: pair[0])  # stable: one of each way first
        numbers = [k for _, k in queue]
        for begin in range(0, len(numbers), CONFIRMED_AT_ONCE):
            chosen = numbers[begin : begin + CONFIRMED_AT_ONCE]
            trials = yield from self._simulated([states[k].draft for k in chosen])
            for k, trial in zip(chosen, trials, strict=True):
                states[k] = replace(states[k], trial=trial)
            confirmed = [states[k] for k in chosen if states[k].trial.stands]
            if confirmed:
                return confirmed
        return []

    def _is_short(self, state: State) -> bool:
        """Whether a state may be changed further."""
        counted = [change for change in state.changes if change.kind is not Kind.LEAVE_OUT]
        return len(counted) < self.options.most_changes

    def _ranked(self, state: State, limits: Limits) -> list[_Candidate]:
        """Allowed changes of a plan, the most promising first."""
        (balance,) = balances([state.draft], self.sim)
        trial = state.trial
        causes = targets(state.draft, self.rules, balance, trial.culprit, trial.fallen, trial.n_placed)
        first = next((cause for cause in causes if cause.depth_mm > 0), causes[0]) if causes else None
        drafts: list[Draft] = []
        origins: list[Proposal] = []
        for cause in causes:
            for proposal in itertools.chain(
                proposals(state.draft, self.rules, cause, limits), self._relocations(state.draft, cause, limits)
            ):
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
            if len(changes) < len(state.changes) + len(proposal):  # some became one: the whole list says the same
                merged = applied(self._start, changes)
                if merged is None or _key(merged) != _key(draft):
                    changes = (*state.changes, *proposal)
            unsolved = first is not None and after.depth_of(first.box) > 0
            rank = after.trouble + UNSOLVED * unsolved + PER_COST * cost_of(proposal)
            ranked.append(_Candidate(draft, changes, proposal, after.trouble, rank, trial.culprit))
        ranked.sort(key=lambda candidate: candidate.key)
        self._seen.difference_update(_key(candidate.draft) for candidate in ranked[sum(TRIALS) :])
        return ranked

    def _relocations(self, draft: Draft, cause: Target, limits: Limits) -> Iterator[Proposal]:
        """Piles put elsewhere box by box: that of the box that does not hold, and that of the box that is too much."""
        if Kind.PLACE in limits.kinds:
            for box in dict.fromkeys((cause.box, cause.cause)):
                if box in draft.order and draft.on_top[box].any():
                    relocated = relocation(draft, self.rules, self.sim, box)
                    if relocated is not None:
                        yield relocated

    # ------------------------------------------------------------------ the end

    def _finished(self, standing: Sequence[State]) -> Asking:
        """Take back what is not needed, and keep the repairs with the fewest changes."""
        ways: dict[tuple[object, ...], list[State]] = {}
        for state in sorted(standing, key=_size):
            ways.setdefault(_way(state), []).append(state)
        pruned: list[State] = []
        for states in [*ways.values()][:MOST_FINALISTS]:
            chosen = max(states, key=lambda state: (self._chance(state), -state.cost))
            pruned.append((yield from self._pruned(chosen)))
        fewest = min(len(state.changes) for state in pruned)
        short = [state for state in pruned if len(state.changes) == fewest]
        different = {_key(state.draft): state for state in reversed(short)}
        self.repairs = tuple(sorted(different.values(), key=lambda state: (_size(state), -self._chance(state))))

    def _pruned(self, state: State) -> Generator[list[Asked], list[Trial], State]:
        """The state without changes that are not needed."""
        while len(state.changes) > 1:
            shorter = [
                (draft, changes)
                for k in range(len(state.changes))
                if (draft := applied(self._start, changes := (*state.changes[:k], *state.changes[k + 1 :]))) is not None
            ]
            allowed = self.rules.allow([draft for draft, _ in shorter]) if shorter else np.zeros(0, bool)
            some = [pair for pair, good in zip(shorter, allowed, strict=True) if good]
            trials = (yield from self._simulated([draft for draft, _ in some])) if some else []
            standing = [
                State(draft, changes, trial)
                for (draft, changes), trial in zip(some, trials, strict=True)
                if trial.stands
            ]
            if not standing:
                return state
            state = min(standing, key=lambda shorter_state: shorter_state.cost)
        return state

    def _chance(self, state: State) -> float:
        """The estimated chance that the changed plan stands when a robot places the boxes, in tenths."""
        return round(float(placement_stability(state.draft.as_plan()).prod()), 1)


def _size(state: State) -> tuple[int, float]:
    """The number of changes, and their cost in steps of ``SAME_COST``."""
    return len(state.changes), math.floor(state.cost / SAME_COST)


def _way(state: State) -> tuple[object, ...]:
    """Equal for repairs that change the same boxes in the same ways, by other amounts."""
    return tuple((change.kind, change.boxes) for change in state.changes)


def _diverse(candidates: Sequence[_Candidate], count: int) -> list[_Candidate]:
    """The first candidates, with few of a kind and of a box; then the others that come first."""
    kinds: Counter[tuple[Kind, bool]] = Counter()
    boxes: Counter[tuple[tuple[Kind, bool], tuple[int, ...]]] = Counter()
    chosen: list[_Candidate] = []
    for candidate in candidates:
        if len(chosen) == count:
            break
        kind = candidate.proposal[-1].kind, len(candidate.proposal) > 1
        key = kind, candidate.proposal[-1].boxes[:1]
        if kinds[kind] < MOST_OF_KIND and boxes[key] < MOST_OF_BOX:
            chosen.append(candidate)
            kinds[kind] += 1
            boxes[key] += 1
    rest = [candidate for candidate in candidates if candidate not in chosen]
    return chosen + rest[: count - len(chosen)]


def _key(draft: Draft) -> bytes:
    """Equal for drafts that are the same."""
    order = np.array(draft.order)
    places = np.round(np.hstack([draft.corner_mm, draft.size_mm])[order], 3)
    key: bytes = order.tobytes() + places.tobytes() + np.array(draft.film_turns).tobytes()
    return key
