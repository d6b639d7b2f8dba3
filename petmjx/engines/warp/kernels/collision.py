"""Collisions of a world: pairs of geoms that are near one another, and the contacts of these pairs.

Pairs are in the order of their geoms. The contacts of a pair are in the order in which the collider gives them. So
every sum over contacts has the same order in every run. Colliders come from mujoco_warp, in the copy inside MJX.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import (
    any_of_all,
    dot_double,
    prefix_sums,
    wait_for_all,
    warp_by_warp,
)
from petmjx.engines.warp.kernels.body_dynamics import ROOM, body_of, doubled, first_geom, geom_half, skin_of
from petmjx.engines.warp.kernels.compliance import compliance_of_pair, spring_of_bed, spring_of_pair
from petmjx.engines.warp.kernels.contact_distances import exact_distance, exact_place, exact_turn
from petmjx.engines.warp.kernels.face_contacts import bed_of
from petmjx.engines.warp.kernels.mujoco_warp import box_box, mat83f, plane_box, vec8f
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds

NEAR = wp.constant(1e-5)
"""Margin by which bounding boxes of geoms are enlarged, m, so that no contact is lost by rounding."""

ROUNDING = wp.constant(1e-6)
"""Largest error of the distances that colliders compute in single precision, m. The largest error seen is 0.13 µm for
boxes of up to 0.6 m, and 0.7 µm for boxes of up to 6 m."""

COLLINEAR = wp.constant(1e-5)
"""A contact counts as lying on the line between two other contacts if its distance from the line is at most this value,
m: a tenth of the default skin. Contacts are removed one after another, and each is compared with the contacts that
remain. So where several contacts are removed, the edge of the area on which a box stands may move by more than this
distance. In the worst of 3,000 random arcs of eight contacts, the edge moved by 23 µm."""

FEWEST = wp.constant(4)
"""Contacts of a pair are removed only if the pair has more contacts than this. Two faces that touch usually have a
common area with four corners, and a contact at each corner, none of which may be removed."""

APART = wp.constant(2.0 * ROOM + 3.0 * NEAR)
"""Largest distance of two geoms' bounding boxes, m, at which the pair is listed. The list stays valid until a body has
moved by more than ``ROOM``, so the list need not be made in each step."""


@wp.func
def _first_partner(worlds: Ref[Worlds], at: Thread, geom: int) -> int:
    """The first later geom that may touch this one: it belongs to another body, and at least one of the two bodies can
    move.
    """
    body = wp.max(body_of(worlds, at.world, geom), wp.where(at.held != 0, 0, -1))
    return first_geom(worlds, at.world, body + 1)


@wp.func
def _near(work: Ref[Workspace], at: Thread, one: int, two: int, apart: float) -> bool:
    """Whether the bounding boxes of two geoms are at most ``apart`` (m) from one another along each axis."""
    reach = work.geom_reach[at.block, two]
    place = work.geom_xpos[at.block, two]
    if one == 0:
        return place[2] - reach[2] <= work.geom_xpos[at.block, 0][2] + apart
    gap = wp.abs(place - work.geom_xpos[at.block, one]) - reach - work.geom_reach[at.block, one]
    return wp.max(gap[0], wp.max(gap[1], gap[2])) <= apart


@wp.func
def _is_between(points: wp.array3d[wp.vec4], block: int, pair: int, count: int, i: int) -> bool:
    """Whether contact i of a pair is at most ``COLLINEAR`` from the line between two other contacts of the pair."""
    point = points[block, pair, i]
    for j in range(count):
        for k in range(j):
            if j != i and k != i:
                end = points[block, pair, j]
                apart = points[block, pair, k] - end
                line = wp.vec3(apart[0], apart[1], apart[2])
                offset = wp.vec3(point[0] - end[0], point[1] - end[1], point[2] - end[2])
                share = wp.clamp(wp.dot(offset, line) / wp.max(wp.dot(line, line), COLLINEAR * COLLINEAR), 0.0, 1.0)
                if wp.length(offset - share * line) < COLLINEAR:
                    return True
    return False


@wp.func
def without_collinear(points: wp.array3d[wp.vec4], block: int, pair: int, count: int) -> int:
    """Remove the contacts of a pair that lie between two others (``COLLINEAR``), and return the number of contacts that
    remain.

    If one box lies exactly on another box of the same size, the edges of the two faces are the same lines. An angle of
    1e-7 rad decides where they cross, so the collider finds four contacts in one step and up to eight in the next.
    Contacts between two others add nothing to the area on which the box stands, but their springs add to the forces:
    without this rule, such boxes tremble.
    """
    remaining = int(count)
    i = int(0)
    while i < remaining:
        if _is_between(points, block, pair, remaining, i):
            remaining -= 1
            for j in range(i, remaining):
                points[block, pair, j] = points[block, pair, j + 1]
        else:
            i += 1
    return remaining


@wp.func
def list_pairs(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    apart: float,
    # Data out:
    work: Ref[Workspace],
) -> int:
    """List the pairs of geoms that are at most ``apart`` (m) from one another. Returns the number of these pairs, which
    may exceed the number for which there is room.

    The pairs whose first geom (the one with the lower number) is g begin at ``geom1_pairadr`` of g. ``geom2_pair``
    lists the pairs of each second geom in order, beginning at ``geom2_pairadr``.
    """
    block = at.block
    n = at.geoms
    for one in range(at.thread, n, at.threads):
        work.listed_xpos[block, one] = work.geom_xpos[block, one]
        work.listed_reach[block, one] = work.geom_reach[block, one]
        count = int(0)
        for two in range(_first_partner(worlds, at, one), n):
            count += wp.where(_near(work, at, one, two, apart), 1, 0)
        work.geom1_pairadr[block, one] = count
    wait_for_all()
    prefix_sums(work.geom1_pairadr, block, n, at.thread)
    wait_for_all()
    npair = work.geom1_pairadr[block, n]
    if npair > model.npairmax:
        return npair
    for one in range(at.thread, n, at.threads):
        pair = work.geom1_pairadr[block, one]
        for two in range(_first_partner(worlds, at, one), n):
            if _near(work, at, one, two, apart):
                work.pair_geom1[block, pair] = one
                work.pair_geom2[block, pair] = two
                pair += 1
    wait_for_all()
    for two in range(at.thread, n, at.threads):
        count = int(0)
        for pair in range(work.geom1_pairadr[block, two]):
            count += wp.where(work.pair_geom2[block, pair] == two, 1, 0)
        work.geom2_pairadr[block, two] = count
    wait_for_all()
    prefix_sums(work.geom2_pairadr, block, n, at.thread)
    wait_for_all()
    for two in range(at.thread, n, at.threads):
        entry = work.geom2_pairadr[block, two]
        for pair in range(work.geom1_pairadr[block, two]):
            if work.pair_geom2[block, pair] == two:
                work.geom2_pair[block, entry] = pair
                entry += 1
    wait_for_all()
    return npair


@wp.func
def collide(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    at: Thread,
    npair: int,
    anew: bool,
    # Data out:
    work: Ref[Workspace],
) -> bool:
    """Find the contacts of the listed pairs. Returns whether the numbering of contacts has changed since the last step.

    For the collider, boxes are enlarged by a skin. So a contact begins when two enlarged boxes overlap by the thickness
    of their skins (``_add_shapes`` in petmjx/world/mujoco_model.py). ``pair_conadr[block, npair]`` is the number of
    contacts, which may exceed the room for contacts. ``contact_pair`` is the pair of each contact that has room.

    Args:
        anew: whether the pairs were listed again for this step.
    """
    block = at.block
    changed = bool(anew)
    for pair in range(warp_by_warp(at), npair, at.threads):
        one = work.pair_geom1[block, pair]
        two = work.pair_geom2[block, pair]
        if not _near(work, at, one, two, NEAR):
            changed = changed or work.pair_ncon[block, pair] != 0
            work.pair_ncon[block, pair] = 0
            continue
        n_points = int(8)
        distances = vec8f()
        places = mat83f()
        normal = wp.vec3(0.0, 0.0, 1.0)
        lower_skin = skin_of(model, worlds, at.world, one)
        skin = skin_of(model, worlds, at.world, two)
        half = geom_half(worlds, at.world, two) + wp.vec3(skin, skin, skin)
        lower_half = wp.vec3(0.0, 0.0, 0.0)
        margin = -lower_skin - skin
        # The collider gets places relative to the first geom, since small numbers have small rounding errors.
        lower_turn = exact_turn(worlds, state, at.world, one)
        turn = exact_turn(worlds, state, at.world, two)
        apart = exact_place(worlds, state, at.world, two, turn) - exact_place(worlds, state, at.world, one, lower_turn)
        place = wp.vec3(float(apart[0]), float(apart[1]), float(apart[2]))
        if one == 0:
            distances, places, normal = plane_box(
                normal, wp.vec3(0.0, 0.0, 0.0), place, work.geom_xmat[block, two], half
            )
        else:
            lower_half = geom_half(worlds, at.world, one) + wp.vec3(lower_skin, lower_skin, lower_skin)
            n_points, distances, places, normal = box_box(
                wp.vec3(0.0, 0.0, 0.0),
                work.geom_xmat[block, one],
                lower_half,
                place,
                work.geom_xmat[block, two],
                half,
                margin + ROUNDING,
            )
        direction = doubled(normal)
        direction = direction / wp.sqrt(dot_double(direction, direction))
        count = int(0)
        for i in range(n_points):
            if distances[i] > margin + ROUNDING:
                continue
            touch = wp.vec3(places[i, 0], places[i, 1], places[i, 2])
            gap = exact_distance(lower_half, lower_turn, half, turn, apart, direction, doubled(touch), distances[i])
            distance = gap - margin
            if distance < 0.0:
                touch += work.geom_xpos[block, one]
                work.pair_points[block, pair, count] = wp.vec4(touch[0], touch[1], touch[2], distance)
                count += 1
        if count > FEWEST and model.skin > 0.0:
            count = without_collinear(work.pair_points, block, pair, count)
        if at.gives != 0:
            give = compliance_of_pair(worlds, at.world, one, two)
            work.pair_spring[block, pair] = spring_of_pair(worlds, at.world, one, two)
            if one != 0 and give > 0.0 and count > 0:
                are_faces, outward, points, area, least = bed_of(
                    work.geom_xpos[block, one],
                    work.geom_xmat[block, one],
                    geom_half(worlds, at.world, one),
                    work.geom_xpos[block, two],
                    work.geom_xmat[block, two],
                    geom_half(worlds, at.world, two),
                    normal,
                )
                if are_faces:
                    count = wp.where(area > 0.0, 4, 0)
                    normal = outward
                    for i in range(4):
                        work.pair_points[block, pair, i] = points[i]
                    work.pair_spring[block, pair] = spring_of_bed(wp.max(area, least), give)
        work.pair_normal[block, pair] = normal
        changed = changed or work.pair_ncon[block, pair] != count
        work.pair_ncon[block, pair] = count
    if not any_of_all(changed):
        return False
    for pair in range(at.thread, npair, at.threads):
        work.pair_conadr[block, pair] = work.pair_ncon[block, pair]
    wait_for_all()
    prefix_sums(work.pair_conadr, block, npair, at.thread)
    wait_for_all()
    for pair in range(at.thread, npair, at.threads):
        begin = work.pair_conadr[block, pair]
        end = wp.min(work.pair_conadr[block, pair + 1], model.nconmax)
        for contact in range(begin, end):
            work.contact_pair[block, contact] = pair
    wait_for_all()
    return True
