"""The box with a world's flag ``knife-edge``, by the world's stored distances."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict

KNIFE_EDGE_M: Final = 0.0005
"""Plans have whole millimetres, and boxes are smaller than planned by a tenth of a millimetre. All verdicts that other
simulators disputed were of boxes whose centre was nearer than this to an edge (docs/validation.md)."""

NEAR_M: Final = 0.001
"""A load nearer than this to an edge sets the flag, too, if the verdict contradicts statics: a world stands with the
load beyond the edge, or falls with it inside. (Small worlds that fall are also tried in stiffer contacts:
petmjx.engines.contact_tilt.)"""

_ROUNDING_M: Final = 1e-9
"""Tables have distances of a millimetre as float32."""

_SAME_M: Final = 1e-6
"""Tables have places of boxes as float32, too."""

BY_PLAN: Final = "by the plan"
AT_REST: Final = "at rest"
WHILE_BUILT: Final = "while it is built"


class KnifeEdge(NamedTuple):
    """A load near an edge.

    Attributes:
        edge_m: distance from the edge, positive inside, negative beyond.
        box: the box that has the load.
        when: ``BY_PLAN``, ``AT_REST`` or ``WHILE_BUILT``.
        step: the box after whose placement the load is there, ``WHILE_BUILT``; else -1.
        own_weight: whether the load is the box's own weight alone.
    """

    edge_m: float
    box: int
    when: str
    step: int = -1
    own_weight: bool = False


def kept_edges(
    world: Mapping[str, Any], plan_edge_m: FloatArray | None, rest_edge_m: FloatArray | None
) -> Iterator[KnifeEdge]:
    """The distances of loads from edges that a run writes for a world.

    Args:
        world: columns of ``worlds``, or fields of ``petmjx.engines.verdict.Outcome``.
        plan_edge_m, rest_edge_m: (n,) distances of the boxes, m; None: they are not kept.
    """
    for name, when, of_boxes in (
        ("plan", BY_PLAN, plan_edge_m),
        ("rest", AT_REST, rest_edge_m),
        ("build", WHILE_BUILT, None),
    ):
        if of_boxes is not None:
            yield from edges_when(of_boxes, when)
        edge_m, box, step = (_float(world.get(f"{name}_edge_{key}")) for key in ("m", "box", "step"))
        if not math.isnan(edge_m):
            yield KnifeEdge(edge_m, _number(box), when, _number(step))


def edges_when(edge_m: FloatArray, when: str, own_weight: bool = False) -> Iterator[KnifeEdge]:
    """The distances of boxes, without those that are not known."""
    for box in np.flatnonzero(~np.isnan(edge_m)).tolist():
        yield KnifeEdge(float(edge_m[box]), box, when, own_weight=own_weight)


def nearest_edge(edges: Iterable[KnifeEdge], verdict: Verdict | None = None) -> KnifeEdge | None:
    """The load that is nearest to an edge, on either side; None: there is none.

    Args:
        verdict: only loads that set the flag of a world with this verdict; None: any load.
    """
    return min(
        (edge for edge in edges if verdict is None or _edge_sets_flag(edge, verdict)),
        key=lambda edge: abs(edge.edge_m),
        default=None,
    )


def sets_flag(edge_m: FloatArray, verdict: Verdict | None, *, rounding_m: float = 0.0) -> NDArray[np.bool_]:
    """(…) whether loads at these distances from edges set the flag: they are near an edge, or less near and on the side
    that the verdict contradicts. NaN sets none.

    Args:
        verdict: of the world; None: the side does not count.
        rounding_m: largest error of the distances, m; so much further counts as near.
    """
    away_m = np.abs(edge_m) - rounding_m
    is_near = away_m <= KNIFE_EDGE_M
    if verdict is None:
        return is_near
    contradicts = (edge_m < 0) if verdict is Verdict.STABLE else (edge_m >= 0)
    return is_near | (contradicts & (away_m <= NEAR_M))


def _edge_sets_flag(edge: KnifeEdge, verdict: Verdict) -> bool:
    """Whether a load whose distance a table keeps sets the flag. At rest its side does not count."""
    side = None if edge.when == AT_REST else verdict
    return bool(sets_flag(np.array([edge.edge_m]), side, rounding_m=_ROUNDING_M)[0])


def is_same_edge(edge: KnifeEdge, kept: KnifeEdge) -> bool:
    """Whether a distance that is computed again is one that tables keep, of the same box at the same time."""
    is_same = (edge.box, edge.when, edge.step) == (kept.box, kept.when, kept.step)
    return is_same and math.isclose(edge.edge_m, kept.edge_m, abs_tol=_SAME_M)


def _float(value: Any) -> float:
    """The number; NaN if it is null."""
    try:
        return math.nan if value is None else float(value)
    except TypeError:  # pandas.NA
        return math.nan


def _number(value: float) -> int:
    """The number of a box; -1 for NaN."""
    return -1 if math.isnan(value) else int(value)
