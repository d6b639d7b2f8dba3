"""Sample plans in BED-BPP's format, packed from generated orders or from a file of orders.

``generate`` and ``write_samples`` generate orders with BED-BPP's statistics and pack them. If no packer is named, these
functions make a mixed set for trials and benchmarks, in which some plans stand and some collapse. About half of the
plans of a mixed set (``loose_share``) are loose, that is, packed with an unsafe support rule. The other plans of a
mixed set are strict: they are packed with a safe support rule. If a packer is named, it packs all plans by its own
rules, so that packers can be compared. Plan i depends only on the seed, i, the packer and ``loose_share``. So with ``n
= 10``, the plans are the first ten plans of ``n = 1000``.

``pack_orders`` packs the orders of a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petmjx.common.argument_checks import integer_of, number_of, path_of
from petmjx.common.errors import InputError
from petmjx.common.parallel_map import ordered_results
from petmjx.options.run_options import MOST_WORKERS
from petmjx.packers.baseline_packer import PackRules, PlacedBox
from petmjx.packers.left_out_items import LeftOutItems, left_out_of
from petmjx.packers.packer_registry import BASELINE, LEFT_OUT_REASONS, packer_named
from petmjx.plans.bedbpp_writer import Placement, write_plans
from petmjx.plans.order import Item, Order, target_extent_mm
from petmjx.plans.order_generator import PACKER_STREAM, draw_order, stream
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan_fields import COM_FIELDS_JSON

if TYPE_CHECKING:
    from petmjx.plans.item_units_and_quantities import OrderReading

DEFAULT_LOOSE_SHARE = 0.5
"""Share of loose plans in a mixed set. For example, the first 100 plans of seed 0 are 55 loose and 45 strict plans.
With check ``one-by-one``, schedule ``adaptive`` and physics ``pallet``, 38 of the loose plans fail, and none of the
strict plans."""

MOST_SAMPLES = 200_000
"""Largest number of plans in a set: twenty times BED-BPP's number. A file with this number of plans has nearly 4 GiB.
Larger files cannot be read by petmjx."""

LOOSE_SUPPORT = (0.3, 0.6)
"""Range of the random ``min_support`` of loose plans. Strict plans have the default of ``PackRules``."""


_Packed = tuple[str, list[Placement], LeftOutItems | None]
"""Plan id, placements, and the items that are left out; the items are None if no item is left out."""


def generate(
    n: int,
    seed: int,
    *,
    loose_share: float | None = None,
    packer: str | None = None,
    look_ahead: int | None = None,
    workers: int = 1,
    on_left_out: Callable[[LeftOutItems], None] | None = None,
) -> Iterator[tuple[str, list[Placement]]]:
    """Generate the first ``n`` plans of ``seed``, as (plan id, placements in packing order). Plans are made when they
    are needed, one after another.

    Args:
        n: number of plans.
        seed: seed of the random numbers.
        loose_share: share of loose plans, for the packer ``baseline``; other packers make no loose plans. If
            ``loose_share`` is None, the share is 0 for a named packer, else ``DEFAULT_LOOSE_SHARE``.
        packer: a name in ``petmjx.packers.packer_registry.PACKERS``. All packers get the same orders. If ``packer`` is
            None, ``baseline`` packs a mixed set of loose and strict plans.
        look_ahead: number of boxes that the packer ``learned`` sees at a time. If ``look_ahead`` is None, the packer
            sees 1 box.
        workers: number of processes, which does not affect the plans.
        on_left_out: function that is called with the items that a plan leaves out, just before the plan is yielded.

    Raises:
        InputError: ``n`` is outside 1…``MOST_SAMPLES``, the seed is negative, the share is outside 0…1, or the packer
            is unknown.
    """
    integer_of(n, "n", 1, MOST_SAMPLES)
    integer_of(seed, "seed", 0)
    share = loose_share_of(packer, loose_share)
    number_of(share, "loose_share", 0, 1)
    name = BASELINE if packer is None else packer
    packer_named(name, look_ahead)
    integer_of(workers, "workers", 1, MOST_WORKERS)
    pack_one = partial(_pack_drawn, seed=seed, loose_share=share, packer=name, look_ahead=look_ahead)
    return _plans(ordered_results(pack_one, range(n), workers), on_left_out)


def generate_one(
    index: int, seed: int, *, loose_share: float | None = None, packer: str | None = None
) -> tuple[str, list[Placement]]:
    """The plan ``index`` of ``seed``: its id, such as "s0-000123", and its placements in packing order."""
    plan_id, placements, _ = _pack_drawn(index, seed, loose_share_of(packer, loose_share), packer or BASELINE)
    return plan_id, placements


def loose_share_of(packer: str | None, share: float | None = None) -> float:
    """The share of loose plans. If ``share`` is given, the result is ``share``. If ``share`` is None, the result is 0
    for a named packer, and else ``DEFAULT_LOOSE_SHARE``."""
    if share is not None:
        return share
    return DEFAULT_LOOSE_SHARE if packer is None else 0.0


def write_samples(
    path: Path | str,
    n: int,
    seed: int,
    *,
    loose_share: float | None = None,
    packer: str | None = None,
    look_ahead: int | None = None,
    workers: int = 1,
    on_left_out: Callable[[LeftOutItems], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Write the first ``n`` plans of ``seed`` to a JSON file, gzipped if its name ends in ``.gz``.

    Each plan is written as soon as it is made, so memory does not grow with ``n``. ``progress`` is called with the
    number of plans written so far. The other arguments have the same meanings as in :func:`generate`.

    Raises:
        InputError: an argument is wrong (see :func:`generate`), or the file cannot be written.
    """
    samples = generate(
        n,
        seed,
        loose_share=loose_share,
        packer=packer,
        look_ahead=look_ahead,
        workers=workers,
        on_left_out=on_left_out,
    )
    write_plans(path, samples, progress=progress)


