"""Finds boxes nested anywhere in JSON, NumPy arrays or Python objects, and turns lists of boxes into raw tables.

A list of boxes may be a list (or an object) of objects with the same fields, an object of lists, or a list of lists of
numbers. Fields inside fields are named by their path: ``position.x``, ``stackable.dx``, ``WHD[0]``. The objects around
a list give the name of its plan and its container.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.plans.column_names import ColumnMeaning, column_meanings, word_set, words_of
from petmjx.plans.json_reader import any_integer
from petmjx.plans.raw_cells import cell_number, cell_text, decimal_of
from petmjx.plans.raw_tables import MOST_ROWS, RawTable, geometric_names, united

_DEEPEST: Final = 12
"""Largest depth of nesting that is searched."""
_UNPLACED: Final = word_set(
    "unfit unfitted unpacked unplaced unassigned unloaded leftover leftovers remaining rejected failed unused "
    "notpacked notplaced"
)
"""Words in names of lists whose boxes are not part of the plan."""
_PLACED_FLAGS: Final = frozenset(("packed", "placed", "fitted", "fit", "is_packed", "is_placed", "loaded", "success"))
LAYERS: Final = word_set("layer layers level levels tier tiers lage lagen schicht schichten row rows couches")
"""Words for lists, sheets and sections whose members are parts of one plan."""
_STACKS: Final = word_set("stack stacks tower towers column columns pile piles block blocks")
"""Words for parts of a plan that stand beside each other."""
_NAMES: Final = (
    "plan_id", "planId", "order_id", "orderId", "pallet_id", "palletId", "container_id", "containerId", "bin_id",
    "binId", "load_id", "loadId",
    "id", "ID", "name", "partno", "bin", "pallet", "container", "index", "number", "no",
)  # fmt: skip
"""Fields that name a plan, most reliable first."""
_N_OF_PLANS: Final = 12
"""Number of these fields, from the first, that name a plan wherever they are."""
_HOLDERS: Final = word_set(
    "container containers bin bins pallet pallets truck trucks carrier carriers vehicle box_size bin_size binsize "
    "containersize palletsize load_carrier"
)
_PRINTED_SIZES: Final = re.compile(r"\(?\s*([\d.]+)\s*[x×]\s*([\d.]+)\s*[x×]\s*([\d.]+)")
_LISTED: Final = 16
"""A list with at most this number of members becomes separate fields: a 4×4 matrix has 16 members."""


@dataclass(frozen=True, eq=False)
class BoxList:
    """A list of boxes as a raw table, with information from the objects around it.

    Attributes:
        table: the boxes.
        path: path of the list, with [] for each list that it passes through: "containers[].stack.placements[]".
        parts: (n,) for each row, the name of its plan; "" if the plan has no name.
        containers: name of a plan → axis (as in ``ColumnMeaning``) → size of the plan's container, in the file's unit.
        left_out: a line about boxes that are not placed; "" if there are none.
        around: fields of the objects that contain the first box of the list.
    """

    table: RawTable
    path: str
    parts: tuple[str, ...] = ()
    containers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    around: Mapping[str, Any] = field(default_factory=dict)

    @property
    def meanings(self) -> list[ColumnMeaning | None]:
        return column_meanings(self.table.header)

    @property
    def kinds(self) -> set[str]:
        return {meaning.kind for meaning in self.meanings if meaning is not None and not meaning.of_container}

    @property
    def has_places(self) -> bool:
        """Whether the boxes have coordinates."""
        return bool(self.kinds & {"position", "positions", "low", "matrix"})

    @property
    def has_sizes(self) -> bool:
        """Whether the boxes have sizes."""
        return bool(self.kinds & {"size", "sizes", "high"})


class JsonLines(list[Any]):
    """The values of a text in JSON lines.

    Attributes:
        lines: for each value, the number of its line.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[int] = []


