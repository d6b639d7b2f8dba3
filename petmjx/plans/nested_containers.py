"""Reads what boxes in nested objects (JSON) get from the objects around them: names of plans, sizes of containers,
weights and sizes of articles, and coordinates of layers and stacks."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from petmjx.plans.cell_numbers import cell_number, cell_text
from petmjx.plans.column_names import (
    CONTAINER_WORDS,
    LENGTH_UNITS,
    ColumnMeaning,
    known_meanings,
    names_deck,
    plain_text,
    word_set,
    words_of,
)
from petmjx.plans.nested_fields import flattened

LAYERS: Final = word_set("layer layers level levels tier tiers lage lagen schicht schichten row rows couches")
"""Words for lists, sheets and sections whose members are parts of one plan."""
STACKS: Final = word_set("stack stacks tower towers column columns pile piles block blocks")
"""Words for parts of a plan that stand beside each other."""
_NAMES: Final = (
    "planid", "orderid", "palletid", "containerid", "binid", "loadid", "plan",
    "id", "name", "sscc", "palletnumber", "partno", "bin", "pallet", "container", "bezeichnung", "nom", "nombre",
    "nome", "naam", "nazwa", "index", "number", "no", "nr", "nummer", "numero", "numer",
)  # fmt: skip
"""Fields that name a plan, most reliable first, in lower case and without "_". The field "palletnumber" stands for all
fields that ``_OF_PALLETS`` matches."""
_OF_PALLETS: Final = re.compile(
    rf"(?:{'|'.join(sorted(CONTAINER_WORDS))})[\W_]*(?:nr|no|num|number|nummer|numer|numero|code|key|id)"
)
"""A field with the number or the key of a pallet, such as "Palettennummer"."""
_N_OF_PLANS: Final = 7
"""Number of fields at the beginning of ``_NAMES`` that name a plan wherever they are in a file."""
CONTAINERS: Final = word_set(
    "container containers bin bins pallet pallets truck trucks carrier carriers vehicle box_size bin_size binsize "
    "containersize palletsize load_carrier"
)
"""Words in names of fields that hold a container, or a list of containers."""
_PRINTED_SIZES: Final = re.compile(r"\(?\s*([\d.]+)\s*[x×]\s*([\d.]+)\s*[x×]\s*([\d.]+)")


@dataclass(frozen=True, eq=False)
class NestedBox:
    """One object of a list, and its path.

    Attributes:
        value: the object.
        place: its path in the file: "containers[0].boxes[3]".
        around: the objects that contain this object, outermost first. Each entry of ``around`` is a pair of the last
            part of a containing object's path, such as "containers[0]", and the containing object.
    """

    value: Mapping[str, Any]
    place: str
    around: tuple[tuple[str, Mapping[str, Any]], ...]


def fields_of_part(
    member: NestedBox,
    own_fields: Mapping[str, Any],
    of_parts: dict[int, tuple[dict[str, Any], dict[str, ColumnMeaning]]],
) -> dict[str, Any]:
    """The coordinates and the height that a box lacks, from the layer or stack that contains it.

    Args:
        own_fields: the fields of the box.
        of_parts: id of a layer or stack → its numbers, and the meanings of their fields. This function adds entries.
    """
    step, holder = member.around[-1] if member.around else ("", {})
    if not (LAYERS | STACKS).intersection(words_of(step)):
        return {}
    given = {(meaning.kind, meaning.axis) for meaning in known_meanings(own_fields).values()}
    if ("positions", "") in given or ("sizes", "") in given or not any(kind == "position" for kind, _ in given):
        return {}
    if id(holder) not in of_parts:
        numbers = _numbers_in(holder)
        of_parts[id(holder)] = numbers, known_meanings(numbers)
    fields, meanings = of_parts[id(holder)]
    lacking = {*(("position", axis) for axis in "xyz"), ("size", "height")} - given
    return {
        name: fields[name]
        for name, meaning in meanings.items()
        if (meaning.kind, meaning.axis) in lacking and not _BOTTOMS.intersection(words_of(name))
    }


def _numbers_in(holder: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of an object that are numbers, also in objects within it, but not in lists."""
    flat = flattened({name: value for name, value in holder.items() if not isinstance(value, list | tuple)})
    return {name: value for name, value in flat.items() if cell_number(value) is not None}


