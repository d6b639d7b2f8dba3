"""Pushing forces: the forces with which several supports carry a box, if supports can push but not pull.

The pressure of a box on a bed of equal springs is a linear function of x and y (petmjx.world.bearings), called the
pressure plane in this module. If a load is far from the middle of the supports, this pressure is negative at the
opposite end, where springs would pull. Real supports only push. So this module computes forces that balance the load,
push, and act within their contact areas. From all forces that do so, the module chooses the forces with the least
energy of the springs (Menabrea 1858, "Nouveau principe sur la distribution des tensions dans les systèmes élastiques").
If the pressure plane is nowhere negative, its forces already have the least energy.

A contact has the force F and the moments Mx, My about the middle of its area A, whose half lengths are a and b. The
energy is

    (F² + 3 Mx²/a² + 3 My²/b²) / (2A),   with F ≥ 0, |Mx| ≤ a F and |My| ≤ b F

In the coordinates z = (F, √3 Mx/a, √3 My/b) / √A, the energy is half the squared length of z, and the constraints form
a square cone. The dual problem has three unknowns for each box: the coefficients of a pressure plane. The force at a
contact is the projection of this plane onto the contact's cone. The dual function is piecewise quadratic, and Newton's
method finds its minimum.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.world.rectangle_hulls import HullTable

IntArray = NDArray[np.intp]

PULL: Final = 1e-9
"""Tolerance for rounding errors: a support may pull with this share of the load, and its force may act this distance
outside its area, m. A support whose force pulls more, or acts farther outside, counts as pulling."""

ON_EDGE_M: Final = 1e-6
"""Distance from an edge of the supports' convex hull, m, within which a load counts as on the edge. A load on an edge
is treated separately (``on_edges``), since the linear pressure that balances the load would be infinitely steep."""

_ROOT: Final = math.sqrt(3.0)
_MOST_STEPS: Final = 60
_MOST_HALVINGS: Final = 30
_EXACT: Final = 1e-11
_ENOUGH: Final = 1e-8
"""Tolerances of forces, as shares of the load, and of moments, as shares of load × half extent of the supports.
Newton's method ends when errors are below ``_EXACT``. The method also ends if errors are below ``_ENOUGH`` and no
longer shrink to half in a step, because very near an edge, rounding prevents better results."""

_RIDGE: Final = 1e-13
"""In Newton's method, this number × (1 + trace) is added to the diagonal of the matrix of second derivatives. Without
the added term, the matrix would be singular if only one corner carries load."""


def pulls(force: FloatArray, low: FloatArray, high: FloatArray, load: FloatArray) -> NDArray[np.bool_]:
    """(c,) whether the force at each contact pulls, or acts outside the contact's area.

    Args:
        force: (c, 3) force at each contact, and the force's first moments along x and y (force × coordinate).
        low, high: (c, 2) lowest and highest corners (x, y) of the contacts' areas, m.
        load: (c,) load of the box above each contact: the box's own weight plus the weight that rests on it.
    """
    slack = -PULL * np.abs(load)
    least = np.minimum(force[:, 1:] - low * force[:, :1], high * force[:, :1] - force[:, 1:])
    pulled: NDArray[np.bool_] = (force[:, 0] < slack) | (np.minimum(least[:, 0], least[:, 1]) < slack)
    return pulled


def pushes(load: FloatArray, owner: IntArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """(c, 3) pushing forces at contacts, and their first moments along x and y, that balance p loads with the least
    energy of the springs. Each load must be within the convex hull of its contacts.

    Args:
        load: (p, 3) load of each box: force, and first moments along x and y (force × coordinate).
        owner: (c,) number of the load on each contact, in ascending order. Each load has at least one contact.
        low, high: (c, 2) lowest and highest corners (x, y) of the contacts' areas, m.
    """
    begins = np.flatnonzero(np.diff(owner, prepend=-1))
    around_low, around_high = np.minimum.reduceat(low, begins), np.maximum.reduceat(high, begins)
    origin, scale = (around_low + around_high) / 2, (around_high - around_low) / 2
    middle = ((low + high) / 2 - origin[owner]) / scale[owner]
    half = (high - low) / 2 / scale[owner]
    area = half.prod(axis=1)
    root = np.sqrt(area / np.add.reduceat(area, begins)[owner])
    to_cone = np.zeros((len(owner), 3, 3))
    to_cone[:, 0, 0] = root
    to_cone[:, 0, 1:] = root[:, None] * middle
    to_cone[:, [1, 2], [1, 2]] = root[:, None] * half / _ROOT
    unit_loads = np.concatenate([np.ones((len(load), 1)), (load[:, 1:] / load[:, :1] - origin) / scale], axis=1)
    force: FloatArray = np.einsum("cji,cj->ci", to_cone, _projected_planes(to_cone, owner, begins, unit_loads))
    force[:, 1:] = origin[owner] * force[:, :1] + scale[owner] * force[:, 1:]
    force *= load[owner, :1]
    return force


def _projected_planes(to_cone: FloatArray, owner: IntArray, begins: IntArray, unit_loads: FloatArray) -> FloatArray:
    """(c, 3) forces at contacts in the coordinates z of this module's docstring.

    For each box, this function searches for a pressure plane. The projections of the plane onto the cones of the box's
    contacts are the forces at the contacts, and these forces must balance the box's load.
    """

    def energy(plane: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        projected, slope = _cone_projection(np.einsum("cij,cj->ci", to_cone, plane[owner]))
        value = np.add.reduceat((projected**2).sum(axis=1), begins) / 2 - (plane * unit_loads).sum(axis=1)
        return value, projected, slope

    second = np.add.reduceat(np.einsum("cki,ckj->cij", to_cone, to_cone), begins)
    plane: FloatArray = np.asarray(np.linalg.solve(second, unit_loads[..., None])[..., 0], np.float64)
    value, projected, slope = energy(plane)
    before, goes_on = np.full(len(plane), np.inf), np.ones(len(plane), bool)
    for _ in range(_MOST_STEPS):
        residual = np.add.reduceat(np.einsum("cji,cj->ci", to_cone, projected), begins) - unit_loads
        off = np.abs(residual).max(axis=1)
        # the iteration for a box ends independently of other boxes, so that the forces do not depend on other boxes
        goes_on &= ~((off <= _EXACT) | ((before / 2 <= off) & (off <= _ENOUGH)))
        if not goes_on.any():
            break
        before = off
        second = np.add.reduceat(np.einsum("cki,ckl,clj->cij", to_cone, slope, to_cone), begins)
        second.reshape(-1, 9)[:, ::4] += _RIDGE * (1 + np.trace(second, axis1=1, axis2=2))[:, None]
        step: FloatArray = np.asarray(-np.linalg.solve(second, residual[..., None])[..., 0], np.float64)
        fall = (step * residual).sum(axis=1)
        share = goes_on.astype(float)
        for _ in range(_MOST_HALVINGS):
            further = plane + share[:, None] * step
            new, new_projected, new_slope = energy(further)
            worse = goes_on & (new > value + 1e-4 * share * fall + 1e-15 * np.abs(value))
            if not worse.any():
                break
            share[worse] /= 2
        plane, value, projected, slope = further, new, new_projected, new_slope
    return projected


def _cone_projection(point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two arrays for the given points: (c, 3) the nearest point of the cone |z₁|, |z₂| ≤ √3 z₀, and (c, 3, 3) the
    derivative of the nearest point with respect to the given point."""
    size, height = np.abs(point[:, 1:]), point[:, 0]
    first_is_large = size[:, 0] >= size[:, 1]
    large, small = np.maximum(size[:, 0], size[:, 1]), np.minimum(size[:, 0], size[:, 1])
    on_face = (height + _ROOT * large) / 4
    on_ridge = (height + _ROOT * (large + small)) / 7
    inside = _ROOT * height >= large
    face = ~inside & (_ROOT * on_face >= small)
    ridge = ~(inside | face) & (on_ridge > 0)
    # ``stays``: which coordinates the projection leaves unchanged. A point inside the cone keeps all coordinates. A
    # point that is projected onto a face keeps only the smaller one of z₁ and z₂.
    stays = np.stack([inside, inside | (face & ~first_is_large), inside | (face & first_is_large)], axis=1)
    towards = np.where(point < 0, -_ROOT, _ROOT)
    towards[:, 0] = 1.0
    towards[stays | ~(face | ridge)[:, None]] = 0.0
    slope = towards[:, :, None] * towards[:, None, :]
    slope /= np.where(face, 4.0, 7.0)[:, None, None]
    diagonal = slope.reshape(-1, 9)[:, ::4]
    diagonal[stays] = 1.0
    nearest = np.where(stays, point, np.where(face, on_face, on_ridge)[:, None] * towards)
    return nearest, slope


