"""The packer ``balanced``, which packs by best fit and keeps the pile in static balance, so that plans stand.

A candidate is a remaining box, in one orientation, at a corner point of the pile (equal boxes count once). At every
step, the packer rates all candidates, as in the best-fit method of Allen, Burke, Kendall (2011, "A hybrid placement
strategy for the three-dimensional strip packing problem", European J. of Operational Research 209, 219–227). Low
places, large bases, heavy boxes and tall boxes are rated well; overhangs are rated badly. The packer chooses the best
candidate with which the pile stays in static balance (:mod:`petmjx.packers.pile_balance`). So the pile is in balance
after every step.

The packer is deterministic: an order always gets the same plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.packing_state import Packing, Preferences
from petmjx.plans.order import Item

PREFERENCE_SETS: Final = (
    Preferences(),
    Preferences(per_height=0.6),
    Preferences(per_overhang=0.0),
    Preferences(per_base_side=1.0),
)
"""Sets of weights with which candidates are rated. The first set in this list is the best of 50 random sets: for the
first 40 generated orders of seed 0, it gave the best volume utilisation and left out the fewest boxes. Sets with
similar weights are about as good. If the packing with one set leaves boxes out, the next set is tried. In 600 orders of
seed 0, the first set leaves out 35 boxes from 10 orders. If the other sets are tried as well, no box is left out."""


def pack_balanced(items: Sequence[Item], extent_mm: tuple[float, float]) -> list[PlacedBox]:
    """Place the items on a target of length and width ``extent_mm``. Returns the placed boxes in packing order. Items
    for which there is no place are left out."""
    best: list[PlacedBox] = []
    for preferences in PREFERENCE_SETS:
        packing = Packing(items, extent_mm, preferences)
        packing.fill()
        if len(packing.placed) > len(best):
            best = packing.placed
        if len(best) == len(items):
            break
    return best
