"""Distances of contacts in double precision.

A box at rest on stiff contacts sinks by 0.1 to 1 µm. In single precision, positions have steps of 0.1 µm at a height of
1 m, and the colliders of mujoco_warp have errors of the same size. With such distances, the boxes of a pallet never
come to rest: contacts open and close, and boxes creep. So the part of a position that single precision cannot hold is
stored separately (``State.qpos_remainder``). And the distance at each contact is computed again in double precision,
from the surfaces on which the collider has placed its points.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import applied_double, dot_double, fused_double
from petmjx.engines.warp.kernels.body_dynamics import body_of, doubled, exact_center, exact_rotation, orientation
from petmjx.engines.warp.world_arrays import Ref, State, Worlds

ON_FACE = wp.constant(wp.float64(4e-6))
"""A collider's point counts as a point of a face if its distance from the face is at most this value, m. The points of
the colliders have errors of up to about 1 µm, for boxes of up to 4 m."""


@wp.func
def exact_turn(worlds: Ref[Worlds], state: Ref[State], world: int, geom: int) -> wp.mat33d:
    """Rotation matrix of a geom."""
    if geom == 0:
        return exact_rotation(wp.vec4(1.0, 0.0, 0.0, 0.0))
    return exact_rotation(orientation(state, world, body_of(worlds, world, geom)))


@wp.func
def exact_place(worlds: Ref[Worlds], state: Ref[State], world: int, geom: int, turn: wp.mat33d) -> wp.vec3d:
    """Centre of a geom with the rotation matrix ``turn``, m."""
    if geom == 0:
        return doubled(wp.vec3(0.0, 0.0, worlds.floor_z[world]))
    offset = worlds.shape_pos[world, geom - 1]
    place = exact_center(state, world, body_of(worlds, world, geom))
    return place + applied_double(turn, doubled(wp.vec3(offset[0], offset[1], offset[2])))


@wp.func
def _reach(half: wp.vec3, turn: wp.mat33d, along: wp.vec3d, point: wp.vec3d) -> wp.float64:
    """How far a point of a box's surface is from the box's centre along a direction, m.

    Args:
        half: half extents of the box, m.
        turn: rotation matrix of the box.
        along: the direction in the box's frame, of unit length.
        point: the collider's point, relative to the centre. This function moves the point onto the faces to which it
            belongs.
    """
    local = applied_double(wp.transpose(turn), point)
    for i in range(3):
        extent = wp.float64(half[i])
        if wp.abs(wp.abs(local[i]) - extent) < ON_FACE:
            local[i] = wp.where(local[i] > wp.float64(0.0), extent, -extent)
    return dot_double(along, local)


@wp.func
def exact_distance(
    half_one: wp.vec3,
    turn_one: wp.mat33d,
    half_two: wp.vec3,
    turn_two: wp.mat33d,
    apart: wp.vec3d,
    normal: wp.vec3d,
    touch: wp.vec3d,
    distance: float,
) -> float:
    """Distance of two geoms at a contact, m; negative if they overlap.

    Args:
        half_one: half extents of the first geom, m; 0 for the floor.
        turn_one: rotation matrix of the first geom.
        half_two, turn_two: half extents, m, and rotation matrix of the second geom.
        apart: centre of the second geom, relative to that of the first, m.
        normal: the contact's normal, from the first geom to the second, of unit length.
        touch: the collider's point of the contact, relative to the centre of the first geom, m. The point is halfway
            between the two surfaces.
        distance: the collider's distance, m.
    """
    ahead = wp.float64(0.5 * distance)
    on_one = wp.vec3d()
    on_two = wp.vec3d()
    for i in range(3):
        on_one[i] = fused_double(-ahead, normal[i], touch[i])
        on_two[i] = fused_double(ahead, normal[i], touch[i])
    gap = dot_double(normal, apart)
    gap += _reach(half_two, turn_two, applied_double(wp.transpose(turn_two), normal), on_two - apart)
    if half_one[2] > 0.0:
        gap -= _reach(half_one, turn_one, applied_double(wp.transpose(turn_one), normal), on_one)
    return float(gap)
