"""The parts of HTML pages, tested without a browser: data, escaped texts, joined scripts, colours, sentences, the still
picture."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import time
import zlib
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from support.stories import FALLING, falling_story, long_story, shaken_story, standing_story

from petmjx.analysis.story import Story
from petmjx.analysis.story_in_words import (
    first_box_in_words,
    headline,
    how_it_was_simulated,
    notes_in_words,
    reason_in_words,
)
from petmjx.engines.verdict import Flag, Reason, Verdict
from petmjx.show.pages.html_page import escaped_html, joined_modules, page, static_text
from petmjx.show.pages.page_arrays import PackedArray, block, integer_column, quantised_column
from petmjx.show.pages.palette import OKABE_ITO, article_colours, category, ramp, rgb_of
from petmjx.show.pages.still_svg import drawing_order, still_svg
from petmjx.show.pages.story_data import framed_corners, placed_s, story_blocks, story_info
from petmjx.show.pages.story_page import story_page
from petmjx.show.story_tables import story_tables
from petmjx.world.history import Contacts

NASTY = "</script><!--<script>alert(1)</script>\u2028&\"'<img src=x onerror=alert(2)>💥,\n"


def opened_block(text: str) -> dict[str, dict[str, Any]]:
    """Unpack a compressed block of a page: name → header entry. Each entry gets the stored numbers as ``values``."""
    raw = zlib.decompress(base64.b64decode(text))
    length = int.from_bytes(raw[:4], "little")
    header = {entry["name"]: entry for entry in json.loads(raw[4 : 4 + length])}
    for entry in header.values():
        start = 4 + length + entry["at"]
        assert start % 8 == 0, "typed arrays need aligned offsets"
        count = int(np.prod(entry["shape"]))
        entry["values"] = np.frombuffer(raw, np.dtype(entry["type"]).newbyteorder("<"), count, start)
    return header


def restored(packed: PackedArray) -> np.ndarray[Any, Any]:
    """The numbers that a page's script computes from a packed column."""
    raw = packed.values
    if packed.steps:
        raw = np.cumsum(raw, axis=0, dtype=raw.dtype)
    if packed.scale is None:
        return raw
    return np.where(raw == -32768, np.nan, raw * packed.scale + packed.offset)


@pytest.mark.parametrize("steps", [False, True])
def test_quantised_numbers_come_back_within_half_a_part(steps: bool) -> None:
    values = np.random.default_rng(1).normal(0.0, 3.0, (50, 7, 3))
    values[:20, 2] = np.nan
    back = restored(quantised_column(values, steps))
    part = (np.nanmax(values) - np.nanmin(values)) / 65_534
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values)) <= part / 2 * 1.001


@pytest.mark.parametrize("values", [np.full((3, 2), np.nan), np.full((3, 2), 0.25), np.zeros((0, 2))])
def test_columns_without_a_range(values: Any) -> None:
    assert np.array_equal(restored(quantised_column(values, steps=True)), values, equal_nan=True)


@pytest.mark.parametrize("values", [[0, 255], [-1, 127], [-2, 200], [0, 70_000], [-70_000, 5]])
def test_whole_numbers_come_back(values: list[int]) -> None:
    packed = integer_column(np.array(values), steps=True)
    assert restored(packed).tolist() == values
    assert packed.values.dtype.itemsize <= 4


def test_whole_numbers_beyond_32_bits_are_refused() -> None:
    with pytest.raises(ValueError, match="32 bits"):
        integer_column(np.array([2**40]))


def test_a_block_has_its_arrays() -> None:
    header = opened_block(block({"a": np.arange(3, dtype=np.uint8), "b": quantised_column(np.array([[0.0, 1.0]]))}))
    assert header["a"]["values"].tolist() == [0, 1, 2]
    assert header["b"]["shape"] == [1, 2]
    assert (header["b"]["values"] * header["b"]["scale"] + header["b"]["offset"]).tolist() == pytest.approx([0, 1])
    with pytest.raises(ValueError, match="int64"):
        block({"a": np.arange(3)})


