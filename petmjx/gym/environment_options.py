"""The options of the environment ``petmjx/Palletizing-v0``: their meanings, defaults and checks."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Final, Self

from petmjx.analysis.criteria import SUPPORT_CRITERIA
from petmjx.common.argument_checks import flag_of, integer_of, number_of
from petmjx.common.checked_records import hint, shown_value
from petmjx.common.errors import InputError
from petmjx.loop.candidate_places import LARGEST_GAP_MM
from petmjx.loop.episode_orders import ENDLESS, Orders, order_reading

CELLS: Final = "cells"
CANDIDATES: Final = "candidates"
PHYSICS: Final = "physics"
SURE: Final = "sure"
LOADS: Final = "loads"
GEOMETRY: Final = "geometry"
CENTRE: Final = "centre"
OF_ORDER: Final = "order"
ALL: Final = "all"
MOST_OPEN: Final = 64
"""Largest number of pallets in an episode. A robot cannot reach more pallets."""
MOST_ERRORS: Final = 10.0
"""Largest value of the option ``errors``, which is a multiple of a common robot's placement errors. The largest value
gives errors of 20 mm. With larger errors, a box would no longer stand at its intended place."""
MASKS: Final = (GEOMETRY, *SUPPORT_CRITERIA, CENTRE, SURE, PHYSICS, LOADS)


@dataclass(frozen=True)
class PalletizingOptions:
    """Options of ``petmjx/Palletizing-v0``. Besides these options, the environment has the options of
    ``petmjx.Pallets``.

    Attributes:
        orders: source of the orders, which are lists of boxes to pack (``petmjx.loop.episode_orders.Orders``).
        orders_seed: seed of the generator of random orders.
        orders_units, orders_columns, orders_density: how to read a file of orders that is not in BED-BPP's form, as in
            the fields of ``petmjx.RunOptions``. If ``orders_units``, ``orders_columns`` or ``orders_density`` is None,
            the most plausible value is used.
        articles: a table of articles (docs/loads.md), from which the strengths of boxes are read.
        look_ahead: number of boxes that are visible in an observation. The value 1 means online packing. A value as
            large as the order means offline packing.
        buffer: number of boxes from which an action may choose. The boxes of the buffer are the first of the visible
            boxes.
        actions: if ``candidates``, an action selects a place from a list of places with features. If ``cells``, an
            action selects a box, an orientation and a cell of the carrier.
        n_candidates: largest number of places in the list. The list begins with the lowest place of each box, then has
            the second-lowest place of each box, and so on. The list has at least one place for each box of the buffer.
        action_cell_mm: side of the cells of actions, mm.
        cell_mm: side of the cells of observed maps, mm.
        mask: which actions are legal, among those that keep the box on the carrier and below ``max_height_mm``.
            ``geometry``: no other condition must hold. The name of a criterion of
            docs/criteria.md (``support_75``, … or ``centre``): actions that fulfil the criterion. ``physics``: actions
            after which the pallet stands in a trial, which is a simulation on a copy of the pallet. ``sure``: actions
            after which the pallet stands according to bounds (``petmjx.loop.placement_bounds``), so that no trial is
            needed. ``loads``: actions after which the pallet stands in a trial and no box is overloaded.
        max_height_mm: largest allowed height of a box's top, mm.
        gap_mm: free space that a robot needs between a box and its neighbours along x and y, mm.
        rewards: weights of the terms of the reward (``petmjx.loop.rewards.TERMS``).
        most_illegal: number of illegal actions after which an episode is truncated.
        scaled: whether observations are scaled to the range from 0 to 1 (``petmjx.gym.observation_spaces``).
        sides: on which of their sides boxes may stand. ``order``: the sides that the order allows, or only the base if
            the order states no sides. ``all``: all sides.
        open_pallets: number of pallets of an episode. An action may put the next box on any pallet of its episode.
        errors: size of the random placement errors, as a multiple of the errors of ``petmjx score --confidence``.
        curriculum: properties of episodes that depend on their level of difficulty
            (``petmjx.gym.curriculum.Curriculum``).
        level: the level of difficulty of episodes, from 0 to 1. ``reset(options={"level": …})`` changes the level.
    """

    orders: Any = ENDLESS
    orders_seed: int = 0
    orders_units: str | None = None
    orders_columns: Any = None
    orders_density: float | None = None
    articles: Any = None
    look_ahead: int = 1
    buffer: int = 1
    actions: str = CANDIDATES
    n_candidates: int = 32
    action_cell_mm: float = 100.0
    cell_mm: float = 50.0
    mask: str = "support_75"
    max_height_mm: float = 1800.0
    gap_mm: float = 0.0
    rewards: Any = None
    most_illegal: int = 20
    scaled: bool = False
    sides: str = OF_ORDER
    open_pallets: int = 1
    errors: float = 0.0
    curriculum: Any = None
    level: float = 1.0

    @classmethod
    def of(cls, arguments: dict[str, Any]) -> tuple[Self, dict[str, Any]]:
        """Split ``arguments`` into options of ``PalletizingOptions`` and all remaining entries.

        Raises:
            InputError: a value is unusable.
        """
        names = {field.name for field in fields(cls)}
        options = cls(**{name: value for name, value in arguments.items() if name in names})
        for name, least, most in (
            ("orders_seed", 0, None),
            ("look_ahead", 1, 512),
            ("buffer", 1, 512),
            ("n_candidates", 1, 100_000),
            ("most_illegal", 1, None),
            ("open_pallets", 1, MOST_OPEN),
        ):
            integer_of(getattr(options, name), name, least, most)
        number_of(options.max_height_mm, "max_height_mm", 1.0, 20_000.0)
        number_of(options.action_cell_mm, "action_cell_mm", 10.0, 20_000.0)
        number_of(options.gap_mm, "gap_mm", 0.0, LARGEST_GAP_MM)
        number_of(options.errors, "errors", 0.0, MOST_ERRORS)
        number_of(options.level, "level", 0.0, 1.0)
        flag_of(options.scaled, "scaled")
        for name, choices in (("actions", (CANDIDATES, CELLS)), ("mask", MASKS), ("sides", (OF_ORDER, ALL))):
            value = getattr(options, name)
            if not isinstance(value, str):
                raise InputError(f"{name} must be text, {shown_value(value)}")
            if value not in choices:
                raise InputError(f"unknown {name} {value!r}; {hint(value, choices)}")
        if options.buffer > options.look_ahead:
            raise InputError(f"buffer must be at most look_ahead, {options.look_ahead}, got {options.buffer}")
        return options, {name: value for name, value in arguments.items() if name not in names}

    def read_orders(self) -> Orders:
        """Read the orders.

        Raises:
            InputError: the orders cannot be read, or the mask is ``loads`` and the orders' boxes have no strengths.
        """
        reading = order_reading(self.orders_units, self.orders_columns, self.orders_density)
        orders = Orders(self.orders, self.orders_seed, self.articles, reading)
        if self.mask == LOADS and not orders.have_strengths:
            raise InputError(
                f"mask: '{LOADS}' needs the strengths of boxes; give orders the column strength_n, or pass articles"
            )
        return orders
