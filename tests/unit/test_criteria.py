"""Tests of the closed-form criteria: their answers are compared with results computed by hand, and those of force
balance with an independent formulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.plans import CARTON_MM, Box, Triple, make_plan, stack

pytest.importorskip("scipy")
pytest.importorskip("shapely")

from scipy.optimize import nnls

import petmjx
from petmjx.analysis.criteria import (
    CRITERIA,
    NAMES,
    NO,
    NOT_ASKED,
    YES,
    Answers,
    answer,
    chosen_criteria,
    load_points,
    support_share,
    tolerable_acceleration_g,
)
from petmjx.analysis.criteria_vs_physics import ARRIVES, CELLS
from petmjx.analysis.force_balance import Friction, _slack_alone, _VerticalSystem, balance_slack
from petmjx.analysis.load_paths import even_bedding, load_slack
from petmjx.analysis.load_polygons import load_polygons
from petmjx.analysis.plan_contacts import contact_hulls, find_contacts
from petmjx.common.errors import InputError
from petmjx.world.history import CARRIER

MU = Friction(0.5)


def asked(boxes: Sequence[Box], friction: Friction = MU) -> Answers:
    return answer(make_plan(boxes=boxes), CRITERIA, friction, 0.5)


def says(answers: Answers, box: int = -1) -> dict[str, bool]:
    """Name of a criterion → whether it accepts a box, by default the last box."""
    return {name: bool(answers.stable[box, number] == YES) for number, name in enumerate(NAMES)}


def slack(answers: Answers, name: str, box: int = -1) -> float:
    return float(answers.slack[box, NAMES.index(name)])


def box(x: float, y: float, z: float, dx: float, dy: float, dz: float, kg: float = 1.0) -> Box:
    return (dx, dy, dz), (x, y, z), kg


def beam(x: float, x_end: float, z: float, z_end: float, kg: float = 1.0) -> Box:
    """A box from x to x_end and from z to z_end. All such boxes are 300 mm wide along y, so the problem is
    two-dimensional."""
    return box(x, 0, z, x_end - x, 300, z_end - z, kg)


HULL = ("centre", "load_polygon", "stacking_tree", "equilibrium", "force_balance", "force_balance_leaning")


def test_overhang_below_half_stands() -> None:
    plan_answers = asked(stack(overhang_mm=190))
    answers = says(plan_answers)
    assert all(answers[name] for name in HULL)
    assert answers["support_50"]
    assert not answers["support_60"]
    assert plan_answers.share[1] == pytest.approx(210 / 400)
    for name in HULL[:4]:
        assert slack(plan_answers, name) == pytest.approx(10)
    # the box's centre is 95 mm from the middle of the contact, which is 210 mm long
    assert slack(plan_answers, "force_balance") == pytest.approx(1 - 95 / 105)
    assert plan_answers.corners.tolist() == [4, 2]


def test_overhang_above_half_falls() -> None:
    plan_answers = asked(stack(overhang_mm=210))
    assert not any(says(plan_answers)[name] for name in HULL)
    assert all(slack(plan_answers, name) == pytest.approx(-10) for name in HULL[:4])
    assert slack(plan_answers, "force_balance") == pytest.approx(1 - 105 / 95)
    assert all(says(plan_answers, 0).values())


def test_an_overhang_of_one_half_is_on_the_edge_and_stands() -> None:
    plan_answers = asked(stack(overhang_mm=200))
    assert all(says(plan_answers)[name] for name in HULL)
    assert all(slack(plan_answers, name) == pytest.approx(0, abs=1e-9) for name in HULL)


def test_bridge() -> None:
    plan_answers = asked([beam(0, 100, 0, 200), beam(300, 400, 0, 200), beam(0, 400, 200, 300)])
    answers = says(plan_answers)
    assert all(answers[name] for name in (*HULL, "three_corners", "support_50"))
    assert not answers["support_60"]
    # 4 corners and exactly half of the base are supported, but the criterion requires more than half
    assert slack(plan_answers, "corner_area_code") == 0
    assert not answers["corner_area_code"]
    assert slack(plan_answers, "centre") == pytest.approx(150)
    assert slack(plan_answers, "force_balance") == pytest.approx(1)


def test_l_shaped_support_is_the_hull_of_two_rectangles() -> None:
    supports = [box(0, 0, 0, 100, 400, 200), box(100, 0, 0, 300, 100, 200)]
    plan_answers = asked([*supports, box(0, 0, 200, 400, 400, 100)])
    assert plan_answers.share[2] == pytest.approx(0.4375)
    assert plan_answers.corners[2] == 3
    assert says(plan_answers)["three_corners"]
    # the slanted edge of the hull is x + y = 500, and the box's centre is at (200, 200)
    for name in HULL[:2]:
        assert slack(plan_answers, name) == pytest.approx(100 / np.sqrt(2))
    for name in HULL[2:4]:  # these criteria also check the supports, which stand on 100 mm of the carrier
        assert 0 < slack(plan_answers, name) <= 50


def test_l_shaped_support_beside_the_centre_falls() -> None:
    supports = [box(0, 0, 0, 50, 400, 200), box(50, 0, 0, 350, 50, 200)]
    answers = asked([*supports, box(0, 0, 200, 400, 400, 100), box(300, 300, 300, 100, 100, 100, kg=3)])
    # the edge of the hull is x + y = 450: the box stands alone, and tips under the load at (350, 350)
    assert all(says(answers, 2)[name] for name in HULL)
    assert says(answers)["centre"]
    assert not any(says(answers)[name] for name in HULL[1:])


def test_tower() -> None:
    answers = asked(stack(5))
    at_rest = [number for number, name in enumerate(NAMES) if name != "tolerable_acceleration"]
    assert (answers.stable[:, at_rest] == YES).all()
    assert slack(answers, "centre") == pytest.approx(150)
    assert slack(answers, "force_balance") == pytest.approx(1)
    assert answers.share.tolist() == [1] * 5


SUPPORT = beam(0, 150, 0, 200)
PLANK = beam(-100, 300, 200, 300, kg=2)
LOAD = beam(200, 300, 300, 400, kg=3)
COUNTERWEIGHT = beam(-100, 0, 300, 400, kg=3)


def test_counterweight_holds_a_plank_only_if_it_is_there_first() -> None:
    # moments about the right edge of the support: 2·50 + 3·200 hold the plank, 3·100 tips it
    held = asked([SUPPORT, PLANK, COUNTERWEIGHT, LOAD])
    falls = asked([SUPPORT, PLANK, LOAD, COUNTERWEIGHT])
    for name in ("stacking_tree", "equilibrium", "force_balance"):
        assert (says(held)[name], says(falls, 2)[name]) == (True, False), name
    total = 2 * 100 + 3 * -50 + 3 * 250
    assert slack(held, "equilibrium") == pytest.approx(min(150 - total / 8, total / 8, 50))
    # with both boxes in place, the stack would be in balance; criteria with load polygons refuse it, ``centre`` accepts
    assert says(falls)["equilibrium"]
    assert falls.stable[3, NAMES.index("force_balance")] == NOT_ASKED
    assert not says(held)["load_polygon"]
    assert says(falls, 2)["centre"]


def test_cantilever_held_down_from_above() -> None:
    """A box lies on the plank's tail and on a column. If this is needed for balance, the box can press on the tail with
    its whole weight."""
    column, across = beam(-200, -20, 0, 300), beam(-100, 120, 300, 400, kg=10)
    end = beam(250, 300, 300, 400, kg=20)
    boxes = [beam(100, 200, 0, 200), column, beam(0, 300, 200, 300, kg=2), across, end]
    answers = asked(boxes)
    # moments about x = 200: the plank's 2·50 and the box's 10·190 hold against 20·75; if the box's weight were shared
    # evenly with the column, the box would hold less
    assert says(answers)["force_balance"]
    assert says(answers)["equilibrium"]
    contacts = find_contacts(make_plan(boxes=boxes))
    assert load_slack(contacts, contact_hulls(contacts), even_bedding)[-1] < 0
    assert not says(answers)["stacking_tree"]
    heavier = asked([beam(100, 200, 0, 200), column, beam(0, 300, 200, 300, kg=2), across, (*end[:2], 27.0)])
    assert not says(heavier)["force_balance"]  # 27·75 > 100 + 1900


LEANING = [beam(0, 400, 0, 200, kg=5), beam(630, 1030, 0, 400, kg=10), beam(230, 630, 200, 400, kg=5)]


def test_a_box_leans_on_its_neighbour() -> None:
    """The centre of the leaning box is 30 mm beyond the edge. The neighbour of the leaning box must press with 0.15 of
    the box's weight, 200 mm above the edge."""
    answers = asked(LEANING)
    assert says(answers)["force_balance_leaning"]
    assert not says(answers)["force_balance"]
    assert not says(asked(LEANING, Friction(0.14)))["force_balance_leaning"]
    assert says(asked(LEANING, Friction(0.16)))["force_balance_leaning"]
    light = [LEANING[0], (*LEANING[1][:2], 1.0), LEANING[2]]
    assert not says(asked(light))["force_balance_leaning"]  # the neighbour slides: it is pushed with 0.75 kg · g


