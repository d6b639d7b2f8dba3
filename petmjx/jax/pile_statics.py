"""Static balance of a pile of boxes, as an array program in JAX. The method is as in ``petmjx.packers.pile_balance``,
but in single precision; the docstring of that module names the sources.

A load is a vector (F, F·x, F·y) in kg and kg·m, where F acts at (x, y). A box presses on the boxes below it with a
pressure that is a linear function of x and y. The pressure is linear in the load on the box. So for each pair of boxes,
a 3 × 3 matrix turns the load on the upper box into the part of this load that reaches the lower box. The matrices are
stored, so adding a box to the pile needs only one product of matrices.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from petmjx.common.units import MM_PER_M
from petmjx.jax.free_cells import TOUCH_MM, Pile
from petmjx.packers.pile_balance import FAR_M, MARGIN_SHARE

_ANGLES: Final = np.arange(32) * (2 * np.pi / 32)
"""Directions in which the corners of a hull are searched for. For each direction, the corner of the hull that reaches
farthest in this direction is computed. All other corners are ignored, so a computed hull may be too small, but never
too large."""

_NO_EDGE: Final = -1e3
"""Offset of an edge that does not exist, m. With so large an offset, every load lies far inside the edge."""

_EXACT: Final = jax.lax.Precision.HIGHEST
"""Precision of matrix products. With JAX's default precision, GPUs round the factors to 10 bits."""

Planes = Float[Array, "*rows 32 3"]
"""Edges of hulls. An edge is stored as (d, n_x, n_y): a point p lies outside the edge by the distance d + n · p."""


class Statics(NamedTuple):
    """The balance of a pile of at most k boxes.

    Attributes:
        load: (k, 3) load of each box: its own weight and all loads from above.
        passed: (k, k, 3, 3) matrices that compute, from a load on each box, the load that reaches each box below.
        planes: (k, 32, 3) edges of the hull of each box's contacts.
        least: (k,) how far inside the hull of its contacts the load of each box must act, m.
    """

    load: Float[Array, "box 3"]
    passed: Float[Array, "box box 3 3"]
    planes: Float[Array, "box 32 3"]
    least: Float[Array, " box"]


class Contacts(NamedTuple):
    """The contacts of q boxes with a pile of k boxes. Lengths are in metres. Coordinates are relative to the middle of
    each box's base, except the coordinates of ``middle``.

    Attributes:
        middle: (q, 2) the middle of each box's base.
        start, end: (q, k, 2) lowest and highest x and y of the rectangle in which a box overlaps each box of the pile.
        bears: (q, k) whether the box lies on each box of the pile.
        on_carrier: (q,) whether the box stands on the carrier.
        support: (q,) supported share of the box's base.
    """

    middle: Float[Array, "placement 2"]
    start: Float[Array, "placement box 2"]
    end: Float[Array, "placement box 2"]
    bears: Bool[Array, "placement box"]
    on_carrier: Bool[Array, " placement"]
    support: Float[Array, " placement"]


def no_boxes(most: int) -> Statics:
    """The balance of an empty pile, with room for ``most`` boxes."""
    planes = jnp.tile(jnp.array([_NO_EDGE, 0.0, 0.0]), (most, len(_ANGLES), 1))
    return Statics(jnp.zeros((most, 3)), jnp.zeros((most, most, 3, 3)), planes, jnp.zeros(most))


def contacts_of(size_mm: Float[Array, "placement 3"], corner_mm: Float[Array, "placement 3"], pile: Pile) -> Contacts:
    """The contacts of boxes with a pile. Each box is treated as if it were the only new box on the pile."""
    low, high = corner_mm[:, None, :2], (corner_mm + size_mm)[:, None, :2]
    ends = pile.corner_mm + pile.size_mm
    start = jnp.maximum(low, pile.corner_mm[None, :, :2])
    end = jnp.minimum(high, ends[None, :, :2])
    level = jnp.abs(ends[None, :, 2] - corner_mm[:, 2:]) <= TOUCH_MM
    bears = (end - start > TOUCH_MM).all(axis=2) & level & pile.present[None]
    on_carrier = corner_mm[:, 2] <= TOUCH_MM
    area = jnp.where(bears, (end - start).prod(axis=2), 0.0).sum(axis=1)
    support = jnp.where(on_carrier, 1.0, area / jnp.maximum(size_mm[:, :2].prod(axis=1), 1.0))
    middle = (low + high) / 2
    start, end = (start - middle) / MM_PER_M, (end - middle) / MM_PER_M
    return Contacts(middle[:, 0] / MM_PER_M, start, end, bears, on_carrier, support)


