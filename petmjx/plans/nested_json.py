"""Decodes JSON and JSON lines of other tools, finds boxes nested anywhere in JSON, NumPy arrays or Python objects, and
turns lists of boxes into raw tables.

A list of boxes may be a list (or an object) of objects with the same fields, an object of lists, or a list of lists of
numbers. The objects around a list give the name of its plan and its container.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable_name
from petmjx.plans.cell_numbers import cell_number, decimal_of
from petmjx.plans.column_names import CONTAINER_WORDS, ColumnMeaning, known_meanings, names_unplaced, word_set, words_of
from petmjx.plans.header_and_total_rows import geometric_columns, geometric_names
from petmjx.plans.json_reader import DuplicateFieldObject, json_fault, json_value
from petmjx.plans.nested_containers import (
    CONTAINERS,
    LAYERS,
    STACKS,
    NestedBox,
    add_bottoms,
    articles_around,
    container_around,
    fields_of_article,
    fields_of_part,
    plan_names_of,
)
from petmjx.plans.nested_fields import LEAST_NUMBERS, flattened, rows_by_column, rows_of_numbers
from petmjx.plans.raw_tables import MOST_ROWS, BoxList, RawTable, flags_unplaced, not_placed, united

_DEEPEST: Final = 12
"""Largest depth of nesting that is searched."""


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
        return _value_of(text)
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
                    values.append(_value_of(line))
                except RecursionError:
                    raise InputError(f"not JSON at line {number} (nested too deeply)") from None
                except json.JSONDecodeError as fault:
                    raise InputError(f"not JSON at line {number}, column {fault.colno} ({json_fault(fault)})") from None
            return values
        cut_off = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated")
        fault_text = "the file ends too early; truncated?" if cut_off else json_fault(error)
        raise InputError(f"not JSON at line {error.lineno}, column {error.colno} ({fault_text})") from None


_TYPES: Final[Mapping[str, type | tuple[type, ...]]] = {
    **dict.fromkeys(("$numberInt", "$numberLong", "$numberDouble", "$numberDecimal", "$oid", "N", "S"), str),
    **dict.fromkeys(("integerValue", "doubleValue", "stringValue"), (str, int, float)),
    **dict.fromkeys(("BOOL", "booleanValue"), bool),
    **dict.fromkeys(("M", "mapValue", "fields"), dict), **dict.fromkeys(("L", "values"), list),
    "arrayValue": dict,
}  # fmt: skip
"""Databases export a value as an object with a single field, whose name states the type of the value, such as
{"$numberInt": "5"}. Name of such a field → Python type of its value. The names come from MongoDB's extended JSON,
DynamoDB and Firestore."""
_TYPED_NAME: Final = re.compile(r'\{\s*"(?:\$number\w+|\$oid|[NS]|(?:integer|double|string)Value)"\s*:')


def _value_of(text: str) -> Any:
    value = json_value(json.JSONDecoder.decode, text)
    return _without_types(value) if _TYPED_NAME.search(text) else value


def _without_types(value: Any) -> Any:
    """The value ``value``, in which each object of the form {type: content} is replaced by its content."""
    if isinstance(value, list):
        return [_without_types(inner) for inner in value]
    if not isinstance(value, dict):
        return value
    if len(value) == 1:
        ((name, inner),) = value.items()
        if name in _TYPES and isinstance(inner, _TYPES[name]):
            return _without_types(inner)
    for name, inner in value.items():
        value[name] = _without_types(inner)
    return value


def box_lists(value: Any) -> list[BoxList]:
    """Find all lists of boxes in a value. Lists with places come first, then lists with sizes; among otherwise equal
    lists, longer lists come first.

    Raises:
        InputError: there are too many boxes.
    """
    groups: dict[str, list[NestedBox]] = {}
    for path, member in _members(value, "", "", (), 0):
        groups.setdefault(path, []).append(member)
        if len(groups[path]) > MOST_ROWS:
            raise InputError(f"has more than {MOST_ROWS:,} boxes")
    lists = [
        replace(boxes, left_out=(*boxes.left_out, *_without_boxes(groups, path)))
        for path, members in groups.items()
        if (boxes := _box_list(path, members)) is not None
    ]
    if isinstance(value, JsonLines):
        lists = [_by_lines(boxes, value.lines) for boxes in lists]
    unplaced = [boxes for boxes in lists if names_unplaced(boxes.path)]
    placed = _side_by_side(_outermost([boxes for boxes in lists if not names_unplaced(boxes.path)]))
    left = sum(len(boxes.table.rows) for boxes in unplaced)
    ranked = sorted(placed, key=lambda boxes: (boxes.has_places, boxes.has_sizes, len(boxes.table.rows)), reverse=True)
    return [replace(boxes, left_out=(*boxes.left_out, *not_placed(left))) for boxes in ranked]


def _without_boxes(groups: Mapping[str, Sequence[NestedBox]], path: str) -> list[str]:
    """A list with one line that names the objects without boxes, such as empty pallets beside pallets with boxes; empty
    if there are none. These objects are members of lists whose other members hold the boxes of the list ``path``.

    Args:
        groups: path of a list → its members.
        path: path of the list of boxes.
    """
    holders = {id(holder) for member in groups[path] for _, holder in member.around}
    empty = [
        member.place
        for outer, members in groups.items()
        if path.startswith(f"{outer}.")
        for member in members
        if id(member.value) not in holders
    ]
    known, outermost = {*empty}, []
    for place in empty:
        steps = place.split(".")
        if not any(".".join(steps[:n]) in known for n in range(1, len(steps))):
            outermost.append(place)
    return [f"no box in {first_names(outermost)}"] if outermost else []


_BOXES: Final = word_set(
    "box boxes item items placement placements package packages parcel parcels carton cartons case cases kartons pieces"
)
"""Words in names of lists whose members are boxes even if they are inside other boxes."""


def _outermost(lists: Sequence[BoxList]) -> list[BoxList]:
    """Lists of boxes without those that describe parts of a box, such as its corners or its pose. A list inside another
    list with sizes and places describes boxes only if it has weights, if the outer list holds containers or layers, or
    if the name of the inner list means boxes."""
    boxes_with_both = [boxes for boxes in lists if boxes.has_places and boxes.has_sizes]

    def is_part(boxes: BoxList) -> bool:
        return any(
            boxes.path.startswith(outer.path)
            and boxes.path != outer.path
            and "weight" not in boxes.kinds
            and not _words_of_last(boxes) & _BOXES
            and not _words_of_last(outer) & (CONTAINERS | LAYERS | STACKS)
            for outer in boxes_with_both
        )

    return [boxes for boxes in lists if not is_part(boxes)]


def _words_of_last(boxes: BoxList) -> set[str]:
    return set(words_of(_last_step(boxes.path)))


def _side_by_side(lists: Sequence[BoxList]) -> list[BoxList]:
    """Join lists of boxes that are beside each other in a file: "A.boxes" and "B.boxes" are two plans of one file, and
    so are "pallet_1" and "pallet_2". The lists must have the same columns for sizes and places."""
    groups: dict[tuple[Any, ...], list[BoxList]] = {}
    for boxes in lists:
        *outer, last = boxes.path.split(".")
        columns = geometric_names(boxes.table.header) if boxes.table.has_header else boxes.table.header
        key = (len(outer), re.sub(r"\d+", "", last), *columns)
        groups.setdefault(key, []).append(boxes)
    joined = []
    for group in groups.values():
        steps = [boxes.path.split(".") for boxes in group]
        levels = [level for level, names in enumerate(zip(*steps, strict=True)) if len(set(names)) > 1]
        if len(levels) == 1 and (group[0].has_places or not group[0].table.has_header):
            joined.append(_joined(group, [step[levels[0]].replace("[]", "") for step in steps]))
        else:
            joined += group
    return joined


def _joined(group: Sequence[BoxList], names: Sequence[str]) -> BoxList:
    """Join lists of boxes into one list.

    Args:
        names: for each list, the part of its path that differs from the paths of the other lists. This part is the name
            of a plan, unless it is the name of a layer.
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
    """Change the places of boxes in JSON lines: the number of a line replaces the index of the value in this line, so
    that "[4].items[2]" becomes "line 5, items[2]"."""
    places = []
    for place in boxes.table.places:
        member = re.match(r"\[(\d+)\]\.?", place)
        rest = "" if member is None else place[member.end() :]
        places.append(place if member is None else f"line {lines[int(member[1])]}{f', {rest}' if rest else ''}")
    return replace(boxes, table=replace(boxes.table, places=places))


