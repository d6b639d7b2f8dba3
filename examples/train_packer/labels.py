"""Labels of placements by physics.

Many pallets are packed side by side in ``petmjx.Pallets``, by rules and partly at random, and a hand places each box as
inexactly as a robot does: its place, its size and its mass are in error. So each box stands among others with errors of
their own. A label is whether the pallet stands when the box has been placed; one that does not begins anew.
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
from petmjx.packers.placement_stability import stability_features
from petmjx.plans.order_generator import TARGET_EXTENT_MM, draw_order, stream

TARGET = "euro-pallet"

CLEARANCES_MM = (0.0, 2.0, CLEARANCE_MM, CLEARANCE_MM, 6.0, 10.0)
WANDERS = (0.0, 0.05, 0.2, 0.5)
"""Free space between boxes, and the share of boxes that are placed at random, in balance or not. Each order has one
such number."""

LEAST_SUPPORT = 0.2
"""Of a box that is placed at random."""

PLACE_MM, SIZE_MM, MASS = 2.7, 1.0, 0.02
"""Errors, as standard deviations: of the ready-made sweep ``confidence``; that of places also stands for turns of 0.5°,
which are 1.8 mm at the ends of a carton of 400 mm."""

CATALOGUES = 3_000_000
"""Seeds of orders begin here: no other set of petmjx's has these."""

ORDERS = 100
"""Most orders of a pallet: the orders of pallet p have numbers from ``ORDERS`` · p on."""

STREAM = 101
"""Random numbers of this stage."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Labels:
    """Placements with their labels by physics.

    Attributes:
        features: (m, f) ``stability_features``.
        stands: (m,) 1 if the pallet stands with the box on it, else 0.
        order: (m,) numbers of orders: test sets consist of whole orders.
        usual: (m,) 1 where the box was placed by the packer and with its free space, 0 where with another or at random.
    """

    features: Array
    stands: Array
    order: Array
    usual: Array

    @property
    def arrays(self) -> dict[str, Array]:
        """The labels in a file."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @classmethod
    def joined(cls, parts: list[Labels]) -> Labels:
        """All of several parts."""
        return cls(**{name: np.concatenate([part.arrays[name] for part in parts]) for name in cls.__dataclass_fields__})


def collect(seed: int, round_: int, *, pallets: int, steps: int, engine: Any, policy: Policy) -> Labels:
    """The labels of one round. Labels depend on the arguments alone.

    Args:
        pallets: number of pallets side by side; ``steps``: boxes placed on each.
        policy: packs half of the orders, the rule ``lowest_first`` the others.
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
    """A box at its intended and at its real place."""

    next: NextCandidate
    features: Array
    size_mm: Array
    corner_mm: Array
    mass_kg: float
    usual: bool


class _Game:
    """One pallet, with one order after another.

    Attributes:
        number: number of the order; ``is_new``: whether no box of it is on the pallet yet.
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
        """The next box with its errors; from the next order if this one is finished."""
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
        """Record whether the pallet stands with the box; if not, the next order begins."""
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
        """A place at random, whether the box keeps the balance there or not."""
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
