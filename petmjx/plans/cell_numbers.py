"""Reads cells of other tools' tables. A cell may have a number, with any decimal sign, with marks between thousands,
and with a unit. A cell may also have three numbers, two corners, or a name."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import date, datetime, time, timedelta
from decimal import Decimal
from typing import Any, Final, NamedTuple

import numpy as np

from petmjx.common.text import printable_name
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS, plain_text
from petmjx.plans.file_formats import number_hint
from petmjx.plans.plan_fields import LARGEST_MM

GROUPED: Final = "grouped"
"""This value takes the place of a decimal sign if no number has decimals, so that points and commas only separate
thousands."""

YES_WORDS: Final = frozenset(("true", "yes", "ja", "oui", "si", "sí", "tak", "sim", "y", "j", "1"))
NO_WORDS: Final = frozenset(("false", "no", "nein", "non", "nie", "nee", "não", "nao", "n", "0"))
"""Texts, in lower case, that mean yes and no in a cell."""


class CellNumber(NamedTuple):
    """A number in a cell, and the unit after it ("" if there is none)."""

    value: float
    unit: str


_DECIMAL_REPR: Final = re.compile(r"""^Decimal\(\s*['"]?([^'"]*)['"]?\s*\)$""")
_WITH_UNIT: Final = re.compile(r"^([+-]?[\d.,' \u00a0\u202f\u2019]*\d(?:[eE][+-]?\d+)?)\s*([a-zA-Zµ\"″]{1,12})\.?$")
_PLAIN: Final = re.compile(r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
_GROUPS: Final = re.compile(r"^[+-]?\d{1,3}([.,' \u00a0\u202f\u2019])\d{3}(?:\1\d{3})*(?:([.,])\d+)?$")
_FRACTION: Final = re.compile(
    r"^([+-]?)(?:(\d{1,4})[ -])?(\d{1,2})/(2|4|8|16|32|64)\s*(\"|″|in\.?|inch|inches)?$", re.IGNORECASE
)
"""A length in inches and fractions of an inch, as on a tape measure: "23 5/8", "3/4"."""
_FEET: Final = re.compile(
    r"^([+-]?)(\d{1,3})\s*(?:['′’]|ft\.?)\s*-?\s*"
    r"(?:(?:(\d{1,2}(?:\.\d+)?)(?!/))?(?:\s*-?\s*(\d{1,2})/(2|4|8|16|32|64))?\s*(?:[\"″”]|in\.?))?$",
    re.IGNORECASE,
)
"""A length in feet and inches: 1'-9 3/16\", 2' 3\", 5 ft."""
_LONGEST_NUMBER: Final = 60


def cell_number(cell: Any, decimal: str = ".") -> CellNumber | None:
    """The number in a cell; None if there is none. NaN and infinite values also count as numbers.

    Args:
        decimal: the decimal sign of numbers stored as text; "": unknown. With ",", a point may only stand between
            thousands, and only if there is also a decimal comma: "1.234,5".
    """
    if isinstance(cell, bool) or cell is None:
        return None
    if isinstance(cell, int | float | Decimal | np.number):
        try:
            return CellNumber(float(cell), "")
        except OverflowError:
            return CellNumber(float("inf"), "")
    if not isinstance(cell, str) or len(cell) > _LONGEST_NUMBER:
        return None
    text = cell.strip()
    if "/" in text and (fraction := _FRACTION.match(text)) is not None:
        value = int(fraction[2] or 0) + int(fraction[3]) / int(fraction[4])
        return CellNumber(-value if fraction[1] == "-" else value, "in" if fraction[5] else "")
    if ("'" in text or "′" in text or "’" in text or "f" in text) and (feet := _FEET.match(text)) is not None:
        value = 12 * int(feet[2]) + float(feet[3] or 0) + (int(feet[4]) / int(feet[5]) if feet[4] else 0.0)
        return CellNumber(-value if feet[1] == "-" else value, "in")
    if (wrapped := _DECIMAL_REPR.match(text)) is not None:
        text, decimal = wrapped[1].strip(), "."
    unit = ""
    if (match := _WITH_UNIT.match(text)) is not None:
        word = {'"': "in", "″": "in"}.get(match[2], plain_text(match[2]).lower())
        if word not in LENGTH_UNITS and word not in MASS_UNITS:
            return None
        text, unit = match[1].strip(), word
    if not text.isascii():
        text = text.replace("\u2212", "-").replace("\u00a0", " ").replace("\u202f", " ").replace("\u2019", "'")
    if decimal == GROUPED:
        text, decimal = (text.replace(",", "").replace(".", ""), ".") if _GROUPS.match(text) else (text, "")
    groups = _GROUPS.match(text)
    if groups is not None and groups[1] != decimal and (groups[1] not in ".," or groups[2] == decimal):
        text = text.replace(groups[1], "")
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    elif not decimal and _MAYBE.match(text):
        return None
    if not _PLAIN.match(text):
        return CellNumber(float(text), unit) if text.lower() in ("nan", "inf", "-inf", "infinity") else None
    return CellNumber(float(text), unit)


