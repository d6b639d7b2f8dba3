"""The limits of EUMOS 40509:2020, a standard for transport tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import DIMENSIONLESS, TEXT, BoxMetrics
from petmjx.results.schema import Param

EUMOS_PROFILE = "eumos-40509"
"""Name of the profile of EUMOS 40509. Worlds with this profile are also checked against the limits of the standard."""

EUMOS_ELASTIC_SHARE = 0.10
"""Largest allowed displacement during the test, as a share of the height of the load."""
EUMOS_PERMANENT_SHARE = 0.05
"""Largest allowed displacement that remains after the test, as a share of the height of the load."""
EUMOS_FOOT_HEIGHT_M = 0.20
EUMOS_FOOT_PERMANENT_M = 0.04
"""Largest allowed lasting displacement in the lowest 20 cm of the load, measured after the test, m."""

EUMOS_COLUMNS = (
    Param(
        "eumos_elastic_share",
        DIMENSIONLESS,
        "largest horizontal displacement of a box during the test / height of the load",
    ),
    Param(
        "eumos_permanent_share",
        DIMENSIONLESS,
        "largest horizontal displacement of a box that remains after the test / height of the load",
    ),
    Param(
        "eumos_foot_permanent_m",
        "m",
        "among the boxes that reach into the lowest 20 cm of the load: largest horizontal displacement that "
        "remains after the test",
    ),
    Param(
        "eumos_passed",
        TEXT,
        "whether the pallet stood before the test, kept all limits of EUMOS 40509, and lost no box",
        bool,
    ),
)
"""Additional columns for worlds that are shaken by the profile of EUMOS 40509."""


def load_height_m(settled_pos: FloatArray, half_size: FloatArray) -> float:
    """Height of a load above the carrier's top (z = 0), m. The arguments are arrays (n, 3): the centres of the n boxes
    at rest, m, and half of the boxes' extents, m."""
    return float((settled_pos[:, 2] + half_size[:, 2]).max())


def eumos_assessment(boxes: BoxMetrics, settled_pos: FloatArray, half_size: FloatArray) -> dict[str, Any]:
    """The values of ``EUMOS_COLUMNS`` for one world after the test.

    The standard allows an elastic deformation of at most 10 % of the load's height during the test. After the test, the
    permanent deformation may be at most 5 % of the load's height, and at most 4 cm in the lowest 20 cm. Displacements
    are measured from the settled positions of box centres. The load's height is measured from the carrier's top, z = 0.
    The elastic deformation here includes the permanent deformation, since in a video of a test, the two can be
    distinguished only after the test.

    A world in which a box fell never passes, even if its deformations are small. A world with a deformation of NaN
    never passes either, since its profile did not run to the end. Source: EUMOS 40509:2020, criteria as published by
    ESTL, the laboratory behind the standard.

    Args:
        settled_pos: (n, 3) centres of the boxes before the profile, m.
        half_size: (n, 3) half extents of the boxes, m.
    """
    bottom = settled_pos[:, 2] - half_size[:, 2]
    height = load_height_m(settled_pos, half_size)
    permanent = np.linalg.norm(boxes.pos[:, :2] - settled_pos[:, :2], axis=1)
    elastic_share = float(np.max(boxes.max_sway_m)) / height
    permanent_share = float(permanent.max()) / height
    foot_permanent_m = float(permanent[bottom < EUMOS_FOOT_HEIGHT_M].max(initial=0.0))
    passed = (
        elastic_share <= EUMOS_ELASTIC_SHARE
        and permanent_share <= EUMOS_PERMANENT_SHARE
        and foot_permanent_m <= EUMOS_FOOT_PERMANENT_M
        and not bool(boxes.dropped.any())
    )
    values = (elastic_share, permanent_share, foot_permanent_m, passed)
    return dict(zip((column.name for column in EUMOS_COLUMNS), values, strict=True))
