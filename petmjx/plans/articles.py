"""Tables of articles (``Articles``) from users' files: properties of boxes by article, product group or material.

The properties are material, centre of mass, stiffness and strength. The strength of a carton is measured, or computed
from the carton's board by McKee's formula: 5.87 · edge crush strength · √(thickness · perimeter) (McKee, Gander,
Wachuta 1963, "Compression strength formula for corrugated boxes", Paperboard Packaging 48(8)). McKee's formula gives
the strength of a new box in a press; the strength in use is this strength divided by a safety factor.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from petmjx.common.checked_records import reason
from petmjx.common.errors import InputError
from petmjx.common.parquet_files import parquet_rows
from petmjx.common.text import number_in, printable, printable_name
from petmjx.common.toml_files import read_toml
from petmjx.plans.file_formats import (
    COMMA_NUMBER,
    CSV_SUFFIXES,
    PARQUET_SUFFIX,
    foreign_kind_of,
    is_csv,
    is_parquet_name,
    is_utf8,
    looks_like_json,
    number_hint,
    other_encoding,
    point_fault,
    separator_mark,
)
from petmjx.plans.json_reader import read_text_bytes
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import COM_FIELDS, LARGEST_MM, SPARSE, com_along_axes, joined_names, kind

_KEYS: Final = ("article", "product_group")
_STIFFNESS: Final = "stiffness_n_mm"
_STRENGTH: Final = "strength_n"
_BOARD: Final = ("ect_kn_m", "thickness_mm", "safety_factor")
_MATERIAL: Final = "material"
_NUMBERS: Final = {
    _STRENGTH: SPARSE[_STRENGTH][:2],
    "ect_kn_m": (0.0, 1e3),
    "thickness_mm": (0.0, 100.0),
    "safety_factor": (1.0, 1e3),
    _STIFFNESS: SPARSE[_STIFFNESS][:2],
    **dict.fromkeys(COM_FIELDS, (-LARGEST_MM / 2, LARGEST_MM / 2)),
}
"""Field → limits between which its values are plausible. If the lower limit is 0, the value must be above 0."""
_FIELDS: Final = (*_KEYS, _MATERIAL, *_NUMBERS)

_LONGEST_MATERIAL: Final = 100

MOST_ARTICLES: Final = 1_000_000
"""Largest number of articles in a table: more than any warehouse has. A table with this number of articles takes about
400 MB of memory."""

_COMMA_NUMBER: Final = re.compile(COMMA_NUMBER)
_TOML_TABLES: Final = {"articles": "article", "product_groups": "product_group", "materials": _MATERIAL}


MCKEE: Final = 5.87
"""Factor of McKee's formula in its simple form, without a unit."""


@dataclass(frozen=True)
class CartonStrength:
    """The strength that one row of a table of articles gives: in newtons, or through properties of the cartons' board.

    Attributes:
        strength_n: strength, N. If ``strength_n`` is None, the strength is computed from the board by McKee's formula.
        ect_kn_m: edge crush strength of the board, kN/m.
        thickness_mm: thickness of the board, mm.
        safety_factor: divisor of the strength. If ``safety_factor`` is None, the strength is not divided.
    """

    strength_n: float | None = None
    ect_kn_m: float | None = None
    thickness_mm: float | None = None
    safety_factor: float | None = None

    def of_box(self, length_mm: float, width_mm: float) -> float:
        """The largest load that a box with a base of ``length_mm`` × ``width_mm`` can bear, N."""
        strength = self.strength_n
        if strength is None:
            perimeter_mm = 2 * (length_mm + width_mm)
            # kN/m is N/mm
            strength = MCKEE * (self.ect_kn_m or 0.0) * math.sqrt((self.thickness_mm or 0.0) * perimeter_mm)
        return strength / (self.safety_factor or 1.0)


