"""Reads values as programs print them for people (``printed_values``, ``values_of_lines``, ``values_of_blocks``):
structures of Rust, Go, JavaScript, Java, Kotlin, C#, PHP and Lua, EDN, named arrays, messages of protocol buffers, and
lines of named values.

All these forms put names and values into brackets. A name may stand before a bracket ("Box3D {"), separators may be
commas, semicolons or white space, and a name is followed by ":", "=" or "=>", or begins with ":".
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, cast

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.plans.column_names import known_meanings
from petmjx.plans.nested_json import JsonLines
from petmjx.plans.raw_tables import MOST_COLUMNS
from petmjx.plans.table_sections import are_unplaced, begins_section, names_part, part_role

_MOST_PRINTED: Final = 8 << 20
"""Largest text that is read, in characters."""
_DEEPEST: Final = 30
"""Largest allowed depth of nested brackets."""
_VALUE_START: Final = re.compile(
    r"\s*(?:return\s*)?(?:&?[\[({]\s*){0,30}(?:&?[A-Za-z_][\w.\\]*(?: Object)?\s*)?&?[\[({]\s*"
    r"(?::[A-Za-z][\w-]*\s|[A-Za-z_$][\w$]*\s*(?::(?!:)|=)|\[['\"]?[\w:\\]+['\"]?\]\s*="
    r"|[A-Za-z_][\w.\\]*(?: Object)?\s*[\[({])"
)
"""The beginning of a printed structure: "[Box3D { position:", "{:pack [", "Array ( [x] =>"."""
_RETURN: Final = re.compile(r"\s*(?:return\b)?")
"""The beginning of a file of Lua that returns a table."""
_JSON_NAME: Final = re.compile(r'"[^"\n]*"(?:\s*:(?![A-Za-z])|\s*:(?:true|false|null|NaN)\b)')
"""A name in JSON. A text with such names is JSON, perhaps damaged, and is not read here. A colon directly before a
letter shows JSON only if the word is true, false, null or NaN, since in EDN such a colon is part of the next name."""
_OPEN: Final = re.compile(r"(?:Array\s*|[A-Za-z_][\w\\]* Object\s*|[#&]?([A-Za-z_][\w.:<>$]*)[ \t]*|&)?([\[({])")
"""A bracket, perhaps behind a name. PHP begins a new line between the name and the bracket. A pointer of Go begins with
"&", a tag of EDN with "#"."""
_CLOSING_BRACKETS: Final = {"[": "]", "(": ")", "{": "}"}
_SEPARATORS: Final = re.compile(r"[\s,;]*")
_GAP: Final = re.compile(
    r"(?:[\s,]++|;[^\S\n]*(?=\{:[\w-]+\s)[^\n]*|;;[^\n]*|;|//[^\n]*|/\*.*?\*/"
    r"|--\[\[.*?\]\]|--(?=[\s{(\[])(?!\s*(?:[,;\])}]|$))[^\n]*)*+",
    re.DOTALL,
)
"""White space, separators and comments. A single semicolon begins a comment only if an object of EDN follows;
otherwise, it is a separator. "--" before a separator is no comment, since it may stand for a missing value."""
_SPACE: Final = re.compile(r"\s*")
_QUOTED: Final = re.compile(r"""\\?(?:"((?:\\.|[^"\\])*)"|'((?:\\.|[^'\\])*)'|`([^`]*)`)""")
_NAME: Final = re.compile(
    r""":([A-Za-z][\w.?!/-]*)(?=\s)"""  # EDN
    r"""|\[\s*+['"]?([^\]\[\n'"]{1,200}+)['"]?\s*+\]\s*+=>?"""  # PHP, Lua; possessive quantifiers save backtracking
    r"""|:?['"]?([A-Za-z_$][\w$.-]*)['"]?\s*(?:=>|=(?!=)|:(?!:))"""
)
_EMPTY: Final = re.compile(r"[ \t]+(?=[A-Za-z_]\w{0,99}[:=](?:[^\s,;]++(?!\s*[,;])|[ \t]{1,9}[A-Za-z_]\w{0,99}[:=]))")
"""White space after a name that has no value. The next name and its value follow this white space, as in Go's "Note:
Weight:5". If a separator follows this value, what looks like the next name is a text: in "id: sku:123, x: 0", the value
of "id" is "sku:123"."""
_WORD: Final = re.compile(r"(?:(?!/\*)[^\s,;\[\](){}])+")
_TEXT: Final = re.compile(
    r"[^,;\[\](){}\n]{0,1000}?(?=\s{0,9}(?:[,;\])}\n]|/\*|$)|\s{1,9}(?://|--(?=[\s\[]))"
    r"|\s{1,9}:?[A-Za-z_]\w{0,99}[:=](?:\S|\s{0,9}(?:[\])}\n]|$)|\s{1,9}[A-Za-z_]\w{0,99}[:=]))"
)
"""A value behind a name. The value may have several words. It ends before a separator, a bracket, a comment or the
next name."""
_CONSTANTS: Final = {"true": True, "false": False, **dict.fromkeys(("nil", "null", "none", "undefined"), None)}
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?([fFdDL]?|[mM])")
_PAIR: Final = re.compile(r"([A-Za-z][\w .#/-]{0,40}?) ?[:=]")
_LONGEST_LINE: Final = 2_000
"""Longest line that is read as named values, in characters."""
_SEARCHED_LINES: Final = 40
"""Number of lines at the beginning of a text that show whether it has lines of named values."""
_LEAST_PAIRS: Final = 5
"""Fewest named values of a line that describes a box."""


