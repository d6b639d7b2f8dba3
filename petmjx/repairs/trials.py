"""Trials: simulations of changed plans at rest or after a drive, with boxes placed exactly or with errors."""

from __future__ import annotations

import math
import time
import warnings
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from petmjx.common.errors import InputError, PlanWarning
from petmjx.common.machine import cpu_threads, why_no_warp, why_no_warp_on_cpu
from petmjx.common.text import count_text, printable_name
from petmjx.engines.attempt_settings import ATTEMPTS, Engines, may_go_on
from petmjx.engines.attempt_with_fallback import outcomes_of_stream
from petmjx.engines.contact_penetration import note_penetration
from petmjx.engines.engine_choice import Choice
from petmjx.engines.engine_registry import make_engine, options_of
from petmjx.engines.floating_boxes import note_floating
from petmjx.engines.job_stream import JobBounds, JobStream
from petmjx.engines.margin import margins_of
from petmjx.engines.metrics import BoxMetrics, box_metrics
from petmjx.engines.outcome_checks import outcome_checks
from petmjx.engines.protocol import Capability, Engine, Progress
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict, failures
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.options.thresholds import FAILURES, Thresholds
from petmjx.packers.pack_flow import TableEngine
from petmjx.plans.plan import Plan
from petmjx.repairs.balance import are_plain, arrays_of
from petmjx.repairs.common_placements import CommonPlacements, Placement, World
from petmjx.repairs.drafts import BoolArray, Draft
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.requests import ERROR_WORLDS, OutOfTime, Trial, TrialAnswer, TrialRequest
from petmjx.results.recording import Recording
from petmjx.results.run_reader import RunResults
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.simulate import RunStart, Watcher, simulate
from petmjx.runs.study import FinishedWorld, Nominal
from petmjx.runs.sweep_design import Design
from petmjx.runs.sweep_file import Sweep, sweep_of_tables
from petmjx.runs.sweep_study import SweepStudy
from petmjx.world.edge_distances import EdgeRisk
from petmjx.world.job import Job
from petmjx.world.profiles.profile import Strength
from petmjx.world.profiles.profile_registry import resolve
from petmjx.world.scene import Scene, build_scenes, plain_scenes
from petmjx.world.variants import apply_all

OF_RUN: Final = ("engine", "threads", "lanes", "world_timeout_s")
"""Fields of ``RunOptions`` that a repair accepts."""


LONGEST_WAIT_S: Final = 2.0
"""Longest wait for a pallet to come to rest, s, in the simulation of a draft that is only judged."""

JUDGED_ITERATIONS: Final = 15_000
"""A world in which a draft is only judged may take this number of solver iterations, plus ``ITERATIONS_PER_BOX`` for
each box (``Job.iteration_limit``). Of 160 generated plans of 15 to 50 boxes, the plans that stand take up to 1,275
steps, and the plans that fall take up to 4,400 steps. A plan of 248 boxes that stands takes 8,800 steps. Each step has
two to four iterations. A pile that rocks without end would keep its search waiting: of 12,749 drafts that a GPU judged,
one took 13.5 s of the 40 s of all searches."""

SCORED_ITERATIONS: Final = 15_000
"""As ``JUDGED_ITERATIONS``, for each attempt of a world in which a changed plan is scored. All searches wait while
scores are simulated. Of 400 generated plans, one changed plan that did not come to rest kept 145 searches waiting for
14 s on a GPU. A changed plan whose attempt 1, 6 or 7 takes more iterations counts as one that falls."""

ITERATIONS_PER_BOX: Final = 150
"""Number of iterations that a draft may take for each of its boxes, in addition to ``JUDGED_ITERATIONS`` or
``SCORED_ITERATIONS``."""

JUDGED_TILT_DEG: Final = 5.0
"""A box that tilts by more than this counts as fallen if a draft is only judged. A box that has shifted too far does
not end the simulation, because most such boxes also tilt by more than 5°. Of 133 generated plans that stand, only one
has a box that tilts by more than 3°. This box tilts by 5.4°."""

ON_A_GPU: Final = "mjx-warp"
ROWS: Final = 256
GPU_ROWS: Final = 4096
"""Number of rows of an engine's table: the number of worlds that are in the engine at the same time."""

