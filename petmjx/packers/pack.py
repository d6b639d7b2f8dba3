"""``petmjx.pack``: packs orders so that the plans stand."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import pandas as pd

from petmjx.common.argument_checks import integer_of, path_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.machine import why_no_warp, why_no_warp_on_cpu
from petmjx.common.text import count_text
from petmjx.options.run_options import AUTO, MOST_WORKERS, OF_ORDERS, Confidence, RunOptions, sorted_options
from petmjx.options.simulation import Simulation
from petmjx.packers.item_stream import MOST_LOOK_AHEAD
from petmjx.packers.learned_packer import LEARNED
from petmjx.packers.pack_options import PHYSICAL, PhysicalOptions
from petmjx.packers.packed_orders import PackedOrder
from petmjx.packers.physical_packer import pack_physical
from petmjx.packers.sample_plans import MOST_SAMPLES
from petmjx.plans.bedbpp_writer import write_plans
from petmjx.plans.file_formats import SupportsArrow, is_csv, is_parquet_name
from petmjx.plans.order import Order
from petmjx.plans.order_generator import draw_order
from petmjx.plans.order_reader import read_order_frame, read_orders
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PathArgument
from petmjx.plans.plan_writer import save_plans
from petmjx.results.notebook_tables import ShownColumn, block_as_html, table_as_html

if TYPE_CHECKING:
    from petmjx.plans.item_units_and_quantities import OrderReading

OF_RUN: Final = ("engine", "threads", "lanes", "world_timeout_s")
"""Fields of ``RunOptions`` that ``pack`` accepts. The accepted fields affect how packings are simulated."""

SHOWN: Final = (
    ShownColumn("plan_id", "order"),
    ShownColumn("boxes", "boxes placed"),
    ShownColumn("left_out", "left out"),
    ShownColumn("utilisation", "utilisation", 3),
    ShownColumn("height_mm", "height mm"),
    ShownColumn("clearance_mm", "clearance mm"),
    ShownColumn("verdict", "placed exactly"),
    ShownColumn("share", "with errors %", 1, 100.0),
)
"""Columns of the table ``Packed.orders`` that notebooks show."""


@dataclass(frozen=True, eq=False)
class Packed:
    """The result of ``petmjx.pack``.

    Attributes:
        packed_orders: the result of each order, in the sequence of the input.
    """

    packed_orders: tuple[PackedOrder, ...]

    @property
    def each(self) -> tuple[PackedOrder, ...]:
        """The same as ``packed_orders``, under the name that this attribute had in version 0.2."""
        warnings.warn("Packed.each is now Packed.packed_orders", DeprecationWarning, stacklevel=2)
        return self.packed_orders

    @property
    def plans(self) -> list[Plan]:
        """The plans, for ``petmjx.score`` and ``petmjx.save_plans``. An order has no plan if there is no place for any
        of its boxes."""
        return [packed.plan for packed in self.packed_orders if packed.plan is not None]

    @property
    def orders(self) -> pd.DataFrame:
        """A table with one row for each order.

        The columns are

        - ``plan_id``: id of the order and of its plan.
        - ``order_boxes``: number of boxes in the order.
        - ``boxes``: number of placed boxes.
        - ``left_out``: number of boxes that are left out.
        - ``why``: the reason why boxes are left out.
        - ``utilisation``: volume of the placed boxes / (area of the target × height of the pile).
        - ``height_mm``: height of the pile, mm.
        - ``clearance_mm``: free space between neighbours, mm.
        - ``verdict``: the verdict if boxes are placed exactly.
        - ``n_worlds``: number of worlds with errors.
        - ``n_standing``: number of worlds with errors in which the plan stands.
        - ``share``: n_standing / n_worlds, with its Wilson 95 % interval ``low``, ``high``.
        - ``tried``: number of simulated packings.
        - ``good``: whether the plan stands as often as requested.
        """
        return pd.DataFrame([packed.row() for packed in self.packed_orders])

    def __repr__(self) -> str:
        orders = self.orders
        sure = f", {100 * orders['share'].mean():.1f} % of worlds with errors stand" if orders["n_worlds"].any() else ""
        return f"Packed({count_text(len(orders), 'order')}, utilisation {orders['utilisation'].mean():.3f}{sure})"

    def _repr_html_(self) -> str:
        """The display in a notebook: mean values, and a table with one row for each order."""
        return block_as_html([repr(self)], [table_as_html(self.orders, SHOWN, "orders")])

    def save(self, path: PathArgument) -> None:
        """Write the plans to a file. An existing file is replaced.

        The format is BED-BPP's JSON, or a table if the name ends in ``.csv`` or ``.parquet``. If the name ends in
        ``.gz``, the file is gzipped.

        Raises:
            InputError: there is no plan, or the file cannot be written.
        """
        file = path_of(path, "path")
        if is_csv(file) or is_parquet_name(file):
            save_plans(self.plans, file)
        else:
            write_plans(file, ((packed.order_id, packed.placements) for packed in self.packed_orders if packed.taken))


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
            ``least_share``, ``maximise`` (docs/packers.md). Options of the simulation: ``errors``, a sweep file; fields
            of ``petmjx.Simulation``; ``engine``, ``threads``, ``lanes``. Options for reading a file of orders:
            ``units``, ``columns``, ``density``, ``items``, ``reading`` (docs/plan-format.md#orders).

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
    """Yield the result of each order as soon as it is known. All arguments except ``orders`` are those of ``pack``.

    Args:
        orders: pairs of an id and an order.
        options: options of ``pack``, which are checked before the first order is read.
    """
    packer_options, simulation_options = _split_options(options)
    if packer not in (PHYSICAL, LEARNED):
        raise InputError(f"packer must be {PHYSICAL} or {LEARNED}, {shown_value(packer)}")
    if packer == PHYSICAL and look_ahead is not None:
        raise InputError(f"look_ahead needs the packer {LEARNED}")
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
        reading: how a file is read that is not in BED-BPP's form. If ``reading`` is None, the file is read in the most
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
    """Split options into those that state how a file of orders is read, and the remaining options.

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
        raise InputError("confidence: a packer has no such option; set worlds, the number of worlds with errors")
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
