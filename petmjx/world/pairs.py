"""Friction by pairs: which coefficient counts between two shapes, where it is not the larger one of the two.

Shapes have surfaces, numbered from 1; a table has the coefficient of sliding friction of each pair of surfaces. Surface
0 is that of all shapes of which nothing is said, and of the floor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from petmjx.units import FloatArray

if TYPE_CHECKING:
    from petmjx.world.scene import Scene

MOST_SURFACES: Final = 16
"""Rows of a world's table on devices, surface 0 included."""

LARGER: Final = -1.0
"""In place of a coefficient: the larger one of the two shapes counts, as everywhere in MuJoCo."""


def no_pairs(n_surfaces: int = MOST_SURFACES) -> FloatArray:
    """(k, k) a table that says nothing."""
    return np.full((n_surfaces, n_surfaces), LARGER)


def scaled_pairs(scene: Scene, box_factor: float, carrier_factor: float) -> FloatArray | None:
    """(k, k) a scene's table with other friction of boxes and carrier.

    Between two the larger factor counts, as the larger coefficient does where nothing is said of a pair.
    """
    table = scene.pair_friction
    if table is None:
        return None
    factor = np.full(len(table), box_factor)
    if scene.carrier.surface is not None:
        factor[scene.carrier.surface] = carrier_factor
    return np.where(table == LARGER, LARGER, table * np.maximum.outer(factor, factor))


def pair_table(scene: Scene) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``) a scene's table, filled up.

    Raises:
        ValueError: it has more surfaces.
    """
    table = no_pairs()
    if scene.pair_friction is not None:
        if len(scene.pair_friction) > MOST_SURFACES:
            raise ValueError(f"at most {MOST_SURFACES - 1} surfaces, got {len(scene.pair_friction) - 1}")
        k = len(scene.pair_friction)
        table[:k, :k] = scene.pair_friction
    return table
