"""Records that check themselves, and the one place where pydantic's complaints become a line of petmjx's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic._internal._model_construction import ModelMetaclass  # has no public name

from petmjx.errors import InputError
from petmjx.text import shortened

_SIGNS = {
    "greater_than": (">", "gt"),
    "greater_than_equal": ("≥", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("≤", "le"),
}


class _OneLine(ModelMetaclass):
    """Constructing a record raises ``InputError`` with one line instead of pydantic's own error.

    Records within records are made by pydantic itself and not through here, so that the line names the whole path.
    """

    def __call__(cls, *args: Any, **values: Any) -> Any:
        try:
            return super().__call__(*args, **values)
        except ValidationError as error:
            raise InputError(describe(error)) from None


class Checked(BaseModel, metaclass=_OneLine):
    """A frozen record whose values are checked and whose fields are all known.

    Raises:
        InputError: "interval_s must be > 0, got -1".
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def read(cls, values: Mapping[str, Any], where: str = "") -> Self:
        """A record from plain values, of a file for instance; ``where`` comes before the field in an error's line."""
        try:
            return cls.model_validate(dict(values))
        except ValidationError as error:
            raise InputError(describe(error, where)) from None

    def changed(self, **values: Any) -> Self:
        """A checked copy with other values for some fields. A table changes the record that it stands for, if that is
        not given a name of its own."""
        return self.read(_fields_with(self, values))


def _fields_with(record: Checked, values: Mapping[str, Any]) -> dict[str, Any]:
    """A record's fields, some replaced. Checked as a whole later, so that an error names the whole path."""
    fields = {name: getattr(record, name) for name in type(record).model_fields}
    for name, value in values.items():
        old = fields.get(name)
        if isinstance(old, Checked) and isinstance(value, Mapping) and "name" not in value:
            value = _fields_with(old, value)
        fields[name] = value
    return fields


def describe(error: ValidationError, where: str = "") -> str:
    """The first of pydantic's complaints as a line: "simulation.interval_s must be > 0, got -1"."""
    first = error.errors()[0]
    place = ".".join([*([where] if where else []), *_path(first["loc"])]) or "value"
    kind, context, value = first["type"], first.get("ctx", {}), first.get("input")
    got = f"got {shortened(repr(value))}"
    if kind == "extra_forbidden":
        return f"{place}: unknown field"
    if kind == "missing":
        return f"{place} is missing"
    if kind in _SIGNS:
        sign, key = _SIGNS[kind]
        return f"{place} must be {sign} {context[key]:g}, {got}"
    if kind in ("literal_error", "enum"):
        return f"{place} must be {context['expected']}, {got}"
    if kind == "value_error":
        # raised by a validator of petmjx's own, whose text says everything after the place
        return f"{place} {context['error']}" if first["loc"] else str(context["error"])
    message = first["msg"].removeprefix("Input ").replace("\n", " ")
    return f"{place}: {message}, {got}"


def _path(location: tuple[int | str, ...]) -> list[str]:
    """Fields by name and list entries as [i], as a path is written in TOML or Python."""
    parts: list[str] = []
    for part in location:
        if isinstance(part, int) and parts:
            parts[-1] += f"[{part}]"
        else:
            parts.append(str(part))
    return parts
