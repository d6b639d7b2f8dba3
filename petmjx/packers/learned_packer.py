"""The packer ``learned``. A candidate is a box that the packer sees, at a place on the pile. Learned weights rank the
candidates, and a small network predicts the probability that a candidate stands.

The packer was trained on generated orders only, with simulations (examples/train_packer). While the packer packs, it
runs no simulation. The packer is deterministic: an order always gets the same plan.

``placement_stability`` predicts the same probability for the boxes of any plan.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import IO, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.argument_checks import instance_of
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.item_stream import Places, pack_stream
from petmjx.packers.learned_candidates import FourSidedStream, cost_mm
from petmjx.packers.learned_features import features
from petmjx.packers.packing_state import NextCandidate
from petmjx.packers.pile_balance import TOUCH_MM, Balance, Rest
from petmjx.packers.policy_network import Network, likely
from petmjx.packers.stability_features import PlacementState, placement_state, stability_features
from petmjx.plans.order import Item
from petmjx.plans.plan import Plan

LEARNED: Final = "learned"
"""The packer's name."""

CLEARANCE_MM: Final = 4.0
"""Free space between neighbouring boxes, mm. With this space, plans stand even if a robot places the boxes inexactly
(docs/packers.md)."""

MOST_PLACES: Final = 32
LEAST_PLACES: Final = 6
"""For each kind of box that the packer sees, only the lowest candidates are rated. The number of rated candidates per
kind is ``MOST_PLACES`` divided by the number of kinds that the packer sees, but at least ``LEAST_PLACES``."""

SURE: Final = 0.98
"""A probability to stand that is high enough. The packer takes the best candidate whose probability is ``SURE`` or
more."""

LEAST_SURE: Final = 0.5
"""Smallest acceptable probability to stand. If no candidate reaches ``SURE``, the packer takes the candidate with the
largest probability, but only if this probability is ``LEAST_SURE`` or more."""

MOST_TRIED: Final = 16
"""Largest number of candidates, best first, whose probability to stand is computed in one step. If none of these
candidates reaches ``SURE``, the packer looks at no further candidates (see ``LEAST_SURE``)."""

SCORE_DECIMALS: Final = 6
"""Number of decimals to which scores are rounded, so that processors that round differently choose the same places."""


class ChosenCandidate(NamedTuple):
    """The candidate that the packer has chosen.

    Attributes:
        row: row of the candidate in ``Places``.
        next: the candidate.
        chance: predicted probability that the box stands if a robot places it inexactly.
    """

    row: int
    next: NextCandidate
    chance: float


class Decision(NamedTuple):
    """What the packer considers in one step: the rated candidates, their features, and the chosen candidate."""

    places: Places
    rows: FloatArray
    chosen: ChosenCandidate


