"""Tests of a change of engine during a run with ``auto``. If C MuJoCo takes longer than expected, worlds that have not
begun are simulated by the faster engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.job_streams import feedback_stream, put
from support.outcomes import make_outcome
from support.plans import make_plan, make_scene, stack

import petmjx
from petmjx.common.errors import EngineUnavailable
from petmjx.engines.cost_model import MEASURED, Costs
from petmjx.engines.engine_choice import Choice
from petmjx.engines.engine_of_run import resolve_engine
from petmjx.engines.expected_work import Work
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco_to_warp_handover import LEAST_WORLDS, HandoverEngine
from petmjx.engines.protocol import Engine, Progress, takes_stream
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job, KeptState

SIM = Simulation()
BOXES = 3
EXPECTED_S = float(MEASURED.of_jobs([Job(make_scene(BOXES))], SIM)[0])
CHEAP = replace(MEASURED, kernel_start_s=0.0)
"""Costs with which kernels need no time to compile, so that a change is worthwhile even for few worlds."""


class Slow(MujocoEngine):
    """C MuJoCo, which reports for each world the expected time × ``times``. The states of this engine contain the
    engine's name."""

    def __init__(self, times: float) -> None:
        super().__init__(1)
        self.times = times
        self.starts: list[object] = []

    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        assert progress is not None
        stream = JobStream.of(jobs)
        while new := stream.take(1):
            self.starts.append(new[0].start)
            progress.thread_s += self.times * EXPECTED_S
            yield answer(new[0], stream.taken - 1)


class Kernels(Engine):
    """The engine that takes the remaining worlds. The engine fails after ``fails_after`` worlds."""

    name = "mjx-warp-cpu"

    def __init__(self, fails_after: int | None = None) -> None:
        self.fails_after, self.asked, self.closed = fails_after, 0, False
        self.starts: list[object] = []

    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        stream = JobStream.of(jobs)
        while new := stream.take(1):
            if self.asked == self.fails_after:
                raise RuntimeError("no more memory")
            self.asked += 1
            self.starts.append(new[0].start)
            yield answer(new[0], stream.taken - 1)

    def close(self) -> None:
        self.closed = True


def answer(job: Job, number: int) -> Outcome:
    return replace(make_outcome(job.scene.n_boxes, Verdict.STABLE), job=number)


def jobs(count: int) -> list[Job]:
    scene = make_scene(BOXES)
    return [Job(scene) for _ in range(count)]


def ended(
    times: float, count: int, costs: Costs = CHEAP, make: Callable[[], Engine] = Kernels, sim: Simulation = SIM
) -> tuple[list[Outcome], Progress]:
    progress = Progress()
    engine = HandoverEngine(Slow(times), make, costs)
    return list(engine.run(jobs(count), sim, progress)), progress


def test_what_has_not_begun_goes_to_the_faster_engine() -> None:
    outcomes, progress = ended(5.0, 300)
    assert sorted(outcome.job for outcome in outcomes) == list(range(300))
    by_engine = [outcome.engine for outcome in sorted(outcomes, key=lambda outcome: outcome.job)]
    # a thread has two worlds at a time, so one more world had begun
    assert by_engine == ["mujoco"] * (LEAST_WORLDS + 1) + ["mjx-warp-cpu"] * (300 - LEAST_WORLDS - 1)
    (note,) = progress.notes
    assert note == (
        "auto: 20 worlds took 5 times as long as expected on mujoco; 279 worlds that had not begun went to mjx-warp-cpu"
    )


@pytest.mark.parametrize(
    ("times", "count", "costs"),
    [
        (1.9, 300, CHEAP),  # worlds take as long as expected, within a factor of two
        (5.0, LEAST_WORLDS, CHEAP),  # no world is left
        (5.0, 300, MEASURED),  # compiling takes longer than all worlds
    ],
)
def test_it_stays_where_nothing_is_gained(times: float, count: int, costs: Costs) -> None:
    outcomes, progress = ended(times, count, costs)
    assert [outcome.engine for outcome in outcomes] == ["mujoco"] * count
    assert not progress.notes


