"""Tests of worlds that leave a GPU and are continued on CPU threads (petmjx/engines/warp/long_worlds.py). In these
tests, CPU kernels also replace the GPU. A world that leaves must therefore have the same outcome, to the last bit, as a
world that does not leave."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.outcomes import make_outcome
from support.plans import make_scene

from petmjx.engines.contact_penetration import stiffened
from petmjx.engines.job_stream import JobStream
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Flag, Outcome, Verdict
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job

pytest.importorskip("warp", reason="Warp is an extra")

from support.fake_stepper import assert_same, run_all
from support.tiny_worlds import SHORT, SOME_NS, engine, shared_engine, tiny, tiny_scenes

from petmjx.engines.attempt_threads import AttemptThreads
from petmjx.engines.mjx.world_constants import NEVER
from petmjx.engines.mjx.world_state import State, Status
from petmjx.engines.subprocess.attempt_process import (
    JOBS_WORTH_A_PROCESS,
    READY,
    AttemptAnswer,
    AttemptProcess,
    AttemptSimulator,
    AttemptTask,
)
from petmjx.engines.warp import world_table
from petmjx.engines.warp.cpu_engine import MjxWarpCpuEngine
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.long_worlds import LongWorlds, most_steps
from petmjx.options.simulation import Simulation

LIMIT = 40
"""Number of steps after which worlds leave: before the last box of some is placed, after it in others."""

ITERATIONS = 180
"""Limit of iterations that some of the tiny worlds use up."""


def leaving(monkeypatch: pytest.MonkeyPatch, simulator: AttemptSimulator) -> list[int]:
    """Let worlds leave the device after ``LIMIT`` steps. Returns a list that gets the number of steps of each world
    that leaves."""
    steps: list[int] = []
    begin = simulator.begin

    def noted(task: AttemptTask) -> None:
        state: Any = task.job.start
        assert int(state.status) == Status.LEFT
        steps.append(int(state.steps_done))
        begin(task)

    def limits(jobs: Sequence[Job], sim: Simulation) -> NDArray[np.int32]:
        return np.where(most_steps(jobs, sim) == NEVER, NEVER, LIMIT).astype(np.int32)

    def continued(self: MjxWarpEngine, sim: Simulation, progress: Progress) -> LongWorlds | None:
        return None if isinstance(self, MjxWarpCpuEngine) else LongWorlds(simulator, sim, progress)

    monkeypatch.setattr(simulator, "begin", noted)
    monkeypatch.setattr(world_table, "most_steps", limits)
    monkeypatch.setattr(MjxWarpEngine, "_long_worlds", continued)
    return steps


def push(kind: str, level: float) -> Drive:
    return Drive(Excitation("push", kind, np.tile([level, 0.0, 0.0], (160, 1))), scale=0.5, yaw_rad=0.7, rest_s=0.1)


def assert_equal(outcomes: Sequence[Outcome], expected: Sequence[Outcome]) -> None:
    for outcome, of_one_engine in zip(outcomes, expected, strict=True):
        assert_same(outcome, of_one_engine)
        assert outcome.flags == of_one_engine.flags


@pytest.mark.slow
def test_worlds_that_leave_end_as_those_that_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The following worlds continue on a thread: placements that stand or fall, one of them with stiffer contacts, and
    a drive after its placement. A placement whose state is kept does not leave the device. A drive from this state
    continues in a process. The two parts of a history are joined."""
    bridge = tiny("hand-bridge")
    jobs = [Job(scene) for scene in tiny_scenes().values()]
    jobs += [Job(bridge, push("acceleration", 12.0)), Job(bridge, stiff=0.5), Job(bridge, keep_state=True)]
    expected = run_all(shared_engine(), jobs, SHORT)
    steps, progress = leaving(monkeypatch, AttemptThreads(1)), Progress()
    outcomes = run_all(engine(), jobs, SHORT, progress)
    assert_equal(outcomes, expected)
    assert {outcome.verdict for outcome in outcomes} == {Verdict.STABLE, Verdict.UNSTABLE}
    assert len(steps) >= 5
    assert len(steps) < len(jobs)
    assert set(steps) <= {LIMIT, LIMIT + 1}, "a world leaves at its limit, or a step later if a box is placed there"
    assert [*progress.notes] == ["long worlds were simulated to their ends on mjx-warp-cpu"]
    monkeypatch.undo()

    drive = push("force", 2.1)
    recorded = Job(bridge, drive, start=expected[-1].state, record=Record(0.02))
    (whole,) = run_all(shared_engine(), [recorded], SHORT)
    steps = leaving(monkeypatch, AttemptThreads(1))
    (joined,) = run_all(engine(), [recorded], SHORT)
    assert steps == [LIMIT]
    assert_equal([joined], [whole])
    assert joined.history is not None
    assert whole.history is not None
    same = np.isin(joined.history.time_s, whole.history.time_s)
    assert np.count_nonzero(~same) <= 1, "the moment at which the world left may be a frame more"
    for name in ("time_s", "pos", "quat", "top_force_n", "drive"):
        np.testing.assert_array_equal(getattr(joined.history, name)[same], getattr(whole.history, name), err_msg=name)
    monkeypatch.undo()

    process = AttemptProcess("petmjx.engines.warp.cpu_engine")
    steps = leaving(monkeypatch, process)
    (fork,) = run_all(engine(), [Job(bridge, drive, start=outcomes[-1].state)], SHORT)
    process.close()
    assert steps == [LIMIT]
    monkeypatch.undo()
    (full_run,) = run_all(shared_engine(), [Job(bridge, drive)], SHORT)
    assert fork.flags == full_run.flags | Flag.FORKED
    for name, values in vars(full_run.boxes).items():
        np.testing.assert_array_equal(getattr(fork.boxes, name), values, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("record", [None, Record(0.02)])
def test_a_source_that_waits_for_long_worlds_gets_their_outcomes(
    monkeypatch: pytest.MonkeyPatch, record: Record | None
) -> None:
    """In a worker, the source of jobs declares only after the last outcome that no further job follows. So the run must
    wait although no world is left on the GPU. If worlds are recorded, the thread that takes outcomes runs the
    slices."""
    steps, stream = leaving(monkeypatch, AttemptThreads(1)), JobStream[None](most_boxes=1)
    stream.put_all([(Job(scene, record=record), None) for scene in tiny_scenes().values()])
    stream.begin()
    numbers: list[int] = []

    def run() -> None:
        for outcome in engine().run(stream, SHORT):
            stream.answered(outcome.job)
            numbers.append(outcome.job)
            if len(numbers) == len(tiny_scenes()):
                stream.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(120)
    stream.close()
    assert sorted(numbers) == [*range(len(tiny_scenes()))]
    assert len(steps) == len(numbers)


class Late(AttemptSimulator):
    """A simulator that fails at each task, and reports this only when it has been asked ``looks`` times."""

    def __init__(self, looks: int) -> None:
        self.looks, self.tasks = looks, list[AttemptTask]()

    def begin(self, task: AttemptTask) -> None:
        self.tasks.append(task)

    def ended(self, *, wait: bool) -> Iterator[AttemptAnswer]:
        assert not wait
        self.looks -= 1
        while self.tasks and self.looks <= 0:
            yield AttemptAnswer(self.tasks.pop().number, None, "no memory")

    def close(self) -> None:
        self.tasks.clear()


def test_a_run_pauses_while_only_long_worlds_are_left() -> None:
    job, progress = Job(make_scene(2)), Progress(message="placed 3 of 4", pauses=True)
    states = State(**(dict.fromkeys(State._fields) | {"status": np.int32(Status.LEFT)}))  # type: ignore[arg-type]
    continued, messages, answers = LongWorlds(Late(3), Simulation(), progress), list[str](), list[Outcome]()
    assert not continued.take(job, make_outcome(2, job=6))
    assert continued.take(job, make_outcome(2, job=7, state=states))
    for outcome in continued.last():
        messages.append(progress.message)
        answers += [outcome] if outcome is not None else []
    assert messages == ["1 long world on CPU threads"] * 4, "three pauses and an outcome"
    assert progress.message == "placed 3 of 4"
    assert [(outcome.job, outcome.verdict, outcome.message) for outcome in answers] == [
        (7, Verdict.INVALID, "no memory")
    ]
    assert "mjx-warp-cpu failed to simulate a long world to its end (no memory)" in progress.notes


@pytest.mark.parametrize(
    ("schedule", "n_jobs", "tasks"),
    [
        ("adaptive", JOBS_WORTH_A_PROCESS, [READY]),
        ("adaptive", JOBS_WORTH_A_PROCESS - 1, []),
        ("fixed", JOBS_WORTH_A_PROCESS, []),
    ],
)
def test_the_process_starts_early_only_if_many_worlds_may_leave(schedule: str, n_jobs: int, tasks: list[int]) -> None:
    simulator = Late(1)
    sim = Simulation().changed(schedule=schedule)
    LongWorlds(simulator, sim, Progress()).prepare([Job(make_scene(2))] * n_jobs)
    assert [task.number for task in simulator.tasks] == tasks


def test_which_worlds_leave_depends_on_their_jobs_alone() -> None:
    sim = Simulation()
    scenes = [make_scene(20), make_scene(40)]
    jobs = [Job(scene) for scene in scenes]
    steps = most_steps(jobs, sim)
    assert 0 < steps[0] < steps[1] < NEVER
    after_placement = Job(scenes[0], push("force", 1.0))
    fork = replace(after_placement, start=object())  # type: ignore[arg-type]  # any state
    mixed = [*jobs, after_placement, fork, Job(scenes[1], keep_state=True), replace(jobs[0], has_errors=True)]
    alone = [most_steps([job], sim)[0] for job in mixed]
    assert most_steps(mixed, sim).tolist() == alone
    assert most_steps(mixed[::-1], sim).tolist() == alone[::-1]
    assert alone[-1] > steps[0], "boxes with errors take more steps"
    assert alone[2] == pytest.approx(alone[3] + steps[0], rel=0.1)
    assert most_steps([replace(jobs[0], record=Record(0.1))], sim)[0] == steps[0]
    stay = [replace(jobs[0], pauses_after=1), replace(jobs[0], keep_state=True), replace(fork, drive=None)]
    assert most_steps(stay, sim).tolist() == [NEVER] * 3
    assert most_steps(jobs, sim.changed(schedule="fixed")).tolist() == [NEVER] * 2


@pytest.mark.parametrize(
    "sim",
    [
        Simulation(),
        Simulation(interval_s=0.25),
        Simulation(rest_window_s=2.0),
        Simulation(check="static"),
        stiffened(Simulation(), 0.5),
    ],
    ids=["usual", "short interval", "long rest window", "static", "stiffer contacts"],
)
def test_no_world_leaves_whose_boxes_stand_or_fall_as_expected(sim: Simulation) -> None:
    """If boxes stand on the slab, each is quiet after little more than ``Quiet.steps`` steps, whatever the interval.
    The rest window follows. Two or three boxes that fall take 400 to 650 steps."""
    rest = sim.rest_window_s / sim.physics.timestep_s
    for n_boxes in (1, 2, 8, 20, 43):
        (steps,) = most_steps([Job(make_scene(n_boxes))], sim)
        assert steps > 1.2 * (60 + sim.quiet.steps * n_boxes) + rest
        assert steps > 650 + rest


@pytest.mark.slow
def test_iterations_are_counted_across_slices_and_engines(monkeypatch: pytest.MonkeyPatch) -> None:
    """A world that uses up its iterations ends after the same step, whichever worlds run beside it, however long slices
    are, and whether it left the GPU."""
    jobs = [*map(Job, tiny_scenes().values()), Job(tiny("hand-bridge"), push("force", 2.1))]
    sim = SHORT.changed(iteration_limit=ITERATIONS)
    expected = run_all(shared_engine(), jobs, sim)
    ended = [outcome.n_steps for outcome in expected if Flag.ITERATION_LIMIT in outcome.flags]
    assert 2 <= len(ended) < len(jobs)
    assert min(ended) > LIMIT
    assert_equal(run_all(shared_engine(), jobs[:0:-1], sim), expected[:0:-1])
    steps = leaving(monkeypatch, AttemptThreads(1))
    assert_equal(run_all(engine(slice_ns=SOME_NS), jobs, sim), expected)
    assert len(steps) >= len(ended)
