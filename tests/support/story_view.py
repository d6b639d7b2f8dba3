"""Opens the page of a story in a browser, and reads pixels and texts of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from petmjx.analysis.story import Story
from petmjx.common.units import FloatArray
from petmjx.show.pages.story_data import framed_corners
from petmjx.show.pages.story_page import story_page
from support.browser import Opened, OpenPage
from support.stories import END_S

# The first view, as in petmjx/show/pages/static/camera.js.
AZIMUTH, ELEVATION, SLOPE, MARGIN = -0.65, 0.4, np.tan(np.radians(16)), 1.06


def opened_story(open_page: OpenPage, story: Story, *, at_end: bool = True, **options: Any) -> Opened:
    """Open the page of a story and wait until it is drawn. ``at_end``: whether to move to the end of the story."""
    opened = open_page(story_page(story), **{"width": 900, "height": 560} | options)
    opened.page.wait_for_selector("#view:not([hidden])")
    if at_end:
        opened.page.keyboard.press("End")
    opened.settled()
    return opened


def seen(opened: Opened) -> FloatArray:
    """The pixels of the picture without labels and legends, as floats."""
    opened.page.evaluate("for (const label of document.querySelectorAll('#view > .label')) label.style.opacity = 0")
    opened.settled()
    return opened.pixels("#canvas").astype(float)


def changed(before: FloatArray, after: FloatArray) -> float:
    """Share of the pixels that look different."""
    return float((np.abs(before - after).max(axis=2) > 24).mean())


def on_canvas(opened: Opened, story: Story, point: FloatArray) -> tuple[float, float]:
    """Where the first view shows a point, in pixels of the window. The camera is computed independently, in closed
    form."""
    frame = opened.page.locator("#canvas").bounding_box()
    aspect = frame["width"] / frame["height"]
    back = np.array([np.sin(AZIMUTH) * np.cos(ELEVATION), -np.cos(AZIMUTH) * np.cos(ELEVATION), np.sin(ELEVATION)])
    right = np.cross([0.0, 0.0, 1.0], back) / np.cos(ELEVATION)
    up = np.cross(back, right)
    low, high = framed_corners(story)
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
    """A value from the list of the selected box. ``name``: name of the value."""
    terms = opened.page.locator("#numbers dt").all_inner_texts()
    return str(opened.page.locator("#numbers dd").all_inner_texts()[terms.index(name)])


def drag_time_to(opened: Opened, time_s: float) -> None:
    """Drag the slider's thumb with the mouse from the end to this time."""
    box = opened.page.locator("#time").bounding_box()
    y = box["y"] + box["height"] / 2
    opened.page.mouse.move(box["x"] + box["width"] - 8, y)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 8 + (box["width"] - 16) * time_s / END_S, y, steps=3)
    opened.page.mouse.up()


def now(opened: Opened) -> float:
    return float(text(opened, "#now").split()[0])
