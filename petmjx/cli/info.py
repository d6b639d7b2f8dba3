"""``petmjx info``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.common.atomic_write import atomic_write
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import printable
from petmjx.options.run_options import READING


@opt.takes(*READING, "limit")
def info(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS…", help=opt.PLANS_HELP)],
    write_as: Annotated[
        Path | None,
        typer.Option(
            "--write-as",
            metavar="FILE.toml",
            help="Write down how the file is read (columns, units, axes). With --as FILE.toml, the file is then read "
            "without guesses.",
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html",
            metavar="FILE.html",
            help="Write a page with pictures of the plans, the columns and units as petmjx reads them, and other "
            "possible readings of the file.",
        ),
    ] = None,
    overwrite: opt.Overwrite = False,
    as_json: opt.JsonOption = False,
    **options: Any,
) -> None:
    """Explain files of packing plans: the kind of each file, how it is read, and what is unusual in it. Nothing is
    simulated.

    For files of other tools, the command shows the columns, the units, the axes, the point of a box that coordinates
    describe, the turns of boxes, the assumed values, and the second most plausible reading. A file that can be read in
    two ways is refused, and both readings are named. For a file of orders, the command shows how the file is read by
    the command "petmjx samples --orders".
    """
    from petmjx.plans.readings import reading_toml
    from petmjx.results.input_files import input_files
    from petmjx.show.file_info import file_infos, info_lines

    outputs = [path for path in (write_as, html) if path is not None]
    check_outputs(outputs, overwrite=overwrite, inputs=input_files(plans))
    infos, plan_set = file_infos(plans, options)
    readings = plan_set.readings
    if as_json:
        print(json.dumps(infos, indent=2, ensure_ascii=False))
    else:
        for line in info_lines(infos):
            print(printable(line))
    if write_as is not None:
        if len(readings) != 1:
            summary = "no file is of another tool" if not readings else f"{len(readings)} files are of other tools"
            raise InputError(f"--write-as: {summary}; name one file of another tool")
        ((source, reading),) = readings.items()
        with atomic_write(write_as) as hidden:
            hidden.write_text(reading_toml(reading, source), encoding="utf-8")
    if html is not None:
        from petmjx.show.pages.reading_page import reading_page

        with atomic_write(html) as hidden:
            hidden.write_text(reading_page(plan_set, infos), encoding="utf-8")
        typer.echo(f"page: {printable(str(html))}", err=True)
    if not any(entry["plans"] or entry["orders"] for entry in infos):
        raise InputError("no usable plan")
