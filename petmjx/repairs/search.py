"""The search for the smallest change that makes a plan stand.

The search changes plans step by step. The search continues with the changed plans that promise a repair with few
changes: those for which the number of changes so far, plus the number of remaining faults, is smallest. To count the
faults of the original plan, the search simulates the plan without the boxes that fall. The faults of a changed plan
follow from the box that falls in the simulation of the changed plan. A plan is changed where it fails: statics ranks
the possible changes, and the best-ranked changes are judged at once, by one short simulation each. Changed plans that
stand when judged are then scored, by a full simulation. At the end, needless changes are taken back. Each remaining
change is needed: without it, the plan falls. Worlds with errors decide which of the repairs with the fewest changes is
chosen. If the chosen repair falls in too many worlds with errors, it is changed further at the places where it falls in
these worlds.

``Search.run`` is a generator: it yields drafts to be simulated and is sent their trials. So the searches of many plans
can share the simulations of an engine. Parts of a search that do not depend on each other run side by side
(``Together``). The simulated plans depend only on the plan, the options and the kind of engine, not on time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from petmjx.engines.verdict import Verdict
from petmjx.repairs.candidates import (
    AT_ONCE,
    Candidate,
    Candidates,
    Fault,
    Node,
    State,
    TrialsSpent,
    batch_of,
    n_counted,
    shortest,
    way_of,
)
from petmjx.repairs.changes import Film, Kind, LeaveOut, applied
from petmjx.repairs.drafts import Draft, key_of
from petmjx.repairs.proposals import lifted_with
from petmjx.repairs.requests import ERROR_WORLDS, Steps, Together, Trial, TrialRequest

BEAM: Final = 4
"""Number of changed plans that are changed further at once."""

PER_WAY: Final = 2
"""Of all plans in which the same boxes are changed in the same ways and the same box falls, at most this number are
changed further."""

FIRST_AT_ONCE: Final = 4
"""Number of changed plans that are judged first. If one change is enough, statics usually ranks it among the best."""

WIDE_AT_ONCE: Final = (8, 16, 24, 48)
"""Number of changed plans that are judged at once on a GPU, for each of the first four rounds of a search. The last
number also holds for all later rounds. During the last searches, a GPU has little to do, since the other searches have
ended. So a search on a GPU goes on in fewer rounds with more plans each: the first four rounds use up the share
``ALONE`` of the trials. These numbers of plans do not depend on other searches, and neither do the results."""

MOST_LIFTED: Final = 3
"""The boxes of at most this many faults are taken off one after the other. For each of these faults, the search waits
for a simulation. Further faults come to light when the counted faults are mended."""

ALONE: Final = 0.15
"""Share of all trials in which only single changes are tried. If no repair is found in these trials, the plan probably
has many faults, so it is built anew."""

MANY_FAULTS: Final = 6.0
"""If at least this number of changes is expected for a plan, single changes are tried only in the share
``ALONE_IF_MANY`` of the trials, and then the plan is built anew. With a lower limit, plans with fewer faults would be
built anew, too, and their repairs would have more changes."""

ALONE_IF_MANY: Final = 0.04
"""Share of all trials in which only single changes are tried, for plans with many faults (``MANY_FAULTS``). On a GPU,
these trials are two rounds."""

LATE_AT_ONCE: Final = 2 * AT_ONCE
"""Number of changed plans that are judged at once after single changes alone (``ALONE``) were in vain."""

BUILT_ANEW: Final = 0.2
"""Largest share of all trials in which plans are built anew."""

ROUNDS_ANEW: Final = 6
"""Largest number of rounds in which plans are built anew. Almost always, the first or second round finds a plan that
stands. Each round takes a second of statics, even if few of its plans are worth judging. With more rounds, the few
plans for which no repair is found would keep all other plans waiting."""

PAIR: Final = 2
"""Once a repair with ``PAIR`` + 1 changes is known, the search for a repair with ``PAIR`` changes is wide: it judges
more changes of the original plan (``PAIRS_AT_ONCE``). A wide search for repairs with more than ``PAIR`` changes takes
too many trials."""

PAIRS: Final = 0.2
"""Share of all trials that the wide search for a repair with ``PAIR`` changes may take."""

SURPLUS: Final = 1.0
"""The wide search also changes a plan further if the plan is expected to need more changes than the known repair has,
but the difference is less than this value. The expected number may be too large, because one change may mend two
faults."""

PAIRS_AT_ONCE: Final = 24
"""Number of changes of the original plan that are judged at once in the wide search for a repair with ``PAIR`` changes.
The first change of such a repair often has a bad rank by statics."""

SHORTER: Final = 0.04
"""Once a repair is known, the search for a repair with fewer changes takes at most this share of all trials."""

MOST_NEARLY: Final = 2
"""Largest number of plans that are scored before plans are built anew (``Search._nearly``). On a GPU, no plan that
falls when judged is scored: such plans hardly ever stand (none of 24), and their scores keep all searches waiting."""

MOST_ANEW: Final = 2
"""Largest number of changed plans that are built anew at once. Each changed plan is built anew in up to sixteen ways.
All ways together take about a second."""

CONFIRMED_AT_ONCE: Final = 2
"""Of the plans that stand when judged, this many are scored at once."""

MOST_FINALISTS: Final = 4
"""Worlds with errors decide which of the repairs with the fewest changes is chosen. At most this many repairs are
compared in all worlds of ``COMPARED_IN``."""

MOST_COMPARED: Final = 12
"""Largest number of repairs of which worlds with errors choose ``MOST_FINALISTS`` (``Search._standing_in``)."""

ALL_WORLDS: Final = range(1, ERROR_WORLDS + 1)
COMPARED_IN: Final = ALL_WORLDS[: ERROR_WORLDS // 2]
"""Numbers of the worlds with errors in which repairs are compared."""

MOST_LOST: Final = 3
"""If a repair falls in some worlds with errors, further changes of it are first judged in at most this many of these
worlds."""

WIDE: Final = 2
"""A GPU judges many plans as fast as a few. So on a GPU, the number of plans that a search judges at once is multiplied
by this factor, and the search has fewer rounds. (For single changes, ``WIDE_AT_ONCE`` holds instead. Worlds with errors
keep even a GPU busy, so a search on a GPU compares as few plans in them as on CPU threads.)"""

STRENGTHENED: Final = 0.33
"""Share of all trials that may be spent on further changes of a repair, so that the repair stands in more worlds with
errors."""

MOST_VAIN: Final = 2
"""Further changes of a repair for worlds with errors end after this number of rounds in a row that found no stronger
repair. Each round takes a tenth of the trials, and nearly all of its time is spent in worlds with errors. A plan that
stands in no world after two rounds hardly ever stands in more after four."""

MORE_TO_COMPARE: Final = 24
"""Number of additional changed plans that are judged at once, so that simulations with errors can choose among more
repairs."""

MOST_UNDONE: Final = 8
"""Limit of the total number of changes in all repairs that are compared. For each change, the search judges the repair
without this change, so the more changes repairs have, the fewer repairs are compared. If the chosen repair has at most
``MOST_UNDONE`` changes, it is also scored without each of its changes in turn. On a GPU, these plans are only judged:
scores of plans that fall would keep all searches waiting."""


@dataclass(eq=False)
class Search(Candidates):
    """The search for repairs of one plan.

    Attributes:
        plan: the plan.
        judged: the trial of the unchanged plan when it is only judged; None if this trial is not known before the
            search begins.
        before: the score of the unchanged plan; None until the plan has been scored. The plan may be scored before the
            search begins.
        repairs: the repairs, the best first. The best repair may have additional changes for worlds with errors; the
            others have the fewest changes with which the plan stands. Empty: there is no repair. Each change of a
            repair is needed: without it, the plan falls, is not allowed, or stands in too few worlds with errors.
        n_trials: number of simulations of changed plans.
        complete: whether the search has ended. Before the search ends, repairs may have needless changes.
        trials_spent: whether the trials were spent too early: before a repair with all boxes was found, although
            further changes could be tried; before the search had tested which changes are needed; or before it had
            compared repairs in worlds with errors. False if only the search for shorter repairs ended early: it has
            only a share of the trials.
        built_falls: whether boxes that stand already (``built``) fall before others are placed. If built boxes fall, no
            repair is sought.
    """

    judged: Trial | None = None
    before: Trial | None = None
    repairs: tuple[State, ...] = ()
    complete: bool = False
    trials_spent: bool = False
    built_falls: bool = False

    def take(self, other: Search) -> None:
        """Take over the results that the same search has reached in another process. If this search already knows that
        the unchanged plan stands, the results of the other process are ignored."""
        if self.complete:
            return
        self.before, self.repairs, self.n_trials = other.before or self.before, other.repairs, other.n_trials
        self.invalid = other.invalid
        self.complete, self.trials_spent, self.built_falls = other.complete, other.trials_spent, other.built_falls

    @property
    def _scale(self) -> int:
        """Factor by which more plans are judged at once, if the engine judges many plans as fast as a few."""
        return WIDE if self.is_wide else 1

    def _at_once(self, n_rounds: int, *, is_late: bool) -> int:
        """Number of changed plans that are judged at once after ``n_rounds`` rounds. ``is_late``: whether plans are
        built anew."""
        if self.is_wide:
            return WIDE * LATE_AT_ONCE if is_late else WIDE_AT_ONCE[min(n_rounds, len(WIDE_AT_ONCE) - 1)]
        return FIRST_AT_ONCE if self.before is None else LATE_AT_ONCE if is_late else AT_ONCE

    def begin(self, before: Trial) -> None:
        """Record the simulation of the unchanged plan."""
        self.before = before
        if before.stands:
            self.repairs, self.complete = (State(self._start, (), before),), True

    def run(self) -> Steps[None]:
        """Yields drafts to be simulated, and is sent their trials."""
        is_driven, is_scored = self.options.profile is not None, self.before is not None
        if self.judged is not None:
            self._remember([self._start], [self.judged])
        (trial,) = yield from self._simulated([self._start], judged=not is_driven)
        self.n_trials = 0  # the trial of the unchanged plan does not count
        self.invalid.clear()
        if is_driven:
            self.begin(trial)
        elif trial.stands and not is_scored:
            yield from self._begun(trial)
        elif trial.culprit is not None and max(trial.culprit + 1, trial.n_placed) <= self.rules.built:
            yield from self._begun_with_built(trial)
        if not (self._stands or self.built_falls):
            # Changes begin where the plan fell. If the plan fell both when it was judged and in its score, the judged
            # trial counts, because the changed plans are judged as well.
            known = trial if is_scored and not trial.stands else self.before or trial
            try:
                yield from self._mended(State(self._start, (), known))
            except TrialsSpent:  # the best repairs so far are the results
                self.trials_spent = True
            if self.before is None and not self._defers_scores:
                yield from self._begun(trial)
            if self.before is not None and self.before.stands:
                self.begin(self.before)
        self._seen.clear()
        self._known.clear()
        self._falls.clear()
        self._balances.clear()
        self.complete = True

    def _begun(self, judged: Trial) -> Steps[None]:
        """Score the unchanged plan, and record its score at once, because the time may be up before the search ends."""
        (trial,) = yield [TrialRequest(self._start, is_judged=False, judged=judged)]
        self.begin(trial)

    def _begun_with_built(self, judged: Trial) -> Steps[None]:
        """Score the unchanged plan. Also score the boxes that are already built, as if they alone were a plan. The
        method is called if a built box fell before any other box was placed. Every changed plan begins with the same
        placements, so no change helps if the built boxes fall even without the other boxes."""
        alone = replace(self._start, order=self._start.order[: self.rules.built])
        parts: list[Steps[Any]] = [self._begun(judged)] if self.before is None else []
        *_, (trial,) = yield Together([*parts, self._simulated([alone])])
        assert self.before is not None
        self.built_falls = not self.before.stands and trial.verdict == Verdict.UNSTABLE.value

    def _mended(self, start: State) -> Steps[None]:
        """Search for repairs of a plan that falls."""
        kinds = self.options.kinds
        standing: list[State] = []
        if Kind.FILM in kinds:
            standing = yield from self._wrapped(start)
        promising, kinds_with_all_boxes = [Node(start)], kinds - {Kind.FILM, Kind.LEAVE_OUT}
        most = self._most_trials
        if not standing and kinds_with_all_boxes:
            standing, promising = yield from self._changed(promising, kinds_with_all_boxes, most)
        if not standing and Kind.LEAVE_OUT in kinds and not self._stands:
            self._seen.clear()
            self._most_trials += most // 2
            standing, promising = yield from self._changed(promising, kinds - {Kind.FILM}, most // 2)
            if not standing:
                standing = yield from self._stripped(promising[0].state)
        if standing:
            self.repairs = tuple(standing)
            yield from self._finished(standing)
            fewest = len(self.repairs[0].changes)
            if self.options.worlds:
                yield from self._strengthened()
            # Needless changes are also taken back according to scores, except in two cases. On a GPU, scores would keep
            # all searches waiting (``MOST_UNDONE``). With a profile, each trial has already been a score.
            is_enough = self.is_wide or self.options.profile is not None
            if not is_enough and len(self.repairs[0].changes) == fewest <= MOST_UNDONE:
                (shorter,) = yield from self._pruned(self.repairs[:1], judged=False)
                self.repairs = (shorter, *self.repairs[1:])

    @property
    def _stands(self) -> bool:
        """Whether the plan stands as it is, although a box tilted when it was judged: the box leans on something."""
        return self.before is not None and self.before.stands

    # ------------------------------------------------------------------ film

    def _wrapped(self, start: State) -> Steps[list[State]]:
        """The plan with as few turns of film as it needs to survive the profile. The list is empty if no allowed number
        of turns is enough."""
        low, high = math.floor(self.film_turns), self.options.most_turns
        best: list[State] = []
        turns = high
        while low < turns:
            film = Film(float(turns))
            draft = film.applied(start.draft)
            (trial,) = yield from self._simulated([draft])
            if trial.stands:
                best, high = [State(draft, (film,), trial)], turns
                self.repairs = tuple(best)  # this is the result if the trials are spent, or the time is up
            else:
                low = turns
            turns = (low + high) // 2
        return best

    # ------------------------------------------------------------------ changes

    def _changed(
        self, start: Sequence[Node], kinds: frozenset[Kind], most_trials: int
    ) -> Steps[tuple[list[State], list[Node]]]:
        """Two lists: plans that stand after changes of these kinds, and the most promising of the plans that still
        fall."""
        options = self.options
        first, last = self.n_trials, self.n_trials + min(most_trials, self._n_left)
        end, nodes = last, list(start)
        ways = Counter(_kind_of(node.state) for node in nodes)
        standing: list[State] = []
        judged: list[State] = []  # states that stand when judged, without the doubtful ones
        doubtful: list[State] = []  # states that may fall when scored (``_is_doubtful``)
        is_late = is_widened = False
        n_anew, may_rebuild = 0, Kind.PLACE in kinds and options.profile is None
        # Boxes may be left out only after a search of many rounds in which no box was left out. So the count of
        # rounds begins with the number of those rounds.
        n_rounds = len(WIDE_AT_ONCE) if Kind.LEAVE_OUT in kinds else 0
        queues: list[list[Candidate]] = []
        while self.n_trials < last and not self._stands:
            nodes.sort(key=lambda node: node.key)
            useful = nodes
            if standing:  # only repairs with fewer changes than the repairs found so far are of use
                fewest = len(standing[0].changes)
                limit = fewest + (SURPLUS if is_widened else 0.0)
                useful = [n for n in nodes if len(n.state.changes) < fewest - 1 and n.n_promised < limit]
            alone = ALONE_IF_MANY if self._has_many_faults(start[0], kinds) else ALONE
            if not (standing or is_late) and self.n_trials - first >= int(alone * most_trials):
                is_late = True
                standing = yield from self._nearly(nodes, doubtful)
                if standing:
                    break
                if may_rebuild:
                    last = min(last, self.n_trials + int(BUILT_ANEW * most_trials))
            at_once = self._at_once(n_rounds, is_late=is_late)
            unchanged = [node for node in nodes if node.queue and not node.state.changes]
            if standing and fewest == PAIR + 1 and unchanged and not is_widened:
                is_widened, useful, at_once = True, unchanged, self._scale * PAIRS_AT_ONCE
                last = min(end, self.n_trials + int(PAIRS * most_trials))
            n_anew += is_late and may_rebuild
            if n_anew > ROUNDS_ANEW:
                # The search ends here as if its trials were used up: there may be further ways to build plans anew, but
                # none is tried.
                last = self.n_trials
                break
            queues = self._queues(useful, kinds, anew=is_late)
            # one trial is kept for the score of a repair
            batch = batch_of(queues, min(at_once, last - self.n_trials, self._n_left - 1))
            n_rounds += 1
            if not batch:  # no queue is left, or fewer trials are left than there are queues
                break
            parts = [self._judged(batch), self._count_faults(nodes)]
            if self.before is None and not self._defers_scores:
                parts.append(self._begun(self._known[key_of(self._start)]))
            states, *_ = yield Together(parts)
            if any(state.trial.stands for state in states):  # judge further candidates: they may stand more often
                if not self.is_wide:
                    # one trial is kept for the score of a repair
                    count = min(last - self.n_trials, self._n_left - 1)
                    next_candidates = self._rivals(queues, states, count)
                    batch, states = batch + next_candidates, states + (yield from self._judged(next_candidates))
                doubtful += [state for state in states if self._is_doubtful(state)]
                judged += [state for state in states if state.trial.stands and not self._is_doubtful(state)]
            states, shortened = yield from self._shortened(states, is_known=bool(standing))
            if shortened and not standing:
                last = min(last, self.n_trials + int(SHORTER * most_trials))
            standing = shortest([*standing, *shortened])
            self.repairs = tuple(standing)
            if is_late and standing:  # to build plans anew once more would hardly give a repair with fewer changes
                break
            pairs = zip(states, batch, strict=True)
            changed = [Node(one, self._remaining(one, c.parent), rank=c.key) for one, c in pairs]
            for node in sorted(changed, key=lambda node: node.key):
                state = node.state
                is_short = n_counted(state.changes) < options.most_changes
                if is_short and not state.trial.stands and ways[kind := _kind_of(state)] < PER_WAY:
                    ways[kind] += 1
                    nodes.append(node)
        if not standing and doubtful:
            standing = yield from self._nearly((), doubtful)
        if Kind.LEAVE_OUT not in kinds:
            self.trials_spent |= not (standing or self._stands) and (self.n_trials >= last or any(queues))
        if standing and self.options.worlds and options.profile is None:
            fewest = len(standing[0].changes)
            nodes = sorted((n for n in nodes if len(n.state.changes) == fewest - 1), key=lambda node: node.key)
            count = min(MORE_TO_COMPARE, self._n_left)
            further = yield from self._judged(batch_of(self._queues(nodes, kinds, anew=False), count))
            judged += [state for state in further if state.trial.stands and not self._is_doubtful(state)]
            standing = yield from self._compared(standing, [one for one in judged if len(one.changes) == fewest])
        nodes.sort(key=lambda node: (node.n_expected, node.key))
        return standing, [Node(node.state, node.faults) for node in nodes[:BEAM]]

    def _has_many_faults(self, start: Node, kinds: frozenset[Kind]) -> bool:
        """Whether a plan has so many faults that single changes hardly help it. The result is False if boxes may be
        left out, because this is the last resort. It is also False with a drive, because faults are then not counted
        one by one."""
        is_asked = self.options.profile is None and Kind.LEAVE_OUT not in kinds
        return is_asked and MANY_FAULTS <= start.n_expected < math.inf

    def _rivals(self, queues: Sequence[list[Candidate]], states: Sequence[State], count: int) -> list[Candidate]:
        """Take at most ``count`` candidates off the queues, and return them: candidates that the search may choose
        instead of the plans that stand. If worlds with errors are simulated, the search may choose any candidate.
        Otherwise, it may choose only a candidate that statics prefers to all standing plans with the fewest changes."""
        if not self.options.worlds:
            standing = shortest([state for state in states if state.trial.stands])
            fewest, best = len(standing[0].changes), min(self._risks(standing))
            safer = [[c for c in queue if (len(c.changes), c.risk) < (fewest, best)] for queue in queues]
            batch = batch_of([queue for queue in safer if queue], min(AT_ONCE, count))
            for queue in queues:
                queue[:] = [c for c in queue if c not in batch]
            return batch
        return batch_of(queues, min(MORE_TO_COMPARE, count))

    def _compared(self, scored: Sequence[State], judged: Sequence[State]) -> Steps[list[State]]:
        """Of repairs with the same number of changes, those that stand most often in a few worlds with errors. The
        first of these worlds, and otherwise statics, decide which repairs are judged in the others.

        Args:
            scored: plans that stand when scored.
            judged: plans that stand when judged.
        """
        different = [*{key_of(state.draft): state for state in (*judged, *scored)}.values()]
        chosen = [different[k] for k in self._safest(different)[:MOST_COMPARED]]
        standing, falling = yield from self._standing_in(chosen, ALL_WORLDS[:1], _n_finalists(chosen))
        finalists = (standing + falling)[:MOST_FINALISTS]
        counted = yield from self._judged_in(finalists, COMPARED_IN)
        counted.sort(key=lambda state: -state.n_good)
        sure = {key_of(state.draft) for state in scored}
        unsure = [k for k, state in enumerate(counted) if key_of(state.draft) not in sure]
        for k, state in zip(unsure, (yield from self._scored([counted[k] for k in unsure])), strict=True):
            counted[k] = state
        return [state for state in counted if state.trial.stands] or [*scored]

    def _standing_in(
        self, states: Sequence[State], worlds: Sequence[int], count: int
    ) -> Steps[tuple[list[State], list[State]]]:
        """Plans that stand in one of these worlds with errors, and all other plans. The plans are judged a few at once,
        in one world after the other, until ``count`` of them stand: a world with errors has five times as many steps as
        a world without errors, because a hand lowers the boxes only in worlds with errors."""
        standing, falling = list[State](), [*states]
        for world in worlds:
            waiting, falling = falling, []
            while waiting and len(standing) < count:
                batch = yield from self._judged_in(waiting[:MOST_FINALISTS], [world])
                del waiting[:MOST_FINALISTS]
                standing += [state for state in batch if state.errors[world].stands]
                falling += [state for state in batch if not state.errors[world].stands]
            falling += waiting
        return standing, falling

    def _judged_until(self, states: Sequence[State], wanted: int) -> Steps[list[State]]:
        """Plans with their trials in all worlds with errors. No further plan is judged once one stands in ``wanted`` of
        these worlds."""
        judged: list[State] = []
        for begin in range(0, len(states), self._scale):
            judged += yield from self._judged_in(states[begin : begin + self._scale], ALL_WORLDS)
            if any(state.n_good >= wanted for state in judged):
                break
        return judged

    @property
    def _defers_scores(self) -> bool:
        """Whether plans are judged first, and scored only if nothing else is left. On a GPU, a score would keep all
        searches waiting. The unchanged plan is then scored after all searches, if its judged trial is no score. With a
        profile, each trial is already a score."""
        return self.is_wide and self.options.profile is None

    def _is_doubtful(self, state: State) -> bool:
        """Whether a plan stands when judged, but would need a score, because it still moves, or needs further attempts
        (docs/rules.md, section 9)."""
        return self._defers_scores and state.trial.stands and not state.trial.is_score

    def _nearly(self, nodes: Sequence[Node], doubtful: list[State]) -> Steps[list[State]]:
        """Score a few changed plans. Of those that stand, the plans with the fewest changes are returned. The search
        scores plans with a single fault: in such a plan, a box tilts, but may lean on something. On a GPU, it scores
        plans of the list ``doubtful`` instead (``_is_doubtful``). Plans that are scored are removed from
        ``doubtful``."""
        if self.options.profile is not None:
            return []
        falling = [node.state for node in nodes if node.n_faults <= 1]
        chosen = sorted(doubtful if self.is_wide else falling, key=lambda state: len(state.changes))
        chosen = chosen[: min(MOST_NEARLY, self._n_left)]
        doubtful[:] = [state for state in doubtful if state not in chosen]
        scored = yield from self._scored(chosen)
        return shortest([state for state in scored if state.trial.stands])

    def _queues(self, nodes: Sequence[Node], kinds: frozenset[Kind], *, anew: bool) -> list[list[Candidate]]:
        """For each of the best nodes, its ranked changes that were not judged yet. With ``anew``, the queues instead
        have ways to build plans anew, if there are nodes whose plans were not built anew before."""
        if anew and Kind.PLACE in kinds:
            chosen = [node for node in nodes if not node.is_anew][:MOST_ANEW]
            for node in chosen:
                node.is_anew = True
            queues = self._anew(chosen, kinds)
            if any(queues):
                return queues
        queues = []
        for node in nodes:
            if node.queue is None:
                node.queue = self._changes(node, kinds)
            node.queue[:] = [candidate for candidate in node.queue if not self._falls_early(key_of(candidate.draft))]
            if node.queue:
                queues.append(node.queue)
                node.n_rounds += 1
            if len(queues) == BEAM:
                break
        return queues

    def _count_faults(self, nodes: Sequence[Node]) -> Steps[None]:
        """Count the faults of the nodes whose faults are not counted yet."""
        unknown = [node for node in nodes if node.faults is None]
        counts: list[tuple[Fault, ...]] = yield Together([self._faults_of(node.state) for node in unknown])
        for node, faults in zip(unknown, counts, strict=True):
            node.faults = faults

    def _faults_of(self, state: State) -> Steps[tuple[Fault, ...]]:
        """The faults of a plan. Boxes that fall are taken off one by one, with all boxes that would lose their support,
        until the rest stands. With a drive, to take boxes off one by one would be too expensive, so only the boxes that
        fell are counted."""
        draft, trial, faults = state.draft, state.trial, list[Fault]()
        if self.options.profile is not None and not trial.stands:
            return (Fault.of(_lost(draft, trial), len(trial.fallen)),)
        while not trial.stands:
            box = _lost(draft, trial)
            lifted = lifted_with(draft, box)
            faults.append(Fault.of(box, len(lifted)))
            if (
                self._n_left < 2
                or len(faults) > MOST_LIFTED
                or min(lifted) < self.rules.built
                or len(lifted) == len(draft.order)
            ):
                break
            draft = replace(draft, order=tuple(box for box in draft.order if box not in lifted))
            (trial,) = yield from self._simulated([draft], judged=True)
        return tuple(faults)

    def _remaining(self, state: State, parent: Node) -> tuple[Fault, ...]:
        """The expected faults of a changed plan, from its trial and the faults of the plan before the change. If the
        box that falls in the trial was a fault before the change, all faults before this fault count as mended. If the
        box was no fault, the change has added a fault, and the later faults remain. The faults are not counted by
        simulations without the boxes that fall, because each changed plan would then need a trial for each of its
        faults."""
        if state.trial.stands:
            return ()
        before, draft = parent.faults or (), state.draft
        box = _lost(draft, state.trial)
        boxes = [fault.box for fault in before]
        if box in boxes:
            return before[boxes.index(box) :]
        lifted = lifted_with(draft, box)
        later = [fault for fault in before if fault.box not in lifted and draft.rank[fault.box] > draft.rank[box]]
        return (Fault.of(box, len(lifted)), *later)

    def _stripped(self, state: State) -> Steps[list[State]]:
        """The state without the boxes that fall. Boxes that fall are left out one by one, with all boxes that would
        lose their support, until the remaining boxes stand. The result is empty if a box that is already built, or the
        last box, would have to be left out. The loop always ends, since each step leaves out a box. If scores are
        deferred (``_defers_scores``), plans are judged before they are scored."""
        while True:
            while not state.trial.stands:
                lifted = lifted_with(state.draft, _lost(state.draft, state.trial))
                if min(lifted) < self.rules.built or len(lifted) >= len(state.draft.order):
                    return []
                changes = (*state.changes, *map(LeaveOut, lifted))
                draft = applied(self._start, changes)
                if draft is None:
                    return []
                (trial,) = yield from self._simulated([draft], judged=self._defers_scores)
                state = State(draft, changes, trial)
            if not self._defers_scores:
                return [state]
            (state,) = yield from self._scored([state])
            if state.trial.stands:
                return [state]

    def _shortened(self, states: Sequence[State], *, is_known: bool) -> Steps[tuple[list[State], list[State]]]:
        """Returns two lists of states. The first list has all states; of these, states that stand when judged are
        scored, as far as needed. The second list has the states that stand when scored, without their needless changes.
        ``is_known``: as in ``_confirmed``."""
        every, confirmed = yield from self._confirmed(states, is_known=is_known)
        self.repairs = self.repairs or tuple(shortest(confirmed))
        return every, (yield from self._pruned(confirmed, judged=True))

    def _confirmed(self, states: Sequence[State], *, is_known: bool) -> Steps[tuple[list[State], list[State]]]:
        """Score states that stand when judged, those with the fewest changes first, until some of them also stand when
        scored. Returns all states, and those that stand when scored. With a profile, nothing is scored here, because
        each trial is already a score. Doubtful plans (``_is_doubtful``) are not scored here.

        Args:
            is_known: whether a repair is known. If a repair is known, only the first ``CONFIRMED_AT_ONCE`` states are
                scored: if these fall, so do most others of the same batch.
        """
        every = list(states)
        numbers = [k for k, state in enumerate(states) if state.trial.stands]
        safest = [numbers[n] for n in self._safest([states[k] for k in numbers])]
        safest = [k for k in safest if not self._is_doubtful(states[k])]
        queue = sorted(safest, key=lambda k: len(states[k].changes))
        if self.options.profile is not None:
            return every, [states[k] for k in queue]
        for begin in range(0, len(queue), CONFIRMED_AT_ONCE):
            chosen = queue[begin : begin + min(CONFIRMED_AT_ONCE, self._n_left)]
            for k, state in zip(chosen, (yield from self._scored([states[k] for k in chosen])), strict=True):
                every[k] = state
            confirmed = [every[k] for k in chosen if every[k].trial.stands]
            if confirmed or is_known:
                return every, confirmed
        return every, []

    # ------------------------------------------------------------------ the end

    def _finished(self, standing: Sequence[State]) -> Steps[None]:
        """Take back needless changes, and keep the repairs with the fewest changes."""
        finalists = shortest(standing)[: _n_finalists(standing)]
        reduced: list[State] = yield Together([self._reduced(state) for state in finalists])
        pruned = shortest((yield from self._pruned(reduced, judged=True)))
        different = [*{key_of(state.draft): state for state in pruned}.values()]
        ranks = [(-state.n_good, *risk) for state, risk in zip(different, self._risks(different), strict=True)]
        self.repairs = tuple(different[k] for k in sorted(range(len(ranks)), key=ranks.__getitem__))

    def _strengthened(self) -> Steps[None]:
        """Put the repair first that stands in the most worlds with errors. Then change this repair further, until it
        stands in the wanted share of the worlds with errors. The repair is changed where it falls in these worlds, just
        as a plan that falls without errors is changed where it falls."""
        options = self.options
        wanted = math.ceil(options.share * ERROR_WORLDS)
        compared = yield from self._judged_until(self.repairs, ERROR_WORLDS)
        compared.sort(key=lambda state: -state.n_good)
        self.repairs = tuple(compared)
        kinds = options.kinds - {Kind.FILM, Kind.LEAVE_OUT}
        if options.profile is not None or not kinds:
            return
        self._seen.clear()
        nodes, best = [Node(state) for state in compared], compared[0]
        last, n_vain = self.n_trials + min(int(STRENGTHENED * options.trials), self._n_left), 0
        while nodes and best.n_good < wanted and self.n_trials < last and n_vain < MOST_VAIN:
            node = min(nodes, key=lambda node: (node.n_rounds - node.state.n_good, node.state.cost))
            if node.queue is None:
                node.queue = self._changes(node, kinds)
            if not node.queue:
                nodes.remove(node)
                continue
            node.n_rounds, n_vain = node.n_rounds + 1, n_vain + 1
            batch = batch_of([node.queue], min(self._scale * MORE_TO_COMPARE, self._n_left))
            try:
                better = yield from self._stronger(node.state, batch, wanted)
                nodes += [Node(state) for state in better]
                better.sort(key=lambda state: (-state.n_good, state.cost))
                if better and better[0].n_good > best.n_good:
                    (most,) = yield from self._scored(better[:1])
                    if most.trial.stands:
                        best, n_vain = most, 0
            except TrialsSpent:
                self.trials_spent = True
                break
        if best is not compared[0]:
            self.repairs = (best, *compared)
            best = yield from self._needed(best, min(wanted, best.n_good))
            self.repairs = (best, *compared)

    def _stronger(self, weak: State, batch: Sequence[Candidate], wanted: int) -> Steps[list[State]]:
        """The candidates that stand, and stand in more worlds with errors than the plan ``weak`` from which they were
        made. Candidates that stand without errors are judged in worlds in which ``weak`` falls, until enough of them
        stand. The best candidates are judged in all worlds with errors, until one stands in ``wanted`` of them.
        """
        judged = yield from self._judged(batch)
        standing = [state for state in judged if state.trial.stands]
        chosen = [standing[k] for k in self._safest(standing)[:MOST_COMPARED]]
        worlds = [*weak.lost][:MOST_LOST]
        good, _ = yield from self._standing_in(chosen, worlds, MOST_FINALISTS)
        good = yield from self._judged_in(good[: 2 * MOST_FINALISTS], worlds)
        good.sort(key=lambda state: -state.n_good)
        finalists = yield from self._judged_until(good[:MOST_FINALISTS], wanted)
        return [state for state in finalists if state.n_good > weak.n_good]

    def _needed(self, state: State, n_good: int) -> Steps[State]:
        """The state without needless changes. A change is needless if the plan without this change stands in the world
        without errors, and in at least ``n_good`` of the worlds with errors."""
        while len(state.changes) > 1:
            lists = [(*state.changes[:k], *state.changes[k + 1 :]) for k in range(len(state.changes))]
            shorter = yield from self._trials_of(lists, judged=self.is_wide or len(lists) > MOST_UNDONE)
            shorter = [one for one in shorter if one.trial.stands]
            for n_worlds in (ERROR_WORLDS // 2, ERROR_WORLDS):
                shorter = yield from self._judged_in(shorter, ALL_WORLDS[:n_worlds])
                shorter = [one for one in shorter if one.n_good >= n_good - (ERROR_WORLDS - n_worlds)]
            shorter.sort(key=lambda one: one.cost)
            scored = yield from self._scored(shorter[:1])
            if not scored or not scored[0].trial.stands:
                break
            state = scored[0]
        return state

    def _reduced(self, state: State) -> Steps[State]:
        """The state after needless changes have been taken back in groups. Halves of the changes are tried first, then
        smaller groups. A state with at most ``MOST_UNDONE`` changes is returned unchanged."""
        size = len(state.changes) // 2 if len(state.changes) > MOST_UNDONE else 0
        shorter = state
        while size > 1:
            changes = shorter.changes
            change_lists = [(*changes[:k], *changes[k + size :]) for k in range(0, len(changes), size)]
            if self._n_left <= len(change_lists):
                break
            standing = [one for one in (yield from self._trials_of(change_lists, judged=True)) if one.trial.stands]
            if standing:
                shorter = min(standing, key=lambda one: one.cost)
            size = min(size if standing else size // 2, len(shorter.changes) // 2)
        if shorter is not state:
            (scored,) = yield from self._scored([shorter])
            if scored.trial.stands:
                return scored
        return state

    def _pruned(self, states: Sequence[State], *, judged: bool) -> Steps[list[State]]:
        """The given states, which stand, without their needless changes. Changes are taken back one by one.

        Args:
            judged: whether states with fewer changes are only judged. Then, for each given state, only the cheapest
                state that remains is scored. To score all states with fewer changes would take minutes.
        """
        shorter = list(states)
        remaining = [k for k, state in enumerate(states) if len(state.changes) > 1]
        while remaining:
            change_lists = {
                k: [(*changes[:n], *changes[n + 1 :]) for n in range(len(changes))]
                for k in remaining
                for changes in [shorter[k].changes]
            }
            different = dict.fromkeys(changes for lists in change_lists.values() for changes in lists)
            tried = yield from self._trials_of([*different], judged=judged)
            standing = {state.changes: state for state in tried if state.trial.stands}
            remaining = []
            for k, lists in change_lists.items():
                if some := [standing[changes] for changes in lists if changes in standing]:
                    shorter[k] = min(some, key=lambda state: state.cost)
                    if len(shorter[k].changes) > 1:
                        remaining.append(k)
        changed = [k for k, state in enumerate(states) if judged and shorter[k] is not state]
        for k, scored in zip(changed, (yield from self._scored([shorter[k] for k in changed])), strict=True):
            shorter[k] = scored if scored.trial.stands else states[k]
        return shorter


def _lost(draft: Draft, trial: Trial) -> int:
    """The box that fell first; if no fallen box is known, the box that was placed last."""
    return draft.order[min(trial.n_placed, len(draft.order)) - 1] if trial.culprit is None else trial.culprit


def _kind_of(state: State) -> tuple[object, ...]:
    """A key that is equal for plans that fall, if they are changed in the same ways and the same box falls."""
    return way_of(state), _lost(state.draft, state.trial)


def _n_finalists(states: Sequence[State]) -> int:
    """How many of the given repairs are tested for needless changes, one change after the other."""
    return min(MOST_FINALISTS, max(MOST_UNDONE // min(len(state.changes) for state in states), 1))
