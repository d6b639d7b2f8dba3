"""Reads what other tools write (``BoxSource``): a file's bytes, an array or a Python object becomes lists of boxes.

A list comes with its form (``KnownForm``): the layout in which a tool writes boxes, and what is known about the meaning
of the columns in this layout, such as units and the vertical axis.

Sources of the forms: py3dbp (``Item.string``, ``get_dimension``; github.com/enzoruiz/3dbinpacking) and its fork with a
web API (github.com/jerry800416/3D-bin-packing), packingsolver's certificates, 3d-bin-container-packing's placements,
the solution file of D-Wave's example (github.com/dwave-examples/3d-bin-packing), packvium's results, MuJoCo's MJCF.
"""

from __future__ import annotations

import ast
import io
import math
import re
import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.file_kinds import foreign_kind
from petmjx.common.text import count_text, first_names, printable_name
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS, column_meanings, plain_text, words_of
from petmjx.plans.file_formats import NoBoxes
from petmjx.plans.nested_json import LAYERS, BoxList, JsonLines, box_lists, decoded_json, flattened
from petmjx.plans.raw_cells import cell_number, cell_text, decimal_of
from petmjx.plans.raw_tables import RawTable, computed_row, decoded_text, distinct_names, geometric_names, united
from petmjx.plans.workbooks import RawFile, check_archive, read_raw_tables, tables_of_page, value_of_xml


@dataclass(frozen=True, slots=True)
class KnownForm:
    """A form (the layout in which a tool writes boxes), and what is known about the meaning of its columns. If a field
    is empty, its value is unknown, and is later chosen by plausibility.

    Attributes:
        name: name of the form, in words.
        units: name of the unit of lengths (one of ``column_names.LENGTH_UNITS``).
        masses: name of the unit of masses (one of ``column_names.MASS_UNITS``).
        anchor: the point of a box that coordinates describe, such as "corner" or "centre".
        up: the vertical axis, "y" or "z".
        sizes: which sizes of a box the columns have: "placed": those of the box as it is placed; "item": those of the
            box before it is turned.
        rule: how a column of rotations turns a box (a key of ``readings.ROTATION_RULES``).
    """

    name: str
    units: str = ""
    masses: str = ""
    anchor: str = ""
    up: str = ""
    sizes: str = ""
    rule: str = ""


@dataclass(frozen=True, eq=False)
class BoxSource:
    """The boxes of a file, before the meaning of their columns is known.

    Attributes:
        boxes: list of boxes with their places.
        form: the form of the list, with what the form states about units, coordinates and sizes.
        notes: lines for the user about how the file was read.
    """

    boxes: BoxList
    form: KnownForm
    notes: tuple[str, ...] = ()


MOST_BYTES: Final = 32 << 20
"""Largest size of a file of another tool, in bytes. A file of this size holds about 200,000 boxes. As Python values,
the boxes take ten times as much memory as the file."""

PY3DBP: Final = KnownForm("py3dbp", anchor="corner", rule="py3dbp", sizes="item")
_UPRIGHT: Final = KnownForm("", anchor="corner", up="z", sizes="placed")
PACKINGSOLVER: Final = replace(_UPRIGHT, name="packingsolver's certificate")
JAVA: Final = replace(_UPRIGHT, name="3d-bin-container-packing")
D_WAVE: Final = KnownForm("the solution of D-Wave's example", anchor="corner", sizes="placed", up="z")
PACKVIUM: Final = replace(_UPRIGHT, name="packvium's result")
BENCHMARK: Final = KnownForm("centres and dimensions as placed", anchor="centre", up="z", sizes="placed")
SCENE: Final = KnownForm("a MuJoCo scene (MJCF)", "m", "kg", "centre", "z", "placed")
OWN: Final = KnownForm("petmjx's table", "mm", "kg", "corner", "z", "item", "swap")
BED_BPP: Final = KnownForm("BED-BPP", anchor="corner", up="z", sizes="item", rule="swap")
ARRAY: Final = KnownForm("an array of numbers", anchor="corner", up="z")
POSES: Final = KnownForm("poses", up="z")


