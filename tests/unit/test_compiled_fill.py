"""Packings that compiled code fills up are equal, to the last bit, to those that Python fills up."""

from __future__ import annotations

import sys
from dataclasses import replace
from math import inf
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.packings import orders, targets

import petmjx.packers.beam_search as beam_module
from petmjx.packers.balanced_packer import PREFERENCE_SETS
from petmjx.packers.beam_search import search
from petmjx.packers.packing_state import Packing, Preferences
from petmjx.plans.order import TARGET_EXTENT_MM, Item
from petmjx.plans.order_generator import draw_order

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
compiled = pytest.importorskip("petmjx.packers.compiled_fill")

DRAWN = draw_order(33, 1)
EXTENT = TARGET_EXTENT_MM[DRAWN.target]


def grown(packing: Packing, boxes: int) -> Packing:
    """The packing with more boxes, as long as there are candidates. Every second box is the second-best or third-best
    candidate."""
    for number in range(boxes):
        if candidates := packing.next(2 + number % 2):
            packing.put(candidates[-1])
    return packing


@settings(max_examples=40, deadline=None)
@given(orders, targets, st.sampled_from(PREFERENCE_SETS), st.sampled_from([0.0, 2.5, 6.0, 1 / 3]), st.integers(0, 12))
def test_they_are_the_same(
    items: list[Item], extent: tuple[int, int], preferences: Preferences, clearance_mm: float, boxes: int
) -> None:
    packing = Packing(items, extent, preferences, clearance_mm)
    fills = compiled.FillKernel(packing)
    grown(packing, boxes)
    first = packing.next(3)[-1:]
    filled = fills(packing, *first)
    assert filled == packing.filled(*first)
    assert filled is not None
    assert fills(packing) == packing.filled()


def test_one_that_becomes_too_high_is_given_up() -> None:
    packing = grown(Packing(DRAWN.items, EXTENT, PREFERENCE_SETS[0], 3.0), 5)
    fills, filled = compiled.FillKernel(packing), packing.filled()
    assert filled is not None
    assert fills(packing, None, filled.top_mm) == filled
    assert fills(packing, None, filled.top_mm - 1) is None
    assert fills(packing) == filled  # the result does not depend on the packing that was filled up before


def test_python_says_whether_a_box_tips_over_whose_weight_acts_on_an_edge(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = []
    tips = compiled.tips

    def noted(*arguments: Any) -> bool:
        answers.append(tips(*arguments))
        return answers[-1]

    monkeypatch.setattr(compiled, "tips", noted)
    order = draw_order(33, 9)
    for preferences in PREFERENCE_SETS:
        packing = Packing(order.items, TARGET_EXTENT_MM[order.target], preferences)
        assert compiled.FillKernel(packing)(packing) == packing.filled()
    assert set(answers) == {True, False}


@pytest.mark.parametrize("room", [{"POINTS": 9, "POINTS_PER_BOX": 0}, {"PLANES_PER_BOX": 1}])
def test_where_there_is_no_room_python_fills_up(monkeypatch: pytest.MonkeyPatch, room: dict[str, int]) -> None:
    for name, number in room.items():
        monkeypatch.setattr(compiled, name, number)
    packing, calls = Packing(DRAWN.items, EXTENT, PREFERENCE_SETS[0], 3.0), []
    monkeypatch.setattr(packing, "filled", lambda *arguments: calls.append(arguments))
    assert compiled.FillKernel(packing)(packing) is None
    assert calls == [(None, inf)]


def test_areas_without_an_exact_sum_are_left_to_python(monkeypatch: pytest.MonkeyPatch) -> None:
    third = [replace(item, length_mm=item.length_mm + 1 / 3) for item in DRAWN.items]
    assert Packing(third, EXTENT, PREFERENCE_SETS[0]).grain_mm < compiled.GRAIN_MM
    assert Packing(DRAWN.items, EXTENT, PREFERENCE_SETS[0], 2.25).grain_mm == 0.25
    calls = []
    monkeypatch.setattr(Packing, "filled", lambda *arguments: calls.append(arguments[1:]))
    packing = Packing(third, EXTENT, PREFERENCE_SETS[0])
    assert compiled.FillKernel(packing)(packing) is None
    assert calls == [(None, inf)]


def test_a_search_finds_the_same_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The beam search finds the same packings without compiled code, also if each step places several boxes."""
    items = DRAWN.items[:18]
    for steps in (80, 6):
        monkeypatch.setattr(beam_module, "MOST_STEPS", steps)
        packings = search(items, EXTENT, 3.0, width=2, branch=3)
        with monkeypatch.context() as without:
            without.setattr(beam_module, "why_no_warp_on_cpu", lambda: "Warp is not installed")
            assert search(items, EXTENT, 3.0, width=2, branch=3) == packings


@pytest.mark.parametrize("broken", ["module", "compiler"])
def test_where_warp_does_not_work_python_fills_up(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python fills up packings if Warp is installed but cannot be imported, or cannot compile on this machine."""
    if broken == "module":
        monkeypatch.setitem(sys.modules, compiled.__name__, None)
    else:
        monkeypatch.setattr(compiled, "_kernel", lambda: 1 / 0)
    assert beam_module.fills_for(Packing(DRAWN.items, EXTENT, PREFERENCE_SETS[0])) is Packing.filled
