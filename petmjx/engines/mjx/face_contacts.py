"""Contacts of compliant boxes in MJX's data: the area in which the faces of two boxes press on one another.

This module does the same as petmjx/engines/mujoco/face_contacts.py, but shares no arithmetic with it. The face of one
box is clipped along the sides of the other face, and then to the area in which the faces press.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float

from petmjx.engines.mjx.compliance import spring_laws
from petmjx.engines.mjx.padded_template import CONTACTS_PER_PAIR, contact_geoms
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.options.physics import Physics
from petmjx.world.compliance import EDGE_SHARE, FACE_COSINE, LEAST_SHARE, OUTWARD, POINTS_PER_BED

LEAST_MOMENT_M2: Final = 1e-9
"""Smallest second moment per area, m². If the moment is smaller, the area counts as a line."""

LEAST_STEEP: Final = 1e-14
"""If the square of the slope with which the contact depth changes along a face is below this number, the depth counts
as equal everywhere on the face."""

_SIGNS: Final = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])


class Faces(NamedTuple):
    """The values of a world's geoms from which beds of springs are computed. Geom 0 is the floor.

    Attributes:
        give: area of the box's top divided by twice the box's stiffness, m³/N; 0 for rigid bodies.
        half: half extents of the shape, m; a geom is larger by its skin (contact margin).
        inverse_mass: inverse mass of the geom's body, 1/kg; 0 for bodies that do not move.
    """

    give: Float[Array, "... geom"]
    half: Float[Array, "... geom 3"]
    inverse_mass: Float[Array, "... geom"]

    @classmethod
    def of(cls, worlds: Worlds, inverse_mass: Float[Array, "world body"]) -> Faces:
        """The faces in all worlds. The floor is rigid."""
        inverse = jnp.take_along_axis(inverse_mass, worlds.shape_body, axis=1)
        return cls(
            give=jnp.pad(worlds.shape_give, ((0, 0), (1, 0))),
            half=jnp.pad(worlds.shape_half, ((0, 0), (1, 0), (0, 0))),
            inverse_mass=jnp.pad(inverse, ((0, 0), (1, 0))),
        )


class FacePressure(NamedTuple):
    """How the faces of two boxes press on one another.

    Attributes:
        flat: whether a face of one box lies against a face of the other box.
        normal: unit normal from the first box to the second.
        points, depth: contact points and their depths, m.
        area: pressed area, m².
        least: smallest area from which the stiffness is computed, m²; used instead of ``area`` if ``area`` is smaller.
    """

    flat: Bool[Array, ""]
    normal: Float[Array, 3]
    points: Float[Array, "4 3"]
    depth: Float[Array, 4]
    area: Float[Array, ""]
    least: Float[Array, ""]


class Beds:
    """Replaces contacts of two faces, at least one of which is compliant, by contact points with the force and the
    moments of a bed of springs."""

    def __init__(self, model: Any, physics: Physics) -> None:
        self._physics = physics
        pairs = contact_geoms(model)
        boxes = (np.asarray(model.geom_type)[pairs] == mujoco.mjtGeom.mjGEOM_BOX).all(axis=1)
        self._geom = pairs[boxes]
        # for each pair of boxes, the numbers of its contacts in MJX's data
        self._rows = np.arange(len(pairs) * POINTS_PER_BED).reshape(-1, POINTS_PER_BED)[boxes]
        assert POINTS_PER_BED == CONTACTS_PER_PAIR

    def pressed(self, data: Any, faces: Faces) -> Any:
        """The data of a step. Where the faces of two boxes meet and at least one box is compliant, the contacts of a
        bed of springs replace the contacts that collision detection has found."""
        contact, rows = data._impl.contact, self._rows
        one, two = self._geom.T
        place, turn = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        toward = contact.frame[rows[:, 0], 0]
        bed = jax.vmap(bed_of)(place[one], turn[one], faces.half[one], place[two], turn[two], faces.half[two], toward)
        give = faces.give[one] + faces.give[two]
        margin = contact.includemargin[rows]
        touches = (contact.dist[rows] < margin).any(axis=1)
        is_bed = (give > 0) & bed.flat & touches
        spring = jnp.maximum(bed.area, bed.least) / jnp.where(give > 0, give, 1.0) / POINTS_PER_BED
        inverse = jnp.maximum(faces.inverse_mass[one] + faces.inverse_mass[two], 1e-12)
        solref, impedance = spring_laws(self._physics, spring, inverse)
        distance = jnp.where(bed.area[:, None] > 0, margin - bed.depth, 1.0)
        frame = jnp.broadcast_to(jax.vmap(_frame_of)(bed.normal)[:, None], (*rows.shape, 3, 3))
        solref = jnp.broadcast_to(solref[:, None], (*rows.shape, 2))
        solimp = contact.solimp[rows].at[..., :2].set(impedance[:, None, None])

        def replaced(values: jax.Array, by: jax.Array) -> jax.Array:
            chosen = is_bed.reshape(-1, *(1,) * (by.ndim - 1))
            return values.at[rows].set(jnp.where(chosen, by, values[rows]))

        contact = contact.replace(
            dist=replaced(contact.dist, distance),
            pos=replaced(contact.pos, bed.points),
            frame=replaced(contact.frame, frame),
            solref=replaced(contact.solref, solref),
            solimp=replaced(contact.solimp, solimp),
        )
        return data.tree_replace({"_impl.contact": contact})


def _frame_of(normal: Float[Array, 3]) -> Float[Array, "3 3"]:
    """The frame of a contact, one axis per row, as in MuJoCo."""
    other = jnp.where(jnp.abs(normal[1]) < 0.5, jnp.array([0.0, 1.0, 0.0]), jnp.array([0.0, 0.0, 1.0]))
    one = other - normal * (normal @ other)
    one /= jnp.linalg.norm(one)
    return jnp.stack([normal, one, jnp.cross(normal, one)])


def bed_of(
    pos_a: Float[Array, 3],
    turn_a: Float[Array, "3 3"],
    half_a: Float[Array, 3],
    pos_b: Float[Array, 3],
    turn_b: Float[Array, "3 3"],
    half_b: Float[Array, 3],
    toward: Float[Array, 3],
) -> FacePressure:
    """How the faces of two boxes press on one another.

    Args:
        toward: the contact normal that MJX found, from the first box to the second.
    """
    out_a, reach_a, edges_a = _face(turn_a, half_a, toward)
    out_b, reach_b, edges_b = _face(turn_b, half_b, -toward)
    normal = out_a - out_b
    normal /= jnp.linalg.norm(normal)
    x = edges_a[0] - (edges_a[0] @ normal) * normal
    x /= jnp.linalg.norm(x)
    axes = jnp.stack([x, jnp.cross(normal, x)])
    # the origin is the middle of the second box's face
    apart = pos_a - pos_b + reach_a * out_a - reach_b * out_b
    at, sides_a, sides_b = axes @ apart, edges_a @ axes.T, edges_b @ axes.T
    around = jnp.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    corners, kept = at + around @ sides_a, jnp.ones(4, bool)
    full_area = sides_b[0, 0] * sides_b[1, 1] - sides_b[0, 1] * sides_b[1, 0]
    way = jnp.where(full_area < 0, -1.0, 1.0)
    for side, sign in ((sides_b[1], 1.0), (sides_b[1], -1.0), (sides_b[0], 1.0), (sides_b[0], -1.0)):
        across = sign * way * jnp.array([side[1], -side[0]])
        corners, kept = _cut(corners, kept, across, jnp.abs(full_area))
    rise_a, rise_b = -axes @ out_a / (out_a @ normal), -axes @ out_b / (out_b @ normal)
    slope, depth = rise_a - rise_b, apart @ normal - rise_a @ at
    common, _, _ = _moments(corners, kept)
    corners, kept = _cut(corners, kept, slope, depth)
    area, center, root = _moments(corners, kept)
    places = center + _SIGNS @ root.T
    depths = jnp.maximum(depth + places @ slope, 0.0)
    outward = jnp.clip(OUTWARD * (EDGE_SHARE * common / jnp.maximum(area, LEAST_MOMENT_M2) - 1.0), 0.0, 1.0)
    deepest = jnp.where(kept, depth + corners @ slope, 0.0).max()
    steep = jnp.maximum(slope @ slope, LEAST_STEEP)
    places = places + (outward * jnp.maximum(deepest - depths, 0.0) / steep)[:, None] * slope
    height = places @ rise_b + 0.5 * depths
    points = pos_b + reach_b * out_b + places @ axes + height[:, None] * normal
    smaller = 4.0 * jnp.minimum(_area(edges_a), _area(edges_b))
    least = jnp.maximum(EDGE_SHARE * common, LEAST_SHARE * smaller)
    return FacePressure(-(out_a @ out_b) >= FACE_COSINE, normal, points, depths, area, least)


def _face(
    turn: Float[Array, "3 3"], half: Float[Array, 3], toward: Float[Array, 3]
) -> tuple[Float[Array, 3], Float[Array, ""], Float[Array, "2 3"]]:
    """Three properties of the face of a box whose normal is nearest to ``toward``: the outward normal, the distance
    from the box's centre, and the two half edges."""
    along = toward @ turn
    axis = jnp.argmax(jnp.abs(along))
    sides = (turn * half).T
    edges = jnp.stack([sides[(axis + 1) % 3], sides[(axis + 2) % 3]])
    return turn[:, axis] * jnp.where(along[axis] < 0, -1.0, 1.0), half[axis], edges


