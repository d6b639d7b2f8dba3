"""The limits of EUMOS 40509:2020 for a pallet after its test."""

from __future__ import annotations

from typing import Any

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.metrics.spec import DIMENSIONLESS, TEXT, BoxMetrics
from petmjx.results.schema import Param

EUMOS_PROFILE = "eumos-40509"
"""Worlds with this profile are also compared with the limits of the standard."""

EUMOS_ELASTIC_SHARE = 0.10
"""Largest displacement during the test as a share of the load's height."""
EUMOS_PERMANENT_SHARE = 0.05
"""Largest displacement left after the test as a share of the load's height."""
EUMOS_FOOT_HEIGHT_M = 0.20
EUMOS_FOOT_PERMANENT_M = 0.04
"""Largest displacement left after the test in the lowest 20 cm."""

EUMOS_COLUMNS = (
    Param("eumos_elastic_share", DIMENSIONLESS, "largest horizontal displacement during the test / load height"),
    Param("eumos_permanent_share", DIMENSIONLESS, "largest horizontal displacement left after it / load height"),
    Param("eumos_foot_permanent_m", "m", "the same, in m, among boxes that reach into the lowest 20 cm"),
    Param("eumos_passed", TEXT, "whether it stood, all limits of EUMOS 40509 hold and nothing fell", bool),
)
"""Additional columns of these worlds."""


def load_height_m(settled_pos: FloatArray, half_size: FloatArray) -> float:
    """Height of a load above the carrier's top, z = 0, from (n, 3) settled centres and half extents, m."""
    return float((settled_pos[:, 2] + half_size[:, 2]).max())


def eumos_assessment(boxes: BoxMetrics, settled_pos: FloatArray, half_size: FloatArray) -> dict[str, Any]:
    """The values of ``EUMOS_COLUMNS`` for one world after the test.

    Elastic deformation at most 10 % of the load's height during the test; permanent deformation at most 5 %
    of it, and at most 4 cm in the lowest 20 cm, after it. Displacements are those of box centres from where
    they had settled; the load's height counts from the carrier's top, z = 0. What stays is included in the elastic
    deformation, as on film the two cannot be distinguished before the end. A world in which a box fell never passes,
    however small the shares, nor does one with a NaN, because the profile never ran to its end. Source: EUMOS
    40509:2020, criteria as published by ESTL, the laboratory behind the standard.

    Args:
        settled_pos: (n, 3) centres before the profile, m.
        half_size: (n, 3) half extents, m.
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