@pytest.mark.parametrize("friction", [MU, Friction(0.5, 0.5)])
def test_between_neighbours_nothing_hangs_in_the_air(friction: Friction) -> None:
    answers = asked([beam(0, 200, 0, 400, 20), beam(400, 600, 0, 400, 20), beam(200, 400, 200, 300)], friction)
    assert not any(says(answers).values())
    assert all(np.isnan(slack(answers, name)) for name in HULL)
    assert answers.n_supports[2] == 0
    assert answers.share[2] == 0


def test_what_is_placed_later_bears_nothing_that_is_there() -> None:
    answers = asked([beam(0, 400, 200, 400), beam(0, 400, 0, 200)])
    assert not says(answers, 0)["centre"]
    assert says(answers)["centre"]
    assert answers.stable[:, NAMES.index("force_balance")].tolist() == [NO, NOT_ASKED]


def test_area_of_overlapping_supports_counts_once() -> None:
    plan = make_plan(boxes=[beam(0, 200, 0, 200), beam(100, 300, 0, 200), beam(0, 400, 200, 300)])
    assert support_share(find_contacts(plan))[2] == pytest.approx(0.75)


def test_gaps_up_to_the_tolerance_touch() -> None:
    for gap, touches in ((0.5, True), (0.6, False), (-0.5, True), (-0.6, False)):
        contacts = find_contacts(make_plan(boxes=[beam(0, 400, 0, 200), beam(0, 400, 200 + gap, 300)]))
        assert (contacts.lower.tolist() == [CARRIER, 0]) is touches
    narrow = find_contacts(make_plan(boxes=[beam(0, 400, 0, 200), beam(399.6, 700, 200, 300)]))
    assert narrow.lower.tolist() == [CARRIER]


