"""What ``--help`` looks like: options in two columns under headings, which fits 80 columns."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand

WIDTH = 110
"""Columns that help takes at most."""

_LAST = "Options"


class SectionedCommand(TyperCommand):
    """A command whose help lists options under the headings that they name as ``rich_help_panel``."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, then each section in the order of its first option, then options without a heading."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            if row is None:
                continue
            name, text = row
            heading = getattr(parameter, "rich_help_panel", None) or _LAST
            if parameter.param_type_name == "argument":
                name, heading = name.partition(" <")[0], "Arguments"  # without its Python type
            sections.setdefault(heading, []).append((name, text))
        for heading in sorted(sections, key=lambda name: name == _LAST):
            with formatter.section(heading):
                formatter.write_dl(sections[heading])
