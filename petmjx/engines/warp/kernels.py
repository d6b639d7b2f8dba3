"""From poses to the constraint rows of a pallet, and from accelerations to the next poses: Warp kernels.

All bodies are free boxes (or a carrier that is clamped). So a contact is described by its frame and three moment arms
per body, and a body's inertia by six numbers. Contacts come from mujoco_warp's collision pipeline, in one pool for all
worlds and in no fixed order. Here the contacts of each world are listed and sorted, so that every sum over them has the
same order in every run, with any number of lanes.

A block is a body that moves; it has six rows in the equations. Blocks are the carrier and the boxes, or only the boxes
if the carrier is clamped ("held"). The block of a geom is its number − 1, or − 2 if the carrier is held; negative
blocks do not move.

This module has only kernels. Warp's compiler reads them; type checkers understand them only in part: ``float(…)`` and
``int(…)`` declare variables that loops change, and arrays are indexed.
"""

from __future__ import annotations

import warp as wp
from mujoco.mjx.third_party.mujoco_warp._src.types import vec5

from petmjx.engines.warp.records import MAX_PANELS, PANEL, ROW_WORDS, Collisions, Model, Out, State, Workspace
from petmjx.metrics import force_jax as force_metrics
from petmjx.verdict import Flag

SEARCH = 8
"""Contacts that a thread loads at the same time: most of a search's time is waiting for loads. A lane's room for
contacts is a multiple of it."""

TOGETHER = 4
"""Contacts of a box whose forces a thread loads at the same time."""

vec8i = wp.types.vector(length=SEARCH, dtype=int)

# MuJoCo's bounds (mjMINVAL, mjMINIMP, mjMAXIMP).
MIN_VALUE = wp.constant(1e-15)
MIN_IMPEDANCE = wp.constant(1e-4)
MAX_IMPEDANCE = wp.constant(0.9999)
VERTICAL_COSINE = wp.constant(force_metrics.VERTICAL_COSINE)
CONTACT_OVERFLOW = wp.constant(int(Flag.CONTACT_OVERFLOW))


@wp.func
def _rotation(w: float, x: float, y: float, z: float) -> wp.mat33:
    """Matrix of a quaternion of any length but zero."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return wp.mat33(
        1.0 - s * (y * y + z * z),
        s * (x * y - w * z),
        s * (x * z + w * y),
        s * (x * y + w * z),
        1.0 - s * (x * x + z * z),
        s * (y * z - w * x),
        s * (x * z - w * y),
        s * (y * z + w * x),
        1.0 - s * (x * x + y * y),
    )


@wp.func
def _three(values: wp.array2d[float], world: int, at: int) -> wp.vec3:
    """Three consecutive numbers of one world."""
    return wp.vec3(values[world, at], values[world, at + 1], values[world, at + 2])


@wp.func
def _moment_arms(axes: wp.mat33, lever: wp.vec3, rotation: wp.mat33) -> wp.mat33:
    """Velocity along each axis at the end of a lever, per angular velocity in the body's own frame."""
    arms = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for r in range(3):
        arms[r] = wp.transpose(rotation) * wp.cross(lever, axes[r])
    return arms


@wp.func
def _velocity_along(axes: wp.mat33, arms: wp.mat33, qvel: wp.array2d[float], world: int, block: int) -> wp.vec3:
    """A body's velocity at a contact, along the contact's axes."""
    return axes * _three(qvel, world, 6 * block) + arms * _three(qvel, world, 6 * block + 3)