def add_bottoms(members: Sequence[NestedBox], rows: Sequence[dict[str, Any]]) -> list[str]:
    """Add z to boxes that have x and y, but no z, from the layers around the boxes.

    z is the height of the bottom of a box's layer. This height is in the layers' only field of numbers that has a word
    of ``_BOTTOMS`` in its name, and whose numbers do not count the layers. If there is no such field, or more than one,
    the boxes get all numbers of their layers, so that the user can name one as z. Returns a note about the field.

    Args:
        rows: the fields of each member, which are changed.
    """
    known = {(meaning.kind, meaning.axis) for row in rows for meaning in known_meanings(row).values()}
    if ("position", "x") not in known or known & {("position", "z"), ("positions", "")}:
        return []
    around = [member.around[-1] if member.around else ("", {}) for member in members]
    if not all(LAYERS.intersection(words_of(step)) for step, _ in around):
        return []
    layers = {id(holder): _numbers_in(holder) for _, holder in around}
    names = dict.fromkeys(name for numbers in layers.values() for name in numbers)
    bottoms = [
        name
        for name in names
        if _BOTTOMS.intersection(words_of(name))
        and not _are_counted([numbers.get(name) for numbers in layers.values()])
    ]
    for row, (_, holder) in zip(rows, around, strict=True):
        numbers = layers[id(holder)]
        if len(bottoms) == 1:
            row["z"] = numbers.get(bottoms[0])
        else:
            row.update({name: value for name, value in numbers.items() if name not in row})
    return [f"z from {bottoms[0]} of layers"] if len(bottoms) == 1 else []


_BOTTOMS: Final = word_set("base bottom elevation level deck unten unterkante onderkant")
"""Words in names of the heights at which layers begin."""


def _are_counted(cells: Sequence[Any]) -> bool:
    """Whether the numbers of several layers count them, from 0 or 1."""
    values = {number.value for cell in cells if (number := cell_number(cell)) is not None}
    return len(values) > 1 and values in ({*range(len(values))}, {*range(1, len(values) + 1)})


def articles_around(members: Sequence[NestedBox]) -> frozenset[int]:
    """Python's ``id`` of each object around boxes that describes an article. The object of an article holds the places
    of all boxes of the article. Either all members of a list are articles, or none is.

    The members of a list with a name such as "items" may also be pallets. The members are articles if they have sizes
    or a word for articles, and if no member has a word for pallets in its fields or its name. But if each member has a
    box at the place of a box of another member, the members are pallets. If several objects have lists of the same
    name, either the members of all these lists are articles, or none is.
    """
    lists: dict[tuple[int, str], dict[int, dict[int, Mapping[str, Any]]]] = {}
    boxes: dict[int, list[Mapping[str, Any]]] = {}
    for member in members:
        for level, (step, holder) in enumerate(member.around):
            if step.endswith("]") and _is_article(step):
                around = id(member.around[level - 1][1]) if level else 0
                alike = lists.setdefault((level, step.partition("[")[0]), {})
                alike.setdefault(around, {})[id(holder)] = holder
                boxes.setdefault(id(holder), []).append(member.value)
    return frozenset(
        number
        for alike in lists.values()
        if all(_describes_article(holder) for holders in alike.values() for holder in holders.values())
        and not any(_at_same_places([boxes[number] for number in holders]) for holders in alike.values())
        for holders in alike.values()
        for number in holders
    )


def _describes_article(holder: Mapping[str, Any]) -> bool:
    """Whether an object has sizes or a word for articles in its fields, and neither its fields nor its name has a word
    for pallets."""
    names = [str(name) for name in holder]
    if any(CONTAINER_WORDS.intersection(words_of(name)) and "per" not in words_of(name) for name in names):
        return False
    if any(CONTAINER_WORDS.intersection(words_of(_name_text(holder.get(name)))) for name in ("name", "id", "label")):
        return False
    flat = flattened({name: value for name, value in holder.items() if not isinstance(value, list | tuple)})
    has_sizes = any(meaning.kind in ("size", "sizes") for meaning in known_meanings(flat).values())
    return has_sizes or any(_ARTICLES.intersection(words_of(name)) for name in flat)


def _at_same_places(groups: Sequence[Sequence[Mapping[str, Any]]]) -> bool:
    """Whether each group of boxes has a box at the place of a box of another group."""
    places = []
    for group in groups:
        flats = [flattened(box) for box in group]
        names = [name for name, meaning in known_meanings(flats[0]).items() if meaning.kind in _PLACES]
        places.append({tuple(str(flat.get(name)) for name in names) for flat in flats} if names else set())
    counts = Counter(place for group in places for place in group)
    return len(groups) > 1 and all(any(counts[place] > 1 for place in group) for group in places)


