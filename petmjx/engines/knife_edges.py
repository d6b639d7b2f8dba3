"""Finds the box that sets the flag ``knife-edge`` of a world.

The data are distances that a run stores for the world: the distances of the boxes' loads from the edges of their
supports.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict

KNIFE_EDGE_M: Final = 0.0005
"""A load that is nearer to an edge than this distance, m, sets the flag ``knife-edge``. The sizes and places in most
plans are whole millimetres, and simulated boxes are smaller than planned by a tenth of a millimetre. In all plans for
which other simulators gave another verdict, the centre of a box was nearer to an edge than this distance
(docs/validation.md)."""

NEAR_M: Final = 0.001
"""Distance from an edge, m. If the verdict contradicts statics, a load that is nearer to an edge than ``NEAR_M`` sets
the flag ``knife-edge``, even if it is farther away than ``KNIFE_EDGE_M``. The verdict contradicts statics if the world
stands with the load beyond the edge, or falls with the load inside the edge. (Small worlds whose boxes fall are also
simulated again with stiffer contacts: petmjx.engines.contact_tilt.)"""

_ROUNDING_M: Final = 1e-9
"""Largest rounding error, m, of a distance near an edge that a table stores as float32."""

_SAME_M: Final = 1e-6
"""Two distances count as equal if they differ by at most this value, m. Small differences are rounding errors, since
tables store the places of boxes as float32."""

BY_PLAN: Final = "by the plan"
AT_REST: Final = "at rest"
WHILE_BUILT: Final = "while it is built"


class KnifeEdge(NamedTuple):
    """The distance of a load from an edge of its supports.

    Attributes:
        edge_m: distance of the load from the edge, m; positive inside the edge, negative beyond it.
        box: number of the box whose supports carry the load.
        when: ``BY_PLAN`` (at the planned places), ``AT_REST`` or ``WHILE_BUILT``.
        step: for ``WHILE_BUILT``, number of the box after whose placement the load acts; otherwise -1.
        own_weight: whether the load is only the box's own weight.
    """

    edge_m: float
    box: int
    when: str
    step: int = -1
    own_weight: bool = False


def kept_edges(
    world: Mapping[str, Any], plan_edge_m: FloatArray | None, rest_edge_m: FloatArray | None
) -> Iterator[KnifeEdge]:
    """The distances of loads from edges that a run stores for one world.

    Args:
        world: columns of the table ``worlds``, or fields of ``petmjx.engines.verdict.Outcome``.
        plan_edge_m, rest_edge_m: (n,) distances of the boxes' loads, in the plan and at rest, m; None if they are not
            stored.
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
    """A ``KnifeEdge`` for each box, with the distance of the box's load from the edge. Boxes whose distance is unknown
    (NaN) are left out."""
    for box in np.flatnonzero(~np.isnan(edge_m)).tolist():
        yield KnifeEdge(float(edge_m[box]), box, when, own_weight=own_weight)


def nearest_edge(edges: Iterable[KnifeEdge], verdict: Verdict | None = None) -> KnifeEdge | None:
    """The load that is nearest to an edge, on either side; None if there is no load.

    Args:
        verdict: if given, only loads that set the flag of a world with this verdict are considered.
    """
    return min(
        (edge for edge in edges if verdict is None or _edge_sets_flag(edge, verdict)),
        key=lambda edge: abs(edge.edge_m),
        default=None,
    )


def sets_flag(edge_m: FloatArray, verdict: Verdict | None, *, rounding_m: float = 0.0) -> NDArray[np.bool_]:
    """(…) whether loads at these distances from edges set the flag ``knife-edge``. A load within ``KNIFE_EDGE_M`` of an
    edge sets the flag. A load within ``NEAR_M`` sets the flag only on the side that contradicts the verdict: beyond the
    edge in a stable world, inside in an unstable world. NaN does not set the flag.

    Args:
        verdict: verdict of the world. If ``verdict`` is None, only ``KNIFE_EDGE_M`` is used.
        rounding_m: largest rounding error of the distances, m. Both limits, ``KNIFE_EDGE_M`` and ``NEAR_M``, are
            increased by the rounding error.
    """
    away_m = np.abs(edge_m) - rounding_m
    is_near = away_m <= KNIFE_EDGE_M
    if verdict is None:
        return is_near
    contradicts = (edge_m < 0) if verdict is Verdict.STABLE else (edge_m >= 0)
    return is_near | (contradicts & (away_m <= NEAR_M))


def _edge_sets_flag(edge: KnifeEdge, verdict: Verdict) -> bool:
    """Whether the load of ``edge`` sets the flag of a world with this verdict. For loads at rest, only the limit
    ``KNIFE_EDGE_M`` applies."""
    side = None if edge.when == AT_REST else verdict
    return bool(sets_flag(np.array([edge.edge_m]), side, rounding_m=_ROUNDING_M)[0])


def is_same_edge(edge: KnifeEdge, kept: KnifeEdge) -> bool:
    """Whether a recomputed distance equals the stored distance of the same box at the same time."""
    is_same = (edge.box, edge.when, edge.step) == (kept.box, kept.when, kept.step)
    return is_same and math.isclose(edge.edge_m, kept.edge_m, abs_tol=_SAME_M)


def _float(value: Any) -> float:
    """The value as a float; NaN for a null value."""
    try:
        return math.nan if value is None else float(value)
    except TypeError:  # the value is pandas.NA
        return math.nan


def _number(value: float) -> int:
    """The value as the number of a box; -1 for NaN."""
    return -1 if math.isnan(value) else int(value)
