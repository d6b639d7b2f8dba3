"""Contacts of a world: pairs of geoms that are near, where they touch, their rows, and the contacts of each block.

Pairs are in the order of their geoms, and a pair's contacts in the order in which the collider gives them. So every sum
over contacts has the same order in every run. Colliders are those of mujoco_warp, in the copy inside MJX. Contacts have
the parameters that MuJoCo gives them (its documentation, "Modeling", "Solver parameters").

A contact is described by its frame and three moment arms per body (27 numbers), since each of its two bodies is free or
does not move.
"""

from __future__ import annotations

import warp as wp
from mujoco.mjx.third_party.mujoco_warp._src.collision_primitive_core import box_box, mat83f, plane_box, vec8f
from mujoco.mjx.third_party.mujoco_warp._src.math import make_frame

from petmjx.engines.warp.kernel.block import any_of_all, prefix_sums, wait_for_all, warp_by_warp
from petmjx.engines.warp.kernel.motion import (
    ROOM,
    angular_velocity,
    body_of,
    center,
    first_geom,
    geom_half,
    linear_velocity,
    skin_of,
)
from petmjx.engines.warp.kernel.ordering import block_position
from petmjx.engines.warp.records import Lane, Model, State, Tables, Workspace

# MuJoCo's bounds (mjMINVAL, mjMINIMP, mjMAXIMP, mjMINMU), and its power and midpoint of impedances (solimp).
MIN_VALUE = wp.constant(1e-15)
MIN_IMPEDANCE = wp.constant(1e-4)
MAX_IMPEDANCE = wp.constant(0.9999)
MIN_FRICTION = wp.constant(1e-5)

NEAR = wp.constant(1e-5)
"""Boxes around geoms are larger by this, m, so that rounding loses no contact."""

APART = wp.constant(2.0 * ROOM + 3.0 * NEAR)
"""How far boxes around geoms may be apart, m, for their pair to be listed. The list is good until one of them has left
its room, so that it need not be made in each step."""


@wp.func
def _first_partner(tables: Tables, at: Lane, geom: int) -> int:
    """The first of the geoms behind this one that may touch it: of another body, and not held fast to the floor."""
    body = wp.max(body_of(tables, at.world, geom), wp.where(at.held != 0, 0, -1))
    return first_geom(tables, at.world, body + 1)


@wp.func
def _near(work: Workspace, at: Lane, one: int, two: int, apart: float) -> bool:
    """Whether the boxes around two geoms are no further apart than this along each axis, m."""
    reach = work.reach[at.lane, two]
    place = work.place[at.lane, two]
    if one == 0:
        return place[2] - reach[2] <= work.place[at.lane, 0][2] + apart
    gap = wp.abs(place - work.place[at.lane, one]) - reach - work.reach[at.lane, one]
    return wp.max(gap[0], wp.max(gap[1], gap[2])) <= apart


@wp.func
def list_pairs(model: Model, tables: Tables, work: Workspace, at: Lane, apart: float) -> int:
    """List pairs of geoms that are no further apart than this, m; returns their number, which may be more than fit.

    ``pair_of`` says where the pairs of each lower geom begin. ``lower`` has the pairs of each higher geom, from
    ``lower_of``, in order.
    """
    lane = at.lane
    n = at.geoms
    for one in range(at.thread, n, at.threads):
        work.home[lane, one] = work.place[lane, one]
        work.home_reach[lane, one] = work.reach[lane, one]
        count = int(0)
        for two in range(_first_partner(tables, at, one), n):
            count += wp.where(_near(work, at, one, two, apart), 1, 0)
        work.pair_of[lane, one] = count
    wait_for_all()
    prefix_sums(work.pair_of, lane, n, at.thread)
    wait_for_all()
    n_pairs = work.pair_of[lane, n]
    if n_pairs > model.pairs:
        return n_pairs
    for one in range(at.thread, n, at.threads):
        pair = work.pair_of[lane, one]
        for two in range(_first_partner(tables, at, one), n):
            if _near(work, at, one, two, apart):
                work.first[lane, pair] = one
                work.second[lane, pair] = two
                pair += 1
    wait_for_all()
    for two in range(at.thread, n, at.threads):
        count = int(0)
        for pair in range(work.pair_of[lane, two]):
            count += wp.where(work.second[lane, pair] == two, 1, 0)
        work.lower_of[lane, two] = count
    wait_for_all()
    prefix_sums(work.lower_of, lane, n, at.thread)
    wait_for_all()
    for two in range(at.thread, n, at.threads):
        entry = work.lower_of[lane, two]
        for pair in range(work.pair_of[lane, two]):
            if work.second[lane, pair] == two:
                work.lower[lane, entry] = pair
                entry += 1
    wait_for_all()
    return n_pairs