def test_load_polygons_are_cut_by_those_below() -> None:
    polygons = load_polygons(find_contacts(make_plan(boxes=stack(3, overhang_mm=150))))
    assert [polygon.bounds for polygon in polygons] == [(0, 0, 400, 300), (150, 0, 400, 300), (150, 0, 400, 300)]


def test_what_is_too_much_for_a_box_below_is_refused() -> None:
    """Three boxes of 10 kg are on top of each other. The lowest box must carry 196 N, and the middle box 98 N. A load
    above a box's strength is refused."""
    plan = make_plan(boxes=[box(0, 0, 200.0 * level, 400, 300, 200, 10.0) for level in range(3)])
    known = replace(plan, strength_n=np.array([150.0, np.nan, np.nan]))
    answers = answer(known, CRITERIA, MU, 0.5)
    assert answers.slack[:, NAMES.index("strength")] == pytest.approx([1.0, 1 - 98.1 / 150, 1 - 196.2 / 150])
    assert answers.stable[:, NAMES.index("strength")].tolist() == [YES, YES, NO]
    assert answer(plan, CRITERIA, MU, 0.5).slack[:, NAMES.index("strength")].tolist() == [1.0, 1.0, 1.0]


def test_an_unknown_criterion_is_refused_with_a_hint() -> None:
    with pytest.raises(InputError, match="there is no suport_75; did you mean support_75"):
        chosen_criteria(["suport_75"])


