"""Failures of a world on mjx-warp harm no other world: buffers that are too small, and numbers that are not finite."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from petmjx.common.errors import InputError
from petmjx.engines.mjx.padded_sizes import GRANULE
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.fake_stepper import assert_same
from support.job_streams import LateStream
from support.plans import make_scene
from support.tiny_worlds import (
    SHORT,
    SOME_NS,
    TINY,
    assert_equal_worlds,
    devices,
    engine,
    shared_engine,
    sizes_apart,
    tiny,
    tiny_scenes,
    watched_rollouts,
)
from support.worlds import simulate

from petmjx.engines.warp import contact_buffers
from petmjx.engines.warp.block_sizes import MAX_BOXES, SIZES
from petmjx.engines.warp.contact_buffers import MORE_BOXES, most_room
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.world_table import WorldTable

pytestmark = pytest.mark.usefixtures("ranks_may_differ")


@pytest.mark.slow
@devices
@pytest.mark.parametrize("buffer", ["CONTACTS_PER_BOX", "PAIRS_PER_BOX"])
def test_buffers_that_are_too_small_grow_and_give_the_same(
    device: str, buffer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Buffers have room for 4 contacts or pairs a world. At least 5 pairs of the bricks touch, in 20 contacts.
    some = tiny_scenes(("hand-one-box", "brickwork"))
    expected = simulate(shared_engine(), some, SHORT)
    monkeypatch.setattr(contact_buffers, buffer, 1)
    monkeypatch.setattr(contact_buffers, "MORE_BOXES", 0)
    outcomes = simulate(engine(), some, SHORT)
    assert outcomes["brickwork"].flags & Flag.RERUN_AFTER_OVERFLOW
    for name, outcome in outcomes.items():
        assert not outcome.flags & Flag.CONTACT_OVERFLOW
        assert_same(outcome, expected[name])


@pytest.mark.slow
def test_buffers_grow_for_the_size_that_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A world has room for eight contacts. Room for eight contacts is enough for a box on the carrier, which has four
    contacts with the floor. Room for eight contacts is too little for bricks."""
    some = {**tiny_scenes(("hand-one-box", "brickwork")), "one more": tiny("hand-one-box")}
    expected = simulate(shared_engine(), some, SHORT)
    sizes_apart(monkeypatch, 1)
    monkeypatch.setattr(contact_buffers, "CONTACTS_PER_BOX", 2)
    monkeypatch.setattr(contact_buffers, "MORE_BOXES", 0)
    made = watched_rollouts(monkeypatch, lambda *_: None)
    for name, outcome in simulate(engine(), some, SHORT).items():
        assert_same(outcome, expected[name])
    large, small = np.array([[pool.nconmax for pool in rollout.launcher.pools] for rollout in made]).T
    assert len(set(large)) > 1
    assert len(set(small)) == 1


@pytest.mark.slow
def test_what_overflows_for_ever_is_invalid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_buffers, "CONTACTS_PER_BOX", 0)
    monkeypatch.setattr(contact_buffers, "MAX_GROWTH", 1)  # each size has programs of its own
    small = engine()
    outcome = simulate(small, tiny_scenes(("hand-one-box",)), SHORT)["hand-one-box"]
    assert (outcome.verdict, outcome.reason) == (Verdict.INVALID, Reason.OVERFLOW)
    (growth,) = small._pools.buffers._growth.values()
    room, most = GRANULE + MORE_BOXES, most_room(SIZES[0].most_boxes)
    assert growth // 2 * room < most <= growth * room


OVERLAPPING = 48


@pytest.mark.slow
def test_what_overflows_does_not_depend_on_larger_plans_beside_it() -> None:
    """Boxes in the same place have at least four contacts with each other."""
    packed = make_scene([((300, 300, 300), (0, 0, 0), 1.0)] * OVERLAPPING)
    sim = Simulation(check="static", schedule="fixed", duration_s=0.02)
    alone = simulate(engine(), {"packed": packed}, sim)["packed"]
    beside = simulate(engine(), {"packed": packed, "larger": make_scene(SIZES[0].most_boxes)}, sim)["packed"]
    assert alone.flags & Flag.RERUN_AFTER_OVERFLOW
    assert alone.reason is not Reason.OVERFLOW
    assert_same(alone, beside)


MARKED = "hand-bridge"
NAN = float("nan")


def poisoned(monkeypatch: pytest.MonkeyPatch, poison: Callable[[WorldTable, int], WorldTable]) -> None:
    """Let ``poison`` put NaN into each new table, in the row of the job with most boxes."""
    plain = MjxWarpEngine._load

    def load(self: MjxWarpEngine, run: Any, jobs: list[Job], *args: Any) -> WorldTable:
        table = plain(self, run, jobs, *args)
        return poison(table, int(np.argmax([job.scene.n_boxes for job in jobs])))

    monkeypatch.setattr(MjxWarpEngine, "_load", load)


def in_release_pose(table: WorldTable, row: int) -> WorldTable:
    table.worlds = table.worlds._replace(start=table.worlds.start.at[row, 1].set(NAN))
    return table


def in_carrier_velocity(table: WorldTable, row: int) -> WorldTable:
    table.table = table.table._replace(carrier_qvel=table.table.carrier_qvel.at[row, 2].set(NAN))
    return table


@pytest.mark.slow
@devices
@pytest.mark.parametrize("poison", [in_release_pose, in_carrier_velocity])
def test_a_world_that_turns_into_no_number_harms_no_other(
    device: str, poison: Callable[[WorldTable, int], WorldTable], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("hand-one-box", MARKED, "hand-overhang-45")
    healthy = simulate(shared_engine(), tiny_scenes(names), SHORT)
    poisoned(monkeypatch, poison)
    outcomes = simulate(shared_engine(), tiny_scenes(names), SHORT)
    ill = outcomes.pop(MARKED)
    assert (ill.verdict, ill.reason) == (Verdict.INVALID, Reason.NONFINITE)
    assert_equal_worlds(outcomes, healthy)


TOO_MANY = [((10.0, 10.0, 10.0), (20.0 * (k % 32), 20.0 * (k // 32), 0.0), 1.0) for k in range(MAX_BOXES + 1)]


def test_a_plan_with_more_bodies_than_the_solver_has_room_for_is_refused() -> None:
    run = engine().run([Job(make_scene(TOO_MANY))], Simulation())
    with pytest.raises(
        InputError, match=rf"up to {MAX_BOXES} boxes, but one plan has {MAX_BOXES + 1}: choose the engine"
    ):
        next(run)


@pytest.mark.slow
def test_a_plan_that_is_refused_takes_no_outcome_from_those_before(crowd: dict[str, Outcome]) -> None:
    jobs, outcomes = [Job(tiny(TINY[0]))], list[Outcome]()
    stream = LateStream(jobs, [jobs[0], Job(make_scene(TOO_MANY))])
    run = engine(most_rows=8, slice_ns=SOME_NS).run(stream, SHORT)
    with pytest.raises(InputError, match=f"one plan has {MAX_BOXES + 1}"):
        outcomes.extend(run)
    assert sorted(outcome.job for outcome in outcomes) == list(range(len(jobs) + 1))
    for outcome in outcomes:
        assert_equal_worlds({TINY[0]: outcome}, crowd)