def _members(
    value: Any, path: str, place: str, around: tuple[tuple[str, Mapping[str, Any]], ...], depth: int
) -> Iterator[tuple[str, NestedBox]]:
    """Yield (path, member) for each object in each list inside a value.

    Raises:
        InputError: a field with a list or an object is repeated, so that boxes of the first one would be lost.
    """
    if depth > _DEEPEST:
        return
    if isinstance(value, DuplicateFieldObject) and isinstance(value[value.field], Mapping | list):
        raise InputError(f"{place}{place and ': '}{printable_name(value.field)} stands twice")
    if isinstance(value, Mapping):
        if (rows := rows_by_column(value)) is not None:
            for index, row in enumerate(rows):
                yield f"{path}[]", NestedBox(row, f"{place}[{index}]", (*around, (_last_step(place), value)))
            return
        step = (*around, (_last_step(place), value))
        members = [name for name, inner in value.items() if isinstance(inner, Mapping)]
        alike = len(members) > 1 and len(members) == len(value) and _alike([value[name] for name in members])
        keyed = _is_plan_key(value)
        # an object whose fields are boxes is no container, so an empty object takes its place
        around_it = (*around, (_last_step(place), dict[str, Any]()))
        for name, inner in value.items():
            inner_place = f"{place}.{name}" if place else str(name)
            if keyed:
                yield from _members(inner, f"{path}[]", inner_place, (*step, (str(name), {"id": str(name)})), depth + 1)
            elif alike and isinstance(inner, Mapping):
                yield f"{path}[]", NestedBox({"id": name, **inner}, inner_place, around_it)
                yield from _members(inner, f"{path}[]", inner_place, step, depth + 1)
            elif isinstance(inner, Mapping | list | tuple | np.ndarray):
                generic = f"{path}.{name}" if path else str(name)
                yield from _members(inner, generic, inner_place, step, depth + 1)
        return
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        return
    if (rows := rows_of_numbers(value)) is not None:
        for index, row in enumerate(rows):
            yield f"{path}[]", NestedBox(row, f"{place}[{index}]", around)
        return
    for index, inner in enumerate(value):
        inner_place = f"{place}[{index}]"
        if isinstance(inner, Mapping):
            yield f"{path}[]", NestedBox(inner, inner_place, around)
            yield from _members(inner, f"{path}[]", inner_place, around, depth + 1)
        elif isinstance(inner, list | tuple):
            # each list of boxes in a list of such lists is a plan (or a layer), so an empty object stands for it
            are_boxes = len(value) > 1 and bool(inner) and isinstance(inner[0], Mapping)
            step = (*around, (_last_step(inner_place), dict[str, Any]())) if are_boxes else around
            yield from _members(inner, f"{path}[]", inner_place, step, depth + 1)