@wp.kernel(enable_backward=False)
def begin_step(model: Model, state: State, collisions: Collisions, work: Workspace, out: Out) -> None:
    """Poses of geoms, diagonal of the inertia matrix, accelerations without contacts. One thread per world and geom.

    A free body's angular velocity is in its own frame, so Euler's equation gives the torque −ω × I·ω.
    """
    world, geom = wp.tid()
    if geom == 0:
        collisions.geom_xpos[world, 0] = wp.vec3(0.0, 0.0, model.floor_z)
        collisions.geom_xmat[world, 0] = wp.identity(n=3, dtype=float)
        out.contacts[world] = 0
        work.n_blocks[world] = 0
        return
    block = geom - 1 - model.held
    if block < 0:
        p = state.carrier_pose[world]
        collisions.geom_xpos[world, geom] = _three(state.carrier_pose, world, 0)
        collisions.geom_xmat[world, geom] = _rotation(p[3], p[4], p[5], p[6])
        return
    q = state.qpos[world]
    at = 7 * block
    collisions.geom_xpos[world, geom] = _three(state.qpos, world, at)
    collisions.geom_xmat[world, geom] = _rotation(q[at + 3], q[at + 4], q[at + 5], q[at + 6])
    dof = 6 * block
    mass = model.body_mass[world, geom]
    spin = _three(state.qvel, world, dof + 3)
    its_inertia = model.body_inertia[world, geom]
    moments = wp.vec3(its_inertia[0], its_inertia[1], its_inertia[2])
    torque = -wp.cross(spin, wp.cw_mul(moments, spin))
    for i in range(3):
        force = float(0.0)
        if geom == 1:
            force = state.carrier_force[world, i]
        work.inertia[world, dof + i] = mass
        work.inertia[world, dof + 3 + i] = moments[i]
        work.smooth[world, dof + i] = state.gravity[world, i] + force / mass
        work.smooth[world, dof + 3 + i] = torque[i] / moments[i]


@wp.kernel(enable_backward=False)
def list_contacts(model: Model, collisions: Collisions, work: Workspace, out: Out) -> None:
    """List each world's contacts, in no fixed order. One thread per contact of the pool.

    A key is made of the pair of geoms and the contact's number in the pool, so all keys differ.
    """
    contact = wp.tid()
    if contact >= collisions.nacon[0]:
        return
    world = collisions.worldid[contact]
    slot = wp.atomic_add(out.contacts, world, 1)
    if slot < model.room:
        pair = collisions.geom[contact]
        order = wp.int64(wp.min(pair[0], pair[1]) * model.n_geoms + wp.max(pair[0], pair[1]))
        work.contact_key[world, slot] = order * wp.int64(model.pool) + wp.int64(contact)


@wp.func
def _reference(solref: wp.vec2, solimp: vec5, depth: float, timestep: float) -> wp.vec3:
    """Stiffness, damping and impedance of a contact (MuJoCo's documentation, "Modeling", "Solver parameters")."""
    low = wp.clamp(solimp[0], MIN_IMPEDANCE, MAX_IMPEDANCE)
    high = wp.clamp(solimp[1], MIN_IMPEDANCE, MAX_IMPEDANCE)
    x = wp.min(wp.abs(depth) / wp.max(solimp[2], MIN_VALUE), 1.0)
    middle = wp.clamp(solimp[3], MIN_IMPEDANCE, MAX_IMPEDANCE)
    power = wp.max(solimp[4], 1.0)
    y = x
    if power > 1.0:
        if x <= middle:
            y = wp.pow(x, power) / wp.pow(middle, power - 1.0)
        else:
            y = 1.0 - wp.pow(1.0 - x, power) / wp.pow(1.0 - middle, power - 1.0)
    impedance = low + y * (high - low)
    if solref[0] <= 0.0:
        return wp.vec3(-solref[0] / (high * high), -solref[1] / high, impedance)
    timeconst = wp.max(solref[0], 2.0 * timestep)
    stiffness = 1.0 / (high * high * timeconst * timeconst * solref[1] * solref[1])
    return wp.vec3(stiffness, 2.0 / (high * timeconst), impedance)


