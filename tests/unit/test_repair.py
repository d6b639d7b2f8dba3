"""Repairs: for each cause of a fall, petmjx finds the smallest change. The change is needed and allowed, and the
changed plan stands."""

from __future__ import annotations

import pickle
import re
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.plans import Box, make_plan, stack

import petmjx
from petmjx.cli.main import main
from petmjx.common.errors import InputError
from petmjx.engines.attempt_with_fallback import outcomes_of_stream
from petmjx.engines.subprocess.task_pipe import Forks, PipedProcess
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.repairs.balance import ROOM_MM, balances
from petmjx.repairs.candidates import AT_ONCE, HELD, Candidate, Fault, Node, State, batch_of, spread
from petmjx.repairs.changes import (
    Change,
    Exchange,
    Film,
    Kind,
    LeaveOut,
    Move,
    Order,
    Place,
    Sheet,
    Turn,
    applied,
    longest_move_mm,
    with_change,
    with_turns_told,
)
from petmjx.repairs.draft_rules import Rules
from petmjx.repairs.drafts import Draft, key_of
from petmjx.repairs.proposals import Target, proposals
from petmjx.repairs.rebuilds import Failure, rebuilds
from petmjx.repairs.repair import Repaired, Repairs, _still_odd_note, _weak_note
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.requests import OutOfTime, Steps, Together, Trial, TrialAnswer, TrialRequest
from petmjx.repairs.search import ALONE, ALONE_IF_MANY, BUILT_ANEW, MANY_FAULTS, SURPLUS, WIDE_AT_ONCE, Search
from petmjx.repairs.search_processes import SearchProcesses, Tasks, most_processes
from petmjx.repairs.trials import Question, Share, TimeLimit, TrialStream
from petmjx.runs.simulate import RunStart
from petmjx.world.job import Job

FAST_TRIALS = {"engine": "mujoco", "threads": 1}
FALLS = Trial("unstable", "tilt", 1, (1,), 2, 2, 0.0)
FAST = {"engine": "mujoco", "threads": 1, "worlds": 0, "trials": 40}
"""Options for repairs without worlds with errors, whose simulation takes the most time."""

COUNTERWEIGHT: Sequence[Box] = (
    ((200, 300, 300), (0, 0, 0), 10),
    ((360, 300, 100), (0, 0, 300), 2),
    ((150, 300, 200), (210, 0, 400), 6),
    ((200, 300, 300), (0, 0, 400), 12),
)
"""A beam with a box on its free end. This box tips the beam before the box comes that holds the other end of the beam
down."""

LATE_SUPPORT: Sequence[Box] = (
    ((200, 300, 200), (0, 0, 0), 5),
    ((600, 300, 100), (0, 0, 200), 5),
    ((200, 300, 200), (400, 0, 0), 5),
)
"""A board on two boxes. The second of these boxes is placed only after the board."""

TOWER: Sequence[Box] = tuple(((200.0, 200.0, 150.0), (70.0 * k, 0.0, 150.0 * k), 4.0) for k in range(4))
"""A stair of boxes: each box alone is in balance on the box below, but all together tip over the edge of the lowest
box."""


def repaired(boxes: Sequence[Box], **options: Any) -> Repaired:
    (result,) = petmjx.repair(make_plan(boxes=boxes), **{**FAST, **options}).each
    return result


def verdict(plan: Plan) -> str:
    return str(petmjx.score(plan, engine="mujoco", threads=1).worlds.verdict[0])


def check(result: Repaired) -> None:
    """Check that the repaired plan stands, is allowed, and falls without any one of its changes."""
    assert result.stands
    assert verdict(result.plan) == "stable"
    rules = Rules(result.before, Simulation(), 2000.0, 0)
    for number in range(len(result.changes)):
        shorter = (*result.changes[:number], *result.changes[number + 1 :])
        draft = applied(Draft.of(result.before), shorter)
        undone = result.undone(number)
        if draft is None or not rules.allow([draft])[0]:
            continue
        assert undone is not None
        assert verdict(undone) == "unstable"


def test_a_counterweight_comes_earlier() -> None:
    result = repaired(COUNTERWEIGHT)
    assert result.words == ["place box 3 before box 2"]
    assert (result.trial_before.verdict, result.trial_before.culprit) == ("unstable", 2)
    assert result.plan.item_ids == ("item-0", "item-1", "item-3", "item-2")
    assert result.cost == 0.8
    check(result)


def test_a_support_comes_before_the_box_on_it() -> None:
    result = repaired(LATE_SUPPORT)
    assert [change.kind for change in result.changes] == [Kind.ORDER]
    assert result.plan.item_ids == ("item-0", "item-2", "item-1")
    check(result)


def test_an_overhang_is_moved_inside() -> None:
    """Half of the box's 400 mm may hang over, but 230 mm do. So the box must be moved by at least 30 mm."""
    result = repaired(stack(2, 230.0), forbid=("order", "place"))
    (change,) = result.changes
    assert isinstance(change, Move)
    assert 30 <= change.length_mm <= 60
    assert result.words == [
        f"move box {change.box} by {change.length_mm:.0f} mm to the {'right' if change.box == 0 else 'left'}"
    ]
    check(result)


def test_a_stair_stands_after_one_change() -> None:
    result = repaired(TOWER)
    assert len(result.changes) == 1
    check(result)


def test_an_unsupported_corner_gets_a_box_under_it() -> None:
    """The lid lies on two columns at its left side. A third column of the same height stands beside them: it can be put
    under the lid."""
    boxes: Sequence[Box] = (
        ((150, 150, 200), (0, 0, 0), 4),
        ((150, 150, 200), (0, 350, 0), 4),
        ((150, 150, 200), (0, 175, 0), 4),
        ((500, 500, 100), (0, 0, 200), 8),
        ((150, 150, 200), (550, 0, 0), 4),
    )
    result = repaired(boxes, forbid=("move",))
    assert len(result.changes) == 1
    assert result.changes[0].kind in (Kind.PLACE, Kind.EXCHANGE)
    check(result)


def test_what_is_forbidden_is_not_done() -> None:
    result = repaired(COUNTERWEIGHT, forbid=("order",))
    assert result.stands
    assert Kind.ORDER not in [change.kind for change in result.changes]
    last = repaired(COUNTERWEIGHT, forbid=[kind for kind in Kind if kind is not Kind.LEAVE_OUT])
    assert last.words == ["leave out box 2"]
    assert last.left_out == (2,)
    assert last.plan.n_boxes == 3


def test_what_is_built_stays() -> None:
    result = repaired(COUNTERWEIGHT, built=2)
    assert result.stands
    assert result.plan.item_ids[:2] == ("item-0", "item-1")
    assert (result.plan.corner_mm[:2] == result.before.corner_mm[:2]).all()


STAIR: Sequence[Box] = tuple(((400, 300, 200), (300 * k, 0, 200 * k), 5) for k in range(3))
"""A stair whose second box falls without any further box."""


def test_built_boxes_that_fall_are_told_without_a_search() -> None:
    result = repaired(STAIR, built=2)
    assert result.headline.endswith(
        "no repair was sought, because the boxes that are already built do not stand by themselves"
    )
    assert (result.built_falls, result.complete, result.n_trials) == (True, True, 1)
    assert result.plan is result.before


@pytest.mark.parametrize(("boxes", "built"), [(STAIR, 1), (COUNTERWEIGHT, 2)])
def test_a_search_begins_where_boxes_fall_that_are_not_built(boxes: Sequence[Box], built: int) -> None:
    result = repaired(boxes, built=built)
    assert (result.built_falls, result.stands) == (False, True)


def test_plans_with_too_few_boxes_are_skipped() -> None:
    plans = [make_plan("one", stack(1)), make_plan("two", stack(2))]
    result = petmjx.repair(plans, built=1, **FAST)
    assert [each.plan.plan_id for each in result.each] == ["two"]
    assert [line.partition("plan ")[2] for line in result.skipped] == ["one: built must be less than its 1 box, got 1"]
    with pytest.raises(InputError, match="plan one: built must be less than its 1 box, got 1"):
        petmjx.repair(plans, built=1, strict=True, **FAST)


def test_odd_plans_are_noted_once_under_their_ids() -> None:
    high = make_plan("high", [((400, 300, 200), (0, 0, 900), 5)])
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        petmjx.repair(high, **{**FAST, "worlds": 4})
    (text,) = {str(one.message) for one in issued}
    assert "in plan high the lowest box" in text
    assert len(issued) == 1


def test_repaired_plans_that_are_still_odd_are_noted() -> None:
    plan = make_plan("high", [((400, 300, 200), (0, 0, 0), 5), ((400, 300, 200), (0, 0, 230), 5)])
    high = Repaired(plan, plan, (Film(2.0),), FALLS, FALLS, None, None, 1)
    (note,) = _still_odd_note([high, replace(high, plan=make_plan())])
    assert note.startswith("1 repaired plan still has overlapping or floating boxes")
    assert note.endswith(": high")
    assert _still_odd_note([replace(high, changes=()), replace(high, trial_after=None)]) == []


def test_nothing_helps_where_all_is_forbidden_that_would() -> None:
    result = repaired(COUNTERWEIGHT, forbid=[kind for kind in Kind if kind is not Kind.SHEET], trials=4)
    assert not result.stands
    assert result.plan is result.before
    assert "no repair is known" in result.headline


def test_plans_that_stand_are_left_as_they_are() -> None:
    result = repaired(stack(2))
    assert result.stands
    assert result.changes == ()
    assert result.plan == result.before or (result.plan.corner_mm == result.before.corner_mm).all()
    assert result.headline == "00000001: stands as it is"
    assert Repairs((result,)).summary == "1 plan stands as it is"


def test_plans_are_repaired_the_same_alone_and_together() -> None:
    plans = [make_plan(str(k), boxes) for k, boxes in enumerate((COUNTERWEIGHT, LATE_SUPPORT, stack(2)))]
    starts, ended = list[RunStart](), list[str]()
    together = petmjx.repair(plans, **FAST, watcher=SimpleNamespace(begin=starts.append, world_done=ended.append))
    assert sorted(ended) == ["0", "1", "2"]
    (start,) = starts
    assert (start.total, start.choice.name, start.choice.reason) == (3, "mujoco", "as asked for")
    assert re.fullmatch(r"3 plans, about .* steps, about \d+ s", start.size)
    assert [r.words for r in together.each] == [petmjx.repair(plan, **FAST).each[0].words for plan in plans]
    assert together.table[["before", "after"]].values.tolist() == [["unstable", "stable"]] * 2 + [["stable"] * 2]
    assert together.summary == "2 plans of 3 do not stand; 2 can be repaired; changes: 1 in the median"


def test_shares_with_errors_are_those_of_a_score() -> None:
    plan = make_plan(boxes=LATE_SUPPORT)
    (result,) = petmjx.repair(plan, **{**FAST, "worlds": 4}, forbid=[k for k in Kind if k is not Kind.ORDER]).each
    summary = petmjx.score(result.plan, engine="mujoco", threads=1, confidence=4).summary
    assert summary is not None
    assert result.share_before == (4, 0)
    assert result.share_after == (4, summary.n_standing[0])


