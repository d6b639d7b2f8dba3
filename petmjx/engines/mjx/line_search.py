"""MJX's solver for elliptic cones, with a line search that does not stop because of rounding."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from petmjx.engines.mjx.mjx_import import mjx

_ROUNDED: Final = 8 * float(np.finfo(np.float32).eps)
"""Relative accuracy of a sum of squares in float32, as a share of its terms."""


def solve(model: Any, data: Any) -> Any:
    """``mjx.solve`` with this line search.

    Along a search direction v from u, the square of a contact's tangential force is u² + α·(2·u·v + α·v²). MJX (3.17:
    mujoco/mjx/_src/solver.py, ``_LSPoint``) computes the root of this expression. If friction should vanish, as under a
    box that lands flat, a Newton step has v = −u, and in float32 the square is slightly negative at the end of the
    step. Then cost and slope are NaN, the search finds no better point, and the solver stops with an arbitrary force.
    So u² is raised here until the square is not negative. The change is smaller than float32's rounding error.

    Args:
        model: the MJX model of one world.
        data: its data, ready for the solver.
    """
    with _real_roots():
        return mjx.solve(model, data)


@contextmanager
def _real_roots() -> Iterator[None]:
    """A context. In programs that are traced inside it, the roots in the points of the line search are real numbers."""
    point = _point_class()
    original, descriptor = point.create, vars(point)["create"]

    def create(model: Any, data: Any, context: Any, alpha: jax.Array, *terms: Any) -> Any:
        *others, uu, v0, uv, vv = terms
        uu = jnp.maximum(uu, -(1 + _ROUNDED) * alpha * (2 * uv + alpha * vv))
        return original(model, data, context, alpha, *others, uu, v0, uv, vv)

    point.create = staticmethod(create)
    try:
        yield
    finally:
        point.create = descriptor


def _point_class() -> Any:
    from mujoco.mjx._src import solver

    return solver._LSPoint
