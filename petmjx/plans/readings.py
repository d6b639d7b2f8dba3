"""Readings of other tools' numbers (``Reading``): their units, axes, anchor, rotations and origin. The module also
reads and writes files with readings (``--as FILE.toml``), and has options for reading (``Wishes``).

Column names often allow several readings of a file's numbers. All possible readings are tried, and the most plausible
one wins. In a plausible reading, no box overlaps another box or floats; boxes lie on other boxes, touch their
neighbours and fit the carrier; and they have the sizes and densities of cartons. If two readings are almost equally
plausible, and differ in more than a shift or a mirror image, they are a tie. In case of a tie, the user is asked or the
file is refused. A tie is never decided silently.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from petmjx.common.checked_records import reason, shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name, three_digits
from petmjx.common.toml_files import read_toml
from petmjx.common.units import LENGTHS_MM, MASSES_KG
from petmjx.options.run_options import RunOptions
from petmjx.plans.column_extraction import LAST_CELLS, ROLES, SIZE_WORDS, XYZ, role_of
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS, UNIT_WORDS
from petmjx.plans.input_conventions import ANCHORS

ROTATION_RULES: Final = {
    "none": "sizes are as placed",
    "swap": "odd values swap the two horizontal sizes",
    "swap back": "the value 0 swaps the two horizontal sizes",
    "degrees": "90 and 270 degrees swap the two horizontal sizes",
    "letters": "letters tell which size lies along x, y and z",
    "py3dbp": "0 WHD, 1 HWD, 2 HDW, 3 DHW, 4 DWH, 5 WDH",
    "py3dbp from 1": "1 WHD, 2 HWD, 3 HDW, 4 DHW, 5 DWH, 6 WDH",
    "permutations": "0 XYZ, 1 XZY, 2 YXZ, 3 YZX, 4 ZXY, 5 ZYX",
    "permutations from 1": "1 XYZ, 2 XZY, 3 YXZ, 4 YZX, 5 ZXY, 6 ZYX",
    "pose": "poses turn boxes, and coordinates describe points of the boxes after they are turned",
    "pose about point": "coordinates describe points of the boxes, and poses turn the boxes about these points",
}
"""Rule of rotation → its description."""
POSES: Final = ("pose", "pose about point")
"""Rules of rotation in files with poses. With "pose", coordinates describe a point of the box as placed: the corner is
that with the smallest x, y and z. With "pose about point", coordinates describe a point of the box before it is turned:
the corner of a box that is turned by 180° becomes that with the largest x and y."""
ORIGINS: Final = {
    "given": "",
    "middle": "origin in the middle of the carrier",
    "floor": "heights measured from below the deck",
}
"""Possible origin of a file (see ``Reading``) → its description."""


@dataclass(frozen=True)
class Evidence:
    """Evidence for or against a reading.

    Attributes:
        n_boxes: number of boxes that were examined.
        n_overlapping, n_floating, n_outside: numbers of boxes that overlap another box, that have no support, and that
            reach beyond the carrier.
        supported: mean over boxes of the supported share of the base.
        density_kg_m3: median density; NaN if there are no weights.
        side_mm: geometric mean of the boxes' sides.
    """

    n_boxes: int = 0
    n_overlapping: int = 0
    n_floating: int = 0
    n_outside: int = 0
    supported: float = 1.0
    density_kg_m3: float = math.nan
    side_mm: float = math.nan

    @property
    def n_odd(self) -> int:
        """Number of boxes that overlap, float or are outside; a box that is odd in two ways counts twice."""
        return self.n_overlapping + self.n_floating + self.n_outside

    @property
    def is_piled(self) -> bool:
        """Whether more than a fifth of the boxes overlap."""
        return 5 * self.n_overlapping > self.n_boxes

    def of_units(self) -> str:
        """The typical size and density that the boxes have in the units of the reading, in words. The user can thus
        tell whether the units are right."""
        density = "" if math.isnan(self.density_kg_m3) else f", {three_digits(self.density_kg_m3)} kg/m³"
        return f"boxes with sides of about {three_digits(self.side_mm)} mm{density}"

    def __str__(self) -> str:
        parts = [
            count_text(self.n_overlapping, "box overlaps", "boxes overlap") if self.n_overlapping else "",
            count_text(self.n_floating, "box floats", "boxes float") if self.n_floating else "",
            count_text(self.n_outside, "box is outside", "boxes are outside") if self.n_outside else "",
        ]
        odd = ", ".join(filter(None, parts)) or "no box overlaps or floats"
        return f"{odd}; {count_text(self.n_boxes, 'box', 'boxes')} in all"


NOT_READ: Final = "not read: "
"""First words of a note about a list of boxes that is not read."""


@dataclass(frozen=True)
class Reading:
    """How the numbers of a file are read.

    Attributes:
        form: name of the file's form, in words.
        columns: role → name of its column.
        units: unit of lengths. If sizes and coordinates have different units, ``units`` is, for example, "cm/mm".
        masses: unit of masses.
        anchor: the point of a box that coordinates describe.
        up: the file's vertical axis, "x", "y" or "z"; "-y" or "-z": heights are counted downwards along y or z.
        along: names of the sizes that lie along the plan's x, y and z, before boxes are turned.
        sizes: "placed": sizes of boxes as placed; "item": sizes before boxes are turned.
        rule: how boxes are turned (``ROTATION_RULES``).
        origin: "given": coordinates are unchanged; "middle": half the carrier is added to x and y; "floor": heights are
            measured from the lowest box.
        order: where the packing order comes from: "sequence": a column; "rows": the order of the rows; "height": the
            rows, sorted from the ground up.
        density_kg_m3: density of boxes that have no weight; None: all boxes have weights.
        notes: lines about values that were added or left out.
        unused: names of the columns that are not used.
        cost: cost of the reading; an implausible reading has a high cost.
        layout_cost: the part of the cost that does not come from names and units.
        evidence: the numbers on which the cost is based.
        alternatives: other readings with a similar cost, most plausible first.
    """

    form: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    units: str = "mm"
    masses: str = "kg"
    anchor: str = "corner"
    up: str = "z"
    along: tuple[str, str, str] = ("x", "y", "z")
    sizes: str = "placed"
    rule: str = "none"
    origin: str = "given"
    order: str = "rows"
    density_kg_m3: float | None = None
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    cost: float = 0.0
    layout_cost: float = 0.0
    evidence: Evidence = Evidence()
    alternatives: tuple[Reading, ...] = ()

    @property
    def length_units(self) -> tuple[str, str]:
        """The units of sizes and of coordinates."""
        return _length_units(self.units)

    @property
    def far_words(self) -> str:
        """What the columns of far corners hold, in words; "" if there are none."""
        name = next((self.columns[role] for role in ("x (far)", "corners") if role in self.columns), "")
        are_cells = LAST_CELLS in self.columns
        return name and f"{name} and columns like it hold {'the last grid cells' if are_cells else 'the ends'} of boxes"

    @property
    def size_columns(self) -> str:
        """The columns of sizes, as in the option ``columns``; "" if the option cannot choose them."""
        roles = [role for role in self.columns if role == "sizes" or role in map(role_of, (*SIZE_WORDS, *XYZ))]
        return ",".join(f"{role}={self.columns[role]}" for role in roles)

    @property
    def anchor_words(self) -> str:
        """The point of a box that coordinates describe, in words."""
        return f"coordinates of {_ANCHOR_WORDS[self.anchor]}"

    @property
    def along_words(self) -> str:
        """Which sizes lie along the axes, in words."""
        return f"{', '.join(self.along)} along x, y, z"

    @property
    def column_words(self) -> str:
        """What each column was taken for."""
        return ", ".join(f"{role}={name}" for role, name in self.columns.items())

    @property
    def size_words(self) -> str:
        """Which sizes the columns of sizes hold, in words."""
        return "sizes as placed" if self.sizes == "placed" else f"sizes before turning ({ROTATION_RULES[self.rule]})"

    @property
    def pose_words(self) -> str:
        """How poses turn boxes, in words; "" if there are no poses."""
        return ROTATION_RULES[self.rule] if self.rule in POSES else ""

    @property
    def unread(self) -> tuple[str, ...]:
        """Lines about lists of boxes that are not read."""
        return tuple(note for note in self.notes if note.startswith(NOT_READ))

    def line(self) -> str:
        """The reading as one line of text, without the lines about lists of boxes that are not read."""
        sizes, places = self.length_units
        lengths = sizes if sizes == places else f"sizes in {sizes}, coordinates in {places}"
        parts = [
            self.form,
            f"{lengths}, {self.masses}",
            self.anchor_words,
            up_words(self.up),
            self.along_words,
            self.size_words,
            self.pose_words if self.rule == POSES[1] else "",
            ORIGINS[self.origin],
            *(note for note in self.notes if note not in self.unread),
        ]
        return f"read as {'; '.join(filter(None, parts))}"


def up_words(up: str) -> str:
    """A vertical axis in words: "z" → "z upwards", "-z" → "z downwards"."""
    return f"{up[1:]} downwards" if up.startswith("-") else f"{up} upwards"


_ANCHOR_WORDS: Final = {
    "corner": "corners",
    "centre": "centres",
    "base-centre": "centres of bases",
    "far-corner": "far corners",
    "top-centre": "centres of tops",
    **{
        f"corner-{axes}": f"corners with the largest {' and '.join(axes)}" for axes in ("x", "y", "xy", "z", "xz", "yz")
    },
}


@dataclass(frozen=True)
class Wishes:
    """Options of a caller about a file. Options that are empty are chosen by plausibility.

    Attributes:
        columns: role → name of the column, for roles that can be chosen.
        exact: all columns, if they come from a written reading; else empty.
        units: unit of lengths, as in ``Reading``.
        masses: unit of masses.
        anchor, up, sizes, origin: as in ``Reading``.
        along: names of the sizes along x, y and z. ``along`` and ``rule`` can only come from a written reading.
        rule: how boxes are turned.
        density_kg_m3: density of boxes that have no weight.
        deck_mm: extents of the carrier along x and y.
        max_boxes: largest number of boxes of a plan; None: any number.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    exact: Mapping[str, str] = field(default_factory=dict)
    units: str = ""
    masses: str = ""
    anchor: str = ""
    up: str = ""
    sizes: str = ""
    origin: str = ""
    along: tuple[str, ...] = ()
    rule: str = ""
    density_kg_m3: float | None = None
    deck_mm: tuple[float, float] | None = None
    max_boxes: int | None = None

    @property
    def length_units(self) -> tuple[str, str]:
        """The units of sizes and of coordinates; "": chosen by plausibility."""
        return _length_units(self.units)