def _last_step(path: str) -> str:
    return path.rpartition(".")[2]


def _alike(members: Sequence[Mapping[str, Any]]) -> bool:
    """Whether objects have similar fields, as the boxes of one list do."""
    names = [set(member) for member in members[:50]]
    common = set.intersection(*names)
    return len(common) >= 2 and len(common) * 2 >= max(map(len, names))


_FORM_WORDS: Final = CONTAINER_WORDS | word_set(
    "box boxes item items placement placements package packages packed placed fitted fit carton cartons case cases "
    "data result results rows records plans layout solution parcels objects orders order stack positions kartons pieces"
)
"""Words in names of fields that hold lists of boxes but do not name a plan, unless a number of a pallet follows."""


def _is_plan_key(value: Mapping[str, Any]) -> bool:
    """Whether the names of an object's fields are names of plans. Every field must hold a list. All lists must have
    similar members, with the same fields for sizes and places: if only some lists have places, the other lists are
    lists of items, and not plans. A list may be empty if its name differs from the name of another list only in its
    number. No name may say that boxes are not placed. If all lists but one are empty, or if the lists have rows of
    numbers, no name may have a word of ``_FORM_WORDS``."""
    lists = [inner for inner in value.values() if isinstance(inner, list) and inner]
    if not lists or not all(isinstance(inner, list) for inner in value.values()):
        return False
    stems = {bool(inner): set[str]() for inner in value.values()}
    for name, inner in value.items():
        stems[bool(inner)].add(re.sub(r"\d+", "", str(name)))
    if not stems.get(False, set()) <= stems[True]:
        return False
    if len(lists) == 1:
        words = words_of(str(next(iter(value))))
        is_numbered = bool(words) and words[-1].isdecimal() and not _BOXES.intersection(words)
        if _FORM_WORDS.intersection(words) and not is_numbered:
            return False
    if len(lists) > 1 and all(rows_of_numbers(inner) is not None for inner in lists):
        named = set().union(*(words_of(str(name)) for name in value))
        return not named & (_FORM_WORDS | _BOXES) and len({len(inner[0]) for inner in lists}) == 1
    if not all(isinstance(inner[0], Mapping) and _alike([inner[0], lists[0][0]]) for inner in lists):
        return False
    headers = [[str(name) for name in inner[0]] for inner in lists]
    if len({frozenset(header[index] for index in geometric_columns(header)) for header in headers}) > 1:
        return False
    return not any(names_unplaced(str(name)) for name in value)