@wp.kernel(enable_backward=False)
def make_rows(model: Model, state: State, collisions: Collisions, work: Workspace, out: Out) -> None:
    """The place of each contact in its world's sorted list, and its rows. One thread per world and contact.

    Rows give the acceleration of the second block relative to the first, along normal and tangents. Moment arms are in
    the frames of the bodies. With pyramidal cones the rows of the four edges are normal ± friction × tangent; they are
    not stored.
    """
    world, slot = wp.tid()
    count = wp.min(out.contacts[world], model.room)
    if slot >= count:
        return
    key = work.contact_key[world, slot]
    me = int(key % wp.int64(model.pool))
    place = int(0)
    for begin in range(0, count, SEARCH):
        for i in range(SEARCH):
            its_key = work.contact_key[world, begin + i]
            place += wp.where(begin + i < count and its_key < key, 1, 0)
    first = collisions.geom[me][0]
    second = collisions.geom[me][1]
    axes = collisions.frame[me]
    if first > second:
        # Seen from the other body, the frame is reversed and the forces stay the same.
        first = collisions.geom[me][1]
        second = collisions.geom[me][0]
        axes = -axes
    one = first - 1 - model.held
    two = second - 1 - model.held
    arms_one = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    arms_two = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    velocity = wp.vec3(0.0, 0.0, 0.0)
    point = collisions.pos[me]
    if one >= 0:
        lever = point - collisions.geom_xpos[world, first]
        arms_one = _moment_arms(axes, lever, collisions.geom_xmat[world, first])
        velocity -= _velocity_along(axes, arms_one, state.qvel, world, one)
    if two >= 0:
        lever = point - collisions.geom_xpos[world, second]
        arms_two = _moment_arms(axes, lever, collisions.geom_xmat[world, second])
        velocity += _velocity_along(axes, arms_two, state.qvel, world, two)
    kbi = _reference(collisions.solref[me], collisions.solimp[me], collisions.dist[me], model.timestep)
    damping = kbi[1]
    if model.friction_damping > 0.0:
        damping = model.friction_damping
    mu = collisions.friction[me][0]
    weight = model.body_invweight0[world, first, 0] + model.body_invweight0[world, second, 0]
    if model.pyramidal != 0:
        weight = 2.0 * mu * mu * weight * (1.0 + mu * mu)
    for r in range(3):
        for i in range(3):
            work.rows[world, place, 3 * r + i] = axes[r, i]
            work.rows[world, place, 9 + 3 * r + i] = arms_one[r, i]
            work.rows[world, place, 18 + 3 * r + i] = arms_two[r, i]
        work.rows[world, place, 27 + r] = -damping * velocity[r]
    work.rows[world, place, 27] = -kbi[1] * velocity[0] - kbi[0] * kbi[2] * collisions.dist[me]
    work.rows[world, place, 30] = 1.0 / wp.max(weight * (1.0 - kbi[2]) / kbi[2], MIN_VALUE)
    work.rows[world, place, 31] = mu
    work.blocks[world, place, 0] = one
    work.blocks[world, place, 1] = two
    wp.atomic_max(work.n_blocks, world, two + 1)


@wp.func
def _fetch_blocks(blocks: wp.array3d[int], world: int, begin: int, side: int) -> vec8i:
    """Blocks on one side of ``SEARCH`` contacts, beginning at ``begin``."""
    found = vec8i()
    for i in range(SEARCH):
        found[i] = blocks[world, begin + i, side]
    return found


@wp.kernel(enable_backward=False)
def link_blocks(model: Model, work: Workspace, out: Out) -> None:
    """The contacts of each block, as links: 2 × contact + side. One thread per world and block.

    ``links[world, link_begin[world, b]:link_begin[world, b + 1]]`` belong to block b, in the order of the contacts.
    ``lowest`` is the lowest block that it touches, or the block itself.
    """
    world, block = wp.tid()
    if block > work.n_blocks[world]:
        return
    count = wp.min(out.contacts[world], model.room)
    at = int(0)
    for begin in range(0, count, SEARCH):
        ones = _fetch_blocks(work.blocks, world, begin, 0)
        twos = _fetch_blocks(work.blocks, world, begin, 1)
        for i in range(SEARCH):
            if begin + i < count:
                at += wp.where(ones[i] >= 0 and ones[i] < block, 1, 0)
                at += wp.where(twos[i] >= 0 and twos[i] < block, 1, 0)
    work.link_begin[world, block] = at
    if block == work.n_blocks[world]:
        return
    low = int(block)
    for begin in range(0, count, SEARCH):
        ones = _fetch_blocks(work.blocks, world, begin, 0)
        twos = _fetch_blocks(work.blocks, world, begin, 1)
        for i in range(SEARCH):
            k = begin + i
            if k < count and (ones[i] == block or twos[i] == block):
                work.links[world, at] = 2 * k + wp.where(twos[i] == block, 1, 0)
                at += 1
                if twos[i] == block and ones[i] >= 0:
                    low = wp.min(low, ones[i])
    work.lowest[world, block] = low


