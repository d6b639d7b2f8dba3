"""The options and arguments that several commands have. Most options are generated from the fields of option records
such as ``petmjx.Simulation``."""

from __future__ import annotations

import functools
import inspect
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

import typer
from pydantic.fields import FieldInfo
from typer.models import OptionInfo

from petmjx.common.checked_records import CheckedRecord, CliFlag
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import printable, printable_name
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation

Command = TypeVar("Command", bound=Callable[..., None])

PLANS_HELP = (
    "Packing plans: files, or folders of files. Files may be BED-BPP's JSON, CSV (both also gzipped), Parquet, or "
    "files of other tools (JSON, tables, sheets, arrays, MJCF; 'petmjx info' says how they are read)."
)

PlanPaths = Annotated[
    list[Path] | None,
    typer.Argument(metavar="PLANS", help=f"{PLANS_HELP} Without plans: the bundled samples."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]

Target = Annotated[
    str | None,
    typer.Option(
        "--target",
        metavar="NAME|LxW",
        help="Carrier of the orders, if their file does not name one: euro-pallet, rollcontainer, or sizes in mm such "
        "as 1200x1000.  [default: the file's container if it is a pallet, else euro-pallet]",
    ),
]


def file_option(flag: str, text: str, section: str) -> Any:
    """An option that names a file to write, under the heading ``section`` of the help."""
    return typer.Option(flag, metavar="FILE", help=text, rich_help_panel=section)


SIMULATION_PANEL = "What is simulated"
PlansOrRun = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="PLANS|DIR",
        help="Packing plans, or the folder of a run, whose options are then used. If the plan files of the run were "
        "moved, give their new paths after the folder. Without plans or a folder: the bundled samples.",
    ),
]
Variant = Annotated[
    int | None,
    typer.Option(
        "--variant",
        metavar="N",
        help="Number of the world (column `variant` of the table `worlds`), if the run has several worlds of the plan.",
        rich_help_panel=SIMULATION_PANEL,
    ),
]
CONFIDENCE_PANEL = "How sure it is"
RUN_PANEL = "How it runs"


def named_paths(texts: Sequence[str], option: str) -> dict[str, str]:
    """Split texts of the form NAME=PATH. Returns name → path; an empty dictionary if no text has a name. A text that is
    an existing path counts as a path without a name, even if it contains "=".

    Raises:
        InputError: only some texts have a name, or two texts have the same name.
    """
    name_parts = [text.partition("=") for text in texts if not Path(text).exists()]
    pairs = [(name, path) for name, _, path in name_parts if name and path]
    if pairs and len(pairs) < len(texts):
        raise InputError(f"{option}: give a name to each path (NAME=PATH), or to none")
    names = [name for name, _ in pairs]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise InputError(f"{option} {printable_name(name)}: two entries have this name")
    return dict(pairs)


def files_by_kind(overwrite: bool, inputs: Iterable[Path], **paths: Path | None) -> dict[str, Path]:
    """The files that the user has requested, after checks of their names: kind → path.

    Args:
        overwrite: whether existing files may be replaced.
        inputs: files and folders that the command reads.
        paths: kind of a file → path, or None if the user has not requested the file. The kind is also the suffix of the
            file's name.

    Raises:
        InputError: the suffix of a name is not the file's kind, or a file already exists or cannot be written.
    """
    files = {kind: path for kind, path in paths.items() if path is not None}
    for kind, path in files.items():
        if path.suffix.lower() != f".{kind}":
            raise InputError(f"--{kind} {printable(str(path))}: the file's name must end in .{kind}")
    check_outputs(files.values(), overwrite=overwrite, inputs=inputs)
    return files


