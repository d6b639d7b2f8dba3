"""The page of one story (the simulation of one plan): the pallet in 3D over time, the first box to fail, and a table of
all boxes.

The module sets ``Story.page``, the function with which notebooks show a story as a page. ``petmjx.tell`` is imported
from this module. So ``Story.page`` is set before ``petmjx.tell`` makes a story.
"""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from petmjx.analysis.story import Story, tell
from petmjx.analysis.story_in_words import first_box_in_words, how_it_was_simulated, notes_in_words, reason_in_words
from petmjx.common.text import count_text, shortened_text
from petmjx.show.pages.html_page import escaped_html, filled_template, page
from petmjx.show.pages.markup import Markup, element, joined_markup
from petmjx.show.pages.still_svg import still_svg
from petmjx.show.pages.story_data import story_blocks, story_info
from petmjx.version import __version__

__all__ = ["story_as_html", "story_page", "tell"]


def story_page(story: Story) -> str:
    """An offline HTML file in which a story can be played, turned and inspected. Without WebGL, the page shows a still
    picture and a table.

    Returns:
        The text of the file, to be written as UTF-8.
    """
    info = story_info(story)
    outcome, plan = story.outcome, story.plan
    facts = [*how_it_was_simulated(story), ("petmjx", __version__), ("units", "s, mm, °, kg, N; 1 g is 9.81 m/s²")]
    body = filled_template(
        "story.html",
        plan=escaped_html(plan.plan_id),
        verdict=escaped_html(outcome.verdict.value),
        summary=escaped_html(_summary(story)),
        first=escaped_html(first_box_in_words(story)),
        variant=f"variant {story.variant}" if story.values else "",
        note=joined_markup(*(element("p", note, class_="note") for note in _notes(story))),
        still=still_svg(story),
        facts=joined_markup(*(element("span", f"{name} ", element("b", value)) for name, value in facts)),
        table=_table(story, info["boxes"]),
        boxes=count_text(plan.n_boxes, "box", "boxes"),
        end=f"{story.history.time_s[-1]:.2f}",
    )
    return page(
        f"{shortened_text(plan.plan_id)}: {outcome.verdict.value}",
        body,
        script="story.js",
        styles=("story.css", "timeline.css"),
        info=info,
        blocks=story_blocks(story),
    )


FRAME_HEIGHT_PX = 760


def story_as_html(story: Story) -> str:
    """The page of a story inside an HTML frame, so that its styles do not mix with the styles of a notebook."""
    text, title = html.escape(story_page(story)), html.escape(repr(story))
    style = f"width: 100%; height: {FRAME_HEIGHT_PX}px; border: 0"
    return f'<iframe title="{title}" srcdoc="{text}" style="{style}"></iframe>'


Story.page = story_as_html


def _notes(story: Story) -> list[str]:
    """Notes for the reader, one line each."""
    notes = notes_in_words(story)
    if story.drive is not None and not np.any(story.history.drive):
        name = story.drive.excitation.name
        notes.append(f"The pallet was shaken by {name}, but no frame shows a push: record at shorter intervals.")
    return notes


def _summary(story: Story) -> str:
    """A sentence with the number of boxes and the reason of the verdict."""
    outcome = story.outcome
    placed = "" if outcome.n_placed == outcome.n_boxes else f"{outcome.n_placed} of "
    boxes = f"{placed}{count_text(outcome.n_boxes, 'box', 'boxes')} placed"
    return f"{boxes}; {reason_in_words(story)}."


_COLUMNS = (
    ("mass_kg", "mass, kg", ".2f"),
    ("sequence", "in the order", "d"),
    ("placed_s", "placed, s", ".2f"),
    ("end_shift_mm", "shift at the end, mm", ".1f"),
    ("max_tilt_deg", "largest tilt, °", ".1f"),
    ("max_force_n", "largest force on top, N", "z.1f"),
    ("rest_force_n", "force on top at rest, N", "z.1f"),
    ("drop_s", "dropped, s", ".2f"),
)
"""The columns with numbers: name in ``story_info``, heading with the unit, and format. The letter z in the format of
forces turns -0.0 into 0.0."""


def _table(story: Story, boxes: dict[str, Any]) -> Markup:
    """The HTML table with one row per box."""
    titles = ("box", "article", "item", "size, mm", *(title for _, title, _ in _COLUMNS))
    texts = ("article", "item")
    heads = [element("th", title, scope="col", class_="text" if title in texts else None) for title in titles]
    rows = []
    for box in range(story.plan.n_boxes):
        cells = [element("td", boxes[name][box], class_="text") for name in texts]
        cells.append(element("td", " × ".join(f"{length:g}" for length in boxes["size_mm"][box])))
        cells += [element("td", _number(boxes[name][box], form)) for name, _, form in _COLUMNS]
        mark = "first" if box == story.outcome.culprit else None
        rows.append(element("tr", element("th", str(box), scope="row"), *cells, class_=mark))
    return element("table", element("thead", element("tr", *heads)), element("tbody", *rows))


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "–"
