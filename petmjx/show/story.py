"""One plan's story as text: what happened when, the first box to fail, the most pressed boxes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from petmjx.show.layout import FittedTable, TableColumn, line, number
from petmjx.story.tell import Story
from petmjx.story.words import first_box_in_words, how_it_was_simulated, notes_in_words, reason_in_words
from petmjx.text import counted, shown
from petmjx.verdict import Flag, Verdict
from petmjx.world.job import FORCE

MOST_DROPS: Final = 8
"""Most boxes whose drop has a line."""

MOST_PRESSED: Final = 5
"""How many of the most pressed boxes are shown."""

_STYLES: Final = {Verdict.STABLE: "bold green", Verdict.UNSTABLE: "bold red", Verdict.INVALID: "bold yellow"}


def headline(story: Story) -> str:
    """Verdict, reason, first box and when, in one line."""
    outcome = story.outcome
    text = outcome.verdict.value + (f" by {outcome.reason.value}" if outcome.reason else "")
    if outcome.verdict is Verdict.STABLE:
        text += ", still moving" if outcome.flags & Flag.MOVING else ""
        return text + ("" if math.isnan(outcome.margin) else f", margin {outcome.margin:.2f}")
    if outcome.culprit < 0:
        return text
    return f"{text}: first {box_name(story, outcome.culprit)}, at {outcome.first_sign_s:.2f} s"


def box_name(story: Story, box: int) -> str:
    """ "box 22 (candy-00100723)"; boxes count from 0 in packing order."""
    return f"box {box} ({shown(story.plan.articles[box])})"


def story_tables(story: Story) -> Iterator[RenderableType]:
    """Lines and tables that tell a story."""
    plan, outcome = story.plan, story.outcome
    yield Text.assemble(
        (f"plan {story.name}", "bold"),
        f", {counted(plan.n_boxes, 'box', 'boxes')}, {plan.mass_kg.sum():.1f} kg: ",
        (outcome.verdict.value, _STYLES[outcome.verdict]),
        f", {reason_in_words(story)}",
    )
    yield line(", ".join(f"{name} {value}" for name, value in how_it_was_simulated(story)), style="dim")
    for note in notes_in_words(story):
        yield line(f"note: {note}", style="yellow")
    yield ""
    yield _events_table(story)
    yield ""
    yield _boxes_table(story)


def _subject(story: Story, box: int) -> str:
    """The name of a box at the beginning of a sentence."""
    return "B" + box_name(story, box)[1:]


def events(story: Story) -> list[tuple[float, str, str]]:
    """What happened, in order of time: (time in s, what, style). Drops beyond ``MOST_DROPS`` are one event."""
    found = [*_placements(story), *_shaking(story), *_first_sign(story), *_drops(story)]
    found.sort(key=lambda event: event[0])
    end_s = max(story.outcome.sim_time_s, float(story.history.time_s[-1]))
    return [*found, (end_s, f"End: {_last_state(story)}", _STYLES[story.outcome.verdict])]


def _events_table(story: Story) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False, collapse_padding=True)
    table.add_column("at s", justify="right", no_wrap=True)
    table.add_column("what", overflow="fold")
    for time_s, what, style in events(story):
        table.add_row(f"{time_s:.2f}", line(what, style=style))
    return table


def _placements(story: Story) -> Iterator[tuple[float, str, str]]:
    history = story.history
    grown = np.flatnonzero(np.diff(history.n_placed, prepend=0) > 0)
    if not len(grown):
        return
    placed, first, last = int(history.n_placed[-1]), grown[0], grown[-1]
    rest = "" if placed == story.plan.n_boxes else f" of {story.plan.n_boxes}"
    if len(grown) == 1:
        yield float(history.time_s[first]), f"{counted(placed, 'box', 'boxes')}{rest} placed at once", ""
        return
    yield float(history.time_s[first]), f"{_subject(story, 0)} is placed, the first of {story.plan.n_boxes}", ""
    yield float(history.time_s[last]), f"{_subject(story, placed - 1)} is placed, number {placed}{rest}", ""


def _shaking(story: Story) -> Iterator[tuple[float, str, str]]:
    if story.drive is None:
        return
    pushed = np.flatnonzero(np.abs(story.history.drive).max(axis=1) > 0)
    if len(pushed):
        excitation = story.drive.excitation
        what = "forces on the carrier" if excitation.kind == FORCE else "accelerations of the carrier"
        name = f"{shown(excitation.name)}, scale {story.drive.scale:g}, {math.degrees(story.drive.yaw_rad):.0f}°"
        yield float(story.history.time_s[pushed[0]]), f"Shaking begins: {what} ({name})", ""
        yield float(story.history.time_s[pushed[-1]]), "Shaking ends", ""


def _first_sign(story: Story) -> Iterator[tuple[float, str, str]]:
    if story.outcome.culprit >= 0 and math.isfinite(story.outcome.first_sign_s):
        yield story.outcome.first_sign_s, first_box_in_words(story), "red"


def _drops(story: Story) -> Iterator[tuple[float, str, str]]:
    times = story.outcome.boxes.drop_s
    dropped = [int(box) for box in np.argsort(times, kind="stable") if np.isfinite(times[box])]
    for box in dropped[:MOST_DROPS]:
        yield float(times[box]), f"{_subject(story, box)} has dropped", ""
    if len(dropped) > MOST_DROPS:
        yield float(times[dropped[MOST_DROPS]]), f"{len(dropped) - MOST_DROPS} more have dropped from here on", ""


def _last_state(story: Story) -> str:
    outcome = story.outcome
    placed = slice(outcome.n_placed)
    moved = np.abs(outcome.boxes.shift_m[placed])
    largest = f"largest shift {number(np.nanmax(moved), '.1f', ' mm', 1000.0)}" if np.isfinite(moved).any() else ""
    return ", ".join(part for part in (headline(story).partition(":")[0], largest) if part)


def _boxes_table(story: Story) -> FittedTable:
    """The first box to fail and the most pressed ones, with their numbers."""
    boxes, plan = story.outcome.boxes, story.plan
    table = FittedTable(
        TableColumn("box"),
        TableColumn("article", "left", least=10, middle=True),
        TableColumn("", "left", spare=2),
        TableColumn("mass\nkg", spare=4),
        TableColumn("shift\nmm"),
        TableColumn("tilt\n°"),
        TableColumn("force on top\nlargest, N"),
        TableColumn("at rest\nN"),
        TableColumn("dropped\nat s", spare=1),
    )
    forces = np.nan_to_num(boxes.max_top_force_n[: story.outcome.n_placed])
    pressed = [int(box) for box in np.argsort(-forces, kind="stable")[:MOST_PRESSED]]
    first = [story.outcome.culprit] if story.outcome.culprit >= 0 else []
    for box in [*first, *(box for box in pressed if box not in first)]:
        table.add(
            str(box),
            plan.articles[box],
            "first to fail" if box in first else "most pressed",
            f"{plan.mass_kg[box]:.2f}",
            number(np.abs(boxes.shift_m[box]).max(), ".1f", factor=1000.0),
            number(boxes.max_tilt_deg[box], ".1f"),
            number(boxes.max_top_force_n[box], "z.1f"),
            number(boxes.rest_top_force_n[box], "z.1f"),
            number(boxes.drop_s[box], ".2f"),
        )
    return table


def how_to_draw() -> Text:
    """The options that draw a story."""
    return line("to see it: --html, --png, --pdf, --svg, --gif, --mp4 or --rrd FILE, or --viewer", style="dim")