def decoded_json(text: str) -> Any:
    """Decode a text that is JSON or JSON lines.

    Raises:
        InputError: the text is neither. The error names the line and the column, but not the file.
    """
    try:
        return _json_value(text)
    except RecursionError:
        raise InputError("not JSON (nested too deeply)") from None
    except json.JSONDecodeError as error:
        lines = [line for line in text.splitlines() if line.strip()]
        if error.msg == "Extra data" and len(lines) > 1 and all(line.lstrip()[:1] in "{[" for line in lines):
            values = JsonLines()
            for number, line in enumerate(text.splitlines(), start=1):
                if not line.strip():
                    continue
                values.lines.append(number)
                try:
                    values.append(_json_value(line))
                except RecursionError:
                    raise InputError(f"not JSON at line {number} (nested too deeply)") from None
                except json.JSONDecodeError as fault:
                    raise InputError(f"not JSON at line {number}, column {fault.colno} ({fault.msg})") from None
            return values
        raise InputError(f"not JSON at line {error.lineno}, column {error.colno} ({error.msg})") from None


def _json_value(text: str) -> Any:
    """Decode JSON. Python refuses whole numbers with thousands of digits; here they become infinite, and a later check
    refuses them as not finite, with their row and column."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        raise
    except ValueError:
        return json.loads(text, parse_int=any_integer)


@dataclass(frozen=True, eq=False)
class _Member:
    """One object of a list, and its path.

    Attributes:
        value: the object.
        place: its path in the file: "containers[0].boxes[3]".
        around: (step, object) pairs for the objects that contain this object, outermost first. A step is the field's
            name or the object's number.
    """

    value: Mapping[str, Any]
    place: str
    around: tuple[tuple[str, Mapping[str, Any]], ...]


def box_lists(value: Any) -> list[BoxList]:
    """Find all lists of boxes in a value. Lists with places come first; then the list with the most boxes.

    Raises:
        InputError: there are too many boxes.
    """
    groups: dict[str, list[_Member]] = {}
    for path, member in _members(value, "", "", (), 0):
        groups.setdefault(path, []).append(member)
        if len(groups[path]) > MOST_ROWS:
            raise InputError(f"has more than {MOST_ROWS:,} boxes")
    lists = [boxes for path, members in groups.items() if (boxes := _box_list(path, members)) is not None]
    if isinstance(value, JsonLines):
        lists = [_by_lines(boxes, value.lines) for boxes in lists]
    unplaced = [boxes for boxes in lists if _is_unplaced(boxes.path)]
    placed = _side_by_side(_outermost([boxes for boxes in lists if not _is_unplaced(boxes.path)]))
    left = sum(len(boxes.table.rows) for boxes in unplaced)
    lines = (f"{count_text(left, 'box is', 'boxes are')} not placed, and left out",) if left else ()
    ranked = sorted(placed, key=lambda boxes: (boxes.has_places, boxes.has_sizes, len(boxes.table.rows)), reverse=True)
    return [_with_lines(boxes, lines) for boxes in ranked]


_BOXES: Final = word_set(
    "box boxes item items placement placements package packages parcel parcels carton cartons case cases kartons pieces"
)
"""Words in names of lists whose members are boxes even if they are inside other boxes."""


def _outermost(lists: Sequence[BoxList]) -> list[BoxList]:
    """Lists of boxes without those that describe parts of a box, such as its corners or its pose. A list inside another
    list with sizes and places describes boxes only if it has weights, if the outer list is one of containers or layers,
    or if its own name means boxes."""
    boxes_with_both = [boxes for boxes in lists if boxes.has_places and boxes.has_sizes]

    def is_part(boxes: BoxList) -> bool:
        return any(
            boxes.path.startswith(outer.path)
            and boxes.path != outer.path
            and "weight" not in boxes.kinds
            and not _words_of_last(boxes) & _BOXES
            and not _words_of_last(outer) & (_HOLDERS | LAYERS | _STACKS)
            for outer in boxes_with_both
        )

    return [boxes for boxes in lists if not is_part(boxes)]


def _words_of_last(boxes: BoxList) -> set[str]:
    return set(words_of(_last(boxes.path)))


def _side_by_side(lists: Sequence[BoxList]) -> list[BoxList]:
    """Lists of boxes, in which lists beside each other are joined: "A.boxes" and "B.boxes" are two plans of one file,
    and so are "pallet_1" and "pallet_2". They must have the same sizes and places."""
    groups: dict[tuple[Any, ...], list[BoxList]] = {}
    for boxes in lists:
        *outer, last = boxes.path.split(".")
        key = (len(outer), re.sub(r"\d+", "", last), *geometric_names(boxes.table.header))
        groups.setdefault(key, []).append(boxes)
    joined = []
    for group in groups.values():
        steps = [boxes.path.split(".") for boxes in group]
        levels = [level for level, names in enumerate(zip(*steps, strict=True)) if len(set(names)) > 1]
        if len(levels) == 1 and group[0].has_places:
            joined.append(_joined(group, [step[levels[0]].replace("[]", "") for step in steps]))
        else:
            joined += group
    return joined


def _joined(group: Sequence[BoxList], names: Sequence[str]) -> BoxList:
    """Lists of boxes as one list.

    Args:
        names: for each list, the step in which its path differs from the others. It names a plan, unless it means a
            layer.
    """
    table = united([boxes.table for boxes in group])
    parts: list[str] = []
    containers: dict[str, Mapping[str, float]] = {}
    for boxes, name in zip(group, names, strict=True):
        plan = "" if LAYERS.intersection(words_of(name)) else name
        own = {
            part: "/".join(filter(None, (plan, "" if part == plan else part))) for part in dict.fromkeys(boxes.parts)
        }
        parts += [own[part] for part in boxes.parts]
        containers |= {own[part]: sizes for part, sizes in boxes.containers.items()}
    left_out = tuple(line for boxes in group for line in boxes.left_out)
    return replace(group[0], table=table, parts=tuple(parts), containers=containers, left_out=left_out)


def _by_lines(boxes: BoxList, lines: Sequence[int]) -> BoxList:
    """Number the boxes of JSON lines by their lines: "[4].items[2]" → "line 5, items[2]"."""
    places = []
    for place in boxes.table.places:
        member = re.match(r"\[(\d+)\]\.?", place)
        rest = "" if member is None else place[member.end() :]
        places.append(place if member is None else f"line {lines[int(member[1])]}{f', {rest}' if rest else ''}")
    return replace(boxes, table=replace(boxes.table, places=places))


def _with_lines(boxes: BoxList, lines: tuple[str, ...]) -> BoxList:
    return replace(boxes, left_out=(*boxes.left_out, *lines))


def _is_unplaced(path: str) -> bool:
    words = words_of(path.replace("_", " "))
    return bool(_UNPLACED.intersection(words)) or "not placed" in " ".join(words) or "not packed" in " ".join(words)


def _members(
    value: Any, path: str, place: str, around: tuple[tuple[str, Mapping[str, Any]], ...], depth: int
) -> Iterator[tuple[str, _Member]]:
    """Yield (path, member) for each object in each list inside a value."""
    if depth > _DEEPEST:
        return
    if isinstance(value, Mapping):
        if (rows := _columnar(value)) is not None:
            for index, row in enumerate(rows):
                yield f"{path}[]", _Member(row, f"{place}[{index}]", ((_last(path), value), *around))
            return
        step = (*around, (_last_step(place), value))
        members = [name for name, inner in value.items() if isinstance(inner, Mapping)]
        alike = len(members) > 1 and len(members) == len(value) and _alike([value[name] for name in members])
        keyed = _is_plan_key(value)
        around_it = (*around, (_last_step(place), dict[str, Any]()))  # if its fields are boxes, it is no container
        for name, inner in value.items():
            inner_place = f"{place}.{name}" if place else str(name)
            if keyed:
                yield from _members(inner, f"{path}[]", inner_place, (*step, (str(name), {"id": str(name)})), depth + 1)
            elif alike and isinstance(inner, Mapping):
                yield f"{path}[]", _Member({"id": name, **inner}, inner_place, around_it)
                yield from _members(inner, f"{path}[]", inner_place, step, depth + 1)
            elif isinstance(inner, Mapping | list | tuple | np.ndarray):
                generic = f"{path}.{name}" if path else str(name)
                yield from _members(inner, generic, inner_place, step, depth + 1)
        return
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        return
    if (rows := _rows_of_numbers(value)) is not None:
        for index, row in enumerate(rows):
            yield f"{path}[]", _Member(row, f"{place}[{index}]", around)
        return
    for index, inner in enumerate(value):
        inner_place = f"{place}[{index}]"
        if isinstance(inner, Mapping):
            yield f"{path}[]", _Member(inner, inner_place, around)
        if isinstance(inner, Mapping | list | tuple):
            yield from _members(inner, f"{path}[]", inner_place, around, depth + 1)


def _last(path: str) -> str:
    return path.rpartition(".")[2]


def _last_step(place: str) -> str:
    return place.rpartition(".")[2]


def _alike(members: Sequence[Mapping[str, Any]]) -> bool:
    """Whether objects have similar fields, as the boxes of one list do."""
    names = [set(member) for member in members[:50]]
    common = set.intersection(*names)
    return len(common) >= 2 and len(common) * 2 >= max(map(len, names))


_FORM_WORDS: Final = word_set(
    "box boxes item items placement placements package packages packed placed fitted fit carton cartons case cases "
    "data result results rows records bin bins container containers pallet pallets plans layout solution parcels "
    "objects orders order stack positions kartons pieces"
)
"""Words in names of fields that hold lists of boxes but do not name a plan."""


def _is_plan_key(value: Mapping[str, Any]) -> bool:
    """Whether the names of an object's fields are names of plans. The names are taken as names of plans if every field
    holds a list, and no name has a word of ``_FORM_WORDS``."""
    lists = [inner for inner in value.values() if isinstance(inner, list) and inner]
    if len(lists) != len(value) or not lists:
        return False
    if len(lists) == 1 and _FORM_WORDS.intersection(words_of(next(iter(value)))):
        return False
    if not all(isinstance(inner[0], Mapping) and _alike([inner[0], lists[0][0]]) for inner in lists):
        return False
    return not any(_is_unplaced(str(name)) for name in value)


_LEAST_COLUMNS: Final = 5


def _columnar(value: Mapping[str, Any]) -> list[dict[str, Any]] | None:
    """The rows of an object that stores them by column: lists of the same length, or pandas' forms (``columns`` and
    ``data``, or objects with one value per row). None if the object has another form."""
    names, data = value.get("columns"), value.get("data")
    if isinstance(names, list) and isinstance(data, list) and data and all(isinstance(row, list) for row in data):
        if all(isinstance(name, str) for name in names) and all(len(row) == len(names) for row in data):
            return [dict(zip(names, row, strict=True)) for row in data]
        return None
    if len(value) >= _LEAST_COLUMNS and all(isinstance(inner, Mapping) and inner for inner in value.values()):
        keys = max((inner.keys() for inner in value.values()), key=len)
        alike = all(inner.keys() <= keys for inner in value.values())
        if alike and sum(meaning is not None for meaning in column_meanings(list(value))) >= _LEAST_COLUMNS:
            return [{name: inner.get(key) for name, inner in value.items()} for key in keys]
        return None
    lists = {name: list(inner) for name, inner in value.items() if isinstance(inner, list | tuple | np.ndarray)}
    lengths = {len(inner) for inner in lists.values()}
    if len(lengths) != 1 or 0 in lengths or any(isinstance(inner[0], Mapping) for inner in lists.values()):
        return None
    if sum(meaning is not None for meaning in column_meanings(list(lists))) < 2:
        return None
    flat = sum(3 if isinstance(inner[0], list | tuple) else 1 for inner in lists.values())
    if flat < _LEAST_COLUMNS:
        return None
    return [{name: inner[index] for name, inner in lists.items()} for index in range(lengths.pop())]


_LEAST_NUMBERS: Final = 6


def _rows_of_numbers(value: Sequence[Any]) -> list[dict[str, Any]] | None:
    """The rows of a list of lists of numbers: sizes, coordinates and more, or matrices. None if the list has another
    form."""
    if not value or not all(isinstance(row, list | tuple) for row in value):
        return None
    first = value[0]
    if len(first) in (3, 4) and all(isinstance(inner, list | tuple) and len(inner) == 4 for inner in first):
        return [{"matrix": row} for row in value]
    widths = {len(row) for row in value}
    if len(first) < _LEAST_NUMBERS or len(first) > 64 or len(widths) > 2:
        return None
    numeric = sum(cell_number(cell) is not None for row in value[:50] for cell in row)
    if numeric < 0.8 * sum(len(row) for row in value[:50]):
        return None
    return [{f"column {number}": cell for number, cell in enumerate(row, start=1)} for row in value]


def flattened(value: Mapping[str, Any], prefix: str = "", depth: int = 0) -> dict[str, Any]:
    """Path → value for all values inside an object: "." leads into an object, "[0]" into a short list of numbers.
    Longer lists are left out."""
    flat: dict[str, Any] = {}
    for name, inner in value.items():
        path = prefix[:-1] if name in _VALUES and prefix.endswith(".") else f"{prefix}{name}"
        if isinstance(inner, np.ndarray):
            inner = inner.tolist()
        if isinstance(inner, Mapping) and (quantity := _quantity(inner)) is not None:
            flat[path] = quantity
        elif isinstance(inner, Mapping):
            if depth < 4:
                flat |= flattened(inner, f"{path}.", depth + 1)
        elif isinstance(inner, list | tuple):
            if _is_matrix(inner):
                flat[path] = inner
            elif (ends := _ends_of_vertices(inner)) is not None:
                for end, point in zip(("min", "max"), ends, strict=True):
                    flat |= {f"{path}.{end}[{axis}]": value for axis, value in enumerate(point)}
            elif (pose := _PARTS_OF_POSES.get(len(inner))) and str(name).lower() in ("pose", "qpos"):
                flat |= {f"{path}.{part}": cell for part, cell in zip(pose, inner, strict=True)}
            elif 0 < len(inner) <= _LISTED and not any(isinstance(cell, Mapping | list | tuple) for cell in inner):
                flat |= {f"{path}[{index}]": cell for index, cell in enumerate(inner)}
        else:
            flat[path] = inner
    return flat


_PARTS_OF_POSES: Final = {
    4: ("x", "y", "z", "yaw"),
    6: ("x", "y", "z", "rx", "ry", "rz"),
    7: ("x", "y", "z", *(f"quaternion[{index}]" for index in range(4))),
}
"""Length of a list of numbers that is called a pose → its members."""


_VALUES: Final = ("value", "amount", "magnitude")
_UNITS: Final = frozenset(
    ("unit", "units", "uom", "einheit", "unite", "unité", "unidad", "unita", "unità", "jednostka")
)
"""Fields of a number, and fields of its unit, in an object beside one another."""


def _quantity(value: Mapping[str, Any]) -> Any:
    """The text of a number with a unit, from an object such as {"value": "400", "unit": "mm"}; None for other
    objects."""
    name = next((name for name in _VALUES if name in value), None)
    unit = next((unit for key, unit in value.items() if key.lower() in _UNITS and isinstance(unit, str)), None)
    if name is not None and unit is not None and len(value) <= 4:
        return f"{value[name]} {unit}"
    if set(value) == {"ticks"}:
        return f"{value['ticks']} ticks"
    return None


def _ends_of_vertices(value: Sequence[Any]) -> tuple[list[Any], list[Any]] | None:
    """The smallest and the largest coordinates of the eight corners of a box, [[x, y, z], …]; None for other lists. If
    the points are not the corners of a level box, one coordinate is replaced by a fault's text."""
    if len(value) != 8 or not all(isinstance(point, list | tuple) and len(point) == 3 for point in value):
        return None
    ends: tuple[list[Any], list[Any]] = ([], [])
    for column in zip(*value, strict=True):
        numbers = [number.value for cell in column if (number := cell_number(cell)) is not None]
        odd = [cell for cell in column if cell_number(cell) is None]
        halves = len(numbers) == 8 and sorted(numbers)[3] == min(numbers) and sorted(numbers)[4] == max(numbers)
        if not halves and not odd:
            odd = [f"{column[0]}, …, which are no level box"]
        ends[0].append(odd[0] if odd else min(numbers))
        ends[1].append(max(numbers, default=None))
    return ends


