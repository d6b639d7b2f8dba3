"""Simulates worlds with an engine, repeats invalid worlds with other settings, and yields each final outcome.

Each simulation of a world is an *attempt*. petmjx/engines/attempt_settings.py lists the settings of all attempts.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Any, Final, Generic

from petmjx.common.deferred_signals import defer_signals
from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.engines.attempt_settings import ATTEMPT_ENGINES, ATTEMPTS, AttemptRecipe, Engines, may_go_on, ready_for
from petmjx.engines.attempt_with_fallback import AttemptResult, AttemptRunner, Pending
from petmjx.engines.contact_penetration import may_penetrate
from petmjx.engines.job_stream import JobBounds, JobStream
from petmjx.engines.protocol import GPU_WORLDS, Capability, Engine, Progress
from petmjx.engines.subprocess.attempt_process import JOBS_WORTH_A_PROCESS, READY, AttemptAnswer, AttemptTask
from petmjx.engines.subprocess.check_pool import LARGE, CheckPool
from petmjx.engines.verdict import Reason, Verdict
from petmjx.engines.world_prefetch import PENDING_BOXES, PENDING_BOXES_GPU, WorldPrefetch
from petmjx.engines.world_results import AnyWorld, WorldResult
from petmjx.options.physics import Cone
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.job import Job

MOST_PENDING: Final = 13 * GPU_WORLDS // 8
"""Largest number of worlds in a list, for an engine that cannot read a stream of jobs. The thread that makes worlds
also pauses while this number of worlds waits for a further attempt on the run's engine, or for the fallback
engine."""

ATTEMPT_WAIT_S: Final = 0.02
"""Time between two checks whether new worlds follow from results, s. These checks are made while the engine is idle,
and other processes or threads make further attempts."""

FIRST_WORLDS: Final = 1600
"""Number of worlds with which a GPU begins. 1,600 worlds are enough to keep all thread blocks for worlds of few boxes
busy (``small_world_blocks``). Further worlds start on the GPU later."""


def check_pool_for(engine: Engine, worlds: int) -> CheckPool[Any] | None:
    """A pool of processes that check the outcomes of ``worlds`` worlds while an engine simulates; None if the engine
    needs no check pool, or if there are too few worlds.
    """
    return CheckPool.here() if _is_gpu(engine) and worlds >= LARGE else None


def _is_gpu(engine: Engine) -> bool:
    """Whether an engine simulates on a GPU in this process. Workers with GPUs do not count, since they check outcomes
    themselves."""
    return engine.name in ATTEMPT_ENGINES and Capability.CHECKS not in engine.capabilities


def score_worlds(
    worlds: Iterable[AnyWorld],
    sim: Simulation,
    engine: Engine,
    *,
    progress: Progress | None = None,
    most_pending: int = MOST_PENDING,
    attempts: Sequence[AttemptRecipe] = ATTEMPTS,
    following: Callable[[], Iterable[AnyWorld]] | None = None,
    bounds: JobBounds | None = None,
    check_pool: CheckPool[Any] | None = None,
    verdicts_only: bool = False,
) -> Iterator[WorldResult[AnyWorld]]:
    """Simulate worlds and yield the final result of each world, in any order.

    A thread makes the worlds and puts their jobs into a ``JobStream``, from which the engine takes the jobs. The thread
    waits while the jobs in the stream have ``PENDING_BOXES`` boxes (``PENDING_BOXES_GPU`` for a GPU). Invalid worlds
    are collected, and simulated again together at the end, or earlier if ``most_pending`` of them wait. So the memory
    of a run does not grow with its number of worlds. Two kinds of further attempts begin at once: attempts that CPU
    threads make beside a GPU (petmjx/engines/attempt_settings.py), and, in runs with ``following``, attempts in stiffer
    contacts. Attempts in stiffer contacts run together with first attempts, if the engine can mix the two kinds
    (``Capability.STIFF_JOBS``).

    ``following`` returns the worlds that follow from the results so far, such as the drives (motions of the carrier) of
    a settled pallet. ``following`` is called after each outcome, and returns each world exactly once. An engine that
    reads a stream simulates the returned worlds together with the other worlds; any other engine simulates the returned
    worlds last.

    ``bounds``: limits that hold for all jobs, including the jobs that follow from results.

    ``check_pool``: a pool of processes that several calls use one after another. If ``check_pool`` is None, a call with
    many worlds starts a check pool of its own.

    ``verdicts_only``: whether the caller needs only verdicts. The outcomes of first attempts then lack the distances
    and flags that ``outcome_checks`` leaves out.

    If an engine raises an error and has a fallback engine, the run continues: the fallback engine simulates the worlds
    without an outcome. The run also continues after an error at a second or later attempt. Without a fallback engine,
    the worlds of this attempt become invalid, with the reason ``failed``.

    Raises:
        RuntimeError: the engine did not return exactly one outcome for each job.
        InputError: the options require soft boxes, but the engine does not support them.
        PetmjxError: the engine refuses the worlds at the first attempt.
        Exception: at the first attempt, an engine without a fallback raised an error, or ``worlds`` raised one.
    """
    progress = progress or Progress()
    engines = Engines(engine, progress)
    if sim.has_soft and not engines.has_fallback and Capability.SOFT not in engine.capabilities:
        raise InputError(f"soft boxes need the engine mujoco, got {engine.name}")
    # Attempts with stiffer contacts run together with first attempts only if states of placements are kept. In other
    # runs, CPU threads make most of these attempts. States can be kept only if all attempts have the run's timestep,
    # because a state counts time in steps.
    keeps = following is not None and all(recipe.timestep_divisor == 1 for recipe in attempts)
    joins = keeps and engine.streams and Capability.STIFF_JOBS in engine.capabilities
    joins = joins and sim.physics.cone is Cone.ELLIPTIC
    stream = JobStream[Pending[AnyWorld]](
        most_boxes=PENDING_BOXES_GPU if _is_gpu(engine) else PENDING_BOXES * engine.devices,
        feedback=following is not None,
        begin_with=FIRST_WORLDS,
        bounds=bounds,
        stiff=[recipe.stiff for recipe in attempts if recipe.joins and recipe.stiff is not None] if joins else (),
    )
    most_pending *= engine.devices
    first_sim = attempts[0].apply_to_sim(sim)
    first_runner = AttemptRunner[AnyWorld](
        attempts[0], first_sim, engines, most=most_pending, verdicts_only=verdicts_only
    )
    attempt_tasks = _AttemptTasks[AnyWorld](sim, engines, check_pool, needs_pool=not verdicts_only)
    run = _AttemptRun[AnyWorld](sim, engines, attempts, following, most_pending, stream, first_runner, attempt_tasks)
    yield from run.results(worlds)


@dataclass(eq=False)
class _AttemptRun(Generic[AnyWorld]):
    """All attempts at the worlds of one call of ``score_worlds``.

    At any time, each unfinished world is in one of four collections. Before its first attempt, a world is in
    ``stream``. If the engine of the run cannot simulate the world, the world is in ``for_fallback`` instead. Before
    each further attempt, a world is in ``retry_queue`` or in ``attempt_tasks``, or again in ``stream``.

    Attributes:
        first_runner: makes the first attempts, and further attempts that join them (``_join``).
        retry_queue: worlds that wait for a further attempt on the engine of the run, each with its next attempt.
    """

    sim: Simulation
    engines: Engines
    attempts: Sequence[AttemptRecipe]
    following: Callable[[], Iterable[AnyWorld]] | None
    most_pending: int
    stream: JobStream[Pending[AnyWorld]]
    first_runner: AttemptRunner[AnyWorld]
    attempt_tasks: _AttemptTasks[AnyWorld]
    retry_queue: list[tuple[AttemptRecipe, Pending[AnyWorld]]] = field(default_factory=list)
    for_fallback: deque[Pending[AnyWorld]] = field(default_factory=deque)
    """Worlds that wait for the fallback engine. The thread that makes worlds fills this queue."""

    def results(self, worlds: Iterable[AnyWorld]) -> Iterator[WorldResult[AnyWorld]]:
        """Simulate worlds in all attempts that they need; yield each result when it is final."""
        source = WorldPrefetch(worlds, partial(self._put_world, bounded=True), self.stream, self._has_room)
        if self.following is not None:
            self.first_runner.put_following = self._put_following
        try:
            source.start()
            yield from self._rounds(source)
        except GeneratorExit:
            raise
        except BaseException as error:  # even after Ctrl-C, no outcome that has arrived is lost
            yield from self._arrived_results(error)
            raise
        finally:
            with defer_signals(afterwards=True), ExitStack() as closing:  # a second Ctrl-C skips none of these steps
                closing.callback(source.close)
                closing.callback(self.attempt_tasks.close)

    def _rounds(self, source: WorldPrefetch[AnyWorld]) -> Iterator[WorldResult[AnyWorld]]:
        """Make first attempts while there are jobs, then further attempts, until no world is left; yield final
        results."""
        primary = self.engines.primary
        while True:
            self._put_following()
            closed = self.stream.closed  # read now, since the stream may be closed while outcomes are checked
            n_ready = self.stream.wait_for(LARGE if primary.name in ATTEMPT_ENGINES else 1)
            if n_ready or self.for_fallback:
                self.attempt_tasks.prepare(self.stream.peek(LARGE), self.attempts[1:])
                self.first_runner.check_pool = self.attempt_tasks.check_pool
                self.attempt_tasks.first = self.first_runner
                yield from self._results_of(self._first_attempts())
            elif not self.retry_queue and self.attempt_tasks.unanswered:
                n_unanswered = self.attempt_tasks.unanswered
                self.engines.progress.message = f"simulating {count_text(n_unanswered, 'world')} again on CPU threads"
                # The loop does not wait for the attempts on CPU threads if further worlds may follow before these
                # attempts end, for example the packings of the next order.
                yield from self._task_results(wait=self.following is None)
                if self.following is not None:
                    time.sleep(ATTEMPT_WAIT_S)
            elif not self.retry_queue and closed:
                source.raise_error()
                return
            if len(self.retry_queue) >= self.most_pending or not n_ready:
                yield from self._retried_results()  # further worlds may follow from these results, so the loop goes on

    def _has_room(self) -> bool:
        return len(self.retry_queue) + len(self.for_fallback) < self.most_pending

    def _put_world(self, world: AnyWorld, *, bounded: bool) -> bool:
        """Put the job of a new world into the stream, or into ``for_fallback`` if the fallback engine must simulate the
        world. Returns False if the stream is closed. ``bounded``: whether the call waits while the stream is full."""
        pending: Pending[AnyWorld] = (world, None, ())
        primary = self.engines.primary
        if self.first_runner.engine_for(world) is not primary:
            self.for_fallback.append(pending)
            return True
        (job,) = self.first_runner.jobs_of([world], primary)
        return self.stream.put(job, pending, bounded=bounded)

    def _put_following(self) -> None:
        """Put the jobs of the worlds that follow from the results so far into the stream."""
        for world in self.following() if self.following is not None else ():
            self._put_world(world, bounded=False)

    def _first_attempts(self) -> Iterator[AttemptResult[AnyWorld] | None]:
        """Make the first attempts. The run's engine simulates the worlds of the stream, and the fallback engine
        simulates the worlds of ``for_fallback``."""
        lost = yield from self.first_runner.run_stream(self.engines.primary, self.stream)
        unanswered = list[Pending[AnyWorld]]()
        for pending in lost:
            runner = self.first_runner.joined.pop(pending[0], None)
            if runner is None:
                unanswered.append(pending)
            else:
                self.retry_queue.append((runner.attempt, pending))
        while self.for_fallback:
            unanswered.append(self.for_fallback.popleft())
        yield from self.first_runner.run_fallback(unanswered)

    def _retried_results(self) -> Iterator[WorldResult[AnyWorld]]:
        """Make all further attempts that wait in ``retry_queue``, in the order of ``attempts``."""
        for attempt in self.attempts[1:]:
            batch = [pending for recipe, pending in self.retry_queue if recipe is attempt]
            self.retry_queue[:] = [entry for entry in self.retry_queue if entry[0] is not attempt]
            if batch:
                worlds_text = count_text(len(batch), "world")
                self.engines.progress.message = f"simulating {worlds_text} again (attempt {attempt.number})"
                yield from self._results_of(self.attempt_tasks.runner_of(attempt).run(batch))

    def _results_of(self, attempt_results: Iterator[AttemptResult[AnyWorld] | None]) -> Iterator[WorldResult[AnyWorld]]:
        """Yield the final results among ``attempt_results``. Also yield the final results of tasks (attempts
        and checks in other processes) that have ended in the meantime."""
        for pending in attempt_results:
            if pending is not None:  # None is not an outcome: the engine pauses
                yield from self._finish_or_retry(pending)
            yield from self._task_results()

    def _task_results(self, *, wait: bool = False) -> Iterator[WorldResult[AnyWorld]]:
        for pending in self.attempt_tasks.ended(wait=wait):
            yield from self._finish_or_retry(pending)

    def _arrived_results(self, error: BaseException) -> Iterator[WorldResult[AnyWorld]]:
        """After an error: the final results among the outcomes that have already arrived."""
        if self.attempt_tasks.check_pool is not None and not isinstance(error, Exception):
            self.attempt_tasks.check_pool.hurry()
        yield from self._task_results()
        if self.attempt_tasks.first is not None:
            for pending in self.attempt_tasks.first.checked_results([], self.engines.primary.name):
                yield from self._finish_or_retry(pending)

    def _finish_or_retry(self, pending: AttemptResult[AnyWorld]) -> Iterator[WorldResult[AnyWorld]]:
        """Process the outcome of an attempt at a world. If the world needs no further attempt, yield the world's
        result. Otherwise, the next attempt begins in another process or thread, or in the stream, or the world waits in
        ``retry_queue``.

        Args:
            pending: the world, with the outcome of the attempt.
        """
        world, outcome, records = pending
        next_attempt = None
        if may_go_on(outcome, self.sim) and records[-1].reason is not Reason.ITERATION_LIMIT:
            later = (recipe for recipe in self.attempts if recipe.number > records[-1].attempt)
            next_attempt = next((recipe for recipe in later if recipe.is_for(outcome, self.sim)), None)
        if next_attempt is None:
            yield WorldResult(world, outcome, records)
        elif not (self.attempt_tasks.begin(next_attempt, pending) or self._join(next_attempt, pending)):
            self.retry_queue.append((next_attempt, pending))

    def _join(self, attempt: AttemptRecipe, pending: Pending[AnyWorld]) -> bool:
        """Put an attempt with stiffer contacts into the stream, where it runs together with first attempts. Returns
        False if the attempt must wait in ``retry_queue``. The attempt must wait if the engine cannot mix attempts, if
        the world is recorded, or if thousands of worlds with errors may need the attempt. Thousands of such attempts
        are faster if they do not run together with first attempts."""
        world, before, _ = pending
        if attempt.stiff not in self.stream.stiff or world.job.record is not None:
            return False
        if world.job.has_errors and not self.attempt_tasks.are_few(attempt, pending):
            return False
        runner = self.attempt_tasks.runner_of(attempt)
        if runner.engine_for(world) is not self.engines.primary:
            return False
        (job,) = runner.jobs_of([world], self.engines.primary)
        self.first_runner.joined[world] = runner
        return self.stream.put(replace(attempt.after(before, job), stiff=attempt.stiff), pending)


@dataclass(eq=False)
class _AttemptTasks(Generic[AnyWorld]):
    """Tasks of a run in other processes or threads: further attempts at single worlds, and checks of outcomes."""

    sim: Simulation
    engines: Engines
    lent: CheckPool[Pending[AnyWorld]] | None = None
    """The check pool that the caller provides and keeps for later runs, if any."""
    needs_pool: bool = True
    """Whether checks of many outcomes take so long that processes for them are worth starting."""
    check_pool: CheckPool[Pending[AnyWorld]] | None = None
    first: AttemptRunner[AnyWorld] | None = None
    """The runner of the first attempts, whose outcomes the check pool checks."""
    _task_numbers: Iterator[int] = field(default_factory=count)
    _in_flight: dict[int, tuple[AttemptRunner[AnyWorld], Pending[AnyWorld], str]] = field(default_factory=dict)
    """Number of a task → the runner of its attempt, the world, and the name of the engine."""

    @property
    def unanswered(self) -> int:
        """Number of worlds whose tasks have not ended."""
        return len(self._in_flight)

    def prepare(self, jobs: Sequence[Job], retries: Sequence[AttemptRecipe]) -> None:
        """At the beginning of a run, start the processes that are worth their cost. A large run gets processes that
        check outcomes. A run of at least ``JOBS_WORTH_A_PROCESS`` jobs gets the process that makes further attempts, if
        few worlds need such attempts. The first task of the process for further attempts is to simulate one box. So
        this process compiles its kernel before worlds need it. Compiling takes as long as simulating many worlds."""
        if self.needs_pool:
            self.check_pool = self.check_pool or self.lent or check_pool_for(self.engines.primary, len(jobs))
        name = ATTEMPT_ENGINES.get(self.engines.primary.name)
        if name is None or len(jobs) < JOBS_WORTH_A_PROCESS:
            return
        if self.sim.physics.cone is not Cone.ELLIPTIC or self.sim.has_soft:
            return
        scene = next((job.scene for job in jobs if not job.settles), None)
        for attempt in retries if self.sim.solver is not Solver.CG else ():
            if attempt.few and scene is not None:
                job, sim = Job(scene.first(1)), attempt.apply_to_sim(self.sim)
                self.engines.attempt_simulator.begin(AttemptTask(READY, name, job, sim))

    def begin(self, attempt: AttemptRecipe, pending: Pending[AnyWorld]) -> bool:
        """Begin an attempt at a world as a task. Returns False if the engine of the run must make the attempt."""
        runner, (world, _, _) = self.runner_of(attempt), pending
        soft, few = runner.is_soft(world), self.are_few(attempt, pending)
        name = self.engines.attempt_engine(world.job, runner.sim, attempt, soft=soft, few=few)
        if name is not None:
            self._ask(runner, pending, name)
        return name is not None

    def runner_of(self, attempt: AttemptRecipe) -> AttemptRunner[AnyWorld]:
        """A runner of an attempt."""
        return AttemptRunner[AnyWorld](attempt, attempt.apply_to_sim(self.sim), self.engines)

    def are_few(self, attempt: AttemptRecipe, pending: Pending[AnyWorld]) -> bool:
        """Whether only few of the run's worlds need this attempt, so that CPU threads can make it."""
        world, before, _ = pending
        # if boxes of a plan may sink into each other, many of the plan's worlds with placement errors need the attempt
        sank = world.variant != 0 and before is not None and before.verdict is Verdict.INVALID
        return attempt.few and not (sank and may_penetrate(world.job.scene, self.sim))

    def _ask(self, runner: AttemptRunner[AnyWorld], pending: Pending[AnyWorld], engine: str) -> None:
        world, before, _ = pending
        (job,) = runner.attempt.apply_to_jobs([ready_for(engine, world.job)])
        task_number = next(self._task_numbers)
        self._in_flight[task_number] = runner, pending, engine
        self.engines.attempt_simulator.begin(
            AttemptTask(task_number, engine, runner.attempt.after(before, job), runner.sim)
        )

    def ended(self, *, wait: bool) -> Iterator[AttemptResult[AnyWorld]]:
        """The worlds of the attempts that have ended, with their outcomes.

        Args:
            wait: if True and an attempt is running, wait until at least one attempt has ended.
        """
        if self._in_flight:
            for answer in self.engines.attempt_simulator.ended(wait=wait):
                if answer.number not in self._in_flight:  # the task READY only prepares a process, without a world
                    continue
                runner, pending, engine = self._in_flight.pop(answer.number)
                for answered in self._answered(runner, pending, engine, answer):
                    if answered is not None:
                        yield answered

    def _answered(
        self, runner: AttemptRunner[AnyWorld], pending: Pending[AnyWorld], engine: str, answer: AttemptAnswer
    ) -> Iterator[AttemptResult[AnyWorld] | None]:
        """The world of a task (an attempt in another process or thread), with the outcome of the task. If the task
        returned no outcome, a new task simulates the world on the fallback engine. If this task returns no outcome
        either, the fallback engine simulates the world in the run's own process."""
        fallback = self.engines.fallback
        if answer.outcome is not None:
            self.engines.progress.world_steps += answer.outcome.n_steps
            yield from runner.checked_results([(pending, answer.outcome)], engine)
        elif fallback is not None and engine != fallback.name:
            self.engines.note_failure(engine, runner.attempt.number, 1, answer.message)
            self._ask(runner, pending, fallback.name)
        else:
            yield from runner.run_fallback([pending])

    def close(self) -> None:
        """End all tasks and their processes."""
        if self.check_pool is not None and self.check_pool is not self.lent:
            self.check_pool.close()
        if "attempt_simulator" in vars(self.engines):
            self.engines.attempt_simulator.close()