@dataclass(frozen=True)
class Article:
    """The properties of an article, a product group or a material. A property that the table does not give is None.

    Attributes:
        strength: strength of the boxes.
        material: material of the boxes, for friction (petmjx.options.materials).
        com_mm: centre of mass relative to the box's middle, along length, width and height, mm.
        stiffness_n_mm: stiffness of the boxes, N/mm, as in ``Plan``.
    """

    strength: CartonStrength | None = None
    material: str | None = None
    com_mm: tuple[float, float, float] | None = None
    stiffness_n_mm: float | None = None

    def filled_up(self, other: Article) -> Article:
        """A copy of this entry in which missing values are taken from another entry."""
        values = {field.name: value for field in fields(self) if (value := getattr(self, field.name)) is not None}
        return replace(other, **values)


@dataclass(frozen=True)
class Articles:
    """Properties by article, by product group and by material.

    Each property is taken from the article. A property that the article lacks is taken from the product group; a
    property that both lack is taken from the material.
    """

    by_article: Mapping[str, Article]
    by_group: Mapping[str, Article]
    by_material: Mapping[str, Article] = field(default_factory=dict)

    def find(self, article: str, group: str, material: str = "") -> Article:
        """The properties of a box: from its article, else its product group, else its material.

        Args:
            article, group: the box's article and product group in the plan; "" if the plan gives none.
            material: the box's material in the plan; "" if the plan gives none.
        """
        entry = self.by_article.get(article, _EMPTY_ARTICLE)
        merged = entry.filled_up(self.by_group.get(group, _EMPTY_ARTICLE) if group else _EMPTY_ARTICLE)
        return merged.filled_up(self.by_material.get(material_key(material or merged.material or ""), _EMPTY_ARTICLE))


_EMPTY_ARTICLE: Final = Article()


def material_key(name: str) -> str:
    """A material's name in the form in which names are compared: without case, and without white space around it."""
    return name.strip().lower()


def read_articles(path: str | Path) -> Articles:
    """Read a table of articles: CSV (possibly gzipped), Parquet or TOML.

    Raises:
        InputError: the file cannot be read, or a row is unusable. The message names the file, the row and the field.
    """
    file, name = Path(path), printable(str(path))
    try:
        # CSV and TOML are not checked here: their readers report files of another format themselves
        has_own_reader = is_csv(file) or file.suffix.lower() == ".toml"
        if not has_own_reader and (foreign := foreign_kind_of(file)) is not None:
            raise InputError(f"{name}: {foreign}")
        if file.suffix.lower() == ".toml":
            rows = _toml_rows(read_toml(file), name)
        elif is_parquet_name(file):
            rows = _parquet_rows(file)
        elif is_csv(file):
            rows = _csv_rows(file, name)
        else:
            raise InputError(f"{name}: the name must end in one of .toml, {PARQUET_SUFFIX}, {', '.join(CSV_SUFFIXES)}")
        articles: dict[str, dict[str, Article]] = {key: {} for key in (*_KEYS, _MATERIAL)}
        for where, row in rows:  # rows are read one at a time, since a million rows as dictionaries take a gigabyte
            key, value, article = _article(f"{name}: {where}", row)
            if value in articles[key]:
                raise InputError(f"{name}: {where}: {key} {printable_name(value)} occurs twice")
            articles[key][value] = article
            if sum(map(len, articles.values())) > MOST_ARTICLES:
                raise InputError(f"{name}: has more than {MOST_ARTICLES:,} articles")
    except pa.ArrowException:
        raise InputError(f"{name}: is not a whole Parquet file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be read: {reason(error)}") from None
    if not any(articles.values()):
        raise InputError(f"{name}: holds no article")
    return Articles(articles["article"], articles["product_group"], articles[_MATERIAL])