GPU_GRANULE: Final = 32
"""Tables on a GPU have columns for a multiple of this number of boxes. Plans differ in their numbers of boxes, and the
engine's program takes seconds to compile for each size of a table, so tables should have few sizes."""

SHEETS_MORE: Final = 2
"""Number of tie sheets of a plan for which an engine's table has room. A world with more sheets needs another
table."""

MOST_LISTED: Final = 1024
"""Largest number of worlds that are given at once to an engine that takes no stream of jobs."""

SWITCH: Final = 4
"""While drafts are being judged, scores begin only if at least this many batches of requests wait for scores."""


class Share(NamedTuple):
    """Worlds with errors: the number with a verdict, and the number in which the plan stands."""

    n_worlds: int
    n_standing: int

    @property
    def value(self) -> float:
        """Share of the worlds with a verdict in which the plan stands; NaN: no world has a verdict."""
        return self.n_standing / self.n_worlds if self.n_worlds else float("nan")


SEARCHED: Final = 0.7
"""Share of the time limit (``TimeLimit.seconds``) after which the searches for repairs end, if worlds with errors must
be simulated afterwards."""


@dataclass(eq=False)
class TimeLimit:
    """The time in which repairs are searched and simulated.

    Attributes:
        seconds: the length of this time, s. It begins when this object is created.
        compiled_s: time in which engines compiled or loaded programs, s. Time for programs does not count towards
            ``seconds``.
    """

    seconds: float = math.inf
    compiled_s: float = 0.0
    _began_s: float = field(default_factory=lambda: time.monotonic())

    def check(self, share: float = 1.0) -> None:
        """Raise ``OutOfTime`` if this share of the time is over."""
        if time.monotonic() - self._began_s - self.compiled_s > share * self.seconds:
            raise OutOfTime


