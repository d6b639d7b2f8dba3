"""Carriers made of boards: they have the stated extents and masses, and boards bear boxes while gaps do not."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from support.pictures import needs_pictures
from support.plans import Box, make_plan

import petmjx
from petmjx.common.units import MM_PER_M, STANDARD_GRAVITY
from petmjx.engines.verdict import Verdict
from petmjx.options.carriers import CARRIER_EXTENT_M, Carrier, OwnCarrier
from petmjx.options.physics import PHYSICS
from petmjx.world.carrier_boards import BOARDS_OF_CARRIERS, body_of, pallet

DECK_EDGE_MM = 145.0
"""The y coordinate at which the first deck board of ``epal-1`` ends, mm. The gap behind it is 41 mm wide."""
POST_MM = (60.0, 60.0, 200.0)


@pytest.mark.parametrize("carrier", BOARDS_OF_CARRIERS)
def test_a_pallet_is_as_large_as_it_says_and_of_one_piece(carrier: Carrier) -> None:
    shape = pallet(carrier)
    assert shape is not None
    body = body_of(shape, PHYSICS["pallet"])
    np.testing.assert_allclose(body.low, [0, 0, -shape.height_mm / MM_PER_M], atol=1e-12)
    np.testing.assert_allclose(body.high, [*(CARRIER_EXTENT_M[carrier] or ()), 0.0], atol=1e-12)
    other_kg = {"gma-48x40": 20.0, "pet-eur": 40.0, "container-20ft": 900.0, "trailer": 6000.0}
    assert body.mass == pytest.approx(other_kg.get(carrier, 25.0))
    center, half = body.pos + body.shape_pos, body.half_size
    inside = half[:, None] + half - np.abs(center[:, None] - center)
    for one, two in itertools.combinations(range(len(half)), 2):
        deep = inside[one, two].min()
        assert deep < (0.0041 if carrier is Carrier.PET_EUR else 1e-9), f"boards {one} and {two} lie in each other"
    joined = {0}
    for _ in half:  # adds the boards that touch boards already reached from the first board
        touching = (inside >= -1e-9).all(axis=2)
        joined |= set(np.flatnonzero(touching[sorted(joined)].any(axis=0)).tolist())
    assert joined == set(range(len(half)))


def post(beyond_mm: float) -> tuple[Box, ...]:
    """A slender box whose centre is ``beyond_mm`` beyond the edge of the board on which the box stands."""
    return ((POST_MM, (600.0, DECK_EDGE_MM - POST_MM[1] / 2 + beyond_mm, 0.0), 3.0),)


@pytest.mark.parametrize(("beyond_mm", "verdict"), [(-4.0, Verdict.STABLE), (4.0, Verdict.UNSTABLE)])
def test_a_box_over_a_gap_stands_or_tips_by_its_centre(beyond_mm: float, verdict: Verdict) -> None:
    plan = make_plan("post", post(beyond_mm))
    worlds = petmjx.score([plan], engine="mujoco", threads=1, carrier="epal-1").worlds
    assert worlds.verdict[0] == verdict
    assert worlds.plan_edge_m[0] == pytest.approx(-beyond_mm / MM_PER_M, abs=1e-4)


def test_a_box_that_bridges_a_gap_stands() -> None:
    plan = make_plan("wide", (((100.0, 100.0, 200.0), (600.0, DECK_EDGE_MM - 25.0, 0.0), 3.0),))
    worlds = petmjx.score([plan], engine="mujoco", threads=1, carrier="epal-1").worlds
    assert worlds.verdict[0] == Verdict.STABLE
    assert worlds.plan_edge_m[0] == pytest.approx(0.05, abs=1e-3)


@needs_pictures()
def test_a_picture_has_room_for_all_boards(tmp_path: Path) -> None:
    story = petmjx.tell("post", [make_plan("post", post(-4.0))], carrier="epal-1")
    petmjx.draw(story, tmp_path / "post.png")
    assert (tmp_path / "post.png").stat().st_size > 1000


def bars(*, width_mm: float, span_mm: float) -> OwnCarrier:
    """A carrier of two narrow bars along x on two blocks. ``span_mm`` is the distance between the middles of the
    bars."""
    bar = {"size_mm": [600.0, width_mm, 40.0], "mass_kg": 0.2 * width_mm}
    block = {"size_mm": [100.0, span_mm + width_mm, 100.0], "mass_kg": 5.0}
    places = [(bar, (0.0, 0.0, 100.0)), (bar, (0.0, span_mm, 100.0)), (block, (0.0,) * 3), (block, (500.0, 0.0, 0.0))]
    return OwnCarrier.read({"boards": [{**board, "corner_mm": corner} for board, corner in places]})


def test_two_bars_share_the_load_of_a_box_by_the_lever_rule() -> None:
    """The bars are 4 mm wide, so the place on the bars at which the box presses changes the shares by only half a per
    cent."""
    width, span, length, kg = 4.0, 400.0, 560.0, 20.0
    plan = make_plan("plank", (((300.0, length, 200.0), (150.0, 0.0, 0.0), kg),))
    carrier = bars(width_mm=width, span_mm=span)
    results = petmjx.score([plan], engine="mujoco", threads=1, carrier=carrier, record="all", record_details=True)
    assert results.worlds.verdict[0] == Verdict.STABLE
    contacts = petmjx.tell("plank", results).history.contacts
    last = contacts.frame == contacts.frame.max()
    on_box = last & (contacts.body.max(axis=1) == 0)
    pressing = np.abs(contacts.force[on_box, 2])
    far = contacts.point[on_box, 1] * MM_PER_M > span / 2
    share = (length / 2 - width / 2) / span
    weight = kg * STANDARD_GRAVITY
    assert pressing[far].sum() == pytest.approx(share * weight, rel=0.02)
    assert pressing[~far].sum() == pytest.approx((1 - share) * weight, rel=0.02)
