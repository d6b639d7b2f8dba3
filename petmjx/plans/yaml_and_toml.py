"""Reads YAML and TOML (``value_of_yaml``, ``value_of_toml``) as the nested values that JSON has.

petmjx reads the part of YAML that programs write: block mappings and sequences, flow mappings and sequences, scalars,
comments, and several documents in one file. Anchors, tags and texts of several lines are refused.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from petmjx.common.errors import InputError
from petmjx.plans.column_names import known_meanings

_QUOTED: Final = r"""(?:"(?:\\.|[^"\\])*"|'(?:''|[^'])*')"""
_KEY: Final = re.compile(rf"""^((?:{_QUOTED}|[^\W_][\w .$/°-]*?|_\w+))\s*:(?:\s+(.*))?$""")
"""A line with the key of a mapping, and its value if the value is in the same line."""
_FLOW_KEY: Final = re.compile(rf"({_QUOTED}|[^:,{{}}\[\]]+?)\s*:\s*")
_FLOW_SCALAR: Final = re.compile(rf"\s*({_QUOTED}|[^,\]}}]*)")
_SPACE: Final = re.compile(r"\s*")
_ITEM: Final = re.compile(r"^-(?:\s+(.*))?$")
_TOML_TABLE: Final = re.compile(r"^\s*\[\[?\s*[\w\"'.-]+\s*\]?\]\s*(?:#.*)?$", re.MULTILINE)
_TOML_PAIR: Final = re.compile(r"^\s*[\w\"'.-]+\s*=\s*\S")
_QUOTED_OR_COMMENT: Final = re.compile(rf"((?:^|[\[{{,:]|-\s)\s*{_QUOTED})|(?:^|\s)#.*")
"""A text in quotes (group 1) or a comment. Within a plain text, quotes are ordinary characters: "Bob's", "5\" box"."""
_NUMBER: Final = re.compile(r"^[+-]?(?:(?:0|[1-9]\d*)\.?\d*|\.\d+)(?:[eE][+-]?\d+)?$")
"""A number. Digits that begin with a needless 0, such as 00123, are an id and not a number."""
_WORDS: Final = {
    "": None, "~": None, "null": None, "true": True, "false": False, "yes": True, "no": False,
    ".nan": float("nan"), ".inf": float("inf"), "-.inf": float("-inf"),
}  # fmt: skip
_ANSWERS: Final = ("yes", "no")
"""Words that stay text in lists, although YAML reads them as truth values: an id may be "no", and programs write truth
values as true and false."""
_LAST_CODE_POINT: Final = 0x10FFFF
_ESCAPED: Final = re.compile(r"\\(x[\da-fA-F]{2}|u[\da-fA-F]{4}|U[\da-fA-F]{8}|.)", re.DOTALL)
_ESCAPES: Final = {
    **{letter: letter for letter in '"/\\ '}, "0": "\0", "a": "\a", "b": "\b", "e": "\x1b", "f": "\f", "n": "\n",
    "r": "\r", "t": "\t", "v": "\v", "N": "\x85", "_": "\xa0", "L": "\u2028", "P": "\u2029",
}  # fmt: skip
"""Letter after a backslash in a text in double quotes → the character that backslash and letter together stand for."""
_DEEPEST: Final = 50
"""Largest allowed depth of nested values."""
_FORMATS: Final = {".toml": "TOML", ".yaml": "YAML", ".yml": "YAML"}
_NAMES: Final = ("article", "item_id", "plan", "group", "material")
"""Kinds of fields with names and ids. Their values stay text, even values such as ``no``, ``1e5`` and ``1.10``, which
elsewhere are a truth value or a number."""


class _Line(NamedTuple):
    """A line with content: its number from 1, its indent, and its text without indent and comment."""

    number: int
    indent: int
    text: str


def nested_format(text: str, path: Path | None) -> str | None:
    """The format of a text: "TOML", "YAML", or None for others. If the lines of the text do not show the format, the
    name of the file decides."""
    if _is_toml(text):
        return "TOML"
    if _is_yaml(text):
        return "YAML"
    if path is None or not text.strip():
        return None
    return _FORMATS.get(Path(path.name.lower().removesuffix(".gz")).suffix)


def _is_yaml(text: str) -> bool:
    """Whether most of the first lines are keys or items of YAML."""
    lines = [line.strip() for line in text[:20_000].splitlines()]
    used = [line for line in lines if line and not line.startswith("#") and line not in ("---", "...")]
    fitting = sum(_KEY.match(line) is not None or line.startswith("- ") or line == "-" for line in used)
    return len(used) > 2 and fitting > 0.9 * len(used) and ";" not in used[0] and "," not in used[0].partition(":")[0]