def sources_of_bytes(data: bytes | bytearray, path: Path) -> list[BoxSource]:
    """The lists of boxes in a file's bytes. The list that most likely describes a plan comes first. The boxes of a list
    may lack places or sizes.

    Raises:
        InputError: the file has none of the known forms, or is damaged. The error does not name the file.
    """
    if len(data) > MOST_BYTES:
        raise NoBoxes(f"is larger than {MOST_BYTES >> 20} MiB, too large for a file of another tool")
    head = bytes(data[:8])
    if head.startswith(b"\x93NUMPY"):
        return _sources_of_arrays({"": _loaded_array(data)})
    if head.startswith(b"PK\x03\x04"):
        if b".npy" in bytes(data[: 1 << 16]):
            return _sources_of_arrays(_loaded_arrays(data))
        if (kind := foreign_kind(data)) is not None and "ZIP" in kind:
            raise InputError(kind)
        return sources_of_tables(read_raw_tables(data))
    text, _ = decoded_text(data)
    start = text.lstrip("\ufeff \t\r\n")
    if start.startswith("<"):
        if re.search(r"<mujoco[\s>/]", start[:20_000]):
            return [_scene(text)]
        return _sources_of_markup(start)
    if start[:1] in ("{", "[") and not re.match(r"\[\s*[A-Za-z]", start):
        try:
            value = decoded_json(start)
        except InputError as error:
            if (printed_values := _python_values(start)) is not None:
                value = printed_values
            elif start.startswith("{") or "nested" in str(error):  # another reader's error explains the fault better
                raise NoBoxes(str(error)) from None
            else:
                raise
        sources = [_with_named_units(_with_known_form(boxes)) for boxes in box_lists(value)]
        if not sources:
            raise NoBoxes("has no list of boxes: petmjx looks for objects with places and sizes")
        return sources
    if (kind := foreign_kind(data)) is not None:
        raise NoBoxes(kind)
    if (printed := _printed(text)) is not None:
        return [printed]
    return sources_of_tables(read_raw_tables(data))


def _sources_of_markup(text: str) -> list[BoxSource]:
    """The lists of boxes in a web page or in XML.

    Raises:
        InputError: there are none.
    """
    kind = foreign_kind(text.encode()[:4096]) or "is XML of another kind"
    if re.search(r"<table[\s>]", text, re.IGNORECASE) and re.search(r"<t[dh][\s>]", text, re.IGNORECASE):
        return sources_of_tables(RawFile(tables_of_page(text), "a web page (HTML)"))
    try:
        lists = box_lists(value_of_xml(text))
    except InputError:
        lists = []
    if not lists:
        raise NoBoxes(kind)
    return [_with_named_units(_with_known_form(boxes, "XML")) for boxes in lists]


def sources_of_tables(file: RawFile) -> list[BoxSource]:
    """Turn tables into lists of boxes. Tables with the same header are joined into one list."""
    groups: dict[tuple[str, ...], list[RawTable]] = {}
    for table in file.tables:
        key = geometric_names(table.header) if table.has_header else table.header
        groups.setdefault(key, []).append(table)
    sources = []
    for tables in groups.values():
        several_sheets = len({table.title for table in tables}) > 1
        names = [
            "/".join(filter(None, (table.title if several_sheets else "", table.part)))
            for table in tables
            for _ in table.rows
        ]
        if several_sheets:
            tables = [replace(table, places=[f"{table.title}, {place}" for place in table.places]) for table in tables]
        if names and all(LAYERS.intersection(words_of(name)) for name in names):
            names = [""] * len(names)
        joined = united(tables)
        boxes = BoxList(joined, "", tuple(names), _containers_above(joined))
        sources.append(_with_known_form(boxes, file.kind))
    return sorted(sources, key=lambda source: (source.boxes.has_places, len(source.boxes.table.rows)), reverse=True)


_SIZE_ABOVE: Final = re.compile(
    r"(?:pallet|palette|container|bin|truck|paleta|pal[eé]|bancale|carrier|kontener|contenedor|conteneur)[^\d]{0,40}?"
    r"(\d[\d.,]*)\s*[x×*]\s*(\d[\d.,]*)(?:\s*[x×*]\s*(\d[\d.,]*))?",
    re.IGNORECASE,
)


def _containers_above(table: RawTable) -> Mapping[str, Mapping[str, float]]:
    """The size of the carrier from the lines above a table, such as "Palette 1200 x 800"."""
    for line in table.above:
        if (match := _SIZE_ABOVE.search(line)) is not None:
            numbers = [cell_number(part, table.decimal) for part in match.groups() if part]
            if all(numbers):
                values = [number.value for number in numbers if number is not None]
                return {"": dict(zip(("length", "width", "height"), values, strict=False))}
    return {}