@dataclass(frozen=True, eq=False)
class Policy:
    """The two learned networks.

    Attributes:
        taste: network that computes a candidate's score from its ``features``. The network may be linear.
        head: network that computes a box's probability to stand from its ``stability_features``.
    """

    taste: Network
    head: Network

    def seen(self, stream: FourSidedStream) -> tuple[Places, FloatArray] | None:
        """The candidates that are rated, and their features; None if there are no candidates."""
        places = lowest(stream, stream.places())
        return (places, features(stream, places)) if len(places) else None

    def take(self, stream: FourSidedStream, places: Places, scores: FloatArray) -> ChosenCandidate | None:
        """The chosen candidate: the best candidate that keeps the balance and whose probability to stand is at least
        ``SURE``.

        If none of the best ``MOST_TRIED`` candidates reaches ``SURE``, the candidate with the largest probability is
        chosen. If none of the best ``MOST_TRIED`` candidates reaches ``LEAST_SURE``, the result is None.
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
        """The packer's decision in one step; None if no rated candidate keeps the balance and stands with a probability
        of at least ``LEAST_SURE``."""
        while (view := self.seen(stream)) is not None:
            places, rows = view
            chosen = self.take(stream, places, np.round(self.taste.scores(rows), SCORE_DECIMALS))
            if chosen is not None:
                return Decision(places, rows, chosen)
            # some candidates keep the balance, but their probability to stand is too small
            if stream.still_open(places).any():
                return None
        return None

    def choose(self, stream: FourSidedStream) -> NextCandidate | None:
        """The candidate that one step chooses; None if there is no place for any box that the packer sees."""
        decision = self.decide(stream)
        return None if decision is None else decision.chosen.next

    def save(self, file: Path | IO[bytes]) -> None:
        """Write the weights to a file, in single precision."""
        arrays = {**self.taste.arrays("taste"), **self.head.arrays("head")}
        np.savez_compressed(
            file, allow_pickle=False, **{name: values.astype(np.float32) for name, values in arrays.items()}
        )

    @classmethod
    def load(cls, file: Path | IO[bytes]) -> Policy:
        """The policy with the weights in a file."""
        with np.load(file, allow_pickle=False) as arrays:
            weights = dict(arrays)
        return cls(Network.of_arrays("taste", weights), Network.of_arrays("head", weights))


def placing_of(stream: FourSidedStream, places: Places, row: int, rest: Rest | None = None) -> PlacementState:
    """The pile and the box of a candidate, at the moment when the box is placed. Boxes have their own sizes, without
    free space."""
    low, high = stream.bare_boxes
    corner, size = places.corner_mm[row], places.size_mm[row] - stream.clearance
    return placement_state(stream.pile, low, high, stream.masses, corner, size, float(places.mass_kg[row]), rest)


def lowest(stream: FourSidedStream, places: Places) -> Places:
    """For each kind of box, the candidates of least cost, that is, mainly the lowest candidates."""
    cost = cost_mm(stream, places) + places.size_mm[:, 2]
    kinds = np.unique(places.kind)
    most = max(MOST_PLACES // max(len(kinds), 1), LEAST_PLACES)
    order: NDArray[np.intp] = np.argsort(cost, kind="stable")
    lowest_rows = [order[places.kind[order] == kind][:most] for kind in kinds.tolist()]
    return places.take(np.concatenate(lowest_rows)) if lowest_rows else places


@functools.cache
def published_policy() -> Policy:
    """The policy with the weights that come with petmjx."""
    with files(__package__).joinpath("learned.npz").open("rb") as file:
        return Policy.load(file)


def pack_learned(
    items: Sequence[Item], extent_mm: tuple[float, float], look_ahead: int = 1, policy: Policy | None = None
) -> list[PlacedBox]:
    """Place the items on a target of length and width ``extent_mm``, as they arrive. Items for which there is no place
    are left out.

    Args:
        items: the items in order of arrival.
        extent_mm: length and width of the target, mm.
        look_ahead: number of boxes that the packer sees at a time. Any of these boxes may be placed next.
        policy: the policy. If ``policy`` is None, the policy that comes with petmjx is used.
    """
    return pack_stream(
        FourSidedStream(items, extent_mm, CLEARANCE_MM, look_ahead), (policy or published_policy()).choose
    )


def placement_stability(plan: Plan) -> FloatArray:
    """(n,) probability of each box of a plan to stand if a robot places all boxes inexactly.

    A box counts as standing if it stands until the end of the simulation, or if another box fails first. So the product
    of all probabilities is the probability that the whole plan stands. The probability of a box is 0 if nothing touches
    its bottom, or if its bottom is below the carrier's top.

    A network estimates the probabilities without a simulation, in a millisecond per box. To simulate the plan instead,
    call ``petmjx.score(plan, confidence=64)``. docs/packers.md states how reliable the estimate is.

    Raises:
        InputError: ``plan`` is not a plan.
    """
    instance_of(plan, "plan", Plan, "a plan")
    pile = Balance(plan.n_boxes)
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    rows, floats = [], []
    for i, (corner, size, mass) in enumerate(zip(low, plan.size_mm, plan.mass_kg.tolist(), strict=True)):
        box = placement_state(pile, low[:i], high[:i], plan.mass_kg[:i], corner, size, mass)
        rows.append(stability_features(box))
        floats.append(box.margins.rest is None or corner[2] < -TOUCH_MM)
        x, y, z = corner.tolist()
        length, width, height = size.tolist()
        middle = np.array([1.0, (x + length / 2) / MM_PER_M, (y + width / 2) / MM_PER_M])
        rest = box.margins.rest or Rest(mass * middle, None, np.zeros((0, 3)))
        pile.add((x, y, z), (length, width, height), rest)
    chances = likely(published_policy().head, np.array(rows))
    return np.where(floats, 0.0, chances)