def test_the_least_film_that_holds_is_used() -> None:
    """A carton of 300 mm slides on the carrier beyond μ·g = 0.5 g. The number of turns of film in the repair is the
    smallest number that holds the carton."""
    plan = make_plan(boxes=[((300, 300, 100), (0, 0, 0), 20)])
    options = {**FAST, "profile": "eumos-40509", "level": 0.8, "forbid": [k for k in Kind if k is not Kind.FILM]}
    (result,) = petmjx.repair(plan, **options).each
    assert result.words == [f"wrap the pallet with {result.film_turns:g} turns of film"]
    for turns, stands in ((result.film_turns, True), (result.film_turns - 1, False)):
        (again,) = petmjx.repair(plan, **options, wrap={"turns": turns}).each
        assert again.trial_before.stands == stands


@pytest.mark.parametrize("trials", [1, 5, 6, 12])
def test_film_is_kept_if_the_trials_are_spent(trials: int) -> None:
    """With a profile, a search has a sixth of the trials, but at least one. The first trial has the most turns, which
    hold the carton."""
    plan = make_plan(boxes=[((300, 300, 100), (0, 0, 0), 20)])
    (result,) = petmjx.repair(plan, **{**FAST, "trials": trials}, profile="eumos-40509", level=0.8, most_turns=40).each
    n_trials = max(trials // 6, 1)
    assert (result.n_trials, result.film_turns) == (n_trials, 40 // n_trials)
    assert (result.stands, result.trials_spent, result.left_out) == (True, True, ())


# ---------------------------------------------------------------------- drafts (plans with changes) and rules


def test_a_draft_without_changes_is_the_plan() -> None:
    plan = replace(make_plan(boxes=COUNTERWEIGHT), materials=("cardboard",) * 4, orientation=np.array([0, 1, 0, 1]))
    same = Draft.of(plan).as_plan()
    for name in Plan.__dataclass_fields__:
        assert np.array_equal(getattr(same, name), getattr(plan, name)), name


def test_a_turned_box_keeps_its_contents() -> None:
    """The centre of mass stays at the same place within the item, whichever way the box is turned."""
    plan = Plan.from_boxes(
        "p", size_mm=[[400, 200, 100]] * 2, corner_mm=[[0, 0, 0], [0, 300, 0]], mass_kg=[5, 5], orientation=[0, 1],
        com_length_mm=[50, 30], com_width_mm=[20, -10],
    )  # fmt: skip
    for box in (0, 1):
        turned = Draft.of(plan).with_turn(box, True)
        after = turned.as_plan()
        assert after.size_mm[box].tolist() == [200, 400, 100]
        assert np.allclose(after.item_com_mm, plan.item_com_mm)
        assert np.allclose(after.item_size_mm, plan.item_size_mm)
        assert np.array_equal(turned.with_turn(box, False).as_plan().mass_center_mm, plan.mass_center_mm)


def test_a_moved_box_keeps_its_properties_and_needs_another_approach() -> None:
    properties = {
        "stiffness_n_mm": [100.0, 200.0, 300.0],
        "strength_n": [400.0, 500.0, np.nan],
        "approach_deg": [0.0, 90.0, 180.0],
    }
    boxes = [((200, 200, 200), (300 * k, 0, 0), 5) for k in range(3)]
    plan = replace(make_plan(boxes=boxes), **{name: np.array(values) for name, values in properties.items()})
    changes = (Order(2, 0), Place(1, (300.0, 400.0, 0.0), turned=False), Sheet((0, 0, 200), (200, 200, 3), 0.5, 1))
    draft = applied(Draft.of(plan), changes)
    assert draft is not None
    assert draft.order == (2, 0, 3, 1), "box 3 is the sheet"
    after = draft.as_plan()
    np.testing.assert_array_equal(after.stiffness_n_mm, [300, 100, np.nan, 200])
    np.testing.assert_array_equal(after.strength_n, [np.nan, 400, np.nan, 500])
    np.testing.assert_array_equal(after.approach_deg, [180, 0, np.nan, np.nan])


def test_a_sheet_raises_what_lies_on_it() -> None:
    draft = Draft.of(make_plan(boxes=stack(2)))
    change = Sheet((0.0, 0.0, 200.0), (400.0, 300.0, 3.0), 0.5, 1)
    after = change.applied(draft)
    assert after is not None
    plan = after.as_plan()
    assert plan.sheets.tolist() == [False, True, False]
    assert plan.corner_mm[:, 2].tolist() == [0, 200, 203]
    assert plan.mass_kg[1] == pytest.approx(0.5 * 0.4 * 0.3)
    assert verdict(plan) == "stable"


def allowed(boxes: Sequence[Box], *changes: Any, built: int = 0, most_mm: float = 2000.0) -> bool:
    plan = make_plan(boxes=boxes)
    draft = applied(Draft.of(plan), changes)
    assert draft is not None
    return bool(Rules(plan, Simulation(carrier="euro-pallet"), most_mm, built).allow([draft])[0])


def test_rules_know_what_a_changed_plan_may_not_do() -> None:
    pair: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5), ((400, 300, 200), (400, 0, 0), 5), *stack(2)[1:])
    assert allowed(pair)
    assert not allowed(pair, Move(1, -10.0, 0.0)), "boxes overlap"
    assert allowed(pair, Move(1, 30.0, 0.0))
    assert not allowed(pair, Move(1, 401.0, 0.0)), "beyond the carrier of 1200 mm"
    assert not allowed(pair, Move(1, 0.0, -1.0)), "beyond its front"
    assert not allowed(pair, LeaveOut(0)), "box 2 floats"
    assert not allowed(pair, Order(2, 0)), "box 2 floats when it is placed"
    assert not allowed(pair, Place(1, (0.0, 0.0, 400.0), False), most_mm=500.0), "too high"
    assert allowed(pair, Place(1, (0.0, 0.0, 400.0), False, 2), most_mm=600.0)
    assert not allowed(pair, Place(1, (0.0, 0.0, 400.0), False)), "placed before the box below"
    assert not allowed(pair, Move(0, 0.0, 0.0, ()), Turn(0, 0.0, 0.0), built=1), "box 0 stands already"
    assert not allowed(pair, Order(1, 0), built=1), "box 0 stands already"
    bridge: Sequence[Box] = (*LATE_SUPPORT[:1], LATE_SUPPORT[2], LATE_SUPPORT[1])
    assert allowed(bridge)
    assert not allowed(bridge, Order(1, 2, after=True)), "a robot cannot get under the board"


def test_odd_plans_may_stay_as_odd() -> None:
    floating: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5), ((400, 300, 200), (0, 0, 230), 5))
    assert allowed(floating)
    assert allowed(floating, Place(1, (0.0, 0.0, 200.0), False))
    assert not allowed(floating, Place(1, (0.0, 0.0, 240.0), False))


def test_changes_of_one_box_become_one() -> None:
    joined = partial(with_change, start=Draft.of(make_plan(boxes=COUNTERWEIGHT)))
    first, second = Move(1, 20.0, 0.0), Move(1, 0.0, -5.0)
    assert joined((first,), second) == (Move(1, 20.0, -5.0),)
    assert Move(1, 20.0, -5.0).words == "move box 1 by 20 mm to the right and 5 mm to the front"
    assert joined((first, Order(2, 3)), second) == (Move(1, 20.0, -5.0), Order(2, 3))
    place = Place(1, (0.0, 0.0, 200.0), False, others=(2,))
    assert joined((place,), Move(1, 4.0, 0.0, (2,))) == (replace(place, corner_mm=(4.0, 0.0, 200.0)),)
    assert joined((place,), first) == (place, first), "the box on it stays"
    assert joined((Turn(1, 5.0, 6.0),), second) == (Turn(1, 5.0, 1.0),)
    assert joined((first,), LeaveOut(1)) == (LeaveOut(1),)
    assert joined((Film(4.0),), Film(3.0)) == (Film(3.0),)
    assert joined((first,), Move(2, 1.0, 0.0)) == (first, Move(2, 1.0, 0.0))
    assert joined((Order(1, 4),), Order(1, 3, after=True)) == (Order(1, 3, after=True),)
    assert joined((Order(1, 4),), Order(2, 3)) == (Order(1, 4), Order(2, 3))
    assert joined((first, Order(2, 3)), Move(1, -20.0, 0.0)) == (Order(2, 3),), "back where it was"


def test_two_turns_of_a_box_are_a_move() -> None:
    """The user forbids moves, and the search turned a box by 90° twice, so that it stood 100 mm further left."""
    plan = make_plan(boxes=COUNTERWEIGHT)
    joined = partial(with_change, start=Draft.of(plan))
    there, back = Turn(3, -100.0, 0.0), Turn(3, -50.0, 0.0)
    assert joined((there, Order(3, 2)), back) == (Order(3, 2), Move(3, -50.0, 0.0))
    assert joined((Move(3, 20.0, 5.0), there), back) == (Move(3, -50.0, 0.0),)
    assert joined((there,), Turn(3, 0.0, 0.0)) == ()
    place = Place(3, (0.0, 0.0, 0.0), turned=True)
    assert joined((place,), back) == (replace(place, corner_mm=(-50.0, 0.0, 0.0), turned=False),)
    for forbid, n_candidates in (((), 1), (("move",), 0)):
        search = Search(plan, Simulation(), RepairOptions(forbid=forbid, worlds=0))
        draft = applied(Draft.of(plan), [there])
        assert draft is not None
        assert len(search._ranked(Node(State(draft, (there,), FALLS)), [], [(Turn(3, 5.0, 0.0),)])) == n_candidates


def test_all_moves_of_a_box_together_keep_the_limit() -> None:
    """Each move kept the limit, but moves of one box became one move that was longer."""
    plan = make_plan(boxes=COUNTERWEIGHT)
    start, first = Draft.of(plan), Move(2, -6.0, 0.0)
    search = Search(plan, Simulation(), RepairOptions(most_move_mm=8.0, worlds=0))
    draft = applied(start, [first])
    assert draft is not None
    second, too_far = Move(2, -1.0, 0.0), Move(2, -3.0, 0.0)
    ranked = search._ranked(Node(State(draft, (first,), FALLS)), [], [(second,), (too_far,)])
    assert [candidate.changes for candidate in ranked] == [(Move(2, -7.0, 0.0),)]
    lists: list[tuple[Change, ...]] = [(first, too_far), (first,)]
    states = result_of(search._trials_of(lists), lambda drafts: [FALLS for _ in drafts])
    assert [state.changes for state in states] == [(first,)]
    assert longest_move_mm([Move(2, 80.0, -90.0), Move(3, 50.0, 0.0, (2,)), Turn(1, 0.0, 0.0)], start) == 130
    assert longest_move_mm([Turn(2, 60.0, 150.0)], start) == 0, "about its back-left corner"
    assert longest_move_mm([Turn(2, 40.0, 155.0)], start) == 20


