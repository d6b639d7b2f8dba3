"""A story (the simulation of one plan) as text: its events, the first box to fail, and the boxes with the largest
forces on top."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from petmjx.analysis.story import Story
from petmjx.analysis.story_in_words import events, how_it_was_simulated, notes_in_words, reason_in_words
from petmjx.common.text import count_text
from petmjx.show.table_layout import VERDICT_STYLES, FittedTable, TableColumn, line, note_lines, number

MOST_PRESSED: Final = 5
"""Number of boxes with the largest forces on top that are shown."""


def story_tables(story: Story) -> Iterator[RenderableType]:
    """Lines and tables that tell a story."""
    plan, outcome = story.plan, story.outcome
    yield Text.assemble(
        (f"plan {story.name}", "bold"),
        f", {count_text(plan.n_boxes, 'box', 'boxes')}, {plan.mass_kg.sum():.1f} kg: ",
        (outcome.verdict.value, _style(story)),
        f", {reason_in_words(story)}",
    )
    yield line(", ".join(f"{name} {value}" for name, value in how_it_was_simulated(story)), style="dim")
    yield from note_lines(notes_in_words(story))
    yield ""
    yield _events_table(story)
    yield ""
    yield _boxes_table(story)


def _style(story: Story) -> str:
    return f"bold {VERDICT_STYLES[story.outcome.verdict]}"


def _events_table(story: Story) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False, collapse_padding=True)
    table.add_column("at s", justify="right", no_wrap=True)
    table.add_column("what", overflow="fold")
    *before, end = events(story)
    for event in before:
        table.add_row(f"{event.time_s:.2f}", line(event.what, style="red" if event.is_first_sign else ""))
    table.add_row(f"{end.time_s:.2f}", line(end.what, style=_style(story)))
    return table


def _boxes_table(story: Story) -> FittedTable:
    """A table with the mass, motion and forces of two kinds of boxes: the first box to fail, and the boxes with the
    largest forces on top."""
    boxes, plan, culprit = story.outcome.boxes, story.plan, story.outcome.culprit
    forces = np.nan_to_num(boxes.max_top_force_n[: story.outcome.n_placed])
    pressed = np.argsort(-forces, kind="stable")[:MOST_PRESSED].tolist()
    role = {box: "most pressed" if forces[box] > 0 else "" for box in pressed} | {culprit: "first to fail"}
    return FittedTable(
        dict.fromkeys([*([culprit] if culprit >= 0 else []), *pressed]),
        TableColumn("box", str),
        TableColumn("article", lambda box: plan.articles[box] or "-", "left", least=10, middle=True),
        TableColumn("", role.__getitem__, "left", spare=2),
        TableColumn("mass\nkg", lambda box: f"{plan.mass_kg[box]:.2f}", spare=4),
        TableColumn("shift\nmm", lambda box: number(np.abs(boxes.shift_m[box]).max(), ".1f", factor=1000.0)),
        TableColumn("tilt\n°", lambda box: number(boxes.max_tilt_deg[box], ".1f")),
        TableColumn("force on top\nlargest, N", lambda box: number(boxes.max_top_force_n[box], "z.1f")),
        TableColumn("at rest\nN", lambda box: number(boxes.rest_top_force_n[box], "z.1f")),
        TableColumn("dropped\nat s", lambda box: number(boxes.drop_s[box], ".2f"), spare=1),
    )
