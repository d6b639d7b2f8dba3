"""The colours of boxes and their meaning. Pages use the same colours (``petmjx.show.pages.palette``)."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.story import Story, thresholds_of
from petmjx.common.text import UNNAMED, count_text, next_round_number
from petmjx.common.units import FloatArray
from petmjx.show.pages.palette import RAMP_COLOURS, Rgb, article_colours, ramp, rgb_of
from petmjx.show.pictures.picture_options import Colour
from petmjx.show.pictures.story_poses import Poses, shift_mm, tilts_deg

FIRST: Final[Rgb] = (0.80, 0.0, 0.0)
"""Colour of the outline of the first box to fail."""
GHOST: Final[Rgb] = (0.0, 0.28, 0.55)
"""Colour of the edges of boxes at their planned places."""
CARRIER: Final[Rgb] = (0.70, 0.64, 0.56)
CARTON: Final[Rgb] = (0.86, 0.74, 0.56)

_DARKEST: Final = 0.15
"""Position on the ramp of colours, from 0 to 1, at which scales begin. On darker colours, black edges are hardly
visible."""

MOST_NAMED: Final = 7
"""Largest number of articles that a legend names."""


@dataclass(frozen=True)
class Scale:
    """The meaning of colours that represent values from ``low`` (dark) to ``high`` (bright).

    If ``open_end`` is True, values larger than ``high`` can occur, and have the same colour as ``high``.
    """

    label: str
    low: float
    high: float
    open_end: bool


@dataclass(frozen=True, eq=False)
class Colouring:
    """The colours of the boxes in pictures of one simulated world.

    Attributes:
        story: the world (``petmjx.analysis.story.Story``).
        colour: what the colours represent.
        scale: the meaning of the colours if they represent values, else None.
        names: (name, colour) pairs if the colours represent names.
        note: text of the legend if there are too many names.
    """

    story: Story
    colour: Colour
    scale: Scale | None = None
    names: tuple[tuple[str, Rgb], ...] = ()
    note: str = ""

    @property
    def outlined(self) -> bool:
        """Whether the colours in ``names`` are colours of edges, not of boxes."""
        return self.colour is Colour.PLANNED

    def of(self, poses: Poses) -> NDArray[np.float64]:
        """(k, 3) colour of each placed box: red, green and blue, from 0 to 1."""
        if self.colour is Colour.PLANNED:
            return np.tile(np.array(CARTON), (poses.n_placed, 1))
        if self.scale is None:
            colours = article_colours(self.story.plan.articles)[: poses.n_placed]
            return np.array([rgb_of(colour) for colour in colours]).reshape(-1, 3)
        return ramp_colours((self._values(poses) - self.scale.low) / (self.scale.high - self.scale.low))

    def _values(self, poses: Poses) -> FloatArray:
        if self.colour is Colour.SHIFT:
            return shift_mm(self.story, poses)
        if self.colour is Colour.TILT:
            return tilts_deg(poses)
        if self.colour is Colour.FORCE:
            return np.nan_to_num(self.story.history.top_force_n[poses.frame, : poses.n_placed])
        return np.arange(poses.n_placed, dtype=np.float64)


def colouring(story: Story, colour: Colour) -> Colouring:
    """The colours of a story's boxes. If colours represent values, the scale is the same for all frames of the
    story."""
    if colour is Colour.ARTICLE:
        colours = article_colours(story.plan.articles)
        shades = {name or UNNAMED: rgb_of(shade) for name, shade in zip(story.plan.articles, colours, strict=True)}
        if len(shades) <= MOST_NAMED:
            return Colouring(story, colour, names=tuple(shades.items()))
        return Colouring(
            story, colour, note=f"a colour for each of {count_text(len(shades.keys() - {UNNAMED}), 'article')}"
        )
    if colour is Colour.PLANNED:
        return Colouring(story, colour, names=(("as planned", GHOST),))
    return Colouring(story, colour, _scale(story, colour))


def _scale(story: Story, colour: Colour) -> Scale:
    limits = thresholds_of(story)
    if colour is Colour.SHIFT:
        return Scale("shift, mm", 0.0, 2000 * limits.shift_m, True)
    if colour is Colour.TILT:
        return Scale("tilt, °", 0.0, 2 * limits.tilt_deg, True)
    if colour is Colour.FORCE:
        steps = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
        return Scale("force on top, N", 0.0, next_round_number(_usual_force(story), steps), True)
    return Scale("order of placement", 0.0, float(max(story.plan.n_boxes - 1, 1)), False)


def _usual_force(story: Story) -> float:
    """Force for the upper end of a scale, N: the largest force at rest, or the 98 % quantile of all forces in the
    frames, whichever is larger. The quantile leaves out the forces of impacts, which last less than a frame."""
    forces = story.history.top_force_n[np.isfinite(story.history.top_force_n)]
    rest_force_n = story.outcome.boxes.rest_top_force_n
    usual = float(np.quantile(forces, 0.98)) if len(forces) else 0.0
    return max(usual, float(np.nanmax(rest_force_n)) if np.isfinite(rest_force_n).any() else 0.0, 1.0)


def ramp_colours(shares: FloatArray) -> NDArray[np.float64]:
    """(k, 3) colours, from dark to bright, for (k,) numbers from 0 to 1. Numbers below 0 get the first colour, and
    numbers above 1 the last."""
    last = RAMP_COLOURS - 1
    places = _DARKEST + (1 - _DARKEST) * np.clip(np.nan_to_num(shares, nan=1.0), 0.0, 1.0)
    return np.asarray(_ramp()[np.round(places * last).astype(np.intp)])


@functools.cache
def _ramp() -> NDArray[np.float64]:
    return np.array([rgb_of(colour) for colour in ramp()])
