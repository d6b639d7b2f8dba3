"""Makes the reference of options and of commands as Markdown, from the code."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer

from petmjx.cli.main import WIDTH, application
from petmjx.common.checked_records import CheckedRecord, CliFlag
from petmjx.options.confidence import Confidence
from petmjx.options.physics import Physics
from petmjx.options.placing import Placing
from petmjx.options.quiet import Quiet
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.options.walls import Walls
from petmjx.options.wrap import Wrap

RECORDS: tuple[tuple[str, str, type[CheckedRecord]], ...] = (
    ("What is simulated", "", Simulation),
    ("Physics", "physics.", Physics),
    ("Thresholds", "thresholds.", Thresholds),
    ("Quiet and rest", "quiet.", Quiet),
    ("Placing", "placing.", Placing),
    ("Walls", "walls.", Walls),
    ("Stretch wrap", "wrap.", Wrap),
    ("How sure it is", "", Confidence),
    ("How it runs", "", RunOptions),
)
"""Heading of the section, prefix of the record's fields for ``--set``, record."""


def cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def shown_default(value: Any) -> str:
    if isinstance(value, CheckedRecord):
        title = next(title for title, _, record in RECORDS if record is type(value))
        name = f"`{value.name}`, " if isinstance(value, Physics) else ""
        return f"{name}[below](#{title.lower().replace(' ', '-')})"
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def flag_of(info: Any, path: str) -> str:
    flag = next((entry for entry in info.metadata if isinstance(entry, CliFlag)), None)
    if flag is None:
        return f"`--set {path}=…`"
    return f"`{flag.name.partition('/')[0]}`"


def option_rows(prefix: str, record: type[CheckedRecord]) -> Iterator[str]:
    for name, info in record.model_fields.items():
        default = shown_default(info.default)
        text = (info.description or "").strip()
        names = f"`{name}`<br>{flag_of(info, prefix + name)}"
        yield f"| {names} | {default} | {cell(text[:1].upper() + text[1:])} |"


def options() -> str:
    """Markdown of all options: one table for each record."""
    parts = []
    for title, prefix, record in RECORDS:
        rows = "\n".join(option_rows(prefix, record))
        about = f"Fields of `{prefix.rstrip('.')}`, as a table or as a record.\n\n" if prefix else ""
        head = "| in Python, on the command line | default | meaning |\n| --- | --- | --- |"
        parts.append(f"## {title}\n\n{about}{head}\n{rows}\n")
    return "\n".join(parts)


def help_of(name: str, command: Any) -> str:
    """The output of ``petmjx NAME --help``."""
    context = command.make_context(
        f"petmjx {name}", [], resilient_parsing=True, terminal_width=WIDTH, max_content_width=WIDTH
    )
    return str(command.get_help(context)).rstrip()


def commands() -> str:
    """Markdown of all commands: one section for each command."""
    group: Any = typer.main.get_command(application())
    parts = []
    for name, command in group.commands.items():
        parts.append(f"## petmjx {name}\n\n{command.short_help}\n\n```text\n{help_of(name, command)}\n```\n")
    return "\n".join(parts)
