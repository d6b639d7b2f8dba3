"""Pallets that stay settled (``petmjx.Pallets``): what they report of placements agrees with a score of the plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pandas as pd
import pytest

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.mujoco.box_motion import tilt_deg
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.loop.pallets import Pallets
from petmjx.loop.placement_results import PlacementResults
from petmjx.packers.baseline_packer import PackRules, _Pile
from petmjx.results.run_reader import RunResults

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.tiny_worlds import engine as warp_engine
from support.worlds import boxes_by_plan, make_plan

pytestmark = pytest.mark.usefixtures("ranks_may_differ")

NAMES = ("hand-one-box", "hand-bridge", "hand-falls-off", "hand-overhang-55", "stack of 4")
SLOW = 5e-6
"""Tolerance in m and °. A pallet that has paused still gives way during the 0.3 s for which a score goes on."""


@pytest.fixture(scope="module")
def engine() -> Engine:
    return MujocoEngine(2)


@pytest.fixture
def pallets(engine: Engine) -> Pallets:
    return Pallets(3, engine=engine, most_boxes=8)


def carton(*corners: tuple[float, float, float]) -> dict[str, Any]:
    return {"size_mm": (400, 300, 200), "corner_mm": corners, "mass_kg": 6}


def assert_same(one: PlacementResults, other: PlacementResults, *skipped: str) -> None:
    """Assert that results agree to the last bit, apart from the skipped fields."""
    for field in fields(PlacementResults):
        if field.name not in skipped:
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), field.name)


def placed_box_by_box(
    engine: Engine, names: Sequence[str], most_boxes: int
) -> tuple[Pallets, dict[int, PlacementResults]]:
    """Return a pallet for each plan, placed box by box, and the last report on each pallet."""
    plans = [make_plan(name, boxes_by_plan()[name]) for name in names]
    pallets = Pallets(len(plans), engine=engine, most_boxes=most_boxes)
    report_by_row: dict[int, PlacementResults] = {}
    for number in range(max(plan.n_boxes for plan in plans)):
        rows = [k for k, plan in enumerate(plans) if plan.n_boxes > number and not pallets.ended[k]]
        boxes = [(plans[k].size_mm[number], plans[k].corner_mm[number], plans[k].mass_kg[number]) for k in rows]
        size, corner, mass = (np.array(values) for values in zip(*boxes, strict=True))
        report = pallets.place(size_mm=size, corner_mm=corner, mass_kg=mass, pallet=rows)
        report_by_row |= {row: report[k] for k, row in enumerate(rows)}
    return pallets, report_by_row


def assert_scored(pallets: Pallets, engine: Engine) -> RunResults:
    """Assert that the score of the pallets is that of their plans, in every column and to the last bit."""
    plans = [pallets.plan(k) for k in range(len(pallets))]
    expected, scored = petmjx.score(plans, engine=engine, carrier="euro-pallet"), pallets.score()
    for table in ("worlds", "boxes", "attempts"):
        pd.testing.assert_frame_equal(getattr(scored, table), getattr(expected, table), check_exact=True)
    assert set(scored.worlds.verdict) == {"stable", "unstable"}
    return scored


def test_a_plan_that_is_placed_has_the_verdict_and_the_numbers_of_a_score(engine: Engine) -> None:
    pallets, report_by_row = placed_box_by_box(engine, NAMES, 8)
    scored = assert_scored(pallets, engine)
    for row, of_world in enumerate(scored.worlds.itertuples()):
        assert report_by_row[row].verdict[0] == of_world.verdict == pallets.verdict(row)
        assert report_by_row[row].culprit[0] == (-1 if pd.isna(of_world.culprit) else of_world.culprit)
        if of_world.verdict == "stable":
            np.testing.assert_allclose(report_by_row[row].margin, of_world.margin, atol=1e-3)
            boxes_of = scored.boxes[scored.boxes.plan_id == of_world.plan_id]
            np.testing.assert_allclose(report_by_row[row].middle_mm[0, :, 2], boxes_of.pos_z_m * 1000, atol=SLOW * 1000)
            np.testing.assert_allclose(
                report_by_row[row].top_force_n[0], boxes_of.rest_top_force_n, rtol=0.01, atol=0.05
            )


@pytest.mark.slow
def test_on_mjx_warp_pallets_go_on_to_the_score_from_where_they_stand() -> None:
    engine = warp_engine()
    pallets, _ = placed_box_by_box(engine, ("hand-one-box", "hand-falls-off"), 4)
    box = {"size_mm": (200, 200, 200), "corner_mm": (700, 400, 0), "mass_kg": 3, "pallet": 0}
    before, tried = pallets.results(), pallets.try_all(**box)
    assert_same(pallets.results(), before)
    assert_same(pallets.place(**box), tried)
    assert tried.n_boxes.tolist() == [2]
    assert_scored(pallets, engine)
    pallets.take_back(0)
    assert_same(pallets.results(), before)


def test_trials_end_at_the_same_step_on_both_engines_when_a_box_is_gone() -> None:
    """Trials (simulations of a candidate for the next box) end when a box is lost.

    Such trials say whether each candidate stands, as trials to the end do. A candidate that tips ends its trial at a
    look (a regular check of all boxes), before the next sample: when it is tilted by 1.25 times the threshold.
    """
    times: dict[str, Any] = {}
    for engine in (MujocoEngine(1), warp_engine()):
        pallets = Pallets(1, engine=engine, most_boxes=8)
        pallets.place(**carton((400, 200, 0)))
        pallets.place(**carton((0, 200, 0)))
        candidates = carton((590, 200, 200), (640, 200, 200), (395, 340, 200), (420, 210, 200))
        results = pallets.try_all(**candidates)
        stands, _ = pallets.stands(**candidates)
        np.testing.assert_array_equal(stands, results.stable)
        assert results.stable.tolist() == [True, False, True, True]
        boxes = pallets._standing.next_boxes(pallets._placements(*(candidates[name] for name in candidates), [0] * 4))
        lost, whole = (pallets._worlds.try_next([0] * 4, boxes, until_lost=until) for until in (True, False))
        np.testing.assert_array_equal(lost.time_s[[0, 2, 3]], whole.time_s[[0, 2, 3]])
        sim = pallets.simulation
        step = round(lost.time_s[1] / sim.physics.timestep_s)
        assert step % sim.quiet.poll_steps == 0
        assert lost.time_s[1] % sim.sample_interval_s > sim.physics.timestep_s, "it is no sample"
        assert lost.time_s[1] < whole.time_s[1]
        assert lost.ended[1]
        assert lost.max_tilt_deg[1].max() <= sim.thresholds.tilt_deg
        tilts = tilt_deg(lost.quat[1])
        assert 1.25 * sim.thresholds.tilt_deg < np.nanmax(tilts) < 1.5 * sim.thresholds.tilt_deg
        times[pallets.engine] = lost.time_s
    assert len({tuple(of_engine.tolist()) for of_engine in times.values()}) == 1


def test_a_candidate_is_told_of_as_if_it_were_placed_and_changes_nothing(pallets: Pallets) -> None:
    pallets.place(**carton((0, 0, 0), (100, 100, 0), (0, 0, 0)))
    before = pallets.results()
    corners, which = (
        np.array([(0, 0, 200), (300, 100, 200), (0, 0, 200), (160, 100, 200), (500, 0, 0)]),
        [2, 1, 0, 1, 1],
    )
    candidates = {
        "size_mm": [(400, 300, 200), (400, 300, 100), (200, 200, 200), (400, 300, 200), (300, 400, 200)],
        "corner_mm": corners,
        "mass_kg": [1, 2, 3, 4, 5],
        "pallet": which,
    }
    tried = pallets.try_all(**candidates)
    assert tried.stable.tolist() == [True, False, True, True, True]
    assert (tried.culprit[1], tried.reason[1]) == (1, "tilt")
    assert tried.margin[1] < 0 < tried.margin[3] < 1
    assert_same(pallets.results(), before)
    for row, pallet in enumerate(which):
        placed = pallets.place(**{name: [values[row]] for name, values in candidates.items()})
        assert_same(placed, tried[row])
        pallets.take_back(pallet)
        assert_same(pallets.results(), before)
    np.testing.assert_allclose(tried.top_force_n[0, 0], 9.81, rtol=0.01)


def test_boxes_are_taken_back_pallets_forked_and_reset(pallets: Pallets) -> None:
    pallets.place(**carton((0, 0, 0)), pallet=1)
    one = pallets.results(1)
    pallets.place(**carton((10, 0, 200)), pallet=1)
    two = pallets.results(1)
    pallets.fork([1, 1], [0, 2])
    assert_same(pallets.results(2), two, "pallet")
    pallets.place(**carton((300, 0, 400)), pallet=2)  # the box falls
    assert not pallets.results(2).stable[0]
    assert pallets.n_boxes.tolist() == [2, 2, 3]
    pallets.take_back(2)
    assert_same(pallets.results(2), two, "pallet")
    pallets.take_back(2)  # the pallet is built again from its boxes
    assert_same(pallets.results(2), one, "pallet")
    assert_same(pallets.results(1), two)
    pallets.reset([0, 1])
    assert pallets.n_boxes.tolist() == [0, 0, 1]
    pallets.place(**carton((0, 0, 0)), pallet=1)
    assert_same(pallets.results(1), one)
    assert pallets.results(0).n_boxes.tolist() == [0]


def test_while_pallets_come_to_rest_others_ask_where_boxes_are_and_of_nothing_else(pallets: Pallets) -> None:
    alone = pallets.place(**carton((0, 0, 0), (0, 0, 0), (1000, 0, 0)))
    pallets.reset()
    answers = []

    def meanwhile() -> None:
        answers.append((pallets.boxes()[1], pallets.places(size_mm=(400, 300, 200), pallet=0), pallets.height_map(400)))
        for ask in (
            pallets.results,
            pallets.reset,
            pallets.close,
            lambda: pallets.place(**carton((0, 0, 0)), pallet=0),
        ):
            with pytest.raises(InputError, match="meanwhile: "):
                ask()

    report = pallets.place(**carton((0, 0, 0), (0, 0, 0), (1000, 0, 0)), meanwhile=meanwhile)
    assert_same(report, alone)
    ((corners, places, heights),) = answers
    np.testing.assert_array_equal(corners[:, 0, 0], [0, 0, 1000])
    assert [400, 0, 0] in places.corner_mm.tolist()
    assert [0, 0, 0] not in places.corner_mm.tolist()
    assert heights[0, 0, 0] == 200
    with pytest.raises(ZeroDivisionError):
        pallets.place(**carton((400, 0, 0)), pallet=0, meanwhile=lambda: 1 / 0)
    assert pallets.results(0).n_boxes == 2  # the box was placed although ``meanwhile`` failed


def test_errors_and_drives(pallets: Pallets) -> None:
    pallets.place(**carton((0, 0, 0)), pallet=0)
    corners = [(0, 0, 200), (198, 0, 200), (260, 0, 200)]
    report = pallets.try_all(**carton(*corners), pallet=0, errors=4)
    assert report.stable.tolist() == [True, True, False]
    assert (report.share[0], report.share[2]) == (1.0, 0.0)
    assert 0 <= report.share[1] < 1, "half of the errors go over the edge"
    slender = {"size_mm": (100, 100, 400), "corner_mm": [(0, 0, 200), (600, 300, 0)], "mass_kg": 2, "pallet": 0}
    low, high = (pallets.try_all(**slender, drive="eumos-40509", level=level) for level in (0.1, 0.45))
    assert low.stable.all()
    assert not high.stable.any()
    assert pallets.try_all(**slender).stable.all()
    assert pallets.n_boxes.tolist() == [1, 0, 0]


def test_a_pallet_that_falls_ends_and_no_other_does(pallets: Pallets) -> None:
    boxes = {"size_mm": (400, 300, 200), "corner_mm": [(0, 0, 0), (1100, 0, 0), (0, 0, 0)], "mass_kg": 5}
    report = pallets.place(**boxes)
    assert report.ended.tolist() == pallets.ended.tolist() == [False, True, False]
    assert (report.verdict[1], report.reason[1], report.culprit[1]) == ("unstable", "drop", 0)
    with pytest.raises(InputError, match="pallet: 1 has fallen; reset it"):
        pallets.try_all(**carton((0, 0, 0)), pallet=1)
    pallets.place(**carton((0, 0, 200)), pallet=2)
    pallets.take_back(1)
    assert not pallets.ended.any()
    assert pallets.n_boxes.tolist() == [1, 0, 2]


def test_what_is_wrong_is_one_line_that_names_the_argument(engine: Engine) -> None:
    pallets, good = Pallets(2, engine=engine, most_boxes=4), carton((0, 0, 0))
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"size_mm": (400, 300)}, r"size_mm must have the shape \(n, 3\)"),
        ({"size_mm": [(400, 300, 200)] * 3}, "size_mm must have 1 row, one for each box, got 3"),
        ({"size_mm": (0.4, 0.3, 0.2)}, "size_mm must be from 1 to 4000 millimetres, got 0.4"),
        ({"mass_kg": "6"}, "mass_kg must be an array of numbers"),
        ({"mass_kg": -1}, "mass_kg must be from"),
        ({"mass_kg": np.nan}, "mass_kg must be finite"),
        ({"corner_mm": None}, "corner_mm is missing"),
        ({"pallet": 2}, "pallet: there are pallets 0 to 1, got 2"),
        ({"pallet": 0.5}, "pallet must be whole numbers"),
        ({"pallet": None}, "pallet must name one of the 2 pallets for each box"),
    ]
    for change, message in wrong:
        with pytest.raises(InputError, match=message):
            pallets.place(**{"pallet": 0, **good, **change})
    with pytest.raises(InputError, match="pallet: 0 is named twice"):
        pallets.place(**carton((0, 0, 0), (0, 0, 200)), pallet=0)
    for call, message in (
        (lambda: pallets.take_back(1), "pallet: 1 has no box"),
        (lambda: pallets.plan(1), "pallet: 1 has no boxes"),
        (lambda: pallets.verdict(2), "pallet: there are pallets"),
        (lambda: pallets.fork([0], [0, 1]), "'into' must name one pallet for each source, 1 in all"),
        (lambda: pallets.fork([0, 0], [1, 1]), "into: 1 is named twice"),
        (lambda: pallets.height_map(0.1), "cell_mm must be at least"),
        (lambda: pallets.try_all(**good, pallet=0, errors=0), "errors must be at least 1"),
        (lambda: pallets.try_all(**good, pallet=0, level=0.3), "level needs a drive"),
        (lambda: pallets.places(size_mm=None), "size_mm is missing"),
        (lambda: pallets.places(size_mm=(4, 3, 2), pallet=0, max_height_mm=np.nan), "max_height_mm must be"),
        (lambda: pallets.places(size_mm=(400, 300, 200), pallet=0, hulls=3), "hulls must be true or false"),
        (
            lambda: pallets.places(size_mm=(400, 300, 200), pallet=0, grid_mm=[(-5, 0)]),
            "grid_mm: all points must lie on",
        ),
        (lambda: pallets.show(0, size=(0, 0)), "size must be at least 16"),
        (lambda: pallets.show(0, view=None), "view must be text"),  # type: ignore[arg-type]
        (pallets.score, "pallet: there is no box on any pallet"),
        (lambda: pallets.try_all(**good, pallet=0, drive="eumos"), "unknown profile 'eumos'"),
        (lambda: pallets.try_all(**good, pallet=0, drive="en-12195-1"), "drive: en-12195-1 stands for several"),
        (lambda: Pallets(0), "n must be at least 1"),
        (lambda: Pallets(carrier="footprint"), "carrier: the size of footprint depends on the whole plan"),
        (lambda: Pallets(schedule="fixed"), "schedule must be 'adaptive' if boxes are added one by one"),
        (lambda: Pallets(check="static"), "check must be 'one-by-one'"),
        (lambda: Pallets(engine="mjx"), "engine must be one of mujoco"),
        (lambda: Pallets(engine="mjx-jax"), "engine mjx-jax has no open worlds"),
        (lambda: Pallets(resume=True), "resume: pallets have no such option"),
        (lambda: Pallets(carier="epal-1"), "unknown option carier"),
    ):
        with pytest.raises(InputError, match=message):
            call()
    assert not pallets.n_boxes.any()
    nothing: dict[str, Any] = {"size_mm": np.zeros((0, 3)), "corner_mm": np.zeros((0, 3)), "mass_kg": 5.0, "pallet": 0}
    assert len(pallets.try_all(**nothing)) == len(pallets.place(**nothing)) == 0  # no box, as where no place is left
    for _ in range(4):
        pallets.place(**carton((0, 0, 200 * int(pallets.n_boxes[0]))), pallet=0)
    with pytest.raises(InputError, match="pallet: 0 has 4 boxes already; make pallets with a larger most_boxes"):
        pallets.place(**carton((0, 0, 800)), pallet=0)


def test_height_maps_and_places_are_those_of_the_packers() -> None:
    rng, pallets = np.random.default_rng(2), Pallets(3, threads=2)
    piles = [_Pile(8, (1200, 800), PackRules(min_support=0.0, centre_supported=False)) for _ in range(3)]
    for _ in range(4):
        sizes = rng.integers(2, 5, (3, 3)) * 100.0
        places = pallets.places(size_mm=sizes)
        corners = []
        for row, pile in enumerate(piles):
            row_corners = places.corner_mm[places.row == row]
            points = np.array(list(pile._points))
            inside = points[(points + sizes[row, :2] <= (1200, 800)).all(axis=1)]
            z, share = pile._rest(inside, np.tile(sizes[row, :2], (len(inside), 1)))
            assert {tuple(corner) for corner in row_corners} == {tuple(map(float, row)) for row in np.c_[inside, z]}
            assert sorted(places.support[places.row == row]) == pytest.approx(sorted(share))
            centred = [pile._centre_supported(c[:2], sizes[row, :2], c[2]) for c in row_corners]
            np.testing.assert_array_equal(places.centred[places.row == row], centred)
            order = np.lexsort((row_corners[:, 1], row_corners[:, 0], row_corners[:, 2]))
            np.testing.assert_array_equal(row_corners[order], row_corners)
            corners.append(row_corners[0])
            pile.add(tuple(sizes[row, :2]), sizes[row, 2], tuple(row_corners[0]))
        assert pallets.place(size_mm=sizes, corner_mm=corners, mass_kg=5).stable.all()
    heights = pallets.height_map(50)
    assert heights.shape == (3, 24, 16)
    for row, pile in enumerate(piles):
        for x, y in ((0, 0), (7, 3), (23, 15)):
            middle = np.array([x, y]) * 50 + 25
            covers = ((pile._low[: pile.n, :2] < middle) & (middle < pile._high[: pile.n, :2])).all(axis=1)
            assert heights[row, x, y] == pile._high[: pile.n, 2][covers].max(initial=0)


def test_after_close_all_methods_say_so() -> None:
    pallets, scorer = petmjx.Pallets(1, engine="mujoco"), petmjx.Scorer(engine="mujoco")
    good = carton((0, 0, 0))
    pallets.place(**good)
    plan = pallets.plan()
    for resource in (pallets, scorer):
        resource.close()
        resource.close()
    for call in (
        lambda: pallets.place(**good),
        lambda: pallets.try_all(**good, drive="unknown"),
        lambda: pallets.places(size_mm=(400, 300, 200)),
        lambda: pallets.fork(0, 0),
        *(getattr(pallets, name) for name in ("take_back", "reset", "results", "plan", "score", "verdict")),
        *(getattr(pallets, name) for name in ("height_map", "boxes", "show")),
    ):
        with pytest.raises(InputError, match=r"^petmjx\.Pallets: closed; make a new one$"):
            call()
    for call in (lambda: scorer.score(plan), lambda: scorer.tell(size_mm=1, corner_mm=2, mass_kg=3)):
        with pytest.raises(InputError, match=r"^petmjx\.Scorer: closed; make a new one$"):
            call()
