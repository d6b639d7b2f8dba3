"""Hand-made plans (``HANDMADE``), and the numbers of the generated plans that also come with petmjx.

``python -m petmjx.packers.handmade_plans`` writes the file with all these plans.

Statics determines whether a hand-made plan stands if its boxes are placed one by one on the carrier ``footprint``,
which is as large as the plan's bounding box. The simulation makes boxes smaller by 0.1 mm. This reduction changes no
verdict, since all hand-made plans are at least 15 mm away from the limit between standing and falling.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.sample_plans import as_placements, generate_one
from petmjx.plans.bedbpp_writer import write_plans
from petmjx.plans.bundled import bundled_path
from petmjx.plans.order import Item

BUNDLED_SEED = 0

BUNDLED_INDICES = (3, 7, 13, 16, 38, 46, 92, 152, 189, 430, 443, 1349, 1784, 2112)
"""Numbers of the generated plans that come with petmjx. Seven of these plans stand, and seven collapse (16, 46, 430,
443, 1349, 1784, 2112). Three plans have 41 to 45 boxes, three have about 30, and eight have 14 to 20. Most plans are
small, so that a demo is quick."""


def bundled_plans() -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """(plan id, placements in BED-BPP's format) of all plans that come with petmjx."""
    for plan in HANDMADE:
        yield plan.plan_id, list(plan.placements)
    for index in BUNDLED_INDICES:
        yield generate_one(index, BUNDLED_SEED)


Size = tuple[int, int, int]
Corner = tuple[int, int, int]

CARTON: Size = (400, 300, 200)
CARTON_KG = 6.0


@dataclass(frozen=True)
class HandmadePlan:
    """A hand-made plan and the verdict that statics gives.

    Attributes:
        plan_id: id of the plan, which begins with "hand-".
        why: the reason of the verdict, in one sentence.
        placements: placements in BED-BPP's format.
        culprit: number of the box that fails first, in packing order from 0; −1 if the plan is stable.
        rest_top_force_n: (number of a box, force on top of the box at rest in N) for each box for which statics gives
            this force.
    """

    plan_id: str
    why: str
    placements: tuple[dict[str, Any], ...]
    culprit: int = -1
    rest_top_force_n: tuple[tuple[int, float], ...] = ()

    @property
    def expected(self) -> Literal["stable", "unstable"]:
        """The verdict that a simulation must have."""
        return "unstable" if self.culprit >= 0 else "stable"


def _plan(*boxes: tuple[Size, Corner, float]) -> tuple[dict[str, Any], ...]:
    placed = []
    for size, corner, weight_kg in boxes:
        name = "x".join(map(str, size))
        placed.append(PlacedBox(Item(f"carton-{name}", name, "handmade", *size, weight_kg), 0, corner))
    return tuple(as_placements(placed))


def _cartons(*corners: Corner) -> tuple[dict[str, Any], ...]:
    return _plan(*((CARTON, corner, CARTON_KG) for corner in corners))


GRAVITY = 9.81

HANDMADE: tuple[HandmadePlan, ...] = (
    HandmadePlan(
        "hand-one-box",
        "one box flat on the carrier; nothing rests on it",
        _cartons((0, 0, 0)),
        rest_top_force_n=((0, 0.0),),
    ),
    HandmadePlan(
        "hand-stack-of-5",
        "five equal boxes flush on each other: each bears the weight of the boxes above it",
        _cartons(*((0, 0, 200 * k) for k in range(5))),
        rest_top_force_n=tuple((k, (4 - k) * CARTON_KG * GRAVITY) for k in range(5)),
    ),
    HandmadePlan(
        "hand-overhang-45",
        "the upper box hangs over by 45 % of its length: its centre is 20 mm inside the lower box's edge",
        _cartons((0, 0, 0), (180, 0, 200)),
        rest_top_force_n=((0, CARTON_KG * GRAVITY),),
    ),
    HandmadePlan(
        "hand-overhang-55",
        "the upper box hangs over by 55 % of its length: its centre is 20 mm outside the lower box's edge, so it tips",
        _cartons((0, 0, 0), (220, 0, 200)),
        culprit=1,
    ),
    HandmadePlan(
        "hand-bridge",
        "a beam rests with its two ends on two equal supports, each of which bears half of the beam's weight; nothing "
        "supports the beam's middle",
        _plan(
            ((200, 300, 200), (0, 0, 0), 4.0), ((200, 300, 200), (400, 0, 0), 4.0), ((600, 300, 150), (0, 0, 200), 9)
        ),
        rest_top_force_n=((0, 4.5 * GRAVITY), (1, 4.5 * GRAVITY)),
    ),
    HandmadePlan(
        "hand-tower",
        "eight cartons, 1.84 m high on a base of 0.3 m: slender, but each centre is right above the base",
        _plan(*(((300, 300, 230), (0, 0, 230 * k), 5.0) for k in range(8))),
        rest_top_force_n=((0, 7 * 5.0 * GRAVITY),),
    ),
    HandmadePlan(
        "hand-harmonic-stack",
        "overhangs of 0.45/3, 0.45/2 and 0.45/1 of the length, as in the book-stacking problem: for each box, the "
        "common centre of all boxes above it is 45 % of the length from the box's centre, so still inside the box's "
        "edge",
        _cartons((0, 0, 0), (60, 0, 200), (150, 0, 400), (330, 0, 600)),
    ),
    HandmadePlan(
        "hand-staircase",
        "each box hangs over by only 40 % of its length, so it passes a support rule of 0.6. But the common centre of "
        "the upper two boxes is 60 % of the length from the lowest box's centre, so both tip over the lowest box's "
        "edge",
        _cartons((0, 0, 0), (160, 0, 200), (320, 0, 400)),
        culprit=2,
    ),
    HandmadePlan(
        "hand-drop-of-5-mm",
        "a box floats 5 mm above the other: it falls flat and ends 5 mm below its place, which is less than the "
        "threshold of 20 mm",
        _cartons((0, 0, 0), (0, 0, 205)),
        rest_top_force_n=((0, CARTON_KG * GRAVITY),),
    ),
    HandmadePlan(
        "hand-floating",
        "a box floats 400 mm above the lower box, with its centre beyond the lower box's edge: it falls, strikes the "
        "edge and turns",
        _cartons((0, 0, 0), (250, 0, 600)),
        culprit=1,
    ),
    HandmadePlan(
        "hand-falls-off",
        "a box of 400 mm length hangs over the lower box's edge by 300 mm: its centre is outside the edge, so it tips, "
        "and because it is 500 mm tall, it also falls off the carrier",
        _plan((CARTON, (0, 0, 0), CARTON_KG), ((400, 300, 500), (300, 0, 200), CARTON_KG)),
        culprit=1,
    ),
    HandmadePlan(
        "hand-over-corner",
        "the upper box hangs over a corner by 40 % of its length and of its width: its centre is 40 mm and 30 mm "
        "inside the lower box's edges, although only 36 % of its base is supported",
        _cartons((0, 0, 0), (160, 120, 200)),
        rest_top_force_n=((0, CARTON_KG * GRAVITY),),
    ),
)


if __name__ == "__main__":
    write_plans(bundled_path(), bundled_plans())