@wp.func_native(f"petmjx::newton<{MAX_PANELS}, {PANEL}, {ROW_WORDS}>(world, thread, threads, model, state, work, out);")
def _newton(world: int, thread: int, threads: int, model: Model, state: State, work: Workspace, out: Out) -> None: ...


def solve(threads: int, model: Model, state: State, work: Workspace, out: Out) -> None:
    """Accelerations and contact forces of every world, beginning at the warm start; ``threads`` threads per world.

    Reads the model's limits, the warm start, and rows and links of contacts. Writes ``acceleration`` and ``force`` (of
    each contact, in its frame) in the workspace, and the number of iterations. It uses other arrays of the workspace as
    scratch. ``newton.solver`` makes a kernel of this function and of the C++ that it calls.
    """
    world, thread = wp.tid()
    _newton(world, thread, threads, model, state, work, out)


@wp.kernel(enable_backward=False)
def end_step(model: Model, state: State, collisions: Collisions, work: Workspace, out: Out) -> None:
    """Semi-implicit Euler, and the force on each box's top. One thread per world and block."""
    world, block = wp.tid()
    dof = 6 * block
    at = 7 * block
    touched = block < work.n_blocks[world]
    for i in range(6):
        a = work.smooth[world, dof + i]
        if touched:
            a = float(work.acceleration[world, dof + i])
        out.qacc[world, dof + i] = a
        out.next_qvel[world, dof + i] = state.qvel[world, dof + i] + model.timestep * a
    for i in range(3):
        out.next_qpos[world, at + i] = state.qpos[world, at + i] + model.timestep * out.next_qvel[world, dof + i]
    spin = _three(out.next_qvel, world, dof + 3)
    angle = model.timestep * wp.length(spin)
    sine = model.timestep * 0.5
    if angle > 1e-6:
        sine = wp.sin(angle * 0.5) / wp.length(spin)
    cosine = wp.cos(angle * 0.5)
    v = sine * spin
    w = state.qpos[world, at + 3]
    u = _three(state.qpos, world, at + 4)
    turned_w = w * cosine - wp.dot(u, v)
    turned = w * v + cosine * u + wp.cross(u, v)
    size = wp.sqrt(turned_w * turned_w + wp.dot(turned, turned))
    out.next_qpos[world, at + 3] = turned_w / size
    for i in range(3):
        out.next_qpos[world, at + 4 + i] = turned[i] / size

    box = block - 1 + model.held
    if box < 0:
        return
    total = wp.float64(0.0)
    if touched:
        z = collisions.geom_xpos[world, block + 1 + model.held][2]
        end = work.link_begin[world, block + 1]
        for begin in range(work.link_begin[world, block], end, TOGETHER):
            # No contact depends on another one, so their loads run at the same time.
            for i in range(TOGETHER):
                link = work.links[world, wp.min(begin + i, end - 1)]
                k = link // 2
                side = link % 2
                its_z = collisions.geom_xpos[world, work.blocks[world, k, 1 - side] + 1 + model.held][2]
                up = wp.float64(0.0)
                for r in range(3):
                    up += wp.float64(work.rows[world, k, 3 * r + 2]) * work.force[world, k, r]
                up = wp.where(side == 1, -up, up)
                vertical = wp.abs(work.rows[world, k, 2]) >= VERTICAL_COSINE
                lower = z < its_z or (side == 1 and z == its_z)
                total += wp.where(begin + i < end and vertical and lower, up, wp.float64(0.0))
    out.top_force[world, box] = float(total)


@wp.kernel(enable_backward=False)
def note_overflow(model: Model, collisions: Collisions, out: Out) -> None:
    """Flag worlds that may have lost a contact: all worlds if the pool was full. One thread per world."""
    world = wp.tid()
    out.overflow[world] = 0
    full = collisions.nacon[0] > model.pool or collisions.ncollision[0] > model.pool
    if full or out.contacts[world] > model.room:
        out.overflow[world] = CONTACT_OVERFLOW
