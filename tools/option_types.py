"""Writes ``petmjx/runs/option_types.py``: the options of ``petmjx.score`` and ``petmjx.sweep`` for type checkers.

    python -m tools.option_types

An option is defined once, as a field of a record in ``petmjx/options``. Type checkers do not run code, so they need the
name and the type of the option in a second place, which this program writes. A test fails if the program has to run
again.
"""

from __future__ import annotations

import types
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from petmjx.common.checked_records import CheckedRecord
from petmjx.engines.engine_registry import ENGINES
from petmjx.options.carriers import Board, OwnCarrier
from petmjx.options.confidence import Confidence
from petmjx.options.materials import FrictionPair, LandingPair
from petmjx.options.physics import CUSTOM, PHYSICS, Physics
from petmjx.options.placing import Placing
from petmjx.options.quiet import Quiet
from petmjx.options.run_options import AUTO, Anchor, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.options.transport import Transport
from petmjx.options.walls import Walls
from petmjx.options.wrap import Wrap

TARGET = Path(__file__).resolve().parents[1] / "petmjx" / "runs" / "option_types.py"

HEAD = '''\
"""The options of ``petmjx.score`` and ``petmjx.sweep`` for type checkers: their names and types.

Written by ``make options`` (tools/option_types.py) from the records in petmjx/options. These records check the values
of options and state their meanings. Do not edit.
"""

from __future__ import annotations

from os import PathLike
from typing import Literal, TypedDict

'''

INNER: tuple[type[CheckedRecord], ...] = (
    Physics,
    Thresholds,
    Quiet,
    Placing,
    Wrap,
    Walls,
    OwnCarrier,
    Board,
    FrictionPair,
    LandingPair,
)
"""Records within ``Simulation``, which a caller may also give as tables (dictionaries)."""

SHORT: dict[type[CheckedRecord], tuple[str, ...]] = {
    Physics: ("PhysicsName",),
    Placing: ("Way", "WayName"),
    Walls: ("tuple[Side | SideName, ...]", "list[Side | SideName]", "str"),
    OwnCarrier: ("str", "PathLike[str]"),
}
"""Record → types of other values that a caller may give for it: the name of a preset, or the file that contains the
record."""

OUTER: dict[str, type[CheckedRecord]] = {
    "SimulationOptions": Simulation,
    "ConfidenceOptions": Confidence,
    "TransportOptions": Transport,
    "RunOptionsGiven": RunOptions,
}
"""Name of a typed dictionary → the record whose fields the dictionary has."""

TAIL = '''

class ScoreOptions(SimulationOptions, ConfidenceOptions, TransportOptions, RunOptionsGiven, total=False):
    """The options of ``petmjx.score``."""


class SweepOptions(SimulationOptions, RunOptionsGiven, total=False):
    """The options of ``petmjx.sweep``."""
'''


def literal(values: Iterable[str]) -> str:
    quoted = ", ".join(f'"{value}"' for value in values)
    return f"Literal[{quoted}]"


class Written:
    """Types as text, and the names that the text uses.

    Attributes:
        enums: the enumerations in the text. For each of them, an alias lists its values as text.
    """

    def __init__(self) -> None:
        self.enums: dict[str, type[Enum]] = {}

    def members(self, kind: Any) -> Iterator[str]:
        """The members of the union of all types that a caller may give for a field of this type."""
        origin, arguments = get_origin(kind), get_args(kind)
        if origin is Annotated:
            yield from self.members(arguments[0])
        elif origin in (Union, types.UnionType):
            for argument in arguments:
                yield from self.members(argument)
        elif origin is Literal:
            yield "AnchorName" if arguments == get_args(Anchor) else literal(arguments)
        elif origin is tuple:
            entries = [self.text(entry) for entry in arguments if entry is not Ellipsis]
            yield f"tuple[{', '.join(entries)}{', ...' if Ellipsis in arguments else ''}]"
            yield f"list[{' | '.join(dict.fromkeys(entries))}]"
        elif origin is dict:  # a caller may also give text, such as "x=Pos X"
            yield from (f"dict[{', '.join(map(self.text, arguments))}]", "str")
        elif kind is type(None):
            yield "None"
        elif issubclass(kind, Enum):
            self.enums[kind.__name__] = kind
            yield from (kind.__name__, f"{kind.__name__}Name")
        elif issubclass(kind, CheckedRecord):
            yield from (kind.__name__, f"{kind.__name__}Table", *SHORT.get(kind, ()))
        elif issubclass(kind, Path):
            yield from ("str", "PathLike[str]")
        else:
            yield str(kind.__name__)

    def text(self, kind: Any) -> str:
        members = list(dict.fromkeys(self.members(kind)))
        return " | ".join(sorted(members, key=lambda member: member == "None"))


def table(name: str, about: str, fields: Iterable[tuple[str, str]]) -> str:
    rows = "\n".join(f"    {field}: {kind}" for field, kind in fields)
    return f'\n\nclass {name}(TypedDict, total=False):\n    """{about}"""\n\n{rows}\n'


def alias(name: str, values: Iterable[str]) -> str:
    rows = "\n".join(f'    "{value}",' for value in values)
    return f"{name} = Literal[\n{rows}\n]\n"


def option_types() -> str:
    """The text of ``petmjx/runs/option_types.py``."""
    written = Written()

    def fields_of(record: type[CheckedRecord]) -> Iterator[tuple[str, str]]:
        if record is Physics:
            yield "name", f"PhysicsName | {literal([CUSTOM])}"
        for field, info in record.model_fields.items():
            yield field, "EngineName | MinimalEngine" if field == "engine" else written.text(info.annotation)

    tables = [
        table(f"{record.__name__}Table", f"Fields of ``{record.__module__}.{record.__name__}``.", fields_of(record))
        for record in INNER
    ]
    tables += [
        table(name, f"Fields of ``{record.__module__}.{record.__name__}``.", fields_of(record))
        for name, record in OUTER.items()
    ]
    modules: dict[str, list[str]] = {"petmjx.engines.protocol": ["MinimalEngine"]}
    for kind in (*written.enums.values(), *INNER):
        modules.setdefault(kind.__module__, []).append(kind.__name__)
    imports = [f"from {module} import {', '.join(sorted(modules[module]))}\n" for module in sorted(modules)]
    aliases = [
        alias("EngineName", [AUTO, *ENGINES]),
        alias("PhysicsName", PHYSICS),
        alias("AnchorName", get_args(Anchor)),
        *(alias(f"{name}Name", [str(member.value) for member in kind]) for name, kind in sorted(written.enums.items())),
    ]
    return HEAD + "".join(imports) + "\n" + "".join(aliases) + "".join(tables) + TAIL


if __name__ == "__main__":
    TARGET.write_text(option_types(), encoding="utf-8")