def _length_units(units: str) -> tuple[str, str]:
    sizes, _, places = units.partition("/")
    return sizes, places or sizes


class AmbiguousFile(InputError):
    """Raised if a file has two possible readings. The message names both readings, and the option that decides between
    them.

    Attributes:
        readings: the possible readings, most plausible first.
    """

    def __init__(self, message: str, readings: Sequence[Reading]) -> None:
        super().__init__(message)
        self.readings = tuple(readings)


def _length_words(reading: Reading) -> str:
    sizes, places = (UNIT_WORDS.get(unit, unit) for unit in reading.length_units)
    return f"lengths in {sizes}" if sizes == places else f"sizes in {sizes}, coordinates in {places}"


def _columns_of(readings: Sequence[Reading]) -> str:
    """The columns of readings; if readings have different columns, those of each reading."""
    return ", or ".join(dict.fromkeys(reading.column_words for reading in readings))


_DIFFERENCES: Final[Sequence[tuple[str, Callable[[Reading], str]]]] = (
    ("--columns", lambda reading: reading.size_columns),
    ("--units", _length_words),
    ("--units", lambda reading: f"weights in {UNIT_WORDS.get(reading.masses, reading.masses)}"),
    ("--up (x, y, z, -y or -z)", lambda reading: up_words(reading.up)),
    ("--anchor", lambda reading: reading.anchor_words),
    ("--sizes", lambda reading: reading.size_words),
    ("", lambda reading: reading.pose_words),
    ('--columns ("last cells=NAME", or "last cells=-")', lambda reading: reading.far_words),
)
"""Descriptions of the choices that a reading makes, with the options that decide."""
_OF_COLUMNS: Final[Sequence[tuple[str, Callable[[Reading], str]]]] = (
    ("--columns", lambda reading: reading.along_words),
    ("--columns", lambda reading: reading.column_words),
)
"""The choices of columns. If two readings also differ in other choices, a difference in columns is only a consequence,
so it is not mentioned."""


