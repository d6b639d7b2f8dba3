"""Where boxes meet: what two of them share along an axis, and whether one's top is at the other's bottom.

Callers that ask what lies on what add their own conditions: the order of placement, the carrier, or a least width.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray


def shared(low: FloatArray, high: FloatArray) -> FloatArray:
    """(…, n, n) length that two boxes share along an axis, from their (…, n) ends there; negative where they are
    apart."""
    ends, begins = np.minimum(high[..., :, None], high[..., None, :]), np.maximum(low[..., :, None], low[..., None, :])
    length: FloatArray = ends - begins
    return length


def meets(low: FloatArray, high: FloatArray, tolerance: float, most_gap: float | None = None) -> NDArray[np.bool_]:
    """(…, n, n): whether the upper end of the row's box is at the lower end of the column's, within the tolerance; or
    no further below it than ``most_gap``."""
    over = high[..., :, None] - low[..., None, :]
    touching: NDArray[np.bool_] = (over <= tolerance) & (over >= -(tolerance if most_gap is None else most_gap))
    return touching