class Question:
    """The requirement on plans: to stand at rest, or after a drive.

    Attributes:
        sim: options of the simulation.
        threads: number of CPU threads of a run.
        choice: the engine of all trials, and the reason for its choice.
        progress: progress of the engine while it judges drafts. Its ``caller_message`` is the number of trials.
        n_trials: number of trials, including those of the plans themselves.

    Args:
        how: options by name: fields of ``petmjx.Simulation``; ``errors``, a sweep file; and the fields of
            ``petmjx.RunOptions`` that ``OF_RUN`` names.
        options: the profile, and the number of worlds with errors.

    Raises:
        InputError: options are unusable.
    """

    def __init__(self, how: Mapping[str, Any], options: RepairOptions) -> None:
        of_simulation, of_run, sure = sorted_options(how, Confidence)
        if other := next((name for name in of_run if name not in OF_RUN), None):
            raise InputError(
                f"{other}: a repair has no such option; the run options that it has are {', '.join(OF_RUN)}"
            )
        if other := next((name for name in sure if name != "errors"), None):
            raise InputError(
                f"{other}: a repair has no such option; set the option worlds (the number of worlds with errors)"
            )
        if "errors" in sure and not options.worlds:
            raise InputError("errors needs worlds > 0")
        self.sim, run = Simulation(**of_simulation), RunOptions(**of_run)
        self._of_simulation, self._errors, self._options = of_simulation, sure.get("errors"), options
        self._engine, self.choice, self._second = _engines(run)
        self.progress, self.n_trials = Progress(pauses=True), 0
        self._owns = isinstance(run.engine, str)
        self.threads = run.threads or cpu_threads()
        self._run = RunOptions(engine=self._engine)
        self._engines = Engines(self._engine, Progress())
        self._quick = [_quick(self.sim)] * 2  # index 0: without errors; index 1: with errors
        self._drive_sweep(self.sim.wrap.turns)  # an unusable profile is refused before anything is simulated
        if options.worlds:
            self._error_sweep = confidence_sweep(ERROR_WORLDS, self._errors, of_simulation)
            # variant 0 of a sweep of errors has no errors, so the worlds with errors have the numbers of the variants
            # from 1 on
            self._variants = [placement for placement, _ in Design(self._error_sweep).placements()]
            with_errors = _quick(self._error_sweep.simulation)
            self._quick[1] = self._quick[0] if with_errors == self._quick[0] else with_errors

    @property
    def is_wide(self) -> bool:
        """Whether the engine judges many plans as fast as a few."""
        return self._engine.name == ON_A_GPU

    @property
    def rows(self) -> int:
        """Number of worlds that are in the engine at the same time."""
        return GPU_ROWS if self.is_wide else ROWS

    @property
    def film_turns(self) -> float:
        """Number of turns of film around plans before they are changed."""
        return self.sim.wrap.turns

    def trials(self, requests: Sequence[TrialRequest], limit: TimeLimit | None = None) -> list[Trial]:
        """The trial of each draft.

        Raises:
            OutOfTime: the time of ``limit`` is up.
        """
        stream = TrialStream(self, limit)
        stream.put(None, requests)
        return next(answer.trials for answer in stream.answers() if answer is not None)

    def is_known(self, one: TrialRequest) -> bool:
        """Whether a draft need not be simulated, because its judged trial is its score."""
        if one.judged is None or not one.judged.is_score:
            return False
        return self._second is None or not one.judged.stands  # only a plan that stands gets a second opinion

    def scores(self, requests: Sequence[TrialRequest], watcher: Watcher | None = None) -> list[Trial]:
        """The trials of drafts that are scored, in the order of the drafts. Drafts with the same number of turns of
        film are simulated together."""
        drafts = [one.draft for one in requests]
        results = {n: one.judged for n, one in enumerate(requests) if one.judged is not None and one.judged.is_score}
        for film_turns in dict.fromkeys(draft.film_turns for draft in drafts):
            numbers = [n for n, draft in enumerate(drafts) if draft.film_turns == film_turns]
            results |= self._scored(drafts, [n for n in numbers if n not in results], self._run, watcher)
            if self._second is not None:
                results |= self._scored(drafts, [n for n in numbers if results[n].stands], self._second, watcher)
        return [results[number] for number in range(len(drafts))]

    def _scored(
        self, drafts: Sequence[Draft], numbers: Sequence[int], run: RunOptions, watcher: Watcher | None
    ) -> dict[int, Trial]:
        """Score the drafts with the given ``numbers``. Returns number of the draft → its trial. All these drafts have
        the same number of turns of stretch film."""
        if not numbers:
            return {}
        plans = [drafts[number].as_plan(str(number)) for number in numbers]
        changed = {str(number) for number in numbers if not drafts[number].is_unchanged(self.film_turns)}
        results = self._simulate(plans, drafts[numbers[0]].film_turns, run, watcher, changed)
        worlds, fallen = results.worlds.set_index("plan_id"), _fallen(results, self.sim)
        trials = {
            number: _trial(worlds.loc[str(number)], fallen.get(str(number), ()), drafts[number].order)
            for number in numbers
        }
        if self._options.profile is not None:
            return trials  # with a profile, only the user can limit iterations, so no reason needs to be examined
        # If a further attempt reaches the iteration limit, its world keeps the reason of an earlier attempt. So the
        # reasons of all attempts are examined.
        simulations = pd.concat([results.worlds[["plan_id", "reason"]], results.attempts[["plan_id", "reason"]]])
        spent = {*simulations.plan_id[simulations.reason == Reason.ITERATION_LIMIT.value]} & changed
        for number in map(int, spent):
            if self._is_own_limit(limit_of(len(drafts[number].order), SCORED_ITERATIONS)):
                trials[number] = trials[number]._replace(verdict=Verdict.UNSTABLE.value)
        return trials

    def jobs(self, requests: Sequence[TrialRequest]) -> list[Job | None]:
        """For each draft, the job of the world in which the draft is judged; None if the draft is scored. If pallets
        must survive a profile, drafts are scored, not judged. Only worlds with errors are judged even then, because
        they are not shaken.

        Most drafts fall, and falling boxes are the costliest part of a simulation. So the world of a judged draft ends
        as soon as a box has tilted by more than ``JUDGED_TILT_DEG``. This early end saves three quarters of the time of
        a world. No draft is simulated again with other settings, as a score would do (docs/rules.md, section 9).
        """
        of_draft: dict[tuple[bool, int], list[int]] = {}
        for number, one in enumerate(requests):
            if one.world or (one.is_judged and self._options.profile is None):
                of_draft.setdefault((one.world > 0, id(one.draft)), []).append(number)
        jobs: list[Job | None] = [None] * len(requests)
        for has_errors in {key[0] for key in of_draft}:
            groups = [numbers for (errors, _), numbers in of_draft.items() if errors is has_errors]
            drafts = [requests[numbers[0]].draft for numbers in groups]
            exact = scenes_of(drafts, self._error_sweep.simulation if has_errors else self.sim)
            for numbers, draft, scene in zip(groups, drafts, exact, strict=True):
                worlds = [requests[number].world for number in numbers]
                scenes = self._with_errors(draft.plan, scene, worlds) if has_errors else repeat(scene)
                for number, its_scene in zip(numbers, scenes, strict=False):
                    limit = limit_of(its_scene.n_boxes, JUDGED_ITERATIONS)
                    # engines need not test the loads of drafts, since no draft is to be simulated before others
                    jobs[number] = Job(
                        its_scene,
                        has_errors=has_errors,
                        until_lost=True,
                        iteration_limit=limit,
                        edge_risk=EdgeRisk.INSIDE,
                    )
        return jobs

    def _with_errors(self, plan: Plan, scene: Scene, worlds: Sequence[int]) -> Iterator[Scene]:
        """The scenes of a plan in worlds with errors (``worlds``: their numbers). All drafts of a plan have the same
        errors. The worlds of a score have other errors. The scenes of all worlds are made together, which takes a
        fraction of the time of making them one by one."""
        variants = [self._variants[world] for world in worlds]
        return apply_all(scene, f"{plan.plan_id}: search", variants, self._error_sweep.seed)

    def lane(self, one: TrialRequest, job: Job) -> Lane:
        """The engine and the options with which a draft is judged."""
        engine = self._engines.for_job(job, self.sim, ATTEMPTS[0], soft=job.scene.soft is not None)
        return Lane(engine, self.sim if one.as_score else self._quick[one.world > 0])

    def judged(self, outcome: Outcome, one: TrialRequest, job: Job, sim: Simulation) -> Trial:
        """The trial of a draft that was judged.

        Args:
            sim: the options with which the draft was judged.
        """
        if not one.as_score:  # below, ``outcome_checks`` notes the floating boxes of a score
            (outcome,) = note_floating([outcome], [job], sim)
        trial = _trial_of(outcome, one.draft.order, sim)
        if trial.reason == Reason.ITERATION_LIMIT.value and self._is_own_limit(job.iteration_limit):
            return trial._replace(verdict=Verdict.UNSTABLE.value)
        if one.as_score:
            (outcome,) = outcome_checks([outcome], [job], self.sim, verdicts_only=True)
            trial = _trial_of(outcome, one.draft.order, self.sim)
            return trial._replace(margin=outcome.margin, is_score=not may_go_on(outcome, self.sim))
        if one.world or not trial.stands or outcome.flags & Flag.MOVING:
            return trial
        (outcome,) = note_penetration([outcome], [job], self.sim)
        (margin,) = margins_of([outcome], self.sim.thresholds)
        is_score = outcome.verdict is Verdict.STABLE and not may_go_on(outcome, self.sim)
        return trial._replace(margin=margin, is_score=is_score)

    def _is_own_limit(self, limit: int | None) -> bool:
        """Whether the search has set the limit of iterations that a draft has reached, not the user. The trial of such
        a draft is valid: the draft counts as one that falls."""
        return limit is not None and limit < (self.sim.iteration_limit or math.inf)

    def close(self) -> None:
        """Free the engine's resources."""
        if self._owns:
            self._engine.close()

    def shares(self, plans: Sequence[Plan], limit: TimeLimit | None = None) -> list[Share | None]:
        """The share of worlds with errors in which each plan stands at rest, as ``petmjx.score`` with ``confidence``
        reports it. The result is None for a plan if the time was up before all its worlds had ended. A share of only
        the ended worlds would be too small, because worlds that fall end first."""
        sweep = confidence_sweep(self._options.worlds, self._errors, self._of_simulation)
        study = partial(SweepStudy, sweep, confidence=self._options.worlds)
        ends = _WorldEnds(limit or TimeLimit())
        with suppress(OutOfTime):
            ends.limit.check()
            _simulated(study, sweep.simulation, list(plans), self._run, ends)
        return [ends.share_of(plan, self._options.worlds) for plan in plans]

    def _simulate(
        self, plans: list[Plan], film_turns: float, run: RunOptions, watcher: Watcher | None, changed: Collection[str]
    ) -> RunResults:
        sweep = self._drive_sweep(film_turns)
        if sweep is None:
            return _simulated(partial(_Scores, changed, self.sim), self.sim, plans, run, watcher)
        return _simulated(partial(SweepStudy, sweep), sweep.simulation, plans, run, watcher)

    def _drive_sweep(self, film_turns: float) -> Sweep | None:
        """The sweep whose only drive is the profile that pallets must survive; None if pallets need only stand at
        rest."""
        options = self._options
        if options.profile is None:
            return None
        profiles = resolve(options.profile)
        if len(profiles) != 1:
            names = ", ".join(profile.name for profile in profiles)
            raise InputError(f"profile {printable_name(options.profile)} is a family of profiles: name one of {names}")
        axes: dict[str, Any] = {"profile": options.profile, "direction": options.direction_deg}
        if profiles[0].strength is not Strength.ANGLE:
            axes[str(profiles[0].strength)] = options.level
        simulation = {**self._of_simulation, "wrap": self.sim.wrap.changed(turns=film_turns)}
        return sweep_of_tables({"name": "repair", "axes": axes}, Path("repair"), True, simulation)


