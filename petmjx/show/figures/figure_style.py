"""The style of figures for papers, and of their files. Text is stored as text, not as outlines. Files do not contain
the date."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.show.pages.palette import OKABE_ITO

WIDTH_IN: Final = 6.3
"""Width of the text on a page (A4 with usual margins), inches."""

POINTS: Final = 8.0
"""Size of text, points."""

DOTS_PER_INCH: Final = 200

COLOUR: Final = OKABE_ITO[4]
"""Colour of dots and lines."""

SETTINGS: Final[Any] = {
    "svg.fonttype": "none",  # Letters are stored as text, not as outlines.
    "svg.hashsalt": "petmjx",  # With a fixed salt, ids in SVG files are always the same.
    "pdf.fonttype": 42,  # Type 42 is TrueType, which journals require.
    "font.family": "DejaVu Sans",  # The font DejaVu Sans comes with matplotlib.
    "text.parse_math": False,  # Otherwise, a $ in a name would begin a formula.
    "font.size": POINTS,
    "axes.titlesize": POINTS,
    "axes.labelsize": POINTS,
    "xtick.labelsize": POINTS,
    "ytick.labelsize": POINTS,
    "legend.fontsize": POINTS,
    "axes.spines.top": False,
    "axes.spines.right": False,
}

_UNDATED: Final[dict[str, dict[str, Any]]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def kind_of(path: Path, kinds: Sequence[str]) -> str:
    """The kind of a file, which its suffix determines.

    Raises:
        InputError: the suffix is not one of ``kinds``.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in kinds:
        raise InputError(f"{printable(str(path))}: unknown ending; there are {', '.join(f'.{one}' for one in kinds)}")
    return kind


@contextmanager
def paper_style() -> Iterator[None]:
    """A context in which matplotlib has the settings of figures for papers."""
    from matplotlib import rc_context

    with rc_context(SETTINGS), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)  # Matplotlib warns of characters that the font lacks
        yield


def new_figure(width_in: float, height_in: float, layout: Any = "constrained") -> Any:
    """An empty figure of matplotlib, which belongs to no window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), facecolor="white", layout=layout)


def write(figure: Any, path: Path, kind: str, dots_per_inch: float = DOTS_PER_INCH) -> None:
    """Write a figure as ``png``, ``pdf`` or ``svg``. The same figure always gives the same bytes."""
    figure.savefig(path, format=kind, dpi=dots_per_inch, metadata=_UNDATED.get(kind))


def draw_intervals(axes: Any, names: Sequence[str], values: ArrayLike, low: ArrayLike, high: ArrayLike) -> None:
    """Draw a row for each name, from the top downwards: a dot at its value, and a line from ``low`` to ``high``. NaN is
    not drawn."""
    for row, (value, begin, end) in enumerate(np.stack((values, low, high), axis=1).tolist()):
        axes.plot([begin, end], [row, row], color=COLOUR, linewidth=1.4, solid_capstyle="butt")
        axes.plot(value, row, "o", color=COLOUR, markersize=4)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def wrapped_sentences(sentences: Sequence[str]) -> str:
    """Sentences, wrapped into lines that fit below a figure. Each sentence begins a new line."""
    letters = int(WIDTH_IN * 72 / (POINTS * 0.55))  # a letter's width is about 0.55 of the size of text
    return "\n".join(line for sentence in sentences for line in textwrap.wrap(sentence, letters))