def test_the_gain_is_worked_out_with_what_was_measured() -> None:
    """The decision uses measured times. Compiling takes the measured time of 100 worlds on C MuJoCo. From this follows
    the number of remaining worlds from which on a change is worthwhile."""
    ratio = float(MEASURED.of_jobs(jobs(1), SIM, MEASURED.kernel)[0]) / EXPECTED_S
    costs = replace(MEASURED, kernel_start_s=100 * 5 * EXPECTED_S)
    worth = 1.5 * 100 / (1 - 1.5 * ratio)  # left × 5 × expected = 1.5 × (start + left × 5 × expected × ratio)
    for left, changes in ((worth - 2, False), (worth + 2, True)):
        outcomes, _ = ended(5.0, LEAST_WORLDS + 1 + round(left), costs)
        assert (outcomes[-1].engine == "mjx-warp-cpu") == changes


def test_without_kernels_it_stays() -> None:
    def missing() -> Engine:
        raise EngineUnavailable("Warp is not installed")

    outcomes, progress = ended(5.0, 100, make=missing)
    assert [outcome.engine for outcome in outcomes] == ["mujoco"] * 100
    assert not progress.notes


def test_an_error_of_the_kernels_loses_no_world() -> None:
    outcomes, progress = ended(5.0, 100, make=lambda: Kernels(fails_after=10))
    assert sorted(outcome.job for outcome in outcomes) == list(range(100))
    assert [outcome.engine for outcome in outcomes].count("mjx-warp-cpu") == 10
    assert "mjx-warp-cpu failed (RuntimeError: no more memory); 69 worlds: went to mujoco" in progress.notes


def test_further_attempts_and_the_solver_cg_stay() -> None:
    engine = HandoverEngine(Slow(5.0), Kernels, CHEAP)
    assert len(list(engine.run(jobs(50), SIM, Progress()))) == 50
    again = list(engine.run(jobs(50), SIM.changed(solver_iterations=400), Progress()))
    assert {outcome.engine for outcome in again} == {"mujoco"}
    outcomes, _ = ended(5.0, 50, sim=SIM.changed(solver="cg"))
    assert {outcome.engine for outcome in outcomes} == {"mujoco"}


def test_each_engine_starts_from_its_own_states() -> None:
    """An engine starts only from its own states. If a drive (shaking) would start from a state of the other engine, its
    placement is simulated again. Jobs that follow from results also change the engine."""
    mujoco, kernels = Slow(5.0), Kernels()
    engine = HandoverEngine(mujoco, lambda: kernels, CHEAP)
    some = jobs(100)
    stream, outcomes = feedback_stream(some), []
    for outcome in engine.run(stream, SIM, Progress()):
        outcomes.append(outcome)
        if outcome.job == 99:
            scene = some[0].scene
            put(stream, *[Job(scene, start=KeptState(name, name)) for name in ("mujoco", "mjx-warp-cpu")])  # type: ignore[arg-type]
    assert sorted(outcome.job for outcome in outcomes) == list(range(102))
    assert kernels.starts[-2:] == [None, "mjx-warp-cpu"]
    assert not any(mujoco.starts)
    engine.close()
    assert kernels.closed


def test_the_kernels_end_when_all_jobs_have_followed() -> None:
    class Waiting(Kernels):
        """Ends when no job can follow, as ``mjx-warp-cpu`` does."""

        @takes_stream
        def run(
            self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
        ) -> Iterator[Outcome]:
            stream = JobStream.of(jobs)
            yield from super().run(stream, sim, progress)
            pauses = 0
            while stream.wait_for_following(()):
                pauses += 1
                assert pauses < 5, "it would wait for ever"
                yield None  # type: ignore[misc]

    stream, n_kernels = feedback_stream(jobs(50)), 0
    stream.begin()
    for outcome in HandoverEngine(Slow(5.0), Waiting, CHEAP).run(stream, SIM, Progress(pauses=True)):
        if outcome is None:
            stream.followed()
        else:
            stream.answered(outcome.job)
            n_kernels += outcome.engine == "mjx-warp-cpu"
    assert n_kernels > 0


