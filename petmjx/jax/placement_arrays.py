"""The results of placements on simulated pallets, as a pytree of arrays."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from petmjx.engines.verdict import Reason
from petmjx.loop.placement_results import PlacementResults as HostResults

ENDED: Final = "ended"
REASONS: Final = (*(str(reason) for reason in Reason), ENDED)
"""The meanings of the numbers in ``PlacementArrays.reason``. The number 0 means that the pallet stands. "ended" means
that nothing was placed."""


class PlacementArrays(NamedTuple):
    """The results of m placements on pallets of at most k boxes. In arrays over boxes, entries after a pallet's last
    box are 0.

    Attributes: as in ``petmjx.PlacementResults``, except that ``reason`` is an index into ``REASONS``, and ``margin``
    is -1 if the simulation is invalid.
    """

    stable: Bool[Array, " placement"]
    reason: Int[Array, " placement"]
    culprit: Int[Array, " placement"]
    margin: Float[Array, " placement"]
    shift_mm: Float[Array, " placement"]
    tilt_deg: Float[Array, " placement"]
    n_boxes: Int[Array, " placement"]
    ended: Bool[Array, " placement"]
    top_force_n: Float[Array, "placement box"]
    middle_mm: Float[Array, "placement box 3"]


def shapes(m: int, k: int) -> list[tuple[tuple[int, ...], type[Any]]]:
    """The shape and the type of each field of ``PlacementArrays``."""
    one = [((m,), kind) for kind in (bool, np.int32, np.int32, *(np.float32,) * 3, np.int32, bool)]
    return [*one, ((m, k), np.float32), ((m, k, 3), np.float32)]


def empty_results(m: int, k: int) -> list[NDArray[Any]]:
    """The results of m requests, none of which placed a box, as a list of arrays: the reason is ``ended``, and numbers
    are 0 or -1."""
    columns: list[NDArray[Any]] = [np.zeros(shape, kind) for shape, kind in shapes(m, k)]
    columns[1][:], columns[2][:], columns[3][:], columns[7][:] = REASONS.index(ENDED), -1, -1.0, True
    return columns


def write_results(into: list[NDArray[Any]], rows: NDArray[np.int64], results: HostResults) -> None:
    """Write results into these rows of the arrays ``into``."""
    k = results.top_force_n.shape[1]
    reasons = np.array([REASONS.index(reason) for reason in results.reason], np.int32)
    margin = np.nan_to_num(results.margin, nan=-1.0)
    one = (
        results.stable,
        reasons,
        results.culprit,
        margin,
        results.shift_mm,
        results.tilt_deg,
        results.n_boxes,
        results.ended,
    )
    for table, values in zip(into, one, strict=False):
        table[rows] = values
    into[8][rows, :k], into[9][rows, :k] = np.nan_to_num(results.top_force_n), np.nan_to_num(results.middle_mm)
