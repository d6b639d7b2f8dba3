"""The layout of ``--help``: options in two columns under headings, readable in a terminal of 80 columns or more."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand

WIDTH = 110
"""Largest width of the help, in columns."""

_LAST = "Options"


class SectionedCommand(TyperCommand):
    """A command whose help lists options under headings. The attribute ``rich_help_panel`` of an option is its
    heading."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, then the options with headings, and finally the options without a heading. Headings have
        the order in which their first options appear in the command."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            if row is None:
                continue
            name, text = row
            heading = getattr(parameter, "rich_help_panel", None) or _LAST
            if parameter.param_type_name == "argument":
                name, heading = name.partition(" <")[0], "Arguments"  # without the argument's Python type
            sections.setdefault(heading, []).append((name, text))
        for heading in sorted(sections, key=lambda name: name == _LAST):
            with formatter.section(heading):
                formatter.write_dl(sections[heading])