def hull_planes(contacts: Contacts) -> Planes:
    """(q, 32, 3) the edges of the hull of each box's contacts, relative to the middle of the box's base. A box that
    stands on the carrier gets no edges (their offset is ``_NO_EDGE``), since it cannot tip."""
    x, y = (jnp.asarray(values, jnp.float32)[None, None] for values in (np.cos(_ANGLES), np.sin(_ANGLES)))
    # (q, k, 32): the corner of each contact that reaches farthest in each direction
    at_x = jnp.where(x > 0, contacts.end[..., :1], contacts.start[..., :1])
    at_y = jnp.where(y > 0, contacts.end[..., 1:], contacts.start[..., 1:])
    reach = jnp.where(contacts.bears[..., None], at_x * x + at_y * y, -jnp.inf)
    farthest = reach.argmax(axis=1, keepdims=True)
    at_x, at_y = (jnp.take_along_axis(values, farthest, axis=1)[:, 0] for values in (at_x, at_y))
    along_x, along_y = jnp.roll(at_x, -1, axis=1) - at_x, jnp.roll(at_y, -1, axis=1) - at_y
    length = jnp.hypot(along_x, along_y)  # the corners are in anticlockwise order, so the outside is on the right
    is_edge = (length > TOUCH_MM / MM_PER_M) & contacts.bears.any(axis=1)[:, None] & ~contacts.on_carrier[:, None]
    along_x, along_y = (jnp.where(is_edge, along / jnp.maximum(length, 1e-9), 0.0) for along in (along_x, along_y))
    offset = jnp.where(is_edge, -along_y * at_x + along_x * at_y, _NO_EDGE)
    return jnp.stack([offset, along_y, -along_x], axis=-1)


def margins_m(
    statics: Statics, contacts: Contacts, planes: Planes, mass_kg: Float[Array, ""]
) -> tuple[Float[Array, " placement"], Float[Array, " placement"], Bool[Array, " placement"]]:
    """Three arrays (q,), with a value for each of q boxes that might be put onto the pile. The first array has the
    distance by which the box's weight would act inside the hull of the box's contacts, m. The second array has the
    smallest distance, m, by which the load of any box of the pile would act inside the hull of that box's contacts.
    This distance is ``FAR_M`` if the new box stands on the carrier. The third array tells whether the load of each box
    of the pile would act inside that box's hull by at least ``Statics.least``. A distance above ``FAR_M`` is replaced
    by ``FAR_M``."""
    floats = ~contacts.bears.any(axis=1) & ~contacts.on_carrier
    inside = jnp.where(floats, -FAR_M, -planes[..., 0].max(axis=1))
    moments, inverse = _moments(contacts)
    # (q, k, 3): the load on each box of the pile, first relative to the middle of the new box's base, then relative to
    # the origin
    share = jnp.einsum("qkxy,qy->qkx", moments, inverse[:, :, 0] * mass_kg, precision=_EXACT)
    share = jnp.concatenate([share[..., :1], share[..., 1:] + share[..., :1] * contacts.middle[:, None]], axis=-1)
    after = statics.load[None] + jnp.einsum("jbxy,qjy->qbx", statics.passed, share, precision=_EXACT)
    point = after[..., 1:] / jnp.maximum(after[..., :1], 1e-6)  # (q, k, 2)
    offset, x, y = jnp.moveaxis(statics.planes, -1, 0)
    beyond = (offset[None] + point[..., :1] * x[None] + point[..., 1:] * y[None]).max(axis=2)
    below = jnp.where(contacts.on_carrier, FAR_M, -beyond.max(axis=1))
    far_enough = contacts.on_carrier | (beyond <= -statics.least[None] + TOUCH_MM / MM_PER_M).all(axis=1)
    return jnp.minimum(inside, FAR_M), jnp.minimum(below, FAR_M), far_enough


