"""``petmjx kpis``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import SHOWN_SKIPPED, print_skipped, print_tables
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import printable


def kpis(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS…", help=opt.PLANS_HELP)],
    orders: Annotated[
        Path,
        typer.Option(
            "--orders", metavar="FILE", help="File of the orders of the plans, in BED-BPP's form or any other."
        ),
    ],
    run: Annotated[
        list[Path] | None,
        typer.Option(
            "--run",
            metavar="DIR",
            help="Folder of a run of these plans, which has their verdicts. If the run was made with --check static, "
            "it also has the results of BED-BPP's own rule of stability. May be given several times.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Folder for kpis.parquet, kpis.csv and summary.json."),
    ] = None,
    xlsx: Annotated[
        bool, typer.Option("--xlsx", help="Also write kpis.xlsx to --out (needs the extra 'packers').")
    ] = False,
    leaderboard: Annotated[
        str | None,
        typer.Option(
            "--leaderboard",
            metavar="NAME",
            help="Check the plans as a submission to BED-BPP's leaderboard, and write it to --out (by default to the "
            "current folder). NAME is SURNAME_ALGORITHM_TASK, with a date in front if the submission is not of today; "
            "the task is offline3dbp, o3dbp or o3dbp-p-s (the packer knows the next p items, and chooses from the next "
            "s items).",
        ),
    ] = None,
    assume_stable: Annotated[
        bool,
        typer.Option("--assume-stable", help="Assume that all plans are stable, which gives the best possible rating."),
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Stop at the first unusable plan or order instead of skipping it.")
    ] = False,
    overwrite: opt.Overwrite = False,
    as_json: opt.JsonOption = False,
) -> None:
    """Rate plans as BED-BPP does: compute BED-BPP's KPIs of each plan, their means, and the leaderboard's score.

    A run of petmjx tells which plans stand. BED-BPP's own rule puts all boxes in place at once, and calls a plan
    unstable if a box moves by more than 10 mm along z. BED-BPP's own rule gives kpi_6, and needs a run with --check
    static. petmjx's verdict is shown beside the KPIs.
    """
    from petmjx.analysis.kpi_files import check_kpis_free, write_kpis
    from petmjx.analysis.kpi_submission import parse_name, write_submission
    from petmjx.analysis.kpis import kpis as rate
    from petmjx.common.errors import InputError
    from petmjx.results.input_files import input_files
    from petmjx.show.kpi_tables import kpi_tables

    if xlsx and out is None:
        raise InputError("--xlsx needs --out DIR")
    read = input_files(plans, orders, run)
    if out is not None:
        check_kpis_free(out, overwrite, xlsx=xlsx, inputs=read)
    if leaderboard is not None:
        check_outputs([(out or Path()) / parse_name(leaderboard).file_name], overwrite=overwrite, inputs=read)
    rating = rate(plans, orders, run, assume_stable=assume_stable, strict=strict)
    if out is not None:
        write_kpis(rating, out, xlsx=xlsx, overwrite=overwrite)
    if as_json:
        print(json.dumps({**rating.summary, "notes": rating.notes, "skipped": rating.skipped}, indent=2))
    else:
        print_skipped(rating.skipped, SHOWN_SKIPPED)
        print_tables(kpi_tables(rating, out))
    if leaderboard is not None:
        file = write_submission(leaderboard, out or Path(), rating.plans_by_id, rating.orders, len(rating.skipped))
        if not as_json:
            print(f"submission in {printable(str(file))}")