def random_stack(rng: np.random.Generator, n: int = 7) -> list[Box]:
    """Boxes that are lowered at random places of a grid. Many boxes touch side by side, and some overhang far."""
    placed: list[tuple[Triple, Triple]] = []
    boxes: list[Box] = []
    for _ in range(n):
        size = (*(100.0 * rng.integers(1, 5, size=2)), 100.0 * rng.integers(1, 3))
        x, y = 50.0 * rng.integers(0, 9), 50.0 * rng.integers(0, 5)
        z = 0.0
        for (a, b, c), (dx, dy, dz) in placed:
            if x < a + dx and a < x + size[0] and y < b + dy and b < y + size[1]:
                z = max(z, c + dz)
        placed.append(((x, y, z), size))
        boxes.append((size, (x, y, z), float(rng.uniform(0.5, 10))))
    return boxes


def balanced_by_rays(boxes: Sequence[Box], friction: float, lean: bool) -> bool:
    """Whether all boxes can be balanced, according to another formulation and another solver. At each corner of each
    contact, the force is a sum of the edges of a friction pyramid, with weights that non-negative least squares
    finds."""
    rays, n = [], len(boxes)
    low = np.array([corner for _, corner, _ in boxes])
    high = low + np.array([size for size, _, _ in boxes])
    for upper in range(n):
        for lower in (-1, *range(n)):
            for axis in (0, 1, 2):
                if (axis == 2 and lower >= upper) or (axis < 2 and (lower < 0 or not lean)):
                    continue
                near = low[upper] if lower < 0 else np.maximum(low[upper], low[lower])
                far = high[upper] if lower < 0 else np.minimum(high[upper], high[lower])
                level = 0.0 if lower < 0 else high[lower, axis]
                across = [k for k in range(3) if k != axis]
                if low[upper, axis] != level or (far - near)[across].min() <= 0:
                    continue
                edges = [np.zeros(3)] if axis < 2 else [s * friction * np.eye(3)[k] for k in across for s in (1, -1)]
                for first in (near[across[0]], far[across[0]]):
                    for second in (near[across[1]], far[across[1]]):
                        point = np.zeros(3)
                        point[axis], point[across[0]], point[across[1]] = level, first, second
                        for edge in edges:
                            force, column = np.eye(3)[axis] + edge, np.zeros((n, 6))
                            for body, sign in ((upper, 1), (lower, -1)):
                                if body >= 0:
                                    arm = (point - (low[body] + high[body]) / 2) / 1000
                                    column[body] += sign * np.r_[force, np.cross(arm, force)]
                            rays.append(column.ravel())
    weights = np.zeros((n, 6))
    weights[:, 2] = [kg for _, _, kg in boxes]
    matrix = np.array(rays).T
    # the residual is computed here, since nnls of SciPy 1.17.1 returns 0 for some problems without a solution
    left_over = matrix @ nnls(matrix, weights.ravel(), maxiter=10_000)[0] - weights.ravel()
    return bool(np.linalg.norm(left_over) < 1e-6)