def test_exchanged_boxes_have_each_others_place_and_time() -> None:
    plan = make_plan(boxes=COUNTERWEIGHT)
    change = Exchange(2, 3, ((0.0, 0.0, 400.0), (210.0, 0.0, 400.0)), (False, False))
    draft = change.applied(Draft.of(plan))
    assert draft is not None
    assert draft.order == (0, 1, 3, 2)
    assert draft.corner_mm[2].tolist() == [0, 0, 400]
    assert change.words == "exchange boxes 2 and 3, also in the packing order"


def test_each_change_has_its_places_in_numbers() -> None:
    plan = make_plan(boxes=COUNTERWEIGHT)
    sheet = Sheet((0.0, 0.0, 400.0), (360.0, 300.0, 3.0), 0.5, before=2)
    exchange = Exchange(2, 3, ((0.0, 0.0, 400.0), (210.0, 0.0, 400.0)), (False, False))
    changes = (exchange, Turn(2, 30.0, 5.0), sheet, Film(2.0), LeaveOut(3))
    result = Repaired(plan, plan, changes, FALLS, FALLS, None, None, 1)
    table = Repairs((result,)).changes
    assert [table[name].tolist() for name in ("x_mm", "y_mm", "z_mm", "turned", "position")] == [
        [(0.0, 210.0), (30.0,), (0.0,), (), ()],
        [(0.0, 0.0), (5.0,), (0.0,), (), ()],
        [(400.0, 400.0), (400.0,), (400.0,), (), ()],
        [(False, False), (True,), (False,), (), ()],
        [(3, 2), (3,), (3,), (), ()],
    ]
    assert "places are those of front-left-bottom corners, mm" in Repairs((result,)).frame
    assert Repairs((replace(result, changes=(exchange,)),)).frame == ""


def test_statics_names_the_box_that_is_too_much() -> None:
    (balance,) = balances([Draft.of(make_plan(boxes=COUNTERWEIGHT))], Simulation())
    assert (balance.box.tolist(), balance.step.tolist(), balance.cause.tolist()) == ([1], [2], [2])
    # 2 kg at x = 180 mm and 6 kg at 285 mm, on a box that ends at 200 mm (boxes are 0.1 mm smaller than planned)
    assert balance.depth_mm[0] == pytest.approx((2 * 180 + 6 * 285) / 8 - 200, abs=0.2)
    assert balance.last_mm[0] > 0


def test_a_search_asks_for_the_same_worlds_again() -> None:
    """Two searches simulate the same worlds, since the worlds depend only on the plan and the options, not on which
    worlds are simulated first."""
    plan, requests = make_plan(boxes=TOWER), []
    for _ in range(2):
        question = Question({"engine": "mujoco", "threads": 1 + len(requests)}, RepairOptions(worlds=0))
        search = Search(plan, Simulation(), RepairOptions(worlds=0, trials=20))
        drafts: list[bytes] = []

        def ask(some: list[TrialRequest], question: Question = question, drafts: list[bytes] = drafts) -> list[Trial]:
            drafts.extend(key_of(one.draft) for one in some)
            return question.trials(some)

        result_of(search.run(), ask)
        requests.append(drafts)
    assert requests[0] == requests[1]
    assert len(requests[0]) > 6, "more than one round"


def test_a_draft_is_judged_as_it_is_scored() -> None:
    """A judged world ends when a box tilts by 5°. The judged world has the verdict and the culprit of the whole
    simulation. An exception is the counterweight: its support tilts by 5° before the first box fails."""
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0))
    drafts = [Draft.of(make_plan(boxes=boxes)) for boxes in (COUNTERWEIGHT, TOWER, LATE_SUPPORT, stack(2))]
    judged = question.trials([TrialRequest(draft, True) for draft in drafts])
    scored = question.trials([TrialRequest(draft, False) for draft in drafts])
    assert [trial.stands for trial in judged] == [trial.stands for trial in scored] == [False, False, False, True]
    assert [t.culprit for t in judged[1:]] == [t.culprit for t in scored[1:]]
    assert (judged[0].culprit, scored[0].culprit) == (1, 2)
    assert judged[0].n_held == 3 <= judged[0].n_placed, "the third box is too much for the second one"


def test_a_judged_plan_that_stands_is_not_simulated_again_for_its_score(monkeypatch: pytest.MonkeyPatch) -> None:
    """The judged world of a draft and the first attempt of its score are the same world, so their margins are equal,
    too."""
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0))
    drafts = [Draft.of(make_plan(boxes=boxes)) for boxes in (stack(2), stack(3, 90.0), TOWER)]
    judged = question.trials([TrialRequest(draft, True) for draft in drafts])
    scored = question.trials([TrialRequest(draft, False) for draft in drafts])
    assert [trial.is_score for trial in judged] == [True, True, False]
    assert [trial._replace(is_score=False) for trial in judged[:2]] == scored[:2]
    monkeypatch.setattr(question, "scores", None)
    known = [TrialRequest(draft, False, judged=trial) for draft, trial in zip(drafts, judged, strict=True)][:2]
    assert question.trials(known) == judged[:2]


