"""The page of a story in headless Chromium: what it shows with and without WebGL, and the effects of play, the time
line, clicks, keys, mouse and fingers. The page makes no request."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from support.browser import OpenPage
from support.stories import END_S, FALLING, SIGN_S, falling_story, shaken_story, standing_story
from support.story_view import changed, drag_time_to, now, number_of, on_canvas, opened_story, seen, text

import petmjx
from petmjx.analysis.story import Story
from petmjx.show.pages.html_page import joined_modules
from petmjx.show.pages.page_arrays import block, integer_column, quantised_column
from petmjx.show.pages.palette import OKABE_ITO, rgb_of
from petmjx.show.pages.story_page import story_page


def test_the_page_loads_without_errors_and_requests_and_shows_the_boxes(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    picture = seen(opened)
    background = picture[2, 2]
    assert (np.abs(picture - background).max(axis=2) > 24).mean() > 0.1
    assert len(np.unique(picture.reshape(-1, 3) // 8, axis=0)) > 40
    assert text(opened, "h1").split() == ["Plan", "plan-1", "unstable"]
    assert "Box 2 (milk) failed first: at 0.80 s" in text(opened, "#first")
    assert "mujoco" in text(opened, "#facts")
    assert opened.page.locator("#still").is_hidden()
    assert opened.errors == []
    assert opened.requests == []


def test_the_page_of_a_simulated_plan(open_page: OpenPage) -> None:
    story = petmjx.tell("hand-falls-off", engine="mujoco")
    opened = opened_story(open_page, story)
    assert text(opened, ".badge") == story.outcome.verdict == "unstable"
    assert f"Box {story.outcome.culprit} " in text(opened, "#first")
    assert f"at {story.outcome.first_sign_s:.2f} s" in text(opened, "#first")
    opened.page.select_option("#box", "0")
    assert number_of(opened, "largest") == f"{story.outcome.boxes.max_top_force_n[0]:.1f} N"
    opened.page.check("#forces")
    opened.until("document.getElementById('force-scale').textContent !== ''")
    assert opened.errors == []
    assert opened.requests == []


def test_the_policy_blocks_what_a_page_must_not_ask_for(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    blocked = opened.page.evaluate(
        """async () => {
          const blocked = [];
          document.addEventListener("securitypolicyviolation", (event) => blocked.push(event.effectiveDirective));
          await fetch("http://127.0.0.1:9/a").catch(() => {});
          const image = new Image();
          image.src = "http://127.0.0.1:9/b.png";
          const script = document.createElement("script");
          script.textContent = "document.title = 'broken into'";
          document.body.append(image, script);
          await new Promise((done) => setTimeout(done, 100));
          return blocked;
        }"""
    )
    assert sorted(blocked) == ["connect-src", "img-src", "script-src-elem"]
    assert opened.page.title() == "plan-1: unstable"


def test_boxes_have_the_colours_of_their_articles_where_they_should_be(open_page: OpenPage) -> None:
    story = falling_story()
    opened = opened_story(open_page, story)
    drag_time_to(opened, 0.5)
    picture = seen(opened)
    frame = opened.page.locator("#canvas").bounding_box()
    tea, milk = OKABE_ITO[:2]
    front, top = np.array([0.0, -0.2, 0.0]), np.array([0.0, 0.0, 0.1])
    for box, face, colour in ((0, front, tea), (1, front, tea), (1, top, tea), (FALLING, front, milk)):
        x, y = on_canvas(opened, story, story.scene.target[box] + face)
        pixel = picture[int(y - frame["y"]), int(x - frame["x"])] / 255
        # light makes the colour brighter or darker, but does not change its hue
        assert np.corrcoef(pixel, rgb_of(colour))[0, 1] > 0.98


def test_ghosts_and_forces_are_drawn(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    before = seen(opened)
    opened.page.check("#ghosts")
    assert changed(before, seen(opened)) > 0.001, "box 2 has left its ghost"
    opened.page.uncheck("#ghosts")
    opened.page.check("#forces")
    opened.until("document.getElementById('force-scale').textContent !== ''")
    assert text(opened, "#force-scale") == "0.2 m of arrow: 200\xa0N", "the carrier bears 118 N"
    assert changed(before, seen(opened)) > 0.03
    opened.page.uncheck("#forces")
    assert changed(before, seen(opened)) < 0.001


def test_a_story_without_contacts_says_so(open_page: OpenPage) -> None:
    story = falling_story()
    opened = opened_story(open_page, replace(story, history=replace(story.history, contacts=None)))
    assert opened.page.locator("#forces").is_disabled()
    assert "not recorded" in text(opened, "#force-scale")


def test_a_shaken_pallet_has_an_arrow_and_a_curve(open_page: OpenPage) -> None:
    opened = opened_story(open_page, shaken_story())
    assert "acceleration 0.50 g" in text(opened, "#shaken")
    assert "1.12 g, 27° from vertical" in text(opened, "#shaken")
    assert opened.page.locator("#curve").is_visible()
    shaking = seen(opened)
    opened.page.keyboard.press("Home")
    assert "acceleration 0.00 g" in text(opened, "#shaken")
    assert changed(shaking, seen(opened)) > 0.005
    assert "variant 3" in text(opened, "h1")


def test_markup_in_names_is_shown_as_text(open_page: OpenPage) -> None:
    nasty = "<img src=x onerror=alert(1)></script>💥"
    opened = opened_story(open_page, falling_story(plan_id=nasty, articles=(nasty, "tea", nasty), note=nasty))
    assert text(opened, "#plan") == nasty
    assert text(opened, ".note") == nasty
    assert number_of(opened, "article") == nasty
    assert nasty in text(opened, "#legend")
    assert nasty in text(opened, "#label-first")
    assert opened.page.locator("img").count() == 0
    assert opened.errors == []


def test_a_plan_that_stands_has_no_first_box(open_page: OpenPage) -> None:
    opened = opened_story(open_page, standing_story())
    assert text(opened, ".badge") == "stable"
    assert opened.page.locator("#to-sign").is_hidden()
    assert opened.page.locator("#label-first").is_hidden()
    assert opened.errors == []


@pytest.mark.parametrize("options", [{"webgl": False}, {"scripts": False}], ids=["no WebGL", "no scripts"])
def test_without_webgl_there_are_a_still_picture_and_the_numbers(open_page: OpenPage, options: Any) -> None:
    opened = open_page(story_page(falling_story()), **options)
    assert opened.page.locator("#still svg").is_visible()
    assert opened.page.locator("#view").is_hidden()
    picture = opened.pixels("#still svg")
    assert len(np.unique(picture.reshape(-1, 3) // 8, axis=0)) > 6
    assert opened.page.locator("#all tbody tr").count() == 3
    assert opened.page.locator("#all tbody").is_visible()
    assert "failed first" in text(opened, "#first")
    assert opened.errors == []


def test_a_lost_context_comes_back(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    before = seen(opened)
    opened.page.evaluate(
        """async () => {
          const lose = document.getElementById("canvas").getContext("webgl2").getExtension("WEBGL_lose_context");
          lose.loseContext();
          await new Promise((done) => setTimeout(done, 50));
          lose.restoreContext();
          await new Promise((done) => setTimeout(done, 50));
        }"""
    )
    assert changed(before, seen(opened)) < 0.001


@pytest.mark.parametrize("dark", [False, True])
def test_the_page_fits_a_phone_and_follows_light_and_dark(open_page: OpenPage, dark: bool) -> None:
    opened = opened_story(open_page, falling_story(), width=400, height=800, dark=dark, device_scale_factor=2)
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= 400
    brightness = opened.pixels("body")[3, 3].mean()
    assert (brightness < 60) == dark
    canvas = "document.getElementById('canvas')"
    assert opened.page.evaluate(f"{canvas}.width / {canvas}.clientWidth") == pytest.approx(2, abs=0.01)


def test_blocks_are_read_as_they_were_written(open_page: OpenPage) -> None:
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.normal(size=(40, 5)), axis=0)
    walk[:10, 1] = np.nan
    numbers = rng.integers(-30_000, 30_000, (40, 2))
    exact = rng.normal(size=7)
    text_of_block = block(
        {"walk": quantised_column(walk, True), "numbers": integer_column(numbers, True), "exact": exact}
    )
    script = joined_modules("page_data.js") + "window.reading = page_data_js.readBlock('all');"
    opened = open_page(
        f'<script type="application/octet-stream" id="block-all">{text_of_block}</script>'
        f'<script type="module">{script}</script>'
    )
    arrays = json.loads(
        opened.page.evaluate(
            """async () => {
              const block = await window.reading;
              const plain = ([name, values]) => [name, {shape: values.shape, values: [...values]}];
              return JSON.stringify(Object.fromEntries(Object.entries(block).map(plain)));
            }"""
        )
    )
    assert arrays["walk"]["shape"] == [40, 5]
    back = np.array([np.nan if value is None else value for value in arrays["walk"]["values"]]).reshape(40, 5)
    assert back == pytest.approx(walk, abs=(np.nanmax(walk) - np.nanmin(walk)) / 65_534, nan_ok=True)
    assert arrays["numbers"]["values"] == numbers.ravel().tolist()
    assert arrays["exact"]["values"] == exact.tolist()


def test_play_moves_the_boxes_to_the_end(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    end = seen(opened)
    # The page itself pauses after one frame: on a busy machine, the boxes may be at the end before a second click from
    # outside arrives.
    label = opened.page.evaluate(
        "() => new Promise((done) => { const play = document.getElementById('play'); play.click();"
        " const label = play.getAttribute('aria-label');"
        " requestAnimationFrame(() => { play.click(); done(label); }); })"
    )
    assert label == "Pause"
    assert changed(end, seen(opened)) > 0.002
    opened.page.select_option("#speed", "4")
    opened.page.click("#play")
    opened.until("!document.getElementById('play').classList.contains('playing')")
    assert text(opened, "#now") == "1.00 of 1.00 s, 3 of 3 boxes placed"
    assert changed(end, seen(opened)) < 0.001
    assert opened.errors == []


def test_dragging_the_time_line_moves_the_boxes(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    end = seen(opened)
    drag_time_to(opened, 0.3)
    assert text(opened, "#now").endswith("2 of 3 boxes placed")
    assert float(text(opened, "#now").split()[0]) == pytest.approx(0.3, abs=0.02)
    assert changed(end, seen(opened)) > 0.01
    assert opened.page.locator("#marks .placed").count() == 3
    assert opened.page.locator("#marks .sign").count() == 1
    assert opened.page.locator("#marks .drop").count() == 1


def test_poses_between_frames_are_interpolated(open_page: OpenPage) -> None:
    """Between two frames, the falling box is at a place that differs from its places in both frames."""
    opened = opened_story(open_page, falling_story())
    pictures = []
    for time_s in (0.85, 0.875, 0.9):
        opened.page.evaluate(
            """(time) => {
              const slider = document.getElementById("time");
              slider.value = time;
              slider.dispatchEvent(new Event("input"));
            }""",
            time_s,
        )
        pictures.append(seen(opened))
    assert min(changed(a, b) for a in pictures for b in pictures if a is not b) > 0.002


@pytest.mark.parametrize("box", [0, 1, FALLING])
def test_a_click_names_the_box(open_page: OpenPage, box: int) -> None:
    story = falling_story()
    opened = opened_story(open_page, story)
    opened.page.select_option("#box", "-1")
    x, y = on_canvas(opened, story, story.history.pos[-1, box])
    opened.page.mouse.click(x, y)
    assert opened.page.locator("#box").input_value() == str(box)
    assert number_of(opened, "item") == f"item-{box}"
    force_n = story.history.top_force_n[-1, box]
    assert number_of(opened, "force on top now") == f"{force_n:.1f} N"
    assert number_of(opened, "size") == " × ".join(f"{size:g}" for size in story.plan.size_mm[box]) + " mm"


def test_a_click_beside_all_boxes_chooses_none(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    frame = opened.page.locator("#canvas").bounding_box()
    opened.page.mouse.click(frame["x"] + 5, frame["y"] + 5)
    assert opened.page.locator("#box").input_value() == "-1"
    assert "click one" in text(opened, "#numbers")


@pytest.mark.parametrize(("story", "time_s"), [(falling_story(), SIGN_S), (standing_story(), END_S)])
def test_it_opens_at_the_first_sign_or_else_at_the_end(open_page: OpenPage, story: Story, time_s: float) -> None:
    opened = opened_story(open_page, story, at_end=False)
    assert now(opened) == time_s
    assert opened.page.locator("#play").get_attribute("aria-label") == "Play"


def test_a_click_on_a_row_chooses_its_box(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story(), height=900)
    before = seen(opened)
    opened.page.click("#all summary")
    opened.page.locator("#all tbody tr").nth(1).locator("td").nth(2).click()
    assert opened.page.locator("#box").input_value() == "1"
    assert number_of(opened, "item") == "item-1"
    assert changed(before, seen(opened)) > 0.001, "it is outlined"
    marked = opened.page.locator("#all tr[aria-current]")
    assert [row.locator("th").inner_text() for row in marked.all()] == ["1"]
    opened.page.locator("#all tbody button").first.focus()
    opened.page.keyboard.press("Enter")
    assert opened.page.locator("#box").input_value() == "0"
    opened.page.keyboard.press("Escape")
    assert opened.page.locator("#box").input_value() == "-1"
    assert marked.count() == 0
    opened.page.click("#all thead th")
    assert opened.page.locator("#box").input_value() == "-1"
    assert opened.errors == []


def test_forces_are_coloured_from_zero_to_the_largest_and_minus_zero_is_zero(open_page: OpenPage) -> None:
    story = falling_story()
    force = story.history.top_force_n.copy()
    force[-1, :2] = -0.04, 7312.0
    boxes = replace(story.outcome.boxes, rest_top_force_n=np.array([-0.04, 0.0, -0.06]))
    other_story = replace(
        story, history=replace(story.history, top_force_n=force), outcome=replace(story.outcome, boxes=boxes)
    )
    opened = opened_story(open_page, other_story)
    opened.page.select_option("#colour", "force")
    assert text(opened, "#legend").split() == ["force", "on", "top,", "N", "0", "7,310"]
    opened.page.select_option("#box", "0")
    assert number_of(opened, "force on top now") == "0.0 N"
    assert number_of(opened, "at rest") == "0.0 N"
    opened.page.select_option("#box", str(FALLING))
    assert number_of(opened, "at rest") == "-0.1 N"
    cells = opened.page.locator("#all tbody tr").first.locator("td").all_text_contents()
    assert cells[-2] == "0.0"


def test_numbers_of_a_box_follow_the_time(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    assert opened.page.locator("#box").input_value() == str(FALLING)
    assert number_of(opened, "shift now") == "800.0 mm"
    assert number_of(opened, "tilt now") == "91.7 °"
    assert number_of(opened, "dropped at") == "1.00 s"
    opened.page.click("#to-sign")
    assert number_of(opened, "shift now") == "400.0 mm"
    assert number_of(opened, "first sign") == f"{SIGN_S:.2f} s"


def test_keys(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    press: Callable[[str], None] = opened.page.keyboard.press
    press("Home")
    assert now(opened) == 0.0
    press("ArrowRight")
    press("ArrowRight")
    assert now(opened) == 0.1
    press("ArrowLeft")
    assert now(opened) == 0.05
    press("f")
    assert now(opened) == SIGN_S
    press("End")
    assert now(opened) == END_S
    before = seen(opened)
    press("+")
    nearer = seen(opened)
    assert changed(before, nearer) > 0.05
    press("Shift+ArrowLeft")
    assert changed(nearer, seen(opened)) > 0.05
    press("0")
    assert changed(before, seen(opened)) < 0.001
    press(",")
    assert opened.page.locator("#speed").input_value() == "0.5"
    press("Escape")
    assert opened.page.locator("#box").input_value() == "-1"
    press("Home")
    press(" ")
    opened.until("Number(document.getElementById('time').value) > 0.1")
    press(" ")
    paused = now(opened)
    opened.page.wait_for_timeout(100)
    assert now(opened) == paused


def test_the_mouse_turns_zooms_and_moves_the_view(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    frame = opened.page.locator("#canvas").bounding_box()
    middle = (frame["x"] + frame["width"] / 2, frame["y"] + frame["height"] / 2)
    mouse = opened.page.mouse
    pictures = [seen(opened)]
    for button in ("left", "right"):
        mouse.move(*middle)
        mouse.down(button=button)
        mouse.move(middle[0] + 80, middle[1] + 20, steps=4)
        mouse.up(button=button)
        pictures.append(seen(opened))
    mouse.wheel(0, 300)
    pictures.append(seen(opened))
    assert all(changed(a, b) > 0.03 for a, b in pairwise(pictures))
    assert opened.page.locator("#box").input_value() == str(FALLING), "a drag is no click"


def test_two_fingers_zoom(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story(), has_touch=True)
    before = seen(opened)
    frame = opened.page.locator("#canvas").bounding_box()
    x, y = frame["x"] + frame["width"] / 2, frame["y"] + frame["height"] / 2
    fingers = opened.page.context.new_cdp_session(opened.page)
    for kind, apart in (("touchStart", 40), ("touchMove", 70), ("touchMove", 100), ("touchEnd", None)):
        points = [] if apart is None else [{"x": x + side * apart, "y": y, "id": side + 1} for side in (-1, 1)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    assert changed(before, seen(opened)) > 0.05
    assert opened.page.locator("#box").input_value() == str(FALLING), "a pinch is no click"


def test_colours_follow_the_choice_and_have_a_scale(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    pictures = [seen(opened)]
    assert text(opened, "#legend").split() == ["tea", "(2)", "milk"]
    for choice, unit in (("order", "packing order"), ("shift", "mm"), ("tilt", "°"), ("force", "N")):
        opened.page.select_option("#colour", choice)
        assert unit in text(opened, "#legend")
        pictures.append(seen(opened))
    assert changed(pictures[0], pictures[1]) > 0.03
    assert "limit 20" in (opened.page.select_option("#colour", "shift") and text(opened, "#legend"))