def _article(where: str, row: Mapping[str, Any]) -> tuple[str, str, Article]:
    """Check one row of a table of articles. Returns three values: "article", "product_group" or "material"; the name of
    this article, product group or material; and its properties."""
    values = {name.strip().lower(): value for name, value in row.items() if value not in (None, "")}
    unknown = [name for name in values if name not in _FIELDS]
    if unknown:
        raise InputError(f"{where}: unknown field {printable_name(unknown[0])}; there are {', '.join(_FIELDS)}")
    keys = [key for key in _KEYS if key in values]
    if len(keys) == 2 or (not keys and _MATERIAL not in values):
        raise InputError(f"{where}: must name an article or a product_group (not both), or only a material")
    numbers = {field: _number(where, field, values[field]) for field in _NUMBERS if field in values}
    stiffness = numbers.pop(_STIFFNESS, None)
    com = [numbers.pop(field) if field in numbers else None for field in COM_FIELDS]
    com_mm = None if com == [None] * 3 else (com[0] or 0.0, com[1] or 0.0, com[2] or 0.0)
    material = values.get(_MATERIAL)
    if material is not None and not (isinstance(material, str) and len(material) <= _LONGEST_MATERIAL):
        raise InputError(
            f"{where}: {_MATERIAL} must be text of at most {_LONGEST_MATERIAL} characters, got {_shown_cell(material)}"
        )
    has_other_values = bool(keys and material) or com_mm is not None or stiffness is not None
    bears = None if not numbers and has_other_values else _strength(where, numbers)
    if not keys and material is not None:
        return _MATERIAL, material_key(material), Article(bears, None, com_mm, stiffness)
    return keys[0], str(values[keys[0]]), Article(bears, material, com_mm, stiffness)


def _strength(where: str, numbers: Mapping[str, float]) -> CartonStrength:
    board = [field for field in _BOARD if field not in numbers]
    if _STRENGTH in numbers and any(field in numbers for field in _BOARD[:2]):
        raise InputError(f"{where}: give either {_STRENGTH}, or {joined_names(_BOARD)}")
    if _STRENGTH not in numbers and board:
        verb = "is" if len(board) == 1 else "are"
        raise InputError(
            f"{where}: needs {_STRENGTH}, or {joined_names(_BOARD)}; of these {joined_names(board)} {verb} missing"
        )
    return CartonStrength(**numbers)


def _number(where: str, field: str, value: Any) -> float:
    low, high = _NUMBERS[field]
    number: float | None = None
    if isinstance(value, str):
        number = number_in(value)
    elif not isinstance(value, bool):
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)
    if number is None:
        number = math.nan
    if not (low < number <= high or (low and number == low)):
        least = f"≥ {low:g}" if low else "> 0"
        hint = number_hint(value) if isinstance(value, str) else ""
        raise InputError(
            f"{where}: {field} must be a number {least} and at most {high:g}, got {_shown_cell(value)}{hint}"
        )
    return number


def _shown_cell(value: Any) -> str:
    return kind(value) if isinstance(value, bool | int | float | str | list | dict) else type(value).__name__


