"""``petmjx label``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from petmjx.cli import command_options as opt
from petmjx.common.argument_checks import integer_of
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable

MOST_LABELS: Final = 100_000_000


@opt.takes(
    *("physics", "size_reduction_mm", "longest_wait_s", "placing", "thresholds", "solver"),
    *("engine", "threads", "lanes", "units", "columns", "density"),
)
def label(
    orders: Annotated[
        Path | None,
        typer.Argument(
            metavar="ORDERS",
            help="A file of orders: BED-BPP's JSON, a table or sheet of items, or another tool's form "
            "(docs/plan-format.md). Without a file: random orders, as in 'petmjx samples'.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder to write.")] = Path("labels"),
    n: Annotated[
        int, typer.Option("-n", metavar="N", help="Number of labels. Orders are used one after another.")
    ] = 10_000,
    seed: Annotated[
        int,
        typer.Option(
            "--seed",
            metavar="SEED",
            help="Seed of the random orders and random places.",
        ),
    ] = 0,
    errors: Annotated[
        int | None,
        typer.Option(
            "--worlds-with-errors",
            metavar="N",
            help="Also simulate each labelled placement in N worlds in which a robot places the box inexactly; the "
            "column `share` has the share of these worlds in which the pallet stands.",
        ),
    ] = None,
    explore: Annotated[
        float,
        typer.Option(
            "--explore",
            metavar="0…1",
            help="Share of boxes that are first tried at a random place, and not at a low place with enough support.",
        ),
    ] = 0.5,
    pallets: Annotated[
        int | None,
        typer.Option(
            "--pallets",
            metavar="N",
            help="Number of pallets that are packed at the same time; the labels do not depend on it. "
            "[default: 4096 on a GPU, else 64]",
        ),
    ] = None,
    max_height_mm: Annotated[
        float, typer.Option("--max-height-mm", metavar="MM", help="Highest top of a box.")
    ] = 1800.0,
    carrier: Annotated[
        str,
        typer.Option(
            "--carrier",
            metavar="NAME|FILE",
            help="What the boxes stand on: a carrier of a fixed size (docs/carriers.md).",
        ),
    ] = "euro-pallet",
    overwrite: opt.Overwrite = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the labels that an interrupted command left in DIR.")
    ] = False,
    **options: Any,
) -> None:
    """Simulate placements of boxes, and write the results (labels) as data with which a model can be trained or tested.

    The command writes a Parquet table for each split (train, validation, test). Orders with the same boxes are always
    in the same split. The command also writes a card that states what the tables contain, how they were made, and how
    well simple rules, and petmjx's own estimate, predict the labels.
    """
    from petmjx.cli.run_command import RunInterrupted
    from petmjx.loop.episode_orders import ENDLESS, Orders, order_reading
    from petmjx.loop.label_files import write_labels
    from petmjx.loop.placement_labels import Labeller
    from petmjx.loop.unfinished_labels import n_unfinished
    from petmjx.show.progress import progress

    count = integer_of(n, "-n", 1, MOST_LABELS)
    if resume and overwrite:
        raise InputError("--resume contradicts --overwrite: drop one of them")
    reading = order_reading(*(options.pop(name, None) for name in ("units", "columns", "density")))
    source = Orders(ENDLESS if orders is None else orders, integer_of(seed, "--seed", 0), reading=reading)
    labeller = Labeller(
        source,
        pallets=pallets,
        seed=seed,
        explore=explore,
        errors=errors,
        max_height_mm=max_height_mm,
        carrier=carrier,
        **options,
    )
    outputs: dict[str, Any] = {"source": orders or ENDLESS, "overwrite": overwrite, "resume": resume}
    n_before = n_unfinished(out) if resume else 0
    earlier = f"{count_text(n_before, 'label')} of an earlier command" if n_before else ""
    try:
        with progress(max(count - n_before, 0), "label") as bar:

            def report(n_made: int) -> None:
                bar.update(n_made - n_before, earlier if n_made < count else "completing the last orders")

            card = write_labels(labeller, count, out, progress=report, **outputs)
    except KeyboardInterrupt:
        n_kept = n_unfinished(out)
        kept = f"{n_kept:,} of {count_text(count, 'label')} are in {out}; --resume continues"
        raise RunInterrupted(kept if n_kept else "nothing was written") from None
    for split, numbers in card["splits"].items():
        print(
            f"{split}: {count_text(numbers['labels'], 'label')} of {count_text(numbers['orders'], 'order')}, "
            f"{numbers['stand']:,} stand, {numbers['fall']:,} fall"
        )
    for name, shares in card["baselines"].items():
        print(
            f"{name}: accepts {shares['standing_found']:.1%} of the boxes that stand, and refuses "
            f"{shares['falling_found']:.1%} of the boxes that fall"
        )
    if empty := [split for split, numbers in card["splits"].items() if not numbers["labels"]]:
        all_used = sum(numbers["orders"] for numbers in card["splits"].values()) >= source.count
        cure = "give more orders" if all_used else "give more labels (-n) or more orders"
        print(f"note: too few orders for {' and '.join(empty)}: {cure}")
    print(f"{printable(str(out))}: README.md and card.json describe the labels")
