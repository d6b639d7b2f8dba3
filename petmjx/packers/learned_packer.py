"""The packer ``learned``: learned weights rank the candidates, and a small network predicts how likely the box is to
stand at each of them.

The packer was trained on generated orders only (examples/train_packer), with physics in the loop. When it packs, it
runs no simulation and is deterministic: an order always gets the same plan.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import IO, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.item_stream import Places, pack_stream
from petmjx.packers.learned_candidates import FourSidedStream, cost_mm
from petmjx.packers.learned_features import features
from petmjx.packers.packing_state import NextCandidate
from petmjx.packers.pile_balance import Rest
from petmjx.packers.placement_stability import PlacementState, likely, placement_state, stability_features
from petmjx.packers.policy_network import Network
from petmjx.plans.order_generator import Item

LEARNED: Final = "learned"
"""The packer's name."""

CLEARANCE_MM: Final = 4.0
"""Free space between neighbours, with which plans stand even if a robot places the boxes inexactly
(docs/packers.md)."""

MOST_PLACES: Final = 32
LEAST_PLACES: Final = 6
"""Only the lowest candidates are rated: ``MOST_PLACES`` in all, and at least ``LEAST_PLACES`` of each visible kind of
box."""

SURE: Final = 0.98
"""The packer takes the best candidate whose chance to stand is at least this."""

LEAST_SURE: Final = 0.5
"""If no candidate reaches ``SURE``, the packer takes the candidate with the largest chance, provided that it is at
least ``LEAST_SURE``."""

MOST_TRIED: Final = 16
"""Largest number of candidates whose chance is computed when none reaches ``SURE``."""

SCORE_DECIMALS: Final = 6
"""Scores are rounded to this many decimals, so that processors with different rounding choose the same places."""


class ChosenCandidate(NamedTuple):
    """The candidate that the packer has chosen.

    Attributes:
        row: row of the candidate in ``Places``.
        next: the candidate itself.
        chance: predicted chance that the box stands when a robot places it inexactly.
    """

    row: int
    next: NextCandidate
    chance: float


class Decision(NamedTuple):
    """One step: the rated candidates, their features, and the chosen candidate."""

    places: Places
    rows: FloatArray
    chosen: ChosenCandidate


@dataclass(frozen=True, eq=False)
class Policy:
    """The two learned networks.

    Attributes:
        taste: network that scores candidates from their ``features``; it may have only its linear part.
        head: network that predicts from ``stability_features`` the chance that a placement stands.
    """

    taste: Network
    head: Network

    def with_linear(self, weights: FloatArray) -> Policy:
        """The same policy with other linear weights in ``taste``."""
        return replace(self, taste=replace(self.taste, linear=weights))

    def seen(self, stream: FourSidedStream) -> tuple[Places, FloatArray] | None:
        """The candidates that are rated, with their features; None if there are none."""
        places = lowest(stream, stream.places())
        return (places, features(stream, places)) if len(places) else None

    def take(self, stream: FourSidedStream, places: Places, scores: FloatArray) -> ChosenCandidate | None:
        """The best candidate that keeps the balance and whose chance to stand is at least ``SURE``.

        If none of the first ``MOST_TRIED`` candidates reaches ``SURE``, the one with the largest chance is taken. None:
        none of these candidates reaches ``LEAST_SURE``.
        """
        surest: ChosenCandidate | None = None
        tried = 0
        for row in np.argsort(-scores, kind="stable").tolist():
            candidate = stream.keeps_balance(places, row)
            if candidate is None:
                continue
            chance = float(
                likely(self.head, stability_features(placing_of(stream, places, row, candidate.rest))[None])[0]
            )
            if surest is None or chance > surest.chance:
                surest = ChosenCandidate(row, candidate, chance)
            tried += 1
            if chance >= SURE or tried == MOST_TRIED:
                break
        return surest if surest is not None and surest.chance >= LEAST_SURE else None

    def decide(self, stream: FourSidedStream) -> Decision | None:
        """One step of the packer; None: no visible box has a place."""
        while (view := self.seen(stream)) is not None:
            places, rows = view
            chosen = self.take(stream, places, np.round(self.taste.scores(rows), SCORE_DECIMALS))
            if chosen is not None:
                return Decision(places, rows, chosen)
            # Some places keep the balance, but the predicted chance that the box stands there is too small.
            if stream.still_open(places).any():
                return None
        return None

    def choose(self, stream: FourSidedStream) -> NextCandidate | None:
        """The chosen candidate of one step; None: no visible box has a place."""
        decision = self.decide(stream)
        return None if decision is None else decision.chosen.next

    def save(self, file: Path | IO[bytes]) -> None:
        """Write the weights, in single precision."""
        arrays = {**self.taste.arrays("taste"), **self.head.arrays("head")}
        np.savez_compressed(
            file, allow_pickle=False, **{name: values.astype(np.float32) for name, values in arrays.items()}
        )

    @classmethod
    def load(cls, file: Path | IO[bytes]) -> Policy:
        """A policy with the weights of a file."""
        with np.load(file, allow_pickle=False) as arrays:
            weights = dict(arrays)
        return cls(Network.of_arrays("taste", weights), Network.of_arrays("head", weights))


def placing_of(stream: FourSidedStream, places: Places, row: int, rest: Rest | None = None) -> PlacementState:
    """The state in which a candidate is placed, without the free space around boxes."""
    low, high = stream.bare_boxes
    corner, size = places.corner_mm[row], places.size_mm[row] - stream.clearance
    return placement_state(stream.pile, low, high, stream.masses, corner, size, float(places.mass_kg[row]), rest)


def lowest(stream: FourSidedStream, places: Places) -> Places:
    """The lowest candidates of each kind of box."""
    cost = cost_mm(stream, places) + places.size_mm[:, 2]
    kinds = np.unique(places.kind)
    most = max(MOST_PLACES // max(len(kinds), 1), LEAST_PLACES)
    order: NDArray[np.intp] = np.argsort(cost, kind="stable")
    lowest_rows = [order[places.kind[order] == kind][:most] for kind in kinds.tolist()]
    return places.take(np.concatenate(lowest_rows)) if lowest_rows else places


@functools.cache
def published_policy() -> Policy:
    """The policy with the weights that are part of petmjx."""
    with files(__package__).joinpath("learned.npz").open("rb") as file:
        return Policy.load(file)


def pack_learned(
    items: Sequence[Item], extent_mm: tuple[float, float], look_ahead: int = 1, policy: Policy | None = None
) -> list[PlacedBox]:
    """Place the items on a target of ``extent_mm``, in order of arrival. Items without a place are left out.

    Args:
        look_ahead: number of next boxes that the packer sees. Any visible box may be placed next.
        policy: a policy; None: the published policy.
    """
    return pack_stream(
        FourSidedStream(items, extent_mm, CLEARANCE_MM, look_ahead), (policy or published_policy()).choose
    )