def fields_of_article(
    member: NestedBox, own_fields: Mapping[str, Any], articles: Collection[int]
) -> tuple[dict[str, Any], str]:
    """The weight, the name and the sizes that a box lacks, taken from its article. The article is an object "cargo" or
    "item" beside the list of boxes, or the member of a list of articles that contains the list of boxes. The function
    also returns a note that tells where weights or sizes are from; "" if the article gives none.

    Args:
        own_fields: the fields of the box.
        articles: Python's ``id`` of each object that is an article (``articles_around``).
    """
    given = {meaning.kind for meaning in known_meanings(own_fields).values()}
    if not given & _PLACES or "weight" in given:
        return {}, ""
    for step, holder in reversed(member.around):
        inner = (
            (name, value) for name, value in holder.items() if isinstance(value, Mapping) and _is_article(str(name))
        )
        around = (f"{step.partition('[')[0]}[]", holder) if id(holder) in articles else ("", None)
        source, article = next(inner, around)
        if article is None or any(names_deck(text) for text in article.values() if isinstance(text, str)):
            continue
        flat = flattened({name: value for name, value in article.items() if not isinstance(value, list | tuple)})
        meanings = known_meanings(flat)
        kinds = {meaning.kind for meaning in meanings.values() if not meaning.of_container}
        if (
            not kinds & {"weight", "size", "sizes"}
            or kinds & _PLACES
            or _is_deck(_sizes_in(flat), _sizes_in(own_fields))
        ):
            continue
        lacking = _OF_ARTICLES - given - ({"size", "sizes"} if given & {"size", "sizes", "high"} else set())
        fields = {
            name: meaning.kind
            for name, meaning in meanings.items()
            if meaning.kind in lacking and name not in own_fields
        }
        taken = {"weights": "weight", "sizes": "size"}
        words = [word for word, kind in taken.items() if kind in {value.removesuffix("s") for value in fields.values()}]
        return {name: flat[name] for name in fields}, f"{' and '.join(words)} from {source}" if words else ""
    return {}, ""


def _is_deck(sizes: Mapping[str, float], of_box: Mapping[str, float]) -> bool:
    """Whether an object is as flat as a deck, and larger than a box beside it.

    Args:
        sizes: axis → size of the object; empty if it has no sizes.
        of_box: axis → size of the box.
    """
    if not sizes or not of_box:
        return False
    (thickness, *base), (height, *base_of_box) = sorted(sizes.values()), sorted(of_box.values())
    ratios = [thickness / height, *(side / other for side, other in zip(base, base_of_box, strict=True))]
    in_other_unit = max(ratios) <= _LARGEST_EQUAL_RATIO * min(ratios)
    return thickness <= FLAT * base[0] and min(ratios[1:]) > _LARGEST_EQUAL_RATIO and not in_other_unit


FLAT: Final = 0.4
"""Largest ratio of a pallet's height to its width. A half pallet, 800 × 600 × 144 mm, has a ratio of 0.24."""
_LARGEST_EQUAL_RATIO: Final = 1.02
"""Largest ratio of two sizes that count as the same, since files have rounded sizes."""
_PLACES: Final = frozenset(("position", "positions", "low"))
_OF_ARTICLES: Final = frozenset(("weight", "size", "sizes", "article", "item_id"))
_ARTICLES: Final = word_set(
    "cargo cargoes article articles artikel item items product products produkt sku skus good goods cargotype itemtype"
)
"""Words for an object that describes an article, or for a list of such objects."""


def _is_article(name: str) -> bool:
    words = words_of(name.partition("[")[0])
    return bool(words) and words[-1] in _ARTICLES and not CONTAINERS.intersection(words)


def plan_names_of(members: Sequence[NestedBox], articles: Collection[int]) -> tuple[list[str], list[str]]:
    """The name of each member's plan, from the objects around the member. If the members are in several objects, each
    plan has the name of its object. If these objects are in several objects, too, such as pallets in orders, the plan's
    name is "order/pallet". Layers, stacks and articles do not count as such objects. If one object holds all members,
    the innermost name around them is the name of the only plan.

    The function also returns the ids or names that several plans have, with their fields ("id 7"). These plans are
    named by other fields or by their numbers. There are none if pallets are in several orders, because each order may
    have pallets with the same ids.

    Args:
        articles: Python's ``id`` of each object that is an article (``articles_around``).
    """
    several = _levels_of_plans(members, articles)
    if not several:
        return [_only_name(members[0].around)] * len(members) if members else [], []
    names = []
    ids: Counter[str] = Counter()
    for level in several:
        distinct = {id(holder): (step, holder) for step, holder in level}
        by_holder = dict(zip(distinct, _names_of(list(distinct.values())), strict=True))
        names.append([by_holder[id(holder)] for _, holder in level])
        for number, (_, holder) in distinct.items() if len(several) == 1 else ():
            firsts = [(field, text) for field, text in _texts_of_names(holder).items() if field.endswith(_IDS)][:1]
            ids.update(f"{field} {text}" for field, text in firsts if text != by_holder[number])
    repeated = [text for text, count in ids.items() if count > 1]
    return ["/".join(filter(None, parts)) for parts in zip(*names, strict=True)], repeated