def _with_known_form(boxes: BoxList, kind: str = "JSON") -> BoxSource:
    """A list of boxes with the form that the names of its fields imply. Rows of totals are removed."""
    boxes = _without_totals(boxes)
    names = {name.lower() for name in boxes.table.header}
    plain = {re.sub(r"[^a-z0-9]", "", name) for name in names}
    around = {str(name).lower() for name in boxes.around}
    if {"type", "id", "bin", "lx", "ly", "lz"} <= names:
        return _certificate(boxes)
    if any(name.startswith("x'") or name.endswith("x'") for name in names):
        return _of_d_wave(boxes)
    if "stackable.dx" in names:
        return BoxSource(boxes, JAVA)
    if "rotationtype" in plain and (names & {"width", "whd[0]", "whd"}):
        boxes_only, left = _without_corner_posts(boxes)
        lines = (f"{count_text(left, 'corner post is', 'corner posts are')} left out",) if left else ()
        name = "py3dbp's web API" if "fititem" in boxes.path.lower() else f"py3dbp ({kind})"
        return BoxSource(boxes_only, replace(PY3DBP, name=name), lines)
    if {"item_type", "dimensions.length", "position.x", "orientation"} <= names:
        return BoxSource(boxes, PACKVIUM)
    of_benchmark = {"position.x", "dimensions.width", "dimensions.depth", "dimensions.height", "rotation"} <= names
    if of_benchmark and names & {"sku_id", "sku", "skuid"} and "container" in around:
        return BoxSource(boxes, BENCHMARK)
    if {"flb_coordinates[0]", "orientation"} <= names:
        return BoxSource(boxes, BED_BPP)
    if {"length_mm", "width_mm", "height_mm", "x_mm", "y_mm", "z_mm"} <= names:
        return BoxSource(boxes, OWN)
    if not boxes.table.has_header:
        return BoxSource(boxes, ARRAY)
    if "matrix" in boxes.kinds or any("matrix" in name or "pose" in name or "transform" in name for name in names):
        return BoxSource(boxes, POSES)
    return BoxSource(boxes, KnownForm(kind))


def _with_named_units(source: BoxSource) -> BoxSource:
    """A list of boxes with the units that fields around it give, as in "units": {"length": "in", "weight": "lb"}."""
    words = {
        plain_text(value).strip(" .").lower()
        for name, value in flattened(source.boxes.around).items()
        if isinstance(value, str) and {"unit", "units"}.intersection(words_of(name))
    }
    lengths, masses = words & LENGTH_UNITS.keys(), words & MASS_UNITS.keys()
    form = source.form
    if len(lengths) == 1 and not form.units:
        form = replace(form, units=lengths.pop())
    if len(masses) == 1 and not form.masses:
        form = replace(form, masses=masses.pop())
    return replace(source, form=form)


def _without_totals(boxes: BoxList) -> BoxList:
    """Remove the last row of each part (plan) of a list if this row has the sums or means of the part's other rows."""
    table = boxes.table
    if not table.has_header:
        return boxes
    parts: dict[str, list[int]] = {}
    for index in range(len(table.rows)):
        parts.setdefault(boxes.parts[index] if boxes.parts else "", []).append(index)
    computed = {rows[-1]: what for rows in parts.values() if (what := computed_row(table, rows))}
    if not computed:
        return boxes
    without_totals = rows_of(boxes, [index for index in range(len(table.rows)) if index not in computed])
    notes = [
        f"{table.places[index]} has {what} of the rows above it, and is left out" for index, what in computed.items()
    ]
    return replace(without_totals, table=replace(without_totals.table, notes=(*table.notes, *notes)))


def _without_corner_posts(boxes: BoxList) -> tuple[BoxList, int]:
    """Remove the posts that the fork of py3dbp puts into the corners of its container. Also returns their number."""
    if "type" not in boxes.table.header:
        return boxes, 0
    kinds = boxes.table.column("type")
    box_rows = [index for index, kind in enumerate(kinds) if kind != "corner"]
    return (rows_of(boxes, box_rows), len(kinds) - len(box_rows)) if box_rows else (boxes, 0)


def rows_of(boxes: BoxList, kept: Sequence[int]) -> BoxList:
    """The same list of boxes, with only the rows at the indices ``kept``."""
    table = replace(
        boxes.table,
        rows=[boxes.table.rows[index] for index in kept],
        places=[boxes.table.places[index] for index in kept],
    )
    return replace(boxes, table=table, parts=tuple(boxes.parts[index] for index in kept) if boxes.parts else ())


