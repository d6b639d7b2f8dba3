"""Labels of placements, from simulations.

Many pallets are packed side by side in ``petmjx.Pallets``, by rules and partly at random. A hand places each box as
inexactly as a robot does: with errors of place, size and mass. So the boxes under a new box have errors, too. The label
of a placement is whether the pallet stands with the new box on it. A pallet that does not stand is emptied, and the
next order begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import petmjx
from petmjx.packers.item_stream import Places
from petmjx.packers.learned_candidates import FourSidedStream, lowest_first
from petmjx.packers.learned_packer import CLEARANCE_MM, Policy, placing_of
from petmjx.packers.packing_state import NextCandidate
from petmjx.packers.stability_features import stability_features
from petmjx.plans.order import TARGET_EXTENT_MM
from petmjx.plans.order_generator import draw_order, stream

TARGET = "euro-pallet"

CLEARANCES_MM = (0.0, 2.0, CLEARANCE_MM, CLEARANCE_MM, 6.0, 10.0)
WANDERS = (0.0, 0.05, 0.2, 0.5)
"""``CLEARANCES_MM``: free space between boxes, mm. ``WANDERS``: share of boxes that are placed at random, in balance or
not. One number of each kind is drawn for each order."""

LEAST_SUPPORT = 0.2
"""Smallest supported share of the base of a box that is placed at random."""

PLACE_MM, SIZE_MM, MASS = 2.7, 1.0, 0.02
"""Standard deviations of the errors: place in mm, size in mm, and mass as a share. They are those of the ready-made
sweep ``confidence``, but the error of places also stands for turns of 0.5°, which move the ends of a carton of 400 mm
by 1.8 mm."""

CATALOGUES = 3_000_000
"""First seed of the orders. No other set of petmjx uses seeds from this number on."""

ORDERS = 100
"""Largest number of orders of a pallet. The orders of pallet p have numbers from ``ORDERS`` · p on."""

STREAM = 101
"""Key of the random numbers of this stage of the training."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Labels:
    """Placements with their labels.

    Attributes:
        features: (m, f) the features from ``stability_features``.
        stands: (m,) 1 if the pallet stands with the box on it, else 0.
        order: (m,) number of the order; test sets consist of whole orders.
        usual: (m,) 1 if the packer chose the place and kept its own free space; 0 if the place is random or has another
            free space.
    """

    features: Array
    stands: Array
    order: Array
    usual: Array

    @property
    def arrays(self) -> dict[str, Array]:
        """The labels as named arrays, for a file."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @classmethod
    def joined(cls, parts: list[Labels]) -> Labels:
        """The labels of several parts, joined."""
        return cls(**{name: np.concatenate([part.arrays[name] for part in parts]) for name in cls.__dataclass_fields__})


def collect(seed: int, round_: int, *, pallets: int, steps: int, engine: Any, policy: Policy) -> Labels:
    """The labels of one round. They depend only on the arguments.

    Args:
        pallets: number of pallets that are packed side by side; ``steps``: number of boxes placed on each pallet.
        policy: packs half of the orders; the rule ``lowest_first`` packs the other half.
    """
    world = petmjx.Pallets(pallets, engine=engine, carrier=TARGET, placing="hand")
    games = [_Game(seed, round_ * 10_000 + number, policy) for number in range(pallets)]
    rows = []
    for _ in range(steps):
        moves = [game.next() for game in games]
        if fresh := [number for number, game in enumerate(games) if game.is_new]:
            world.reset(np.array(fresh))
        report = world.place(
            size_mm=np.array([move.size_mm for move in moves]),
            corner_mm=np.array([move.corner_mm for move in moves]),
            mass_kg=np.array([move.mass_kg for move in moves]),
        )
        for game, move, verdict in zip(games, moves, report.verdict.tolist(), strict=True):
            if verdict != "invalid":
                rows.append((move.features, float(verdict == "stable"), game.number, float(move.usual)))
            game.placed(verdict == "stable")
    world.close()
    features, stands, order, usual = zip(*rows, strict=True)
    return Labels(np.array(features), np.array(stands), np.array(order, float), np.array(usual))


@dataclass(frozen=True)
class _Move:
    """A box with its intended place and its real place."""

    next: NextCandidate
    features: Array
    size_mm: Array
    corner_mm: Array
    mass_kg: float
    usual: bool


class _Game:
    """One pallet, on which orders are packed one after another.

    Attributes:
        number: number of the present order; ``is_new``: whether no box of this order is on the pallet yet.
    """

    def __init__(self, seed: int, number: int, policy: Policy) -> None:
        self._rng = stream(seed, STREAM, number)
        self._seed, self._policy = seed, policy
        self._first, self._orders = number, 0
        self._begin()

    def _begin(self) -> None:
        rng = self._rng
        self.number = self._first * ORDERS + self._orders
        self._orders += 1
        items = list(draw_order(CATALOGUES + self._seed, self.number).items)
        if rng.random() < 0.5:
            items = [items[i] for i in rng.permutation(len(items))]
        self._plays = self._policy if rng.random() < 0.5 else None
        self._wanders, clearance = float(rng.choice(WANDERS)), float(rng.choice(CLEARANCES_MM))
        self._clearance = clearance if self._plays is None else CLEARANCE_MM
        self._boxes = FourSidedStream(items, TARGET_EXTENT_MM[TARGET], self._clearance)
        self._move: _Move | None = None
        self.is_new = True

    def next(self) -> _Move:
        """The next box with its errors. If the present order is finished, the box is from the next order."""
        while True:
            if not self._boxes.seen:
                self._begin()
            wanders = self._rng.random() < self._wanders
            decision = self._anywhere() if wanders else self._best()
            if decision is None:
                self._boxes.skip()
                continue
            places, row, chosen = decision
            size, rng = places.size_mm[row] - self._boxes.clearance, self._rng
            beside = np.append(rng.normal(0, PLACE_MM, 2), 0.0)
            self._move = _Move(
                chosen,
                stability_features(placing_of(self._boxes, places, row)),
                size + rng.normal(0, SIZE_MM, 3),
                places.corner_mm[row] + beside,
                float(places.mass_kg[row] * (1 + rng.normal(0, MASS))),
                not wanders and self._clearance == CLEARANCE_MM,
            )
            return self._move

    def placed(self, stands: bool) -> None:
        """Record whether the pallet stands with the box. If it does not, the next order begins."""
        assert self._move is not None
        self.is_new = False
        if stands:
            self._boxes.put(self._move.next)
        else:
            self._begin()

    def _best(self) -> tuple[Places, int, NextCandidate] | None:
        places = self._boxes.places()
        chosen = lowest_first(self._boxes) if self._plays is None else self._plays.choose(self._boxes)
        if chosen is None:
            return None
        row = int(np.flatnonzero((places.point == chosen.point) & (places.shape == chosen.shape))[0])
        return places, row, chosen

    def _anywhere(self) -> tuple[Places, int, NextCandidate] | None:
        """A random place for the box, whether the box is in balance there or not."""
        places = self._boxes.places(LEAST_SUPPORT)
        if not len(places):
            return None
        row = int(self._rng.integers(len(places)))
        rest = placing_of(self._boxes, places, row).margins.rest
        (x, y, z) = places.corner_mm[row].tolist()
        return (
            None
            if rest is None
            else (places, row, NextCandidate(int(places.point[row]), int(places.shape[row]), (x, y, z), rest))
        )
