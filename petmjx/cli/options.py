"""Options of commands, made from the records that hold them (``petmjx.config``), and those that are the command line's
own."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import typer
from pydantic.fields import FieldInfo
from rich.markup import escape

from petmjx.checked import Checked
from petmjx.config import Flag, Physics, RunOptions, Simulation
from petmjx.errors import InputError

Command = TypeVar("Command", bound=Callable[..., None])

PlanPaths = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[PLANS]...",
        help="BED-BPP packing plans: JSON files (also gzipped) or folders of them. Without any: the bundled samples, "
        "or those that a sweep file names.",
        show_default=False,
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]

_PANELS = {Simulation: "What is simulated", RunOptions: "How it runs"}

_SHOWN_DEFAULTS = {
    "threads": "all that may be used",
    "lanes": "from device memory",
    "limit": "all",
    "out": "petmjx-results/DATE-TIME",
}

_SET = inspect.Parameter(
    "settings",
    inspect.Parameter.KEYWORD_ONLY,
    default=None,
    annotation=Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="FIELD=VALUE",
            help="Any field of petmjx.Simulation, such as quiet.steps=50 or physics.timestep_s=0.001. Repeatable.",
            rich_help_panel=_PANELS[Simulation],
            show_default=False,
        ),
    ],
)


def takes(*fields: str, without: Collection[str] = (), defaults: bool = True) -> Callable[[Command], Command]:
    """Give a command the options of ``Simulation`` and ``RunOptions``: all of them but some, or those named.

    The command gets what was given, and only that, as keyword arguments: fields of the records, nested ones as tables.

    Args:
        defaults: whether the help shows the records' defaults (not where something else stands in for them).
    """

    def decorate(command: Command) -> Command:
        own = inspect.signature(command, eval_str=True)
        options = dict(_parameters(fields, without, defaults))

        def wrapped(**given: Any) -> None:
            settings = given.pop("settings", None) or ()
            chosen = {name: given.pop(name) for name in options if name in given}
            tables = _nested({name: value for name, value in chosen.items() if value is not None})
            for text in settings:
                _merge(tables, _setting(text))
            command(**given, **tables)

        named = [p for p in own.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        added = [*options.values(), *([] if fields else [_SET])]
        wrapped.__doc__, wrapped.__name__ = command.__doc__, command.__name__
        wrapped.__signature__ = own.replace(parameters=[*named, *added])  # type: ignore[attr-defined]
        wrapped.__annotations__ = {p.name: p.annotation for p in (*named, *added)}
        return wrapped  # type: ignore[return-value]

    return decorate


def _parameters(
    fields: Sequence[str], without: Collection[str], defaults: bool
) -> Iterator[tuple[str, inspect.Parameter]]:
    """The options' parameters by name; those of a record within a record are called record__field."""
    for record in (Simulation, RunOptions):
        for path, info in _flagged(record):
            if (fields and path[0] not in fields) or path[0] in without:
                continue
            name = "__".join(path)
            yield (
                name,
                inspect.Parameter(
                    name,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=None,
                    annotation=_annotation(name, info, _PANELS[record], defaults),
                ),
            )


def _flagged(record: type[Checked], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    for name, info in record.model_fields.items():
        if _flag(info) is not None:
            yield (*path, name), info
        elif isinstance(info.default, Checked):
            yield from _flagged(type(info.default), (*path, name))


def _flag(info: FieldInfo) -> Flag | None:
    return next((entry for entry in info.metadata if isinstance(entry, Flag)), None)


def _annotation(name: str, info: FieldInfo, panel: str, defaults: bool) -> Any:
    flag = _flag(info)
    assert flag is not None
    kind = _kind(info)
    text = info.description or ""
    shown = _default(name, info) if defaults else ""
    return Annotated[
        kind | None,
        typer.Option(
            *[each for each in (flag.name, flag.short) if each],
            metavar=None if kind is bool else flag.metavar,
            help=f"{text[:1].upper()}{text[1:]}." + (escape(f" [default: {shown}]") if shown else ""),
            show_default=False,
            rich_help_panel=panel,
        ),
    ]


def _kind(info: FieldInfo) -> Any:
    """The type of an option's value: that of the field, text for whatever is not a plain value."""
    plain = [kind for kind in get_args(info.annotation) or (info.annotation,) if kind is not type(None)]
    return plain[0] if plain[0] in (int, float, bool, Path) or _is_enum(plain[0]) else str


def _is_enum(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Enum)


def _default(name: str, info: FieldInfo) -> str:
    """What the help says of a default; nothing of switches, which are off."""
    value = info.default
    if value is None or isinstance(value, bool):
        return "on" if value else _SHOWN_DEFAULTS.get(name, "")
    return f"{value:g}" if isinstance(value, float) else str(value.name if isinstance(value, Physics) else value)


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """record__field = value as {record: {field: value}}."""
    tables: dict[str, Any] = {}
    for name, value in values.items():
        record, _, field = name.partition("__")
        _merge(tables, {record: {field: value}} if field else {record: value})
    return tables


def _setting(text: str) -> dict[str, Any]:
    """``quiet.steps=50`` as {"quiet": {"steps": 50}}; values are written as in TOML, plain words need no quotes.

    Raises:
        InputError: no name, or no value.
    """
    path, separator, value = text.partition("=")
    if not (path.strip() and separator):
        raise InputError(f"--set {text}: must be FIELD=VALUE, such as quiet.steps=50")
    try:
        read: Any = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        read = value
    for name in reversed(path.strip().split(".")):
        read = {name: read}
    table: dict[str, Any] = read
    return table


def _merge(tables: dict[str, Any], more: Mapping[str, Any]) -> None:
    for name, value in more.items():
        if isinstance(value, dict) and isinstance(tables.get(name), dict):
            _merge(tables[name], value)
        elif isinstance(value, dict) and name == "physics" and isinstance(tables.get(name), str):
            tables[name] = {"name": tables[name], **value}
        else:
            tables[name] = value