@pytest.mark.parametrize("lean", [False, True], ids=["", "leaning"])
def test_force_balance_agrees_with_rays_on_random_stacks(lean: bool) -> None:
    rng = np.random.default_rng(7)
    answers: list[bool] = []
    while len(answers) < 120:
        boxes = random_stack(rng)
        contacts = find_contacts(make_plan(boxes=boxes))
        slacks = balance_slack(contacts, contact_hulls(contacts), Friction(0.3), lean)[int(lean)]
        # the slacks up to a random placement, at most up to the first failure; no box floats
        slacks = slacks[: rng.integers(1, np.count_nonzero(~np.isnan(slacks)) + 1)]
        if abs(slacks.min()) >= 1e-6:
            answers.append(bool(slacks.min() > 0))
            assert answers[-1] == balanced_by_rays(boxes[: len(slacks)], 0.3, lean), boxes
    assert 0.2 < np.mean(answers) < 0.8


def test_the_closed_form_of_one_box_is_what_its_linear_programme_finds() -> None:
    rng = np.random.default_rng(11)
    compared = 0
    for _ in range(60):
        contacts = find_contacts(make_plan(boxes=random_stack(rng, 4)))
        system, alone = _VerticalSystem(contacts), _slack_alone(contacts, contact_hulls(contacts))
        for box_number in np.flatnonzero(~contacts.grounded):
            if not contacts.grounded[contacts.lower[contacts.upper == box_number]].all():
                continue  # the box is part of a larger structure
            assert system.slack(np.array([box_number])) == pytest.approx(min(alone[box_number], 1), abs=1e-6)
            compared += 1
    assert compared > 60


def test_boards_bear_as_boxes_would_that_stand_fast() -> None:
    """The answers for a box on a deck of boards are those for the same box on boxes at the boards' places.

    There are exceptions. Criteria that pass loads down also check the boxes at the boards' places, and the tolerable
    acceleration of the load and its points include them. Force balance treats a box that stands on the deck with all
    its corners as part of the carrier, with a slack of 1.
    """
    rng, compared, unstable = np.random.default_rng(4), 0, 0
    loads = [NAMES.index(name) for name in ("stacking_tree", "equilibrium")]
    of_load = [NAMES.index(name) for name in ("tolerable_acceleration", "load_points")]
    of_base = slice(min(loads))
    for _ in range(60):
        edges = np.sort(rng.choice(np.arange(0, 61), 8, replace=False)) * 10.0
        boards = [box(0, low, 0, 600, high - low, 100) for low, high in edges.reshape(4, 2)]
        boxes = random_stack(rng, 5)
        lifted = [*boards, *((size, (x, y, z + 100), kg) for size, (x, y, z), kg in boxes)]
        deck = np.array([((0.0, low), (600.0, high)) for low, high in edges.reshape(4, 2)])
        answers, twin = answer(make_plan(boxes=boxes), CRITERIA, MU, 0.5, deck), asked(lifted)
        np.testing.assert_array_equal(answers.n_supports, twin.n_supports[4:])
        np.testing.assert_array_equal(answers.corners, twin.corners[4:])
        np.testing.assert_allclose(answers.share, twin.share[4:], atol=1e-12)
        np.testing.assert_allclose(answers.slack[:, of_base], twin.slack[4:, of_base], atol=1e-9)
        same = [number for number in range(len(NAMES)) if number not in (*loads, *of_load)]
        np.testing.assert_array_equal(answers.stable[:, same], twin.stable[4:, same])
        assert (answers.stable[:, loads] >= twin.stable[4:, loads]).all()
        compared, unstable = compared + answers.stable.size, unstable + int((answers.stable == NO).sum())
    assert 0.2 < unstable / compared < 0.8


