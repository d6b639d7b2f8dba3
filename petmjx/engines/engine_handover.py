"""Engine handover: C MuJoCo, which hands worlds over to the kernels if they take long.

``auto`` takes this engine for little work without a GPU. It chooses by an estimate from the numbers of boxes. Plans
that collapse take many times as long on C MuJoCo, and less so in kernels. So the CPU time of finished worlds is
compared with their expected time. If the kernels would finish the remaining worlds sooner, compilation included, they
take them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Final, Generic, TypeVar

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.text import count_text, one_line, three_digits
from petmjx.common.units import FloatArray
from petmjx.engines.attempts import ready_for
from petmjx.engines.cost_model import Costs
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.open_worlds import MOST_BOXES, OpenWorlds
from petmjx.engines.protocol import Engine, GrowingJobs, Progress, says_at_hand
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job
from petmjx.world.scene import Scene

LEAST_WORLDS: Final = 20
"""Number of finished worlds before their time is compared with the expected one: single worlds vary tenfold."""

SLOWER: Final = 2.0
"""Estimates hold within this factor. Worlds that take no longer are no reason for a handover."""

GAIN: Final = 1.5
"""The kernels must be faster by this factor with the remaining worlds: their estimated time is no more exact."""

Faster = TypeVar("Faster", bound=Engine)


class HandoverEngine(Engine, Generic[Faster]):
    """C MuJoCo until its worlds take longer than expected; then the kernels, for all that has not begun.

    Only first attempts change engines: C MuJoCo makes further ones, which want double precision. Each outcome says
    which engine made it.

    Args:
        mujoco: the engine of the run.
        make_faster: makes the engine that takes over. If it raises ``EngineUnavailable`` or ``InputError``, the run
            stays with ``mujoco``.
        costs: costs of both engines; ``costs.kernel_start_s`` is the time until the other engine begins.
    """

    name = MujocoEngine.name
    takes_more = True
    names_engines = True

    def __init__(self, mujoco: MujocoEngine, make_faster: Callable[[], Faster], costs: Costs) -> None:
        self._mujoco, self._make_faster, self._costs = mujoco, make_faster, costs
        self._faster: Faster | None = None
        self._stays = False
        """Whether the other engine turned out to be unavailable."""
        self._sim: Simulation | None = None
        self._worlds, self._spent_s, self._expected_s = 0, 0.0, 0.0

    @property
    def device(self) -> str:
        return self._mujoco.device

    @property
    def threads(self) -> int:
        """Number of worlds that are simulated at once."""
        return self._mujoco.threads

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> OpenWorlds:
        """As in the protocol, on C MuJoCo."""
        return self._mujoco.open(scenes, sim, most_boxes)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """As in the protocol, on C MuJoCo."""
        return self._mujoco.paths(bodies, sim)

    def retire(self) -> None:
        if self._faster is not None:
            self._faster.retire()

    def close(self) -> None:
        if self._faster is not None:
            self._faster.close()

    @says_at_hand
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """As in the protocol. Jobs begin with the states that they start from (``KeptState``), of either engine."""
        progress = progress if progress is not None else Progress()
        self._sim = self._sim or sim
        run = _Shared(self, jobs, sim, progress, first_attempt=sim == self._sim and sim.solver is Solver.NEWTON)
        while run.take():
            yield from run.on_mujoco() if run.next_is_mujoco else run.on_faster()

    def _slower(self) -> float:
        """Time of finished worlds relative to the expected time."""
        return self._spent_s / self._expected_s if self._expected_s > 0 else 1.0

    def _hands_over(self, jobs: Sequence[Job], sim: Simulation, progress: Progress) -> bool:
        """Whether the other engine takes the jobs that have not begun. If so, it has been made.

        Args:
            jobs: the jobs that have not begun.
        """
        slower = self._slower()
        if self._stays or self._worlds < LEAST_WORLDS or slower < SLOWER or not jobs:
            return False
        threads, costs = self.threads, self._costs
        mujoco_s = slower * float(costs.of_jobs(jobs, sim).sum()) / threads
        if mujoco_s < GAIN * costs.kernel_start_s:
            return False
        placed_again = [ready_for("", job) for job in jobs]
        faster_s = costs.kernel_start_s + slower * float(costs.of_jobs(placed_again, sim, costs.kernel).sum()) / threads
        if mujoco_s < GAIN * faster_s:
            return False
        try:
            self._faster = self._make_faster()
        except (EngineUnavailable, InputError):
            self._stays = True
            return False
        progress.notes[
            f"auto: {count_text(self._worlds, 'world')} took {three_digits(slower)} times as long as expected on "
            f"{self.name}; {count_text(len(jobs), 'world')} that had not begun went to {self._faster.name}"
        ] = None
        return True


class _Shared(Generic[Faster]):
    """The jobs of one run, shared out over both engines."""

    def __init__(
        self,
        engine: HandoverEngine[Faster],
        jobs: Sequence[Job],
        sim: Simulation,
        progress: Progress,
        *,
        first_attempt: bool,
    ) -> None:
        self._engine, self._jobs, self._sim, self._progress = engine, jobs, sim, progress
        self._first_attempt = first_attempt
        self._taken = 0
        self._mujoco, self._faster = deque[int](), deque[int]()

    def take(self) -> bool:
        """Take jobs that have been added; returns whether any job is left."""
        for number in range(self._taken, len(self._jobs)):
            (self._mujoco if self._is_for_mujoco(number) else self._faster).append(number)
        self._taken = len(self._jobs)
        return self.next_is_mujoco or bool(self._faster)

    @property
    def next_is_mujoco(self) -> bool:
        """Whether C MuJoCo has jobs."""
        return bool(self._mujoco)

    def _is_for_mujoco(self, number: int) -> bool:
        soft = self._jobs[number].scene.soft is not None
        return self._engine._faster is None or self._engine._stays or soft or not self._first_attempt

    def on_mujoco(self) -> Iterator[Outcome]:
        """Run jobs on C MuJoCo. It is given only as many as it begins, so that the remaining ones can be taken back."""
        mujoco, numbers = self._engine._mujoco, list[int]()
        jobs = GrowingJobs()
        answered = 0

        def feed() -> None:
            while self._mujoco and len(jobs) - answered < 2 * mujoco.threads:
                numbers.append(self._mujoco.popleft())
                jobs.append(ready_for(mujoco.name, self._jobs[numbers[-1]]))

        feed()
        spent_s = self._progress.thread_s
        with closing(mujoco.run(jobs, self._sim, self._progress)) as outcomes:  # type: ignore[type-var]  # a generator
            for outcome in outcomes:
                if outcome is not None:
                    answered += 1
                    outcome.job, outcome.engine = numbers[outcome.job], mujoco.name
                    self._count(outcome.job, self._progress.thread_s - spent_s)
                    spent_s = self._progress.thread_s
                yield outcome
                self.take()
                if outcome is not None and self._first_attempt and self._mujoco:
                    self._reconsider()
                feed()

    def _count(self, number: int, seconds: float) -> None:
        """Count the time of a finished world. A world that should start from a state but was placed anew is not
        counted."""
        engine = self._engine
        if self._first_attempt:
            engine._worlds += 1
            engine._spent_s += seconds
            engine._expected_s += float(engine._costs.of_jobs([self._jobs[number]], self._sim)[0])

    def _reconsider(self) -> None:
        if self._engine._faster is None and self._engine._hands_over(
            [self._jobs[number] for number in self._mujoco], self._sim, self._progress
        ):
            others = [number for number in self._mujoco if not self._is_for_mujoco(number)]
            self._faster += others
            left = [number for number in self._mujoco if self._is_for_mujoco(number)]
            self._mujoco.clear()
            self._mujoco += left

    def on_faster(self) -> Iterator[Outcome]:
        """Run jobs on the other engine. After an error of it C MuJoCo takes the unanswered ones."""
        faster, progress = self._engine._faster, self._progress
        assert faster is not None
        numbers, jobs = list[int](), GrowingJobs()

        def feed() -> None:
            while self._faster:
                numbers.append(self._faster.popleft())
                jobs.append(ready_for(faster.name, self._jobs[numbers[-1]]))

        feed()
        unanswered = dict.fromkeys(numbers)
        try:
            with closing(faster.run(jobs, self._sim, progress)) as outcomes:  # type: ignore[type-var]  # a generator
                for outcome in outcomes:
                    if outcome is not None:
                        outcome.job, outcome.engine = numbers[outcome.job], faster.name
                        del unanswered[outcome.job]
                    yield outcome
                    self.take()
                    if faster.takes_more:
                        unanswered |= dict.fromkeys(self._faster)
                        feed()
        except Exception as error:
            self._engine._stays = True
            left = count_text(len(unanswered), "world")
            progress.notes[f"{faster.name} failed ({one_line(error)}); {left}: went to {self._engine.name}"] = None
            self._mujoco += [*unanswered, *(number for number in self._faster if number not in unanswered)]
            self._faster.clear()