def _box_list(path: str, members: Sequence[NestedBox]) -> BoxList | None:
    """Turn a list of objects into a table; None if the objects are not boxes."""
    flat = [_fields_of(member) for member in members]
    articles, sources = articles_around(members), list[str]()
    of_parts: dict[int, tuple[dict[str, Any], dict[str, ColumnMeaning]]] = {}
    for row, member in zip(flat, members, strict=True):
        of_part = fields_of_part(member, row, of_parts)
        of_article, source = fields_of_article(member, row, articles)
        row |= of_part | of_article
        sources.append(source)
    notes = [*filter(None, dict.fromkeys(sources)), *add_bottoms(members, flat)]
    for others_in in (_static_objects, _other_kinds, _floors):
        others, note = others_in(flat)
        if 0 < len(others) < len(flat):
            kept = [number for number in range(len(flat)) if number not in others]
            members, flat = [members[number] for number in kept], [flat[number] for number in kept]
            notes.append(note)
    notes += _with_zeros(flat)
    _mark_long_lists(flat)
    header = tuple(dict.fromkeys(name for row in flat for name in row))
    meanings = [meaning for meaning in known_meanings(header).values() if not meaning.of_container]
    kinds = [meaning.kind for meaning in meanings]
    matrices = any(isinstance(row.get(name), list | tuple) for row in flat[:1] for name in header)
    numbered = any(name.startswith("column ") for name in header) and len(header) >= LEAST_NUMBERS
    geometric = sum(kind in ("size", "position", "low", "high") for kind in kinds)
    triples = sum(kind in ("sizes", "positions") for kind in kinds)
    if not (geometric >= 3 or triples or matrices or numbered):
        return None
    numbers = [number for number, row in enumerate(flat) if not flags_unplaced(row.items())]
    rows = [tuple(_cell(flat[number].get(name)) for name in header) for number in numbers]
    places = [members[number].place or f"[{number}]" for number in numbers]
    boxes = [members[number] for number in numbers]
    table = RawTable(header, rows, places, decimal_of(rows) or "", title=path, has_header=not numbered)
    parts, ids = plan_names_of(boxes, articles)
    if ids:
        notes.append(f"several plans have {first_names(ids)}: other fields or numbers name them")
    first_boxes = dict(zip(reversed(parts), reversed(boxes), strict=True))
    containers = {
        part: sizes for part in dict.fromkeys(parts) if (sizes := container_around(first_boxes[part], articles))
    }
    keyed: Mapping[str, Any] = next(
        (holder for _, holder in reversed(members[0].around) if len(holder) > 1 and _is_plan_key(holder)), {}
    )
    if empty := [str(name) for name, inner in keyed.items() if not inner]:
        notes.append(f"no box in {first_names(empty)}")
    around: dict[str, Any] = {}
    for _, holder in members[0].around:
        around |= {name: inner for name, inner in holder.items() if not isinstance(inner, list)}
    left_out = not_placed(len(flat) - len(boxes))
    return BoxList(table, path, tuple(parts), containers, (*notes, *left_out), around)


def _fields_of(member: NestedBox) -> dict[str, Any]:
    """The fields of a box.

    Raises:
        InputError: a field is repeated, so that it is unknown which of its values is right.
    """
    if repeated := _repeated_field(member.value):
        raise InputError(f"{member.place or 'a box'}: {repeated} stands twice")
    return flattened(member.value)


def _repeated_field(value: Any, path: str = "") -> str:
    """The path of the first field that is repeated in an object or in an object within it; "" if there is none."""
    if not isinstance(value, Mapping):
        return ""
    if isinstance(value, DuplicateFieldObject):
        return f"{path}{printable_name(value.field)}"
    fields = (_repeated_field(inner, f"{path}{name}.") for name, inner in value.items() if isinstance(inner, Mapping))
    return next(filter(None, fields), "")


_KIND_FIELDS: Final = frozenset(("event", "type", "kind", "action", "record", "op", "msg", "message"))
"""Names of fields that tell what kind of object a member of a list is."""


