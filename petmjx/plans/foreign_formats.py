"""Reads what other tools write (``sources_of_bytes``): a file's bytes become lists of boxes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from petmjx.common.errors import InputError
from petmjx.common.text import blanked
from petmjx.common.unreadable_files import ARCHIVE_BYTES, NUMPY_MAGIC, ZIP_MAGIC, foreign_kind, program_kind
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.column_names import words_of
from petmjx.plans.file_formats import NoBoxes, NoGeometry, nul_fault
from petmjx.plans.header_and_total_rows import geometric_names
from petmjx.plans.known_forms import MOST_BYTES, X3D, BoxSource, rows_of, with_known_form, with_named_units
from petmjx.plans.nested_containers import LAYERS
from petmjx.plans.nested_json import box_lists, decoded_json
from petmjx.plans.numpy_arrays import loaded_array, loaded_arrays, sources_of_arrays
from petmjx.plans.printed_values import printed_values, values_of_blocks, values_of_lines
from petmjx.plans.python_objects_and_py3dbp import is_printed_object, python_values, source_of_printed
from petmjx.plans.raw_tables import BoxList, RawTable, not_placed, rows_with_boxes, united, with_names_of, with_titles
from petmjx.plans.scene_files import is_gltf, is_three_js, source_of_gltf, source_of_scene, source_of_three_js
from petmjx.plans.table_sections import are_unplaced
from petmjx.plans.text_tables import decoded_text
from petmjx.plans.workbooks import read_raw_tables, tables_of_page, value_of_xml
from petmjx.plans.yaml_and_toml import nested_format, value_of_toml, value_of_yaml


def sources_of_bytes(data: bytes | bytearray, path: Path | None = None) -> list[BoxSource]:
    """The lists of boxes in a file's bytes. The list that most likely describes a plan comes first. The boxes of a list
    may lack places or sizes.

    Args:
        path: the file, whose name may tell its format; None: it has no name.

    Raises:
        InputError: the file has none of the known forms, or is damaged. The error does not name the file.
    """
    if len(data) > MOST_BYTES:
        raise NoBoxes(f"is larger than {MOST_BYTES >> 20} MiB, the limit for files of other tools")
    head = bytes(data[:8])
    if head.startswith(NUMPY_MAGIC):
        return sources_of_arrays({"": loaded_array(data)})
    if head.startswith(ZIP_MAGIC):
        if b".npy" in bytes(data[:ARCHIVE_BYTES]):
            return sources_of_arrays(loaded_arrays(data))
        if (kind := foreign_kind(data)) is not None and "ZIP" in kind:
            raise InputError(kind)
        return sources_of_tables(*read_raw_tables(data))
    text = _FIRST_COMMENTS.sub(_blank, decoded_text(data)[0].lstrip("\ufeff"))
    if (fault := nul_fault(text)) is not None:
        raise InputError(fault)
    start = text.lstrip("\ufeff \t\r\n")
    if start.startswith("<"):
        if re.search(r"<mujoco[\s>/]", start[:20_000]):
            return [source_of_scene(text)]
        return _sources_of_markup(start)
    if start[:1] in ("{", "[") and not re.match(r"\[+\s*[A-Za-z]", start):
        try:
            value = _decoded_json(text)
        except InputError:
            if (python_value := python_values(start)) is None:
                if (sources := _sources_of_document(text, path) or _sources_of_printed(text)) is None:
                    raise
                return sources
            value = python_value
        if is_three_js(value):
            return [source_of_three_js(value)]
        if is_gltf(value):
            return [source_of_gltf(value)]
        if isinstance(value, dict) and value.get("type") == "FeatureCollection" and "features" in value:
            raise InputError("is a map (GeoJSON): petmjx looks for boxes with places and three sizes")
        if not (sources := _sources_of_value(value, "JSON")):
            raise NoBoxes(
                "holds no box"
                if value == []
                else "has no list of boxes: petmjx looks for objects with places and sizes"
            )
        return sources
    values = python_values(start) if is_printed_object(start) else None
    if sources := _sources_of_value(values, "Python's text"):
        return sources
    if (kind := foreign_kind(data)) is not None:
        raise NoBoxes(kind)
    if (printed := source_of_printed(text)) is not None:
        return [printed]
    if (kind := program_kind(start)) is not None:
        raise NoGeometry(kind)
    if (sources := _sources_of_printed(text)) is not None:
        return sources
    return _sources_of_document(text, path) or sources_of_tables(*read_raw_tables(data))


_FIRST_COMMENTS: Final = re.compile(r"\A(?:\s|(?://|;)[^\n]*|/\*.*?\*/)++(?=[{\[])", re.DOTALL)
"""Comments above a value of JSON5, JavaScript or EDN."""
_COMMENT: Final = re.compile(r'("(?:\\.|[^"\\\n])*+")|//[^\n]*+|/\*.*?(?:\*/|\Z)', re.DOTALL)
_LAST_COMMA: Final = re.compile(r'("(?:\\.|[^"\\\n])*+")|,(?=\s*+[}\]])')
"""``_COMMENT`` matches a comment. ``_LAST_COMMA`` matches a comma behind the last value of a list or object. Both
patterns also match each text in quotation marks as a whole, so that no comment or comma is matched inside it; such a
text is kept."""


def _blank(match: re.Match[str]) -> str:
    """The replacement of a comment or comma."""
    return match[1] if match.re.groups and match[1] else blanked(match[0])


def plain_json(data: bytes | bytearray) -> bytearray | None:
    """JSON in which blanks replace all comments and all commas behind last values. The result is None if the text has
    no such comments and commas, or is larger than ``MOST_BYTES``."""
    if len(data) > MOST_BYTES:
        return None
    plain = _plain_text(data.decode("utf-8", "surrogateescape")).encode("utf-8", "surrogateescape")
    return None if plain == data else bytearray(plain)


def _plain_text(text: str) -> str:
    return _LAST_COMMA.sub(_blank, _COMMENT.sub(_blank, text))


def _decoded_json(text: str) -> Any:
    """The value of JSON, also of JSON with comments and with commas behind last values.

    Raises:
        InputError: the text is damaged.
    """
    try:
        return decoded_json(text)
    except InputError:
        if (plain := _plain_text(text)) == text:
            raise
    return decoded_json(plain)


def _sources_of_value(value: Any, kind: str) -> list[BoxSource]:
    """The lists of boxes in a nested value. ``kind``: kind of the file, in words."""
    return [with_named_units(with_known_form(boxes, kind)) for boxes in box_lists(value)]


def _sources_of_document(text: str, path: Path | None) -> list[BoxSource] | None:
    """The lists of boxes in YAML or TOML; None if a text is neither.

    Raises:
        InputError: the text is damaged, or has no lists of boxes.
    """
    if (name := nested_format(text, path)) is None:
        return None
    try:
        value = value_of_toml(text) if name == "TOML" else value_of_yaml(text)
    except InputError:
        if name != "TOML" or (value := values_of_blocks(text)) is None:
            raise
        name = "INI"
    if not (sources := _sources_of_value(value, name)):
        raise NoGeometry(f"is {name} without a list of boxes: petmjx looks for objects with places and sizes")
    return sources


def _sources_of_printed(text: str) -> list[BoxSource] | None:
    """The lists of boxes in a text that a program has printed; None if there are none.

    Raises:
        InputError: the text is damaged.
    """
    value = printed_values(text)
    value = values_of_lines(text) if value is None else value
    if value is None and nested_format(text, None) != "TOML":
        value = values_of_blocks(text)
    return _sources_of_value(value, "printed text") or None


def _sources_of_markup(text: str) -> list[BoxSource]:
    """The lists of boxes in a web page or in XML.

    Raises:
        InputError: the text has no lists of boxes.
    """
    if re.search(r"<table[\s>]", text, re.IGNORECASE) and re.search(r"<t[dh][\s>]", text, re.IGNORECASE):
        return sources_of_tables(tables_of_page(text), "a web page (HTML)")
    if "HTML" in (kind := foreign_kind(text.encode()[:4096]) or ""):
        raise NoBoxes(kind)
    if not (sources := _sources_of_value(value_of_xml(text), "XML")):
        raise NoBoxes("is XML without a list of boxes: petmjx looks for elements with places and sizes")
    return [replace(source, form=X3D) for source in sources] if re.search(r"<X3D[\s>]", text) else sources


def sources_of_tables(raw_tables: Sequence[RawTable], kind: str) -> list[BoxSource]:
    """Turn tables into lists of boxes. Tables whose columns of sizes and places have the same names, or names with the
    same meanings, are joined into one list.

    Args:
        kind: kind of the file, in words.
    """
    groups: dict[tuple[str, ...], list[RawTable]] = {}
    unplaced = [table for table in raw_tables if table.title and are_unplaced(table.title.replace("_", " "))]
    n_unplaced = sum(len(table.rows) for table in unplaced) if len(unplaced) < len(raw_tables) else 0
    for table in raw_tables:
        if n_unplaced and table in unplaced:
            continue
        key = geometric_names(table.header) if table.has_header else table.header
        for other_key, (first, *_) in groups.items() if table.has_header else ():
            renamed = with_names_of(table, first)
            if geometric_names(renamed.header) == other_key:
                key, table = other_key, renamed
                break
        groups.setdefault(key, []).append(table)
    sources = []
    for tables in groups.values():
        several_sheets = len({table.title for table in tables}) > 1
        names = [
            "/".join(filter(None, (table.title if several_sheets else "", table.part)))
            for table in tables
            for _ in table.rows
        ]
        if names and all(LAYERS.intersection(words_of(name)) for name in names):
            names = [""] * len(names)
        joined = united(with_titles(tables))
        boxes = BoxList(joined, "", tuple(names), _containers_above(joined), left_out=tuple(not_placed(n_unplaced)))
        if boxes.has_places:
            boxes = _without_unplaced(boxes)
        sources.append(with_known_form(boxes, kind))
    return sorted(sources, key=lambda source: (source.boxes.has_places, len(source.boxes.table.rows)), reverse=True)


def _without_unplaced(boxes: BoxList) -> BoxList:
    """A list of boxes without the boxes that were not placed, according to a column such as "placed"."""
    kept = rows_with_boxes(boxes.table)
    left_out = (*boxes.left_out, *not_placed(len(boxes.table.rows) - len(kept)))
    return replace(rows_of(boxes, kept), left_out=left_out)


_SIZE_ABOVE: Final = re.compile(
    r"(?:pallet|palette|container|bin|truck|paleta|pal[eé]|bancale|carrier|kontener|contenedor|conteneur)[^\d]{0,40}?"
    r"(\d[\d.,]*)\s*[x×*]\s*(\d[\d.,]*)(?:\s*[x×*]\s*(\d[\d.,]*))?",
    re.IGNORECASE,
)


def _containers_above(table: RawTable) -> Mapping[str, Mapping[str, float]]:
    """The size of the carrier from the lines above a table, such as "Palette 1200 x 800". Above a table without a
    header, the size may also be a line of three numbers."""
    for line in table.above:
        numbers = [cell_number(part, table.decimal) for part in line.split()]
        if not table.has_header and len(numbers) == 3 and all(numbers):
            return {"": {str(axis): number.value for axis, number in enumerate(numbers) if number is not None}}
        if (match := _SIZE_ABOVE.search(line)) is not None:
            parts = [part for part in match.groups() if part]
            values = [number.value for part in parts if (number := cell_number(part, table.decimal)) is not None]
            if len(values) == len(parts):
                return {"": dict(zip(("length", "width", "height"), values, strict=False))}
    return {}
