"""Orders on their way through search and simulation: each goes on when what it waits for is there."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, runtime_checkable

from petmjx.common.parallel_map import UnorderedResults
from petmjx.engines.attempt_stream import score_worlds
from petmjx.engines.protocol import Engine
from petmjx.engines.world_results import World
from petmjx.packers.pack_candidates import Finalist
from petmjx.packers.pack_evaluation import Asks, Evaluation, Trial, order_evaluation
from petmjx.packers.pack_options import PhysicalOptions
from petmjx.packers.pack_worlds import WorldsOfPlans
from petmjx.packers.packed_orders import PackedOrder
from petmjx.plans.order_generator import Order


class Orders(NamedTuple):
    """How many orders are simulated at a time.

    Attributes:
        few: an engine that is idle waits until so many are searched.
        most: with more an engine is not faster.
        worlds: an engine that has fewer has room for some that may not be needed.
        rows: how many worlds the tables of ``mjx-warp`` have room for, at least. When they are full, all of these end
            before others begin.
    """

    few: int
    most: int
    worlds: int
    rows: int


CPU: Final = Orders(4, 16, 0, 1024)
GPU: Final = Orders(64, 1024, 256, 8192)

GRANULE: Final = 96
"""Tables have room for a multiple of so many boxes. With less, an order with more boxes than those before would wait
until their worlds have ended, and the orders behind it as well."""

FEW_ALONE: Final = 16
"""``Orders.few``, at most, where the process that simulates also searches."""

Searched = tuple[str, Order, list[Finalist]]
"""Id, order, packings among which physics decides."""


@runtime_checkable
class TableEngine(Protocol):
    """An engine that has worlds in tables: ``mjx-warp`` and ``mjx-warp-cpu``."""

    least_rows: int
    granule: int


@dataclass(eq=False)
class _OpenOrder:
    """An order whose packings are simulated.

    Attributes:
        asking: says which worlds it needs.
        unanswered: worlds that it waits for.
    """

    number: int
    order_id: str
    order: Order
    found: Sequence[Finalist]
    asking: Generator[Asks, None, list[Evaluation]]
    unanswered: int = 0


@dataclass(frozen=True, eq=False)
class _PackingWorld(World):
    """A world of a packing."""

    of: _OpenOrder
    trial: Trial


class Flow:
    """Orders from their search to their packing.

    Args:
        searched: what was found of each order.
        worlds: makes their worlds.
        at_a_time: orders.
    """

    def __init__(
        self,
        searched: UnorderedResults[tuple[str, Order], Searched],
        options: PhysicalOptions,
        worlds: WorldsOfPlans,
        at_a_time: Orders,
    ) -> None:
        self._searched, self._options, self._worlds = searched, options, worlds
        self._at_a_time = at_a_time
        self._few = min(at_a_time.few, FEW_ALONE) if searched.alone else at_a_time.few
        self._open = self._unanswered = self._given = 0  # orders on their way, their worlds, orders that are packed
        self._following: list[World] = []
        self._packed: dict[int, PackedOrder] = {}

    def packed(self, engine: Engine) -> Iterator[PackedOrder]:
        """Each order, packed, in the order given."""
        if isinstance(engine, TableEngine):
            engine.least_rows, engine.granule = self._at_a_time.rows, GRANULE
        for result in score_worlds((), self._worlds.sim, engine, more=self._more):
            world = result.world
            assert isinstance(world, _PackingWorld)
            self._unanswered -= 1
            world.trial.take(world.variant, result.outcome.verdict)
            world.of.unanswered -= 1
            if not world.of.unanswered:
                self._go_on(world.of)
            yield from self._in_sequence()
        yield from self._in_sequence()

    def _in_sequence(self) -> Iterator[PackedOrder]:
        while (packed := self._packed.pop(self._given, None)) is not None:
            self._given += 1
            yield packed

    def _more(self) -> list[World]:
        """The worlds that are asked for now, also of orders that begin now. They are waited for if there is no other
        work."""
        while self._open < self._at_a_time.most:
            idle = self._unanswered == len(self._following)
            searched_orders = self._searched.take(waits=self._open < self._few and (idle or self._searched.alone))
            if not searched_orders:
                break
            for number, (order_id, order, packings) in searched_orders:
                self._open += 1
                asking = order_evaluation(order_id, packings, self._options, self._has_spare)
                self._go_on(_OpenOrder(number, order_id, order, packings, asking))
        worlds, self._following = self._following, []
        return worlds

    def _has_spare(self) -> bool:
        """Whether the engine has room for worlds that may not be needed: at the end, when few orders are left."""
        return self._searched.ended and self._unanswered < self._at_a_time.worlds

    def _go_on(self, order: _OpenOrder) -> None:
        """Ask for an order's next worlds. If it needs no more, it is packed."""
        try:
            requests = next(order.asking)
        except StopIteration as end:
            self._open -= 1
            self._packed[order.number] = PackedOrder.of(
                order.order_id, order.order, order.found, end.value, self._options
            )
            return
        for trial, variants in requests:
            for world in self._worlds.of(trial.plan, variants):
                self._following.append(_PackingWorld(world.plan, world.variant, world.job, order, trial))
                order.unanswered += 1
                self._unanswered += 1