def test_drafts_join_the_worlds_that_are_being_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A request that follows from an answer is simulated in the same run of the engine. Scores have a run of their
    own, once no draft is being judged."""
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0))
    runs = []

    def counted(*arguments: Any) -> Iterator[Any]:
        runs.append("judged")
        return outcomes_of_stream(*arguments)

    scores = question.scores
    monkeypatch.setattr("petmjx.repairs.trials.outcomes_of_stream", counted)
    monkeypatch.setattr(question, "scores", lambda requests, _: [runs.append("scored"), *scores(requests)][1:])
    draft = Draft.of(make_plan(boxes=stack(2)))
    stream = TrialStream(question)
    stream.put("score", [TrialRequest(draft, False)])
    stream.put("first", [TrialRequest(draft, True)] * 2)
    tickets = []
    for answer in stream.answers():
        if answer is not None:
            tickets.append(answer.ticket)
            assert all(trial.stands for trial in answer.trials)
            if answer.ticket == "first":
                stream.put("second", [TrialRequest(draft, True)])
    assert sorted(tickets) == ["first", "score", "second"]
    assert sorted(runs) == ["judged", "scored"]
    assert tickets.index("first") < tickets.index("second")
    assert question.progress.shown_message == "4 trials"
    assert question.progress.message == "", "engines set the message back to an earlier one"


Ask = Callable[[list[TrialRequest]], list[Trial]]


def result_of(steps: Steps[Any], ask: Ask) -> Any:
    """What a part of a search returns, if its drafts have the trials that ``ask`` returns."""
    results = []

    def noting() -> Steps[None]:
        results.append((yield from steps))

    tasks = Tasks([noting()])
    while tasks.batches:
        batches, tasks.batches = tasks.batches, []
        for ticket, requests in batches:
            tasks.take(TrialAnswer(ticket, ask(requests)))
    return results[0]


class Simulated:
    """A simulator of searches: a function instead of an engine."""

    def __init__(self, ask: Ask) -> None:
        self._ask, self._batches = ask, list[tuple[Any, Sequence[TrialRequest]]]()

    def put(self, ticket: Any, requests: Sequence[TrialRequest]) -> None:
        self._batches.append((ticket, requests))

    def answers(self) -> Iterator[TrialAnswer | None]:
        while self._batches:
            batches, self._batches = self._batches, []
            for ticket, requests in batches:
                yield TrialAnswer(ticket, self._ask([*requests]))
            yield None


def test_parts_of_a_search_wait_only_for_their_own_trials() -> None:
    draft = Draft.of(make_plan(boxes=stack(2)))

    def part(name: str, n_requests: int) -> Steps[str]:
        for number in range(n_requests):
            (trial,) = yield [TrialRequest(draft, True, number)]
            assert trial == (name, number)
        return name

    def whole() -> Steps[list[str]]:
        assert (yield Together([])) == []
        results: list[str] = yield Together([part("long", 3), part("short", 1), part("none", 0)])
        return results

    results = []

    def noting() -> Steps[None]:
        results.append((yield from whole()))

    tasks = Tasks([noting()])
    (long_part, _), (short_part, _) = tasks.batches
    for number in range(3):
        tasks.take(TrialAnswer(long_part, [("long", number)]))  # type: ignore[list-item]
        long_part, (request,) = tasks.batches[-1]
        assert request.world == min(number + 1, 2)
    assert not results
    tasks.take(TrialAnswer(short_part, [("short", 0)]))  # type: ignore[list-item]
    assert results == [["long", "short", "none"]]


def test_any_number_of_rounds_without_simulations_may_follow_one_another() -> None:
    def part() -> Steps[str]:
        return "known"
        yield  # a generator without requests

    def search() -> Steps[None]:
        for _ in range(5000):
            rounds.append((yield Together([part()])))

    rounds: list[list[str]] = []
    tasks = Tasks([search()])
    assert rounds == [["known"]] * 5000
    assert not tasks.batches


def test_only_changes_that_are_needed_are_left() -> None:
    """Two of sixteen moves are needed. The search undoes groups of changes before single changes, so it needs fewer
    trials than if it undid the changes one by one."""
    plan = make_plan(boxes=[((100, 100, 100), (150 * k, 0, 0), 1) for k in range(16)])
    search = Search(plan, Simulation(), RepairOptions(worlds=0))
    changes = tuple(Move(k, 20.0, 0.0) for k in reversed(range(16)))
    draft = applied(Draft.of(plan), changes)
    assert draft is not None

    def stands(draft: Draft) -> bool:
        return bool((draft.corner_mm[[3, 12], 0] == plan.corner_mm[[3, 12], 0] + 20).all())

    requests = list[TrialRequest]()

    def ask(drafts: list[TrialRequest]) -> list[Trial]:
        requests.extend(drafts)
        good = [stands(one.draft) for one in drafts]
        return [Trial("stable" if g else "unstable", "", None, (), 16, 16, 0.0) for g in good]

    result_of(search._finished([State(draft, changes, Trial("stable", "", None, (), 16, 16, 0.0))]), ask)
    (repair,) = search.repairs
    assert [change.boxes for change in repair.changes] == [(12,), (3,)]
    assert len(requests) < 50, "one by one it is up to 16 + 15 + … + 3 = 133"


def test_of_repairs_with_as_many_changes_the_one_that_stands_with_errors_is_first() -> None:
    """The upper box of a stack can be moved to the edge of balance, or well inside, where it also stands with
    errors."""
    plan = make_plan(boxes=stack(2, 230.0))
    search = Search(plan, Simulation(), RepairOptions(worlds=4))
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=4))
    moves = [Move(1, -float(length), 0.0) for length in (32, 150)]
    drafts = [draft for move in moves if (draft := move.applied(Draft.of(plan))) is not None]
    trials = question.trials([TrialRequest(draft, is_judged=False) for draft in drafts])
    assert [trial.stands for trial in trials] == [True, True]
    states = [State(draft, (move,), trial) for draft, move, trial in zip(drafts, moves, trials, strict=True)]
    requests = list[TrialRequest]()

    def ask(drafts: list[TrialRequest]) -> list[Trial]:
        requests.extend(drafts)
        return question.trials(drafts)

    best, worst = result_of(search._compared(states, states[:1]), ask)
    assert sorted({one.world for one in requests}) == [1, 2, 3, 4]
    assert len(requests) == 8
    assert (best.changes, worst.changes) == ((moves[1],), (moves[0],))
    assert best.n_good == 4 > worst.n_good


@pytest.mark.parametrize(
    ("stands_in", "n_requests"),
    [
        pytest.param(lambda place, world: True, 4 + 4 * 3, id="all"),
        pytest.param(lambda place, world: place >= 4, 8 + 4 * 3, id="all but the first four"),
        pytest.param(lambda place, world: world == 1, 4 + 4 * 3, id="the first world"),
        pytest.param(lambda place, world: False, 10 + 4 * 3, id="none"),
    ],
)
def test_repairs_are_compared_until_enough_of_them_stand(
    stands_in: Callable[[int, int], bool], n_requests: int
) -> None:
    """Ten repairs are judged in the first world with errors, four at once in the order of statics, until four of them
    stand. Four are then judged in three further worlds."""
    plan = make_plan(boxes=stack(2))
    search, stands = Search(plan, Simulation(), RepairOptions(worlds=4)), Trial("stable", "", None, (), 2, 2, 0.5)
    moves = [Move(box, float(length), 0.0) for box in (0, 1) for length in range(5, 30, 5)]
    drafts = [draft for move in moves if (draft := move.applied(Draft.of(plan))) is not None]
    states = [State(draft, (move,), stands) for draft, move in zip(drafts, moves, strict=True)]
    places = {key_of(states[k].draft): place for place, k in enumerate(search._safest(states))}
    requests = list[TrialRequest]()

    def ask(some: list[TrialRequest]) -> list[Trial]:
        requests.extend(some)
        good = [stands_in(places[key_of(one.draft)], one.world) for one in some]
        return [stands if is_good else stands._replace(verdict="unstable") for is_good in good]

    compared = result_of(search._compared(states, states), ask)
    assert len(requests) == n_requests
    assert [state.n_good for state in compared] == [sum(stands_in(4, world) for world in range(1, 5))] * 4
    result_of(search._compared(states, states), ask)
    assert len(requests) == n_requests, "no world is simulated twice"


def test_a_repair_that_falls_with_errors_is_changed_further() -> None:
    """The repair mends one fault. A second stack stands as planned, but with its load only half a millimetre inside the
    edge, so it falls with many errors. The box of this stack is moved inside, too, but only if a share with errors is
    required, and only if both changes are needed."""
    plan = make_plan(boxes=(*stack(2, 230.0), *stack(2, 199.5, at_mm=(0.0, 500.0))))
    moves = Move(1, -60.0, 0.0), Move(0, 0.0, 40.0, (1,))
    draft = applied(Draft.of(plan), moves)
    assert draft is not None
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions())
    (trial,) = question.trials([TrialRequest(draft, is_judged=False)])
    assert trial.stands
    repairs = {}
    for share in (0.25, 1.0):
        search = Search(plan, Simulation(), RepairOptions(share=share, forbid=("exchange", "place", "turn", "order")))
        search.repairs = (State(draft, moves, trial),)
        result_of(search._strengthened(), question.trials)
        repairs[share] = search.repairs[0]
    assert repairs[0.25].changes == moves
    assert 2 <= repairs[0.25].n_good < 8, "about half of the worlds"
    first, second = repairs[1.0].changes
    assert first == moves[0], "the second of the moves was of no use"
    assert second.boxes[0] in (2, 3)
    assert repairs[1.0].n_good == 8
    (balance,) = balances([repairs[1.0].draft], Simulation())
    assert balance.weakness < 0.5


@pytest.mark.parametrize(("is_wide", "rounds"), [(False, [5, 5]), (True, [10])])
def test_few_worlds_with_errors_are_simulated_for_changes_that_do_not_help(is_wide: bool, rounds: list[int]) -> None:
    """The weak plan falls in worlds 2, 5 and 7. Of six moves, the first one stands in worlds 2 and 7, and the third one
    in world 5. At most four plans are judged at once in one of these worlds. On a GPU, two plans are judged in all
    worlds at once."""
    plan = make_plan(boxes=stack(2))
    search, start = Search(plan, Simulation(), RepairOptions(), is_wide=is_wide), Draft.of(plan)
    stands = Trial("stable", "", None, (), 2, 2, 0.5)
    falls = dict.fromkeys((2, 5, 7), Trial("unstable", "tilt", 1, (1,), 2, 1, -1.0))
    weak = State(start, (), stands, errors={world: falls.get(world, stands) for world in range(1, 9)})
    moves = [Move(1, float(length), 0.0) for length in (5, 10, 15, 20, 25, 30)]
    drafts = {move: draft for move in moves if (draft := move.applied(start)) is not None}
    batch = [Candidate(draft, (move,), (move,), 0.0, Node(weak)) for move, draft in drafts.items()]
    sizes = []

    def ask(requests: list[TrialRequest]) -> list[Trial]:
        sizes.append(len(requests))
        trials = []
        for one in requests:
            number = next(k for k, draft in enumerate(drafts.values()) if key_of(draft) == key_of(one.draft))
            helps = {2: number == 0, 5: number == 2, 7: number == 0}.get(one.world, True)
            trials.append(stands if helps else falls[one.world])
        return trials

    better = result_of(search._stronger(weak, batch, 8), ask)
    assert [state.changes for state in better] == [(moves[0],), (moves[2],)]
    assert [state.n_good for state in better] == [7, 6]
    in_world_2, in_world_5, in_world_7 = [4, 2], [4, 1], [4]
    assert sizes == [6, *in_world_2, *in_world_5, *in_world_7, 3, *rounds]


def test_a_box_that_is_lowered_between_two_others_gets_room() -> None:
    plan = make_plan(boxes=[((200, 200, 200), (x, 0, 0), 5) for x in (0, 402, 201)])
    draft, rules = Draft.of(plan), Rules(make_plan(), Simulation(), 2000.0, 0)
    (balance,) = balances([draft], Simulation())
    assert balance.squeezed == (2,)
    assert balance.weakness == pytest.approx(1 - 2 / ROOM_MM)
    kinds = frozenset({Kind.ORDER, Kind.MOVE})
    some = [*proposals(draft, rules, [Target(2, 2, is_squeezed=True)], kinds, RepairOptions())]
    assert set(some) > {(Order(2, 0),), (Order(2, 1),), (Order(1, 2, after=True),), (Move(1, 7.0, 0.0),)}
    assert (Move(0, -7.0, 0.0),) in some, "whether a box may reach so far is for the rules to say"
    drafts = [one for p in ((Order(2, 1),), (Move(1, 7.0, 0.0),)) if (one := applied(draft, p)) is not None]
    assert [balance.squeezed for balance in balances(drafts, Simulation())] == [(), ()]


@pytest.mark.parametrize(("is_wide", "judged"), [(False, [False, False]), (True, [True, True, False])])
def test_boxes_are_left_out_until_the_rest_stands(is_wide: bool, judged: list[bool]) -> None:
    """The tops of two stacks fall. A GPU judges each plan, and only scores the plan that stands when judged."""
    plan, requests = make_plan(boxes=[*stack(2), *stack(2, at_mm=(0.0, 500.0))]), list[TrialRequest]()

    def ask(some: list[TrialRequest]) -> list[Trial]:
        requests.extend(some)
        return [trial_of(one.draft) for one in some]

    def trial_of(draft: Draft) -> Trial:
        if falls := [box for box in (1, 3) if box in draft.order]:
            return Trial("unstable", "tilt", falls[0], (falls[0],), falls[0] + 1, falls[0], -1.0)
        return Trial("stable", "", None, (), 2, 2, 1.0)

    start = Draft.of(plan)
    search = Search(plan, Simulation(), RepairOptions(worlds=0), is_wide=is_wide)
    (left,) = result_of(search._stripped(State(start, (), trial_of(start))), ask)
    assert [change.boxes for change in left.changes] == [(1,), (3,)]
    assert [one.is_judged for one in requests] == judged


def test_a_box_that_is_left_out_pushes_no_others() -> None:
    draft = Draft.of(make_plan(boxes=[((200, 200, 200), (200 * k, 0, 0), 5) for k in range(3)]))
    gap, rules = draft.without(1), Rules(make_plan(), Simulation(), 2000.0, 0)
    assert gap is not None
    of_row, of_gap = (
        {*proposals(one, rules, [Target(0, 0)], frozenset({Kind.MOVE}), RepairOptions())} for one in (draft, gap)
    )
    assert (Move(0, 45.0, 0.0, (1, 2)),) in of_row
    assert (Move(0, 45.0, 0.0),) in of_gap
    assert not any(move.others for (move,) in of_gap if isinstance(move, Move))


def test_statics_of_a_draft_does_not_depend_on_the_drafts_beside_it() -> None:
    drafts = [
        Draft.of(make_plan(boxes=boxes)) for boxes in (COUNTERWEIGHT, stack(1), TOWER, stack(2, 190.0), TOWER[:3])
    ]
    for spare_mm in (0.0, 12.0):
        together = balances(drafts, Simulation(), spare_mm=spare_mm)
        for draft, balance in zip(drafts, together, strict=True):
            (alone,) = balances([draft], Simulation(), spare_mm=spare_mm)
            assert all(np.array_equal(one, other) for one, other in zip(alone, balance, strict=True))
    assert together[3].last_mm[0] == pytest.approx(10 - 12, abs=0.2), "200 mm of 400 may hang over, 190 do"


TWO_FAULTS: Sequence[Box] = (*stack(3, 230.0), *stack(2, 230.0, at_mm=(0.0, 600.0)))
"""Two stacks, each with a box that has more than half of its length beyond the box below. In the first stack, a third
box lies on this box."""


def test_faults_are_counted_by_taking_off_what_falls() -> None:
    search = Search(make_plan(boxes=TWO_FAULTS), Simulation(), RepairOptions(worlds=0))
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0))
    moves = (), (Move(1, -60.0, 0.0),), (Move(1, -60.0, 0.0), Move(4, -60.0, 0.0))
    drafts = [draft for changes in moves if (draft := applied(Draft.of(search.plan), changes)) is not None]
    trials = question.trials([TrialRequest(draft, True) for draft in drafts])
    requests = []

    def ask(drafts: list[TrialRequest]) -> list[Trial]:
        requests.append([one.draft.order for one in drafts])
        return question.trials(drafts)

    nodes = [Node(State(draft, (), trial)) for draft, trial in zip(drafts, trials, strict=True)]
    result_of(search._count_faults(nodes), ask)
    assert [node.faults for node in nodes] == [(Fault(1, 1), Fault(4, 1)), (Fault(4, 1),), ()]
    assert [node.n_faults for node in nodes] == [2, 1, 0]
    # with the box on it, which loses its hold
    assert requests == [[(0, 3, 4)], [(0, 1, 2, 3)], [(0, 3)]], "the plans do not wait for one another"


def test_faults_of_a_changed_plan_follow_from_those_of_the_plan_before() -> None:
    """Faults before the box that falls are mended, and a new fault leaves those that come later."""
    plan = make_plan(boxes=[((100, 100, 100), (150 * k, 0, 0), 1) for k in range(9)])
    search, start = Search(plan, Simulation(), RepairOptions(worlds=0)), Draft.of(plan)
    falls = Trial("unstable", "tilt", 2, (2,), 3, 2, -1.0)
    before = Node(State(start, (), falls), (Fault(2, 1.0), Fault(5, 2.0), Fault(7, 1.0)))

    def remaining(trial: Trial) -> list[tuple[int, float]]:
        return [*search._remaining(State(start, (), trial), before)]

    assert remaining(falls._replace(verdict="stable", culprit=None)) == []
    assert remaining(falls) == [(2, 1), (5, 2), (7, 1)]
    assert remaining(falls._replace(culprit=5)) == [(5, 2), (7, 1)]
    assert remaining(falls._replace(culprit=6)) == [(6, 1), (7, 1)]


def test_no_draft_is_judged_twice() -> None:
    search = Search(make_plan(boxes=stack(2)), Simulation(), RepairOptions(worlds=0))
    drafts = [draft for x in (5.0, 9.0, 5.0) if (draft := Move(1, x, 0.0).applied(Draft.of(search.plan))) is not None]
    requests = list[TrialRequest]()

    def ask(some: list[TrialRequest]) -> list[Trial]:
        requests.extend(some)
        return [Trial("stable", "", None, (), 2, 2, float(one.draft.corner_mm[1, 0])) for one in some]

    for _ in range(2):
        trials = result_of(search._simulated(drafts, judged=True), ask)
        assert [trial.margin for trial in trials] == [one.corner_mm[1, 0] for one in drafts]
    assert (len(requests), search.n_trials) == (2, 2)


def test_a_plan_that_begins_as_one_that_fell_is_not_simulated() -> None:
    """The third box of a stair falls, before the fourth one is placed. The third box falls in the same way wherever the
    fourth box is placed, but not if a box below is moved."""
    plan = make_plan(boxes=TOWER)
    search, question = (
        Search(plan, Simulation(), RepairOptions(worlds=0)),
        Question(FAST_TRIALS, RepairOptions(worlds=0)),
    )
    start, requests = Draft.of(plan), list[TrialRequest]()

    def ask(some: list[TrialRequest]) -> list[Trial]:
        requests.extend(some)
        return question.trials(some)

    def judged(draft: Draft | None) -> Trial:
        assert draft is not None
        (trial,) = result_of(search._simulated([draft], judged=True), ask)
        assert trial[:6] == question.trials([TrialRequest(draft, True)])[0][:6]
        return trial

    falls = judged(start)
    assert (falls.culprit, falls.n_placed) == (2, 3)
    assert judged(Move(3, 60.0, 0.0).applied(start)) == falls
    assert search.n_trials == len(requests) == 1
    assert not search._falls_early(key_of(replace(start, order=(0, 1, 2)))), "after the last box, the wait is another"
    judged(Move(2, -60.0, 0.0).applied(start))
    assert search.n_trials == len(requests) == 2
    node, early = Node(State(start, (), falls)), {}
    for one in (search, Search(plan, Simulation(), RepairOptions(worlds=0))):
        drafts = [c.draft for c in one._changes(node, frozenset({Kind.MOVE}))]
        early[one is search] = [search._falls_early(key_of(draft)) for draft in drafts]
    assert any(early[False]), "another search knows nothing of the fall"
    assert early[True]
    assert not any(early[True])


@pytest.mark.parametrize(("placing", "n_known"), [("exact", 3), ("hand", 4)])
def test_a_box_in_a_hand_may_be_why_a_plan_falls(placing: str, n_known: int) -> None:
    """A carried box does not count as placed, but may push others. So plans with another place of this box are
    simulated. A world without a verdict shows nothing about other plans."""
    plan = make_plan(boxes=stack(6))
    search, start = Search(plan, Simulation(placing=placing), RepairOptions(worlds=0)), Draft.of(plan)
    invalid = FALLS._replace(verdict="invalid", reason="failed", culprit=None, fallen=(), n_placed=0)
    result_of(search._simulated([start], judged=True), lambda some: [invalid] * len(some))
    moved = [one for box in (3, 4) if (one := Move(box, 5.0, 0.0).applied(start)) is not None]
    assert not any(search._falls_early(key_of(draft)) for draft in moved)
    falls = FALLS._replace(n_placed=3)
    result_of(search._simulated(moved[1:], judged=True), lambda some: [falls] * len(some))
    assert [search._falls_early(key_of(draft)) for draft in moved] == [n_known == 3, True]


def test_a_load_that_was_seen_to_hold_counts_little() -> None:
    """The upper boxes of two stacks hang over. The one of the second stack was placed, and leans on something. If this
    box is moved, it may lean no more."""
    plan = make_plan(boxes=(*stack(2, 230.0), *stack(2, 230.0, at_mm=(0.0, 500.0)), ((100, 100, 100), (600, 0, 0), 1)))
    search, start = Search(plan, Simulation(), RepairOptions(worlds=0)), Draft.of(plan)
    (balance,) = balances([start], Simulation())
    assert balance.box.tolist() == [1, 3]
    assert search._expected_trouble(balance, ()) == balance.trouble == pytest.approx(balance.weight.sum())
    search._learn([start], [FALLS._replace(culprit=1, fallen=(1,), n_placed=4)])
    assert search._expected_trouble(balance, ()) == balance.trouble, "the box that was placed last may fall as well"
    search._learn([start], [FALLS._replace(culprit=1, fallen=(1,), n_placed=5)])
    first, second = balance.weight
    assert search._expected_trouble(balance, ()) == pytest.approx(first + HELD * second)
    assert search._expected_trouble(balance, {3}) == balance.trouble
    further = balance._replace(depth_mm=balance.depth_mm + 10)
    assert search._expected_trouble(further, ()) == balance.trouble, (
        "a load farther beyond the edge was not seen to hold"
    )
    search._learn([start], [FALLS._replace(verdict="stable", culprit=None, fallen=(), n_placed=5)])
    assert search._expected_trouble(balance, ()) == pytest.approx(HELD * balance.trouble)


def test_a_change_is_ranked_by_what_remains_of_the_failure() -> None:
    draft = Draft.of(make_plan(boxes=stack(2, 230.0)))
    search = Search(draft.plan, Simulation(), RepairOptions(worlds=0))
    moved = [one for x in (0.0, -15.0, -60.0) if (one := Move(1, x, 0.0).applied(draft)) is not None]
    before, nearer, inside = balances(moved, Simulation())
    depths = {1: before.depth_of(1)}
    share = nearer.depth_of(1) / depths[1]
    assert 0.3 < share < 0.7
    assert [search._unsolved(after, depths, 1) for after in (before, nearer, inside)] == [2.0, 2 * share, 0.0]
    assert search._unsolved(nearer, depths, 0) == share, "the box that fell first is another one"
    assert search._unsolved(nearer, {}, None) == 0.0
    nodes = [
        Node(State(draft, (), FALLS), (Fault(1, 1.0),), n_rounds=n, rank=rank) for n, rank in ((0, 2), (0, 1), (1, 0))
    ]
    nodes[1].queue = [Candidate(draft, (), (Move(1, 5.0, 0.0),), 0.0, nodes[1], unsolved=0.2)]
    assert [node.n_promised for node in nodes] == [1, 1.2, 1.25]
    assert sorted([*reversed(nodes)], key=lambda node: node.key) == nodes


@pytest.mark.parametrize(("is_known", "n_scored"), [(False, 5), (True, 2)])
def test_few_plans_are_scored_once_a_repair_is_known(is_known: bool, n_scored: int) -> None:
    draft = Draft.of(make_plan(boxes=stack(2)))
    search = Search(draft.plan, Simulation(), RepairOptions(worlds=0))
    moves = [Move(1, float(length), 0.0) for length in (5, 10, 15, 20, 25)]
    moved = [one for move in moves if (one := move.applied(draft)) is not None]
    stands = Trial("stable", "", None, (), 2, 2, 0.5)
    states = [State(one, (move,), stands) for one, move in zip(moved, moves, strict=True)]
    every, confirmed = result_of(
        search._confirmed(states, is_known=is_known), lambda some: [FALLS._replace(n_placed=2)] * len(some)
    )
    assert confirmed == []
    assert sum(not state.trial.stands for state in every) == search.n_trials == n_scored


def test_two_changes_are_sought_widely_once_three_are_known() -> None:
    """Each of three boxes falls until it is moved inside. If the first one is moved to the back alone, it leans on
    something, and so does the second one. Statics does not know this, and prefers other moves."""
    plan = make_plan(
        boxes=[*stack(2, 230.0), *stack(2, 230.0, at_mm=(0.0, 400.0)), *stack(2, 230.0, at_mm=(600.0, 0.0))]
    )
    start, requests = Draft.of(plan), list[list[Draft]]()

    def trial_of(draft: Draft) -> Trial:
        (balance,) = balances([draft], Simulation())
        falls = [box for box in (1, 3, 5) if box in balance.box]
        if draft.corner_mm[1, 1] > 0 and draft.corner_mm[1, 0] == start.corner_mm[1, 0]:
            falls = [box for box in falls if box == 5]
        if not falls:
            return Trial("stable", "", None, (), 6, 6, 1.0, is_score=True)
        return Trial("unstable", "tilt", falls[0], (falls[0],), falls[0] + 1, falls[0] + 1, -1.0)

    def ask(some: list[TrialRequest]) -> list[Trial]:
        requests.append([one.draft for one in some])
        return [trial_of(one.draft) for one in some]

    options = RepairOptions(worlds=0, forbid=("exchange", "place", "turn", "order", "sheet"))
    search = Search(plan, Simulation(), options, is_wide=True)
    result_of(search.run(), ask)
    known = next(k for k, drafts in enumerate(requests) if any(trial_of(draft).stands for draft in drafts))
    assert max(map(len, requests[:known])) <= 2 * AT_ONCE < max(map(len, requests[known + 1 :]))
    assert len(search.repairs[0].changes) == 2


@pytest.mark.parametrize(("surplus", "n_changes"), [(0.0, 3), (SURPLUS, 2)])
def test_one_change_may_mend_two_faults(surplus: float, n_changes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three boxes fall. Once box 4 is moved to the left, with boxes 1 and 5, a move of box 3 mends the fault of box 5,
    too. But after the first of these two moves, box 3 falls, and two faults seem to be left."""
    monkeypatch.setattr("petmjx.repairs.search.SURPLUS", surplus)
    plan = make_plan(
        boxes=[*stack(2, 230.0), *stack(2, 230.0, at_mm=(0.0, 400.0)), *stack(2, 230.0, at_mm=(600.0, 0.0))]
    )
    start = Draft.of(plan)

    def trial_of(draft: Draft) -> Trial:
        (balance,) = balances([draft], Simulation())
        falls = [box for box in (1, 3, 5) if box in balance.box]
        if draft.corner_mm[4, 0] < start.corner_mm[4, 0]:
            falls = [box for box in falls if box == 3]
        if not falls:
            return Trial("stable", "", None, (), 6, 6, 1.0, is_score=True)
        return Trial("unstable", "tilt", falls[0], (falls[0],), falls[0] + 1, falls[0] + 1, -1.0)

    options = RepairOptions(worlds=0, forbid=("exchange", "place", "turn", "order", "sheet"))
    search = Search(plan, Simulation(), options, is_wide=True)
    result_of(search.run(), lambda some: [trial_of(one.draft) for one in some])
    assert len(search.repairs[0].changes) == n_changes