def _toml_rows(tables: Mapping[str, Any], name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    for table, rows in tables.items():
        if table not in _TOML_TABLES or not isinstance(rows, Mapping):
            raise InputError(
                f"{name}: must have the tables [articles.NAME], [product_groups.NAME] and [materials.NAME], got "
                f"{printable_name(table)}"
            )
        for value, row in rows.items():
            location = f"{table}.{printable_name(value)}"
            if not isinstance(row, Mapping):
                raise InputError(f"{name}: {location} must be a table with {_STRENGTH}, or with {joined_names(_BOARD)}")
            yield location, {**row, _TOML_TABLES[table]: value}


def _csv_rows(file: Path, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    data, fault = read_text_bytes(file)
    if fault is not None:
        raise InputError(f"{name}: {fault.partition(';')[0]}")
    if looks_like_json(data):
        raise InputError(f"{name}: is JSON, but a table of articles must be TOML, CSV or Parquet")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        line = next(number for number, row in enumerate(data.split(b"\n"), start=1) if not is_utf8(row))
        cell = data.split(b"\n")[line - 1].decode("utf-8", "surrogateescape")
        raise InputError(f"{name}: row {line} is not UTF-8 text{other_encoding(cell)}") from None
    header = text.partition("\n")[0]
    if (mark := separator_mark(header.encode())) is not None:
        raise InputError(f"{name}: {mark}")
    delimiter = max(",;\t", key=header.count)
    commas = delimiter == ";" and _has_decimal_commas(text)
    number = 0
    try:
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        for number, row in enumerate(rows, start=1):
            if number == 1:
                names = row
            elif row:
                yield f"row {number}", _cells(name, number, names, row, commas)
    except csv.Error as error:
        unclosed = "unexpected end of data" in str(error)
        quote_fault = "has an unclosed quotation mark" if unclosed else f"not CSV: {reason(error)}"
        raise InputError(f"{name}: row {number + 1}: {quote_fault}") from None


def _cells(name: str, number: int, names: Sequence[str], row: Sequence[str], commas: bool) -> dict[str, Any]:
    if len(row) != len(names):
        raise InputError(f"{name}: row {number}: has {len(row)} fields instead of {len(names)}")
    values = dict(zip(names, row, strict=True))
    field_names = [field.strip().lower() for field in names]
    if twice := next((field for field in field_names if field_names.count(field) > 1), None):
        raise InputError(f"{name}: row 1: the column {printable_name(twice)} is repeated")
    if commas:
        for field, value in values.items():
            if (plain := field.strip().lower()) in _NUMBERS:
                if (fault := point_fault(plain, value)) is not None:
                    raise InputError(f"{name}: row {number}: {fault}")
                values[field] = value if "." in value else value.replace(",", ".")
    return values


def _has_decimal_commas(text: str) -> bool:
    """Whether a table with semicolons has a number with a decimal comma."""
    if "," not in text:
        return False
    rows = csv.reader(io.StringIO(text, newline=""), delimiter=";")
    try:
        numeric = [at for at, field in enumerate(next(rows, [])) if field.strip().lower() in _NUMBERS]
        return any(_COMMA_NUMBER.match(row[at]) for row in rows for at in numeric if at < len(row))
    except csv.Error:  # the fault of a bad row is reported when the table is read
        return False


def _parquet_rows(file: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    for number, row in enumerate(parquet_rows(file)):
        yield (
            f"row {number}",
            {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in row.items()},
        )


# Applying articles to plans.


def with_articles(plan: Plan, articles: Articles) -> Plan:
    """Add to a plan the materials, centres of mass, stiffness and strength that a table gives for its boxes.

    A value in the plan takes precedence over the table. If the table gives nothing for the plan's boxes, the object
    ``plan`` itself is returned.

    Raises:
        InputError: a centre of mass is outside its box. The message begins with ", placement 3: …", so that the caller
            can put the name of the plan before it.
    """
    groups = plan.product_groups or ("",) * plan.n_boxes
    own_materials = plan.materials or ("",) * plan.n_boxes
    rows = [articles.find(*names) for names in zip(plan.articles, groups, own_materials, strict=True)]
    changes: dict[str, Any] = {}
    numbers = {
        _STIFFNESS: [row.stiffness_n_mm for row in rows],
        _STRENGTH: [
            None if row.strength is None else row.strength.of_box(*base)
            for row, base in zip(rows, plan.size_mm[:, :2].tolist(), strict=True)
        ],
    }
    for name, values in numbers.items():
        if any(value is not None for value in values):
            own_values = getattr(plan, name)
            array = np.array([np.nan if value is None else value for value in values])
            changes[name] = array if own_values is None else np.where(np.isnan(own_values), array, own_values)
    if any(row.material for row in rows):
        changes["materials"] = tuple(name or row.material or "" for name, row in zip(own_materials, rows, strict=True))
    if any(row.com_mm for row in rows):
        offset = np.array([row.com_mm or (0.0, 0.0, 0.0) for row in rows])
        outside = 2 * np.abs(offset) >= plan.item_size_mm
        if outside.any():
            box, axis = np.argwhere(outside)[0].tolist()
            where, size = f", placement {box}: {COM_FIELDS[axis]}", plan.item_size_mm[box, axis]
            name = f" of article {printable_name(plan.articles[box])}" if plan.articles[box] else ""
            raise InputError(f"{where}{name} is {offset[box, axis]:g}, not inside the box of {size:g} mm")
        own_com_mm = plan.item_com_mm
        offset = np.where(own_com_mm.any(axis=1, keepdims=True), own_com_mm, offset)
        changes["mass_center_mm"] = com_along_axes(offset, plan.turned)
    return replace(plan, **changes) if changes else plan