def on_edges(
    load: FloatArray, owner: IntArray, low: FloatArray, high: FloatArray, hulls: HullTable, hull: IntArray
) -> FloatArray:
    """(c, 3) force at each contact, and the force's first moments along x and y (force × coordinate). Each load must
    act on or beyond an edge of the convex hull of the contacts that carry the load.

    Only the two outermost corners on the nearest edge carry the load, as if the box began to tip over.

    Args:
        load, owner, low, high: as in ``pushes``.
        hulls: the convex hulls of the boxes' contacts.
        hull: (p,) number in ``hulls`` of each load's hull.
    """
    point = load[:, 1:] / load[:, :1]
    nearest = hulls.distances_m(hull, point).argmin(axis=1)
    normal, offset = hulls.normal[hull, nearest], hulls.offset[hull, nearest]
    x = np.stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0]], axis=1).ravel()
    y = np.stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1]], axis=1).ravel()
    of_corner = np.repeat(owner, 4)
    begins = np.flatnonzero(np.diff(of_corner, prepend=-1))
    inside = normal[of_corner, 0] * x + normal[of_corner, 1] * y - offset[of_corner]
    along = -normal[of_corner, 1] * x + normal[of_corner, 0] * y
    on_it = inside <= (np.minimum.reduceat(inside, begins) + PULL)[of_corner]
    places = []
    for sign in (1.0, -1.0):
        outermost = np.where(on_it, sign * along, np.inf)
        places.append(np.lexsort((outermost, of_corner))[begins])
    first, last = places
    length = along[last] - along[first]
    place = -normal[:, 1] * point[:, 0] + normal[:, 0] * point[:, 1] - along[first]
    share = np.clip(place / np.where(length > 0, length, 1.0), 0.0, 1.0)
    forces = np.zeros((len(owner), 3))
    for corner, part in ((first, 1 - share), (last, share)):
        force = part * load[:, 0]
        np.add.at(forces, corner // 4, np.stack([force, force * x[corner], force * y[corner]], axis=1))
    return forces