_IDS: Final = ("id", "name", "sscc")
"""Endings of the names of fields whose texts should differ between plans."""


def _levels_of_plans(
    members: Sequence[NestedBox], articles: Collection[int]
) -> list[list[tuple[str, Mapping[str, Any]]]]:
    """The levels of nesting at which the members of a list are in different objects that are no layers, stacks or
    articles. A level is given as a pair for each member: the last part of the path of the object around the member, and
    this object. Several levels may divide the members in the same way, as in answers of GraphQL
    (``edges[0].node.placements``). Then a level counts only if all its objects have names. If there is no such level,
    only the first one counts."""
    depth = max((len(member.around) for member in members), default=0)
    levels = [
        [member.around[level] if level < len(member.around) else ("", {}) for member in members]
        for level in range(depth)
    ]
    alike: dict[tuple[int, ...], list[list[tuple[str, Mapping[str, Any]]]]] = {}
    for level in levels:
        numbers: dict[int, int] = {}
        division = tuple(numbers.setdefault(id(holder), len(numbers)) for _, holder in level)
        if len(numbers) > 1 and not (_is_part(level[0][0]) or all(id(holder) in articles for _, holder in level)):
            alike.setdefault(division, []).append(level)
    return [
        level
        for same in alike.values()
        for level in [
            one
            for one in same
            if len(same) > 1 and all(_names_in([*{id(holder): holder for _, holder in one}.values()]))
        ]
        or same[:1]
    ]


def _is_part(step: str) -> bool:
    """Whether the members of a list with this name are parts of one plan: its layers, or several stacks."""
    words = set(words_of(step))
    return bool(words & LAYERS) or (bool(words & STACKS) and step.endswith("]"))


def _only_name(around: Sequence[tuple[str, Mapping[str, Any]]]) -> str:
    """The name of a file's only plan; "" if no field gives a name."""
    for _, holder in reversed(around):
        texts = _texts_of_names(holder)
        if text := next((texts[name] for name in (*_NAMES[:_N_OF_PLANS], "sscc") if name in texts), ""):
            return text
    for step, holder in reversed(around):
        # {"id": step} stands for a list whose key is the name of the plan
        if step.endswith("]") or not step or holder == {"id": step}:
            texts = _texts_of_names(holder)
            if text := next((texts[name] for name in ("id", "name", "bin", "partno") if name in texts), ""):
                return text
    return ""