_ARRAYS: Final = re.compile(
    r"\s*+(?:[#%/][^\n]*+\s*+)*+(?:\w++\s*+=\s*+-?[\w.]++\s*+;?\s*+)*+[A-Za-z_]\w*+\s*+=\s*+\[\s*+[-+.\d]"
)
"""The beginning of a text of named arrays, as MiniZinc and Octave print them: "x = [0, 400];"."""
_MESSAGES: Final = re.compile(
    r"\s*+(?:#[^\n]*+\s*+)*+(?!return\b)(?:[a-z_]\w*\s*:\s*(?:\"[^\"\n]*\"|[\w.+-]+)\s+)*[a-z_]\w*\s*\{\s*\w+\s*[:{]"
)
"""The beginning of messages of protocol buffers as text: "boxes { sku: ..."."""
_FIELD: Final = re.compile(r"#[^\n]*|\"(?:\\.|[^\"\\\n])*+\"?|(?<!\w)([A-Za-z_]\w{0,99})[ \t]{0,9}(:?[ \t]{0,9}\{|:)")
"""A field of a message of protocol buffers: "boxes {" or "sku:"; or a comment, or a text in quotation marks, which may
contain something that looks like a field."""
_RULES: Final = re.compile(r"^(?:[-=]{3,}|[#%][^\n]*)$", re.MULTILINE)
"""Lines without values that stand between named arrays: rules of dashes or equals signs, and comments."""


def printed_values(text: str) -> Any:
    """The values in a text that a program has printed: a structure, one structure in each line, named arrays, or
    messages of protocol buffers. The result is None for other texts.

    Raises:
        InputError: the text begins as a structure, but is damaged. The error names the line, but not the file.
    """
    are_messages = False
    if _ARRAYS.match(text):
        text = f"{{{_RULES.sub('', text)}}}"
    elif are_messages := (_MESSAGES.match(text) is not None):
        text = f"{{{_FIELD.sub(_with_separator, text).replace(',', ' ', 1)}}}"
    if len(text) > _MOST_PRINTED or _VALUE_START.match(text) is None or _JSON_NAME.search(text):
        return None
    values = JsonLines()
    places: list[int] = []
    at = _behind_gap(text, _behind(_RETURN, text, 0))
    line = 1 + text.count("\n", 0, at)
    while at < len(text):
        if _OPEN.match(text, at) is None:
            raise _fault(text, at, "there is text after a closing bracket")
        values.lines.append(line)
        places.append(at)
        value, end = _value(text, at, 0)
        values.append(value)
        end = _behind_gap(text, end)
        at, line = end, line + text.count("\n", at, end)
    _check_alike(text, places, values, 2)
    if are_messages:
        return _with_lists(values[0], _repeated_names(values[0]))
    return values[0] if len(values) == 1 else values


def _with_separator(field: re.Match[str]) -> str:
    if field[0].startswith("#"):
        return ""
    return f",{field[1]}: {field[2].lstrip(':')}" if field[1] else field[0]