class _Scores(Nominal):
    """A plain score for verdicts alone: a world ends when a box is lost (``Job.until_lost``), since the collapse of a
    large pallet takes many times as long as its placement. Worlds of changed plans also end if they take too many
    iterations (``SCORED_ITERATIONS``).

    Args:
        changed: ids of the changed plans.
    """

    def __init__(self, changed: Collection[str], sim: Simulation, plans: Sequence[Plan], options: RunOptions) -> None:
        super().__init__(sim, plans, options)
        self._changed = changed

    def job(self, plan: Plan, scene: Scene, recording: Recording) -> Job:
        """See ``Nominal``."""
        limit = limit_of(scene.n_boxes, SCORED_ITERATIONS) if plan.plan_id in self._changed else None
        return replace(super().job(plan, scene, recording), until_lost=True, iteration_limit=limit)


def limit_of(n_boxes: int, iterations: int) -> int:
    """The limit of iterations of a draft. ``iterations``: ``JUDGED_ITERATIONS`` or ``SCORED_ITERATIONS``."""
    return iterations + ITERATIONS_PER_BOX * n_boxes


def _simulated(*arguments: Any) -> RunResults:
    """Call ``simulate`` without warnings about plans. The user has already seen the warnings about the given plans.
    Warnings about drafts would not help, since drafts have numbers instead of ids."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlanWarning)
        return simulate(*arguments)


@dataclass(eq=False)
class _WorldEnds:
    """A watcher of a run that ends the run when the time is up.

    Attributes:
        share: share of the time limit after which the run ends, from 0 to 1.
        verdicts: plan id → verdicts of the ended worlds with errors.
    """

    limit: TimeLimit
    share: float = 1.0
    verdicts: dict[str, list[Verdict]] = field(default_factory=dict)

    def begin(self, start: RunStart) -> None:
        """See ``Watcher``."""

    def world_done(self, world: FinishedWorld) -> None:
        """See ``Watcher``."""
        if world.variant.index:
            self.verdicts.setdefault(world.plan.plan_id, []).append(world.outcome.verdict)
        self.limit.check(self.share)

    def share_of(self, plan: Plan, n_worlds: int) -> Share | None:
        """The share of a plan's worlds that stand; None if not all of its worlds have ended."""
        verdicts = self.verdicts.get(plan.plan_id, [])
        if len(verdicts) < n_worlds:
            return None
        return Share(sum(v is not Verdict.INVALID for v in verdicts), sum(v is Verdict.STABLE for v in verdicts))


