"""Records that check their own values (``CheckedRecord``), and their one-line error messages.

This module turns each error of pydantic into one line. The module also decides how messages name an option: by its flag
if the command line is running, otherwise by its argument in Python.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import UnionType
from typing import TYPE_CHECKING, Any, Final, Self, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name, shortened_text

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # pydantic exports this class in no public module

_typed = False
"""Whether the command line is running. A process runs at most one command line, and all threads share this flag."""


@contextmanager
def typed_options() -> Iterator[None]:
    """Context of the command line: messages name options by their flags, such as ``--out``."""
    global _typed
    before, _typed = _typed, True
    try:
        yield
    finally:
        _typed = before


def option(flag: str, value: str = "", *, python: str = "") -> str:
    """The name of an option in messages, such as "--overwrite" on the command line or "overwrite=True" in Python.

    Args:
        flag: the flag as users type it, such as ``--out``.
        value: value that the message shows for the argument in Python, such as ``True``. If ``value`` is empty, only
            the argument's name is shown.
        python: name of the argument in Python, if it differs from the flag's name.
    """
    if _typed:
        return flag
    name = python or flag.removeprefix("--").replace("-", "_")
    return f"{name}={value}" if value else name


_TEXTS: Final = {
    "greater_than": "must be > {gt:g}",
    "greater_than_equal": "must be ≥ {ge:g}",
    "less_than": "must be < {lt:g}",
    "less_than_equal": "must be ≤ {le:g}",
    "literal_error": "must be {expected}",
    "enum": "must be {expected}",
    "string_type": "must be text",
    "path_type": "must be a path",
    "string_pattern_mismatch": "does not have the form in which petmjx writes it",
    **dict.fromkeys(("float_type", "float_parsing", "finite_number"), "must be a finite number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_parsing_size", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
    **dict.fromkeys(("list_type", "tuple_type"), "must be a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "must be a table"),
}
"""pydantic's name for a kind of error → the text between the name of the field and the value in messages, as in
"interval_s must be > 0, got -1"."""

_NO_NUMBERS: Final = (str, bytes, bool)

_COMPLAINT: Final = "complaint"


TABLE: Final = "<a table>"
LIST: Final = "<a list>"
VALUE: Final = "<a single value>"
"""Tags for the types in a union, such as ``float | list[float]``. A tag says whether a value is a table, a list or a
single value. pydantic inserts tags into the path of an error, and ``describe`` removes the tags. The angle brackets
distinguish tags from names of fields."""
_KEY: Final = "[key]"
"""Last part of the path in pydantic's errors about a key of a table. The part of the path before ``_KEY`` is the key
itself."""


@dataclass(frozen=True)
class CliFlag:
    """The option of the command line that sets a field of a record. ``name`` is the option's long name, and ``short``
    its short name.

    Attributes:
        metavar: placeholder for the option's value in the help.
        default: text that the help shows instead of the field's own default.
    """

    name: str
    metavar: str = "NAME"
    short: str = ""
    default: str = ""


class _OneLine(ModelMetaclass):
    """Metaclass that makes the constructor of a record raise an ``InputError`` of one line instead of pydantic's own
    error.

    The line gives the path of the wrong field from the outermost record: pydantic does not call this constructor for
    records within a record, so only the outermost record makes the line.
    """

    def __call__(cls, *args: Any, **values: Any) -> Any:
        try:
            return super().__call__(*args, **values)
        except ValidationError as error:
            raise InputError(describe(error)) from None


class CheckedRecord(BaseModel, metaclass=_OneLine):
    """A frozen record with checked values. Unknown fields are refused.

    Raises:
        InputError: a value is wrong, as in "interval_s must be > 0, got -1".
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def read(cls, values: Mapping[str, Any], context: Any = None) -> Self:
        """Make a record from plain values, such as the values in a file. ``context`` is passed to the validators."""
        try:
            return cls.model_validate(dict(values), context=context)
        except ValidationError as error:
            raise InputError(describe(error)) from None

    def changed(self, **values: Any) -> Self:
        """A copy of the record in which some fields have new values. The new values are checked.

        If the value of a field is a record, a table can be its new value. The table changes only those entries of the
        record that it names, except that a table with a ``name`` replaces the whole record.
        """
        return self.read(_fields_with(self, values))

    @model_validator(mode="before")
    @classmethod
    def _has_its_fields(cls, values: Any) -> Any:
        """Refuse unknown and missing fields. pydantic would also refuse them, but its errors do not name the known
        fields."""
        if not isinstance(values, Mapping):
            return values
        fields = {info.alias or name: info for name, info in cls.model_fields.items()}
        for name in values:
            if name not in fields:
                raise complaint(f": unknown field; {hint(str(name), fields)}", str(name))
        for name, value in values.items():
            # a validator of the field may convert text, such as the name "+x" of a direction
            converts = isinstance(value, str) and any(isinstance(e, BeforeValidator) for e in fields[name].metadata)
            expected = "" if converts else _lax(fields[name].annotation, value)
            if expected:
                raise complaint(f"{expected}, {shown_value(value)}", str(name))
        for name, info in fields.items():
            if info.is_required() and name not in values:
                raise complaint(f"is missing: {info.description}" if info.description else "is missing", name)
        return values


