"""The simulated worlds of open pallets (pallets to which boxes can be added). For each pallet, there is the current
world and the world before the last box was placed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.protocol import Engine
from petmjx.loop.box_tables import BoxTable
from petmjx.loop.candidate_trials import placing_errors_of
from petmjx.loop.placement_arguments import Placements
from petmjx.loop.placement_bounds import Bounds, boxes_apart_mm, decidable
from petmjx.loop.placement_results import PlacementResults
from petmjx.options.simulation import Simulation
from petmjx.world.growing_scenes import EmptyCarrier, NextBoxes


class PalletWorlds:
    """n open pallets, simulated by an engine. Only one thread at a time may call the methods.

    Attributes:
        worlds: the worlds. World i has pallet i in its current state, world n + i has pallet i as it was before its
            last box, and the last world stays empty.
        boxes: the boxes of the pallets, as the caller requested them.
        bounds: the bounds by which clear cases are decided without a simulation.
        dead: (n,) whether each pallet has fallen.
        margin: (n,) margin of stability of each pallet that is at rest and for which the bounds are valid; −1 for all
            other pallets.
        apart_mm: (n, k) largest distance of any corner of each box from its planned position, mm.
        placing: whether another thread is currently simulating pallets until they rest. While another thread simulates
            pallets, only that thread may use the worlds.
    """

    def __init__(self, n: int, engine: Engine, sim: Simulation, most_boxes: int) -> None:
        self._n, self._sim = n, sim
        self._decidable = decidable(sim)
        # margin of an empty pallet; -1 if ``Bounds`` is not valid for these options
        self._bare = 1.0 if self._decidable else -1.0
        self.boxes = BoxTable(n)
        self.bounds = Bounds(self.boxes, sim.physics.box_friction[0])
        self.dead: NDArray[np.bool_] = np.zeros(n, bool)
        self.margin: FloatArray = np.full(n, self._bare)
        self.apart_mm: FloatArray = np.zeros((n, most_boxes))
        self.placing = False
        # for each box, the arguments ``error`` and ``error_strength`` of ``petmjx.Pallets.place``
        self._error: NDArray[np.int64] = np.zeros((n, most_boxes), np.int64)
        self._strength: FloatArray = np.zeros((n, most_boxes))
        # (n,) number of boxes in world n + i, which has pallet i as it was before its last box; -1 if world n + i is
        # not used
        self._before: NDArray[np.int64] = np.full(n, -1, np.int64)
        self.worlds = engine.open([EmptyCarrier(sim).scene] * (2 * n + 1), sim, most_boxes)
        self.worlds.go_on()

    def next_boxes(self, placements: Placements) -> NextBoxes:
        """The requested boxes in the form that open worlds need."""
        return NextBoxes.of(placements.size_mm, placements.corner_mm, placements.mass_kg, self._sim)

    def place(
        self,
        placements: Placements,
        meanwhile: Callable[[], object] | None,
        error: NDArray[np.int64] | None = None,
        strength: FloatArray | None = None,
    ) -> PlacementResults:
        """Put one box onto each pallet in ``placements``, and simulate these pallets until they rest. ``meanwhile`` is
        called during the simulation.

        Args:
            error, strength: (m,) see ``petmjx.Pallets.place``. If ``error`` is None, boxes are placed exactly.
        """
        rows = placements.pallet
        if len(rows):
            self.worlds.fork(rows.tolist(), (self._n + rows).tolist())
            self._before[rows] = self.boxes.count[rows]
            at = self.boxes.count[rows]
            for values, of_boxes in ((error, self._error), (strength, self._strength)):
                of_boxes[rows, at] = 0 if values is None else values
            self._put(placements, at)
            self.boxes.add(placements)
        if meanwhile is None:
            return self._rested(rows)
        self.placing = True
        try:
            with ThreadPoolExecutor(1, thread_name_prefix="petmjx-pallets") as pool:
                future = pool.submit(self._rested, rows)
                meanwhile()
        finally:
            self.placing = False
        return future.result()

    def _put(self, placements: Placements, at: NDArray[np.int64]) -> None:
        """Put boxes into the worlds of their pallets, with the random errors with which the boxes were placed.

        Args:
            at: (m,) number of each box on its pallet.
        """
        worlds, boxes, strength = placements.pallet, self.next_boxes(placements), self._strength[placements.pallet, at]
        exact = np.flatnonzero(strength == 0)
        if len(exact):
            self.worlds.put_next(worlds[exact].tolist(), boxes.take(exact))
        if len(error_rows := np.flatnonzero(strength)):
            errors = placing_errors_of(self._sim)
            scenes = self.worlds.with_next(worlds[error_rows].tolist(), boxes.take(error_rows))
            numbers = self._error[worlds[error_rows], at[error_rows]].tolist()
            drawn = [errors.scene(*of) for of in zip(scenes, numbers, strength[error_rows].tolist(), strict=True)]
            self.worlds.put(worlds[error_rows].tolist(), drawn)

    def _rested(self, rows: NDArray[np.int64]) -> PlacementResults:
        if len(rows):
            self.worlds.go_on()
        snapshots = self.worlds.snapshots(rows.tolist())
        outcomes = PlacementResults.of_snapshots(rows, snapshots, self._sim.thresholds)
        self.dead[rows] = outcomes.ended
        rests = outcomes.stable & ~outcomes.moving & self._decidable & ~(self._strength[rows] > 0).any(axis=1)
        self.margin[rows] = np.where(rests, outcomes.margin, -1.0)
        apart = boxes_apart_mm(snapshots, self._sim.thresholds)
        self.apart_mm[rows, : apart.shape[1]] = apart
        return outcomes

    def decided(self, placements: Placements) -> NDArray[np.int8]:
        """(m,) the decision of the bounds about each placement, as returned by ``Bounds.of``."""
        return self.bounds.of(placements, self.margin, self.apart_mm)

    def has_errors(self, pallet: int) -> bool:
        """Whether any box of a pallet was placed with an error."""
        return bool(self._strength[pallet, : self.boxes.count[pallet]].any())

    def take_back(self, rows: NDArray[np.int64]) -> None:
        """Remove the last box from each given pallet. Each of them must have a box."""
        left = self.boxes.count[rows] - 1
        has_before = self._before[rows] == left
        if has_before.any():
            self.worlds.fork((self._n + rows[has_before]).tolist(), rows[has_before].tolist())
        self._cut(rows, left)
        self.dead[rows], self.margin[rows], self._before[rows] = False, -1.0, -1
        if not has_before.all():
            self._build(rows[~has_before])

    def fork(self, sources: NDArray[np.int64], into: NDArray[np.int64]) -> None:
        """Copy the states of the pallets ``sources`` to the pallets ``into``."""
        these, copies = ([*rows.tolist(), *(self._n + rows).tolist()] for rows in (sources, into))
        self.worlds.fork(these, copies)
        self.boxes.copy(sources, into)
        self.bounds.cut(into, np.zeros(len(into), np.int64))
        for values in (self._before, self.dead, self.margin, self.apart_mm, self._error, self._strength):
            values[into] = values[sources]

    def empty(self, rows: NDArray[np.int64]) -> None:
        """Remove all boxes from the given pallets."""
        self._empty_worlds(rows)
        self._cut(rows, np.zeros(len(rows), np.int64))
        self.margin[rows] = self._bare

    def _cut(self, rows: NDArray[np.int64], count: NDArray[np.int64]) -> None:
        self.boxes.cut(rows, count)
        self.bounds.cut(rows, count)
        left = np.arange(self._strength.shape[1]) < count[:, None]
        for values in (self._strength, self.apart_mm):
            values[rows] = np.where(left, values[rows], 0.0)

    def _empty_worlds(self, rows: NDArray[np.int64]) -> None:
        self.worlds.fork([2 * self._n] * len(rows), rows.tolist())
        self.dead[rows], self._before[rows] = False, -1

    def _build(self, rows: NDArray[np.int64]) -> None:
        """Simulate the placement of all boxes of the given pallets again, one box after another."""
        self._empty_worlds(rows)
        for number in range(int(self.boxes.count[rows].max(initial=0))):
            grown_rows = rows[self.boxes.count[rows] > number]
            self._put(self.boxes.box(grown_rows, number), np.full(len(grown_rows), number))
            self.worlds.go_on()