class Lane(NamedTuple):
    """Worlds that are simulated in one run of an engine.

    Attributes:
        sim: the options of the run.
    """

    engine: Engine
    sim: Simulation

    @property
    def can_pause(self) -> bool:
        """Whether placements can pause, so that worlds with the same first boxes share the simulation of these boxes.
        On a GPU, placements do not pause: a paused world waits for the end of a time slice, and a measured run with
        pauses made fewer trials per second than a run without pauses."""
        waits = self.sim.schedule is Schedule.ADAPTIVE and self.sim.check is Check.ONE_BY_ONE
        pauses = Capability.PAUSES in getattr(self.engine, "capabilities", Capability(0))
        return waits and pauses and self.engine.name != ON_A_GPU


@dataclass(eq=False)
class _Batch:
    """Requests whose trials are answered together."""

    ticket: Any
    requests: Sequence[TrialRequest]
    trials: dict[int, Trial] = field(default_factory=dict)

    @property
    def answer(self) -> TrialAnswer:
        return TrialAnswer(self.ticket, [self.trials[number] for number in range(len(self.requests))])


@dataclass(eq=False)
class _Queue:
    """Batches that wait for one kind of simulation, each with the numbers of its requests and their jobs.

    Attributes:
        lane: the run of an engine that judges the drafts of these batches; None if the drafts are scored.
        common: the common placements of the worlds of this queue; None if the engine simulates each world from its
            beginning.
    """

    lane: Lane | None
    common: CommonPlacements[tuple[_Batch, int]] | None = None
    entries: deque[tuple[_Batch, list[tuple[int, Job | None]]]] = field(default_factory=deque)


