"""The style of figures for papers, and of their files. Text in a file is stored as text, and nothing depends on the
date."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

WIDTH_IN: Final = 6.3
"""Width of the text of a page (A4 with usual margins), inches."""

POINTS: Final = 8.0
"""Size of text, points."""

DOTS_PER_INCH: Final = 200

SETTINGS: Final[Any] = {
    "svg.fonttype": "none",  # letters are stored as text instead of outlines
    "svg.hashsalt": "petmjx",  # ids are the same each time
    "pdf.fonttype": 42,  # fonts are TrueType, which journals require
    "font.family": "DejaVu Sans",  # this font is part of matplotlib
    "text.parse_math": False,  # a $ in a name does not begin a formula
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


@contextmanager
def paper_style() -> Iterator[None]:
    """Within the body, set matplotlib's settings for all figures."""
    from matplotlib import rc_context

    with rc_context(SETTINGS), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)  # names may have characters that the font lacks
        yield


def write(figure: Any, path: Path, kind: str, dots_per_inch: float = DOTS_PER_INCH) -> None:
    """Write a figure as ``png``, ``pdf`` or ``svg``. The same figure always gives the same bytes."""
    figure.savefig(path, format=kind, dpi=dots_per_inch, metadata=_UNDATED.get(kind))


def wrapped_sentences(sentences: Sequence[str], width_in: float = WIDTH_IN) -> str:
    """Sentences wrapped into lines that fit below a figure. Each sentence begins a new line."""
    letters = int(width_in * 72 / (POINTS * 0.55))  # the width of a letter is about 0.55 of its size
    return "\n".join(line for sentence in sentences for line in textwrap.wrap(sentence, letters))
