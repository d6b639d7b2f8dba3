"""n episodes side by side: their states, and the steps that placements make. Environments wrap this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.gym.actions import FEATURES, Actions, Table
from petmjx.gym.environment_options import PalletizingOptions
from petmjx.gym.item_queues import Queues
from petmjx.gym.observation_maps import Maps
from petmjx.loop.height_maps import cells_of
from petmjx.loop.pallets import Pallets
from petmjx.loop.placement_results import PlacementResults
from petmjx.loop.rewards import TERMS, Placement
from petmjx.plans.plan_fields import LARGEST_KG, LARGEST_MM

_MOST_ORDERS: Final = 100
"""Most orders that are drawn until one has a box that fits on the empty carrier."""

Observation = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class EpisodeStep:
    """The results of a step of m episodes.

    Attributes:
        reward: (m,); ``terms``: its terms, (m,) each, not weighted.
        terminated, truncated: (m,).
    """

    reward: FloatArray
    terms: dict[str, FloatArray]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class Episodes:
    """n episodes, one a pallet.

    Args:
        given: options of ``PalletizingOptions`` and of ``petmjx.Pallets``.

    Raises:
        InputError: an unusable option.
    """

    def __init__(self, n: int, options: dict[str, Any]) -> None:
        self.options, of_pallets = PalletizingOptions.of(options)
        self.weights = self.options.weights
        self.orders = self.options.read_orders()
        self.pallets = Pallets(n, **of_pallets)
        self.n = n
        self.cells = cells_of(self.pallets.extent_mm, self.options.cell_mm)
        self._actions = Actions(self.pallets, self.options)
        self.n_actions = self._actions.count
        self.table = Table.empty(n, self.n_actions)
        self._queues = Queues(n, self.options.look_ahead)
        self._maps = Maps(n, self.cells, self.options.cell_mm)
        self._mass: FloatArray = np.zeros(n)
        self._volume: FloatArray = np.zeros(n)
        self._top: FloatArray = np.zeros(n)
        self._illegal = np.zeros(n, np.int64)
        self._verdict = np.full(n, "stable", dtype="<U8")
        self._reason, self._culprit = np.full(n, "", dtype="<U16"), np.full(n, -1)
        self._margin = np.ones(n)

    # ------------------------------------------------------------------ what happens

    def begin(self, rows: NDArray[np.int64], rngs: Sequence[np.random.Generator]) -> None:
        """Begin episodes anew, each with an order drawn by its own random generator.

        Raises:
            InputError: no box of the orders has a place on the empty carrier.
        """
        if not len(rows):
            return
        self.pallets.reset(rows)
        self._actions.strength_n[rows] = np.nan
        self._maps.clear(rows)
        for values in (self._mass, self._volume, self._top, self._illegal):
            values[rows] = 0
        self._verdict[rows], self._reason[rows], self._culprit[rows], self._margin[rows] = "stable", "", -1, 1.0
        left, by_row = rows, dict(zip(rows.tolist(), rngs, strict=True))
        for _ in range(_MOST_ORDERS):
            for row in left.tolist():
                self._queues.begin(row, self.orders.draw(by_row[row]))
            self._look(left)
            left = left[~self.table.legal[left].any(axis=1)]
            if not len(left):
                return
        raise InputError(f"orders: in {_MOST_ORDERS} orders no box has a legal place on the empty carrier")

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.int64]) -> EpisodeStep:
        """Place a box in each of these running episodes."""
        m = len(rows)
        legal = self.table.legal[rows, actions]
        terms: dict[str, FloatArray] = {name: np.zeros(m) for name in self.weights}
        if "illegal" in terms:
            terms["illegal"] = np.where(legal, 0.0, -1.0)
        self._illegal[rows] += ~legal
        terminated = np.zeros(m, bool)
        if legal.any():
            report, new_terms = self._place(rows[legal], actions[legal])
            for name in set(terms) - {"illegal"}:
                terms[name][legal] = new_terms[name]
            terminated[legal] = ~report.stable
            self.table.clear(rows[legal][~report.stable])
            full = self.pallets.n_boxes[rows] >= self.pallets.most_boxes
            self.table.clear(rows[full])
        terminated |= ~self.table.legal[rows].any(axis=1)
        truncated = ~terminated & (self._illegal[rows] >= self.options.most_illegal)
        reward = np.sum([self.weights[name] * values for name, values in terms.items()], axis=0) + np.zeros(m)
        return EpisodeStep(reward, terms, terminated, truncated)

    def _place(
        self, rows: NDArray[np.int64], actions: NDArray[np.int64]
    ) -> tuple[PlacementResults, dict[str, FloatArray]]:
        table, at = self.table, (rows, actions)
        size, corner, mass, box = table.size_mm[at], table.corner_mm[at], table.mass_kg[at], table.box[at]
        last = self.pallets.n_boxes[rows]
        queues: list[NDArray[Any]] = []

        def go_on() -> None:  # updates that depend only on where boxes were put
            self._actions.strength_n[rows, last] = self._queues.take(rows, box)
            self._maps.add(rows, last, size, corner)
            queues.extend(self._queues.kept(rows))
            if not self._actions.asks_physics:
                self._look(rows)

        report = self.pallets.place(size_mm=size, corner_mm=corner, mass_kg=mass, pallet=rows, meanwhile=go_on)
        if self._actions.asks_physics:
            self._look(rows[report.stable])
        fallen = ~report.stable  # an ended episode leaves out no further box
        self._queues.restore(rows[fallen], [values[fallen] for values in queues])
        volume, top = size.prod(axis=1), corner[:, 2] + size[:, 2]
        higher = np.maximum(top - self._top[rows], 0.0)
        self._top[rows] += higher
        self._mass[rows] += mass
        self._volume[rows] += volume * report.stable
        self._maps.load(rows, report.top_force_n)
        self._verdict[rows], self._reason[rows] = report.verdict, report.reason
        self._culprit[rows], self._margin[rows] = report.culprit, np.nan_to_num(report.margin, nan=-1.0)
        placement = Placement(report, volume, self._mass[rows], self._room_mm3, higher, self.options.max_height_mm)
        return report, {name: value(placement) for name, (_, value) in TERMS.items() if name in self.weights}

    @property
    def _room_mm3(self) -> float:
        x, y = self.pallets.extent_mm
        return x * y * self.options.max_height_mm

    def _look(self, rows: NDArray[np.int64]) -> None:
        """Find the actions of episodes. If an episode has none, the boxes that may come next are left out."""
        while len(rows):
            self._actions.fill(self.table, rows, *self._queues.seen(rows))
            stuck = rows[~self.table.legal[rows].any(axis=1)]
            rows = stuck[self._queues.counts[stuck] > 0]
            self._queues.leave_out(rows, self.options.buffer)

    # ------------------------------------------------------------------ what is seen

    def observed(self, rows: NDArray[np.int64]) -> Observation:
        """The observations of episodes, arrays of m rows."""
        size, mass = self._queues.seen(rows)
        observation: Observation = {
            "height_map": self._maps.heights[rows],
            "load_map": self._maps.loads[rows],
            "boxes": np.concatenate([size, mass[..., None]], axis=2),
            "left": self._queues.counts[rows, None],
            "mass": self._mass[rows, None],
            "carrier": np.tile([*self.pallets.extent_mm, self.options.max_height_mm], (len(rows), 1)),
        }
        observation = {name: values.astype(np.float32, copy=False) for name, values in observation.items()}
        observation["action_mask"] = self.table.legal[rows].astype(np.int8)
        if self.options.actions == "candidates":
            observation["candidates"] = self.table.features(rows)
        return observation

    def info_of(self, rows: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """The ``info`` values of episodes after a step."""
        return {
            "verdict": self._verdict[rows].astype(object),
            "reason": self._reason[rows].astype(object),
            "culprit": self._culprit[rows],
            "margin": self._margin[rows],
            "placed": self.pallets.n_boxes[rows],
            "left_out": self._queues.left_out[rows],
            "utilisation": self._volume[rows] / self._room_mm3,
            "illegal": self._illegal[rows],
        }

    @property
    def shapes(self) -> dict[str, tuple[tuple[int, ...], float, float, type[Any]]]:
        """Name of an observation → shape, least and largest value, type."""
        most, high = float(np.finfo(np.float32).max), self.options.max_height_mm
        spaces: dict[str, tuple[tuple[int, ...], float, float, type[Any]]] = {
            "height_map": (self.cells, 0.0, high + 1.0, np.float32),
            "load_map": (self.cells, 0.0, most, np.float32),
            "boxes": ((self.options.look_ahead, 4), 0.0, max(LARGEST_MM, LARGEST_KG), np.float32),
            "left": ((1,), 0.0, most, np.float32),
            "mass": ((1,), 0.0, most, np.float32),
            "carrier": ((3,), 0.0, 20_000.0, np.float32),
            "action_mask": ((self.n_actions,), 0, 1, np.int8),
        }
        if self.options.actions == "candidates":
            spaces["candidates"] = ((self.n_actions, len(FEATURES)), -most, most, np.float32)
        return spaces
