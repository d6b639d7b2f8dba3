"""The quantities from which criteria are computed: contacts between boxes, their convex hulls, and the shares in which
supports bear a load."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support.plans import Box, make_plan

pytest.importorskip("scipy")
pytest.importorskip("shapely")


from test_criteria import LEANING, beam, box, random_stack

from petmjx.analysis.load_paths import even_bedding, lever_rule
from petmjx.analysis.plan_contacts import PlanContacts, contact_hulls, find_contacts, find_sides


@pytest.mark.parametrize("sharing", [lever_rule, even_bedding])
def test_shares_add_up_to_the_load(sharing: object) -> None:
    contacts = find_contacts(make_plan(boxes=[*three_posts(), box(0, 0, 200, 500, 500, 100, 4)]))
    shares = sharing(contacts)[contacts.upper == 3]  # type: ignore[operator]
    load = np.array([1.0, 240.0, 230.0])
    assert shares.sum(axis=0) @ load == pytest.approx(load)


def three_posts() -> list[Box]:
    return [box(0, 0, 0, 100, 100, 200), box(400, 0, 0, 100, 100, 200), box(200, 400, 0, 100, 100, 200)]


def test_lever_rule_of_two() -> None:
    contacts = find_contacts(make_plan(boxes=[beam(0, 100, 0, 200), beam(300, 400, 0, 200), beam(0, 400, 200, 300)]))
    shares = lever_rule(contacts)[contacts.upper == 2]
    load = np.array([4.0, 4 * 125, 4 * 150])  # the load acts at x = 125, a quarter of the distance from 50 to 350
    assert (shares @ load)[:, 0] == pytest.approx([3, 1])


def test_hull_distances_are_those_of_shapely() -> None:
    import shapely

    contacts = find_contacts(make_plan(boxes=[*three_posts(), box(0, 0, 200, 500, 500, 100)]))
    hulls, rng = contact_hulls(contacts), np.random.default_rng(1)
    polygon = shapely.MultiPoint(contacts.corners_mm[contacts.upper == 3].reshape(-1, 2)).convex_hull
    points = rng.uniform(-200, 700, size=(500, 2))
    distance = shapely.distance(polygon.exterior, shapely.points(points))
    signed = np.where(shapely.contains_xy(polygon, *points.T), distance, -distance)
    assert hulls.distance(np.full(500, 3), points) == pytest.approx(signed)


def test_sides_are_found_once_for_each_pair() -> None:
    sides = find_sides(find_contacts(make_plan(boxes=LEANING)))
    assert list(zip(sides.first, sides.second, sides.axis, strict=True)) == [(2, 1, 0)]
    assert sides.low_mm.tolist() == [[630, 0, 200]]
    assert sides.high_mm.tolist() == [[630, 300, 400]]


def test_contacts_are_in_the_order_of_the_boxes_above() -> None:
    contacts: PlanContacts = find_contacts(make_plan(boxes=random_stack(np.random.default_rng(5), 20)))
    assert all(first <= second for first, second in pairwise(contacts.upper.tolist()))
    assert (contacts.lower < contacts.upper).all()