def test_a_box_over_a_gap_is_judged_by_what_bears_it() -> None:
    deck = np.array([((0.0, 0.0), (1000.0, 145.0)), ((0.0, 186.0), (1000.0, 286.0))])
    post = ((60.0, 60.0, 200.0), (100.0, 119.0, 0.0), 1.0)  # the centre is 4 mm beyond the edge of the first board
    answers = answer(make_plan(boxes=[post]), CRITERIA, MU, 0.5, deck)
    assert not any(says(answers)[name] for name in HULL)
    assert slack(answers, "centre") == pytest.approx(-4)
    assert answers.share[0] == pytest.approx(26 / 60)
    assert answers.corners.tolist() == [2]
    bridge = ((60.0, 100.0, 200.0), (100.0, 115.0, 0.0), 1.0)
    answers = answer(make_plan(boxes=[bridge]), CRITERIA, MU, 0.5, deck)
    assert all(says(answers)[name] for name in HULL)
    assert answers.n_supports.tolist() == [2]
    assert slack(answers, "force_balance") == pytest.approx(1 - 0.5 / 50, abs=0.05)
    assert answers.share[0] == pytest.approx(59 / 100)


def test_friction_can_hold_what_vertical_forces_cannot() -> None:
    """Friction can hold a board that vertical forces cannot hold. The board is at the edge of its support. A box that
    lies across the board and a cube would tip the board, but its friction also ties board and cube together."""
    boxes = [box(0, 0, 0, 400, 400, 200, 1.7), box(0, 200, 200, 200, 400, 100, 3.4)]
    boxes += [box(350, 150, 200, 100, 100, 100, 3.8), box(100, 200, 300, 400, 300, 200, 1.9)]
    assert [says(asked(boxes, Friction(mu)))["force_balance"] for mu in (0.0, 0.8)] == [False, True]
    assert [balanced_by_rays(boxes, mu, lean=False) for mu in (0.0, 0.8)] == [False, True]


def test_answers_do_not_depend_on_where_the_plan_is() -> None:
    boxes = random_stack(np.random.default_rng(3))
    moved = [(size, (x + 3000, y - 700, z), kg) for size, (x, y, z), kg in boxes]
    here, moved_answers = asked(boxes), asked(moved)
    assert (here.stable == moved_answers.stable).all()
    assert moved_answers.slack == pytest.approx(here.slack, abs=1e-6, nan_ok=True)


def test_equilibrium_has_the_sign_of_vertical_forces_that_balance() -> None:
    """The slack of ``equilibrium`` is positive exactly if vertical forces can balance the boxes. The sign of the slack
    is checked in 40 random piles, after each placement until a box has no balance."""
    rng = np.random.default_rng(11)
    accepted = []
    for _ in range(40):
        boxes: list[Box] = []
        below, z = [(0.0, 1000.0)], 0.0
        for _ in range(int(rng.integers(2, 5))):
            x, row, height = 0.0, [], float(rng.choice([100, 200]))
            while x < 1000:
                length = 10.0 * int(rng.integers(10, 45))
                if any(min(x + length, high) > max(x, low) for low, high in below):
                    boxes.append(((length, 300.0, height), (x, 0.0, z), float(np.exp(rng.uniform(-1, 3)))))
                    row.append((x, x + length))
                x += length + 10.0 * int(rng.integers(0, 10))
            if not row:
                break
            below, z = row, z + height
        answers = asked(boxes, Friction(0.0, 0.0))
        balance, equilibrium = (answers.slack[:, NAMES.index(name)] for name in ("force_balance", "equilibrium"))
        judged = ~np.isnan(balance)
        np.testing.assert_array_equal(equilibrium[judged] >= -1e-6, balance[judged] >= -1e-6)
        accepted.append(bool((balance[judged] >= -1e-6).all()))
    assert 5 < sum(accepted) < 35