@pytest.mark.parametrize("is_score", [True, False])
def test_a_gpu_scores_plans_in_doubt_before_plans_are_built_anew(is_score: bool) -> None:
    """A plan that stands when judged is a repair at once, if its judgement is a score. If it still moves, it is scored
    only if nothing else was found with single changes."""
    plan, scored = make_plan(boxes=stack(2, 230.0)), list[int]()
    falls = Trial("unstable", "tilt", 1, (1,), 2, 2, -1.0)
    stands = Trial("stable", "", None, (), 2, 2, 1.0, is_score=is_score)
    n_judged = 0

    def ask(some: list[TrialRequest]) -> list[Trial]:
        nonlocal n_judged
        if some[0].is_judged:
            n_judged += len(some)
        else:
            scored.append(n_judged)
        return [
            falls if len(balance.box) else stands for balance in balances([one.draft for one in some], Simulation())
        ]

    search = Search(plan, Simulation(), RepairOptions(worlds=0, forbid=("place",)), is_wide=True)
    search.begin(falls)
    result_of(search.run(), ask)
    assert search.repairs[0].trial.stands
    assert len(search.repairs[0].changes) == 1
    if is_score:
        assert scored[0] <= 2 * WIDE_AT_ONCE[0]
    else:
        assert scored[0] >= ALONE * search.options.trials


