"""Boxes in Python objects: py3dbp's packers, arrays and nested dictionaries. The module also reads boxes in text
that programs print: Python's dictionaries and lists, and the text of py3dbp and of bp3d, the program on which py3dbp is
modelled.

Source of the texts: ``Item.string`` (github.com/enzoruiz/3dbinpacking), ``Item.String`` (github.com/gedex/bp3d).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.plans.known_forms import PY3DBP, BoxSource, with_known_form
from petmjx.plans.nested_json import JsonLines, box_lists
from petmjx.plans.numpy_arrays import sources_of_arrays
from petmjx.plans.raw_tables import BoxList, RawTable, not_placed

_MOST_PRINTED: Final = 8 << 20
"""Largest text of Python values that is parsed, in characters. The syntax tree of Python values takes 100 times as much
memory as their text."""
_CONSTRUCTED: Final = re.compile(
    r"(?<![\w.])(?:[A-Za-z_]\w*\.){0,20}"
    r"(?:Decimal|float(?:32|64)|u?int(?:8|16|32|64)|array)\(([^()]*?)(?:, dtype=\w+)?\)"
)
"""A number or an array as Python shows it: "Decimal('60.0')", "np.float64(1.5)", "array([0, 0, 200])". In this pattern
and in the patterns below, the number of repetitions is limited, since otherwise the search in some texts would take
very long."""
_PRINTED_OBJECT: Final = re.compile(r"\[?\s*[A-Za-z_][\w.]*\(\s*[A-Za-z_]\w*=")
"""The beginning of an object with named fields as Python prints it: "Box(x=0, y=0, …)"."""
_NOT_FINITE: Final = re.compile(r"(?<![\w'\"])(-?(?:nan|inf))(?![\w'\"])")


def python_values(text: str) -> Any:
    """The dictionaries and lists in a text that Python has printed, one or several; None for any other text."""
    if not ("'" in text or _PRINTED_OBJECT.match(text)) or len(text) > _MOST_PRINTED:
        return None
    text = _NOT_FINITE.sub(r"'\1'", _CONSTRUCTED.sub(r"\1", text))
    try:
        return _value_of(ast.parse(text, mode="eval").body)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        pass
    values = JsonLines()
    try:
        for number, line in enumerate(text.splitlines(), start=1):
            if line.strip():
                values.append(_value_of(ast.parse(line.strip(), mode="eval").body))
                values.lines.append(number)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None
    return values


def is_printed_object(text: str) -> bool:
    """Whether a text begins with an object that Python has printed, such as a data class."""
    return _PRINTED_OBJECT.match(text) is not None


def _value_of(node: ast.expr) -> Any:
    """The value of an expression. A call with named arguments, such as "Box(x=0)", becomes an object whose fields are
    the arguments.

    Raises:
        ValueError: the expression is no value.
    """
    if isinstance(node, ast.Call) and node.keywords and not node.args:
        return {keyword.arg or "": _value_of(keyword.value) for keyword in node.keywords}
    if isinstance(node, ast.List | ast.Tuple):
        return [_value_of(member) for member in node.elts]
    if isinstance(node, ast.Dict):
        keys = [None if key is None else _value_of(key) for key in node.keys]
        return dict(zip(keys, map(_value_of, node.values), strict=True))
    return ast.literal_eval(node)


_ITEM_LINE: Final = re.compile(
    r"^\W{0,20}(?P<name>.{0,200}?)\((?P<width>[^x(),]{1,50})x(?P<height>[^x(),]{1,50})x(?P<depth>[^x(),]{1,50}),\s{0,9}"
    r"weight:\s{0,9}(?P<weight>[^)]{0,50})\)\s{0,9}pos\(\[?(?P<position>.{0,200}?)\]?\)\s{0,9}"
    r"rt\((?P<rotation_type>[^()]*)"
)
_BIN_LINE: Final = re.compile(
    r"^\W{0,20}(?P<name>.{0,200}?)\((?P<width>[\d.]{1,50})x(?P<height>[\d.]{1,50})x(?P<depth>[\d.]{1,50}),\s{0,9}max_weight"
)
_FIELD_LINE: Final = re.compile(
    r"^(name|partno|part no|color|position|rotation type|W\*H\*D|volume|weight)\s*:\s*(.*)$"
)
_ROTATIONS: Final = {letters: str(number) for number, letters in enumerate(("WHD", "HWD", "HDW", "DHW", "DWH", "WDH"))}
"""Letters in the name of a rotation, "RotationType_WHD" → its number."""
PY3DBP_COLUMNS: Final = ("name", "width", "height", "depth", "weight", "pos x", "pos y", "pos z", "rotation_type")


def source_of_printed(text: str) -> BoxSource | None:
    """The boxes in text that py3dbp or its fork has printed; None for any other text."""
    if not ("pos(" in text and "rt(" in text) and "W*H*D" not in text:
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
                lost.append((f"line {first_line}", "lacks sizes or coordinates"))
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
            turn = item["rotation_type"].strip()
            turn = _ROTATIONS.get(turn.rpartition("_")[2], turn)
            cells = (item["width"], item["height"], item["depth"], item["weight"], *triple, turn)
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
        elif ("pos(" in plain or re.match(r"=+>", plain)) and not unfitted:
            lost.append((f"line {number}", f"is no box as py3dbp prints it: {printable_name(plain)}"))
    end_fields()
    if not rows and not lost:
        return None
    if len(set(parts)) == 1:  # all boxes are in one bin, so there is one plan; other bins may be empty
        containers = {"": containers[parts[0]]} if parts[0] in containers else {}
        parts = [""] * len(parts)
    table = RawTable(PY3DBP_COLUMNS, rows, places, ".", lost=tuple(lost))
    boxes = BoxList(table, "", tuple(parts), containers, not_placed(fitted))
    return BoxSource(boxes, replace(PY3DBP, name="text printed by py3dbp"))


def _triple_cells(text: str) -> list[str]:
    """The three numbers of a printed position as text, so that a message can show a bad one."""
    plain = re.sub(r"Decimal\(\s*['\"]?([^'\")]*)['\"]?\s*\)", r"\1", text).strip("[]() ")
    return [part.strip() for part in plain.split(",")]


# Python objects.


def sources_of_object(value: Any) -> list[BoxSource]:
    """The boxes in a Python object: py3dbp's packer, bin or list of bins; an array; nested dictionaries and lists.

    Raises:
        InputError: the object holds no boxes.
    """
    value = _with_text_names(value)
    if isinstance(value, np.ndarray):
        return sources_of_arrays({"": value})
    if bins := _bins_of(value):
        value = {"bins": [_value_of_bin(holder) for holder in bins]}
    if isinstance(value, Mapping) and value and all(isinstance(inner, np.ndarray) for inner in value.values()):
        return sources_of_arrays(value)
    sources = [with_known_form(boxes, "Python values") for boxes in box_lists(value)]
    if not sources:
        raise InputError("holds no boxes: petmjx looks for objects with places and sizes")
    return sources


def _with_text_names(value: Any, depth: int = 0) -> Any:
    """A nested value in which all names of dictionaries are texts, as in JSON: 7 becomes "7"."""
    if depth > _DEEPEST_NAMES:
        return value
    if isinstance(value, Mapping):
        return {str(name): _with_text_names(inner, depth + 1) for name, inner in value.items()}
    if type(value) in (list, tuple):
        return [_with_text_names(inner, depth + 1) for inner in value]
    return value


_DEEPEST_NAMES: Final = 32
"""Boxes are not expected in dictionaries and lists that are nested more deeply than this."""


def _bins_of(value: Any) -> list[Any]:
    """The bins with items in an object of py3dbp (a packer or a bin), or in a list of such objects; empty for any other
    object."""
    if isinstance(value, Mapping | str | bytes | np.ndarray) or value is None:
        return []
    if isinstance(value, list | tuple):
        bins = [holder for inner in value for holder in _bins_of(inner)]
        return bins if value and all(_bins_of(inner) for inner in value[:3]) else []
    if isinstance(getattr(value, "bins", None), list):
        return [holder for holder in value.bins if getattr(holder, "items", None)]
    items = getattr(value, "items", None)
    return [value] if isinstance(items, list) and items and hasattr(items[0], "rotation_type") else []


def _value_of_bin(holder: Any) -> dict[str, Any]:
    """One of py3dbp's bins as a nested value."""
    items = [
        {name: vars(item)[name] for name in _ITEM_FIELDS if name in vars(item)} | {"position": [*item.position]}
        for item in holder.items
    ]
    of_bin = {name: vars(holder)[name] for name in _ITEM_FIELDS if name in vars(holder)}
    return {**of_bin, "items": items, "unfitted_items": [vars(item) for item in vars(holder).get("unfitted_items", ())]}


_ITEM_FIELDS: Final = ("name", "partno", "width", "height", "depth", "weight", "rotation_type")
