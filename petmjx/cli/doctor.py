"""``petmjx doctor``."""

from __future__ import annotations

import json

from petmjx.cli import options as opt
from petmjx.cli.console import results_console


def doctor(as_json: opt.JsonOption = False) -> None:
    """Show versions, devices, which engines work here and why not, and where compiled programs are cached."""
    from dataclasses import asdict

    from petmjx.doctor import examine

    report = examine()
    if as_json:
        print(json.dumps(asdict(report), indent=2))
        return
    from rich.table import Table

    table = Table(show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for name, version in report.versions.items():
        table.add_row(name, version)
    table.add_section()
    for device in report.devices:
        kind, _, text = device.partition(": ")
        table.add_row(kind, text)
    table.add_section()
    for engine in report.engines:
        state = "[green]works[/green]" if engine.works else "[yellow]not here[/yellow]"
        table.add_row(f"engine {engine.name}", f"{state}: {engine.detail}")
    table.add_section()
    for name, folder in report.caches.items():
        table.add_row(f"cache: {name}", folder)
    results_console().print(table)