def _is_matrix(value: Sequence[Any]) -> bool:
    return len(value) in (3, 4) and all(isinstance(row, list | tuple) and len(row) in (3, 4) for row in value)


def _box_list(path: str, members: Sequence[_Member]) -> BoxList | None:
    """Turn a list of objects into a table; None if the objects are not boxes."""
    flat = [flattened(member.value) for member in members]
    for row, member in zip(flat, members, strict=True):
        row.update(_of_part(member))
    counts: dict[str, int] = {}
    for row in flat:
        for name in row:
            counts[name] = counts.get(name, 0) + 1
    header = tuple(counts)
    meanings = [meaning for meaning in column_meanings(header) if meaning is not None and not meaning.of_container]
    kinds = [meaning.kind for meaning in meanings]
    matrices = any(isinstance(row.get(name), list | tuple) for row in flat[:1] for name in header)
    numbered = any(name.startswith("column ") for name in header) and len(header) >= _LEAST_NUMBERS
    geometric = sum(kind in ("size", "position", "low", "high") for kind in kinds)
    triples = sum(kind in ("sizes", "positions") for kind in kinds)
    if not (geometric >= 3 or triples or matrices or numbered):
        return None
    box_members, left = [], 0
    for number, row in enumerate(flat):
        flags = [value for name, value in row.items() if name.lower() in _PLACED_FLAGS and value in (True, False)]
        if flags and not all(flags):
            left += 1
        else:
            box_members.append(number)
    rows = [tuple(_cell(flat[number].get(name)) for name in header) for number in box_members]
    places = [members[number].place or f"[{number}]" for number in box_members]
    table = RawTable(header, rows, places, decimal_of(rows) or "", title=path, has_header=not numbered)
    parts = _parts([members[number] for number in box_members])
    containers: dict[str, Mapping[str, float]] = {}
    for number, part in zip(box_members, parts, strict=True):
        if part not in containers:
            containers[part] = _container_of(members[number])
    lines = (f"{count_text(left, 'box is', 'boxes are')} not placed, and left out",) if left else ()
    around: dict[str, Any] = {}
    for _, holder in members[0].around:
        around |= {name: inner for name, inner in holder.items() if not isinstance(inner, list)}
    return BoxList(
        table, path, tuple(parts), {part: sizes for part, sizes in containers.items() if sizes}, lines, around
    )


