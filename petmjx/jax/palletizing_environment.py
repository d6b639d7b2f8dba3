"""``petmjx.jax.Palletizing``: a reinforcement learning environment of pure functions, for ``jax.jit``, ``jax.vmap`` and
``jax.lax.scan``."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from petmjx.analysis.criteria import SUPPORT_CRITERIA
from petmjx.common.argument_checks import integer_of, number_of, text_of
from petmjx.common.checked_records import hint, shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import MM_PER_M, STANDARD_GRAVITY
from petmjx.jax.extreme_places import Candidates
from petmjx.jax.free_cells import Cells, Pile, Ways
from petmjx.jax.pallet_functions import State as Pallet
from petmjx.jax.pallet_functions import empty, place
from petmjx.jax.placement_arrays import PlacementArrays
from petmjx.jax.timestep_and_specs import Spec, StepType, TimeStep
from petmjx.loop.candidate_places import LARGEST_GAP_MM
from petmjx.loop.episode_orders import ENDLESS, Boxes, Orders, order_reading
from petmjx.loop.height_maps import cells_of
from petmjx.loop.rewards import weights_of
from petmjx.options.carriers import AnyCarrier, extent_m
from petmjx.options.run_options import AUTO
from petmjx.options.simulation import Simulation

GEOMETRY: Final = "geometry"
MASKS: Final = {GEOMETRY: None, **SUPPORT_CRITERIA}
"""Name of a mask of legal actions → smallest share of a box's base that must be supported. The value is None if any
share is sufficient."""

CELLS: Final = "cells"
CANDIDATES: Final = "candidates"
ACTIONS: Final = (CELLS, CANDIDATES)
MOST_CANDIDATES: Final = 512

_DRAWN: Final = 256
"""Number of orders that are taken from an endless source of orders. All orders are stored in arrays of fixed size, so
their number must be finite."""

_EDGE: Final = 1e-4
"""Tolerance for rounding errors of single precision, as a share of a cell's side. A box that ends closer to the edge of
a cell than this tolerance counts as ending at the edge."""

_LARGEST: Final = float(np.finfo(np.float32).max)


class Observation(NamedTuple):
    """The observation of a pallet.

    Attributes:
        height_map: height of the highest top of a box over each cell of the carrier, mm.
        load_map: largest force on the top of a box over each cell, N.
        boxes: length, width and height, mm, and mass, kg, of the next boxes; 0 after the last box.
        left: number of remaining boxes.
        mass: total mass of the boxes on the pallet, kg.
        action_mask: (a,) whether each action is legal.
        candidates: (a, f) features of the candidates (``Palletizing.features`` has their names); 0 for illegal actions.
    """

    height_map: Float[Array, "x y"]
    load_map: Float[Array, "x y"]
    boxes: Float[Array, "seen 4"]
    left: Int[Array, ""]
    mass: Float[Array, ""]
    action_mask: Bool[Array, " action"]
    candidates: Float[Array, "action feature"]


class State(NamedTuple):
    """The state of an episode. ``order`` is the number of the episode's order (its list of boxes), and ``next`` is the
    number of the next box in this order. ``size_mm``, ``corner_mm``, ``mass_kg`` and ``force_n`` describe the boxes on
    the pallet at their requested places, and are 0 after the last box. ``ways`` has the actions for the next box.
    ``statics`` is the balance of the pile, or None if actions are cells."""

    key: jax.Array
    pallet: Pallet
    order: Int[Array, ""]
    next: Int[Array, ""]
    size_mm: Float[Array, "box 3"]
    corner_mm: Float[Array, "box 3"]
    mass_kg: Float[Array, " box"]
    force_n: Float[Array, " box"]
    volume_mm3: Float[Array, ""]
    placed: Int[Array, ""]
    left_out: Int[Array, ""]
    illegal: Int[Array, ""]
    over: Bool[Array, ""]
    ways: Ways
    statics: Any

    @property
    def mask(self) -> Bool[Array, " action"]:
        """Whether each action is legal."""
        return self.ways.legal


class Palletizing:
    """An environment with one pallet, on which each step places one box, as in ``petmjx/Palletizing-v0``.

    ``state, timestep = env.reset(key)`` begins an episode, and ``state, timestep = env.step(state, action)`` carries
    out an action. The functions ``reset`` and ``step`` are pure. Methods and classes have the same names as in the
    library jumanji, which need not be installed. Under ``jax.vmap``, all pallets are simulated in one call.

    Args:
        orders: as in ``petmjx/Palletizing-v0``, except that ``endless`` means 256 orders from the generator of random
            orders.
        orders_seed: seed of the generator.
        look_ahead: number of visible boxes.
        orders_units, orders_columns, orders_density: as in ``petmjx/Palletizing-v0``.
        actions: if ``cells``, an action selects one of two orientations and a cell of the carrier. If ``candidates``,
            an action selects one of ``n_candidates`` places, which have features. The candidate places are at extreme
            points (points at which a box touches other boxes or the carrier's edges), as seen from all four corners of
            the carrier. Low and well supported places come first.
        mask: which actions are legal. With ``geometry``, all actions that keep the box on the carrier and below
            ``max_height_mm`` are legal. With ``support_50`` … ``support_100``, at least 50 % … 100 % of the box's base
            must also be supported.
        gap_mm: free space that a robot needs between a box and its neighbours along x and y.
        inside_mm: only for ``candidates``: how far inside the convex hull of its contacts the load of a box must act,
            mm. A fifth of the shorter side of the box's base is always enough. If ``inside_mm`` is 0, loads may act
            anywhere. The packer ``balanced`` uses 20 mm.
        action_cell_mm, cell_mm: side of the cells of actions, and side of the cells of observed maps.
        rewards: weights of the terms of the reward.
        most_illegal: number of illegal actions after which an episode is truncated; an illegal action changes nothing.
        most_boxes: largest number of boxes on a pallet.
        carrier, engine: as in ``petmjx.jax.empty``.
        options: fields of ``petmjx.Simulation``.

    Raises:
        InputError: an option is unusable, or no box of any order fits on the carrier.
    """

    def __init__(
        self,
        *,
        orders: Any = ENDLESS,
        orders_seed: int = 0,
        orders_units: str | None = None,
        orders_columns: Any = None,
        orders_density: float | None = None,
        look_ahead: int = 1,
        actions: str = CELLS,
        n_candidates: int = 32,
        mask: str = "support_75",
        gap_mm: float = 0.0,
        inside_mm: float = 0.0,
        action_cell_mm: float = 100.0,
        cell_mm: float = 50.0,
        max_height_mm: float = 1800.0,
        rewards: Any = None,
        most_illegal: int = 20,
        most_boxes: int = 40,
        carrier: AnyCarrier | str = "euro-pallet",
        engine: str | Any = AUTO,
        **options: Any,
    ) -> None:
        for name, value, choices in (("mask", mask, MASKS), ("actions", actions, ACTIONS)):
            if text_of(value, name) not in choices:
                raise InputError(f"unknown {name} {value!r}; {hint(value, choices)}")
        self._seen = integer_of(look_ahead, "look_ahead", 1, 512)
        self._most_illegal, self._most_boxes = integer_of(most_illegal, "most_illegal", 1), most_boxes
        self._highest = number_of(max_height_mm, "max_height_mm", 1.0, 20_000.0)
        side = number_of(action_cell_mm, "action_cell_mm", 10.0, 20_000.0)
        self._weights = weights_of(rewards)
        self._empty = empty(1, carrier=carrier, engine=engine, most_boxes=most_boxes, **options)
        sim = Simulation(**{"carrier": carrier, **options})
        extent = extent_m(sim.carrier)
        assert extent is not None  # None means a carrier as large as the plan, which ``empty`` refuses
        self._extent = extent[0] * MM_PER_M, extent[1] * MM_PER_M
        gap, inside = (
            number_of(value, name, 0.0, LARGEST_GAP_MM)
            for name, value in (("gap_mm", gap_mm), ("inside_mm", inside_mm))
        )
        self._actions: Cells | Candidates = Cells(self._extent, side, self._highest, MASKS[mask], gap)
        if actions == CANDIDATES:
            count = integer_of(n_candidates, "n_candidates", 1, MOST_CANDIDATES)
            self._actions = Candidates(self._extent, count, self._highest, MASKS[mask], gap, inside)
        elif inside:
            raise InputError("inside_mm needs actions='candidates'")
        self._maps, self._side = cells_of(self._extent, cell_mm), float(cell_mm)
        reading = order_reading(orders_units, orders_columns, orders_density)
        read = Orders(orders, integer_of(orders_seed, "orders_seed", 0), reading=reading)
        read.check_sizes(sim.size_reduction_mm)
        of_orders = self._usable(read)
        self._counts = jnp.array([len(boxes) for boxes in of_orders], jnp.int32)
        # each order gets rows of zeros after its last box: observations show these rows in place of boxes that do not
        # exist
        longest = int(self._counts.max()) + self._seen
        rows = [np.column_stack([boxes.size_mm, boxes.mass_kg]) for boxes in of_orders]
        # the largest value is computed here, because ``observation_spec`` needs it and may be called in a jitted
        # program
        self._largest = max(float(table.max(initial=0.0)) for table in rows)
        self._boxes = jnp.array([np.pad(table, ((0, longest - len(table)), (0, 0))) for table in rows], jnp.float32)

    def _usable(self, orders: Orders) -> list[Boxes]:
        """The orders that have at least one box that fits on the empty carrier. Orders without such a box are left
        out."""
        drawn_orders = orders.some(_DRAWN)
        ways = np.sort(self._extent)

        def fits(boxes: Boxes) -> bool:
            low = np.sort(boxes.size_mm[:, :2], axis=1) <= ways
            return bool((low.all(axis=1) & (boxes.size_mm[:, 2] <= self._highest)).any())

        usable = [boxes for boxes in drawn_orders if fits(boxes)]
        if not usable:
            raise InputError("orders: no box of any order fits on the empty carrier")
        return usable

    # ------------------------------------------------------------------ episodes

    def reset(self, key: jax.Array, order: Int[Array, ""] | int | None = None) -> tuple[State, TimeStep[Observation]]:
        """Begin an episode. The order is drawn with ``key``, unless ``order`` gives the number of the order, from 0 to
        ``num_orders`` - 1. (A number out of range selects the first or the last order.) The same key gives the same
        episode.

        Raises:
            InputError: the order is not a whole number.
        """
        number = None if order is None else _whole(order, "order")
        key, order_key = jax.random.split(key)
        k, none = self._most_boxes, jnp.int32(0)
        drawn = jax.random.randint(order_key, (), 0, self.num_orders)
        state = State(
            key=key,
            pallet=self._empty,
            order=drawn if number is None else jnp.clip(number.astype(jnp.int32), 0, self.num_orders - 1),
            next=none,
            size_mm=jnp.zeros((k, 3)),
            corner_mm=jnp.zeros((k, 3)),
            mass_kg=jnp.zeros(k),
            force_n=jnp.zeros(k),
            volume_mm3=jnp.float32(0.0),
            placed=none,
            left_out=none,
            illegal=none,
            over=jnp.array(False),
            ways=self._no_ways,
            statics=self._actions.no_boxes(k),
        )
        state = self._looked(state, most=1)
        extras = {**self._about(state), "reason": none, "culprit": jnp.int32(-1), "margin": jnp.float32(1.0)}
        extras |= {f"reward_{name}": jnp.float32(0.0) for name in self._weights}
        first = jnp.int8(StepType.FIRST)
        return state, TimeStep(first, jnp.float32(0.0), jnp.float32(1.0), self._observed(state), extras)

    def step(self, state: State, action: Int[Array, ""] | int) -> tuple[State, TimeStep[Observation]]:
        """Put the next box onto the pallet. An illegal action changes nothing, and neither does an action after the end
        of the episode. Raises InputError if the action is not a whole number."""
        chosen = _whole(action, "action")
        valid = (chosen >= 0) & (chosen < self.num_actions)
        at = jnp.clip(chosen, 0, self.num_actions - 1)
        legal = valid & state.mask[at] & ~state.over
        mass = self._boxes[state.order, state.next, 3]
        size, corner = state.ways.size_mm[at], state.ways.corner_mm[at]
        pallet, outcome = place(state.pallet, size[None], corner[None], mass[None], legal[None])
        outcome = jax.tree.map(lambda values: values[0], outcome)
        # the box of an illegal action gets a row beyond the end of the arrays, and JAX drops such a row
        row = jnp.where(legal, state.placed, self._most_boxes)
        after = state._replace(
            pallet=pallet,
            next=state.next + legal,
            size_mm=state.size_mm.at[row].set(size, mode="drop"),
            corner_mm=state.corner_mm.at[row].set(corner, mode="drop"),
            mass_kg=state.mass_kg.at[row].set(mass, mode="drop"),
            force_n=jnp.where(legal, outcome.top_force_n, state.force_n),
            volume_mm3=state.volume_mm3 + jnp.where(legal & outcome.stable, size.prod(), 0.0),
            placed=state.placed + legal,
            illegal=state.illegal + ~legal,
            statics=self._actions.put(state.statics, row, size, corner, mass, self._pile(state)),
        )
        after = after._replace(over=state.over | (legal & ~outcome.stable) | (after.placed >= self._most_boxes))
        after = self._looked(after)
        terminated = after.over | ~after.mask.any()
        truncated = ~terminated & (after.illegal >= self._most_illegal)
        after = after._replace(over=terminated | truncated)
        terms = self._terms(state, after, outcome, legal)
        reward = sum((self._weights[name] * value for name, value in terms.items()), start=jnp.float32(0.0))
        extras = {
            **self._about(after),
            "reason": jnp.where(legal, outcome.reason, 0),
            "culprit": jnp.where(legal, outcome.culprit, -1),
            "margin": jnp.where(legal, outcome.margin, 1.0),
            **{f"reward_{name}": value for name, value in terms.items()},
        }
        kind = jnp.where(after.over, StepType.LAST, StepType.MID).astype(jnp.int8)
        return after, TimeStep(kind, reward, jnp.where(terminated, 0.0, 1.0), self._observed(after), extras)

    @property
    def _no_ways(self) -> Ways:
        a = self.num_actions
        return Ways(jnp.zeros(a, bool), jnp.zeros((a, 3)), jnp.zeros((a, 3)), jnp.zeros((a, len(self.features))))

    def _looked(self, state: State, most: int | None = None) -> State:
        """The state with the actions for the next box. Boxes for which there is no legal place are left out.

        Args:
            most: largest number of boxes that the pallet can have at this moment, if this is known. With ``most``, the
                compiled program is smaller.
        """
        statics: Any = state.statics if most is None else self._actions.no_boxes(most)
        view: Any = self._actions.view(self._pile(state, most), statics)

        def goes_on(carry: tuple[State, jax.Array]) -> jax.Array:
            state, is_first = carry
            return is_first | ((state.next < self._counts[state.order]) & ~state.mask.any() & ~state.over)

        def look(carry: tuple[State, jax.Array]) -> tuple[State, jax.Array]:
            state, is_first = carry
            state = state._replace(next=state.next + ~is_first, left_out=state.left_out + ~is_first)
            box = self._boxes[state.order, state.next]
            ways = self._actions.ways(view, box[:3], box[3])
            return state._replace(ways=ways._replace(legal=ways.legal & ~state.over)), jnp.array(False)

        # the loop does not change ``pallet`` and ``statics``, so the loop's state does not have these two fields
        small = state._replace(pallet=None, statics=None)
        looked, _ = jax.lax.while_loop(goes_on, look, (small, jnp.array(True)))
        return looked._replace(pallet=state.pallet, statics=state.statics)

    def _pile(self, state: State, most: int | None = None) -> Pile:
        """The boxes on the pallet, as arrays of ``most`` rows, or, if ``most`` is None, of as many rows as the state
        has."""
        present = jnp.arange(self._most_boxes) < state.placed
        return Pile(*(values[:most] for values in (state.size_mm, state.corner_mm, present)))

    def _terms(self, before: State, after: State, outcome: PlacementArrays, legal: jax.Array) -> dict[str, jax.Array]:
        """The terms of the reward, without their weights, as in ``petmjx.loop.rewards.TERMS``."""
        stands = legal & outcome.stable
        tops = [(state.corner_mm + state.size_mm)[:, 2].max() for state in (before, after)]
        terms = {
            "placed": stands.astype(jnp.float32),
            "utilisation": (after.volume_mm3 - before.volume_mm3) / self._room_mm3,
            "fall": -(legal & ~outcome.stable).astype(jnp.float32),
            "margin": jnp.where(legal, jnp.clip(outcome.margin, -1.0, 1.0), 0.0),
            "load": jnp.where(
                legal, -outcome.top_force_n.max() / (STANDARD_GRAVITY * jnp.maximum(after.mass_kg.sum(), 1e-6)), 0.0
            ),
            "height": (tops[0] - tops[1]) / self._highest,
            "illegal": -(~legal).astype(jnp.float32),
        }
        return {name: terms[name] for name in self._weights}

    # ------------------------------------------------------------------ observations

    def _observed(self, state: State) -> Observation:
        covers = self._covers(state)
        tops = (state.corner_mm + state.size_mm)[:, 2, None, None]
        coming = jax.lax.dynamic_slice_in_dim(self._boxes[state.order], state.next, self._seen)
        return Observation(
            height_map=jnp.where(covers, tops, 0.0).max(axis=0),
            load_map=jnp.where(covers, state.force_n[:, None, None], 0.0).max(axis=0),
            boxes=coming,
            left=self._counts[state.order] - state.next,
            mass=state.mass_kg.sum(),
            action_mask=state.mask,
            candidates=jnp.where(state.mask[:, None], state.ways.features, 0.0),
        )

    def _covers(self, state: State) -> Bool[Array, "box x y"]:
        """Whether each box covers each cell by more than the tolerance ``_EDGE``."""
        low = jnp.floor(state.corner_mm / self._side + _EDGE)
        high = jnp.ceil((state.corner_mm + state.size_mm) / self._side - _EDGE)
        along = []
        for axis, count in enumerate(self._maps):
            cell = jnp.arange(count)[None]
            along.append((cell >= low[:, axis, None]) & (cell < high[:, axis, None]))
        covers: Bool[Array, "box x y"] = along[0][:, :, None] & along[1][:, None, :]
        return covers

    def _about(self, state: State) -> dict[str, jax.Array]:
        return {
            "placed": state.placed,
            "left_out": state.left_out,
            "illegal": state.illegal,
            "utilisation": state.volume_mm3 / self._room_mm3,
        }

    @property
    def _room_mm3(self) -> float:
        return self._extent[0] * self._extent[1] * self._highest

    # ------------------------------------------------------------------ specs

    @property
    def num_actions(self) -> int:
        """Number of actions, legal or not."""
        return self._actions.count

    @property
    def num_orders(self) -> int:
        """Number of orders that have a box that fits on the empty carrier."""
        return len(self._counts)

    @property
    def features(self) -> tuple[str, ...]:
        """The names of the features of candidates; empty if actions are cells."""
        return self._actions.features

    @property
    def action_spec(self) -> Spec:
        """The specification of an action. An action is a whole number: the number of a candidate, or (orientation ×
        number of cells along x + cell along x) × number of cells along y + cell along y."""
        return Spec("action", (), jnp.int32, 0, self.num_actions - 1, self.num_actions)

    @property
    def observation_spec(self) -> dict[str, Spec]:
        """The specification of each field of an observation."""
        longest = int(self._boxes.shape[1])
        specs = (
            Spec("height_map", self._maps, jnp.float32, 0.0, self._highest + 1.0),
            Spec("load_map", self._maps, jnp.float32, 0.0, _LARGEST),
            Spec("boxes", (self._seen, 4), jnp.float32, 0.0, self._largest),
            Spec("left", (), jnp.int32, 0, longest),
            Spec("mass", (), jnp.float32, 0.0, _LARGEST),
            Spec("action_mask", (self.num_actions,), jnp.bool_, 0, 1),
            Spec("candidates", (self.num_actions, len(self.features)), jnp.float32, -_LARGEST, _LARGEST),
        )
        return {spec.name: spec for spec in specs}

    @property
    def reward_spec(self) -> Spec:
        """The specification of a reward, which can be any number."""
        return Spec("reward", (), jnp.float32, -_LARGEST, _LARGEST)

    @property
    def discount_spec(self) -> Spec:
        """The specification of a discount, which is 0 or 1."""
        return Spec("discount", (), jnp.float32, 0.0, 1.0)


def _whole(value: Any, name: str) -> Int[Array, ""]:
    """The value as a JAX array, if it is a whole number. The value may be a traced value of a jitted program. Raises
    InputError for anything else."""
    is_numeric = isinstance(value, int | np.generic | np.ndarray | jax.Array)
    try:
        number = jnp.asarray(value) if is_numeric else None
    except (TypeError, OverflowError):
        number = None
    if number is None:
        raise InputError(f"{name} must be a whole number, {shown_value(value)}")
    if number.shape != () or not jnp.issubdtype(number.dtype, jnp.integer):
        raise InputError(f"{name} must be a whole number, got {number.dtype} of shape {number.shape}")
    return number