def test_the_tolerable_acceleration_by_hand() -> None:
    """The tolerable acceleration, computed by hand. With little friction, cartons of 400 × 300 × 200 mm slide. With
    much friction, a carton on another carton, offset by 150 mm, tips over an edge, and a tower tips as a whole."""
    boxes = make_plan(boxes=stack(2, 150.0))
    tower = make_plan(boxes=stack(8))
    for friction, of_boxes in ((0.4, [0.4, 0.4]), (3.0, [150 / 100, 50 / 100])):
        contacts = find_contacts(boxes, 0.5)
        found = tolerable_acceleration_g(contacts, contact_hulls(contacts), friction)
        assert found == pytest.approx(of_boxes)
    contacts = find_contacts(tower, 0.5)
    found = tolerable_acceleration_g(contacts, contact_hulls(contacts), 3.0)
    assert found == pytest.approx([150 / (100 * k) for k in range(1, 9)])  # the tower's centre is at half of its height
    names = chosen_criteria(("tolerable_acceleration",))
    answers = answer(tower, names, Friction(0.6), 0.5)
    # a tower of three boxes tolerates exactly 0.5 g
    assert answers.stable[:, 0].tolist() == [YES, YES, YES, NO, NO, NO, NO, NO]
    assert not {"tolerable_acceleration", "load_points"} & {criterion.name for criterion in chosen_criteria()}


BESIDE = ((CARTON_MM, (0, 0, 0), 6.0), (CARTON_MM, (400, 0, 0), 2.0))
LEANING_OUT = stack(2, 100.0, kg=(2.0, 6.0))


@pytest.mark.parametrize(
    ("boxes", "points"),
    [
        (stack(1), [25, 25, 10, 10, 15, 15]),
        (stack(5), [25, 25, 10, 0, 15, 15]),  # each box lies on one box
        (BESIDE, [25, 12.5, 10, 10, 15, 15]),  # the right half has a quarter of the mass
        # the centre is at 250 of 400 mm; 2.5 of 8 kg are left of the middle; 4/5 of the volume is filled; a quarter of
        # the base overhangs; the heavier box is above
        (LEANING_OUT, [18.75, 15.625, 8, 0, 11.25, 0]),
    ],
    ids=["carton", "tower", "beside", "leaning out"],
)
def test_points_of_a_load_by_hand(boxes: tuple[Box, ...], points: list[float]) -> None:
    plan = make_plan(boxes=boxes)
    assert [*load_points(find_contacts(plan, 0.5)).values()] == pytest.approx(points)
    answers = answer(plan, chosen_criteria(("load_points",)), Friction(0.6), 0.5)
    assert answers.stable[:, 0].tolist() == [YES] * (len(boxes) - 1) + [YES if sum(points) >= 75 else NO]
    assert answers.slack[-1, 0] == pytest.approx(sum(points) - 75)


def test_criteria_are_judged_by_how_often_plans_arrive(tmp_path: Path) -> None:
    chain = tmp_path / "chain.toml"
    chain.write_text(
        "replicates = 4\n[axes]\nfriction_tolerance_rel = { distribution = 'uniform', low = -0.1, high = 0.1 }\n"
        "[[legs]]\nname = 'truck'\nevents = [{ profile = 'eumos-40509', level = 0.4 }]\n"
    )
    plans = [make_plan("low", stack(1)), make_plan("tower", stack(3, size_mm=(100.0, 100.0, 300.0)))]
    run = petmjx.score(plans, chain=chain, engine="mujoco")
    assert set(run.worlds.query("variant == 0")["verdict"]) == {"stable"}
    names = ("centre", "tolerable_acceleration")
    judged = petmjx.criteria(plans, run=run, only=names).judged
    assert judged is not None
    cells = judged.set_index("criterion")[[*CELLS]]
    assert cells.loc["centre"].tolist() == [1, 1, 0, 0]
    assert cells.loc["tolerable_acceleration"].tolist() == [1, 0, 0, 1]
    shares = run.summary.query("scope == 'plan' and leg == ''").set_index("plan_id")["share"]
    means = judged.set_index("criterion")[[*ARRIVES]]
    assert means.loc["tolerable_acceleration"].tolist() == [shares["low"], shares["tower"]]
    assert means.loc["centre"].iloc[0] == shares.mean()
    assert np.isnan(means.loc["centre"].iloc[1])  # the criterion ``centre`` refuses no plan
    assert petmjx.criteria(plans, run=run, only=names, p_arrives=0.0).judged[[*CELLS]].iloc[0].tolist() == [2, 0, 0, 0]
