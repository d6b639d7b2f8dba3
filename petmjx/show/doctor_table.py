"""The table of ``petmjx doctor``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from petmjx.show.layout import line

if TYPE_CHECKING:
    from petmjx.engines.doctor import Report


def doctor_table(report: Report, why_no_pictures: str) -> Table:
    """A table of two columns. Long lines of the second one are wrapped.

    Args:
        why_no_pictures: why nothing can be drawn here; "" where pictures and films can.
    """
    table = Table(show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, version in report.versions.items():
        table.add_row(name, line(version))
    table.add_section()
    for device in report.devices:
        kind, _, text = device.partition(": ")
        table.add_row(kind, line(text))
    table.add_section()
    for engine in report.engines:
        table.add_row(f"engine {engine.name}", _state(engine.works, engine.detail))
    table.add_row("pictures", _state(not why_no_pictures, why_no_pictures or "drawn without a display"))
    table.add_section()
    for name, folder in report.caches.items():
        table.add_row(f"cache: {name}", line(folder))
    return table


def _state(works: bool, detail: str) -> Text:
    state = Text("works", style="green") if works else Text("not here", style="yellow")
    return Text.assemble(state, ": ", line(detail))