def _certificate(boxes: BoxList) -> BoxSource:
    """The boxes of packingsolver's certificate. Rows of type ITEM are boxes. A row of type BIN stands for one
    or several equal containers; the column COPIES has their number."""
    table = boxes.table
    upper = {name.upper(): table.header.index(name) for name in table.header}
    kinds = [cell_text(row[upper["TYPE"]]).upper() for row in table.rows]
    items = [index for index, kind in enumerate(kinds) if kind not in ("BIN", "STACK")]
    containers: dict[str, Mapping[str, float]] = {}
    notes = []
    for row, kind in zip(table.rows, kinds, strict=True):
        if kind != "BIN":
            continue
        sizes = [cell_number(row[upper[name]], table.decimal) for name in ("LX", "LY", "LZ")]
        if all(sizes):
            containers[cell_text(row[upper["BIN"]])] = {
                axis: number.value for axis, number in zip("xyz", sizes, strict=True) if number is not None
            }
        copies = cell_number(row[upper["COPIES"]]) if "COPIES" in upper else None
        if copies is not None and copies.value > 1:
            notes.append(
                f"container {cell_text(row[upper['BIN']])} stands for {copies.value:g} alike, and is read once"
            )
    item_boxes = rows_of(boxes, items)
    return BoxSource(replace(item_boxes, containers=containers), PACKINGSOLVER, tuple(notes))


def _of_d_wave(boxes: BoxList) -> BoxSource:
    """The boxes in the solution of D-Wave's example. The bins in such a file stand one behind the other along x, so the
    boxes of each bin are moved to x = 0."""
    dashes = re.compile(r"^[-=]{2,}$")
    box_lines = [
        index
        for index, row in enumerate(boxes.table.rows)
        if not all(cell is None or dashes.match(str(cell)) for cell in row)
    ]
    boxes = rows_of(boxes, box_lines)
    table = boxes.table
    x = next((index for index, name in enumerate(table.header) if name.strip().lower() == "x"), None)
    bins = next((index for index, name in enumerate(table.header) if name.lower().startswith("bin")), None)
    if x is None or bins is None or len({row[bins] for row in table.rows}) < 2:
        return BoxSource(boxes, D_WAVE)
    first: dict[Any, float] = {}
    for row in table.rows:
        number = cell_number(row[x], table.decimal)
        if number is not None:
            first[row[bins]] = min(first.get(row[bins], np.inf), number.value)
    rows = []
    for row in table.rows:
        number = cell_number(row[x], table.decimal)
        moved = row[x] if number is None else number.value - first[row[bins]]
        rows.append((*row[:x], moved, *row[x + 1 :]))
    note = "bins stand one behind the other along x: each is moved to x = 0"
    return BoxSource(replace(boxes, table=replace(table, rows=rows)), D_WAVE, (note,))


# Text that Python prints.

_MOST_PRINTED: Final = 8 << 20
"""Largest text of Python values that is parsed, in characters. Their syntax tree takes 100 times as much memory."""
_CONSTRUCTED: Final = re.compile(
    r"\b(?:[A-Za-z_]\w*\.)*(?:Decimal|float(?:32|64)|u?int(?:8|16|32|64)|array)\(([^()]*?)(?:, dtype=\w+)?\)"
)
"""A number or an array as Python shows it: "Decimal('60.0')", "np.float64(1.5)", "array([0, 0, 200])"."""
_NOT_FINITE: Final = re.compile(r"(?<![\w'\"])(-?(?:nan|inf))(?![\w'\"])")


def _python_values(text: str) -> Any:
    """The dictionaries and lists in a text that Python has printed, one or several; None for any other text."""
    if "'" not in text or len(text) > _MOST_PRINTED:
        return None
    text = _NOT_FINITE.sub(r"'\1'", _CONSTRUCTED.sub(r"\1", text))
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        pass
    values = JsonLines()
    try:
        for number, line in enumerate(text.splitlines(), start=1):
            if line.strip():
                values.append(ast.literal_eval(line))
                values.lines.append(number)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None
    return values


# Text that py3dbp prints.

_ITEM_LINE: Final = re.compile(
    r"^\W*(?P<name>.*?)\((?P<width>[^x(),]+)x(?P<height>[^x(),]+)x(?P<depth>[^x(),]+),\s*weight:\s*(?P<weight>[^)]*)\)"
    r"\s*pos\(\[?(?P<position>.*?)\]?\)\s*rt\((?P<rotation_type>[^)]*)\)"
)
_BIN_LINE: Final = re.compile(
    r"^[:\W]*(?P<name>.*?)\((?P<width>[\d.]+)x(?P<height>[\d.]+)x(?P<depth>[\d.]+),\s*max_weight"
)
_FIELD_LINE: Final = re.compile(
    r"^(name|partno|part no|color|position|rotation type|W\*H\*D|volume|weight)\s*:\s*(.*)$"
)
_PRINTED: Final = ("name", "width", "height", "depth", "weight", "pos x", "pos y", "pos z", "rotation_type")


