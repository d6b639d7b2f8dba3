"""Worlds that begin alike share the simulation of their first boxes."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.plans import make_plan, stack

from petmjx.options.simulation import Simulation
from petmjx.repairs import common_placements
from petmjx.repairs.common_placements import CommonPlacements, Placement, World
from petmjx.world.job import Job
from petmjx.world.scene import build_scene


class Kept(NamedTuple):
    """A state of a placement: the boxes that are placed in it."""

    boxes: str
    memory: Any


def world(boxes: str) -> World[str]:
    """A world whose boxes are letters."""
    keys = [boxes[:n].encode() for n in range(len(boxes) + 1)]
    return World(Job(build_scene(make_plan(boxes=stack(len(boxes))), Simulation())), boxes, keys)


def simulated(common: CommonPlacements[str], worlds: Sequence[str], n_bytes: int = 8) -> tuple[list[str], int]:
    """Simulate worlds. Returns the worlds that ended, sorted, and the number of boxes that were placed."""
    waiting: list[Placement[str]] = [*common.begin([world(boxes) for boxes in worlds])]
    ended: list[str] = []
    n_placed = 0
    while waiting:
        placement = waiting.pop()
        job, first = placement.job, placement.worlds[0].tag
        start: Any = job.start
        before = "" if start is None else start.boxes
        assert all(one.tag.startswith(before) for one in placement.worlds), "they start from their own beginning"
        n_placed += placement.n_boxes - len(before)
        if job.pauses_after is None:
            assert len(placement.worlds) == 1
            ended.append(first)
            continue
        assert job.pauses_after == placement.n_boxes < min(len(one.tag) for one in placement.worlds)
        state = Kept(first[: placement.n_boxes], np.zeros(n_bytes, np.uint8))
        waiting += common.go_on(placement, SimpleNamespace(state=state))  # type: ignore[arg-type]
    return sorted(ended), n_placed


@pytest.fixture
def without_least(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(common_placements, "LEAST_SAVED", 1)


@pytest.mark.usefixtures("without_least")
@pytest.mark.parametrize(
    ("worlds", "n_placed"),
    [
        (["abcdef"], 6),
        (["abcdef", "abcxyz"], 3 + 3 + 3),
        (["abcdef", "abcdxy", "abxyzw"], 2 + 2 + 2 + 2 + 4),
        (["abc", "abcdef"], 2 + 1 + 4),
        (["abcd", "abcd", "abcd"], 3 + 1 + 1 + 1),
        (["abcd", "xyz"], 4 + 3),
        (["a", "a", "b"], 3),
    ],
    ids=["one", "two", "a tree", "one is the beginning of another", "equal", "nothing in common", "single boxes"],
)
def test_boxes_in_common_are_placed_once(worlds: list[str], n_placed: int) -> None:
    assert simulated(CommonPlacements(), worlds) == (sorted(worlds), n_placed)


@pytest.mark.usefixtures("without_least")
def test_later_worlds_start_from_kept_states() -> None:
    common = CommonPlacements[str]()
    assert simulated(common, ["abcdef", "abcxyz"])[1] == 9
    assert simulated(common, ["abcpqr"])[1] == 3
    assert simulated(common, ["abcdpq", "abcdqp", "ab"])[1] == 2 + 1 + 2 + 2


@pytest.mark.usefixtures("without_least")
def test_kept_states_have_a_limit() -> None:
    """The state of four letters has 16 + 400 bytes as NumPy counts it, so two of them fit."""
    common = CommonPlacements[str](most_bytes=1000)
    for letter in "abc":
        simulated(common, [4 * letter + "x", 4 * letter + "y"], 400)
    n_placed = [simulated(common, [4 * letter + "z"], 400)[1] for letter in "abc"]
    assert n_placed == [5, 1, 1], "the oldest state was removed"


def test_few_boxes_in_common_are_not_worth_a_pause() -> None:
    assert simulated(CommonPlacements(), ["abcdef", "abcxyz"])[1] == 12
    many = ["abc" + letter for letter in "defghijklmnopqr"]
    assert simulated(CommonPlacements(), many)[1] == 3 + 15
