"""Packs orders with a search and simulations, for the command ``petmjx samples --packer physical``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name

if TYPE_CHECKING:
    from petmjx.plans.item_orders import OrderReading

MOST_NAMED: Final = 10
"""Largest number of generated orders for which a separate line about left-out boxes is printed, and largest number of
orders that a single line names."""


def write_physical(
    out: Path,
    orders: Path | None,
    n: int,
    seed: int,
    workers: int,
    options: Mapping[str, Any],
    reading: OrderReading | None = None,
) -> None:
    """Pack orders with the packer ``physical`` (a search and simulations), write the plans, and print a summary."""
    from petmjx.packers.pack import Packed, orders_of, pack_each
    from petmjx.packers.packed_orders import PackedOrder
    from petmjx.plans.json_writer import Placement, write_plans
    from petmjx.show.progress import progress

    errors: list[InputError] = []
    packings: list[PackedOrder] = []

    def plans() -> Iterator[tuple[str, list[Placement]]]:
        orders_to_pack = orders_of(orders, n if orders is None else None, seed, errors.append, reading)
        for packed in pack_each(orders_to_pack, workers=workers, **options):
            packings.append(packed)
            bar.update(len(packings))
            if packed.taken is not None:
                yield packed.order_id, packed.placements

    try:
        with progress(n if orders is None else None) as bar:
            write_plans(out, plans())
    finally:  # the lines are printed even after an error, since they explain missing plans
        for error in errors:
            typer.echo(f"skipped: {printable(str(error))}", err=True)
    packed = Packed(tuple(packings))
    for line in (*_left_out(packings, named=orders is not None), *_not_good(packings), *_in_short(packed, out)):
        print(line)


def _left_out(packings: list[Any], *, named: bool) -> Iterator[str]:
    """Yield a line for each order of which boxes were left out. For generated orders, only the first ``MOST_NAMED``
    lines are yielded, and a line with the number of all further orders."""
    incomplete = [packed for packed in packings if packed.left_out]
    few = incomplete if named else incomplete[:MOST_NAMED]
    for packed in few:
        yield f"{packed.left_out}: {packed.why}"
    if len(incomplete) > len(few):
        yield f"{count_text(len(incomplete) - len(few), 'more order')} with boxes left out"


def _not_good(packings: list[Any]) -> Iterator[str]:
    """Yield a line that names orders without a good packing. A packing is good if it stands in the required share of
    simulations."""
    shaky = [packed for packed in packings if packed.taken is not None and not packed.good]
    if shaky:
        names = ", ".join(
            f"{printable_name(packed.order_id)} ({100 * packed.taken.share:.0f} %)" for packed in shaky[:MOST_NAMED]
        )
        tail = ", …" if len(shaky) > MOST_NAMED else ""
        verb = "has" if len(shaky) == 1 else "have"
        yield f"{count_text(len(shaky), 'order')} {verb} no packing that stands as often as asked for: {names}{tail}"


def _in_short(packed: Any, out: Path) -> Iterator[str]:
    table = packed.orders
    table = table[table["boxes"] > 0]
    boxes, orders = int(packed.orders["left_out"].sum()), int((packed.orders["left_out"] > 0).sum())
    left = f"; {count_text(boxes, 'box', 'boxes')} of {count_text(orders, 'order')} left out" if orders else ""
    yield f"{count_text(len(table), 'plan')} in {printable(str(out))}{left}"
    standing = int((table["verdict"] == "stable").sum())
    sure = f", {100 * table['share'].mean():.1f} % of worlds with errors" if table["n_worlds"].any() else ""
    yield f"utilisation {table['utilisation'].mean():.3f}; {standing:,} stand placed exactly{sure}"
