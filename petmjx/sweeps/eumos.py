"""EUMOS 40509:2020's own limits for a pallet that has been through its test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from petmjx.metrics.spec import DIMENSIONLESS, TEXT
from petmjx.results.schema import Param
from petmjx.units import FloatArray
from petmjx.verdict import BoxMetrics

EUMOS_PROFILE = "eumos-40509"
"""The profile whose worlds are also held against the standard's own limits."""

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
"""Columns that its worlds have in addition."""


@dataclass(frozen=True)
class EumosAssessment:
    """EUMOS 40509:2020's criteria for one world, beside petmjx's own thresholds.

    Attributes:
        load_height_m: top of the settled load above the carrier.
        elastic_share: largest horizontal displacement of a box during the test ÷ load height; the part that
            stays is included, as on film the two cannot be told apart until the end.
        permanent_share: largest horizontal displacement left ÷ load height.
        foot_permanent_m: the same in metres, among boxes that reach into the lowest 20 cm; 0 if there is none.
        dropped: whether a box fell; no standard accepts that, however small the shares.
    """

    load_height_m: float
    elastic_share: float
    permanent_share: float
    foot_permanent_m: float
    dropped: bool

    @property
    def elastic_ok(self) -> bool:
        return self.elastic_share <= EUMOS_ELASTIC_SHARE

    @property
    def permanent_ok(self) -> bool:
        return self.permanent_share <= EUMOS_PERMANENT_SHARE and self.foot_permanent_m <= EUMOS_FOOT_PERMANENT_M

    @property
    def passed(self) -> bool:
        """False too where a figure is NaN, because the profile never ran to its end."""
        return self.elastic_ok and self.permanent_ok and not self.dropped

    def columns(self) -> dict[str, Any]:
        """The values of ``EUMOS_COLUMNS``."""
        values = (self.elastic_share, self.permanent_share, self.foot_permanent_m, self.passed)
        return dict(zip((column.name for column in EUMOS_COLUMNS), values, strict=True))


def eumos_assessment(boxes: BoxMetrics, settled_pos: FloatArray, half_size: FloatArray) -> EumosAssessment:
    """Apply EUMOS 40509:2020's limits to one world that has been through the test.

    Elastic deformation at most 10 % of the load's height during the test; permanent deformation at most 5 %
    of it, and at most 4 cm in the lowest 20 cm, after it. Displacements are those of box centres from where
    they had settled; the load's height counts from the carrier's top, z = 0. Source: EUMOS 40509:2020,
    criteria as published by ESTL, the laboratory behind the standard.

    Args:
        settled_pos: (n, 3) centres before the profile, m.
        half_size: (n, 3) half extents, m.
    """
    bottom = settled_pos[:, 2] - half_size[:, 2]
    height = float((settled_pos[:, 2] + half_size[:, 2]).max())
    permanent = np.linalg.norm(boxes.pos[:, :2] - settled_pos[:, :2], axis=1)
    foot = bottom < EUMOS_FOOT_HEIGHT_M
    return EumosAssessment(
        load_height_m=height,
        elastic_share=float(np.max(boxes.max_sway_m)) / height,
        permanent_share=float(permanent.max()) / height,
        foot_permanent_m=float(permanent[foot].max(initial=0.0)),
        dropped=bool(boxes.dropped.any()),
    )