@dataclass(frozen=True)
class _Option:
    """An option of a command, made from a field of an option record.

    Attributes:
        path: names of the fields that lead from the outermost record to the value. Usually, ``path`` is a single name;
            for a field of a record within a record, ``path`` is a tuple such as ``("thresholds", "shift_m")``.
        section: heading under which the help lists the option.
    """

    path: tuple[str, ...]
    info: FieldInfo
    flag: CliFlag
    section: str

    @property
    def name(self) -> str:
        """The name of the function parameter that receives the option's value."""
        return "__".join(self.path)

    @property
    def kind(self) -> Any:
        """The type to which typer converts the value: int, float, bool or Path if the field has this type. For all
        other fields, the type is text, which the option record converts and checks."""
        kinds = get_args(self.info.annotation) or (self.info.annotation,)
        if str in kinds or get_origin(self.info.annotation) is tuple:
            return str
        return next((kind for kind in kinds if kind in (int, float, bool, Path)), str)

    @property
    def help(self) -> str:
        """The text of the option in the help: the description of the field without remarks about Python, and the
        default if there is one to show."""
        text = (self.info.description or "").partition("; in Python")[0]
        value = self.info.default
        if isinstance(value, CheckedRecord):
            value = getattr(value, "name", "")
        if self.flag.default or value is None:
            default = self.flag.default
        elif isinstance(value, bool):
            default = "on" if value else ""
        else:
            values = value if isinstance(value, tuple) else (value,)
            default = ",".join(f"{part:g}" if isinstance(part, float) else str(part) for part in values)
        return f"{text[:1].upper()}{text[1:]}." + (f" [default: {default}]" if default else "")

    @property
    def parameter(self) -> inspect.Parameter:
        """The function parameter from which typer makes the option. The value of this parameter is None if the user
        does not set the option."""
        names = [name for name in (self.flag.name, self.flag.short) if name]
        option = typer.Option(
            *names,
            metavar=None if self.kind is bool else self.flag.metavar,
            help=self.help,
            rich_help_panel=self.section,
        )
        return _keyword(self.name, Annotated[self.kind | None, option])


def takes(
    *fields: str,
    without: Collection[str] = (),
    simulated: str = SIMULATION_PANEL,
    more: Sequence[tuple[type[CheckedRecord], str]] = (),
) -> Callable[[Command], Command]:
    """Decorator that gives a command options of ``Simulation`` and ``RunOptions``: all options, all but some, or only
    some.

    The command receives only the options that were typed, as keyword arguments with the names of the fields. Records
    within records become dictionaries. An error about a field names the option in the form in which the user typed it.

    Args:
        fields: names of fields of ``Simulation`` and ``RunOptions``. If ``fields`` is empty, all fields are used.
        without: names of the fields that are left out.
        simulated: heading of the options of ``Simulation``.
        more: further option records, each with the heading of its options in the help. The fields of these records
            replace fields of ``Simulation`` that have the same names.
    """
    record_fields = {name for record, _ in more for name in record.model_fields}
    records: list[tuple[type[CheckedRecord], str]] = [(Simulation, simulated), *more, (RunOptions, RUN_PANEL)]
    options = [
        option
        for record, section in records
        for option in _options_of(record, section)
        if option.path[0] not in without and (not fields or option.path[0] in fields)
        if record is not Simulation or option.path[0] not in record_fields
    ]
    settable = [
        name for name in Simulation.model_fields if (not fields or name in fields) and name not in record_fields
    ]

    def decorate(command: Command) -> Command:
        def with_options(**arguments: Any) -> None:
            tables: dict[str, Any] = {}
            typed: dict[str, str] = {}
            for option in options:
                value = arguments.pop(option.name, None)
                if value is not None:
                    _put(tables, option.path, value)
                    typed[".".join(option.path)] = option.flag.name.partition("/")[0]
            for setting in arguments.pop("settings", None) or ():
                path, value = _setting(setting, settable)
                name = ".".join(path)
                if name in typed:
                    also = "twice" if typed[name].startswith("--set ") else f"beside {typed[name]}"
                    raise InputError(f"--set {printable(name)}: is given {also}; drop one of them")
                _put(tables, path, value)
                typed[name] = f"--set {name}"
            with _named_as_typed(typed):
                command(**arguments, **tables)

        signature = inspect.signature(command, eval_str=True)
        parameters = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        parameters += [option.parameter for option in options if option.section == simulated]
        parameters += [_set_parameter(settable, simulated)] if settable else []
        parameters += [option.parameter for option in options if option.section != simulated]
        with_options.__doc__, with_options.__name__ = command.__doc__, command.__name__
        with_options.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]  # what inspect reads
        with_options.__annotations__ = {p.name: p.annotation for p in parameters}
        return with_options  # type: ignore[return-value]  # typer calls it as the signature states

    return decorate