def differences(one: Reading, two: Reading) -> list[tuple[str, str, str]]:
    """The differences between two readings. Each difference has three texts: the option that decides between the two
    readings; what the first reading says, in words; and what the second reading says."""
    of_choices, of_columns = (
        [(option, words(one), words(two)) for option, words in choices if words(one) != words(two)]
        for choices in (_DIFFERENCES, _OF_COLUMNS)
    )
    return of_choices or of_columns


def tie_text(readings: Sequence[Reading], weak: bool) -> str:
    """The line about a tie: the two readings, how they differ, the vertical axes of other readings, the options that
    decide, and the columns that were used."""
    one, two = readings[0], readings[1]
    parts = differences(one, two)
    first, second = (", ".join(part[index] for part in parts) for index in (1, 2))
    options = " or ".join(dict.fromkeys(part[0] for part in parts if part[0]))
    reason = "no reading is plausible; the best are" if weak else "can be read in two ways:"
    of_units = not weak and (one.units != two.units or one.masses != two.masses)
    evidence = [reading.evidence.of_units() if of_units else str(reading.evidence) for reading in (one, two)]
    ways = f"{first} ({evidence[0]}), or {second} ({evidence[1]})"
    further = dict.fromkeys(other.up for other in readings[2:] if one.up != two.up and other.up not in (one.up, two.up))
    ways += "".join(f"; {up_words(up)} is possible, too" for up in further)
    is_piled = weak and one.evidence.is_piled
    advice = f"{options}, or with --as FILE.toml" if options else "--as FILE.toml"
    columns = "" if one.column_words in first else f"; columns: {_columns_of(readings[:2])}"
    return f"{reason} {ways}; {f'{SEVERAL}; ' if is_piled else ''}say which with {advice}{columns}"


