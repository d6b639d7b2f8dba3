"""The packer ``physical``: dense packings, found by rules, of which physics takes one.

Rules find packings that are dense and in balance (:mod:`petmjx.plans.samples.beam`), with more or less free space
between neighbours. Simulation says which of them stand, exactly placed and as a robot places them. Many orders are
judged in one run, since worlds side by side are what engines are fast at.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Any, Final

from petmjx.basics.machine import why_no_warp, why_no_warp_on_cpu
from petmjx.options.run_options import AUTO
from petmjx.packing.finalists import Finalist, finalists, learned_finalists
from petmjx.packing.judged import Judged, judge
from petmjx.packing.options import PhysicalOptions
from petmjx.packing.packed import PackedOrder
from petmjx.plans.samples.orders import Order
from petmjx.plans.samples.parallel import in_order

AT_ONCE_CPU: Final = 16
AT_ONCE_GPU: Final = 512
"""Orders that are judged in one run: a GPU is busy with thousands of worlds, and on CPUs results come soon."""


def pack_physical(
    orders: Iterable[tuple[str, Order]],
    options: PhysicalOptions,
    how: Mapping[str, Any],
    workers: int,
    look_ahead: int | None = None,
) -> Iterator[PackedOrder]:
    """Pack orders, in the order given.

    Args:
        orders: id and order.
        how: options of ``petmjx.score`` for the simulation.
        workers: processes that search; they change no plan.
        look_ahead: instead of searching, pack by ``learned``, which sees so many boxes; physics judges that packing.

    Raises:
        InputError: unusable options.
        EngineUnavailable: the engine asked for cannot run here.
    """
    engine = how.get("engine", AUTO)
    if engine == AUTO:
        engine = fastest()
    searched = in_order(partial(_searched, options=options, look_ahead=look_ahead), orders, workers, alone=1, chunk=1)
    while batch := list(islice(searched, AT_ONCE_GPU if engine == "mjx-warp" else AT_ONCE_CPU)):
        yield from _packed(batch, options, {**how, "engine": engine})


def fastest() -> str:
    """The engine that is fastest on this machine for many worlds. ``auto`` would take another one for few orders than
    for many, and an order's plan must not depend on the others."""
    if why_no_warp() is None:
        return "mjx-warp"
    return "mjx-warp-cpu" if why_no_warp_on_cpu() is None else "mujoco"


_Searched = tuple[str, Order, list[Finalist]]


def _searched(numbered: tuple[str, Order], options: PhysicalOptions, look_ahead: int | None) -> _Searched:
    order_id, order = numbered
    found = finalists(order, options) if look_ahead is None else learned_finalists(order, look_ahead)
    return order_id, order, found


def _packed(batch: Sequence[_Searched], options: PhysicalOptions, how: Mapping[str, Any]) -> list[PackedOrder]:
    judged: dict[str, list[Judged]] = {order_id: [] for order_id, _, _ in batch}
    waiting = {order_id: list(found) for order_id, _, found in batch}
    while asked := {order_id: found.pop(0) for order_id, found in waiting.items() if found}:
        for order_id, each in judge(asked, options, how).items():
            judged[order_id].append(each)
            if options.maximise == "utilisation" and each.is_good(options):
                waiting[order_id].clear()  # the others are less dense
    return [PackedOrder.of(order_id, order, found, judged[order_id], options) for order_id, order, found in batch]