def _printed(text: str) -> BoxSource | None:
    """The boxes in text that py3dbp or its fork has printed; None for any other text."""
    if "pos(" not in text and "W*H*D" not in text:
        return None
    rows: list[tuple[Any, ...]] = []
    places: list[str] = []
    parts: list[str] = []
    lost: list[tuple[str, str]] = []
    containers: dict[str, Mapping[str, float]] = {}
    part, unfitted, fitted = "", False, 0
    fields: dict[str, str] = {}
    first_line = 0
    bins = 0

    def end_fields() -> None:
        if "position" in fields and not unfitted:
            sizes = fields.get("W*H*D", "").split("*")
            triple = _triple_cells(fields["position"])
            name = fields.get("partno") or fields.get("part no") or fields.get("name")
            if len(sizes) == 3 and len(triple) == 3:
                rows.append((name, *sizes, fields.get("weight"), *triple, fields.get("rotation type")))
                places.append(f"line {first_line}")
                parts.append(part)
            else:
                lost.append((f"line {first_line}", "has no three sizes and coordinates"))
        fields.clear()

    for number, line in enumerate(text.splitlines(), start=1):
        plain = line.strip()
        if re.match(r"\W*UNFIT", plain, re.IGNORECASE):
            end_fields()
            unfitted = True
        elif re.match(r"\W*FITTED", plain, re.IGNORECASE):
            unfitted = False
        elif (bin_line := _BIN_LINE.match(plain)) is not None:
            end_fields()
            bins += 1
            part, unfitted = bin_line["name"].strip() or str(bins), False
            if part in containers:
                part = f"{part} ({bins})"
            containers[part] = {axis: float(bin_line[axis]) for axis in ("width", "height", "depth")}
        elif (item := _ITEM_LINE.match(plain)) is not None:
            fitted += unfitted
            if unfitted:
                continue
            triple = _triple_cells(item["position"])
            if len(triple) != 3:
                lost.append((f"line {number}", f"pos must be three numbers, got {len(triple)}"))
                continue
            cells = (item["width"], item["height"], item["depth"], item["weight"], *triple, item["rotation_type"])
            rows.append((item["name"].strip(), *(cell.strip() or None for cell in cells)))
            places.append(f"line {number}")
            parts.append(part)
        elif (entry := _FIELD_LINE.match(plain)) is not None:
            if entry[1] in ("name", "partno", "part no") and fields:
                end_fields()
            first_line = first_line if fields else number
            fields[entry[1]] = entry[2].strip()
        elif plain.startswith("***"):
            end_fields()
        elif "pos(" in plain and not unfitted:
            lost.append((f"line {number}", f"is no box as py3dbp prints it: {printable_name(plain)}"))
    end_fields()
    if not rows and not lost:
        return None
    parts = parts if len(set(parts)) > 1 else [""] * len(parts)
    if not any(parts) and containers:
        containers = {"": next(iter(containers.values()))}
    table = RawTable(_PRINTED, rows, places, ".", lost=tuple(lost))
    left = (f"{count_text(fitted, 'box is', 'boxes are')} not placed, and left out",) if fitted else ()
    return BoxSource(BoxList(table, "", tuple(parts), containers, left), replace(PY3DBP, name="text printed by py3dbp"))


def _triple_cells(text: str) -> list[str]:
    """The three numbers of a printed position as text, so that a message can show a bad one."""
    plain = re.sub(r"Decimal\(\s*['\"]?([^'\")]*)['\"]?\s*\)", r"\1", text).strip("[]() ")
    return [part.strip() for part in plain.split(",")]


# NumPy arrays.


_MOST_HEADER: Final = 10_000
"""Largest length of an array's header in bytes, as in NumPy."""


def _loaded_array(data: bytes | bytearray, name: str = "") -> Any:
    """Load an array from .npy bytes. Before memory is reserved, the size in the array's header is compared with the
    number of bytes.

    Args:
        name: name of the array in its archive, for error messages; "" if the file is not an archive but a single array.
    """
    prefix = f"{printable_name(name)} " if name else ""
    try:
        dtype, shape, begin = _array_header(data)
    except (ValueError, TypeError, SyntaxError, KeyError, IndexError, struct.error, MemoryError, RecursionError):
        raise InputError(f"{prefix}is no whole NumPy array: its header cannot be read") from None
    if dtype.hasobject:
        raise InputError(f"{prefix}is an array of Python objects, which may hold code, and is not read")
    n_bytes = len(data) - begin
    expected = math.prod(shape) * dtype.itemsize
    if expected != n_bytes:
        raise InputError(
            f"{prefix}is no whole NumPy array: its header says {shape} of {dtype.str}, {expected:,} bytes, "
            f"but {count_text(n_bytes, 'byte follows', 'bytes follow')}"
        )
    if math.prod(max(extent, 1) for extent in shape) > MOST_BYTES:
        raise InputError(f"{prefix}is an array {shape} without values")
    try:
        return np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError, tokenize.TokenError) as error:
        raise InputError(f"{prefix}is not a whole NumPy array: {error}") from error