def test_frames_at_rest_take_hardly_any_room() -> None:
    moving = np.random.default_rng(2).normal(size=(400, 45, 3))
    resting = np.tile(moving[:1], (400, 1, 1))
    assert len(block({"pos": quantised_column(resting, steps=True)})) < 0.01 * len(
        block({"pos": quantised_column(moving, True)})
    )


def elements(html: str, tag: str) -> list[str]:
    return re.findall(rf"<{tag}[^>]*>(.*?)</{tag}>", html, flags=re.DOTALL)


def test_the_policy_names_script_and_style_by_their_hashes_and_nothing_else() -> None:
    html = page("title", "<p>body</p>", script="viewer.js", styles=("story.css",))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html)
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy[1].split(";"))
    (script,) = re.findall(r'<script type="module">(.*?)</script>', html, flags=re.DOTALL)
    for name, text in (("script-src", script), ("style-src", elements(html, "style")[0])):
        assert rules.pop(name) == f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
    assert rules == {"default-src": "'none'", "img-src": "data:", "base-uri": "'none'", "form-action": "'none'"}


def test_data_cannot_end_its_element() -> None:
    html = page(NASTY, "", script="viewer.js", info={NASTY: [NASTY, float("nan")]})
    (text,) = re.findall(r'<script type="application/json" id="info">(.*?)</script>', html, flags=re.DOTALL)
    assert text.isascii()
    assert not set("<>&") & set(text)
    assert json.loads(text) == {NASTY: [NASTY, None]}
    assert "<img" not in html
    assert html.count("<script") == 2


def test_markup_of_plans_is_text_everywhere_in_the_page() -> None:
    html = story_page(falling_story(plan_id=NASTY, articles=(NASTY, "tea", NASTY), note=NASTY))
    without_data = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    assert "alert(1)" in without_data
    assert "<img" not in without_data
    assert "<!--" not in without_data
    assert escaped_html("<b>&'\"\n") == "&lt;b&gt;&amp;&#x27;&quot;\\n"


def test_names_of_blocks_are_checked() -> None:
    with pytest.raises(ValueError, match="name of a block"):
        page("", "", script="viewer.js", blocks={'"><script>': ""})


def test_modules_are_joined_in_the_order_of_their_imports() -> None:
    text = joined_modules("story.js")
    made = re.findall(r"^const (\w+)_js = ", text, flags=re.MULTILINE)
    assert made[-1] == "story"
    assert made.index("vectors") < made.index("camera") < made.index("viewer")
    assert len(made) == len(set(made))
    assert not re.search(r"^(import|export)\b", text, flags=re.MULTILINE)
    assert static_text("vectors.js").count("export ") > 5


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('import a from "./vectors.js";\n', "cannot be joined"),
        ("export default 1;\n", "cannot be joined"),
        ('import { a } from "./it.js";\n', "import each other"),
    ],
)
def test_what_cannot_be_joined_is_refused(text: str, complaint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.show.pages.html_page.static_text", lambda name: text)
    with pytest.raises(ValueError, match=complaint):
        joined_modules("it.js")


def luminance(colour: str) -> float:
    """Relative luminance of an sRGB colour, from 0 to 1 (WCAG 2.1)."""
    parts = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in rgb_of(colour)]
    return float(np.dot(parts, [0.2126, 0.7152, 0.0722]))


def test_the_ramp_is_read_without_hues() -> None:
    brightness = [luminance(colour) for colour in ramp()]
    assert all(a < b for a, b in pairwise(brightness))
    assert brightness[0] < 0.1
    assert brightness[-1] > 0.75


def test_articles_keep_their_colours_and_frequent_ones_get_the_plain_hues() -> None:
    assert article_colours(["b", "a", "a"]) == [OKABE_ITO[1], OKABE_ITO[0], OKABE_ITO[0]]
    assert len({category(number) for number in range(21)}) == 21
    assert category(21) == category(0)


