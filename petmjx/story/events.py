"""What happened in a story, event by event, and what came of it in one line."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from petmjx.basics.text import box_in_words, counted, shown
from petmjx.basics.units import MM_PER_M
from petmjx.story.tell import Story
from petmjx.story.words import first_box_in_words
from petmjx.verdict import Flag, Reason, Verdict
from petmjx.world.job import FORCE

MOST_DROPS: Final = 8
"""Most boxes whose drop has a line."""


class Event(NamedTuple):
    """Something that happened. ``is_first_sign``: a box crossed a limit before all others."""

    time_s: float
    what: str
    is_first_sign: bool = False


def headline(story: Story) -> str:
    """Verdict, reason, first box and when, in one line."""
    outcome = story.outcome
    text = outcome.verdict.value + (f" by {outcome.reason.value}" if outcome.reason else "")
    if outcome.verdict is Verdict.STABLE or outcome.reason is Reason.SHIFT:
        text += ", still moving" if outcome.flags & Flag.MOVING else ""
    if outcome.verdict is Verdict.STABLE:
        text += ", leans" if outcome.flags & Flag.LEANS else ""
        return text + ("" if math.isnan(outcome.margin) else f", margin {outcome.margin:.2f}")
    if outcome.culprit < 0:
        return text
    return f"{text}: first {box_name(story, outcome.culprit)}, at {outcome.first_sign_s:.2f} s"


def box_name(story: Story, box: int) -> str:
    """ "box 22 (candy-00100723)", with the id where there is no article; boxes count from 0 in packing order."""
    return box_in_words(box, story.plan.articles[box] or story.plan.item_ids[box])


def _subject(story: Story, box: int) -> str:
    """The name of a box at the beginning of a sentence."""
    return "B" + box_name(story, box)[1:]


def events(story: Story) -> list[Event]:
    """What happened, in order of time; the last one is the end. Drops beyond ``MOST_DROPS`` are one event."""
    timeline = [*_placements(story), *_shaking(story), *_first_sign(story), *_drops(story)]
    timeline.sort(key=lambda event: event.time_s)
    end_s = max(story.outcome.sim_time_s, float(story.history.time_s[-1]))
    return [*timeline, Event(end_s, f"End: {_last_state(story)}")]


def _placements(story: Story) -> Iterator[Event]:
    history = story.history
    grown = np.flatnonzero(np.diff(history.n_placed, prepend=0) > 0)
    if not len(grown):
        return
    placed, first, last = int(history.n_placed[-1]), grown[0], grown[-1]
    rest = "" if placed == story.plan.n_boxes else f" of {story.plan.n_boxes}"
    if len(grown) == 1:
        yield Event(float(history.time_s[first]), f"{counted(placed, 'box', 'boxes')}{rest} placed at once")
        return
    yield Event(float(history.time_s[first]), f"{_subject(story, 0)} is placed, the first of {story.plan.n_boxes}")
    yield Event(float(history.time_s[last]), f"{_subject(story, placed - 1)} is placed, number {placed}{rest}")


def _shaking(story: Story) -> Iterator[Event]:
    if story.drive is None:
        return
    pushed = np.flatnonzero(np.abs(story.history.drive).max(axis=1) > 0)
    if len(pushed):
        excitation = story.drive.excitation
        quantity = "forces on the carrier" if excitation.kind == FORCE else "accelerations of the carrier"
        name = f"{shown(excitation.name)}, scale {story.drive.scale:g}, {math.degrees(story.drive.yaw_rad):.0f}°"
        yield Event(float(story.history.time_s[pushed[0]]), f"Shaking begins: {quantity} ({name})")
        yield Event(float(story.history.time_s[pushed[-1]]), "Shaking ends")


def _first_sign(story: Story) -> Iterator[Event]:
    if story.outcome.culprit >= 0 and math.isfinite(story.outcome.first_sign_s):
        yield Event(story.outcome.first_sign_s, first_box_in_words(story), is_first_sign=True)


def _drops(story: Story) -> Iterator[Event]:
    times = story.outcome.boxes.drop_s
    dropped = [int(box) for box in np.argsort(times, kind="stable") if np.isfinite(times[box])]
    for box in dropped[:MOST_DROPS]:
        yield Event(float(times[box]), f"{_subject(story, box)} has dropped")
    if len(dropped) > MOST_DROPS:
        yield Event(float(times[dropped[MOST_DROPS]]), f"{len(dropped) - MOST_DROPS} more have dropped from here on")


def _last_state(story: Story) -> str:
    outcome = story.outcome
    placed = slice(outcome.n_placed)
    moved = np.abs(outcome.boxes.shift_m[placed])
    largest = f"largest shift {MM_PER_M * np.nanmax(moved):.1f} mm" if np.isfinite(moved).any() else ""
    return ", ".join(part for part in (headline(story).partition(":")[0], largest) if part)
