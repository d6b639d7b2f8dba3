"""``petmjx.pack``: packs orders so that the plans stand."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

from petmjx.common.argument_checks import integer_of, path_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.machine import why_no_warp, why_no_warp_on_cpu
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import AUTO, MOST_WORKERS, OF_ORDERS, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.packers.item_stream import MOST_LOOK_AHEAD
from petmjx.packers.learned_packer import LEARNED
from petmjx.packers.pack_flow import pack_physical
from petmjx.packers.packed_orders import Packed, PackedOrder
from petmjx.packers.physical_packer_options import PHYSICAL, PhysicalOptions
from petmjx.packers.sample_plans import MOST_SAMPLES
from petmjx.plans.file_formats import SupportsArrow
from petmjx.plans.order import Order
from petmjx.plans.order_generator import draw_order
from petmjx.plans.order_reader import read_order_frame, read_orders
from petmjx.plans.plan_sources import PathArgument

if TYPE_CHECKING:
    from petmjx.plans.item_units_and_quantities import OrderReading

OF_RUN: Final = ("engine", "threads", "lanes", "world_timeout_s")
"""Fields of ``RunOptions`` that ``pack`` accepts. The accepted fields affect how packings are simulated."""


def pack(
    orders: PathArgument | SupportsArrow | None = None,
    *,
    n: int | None = None,
    seed: int = 0,
    packer: str = PHYSICAL,
    look_ahead: int | None = None,
    workers: int = 1,
    on_bad_order: Callable[[InputError], None] | None = None,
    target: str | None = None,
    **options: Any,
) -> Packed:
    """Pack orders with the packer ``physical`` or ``learned``.

    ``physical`` packs densely, and chooses plans that stand in simulations in which boxes are placed exactly, and in
    simulations with the errors of a robot. ``learned`` places boxes in the sequence of their arrival; its plans are
    simulated as well.

    ``petmjx.pack("orders.json", least_share=0.95).save("plans.json")``

    On the same engine, an order always gets the same plan. Only the errors are random, and they depend only on the
    plan's id.

    Args:
        orders: file of orders, in BED-BPP's form or any other form that ``petmjx samples --orders`` reads; or a data
            frame of items. If ``orders`` is None, ``n`` orders are generated, as in ``petmjx samples``.
        n, seed: number and seed of the generated orders.
        packer: ``physical`` or ``learned``.
        look_ahead: number of boxes that ``learned`` sees at a time. If ``look_ahead`` is None, ``learned`` sees 1 box.
        workers: number of processes for the search. The plans do not depend on the number of processes. Scripts that
            use more than one process need ``if __name__ == "__main__":``.
        on_bad_order: function that is called with the error of each unusable order; the order is then skipped. If
            ``on_bad_order`` is None, the error is raised.
        target: carrier for orders whose file does not name a carrier. The carrier may be ``euro-pallet``,
            ``rollcontainer``, or sizes in mm such as ``1200x1000``. If ``target`` is None, the carrier is the file's
            container if that container is a pallet, else a Euro pallet.
        options: options of the packer ``physical``: ``width``, ``branch``, ``clearances_mm``, ``worlds``,
            ``least_share``, ``maximise`` (docs/packers.md). Options of the simulation: ``errors`` (a sweep file),
            fields of ``petmjx.Simulation``, and ``engine``, ``threads`` and ``lanes``. Options for reading a file of
            orders: ``units``, ``columns``, ``density``, ``items``, ``reading`` (docs/plan-format.md#orders).

    Raises:
        InputError: the orders or the options are unusable.
        EngineUnavailable: the requested engine cannot run on this machine.
    """
    reading, options = reading_of(orders is not None, target, options)
    packed_orders = pack_each(
        orders_of(orders, n, seed, on_bad_order, reading),
        packer=packer,
        look_ahead=look_ahead,
        workers=workers,
        **options,
    )
    return Packed(tuple(packed_orders))


def pack_each(
    orders: Iterable[tuple[str, Order]],
    *,
    packer: str = PHYSICAL,
    look_ahead: int | None = None,
    workers: int = 1,
    **options: Any,
) -> Iterator[PackedOrder]:
    """Yield the result of each order as soon as it is known. All arguments except ``orders`` are as in ``pack``.

    Args:
        orders: pairs of an id and an order.
        options: options of ``pack``, which are checked before the first order is read.
    """
    packer_options, simulation_options = _split_options(options)
    if packer not in (PHYSICAL, LEARNED):
        raise InputError(f"packer must be {PHYSICAL} or {LEARNED}, {shown_value(packer)}")
    if packer == PHYSICAL and look_ahead is not None:
        raise InputError(f"look_ahead needs the packer '{LEARNED}'")
    ahead = integer_of(1 if look_ahead is None else look_ahead, "look_ahead", 1, MOST_LOOK_AHEAD)
    sees = ahead if packer == LEARNED else None
    if simulation_options.get("engine", AUTO) == AUTO:
        simulation_options["engine"] = fastest()
    return pack_physical(
        orders, packer_options, simulation_options, integer_of(workers, "workers", 1, MOST_WORKERS), sees
    )


def fastest() -> str:
    """The name of the engine that is fastest on this machine if there are many worlds.

    The engine ``auto`` is not used, because the engine that it chooses depends on the number of orders, but an order's
    plan must not depend on other orders.
    """
    if why_no_warp() is None:
        return "mjx-warp"
    return "mjx-warp-cpu" if why_no_warp_on_cpu() is None else "mujoco"


def orders_of(
    orders: PathArgument | SupportsArrow | None,
    n: int | None,
    seed: int,
    on_bad_order: Callable[[InputError], None] | None = None,
    reading: OrderReading | None = None,
) -> Iterator[tuple[str, Order]]:
    """The orders of a file, or generated orders, as pairs of an id and an order.

    Args:
        orders, n, seed, on_bad_order: as in ``pack``.
        reading: how to read a file that is not in BED-BPP's form. If ``reading`` is None, the file is read in the most
            plausible way.
    """
    integer_of(seed, "seed", 0)
    if orders is not None:
        if n is not None:
            raise InputError("n is the number of generated orders; leave it out if a file of orders is given")
        if isinstance(orders, SupportsArrow):
            return read_order_frame(orders, on_bad_order, reading)
        return read_orders(path_of(orders, "orders"), on_bad_order, reading)
    count = integer_of(100 if n is None else n, "n", 1, MOST_SAMPLES)
    return ((f"s{seed}-{index:06d}", draw_order(seed, index)) for index in range(count))


def reading_of(
    are_read: bool, target: str | None, options: Mapping[str, Any]
) -> tuple[OrderReading | None, dict[str, Any]]:
    """Split options into options that state how a file of orders is read, and the remaining options.

    Args:
        are_read: whether orders are read from a file. If orders are generated, options for reading must not be set.
        target: as in ``pack``.
        options: the options.

    Raises:
        InputError: an option is unusable.
    """
    from petmjx.plans.item_units_and_quantities import OrderReading

    of_files = {name: options[name] for name in OF_ORDERS if options.get(name) is not None}
    left = {name: value for name, value in options.items() if name not in OF_ORDERS}
    if not are_read and (idle := next(iter([*of_files, *(["target"] if target is not None else [])]), None)):
        raise InputError(f"{idle} applies only to a file of orders, but these orders are generated")
    return OrderReading.of(RunOptions(**of_files), target) if are_read else None, left


def _split_options(options: Mapping[str, Any]) -> tuple[PhysicalOptions, dict[str, Any]]:
    """Split options into the options of the packer and the options of its simulations."""
    sim, run, sure, of_packer = sorted_options(options, Confidence, PhysicalOptions)
    if other := next((name for name in run if name not in OF_RUN), None):
        raise InputError(f"{other}: a packer has no such option; the run options that it has are {', '.join(OF_RUN)}")
    if "confidence" in sure:
        raise InputError(
            "confidence: a packer has no such option; set the option worlds (the number of worlds with errors)"
        )
    if "exact_too" in sure:
        raise InputError("exact_too is an option of scores with confidence, not of packers; leave it out")
    packer_options = PhysicalOptions(**of_packer)
    if not packer_options.worlds and (
        idle := next((name for name in ("errors", "least_share") if name in sure | of_packer), None)
    ):
        raise InputError(f"{idle} needs worlds > 0")
    if not packer_options.worlds and packer_options.maximise == "share":
        raise InputError("maximise share needs worlds > 0")
    Simulation(**sim), RunOptions(**run)
    return packer_options, {**sim, **run, **sure}
