"""The page about repairs: each plan before and after its repair, side by side, and the changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from petmjx.analysis.story import Story
from petmjx.analysis.story import tell as simulated_story
from petmjx.analysis.story_in_words import first_box_in_words, reason_in_words
from petmjx.common.atomic_write import atomic_write
from petmjx.common.text import count_text, shortened_text
from petmjx.options.simulation import Simulation
from petmjx.repairs.repair import Repaired, Repairs
from petmjx.show.pages.html_page import escaped_html, page
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
    also = (
        f"<p>{count_text(standing, 'plan stands as it is', 'plans stand as they are')}.</p>"
        if standing and fell
        else ""
    )
    frame = f" {repairs.frame[0].upper()}{repairs.frame[1:]}." if repairs.frame else ""
    body = (
        f"<header><h1>Repairs</h1><p>{escaped_html(repairs.summary)}.</p>{also}"
        '<p class="small faint">In both plans, boxes have the numbers of the original plan, from 0. '
        "Left is −x, front −y. The first box to fail, and the boxes that are changed, are outlined. Boxes "
        f"that the text names have their numbers, in parentheses if other boxes hide them.{frame}</p></header><main>"
        f"{''.join(_section(repaired, dict(repairs.how or {})) for repaired in fell)}</main>"
        f'<footer class="small faint">petmjx {escaped_html(__version__)}; units mm, kg</footer>'
    )
    title = shortened_text(fell[0].before.plan_id) if len(fell) == 1 else "repairs"
    return page(f"{title}: before and after", body, script="", styles=("repair.css",))


def _section(repaired: Repaired, how: dict[str, Any]) -> str:
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
        pictures = _picture("before", before, still_svg(before, {culprit}, None, named, [after]))
        pictures += _picture("after", after, still_svg(after, marked, numbers, named, [before]))
    else:
        pictures = _picture("before", before, still_svg(before, {culprit}, None, named))
        pictures += '<figure><figcaption class="note">No repair is known.</figcaption></figure>'
    changes = "".join(f"<li>{escaped_html(words)}</li>" for words in repaired.words)
    title = escaped_html(repaired.before.plan_id)
    return (
        f'<section><h2>Plan {title}</h2><div class="sides">{pictures}</div>'
        f"<h3>{escaped_html(_heading(repaired))}</h3><ol>{changes}</ol>{_facts(repaired)}</section>"
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


def _picture(title: str, story: Story, svg: str) -> str:
    verdict = escaped_html(story.outcome.verdict.value)
    words = first_box_in_words(story) or f"{reason_in_words(story).capitalize()}."
    return (
        f'<figure><figcaption><b>{title}</b> <span class="badge {verdict}">{verdict}</span></figcaption>'
        f'{svg}<p class="small">{escaped_html(words)}</p></figure>'
    )


def _facts(repaired: Repaired) -> str:
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
    return f'<p class="small faint">{"; ".join(f"{name} <b>{escaped_html(text)}</b>" for name, text in facts)}</p>'
