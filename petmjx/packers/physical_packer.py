"""The packer ``physical``: rules find dense packings, and simulations decide which of them is chosen.

Rules find packings that are dense and in balance (:mod:`petmjx.packers.beam_search`), with different free spaces
between neighbours. Simulations show which of these packings stand, both if boxes are placed exactly and if a robot
places them with errors. Searches run in worker processes. One engine simulates the packings of all orders, because
engines are fastest with many worlds at a time. The engine gets the packings of an order as soon as the search has found
them, so that no order waits for another order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from petmjx.common.parallel_map import UnorderedResults
from petmjx.engines.engine_of_run import engine_for
from petmjx.packers.finalists import finalists, learned_finalists
from petmjx.packers.pack_flow import CPU, GPU, Flow, Searched, WorldsOfPlans
from petmjx.packers.packed_orders import PackedOrder
from petmjx.packers.physical_packer_options import PhysicalOptions
from petmjx.plans.order import Order


def pack_physical(
    orders: Iterable[tuple[str, Order]],
    options: PhysicalOptions,
    how: Mapping[str, Any],
    workers: int,
    look_ahead: int | None = None,
) -> Iterator[PackedOrder]:
    """Pack orders. The results are in the sequence of the input.

    Args:
        orders: pairs of an id and an order.
        options: options of the packer.
        how: options of ``petmjx.score`` for the simulations. The option ``engine`` must name an engine; it must not be
            ``auto``.
        workers: number of processes for the search, which does not affect the plans.
        look_ahead: if given, the packer ``learned`` makes the packing that is simulated, and sees this number of boxes
            at a time. If ``look_ahead`` is None, the search makes the packings.

    Raises:
        InputError: the options are unusable.
        EngineUnavailable: the requested engine cannot run on this machine.
    """
    worlds = WorldsOfPlans(options.worlds, how)
    searching = partial(_order_search, options=options, look_ahead=look_ahead)
    with (
        UnorderedResults(searching, orders, workers) as searched,
        engine_for(worlds.run, worlds.work) as (simulator, _),
    ):
        yield from Flow(searched, options, worlds, GPU if how["engine"] == "mjx-warp" else CPU).packed(simulator)


def _order_search(numbered: tuple[str, Order], options: PhysicalOptions, look_ahead: int | None) -> Searched:
    order_id, order = numbered
    packings = finalists(order, options) if look_ahead is None else learned_finalists(order, look_ahead)
    return order_id, order, packings