def is_number(cell: Any) -> bool:
    """Whether a cell has a number, with a decimal point or a decimal comma."""
    return cell_number(cell) is not None or cell_number(cell, ",") is not None


def _by_decimal_sign(pattern: str) -> dict[str, re.Pattern[str]]:
    """Decimal sign → a pattern in which D stands for this sign, and T for the other sign, between thousands."""
    return {
        sign: re.compile(pattern.replace("D", re.escape(sign)).replace("T", re.escape(other)))
        for sign, other in ((",", "."), (".", ","))
    }


_GROUPS_AND_DECIMALS: Final = _by_decimal_sign(r"^[+-]?\d{1,3}(T\d{3})+D\d+$")
"""Numbers with groups of thousands and decimals: "1.234,5" for ","."""
_ONLY_GROUPS: Final = _by_decimal_sign(r"^[+-]?\d{1,3}(T\d{3})+$")
_SURE: Final = _by_decimal_sign(
    r"^[+-]?(\d{1,3}(T\d{3})+D\d+|0D\d+|D\d+|\d+D(\d{1,2}|\d{4,})|\d{4,}D\d+)(\s*[a-zA-Z]+)?$"
)
"""Numbers that certainly have this decimal sign."""


def has_groups_with_decimals(rows: Sequence[Sequence[Any]], decimal: str) -> bool:
    """Whether a number of a table has decimals, and marks between its thousands: "1.234,5". In a table with such
    numbers, "1.200" means 1200 everywhere."""
    pattern = _GROUPS_AND_DECIMALS.get(decimal)
    return pattern is not None and any(isinstance(cell, str) and pattern.match(cell) for row in rows for cell in row)


_LEAST_GROUPED: Final = 3


def are_grouped(cells: Sequence[Any], decimal: str) -> bool:
    """Whether the points in a column separate thousands. They do if the decimal sign of the file is a comma, at least
    three numbers of the column are like "1.200", and no text of the column has a comma."""
    texts = [cell for cell in cells if isinstance(cell, str)]
    grouped = [text for text in texts if _ONLY_GROUPS[","].match(text)]
    return decimal == "," and len(grouped) >= _LEAST_GROUPED and not any("," in text for text in texts)


def without_groups(cell: Any, decimal: str) -> Any:
    """A cell without the marks between its thousands: "1.200" → "1200". A cell that is not a number without decimals is
    returned unchanged."""
    is_grouped = isinstance(cell, str) and _ONLY_GROUPS[decimal].match(cell)
    return re.sub(r"[.,]", "", cell) if is_grouped else cell


_KINDS: Final[dict[type, str]] = {
    dict: "an object", list: "a list", tuple: "a list", bool: "true or false", datetime: "a date", date: "a date",
    time: "a time", timedelta: "a duration",
}  # fmt: skip
"""Type of a cell that has no number → its kind, in words."""


def number_fault_of(cell: Any, decimal: str) -> str:
    """The end of a message about a cell that should have a number: the fault of the cell, and advice."""
    if cell is None or cell == "":
        return "is missing"
    if not isinstance(cell, str):
        kind = next((words for kind, words in _KINDS.items() if isinstance(cell, kind)), type(cell).__name__)
        return f"must be a number, got {kind}"
    hint = number_hint(cell)
    if not hint and not decimal and _MAYBE.match(cell):
        hint = f": write {cell.replace('.', '')} or {cell.replace('.', ',')}, whichever is meant"
    if not hint and decimal == "," and "." in cell:
        hint = ": other numbers of this file have decimal commas"
    return f'must be a number, got "{printable_name(cell)}"{hint}'