def _of_part(member: _Member) -> dict[str, Any]:
    """The coordinates and the height that a box lacks, from the layer or stack that contains it."""
    step, holder = member.around[-1] if member.around else ("", {})
    if not (LAYERS | _STACKS).intersection(words_of(step)):
        return {}
    own = {(meaning.kind, meaning.axis) for meaning in column_meanings(list(flattened(member.value))) if meaning}
    if ("positions", "") in own or ("sizes", "") in own or not any(kind == "position" for kind, _ in own):
        return {}
    fields = {name: value for name, value in holder.items() if cell_number(value) is not None}
    lacking = {*(("position", axis) for axis in "xyz"), ("size", "height")} - own
    return {
        name: fields[name]
        for name, meaning in zip(fields, column_meanings(list(fields)), strict=True)
        if meaning is not None and (meaning.kind, meaning.axis) in lacking
    }


def _cell(value: Any) -> Any:
    return value.strip() or None if isinstance(value, str) else value


def _parts(members: Sequence[_Member]) -> list[str]:
    """The name of each member's plan: the differing names of the objects around it, or, if none differ, the innermost
    name."""
    depth = max((len(member.around) for member in members), default=0)
    levels = [
        [member.around[level] if level < len(member.around) else ("", {}) for member in members]
        for level in range(depth)
    ]
    several = [level for level in levels if len({id(holder) for _, holder in level}) > 1 and not _is_part(level[0][0])]
    if not several:
        return [_only_name(members[0].around)] * len(members) if members else []
    names = []
    for level in several:
        distinct = {id(holder): (step, holder) for step, holder in level}
        labels = _names_of(list(distinct.values()))
        by_holder = dict(zip(distinct, labels, strict=True))
        names.append([by_holder[id(holder)] for _, holder in level])
    return ["/".join(filter(None, parts)) for parts in zip(*names, strict=True)]