def test_only_safer_plans_are_judged_beside_one_that_stands() -> None:
    """Without worlds with errors, statics chooses between plans that stand. So no other plans are simulated."""
    draft = Draft.of(make_plan(boxes=stack(2)))
    moves = [Move(1, float(x), 0.0) for x in (4, 8, 12)]
    start = Node(State(draft, (), Trial("unstable", "tilt", 1, (1,), 2, 2, 0.0)))
    made = [one for move in moves if (one := move.applied(draft)) is not None]
    standing = State(made[0], (moves[0],), Trial("stable", "", None, (), 2, 2, 0.5))
    for worlds, expected in ((0, [moves[2]]), (8, [moves[1]])):
        search = Search(draft.plan, Simulation(), RepairOptions(worlds=worlds))
        (risk,) = search._risks([standing])
        ways = zip(made[1:], moves[1:], (risk, (risk[0] - 1, 0)), strict=True)
        queue = [Candidate(one, (move,), (move,), 0.0, start, its) for one, move, its in ways]
        assert [c.changes[0] for c in search._rivals([queue], [standing], 1)] == expected
        assert len(queue) == 1, "what is taken is in the queue no longer"


def test_two_faults_are_mended_by_two_changes() -> None:
    result = repaired(TWO_FAULTS, trials=60)
    assert len(result.changes) == 2
    assert verdict(result.plan) == "stable"


def test_a_gpu_judges_more_plans_at_once() -> None:
    search = Search(make_plan(boxes=TWO_FAULTS), Simulation(), RepairOptions(worlds=0), is_wide=True)
    question, sizes = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0)), list[int]()

    def ask(drafts: list[TrialRequest]) -> list[Trial]:
        sizes.append(len(drafts))
        return question.trials(drafts)

    result_of(search.run(), ask)
    assert search.repairs[0].trial.stands
    assert len(search.repairs[0].changes) == 2
    assert AT_ONCE < max(sizes) <= max(WIDE_AT_ONCE), "more than on CPU threads"


def test_a_search_on_a_gpu_goes_on_in_wider_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is changed, the first box of a plan falls. The search ends after the fifth round, in which it gets no
    candidates."""
    falls, widths = Trial("unstable", "tilt", 0, (0,), 6, 0, -1.0), list[int]()

    def counted(queues: Sequence[list[Candidate]], count: int) -> list[Candidate]:
        widths.append(count)
        return batch_of(queues, count) if len(widths) <= len(WIDE_AT_ONCE) else []

    monkeypatch.setattr("petmjx.repairs.search.batch_of", counted)
    search = Search(make_plan(boxes=stack(6)), Simulation(), RepairOptions(worlds=0), is_wide=True)
    search.begin(falls)
    node = Node(State(Draft.of(search.plan), (), falls), (Fault(0, 1.0),))
    kinds = search.options.kinds - {Kind.LEAVE_OUT}
    standing, _ = result_of(search._changed([node], kinds, 600), lambda some: [falls] * len(some))
    assert standing == []
    assert tuple(widths) == (*WIDE_AT_ONCE, WIDE_AT_ONCE[-1])
    assert WIDE_AT_ONCE[0] < WIDE_AT_ONCE[-1] == search._at_once(30, is_late=False)
    widths.clear()
    result_of(search._changed([node], search.options.kinds, 600), lambda some: [falls] * len(some))
    assert set(widths) == {WIDE_AT_ONCE[-1]}, "boxes are left out after many rounds, so the first round is wide, too"


def test_on_a_gpu_attempt_1_of_all_plans_is_made_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan is scored, after all searches, only if a further attempt may change its verdict. A plan that stands when
    scored has no repair, although it falls in attempt 1. All this is the same in processes."""
    names = ["falls", "leans", "stands"]
    few = [
        make_plan(name, boxes=[((300, 300, 100), (0, 0, 0), 1)] if name == "stands" else COUNTERWEIGHT)
        for name in names
    ]
    many = [replace(plan, plan_id=f"{plan.plan_id} {k}") for plan in few for k in range(4)]
    calls: list[list[str]] = []
    judged: list[str] = []
    make_trial, make_trials, make_jobs = Question.judged, Question.trials, Question.jobs

    def trial_of(question: Question, outcome: Outcome, one: TrialRequest, job: Job, sim: Simulation) -> Trial:
        trial, plan_id = make_trial(question, outcome, one, job, sim), one.draft.plan.plan_id
        if not one.as_score:
            return trial
        judged.append(plan_id[:6].strip())
        return trial._replace(is_score=False, verdict="unstable") if plan_id[:5] == "leans" else trial

    def trials(question: Question, requests: Sequence[TrialRequest], limit: TimeLimit | None = None) -> list[Trial]:
        calls.append([one.draft.plan.plan_id[:6].strip() for one in requests])
        return [
            trial._replace(is_score=False, verdict="stable") if one.draft.plan.plan_id[:5] == "leans" else trial
            for one, trial in zip(requests, make_trials(question, requests, limit), strict=True)
        ]

    def jobs(question: Question, requests: Sequence[TrialRequest]) -> list[Any]:
        if not requests[0].is_judged and requests[0].draft.order == (0, 1, 2, 3):
            scored.append(len(requests))
        return make_jobs(question, requests)

    scored: list[int] = []
    monkeypatch.setattr(Question, "is_wide", True)
    monkeypatch.setattr(Question, "judged", trial_of)
    monkeypatch.setattr(Question, "trials", trials)
    monkeypatch.setattr(Question, "jobs", jobs)
    rows = []
    for plans in (few, many):
        for some in (calls, judged, scored):
            some.clear()
        n = len(plans) // 3
        repairs = petmjx.repair(plans, engine="mjx-warp-cpu", threads=2, worlds=0, trials=40).each
        assert sorted(judged) == [name for name in names for _ in range(n)]
        assert calls == [["leans"] * n]
        assert scored[-1] == n, "all plans together"
        rows.append([(r.trial_before.stands, r.words, r.stands, r.n_trials, r.complete) for r in repairs[::n]])
        falls, leans, stands = repairs[::n]
        assert (falls.trial_before.stands, len(falls.changes), falls.stands) == (False, 1, True)
        assert (leans.trial_before.stands, leans.changes, leans.complete) == (True, (), True)
        assert (stands.changes, stands.n_trials) == ((), 0)
    assert rows[0] == rows[1]


def test_other_ways_to_change_a_plan_come_between_the_amounts_of_one_way() -> None:
    draft = Draft.of(make_plan(boxes=stack(2)))
    changes = [
        Move(0, 5.0, 0.0),
        Move(0, 9.0, 0.0),
        Move(0, 0.0, 7.0),
        Move(1, 5.0, 0.0),
        Order(1, 0),
        Move(1, 7.0, 0.0),
    ]
    ranks = 1.0, 1.0, 1.0, 1.2, 1.7, 4.0
    start = Node(State(draft, (), FALLS))
    pairs = zip(changes, ranks, strict=True)
    ranked = [Candidate(draft, (change,), (change,), rank, start) for change, rank in pairs]
    queue = spread(ranked)
    assert [c.changes[0] for c in queue] == [changes[k] for k in (0, 3, 1, 4, 2, 5)]
    assert [c.changes[0] for c in batch_of([queue], 2)] == [changes[0], changes[3]]
    assert [c.changes[0] for c in queue] == [changes[k] for k in (1, 4, 2, 5)], "the rest waits"


def test_a_plan_with_faults_all_over_is_built_anew() -> None:
    """The third box of a stair goes beyond the edge. The third box is put elsewhere, if necessary together with the box
    on it. The boxes below keep their places, and in the best result no load is beyond an edge."""
    draft = Draft.of(make_plan(boxes=TOWER))
    rules, sim = Rules(draft.plan, Simulation(), 2000.0, built=2), Simulation()
    (balance,) = balances([draft], sim)
    assert balance.cause[0] == 2
    some = rebuilds([Failure(draft, [Target(0, 2)], 2)], rules, sim, leaves_out=False)[0]
    assert {tuple(change.boxes for change in proposal) for proposal in some} == {((2,),), ((2,), (3,))}
    anew = [built for proposal in some if (built := applied(draft, proposal)) is not None]
    assert rules.allow(anew).tolist() == [True] * len(some)
    assert all((built.corner_mm[:2] == draft.corner_mm[:2]).all() for built in anew)
    assert min(balance.trouble for balance in balances(anew, sim)) == 0
    ((shorter, *_),) = rebuilds([Failure(draft, [Target(2, 2)], 2)], rules, sim, leaves_out=True)
    assert [change.kind for change in shorter] == [Kind.LEAVE_OUT, Kind.PLACE], "only the box on it has another place"


