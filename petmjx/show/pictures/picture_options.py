"""Options for drawing pictures and films, for Python and the command line."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Any, Final

from pydantic import BeforeValidator, Field

from petmjx.common.checked_records import CheckedRecord, CliFlag, hint, shown_value, within
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.show.pictures.camera import VIEWS, view_of

START: Final = "start"
BEFORE: Final = "before"
FIRST_SIGN: Final = "first-sign"
END: Final = "end"
MOMENTS: Final = (START, BEFORE, FIRST_SIGN, END)
"""Names of moments: the first frame, the last placement before the first sign, the first sign (when a box first crosses
a threshold), and the last frame."""

LEAST_PX: Final = 64
MOST_PX: Final = 4096
"""Largest side of a picture, px. Many OpenGL drivers cannot draw larger pictures."""

STILL_SIZE: Final = (1200, 900)
PANEL_SIZE: Final = (675, 810)
GIF_SIZE: Final = (480, 480)
MP4_SIZE: Final = (960, 720)
"""Default sizes, px: of a single picture, of each picture in a row, of films in GIF, and of films in MP4."""

FILM_FPS: Final = 20.0

_USUAL_SIZES: Final = "{}x{}, in a row {}x{}, GIF {}x{}, MP4 {}x{}".format(
    *STILL_SIZE, *PANEL_SIZE, *GIF_SIZE, *MP4_SIZE
)


class Colour(StrEnum):
    """What the colours of boxes represent."""

    ARTICLE = "article"
    ORDER = "order"
    SHIFT = "shift"
    TILT = "tilt"
    FORCE = "force"
    PLANNED = "planned"


def moment_of(text: str) -> str | float:
    """The moment that a text states: a name in ``MOMENTS``, or a time, s.

    Raises:
        InputError: the text is neither a name nor a number.
    """
    name = text.strip()
    if name in MOMENTS:
        return name
    try:
        time_s = float(name)
    except ValueError:
        time_s = math.nan
    if not math.isfinite(time_s):
        raise InputError(f"unknown moment {printable_name(name)}; {hint(name, MOMENTS)} (or seconds, such as 2.5)")
    return time_s


def size_of(text: str) -> tuple[int, int]:
    """Width and height, px, from text such as "1200x900".

    Raises:
        ValueError: the text has another form, or the picture is too small or too large.
    """
    match = re.fullmatch(r"(\d{1,6})\s*[x×X]\s*(\d{1,6})", text.strip())
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (LEAST_PX <= width <= MOST_PX and LEAST_PX <= height <= MOST_PX):
        raise ValueError(f"must be WIDTHxHEIGHT with sides from {LEAST_PX} to {MOST_PX} pixels, {shown_value(text)}")
    return width, height


def _checked_by(read: Callable[[str], Any]) -> BeforeValidator:
    """A validator that accepts text if ``read`` accepts the text. If ``read`` raises an error, the field has this
    error."""

    def check(value: Any) -> Any:
        if value is None:
            return None
        text = _text(value)
        try:
            read(text)
        except InputError as error:
            raise ValueError(f": {error}") from None
        return text

    return BeforeValidator(check)


def _text(value: Any) -> str:
    """A Python value as text in the form of the command line: (1200, 900) becomes "1200x900", and ["start", 2.5]
    becomes "start,2.5"."""
    if isinstance(value, list | tuple):
        between = "," if isinstance(value, list) else "x"
        return between.join(str(part) for part in value)
    return str(value)


def _moments(text: str) -> None:
    for part in text.split(","):
        moment_of(part)


class PictureOptions(CheckedRecord):
    """How pictures and films of a story are drawn."""

    at: Annotated[
        str | None,
        _checked_by(_moments),
        CliFlag("--at", "TIMES", default="before,first-sign,end if a box fails; else end"),
    ] = Field(
        None,
        description="moments that pictures show, separated by commas: times in seconds, or 'start', 'before' "
        "(the last placement before the first sign), 'first-sign', 'end'; several moments give a row of pictures",
    )
    view: Annotated[str, _checked_by(view_of), CliFlag("--view")] = Field(
        "iso",
        description=f"where the pallet is seen from: {', '.join(VIEWS)}, or AZIMUTH/ELEVATION in degrees: 0/0 is in "
        "front, 90/0 is on the right",
    )
    size: Annotated[str | None, _checked_by(size_of), CliFlag("--size", "WxH", default=_USUAL_SIZES)] = Field(
        None,
        description="width and height of a film, or of each picture, in pixels",
    )
    colour: Annotated[Colour, CliFlag("--colour")] = Field(
        Colour.ARTICLE,
        description="what colours show: article, order, shift, tilt, force (on top), planned (where boxes should be)",
    )
    arrows: Annotated[bool, CliFlag("--arrows")] = Field(
        False, description="draw contact forces as arrows, in transparent boxes; needs the engine mujoco"
    )
    speed: Annotated[
        float | None,
        within(0.01, 1000),
        CliFlag("--speed", "X", default="1, or more if a film would otherwise last longer than 20 s"),
    ] = Field(
        None,
        description="speed of films, as a multiple of real time",
    )
    fps: Annotated[float, within(1, 50), CliFlag("--fps", "N")] = Field(
        FILM_FPS, description="frames per second of films"
    )
