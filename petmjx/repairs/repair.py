"""``petmjx.repair``: changes that make plans stand."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final, Protocol

import pandas as pd

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable_name
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import READING, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import PathArgument, PlanSource, usable_plans, without_built_plans
from petmjx.plans.plan_warnings import odd_layouts
from petmjx.plans.plan_writer import save_plans
from petmjx.repairs.candidates import State
from petmjx.repairs.changes import Change, Film, Kind, applied, cost_of, with_turns_told
from petmjx.repairs.drafts import Draft
from petmjx.repairs.expected_time import size_of
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.requests import Trial, TrialRequest
from petmjx.repairs.search import Search
from petmjx.repairs.search_processes import OnEnd, SearchProcesses, most_processes
from petmjx.repairs.trials import OF_RUN, SEARCHED, Question, Share, TimeLimit, TrialStream
from petmjx.results.notebook_tables import ShownColumn, block_as_html, table_as_html
from petmjx.results.plan_lookup import plans_in_place
from petmjx.results.share_statistics import wilson_interval
from petmjx.runs.notebook_progress import watching
from petmjx.runs.simulate import RunStart
from petmjx.world.option_lint import notes_about

OF_READING: Final = (*READING, "articles", "limit", "strict")
"""Fields of ``RunOptions`` about the reading of plans."""

AT_ONCE: Final = 256
GPU_AT_ONCE: Final = 1024
"""Largest number of plans that are repaired at the same time, on CPU threads and on a GPU. The trials of plans that
are repaired at the same time share runs of the engine, so that a GPU has enough worlds to be busy. The next plans wait
for the last search: seven of 263 plans waited for more than a minute, when this number was 256 on a GPU, too."""

SHOWN: Final = (
    ShownColumn("plan_id", "plan"),
    ShownColumn("boxes", "boxes"),
    ShownColumn("before", "before"),
    ShownColumn("after", "after"),
    ShownColumn("n_changes", "changes"),
    ShownColumn("left_out", "left out"),
    ShownColumn("cost", "cost", 1),
    ShownColumn("share_before", "with errors before %", 1, 100.0),
    ShownColumn("share_after", "after %", 1, 100.0),
)
"""Columns of ``Repairs.table`` in a notebook."""


_CHANGE_COLUMNS: Final = (
    *("plan_id", "number", "kind", "boxes", "words", "cost"),
    *("x_mm", "y_mm", "z_mm", "turned", "position"),
)
"""Columns of ``Repairs.changes``."""

_FRAME: Final = (
    "places are those of front-left-bottom corners, mm, in the coordinates of the plans that petmjx writes: "
    "x = 0 and y = 0 are usually the left and the front edge of the load, z = 0 is the top of the carrier"
)


@dataclass(frozen=True, eq=False)
class Repaired:
    """One plan and its repair.

    Attributes:
        before: the plan before the repair.
        plan: the repaired plan; the plan itself if it stands already, or if no repair is known.
        changes: the changes, in order. Each change is needed: without it, the plan falls, or is not allowed (boxes
            overlap, float, …), or stands in too few worlds with errors (``RepairOptions.share``).
        trial_before, trial_after: the simulations of the plan and of the repaired plan. ``trial_after`` is None if no
            repair is known.
        share_before, share_after: shares of worlds with errors in which the plan stands before and after its repair;
            None: the worlds were not simulated, or the time was up before all of these worlds had ended.
        n_trials: number of simulations of changed plans.
        invalid: reason → number of simulations of changed plans that were invalid for this reason, such as
            ``iteration-limit``. Invalid simulations count as falls.
        complete: whether the search came to its end. If the search is not complete, its time was up or its trials were
            spent, and a longer search might find smaller changes.
        trials_spent: whether the trials were spent too early: before a repair with all boxes was found, although
            further changes could be tried; before the search had tested which changes are needed; or before it had
            compared repairs in worlds with errors.
        built_falls: whether boxes that stand already (``built``) fall before others are placed. If built boxes fall, no
            repair was sought.
    """

    before: Plan
    plan: Plan
    changes: tuple[Change, ...]
    trial_before: Trial
    trial_after: Trial | None
    share_before: Share | None
    share_after: Share | None
    n_trials: int
    complete: bool = True
    invalid: Mapping[str, int] = field(default_factory=dict)
    trials_spent: bool = False
    built_falls: bool = False

    @property
    def stands(self) -> bool:
        """Whether the plan stands now."""
        return self.trial_after is not None

    @property
    def cost(self) -> float:
        """The cost of the changes (docs/repair.md)."""
        return cost_of(self.changes)

    @property
    def left_out(self) -> tuple[int, ...]:
        """Boxes that are left out: their numbers in the original plan."""
        return tuple(box for change in self.changes if change.kind is Kind.LEAVE_OUT for box in change.boxes)

    @property
    def film_turns(self) -> float | None:
        """Turns of film that the repair needs; None: no film. The repaired plan itself does not contain the turns of
        film."""
        return next((change.turns for change in reversed(self.changes) if isinstance(change, Film)), None)

    def undone(self, number: int) -> Plan | None:
        """The plan with all changes but one; None if the other changes are impossible without this change.

        Raises:
            InputError: there is no change with this number.
        """
        if not 0 <= number < len(self.changes):
            raise InputError(f"number must be from 0 to {len(self.changes) - 1}, {shown_value(number)}")
        draft = applied(Draft.of(self.before), (*self.changes[:number], *self.changes[number + 1 :]))
        return None if draft is None else draft.as_plan()

    @property
    def words(self) -> list[str]:
        """The changes in plain words."""
        return [change.words for change in self.changes]

    @property
    def headline(self) -> str:
        """The result in one line: "tower: falls (drop, first box 3); stands after 1 change"."""
        trial = self.trial_before
        name = printable_name(self.before.plan_id)
        if trial.stands:
            return f"{name}: stands as it is"
        first = "" if trial.culprit is None else f", first box {trial.culprit}"
        fails = f"{name}: {trial.verdict} ({trial.reason}{first})"
        spent = "" if self.complete else f"; the search stopped because {self._limit} were used up"
        if self.built_falls:
            return f"{fails}; no repair was sought, because the boxes that are already built do not stand by themselves"
        if not self.stands:
            return f"{fails}; no repair is known ({count_text(self.n_trials, 'plan')} simulated{spent})"
        text = f"{fails}; stands after {count_text(len(self.changes), 'change')}"
        if self.complete:
            return text
        doubt = "some may not be needed" if len(self.changes) > 1 else "another change might be better"
        if self.trials_spent and self.left_out:
            doubt = "all boxes might be kept"
        return f"{text}; {doubt}, since the search stopped when {self._limit} were used up"

    @property
    def doubt(self) -> str:
        """A line about invalid simulations of changed plans; empty if no simulation was invalid."""
        if not self.invalid:
            return ""
        reasons = ", ".join(f"{number:,} {reason}" for reason, number in self.invalid.items())
        n_invalid, n_trials = sum(self.invalid.values()), count_text(self.n_trials, "simulation")
        return f"{n_invalid:,} of {n_trials} had no verdict and counted as falls: {reasons}"

    @property
    def _limit(self) -> str:
        """What ended a search that is not complete."""
        return "the trials" if self.trials_spent else "the seconds"

    def change_rows(self) -> Iterator[dict[str, Any]]:
        """The rows of ``Repairs.changes``."""
        draft = Draft.of(self.before)
        for number, change in enumerate(self.changes):
            draft = change.applied(draft) or draft
            boxes = [len(draft.size_mm) - 1] if change.kind is Kind.SHEET else change.boxes
            placed = [box for box in boxes if box in draft.order]
            x_mm, y_mm, z_mm = (tuple(column) for column in draft.corner_mm[placed].T.tolist())
            turned, position = draft.turned[placed].tolist(), draft.rank[placed].astype(int).tolist()
            values = (
                *(self.before.plan_id, number, str(change.kind), change.boxes, change.words, change.cost),
                *(x_mm, y_mm, z_mm, tuple(turned), tuple(position)),
            )
            yield dict(zip(_CHANGE_COLUMNS, values, strict=True))

    def row(self) -> dict[str, Any]:
        """The row of ``Repairs.table``."""
        row: dict[str, Any] = {
            "plan_id": self.before.plan_id,
            "boxes": self.before.n_boxes,
            "before": self.trial_before.verdict,
            "reason": self.trial_before.reason,
            "culprit": self.trial_before.culprit,
            "after": self.trial_before.verdict if self.trial_after is None else self.trial_after.verdict,
            "n_changes": len(self.changes),
            "left_out": len(self.left_out),
            "cost": self.cost,
            "changes": "; ".join(self.words),
            "margin_before": self.trial_before.margin,
            "margin_after": None if self.trial_after is None else self.trial_after.margin,
        }
        for name, share in (("before", self.share_before), ("after", self.share_after)):
            worlds, standing = (0, 0) if share is None else share
            low, high = wilson_interval(standing, worlds)
            row[f"n_worlds_{name}"], row[f"n_standing_{name}"] = worlds, standing
            row[f"share_{name}"] = None if share is None else share.value
            row[f"low_{name}"], row[f"high_{name}"] = float(low), float(high)
        return row | {"trials": self.n_trials, "invalid_trials": sum(self.invalid.values()), "complete": self.complete}


@dataclass(frozen=True, eq=False)
class Repairs:
    """The result of ``petmjx.repair``.

    Attributes:
        each: the result for each plan, in the order of the input.
        skipped: a line for each unreadable plan.
        how: the options of the simulation, for pages and pictures.
        notes: the warnings about plans and options, one line each, as a score reports them.
    """

    each: tuple[Repaired, ...]
    skipped: tuple[str, ...] = ()
    how: Mapping[str, Any] | None = None
    notes: tuple[str, ...] = ()

    @property
    def plans(self) -> list[Plan]:
        """All plans, repaired if a repair is known, for ``petmjx.score`` and ``petmjx.save_plans``."""
        return [repaired.plan for repaired in self.each]

    @property
    def table(self) -> pd.DataFrame:
        """A table with one row for each plan; docs/repair.md has the columns."""
        return pd.DataFrame([repaired.row() for repaired in self.each])

    @property
    def changes(self) -> pd.DataFrame:
        """A table with one row for each change; docs/repair.md has the columns."""
        rows = [row for repaired in self.each for row in repaired.change_rows()]
        return pd.DataFrame(rows, columns=[*_CHANGE_COLUMNS])

    @property
    def frame(self) -> str:
        """A sentence about the coordinates in the words of the changes; empty if no words have coordinates."""
        kinds = {change.kind for repaired in self.each for change in repaired.changes}
        return _FRAME if kinds & {Kind.TURN, Kind.PLACE} else ""

    @property
    def summary(self) -> str:
        """The result in one line."""
        fell = [repaired for repaired in self.each if not repaired.trial_before.stands]
        mended = [repaired for repaired in fell if repaired.stands]
        if not fell:
            return count_text(len(self.each), "plan stands as it is", "plans stand as they are")
        left = sum(bool(repaired.left_out) for repaired in mended)
        changes = sorted(len(repaired.changes) for repaired in mended)
        verb = "does" if len(fell) == 1 else "do"
        text = (
            f"{count_text(len(fell), 'plan')} of {len(self.each):,} {verb} not stand; {len(mended):,} can be repaired"
        )
        if left:
            text += f", {left:,} of them only without some boxes"
        return text + (f"; changes: {changes[len(changes) // 2]} in the median" if len(changes) > 1 else "")

    def __repr__(self) -> str:
        return f"Repairs({self.summary})"

    def _repr_html_(self) -> str:
        """The display in a notebook: a row for each plan."""
        return block_as_html([repr(self)], [table_as_html(self.table, SHOWN, "table")])

    def save(self, path: PathArgument) -> None:
        """Write the plans to a file, as ``petmjx.save_plans`` does. An existing file is replaced."""
        save_plans(self.plans, path)


class SearchWatcher(Protocol):
    """An object whose methods are called as repairs proceed, such as the progress bar of the command line."""

    def begin(self, start: RunStart) -> None:
        """Called before the first simulation."""

    def world_done(self, plan_id: str) -> None:
        """Called when the search of one more plan has ended."""


class RepairInterrupted(KeyboardInterrupt):
    """An interrupt of ``petmjx.repair``.

    Attributes:
        repairs: the results of the plans whose search had ended. The shares of worlds that stand are missing if the
            worlds with errors were not simulated yet.
    """

    def __init__(self, repairs: Repairs) -> None:
        super().__init__()
        self.repairs = repairs


def repair(
    plans: PlanSource | None = None,
    *,
    watcher: SearchWatcher | None = None,
    progress: bool = False,
    **options: Any,
) -> Repairs:
    """Find for each plan the smallest change with which the plan stands, also in a sufficient share of simulations with
    random errors.

    ``petmjx.repair("plans.json", forbid=["leave-out"], built=12).save("repaired.json")``

    Possible changes are another order, place or turn of a box, moves by some millimetres, exchanges of two boxes, and
    tie sheets. If the pallet must survive a profile, film can be added. As the last resort, boxes are left out. Without
    ``seconds``, a plan always gets the same repair on the same engine: only the errors are random numbers, and these
    are the same for the same plan id and the same file ``errors``.

    Args:
        plans: as for ``petmjx.score``.
        watcher: an object whose methods are called as the searches proceed. Without a watcher, notebooks show a
            progress bar.
        progress: in a script, print the progress on standard error every few seconds.
        options: ``forbid``, ``built``, ``most_move_mm``, ``max_height_mm``, ``most_changes``, ``trials``, ``seconds``,
            ``worlds``, ``share``, ``sheet_mm``, ``sheet_kg_m2``, ``profile``, ``level``, ``direction_deg``,
            ``most_turns`` (docs/repair.md); ``errors``, a sweep file; fields of ``petmjx.Simulation``; ``engine``,
            ``threads``, ``lanes``, ``world_timeout_s``, ``units``, ``anchor``, ``articles``, ``limit``, ``strict``.

    Raises:
        InputError: plans or options are unusable.
        EngineUnavailable: the requested engine cannot run here.
        RepairInterrupted: Ctrl-C was pressed. The exception holds the results of the plans whose search has ended.
    """
    of_simulation, of_run, sure, of_repair = sorted_options(options, Confidence, RepairOptions)
    if other := next((name for name in of_run if name not in (*OF_RUN, *OF_READING)), None):
        raise InputError(
            f"{other}: a repair has no such option; the run options that it has are {', '.join(OF_RUN + OF_READING)}"
        )
    repair_options = RepairOptions(**of_repair)
    reading = RunOptions(**{name: value for name, value in of_run.items() if name in OF_READING})
    score_options = {**of_simulation, **sure, **{name: value for name, value in of_run.items() if name in OF_RUN}}
    question = Question(score_options, repair_options)
    plan_set = usable_plans(plans_in_place(plans, reading.strict), question.sim, reading)
    plan_set = without_built_plans(plan_set, repair_options.built, reading.strict)
    driven, errors = repair_options.profile is not None, repair_options.worlds > 0
    about = notes_about(question.sim, plan_set.plans, errors=errors, driven=driven)
    shown = {name: value for name, value in score_options.items() if name in Simulation.model_fields or name in OF_RUN}
    results: list[Repaired] = []

    def repairs() -> Repairs:
        skipped = tuple(str(line) for line in plan_set.skipped)
        of_results = *_still_odd_note(results), *_weak_note(results, repair_options.share)
        return Repairs(tuple(results), skipped, shown, (*plan_set.notes, *_odd_notes(plan_set), *about, *of_results))

    waiting = {plan.plan_id for plan in plan_set.plans}  # plans whose search has not ended
    try:
        with watching(watcher, progress) as follows:

            def on_end(plan_id: str) -> None:
                if plan_id in waiting and follows is not None:
                    follows.world_done(plan_id)
                waiting.discard(plan_id)

            if follows is not None:
                size = size_of(plan_set.plans, question.sim, repair_options, question.choice.name, question.threads)
                follows.begin(RunStart("plan", len(plan_set.plans), size, question.choice, question.progress))
            for repaired in _repaired(plan_set.plans, question, repair_options, on_end):
                results.append(repaired)
                on_end(repaired.before.plan_id)
    except KeyboardInterrupt:
        raise RepairInterrupted(repairs()) from None
    finally:
        question.close()
    return repairs()


def _repaired(plans: Iterable[Plan], question: Question, options: RepairOptions, on_end: OnEnd) -> Iterator[Repaired]:
    """The repair of each plan. The searches of several plans share runs of the engine."""
    limit = TimeLimit(math.inf if options.seconds is None else options.seconds)
    waiting = iter(plans)
    while group := list(islice(waiting, GPU_AT_ONCE if question.is_wide else AT_ONCE)):
        searches = [Search(plan, question.sim, options, question.film_turns, question.is_wide) for plan in group]
        try:
            most = most_processes(question.threads, is_wide=question.is_wide)
            with closing(SearchProcesses(len(searches), most)) as processes:
                stream = TrialStream(question, limit, SEARCHED if options.worlds else 1.0)
                if question.is_wide and options.profile is None:
                    _judge(searches, question, processes, on_end)
                    _score([search for search in searches if search.judged is None or search.judged.stands], question)
                    stream.scores = {one.plan.plan_id: one.before for one in searches if one.before is not None}
                else:
                    processes.begin(searches)
                processes.run(stream, on_end)
            _score(searches, question)
            results = _with_shares(searches, question, options, limit)
        except KeyboardInterrupt:  # the engine was stopped at an unknown point, so it simulates nothing more
            yield from (_repaired_by(search, _first(search), None, None) for search in searches if search.complete)
            raise
        yield from results


def _judge(searches: Sequence[Search], question: Question, processes: SearchProcesses, on_end: OnEnd) -> None:
    """Make attempt 1 of the scores of all plans. If a plan stands, and needs no further attempt, the search for its
    repairs ends. All other searches begin in groups, while further plans are being judged."""
    unchanged = [Draft.of(search.plan, question.film_turns) for search in searches]
    requests = [TrialRequest(draft, is_judged=True, as_score=True) for draft in unchanged]
    stream = TrialStream(question)
    for number, request in enumerate(requests):
        stream.put(number, [request])
    group: list[Search] = []
    size, n_left = math.ceil(len(searches) / _GROUPS), len(searches)
    for answer in stream.answers():
        if answer is None:
            continue
        search, (trial,) = searches[answer.ticket], answer.trials
        search.judged = trial
        if question.is_known(requests[answer.ticket]._replace(judged=trial)):
            search.begin(trial)
        if search.complete:
            on_end(search.plan.plan_id)
        else:
            group.append(search)
        n_left -= 1
        if group and (len(group) == size or not n_left):
            processes.begin(group)
            group = []


_GROUPS: Final = 4
"""Number of groups in which searches begin on a GPU while plans are being judged. To propose the first changes of 200
plans takes 16 CPU threads about two seconds. Meanwhile, the GPU judges the slowest plans."""


def _score(searches: Sequence[Search], question: Question) -> None:
    """Score the plans that were not scored yet. On a GPU, plans are scored together: a separate score for each search
    would keep the other searches waiting, because no changed plan is judged during a score. Plans that stand in attempt
    1 are scored before the searches, since a plan that stands needs no search. All other plans are scored after the
    searches."""
    unknown = [search for search in searches if search.before is None]
    if not unknown:
        return
    requests = [
        TrialRequest(Draft.of(search.plan, question.film_turns), is_judged=False, judged=search.judged)
        for search in unknown
    ]
    for search, trial in zip(unknown, question.trials(requests), strict=True):
        search.begin(trial)


def _with_shares(
    searches: Sequence[Search], question: Question, options: RepairOptions, limit: TimeLimit
) -> list[Repaired]:
    """The results of searches. Unless the time is up, a result has the share of the worlds with errors in which the
    plan stands before its repair, and the share in which it stands afterwards."""
    before: list[Share | None] = [None] * len(searches)
    after = list(before)
    chosen = [_first(search) for search in searches]
    if options.worlds:
        before = question.shares([search.plan for search in searches], limit)
        after = [None if state is None else share for state, share in zip(chosen, before, strict=True)]
        changed = {row: state.draft.as_plan() for row, state in enumerate(chosen) if state and state.changes}
        for row, result in zip(changed, question.shares([*changed.values()], limit) if changed else [], strict=True):
            after[row] = result
    return [_repaired_by(*row) for row in zip(searches, chosen, before, after, strict=True)]


def _first(search: Search) -> State | None:
    """The best repair; None: no repair."""
    return search.repairs[0] if search.repairs else None


def _odd_notes(plan_set: PlanSet) -> list[str]:
    """Notes about plans in which boxes overlap, float or are outside the carrier: one for each of the first plans, and
    one for all others."""
    first, others = plan_set.warnings[:_MOST_ODD_PLANS], plan_set.warnings[_MOST_ODD_PLANS:]
    count = count_text(len(others), "more plan")
    return [*map(str, first), *([f"{count} with overlapping, floating or outside boxes"] if others else [])]


_MOST_ODD_PLANS: Final = 5
"""Largest number of plans with odd boxes that have a note of their own."""


def _still_odd_note(results: Sequence[Repaired]) -> list[str]:
    """A line about repaired plans in which boxes overlap or float, as they do in the given plans; an empty list if
    there are no such plans."""
    odd = odd_layouts([one.plan for one in results if one.stands and one.changes])
    names = [one.plan_id for one in odd if one.n_overlapping_pairs or one.n_floating]
    if not names:
        return []
    still = "still has" if len(names) == 1 else "still have"
    return [
        f"{count_text(len(names), 'repaired plan')} {still} overlapping or floating boxes, "
        f"because the {'given plan has' if len(names) == 1 else 'given plans have'} such boxes: {first_names(names)}"
    ]


def _weak_note(results: Sequence[Repaired], share: float) -> list[str]:
    """A line about repaired plans that stand in a smaller share of the worlds with errors than requested; an empty list
    if there are no such plans."""
    repaired = [one for one in results if one.stands and not one.trial_before.stands]
    weak = [one.plan.plan_id for one in repaired if one.share_after is not None and one.share_after.value < share]
    if not weak:
        return []
    verb = "stands" if len(weak) == 1 else "stand"
    plans_text = f"{count_text(len(weak), 'repaired plan')} {verb}"
    return [
        f"{plans_text} in less than {100 * share:.0f} % of the worlds with errors (option share): {first_names(weak)}"
    ]


def _repaired_by(search: Search, state: State | None, before: Share | None, after: Share | None) -> Repaired:
    """The result of a search with one of its repairs.

    Args:
        state: the repair; None: no repair.
        before, after: shares of worlds with errors in which the plan stands before and after the repair; None: not
            simulated.
    """
    before_trial = search.before or search.judged  # an interrupted run may have no score yet
    assert before_trial is not None
    return Repaired(
        before=search.plan,
        plan=search.plan if state is None else state.draft.as_plan(),
        changes=() if state is None else with_turns_told(Draft.of(search.plan), state.changes),
        trial_before=before_trial,
        trial_after=None if state is None else state.trial,
        share_before=before,
        share_after=after,
        n_trials=search.n_trials,
        invalid=dict(search.invalid),
        complete=search.complete and not search.trials_spent,
        trials_spent=search.complete and search.trials_spent,
        built_falls=search.built_falls,
    )
