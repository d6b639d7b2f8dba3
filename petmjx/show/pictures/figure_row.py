"""A row of pictures as a figure for a paper, in PNG, PDF or SVG. In PDF and SVG, labels are text and outlines are
vectors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.analysis.story import Story
from petmjx.analysis.story_in_words import headline
from petmjx.common.text import printable, printable_name
from petmjx.show.figures.figure_style import new_figure, paper_style, write
from petmjx.show.pictures.box_colours import FIRST, Colouring, Scale, ramp_colours
from petmjx.show.pictures.camera import Camera, Margins
from petmjx.show.pictures.draw_story import PictureStyle
from petmjx.show.pictures.overlay import first_outline, scale_ends, state_in_words
from petmjx.show.pictures.still_pictures import draw_frames, frame_camera
from petmjx.show.pictures.story_poses import Moment, poses_of_frame

PANEL_IN: Final = 2.25
"""Width of one picture, inches. Three pictures are as wide as the text of a page."""

_MARGINS: Final = Margins(0.03, 0.03, 0.07, 0.03)
_POINTS: Final = 8.0
"""Size of text, points."""
_HEAD_IN: Final = 0.36
_TITLE_IN: Final = 0.3
_FOOT_IN: Final = 0.42


def write_figure(look: PictureStyle, moments: list[Moment], path: Path, kind: str) -> None:
    """Write a row with one picture for each moment, all from the same camera.

    Args:
        look: style of the pictures. ``look.size`` is the size of a single picture, px.
        moments: the moments of the story that are shown.
        kind: format of the file: ``png``, ``pdf`` or ``svg``.
    """
    story, frames = look.story, [moment.frame for moment in moments]
    camera = frame_camera(look, frames, _MARGINS)
    panel_height = PANEL_IN * look.size[1] / look.size[0]
    width, height = PANEL_IN * len(moments), _HEAD_IN + _TITLE_IN + panel_height + _FOOT_IN
    with paper_style():
        figure = new_figure(width, height, layout=None)
        _head(figure, story, width, height)
        for number, (image, moment) in enumerate(zip(draw_frames(look, frames, camera), moments, strict=True)):
            place = (number / len(moments), _FOOT_IN / height, 1 / len(moments), panel_height / height)
            letter = f"({chr(ord('a') + number % 26)}) " if len(moments) > 1 else ""
            _panel(figure.add_axes(place), np.asarray(image), story, moment, camera, letter)
        _foot(figure, look, width, height)
        write(figure, path, kind, dots_per_inch=look.size[0] / PANEL_IN)


def _head(figure: Any, story: Story, width: float, height: float) -> None:
    top = 1 - 0.06 / height
    left = 0.04 / width
    name = figure.text(left, top, story.name, size=_POINTS + 1, weight="bold", va="top")
    line = printable(headline(story))
    colour = FIRST if story.outcome.culprit >= 0 else "0.35"
    below = figure.text(left, top - 0.17 / height, line, size=_POINTS, color=colour, va="top")
    for text in (name, below):
        text.set_parse_math(False)  # otherwise, a $ in an id would begin a formula
    room = width - 0.08
    wide = len(line) * _POINTS * 0.55 / 72
    below.set_size(max(4.0, _POINTS * min(1.0, room / wide)))


def _panel(axes: Any, pixels: Any, story: Story, moment: Moment, camera: Camera, letter: str) -> None:
    """Draw one picture with a title above, and with an outline around the first box to fail."""
    poses = poses_of_frame(story.history, moment.frame)
    axes.imshow(pixels, interpolation="none", extent=(0, camera.width, camera.height, 0))
    axes.set_axis_off()
    name = f"{moment.name.replace('-', ' ')}, " if moment.name else ""
    title = f"{letter}{name}{poses.time_s:.2f} s\n{state_in_words(story, poses)}"
    axes.set_title(title, size=_POINTS, loc="center", pad=2, linespacing=1.1)
    outline = first_outline(story, poses, camera)
    if outline is not None:
        axes.add_patch(_polygon(outline))
        top = outline[outline[:, 1].argmin()]
        text = f"box {story.outcome.culprit}"
        spot = (min(max(top[0], 0.1 * camera.width), 0.9 * camera.width), max(top[1] - 0.02 * camera.height, 0))
        behind = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.6}
        axes.text(*spot, text, color=FIRST, size=_POINTS - 1, ha="center", va="bottom", bbox=behind)
    axes.set_xlim(0, camera.width)
    axes.set_ylim(camera.height, 0)


def _polygon(outline: Any) -> Any:
    from matplotlib.patches import Polygon

    return Polygon(outline, closed=True, fill=False, edgecolor=FIRST, linewidth=1.3, joinstyle="round")


def _foot(figure: Any, look: PictureStyle, width: float, height: float) -> None:
    """Draw the legend below the pictures: a colour bar, or names with their colours; and a line about arrows."""
    colours = look.colours
    row = 0.24 / height
    if colours.scale is not None:
        _bar(figure, colours.scale, width, height)
    elif colours.names:
        _names(figure, colours, row)
    else:
        figure.text(0.5, row, colours.note, size=_POINTS, color="0.35", ha="center", va="center")
    if look.arrows:
        figure.text(0.5, 0.07 / height, look.arrows, size=_POINTS - 1, color="0.35", ha="center", va="center")


def _bar(figure: Any, scale: Scale, width: float, height: float) -> None:
    axes = figure.add_axes((0.5 - 0.75 / width, 0.19 / height, 1.5 / width, 0.1 / height))
    axes.imshow(ramp_colours(np.linspace(0, 1, 256))[None], aspect="auto", extent=(0, 1, 0, 1))
    axes.set_axis_off()
    low, high = scale_ends(scale)
    axes.text(-0.03, 0.5, low, size=_POINTS, ha="right", va="center", transform=axes.transAxes)
    axes.text(1.03, 0.5, f"{high}\u2003{scale.label}", size=_POINTS, va="center", transform=axes.transAxes)


def _names(figure: Any, colours: Colouring, row: float) -> None:
    from matplotlib.patches import Patch

    names = colours.names
    if colours.outlined:
        marks = [Patch(facecolor="white", edgecolor=rgb, linewidth=1.2) for _, rgb in names]
    else:
        marks = [Patch(facecolor=rgb, edgecolor="0.1", linewidth=0.5) for _, rgb in names]
    labels = [printable_name(name) for name, _ in names]
    widest = sum(len(label) + 5 for label in labels) * _POINTS * 0.6 / 72
    columns = max(1, math.floor(len(names) * min(1.0, figure.get_figwidth() / widest)))
    legend = figure.legend(
        marks, labels, loc="center", bbox_to_anchor=(0.5, row), ncols=columns, frameon=False,
        fontsize=_POINTS - (1 if columns < len(names) else 0), handlelength=1.0, columnspacing=1.2, borderpad=0,
    )  # fmt: skip
    for text in legend.get_texts():
        text.set_parse_math(False)