class TrialStream:
    """Simulates drafts while further ones are requested. A batch of requests is answered as soon as its own drafts are
    simulated. So a search does not wait for the trials of other searches.

    A draft is either only judged (simulated once) or scored (``TrialRequest.is_judged``). Drafts to be judged join the
    worlds that an engine is simulating. Scores have other options, so they need a run of their own. The run of scores
    begins when no draft is being judged, or when at least ``SWITCH`` batches, and at least a quarter of all batches,
    wait for scores.

    Args:
        limit: the time limit of the repairs. None: no limit.
        share: share of the time limit after which the stream ends, from 0 to 1.

    Attributes:
        scores: plan id → score of the unchanged plan. Such a plan is not scored again.
    """

    def __init__(self, question: Question, limit: TimeLimit | None = None, share: float = 1.0) -> None:
        self.scores: dict[str, Trial] = {}
        self._question, self._limit, self._share = question, limit or TimeLimit(), share
        self._queues: dict[object, _Queue] = {}
        self._complete: deque[_Batch] = deque()
        self._last: _Queue | None = None
        self._n_open = self._most_boxes = 0

    def put(self, ticket: Any, requests: Sequence[TrialRequest]) -> None:
        """Request the trials of at least one draft. The requests of one call are a batch.

        Args:
            ticket: a value that the answer returns, so that the answer can be assigned to the batch.
        """
        batch = _Batch(ticket, requests)
        self._n_open += 1
        # Tables of the engine always have room for the largest plan of any search, even while none of its drafts is
        # judged. Its search may soon request judged drafts again, and a larger table would then need programs that are
        # not compiled yet.
        self._most_boxes = max(self._most_boxes, *(one.draft.plan.n_boxes for one in requests))
        numbered: dict[object, list[tuple[int, Job | None]]] = {}
        for number, (one, job) in enumerate(zip(requests, self._question.jobs(requests), strict=True)):
            if (known := self._known(one)) is not None:
                self._take(batch, number, known)
                continue
            lane = None if job is None else self._question.lane(one, job)
            key = None if lane is None else (id(lane.engine), id(lane.sim))
            if key not in self._queues:
                can_pause = lane is not None and lane.can_pause
                self._queues[key] = _Queue(lane, CommonPlacements() if can_pause else None)
            numbered.setdefault(key, []).append((number, job))
        for kind, jobs in numbered.items():
            self._queues[kind].entries.append((batch, jobs))

    def _known(self, one: TrialRequest) -> Trial | None:
        """The score of a draft that need not be simulated; None if it must be simulated."""
        if self._question.is_known(one):
            return one.judged
        if one.is_judged or (score := self.scores.get(one.draft.plan.plan_id)) is None:
            return None
        return score if one.draft.is_unchanged(self._question.film_turns) else None

    def answers(self) -> Iterator[TrialAnswer | None]:
        """The answers, until no batch is left. An answer None means that the engine pauses, so further requests can
        be put.

        Raises:
            OutOfTime: the time is up.
        """
        while self._n_open:
            self._limit.check(self._share)
            yield from self._answered()
            waiting = [queue for queue in self._queues.values() if queue.entries]
            if waiting:
                queue = max(waiting, key=lambda queue: (queue is not self._last, len(queue.entries)))
                self._last = queue
                yield from self._scored(queue) if queue.lane is None else self._judged(queue, queue.lane)

    def _scored(self, queue: _Queue) -> Iterator[TrialAnswer]:
        """Score all drafts that wait for a score."""
        waiting = [(batch, number) for batch, jobs in queue.entries for number, _ in jobs]
        queue.entries.clear()
        ends = _WorldEnds(self._limit, self._share)
        trials = self._question.scores([batch.requests[number] for batch, number in waiting], ends)
        for (batch, number), trial in zip(waiting, trials, strict=True):
            self._take(batch, number, trial)
        yield from self._answered()

    def _judged(self, queue: _Queue, lane: Lane) -> Iterator[TrialAnswer | None]:
        """Judge the drafts of a queue, until the queue is empty or another queue needs the engine."""
        most = self._most_boxes + SHEETS_MORE
        bounds = JobBounds(self._question.rows, range(1, most + 1), drive_steps=0, excitations=None)
        stream = JobStream[Placement[tuple[_Batch, int]]](feedback=True, bounds=bounds)
        stream.close()  # drafts that are requested later enter the stream as jobs that follow from an outcome
        self._feed(stream, queue, lane)
        progress = self._question.progress
        # both numbers contain the times of earlier runs; below, only the increase of ``compile_s`` is added
        compiled_s = self._limit.compiled_s - progress.compile_s
        with closing(outcomes_of_stream(lane.engine, stream, lane.sim, progress, MOST_LISTED)) as outcomes:
            for outcome in outcomes:
                self._limit.compiled_s = compiled_s + progress.compile_s
                self._limit.check(self._share)
                if outcome is None:
                    yield None
                else:
                    placement = stream.answered(outcome.job)
                    if outcome.state is not None and queue.common is not None:
                        for following in queue.common.go_on(placement, outcome):
                            stream.put(following.job, following)
                    # the outcome is final for all worlds of the placement: there is only one world, or a box fell
                    # before the worlds begin to differ
                    else:
                        for world in placement.worlds:
                            batch, number = world.tag
                            trial = self._question.judged(outcome, batch.requests[number], world.job, lane.sim)
                            self._take(batch, number, trial)
                yield from self._answered()
                self._feed(stream, queue, lane)
                stream.followed()

    def _feed(self, stream: JobStream[Placement[tuple[_Batch, int]]], queue: _Queue, lane: Lane) -> None:
        """Give the engine the drafts that wait in a queue, unless the engine is needed for other queues."""
        n_others = sum(len(other.entries) for other in self._queues.values() if other is not queue)
        if not queue.entries or n_others >= max(SWITCH, self._n_open / 4):
            return
        entries = [(job, (batch, number)) for batch, jobs in queue.entries for number, job in jobs]
        queue.entries.clear()
        jobs = [job for job, _ in entries if job is not None]
        if queue.common is None:
            for job, tag in zip(jobs, (tag for _, tag in entries), strict=True):
                stream.put(job, Placement(job, (World(job, tag, ()),), job.scene.n_boxes))
            return
        keys = lane.engine.beginnings([job.scene for job in jobs], lane.sim)
        worlds = [World(job, tag, its) for job, (_, tag), its in zip(jobs, entries, keys, strict=True)]
        for placement in queue.common.begin(worlds):
            stream.put(placement.job, placement)

    def _take(self, batch: _Batch, number: int, trial: Trial) -> None:
        batch.trials[number] = trial
        self._question.n_trials += 1
        # not ``message``: the engine overwrites it with the message from the start of its run
        self._question.progress.caller_message = count_text(self._question.n_trials, "trial")
        if len(batch.trials) == len(batch.requests):
            self._complete.append(batch)

    def _answered(self) -> Iterator[TrialAnswer]:
        while self._complete:
            self._n_open -= 1
            yield self._complete.popleft().answer