def test_jobs_that_follow_do_not_wait_for_those_of_the_source() -> None:
    """C MuJoCo takes only the jobs that it begins next out of the stream: four jobs, and two that run. So jobs that
    follow from results need not wait for all jobs of the source."""
    stream, tags = JobStream[str](feedback=True), dict[int, str]()
    for number, job in enumerate(jobs(20)):
        stream.put(job, f"source {number}", bounded=True)
    stream.close()
    for outcome in HandoverEngine(Slow(1.0), Kernels, CHEAP).run(stream, SIM, Progress()):
        tags[outcome.job] = stream.answered(outcome.job)
        if len(tags) == 1:
            stream.put(jobs(1)[0], "follows")
    assert sorted(tags) == list(range(21))
    assert next(number for number, tag in tags.items() if tag == "follows") <= 5


def test_a_run_of_both_engines_goes_on_after_ctrl_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After Ctrl-C, a run with both engines can be continued. The worlds are real, and the second engine is C MuJoCo
    under another name."""

    class Named(MujocoEngine):
        name = "mjx-warp-cpu"
        interrupt_after = 3

        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            for outcome in super().run(jobs, sim, progress):
                if self.interrupt_after == 0:
                    raise KeyboardInterrupt
                self.interrupt_after -= 1
                yield outcome

    engines: list[str | None] = []

    def resolved(options: RunOptions, work: Work, *, earlier: str | None, **_: Any) -> tuple[Engine, Choice]:
        engines.append(earlier)
        cheap = replace(CHEAP, mujoco=CHEAP.mujoco.slowed(0.001), kernel=CHEAP.kernel.slowed(0.0001))
        return HandoverEngine(MujocoEngine(1), lambda: Named(1), cheap), Choice("mujoco", "for this test", 1.0)

    monkeypatch.setattr("petmjx.engines.engine_of_run.resolve_engine", resolved)
    plans = [make_plan(f"p{number}", stack(1)) for number in range(30)]
    with pytest.raises(KeyboardInterrupt):
        petmjx.score(plans, out=tmp_path / "run")
    begun = petmjx.load_run(tmp_path / "run")
    by_engine = begun.worlds["engine"].value_counts().to_dict()
    assert by_engine == {"mujoco": LEAST_WORLDS + 1, "mjx-warp-cpu": 3}
    assert any(note.startswith("auto: 20 worlds took ") for note in begun.info["warnings"])
    results = petmjx.score(plans, out=tmp_path / "run", resume=True)
    assert engines == [None, "mujoco"]
    assert results.worlds["plan_id"].tolist() == [plan.plan_id for plan in plans]
    assert results.worlds["engine"].value_counts().to_dict() == {"mujoco": 27, "mjx-warp-cpu": 3}
    assert results.info["status"] == "finished"


def test_auto_keeps_the_engine_of_a_run_that_goes_on() -> None:
    work = Work(SIM, [2])
    assert resolve_engine(RunOptions(threads=1), work, MEASURED)[1].reason.startswith("about 0 s")
    engine, choice = resolve_engine(RunOptions(threads=1), Work(SIM, [40] * 5000), MEASURED, earlier="mujoco")
    assert (engine.name, choice.name, choice.reason) == ("mujoco", "mujoco", "as before")
    unknown = resolve_engine(RunOptions(threads=1), work, MEASURED, earlier="of a newer petmjx")
    assert unknown[1].name == "mujoco"


def test_only_what_auto_took_hands_over() -> None:
    for options, kind in (
        (RunOptions(threads=1), HandoverEngine),
        (RunOptions(threads=1, world_timeout_s=9), MujocoEngine),
        (RunOptions(threads=1, engine="mujoco"), MujocoEngine),
    ):
        assert isinstance(resolve_engine(options, Work(SIM, [2]), MEASURED, hands_over=True)[0], kind)