def _array_header(data: bytes | bytearray) -> tuple[np.dtype[Any], tuple[int, ...], int]:
    """The type, the shape and the position of the first value in .npy bytes (NumPy's format, versions 1 to 3).

    Raises:
        ValueError, TypeError, SyntaxError, KeyError, IndexError, struct.error: the header is damaged.
    """
    width = "<H" if data[6] == 1 else "<I"
    first = 8 + struct.calcsize(width)
    (length,) = struct.unpack_from(width, data, 8)
    if length > _MOST_HEADER or first + length > len(data) or not data.startswith(b"\x93NUMPY"):
        raise ValueError("header")
    fields = ast.literal_eval(bytes(data[first : first + length]).decode("utf-8" if data[6] > 2 else "latin1"))
    shape = fields["shape"]
    if not isinstance(shape, tuple) or any(type(extent) is not int or extent < 0 for extent in shape):
        raise ValueError("shape")
    return np.lib.format.descr_to_dtype(fields["descr"]), shape, first + length


def _loaded_arrays(data: bytes | bytearray) -> dict[str, Any]:
    check_archive(data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist() if name.endswith(".npy")}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:
        raise InputError(f"is not a whole archive of NumPy arrays: {error}") from error
    return {name.removesuffix(".npy"): _loaded_array(member, name) for name, member in members.items()}


def _sources_of_arrays(arrays: Mapping[str, Any]) -> list[BoxSource]:
    """Turn arrays into lists of boxes. There may be one array with a row per box, or several arrays that each have a
    row per box.

    Raises:
        InputError: no array has rows that are boxes.
    """
    row_arrays = {name: array for name, array in arrays.items() if getattr(array, "ndim", 0) >= 1}
    for name, array in row_arrays.items():
        if array.dtype.names:
            header = tuple(array.dtype.names)
            rows = [tuple(_cell_of(value) for value in row) for row in array.ravel().tolist()]
            table = RawTable(header, rows, [f"row {index}" for index in range(len(rows))], title=name)
            return [_with_known_form(BoxList(table, name, ("",) * len(rows)), "a NumPy array")]
    containers = _containers_in(arrays)
    columns = {
        name: array
        for name, array in row_arrays.items()
        if (array.ndim <= 2 or array.shape[1:] in ((4, 4), (3, 4))) and not _is_container(name)
    }
    lengths = Counter(len(array) for array in columns.values())
    if len(columns) > 1 and lengths and column_names_known(columns):
        n_rows = lengths.most_common(1)[0][0]
        header_list: list[str] = []
        stacked: list[Any] = []
        for name, array in columns.items():
            if len(array) != n_rows:
                continue
            if array.ndim == 3:
                header_list.append(name)
                stacked.append(array.tolist())
                continue
            flat = array.reshape(n_rows, -1)
            header_list += [name] if array.ndim == 1 else [f"{name}[{index}]" for index in range(flat.shape[1])]
            stacked += [flat[:, index].tolist() for index in range(flat.shape[1])]
        rows = list(zip(*stacked, strict=True))
        table = RawTable(tuple(header_list), rows, [f"row {index}" for index in range(n_rows)])
        return [_with_known_form(BoxList(table, "", ("",) * n_rows, containers), "NumPy arrays")]
    sources = []
    for name, array in row_arrays.items():
        if _is_container(name) or array.dtype.kind not in "fiu":
            continue
        if array.ndim == 3 and array.shape[1:] in ((4, 4), (3, 4)):
            rows = [(matrix,) for matrix in array.tolist()]
            table = RawTable(("matrix",), rows, [f"row {index}" for index in range(len(rows))], title=name)
            sources.append(BoxSource(BoxList(table, name, ("",) * len(rows), containers), POSES))
            continue
        if array.shape[1:] == (2, 3):  # sizes and places, or two corners, of each box
            array = array.reshape(len(array), 6)
        plans = array if array.ndim == 3 else array[None] if array.ndim == 2 else None
        if plans is None or not 6 <= plans.shape[2] <= 64:
            continue
        rows, places, parts = [], [], []
        for number, plan in enumerate(plans.tolist()):
            used = [index for index, row in enumerate(plan) if any(row)]
            for index in range(used[-1] + 1 if used else 0):  # arrays of fixed length end with rows of zeros
                rows.append(tuple(plan[index]))
                places.append(f"row {index}" if array.ndim == 2 else f"plan {number}, row {index}")
                parts.append("" if array.ndim == 2 else str(number))
        if len(row_arrays) > 1:
            parts = ["/".join(filter(None, (name, part))) for part in parts]
        header = tuple(f"column {index}" for index in range(plans.shape[2]))
        table = RawTable(header, rows, places, title=name, has_header=False)
        sources.append(BoxSource(BoxList(table, name, tuple(parts), containers), ARRAY))
    if not sources:
        shapes = ", ".join(f"{name or 'array'} {getattr(array, 'shape', ())}" for name, array in arrays.items())
        raise InputError(f"holds no array of boxes, whose shape must be (n, 6 to 64): {printable_name(shapes)}")
    return _as_plans(sources)


