"""Tests of the cameras, options, moments, colours and forces of pictures. Results are known in closed form; nothing is
drawn."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from support.pictures import falling_story, standing_story

from petmjx.common.convex_hull import convex_hull
from petmjx.common.errors import InputError
from petmjx.show.pages.palette import article_colours, rgb_of
from petmjx.show.pictures.animation import film_times, usual_speed
from petmjx.show.pictures.box_colours import colouring, ramp_colours
from petmjx.show.pictures.camera import VIEWS, Margins, View, framing, view_of
from petmjx.show.pictures.draw_story import forces_of_pairs, framed_points, newtons_per_m
from petmjx.show.pictures.overlay import first_outline
from petmjx.show.pictures.picture_options import Colour, PictureOptions, size_of
from petmjx.show.pictures.story_poses import moments, nearest_frame, poses_at, poses_of_frame
from petmjx.world.rotation import corners, rotations

STORY = falling_story()
CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


@pytest.mark.parametrize("size", [(640, 480), (300, 900), (64, 64)], ids=str)
@pytest.mark.parametrize("view", [*VIEWS, "200/-40"])
def test_all_points_are_in_the_picture_and_touch_its_margins(view: str, size: tuple[int, int]) -> None:
    margins = Margins(0.05, 0.1, 0.15, 0.2)
    seen = framing(CUBE, view_of(view), size, margins).project(CUBE) / size
    low, high = seen.min(axis=0), seen.max(axis=0)
    assert (low >= np.array([margins.left, margins.top]) - 1e-9).all()
    assert (high <= 1 - np.array([margins.right, margins.bottom]) + 1e-9).all()
    # the camera is as near as possible: in one direction, points touch both margins; in the other direction, the free
    # space is equal on both sides
    free = [(low[0] - margins.left, 1 - margins.right - high[0]), (low[1] - margins.top, 1 - margins.bottom - high[1])]
    assert min(max(pair) for pair in free) == pytest.approx(0.0, abs=1e-9)


def test_the_front_view_in_closed_form() -> None:
    """A square of 1 m that fills the height of the picture is 0.5 m / tan(half the angle of view) away from the
    camera."""
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    camera = framing(square, View(0, 0), (500, 500), Margins(0, 0, 0, 0))
    away = 0.5 / np.tan(np.radians(24 / 2))
    assert camera.pos == pytest.approx([0.5, -away, 0.5])
    assert camera.project(square) == pytest.approx(np.array([[0, 500], [500, 500], [0, 0], [500, 0]]), abs=1e-6)


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("front", [0, -1, 0]), ("right", [1, 0, 0]), ("back", [0, 1, 0]), ("left", [-1, 0, 0]), ("top", [0, 0, 1])],
)
def test_views_are_from_where_their_names_say(name: str, nearest: list[int]) -> None:
    camera = framing(CUBE, VIEWS[name], (200, 200))
    assert -camera.forward @ nearest > 0.98
    assert camera.up[2] >= 0
    assert np.linalg.norm(np.cross(camera.right, camera.forward) - camera.up) < 1e-12


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("view", "isso", "view: unknown view isso; did you mean iso?"),
        ("view", "10/95", "view: 10/95: the elevation must be from -90 to 90"),
        ("at", "start,forst-sign", "at: unknown moment forst-sign; did you mean first-sign?"),
        ("at", "nan", "at: unknown moment nan; there are start, before, first-sign, end (or seconds, such as 2.5)"),
        ("size", "12x900", "size must be WIDTHxHEIGHT with sides from 64 to 4096 pixels, got '12x900'"),
        ("size", "big", "size must be WIDTHxHEIGHT"),
        ("colour", "blue", "colour must be 'article', 'order', 'shift', 'tilt', 'force' or 'planned', got 'blue'"),
        ("speed", 0, "speed must be from 0.01 to 1000, got 0"),
        ("fps", 1000, "fps must be from 1 to 50, got 1000"),
    ],
)
def test_options_say_what_is_wrong(option: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match="^" + re.escape(message)):
        PictureOptions(**{option: value})


def test_options_of_python_may_be_numbers_and_lists() -> None:
    options = PictureOptions(at=["start", 2.5], size=(800, 600), colour="tilt")
    assert (options.at, options.size) == ("start,2.5", "800x600")
    assert size_of("800 × 600") == (800, 600)
    assert PictureOptions(at=2.5).at == "2.5"


def test_moments_are_the_frames_that_their_names_say() -> None:
    assert [(moment.frame, moment.name) for moment in moments(STORY, None)] == [
        (5, "before"),  # frame 5, at 0.5 s, in which the third box is placed
        (7, "first-sign"),
        (20, "end"),
    ]
    assert [moment.frame for moment in moments(STORY, "start,0.34,0.36,2.004,0")] == [0, 3, 4, 20, 0]
    calm = standing_story(STORY)
    assert [moment.name for moment in moments(calm, None)] == ["end"]
    with pytest.raises(InputError, match="there is no moment 'first-sign': nothing failed in plan tower"):
        moments(calm, "first-sign")


@pytest.mark.parametrize(("asked", "said"), [("1e308", "1e+308"), ("end,2.1", "2.1"), ("-1", "-1")])
def test_a_time_outside_the_story_is_refused(asked: str, said: str) -> None:
    line = f"there is no moment {said} s: plan tower ends at 2.00 s"
    with pytest.raises(InputError, match=re.escape(line)):
        moments(STORY, asked)


def test_at_takes_the_nearest_frame_and_of_equal_times_the_last() -> None:
    history = STORY.history
    twice = replace(history, time_s=np.array([0.0, 0.1, 0.1, *history.time_s[3:]]))
    assert nearest_frame(twice, 0.12) == 2
    assert nearest_frame(history, 0.149) == 1


def test_poses_between_two_frames() -> None:
    """At 0.75 s, half of the box's motion is done: 150 mm to the right, and a rotation by 45°, within the accuracy of
    linear interpolation."""
    poses = poses_at(STORY.history, 0.75)
    assert poses.pos[2] == pytest.approx([0.25, 0.1, 0.3])
    assert 2 * np.degrees(np.arctan2(poses.quat[2, 2], poses.quat[2, 0])) == pytest.approx(45.0, abs=1e-6)
    assert poses_at(STORY.history, 0.45).n_placed == 2, "a box comes when it is placed, not before"
    assert poses_at(STORY.history, 0.5).n_placed == 3
    assert poses_at(STORY.history, 9.0).time_s == 2.0


def test_film_times_and_speed() -> None:
    assert film_times(STORY, 1.0, 10.0) == pytest.approx(np.arange(21) / 10)
    assert film_times(STORY, 4.0, 5.0) == pytest.approx([0.0, 0.8, 1.6, 2.0]), "the end is always seen"
    assert usual_speed(STORY) == 1.0
    long = replace(STORY, history=replace(STORY.history, time_s=STORY.history.time_s * 25))
    assert usual_speed(long) == 3.0, "50 s in 20 s at most"


def test_colours_mean_what_the_legend_says() -> None:
    tea, salt, _ = (rgb_of(colour) for colour in article_colours(STORY.plan.articles))
    end = poses_of_frame(STORY.history, 20)
    by_article = colouring(STORY, Colour.ARTICLE)
    assert by_article.names == (("tea", tea), ("salt", salt))
    assert by_article.of(end) == pytest.approx(np.array([tea, salt, tea]))
    by_shift = colouring(STORY, Colour.SHIFT)
    assert by_shift.scale is not None
    assert (by_shift.scale.low, by_shift.scale.high, by_shift.scale.label) == (0.0, 40.0, "shift, mm")
    assert by_shift.of(end) == pytest.approx(ramp_colours(np.array([0.0, 0.0, 1.0])))
    by_tilt = colouring(STORY, Colour.TILT).of(poses_at(STORY.history, 0.6))
    assert by_tilt[2] == pytest.approx(ramp_colours(np.array([18.0 / 40.0]))[0])
    by_force = colouring(STORY, Colour.FORCE)
    assert by_force.scale is not None
    assert by_force.scale.high == 20.0, "19.62 N, rounded up"
    assert by_force.of(end)[0] == pytest.approx(ramp_colours(np.array([19.62 / 20]))[0])


def test_forces_between_two_bodies_are_on_the_lower_one() -> None:
    contacts = STORY.history.contacts
    assert contacts is not None
    forces = sorted(forces_of_pairs(contacts, poses_of_frame(STORY.history, 3)), key=lambda pair: pair[0][0])
    assert [place.tolist() for place, _ in forces] == [[0.1, 0.1, 0.0], [0.3, 0.1, 0.0]]
    assert [force.tolist() for _, force in forces] == [[0.0, 0.0, -20.0], [0.0, 0.0, -20.0]]
    turned = replace(contacts, body=contacts.body.copy(), force=contacts.force.copy())
    both = turned.frame == 3
    turned.body[both], turned.force[both] = [[-1, 0], [0, -1]], [[0, 0, 20.0], [0, 0, -20.0]]
    ((place, force),) = forces_of_pairs(turned, poses_of_frame(STORY.history, 3))
    assert (place.tolist(), force.tolist()) == ([0.2, 0.1, 0.0], [0.0, 0.0, -40.0]), "whichever a contact names first"
    with pytest.raises(InputError, match=r"plan tower: no contact forces were recorded \(engine mujoco\)"):
        newtons_per_m(falling_story(contacts=False))


def test_what_is_framed() -> None:
    """Pictures show the planned places and the boxes that are near, but not boxes that have rolled away."""
    near = framed_points(STORY, [20])
    assert near[:, 0].max() == pytest.approx(0.5), "the fallen box, from 0.3 to 0.5 m"
    far = STORY.history.pos.copy()
    far[20, 2] = [9.0, 0.1, 0.1]
    rolled = replace(STORY, history=replace(STORY.history, pos=far))
    assert framed_points(rolled, [20])[:, 0].max() == pytest.approx(0.4)
    assert framed_points(STORY, [0])[:, 2].max() == pytest.approx(0.4), "planned boxes before they are placed, too"


def test_the_hull_of_points() -> None:
    square = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
    assert convex_hull([(1.0, 1.0), (1.0, 0.0), *square[::-1], (1.0, 0.5)]) == square


def test_the_outline_is_of_the_first_box_once_it_is_placed() -> None:
    camera = framing(framed_points(STORY, [20]), VIEWS["front"], (300, 300))
    assert first_outline(STORY, poses_of_frame(STORY.history, 4), camera) is None
    outline = first_outline(STORY, poses_of_frame(STORY.history, 20), camera)
    assert outline is not None
    box = slice(2, 3)
    turned = rotations(STORY.history.quat[20, box])
    seen = camera.project(corners(STORY.history.pos[20, box], turned, np.full((1, 3), 0.1))[0])
    assert outline.min(axis=0) == pytest.approx(seen.min(axis=0))
    assert first_outline(standing_story(STORY), poses_of_frame(STORY.history, 20), camera) is None