def least_m(size_mm: Float[Array, "placement 3"], least_mm: float) -> Float[Array, " placement"]:
    """(q,) each box's load must act inside the hull of the box's contacts, at least this distance from the edges, m, as
    in the packer ``balanced``. The distance is ``least_mm``, or ``MARGIN_SHARE`` of the shorter side of the box's base
    if that is less."""
    return jnp.minimum(least_mm, MARGIN_SHARE * size_mm[:, :2].min(axis=1)) / MM_PER_M


def with_box(
    statics: Statics,
    row: Array,
    contacts: Contacts,
    mass_kg: Float[Array, ""],
    least: Float[Array, ""],
) -> Statics:
    """The balance of the pile after one more box, which has the contacts ``contacts``. The values of the new box are
    stored in row ``row``. If ``row`` is beyond the last row, the box is ignored."""
    (x, y), on_carrier = contacts.middle[0], contacts.on_carrier[0]
    moments, inverse = _moments(contacts)
    # Loads are relative to the origin, but the moments of ``contacts`` are relative to the middle of the base. The
    # first matrix converts a load from the origin to the middle, and the second matrix converts it back.
    seen_there = jnp.eye(3).at[1, 0].set(-x).at[2, 0].set(-y)
    seen_here = jnp.eye(3).at[1, 0].set(x).at[2, 0].set(y)
    share = jnp.einsum("xa,kab,bc,cy->kxy", seen_here, moments[0], inverse[0], seen_there, precision=_EXACT)
    passed = jnp.einsum("jbxy,jyz->bxz", statics.passed, share, precision=_EXACT)
    passed = jnp.where(on_carrier, 0.0, passed)
    load = mass_kg * jnp.stack([jnp.float32(1.0), x, y])
    loads = statics.load + jnp.einsum("bxy,y->bx", passed, load, precision=_EXACT)
    planes = hull_planes(contacts)[0]
    # The distances d in ``planes`` are for coordinates relative to the middle of the box's base. ``offset`` has the
    # distances d for coordinates relative to the origin.
    offset = planes[:, 0] - planes[:, 1] * x - planes[:, 2] * y
    is_edge = planes[:, 0] > _NO_EDGE
    planes = jnp.stack([jnp.where(is_edge, offset, _NO_EDGE), planes[:, 1], planes[:, 2]], axis=1)
    is_in = row < len(statics.load)
    return Statics(
        load=jnp.where(is_in, loads, statics.load).at[row].set(load, mode="drop"),
        passed=statics.passed.at[row].set(passed, mode="drop").at[row, row].set(jnp.eye(3), mode="drop"),
        planes=statics.planes.at[row].set(planes, mode="drop"),
        least=statics.least.at[row].set(least, mode="drop"),
    )


def _moments(contacts: Contacts) -> tuple[Float[Array, "placement box 3 3"], Float[Array, "placement 3 3"]]:
    """The integral ∫ (1, x, y)ᵀ (1, x, y) dA over each contact of a box, and the inverse of the sum of these matrices
    over all contacts of the box. Coordinates are relative to the middle of the base. With coordinates relative to the
    middle, moments are small, so that the inverse is exact enough in single precision."""
    middle, side = (contacts.start + contacts.end) / 2, contacts.end - contacts.start
    area = jnp.where(contacts.bears, side.prod(axis=-1), 0.0)
    x, y = middle[..., 0], middle[..., 1]
    one = jnp.ones_like(x)
    xx, yy = x * x + side[..., 0] ** 2 / 12, y * y + side[..., 1] ** 2 / 12
    rows = [jnp.stack(row, axis=-1) for row in ((one, x, y), (x, xx, x * y), (y, x * y, yy))]
    moments = jnp.stack(rows, axis=-2) * area[..., None, None]
    total = moments.sum(axis=1)
    (a, b, c), (_, d, e), (_, _, f) = (jnp.moveaxis(total[:, row], -1, 0) for row in range(3))
    first = (d * f - e * e, c * e - b * f, b * e - c * d)
    scale = a * first[0] + b * first[1] + c * first[2]
    adjugate = (first, (first[1], a * f - c * c, b * c - a * e), (first[2], b * c - a * e, a * d - b * b))
    inverse = jnp.stack([jnp.stack(row, axis=-1) for row in adjugate], axis=-2)
    return moments, jnp.where(scale[:, None, None] > 0, inverse / jnp.maximum(scale, 1e-30)[:, None, None], 0.0)
