"""Finds the cells of a carrier at which a box can be placed. The module is an array program in JAX, in single precision
like all of ``petmjx.jax``."""

from __future__ import annotations

from typing import Final, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

TOUCH_MM: Final = 0.01
"""Two tops whose heights differ by less than this length count as equally high. In single precision, heights of 10 m
are exact to 0.001 mm."""

TURNS: Final = 2
"""Number of orientations of a box: as given, or turned by 90° about the vertical."""


class Pile(NamedTuple):
    """The sizes and the front-left-bottom corners of the boxes on a pallet, mm. Only rows for which ``present`` is true
    hold a box."""

    size_mm: Float[Array, "box 3"]
    corner_mm: Float[Array, "box 3"]
    present: Bool[Array, " box"]


class Ways(NamedTuple):
    """The actions for a box.

    Attributes:
        legal: (a,) whether each action is legal.
        size_mm, corner_mm: (a, 3) extents and front-left-bottom corner that the box has after each action.
        features: (a, f) features of the actions; 0 for illegal actions.
    """

    legal: Bool[Array, " action"]
    size_mm: Float[Array, "action 3"]
    corner_mm: Float[Array, "action 3"]
    features: Float[Array, "action feature"]


class Cells:
    """Actions that put a box into a cell of the carrier. The actions are numbered by orientation, then by cell along x,
    then by cell along y.

    Args:
        side_mm: side of a cell.
        least_support: smallest share of a box's base that must be supported. If ``least_support`` is None, any
            supported share is sufficient.
        gap_mm: free space between a box and its neighbours along x and y.

    Attributes:
        count: number of actions.
        features: names of the features of an action.
    """

    features: Final[tuple[str, ...]] = ()

    def __init__(
        self,
        extent_mm: tuple[float, float],
        side_mm: float,
        max_height_mm: float,
        least_support: float | None,
        gap_mm: float,
    ) -> None:
        cells = [int(np.ceil(length / side_mm - 1e-9)) for length in extent_mm]
        corners = np.indices(cells).reshape(2, -1).T * side_mm
        self._corners = jnp.asarray(np.tile(corners, (TURNS, 1)), jnp.float32)
        self._turned = jnp.repeat(jnp.array([False, True]), len(corners))
        self._extent, self._highest = jnp.asarray(extent_mm, jnp.float32), max_height_mm
        self._least, self._gap = least_support, gap_mm
        self.count = TURNS * len(corners)

    def no_boxes(self, most: int) -> None:
        """The balance of an empty pile, which is None, because this class does not need the balance."""

    def put(self, statics: None, row: Array, size_mm: Array, corner_mm: Array, mass_kg: Array, pile: Pile) -> None:
        """The balance of the pile after one more box: None, because this class does not need the balance."""

    def view(self, pile: Pile, statics: None) -> Pile:
        """The values for ``ways`` that do not depend on the next box: here, only the pile."""
        return pile

    def ways(self, pile: Pile, size_mm: Float[Array, " 3"], mass_kg: Float[Array, ""]) -> Ways:
        """The actions for a box of size ``size_mm``. If the size is 0, there are no legal actions."""
        size = jnp.where(self._turned[:, None], size_mm[jnp.array([1, 0, 2])][None], size_mm[None])
        low, high = self._corners, self._corners + size[:, :2]
        ends = pile.corner_mm + pile.size_mm
        start = jnp.maximum(low[:, None], pile.corner_mm[None, :, :2])
        side = jnp.minimum(high[:, None], ends[None, :, :2]) - start
        # the gap is part of the space that a box needs
        under = (side + self._gap > TOUCH_MM).all(axis=2) & pile.present[None]
        tops = jnp.broadcast_to(ends[None, :, 2], under.shape)
        z = jnp.where(under, tops, 0.0).max(axis=1)
        area = jnp.where(under & (side > TOUCH_MM).all(axis=2), side[..., 0] * side[..., 1], 0.0)
        carried = jnp.where(jnp.abs(tops - z[:, None]) <= TOUCH_MM, area, 0.0).sum(axis=1)
        support = jnp.where(z > 0, carried / jnp.maximum(size[:, 0] * size[:, 1], 1.0), 1.0)
        legal = (high <= self._extent[None] + TOUCH_MM).all(axis=1) & (z + size[:, 2] <= self._highest + TOUCH_MM)
        legal &= ~(self._turned & (size_mm[0] == size_mm[1])) & (size_mm[2] > 0)
        if self._least is not None:
            legal &= support >= self._least - 1e-6
        return Ways(legal, size, jnp.concatenate([self._corners, z[:, None]], axis=1), jnp.zeros((self.count, 0)))