def _is_toml(text: str) -> bool:
    """Whether a text has the title of a TOML table ("[name]"), and more than half of its lines are such titles or pairs
    ("name = value")."""
    lines = [line for line in text[:20_000].splitlines() if line.strip() and not line.lstrip().startswith("#")]
    fitting = sum(_TOML_TABLE.match(line) is not None or _TOML_PAIR.match(line) is not None for line in lines)
    return _TOML_TABLE.search(text[:20_000]) is not None and fitting > 0.5 * len(lines)


def value_of_toml(text: str) -> Any:
    """The tables of a text in TOML.

    Raises:
        InputError: the text is not TOML. The error does not name the file.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError("not TOML: lists or tables are nested too deeply") from None
    except ValueError as error:  # tomllib also raises ValueError for a whole number with too many digits
        end = f"at line {len(text.rstrip().splitlines())}, the end of the file"
        raise InputError(f"not TOML: {str(error).replace('at end of document', end)}") from None


def value_of_yaml(text: str) -> Any:
    """The value of a text in YAML; if the text has several documents, a list of their values.

    Raises:
        InputError: the text is not YAML, or uses a part of YAML that petmjx does not read. The error does not name the
            file.
    """
    documents: list[list[_Line]] = [[]]
    for number, line in enumerate(text.splitlines(), start=1):
        if line.rstrip() in ("---", "..."):
            documents.append([])
            continue
        content = _QUOTED_OR_COMMENT.sub(lambda match: match[1] or "", line).rstrip()
        if "\t" in content[: len(content) - len(content.lstrip())]:
            raise InputError(f"not YAML at line {number} (a tab before the text)")
        if content.strip():
            documents[-1].append(_Line(number, len(content) - len(content.lstrip()), content.lstrip()))
    values = [_Reader(lines).document() for lines in documents if lines]
    return values[0] if len(values) == 1 else values


class _Reader:
    """Reads one document."""

    def __init__(self, lines: Sequence[_Line]) -> None:
        self.lines = list(lines)
        self.next = 0

    def document(self) -> Any:
        value = self._block(self.lines[0].indent, 0)
        if self.next < len(self.lines):
            raise self._fault(self.lines[self.next], "its indent fits no line above")
        return value

    def _fault(self, line: _Line, why: str) -> InputError:
        return InputError(f"not YAML at line {line.number} ({why})")

    def _block(self, indent: int, depth: int, key: str = "") -> Any:
        """The mapping, sequence or scalar that begins at the next line. ``indent``: the indent of the block's lines.
        ``key``: as in :meth:`_scalar`."""
        line = self.lines[self.next]
        if depth > _DEEPEST:
            raise self._fault(line, "nested too deeply")
        if _ITEM.match(line.text):
            return self._sequence(indent, depth, key)
        if _KEY.match(line.text):
            return self._mapping(indent, depth)
        self.next += 1
        return self._scalar(line, line.text)

    def _sequence(self, indent: int, depth: int, key: str) -> list[Any]:
        values = []
        key = key if _names(key) else ""
        while self.next < len(self.lines) and self.lines[self.next].indent == indent:
            line = self.lines[self.next]
            match = _ITEM.match(line.text)
            if match is None:
                break
            rest = (match[1] or "").strip()
            if not rest:
                self.next += 1
                values.append(self._inner(indent, depth))
            elif _ITEM.match(rest) or _KEY.match(rest):  # a list or a mapping begins after the dash, on the same line
                inner = indent + len(line.text) - len(match[1])
                self.lines[self.next] = _Line(line.number, inner, rest)
                values.append(self._block(inner, depth + 1))
            else:
                self.next += 1
                values.append(self._scalar(line, rest, key if rest[0] not in "[{" else ""))
        return values

    def _mapping(self, indent: int, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {}
        while self.next < len(self.lines) and self.lines[self.next].indent == indent:
            line = self.lines[self.next]
            match = _KEY.match(line.text)
            if match is None:
                raise self._fault(line, "an entry between { and } is not KEY: VALUE")
            key, rest = self._plain(line, match[1]), (match[2] or "").strip()
            if key in values:
                raise self._fault(line, f"{key} occurs twice")
            self.next += 1
            values[key] = self._scalar(line, rest, key) if rest else self._inner(indent, depth, key)
        return values

    def _inner(self, indent: int, depth: int, key: str = "") -> Any:
        """The value in the lines below a key, or below a dash (no key); None if there are none."""
        if self.next == len(self.lines):
            return None
        line = self.lines[self.next]
        # the items below a key may have the indent of the key
        if line.indent > indent or (key and line.indent == indent and _ITEM.match(line.text)):
            return self._block(line.indent, depth + 1, key)
        return None

    def _scalar(self, line: _Line, text: str, key: str = "") -> Any:
        """A value in one line, or a flow mapping or sequence, which may go on in the next lines.

        Args:
            key: the key of the value, or of the sequence of which the value is an item; "": there is no key.
        """
        if text[0] in "[{":
            texts, unclosed = [text], _unclosed(text)
            while unclosed > 0:
                if self.next == len(self.lines):
                    raise self._fault(line, "a bracket is not closed")
                texts.append(self.lines[self.next].text)
                unclosed += _unclosed(texts[-1])
                self.next += 1
            text = " ".join(texts)
            value, end = self._flow(line, text, 0, 0, key)
            if text[end:].strip():
                raise self._fault(line, "there is text behind a bracket")
            return value
        if text[0] in "&*!|>%@`":
            raise self._fault(line, f"petmjx does not read values that begin with {text[0]}")
        return self._typed(line, text, key)

    def _plain(self, line: _Line, text: str) -> str:
        """The text of a scalar, without its quotes and escapes."""
        if len(text) < 2 or text[0] != text[-1] or text[0] not in "\"'":
            return text
        if text[0] == "'":
            return text[1:-1].replace("''", "'")

        def escaped(match: re.Match[str]) -> str:
            code = match[1]
            if code in _ESCAPES:
                return _ESCAPES[code]
            if len(code) == 1 or int(code[1:], 16) > _LAST_CODE_POINT:
                raise self._fault(line, f"unknown escape {match[0]}")
            return chr(int(code[1:], 16))

        return _ESCAPED.sub(escaped, text[1:-1])

    def _typed(self, line: _Line, text: str, key: str) -> Any:
        """The value that a scalar (a text in YAML) stands for. ``key``: as in :meth:`_scalar`."""
        plain = self._plain(line, text)
        if plain != text:
            return plain
        value = _WORDS.get(text.lower(), text)
        if value is not None and _names(key):
            return text
        if value is not text:
            return text if not key and text.lower() in _ANSWERS else value
        if _NUMBER.match(text):
            return float(text) if re.search(r"[.eE]", text) else int(text) if len(text) < 20 else float(text)
        return text

    def _flow(self, line: _Line, text: str, start: int, depth: int, key: str = "") -> tuple[Any, int]:
        """The value at a position of a text, and the position behind it. ``key``: as in :meth:`_scalar`."""
        at = _behind_space(text, start)
        if depth > _DEEPEST or at == len(text):
            raise self._fault(line, "nested too deeply" if at < len(text) else "a bracket is not closed")
        if text[at] not in "[{":
            match = _FLOW_SCALAR.match(text, at)
            assert match is not None
            return self._typed(line, match[1].strip(), key), match.end()
        end, items = {"[": "]", "{": "}"}[text[at]], []
        pairs: dict[str, Any] = {}
        key = key if _names(key) else ""
        at = _behind_space(text, at + 1)
        while not text.startswith(end, at):
            if end == "}":
                match = _FLOW_KEY.match(text, at)
                if match is None:
                    raise self._fault(line, "an entry between { and } is not KEY: VALUE")
                name = self._plain(line, match[1])
                if name in pairs:
                    raise self._fault(line, f"{name} occurs twice")
                pairs[name], at = self._flow(line, text, match.end(), depth + 1, name)
            else:
                value, at = self._flow(line, text, at, depth + 1, key if text[at : at + 1] not in ("[", "{") else "")
                items.append(value)
            at = _behind_space(text, at)
            if text.startswith(",", at):
                at = _behind_space(text, at + 1)
            elif not text.startswith(end, at):
                raise self._fault(line, "a bracket is not closed")
        return (pairs if end == "}" else items), at + 1


def _names(key: str) -> bool:
    """Whether the values of a key are names or ids."""
    return any(meaning.kind in _NAMES for meaning in known_meanings([key]).values())


def _unclosed(text: str) -> int:
    """How many more brackets a text opens than it closes. Brackets in quotes count too."""
    return text.count("[") + text.count("{") - text.count("]") - text.count("}")


def _behind_space(text: str, start: int) -> int:
    """The position of the first character from ``start`` on that is no white space."""
    match = _SPACE.match(text, start)
    assert match is not None
    return match.end()