def _lax(annotation: Any, value: Any) -> str:
    """The error text ("must be …") for a value that pydantic would convert silently, such as the text "3" to the number
    3. The error text is empty for all other values."""
    union = isinstance(annotation, UnionType) or get_origin(annotation) is Union
    kinds = set(get_args(annotation)) if union else {annotation}
    kinds.discard(type(None))
    if kinds == {bool}:
        return "" if value is None or isinstance(value, bool) else "must be true or false"
    if kinds and kinds <= {float, int} and isinstance(value, _NO_NUMBERS):
        return _TEXTS["int_type" if kinds == {int} else "float_type"]
    numbers = get_origin(annotation) is tuple and set(get_args(annotation)) - {Ellipsis} <= {float, int}
    if numbers and isinstance(value, list | tuple) and any(isinstance(element, _NO_NUMBERS) for element in value):
        return "must be a list of numbers"
    return ""


def within(low: float, high: float) -> AfterValidator:
    """A pydantic validator that checks that a value is within a physically reasonable range. The error states the
    range."""

    def check(value: Any) -> Any:
        if value is not None and not low <= value <= high:
            raise ValueError(f"must be from {low:g} to {high:g}, {shown_value(value)}")
        return value

    return AfterValidator(check)


def _fields_with(record: CheckedRecord, values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a record, with new values for some of them. This function does not check the values. The outermost
    record checks all values together later, so that an error message gives the path of the field from the outermost
    record.
    """
    fields = {name: getattr(record, name) for name in type(record).model_fields}
    for name, value in values.items():
        old = fields.get(name)
        if isinstance(old, CheckedRecord) and isinstance(value, Mapping) and "name" not in value:
            value = _fields_with(old, value)
        fields[name] = value
    return fields


def hint(name: str, known: Iterable[str]) -> str:
    """A hint for a user who wrote an unknown name, such as "did you mean scale?", or a list of the known names."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {close[0]}?" if close else f"there are {', '.join(names)}"


def similar(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name, if there are too many known names for a list. The text suggests the
    most similar name, as in "; did you mean s0-000016?", or is empty."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {printable_name(close[0])}?" if close else ""


def complaint(text: str, *path: str | int) -> ValidationError:
    """An error that a validator of a value can raise about a field inside the value.

    Args:
        text: the text that follows the field's path in the message, such as "must be > 0" or ": unknown field".
        path: the keys that lead from the validated value to the field.
    """
    kind = PydanticCustomError(_COMPLAINT, "{text}", {"text": text})
    return ValidationError.from_exception_data("value", [InitErrorDetails(type=kind, loc=path, input=None)])


def shape(value: object) -> str:
    """``TABLE``, ``LIST`` or ``VALUE``, depending on whether a value is a table, a list or a single value. With
    ``Discriminator(shape)``, pydantic uses this function to choose one type of a union of types."""
    if isinstance(value, Mapping | BaseModel):
        return TABLE
    return LIST if isinstance(value, list | tuple) else VALUE


def by_entry(key: str) -> Discriminator:
    """A discriminator for a union of record classes: it chooses the class by the entry ``key`` of a table. The tag of a
    class in the union is the value of the entry ``key`` in angle brackets.
    """

    def tag(value: object) -> str | None:
        if not isinstance(value, Mapping):
            return None
        entry = value.get(key)
        return f"<{entry}>" if isinstance(entry, str) else "<>"

    # pydantic's errors contain the name of this function, from which `describe` reads the entry's name
    tag.__name__ = key
    return Discriminator(tag)


def shown_value(value: object) -> str:
    """The end of an error message: "got" and the wrong value, in one line of limited length."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # The value is a whole number with more digits than Python prints, or has tables nested too deeply.
        return f"got {type(value).__name__} too large to be shown"
    except Exception:  # the ``__repr__`` of a user's class may raise anything
        return f"got {type(value).__name__} that cannot be shown"
    return f"got {shortened_text(' '.join(text.split()) if len(text.splitlines()) > 1 else text)}"


def describe(error: ValidationError) -> str:
    """The first of pydantic's errors as one line, such as "simulation.interval_s must be > 0, got -1"."""
    first = error.errors(include_url=False)[0]
    place = _path(first["loc"])
    text = _error_text(first["type"], first.get("ctx", {}), first.get("input"), first["msg"])
    if not place:
        return text.removeprefix(": ")
    return f"{place}{text}" if text.startswith((":", ".")) else f"{place} {text}"


def _error_text(kind: str, context: Mapping[str, Any], value: Any, message: str) -> str:
    """The text that follows the path of a field in an error message."""
    if kind in (_COMPLAINT, "value_error"):
        # a validator of petmjx raised the error, so the text is complete
        return message.removeprefix("Value error, ")
    if kind == "missing":  # an entry of a list is missing; CheckedRecord itself reports missing fields
        return "is missing"
    if kind in _TEXTS:
        return f"{_TEXTS[kind].format(**context)}, {shown_value(value)}"
    if kind in ("too_short", "too_long"):
        most, key = ("most", "max_length") if kind == "too_long" else ("least", "min_length")
        length = context.get("actual_length")  # the length is None if pydantic did not count to the end
        limit = count_text(context[key], "entry", "entries")
        return f"must have at {most} {limit}, got {'more' if length is None else length}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _no_member(context, value)
    return f": {message.removeprefix('Input ')}, {shown_value(value)}".replace("\n", " ")


def _no_member(context: Mapping[str, str], value: Any) -> str:
    """The error text for a value that has none of the types of a union."""
    key = context["discriminator"].removesuffix("()")
    tags = re.findall("<(.*?)>", context.get("expected_tags", ""))
    if key == shape.__name__:
        return f"must be {' or '.join(tags)}, {shown_value(value)}"
    if not isinstance(value, Mapping):
        return f"must be a table, {shown_value(value)}"
    if key not in value:
        return f".{key} is missing: it must be one of {', '.join(tags)}"
    return f".{key} must be one of {', '.join(tags)}, {shown_value(value[key])}"


def _path(location: tuple[int | str, ...]) -> str:
    """The path of a value within a record, in the notation of TOML and Python: fields by name, list entries as [i].
    Parts that pydantic inserts into the path, such as the tags of unions, are left out."""
    path = ""
    for part in location:
        if isinstance(part, int):
            path += f"[{part}]"
        elif part != _KEY and not (part.startswith("<") and part.endswith(">")):
            path += f".{printable_name(part)}" if path else printable_name(part)
    return path


def reason(error: Exception) -> str:
    """The text of an error about a file, in one line: the reason why the file cannot be used."""
    return " ".join(printable(getattr(error, "strerror", None) or str(error)).split())