def test_searches_in_several_processes_end_as_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two processes search for repairs of these plans: first copies of a process, then new interpreters. In place of a
    simulation, the test says that a plan stands once its last box is moved."""
    plans = [
        make_plan(f"{k}", boxes=[((300, 300, 100 + k), (0, 0, 0), 1), ((90, 90, 90), (0, 0, 100 + k), 1)])
        for k in range(8)
    ]

    def ask(requests: list[TrialRequest]) -> list[Trial]:
        good = [bool((one.draft.corner_mm[1, :2] > one.draft.plan.size_mm[0, 2] - 100).all()) for one in requests]
        return [Trial("stable" if g else "unstable", "", None if g else 1, () if g else (1,), 2, 1, 0.0) for g in good]

    ends, ended = [], list[str]()
    for processes, are_copies in ((1, True), (2, Forks.are_possible), (2, False)):
        monkeypatch.setattr(Forks, "are_possible", are_copies)
        searches = [Search(plan, Simulation(), RepairOptions(worlds=0)) for plan in plans]
        with closing(SearchProcesses(len(searches), processes)) as some:
            some.begin(searches)
            some.run(Simulated(ask), ended.append)
        ends.append([([state.changes for state in s.repairs], s.n_trials, s.before, s.complete) for s in searches])
    assert ends[0] == ends[1] == ends[2]
    assert all(changes for changes, *_ in ends[0])
    assert Counter(ended) == dict.fromkeys("01234567", 3)
    searches = [Search(plan, Simulation(), RepairOptions(worlds=0)) for plan in plans]

    def ask_until_stopped(requests: list[TrialRequest]) -> list[Trial]:
        if any(one.draft.plan.plan_id == "2" and len(one.draft.order) == 1 for one in requests):
            raise KeyboardInterrupt  # plan 0, which is in the same process, had all of its answers before
        trials = zip(requests, ask(requests), strict=True)
        return [
            trial._replace(verdict="stable") if draft.plan.plan_id == "0" else trial for (draft, *_), trial in trials
        ]

    with closing(SearchProcesses(len(searches), 2)) as some:
        some.begin(searches)
        with pytest.raises(KeyboardInterrupt):
            some.run(Simulated(ask_until_stopped))
    assert [search.complete for search in searches[::2]] == [True, False, False, False]


@pytest.mark.parametrize(
    ("are_copies", "n_plans", "threads", "is_wide", "n_processes"),
    [
        (True, 7, 2, True, 0),
        (True, 9, 2, False, 2),
        (True, 9, 2, True, 9),
        (True, 20, 2, True, 16),
        (False, 7, 2, True, 0),
        (False, 9, 2, True, 2),
        (False, 27, 2, False, 2),
        (False, 27, 2, True, 6),
    ],
)
def test_searches_run_in_fewer_processes_if_none_can_be_copied(
    are_copies: bool, n_plans: int, threads: int, is_wide: bool, n_processes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Started(PipedProcess):
        def end(self) -> None:
            pass

    monkeypatch.setattr(Forks, "are_possible", are_copies)
    monkeypatch.setattr(Forks, "__init__", lambda *_: None)
    monkeypatch.setattr(Forks, "end", lambda _: None)
    started: list[Started] = []

    def start(_: object) -> Started:
        started.append(Started())
        return started[-1]

    monkeypatch.setattr(Forks, "fork", start)
    monkeypatch.setattr("petmjx.repairs.search_processes.Child", start)
    searches = [Search(make_plan(f"{k}"), Simulation(), RepairOptions(worlds=0)) for k in range(n_plans)]
    with closing(SearchProcesses(n_plans, most_processes(threads, is_wide=is_wide))) as processes:
        processes.begin(searches)
    assert len(started) == n_processes
    parts = [pickle.loads(one.tasks.get_nowait() or b"") for one in started]
    assert sum(map(len, parts)) == (n_plans if n_processes else 0)


def test_judging_ends_when_the_time_is_up() -> None:
    """A batch on a GPU may have thousands of drafts, so judging must end within the batch. The engine can be used again
    afterwards."""
    drafts = [Draft.of(make_plan(boxes=boxes)) for boxes in (TOWER, stack(2))]
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0))
    try:
        with pytest.raises(OutOfTime):
            question.trials([TrialRequest(draft, is_judged=True) for draft in drafts], TimeLimit(0.0))
        assert [trial.stands for trial in question.trials([TrialRequest(draft, is_judged=True) for draft in drafts])][1]
    finally:
        question.close()


def test_scores_and_shares_end_when_the_time_is_up() -> None:
    """If only three worlds with errors ended in time, they do not count: worlds that fall end first, so the share would
    be too small."""
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=4))
    plan = make_plan(boxes=stack(2))
    try:
        with pytest.raises(OutOfTime):
            question.trials([TrialRequest(Draft.of(plan), is_judged=False)], TimeLimit(0.0))
        assert question.shares([plan], TimeLimit(0.0)) == [None]
        assert [share and share.n_worlds for share in question.shares([plan])] == [4]
    finally:
        question.close()


def test_the_start_of_an_engine_takes_none_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 50.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    limit = TimeLimit(100.0)
    now_s = 130.0
    limit.check()
    with pytest.raises(OutOfTime):
        limit.check(0.7)
    limit.compiled_s = 20.0
    limit.check(0.7)
    now_s = 171.0
    with pytest.raises(OutOfTime):
        limit.check()


def test_a_search_whose_seconds_are_spent_says_so() -> None:
    result = repaired(TOWER, seconds=0.1)
    assert not result.complete
    assert result.trial_before.verdict == "unstable"
    assert "the search stopped because the seconds were used up" in result.headline
    assert not result.row()["complete"]
    assert repaired(stack(2), seconds=0.1).complete, "a plan that stands needs no search"


def test_a_search_whose_trials_are_spent_says_so() -> None:
    """If all trials are spent before a box is left out, more trials might find a repair with all boxes. Sheets do not
    help here, and all of them were tried: more trials would find nothing."""
    few = repaired(TWO_FAULTS, forbid=[kind for kind in Kind if kind not in (Kind.MOVE, Kind.LEAVE_OUT)], trials=6)
    assert (few.stands, few.complete, few.trials_spent, len(few.left_out)) == (True, False, True, 1)
    assert few.headline.endswith("all boxes might be kept, since the search stopped when the trials were used up")
    all_tried = repaired(TWO_FAULTS, forbid=[kind for kind in Kind if kind not in (Kind.SHEET, Kind.LEAVE_OUT)])
    assert (all_tried.complete, all_tried.trials_spent, len(all_tried.left_out)) == (True, False, 3)


@pytest.mark.parametrize("is_wide", [False, True])
@pytest.mark.parametrize("worlds", [0, 8])
@pytest.mark.parametrize("n_faults", [1, 2])
def test_a_search_makes_no_more_trials_than_allowed(is_wide: bool, worlds: int, n_faults: int) -> None:
    """One box falls, or two, and box 5 stands in half of the worlds with errors. The trials are spent in every part of
    the search. A search that has found a repair keeps it, and leaves out no box if a plan with all boxes has stood."""
    boxes = TWO_FAULTS if n_faults == 2 else [*TWO_FAULTS[:3], *stack(2, at_mm=(0.0, 600.0))]
    plan = make_plan(boxes=[*boxes, *stack(1, at_mm=(0.0, 1200.0))])
    has_stood = False
    falling = dict[bytes, list[int]]()  # searches with more trials try the same drafts again

    def trial_of(one: TrialRequest) -> Trial:
        nonlocal has_stood
        if (key := key_of(one.draft)) not in falling:
            (balance,) = balances([one.draft], Simulation())
            falling[key] = [box for box in (1, 4) if box in balance.box]
        falls = falling[key] or [5] * (one.world % 2)
        if not falls:
            has_stood |= {*range(6)} <= {*one.draft.order}
            return Trial("stable", "", None, (), 6, 6, 1.0, is_score=True)
        return Trial("unstable", "tilt", falls[0], (falls[0],), falls[0] + 1, falls[0] + 1, -1.0)

    n_repaired = 0
    for trials in (1, 2, 3, 5, 8, 10, 13, 25, 60, 200, 600):
        has_stood = False
        search = Search(plan, Simulation(), RepairOptions(worlds=worlds, trials=trials), is_wide=is_wide)
        result_of(search.run(), lambda some: [trial_of(one) for one in some])
        has_left_out = any(change.kind is Kind.LEAVE_OUT for state in search.repairs for change in state.changes)
        assert search.n_trials <= (trials if not has_left_out and search.repairs else trials + trials // 2)
        assert search.complete
        n_repaired += bool(search.repairs)
        assert search.trials_spent or not has_left_out, "all boxes might be kept"
        assert not (has_stood and has_left_out), "a plan with all boxes stood when it was judged"
    assert n_repaired > 6
    assert not search.trials_spent


@pytest.mark.parametrize(("boxes", "worlds"), [(TOWER, 4), (COUNTERWEIGHT, 0), (COUNTERWEIGHT, 4)])
@pytest.mark.parametrize("trials", [8, 12])
def test_a_trial_is_kept_for_the_score_of_a_repair(boxes: Sequence[Box], worlds: int, trials: int) -> None:
    """A plan stands when it is judged, and further plans are judged to have a choice."""
    result = repaired(boxes, worlds=worlds, trials=trials)
    assert (len(result.changes), result.left_out) == (1, ())
    assert result.complete == (not worlds), "with errors, the trials are not enough to compare repairs"
    spent = "; another change might be better, since the search stopped when the trials were used up"
    assert result.headline.endswith("stands after 1 change" + spent * bool(worlds))


def test_simulations_without_a_verdict_are_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The solver may use so few iterations that only short plans come to an end."""
    file = tmp_path / "plans.json"
    petmjx.save_plans([make_plan(boxes=COUNTERWEIGHT)], file)
    how = ["--engine", "mujoco", "--threads", "1", "--worlds", "0", "--trials", "6"]
    assert main(["repair", str(file), *how]) == 0
    assert "had no verdict" not in (out := capsys.readouterr().out)
    assert "cost 2.00; margin 1.00" in out
    assert main(["repair", str(file), *how, "--iteration-limit", "300"]) == 0
    assert "5 of 6 simulations had no verdict and counted as falls: 5 iteration-limit" in " ".join(
        capsys.readouterr().out.split()
    )
    result = repaired(COUNTERWEIGHT, trials=6, iteration_limit=300)
    assert (result.row()["trials"], result.row()["invalid_trials"]) == (6, 5)