def _is_part(step: str) -> bool:
    """Whether the members of a list with this name are parts of one plan: its layers, or several stacks."""
    words = set(words_of(step))
    return bool(words & LAYERS) or (bool(words & _STACKS) and step.endswith("]"))


def _only_name(around: Sequence[tuple[str, Mapping[str, Any]]]) -> str:
    """The name of a file's only plan; "" if no field gives a name."""
    for _, holder in reversed(around):
        for name in _NAMES[:_N_OF_PLANS]:
            if (text := _name_text(holder.get(name))) != "":
                return text
    for step, holder in reversed(around):
        if step.endswith("]") or not step:
            for name in ("id", "ID", "name", "bin", "partno"):
                if (text := _name_text(holder.get(name))) != "":
                    return text
    return ""


def _names_of(holders: Sequence[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """The names of objects around boxes. A name is the text of the first field that is unique, else the place of the
    object."""
    texts = {name: [_name_text(holder.get(name)) for _, holder in holders] for name in _NAMES}
    counts = {name: Counter(values) for name, values in texts.items()}
    names = []
    for number, (step, _) in enumerate(holders):
        unique = (
            values[number] for name, values in texts.items() if values[number] and counts[name][values[number]] == 1
        )
        member = re.search(r"\[(\d+)\]$", step)
        names.append(next(unique, step if member is None else str(int(member[1]) + 1)))
    return names


def _name_text(value: Any) -> str:
    if isinstance(value, str):
        printed = re.match(r"^([\w .#-]+)\([\d.]+\s*x", value)  # py3dbp prints "euro(1200x800x1500, …)"
        return (printed[1] if printed else value).strip()[:1000]
    return cell_text(value) if isinstance(value, int | float) and not isinstance(value, bool) else ""


def _container_of(member: _Member) -> dict[str, float]:
    """The size of the container of a box, by axis; empty if no size is given."""
    for step, holder in reversed(member.around):
        for name, inner in holder.items():
            words = words_of(str(name))
            # In py3dbp's web API, the container "box" is beside the list of its boxes.
            is_box = isinstance(inner, Mapping) and str(name).lower() == "box"
            if not (_HOLDERS.intersection(words) or str(name).lower() in _HOLDERS or is_box):
                continue
            if isinstance(inner, Mapping) and (sizes := _sizes_in(inner)):
                return sizes
            if isinstance(inner, list | tuple) and len(inner) == 3 and all(map(cell_number, inner)):
                return {str(axis): float(cell_number(cell).value) for axis, cell in enumerate(inner)}  # type: ignore[union-attr]  # as just checked
            if isinstance(inner, str) and (printed := _PRINTED_SIZES.search(inner)):
                return dict(zip(("width", "height", "depth"), map(float, printed.groups()), strict=True))
        alone = {
            name: inner for name, inner in holder.items() if not (isinstance(inner, list) and _holds_objects(inner))
        }
        if (sizes := _sizes_in(alone)) and step != "":
            return sizes
        if sizes and set(holder) & {"items", "boxes", "placements", "stack", "fitted_items", "packages"}:
            return sizes
    return {}


def _holds_objects(value: Sequence[Any]) -> bool:
    return any(isinstance(inner, Mapping) for inner in value[:1])


def _sizes_in(value: Mapping[str, Any]) -> dict[str, float]:
    """Axis → size, from the fields of an object; empty unless there are three sizes."""
    flat = flattened(value)
    sizes: dict[str, float] = {}
    for name, meaning in zip(flat, column_meanings(list(flat)), strict=True):
        number = cell_number(flat[name])
        if meaning is not None and meaning.kind == "size" and number is not None and number.value > 0:
            sizes.setdefault(meaning.axis, number.value)
    return sizes if len(sizes) == 3 else {}
