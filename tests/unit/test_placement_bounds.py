"""Closed-form bounds: placements that surely stand or fall. The bounds are compared with geometry and with
simulations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import petmjx
from benchmarks.placement_bounds_check import bounds
from petmjx.engines.engine_registry import make_engine
from petmjx.loop.placement_bounds import FALLS, OPEN, STANDS, _hull_edges, _margin

MUJOCO: dict[str, Any] = {"engine": "mujoco", "threads": 1}

BOX = (400, 300, 200)


def pile(*boxes: tuple[Any, ...], **options: Any) -> petmjx.Pallets:
    """A pallet with these boxes. Each box is a corner, perhaps followed by a size and a mass."""
    pallets = petmjx.Pallets(**{**MUJOCO, **options})
    for corner, *more in boxes:
        size, mass = (*more, *(BOX, 6.0)[len(more) :])
        assert pallets.place(size_mm=size, corner_mm=corner, mass_kg=mass).stable
    return pallets


def said(pallets: petmjx.Pallets, corner: Any, size: Any = BOX, mass: float = 6.0) -> int:
    return int(pallets.decided(size_mm=size, corner_mm=corner, mass_kg=mass)[0])


def test_what_the_geometry_decides() -> None:
    one = pile(((400, 200, 0),))
    assert said(one, (0, 0, 0)) == STANDS  # on the carrier
    assert said(one, (400, 200, 200)) == STANDS  # on the box
    assert said(one, (425, 250, 200)) == STANDS  # its weight is 175 and 100 mm from the edges
    assert said(one, (590, 200, 200)) == OPEN  # 10 mm from the edge
    assert said(one, (620, 200, 200)) == FALLS  # its weight acts 20 mm beyond the edge
    assert said(one, (0, 0, 50)) == OPEN  # no body is below the box
    assert said(one, (500, 200, 100)) == OPEN  # the place overlaps the box on the pallet
    assert said(one, (400, 200, 200), BOX, 700.0) == OPEN  # too heavy for the box below
    assert said(one, (550, 300, 200), (90, 90, 600)) == OPEN  # the box is slender


def test_what_may_catch_a_box_leaves_it_open() -> None:
    """The box hangs over the edge of its support by 150 mm. A neighbour as high as the support bears it; a neighbour 20
    mm lower may catch it; a neighbour 150 mm lower does not. If a wall stands in front of the box, the box may lean on
    it, unless the wall is farther away than the box turns. A low box at its side cannot hold it by friction. A high box
    at its side may hold it, and so may low boxes on both sides, between which it may jam."""
    support = ((440, 200, 0), (110, 300, 200))
    hanging = {"corner": (440, 200, 200), "size": (300, 300, 200)}
    expected = {
        None: FALLS,
        ((600, 200, 0), (300, 300, 200)): STANDS,
        ((600, 200, 0), (300, 300, 180)): OPEN,
        ((600, 200, 0), (300, 300, 50)): FALLS,
        ((745, 200, 0), (100, 300, 400)): OPEN,
        ((850, 200, 0), (100, 300, 400)): FALLS,
        ((340, 200, 0), (95, 300, 400)): FALLS,
        ((440, 500, 0), (300, 200, 400)): OPEN,
    }
    for other, verdict in expected.items():
        pallets = pile(support) if other is None else pile(support, other)
        assert said(pallets, **hanging) == verdict, other
        if verdict != OPEN:
            results = pallets.try_all(size_mm=hanging["size"], corner_mm=hanging["corner"], mass_kg=6)
            assert bool(results.stable[0]) == (verdict == STANDS)


@pytest.mark.parametrize(("gap", "verdict"), [(1, OPEN), (3, FALLS)])
def test_a_low_box_at_either_side_may_catch_a_box_if_the_gap_is_small(gap: int, verdict: int) -> None:
    """The box hangs over by 150 mm. A neighbour 20 mm lower is beside the overhang, on either side. Boxes at rest may
    be off their places, so that a gap of 1 mm may close."""
    for y in (200 - gap - 150, 500 + gap):
        pallets = pile(((440, 200, 0), (110, 300, 200)), ((560, y, 0), (300, 150, 180)))
        assert said(pallets, (440, 200, 200), (300, 300, 200)) == verdict, y


def test_a_box_beside_holds_by_friction_as_much_as_the_friction_below_allows() -> None:
    """A box on a beam hangs over by 48 mm, and a heavy box touches its side. The friction at the side can hold the box
    up to a limit: μ² times the lever, with μ = 0.5. If the faces touch up to 50 mm above the base, the limit is an
    overhang of 25 mm; if they touch up to the top, it is 64 mm."""
    for top, verdict in ((250, FALLS), (440, OPEN)):
        pallets = pile(((300, 200, 0), (72, 300, 200)), ((300, 500, 0), (160, 200, top), 20.0))
        assert said(pallets, (300, 200, 200), (240, 300, 240)) == verdict, top


def test_a_box_that_has_moved_leaves_open_what_it_may_touch_and_what_stands() -> None:
    """A box leans on a neighbour that is 5 mm lower than its support. For boxes on the far side of the pallet, the
    bounds still decide that they fall. For boxes beside the leaning box, they do not decide. No box surely stands any
    more."""
    support, lower = ((440, 200, 0), (110, 300, 200)), ((600, 200, 0), (300, 300, 195))
    pallets = pile(support, lower, ((0, 0, 0), (200, 200, 300)), ((380, 600, 0), (50, 100, 250)))
    hanging, beside = ((150, 0, 300), (200, 200, 200)), ((380, 480, 250), (50, 200, 200))
    on_carrier = ((600, 500, 0), (400, 300, 200))
    assert [said(pallets, *box) for box in (hanging, beside, on_carrier)] == [FALLS, FALLS, STANDS]
    leaning = pallets.place(size_mm=(300, 300, 200), corner_mm=(440, 200, 200), mass_kg=6.0)
    assert leaning.stable
    assert leaning.shift_mm[0] > 1
    assert [said(pallets, *box) for box in (hanging, beside, on_carrier)] == [FALLS, OPEN, OPEN]


def test_nothing_is_decided_between_walls_which_may_catch_a_box() -> None:
    walled = pile(((400, 200, 0),), carrier="euro-pallet", walls=["right"])
    assert [said(walled, (x, 200, 200)) for x in (400, 620)] == [OPEN, OPEN]


def test_loads_on_boxes_below_count() -> None:
    """A long box hangs over as far as its own weight allows. A box that is put onto its free end tips it; a box on its
    other end does not."""
    long = ((300, 200, 200), (600, 300, 100), 6.0)
    pallets = pile(((300, 200, 0), (400, 300, 200)), long)
    end, middle = (750, 250, 300), (350, 250, 300)
    small = (150, 150, 150)
    assert said(pallets, end, small, 20.0) == OPEN
    assert said(pallets, end, small, 1.0) == STANDS
    assert said(pallets, middle, small, 20.0) == STANDS
    stable = pallets.try_all(size_mm=small, corner_mm=[end, end, middle], mass_kg=[20.0, 1.0, 20.0]).stable
    assert stable.tolist() == [False, True, True]


def test_nothing_is_decided_on_a_pallet_that_does_not_rest_where_its_plan_is() -> None:
    pallets = pile(((400, 200, 0),))
    pallets.place(size_mm=BOX, corner_mm=(0, 0, 0), mass_kg=6, error=[3], error_strength=1e-3)
    assert said(pallets, (800, 200, 0)) == OPEN  # however small the error is
    pallets.take_back()
    assert said(pallets, (800, 200, 0)) == OPEN, "how it rests is not known until something is placed"
    pallets.reset()
    assert said(pallets, (800, 200, 0)) == STANDS
    for options in ({"carrier": "epal-1"}, {"physics": "reference"}, {"thresholds": {"shift_m": 0.001}}):
        assert said(pile(**options), (0, 0, 0)) == OPEN, options


def test_pallets_that_are_copied_or_lose_boxes_are_decided_by_their_boxes() -> None:
    pallets = petmjx.Pallets(3, **MUJOCO)
    box = {"size_mm": BOX, "mass_kg": 6.0}
    pallets.place(corner_mm=[(0, 0, 0)] * 3, **box)
    top = {"corner_mm": [(0, 0, 200)] * 3, **box}
    assert pallets.decided(**top).tolist() == [STANDS] * 3
    pallets.reset(1)
    pallets.place(corner_mm=(190, 0, 0), pallet=1, **box)
    pallets.fork([1], [2])
    assert pallets.decided(**top).tolist() == [STANDS, OPEN, OPEN]  # the weight acts 10 mm inside the edge


def test_edges_of_hulls() -> None:
    """The distances of random points from the edges of convex hulls equal the distances that SciPy computes."""
    spatial = pytest.importorskip("scipy.spatial")
    rng = np.random.default_rng(0)
    corners = rng.integers(0, 400, (30, 8, 2)).astype(float)
    places = rng.uniform(-100, 500, (30, 2))
    margins = _margin(_hull_edges(corners), places)
    for points, place, margin in zip(corners, places, margins.tolist(), strict=True):
        equations = spatial.ConvexHull(points).equations  # n · p + d ≤ 0 inside the hull
        assert margin == pytest.approx(-(equations[:, :2] @ place + equations[:, 2]).max(), abs=1e-6)
    square = np.array([[[0, 0], [0, 100], [100, 100], [100, 0]]], float)
    assert _margin(_hull_edges(square), np.array([[30.0, 50.0]])) == 30


def test_simulations_agree_with_the_bounds() -> None:
    """Simulates a few of the placements that ``python -m benchmarks loop bounds`` simulates by the ten thousand."""
    summary = bounds(make_engine("mujoco", threads=1), 200, seed=1)
    assert summary["faults"] == []
    assert summary["simulated"] == 200
    assert min(summary["stand"], summary["fall"]) > 20


def test_stands_is_what_trials_say() -> None:
    """``stands`` gives the same answers as complete trials, also for placements that the bounds do not decide. Trials
    of ``stands`` end as soon as a box is tilted too far."""
    pallets = pile(((0, 0, 0),), ((400, 0, 0), (400, 300, 185)), ((0, 300, 0), (300, 300, 300)))
    x, y = np.meshgrid(np.arange(0, 700, 90), (0, 150))
    places = pallets.places(size_mm=BOX, grid_mm=np.column_stack([x.ravel(), y.ravel()]).astype(float), hulls=False)
    candidates = {"size_mm": BOX, "corner_mm": places.corner_mm, "mass_kg": 6.0}
    decided, results = pallets.decided(**candidates), pallets.try_all(**candidates)
    stands, margin = pallets.stands(**candidates)
    np.testing.assert_array_equal(stands, results.stable)
    undecided = decided == OPEN
    assert 0 < results.stable[undecided].sum() < undecided.sum()
    np.testing.assert_array_equal(margin[undecided & stands], results.margin[undecided & stands])
    np.testing.assert_array_equal(margin[~undecided], decided[~undecided])