def as_typed(command: Command) -> Command:
    """Wrap a command so that its errors name the options of this command in the form in which users type them, such as
    ``--out``."""
    typed = _flags_of(inspect.signature(command, eval_str=True))

    @functools.wraps(command)
    def named(*arguments: Any, **options: Any) -> Any:
        with _named_as_typed(typed):
            return command(*arguments, **options)

    return named  # type: ignore[return-value]  # called as the command


@contextmanager
def _named_as_typed(typed: Mapping[str, str]) -> Iterator[None]:
    """Context in which errors about fields name the options in the form in which the user typed them.

    Args:
        typed: name of a field → the option that the user typed for the field.
    """
    try:
        yield
    except InputError as error:
        line = _as_typed(str(error), typed)
        if line == str(error):
            raise
        raise InputError(line) from error


def _flags_of(signature: inspect.Signature) -> dict[str, str]:
    """Name of a function parameter → flag of the option that typer makes from it, for all options of a command."""
    flags = {}
    for name, parameter in signature.parameters.items():
        for entry in getattr(parameter.annotation, "__metadata__", ()):
            if isinstance(entry, OptionInfo):
                # typer may store the first flag, such as "--out", as ``default``, so ``default`` is examined, too
                words = (entry.default, *(entry.param_decls or ()))
                names = [word.partition("/")[0] for word in words if isinstance(word, str) and word.startswith("-")]
                usual = f"--{name.replace('_', '-')}"
                flags[name] = next((text for text in names if text.startswith("--")), names[0] if names else usual)
    return flags


def _keyword(name: str, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def _options_of(record: type[CheckedRecord], section: str, path: tuple[str, ...] = ()) -> Iterator[_Option]:
    """The options of a record: one for each field with a command-line flag, in this record and in the records within
    it."""
    for name, info in record.model_fields.items():
        flag = next((entry for entry in info.metadata if isinstance(entry, CliFlag)), None)
        if flag is not None:
            yield _Option((*path, name), info, flag, section)
        elif isinstance(info.default, CheckedRecord):
            yield from _options_of(type(info.default), section, (*path, name))


def _set_parameter(settable: Collection[str], section: str) -> inspect.Parameter:
    example = "quiet.steps=50 or physics.timestep_s=0.001" if "quiet" in settable else "physics.timestep_s=0.001"
    option = typer.Option(
        "--set",
        metavar="FIELD=VALUE",
        help=f"Set any other option of the simulation, such as {example}. May be given several times.",
        rich_help_panel=section,
    )
    return _keyword("settings", Annotated[list[str] | None, option])


def _setting(text: str, settable: Collection[str]) -> tuple[tuple[str, ...], Any]:
    """Split ``FIELD=VALUE`` into its two parts. The value is read as TOML, or as plain text if it is not TOML."""
    path, separator, value = text.partition("=")
    names = tuple(path.strip().split("."))
    if not (separator and all(names)):
        raise InputError(f"--set {printable(text)}: must be FIELD=VALUE, such as physics.timestep_s=0.001")
    if names[0] not in settable:
        raise InputError(f"--set {printable(names[0])}: unknown field; there are {', '.join(settable)}")
    try:
        return names, tomllib.loads(f"value = {value}")["value"]
    # The value is plain text if it is not TOML, or has a number with thousands of digits or lists nested too deeply.
    except (ValueError, RecursionError):
        return names, value.strip()


def _put(tables: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    """Store a value at its path in nested tables. The user may set a record by its name, by a table and by single
    values, in any order, and all of these settings take effect."""
    *records, field = path
    for name in records:
        inner = tables.get(name, {})
        tables[name] = inner = inner if isinstance(inner, dict) else {"name": inner}
        tables = inner
    if isinstance(tables.get(field), dict):
        tables[field].update(value if isinstance(value, dict) else {"name": value})
    else:
        tables[field] = value


def _as_typed(line: str, typed: Mapping[str, str]) -> str:
    """The text of an error. If the text begins with the name of a field, this name is replaced by the option that the
    user typed. An error that begins with the name of a file is not changed, because it is about the content of the
    file."""
    for path, option in typed.items():
        path_match = re.match(rf"(?:simulation\.|orders_)?{re.escape(path)}(?:\[\d+\])?(?=[ :])", line)
        if path_match:
            return option + line[path_match.end() :]
    return line