def _names_of(holders: Sequence[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """The names of objects around boxes. The fields of ``_NAMES`` are tried in order. An object is named by the text of
    the first field in which no other object has the same text. If there is no such field, a member of a list is named
    by its number, from 1, and any other object by the last part of its path."""
    names = []
    for (step, _), name in zip(holders, _names_in([holder for _, holder in holders]), strict=True):
        member = re.search(r"\[(\d+)\]$", step)
        names.append(name or (step if member is None else str(int(member[1]) + 1)))
    return names


def _names_in(holders: Sequence[Mapping[str, Any]]) -> list[str]:
    """For each object, its text in the first field of ``_NAMES`` in which no other object has the same text; "" if
    there is no such field."""
    of_holders = [_texts_of_names(holder) for holder in holders]
    texts = {name: [named.get(name, "") for named in of_holders] for name in _NAMES}
    counts = {name: Counter(values) for name, values in texts.items()}
    return [
        next((row[number] for name, row in texts.items() if row[number] and counts[name][row[number]] == 1), "")
        for number in range(len(holders))
    ]


def _texts_of_names(holder: Mapping[str, Any]) -> dict[str, str]:
    """Field (as in ``_NAMES``) → its text, for the fields that may name a plan, most reliable first."""
    texts: dict[str, str] = {}
    for name, value in holder.items():
        if text := _name_text(value):
            field = str(name).lower().replace("_", "")
            is_number = field not in _NAMES and _OF_PALLETS.fullmatch(plain_text(field)) is not None
            texts.setdefault("palletnumber" if is_number else field, text)
    return {name: texts[name] for name in _NAMES if name in texts}


def _name_text(value: Any) -> str:
    if isinstance(value, str):
        printed = re.match(r"^([\w .#-]+)\([\d.]+\s*x", value)  # py3dbp prints "euro(1200x800x1500, …)"
        return (printed[1] if printed else value).strip()[:1000]
    return cell_text(value) if isinstance(value, int | float) and not isinstance(value, bool) else ""


def container_around(member: NestedBox, articles: Collection[int]) -> dict[str, float]:
    """The size of the container of a box, by axis; empty if no size is given. The sizes are in the unit of the box's
    coordinates, if the file names the units of both. The height may be missing.

    Args:
        articles: Python's ``id`` of each object that is an article (``articles_around``).
    """
    unit = "mm" if _has_units(member.value) else _unit_of(flattened(member.value))
    for step, holder in reversed(member.around):
        if id(holder) in articles:
            continue
        for name, inner in holder.items():
            words = words_of(str(name))
            if str(name).lower() == "box" and isinstance(inner, list) and len(inner) == 1:
                (inner,) = inner
            # In py3dbp's web API, the container "box" is beside the list of its boxes.
            is_box = isinstance(inner, Mapping) and str(name).lower() == "box"
            if not (CONTAINERS.intersection(words) or str(name).lower() in CONTAINERS or is_box):
                continue
            if isinstance(inner, Mapping) and (sizes := _sizes_in(inner, unit, is_deck=True)):
                return sizes
            if isinstance(inner, list | tuple) and len(inner) == 3 and all(map(cell_number, inner)):
                return {str(axis): float(cell_number(cell).value) for axis, cell in enumerate(inner)}  # type: ignore[union-attr]  # as just checked
            if isinstance(inner, str) and (printed := _PRINTED_SIZES.search(inner)):
                return dict(zip(("width", "height", "depth"), map(float, printed.groups()), strict=True))
        alone = {
            name: inner for name, inner in holder.items() if not (isinstance(inner, list) and _holds_objects(inner))
        }
        is_deck = bool(CONTAINERS.intersection(words_of(step)))
        if (sizes := _sizes_in(alone, unit, is_deck=is_deck)) and step != "":
            return sizes
        if sizes and set(holder) & {"items", "boxes", "placements", "stack", "fitted_items", "packages"}:
            return sizes
    return {}


def _holds_objects(value: Sequence[Any]) -> bool:
    return any(isinstance(inner, Mapping) for inner in value[:1])


def _has_units(value: Mapping[str, Any]) -> bool:
    """Whether a size or coordinate in the fields of an object has a unit of its own, such as "40 cm"."""
    flat = flattened(value)
    cells = (cell_number(flat[name]) for name, meaning in known_meanings(flat).items() if meaning.kind in _LENGTHS)
    return any(number is not None and number.unit in LENGTH_UNITS for number in cells)


_LENGTHS: Final = _PLACES | {"size", "sizes", "high"}


def _unit_of(flat: Mapping[str, Any]) -> str:
    """The unit of the lengths in an object: from the name of a field with a length, or from a field of units; "" if
    neither gives a unit."""
    units = [meaning.unit for meaning in known_meanings(flat).values() if meaning.kind in _LENGTHS]
    units += [str(cell).lower() for name, cell in flat.items() if words_of(name)[-1:] in (["unit"], ["units"], ["uom"])]
    return next((unit for unit in units if unit in LENGTH_UNITS), "")


def _sizes_in(value: Mapping[str, Any], unit: str = "mm", *, is_deck: bool = False) -> dict[str, float]:
    """Axis → size, from the fields of an object; empty unless there are three sizes.

    Args:
        unit: sizes with a unit are converted to this unit; "": all sizes stay as they are in the file.
        is_deck: whether a length and a width are enough.
    """
    flat = flattened(value)
    sizes: dict[str, float] = {}
    unit_of_all = _unit_of(flat)
    for name, meaning in known_meanings(flat).items():
        number = cell_number(flat[name])
        if meaning.kind != "size" or number is None or number.value <= 0:
            continue
        # a name such as "dimension1" gives no axis, so its number is left out
        if meaning.axis not in "012" or name.endswith("]"):
            own_unit = number.unit if number.unit in LENGTH_UNITS else unit_of_all
            factor = LENGTH_UNITS[own_unit] / LENGTH_UNITS[unit] if own_unit and unit else 1.0
            sizes.setdefault(meaning.axis, number.value * factor)
    return sizes if len(sizes) == 3 or (is_deck and sizes.keys() == {"length", "width"}) else {}
