"""``petmjx convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import SHOWN_SKIPPED, print_skipped
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import count_text, printable
from petmjx.options.run_options import OF_ORDERS, READING
from petmjx.plans.file_formats import is_csv, is_parquet_name


@opt.takes(*READING, "limit", "strict")
def convert(
    plans: Annotated[list[Path], typer.Argument(metavar="PLANS…", help=opt.PLANS_HELP)],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="FILE", help="File to write: *.json, *.csv (both also *.gz) or *.parquet."),
    ],
    orders: Annotated[
        bool,
        typer.Option(
            "--orders",
            help="The file holds orders: write them as BED-BPP's JSON. The file may have any form that the command "
            "'petmjx samples --orders' reads.",
        ),
    ] = False,
    target: opt.Target = None,
    overwrite: opt.Overwrite = False,
    **options: Any,
) -> None:
    """Write packing plans in another form: as BED-BPP's JSON, or as a CSV or Parquet table with one row per box.

    Plans read from the new file are bit-identical to the old ones. Unusable plans are skipped, and the first of them
    are listed, one line each. If the input is the folder of a run, the command writes the plans that the run simulated.

    With --orders, a file of orders of any form is written in BED-BPP's form, which all commands read unambiguously.
    """
    from petmjx.options.run_options import RunOptions
    from petmjx.options.simulation import Simulation
    from petmjx.plans.plan_reader import load_plans
    from petmjx.plans.plan_set import PlanSet
    from petmjx.plans.plan_sources import gather_plans
    from petmjx.plans.plan_writer import save_plans
    from petmjx.results.input_files import input_files
    from petmjx.results.plan_lookup import plans_in_place

    check_outputs([out], overwrite=overwrite, inputs=input_files(plans))
    if orders:
        _convert_orders(plans, out, target, options)
        return
    if target is not None:
        raise InputError("--target needs --orders")
    of_runs = plans_in_place(plans, bool(options.get("strict")))
    if isinstance(of_runs, PlanSet):
        plan_set = gather_plans(of_runs, Simulation(), RunOptions(**options))
    else:
        plan_set = load_plans(plans, **options)
    print_skipped(plan_set.skipped, SHOWN_SKIPPED)
    for note in plan_set.notes:
        typer.echo(f"note: {printable(note)}", err=True)
    if not plan_set.plans:
        raise InputError(f"no usable plan ({len(plan_set.skipped):,} skipped)")
    save_plans(plan_set.plans, out)
    boxes = count_text(sum(plan.n_boxes for plan in plan_set), "box", "boxes")
    print(f"{count_text(len(plan_set), 'plan')} ({boxes}) in {printable(str(out))}")


def _convert_orders(files: list[Path], out: Path, target: str | None, options: dict[str, Any]) -> None:
    """Write the orders of a file in BED-BPP's form."""
    from petmjx.options.run_options import RunOptions
    from petmjx.plans.bedbpp_writer import write_orders
    from petmjx.plans.item_units_and_quantities import OrderReading
    from petmjx.plans.order_reader import read_orders

    if is_csv(out) or is_parquet_name(out):
        raise InputError(f"{printable(str(out))}: orders are written as JSON, so name a .json file")
    if len(files) > 1:
        raise InputError("--orders: name one file")
    if idle := next((name for name in options if name not in OF_ORDERS), None):
        raise InputError(f"{idle} is for plans, but --orders means that the file holds orders")
    errors: list[InputError] = []
    reading = OrderReading.of(RunOptions(**options), target)
    read = list(read_orders(files[0], errors.append, reading))
    print_skipped(errors, SHOWN_SKIPPED)
    if not read:
        raise InputError(f"no usable order ({len(errors):,} skipped)")
    write_orders(out, read)
    boxes = count_text(sum(len(order.items) for _, order in read), "box", "boxes")
    print(f"{count_text(len(read), 'order')} ({boxes}) in {printable(str(out))}")