def _as_plans(sources: Sequence[BoxSource]) -> list[BoxSource]:
    """Lists of boxes, longest first. Lists with the same columns are joined into one list of several plans."""
    groups: dict[tuple[str, ...], list[BoxSource]] = {}
    for source in sources:
        groups.setdefault(source.boxes.table.header, []).append(source)
    joined = []
    for group in groups.values():
        first = group[0]
        tables = [source.boxes.table for source in group]
        several = len(group) > 1
        places = [f"{table.title}, {place}" if several else place for table in tables for place in table.places]
        table = replace(tables[0], rows=[row for table in tables for row in table.rows], places=places)
        parts = tuple(part for source in group for part in source.boxes.parts)
        joined.append(replace(first, boxes=replace(first.boxes, table=table, parts=parts)))
    return sorted(joined, key=lambda source: len(source.boxes.table.rows), reverse=True)


def column_names_known(columns: Mapping[str, Any]) -> bool:
    """Whether the names of arrays are known names of sizes and places."""
    names = [name if array.ndim == 1 else f"{name}[0]" for name, array in columns.items()]
    kinds = {meaning.kind for meaning in column_meanings(names) if meaning is not None}
    posed = any(array.ndim == 3 for array in columns.values())
    return (posed or bool(kinds & {"position", "low"})) and bool(kinds & {"size", "high"})


def _cell_of(value: Any) -> Any:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _is_container(name: str) -> bool:
    return bool(re.search(r"bin|container|pallet", name, re.IGNORECASE)) and not re.search(r"id", name, re.IGNORECASE)


