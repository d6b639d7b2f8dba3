"""Repairs in the terminal: the changes to each plan, and its share of standing worlds before and after."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from rich.console import RenderableType

from petmjx.common.text import count_text
from petmjx.repairs.repair import Repaired, Repairs
from petmjx.repairs.trials import Share
from petmjx.show.table_layout import line, note_lines

MOST_STANDING: Final = 20
"""Largest number of lines about plans that stand without repair."""


def repair_tables(repairs: Repairs) -> Iterator[RenderableType]:
    """Several lines for each plan that did not stand, a line for each of the first plans that stood, a line about all
    plans, and notes."""
    standing = [repaired for repaired in repairs.each if repaired.trial_before.stands]
    for repaired in repairs.each:
        if not repaired.trial_before.stands:
            yield from _plan_lines(repaired)
            yield ""
    for repaired in standing[:MOST_STANDING]:
        yield line(repaired.headline)
    if len(standing) > MOST_STANDING:
        yield line(
            f"{count_text(len(standing) - MOST_STANDING, 'more plan stands as it is', 'more plans stand as they are')}"
        )
    if standing and len(standing) < len(repairs.each):
        yield ""
    yield line(repairs.summary, style="bold")
    if any(repaired.changes for repaired in repairs.each):
        yield line("boxes have the numbers of the original plan, from 0", style="dim")
    if repairs.frame:
        yield line(repairs.frame, style="dim")
    yield from note_lines(repairs.notes)


def _plan_lines(repaired: Repaired) -> Iterator[RenderableType]:
    yield line(repaired.headline, style="bold green" if repaired.stands else "bold red")
    for number, words in enumerate(repaired.words, start=1):
        yield line(f"  {number}. {words}")
    if repaired.stands:
        margin = f"; margin {text}" if (text := margin_text(repaired)) else ""
        yield line(f"  cost {repaired.cost:.2f}{margin}{_shares(repaired)}", style="dim")
    if repaired.doubt:
        yield line(f"  {repaired.doubt}", style="yellow")


def margin_text(repaired: Repaired) -> str:
    """The margin of a repaired plan as text, such as "0.98"; empty: there is none."""
    trial = repaired.trial_after
    return "" if trial is None or math.isnan(trial.margin) else f"{trial.margin:.2f}"


def _shares(repaired: Repaired) -> str:
    """Text with the shares of worlds with errors in which a plan stands, before and after its repair."""
    if repaired.share_before is None or repaired.share_after is None:
        return ""
    if not repaired.share_after.n_worlds:
        return "; no world with errors had a verdict"
    before, after = share_text(repaired.share_before), share_text(repaired.share_after)
    return f"; of the worlds with errors, {before} stand before the repair, {after} after it"


def share_text(share: Share) -> str:
    """A share as text, such as "7 of 8"."""
    return f"{share.n_standing} of {share.n_worlds}"
