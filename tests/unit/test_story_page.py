"""The page of a story in headless Chromium: what it shows with and without WebGL. The page makes no request."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.browser import OpenPage
from support.stories import FALLING, falling_story, shaken_story, standing_story
from support.story_view import changed, drag_time_to, number_of, on_canvas, opened_story, seen, text

import petmjx
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
