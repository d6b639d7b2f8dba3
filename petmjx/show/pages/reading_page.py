"""The page about how files of other tools are read: pictures of plans, columns, units and axes, and other possible
readings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from petmjx.common.text import count_text, shortened_text
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.readings import ROTATION_RULES
from petmjx.show.pages.html_page import page
from petmjx.show.pages.markup import Content, Markup, element, joined_markup
from petmjx.show.pages.still_svg import plan_svg
from petmjx.version import __version__

_MOST_PICTURES: Final = 4
"""Largest number of plans of a file that are drawn."""
_MOST_BOXES: Final = 8
"""Largest number of boxes of a plan whose sizes, corners and masses are listed."""
_MOST_LINES: Final = 20
"""Largest number of lines about odd and skipped plans."""

_FACTS: Final = {
    "units": "lengths",
    "masses": "masses",
    "anchor": "coordinates of",
    "up": "vertical axis",
    "sizes": "sizes",
    "rule": "turns",
    "origin": "origin",
    "order": "packing order",
}
"""Name of a field of ``Reading`` → its heading."""
_WORDS: Final = {
    "sizes": {"placed": "as placed", "item": "before turning"},
    "rule": ROTATION_RULES,
    "origin": {"given": "as in the file", "middle": "the middle of the carrier", "floor": "below the deck"},
    "order": {"sequence": "by its column", "rows": "as the rows", "height": "from the ground up"},
}
"""Name of a field of ``Reading`` → value → description of the value."""

_INTRODUCTION: Final = Markup(
    "Pictures show plans as they were read, before anything is simulated. Left is −x, front −y. If a picture is wrong, "
    "say how the file is to be read: <code>--units</code>, <code>--anchor</code>, <code>--up</code>, "
    "<code>--sizes</code>, <code>--columns</code>."
)


def reading_page(plan_set: PlanSet, infos: Sequence[Mapping[str, Any]]) -> str:
    """The text of an offline HTML file that shows how files are read.

    Args:
        infos: one record per file, from ``petmjx.show.file_info.file_infos``.
    """
    sections = [_section(record, [plan for plan in plan_set if plan.source == record["file"]]) for record in infos]
    body = joined_markup(
        element("header", element("h1", "How the files were read"), element("p", _INTRODUCTION, class_="small faint")),
        element("main", *sections),
        element("footer", f"petmjx {__version__}", class_="small faint"),
    )
    title = shortened_text(infos[0]["file"]) if len(infos) == 1 else count_text(len(infos), "file")
    return page(f"{title}: how it was read", body, script="", styles=("reading.css",))


def _section(record: Mapping[str, Any], plans: Sequence[Plan]) -> Markup:
    """The section about one file."""
    counts = f"{count_text(record['plans'], 'plan')}, {count_text(record['boxes'], 'box', 'boxes')}"
    n_more = len(plans) - _MOST_PICTURES
    reading = record["reading"]
    return element(
        "section",
        element("h2", record["file"]),
        element("p", f"{record['form']}; {counts}"),
        *(element("p", note, class_="note") for note in (reading["notes"] if reading else ())),
        element(
            "div", *map(_picture, plans[:_MOST_PICTURES]), _conventions(reading) if reading else None, class_="sides"
        ),
        element("p", count_text(n_more, "more plan"), class_="faint small") if n_more > 0 else None,
        *(_columns(reading) if reading else ()),
        *(_first_boxes(plans[0]) if plans else ()),
        *_lines("What is odd", record["odd"]),
        *_lines("What was skipped", record["skipped"]),
    )


def _picture(plan: Plan) -> Markup:
    size = " × ".join(f"{length:,.0f}" for length in (plan.corner_mm + plan.size_mm).max(axis=0))
    caption = f"{plan.plan_id}: {count_text(plan.n_boxes, 'box', 'boxes')}, {size} mm, {plan.mass_kg.sum():,.1f} kg"
    return element("figure", element("figcaption", element("b", caption)), plan_svg(plan))


def _conventions(reading: Mapping[str, Any]) -> Markup:
    """The section about units, axes and rotations."""
    facts = [(_FACTS[name], _WORDS.get(name, {}).get(reading[name], reading[name])) for name in _FACTS]
    facts.append(("sizes along x, y, z", ", ".join(reading["along"])))
    facts.append(("evidence", reading["evidence"]))
    return element("div", element("h3", "Units and axes"), _table(("", "read as"), facts))


def _columns(reading: Mapping[str, Any]) -> Iterator[Markup]:
    """The columns of the file, and other possible readings."""
    yield element("h3", "Columns")
    yield _table(("in petmjx", "in the file"), reading["columns"].items())
    if reading["unused"]:
        yield element("p", f"Not used: {', '.join(reading['unused'])}")
    if reading["alternatives"]:
        yield element("h3", "Other readings")
        rows = [
            (other["line"].removeprefix("read as "), other["evidence"], f"{other['cost']:.2f}")
            for other in reading["alternatives"]
        ]
        yield _table(("reading", "evidence", "less plausible by"), rows)


def _first_boxes(plan: Plan) -> Iterator[Markup]:
    """A table of the first boxes of a plan, as petmjx reads them."""
    yield element("h3", f"The first boxes of {plan.plan_id}")
    rows = [
        (box, plan.articles[box], _lengths(plan.size_mm[box]), _lengths(plan.corner_mm[box]), f"{plan.mass_kg[box]:g}")
        for box in range(min(plan.n_boxes, _MOST_BOXES))
    ]
    yield _table(("box", "article", "size along x, y, z, mm", "corner, mm", "mass, kg"), rows)


def _lengths(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.7g}" for value in values)


def _lines(title: str, lines: Sequence[str]) -> Iterator[Markup]:
    if lines:
        yield element("h3", title)
        items: list[Content] = [element("li", line) for line in lines[:_MOST_LINES]]
        items += [element("li", f"{len(lines) - _MOST_LINES:,} more")] if len(lines) > _MOST_LINES else []
        yield element("ul", *items)


def _table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Markup:
    head = element("tr", *(element("th", name, scope="col") for name in heads))
    lines = [element("tr", *(element("td", str(value), class_="text") for value in row)) for row in rows]
    return element("div", element("table", element("thead", head), element("tbody", *lines)), class_="wide")
