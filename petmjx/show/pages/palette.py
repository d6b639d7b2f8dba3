"""Colours for pages and pictures that colour-blind people can distinguish, in sRGB, as ``#rrggbb``."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from petmjx.show.pages.html_page import static_text

Rgb = tuple[float, float, float]

OKABE_ITO: Final = ("#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7")
"""The colours of Okabe and Ito, "Color Universal Design", 2008, without black."""

_TONES: Final = (0.0, 0.45, -0.4)
"""Tones in which the colours are used, one after another: pure, lighter (mixed with white), and darker (mixed with
black)."""

RAMP_COLOURS: Final = 64

# The ramp (colours for values from small to large) is a path through the colour space OKLab, from dark blue through
# green to yellow (Ottosson, "A perceptual color space for image processing", 2020). Lightness grows evenly, so the
# order of values is visible even without hues.
_LIGHTNESS: Final = (0.36, 0.93)
_HUE_DEG: Final = (278.0, 103.0)
_CHROMA: Final = 0.15


def article_colours(articles: Sequence[str]) -> list[str]:
    """The colour of each box, given the article of each box. All boxes of an article have the same colour. The most
    frequent articles get pure colours."""
    counts = Counter(articles)
    ranked = sorted(counts, key=lambda article: (-counts[article], articles.index(article)))
    colours = {article: category(number) for number, article in enumerate(ranked)}
    return [colours[article] for article in articles]


def category(number: int) -> str:
    """The colour of category ``number``, from 0. After 21 categories, colours repeat."""
    hue, tone = OKABE_ITO[number % len(OKABE_ITO)], _TONES[number // len(OKABE_ITO) % len(_TONES)]
    towards = 1.0 if tone > 0 else 0.0
    red, green, blue = (part + abs(tone) * (towards - part) for part in rgb_of(hue))
    return hex_of((red, green, blue))


def ramp() -> list[str]:
    """``RAMP_COLOURS`` colours, for values from small to large."""
    return [_on_path(number / (RAMP_COLOURS - 1)) for number in range(RAMP_COLOURS)]


def rgb_of(colour: str) -> Rgb:
    """Red, green and blue, from 0 to 1, of a colour ``#rrggbb``."""
    red, green, blue = (int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5))
    return red, green, blue


def hex_of(rgb: Rgb) -> str:
    """The colour ``#rrggbb`` with the given red, green and blue, from 0 to 1."""
    return "#" + "".join(f"{round(255 * min(max(part, 0.0), 1.0)):02x}" for part in rgb)


def look() -> dict[str, Any]:
    """The appearance of boxes, walls and ground, read from ``petmjx/show/pages/static/appearance.js``."""
    _, _, json_text = static_text("appearance.js").partition("LOOK = ")
    appearance: dict[str, Any] = json.loads(json_text.rstrip().removesuffix(";"))
    return appearance


def _on_path(share: float) -> str:
    """The colour at a position on the ramp, from 0 to 1. The colour's chroma is reduced as far as sRGB requires."""
    lightness, hue = (low + share * (high - low) for low, high in (_LIGHTNESS, _HUE_DEG))
    chroma = _CHROMA
    while True:
        linear = _linear_of(lightness, chroma * math.cos(math.radians(hue)), chroma * math.sin(math.radians(hue)))
        if min(linear) >= 0.0 and max(linear) <= 1.0:
            red, green, blue = (_srgb_encoding(part) for part in linear)
            return hex_of((red, green, blue))
        chroma *= 0.98


def _linear_of(lightness: float, a: float, b: float) -> Rgb:
    """Linear sRGB of a colour in OKLab, with the matrices of Ottosson's definition."""
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    middle = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    return (
        4.0767416621 * long - 3.3077115913 * middle + 0.2309699292 * short,
        -1.2684380046 * long + 2.6097574011 * middle - 0.3413193965 * short,
        -0.0041960863 * long - 0.7034186147 * middle + 1.7076147010 * short,
    )


def _srgb_encoding(linear: float) -> float:
    """The sRGB value of a linear value: sRGB's transfer function (IEC 61966-2-1)."""
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055