def scenes_of(drafts: Sequence[Draft], sim: Simulation) -> list[Scene]:
    """The scenes of drafts. Plain scenes (``has_plain_scene``) are made from arrays, which takes a fraction of the time
    that other scenes take."""
    is_plain = are_plain(drafts, sim)
    plain = [draft for draft, plain in zip(drafts, is_plain, strict=True) if plain]
    of_plain = plain_scenes(*arrays_of(plain), sim) if plain else iter(())
    others = build_scenes((draft.as_plan() for draft, plain in zip(drafts, is_plain, strict=True) if not plain), sim)
    return [next(of_plain if plain else others) for plain in is_plain]


def _quick(sim: Simulation) -> Simulation:
    """The options for drafts that are only judged."""
    return sim.changed(
        longest_wait_s=min(sim.longest_wait_s, LONGEST_WAIT_S),
        thresholds=sim.thresholds.changed(tilt_deg=min(sim.thresholds.tilt_deg, JUDGED_TILT_DEG)),
    )


def _engines(run: RunOptions) -> tuple[Engine, Choice, RunOptions | None]:
    """The engine of all trials, the reason for its choice, and the options of the second opinion on standing plans
    (None: no second opinion).

    ``auto`` takes the kernels of Warp, on a GPU or on CPU threads, since hundreds of plans are simulated. A score of a
    single plan uses C MuJoCo. So a repaired plan must also stand on C MuJoCo: this is the second opinion.
    """
    if not isinstance(run.engine, str):
        return run.engine, Choice(run.engine.name, "given"), None
    name, reason = run.engine, "as asked for"
    if name == AUTO:
        name = ON_A_GPU if why_no_warp() is None else "mjx-warp-cpu" if why_no_warp_on_cpu() is None else "mujoco"
        reason = "the fastest for many changed plans"
    second = RunOptions(engine="mujoco", threads=run.threads) if run.engine == AUTO and name != "mujoco" else None
    engine = make_engine(name, **options_of(name, run))
    if isinstance(engine, TableEngine):
        engine.least_rows = GPU_ROWS if engine.name == ON_A_GPU else ROWS
    if engine.name == ON_A_GPU and isinstance(engine, TableEngine):
        engine.granule = GPU_GRANULE
    return engine, Choice(name, reason), second