def _containers_in(arrays: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    for name, array in arrays.items():
        if _is_container(name) and getattr(array, "size", 0) == 3:
            return {"": {str(axis): float(value) for axis, value in enumerate(np.ravel(array))}}
    return {}


# Scenes.

_PALLET: Final = re.compile(r"pallet|palette|carrier|floor|ground|table|deck|wall|robot|gripper", re.IGNORECASE)


def _scene(text: str) -> BoxSource:
    """The boxes of a MuJoCo scene: free bodies whose only colliding geom is a box. MuJoCo itself parses the text.

    Raises:
        InputError: MuJoCo cannot parse the text, a free body is not a single box, or there are no boxes. Bodies that
            are named as pallets are ignored.
    """
    import mujoco  # MuJoCo itself interprets all of MJCF: defaults, angles, densities

    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        text = " ".join(str(error).split())
        number = re.search(r"[Ll]ine(?: number)?[ =](\d+)", text)
        line = "" if number is None else f"line {number[1]}: "
        raise InputError(f"{line}is a MuJoCo scene that MuJoCo refuses: {text}") from None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rows, places, pallets = [], [], 0
    other_bodies: list[str] = []
    for body in range(1, model.nbody):
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        if not any(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE for joint in joints):
            continue
        name = model.body(body).name or f"body {body}"
        shapes = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
        solid = [shape for shape in shapes if model.geom_contype[shape] or model.geom_conaffinity[shape]] or list(
            shapes
        )
        if _PALLET.search(name):
            pallets += 1
            continue
        if len(solid) != 1 or model.geom_type[solid[0]] != mujoco.mjtGeom.mjGEOM_BOX:
            other_bodies.append(name)
            continue
        shape = solid[0]
        size = 2 * model.geom_size[shape]
        matrix = np.eye(4)
        matrix[:3, :3] = data.geom_xmat[shape].reshape(3, 3)
        matrix[:3, 3] = data.geom_xpos[shape]
        rows.append((name, *map(float, size), matrix.tolist(), float(model.body_mass[body])))
        places.append(f"body {name}")
    if other_bodies:
        raise InputError(
            f"is a MuJoCo scene in which these free bodies are not single boxes: {first_names(other_bodies)}"
        )
    if not rows:
        raise InputError("is a MuJoCo scene in which no free body consists of exactly one box geom")
    notes = []
    if pallets:
        notes.append(f"{count_text(pallets, 'body', 'bodies')} named as a pallet or floor left out")
    table = RawTable(("name", "size_x", "size_y", "size_z", "matrix", "mass"), rows, places)
    return BoxSource(BoxList(table, "", ("",) * len(rows)), SCENE, tuple(notes))


# Python objects.


def sources_of_object(value: Any) -> list[BoxSource]:
    """The boxes in a Python object: py3dbp's packer, bin or list of bins; an array; nested dictionaries and lists.

    Raises:
        InputError: the object holds no boxes.
    """
    if isinstance(value, np.ndarray):
        return _sources_of_arrays({"": value})
    bins = _bins_of(value)
    if bins:
        return [_of_bins(bins)]
    if isinstance(value, Mapping) and value and all(isinstance(inner, np.ndarray) for inner in value.values()):
        return _sources_of_arrays(value)
    sources = [_with_known_form(boxes, "Python values") for boxes in box_lists(value)]
    if not sources:
        raise InputError("holds no boxes: petmjx looks for objects with places and sizes")
    return sources


def sources_of_frame(frame: Any) -> list[BoxSource]:
    """The boxes of a data frame whose columns do not have petmjx's names. Rows are numbered from 0.

    Raises:
        NoBoxes: the frame is not a table.
        InputError: two columns have the same known name.
    """
    try:
        if hasattr(frame, "iloc") and hasattr(frame, "columns"):
            header = tuple(str(name) for name in frame.columns)
            rows = [tuple(_plain(cell) for cell in row) for row in frame.itertuples(index=False, name=None)]
        else:
            import pyarrow as pa

            table = pa.table(frame)
            header = tuple(table.column_names)
            rows = list(zip(*(column.to_pylist() for column in table.columns), strict=True))
    except Exception as error:  # for an object that is no table, Arrow may raise any exception
        raise NoBoxes(f"is no table: {type(error).__name__}") from None
    places = [f"row {number}" for number in range(len(rows))]
    raw = RawTable(tuple(distinct_names(header)), rows, places, decimal_of(rows))
    return [_with_known_form(BoxList(raw, "", ("",) * len(rows)), "a data frame")]


def _plain(cell: Any) -> Any:
    """A cell of pandas as a Python value; None if it is missing."""
    cell = cell.item() if isinstance(cell, np.generic) else cell
    is_missing = type(cell).__name__ in _MISSING or (isinstance(cell, float) and np.isnan(cell))
    return None if is_missing else cell


_MISSING: Final = ("NoneType", "NAType", "NaTType")
"""Names of the types of missing cells. Comparing with pandas' types would need an import of pandas."""


def _bins_of(value: Any) -> list[Any]:
    """The bins among py3dbp's objects; empty for any other object."""
    if isinstance(value, Mapping | str | bytes | np.ndarray) or value is None:
        return []
    if isinstance(value, list | tuple):
        bins = [holder for inner in value for holder in _bins_of(inner)]
        return bins if value and all(_bins_of(inner) for inner in value[:3]) else []
    if isinstance(getattr(value, "bins", None), list):
        return [holder for holder in value.bins if getattr(holder, "items", None)]
    items = getattr(value, "items", None)
    if (
        isinstance(items, list)
        and items
        and all(hasattr(items[0], name) for name in ("position", "rotation_type", "width"))
    ):
        return [value]
    return []


def _of_bins(bins: Sequence[Any]) -> BoxSource:
    rows, places, parts = [], [], []
    containers: dict[str, Mapping[str, float]] = {}
    left = 0
    for number, holder in enumerate(bins, start=1):
        name = str(getattr(holder, "name", None) or getattr(holder, "partno", None) or number)
        part = name if len(bins) == 1 or name not in containers else f"{name} ({number})"
        containers[part] = {axis: float(getattr(holder, axis)) for axis in ("width", "height", "depth")}
        left += len(getattr(holder, "unfitted_items", None) or ())
        for index, item in enumerate(holder.items):
            position = list(item.position)
            label = getattr(item, "name", None) or getattr(item, "partno", None) or ""
            cells = (item.width, item.height, item.depth, getattr(item, "weight", None), *position, item.rotation_type)
            rows.append((str(label), *(cell_triple_value(cell) for cell in cells)))
            places.append(f"bin {name}, item {index}")
            parts.append(part)
    table = RawTable(_PRINTED, rows, places)
    lines = (f"{count_text(left, 'box is', 'boxes are')} not placed, and left out",) if left else ()
    return BoxSource(BoxList(table, "", tuple(parts), containers, lines), replace(PY3DBP, name="py3dbp's objects"))


def cell_triple_value(value: Any) -> Any:
    """A number of a Python object as a float. Other values are returned unchanged."""
    number = cell_number(value)
    return value if number is None else number.value
