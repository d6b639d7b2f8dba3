"""The page about repairs: each plan before and after its repair, side by side, and the changes."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

from petmjx.analysis.story import Story
from petmjx.analysis.story import tell as simulated_story
from petmjx.analysis.story_in_words import first_box_in_words, reason_in_words
from petmjx.common.atomic_write import atomic_write
from petmjx.common.text import count_text, shortened_text
from petmjx.options.simulation import Simulation
from petmjx.repairs.repair import Repaired, Repairs
from petmjx.show.pages.html_page import page
from petmjx.show.pages.markup import Markup, element, joined_markup
from petmjx.show.pages.still_svg import still_svg
from petmjx.show.repair_tables import margin_text, share_text
from petmjx.version import __version__


def write_repair_page(repairs: Repairs, path: Path) -> None:
    """Write the page to a file. An existing file is replaced.

    Raises:
        InputError: the file cannot be written.
    """
    text = repair_page(repairs)
    with atomic_write(path) as file:
        file.write_text(text, encoding="utf-8")


def repair_page(repairs: Repairs) -> str:
    """The text of an offline HTML file about repairs. For each plan that did not stand, the page shows the changes, and
    two pictures: the end of the simulation before and after the repair.

    To make the pictures, both plans are simulated once more.
    """
    fell = [repaired for repaired in repairs.each if not repaired.trial_before.stands]
    standing = len(repairs.each) - len(fell)
    also = f"{count_text(standing, 'plan stands as it is', 'plans stand as they are')}."
    frame = f" {repairs.frame[0].upper()}{repairs.frame[1:]}." if repairs.frame else ""
    how_to_read = (
        "In both plans, boxes have the numbers of the original plan, from 0. Left is −x, front −y. The first box to "
        "fail, and the boxes that are changed, are outlined. Boxes that the text names have their numbers, in "
        f"parentheses if other boxes hide them.{frame}"
    )
    body = joined_markup(
        element(
            "header",
            element("h1", "Repairs"),
            element("p", f"{repairs.summary}."),
            element("p", also) if standing and fell else None,
            element("p", how_to_read, class_="small faint"),
        ),
        element("main", *(_section(repaired, dict(repairs.how or {})) for repaired in fell)),
        element("footer", f"petmjx {__version__}; units mm, kg", class_="small faint"),
    )
    title = shortened_text(fell[0].before.plan_id) if len(fell) == 1 else "repairs"
    return page(f"{title}: before and after", body, script="", styles=("repair.css",))


def _section(repaired: Repaired, how: dict[str, Any]) -> Markup:
    """The section about one plan: its pictures and its changes."""
    before = simulated_story(repaired.before, details=False, **how)
    culprit = before.outcome.culprit
    named = {culprit, *(box for change in repaired.changes for box in change.named)}
    if repaired.stands:
        changed = {box for change in repaired.changes for box in change.boxes}
        numbers = _numbers(repaired)
        if repaired.film_turns is not None:
            how = {**how, "wrap": Simulation(**how).wrap.changed(turns=repaired.film_turns)}
        after = simulated_story(repaired.plan, details=False, **how)
        marked = {row for row, box in enumerate(numbers) if box in changed}
        pictures = (
            _picture("before", before, still_svg(before, {culprit}, None, named, [after])),
            _picture("after", after, still_svg(after, marked, numbers, named, [before])),
        )
    else:
        pictures = (
            _picture("before", before, still_svg(before, {culprit}, None, named)),
            element("figure", element("figcaption", "No repair is known.", class_="note")),
        )
    return element(
        "section",
        element("h2", f"Plan {repaired.before.plan_id}"),
        element("div", *pictures, class_="sides"),
        element("h3", _heading(repaired)),
        element("ol", *(element("li", words) for words in repaired.words)),
        _facts(repaired),
    )


def _heading(repaired: Repaired) -> str:
    """The heading above the changes."""
    if not repaired.stands:
        return f"No changed plan stands ({repaired.n_trials:,} simulated)"
    return f"It stands after {count_text(len(repaired.changes), 'change')}"


def _numbers(repaired: Repaired) -> list[int]:
    """For each box of the repaired plan, its number in the original plan. Sheets that the repair added have numbers
    after the last box of the original plan."""
    from petmjx.repairs.changes import applied
    from petmjx.repairs.drafts import Draft

    draft = applied(Draft.of(repaired.before), repaired.changes)
    assert draft is not None
    return list(draft.order)


def _picture(title: str, story: Story, svg: Markup) -> Markup:
    verdict = story.outcome.verdict.value
    badge = element("span", verdict, class_=f"badge {verdict}")
    words = first_box_in_words(story) or f"{reason_in_words(story).capitalize()}."
    caption = element("figcaption", element("b", title), " ", badge)
    return element("figure", caption, svg, element("p", words, class_="small"))


def _facts(repaired: Repaired) -> Markup:
    """A line with the cost of the repair, the margin, the shares of worlds with errors in which the plan stands, and
    the number of plans that were simulated."""
    facts = [("cost", f"{repaired.cost:.2f}")] if repaired.stands else []
    facts += [("margin", text)] if (text := margin_text(repaired)) else []
    for name, share in (("before", repaired.share_before), ("after", repaired.share_after)):
        if share is not None:
            facts.append((f"{name} the repair, worlds with errors that stand", share_text(share)))
    facts.append(("plans simulated", f"{repaired.n_trials:,}"))
    if repaired.doubt:
        facts.append(("without a verdict", repaired.doubt))
    words = [(f"{'; ' * (number > 0)}{name} ", element("b", text)) for number, (name, text) in enumerate(facts)]
    return element("p", *itertools.chain(*words), class_="small faint")