def cell_text(cell: Any) -> str:
    """A cell as a name: text without surrounding white space, and whole numbers without a point; "" for an empty
    cell."""
    if cell is None:
        return ""
    if isinstance(cell, float) and cell.is_integer() and abs(cell) < 2**53:
        return str(int(cell))
    return str(cell).strip()


_TRIPLE_LETTER: Final = re.compile(r"""["']?\b([xyzlwhdbt])\b["']?\s*[=:]\s*""", re.IGNORECASE)
_USUAL_ORDER: Final = {"".join(sorted(letters)): letters for letters in ("xyz", "lwh", "lbh")}
"""Letters before three numbers in one cell ("H=200 L=400 B=300"), in alphabetical order → the letters in the order in
which the numbers are returned."""


def cell_triple(cell: Any, decimal: str = ".") -> list[CellNumber] | None:
    """The three numbers in a cell: "400x300x200", "(0, 0, 200)", "[Decimal('600.0'), 0, 0]"; None if there are none."""
    if isinstance(cell, list | tuple | np.ndarray):
        numbers = [cell_number(value) for value in cell]
        return [number for number in numbers if number is not None] if len(numbers) == 3 and all(numbers) else None
    if not isinstance(cell, str) or len(cell) > 200:
        return None
    text = re.sub(r"Decimal\(\s*['\"]?([^'\")]*)['\"]?\s*\)", r"\1", cell).strip().strip("[](){}<>")
    unit = ""
    if (last := re.search(r"\s*([a-zA-Z]{1,6})$", text)) is not None and last[1].lower() in LENGTH_UNITS:
        text, unit = text[: last.start()], last[1].lower()
    letters = "".join(_TRIPLE_LETTER.findall(text)).lower()
    text = _TRIPLE_LETTER.sub(" ", text)
    for separator in (r"[x×X*]", r"[;|/]", r",\s+" if decimal == "," else r",", r"\s+"):
        parts = [part for part in re.split(rf"\s*{separator}\s*", text.strip()) if part]
        if len(parts) == 3:
            numbers = [cell_number(part, decimal) for part in parts]
            if all(number is not None for number in numbers):
                triple = [CellNumber(number.value, number.unit or unit) for number in numbers if number is not None]
                usual = _USUAL_ORDER.get("".join(sorted(letters)), letters)
                return [triple[letters.index(letter)] for letter in usual] if len(set(letters)) == 3 else triple
    return None


_BRACKETED: Final = re.compile(r"[(\[{]([^()\[\]{}]{1,100})[)\]}]")


def cell_corners(cell: Any, decimal: str = ".") -> tuple[list[CellNumber], list[CellNumber]] | None:
    """The coordinates of two corners in a cell, "(0, 0, 0), (400, 300, 200)" or "0 0 0 400 300 200"; None if there are
    none."""
    texts = _BRACKETED.findall(cell) if isinstance(cell, str) and len(cell) < 300 else []
    if isinstance(cell, str) and len(texts) < 2 and len(parts := re.findall(r"[^\s,;()\[\]{}]+", cell[:300])) == 6:
        texts = [" ".join(parts[:3]), " ".join(parts[3:])]
    triples = [triple for text in texts if (triple := cell_triple(text, decimal)) is not None]
    return (triples[0], triples[1]) if len(texts) == len(triples) == 2 else None


_MAYBE: Final = re.compile(r"^[+-]?\d{1,3}([.,])\d{3}$")


_WITH_THREE: Final = re.compile(r"^[+-]?[1-9]\d{0,2}\.\d{3}(\s*[a-zA-Z]+)?$")
_LEAST_LIKELY_MM: Final = 10.0
"""Smallest plausible size of a box that is given in millimetres with three decimals. Letters and flat cartons are
thicker."""


def _with_three_digits(cells: Sequence[Any], decimal: str) -> dict[int, str]:
    """Row → text, for the numbers of a column that have a point, such as "1.200". The result is empty unless all points
    of the column are followed by three digits, so that they may separate thousands."""
    texts = {row: cell.strip() for row, cell in enumerate(cells) if isinstance(cell, str) and "." in cell}
    return texts if decimal == "." and all(map(_WITH_THREE.match, texts.values())) else {}


