"""The page about how files of other tools are read: pictures of plans, columns, units and axes, and other possible
readings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from petmjx.common.text import count_text, shortened_text
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.readings import ROTATION_RULES
from petmjx.show.pages.html_page import escaped_html, page
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


def reading_page(plan_set: PlanSet, infos: Sequence[Mapping[str, Any]]) -> str:
    """The text of an offline HTML file that shows how files are read.

    Args:
        infos: one record per file, from ``petmjx.show.file_info.file_infos``.
    """
    sections = "".join(
        _section(record, [plan for plan in plan_set if plan.source == record["file"]]) for record in infos
    )
    body = (
        "<header><h1>How the files were read</h1>"
        '<p class="small faint">Pictures show plans as they were read, before anything is simulated. '
        "Left is −x, front −y. If a picture is wrong, say how the file is to be read: "
        "<code>--units</code>, <code>--anchor</code>, <code>--up</code>, <code>--sizes</code>, "
        "<code>--columns</code>.</p></header>"
        f'<main>{sections}</main><footer class="small faint">petmjx {escaped_html(__version__)}</footer>'
    )
    title = shortened_text(infos[0]["file"]) if len(infos) == 1 else count_text(len(infos), "file")
    return page(f"{title}: how it was read", body, script="", styles=("reading.css",))


def _section(record: Mapping[str, Any], plans: Sequence[Plan]) -> str:
    """The section about one file."""
    counts = f"{count_text(record['plans'], 'plan')}, {count_text(record['boxes'], 'box', 'boxes')}"
    pictures = "".join(_picture(plan) for plan in plans[:_MOST_PICTURES])
    n_more = len(plans) - _MOST_PICTURES
    also = f'<p class="faint small">{count_text(n_more, "more plan")}</p>' if n_more > 0 else ""
    reading = record["reading"]
    return (
        f"<section><h2>{escaped_html(record['file'])}</h2><p>{escaped_html(record['form'])}; {counts}</p>"
        f"{_notes(reading['notes'] if reading else ())}"
        f'<div class="sides">{pictures}{_conventions(reading) if reading else ""}</div>{also}'
        f"{_columns(reading) if reading else ''}"
        f"{_first_boxes(plans[0]) if plans else ''}"
        f"{_lines('What is odd', record['odd'])}{_lines('What was skipped', record['skipped'])}</section>"
    )


def _picture(plan: Plan) -> str:
    size = " × ".join(f"{length:,.0f}" for length in (plan.corner_mm + plan.size_mm).max(axis=0))
    caption = f"{plan.plan_id}: {count_text(plan.n_boxes, 'box', 'boxes')}, {size} mm, {plan.mass_kg.sum():,.1f} kg"
    return f"<figure><figcaption><b>{escaped_html(caption)}</b></figcaption>{plan_svg(plan)}</figure>"


def _conventions(reading: Mapping[str, Any]) -> str:
    """The section about units, axes and rotations."""
    facts = [(_FACTS[name], _WORDS.get(name, {}).get(reading[name], reading[name])) for name in _FACTS]
    facts.append(("sizes along x, y, z", ", ".join(reading["along"])))
    facts.append(("evidence", reading["evidence"]))
    return f"<div><h3>Units and axes</h3>{_table(('', 'read as'), facts)}</div>"


def _columns(reading: Mapping[str, Any]) -> str:
    """The section about the columns of the file, and about other possible readings."""
    html = f"<h3>Columns</h3>{_table(('in petmjx', 'in the file'), reading['columns'].items())}"
    if reading["unused"]:
        html += f"<p>Not used: {escaped_html(', '.join(reading['unused']))}</p>"
    if reading["alternatives"]:
        rows = [
            (other["line"].removeprefix("read as "), other["evidence"], f"{other['cost']:.2f}")
            for other in reading["alternatives"]
        ]
        html += f"<h3>Other readings</h3>{_table(('reading', 'evidence', 'less plausible by'), rows)}"
    return html


def _first_boxes(plan: Plan) -> str:
    """A table of the first boxes of a plan, as petmjx reads them."""
    rows = [
        (box, plan.articles[box], _lengths(plan.size_mm[box]), _lengths(plan.corner_mm[box]), f"{plan.mass_kg[box]:g}")
        for box in range(min(plan.n_boxes, _MOST_BOXES))
    ]
    heads = ("box", "article", "size along x, y, z, mm", "corner, mm", "mass, kg")
    return f"<h3>The first boxes of {escaped_html(plan.plan_id)}</h3>{_table(heads, rows)}"


def _lengths(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.7g}" for value in values)


def _notes(notes: Sequence[str]) -> str:
    return "".join(f'<p class="note">{escaped_html(note)}</p>' for note in notes)


def _lines(title: str, lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "".join(f"<li>{escaped_html(line)}</li>" for line in lines[:_MOST_LINES])
    more_item = f"<li>{len(lines) - _MOST_LINES:,} more</li>" if len(lines) > _MOST_LINES else ""
    return f"<h3>{title}</h3><ul>{items}{more_item}</ul>"


def _table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    head = "".join(f'<th scope="col">{escaped_html(name)}</th>' for name in heads)
    cells = "".join(
        "<tr>" + "".join(f'<td class="text">{escaped_html(value)}</td>' for value in row) + "</tr>" for row in rows
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{cells}</tbody></table></div>'
