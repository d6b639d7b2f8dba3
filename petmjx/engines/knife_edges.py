"""Finds the box that sets a world's flag ``knife-edge``, from the distances stored for the world."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict

KNIFE_EDGE_M: Final = 0.0005
"""A load nearer to an edge than this sets the flag, m. Plans have whole millimetres, and boxes are smaller than planned
by a tenth of a millimetre. In all verdicts that other simulators disputed, the centre of a box was nearer than this to
an edge (docs/validation.md)."""

NEAR_M: Final = 0.001
"""A load nearer to an edge than this sets the flag, too, if the verdict contradicts statics, m: the world stands with
the load beyond the edge, or falls with the load inside. (Small worlds whose boxes fall are also simulated again with
stiffer contacts: petmjx.engines.contact_tilt.)"""

_ROUNDING_M: Final = 1e-9
"""Rounding error of tables, m: they store distances of a millimetre as float32."""

_SAME_M: Final = 1e-6
"""Tolerance for equal distances, m: tables store places of boxes as float32, too."""

BY_PLAN: Final = "by the plan"
AT_REST: Final = "at rest"
WHILE_BUILT: Final = "while it is built"


class KnifeEdge(NamedTuple):
    """A load and its distance from an edge.

    Attributes:
        edge_m: distance from the edge, m; positive inside, negative beyond.
        box: the box that has the load.
        when: ``BY_PLAN``, ``AT_REST`` or ``WHILE_BUILT``.
        step: for ``WHILE_BUILT``, the box after whose placement the load acts; else -1.
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
    """The distances of loads from edges that a run stores for a world.

    Args:
        world: columns of ``worlds``, or fields of ``petmjx.engines.verdict.Outcome``.
        plan_edge_m, rest_edge_m: (n,) distances of the boxes' loads, m; None: they are not stored.
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
    """The distances of the boxes' loads, except unknown (NaN) ones."""
    for box in np.flatnonzero(~np.isnan(edge_m)).tolist():
        yield KnifeEdge(float(edge_m[box]), box, when, own_weight=own_weight)


def nearest_edge(edges: Iterable[KnifeEdge], verdict: Verdict | None = None) -> KnifeEdge | None:
    """The load that is nearest to an edge, on either side; None: there is no load.

    Args:
        verdict: consider only loads that set the flag of a world with this verdict; None: consider all loads.
    """
    return min(
        (edge for edge in edges if verdict is None or _edge_sets_flag(edge, verdict)),
        key=lambda edge: abs(edge.edge_m),
        default=None,
    )


def sets_flag(edge_m: FloatArray, verdict: Verdict | None, *, rounding_m: float = 0.0) -> NDArray[np.bool_]:
    """(…) whether loads at these distances from edges set the flag. A load near an edge sets the flag. A load a little
    farther from an edge sets the flag only if it is on the side that the verdict contradicts. NaN does not set the
    flag.

    Args:
        verdict: verdict of the world; None: the side does not count.
        rounding_m: largest error of the distances, m; the limit of near distances is larger by this amount.
    """
    away_m = np.abs(edge_m) - rounding_m
    is_near = away_m <= KNIFE_EDGE_M
    if verdict is None:
        return is_near
    contradicts = (edge_m < 0) if verdict is Verdict.STABLE else (edge_m >= 0)
    return is_near | (contradicts & (away_m <= NEAR_M))


def _edge_sets_flag(edge: KnifeEdge, verdict: Verdict) -> bool:
    """Whether a load whose distance a table stores sets the flag. At rest, the side does not count."""
    side = None if edge.when == AT_REST else verdict
    return bool(sets_flag(np.array([edge.edge_m]), side, rounding_m=_ROUNDING_M)[0])


def is_same_edge(edge: KnifeEdge, kept: KnifeEdge) -> bool:
    """Whether a recomputed distance equals the one that tables store for the same box at the same time."""
    is_same = (edge.box, edge.when, edge.step) == (kept.box, kept.when, kept.step)
    return is_same and math.isclose(edge.edge_m, kept.edge_m, abs_tol=_SAME_M)


def _float(value: Any) -> float:
    """The number as float; NaN if it is null."""
    try:
        return math.nan if value is None else float(value)
    except TypeError:  # the value is pandas.NA
        return math.nan


def _number(value: float) -> int:
    """The number as the number of a box; -1 for NaN."""
    return -1 if math.isnan(value) else int(value)
