"""Engines that users write: petmjx keeps all their attributes. An interrupt leaves nothing behind, however often a run
is interrupted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from support.failing_engine import FailingEngine, worlds_failing

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines import simulation_loop
from petmjx.engines.engine_of_run import engine_for
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.expected_work import Work
from petmjx.engines.protocol import PHYSICS, Capability, Engine, Progress, says_at_hand, takes_stream
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Outcome
from petmjx.engines.world_prefetch import WorldPrefetch
from petmjx.loop import candidate_trials
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job


class Full:
    """An engine that inherits from no class of petmjx and has all optional attributes."""

    name = "full"
    capabilities = Capability.FLOAT64 | Capability.CHECKS
    devices = 3
    device = "three of mine"
    closed = False

    @says_at_hand
    @takes_stream
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        return iter(())

    def open(self, scenes: Any, sim: Any, most_boxes: int = 0) -> Any:
        return ("open", scenes, sim, most_boxes)

    def close(self) -> None:
        self.closed = True


class Bare:
    name = "bare"

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        return iter(())


def lent(user_engine: Any) -> Engine:
    with engine_for(RunOptions(engine=user_engine), Work(Simulation(), [1])) as (engine, _):
        return engine


def test_a_lent_engine_keeps_what_it_has() -> None:
    user_engine = Full()
    engine = lent(user_engine)
    for name in ("name", "capabilities", "devices", "device"):
        assert getattr(engine, name) == getattr(user_engine, name), name
    assert engine.tells
    assert engine.streams
    assert engine.open([], Simulation(), 7) == ("open", [], Simulation(), 7)  # type: ignore[comparison-overlap]
    assert not user_engine.closed, "it stays the user's"


def test_what_it_leaves_out_is_as_of_any_engine() -> None:
    engine = lent(Bare())
    assert engine.capabilities == PHYSICS["mujoco"] & ~Capability.SOFT
    assert engine.devices == 1
    assert not engine.tells
    with pytest.raises(InputError, match="engine bare has no open worlds"):
        engine.open([], Simulation())
    assert lent(make_engine("mujoco")).tells


def test_an_engine_with_flags_of_an_older_version_is_told() -> None:
    class Dated(Bare):
        takes_more = True

    with pytest.warns(UserWarning, match="engine bare: takes_more has no effect; set the attribute 'capabilities'"):
        lent(Dated())


def test_a_second_ctrl_c_skips_no_cleaning(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[str] = []
    close = WorldPrefetch.close

    def interrupted(self: Any) -> None:
        close(self)
        closed.append("source")
        raise KeyboardInterrupt

    monkeypatch.setattr(WorldPrefetch, "close", interrupted)
    monkeypatch.setattr(simulation_loop._AttemptTasks, "close", lambda self: closed.append("besides"))
    with pytest.raises(KeyboardInterrupt):
        list(score_worlds(worlds_failing(0), Simulation(), FailingEngine()))
    assert sorted(closed) == ["besides", "source"]


def test_errors_are_read_from_their_file_once(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    sweep = candidate_trials.confidence_sweep
    monkeypatch.setattr(
        candidate_trials, "confidence_sweep", lambda count, *rest: read.append(count) or sweep(count, *rest)
    )
    candidate_trials.errors_of.cache_clear()
    box = petmjx.Plan.from_boxes("p", size_mm=[[400, 300, 200]], corner_mm=[[0, 0, 0]], mass_kg=[5])
    pallets = petmjx.Pallets(engine="mujoco")
    fields = {"size_mm": box.size_mm, "mass_kg": box.mass_kg, "corner_mm": box.corner_mm}
    first, again = (pallets.try_all(**fields, errors=4).share for _ in range(2))
    pallets.close()
    assert read == [4]
    assert first.tolist() == again.tolist()
