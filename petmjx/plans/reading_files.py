"""Files with readings (``--as FILE.toml``), and options for reading."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from petmjx.common.checked_records import read_toml, reason, shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import printable, printable_name
from petmjx.common.units import LENGTHS_MM, MASSES_KG, plan_units
from petmjx.options.run_options import RunOptions
from petmjx.plans.column_extraction import ROLES
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS
from petmjx.plans.input_conventions import ANCHORS
from petmjx.plans.readings import ORIGINS, ROTATION_RULES, Reading, Wishes

_TEXTS: Final = {
    "anchor": tuple(ANCHORS),
    "up": ("z", "y"),
    "sizes": ("placed", "item"),
    "rule": tuple(ROTATION_RULES),
    "origin": ORIGINS,
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
    for field in table:
        if field not in _FIELDS:
            raise InputError(f"{name}: unknown field {printable_name(field)}; there are {', '.join(_FIELDS)}")
    for field, allowed_values in _TEXTS.items():
        if field in table and table[field] not in allowed_values:
            raise InputError(f"{name}: {field} must be one of {', '.join(allowed_values)}, {shown_value(table[field])}")
    units = table.get("units", "")
    if not isinstance(units, str) or not set(filter(None, units.split("/"))) <= LENGTH_UNITS.keys():
        raise InputError(f"{name}: units must be a unit of length, such as mm, {shown_value(units)}")
    along = table.get("along", [])
    if not (isinstance(along, list) and len(along) in (0, 3) and all(isinstance(axis, str) for axis in along)):
        raise InputError(f"{name}: along must be three names of sizes, {shown_value(along)}")
    columns = table.get("columns", {})
    if not (isinstance(columns, dict) and all(isinstance(column, str) for column in columns.values())):
        raise InputError(f"{name}: columns must be a table of names, {shown_value(columns)}")
    density = table.get("density")
    if density is not None and (isinstance(density, bool) or not isinstance(density, int | float) or density <= 0):
        raise InputError(f"{name}: density must be a number > 0, {shown_value(density)}")
    texts: dict[str, Any] = {field: str(table.get(field, "")) for field in _TEXTS}
    return Wishes(
        columns=_choosable(columns), exact=columns, units=units, along=tuple(along), density_kg_m3=density, **texts
    )


def _choosable(columns: Mapping[str, str]) -> dict[str, str]:
    return {role: name for role, name in columns.items() if role in ROLES}


def wishes_of(
    options: RunOptions, deck_mm: tuple[float, float] | None = None, reading: Reading | None = None
) -> Wishes:
    """The options for reading files of other tools. An option for one choice, such as ``units``, takes precedence over
    a written reading.

    Args:
        deck_mm: extents of the carrier along x and y; None: unknown.
        reading: how to read the file (units, columns, axes); used instead of the file that the options name with
            ``--as``; None: that file is used.

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
    }
    if options.columns:
        changes["columns"] = {**wishes.columns, **options.columns}
    return replace(wishes, **{name: value for name, value in changes.items() if value})


def named_units(units: str | None) -> tuple[str, str]:
    """The unit of lengths and the unit of masses in a text such as "cm" or "cm,g". A unit that the text lacks is ""."""
    if not units:
        return "", ""
    plan_units(units)
    names = [name.strip() for name in units.split(",")]
    length = next((name for name in names if name in LENGTHS_MM), "")
    return length, next((name for name in names if name in MASSES_KG), "")