def implausible_text(reading: Reading) -> str:
    """The line about a file whose most plausible reading lets most boxes overlap, or contradicts column names."""
    options = f"if that is right, say --up {reading.up} --anchor {reading.anchor}"
    if reading.evidence.is_piled:
        turned = "" if "rotation" in reading.columns else "if boxes are turned, say --columns rotation=NAME; "
        options = f"{turned}{SEVERAL}; if boxes really overlap, say --anchor {reading.anchor}"
    return (
        f"no reading is plausible; the best has {reading.anchor_words}, {up_words(reading.up)} "
        f"({reading.evidence}); {options}; columns: {_columns_of([reading])}"
    )


SEVERAL: Final = "if the file has several pallets, name their column with --columns plan=NAME"
"""Advice about a file whose boxes overlap in every reading, or are too many for one plan."""


CHOOSER: ContextVar[Callable[[str, AmbiguousFile], Reading | None] | None] = ContextVar("CHOOSER", default=None)
"""Function that asks the user which reading of a file is right. The arguments of the function are the name of the file
and the possible readings. The function returns the right reading, or None if the user does not know. If None is given
instead of a function, the file is refused without a question."""


# Files with readings, and options for reading.


_TEXTS: Final = {
    "anchor": tuple(ANCHORS),
    "up": ("z", "y", "x", "-z", "-y"),
    "sizes": ("placed", "item"),
    "rule": tuple(ROTATION_RULES),
    "origin": tuple(ORIGINS),
    "masses": tuple(MASS_UNITS),
}
"""Field of a written reading → its possible values."""
_FIELDS: Final = ("form", "units", "along", "density", "columns", *_TEXTS)


def wishes_of_reading(reading: Reading) -> Wishes:
    """Turn a reading into options that fix every choice."""
    same = {name: getattr(reading, name) for name in (*_TEXTS, "units", "along", "density_kg_m3")}
    return Wishes(columns=_choosable(reading.columns), exact=dict(reading.columns), **same)