@wp.func
def collide(model: Model, tables: Tables, work: Workspace, at: Lane, n_pairs: int, anew: bool) -> bool:
    """Find where pairs touch; returns whether contacts have other slots than a step ago.

    Boxes are larger by a skin for the collider, and contacts begin as deep as skins are thick (``_add_skin`` in
    petmjx/world/model.py). ``contact_of[lane, n_pairs]`` is the number of contacts, which may be more than fit.
    ``pair_at`` is the pair of each contact that fits.

    Args:
        anew: pairs were listed for this step.
    """
    lane = at.lane
    changed = bool(anew)
    for pair in range(warp_by_warp(at), n_pairs, at.threads):
        one = work.first[lane, pair]
        two = work.second[lane, pair]
        if not _near(work, at, one, two, NEAR):
            changed = changed or work.touching[lane, pair] != 0
            work.touching[lane, pair] = 0
            continue
        found = int(8)
        distances = vec8f()
        places = mat83f()
        normal = wp.vec3(0.0, 0.0, 1.0)
        lower_skin = skin_of(model, tables, at.world, one)
        skin = skin_of(model, tables, at.world, two)
        half = geom_half(tables, at.world, two) + wp.vec3(skin, skin, skin)
        margin = -lower_skin - skin
        if one == 0:
            distances, places, normal = plane_box(
                normal, work.place[lane, 0], work.place[lane, two], work.turn[lane, two], half
            )
        else:
            found, distances, places, normal = box_box(
                work.place[lane, one],
                work.turn[lane, one],
                geom_half(tables, at.world, one) + wp.vec3(lower_skin, lower_skin, lower_skin),
                work.place[lane, two],
                work.turn[lane, two],
                half,
                margin,
            )
        count = int(0)
        for i in range(found):
            distance = distances[i] - margin
            if distance < 0.0:
                work.points[lane, pair, count] = wp.vec4(places[i, 0], places[i, 1], places[i, 2], distance)
                count += 1
        work.normal[lane, pair] = normal
        changed = changed or work.touching[lane, pair] != count
        work.touching[lane, pair] = count
    if not any_of_all(changed):
        return False
    for pair in range(at.thread, n_pairs, at.threads):
        work.contact_of[lane, pair] = work.touching[lane, pair]
    wait_for_all()
    prefix_sums(work.contact_of, lane, n_pairs, at.thread)
    wait_for_all()
    for pair in range(at.thread, n_pairs, at.threads):
        begin = work.contact_of[lane, pair]
        end = wp.min(work.contact_of[lane, pair + 1], model.room)
        for slot in range(begin, end):
            work.pair_at[lane, slot] = pair
    wait_for_all()
    return True


@wp.func
def _reference(model: Model, depth: float) -> wp.vec3:
    """Stiffness, damping and impedance of a contact (MuJoCo's documentation, "Modeling", "Solver parameters")."""
    low = wp.clamp(model.low_impedance, MIN_IMPEDANCE, MAX_IMPEDANCE)
    high = wp.clamp(model.high_impedance, MIN_IMPEDANCE, MAX_IMPEDANCE)
    x = wp.min(wp.abs(depth) / wp.max(model.impedance_width, MIN_VALUE), 1.0)
    # MuJoCo's default midpoint 0.5 and power 2
    y = wp.where(x <= 0.5, 2.0 * x * x, 1.0 - 2.0 * (1.0 - x) * (1.0 - x))
    impedance = low + y * (high - low)
    time = model.solref[0]
    ratio = model.solref[1]
    if time <= 0.0:
        return wp.vec3(-time / (high * high), -ratio / high, impedance)
    time = wp.max(time, 2.0 * model.timestep)
    return wp.vec3(1.0 / (high * high * time * time * ratio * ratio), 2.0 / (high * time), impedance)


@wp.func
def _moment_arms(axes: wp.mat33, lever: wp.vec3, turn: wp.mat33) -> wp.mat33:
    """Velocity along each axis at the end of a lever, per angular velocity in the body's own frame."""
    arms = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for r in range(3):
        arms[r] = wp.transpose(turn) * wp.cross(lever, axes[r])
    return arms


@wp.func
def _give(tables: Tables, at: Lane, body: int) -> float:
    """MuJoCo's inverse weight of a body, 1/kg; 0 if it does not move."""
    if body - at.held < 0:
        return 0.0
    return 1.0 / tables.mass[at.world, body]


@wp.func
def _friction(tables: Tables, world: int, geom: int) -> float:
    """Sliding friction of a geom."""
    if geom == 0:
        return tables.floor_friction[world, 0]
    return tables.friction[world, geom - 1, 0]


@wp.func
def _surface(tables: Tables, world: int, geom: int) -> int:
    """Surface of a geom; the floor has 0, of which nothing is said."""
    if geom == 0:
        return 0
    return tables.shape_surface[world, geom - 1]


@wp.func
def _friction_of_pair(tables: Tables, world: int, first: int, second: int) -> float:
    """Sliding friction between two geoms: that of their surfaces, else the larger one."""
    own = tables.pair_friction[world, _surface(tables, world, first), _surface(tables, world, second)]
    if own >= 0.0:
        return own
    return wp.max(_friction(tables, world, first), _friction(tables, world, second))


