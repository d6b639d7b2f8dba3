"""What the search for repairs computes in part, or for many plans at once, is the same as computed in whole and
alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import combinations, islice

import numpy as np
import pytest
from support.plans import make_plan, stack

from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import MOST_SAMPLES, generate
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan
from petmjx.repairs.balance import Balance, balances, balances_with_last
from petmjx.repairs.changes import Exchange, Move, Place, applied
from petmjx.repairs.draft_rules import Rules
from petmjx.repairs.drafts import TOLERANCE_MM, Draft, key_of
from petmjx.repairs.proposals import (
    LEAST_SUPPORT,
    Proposal,
    Target,
    _exchanged_places,
    _places_of,
    _triple,
    proposals,
    resting_corners,
)
from petmjx.repairs.rebuilds import Failure, rebuilds
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.trials import scenes_of
from petmjx.world.scene import OF_BOXES, build_scene, has_plain_scene
from petmjx.world.supports import find_bearings, find_plain_bearings

SIM, OPTIONS = Simulation(), RepairOptions()
SEED = 33412


def plans(n: int, boxes: tuple[int, int]) -> list[Plan]:
    """The first generated plans of a seed with so many boxes."""
    drawn = (parse_plan(name, placed, DecoderOptions("seed")) for name, placed in generate(MOST_SAMPLES, SEED))
    return [*islice((plan for plan in drawn if boxes[0] <= plan.n_boxes <= boxes[1]), n)]


@pytest.fixture(scope="module", name="some_plans")
def _some_plans() -> list[Plan]:
    return plans(2, (15, 22))


def proposed(draft: Draft, rules: Rules, boxes: tuple[int, ...]) -> Iterator[tuple[Draft, Proposal]]:
    """All changes that are proposed because of some boxes, and the changed drafts."""
    causes = [Target(box, max(box - 1, 0), 12.0) for box in boxes]
    for proposal in proposals(draft, rules, causes, frozenset(OPTIONS.kinds), OPTIONS):
        if (changed := applied(draft, proposal)) is not None:
            yield changed, proposal


def parents(plan: Plan, rules: Rules) -> Iterator[Draft]:
    """The plan, and allowed drafts with a change: a sheet, a box left out, and another place."""
    start = Draft.of(plan)
    yield start
    kinds = set()
    for changed, proposal in proposed(start, rules, (plan.n_boxes // 2,)):
        if str(proposal[0].kind) not in kinds and rules.allow([changed])[0]:
            kinds.add(str(proposal[0].kind))
            yield changed


def test_a_changed_draft_is_checked_as_a_whole_draft(some_plans: list[Plan]) -> None:
    n_allowed, n_forbidden = 0, 0
    for plan in some_plans:
        rules = Rules(plan, SIM, 2000.0, built=3)
        for parent in parents(plan, rules):
            drafts, changes = zip(*proposed(parent, rules, (plan.n_boxes - 4, plan.n_boxes // 2)), strict=True)
            changed = [{box for change in proposal for box in change.boxes} for proposal in changes]
            allowed = rules.allow(drafts)
            assert rules.allow(drafts, changed, parent).tolist() == allowed.tolist()
            n_allowed, n_forbidden = n_allowed + allowed.sum(), n_forbidden + (~allowed).sum()
    assert n_allowed > 500
    assert n_forbidden > 500


def test_a_box_whose_support_is_moved_away_floats() -> None:
    start = Draft.of(make_plan(boxes=stack(2)))
    rules = Rules(start.plan, SIM, 2000.0, 0)
    away = start.with_places([0], start.corner_mm[[0]] + (900.0, 0.0, 0.0))
    rules.high_mm[0] = 2000.0
    assert rules.allow([away], [[0]], start).tolist() == [False]
    assert rules.allow([away], [[0]]).tolist() == [True], "without the draft before, only the box itself is checked"


def test_places_are_checked_without_drafts_as_drafts_are(some_plans: list[Plan]) -> None:
    """Exchanges, turns and other places, of single boxes and of piles, now and last."""
    allowed, forbidden = Counter[str](), Counter[str]()
    for plan in some_plans:
        rules = Rules(plan, SIM, 2000.0, built=0)
        for parent in parents(plan, rules):
            boxes = [box for box in parent.order if box < plan.n_boxes]
            pairs = np.array([*combinations(boxes[-12:], 2)])
            exchanged, turns = _exchanged_places(parent, pairs)
            corners = [(_triple(corner), _triple(other)) for corner, other in exchanged.corner_mm]
            rows = zip(exchanged.boxes.tolist(), corners, exchanged.turned.tolist(), turns.tolist(), strict=True)
            exchanges = [
                Exchange(*pair, corner, (one, other), tuple(turn)) for pair, corner, (one, other), turn in rows
            ]
            moved = [
                Place(box, (x, y, z), bool(parent.turned[box]) != turn, last, differs=turn, others=tuple(riders))
                for box in boxes[::4]
                for riders in ((), sorted({*parent.above(box)} & {*boxes})[:3])
                for x, y, z in (parent.corner_mm[box] + (5.0, 0.0, 0.0), (0.0, 0.0, 0.0), (300.0, 0.0, 400.0))
                for turn in ((False,) if riders else (False, True))
                for last in (None, boxes[-1])
                if last not in (box, *riders)
            ]
            for places, changes in ((exchanged, exchanges), (_places_of(parent, moved), moved)):
                drafts = [change.applied(parent) for change in changes]
                checked = rules.allow([one for one in drafts if one is not None], [{*c.boxes} for c in changes], parent)
                assert rules.allow_places(parent, places).tolist() == checked.tolist()
                for change, is_allowed in zip(changes, checked, strict=True):
                    (allowed if is_allowed else forbidden)[change.kind] += 1
    assert min(min(counts["exchange"], counts["place"]) for counts in (allowed, forbidden)) > 10


def test_changes_of_places_that_are_proposed_are_allowed(some_plans: list[Plan]) -> None:
    kinds = Counter[str]()
    for plan in some_plans:
        rules, draft = Rules(plan, SIM, 2000.0, 0), Draft.of(plan)
        for changed, (*_, change) in proposed(draft, rules, (plan.n_boxes - 4, plan.n_boxes // 2)):
            if change.kind in ("exchange", "turn") or (isinstance(change, Place) and change.after):
                kinds[change.kind] += 1
                assert rules.allow([changed])[0]
    assert set(kinds) == {"exchange", "turn", "place"}


def test_the_key_of_first_boxes_is_the_beginning_of_the_key(some_plans: list[Plan]) -> None:
    draft, other = Draft.of(some_plans[0]), _shifted(some_plans[0])
    assert all(key_of(draft).startswith(key_of(draft, n)) for n in range(len(draft.order) + 1))
    assert key_of(replace(draft)) == key_of(draft)
    assert not key_of(other).startswith(key_of(draft, 1)), "the first box is at another place"


def test_only_moves_that_are_not_allowed_have_no_room(some_plans: list[Plan]) -> None:
    lengths = (-150.0, -40.0, -7.0, 7.0, 40.0, 150.0)
    ways = [(length, 0.0) for length in lengths] + [(0.0, length) for length in lengths]
    n_room = 0
    for plan in some_plans:
        rules, draft = Rules(plan, SIM, 2000.0, 0), Draft.of(plan)
        for box in draft.order:
            for others in ((), tuple(draft.above(box))):
                room = rules.have_room(draft, [box, *others], ways)
                moved = [applied(draft, [Move(box, *way, others)]) for way in ways]
                allowed = rules.allow([one for one in moved if one is not None])
                assert not (allowed & ~room).any()
                n_room += int(room.sum())
    assert 0 < n_room < len(ways) * sum(2 * plan.n_boxes for plan in some_plans)


def test_boxes_rest_on_what_is_under_them(some_plans: list[Plan]) -> None:
    """At each place, the box rests at the height of the highest top under it, on half of its base or more."""
    n_turned = 0
    for plan in some_plans:
        rules, draft = Rules(plan, SIM, 2000.0, 0), Draft.of(plan)
        for box in draft.order[::3]:
            others = [other for other in draft.order if other != box]
            heights: dict[bool, list[float]] = {False: [], True: []}
            for turn, corner in resting_corners(draft, rules, box):
                size = draft.size_mm[box][[1, 0, 2] if turn else [0, 1, 2]]
                low, high = np.array(corner), np.array(corner) + size
                shared = np.minimum(high, (draft.corner_mm + draft.size_mm)[others])
                shared -= np.maximum(low, draft.corner_mm[others])
                tops = (draft.corner_mm + draft.size_mm)[others, 2]
                under = (shared[:, :2] > TOLERANCE_MM).all(axis=1)
                assert corner[2] == max(tops[under], default=0.0)
                bears = under & (np.abs(tops - corner[2]) <= TOLERANCE_MM)
                area = shared[bears, :2].prod(axis=1).sum()
                assert corner[2] == 0 or area >= (LEAST_SUPPORT - 1e-9) * size[:2].prod()
                assert high[2] <= 2000.0 + TOLERANCE_MM
                heights[turn].append(corner[2])
                n_turned += turn
            assert all(some == sorted(some) for some in heights.values()), "the lowest places come first"
    assert n_turned > 0


def test_changes_for_two_causes_are_those_for_each(some_plans: list[Plan]) -> None:
    for plan in some_plans:
        rules, draft = Rules(plan, SIM, 2000.0, 0), Draft.of(plan)
        top = plan.n_boxes - 1
        together = [key_of(changed) for changed, _ in proposed(draft, rules, (top, top - 2))]
        alone = [key_of(changed) for box in (top, top - 2) for changed, _ in proposed(draft, rules, (box,))]
        assert list(dict.fromkeys(together)) == list(dict.fromkeys(alone))
        assert len(together) < len(alone), "what does not depend on the cause is proposed once"


def test_the_balance_with_one_more_box_follows_from_the_one_before(some_plans: list[Plan]) -> None:
    """The balance with one more box is also right where supports would have to pull, and where loads are beyond
    edges."""
    n_beyond = 0
    for draft in [*map(Draft.of, some_plans), *map(_shifted, some_plans)]:
        piles = [replace(draft, order=draft.order[:n]) for n in range(1, len(draft.order) + 1)]
        whole = balances(piles, SIM, with_loads=True)
        known: list[Balance] = whole[:1]
        for pile in piles[1:]:
            known += balances_with_last([pile], known[-1:], SIM)
        for one, other in zip(known, whole, strict=True):
            assert one.trouble == pytest.approx(other.trouble, abs=1e-6)
            assert one.weakness == pytest.approx(other.weakness, abs=1e-6)
            assert one.box.tolist() == other.box.tolist()
            assert one.cause.tolist() == other.cause.tolist()
            n_beyond += len(other.box)
    assert n_beyond > 10


def test_loads_after_equal_placements_are_those_of_the_parent(
    some_plans: list[Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The balance of a changed draft is the same if its first loads are taken over from the draft before the change."""
    monkeypatch.setattr("petmjx.repairs.balance.LARGE", 1)
    n_beyond = 0
    for parent in [*map(Draft.of, some_plans), *map(_shifted, some_plans)]:
        rules, top = Rules(parent.plan, SIM, 2000.0, 0), parent.plan.n_boxes - 1
        changed = [draft for draft, _ in proposed(parent, rules, (top, top // 2))]
        drafts = [parent, *changed, *filter(None, map(parent.without, parent.order))]
        taken_over = balances(drafts, SIM, with_loads=True, parent=parent)
        for one, other in zip(taken_over, balances(drafts, SIM, with_loads=True), strict=True):
            assert (one.box.tolist(), one.step.tolist()) == (other.box.tolist(), other.step.tolist())
            assert one.depth_mm == pytest.approx(other.depth_mm, abs=1e-6)
            assert one.last_mm == pytest.approx(other.last_mm, abs=1e-6)
            assert one.weight == pytest.approx(other.weight, abs=1e-6)
            assert one.weakness == pytest.approx(other.weakness, abs=1e-6)
            n_beyond += len(other.box)
    assert n_beyond > 10


def _shifted(plan: Plan) -> Draft:
    """The plan with every third box moved by 110 mm, so that loads are beyond edges."""
    boxes = [*range(0, plan.n_boxes, 3)]
    return Draft.of(plan).with_places(boxes, plan.corner_mm[boxes] + (110.0, 0.0, 0.0))


def test_plans_are_built_anew_side_by_side_as_alone(some_plans: list[Plan]) -> None:
    plan = some_plans[0]
    rules, draft = Rules(plan, SIM, 2000.0, 0), Draft.of(plan)
    boxes = plan.n_boxes // 2, plan.n_boxes - 3
    failures = [Failure(draft, [Target(box, box - 1)], box - 2) for box in boxes]
    alone = [rebuilds([failure], rules, SIM, leaves_out=False)[0] for failure in failures]
    assert rebuilds(failures, rules, SIM, leaves_out=False) == alone
    assert all(alone)


def test_statics_takes_plain_drafts_and_others_together() -> None:
    """The balance of a plain draft is computed from arrays, and is the same beside others."""
    plain = Draft.of(make_plan(boxes=stack(3, 60.0)))
    with_sheet = plain.with_sheet(np.array([400.0, 300.0, 3.0]), np.array([0.0, 0.0, 200.0]), 0.06, 1)
    assert with_sheet is not None
    heavy = Draft.of(replace(plain.plan, mass_center_mm=np.tile([140.0, 0.0, 0.0], (3, 1))))
    drafts = [with_sheet, plain, heavy, replace(plain, order=(0, 2))]
    together = balances(drafts, SIM)
    for draft, one in zip(drafts, together, strict=True):
        (alone,) = balances([draft], SIM)
        assert (alone.trouble, alone.weakness) == (one.trouble, one.weakness)
        assert (alone.order.tolist(), alone.box.tolist()) == (one.order.tolist(), one.box.tolist())
    assert together[1].trouble != together[2].trouble


def test_scenes_of_plain_drafts_are_those_of_their_plans() -> None:
    plain = Draft.of(make_plan(boxes=stack(3, 60.0)))
    with_sheet = plain.with_sheet(np.array([400.0, 300.0, 3.0]), np.array([0.0, 0.0, 200.0]), 0.06, 1)
    assert with_sheet is not None
    heavy = Draft.of(replace(plain.plan, mass_center_mm=np.tile([0.0, 90.0, 0.0], (3, 1))))
    drafts = [plain, with_sheet, heavy, replace(plain, order=(0, 2))]
    for draft, scene in zip(drafts, scenes_of(drafts, SIM), strict=True):
        expected = build_scene(draft.as_plan(), SIM)
        for name in OF_BOXES:
            assert np.array_equal(getattr(scene, name), getattr(expected, name)), name
        assert np.array_equal(scene.carrier.half_size, expected.carrier.half_size)
        assert len(scene.pieces) == len(expected.pieces)


@pytest.mark.parametrize("sim", [SIM, Simulation(carrier="euro-pallet")])
def test_contacts_of_plain_plans_are_those_of_their_scenes(some_plans: list[Plan], sim: Simulation) -> None:
    assert all(has_plain_scene(plan, sim) for plan in some_plans)
    scenes = [build_scene(plan, sim) for plan in some_plans]
    expected = find_bearings(scenes, [scene.target for scene in scenes])
    arrays = (
        np.concatenate([getattr(plan, name) for plan in some_plans]) for name in ("size_mm", "corner_mm", "mass_kg")
    )
    bearing = find_plain_bearings(*arrays, [plan.n_boxes for plan in some_plans], sim)
    for name in ("upper", "lower", "low", "high"):
        assert np.array_equal(getattr(bearing, name), getattr(expected, name)), name
    for field in fields(bearing.boxes):
        assert np.array_equal(getattr(bearing.boxes, field.name), getattr(expected.boxes, field.name)), field.name