def _repeated_names(value: Any) -> set[str]:
    """The names of all fields, at any depth of a nested value, whose value is a list with an object."""
    if isinstance(value, list):
        return set().union(*map(_repeated_names, value))
    names: set[str] = set()
    for name, inner in value.items() if isinstance(value, dict) else ():
        is_list = isinstance(inner, list) and any(isinstance(member, dict) for member in inner)
        names |= _repeated_names(inner) | ({name} if is_list else set())
    return names


def _with_lists(value: Any, names: Collection[str]) -> Any:
    """A copy of a nested value in which each single object under one of these names is replaced by a list with this
    object. All values under the name are then lists."""
    if isinstance(value, list):
        return [_with_lists(inner, names) for inner in value]
    if not isinstance(value, dict):
        return value
    inside = {name: _with_lists(inner, names) for name, inner in value.items()}
    return {name: [inner] if name in names and isinstance(inner, dict) else inner for name, inner in inside.items()}


def values_of_lines(text: str) -> JsonLines | None:
    """The values in lines of named values, "Item: A, Position: (0, 0, 0), Dimensions: 40 x 30 x 20"; None for other
    texts. Lines above the first and below the last of these lines are left out. Titles ("Pallet 2:") become fields of
    the boxes below them.

    Raises:
        InputError: a line between two lines of named values has no named values. The error names the line.
    """
    lines = text.splitlines()
    first = [line for line in lines[:_SEARCHED_LINES] if line.strip()]
    if sum(len(re.findall("[:=]", line)) >= _LEAST_PAIRS for line in first) * 2 <= len(first):
        return None
    records = [_pairs_of_line(line) for line in lines]
    used = [index for index, record in enumerate(records) if len(record) >= _LEAST_PAIRS]
    if len(used) < 2 or len(used) * 2 <= sum(map(bool, map(str.strip, lines))):
        return None
    names = {name for index in used for name in records[index]}
    if len(known_meanings(sorted(names))) < 2:
        return None
    values = JsonLines()
    above = [line.strip() for line in lines[: used[0]] if line.strip()]
    title = first_title = above[-1] if above and names_part(above[-1]) else ""
    for index in range(used[0], used[-1] + 1):
        line = lines[index].strip()
        if not line:
            continue
        if len(records[index]) >= _LEAST_PAIRS:
            values.append({**_fields_of_title(title), **records[index]})
            values.lines.append(index + 1)
        elif are_unplaced(line) or begins_section(line, first_title):
            title = line
        elif not (are_unplaced(title) and records[index]):
            raise InputError(f"line {index + 1}: is no box: {printable_name(line)}")
    return values


def _fields_of_title(title: str) -> Mapping[str, str]:
    """The field that the title of a section gives to its boxes."""
    if not title:
        return {}
    return {"placed": "no"} if are_unplaced(title) else {part_role(title): title.rstrip(": ")}


def _pairs_of_line(line: str) -> Mapping[str, Any]:
    """The named values of a line; empty if the line also has values without names, or a damaged value."""
    pairs: dict[str, Any] = {}
    at, end = len(line) - len(line.lstrip()), len(line) if len(line) <= _LONGEST_LINE else 0
    while at < end:
        if (match := _PAIR.match(line, at)) is None or match[1] in pairs:
            return {}
        try:
            pairs[match[1]], at = _value_of_name(line, match.end(), 0)
        except InputError:
            return {}
        at = _behind(_SEPARATORS, line, at)
    return pairs


_BLOCK: Final = re.compile(r"\s*(?:\*{3,} \d+\. row \*{3,}|-\[ RECORD \d+ \][-+]*|\[([^\[\]\n]{1,100})\])\s*")
"""The line above the values of a record, as MySQL and PostgreSQL print them, or above a section of an INI file."""
_NAMED: Final = re.compile(r"\s*([A-Za-z][\w .#/-]{0,40}?)\s*[:=|]\s*(.*)")
_COMMENT: Final = re.compile(r"\s*(?:[;#].*)?")