def _other_kinds(flat: list[dict[str, Any]]) -> tuple[set[int], str]:
    """Two values: the numbers of the members of a list that are no boxes, such as events "start" and "end" or the
    lights of a scene; and a line for the user about these members, which are left out. A member is no box if it has no
    size (or, in a list without sizes, no place), and if a field such as ``type`` gives it a kind that no box has."""
    names = list(dict.fromkeys(name for row in flat for name in row))
    geometric = _named(names, _SIZE_KINDS) or _named(names, _GEOMETRIC)
    lacking = {number for number, row in enumerate(flat) if not geometric.intersection(row)}
    for name in sorted(_KIND_FIELDS.intersection(names)):
        others = {str(flat[number].get(name, "")) for number in lacking}
        boxes = {str(row.get(name, "")) for number, row in enumerate(flat) if number not in lacking}
        if lacking and others.isdisjoint(boxes) and "" not in others:
            return lacking, f"objects whose {name} is {first_names(sorted(others))} have no size, and are left out"
    return set(), ""


_SIZE_KINDS: Final = ("size", "sizes", "high")
_GEOMETRIC: Final = (*_SIZE_KINDS, "position", "positions", "low")


def _named(names: Sequence[str], kinds: Collection[str]) -> set[str]:
    """The names that have a known meaning of one of the ``kinds``, and that do not describe the container."""
    return {
        name for name, meaning in known_meanings(names).items() if meaning.kind in kinds and not meaning.of_container
    }


def _static_objects(flat: list[dict[str, Any]]) -> tuple[set[int], str]:
    """The numbers of the members of a list that a scene calls static, such as its floor and its pallet; and a line for
    the user that these members are left out."""
    static = {
        number
        for number, row in enumerate(flat)
        if any(name.lower() in _STATIC and str(value).lower() in ("true", "1") for name, value in row.items())
    }
    return static, f"{count_text(len(static), 'static object')} left out"


_STATIC: Final = frozenset(("static", "isstatic", "is_static"))
"""Names of fields, in lower case, that tell whether an object of a scene can move."""


def _floors(flat: list[dict[str, Any]]) -> tuple[set[int], str]:
    """The numbers of the members of a list that are planes named as a floor; and a line for the user that these members
    are left out. A member is a plane if one of its sizes is 0."""
    sizes = _named(list(dict.fromkeys(name for row in flat for name in row)), _SIZE_KINDS)
    floors = {
        number
        for number, row in enumerate(flat)
        if any(row.get(name) == 0 for name in sizes)
        and any(isinstance(value, str) and _FLOORS.intersection(words_of(value)) for value in row.values())
    }
    return floors, f"{count_text(len(floors), 'floor')} left out"


_FLOORS: Final = word_set("floor ground plane boden")


def _with_zeros(flat: list[dict[str, Any]]) -> list[str]:
    """Fill in coordinates that are missing because they are 0, as in JSON of protocol buffers. Coordinates are filled
    in only if three conditions hold. Some of x, some of y and some of z are missing; some boxes lack only a part of
    their coordinates; and no coordinate is written as 0. Returns a note if coordinates were filled."""
    names = list(dict.fromkeys(name for row in flat for name in row))
    by_axis: dict[str, list[str]] = {}
    for name, meaning in known_meanings(names).items():
        if meaning.kind == "position" and not meaning.of_container and "[" not in name:
            by_axis.setdefault(meaning.axis, []).append(name)
    columns = [by_axis[axis][0] for axis in "xyz" if len(by_axis.get(axis, ())) == 1]
    numbers = [[cell_number(row.get(name)) for row in flat] for name in columns]
    is_zero = any(number is not None and number.value == 0 for column in numbers for number in column)
    n_lacking = [sum(name not in row for name in columns) for row in flat]
    # a box must lack only one or two coordinates, since a box that lacks all three may not have been placed
    in_part = any(0 < count < 3 for count in n_lacking)
    if len(columns) < 3 or is_zero or not in_part or not all(any(name not in row for row in flat) for name in columns):
        return []
    for row in flat:
        for name in columns:
            row.setdefault(name, 0)
    return ["missing coordinates are read as 0"]


def _mark_long_lists(flat: list[dict[str, Any]]) -> None:
    """Mark sizes and places that are lists of four numbers, if fewer than half of the rows have such lists. The fourth
    number may come from a decimal comma: in "[38.5, 22.7, 41,6]", a comma has divided the number 41.6. The third number
    of a marked list becomes a text that is no number, so its row is reported as bad."""
    names = {name for row in flat for name in row if name.endswith("[3]")}
    for name in _named(sorted(names), ("size", "position", "low", "high")):
        long = [row for row in flat if name in row]
        if len(long) * 2 < len(flat):
            for row in long:
                row[f"{name[:-3]}[2]"] = f"{row[f'{name[:-3]}[2]']} and a further number"


def _cell(value: Any) -> Any:
    return value.strip() or None if isinstance(value, str) else value