def grams_with_points(cells: Sequence[Any], decimal: str, unit: str) -> dict[int, str]:
    """Row → text, for the numbers with a point in a column of grams: "9.500" could mean 9500. The result is empty if
    the points cannot separate thousands, or if a number is not in grams.

    Args:
        unit: unit of numbers that have no unit in their cell.
    """
    texts = _with_three_digits(cells, decimal)
    units = {(number.unit if number is not None else "") or unit for number in map(cell_number, texts.values())}
    return texts if all(MASS_UNITS.get(name) == MASS_UNITS["g"] for name in units) else {}


def thousands_faults(cells: Sequence[Any], decimal: str, unit: str, are_sizes: bool) -> dict[int, str]:
    """Row → fault, for numbers such as "1.200" that could mean 1200, in a column of lengths with decimal points.

    "1.200" could mean 1200 if three conditions hold. First, all points of the column are followed by three digits.
    Second, no number would be too large if it were a thousand times larger. Third, the column also has numbers without
    a point, or boxes would be thinner than real boxes if "1.200" were read as 1.2.

    Args:
        unit: unit of numbers that have no unit in their cell.
        are_sizes: whether the lengths are sizes of boxes.
    """
    texts = {row: cell.strip() for row, cell in enumerate(cells) if isinstance(cell, str)}
    pointed = _with_three_digits(cells, decimal)
    if not pointed:
        return {}
    numbers = {row: number for row, text in pointed.items() if (number := cell_number(text)) is not None}
    mm = {row: abs(number.value) * LENGTH_UNITS.get(number.unit or unit, 1.0) for row, number in numbers.items()}
    beside_whole = any(text.isdigit() for text in texts.values())
    too_thin = are_sizes and min(mm.values(), default=math.inf) < _LEAST_LIKELY_MM
    if max(mm.values(), default=math.inf) * 1000 > LARGEST_MM or not (beside_whole or too_thin):
        return {}
    faults = {}
    for row, number in numbers.items():
        short, thousands = f"{number.value:g}", f"{number.value * 1000:g}"
        sure = f"{number.value:.4f}" if _WITH_THREE.match(short) else short
        faults[row] = f"{pointed[row]} may mean {short} or {thousands}: write {sure} or {thousands}"
    return faults


_TRIPLE: Final = re.compile(r"^\s*([\d.,]+)\s*[x×X*/;|]\s*([\d.,]+)\s*[x×X*/;|]\s*([\d.,]+)")
"""Three numbers in one cell: "28,0 x 20,6 x 14,1"."""


_MANY: Final = 10
"""If numbers with a point are more frequent than numbers with a comma by more than this factor, the commas are no
decimal signs."""


def decimal_of(rows: Sequence[Sequence[Any]]) -> str:
    """The decimal sign of numbers that are stored as text. The result is "" if the numbers do not show which sign it
    is, so that "1,200" could be 1200 or 1.2.

    "1,200" has a decimal comma if whole numbers of four or more digits are written without a mark between thousands. If
    there are no whole numbers of four or more digits, "1.200" may mean 1200 if its column has whole numbers of three
    digits.
    """
    sure, maybe = {",": 0, ".": 0}, {",": 0, ".": 0}
    long_whole = beside_whole = False
    for column in zip(*rows, strict=False):
        has_groups = grouped = False
        for cell in column:
            if not isinstance(cell, str) or len(cell) >= 40:
                continue
            triple = _TRIPLE.match(cell)
            for mark, pattern in _SURE.items():
                sure[mark] += any(map(pattern.match, (cell,) if triple is None else triple.groups()))
            if triple is not None:
                continue
            if (match := _MAYBE.match(cell)) is not None:
                maybe[match[1]] += 1
                grouped |= match[1] == "."
            elif cell.isdigit():
                long_whole |= len(cell) > 3
                has_groups |= len(cell) > 2
        beside_whole |= has_groups and grouped
    if any(sure.values()):
        return "," if sure[","] > sure["."] else "."
    if maybe["."] > _MANY * maybe[","] > 0:
        return "."  # the commas come from a few damaged cells
    if maybe[","]:
        return "," if long_whole and not maybe["."] else ""
    return "" if beside_whole and not long_whole else "."