def values_of_blocks(text: str) -> Any:
    """The values in blocks of lines. A line such as "[box1]" begins a block, and each further line has one named value.
    The result is None for other texts. Blocks whose names have the same letters become one list: "[box1]", "[box2]".

    Raises:
        InputError: a line of a block has no named value, or the name of an earlier line of the block. The error names
            the line.
    """
    lines = text.splitlines()
    heads = [index for index, line in enumerate(lines) if _BLOCK.fullmatch(line)]
    if len(heads) < 2 or any(not _COMMENT.fullmatch(line) for line in lines[: heads[0]]):
        return None
    lists: dict[str, JsonLines] = {}
    sections: list[tuple[str, str, dict[str, Any]]] = []  # name, letters of the name, named values
    fault = ""
    for head, end in zip(heads, [*heads[1:], len(lines)], strict=True):
        section = cast(re.Match[str], _BLOCK.fullmatch(lines[head]))[1] or ""
        pairs: dict[str, Any] = {"section": section} if section else {}
        for index in range(head + 1, end):
            if (named := _NAMED.fullmatch(lines[index])) is not None and named[1] not in pairs:
                pairs[named[1]] = named[2].strip() or None
            elif not _COMMENT.fullmatch(lines[index]) and (end < len(lines) or named is not None):
                what = "is no named value" if named is None else "its name stands twice"
                fault = fault or f"line {index + 1}: {what}: {printable_name(lines[index].strip())}"
        letters = re.sub(r"[\W\d_]+", "", section)
        values = lists.setdefault(letters, JsonLines())
        values.append(pairs)
        values.lines.append(head + 1)
        sections.append((section, letters, pairs))
    boxes = max(lists.values(), key=len)
    titles = [name for name, some in lists.items() if some is not boxes and names_part(name) and len(some) > 1]
    title = ""
    for section, letters, pairs in sections if titles else ():  # boxes below "[pallet2]"
        if letters in titles:
            title = section
        else:
            pairs |= _fields_of_title(title)
    n_known = len(known_meanings(boxes[0])) if len(boxes) > 1 and len(boxes[0]) <= MOST_COLUMNS else 0
    # if fewer fields are known, blocks may be something else: "[Pallet 1]" may be the title of a section of a table
    if n_known < _LEAST_PAIRS:
        return None
    if fault:
        raise InputError(fault)
    return boxes if len(lists) == 1 else {name: some if len(some) > 1 else some[0] for name, some in lists.items()}


def _value(text: str, at: int, depth: int, decimal_marks: str = "") -> tuple[Any, int]:
    """The value at a position of a text, and the position behind the value."""
    if depth > _DEEPEST:
        raise _fault(text, at, "brackets are nested too deeply")
    if (opened := _OPEN.match(text, at)) is not None:
        value, end = _inside(text, opened.end(), opened[1] or "", _CLOSING_BRACKETS[opened[2]], depth)
        # Rust prints an optional value as Some(5): the value is 5
        return (value[0] if opened[1] == "Some" and isinstance(value, list) and len(value) == 1 else value), end
    if (quoted := _QUOTED.match(text, at)) is not None:
        return next(part for part in quoted.groups() if part is not None), quoted.end()
    word = _WORD.match(text, at)
    if word is None:
        raise _fault(text, at, "a value is missing")
    return _scalar(word[0], decimal_marks), word.end()


def _value_of_name(text: str, at: int, depth: int, decimal_marks: str = "") -> tuple[Any, int]:
    """The value that follows a name and the sign after the name (":", "=" or "=>"). The value is "" if the line ends
    after the sign, or if the next name follows. Brackets and quoted texts may stand on the next line. The function also
    returns the position behind the value.

    Args:
        decimal_marks: letters that may end a number without being a unit.
    """
    if (empty := _EMPTY.match(text, at)) is not None:
        return "", empty.end()
    behind = _behind(_SPACE, text, at)
    if "\n" in text[at:behind]:
        is_value = _NAME.match(text, behind) is None and (_OPEN.match(text, behind) or _QUOTED.match(text, behind))
        if not is_value:
            return "", behind
    at = behind
    if _OPEN.match(text, at) is not None or _QUOTED.match(text, at) is not None:
        return _value(text, at, depth)
    if (words := _TEXT.match(text, at)) is None:
        raise _fault(text, at, "a value has no end")
    return _scalar(words[0].strip(), decimal_marks), words.end()


