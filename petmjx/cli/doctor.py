"""``petmjx doctor``."""

from __future__ import annotations

import json

from petmjx.cli import command_options as opt
from petmjx.cli.console import print_tables


def doctor(as_json: opt.JsonOption = False) -> None:
    """Show versions, devices, which engines work on this machine and why others do not, whether pictures can be drawn,
    and where compiled programs are cached."""
    from dataclasses import asdict

    from petmjx.show.doctor_report import doctor_table, examine
    from petmjx.show.pictures.picture_files import why_nothing_is_drawn

    report, why_not = examine(), why_nothing_is_drawn()
    if as_json:
        print(json.dumps(asdict(report) | {"pictures": {"works": not why_not, "detail": why_not}}, indent=2))
        return
    print_tables([doctor_table(report, why_not)])
