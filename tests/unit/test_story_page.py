"""The page of a story in headless Chromium: what is seen, what moves, what a click and keys do, without any request."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from support.browser import Opened, OpenPage
from support.stories import END_S, FALLING, SIGN_S, falling_story, shaken_story, standing_story

import petmjx
from petmjx.pages.columns import block, quantised, whole
from petmjx.pages.modules import joined_modules
from petmjx.pages.palette import OKABE_ITO, rgb_of
from petmjx.pages.story_data import framed
from petmjx.pages.story_page import story_page
from petmjx.story import Story
from petmjx.units import FloatArray

# The first view of petmjx/pages/static/camera.js
AZIMUTH, ELEVATION, SLOPE, MARGIN = -0.65, 0.4, np.tan(np.radians(16)), 1.06


def opened_story(open_page: OpenPage, story: Story, **options: Any) -> Opened:
    """The page of a story, once it is drawn."""
    opened = open_page(story_page(story), **{"width": 900, "height": 560} | options)
    opened.page.wait_for_selector("#view:not([hidden])")
    opened.settled()
    return opened


def seen(opened: Opened) -> FloatArray:
    """The picture, without labels and legends above it, as numbers that can be subtracted."""
    opened.page.evaluate("for (const label of document.querySelectorAll('#view > .label')) label.style.opacity = 0")
    opened.settled()
    return opened.pixels("#canvas").astype(float)


def changed(before: FloatArray, after: FloatArray) -> float:
    """Share of pixels that look different."""
    return float((np.abs(before - after).max(axis=2) > 24).mean())


def on_canvas(opened: Opened, story: Story, point: FloatArray) -> tuple[float, float]:
    """Where the first view shows a point, in pixels of the window: the camera once more, in closed form."""
    frame = opened.page.locator("#canvas").bounding_box()
    aspect = frame["width"] / frame["height"]
    back = np.array([np.sin(AZIMUTH) * np.cos(ELEVATION), -np.cos(AZIMUTH) * np.cos(ELEVATION), np.sin(ELEVATION)])
    right = np.cross([0.0, 0.0, 1.0], back) / np.cos(ELEVATION)
    up = np.cross(back, right)
    low, high = framed(story)
    middle = (low + high) / 2
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = signs * (high - low) / 2
    distance, target = 0.1, middle.copy()
    for side, slope in ((right, SLOPE * aspect), (up, SLOPE)):
        one = (corners @ side + slope * corners @ back).max()
        other = (-corners @ side + slope * corners @ back).max()
        distance = max(distance, MARGIN * (one + other) / (2 * slope))
        target += side * (one - other) / 2
    from_eye = point - (target + back * distance)
    depth = -from_eye @ back
    x, y = from_eye @ right / (depth * SLOPE * aspect), from_eye @ up / (depth * SLOPE)
    return frame["x"] + (1 + x) / 2 * frame["width"], frame["y"] + (1 - y) / 2 * frame["height"]


def text(opened: Opened, selector: str) -> str:
    return str(opened.page.locator(selector).inner_text())


def number_of(opened: Opened, name: str) -> str:
    """A value from the list of the chosen box."""
    terms = opened.page.locator("#numbers dt").all_inner_texts()
    return str(opened.page.locator("#numbers dd").all_inner_texts()[terms.index(name)])


def drag_time_to(opened: Opened, time_s: float) -> None:
    """Drag the slider's thumb, which is at the end, with the mouse."""
    box = opened.page.locator("#time").bounding_box()
    y = box["y"] + box["height"] / 2
    opened.page.mouse.move(box["x"] + box["width"] - 8, y)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 8 + (box["width"] - 16) * time_s / END_S, y, steps=3)
    opened.page.mouse.up()


def test_the_page_loads_without_errors_and_requests_and_shows_the_boxes(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    picture = seen(opened)
    background = picture[2, 2]
    assert (np.abs(picture - background).max(axis=2) > 24).mean() > 0.1
    assert len(np.unique(picture.reshape(-1, 3) // 8, axis=0)) > 40
    assert text(opened, "h1").split() == ["Plan", "plan-1", "unstable"]
    assert "Box 2 (milk) went first: at 0.80 s" in text(opened, "#first")
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
    picture = seen(opened)
    frame = opened.page.locator("#canvas").bounding_box()
    tops = {0: (story.scene.target[1] + [0.05, 0.0, 0.1], OKABE_ITO[0])}
    for point, colour in tops.values():
        x, y = on_canvas(opened, story, point)
        pixel = picture[int(y - frame["y"]), int(x - frame["x"])] / 255
        wanted = np.array(rgb_of(colour))
        # lit, so brighter or darker, but of the same hue
        assert np.corrcoef(pixel, wanted)[0, 1] > 0.98


def test_play_moves_the_boxes_to_the_end(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    end = seen(opened)
    opened.page.select_option("#speed", "0.5")
    opened.page.click("#play")
    assert opened.page.locator("#play").get_attribute("aria-label") == "Pause"
    opened.until("Number(document.getElementById('time').value) < 0.5")
    assert changed(end, seen(opened)) > 0.002
    opened.page.select_option("#speed", "4")
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
    """Between two frames the falling box is at another place than in either."""
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


def test_numbers_of_a_box_follow_the_time(open_page: OpenPage) -> None:
    opened = opened_story(open_page, falling_story())
    assert opened.page.locator("#box").input_value() == str(FALLING)
    assert number_of(opened, "shift now") == "800.0 mm"
    assert number_of(opened, "tilt now") == "91.7 °"
    assert number_of(opened, "dropped at") == "1.00 s"
    opened.page.click("#to-sign")
    assert number_of(opened, "shift now") == "400.0 mm"
    assert number_of(opened, "first sign") == f"{SIGN_S:.2f} s"


def now(opened: Opened) -> float:
    return float(text(opened, "#now").split()[0])


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
    assert "went first" in text(opened, "#first")
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
    text_of_block = block({"walk": quantised(walk, True), "numbers": whole(numbers, True), "exact": exact})
    script = joined_modules("blocks.js") + "window.reading = blocks_js.readBlock('all');"
    opened = open_page(
        f'<script type="application/octet-stream" id="block-all">{text_of_block}</script>'
        f'<script type="module">{script}</script>'
    )
    found = json.loads(
        opened.page.evaluate(
            """async () => {
              const block = await window.reading;
              const plain = ([name, values]) => [name, {shape: values.shape, values: [...values]}];
              return JSON.stringify(Object.fromEntries(Object.entries(block).map(plain)));
            }"""
        )
    )
    assert found["walk"]["shape"] == [40, 5]
    back = np.array([np.nan if value is None else value for value in found["walk"]["values"]]).reshape(40, 5)
    assert back == pytest.approx(walk, abs=(np.nanmax(walk) - np.nanmin(walk)) / 65_534, nan_ok=True)
    assert found["numbers"]["values"] == numbers.ravel().tolist()
    assert found["exact"]["values"] == exact.tolist()