@wp.func
def make_rows(model: Model, tables: Tables, state: State, work: Workspace, at: Lane, n_contacts: int) -> None:
    """Rows of all contacts.

    Rows give the acceleration of the second block relative to the first, along normal and tangents. Moment arms are in
    the frames of the bodies. With pyramidal cones the rows of the four edges are normal ± friction × tangent; they are
    not stored.
    """
    lane = at.lane
    world = at.world
    for slot in range(at.thread, n_contacts, at.threads):
        pair = work.pair_at[lane, slot]
        first = work.first[lane, pair]
        second = work.second[lane, pair]
        point = work.points[lane, pair, slot - work.contact_of[lane, pair]]
        axes = make_frame(work.normal[lane, pair])
        body_one = body_of(tables, world, first)
        body_two = body_of(tables, world, second)
        one = body_one - at.held
        two = body_two - at.held
        mu = wp.max(_friction_of_pair(tables, world, first, second), MIN_FRICTION)
        weight = _give(tables, at, body_one) + _give(tables, at, body_two)
        if model.pyramidal != 0:
            weight = 2.0 * mu * mu * weight * (1.0 + mu * mu)
        touch = wp.vec3(point[0], point[1], point[2])
        arms_one = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        arms_two = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        velocity = wp.vec3(0.0, 0.0, 0.0)
        if one >= 0:
            arms_one = _moment_arms(axes, touch - center(state, world, body_one), work.turn[lane, first])
            along = axes * linear_velocity(state, world, body_one)
            velocity -= along + arms_one * angular_velocity(state, world, body_one)
        if two >= 0:
            arms_two = _moment_arms(axes, touch - center(state, world, body_two), work.turn[lane, second])
            along = axes * linear_velocity(state, world, body_two)
            velocity += along + arms_two * angular_velocity(state, world, body_two)
        kbi = _reference(model, point[3])
        damping = wp.where(model.friction_damping > 0.0, model.friction_damping, kbi[1])
        for r in range(3):
            for i in range(3):
                work.rows[lane, slot, 3 * r + i] = axes[r, i]
                work.rows[lane, slot, 9 + 3 * r + i] = arms_one[r, i]
                work.rows[lane, slot, 18 + 3 * r + i] = arms_two[r, i]
        work.rows[lane, slot, 27] = -kbi[1] * velocity[0] - kbi[0] * kbi[2] * point[3]
        work.rows[lane, slot, 28] = -damping * velocity[1]
        work.rows[lane, slot, 29] = -damping * velocity[2]
        work.rows[lane, slot, 30] = 1.0 / wp.max(weight * (1.0 - kbi[2]) / kbi[2], MIN_VALUE)
        work.rows[lane, slot, 31] = mu
        work.blocks[lane, slot, 0] = one
        work.blocks[lane, slot, 1] = two
    wait_for_all()


@wp.func
def link_blocks(tables: Tables, state: State, work: Workspace, at: Lane) -> None:
    """The contacts of each block, as links: 2 × contact + side.

    ``links[lane, link_begin[lane, b]:link_begin[lane, b + 1]]`` belong to block b, in the order of the contacts:
    first those in which b is the second body. ``lowest`` says, by a block's position in the system, what is the lowest
    position of the blocks that it touches and of itself.
    """
    lane = at.lane
    n_blocks = work.n_blocks[lane]
    for block in range(at.thread, n_blocks, at.threads):
        geom = first_geom(tables, at.world, block + at.held)
        end_geom = first_geom(tables, at.world, block + at.held + 1)
        count = work.contact_of[lane, work.pair_of[lane, end_geom]] - work.contact_of[lane, work.pair_of[lane, geom]]
        for entry in range(work.lower_of[lane, geom], work.lower_of[lane, end_geom]):
            pair = work.lower[lane, entry]
            count += work.contact_of[lane, pair + 1] - work.contact_of[lane, pair]
        work.link_begin[lane, block] = count
    wait_for_all()
    prefix_sums(work.link_begin, lane, n_blocks, at.thread)
    wait_for_all()
    for block in range(at.thread, n_blocks, at.threads):
        geom = first_geom(tables, at.world, block + at.held)
        end_geom = first_geom(tables, at.world, block + at.held + 1)
        position = block_position(state, at, block)
        low = int(position)
        link = work.link_begin[lane, block]
        for entry in range(work.lower_of[lane, geom], work.lower_of[lane, end_geom]):
            pair = work.lower[lane, entry]
            begin = work.contact_of[lane, pair]
            end = work.contact_of[lane, pair + 1]
            for slot in range(begin, end):
                work.links[lane, link] = 2 * slot + 1
                link += 1
            other = body_of(tables, at.world, work.first[lane, pair]) - at.held
            if end > begin and other >= 0:
                low = wp.min(low, block_position(state, at, other))
        for pair in range(work.pair_of[lane, geom], work.pair_of[lane, end_geom]):
            begin = work.contact_of[lane, pair]
            end = work.contact_of[lane, pair + 1]
            for slot in range(begin, end):
                work.links[lane, link] = 2 * slot
                link += 1
            if end > begin:
                low = wp.min(
                    low, block_position(state, at, body_of(tables, at.world, work.second[lane, pair]) - at.held)
                )
        work.position[lane, block] = position
        work.lowest[lane, position] = low
    wait_for_all()
