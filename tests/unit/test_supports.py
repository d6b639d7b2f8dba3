"""Supports in a plan: which body bears which box, where loads act, and where boxes are released."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely.geometry.polygon import orient
from support.plan_edges import plan_edges
from support.plans import Box, make_plan, make_scene, stack

from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.world.bearings import TOUCH_M
from petmjx.world.history import CARRIER
from petmjx.world.rectangle_hulls import hull_table
from petmjx.world.release_places import MOST_FOLLOWED_M, NOTHING, release_of
from petmjx.world.scene import Scene, build_scene
from petmjx.world.supports import bearing_of, bearings_of, find_bearings, without_circles

EXACT = Simulation(size_reduction_mm=0.0)
MM = 1e-3


def scene_of(*boxes: Box) -> Scene:
    return make_scene(boxes, EXACT)


def edges_mm(scene: Scene) -> list[float]:
    bearing = bearing_of(scene)
    return (bearing.edges_m(bearing.loads(scene.n_boxes)) / MM).tolist()


def test_a_tower_s_loads_act_at_their_common_centres() -> None:
    """Three boxes 400 mm long have their centres at x = 200, 300 and 350 mm. The load of each box (its own weight and
    that of the boxes above) acts at the common centre of these boxes."""
    scene = scene_of(
        ((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (100, 0, 200), 5.0), ((400, 300, 200), (150, 0, 400), 5.0)
    )
    bearing = bearing_of(scene)
    assert bearing.lower.tolist() == [CARRIER, 0, 1]
    load = bearing.loads(3)
    np.testing.assert_allclose(load[:, 0], [15.0, 10.0, 5.0])
    np.testing.assert_allclose(load[:, 1] / load[:, 0], [0.85 / 3, 0.325, 0.35])
    # the contact areas reach from 0 to 400, from 100 to 400, and from 150 to 500 mm
    assert edges_mm(scene) == pytest.approx([400 - 850 / 3, 75.0, 150.0])
    # the third box is not placed yet
    assert bearing.loads(2)[:, 0].tolist() == [10.0, 5.0, 0.0]


def test_a_bridge_is_borne_within_the_hull_of_its_supports() -> None:
    """One support ends at x = 200 mm, the other begins at 400 mm. The load acts at 300 mm, over the gap, as far inside
    the hull of both supports as possible."""
    scene = scene_of(
        ((200, 300, 200), (0, 0, 0), 5.0), ((200, 300, 200), (400, 0, 0), 5.0), ((600, 300, 200), (0, 0, 200), 8.0)
    )
    assert edges_mm(scene) == pytest.approx([100.0 - 100.0 * 4 * 0 / 9, 100.0, 150.0], abs=0.01)
    assert bearing_of(scene).loads(3)[:, 0].tolist() == pytest.approx([9.0, 9.0, 8.0])


def test_a_corner_hull_is_not_its_bounding_box() -> None:
    """Two supports are at opposite corners. The other two corners of the square around them bear nothing."""
    small = (100.0, 100.0, 100.0)
    top: Box = ((400, 400, 100), (0, 0, 100), 1.0)
    weight: Box = (small, (300, 0, 200), 1000.0)
    scene = scene_of((small, (0, 0, 0), 1.0), (small, (300, 300, 0), 1.0), top, weight)
    edge_mm = edges_mm(scene)[2]
    # the edge of the hull goes from (100, 0) to (400, 300); the load acts near (350, 50)
    point = (1000 * np.array([350.0, 50.0]) + np.array([200.0, 200.0])) / 1001
    assert edge_mm == pytest.approx((point[1] - point[0] + 100) / 2**0.5)
    assert edge_mm < 0


def test_what_hangs_in_the_air_has_no_edge() -> None:
    scene = scene_of(((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (0, 0, 201), 5.0))
    assert np.isnan(edges_mm(scene)[1])
    assert release_of(scene, EXACT).support.tolist() == [CARRIER, NOTHING]


@pytest.mark.parametrize("boxes", [stack(5), stack(4, size_mm=(100, 100, 400), kg=(0.5, 5.0, 2.0, 1.0))])
def test_boxes_are_released_as_they_will_rest(boxes: Sequence[Box]) -> None:
    """Released boxes do not fall: one step later, and at rest, each box is at its place of release, to within 2 % of
    the distance that it has come down."""
    scene = make_scene(boxes, EXACT)
    live = LiveWorld(scene, EXACT)
    live.step(200)
    for box in range(scene.n_boxes):
        live.place_next()
        released = live.pose[box, 2]
        live.step(300)
        down = scene.target[box, 2] - released
        assert 0 < down < 1 * MM
        assert live.pose[box, 2] == pytest.approx(released, abs=max(0.15 * down, 2e-6))


def test_the_reference_lets_boxes_fall() -> None:
    scene = make_scene(stack(3), sim := Simulation(physics=PHYSICS["reference"]))
    release = release_of(scene, sim)
    assert release.support.tolist() == [NOTHING] * 3
    np.testing.assert_array_equal(release.pos, scene.start_pos)


def test_a_box_does_not_follow_a_support_that_has_gone() -> None:
    scene = make_scene(stack(2), EXACT)
    live = LiveWorld(scene, EXACT)
    live.step(100)
    live.place_next()
    live._poses[live._row[0], 2] -= 0.05
    live.place_next()
    assert live.pose[1, 2] == pytest.approx(release_of(scene, EXACT).pos[1, 2] - MOST_FOLLOWED_M, abs=1e-9)


def test_the_order_of_boxes_does_not_matter() -> None:
    """In a static check, all boxes stand from the start, so the order in the plan does not matter."""
    boxes: list[Box] = [
        ((200, 300, 200), (0, 0, 0), 5.0),
        ((200, 300, 200), (400, 0, 0), 5.0),
        ((600, 300, 200), (0, 0, 200), 8.0),
        ((300, 300, 100), (350, 0, 400), 3.0),
    ]
    expected = edges_mm(scene_of(*boxes))
    for order in ([3, 2, 1, 0], [2, 0, 3, 1]):
        edges = edges_mm(scene_of(*(boxes[k] for k in order)))
        assert [edges[order.index(k)] for k in range(4)] == pytest.approx(expected)


def test_a_load_acts_at_the_centre_of_mass() -> None:
    scene = scene_of(((400, 300, 200), (0, 0, 0), 5.0))
    aside = replace(scene, mass_center=np.array([[0.0, 0.1, 0.0]]))
    assert edges_mm(scene) == pytest.approx([150.0])
    assert edges_mm(aside) == pytest.approx([50.0])


def test_scenes_together_have_the_numbers_of_each_alone() -> None:
    """Random heaps of 1 to 12 boxes: the distances are equal to the last bit. Boxes that are not placed have no
    distance."""
    rng = np.random.default_rng(4)
    scenes = [scene_of(*random_heap(rng, n)) for n in (1, 12, 5, 8)]
    placed = [1, 7, 5, 0]
    alone = [plan_edges([scene], [count])[0] for scene, count in zip(scenes, placed, strict=True)]
    for joined, single, count in zip(plan_edges(scenes, placed), alone, placed, strict=True):
        np.testing.assert_array_equal(joined.least, single.least)
        assert np.isnan(joined.least[count:]).all()
        assert np.isfinite(joined.least[:count]).any() == (count > 0)
    loads = bearings_of(scenes).loads(placed)
    apart = [bearing_of(scene).loads(count) for scene, count in zip(scenes, placed, strict=True)]
    np.testing.assert_array_equal(loads, np.concatenate(apart))


def test_scenes_that_are_alike_are_looked_at_together() -> None:
    """Similar scenes have the same contacts to the last bit, whether they are computed together or alone: on one board
    or many, with random errors, and at other places. The contacts are those of each pair of bodies that touch."""
    rng = np.random.default_rng(6)
    for carrier in ("footprint", "epal-1"):
        sim = Simulation(carrier=carrier)
        scenes = [build_scene(make_plan("p", random_heap(rng, n)), sim) for n in (6, 6, 6, 9, 6, 9)]
        targets = [scene.target + rng.normal(0, 2e-4, scene.target.shape) for scene in scenes]
        # with a larger tolerance of height, boxes rest on more bodies
        gaps_m = np.array([5e-4, 5e-4, 2e-2, 5e-4, 2e-2, 5e-4])
        together = find_bearings(scenes, targets, gaps_m)
        for number, (scene, target, gap_m) in enumerate(zip(scenes, targets, gaps_m.tolist(), strict=True)):
            bearing, expected = together.of_scene(number), find_bearings([scene], [target], gap_m)
            contacts = [*zip(bearing.upper, bearing.lower, bearing.low.tolist(), bearing.high.tolist(), strict=True)]
            assert contacts == contacts_by_pairs(replace(scene, target=target), gap_m)
            for name in ("upper", "lower", "low", "high"):
                np.testing.assert_array_equal(getattr(bearing, name), getattr(expected, name), strict=True)
            for name in ("target", "half_size", "mass", "mass_center", "carrier_mass", "first"):
                np.testing.assert_array_equal(getattr(bearing.boxes, name), getattr(expected.boxes, name), strict=True)
            edges = expected.hulls.offset
            np.testing.assert_array_equal(bearing.hulls.offset[:, : edges.shape[1]], edges)
        one, other = bearing_of(scenes[0]), bearing_of(scenes[3])
        picked, rows = bearings_of(scenes).of_scenes(np.array([0, 3, 0]))
        assert rows.tolist() == [*range(6), *range(18, 27), *range(6)]
        for several in (picked, bearings_of([scenes[0], scenes[3], scenes[0]])):
            np.testing.assert_array_equal(several.low, np.concatenate([one.low, other.low, one.low]))
            np.testing.assert_array_equal(several.of_scene(2).lower, one.lower)
            assert several.boxes.first.tolist() == [0, 6, 15, 21]
        twice = bearings_of([scenes[0]] * 2)
        np.testing.assert_array_equal(twice.upper, np.concatenate([one.upper, one.upper + 6]))


def test_a_tilted_box_bears_on_the_parts_of_its_supports_that_it_touches() -> None:
    """One support is 2 mm higher than the other. A plank touches the inner edge of the higher support, at x = 100 mm,
    and, with its own end, the lower support at x = 400 mm. It tilts by 2 mm over 300 mm, so its bottom is at most
    0.5 mm above the supports within 75 mm of these two lines."""
    scene = scene_of(
        ((100, 800, 100), (0, 0, 0), 5.0), ((100, 800, 98), (300, 0, 0), 5.0), ((400, 800, 20), (0, 0, 100), 8.0)
    )
    slope = 2 / 300
    up = np.array([[0, 0, 1], [0, 0, 1], np.array([slope, 0, 1]) / np.hypot(slope, 1)])
    target = scene.target.copy()
    target[2] = np.array([200, 400, 100 - 100 * slope]) * MM + up[2] * scene.half_size[2, 2]
    upright, tilted = (find_bearings([scene], [target], TOUCH_M, directions) for directions in ([], [up]))
    assert upright.upper.tolist() == [0, 1]  # the plank's middle is too high above the lower support
    assert (tilted.upper.tolist(), tilted.lower.tolist()) == ([0, 1, 2, 2], [CARRIER, CARRIER, 0, 1])
    np.testing.assert_allclose(tilted.low[2:, 0] / MM, [25.0, 325.0], atol=1e-6)
    np.testing.assert_allclose(tilted.high[2:, 0] / MM, [100.0, 400.0], atol=1e-6)
    np.testing.assert_allclose(tilted.low[:2], upright.low)
    middle_mm = target[2, 0] / MM
    assert tilted.edges_m(tilted.loads(3))[2] / MM == pytest.approx(middle_mm - 25, abs=1e-3)
    # the mirrored plank touches the mirrored parts
    mirrored = replace(scene, target=target * [-1, 1, 1])
    other = find_bearings([mirrored], [mirrored.target], TOUCH_M, [up * [-1, 1, 1]])
    assert other.edges_m(other.loads(3))[2] == pytest.approx(tilted.edges_m(tilted.loads(3))[2], abs=1e-12)


def test_no_box_lies_on_itself() -> None:
    """Boxes 0, 1 and 2 lie on one another in a circle, box 3 lies on box 0, and box 2 on the carrier."""
    upper, lower = np.array([0, 1, 2, 2, 3]), np.array([1, 2, 0, CARRIER, 0])
    assert without_circles(upper, lower, np.array([0.3, 0.2, 0.1, 0.4])).tolist() == [True, True, False, True, True]
    assert without_circles(upper[3:], lower[3:], np.zeros(4)).all()


def contacts_by_pairs(scene: Scene, gap_m: float) -> list[tuple[int, int, list[float], list[float]]]:
    """Upper body, lower body, and lowest and highest corner of each contact of a scene, found pair by pair."""
    carrier, half = scene.carrier, scene.half_size
    places, halves = carrier.pos + carrier.shape_pos, carrier.half_size
    deck = [k for k in range(len(halves)) if places[k, 2] + halves[k, 2] >= -TOUCH_M]
    below = [(CARRIER, places[k] - halves[k], places[k] + halves[k]) for k in deck]
    below += [(k, scene.target[k] - half[k], scene.target[k] + half[k]) for k in range(scene.n_boxes)]
    contacts = []
    for upper in range(scene.n_boxes):
        low, high = scene.target[upper] - half[upper], scene.target[upper] + half[upper]
        for lower, lower_low, lower_high in below:
            over = lower_high[2] - low[2]
            touches = lower_low[2] < low[2] and -gap_m <= over <= TOUCH_M
            area = np.maximum(low, lower_low)[:2], np.minimum(high, lower_high)[:2]
            if (low[2] <= gap_m if lower == CARRIER else touches) and (area[1] - area[0] > 1e-6).all():
                contacts.append((upper, lower, area[0].tolist(), area[1].tolist()))
    return contacts


def random_heap(rng: np.random.Generator, n: int) -> list[Box]:
    """Layers of boxes at random places. Each box rests on several other boxes or on none."""
    corners = [(float(x), float(y), 200.0 * (k // 4)) for k, (x, y) in enumerate(rng.integers(0, 500, (n, 2)))]
    return [((400, 300, 200), corner, float(mass)) for corner, mass in zip(corners, rng.uniform(1, 20, n), strict=True)]


def test_a_hull_s_edges_are_the_lines_with_all_corners_on_one_side() -> None:
    """Random rectangles: no corner is outside the hull, and each edge goes through two corners."""
    rng = np.random.default_rng(5)
    for count in (1, 2, 3, 6):
        low = rng.integers(0, 6, (count, 2)).astype(float)
        high = low + rng.integers(1, 4, (count, 2))
        corners = np.concatenate([low, high, np.c_[low[:, 0], high[:, 1]], np.c_[high[:, 0], low[:, 1]]])
        (normal,), (offset,) = hull_table(low, high, np.array([count]))
        inside = corners @ normal.T - offset
        np.testing.assert_allclose(np.hypot(*normal.T), 1.0)
        assert (inside >= -1e-12).all()
        assert ((np.abs(inside) < 1e-12).sum(axis=0) >= 2).all()
        assert len(offset) >= 4


def test_many_hulls_have_the_edges_of_each_alone() -> None:
    """500 sets of one to six random rectangles: the distance of a point from the hull's edges is the same as from the
    edges that shapely finds for each hull alone."""
    rng = np.random.default_rng(6)
    count = rng.integers(1, 7, 500)
    low = rng.integers(0, 8, (count.sum(), 2)) / 10
    high = low + rng.integers(1, 5, low.shape) / 10
    point = rng.uniform(-0.2, 1.4, (500, 2))
    ends = np.cumsum(count)
    expected = []
    for i, k, place in zip((ends - count).tolist(), ends.tolist(), point, strict=True):
        hull = shapely.convex_hull(shapely.multipolygons(shapely.box(*low[i:k].T, *high[i:k].T)))
        ring = shapely.get_coordinates(orient(hull))
        (side_x, side_y), (x, y) = np.diff(ring, axis=0).T, (place - ring[:-1]).T
        expected.append(((side_x * y - side_y * x) / np.hypot(side_x, side_y)).min())
    inside = hull_table(low, high, count).inside_m(np.arange(500), point)
    np.testing.assert_allclose(inside, expected, rtol=0, atol=1e-14)