def test_a_plan_that_is_judged_for_too_long_counts_as_one_that_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search has set the limit of iterations, so such simulations do have a verdict. Without the limit, no box need
    be left out. Scores have a limit of their own."""
    monkeypatch.setattr("petmjx.repairs.trials.JUDGED_ITERATIONS", 0)
    monkeypatch.setattr("petmjx.repairs.trials.ITERATIONS_PER_BOX", 60)
    result = repaired(COUNTERWEIGHT, trials=6)
    assert (result.stands, result.left_out, result.row()["invalid_trials"]) == (True, (2,), 0)


def test_a_changed_plan_that_is_scored_for_too_long_counts_as_one_that_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    """The score of the plan as it was given has no limit, since the user is told of it."""
    draft = Draft.of(make_plan(boxes=stack(2)))
    moved = Move(1, 1.0, 0.0).applied(draft)
    assert moved is not None
    requests = [TrialRequest(draft, is_judged=False), TrialRequest(moved, is_judged=False)]
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0))
    assert [trial.verdict for trial in question.scores(requests)] == ["stable", "stable"]
    monkeypatch.setattr("petmjx.repairs.trials.SCORED_ITERATIONS", 0)
    monkeypatch.setattr("petmjx.repairs.trials.ITERATIONS_PER_BOX", 10)
    assert [trial.verdict for trial in question.scores(requests)] == ["stable", "unstable"]
    monkeypatch.setattr("petmjx.repairs.trials.SCORED_ITERATIONS", 20_000)
    limited = Question({"engine": "mujoco", "threads": 1, "iteration_limit": 20}, RepairOptions(worlds=0))
    assert [trial.verdict for trial in limited.scores(requests)] == ["invalid", "invalid"], "the user has set the limit"


def test_a_repair_with_few_trials_is_told_as_such() -> None:
    few = repaired(COUNTERWEIGHT, trials=3)
    assert (few.stands, few.n_trials <= 4, few.complete) == (True, True, False)
    assert few.headline.endswith("all boxes might be kept, since the search stopped when the trials were used up")
    undone = replace(few, changes=(Move(0, 1.0, 0.0), Move(1, 1.0, 0.0)))
    assert undone.headline.endswith("some may not be needed, since the search stopped when the trials were used up")


def test_a_repair_that_stands_in_too_few_worlds_with_errors_is_told() -> None:
    weak = replace(repaired(COUNTERWEIGHT, trials=3), share_after=Share(8, 5))
    assert _weak_note([weak], 5 / 8) == []
    (note,) = _weak_note([weak, replace(weak, share_after=Share(8, 8))], 0.75)
    assert note == "1 repaired plan stands in less than 75 % of the worlds with errors (option share): 00000001"


@pytest.mark.parametrize(("forbid", "profile"), [((), None), (("place",), None), ((), "eumos-40509")])
def test_plans_are_built_anew_in_a_share_of_the_trials(forbid: tuple[str, ...], profile: str | None) -> None:
    """Whatever is changed, the last box of a plan falls. If no box may be put elsewhere, no plan is built anew. With a
    profile, all trials may be spent."""
    plan = make_plan(boxes=[*stack(6), *stack(6, 30.0, at_mm=(0.0, 500.0))])
    falls = Trial("unstable", "tilt", 11, (11,), 12, 11, -1.0)
    options = RepairOptions(worlds=0, forbid=forbid, profile=profile, trials=1206)
    search = Search(plan, Simulation(), options, is_wide=True)
    search.begin(falls)
    node = Node(State(Draft.of(plan), (), falls), (Fault(11, 1.0),))
    kinds = search.options.kinds - {Kind.LEAVE_OUT, Kind.FILM}
    standing, _ = result_of(search._changed([node], kinds, 200), lambda some: [falls] * len(some))
    assert standing == []
    assert search.trials_spent
    most = int(ALONE * 200) + WIDE_AT_ONCE[-1] + int(BUILT_ANEW * 200)
    assert search.n_trials == 200 if forbid or profile else search.n_trials <= most < 200


@pytest.mark.parametrize("weight", [MANY_FAULTS - 0.25, MANY_FAULTS])
def test_plans_with_many_faults_are_built_anew_earlier(weight: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is changed, the last box of a plan falls."""
    plan, began = make_plan(boxes=[*stack(6), *stack(6, 30.0, at_mm=(0.0, 500.0))]), list[int]()
    falls, build = Trial("unstable", "tilt", 11, (11,), 12, 11, -1.0), Search._anew

    def noted(search: Search, *rest: Any) -> list[list[Candidate]]:
        began.append(search.n_trials)
        return build(search, *rest)

    monkeypatch.setattr(Search, "_anew", noted)
    for is_wide in (False, True):
        began.clear()
        search = Search(plan, Simulation(), RepairOptions(worlds=0), is_wide=is_wide)
        search.begin(falls)
        node = Node(State(Draft.of(plan), (), falls), (Fault(11, weight),))
        kinds = search.options.kinds - {Kind.LEAVE_OUT}
        result_of(search._changed([node], kinds, 600), lambda some: [falls] * len(some))
        least = int((ALONE_IF_MANY if weight >= MANY_FAULTS else ALONE) * 600)
        assert least <= began[0] <= least + WIDE_AT_ONCE[-1]


def test_a_load_that_nothing_bears_has_no_weakness() -> None:
    """One box overlaps another: the corner of the upper box lies inside the lower box, so no body bears its load."""
    boxes: Sequence[Box] = (((600, 400, 250), (0, 0, 0), 12), ((600, 400, 250), (100, 0, 100), 12))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (balance,) = balances([Draft.of(make_plan(boxes=boxes))], Simulation())
    assert np.isfinite([balance.trouble, balance.weakness, *balance.depth_mm]).all()


@pytest.mark.parametrize(
    ("carrier", "text"),
    [("rollcontainer-4", "1 box reaches through a wall of the carrier"), ("footprint", "1 overlapping pair (0 and 1)")],
)
def test_notes_are_those_of_a_score(carrier: str, text: str) -> None:
    """A box of 600 mm that begins at x = 220 mm reaches through the wall of a roll container of 710 mm."""
    boxes: list[Box] = [((600, 400, 250), (220, 0, 0), 12)]
    plan = make_plan(boxes=boxes if carrier != "footprint" else [*boxes, ((600, 400, 250), (220, 0, 240), 12)])
    how = {"engine": "mujoco", "threads": 1, "carrier": carrier}
    notes = petmjx.repair(plan, worlds=0, **how).notes
    assert any(text in note for note in notes)
    assert {*notes} <= {*petmjx.score(plan, **how).info["warnings"]}


# ---------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"forbid": ["moves"]}, "forbid must be one of order, move"),
        ({"forbid": list(Kind)}, "nothing is left to repair with"),
        ({"built": 2}, "plan 00000001: built must be less than its 2 boxes, got 2"),
        ({"seconds": 0}, "seconds must be from 0.1"),
        ({"worlds": 3}, "worlds must be 0, or from 4"),
        ({"worlds": 0, "share": 0.8}, "share needs worlds"),
        ({"level": 0.5}, "level needs a profile"),
        ({"profile": "eumos"}, "eumos"),
        ({"out": "x"}, "out: a repair has no such option"),
        ({"confidence": 8}, "confidence: a repair has no such option; set the option worlds"),
        ({"most_move": 8}, "unknown option most_move"),
        ({"worlds": 0, "errors": Path("x.toml")}, "errors needs worlds"),
    ],
)
def test_unusable_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        petmjx.repair(make_plan(boxes=stack(2, 300.0)), **{"engine": "mujoco", "threads": 1, **options})


# ---------------------------------------------------------------------- the command and its HTML page


def test_the_command_writes_plans_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out, html = tmp_path / "plans.json", tmp_path / "repaired.csv", tmp_path / "repairs.html"
    petmjx.save_plans([make_plan("late", LATE_SUPPORT)], source)
    options = ["--engine", "mujoco", "--threads", "1", "--worlds", "0", "--without", "move,place,turn,exchange"]
    assert main(["repair", str(source), "-o", str(out), "--html", str(html), *options]) == 0
    printed = capsys.readouterr().out
    assert "late: unstable (tilt, first box 1); stands after 1 change\n  1. place box 2 before box 1" in printed
    assert verdict(petmjx.load_plans(out).plans[0]) == "stable"
    page = html.read_text(encoding="utf-8")
    carriers = re.findall(r"<title>carrier</title>(.*?)</g>", page)
    assert len(carriers) == page.count("<svg") == 2
    assert carriers[0] == carriers[1], "both pictures have the same scale"
    assert sorted(re.findall(r'<text class="number".*?>(.*?)<', page)) == ["1", "1", "2", "2"]
    assert "place box 2 before box 1" in page
    assert main(["repair", str(source), "-o", str(out), *options]) == 2
    assert "--overwrite" in capsys.readouterr().err
    for flag, name in (("-o", "x.json"), ("--html", "x.html")):
        assert main(["repair", str(source), flag, str(tmp_path / "no" / name)]) == 2
        assert "is not a folder" in capsys.readouterr().err
    assert main(["repair", str(source), "--without", "moves"]) == 2
    assert capsys.readouterr().err.startswith("petmjx: --without must be one of order, move")
    assert main(["repair", str(source), "--forbid", "move"]) == 2
    assert "(Possible options: --without)" in capsys.readouterr().err
    assert main(["show", "late", str(source), "--repair"]) == 2
    assert capsys.readouterr().err.startswith("petmjx: --repair needs --html FILE")


@pytest.mark.parametrize(("n_calls", "names"), [(0, []), (3, ["stands"]), (None, ["stands", "falls"])])
def test_an_interrupted_repair_keeps_the_plans_that_are_done(
    n_calls: int | None,
    names: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The interrupt comes after this number of answers of the engine, or, if it is None, while the shares with errors
    are simulated."""
    source, out = tmp_path / "plans.json", tmp_path / "repaired.json"
    petmjx.save_plans([make_plan("stands", stack(2)), make_plan("falls", COUNTERWEIGHT)], source)
    answers, n_answers = TrialStream.answers, 0

    def stopped(stream: TrialStream) -> Iterator[TrialAnswer | None]:
        nonlocal n_answers
        for answer in answers(stream):
            if n_answers == n_calls:
                raise KeyboardInterrupt
            n_answers += answer is not None
            yield answer

    def no_shares(*_: object) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(TrialStream, "answers", stopped)
    monkeypatch.setattr(Question, "shares", no_shares)
    assert main(["repair", str(source), "-o", str(out), "--engine", "mujoco", "--threads", "1"]) == 130
    shown = capsys.readouterr()
    if not names:
        assert "no search for a repair was finished; nothing was written" in shown.err
        assert not out.exists()
        return
    assert f"repairs were searched to the end for {len(names)} of 2 plans" in shown.err
    assert shown.err.startswith("2 plans, about ")
    assert "\nengine mujoco (as asked for)\n" in shown.err
    plans = petmjx.load_plans(out).plans
    assert [plan.plan_id for plan in plans] == names
    assert [verdict(plan) for plan in plans] == ["stable"] * len(names)


def test_a_change_says_that_it_turns_a_box_although_an_earlier_turn_was_dropped() -> None:
    draft = Draft.of(make_plan(boxes=[*stack(2), *stack(2, at_mm=(600.0, 0.0))]))
    turn, place = Turn(1, 0.0, 0.0), Place(1, (600.0, 300.0, 0.0), turned=True)
    exchange = Exchange(1, 3, ((600.0, 0.0, 100.0), (0.0, 0.0, 100.0)), (True, True))
    changes = with_change((turn,), place, draft)
    assert changes == (place,)
    assert [change.words for change in with_turns_told(draft, changes)] == [replace(place, differs=True).words]
    first, second, third = with_turns_told(draft, (turn, replace(place, differs=True), exchange))
    assert (first, second) == (turn, place)
    assert isinstance(third, Exchange)
    assert third.differ == (False, True)


def test_only_film_counts_as_turns_of_film() -> None:
    """An exchange of boxes may turn the boxes; the page of repairs took this for turns of film."""
    exchange = Exchange(1, 2, ((0.0, 0.0, 100.0), (0.0, 0.0, 200.0)), (True, True))
    result = replace(repaired(COUNTERWEIGHT, trials=3), changes=(exchange,))
    assert result.film_turns is None
    assert replace(result, changes=(Film(2.0), exchange)).film_turns == 2.0