def pack_orders(
    path: Path | str,
    *,
    seed: int = 0,
    packer: str | None = None,
    rules: PackRules | None = None,
    look_ahead: int | None = None,
    workers: int = 1,
    on_bad_order: Callable[[InputError], None] | None = None,
    on_left_out: Callable[[LeftOutItems], None] | None = None,
    reading: OrderReading | None = None,
) -> Iterator[tuple[str, list[Placement]]]:
    """Pack a file of orders, in BED-BPP's form or any other. Yields (plan id, placements), in the order of the file.

    Boxes that find no place below 2 m are left out. An order without any placed box has no plan. A packer may sort the
    boxes, so ``sequence`` is renumbered in packing order.

    Args:
        path: the file, gzipped or not.
        seed: seed of the packer's random numbers.
        packer: a name in ``petmjx.packers.packer_registry.PACKERS``. If ``packer`` is None, the packer is ``baseline``.
        rules: rules of the packer ``baseline``. If ``rules`` is None, the packer's strict rules are used.
        look_ahead: number of boxes that the packer ``learned`` sees at a time. If ``look_ahead`` is None, the packer
            sees 1 box.
        workers: number of processes, which does not affect the plans.
        on_bad_order: function that is called with the error of each bad order; the order is then skipped. If
            ``on_bad_order`` is None, the error is raised.
        on_left_out: function that is called with the items that a plan leaves out, just before the plan is yielded.
        reading: how to read a file that is not in BED-BPP's form, and the target of its orders. If ``reading`` is None,
            the file is read in the most plausible way.

    Raises:
        InputError: the file has no orders, the packer is unknown, or an order is bad and ``on_bad_order`` is None.
    """
    name = BASELINE if packer is None else packer
    packer_named(name, look_ahead)
    integer_of(seed, "seed", 0)
    integer_of(workers, "workers", 1, MOST_WORKERS)
    orders = enumerate(read_orders(path_of(path, "path"), on_bad_order, reading))
    pack_one = partial(_pack_read, seed=seed, packer=name, rules=rules, look_ahead=look_ahead)
    return _plans(ordered_results(pack_one, orders, workers), on_left_out)


def _pack_drawn(index: int, seed: int, loose_share: float, packer: str, look_ahead: int | None = None) -> _Packed:
    rng = stream(seed, PACKER_STREAM, index)
    loose, support, y_first = rng.random(3)
    rules = PackRules(y_first=bool(y_first < 0.5))
    if loose < loose_share:
        low, high = LOOSE_SUPPORT
        support = low + (high - low) * float(support)
        rules = PackRules(min_support=support, centre_supported=False, y_first=rules.y_first)
    return _pack(f"s{seed}-{index:06d}", draw_order(seed, index), packer, rules, rng, look_ahead)


def _pack_read(
    numbered: tuple[int, tuple[str, Order]],
    seed: int,
    packer: str,
    rules: PackRules | None,
    look_ahead: int | None,
) -> _Packed:
    index, (order_id, order) = numbered
    return _pack(order_id, order, packer, rules, stream(seed, PACKER_STREAM, index), look_ahead)


def _pack(
    order_id: str,
    order: Order,
    packer: str,
    rules: PackRules | None,
    rng: np.random.Generator,
    look_ahead: int | None,
) -> _Packed:
    placed = packer_named(packer, look_ahead)(order.items, target_extent_mm(order.target), rules, rng)
    return order_id, as_placements(placed), left_out_of(order_id, order, placed, LEFT_OUT_REASONS.get(packer, ""))


def _plans(
    packed: Iterable[_Packed], on_left_out: Callable[[LeftOutItems], None] | None
) -> Iterator[tuple[str, list[Placement]]]:
    """The plans that have at least one box. ``on_left_out`` is called with the items that a plan leaves out."""
    for plan_id, placements, left_out in packed:
        if left_out is not None and on_left_out is not None:
            on_left_out(left_out)
        if placements:
            yield plan_id, placements


def as_placements(placed: Iterable[PlacedBox]) -> list[Placement]:
    """Packed boxes as placements in BED-BPP's format. ``sequence`` is a box's number in packing order, from 1."""
    return [
        {
            "item": {
                "article": box.item.article,
                "id": box.item.item_id,
                "product_group": box.item.product_group,
                "length/mm": _plain(box.item.length_mm),
                "width/mm": _plain(box.item.width_mm),
                "height/mm": _plain(box.item.height_mm),
                "weight/kg": box.item.weight_kg,
                "sequence": rank,
                **_seldom(box.item),
            },
            "orientation": box.orientation,
            "flb_coordinates": [_plain(value) for value in box.corner_mm],
        }
        for rank, box in enumerate(placed, start=1)
    ]


def _seldom(item: Item) -> dict[str, Any]:
    """Those properties of an item that most orders do not state: centre of mass, stiffness and kind."""
    fields: dict[str, Any] = {} if item.com_mm is None else dict(zip(COM_FIELDS_JSON, item.com_mm, strict=True))
    fields |= {} if item.stiffness_n_mm is None else {"stiffness_n_mm": item.stiffness_n_mm}
    return fields | ({"kind": item.kind} if item.kind else {})


def _plain(value_mm: float) -> int | float:
    """A length as int if it is a whole number of millimetres, as in BED-BPP. Other lengths are rounded to a nanometre,
    to remove float64 noise."""
    rounded = round(value_mm, 6)
    return int(rounded) if rounded == int(rounded) else rounded