def _inside(text: str, at: int, kind: str, close: str, depth: int) -> tuple[Any, int]:
    """The values in brackets (an object if the values have names, else a list), and the position behind the brackets.

    Args:
        kind: the name before the bracket.
    """
    pairs: dict[str, Any] = {}
    repeated: set[str] = set()
    """Names that stand before several objects each, such as "boxes" in messages of protocol buffers."""
    items: list[Any] = []
    places: list[int] = []
    begin = at
    while True:
        at = _behind_gap(text, at, depth)
        if at == len(text):
            raise _fault(text, begin, "a bracket is not closed")
        if text[at] in "])}":
            if text[at] != close:
                raise _fault(text, at, f"{text[at]} closes no bracket")
            break
        if (name := _NAME.match(text, at)) is not None:
            key = next(filter(None, name.groups())).strip()
            key = re.sub(r"(?::[\w\\]+)?:(?:private|protected)$", "", key)  # PHP: "x:protected", "x:Box:private"
            begin_of_pair = at
            if name[1]:  # EDN puts texts into quotation marks, so an unquoted value is one word
                value, at = _value(text, _behind(_SPACE, text, name.end()), depth + 1, "M")
            else:
                # C# and F# print records as "{ X = 0.4M }". C# writes the record's name (``kind``) before them, F# does
                # not.
                of_dotnet = close == "}" and name[0].endswith(" =")
                marks = ("mM" if kind else "M") if of_dotnet else ""
                value, at = _value_of_name(text, name.end(), depth + 1, marks)
            if key not in pairs:
                pairs[key] = value
            elif isinstance(value, dict) and (key in repeated or isinstance(pairs[key], dict)):
                if key not in repeated:
                    pairs[key] = [pairs[key]]
                    repeated.add(key)
                pairs[key].append(value)
            else:
                raise _fault(text, begin_of_pair, f"{printable_name(key)} stands twice")
        else:
            places.append(at)
            value, at = _value(text, at, depth + 1)
            items.append(value)
    if pairs and items:
        raise _fault(text, begin, "a value has no name")
    _check_alike(text, places, items, 1)
    return (pairs or items), at + 1


def _check_alike(text: str, places: Sequence[int], items: Sequence[Any], least: int) -> None:
    """Refuse a list in which at least ``least`` items are objects, and another item holds no object: the box of this
    item would be lost."""
    others = [place for place, item in zip(places, items, strict=True) if not (item is None or _has_objects(item))]
    if others and sum(isinstance(item, dict) for item in items) >= least:
        raise _fault(text, others[0], "this value is no object, unlike others in its list")


def _has_objects(value: Any) -> bool:
    """Whether a value is an object, an empty list, or a list that contains such a value."""
    return isinstance(value, dict) or (isinstance(value, list) and (not value or any(map(_has_objects, value))))


def _scalar(text: str, decimal_marks: str = "") -> Any:
    """The number, truth value or None that a text stands for; else the text itself. "0.4m" is a length, and so a text,
    unless "m" is one of the ``decimal_marks``: then it is the number 0.4."""
    if text.lower() in _CONSTANTS:
        return _CONSTANTS[text.lower()]
    if (number := _NUMBER.fullmatch(text)) is not None and (number[1] not in ("m", "M") or number[1] in decimal_marks):
        text = text.rstrip("fFdDmML")
        return float(text) if re.search(r"[.eE]", text) else int(text) if len(text) < 20 else float(text)
    return text


def _behind_gap(text: str, at: int, depth: int = 0) -> int:
    """The first position from ``at`` on that is behind white space, separators, comments, and values that EDN leaves
    out ("#_{:x 0}")."""
    at = _behind(_GAP, text, at)
    while text.startswith("#_", at):
        _, end = _value(text, _behind(_GAP, text, at + 2), depth + 1)
        at = _behind(_GAP, text, end)
    if text.startswith(("/*", "--[["), at):
        raise _fault(text, at, "a comment has no end")
    return at


def _behind(pattern: re.Pattern[str], text: str, at: int) -> int:
    """The position behind the match of a pattern at the position ``at``; ``at`` itself if the pattern does not match
    there."""
    match = pattern.match(text, at)
    return at if match is None else match.end()


def _fault(text: str, at: int, why: str) -> InputError:
    line = text.count("\n", 0, at) + 1
    return InputError(f"not readable at line {line}, column {at - text.rfind(chr(10), 0, at)} ({why})")
