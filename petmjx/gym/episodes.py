"""The class ``Episodes``: the states and the steps of n episodes that run side by side. All environments are built on
this class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.argument_checks import number_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.gym.actions import Actions, Table, features_of, ranks
from petmjx.gym.curriculum import Curriculum
from petmjx.gym.environment_options import PalletizingOptions
from petmjx.gym.item_queues import Queues, parts_of
from petmjx.gym.observation_maps import Maps
from petmjx.gym.observation_spaces import Observation, ObservationSpaces, Space
from petmjx.loop.candidate_trials import MOST_ERRORS_DRAWN
from petmjx.loop.height_maps import cells_of
from petmjx.loop.pallets import Pallets
from petmjx.loop.placement_results import PlacementResults
from petmjx.loop.rewards import TERMS, Placement, weights_of

_MOST_ORDERS: Final = 100
"""Largest number of orders that are drawn for one episode. If no box of the drawn order fits on the empty carrier,
another order is drawn."""

_MOST_KINDS: Final = 16
"""Largest number of kinds of boxes (boxes with equal size and mass) that one call examines for each episode, in the
search for a box with a legal action."""

PICTURE: Final = (480, 480)
"""Width and height of a pallet's picture, in pixels."""


@dataclass(frozen=True, eq=False)
class EpisodeStep:
    """The results of one step of m episodes.

    Attributes:
        reward: (m,) reward of each episode, which is the weighted sum of the terms.
        terms: name of each term of the reward → its values (m,) without the weight.
        terminated, truncated: (m,) whether each episode was terminated or truncated, as Gymnasium defines these words.
    """

    reward: FloatArray
    terms: dict[str, FloatArray]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class Episodes:
    """n episodes that run side by side. Each episode has one or several pallets.

    Args:
        options: options of ``PalletizingOptions`` and arguments of ``petmjx.Pallets``.

    Raises:
        InputError: an option is unusable.
    """

    def __init__(self, n: int, options: dict[str, Any]) -> None:
        self.options, of_pallets = PalletizingOptions.of(options)
        self.weights = weights_of(self.options.rewards)
        self.orders = self.options.read_orders()
        self.curriculum = Curriculum.of(self.options)
        self._several = self.options.open_pallets
        self.pallets = Pallets(n * self._several, **of_pallets)
        self.orders.check_sizes(self.pallets.simulation.size_reduction_mm)
        self.n = n
        self.level: FloatArray = np.full(n, float(self.options.level))
        self._errors: FloatArray = np.zeros(n)
        self.cells = cells_of(self.pallets.extent_mm, self.options.cell_mm)
        self._actions = Actions(self.pallets, self.options, self.orders)
        self.n_actions = self._actions.count
        self.table = Table.empty(n, self.n_actions)
        self._queues = Queues(n, self.options.look_ahead)
        self._features = features_of(self.options, self.orders)
        self._spaces = ObservationSpaces(self.options, self.pallets, self.cells, self.n_actions, self._features)
        self._maps = Maps(self.pallets.n, self.cells, self.options.cell_mm)
        self._mass: FloatArray = np.zeros((n, self._several))
        self._volume: FloatArray = np.zeros(n)
        self._top: FloatArray = np.zeros(self.pallets.n)
        self._illegal = np.zeros(n, np.int64)
        self._verdict = np.full(n, "stable", dtype="<U8")
        self._reason, self._culprit = np.full(n, "", dtype="<U16"), np.full(n, -1)
        self._margin = np.ones(n)
        self._rngs: list[np.random.Generator | None] = [None] * n

    # ------------------------------------------------------------------ events

    def begin(self, rows: NDArray[np.int64], rngs: Sequence[np.random.Generator]) -> None:
        """Begin new episodes in the given rows. The order of each episode is drawn with the episode's own random
        generator.

        Raises:
            InputError: no box of the orders fits on the empty carrier.
        """
        if not len(rows):
            return
        on = self._pallets_of(rows).ravel()
        self.pallets.reset(on)
        self._actions.strength_n[on], self._top[on] = np.nan, 0
        self._maps.clear(on)
        for values in (self._mass, self._volume, self._illegal):
            values[rows] = 0
        self._errors[rows] = self.curriculum.error_strength(self.level[rows])
        self._verdict[rows], self._reason[rows], self._culprit[rows], self._margin[rows] = "stable", "", -1, 1.0
        left, by_row = rows, dict(zip(rows.tolist(), rngs, strict=True))
        for row, rng in by_row.items():
            self._rngs[row] = rng
        for _ in range(_MOST_ORDERS):
            for row in left.tolist():
                order = self.orders.draw(by_row[row])
                self._queues.begin(row, self.curriculum.order(order, float(self.level[row])))
            self._look(left)
            left = left[~self.table.legal[left].any(axis=1)]
            if not len(left):
                return
        raise InputError(
            f"orders: none of {_MOST_ORDERS} drawn orders has a box with a legal place on the empty carrier; check "
            f"max_height_mm ({self.options.max_height_mm:g}), carrier and mask"
        )

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.int64]) -> EpisodeStep:
        """Carry out one action in each given episode. The episodes must be running."""
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
            self.table.clear(rows[self._are_full(rows)])
        terminated |= ~self.table.legal[rows].any(axis=1)
        truncated = ~terminated & (self._illegal[rows] >= self.options.most_illegal)
        reward = np.sum([self.weights[name] * values for name, values in terms.items()], axis=0) + np.zeros(m)
        return EpisodeStep(reward, terms, terminated, truncated)

    def _place(
        self, rows: NDArray[np.int64], actions: NDArray[np.int64]
    ) -> tuple[PlacementResults, dict[str, FloatArray]]:
        table, at = self.table, (rows, actions)
        size, corner, mass, box = table.size_mm[at], table.corner_mm[at], table.mass_kg[at], table.box[at]
        pallet = table.pallet[at]
        on = rows * self._several + pallet
        last = self.pallets.n_boxes[on]
        queues: list[NDArray[Any]] = []

        def go_on() -> None:  # updates of the packing need only the places of boxes, not the results of the simulation
            self._actions.strength_n[on, last] = self._queues.take(rows, box)
            self._maps.add(on, last, size, corner)
            queues.extend(self._queues.kept(rows))
            if not self._actions.asks_physics:
                self._look(rows[~self._are_full(rows)])

        report = self.pallets.place(
            size_mm=size, corner_mm=corner, mass_kg=mass, pallet=on, meanwhile=go_on, **self._drawn_errors(rows)
        )
        if self._actions.asks_physics:
            self._look(rows[report.stable & ~self._are_full(rows)])
        # where a pallet has fallen, the queue gets back the state that it had before ``go_on`` left out boxes
        fallen = ~report.stable
        self._queues.restore(rows[fallen], [values[fallen] for values in queues])
        volume, top = size.prod(axis=1), corner[:, 2] + size[:, 2]
        higher = np.maximum(top - self._top[on], 0.0)
        self._top[on] += higher
        self._mass[rows, pallet] += mass
        self._volume[rows] += volume * report.stable
        self._maps.load(on, report.top_force_n)
        self._verdict[rows], self._reason[rows] = report.verdict, report.reason
        self._culprit[rows], self._margin[rows] = report.culprit, np.nan_to_num(report.margin, nan=-1.0)
        placement = Placement(
            report, volume, self._mass[rows, pallet], self._room_mm3, higher, self.options.max_height_mm
        )
        return report, {name: value(placement) for name, (_, value) in TERMS.items() if name in self.weights}

    @property
    def _room_mm3(self) -> float:
        x, y = self.pallets.extent_mm
        return x * y * self.options.max_height_mm * self._several

    def _pallets_of(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """(m, p) the numbers of the p pallets of each episode."""
        pallets: NDArray[np.int64] = rows[:, None] * self._several + np.arange(self._several)
        return pallets

    def _are_full(self, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(m,) for each episode, whether all its pallets have the largest allowed number of boxes."""
        full: NDArray[np.bool_] = self.pallets.n_boxes[self._pallets_of(rows)].min(axis=1) >= self.pallets.most_boxes
        return full

    def _drawn_errors(self, rows: NDArray[np.int64]) -> dict[str, Any]:
        """Draw random placement errors for the next boxes, in the form of arguments of ``Pallets.place``. If the
        environment has no placement errors, the result is empty."""
        if not self._errors[rows].any():
            return {}
        rngs = [self._rngs[row] for row in rows.tolist()]
        numbers = [0 if rng is None else int(rng.integers(MOST_ERRORS_DRAWN)) for rng in rngs]
        return {"error": np.array(numbers, np.int64), "error_strength": self._errors[rows]}

    def _look(self, rows: NDArray[np.int64]) -> None:
        """Find the legal actions of the given episodes. If an episode has no legal action, the boxes from which it may
        choose are left out, and the search is repeated with the boxes that follow."""
        while len(rows):
            self._actions.fill(self.table, rows, *self._queues.seen(rows))
            stuck = rows[~self.table.legal[rows].any(axis=1)]
            rows = stuck[self._queues.counts[stuck] > 0]
            if self.options.buffer == 1:
                self._look_ahead(rows)
                return
            self._queues.leave_out(rows, self.options.buffer)

    def _look_ahead(self, rows: NDArray[np.int64]) -> None:
        """Find the first box that has a legal action, among the boxes after the next box, and leave out all boxes
        before it. Of each kind of box (equal size and mass), only one box is examined, because boxes of a kind have the
        same legal actions. Several kinds are examined in one call, and their number grows from call to call, because
        even a call for few boxes takes time."""
        if not len(rows):
            return
        of, position, boxes = self._queues.kinds(rows)
        number = ranks(of)
        is_open = np.ones(len(rows), bool)
        begin = most = 1  # kind 0 is the kind of the next box, which is known to have no legal action
        while is_open.any():
            searched = np.flatnonzero(is_open[of] & (begin <= number) & (number < begin + most))
            table = Table.empty(len(searched), self.n_actions)
            if len(searched):
                some = parts_of(boxes[searched, None])
                self._actions.fill(table, np.arange(len(searched)), *some, rows[of[searched]])
            # the first row of the table with a legal action, for each episode that has such a row
            sources = np.flatnonzero(table.legal.any(axis=1))
            into, of_first = np.unique(of[searched[sources]], return_index=True)
            sources = sources[of_first]
            self.table.copy(rows[into], table, sources)
            self._queues.leave_out(rows[into], position[searched[sources]])
            is_exhausted = is_open.copy()
            is_exhausted[of[searched]] = False
            exhausted = rows[is_exhausted]
            self._queues.leave_out(exhausted, self._queues.counts[exhausted])
            is_open[into], is_open[is_exhausted] = False, False
            begin, most = begin + most, min(2 * most, _MOST_KINDS)

    # ------------------------------------------------------------------ observations

    def observed(self, rows: NDArray[np.int64]) -> Observation:
        """The observations of m episodes, as arrays of m rows."""
        size, mass, _ = self._queues.seen(rows)
        on = rows if self._several == 1 else self._pallets_of(rows)
        observation: Observation = {
            "height_map": self._maps.heights[on],
            "load_map": self._maps.loads[on],
            "boxes": np.concatenate([size, mass[..., None]], axis=2),
            "left": self._queues.counts[rows, None],
            "mass": self._mass[rows],
            "carrier": np.tile([*self.pallets.extent_mm, self.options.max_height_mm], (len(rows), 1)),
        }
        observation = {name: values.astype(np.float32, copy=False) for name, values in observation.items()}
        observation["action_mask"] = self.table.legal[rows].astype(np.int8)
        if self.options.actions == "candidates":
            observation["candidates"] = self.table.features(rows, self._features)
        return self._spaces.scaled(observation)

    def info_of(self, rows: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """The values of Gymnasium's ``info`` for the given episodes after a step."""
        return {
            "verdict": self._verdict[rows].astype(object),
            "reason": self._reason[rows].astype(object),
            "culprit": self._culprit[rows],
            "margin": self._margin[rows],
            "placed": self.pallets.n_boxes[self._pallets_of(rows)].sum(axis=1),
            "left_out": self._queues.left_out[rows],
            "utilisation": self._volume[rows] / self._room_mm3,
            "illegal": self._illegal[rows],
        }

    @property
    def spaces(self) -> dict[str, Space]:
        """The space (shape, bounds and type) of each part of an observation, by name."""
        return self._spaces.spaces

    def set_level(self, rows: NDArray[np.int64], level: Any) -> None:
        """Set the level of difficulty of some environments, from their next episodes on. The level is one number, or an
        array (m,) with a number for each environment.

        Raises:
            InputError: a level is not from 0 to 1, the number of levels is neither 1 nor m, or the environment has no
                curriculum.
        """
        values = np.atleast_1d(np.asarray(level, object))
        if values.shape not in ((1,), (len(rows),)):
            raise InputError(f"level must be a number from 0 to 1, or {len(rows)} of them, {shown_value(level)}")
        levels = [number_of(value, "level", 0.0, 1.0) for value in values.tolist()]
        if self.options.curriculum is None:
            raise InputError(
                "level: the environment has no curriculum, so its episodes are the same at all levels; leave level out"
            )
        self.level[rows] = levels

    def picture(self, row: int) -> NDArray[np.uint8]:
        """A picture of an episode's pallets, side by side."""
        pictures = [self.pallets.show(int(pallet), size=PICTURE) for pallet in self._pallets_of(np.array([row]))[0]]
        return np.concatenate(pictures, axis=1)