def _area(edges: Float[Array, "2 3"]) -> Float[Array, ""]:
    return jnp.sqrt((edges**2).sum(-1)).prod()


def _cut(
    corners: Float[Array, "k 2"], kept: Bool[Array, " k"], across: Float[Array, 2], offset: Float[Array, ""]
) -> tuple[Float[Array, "k+1 2"], Bool[Array, " k+1"]]:
    """The part of a polygon on the positive side of a line: the points x with across · x + offset > 0.

    ``corners``: the corners of the polygon. ``kept``: whether each row of ``corners`` is valid; the valid rows come
    first. Returns the corners of the part, and whether each row of them is valid."""
    k = len(corners)
    count = kept.sum()
    following = jnp.where(jnp.arange(k) + 1 < count, jnp.arange(k) + 1, 0)
    here = corners @ across + offset
    ahead = here[following]
    crosses = kept & ((here >= 0) != (ahead >= 0))
    part = here / jnp.where(crosses, here - ahead, 1.0)
    points = jnp.stack([corners, corners + part[:, None] * (corners[following] - corners)], axis=1)
    stay = jnp.stack([kept & (here >= 0), crosses], axis=1).reshape(-1)
    # points that are cut off get a row beyond the end, and are dropped
    row = jnp.where(stay, jnp.cumsum(stay) - 1, k + 1)
    left = jnp.zeros((k + 1, 2)).at[row].set(points.reshape(-1, 2), mode="drop")
    return left, jnp.arange(k + 1) < stay.sum()


def _moments(
    corners: Float[Array, "k 2"], kept: Bool[Array, " k"]
) -> tuple[Float[Array, ""], Float[Array, 2], Float[Array, "2 2"]]:
    """Three properties of a polygon: the area, the centroid, and the Cholesky factor of the second moments per area."""
    p, q = corners[1:-1] - corners[0], corners[2:] - corners[0]
    part = jnp.where(kept[2:], 0.5 * jnp.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), 0.0)
    area = part.sum()
    share = part / jnp.where(area > 0, area, 1.0)
    both = p + q
    center = share @ both / 3.0
    second = jnp.einsum("k,ki,kj->ij", share, p, p) + jnp.einsum("k,ki,kj->ij", share, q, q)
    second = (second + jnp.einsum("k,ki,kj->ij", share, both, both)) / 12.0 - jnp.outer(center, center)
    first = jnp.sqrt(jnp.maximum(second[0, 0], LEAST_MOMENT_M2))
    lean = second[0, 1] / first
    remaining_root = jnp.sqrt(jnp.maximum(second[1, 1] - lean**2, 0.0))
    root = jnp.stack([jnp.stack([first, jnp.zeros_like(first)]), jnp.stack([lean, remaining_root])])
    return area, corners[0] + center, root