def _over_limits(boxes: BoxMetrics, limits: Thresholds) -> BoolArray:
    """(n,) whether boxes have crossed a limit."""
    over: BoolArray = np.logical_or.reduce([failed for _, failed in failures(boxes, limits)])
    return over


def _trial_of(outcome: Outcome, order: tuple[int, ...], sim: Simulation) -> Trial:
    """A trial from the outcome of a single simulation."""
    k = outcome.n_placed
    over = _over_limits(outcome.boxes, sim.thresholds)
    return Trial(
        outcome.verdict.value,
        outcome.reason.value,
        order[outcome.culprit] if outcome.culprit >= 0 else None,
        tuple(order[row] for row in np.flatnonzero(over[:k])),
        k,
        outcome.n_at_sign or k,
        float("nan"),
    )


def _trial(world: Any, fallen: Sequence[int], order: tuple[int, ...]) -> Trial:
    """A trial from a row of ``worlds``. The rows of boxes in the draft are converted to the numbers of the boxes in the
    plan."""
    culprit = world["culprit"]
    has_culprit = not pd.isna(culprit)
    return Trial(
        str(world["verdict"]),
        str(world["reason"] or ""),
        order[int(culprit)] if has_culprit else None,
        tuple(order[row] for row in fallen),
        int(world["n_placed"]),
        int(world["n_placed"]),
        float(world["margin"]),
    )


def _fallen(run: RunResults, sim: Simulation) -> dict[str, list[int]]:
    """Plan id → rows of the boxes that have failed in one of the ways ``FAILURES``."""
    boxes = run.boxes
    judged = {failure.metric for failure in FAILURES}
    values = {metric.attribute: metric.of_table(boxes) for metric in box_metrics() if metric.attribute in judged}
    over = _over_limits(BoxMetrics.measured(len(boxes), **values), sim.thresholds)
    rows = boxes.loc[over, ["plan_id", "box"]]
    return {str(plan_id): numbers.tolist() for plan_id, numbers in rows.groupby("plan_id", observed=True)["box"]}
