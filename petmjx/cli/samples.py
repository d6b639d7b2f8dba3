"""``petmjx samples``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import print_skipped
from petmjx.common.argument_checks import integer_of
from petmjx.common.checked_records import hint
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import count_text, printable, printable_name
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import OF_ORDERS
from petmjx.packers.item_stream import MOST_LOOK_AHEAD
from petmjx.packers.learned_packer import LEARNED
from petmjx.packers.left_out_items import LeftOutItems
from petmjx.packers.packer_registry import BASELINE, PACKERS
from petmjx.packers.physical_packer_options import PHYSICAL, PhysicalOptions
from petmjx.packers.sample_plans import DEFAULT_LOOSE_SHARE

if TYPE_CHECKING:
    from petmjx.plans.item_units_and_quantities import OrderReading

DEFAULT_SAMPLES: Final = 100
MOST_SHOWN: Final = 10
"""Each random order of which boxes are left out gets a line, but at most this number of lines is printed. One more line
names orders without a packing that stands often enough, but at most this number of them."""


@opt.takes(
    *PhysicalOptions.model_fields,
    *("engine", "threads", "lanes", "errors"),
    *OF_ORDERS,
    more=((PhysicalOptions, "The packer physical"), (Confidence, "The packer physical")),
)
def samples(
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="File to write; *.gz is gzipped.")],
    n: Annotated[
        int | None, typer.Option("-n", metavar="N", help="Number of plans, 1 to 200,000.  [default: 100]")
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            "--seed",
            metavar="SEED",
            help="Seed of the random plans: plan number i depends only on the seed, on i, on --packer and on "
            "--loose-share.",
        ),
    ] = 0,
    loose_share: Annotated[
        float | None,
        typer.Option(
            "--loose-share",
            metavar="0…1",
            help="Share of plans that the packer 'baseline' packs with a support rule that is too loose to be safe.  "
            f"[default: {DEFAULT_LOOSE_SHARE}; 0 if --packer is given]",
        ),
    ] = None,
    orders: Annotated[
        Path | None,
        typer.Option(
            "--orders",
            metavar="FILE",
            help="Pack the orders of this file instead of random orders: BED-BPP's JSON, a table or sheet "
            "of items with sizes and quantities, or another tool's form (docs/plan-format.md).",
        ),
    ] = None,
    target: opt.Target = None,
    packer: Annotated[
        str | None,
        typer.Option(
            "--packer",
            metavar="NAME",
            help="baseline: puts each box at the lowest place with enough support; balanced: packs more densely, and "
            "keeps every box in balance; physical: packs more densely still, and chooses packings that stand in "
            "simulations, also with the errors of a robot; learned: packs boxes in the sequence of the order, by "
            "weights trained with simulations.  "
            "[default: baseline, with some loose plans]",
        ),
    ] = None,
    look_ahead: Annotated[
        int | None,
        typer.Option(
            "--lookahead",
            metavar="K",
            min=1,
            help="Number of next boxes that the packer 'learned' sees; the packer may place any of them.  [default: 1]",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="N",
            min=1,
            help="Number of processes among which packing is divided. This number does not change the plans.  "
            "[default: one for each CPU]",
        ),
    ] = None,
    overwrite: opt.Overwrite = False,
    **options: Any,
) -> None:
    """Write packing plans for random orders (43±14 boxes) with the statistics of the benchmark BED-BPP. A packer, which
    is a packing program, packs the orders.

    Without --packer, the set is mixed: about half of the plans are packed too loosely on purpose, so that some plans
    stand and some fall. To compare a packer with others, name it with --packer: no plan is then packed loosely on
    purpose.

    The packer physical simulates several packings of each order, and chooses the densest packing that stands often
    enough. The simulations take seconds per order on CPUs.

    The packer learned places boxes in the sequence of the order, and sees the next --lookahead boxes. The other packers
    see the whole order.

    With --orders, the orders of a file are packed instead. Boxes for which there is no place below 2 m are left out.
    For each order with boxes left out, the command prints a line that names these boxes. For random orders, the command
    prints only the first 10 of these lines.
    """
    from petmjx.common.machine import cpu_threads
    from petmjx.packers.pack import reading_of
    from petmjx.packers.sample_plans import loose_share_of, pack_orders, write_samples
    from petmjx.plans.bedbpp_writer import write_plans
    from petmjx.plans.file_formats import is_csv, is_parquet_name
    from petmjx.show.progress import progress

    if is_csv(out) or is_parquet_name(out):
        raise InputError(f"{out}: samples are written as JSON; use 'petmjx convert' to make a table")
    check_outputs([out], overwrite=overwrite, inputs=[] if orders is None else [orders])
    if look_ahead is not None:
        if packer != LEARNED:
            raise InputError(f"--lookahead needs the packer '{LEARNED}'")
        integer_of(look_ahead, "--lookahead", 1, MOST_LOOK_AHEAD)
    drawn = {"-n": n, "--loose-share": loose_share}
    if orders is not None and (
        drawn_option := next((name for name, value in drawn.items() if value is not None), None)
    ):
        raise InputError(f"{drawn_option} is for random orders, but --orders names a file of orders")
    n = DEFAULT_SAMPLES if n is None else n
    reading, options = reading_of(orders is not None, target, options)
    if packer == PHYSICAL:
        _write_physical(out, orders, n, seed, workers or cpu_threads(), options, reading)
        return
    if packer is not None and packer not in PACKERS:
        raise InputError(f"unknown packer {printable_name(packer)}; {hint(packer, [*PACKERS, PHYSICAL])}")
    if options:
        raise InputError(f"{next(iter(options))} needs the packer '{PHYSICAL}'")
    errors: list[InputError] = []
    left_out: list[LeftOutItems] = []
    written = 0

    def count(done: int) -> None:
        nonlocal written
        written = done
        bar.update(done)

    pack_options: dict[str, Any] = {
        "seed": seed,
        "packer": packer,
        "look_ahead": look_ahead,
        "workers": workers or cpu_threads(),
        "on_left_out": left_out.append,
    }
    try:
        with progress(n if orders is None else None) as bar:
            if orders is None:
                write_samples(out, n, loose_share=loose_share, progress=count, **pack_options)
            else:
                packed = pack_orders(orders, on_bad_order=errors.append, reading=reading, **pack_options)
                write_plans(out, packed, progress=count)
    finally:  # the lines about skipped orders are printed even after an error, since they explain missing plans
        print_skipped(errors)
    _print_left_out([str(order) for order in left_out], drawn=orders is None)
    boxes = sum(len(order.numbers) for order in left_out)
    print(f"{count_text(written, 'plan')} in {printable(str(out))}{_totals(boxes, len(left_out))}")
    share = loose_share_of(packer, loose_share)
    if orders is None and share > 0 and packer in (None, BASELINE):
        print(
            f"about {100 * share:.3g} % of these plans are packed loosely on purpose; "
            "to compare packers, use --loose-share 0"
        )


def _print_left_out(lines: Sequence[str], *, drawn: bool) -> None:
    """Print the lines about orders of which boxes were left out. For random orders (``drawn``), only the first
    ``MOST_SHOWN`` lines are printed, and then the number of all further orders."""
    shown = lines[:MOST_SHOWN] if drawn else lines
    for line in shown:
        print(line)
    if len(lines) > len(shown):
        print(f"{count_text(len(lines) - len(shown), 'more order')} with boxes left out")


def _totals(boxes: int, orders: int) -> str:
    """The end of a line: how many boxes of how many orders were left out."""
    return f"; {count_text(boxes, 'box', 'boxes')} of {count_text(orders, 'order')} left out" if orders else ""


def _write_physical(
    out: Path,
    orders: Path | None,
    n: int,
    seed: int,
    workers: int,
    options: Mapping[str, Any],
    reading: OrderReading | None,
) -> None:
    """Pack orders with the packer ``physical`` (a search and simulations), write the plans, and print a summary."""
    from petmjx.packers.pack import orders_of, pack_each
    from petmjx.packers.packed_orders import Packed, PackedOrder
    from petmjx.plans.bedbpp_writer import Placement, write_plans
    from petmjx.show.progress import progress

    errors: list[InputError] = []
    packings: list[PackedOrder] = []

    def plans() -> Iterator[tuple[str, list[Placement]]]:
        orders_to_pack = orders_of(orders, n if orders is None else None, seed, errors.append, reading)
        for packing in pack_each(orders_to_pack, workers=workers, **options):
            packings.append(packing)
            bar.update(len(packings))
            if packing.taken is not None:
                yield packing.order_id, packing.placements

    try:
        with progress(n if orders is None else None) as bar:
            write_plans(out, plans())
    finally:  # the lines about skipped orders are printed even after an error, since they explain missing plans
        print_skipped(errors)
    _print_left_out(
        [f"{packing.left_out}: {packing.why}" for packing in packings if packing.left_out], drawn=orders is None
    )
    shaky = [
        f"{printable_name(packing.order_id)} ({100 * packing.taken.share:.0f} %)"
        for packing in packings
        if packing.taken is not None and not packing.good
    ]
    if shaky:
        verb = "has" if len(shaky) == 1 else "have"
        names = ", ".join(shaky[:MOST_SHOWN]) + (", …" if len(shaky) > MOST_SHOWN else "")
        print(
            f"{count_text(len(shaky), 'order')} {verb} no packing that stands in the required share of worlds with "
            f"errors (--least-share): {names}"
        )
    table = Packed(tuple(packings)).orders
    totals = _totals(int(table["left_out"].sum()), int((table["left_out"] > 0).sum()))
    table = table[table["boxes"] > 0]
    print(f"{count_text(len(table), 'plan')} in {printable(str(out))}{totals}")
    standing = int((table["verdict"] == "stable").sum())
    sure = f"; {100 * table['share'].mean():.1f} % of worlds with errors stand" if table["n_worlds"].any() else ""
    print(f"utilisation {table['utilisation'].mean():.3f}; {standing:,} stand if placed exactly{sure}")