def test_a_story_in_words() -> None:
    story = falling_story()
    assert reason_in_words(story) == "a box dropped"
    # after 0.2 s of fall, the box has moved 400 mm to the right and turned by 0.8 rad; its lowest corner is not yet 0.1
    # m below the carrier's top
    assert first_box_in_words(story) == (
        "Box 2 (milk) failed first: at 0.80 s it was tilted by 45.8° (limit 20°) and had shifted by 400 mm "
        "(limit 20 mm)."
    )
    high = story.plan.corner_mm + np.array([0, 0, 100.0]) * (np.arange(3)[:, None] == story.outcome.culprit)
    planned = first_box_in_words(replace(story, plan=replace(story.plan, corner_mm=high)))
    assert planned.startswith("Box 2 (milk) was planned 100 mm in the air and failed first: at 0.80 s it was tilted")
    standing = standing_story()
    assert first_box_in_words(standing) == ""
    assert reason_in_words(standing) == "no box shifted by more than 20 mm, tilted by more than 20° or dropped"
    facts = dict(how_it_was_simulated(shaken_story()))
    assert facts["engine"] == "mujoco"
    assert facts["physics"] == "pallet"
    assert facts["shaken by"] == "half-a-g × 1, 0°"
    assert facts["level_g"] == "0.5"


def test_flags_that_make_a_verdict_doubtful_are_told() -> None:
    story = standing_story()

    def told(flags: Flag, **changes: Any) -> Story:
        return replace(story, outcome=replace(story.outcome, flags=flags, **changes))

    assert notes_in_words(told(Flag.EARLY_STOP)) == []
    moving = told(Flag.MOVING)
    (note,) = notes_in_words(moving)
    assert note.startswith("Boxes still moved after the longest wait")
    assert headline(moving).startswith("stable, still moving")
    aside = told(Flag.MOVING, verdict=Verdict.UNSTABLE, reason=Reason.SHIFT, culprit=0, first_sign_s=1.0)
    assert headline(aside).startswith("unstable by shift, still moving: first box 0")
    edge = told(Flag.KNIFE_EDGE, plan_edge_m=0.041, rest_edge_m=-0.00031)
    (note,) = notes_in_words(edge)
    assert note.startswith("A load acts within 0.31 mm of the edge of its support (at rest):")
    all_of_them = replace(told(Flag.MOVING | Flag.KNIFE_EDGE | Flag.TIMESTEP, plan_edge_m=0.0), note="another engine")
    notes = notes_in_words(all_of_them)
    assert len(notes) == 4
    page = story_page(all_of_them)
    assert all(escaped_html(note) in page for note in notes)
    printed = "\n".join(str(table) for table in story_tables(all_of_them))
    assert all(f"note: {note}" in printed for note in notes)
    assert notes_in_words(told(Flag.MOVING, verdict=Verdict.INVALID, reason=Reason.FAILED)) == []


@pytest.mark.parametrize("reason", [reason for reason in Reason if reason is not Reason.NONE])
def test_every_reason_has_words(reason: Reason) -> None:
    story = falling_story()
    unstable = reason in (Reason.DROP, Reason.TILT, Reason.SHIFT)
    verdict = Verdict.UNSTABLE if unstable else Verdict.INVALID
    outcome = replace(story.outcome, verdict=verdict, reason=reason, culprit=-1, first_sign_s=np.nan)
    changed_story = replace(story, outcome=outcome)
    assert len(reason_in_words(changed_story)) > 10
    assert escaped_html(reason_in_words(changed_story)) in story_page(changed_story)


def test_times_of_placements() -> None:
    story = falling_story()
    assert placed_s(story.history) == pytest.approx([0.0, 0.2, 0.4])
    history = replace(story.history, n_placed=np.minimum(story.history.n_placed, 2))
    assert placed_s(history) == pytest.approx([0.0, 0.2, np.nan], nan_ok=True)


def test_the_picture_shows_plan_and_carrier_and_what_lies_near() -> None:
    story = falling_story()
    low, high = framed_corners(story)
    assert low == pytest.approx([0.0, 0.0, -0.144], abs=1e-3)
    assert high[0] == pytest.approx(story.history.pos[-1, FALLING, 0])
    assert story_info(story)["first"]["box"] == FALLING


