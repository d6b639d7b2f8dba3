"""Room for boxes that appear at their places although places and sizes have errors. Boxes are moved by the smallest
translations, which are compared with closed forms, and contacts do not decide verdicts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import isotonic_regression
from support.command_line import write

import petmjx
from petmjx.common.units import FloatArray
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.release_places import CLEAR_M, make_room
from petmjx.world.scene import Scene

KNOWN_M = 5e-6
"""Tolerance of a place, m: in a row of boxes, the remaining errors of all contacts add up."""
GAP_M = 1e-4
"""Gap between neighbours in the plan, m."""


def row(size: list[float], place: list[float], planned: list[float], **options: Any) -> FloatArray:
    """Final places along x of boxes in a row, from their drawn places. The boxes are 1 m wide in y."""
    n = len(size)
    half = np.column_stack([np.array(size) / 2, np.full((n, 2), 0.5)])
    planned_half = np.full((n, 3), 0.5)
    along = np.column_stack([place, np.zeros(n)])
    middles = np.column_stack([planned, np.zeros(n)])
    given = {"beside": ~np.eye(n, dtype=bool), "movable": np.ones(n, bool), "reach_m": 0.3, **options}
    (places,) = make_room(along[None], half[None], np.zeros((1, n)), middles, planned_half, **given)
    assert not places[:, 1].any()
    return places[:, 0]


def test_boxes_that_find_room_stay_where_they_are() -> None:
    planned = [0.0, 1.0 + GAP_M, 2.0 + 2 * GAP_M]
    assert row([1.0] * 3, planned, planned).tolist() == planned
    moved = [-0.003, 1.0 + GAP_M, 2.004]
    assert row([1.0, 0.999, 1.0], moved, planned).tolist() == moved


def test_two_boxes_share_the_way_apart_and_one_that_stands_leaves_it_to_the_other() -> None:
    planned = [0.0, 1.0 + GAP_M]
    places = row([1.002, 1.002], planned, planned)
    np.testing.assert_allclose(places, [-0.001, 1.0 + GAP_M + 0.001], atol=KNOWN_M)
    places = row([1.002, 1.002], planned, planned, movable=np.array([False, True]))
    np.testing.assert_allclose(places, [0.0, 1.002 + GAP_M], atol=KNOWN_M)
    # in the plan, the boxes are 3 mm apart; with errors they overlap by 1 mm. They are then moved apart only by the
    # usual gap
    wide = [0.0, 1.003]
    places = row([1.002, 1.002], [0.001, 1.002], wide)
    np.testing.assert_allclose(places, [0.001 - (0.001 + CLEAR_M) / 2, 1.002 + (0.001 + CLEAR_M) / 2], atol=KNOWN_M)


def test_a_row_of_wide_boxes_spreads_from_its_middle() -> None:
    """By symmetry, the middle box keeps its place. Each other box moves by as much as all boxes between it and the
    middle box need."""
    n, wider = 7, 0.002
    planned = [k * (1.0 + GAP_M) for k in range(n)]
    places = row([1.0 + wider] * n, planned, planned)
    np.testing.assert_allclose(places - planned, (np.arange(n) - 3) * wider, atol=n * KNOWN_M)


def test_the_translations_are_the_least() -> None:
    """In a row of boxes, the smallest translations are the solution of an isotonic regression: from box to box, the
    difference (place − widths of all boxes before) must not decrease."""
    rng = np.random.default_rng(11)
    n = 9
    planned = np.arange(n) * (1.0 + GAP_M)
    drawn, size = planned + rng.normal(0.0, 0.002, n), 1.0 + rng.normal(0.0, 0.001, n)
    offsets = np.concatenate([[0.0], np.cumsum((size[1:] + size[:-1]) / 2 + GAP_M)])
    expected = isotonic_regression(drawn - offsets).x + offsets
    assert np.abs(expected - drawn).max() > 0.001
    np.testing.assert_allclose(row(size.tolist(), drawn.tolist(), planned.tolist()), expected, atol=n * KNOWN_M)


def test_what_overlaps_in_the_plan_does_so_still_and_what_stands_above_is_left_alone() -> None:
    planned = [0.0, 0.99]
    assert row([1.0, 1.0], planned, planned).tolist() == planned
    np.testing.assert_allclose(row([1.002, 1.002], planned, planned), [-0.001, 0.991], atol=KNOWN_M)
    above = np.zeros((2, 2), dtype=bool)
    assert row([1.5, 1.5], planned, planned, beside=above).tolist() == planned


def corners(place: FloatArray, half: FloatArray, yaw: float) -> FloatArray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    outline = np.array([(x, y) for x in (-1, 1) for y in (-1, 1)]) * half
    return np.asarray(place + outline @ np.array([[cos, sin], [-sin, cos]]))


def test_turned_boxes_are_apart_and_no_world_depends_on_another() -> None:
    rng = np.random.default_rng(3)
    planned = np.array([(i * 0.3001, j * 0.2001) for j in range(3) for i in range(3)])
    half = np.tile([0.15, 0.1, 0.1], (9, 1))
    drawn = planned + rng.normal(0.0, 0.003, (4, 9, 2))
    halves, yaw = half + rng.normal(0.0, 0.001, (4, 9, 3)), rng.normal(0.0, 0.01, (4, 9))
    more = planned, half, ~np.eye(9, dtype=bool), np.ones(9, bool), 0.05
    places = make_room(drawn, halves, yaw, *more)
    for k in range(4):
        (alone,) = make_room(drawn[k : k + 1], halves[k : k + 1], yaw[k : k + 1], *more)
        np.testing.assert_array_equal(alone, places[k])
        outlines = [corners(places[k, box], halves[k, box, :2], yaw[k, box]) for box in range(9)]
        for i in range(9):
            for j in range(i):
                assert separation(outlines[i], outlines[j], (yaw[k, i], yaw[k, j])) > -KNOWN_M


def separation(one: FloatArray, other: FloatArray, yaws: tuple[float, float]) -> float:
    """Distance between two turned rectangles, m, from the projections of their corners on all four axes."""
    gaps = []
    for yaw in yaws:
        for axis in (np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])):
            a, b = one @ axis, other @ axis
            gaps.append(max(a.min() - b.max(), b.min() - a.max()))
    return float(max(gaps))


ERRORS = "seed = 7\n[axes]\nplacement_error_x_mm = 3\nsize_tolerance_mm = 1"


def ledge(n: int, margin: float) -> petmjx.Plan:
    """A plan of boxes of 300 mm side by side on a narrower base of two boxes. The centres of the outer boxes are inside
    the ends of the base by this margin, mm."""
    base = (n - 1) * 300.0 + 2 * margin
    x = (n * 300.0 - base) / 2
    return petmjx.Plan.from_boxes(
        f"ledge-{n}-{margin:g}",
        size_mm=[(base / 2, 250, 150)] * 2 + [(300, 250, 200)] * n,
        corner_mm=[(x, 0, 0), (x + base / 2, 0, 0)] + [(k * 300, 0, 150) for k in range(n)],
        mass_kg=[8.0] * 2 + [6.0] * n,
    )


def overhang_m(scene: Scene) -> float:
    """Largest distance of the centre of an upper box beyond the end of the base, m. If it is negative, all boxes
    stand."""
    x, half = scene.start_pos[:, 0], scene.half_size[:, 0]
    return float(max((x[0] - half[0]) - x[2:].min(), x[2:].max() - (x[1] + half[1])))


@pytest.fixture(scope="module")
def ledges(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[petmjx.Plan], Any]:
    errors = write(tmp_path_factory.mktemp("ledges") / "errors.toml", ERRORS)
    return [ledge(2, 2.0), ledge(3, 4.0)], errors


def test_whether_boxes_that_appear_stand_follows_from_statics_in_any_contacts(
    ledges: tuple[list[petmjx.Plan], Any],
) -> None:
    """If contacts pushed the boxes apart, some would tip over the ends of the base, and which boxes tip would depend on
    the timestep."""
    plans, errors = ledges
    sweep = confidence_sweep(8, errors, {"placing": "exact"})
    every = SweepPlan(sweep, plans)
    scenes = {(group.plan.plan_id, group.index): scene for group, scene in every.scenes(every.groups())}
    stands = {key: overhang_m(scene) < 0 for key, scene in scenes.items()}
    # a smaller distance may be changed by soft contacts and gaps
    sure = [key for key, scene in scenes.items() if abs(overhang_m(scene)) > 5e-4]
    assert len(sure) >= 12
    assert 0 < sum(stands[key] for key in sure) < len(sure)
    for physics in ({}, {"timestep_s": 0.004}, {"solref": (0.04, 1.25)}):
        options = {"physics": physics} if physics else {}
        worlds = petmjx.score(plans, engine="mujoco", confidence=8, errors=errors, placing="exact", **options).worlds
        verdicts = dict(zip(zip(worlds["plan_id"], worlds["variant"], strict=True), worlds["verdict"], strict=True))
        assert {key: verdicts[key] == "stable" for key in sure} == {key: stands[key] for key in sure}
