"""The packer ``physical``: rules find dense packings, and simulations decide which of them is chosen.

Rules find packings that are dense and in balance (:mod:`petmjx.packers.beam_search`), with different free spaces
between neighbours. Simulations show which of these packings stand, both if boxes are placed exactly and if a robot
places them with errors. Searches run in worker processes. One engine simulates the packings of all orders, because
engines are fastest with many worlds at a time. An order continues as soon as its own results are known, without waiting
for other orders (``Flow``).
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Final, NamedTuple, Protocol, runtime_checkable

from petmjx.common.parallel_map import UnorderedResults
from petmjx.engines.engine_of_run import engine_for
from petmjx.engines.expected_work import Work
from petmjx.engines.protocol import Engine
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.world_results import World
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.packers.finalists import (
    Asks,
    Evaluation,
    Finalist,
    Trial,
    finalists,
    learned_finalists,
    order_evaluation,
)
from petmjx.packers.packed_orders import PackedOrder
from petmjx.packers.physical_packer_options import PhysicalOptions
from petmjx.plans.order import Order
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import without_narrow_walls, without_vanishing_boxes
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.sweep_worlds import PlacementGroup, SweepPlan
from petmjx.world.job import Job
from petmjx.world.scene import build_scene


class Orders(NamedTuple):
    """Numbers that limit how many orders and worlds are simulated at the same time.

    Attributes:
        few: number of orders for which the search must be complete before an idle engine begins. The worlds of later
            orders join the running worlds.
        most: largest number of orders that are simulated at a time. More orders do not make an engine faster.
        worlds: an engine that simulates fewer worlds than this number has spare capacity. Spare capacity is used for
            worlds that may turn out not to be needed.
        rows: smallest number of worlds for which the engine ``mjx-warp`` reserves memory. When the reserved memory is
            full, all worlds in it must end before new worlds begin.
    """

    few: int
    most: int
    worlds: int
    rows: int


CPU: Final = Orders(4, 16, 0, 1024)
GPU: Final = Orders(16, 1024, 256, 8192)

GRANULE: Final = 96
"""The engine's capacity (largest number of boxes of a world) is a multiple of this number. With a smaller number,
orders would exceed the present capacity more often. An order that exceeds the capacity, and all orders after it, must
wait until the worlds of the earlier orders have ended."""

Searched = tuple[str, Order, list[Finalist]]
"""The result of a search: id of the order, the order, and the packings to simulate."""


@runtime_checkable
class TableEngine(Protocol):
    """An engine that keeps its worlds in tables, with one row per world: ``mjx-warp`` and ``mjx-warp-cpu``."""

    least_rows: int
    granule: int


@dataclass(eq=False)
class _OpenOrder:
    """An order whose packings are being simulated.

    Attributes:
        number: position of the order in the input.
        order_id: id of the order.
        order: the order.
        finalists: the packings of the order.
        asking: the generator ``order_evaluation`` of the order, which requests worlds.
        unanswered: number of requested worlds that have no result yet.
    """

    number: int
    order_id: str
    order: Order
    finalists: Sequence[Finalist]
    asking: Generator[Asks, None, list[Evaluation]]
    unanswered: int = 0


@dataclass(frozen=True, eq=False)
class _PackingWorld(World):
    """A world in which a packing is simulated."""

    of: _OpenOrder
    trial: Trial


class WorldsOfPlans:
    """Makes the worlds of plans, the same worlds as in ``petmjx.score`` with ``confidence``. Variant 0 of a plan is the
    nominal (unchanged) world. All variants other than 0 have errors.

    Attributes:
        sim: options of the simulation of every world.
        run: options of the run.

    Args:
        n_worlds: number of worlds with errors for each plan.
        how: options of ``petmjx.score``.

    Raises:
        InputError: the options are unusable.
    """

    def __init__(self, n_worlds: int, how: Mapping[str, Any]) -> None:
        of_simulation, of_run, errors = sorted_options(how, Confidence)
        self.run = RunOptions(**of_run)
        sure = Confidence(**errors, **({"confidence": n_worlds} if n_worlds else {}))
        self._sweep = confidence_sweep(n_worlds, sure.errors, of_simulation) if n_worlds else None
        self.sim = self._sweep.simulation if self._sweep else Simulation(**of_simulation)
        self._variants: SweepPlan | None = None

    @property
    def work(self) -> Work:
        """The amount of work for one plan. The amount for all plans is not needed: only the engine ``auto`` would
        depend on it, but packers always name an engine."""
        return Work(self.sim, [1])

    def of(self, plan: Plan, variants: Iterable[int]) -> Iterator[World]:
        """The worlds of the given variants of a plan.

        Raises:
            InputError: a box has no extent left after the size reduction, or walls leave no room.
        """
        without_vanishing_boxes(PlanSet([plan]), self.sim.size_reduction_mm, strict=True)
        without_narrow_walls(PlanSet([plan]), self.sim.carrier, self.sim.walls, strict=True)
        if self._sweep is None:
            yield from (World(plan, number, Job(build_scene(plan, self.sim))) for number in variants)
            return
        if self._variants is None:  # the variants are made only once, since they are the same for all plans
            self._variants = SweepPlan(self._sweep, [plan])
        placements = [*self._variants.placements()]
        groups = (PlacementGroup(plan, number, *placements[number]) for number in variants)
        for group, scene in self._variants.scenes(groups):
            yield World(plan, group.index, self._variants.job(group, scene))


class Flow:
    """Takes orders from the search, through the simulation of their packings, to the chosen packing.

    Args:
        searched: the results of the searches.
        options: options of the packer.
        worlds: an object that makes the worlds of plans.
        at_a_time: limits on the numbers of orders and worlds.
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
        # numbers of orders that are being simulated, of their worlds without a result, and of orders that were yielded
        self._open = self._unanswered = self._n_yielded = 0
        self._following: list[World] = []
        self._packed: dict[int, PackedOrder] = {}

    def packed(self, engine: Engine) -> Iterator[PackedOrder]:
        """The result of each order, in the sequence of the input."""
        if isinstance(engine, TableEngine):
            engine.least_rows, engine.granule = self._at_a_time.rows, GRANULE
        results = score_worlds((), self._worlds.sim, engine, following=self._more, verdicts_only=True)
        for result in results:
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
        while (packed := self._packed.pop(self._n_yielded, None)) is not None:
            self._n_yielded += 1
            yield packed

    def _more(self) -> list[World]:
        """The worlds requested since the last call, including worlds of newly searched orders.

        This method waits for searches only if the engine has no other work, or if the searches run in this process.
        """
        while self._open < self._at_a_time.most:
            idle = self._unanswered == len(self._following)
            is_waiting = self._open < self._at_a_time.few and (idle or self._searched.alone)
            searched_orders = self._searched.take(waits=is_waiting)
            if not searched_orders:
                break
            for number, (order_id, order, packings) in searched_orders:
                self._open += 1
                asking = order_evaluation(order_id, packings, self._options, self._has_spare)
                self._go_on(_OpenOrder(number, order_id, order, packings, asking))
        worlds, self._following = self._following, []
        return worlds

    def _has_spare(self) -> bool:
        """Whether the engine has spare capacity for worlds that may not be needed: near the end of a run, when few
        worlds are left."""
        return self._searched.ended and self._unanswered < self._at_a_time.worlds

    def _go_on(self, order: _OpenOrder) -> None:
        """Request the next worlds of an order. If the order needs no more worlds, its packing is chosen."""
        try:
            requests = next(order.asking)
        except StopIteration as end:
            self._open -= 1
            self._packed[order.number] = PackedOrder.of(
                order.order_id, order.order, order.finalists, end.value, self._options
            )
            return
        for trial, variants in requests:
            if trial.worlds is None:  # scenes of all worlds are made together, which takes fewer calls
                trial.worlds = self._worlds.of(trial.plan, range(1 + self._options.worlds))
            for world in islice(trial.worlds, len(variants)):
                self._following.append(_PackingWorld(world.plan, world.variant, world.job, order, trial))
                order.unanswered += 1
                self._unanswered += 1


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
