"""Packing plans for files of other tools: packed by petmjx's packers, and converted to a tool's units and axes."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from petmjx.packers.balanced_packer import pack_balanced
from petmjx.packers.baseline_packer import PackRules, pack
from petmjx.plans.order_generator import draw_order, stream

SEED = 59
DECK_MM = (1200.0, 800.0)
CUBE_MM = (1000.0, 1000.0)
"""Length and width of the cubic bins in repositories of reinforcement learning, mm: 10 units of 100 mm, or 100 of 1
cm."""
HEIGHT_MM = 2000.0
CONTACT_MM = 0.06
"""Largest distance between faces that touch, mm. Numbers in files are rounded, at most to a thousandth of an inch
(0.025 mm)."""
MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "dm": 100.0}
KG = {"kg": 1.0, "g": 0.001, "lb": 0.45359237}
DECIMALS = {"mm": 1, "cm": 2, "m": 4, "in": 3, "dm": 0}
ANCHORS = {
    "corner": (0.0, 0.0, 0.0),
    "centre": (0.5, 0.5, 0.5),
    "base-centre": (0.5, 0.5, 0.0),
    "far-corner": (1, 1, 1),
}
ORIGINS = {"corner": (0.0, 0.0), "middle": (0.5, 0.5), "far": (1.0, 1.0), "right": (1.0, 0.0)}
"""Name of a point of the deck → place of this point, as shares of the deck's length and width."""


@dataclass(frozen=True, eq=False)
class Packing:
    """The right result: boxes in packing order, in the coordinates of the deck. Lengths in mm, masses in kg.

    Attributes:
        name: name of the pallet.
        size: (n, 3) sizes of the boxes as placed.
        corner: (n, 3) front-left-bottom corners of the boxes. z = 0 is the top of the deck.
        weight: (n,) masses of the boxes. None if the file does not have them.
        ids: names of the n boxes. Empty if the file does not have them.
        articles: names of the articles of the n boxes.
        turned: (n,) whether the length of each box's article lies along y.
        deck: sizes of the deck along x and y.
    """

    name: str
    size: np.ndarray
    corner: np.ndarray
    weight: np.ndarray | None
    ids: tuple[str, ...]
    articles: tuple[str, ...]
    turned: np.ndarray
    deck: tuple[float, float] = DECK_MM

    @property
    def n(self) -> int:
        return len(self.size)

    def take(self, boxes: Sequence[int] | np.ndarray) -> Packing:
        """The packing with only these boxes, in this order."""
        rows = np.asarray(boxes, int)
        return replace(
            self,
            size=self.size[rows],
            corner=self.corner[rows],
            weight=None if self.weight is None else self.weight[rows],
            ids=tuple(self.ids[k] for k in rows) if self.ids else (),
            articles=tuple(self.articles[k] for k in rows),
            turned=self.turned[rows],
        )

    def without(self, *fields: str) -> Packing:
        """The packing as read from a file that does not have these fields: "weight" or "ids"."""
        blank: dict[str, Any] = {"weight": None, "ids": ()}
        return replace(self, **{name: blank[name] for name in fields})


@functools.cache
def packing(
    number: int,
    most: int = 60,
    *,
    grid_mm: int = 1,
    deck: tuple[float, float] = DECK_MM,
    packer: str = "baseline",
    prefix: str = "B",
) -> Packing:
    """The first ``most`` boxes of the generated order ``number``, packed by a packer of petmjx.

    Args:
        grid_mm: sizes are multiples of this, for tools that count in whole units.
        prefix: beginning of the names of boxes.
    """
    rounded = [
        replace(item, **{side: max(grid_mm, round(getattr(item, side) / grid_mm) * grid_mm) for side in SIDES})
        for item in draw_order(SEED, number).items[:most]
    ]
    if packer == "balanced":
        placed = pack_balanced(rounded, deck)
    else:
        placed = pack(rounded, deck, PackRules(), stream(SEED, number))
    size = np.array([[getattr(box.item, side) for side in SIDES] for box in placed], float)
    turned = np.array([box.orientation == 1 for box in placed])
    size[turned] = size[turned][:, [1, 0, 2]]
    return Packing(
        name=f"P{number:02}",
        size=size,
        corner=np.array([box.corner_mm for box in placed], float).round(6),
        weight=np.array([box.item.weight_kg for box in placed], float),
        ids=tuple(f"{prefix}{k:03}" for k in range(1, len(placed) + 1)),
        articles=tuple(box.item.article for box in placed),
        turned=turned,
        deck=deck,
    )


SIDES = ("length_mm", "width_mm", "height_mm")


@dataclass(frozen=True)
class View:
    """A packing in the units and axes of a tool.

    Attributes:
        plan: the packing.
        size: (n, 3) sizes of the boxes as placed.
        place: (n, 3) the points that the tool calls the positions of the boxes.
        weight: (n,) weights of the boxes in the tool's unit.
        deck: (3,) sizes of the deck or bin along the tool's axes. The vertical one is its largest height.
        decimals: number of decimals of lengths.
        vertical: index of the axis that points up.
        step: (n,) position of each box in packing order, from 1. If None, rows are in packing order.
    """

    plan: Packing
    size: np.ndarray
    place: np.ndarray
    weight: np.ndarray
    deck: np.ndarray
    decimals: int
    vertical: int
    step: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.size)


@dataclass(frozen=True)
class Convention:
    """The convention of a tool for places and sizes of boxes.

    Attributes:
        length, mass: names of the units.
        anchor: the point of a box to which its position refers.
        up: the vertical axis, "z" or "y". With "y", the second and third numbers of sizes and positions are exchanged.
        origin: the point of the deck to which positions refer.
        short_first: whether x runs along the short side of the deck. The deck is then turned about the vertical.
    """

    length: str = "mm"
    mass: str = "kg"
    anchor: str = "corner"
    up: str = "z"
    origin: str = "corner"
    short_first: bool = False

    def view(self, plan: Packing) -> View:
        unit = MM[self.length]
        size, corner, deck = plan.size, plan.corner, np.array([*plan.deck, HEIGHT_MM])
        if (
            self.short_first
        ):  # a quarter turn to the left about the vertical; the deck's back left corner becomes the origin
            corner = np.column_stack([deck[1] - corner[:, 1] - size[:, 1], corner[:, 0], corner[:, 2]])
            size, deck = size[:, [1, 0, 2]], deck[[1, 0, 2]]
        place = corner + size * ANCHORS[self.anchor] - [*(deck[:2] * ORIGINS[self.origin]), 0.0]
        axes = [0, 2, 1] if self.up == "y" else [0, 1, 2]
        weight = np.full(plan.n, np.nan) if plan.weight is None else (plan.weight / KG[self.mass]).round(4)
        decimals = DECIMALS[self.length]
        size, place, deck = ((values[..., axes] / unit).round(decimals) for values in (size, place, deck))
        return View(plan, size, place, weight, deck, decimals, 1 if self.up == "y" else 2)