def reading_toml(reading: Reading, source: str) -> str:
    """A reading as the text of a file for :func:`read_reading`.

    Args:
        source: name of the file, for a comment.
    """
    lines = [
        f"# How petmjx reads {printable(source)}",
        f"form = {_quoted(reading.form)}",
        f"units = {_quoted(reading.units)}",
        *(f"{name} = {_quoted(getattr(reading, name))}" for name in _TEXTS),
        f"along = [{', '.join(map(_quoted, reading.along))}]",
        *([] if reading.density_kg_m3 is None else [f"density = {reading.density_kg_m3:g}"]),
        "",
        "[columns]",
        *(f"{_quoted(role)} = {_quoted(name)}" for role, name in reading.columns.items()),
    ]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def read_reading(path: Path) -> Wishes:
    """Read a file with a reading.

    Raises:
        InputError: the file cannot be read, or has an unknown field or value. The message names the file and the field.
    """
    name = printable(str(path))
    try:
        table = read_toml(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be read: {reason(error)}") from None
    if unknown := [key for key in table if key not in _FIELDS]:
        raise InputError(f"{name}: unknown field {printable_name(unknown[0])}; there are {', '.join(_FIELDS)}")
    for key, allowed_values in _TEXTS.items():
        if key in table and table[key] not in allowed_values:
            raise InputError(f"{name}: {key} must be one of {', '.join(allowed_values)}, {shown_value(table[key])}")
    units = table.get("units", "")
    parts = units.split("/") if isinstance(units, str) and units else []
    if not isinstance(units, str) or len(parts) > 2 or not set(parts) <= LENGTH_UNITS.keys():
        raise InputError(f"{name}: 'units' must be a unit of length, such as mm, {shown_value(units)}")
    along = table.get("along", [])
    if not (isinstance(along, list) and len(along) in (0, 3) and all(isinstance(axis, str) for axis in along)):
        raise InputError(f"{name}: 'along' must be three names of sizes, {shown_value(along)}")
    columns = table.get("columns", {})
    if not (isinstance(columns, dict) and all(isinstance(column, str) for column in columns.values())):
        raise InputError(f"{name}: 'columns' must be a table of names, {shown_value(columns)}")
    density = table.get("density")
    if density is not None and (isinstance(density, bool) or not isinstance(density, int | float) or density <= 0):
        raise InputError(f"{name}: density must be a number > 0, {shown_value(density)}")
    texts: dict[str, Any] = {key: str(table.get(key, "")) for key in _TEXTS}
    return Wishes(
        columns=_choosable(columns), exact=columns, units=units, along=tuple(along), density_kg_m3=density, **texts
    )


def _choosable(columns: Mapping[str, str]) -> dict[str, str]:
    return {role: name for role, name in columns.items() if role in ROLES}


def wishes_of(
    options: RunOptions,
    deck_mm: tuple[float, float] | None = None,
    reading: Reading | None = None,
    max_boxes: int | None = None,
) -> Wishes:
    """How to read files of other tools, according to the options. An option for one choice, such as ``units``, takes
    precedence over a reading.

    Args:
        deck_mm: extents of the carrier along x and y; None: unknown.
        reading: how to read the numbers of a file (units, columns, axes …). If ``reading`` is None, the reading comes
            from the TOML file that the option ``--as`` names, if this option is set.
        max_boxes: largest number of boxes of a plan; None: any number.

    Raises:
        InputError: the written reading cannot be read.
    """
    wishes = Wishes() if options.reading is None else read_reading(options.reading)
    if reading is not None:
        wishes = wishes_of_reading(reading)
    units, masses = named_units(options.units)
    changes: dict[str, Any] = {
        "units": units,
        "masses": masses,
        "anchor": options.anchor,
        "up": options.up,
        "sizes": options.sizes,
        "density_kg_m3": options.density,
        "deck_mm": deck_mm,
        "max_boxes": max_boxes,
    }
    if options.columns:
        changes["columns"] = {**wishes.columns, **options.columns}
    return replace(wishes, **{name: value for name, value in changes.items() if value})


def named_units(units: str | None) -> tuple[str, str]:
    """The unit of lengths and the unit of masses in a text such as "cm", "cm,g" or "cm/mm" (sizes and coordinates). A
    unit that the text lacks is ""."""
    if not units:
        return "", ""
    names = [name.strip() for name in units.split(",")]
    length = next((name for name in names if {*name.split("/")} <= LENGTHS_MM.keys()), "")
    return length, next((name for name in names if name in MASSES_KG), "")