def test_near_boxes_are_drawn_after_far_ones() -> None:
    """A long box stands in front of a tall box, and a small box lies on the long box. The centre of the long box is
    farther away than that of the tall box."""
    pos = np.array([[0.0, 0.0, 0.0], [-3.0, 0.5, 0.0], [0.0, 0.0, 1.0]])
    half = np.array([[4.0, 0.2, 0.5], [0.2, 0.2, 2.0], [0.2, 0.2, 0.5]])
    axes = np.tile(np.eye(3), (3, 1, 1))
    order = drawing_order(pos, axes, half)
    assert order.index(1) < order.index(0) < order.index(2)


def test_the_still_picture_has_every_box_that_is_there() -> None:
    story = falling_story()
    svg = still_svg(story)
    assert svg.count("<g") == 4
    assert svg.count('class="first"') == 1
    assert re.findall(r"<title>(.*?)</title>", svg).count("2 milk") == 1
    pos = story.history.pos.copy()
    pos[-1, FALLING] = np.nan
    assert still_svg(replace(story, history=replace(story.history, pos=pos))).count("<g") == 3


def test_contacts_of_a_pair_are_one_force_on_the_lower_body() -> None:
    """Boxes 0 and 1 have four contacts, one of which is stored with the two bodies in the other order. One of the boxes
    also touches the carrier."""
    story = falling_story()
    contacts = story.history.contacts
    assert contacts is not None
    between = np.flatnonzero((contacts.body == [0, 1]).all(axis=1))
    body, force = contacts.body.copy(), contacts.force.copy()
    body[between[::4]], force[between[::4]] = [1, 0], -force[between[::4]]
    history = replace(story.history, contacts=replace(contacts, body=body, force=force))
    columns = opened_block(story_blocks(replace(story, history=history))["contacts"])

    def values(name: str) -> Any:
        column = columns[name]
        raw = np.cumsum(column["values"].reshape(column["shape"]), axis=0, dtype=column["type"])
        return raw * column.get("scale", 1) + column.get("offset", 0)

    last = values("frame") == len(story.history.time_s) - 1
    assert values("force")[last] == pytest.approx(np.array([[0, 0, -117.8], [0, 0, -58.9]]), abs=0.01)
    assert values("point")[last] == pytest.approx(np.array([[0.2, 0.2, 0.0], [0.2, 0.2, 0.2]]), abs=1e-4)


def test_a_story_without_a_single_contact() -> None:
    story = falling_story()
    none = replace(story.history, contacts=Contacts.none())
    assert opened_block(story_blocks(replace(story, history=none))["contacts"])["frame"]["shape"] == [0]


def test_numbers_that_are_not_finite_spoil_nothing() -> None:
    """In the last frames, the numbers of one box and of the carrier are huge, infinite or NaN, as in a simulation that
    failed numerically."""
    story = falling_story()
    pos, carrier = story.history.pos.copy(), story.history.carrier_pos.copy()
    pos[-2, 0], pos[-1, 0], carrier[-1] = 1e30, np.inf, np.nan
    history = replace(story.history, pos=pos, carrier_pos=carrier)
    blown_up = replace(story, history=history)
    frames = opened_block(story_blocks(blown_up)["frames"])
    assert frames["pos"]["scale"] < 1e-3
    assert "nan" not in still_svg(blown_up)
    (info,) = re.findall(r'id="info">(.*?)</script>', story_page(blown_up))
    assert "Infinity" not in info


def test_a_page_of_45_boxes_and_a_minute_is_small_and_made_quickly() -> None:
    story = long_story()
    began = time.process_time()
    html = story_page(story)
    assert time.process_time() - began < 10
    assert len(html.encode()) < 2_000_000


def test_the_table_has_the_numbers_of_all_boxes() -> None:
    (table,) = elements(story_page(falling_story()), "tbody")
    rows = [
        [re.sub("<.*?>", "", cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", row)] for row in elements(table, "tr")
    ]
    assert rows[0][:6] == ["0", "tea", "item-0", "400 × 400 × 200", "6.00", "1"]
    assert rows[2][-5:] == ["800.0", "91.7", "0.0", "0.0", "1.00"]
    assert rows[1][-1] == "–"
