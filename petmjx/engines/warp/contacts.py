"""From poses to the constraint rows of a pallet, and from accelerations to the next poses: Warp kernels.

All bodies are free boxes (or a carrier that is held fast), so that a contact is fully described by its frame and by
three moment arms a body, and a body's inertia is six numbers. Contacts come from mujoco_warp's collision pipeline,
in a pool shared by all worlds and in no fixed order; here each world's are listed and sorted, so that every sum over
them is taken in the same order in every run, on any number of lanes.

Blocks are bodies that move, six rows of the equations each: carrier and boxes, or the boxes alone where the carrier
is held. A geom's block is its number less one, less one more where the carrier is held; negative ones don't move.
"""

from __future__ import annotations

import warp as wp

from petmjx.metrics import force_jax as force_metrics

ROW_WORDS = 32
"""Numbers kept of a contact: frame (9), moment arms of both bodies (9 + 9), reference accelerations (3), stiffness
of a row (1), friction (1)."""

SEARCH = 8
"""Contacts that a thread fetches at a time: loads that wait for one another are what a search costs. Room for
contacts is a multiple of it."""

TOGETHER = 4
"""Contacts of a box whose forces a thread fetches at a time."""

vec8i = wp.types.vector(length=SEARCH, dtype=int)
vec5 = wp.types.vector(length=5, dtype=float)

# MuJoCo's bounds (mjMINVAL, mjMINIMP, mjMAXIMP).
MIN_VALUE = wp.constant(1e-15)
MIN_IMPEDANCE = wp.constant(1e-4)
MAX_IMPEDANCE = wp.constant(0.9999)
VERTICAL_COSINE = wp.constant(force_metrics.VERTICAL_COSINE)


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
def _three(values: wp.array2d(dtype=float), world: int, at: int) -> wp.vec3:
    """Three neighbouring numbers of a world's."""
    return wp.vec3(values[world, at], values[world, at + 1], values[world, at + 2])


@wp.func
def _moment_arms(axes: wp.mat33, lever: wp.vec3, rotation: wp.mat33) -> wp.mat33:
    """What a body's angular velocity, in its own frame, adds along each axis at the end of a lever."""
    arms = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for r in range(3):
        arms[r] = wp.transpose(rotation) * wp.cross(lever, axes[r])
    return arms


@wp.func
def _velocity_along(axes: wp.mat33, arms: wp.mat33, qvel: wp.array2d(dtype=float), world: int, block: int) -> wp.vec3:
    """A body's velocity at a contact, along the contact's axes."""
    return axes * _three(qvel, world, 6 * block) + arms * _three(qvel, world, 6 * block + 3)


@wp.kernel(enable_backward=False)
def begin_step(
    held: int,
    floor_z: float,
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    carrier_force: wp.array2d(dtype=float),
    gravity: wp.array2d(dtype=float),
    carrier_pose: wp.array2d(dtype=float),
    body_mass: wp.array2d(dtype=float),
    body_inertia: wp.array3d(dtype=float),
    geom_xpos: wp.array2d(dtype=wp.vec3),
    geom_xmat: wp.array2d(dtype=wp.mat33),
    inertia: wp.array2d(dtype=float),
    smooth: wp.array2d(dtype=float),
    n_contacts: wp.array(dtype=int),
    n_blocks: wp.array(dtype=int),
):
    """Poses of geoms, diagonal of the inertia matrix, accelerations without contacts. One thread a world and geom.

    A free body's angular velocity is in its own frame, so that Euler's equation gives −ω × I·ω as torque.
    """
    world, geom = wp.tid()
    if geom == 0:
        geom_xpos[world, 0] = wp.vec3(0.0, 0.0, floor_z)
        geom_xmat[world, 0] = wp.identity(n=3, dtype=float)
        n_contacts[world] = 0
        n_blocks[world] = 0
        return
    block = geom - 1 - held
    if block < 0:
        p = carrier_pose[world]
        geom_xpos[world, geom] = _three(carrier_pose, world, 0)
        geom_xmat[world, geom] = _rotation(p[3], p[4], p[5], p[6])
        return
    q = qpos[world]
    at = 7 * block
    geom_xpos[world, geom] = _three(qpos, world, at)
    geom_xmat[world, geom] = _rotation(q[at + 3], q[at + 4], q[at + 5], q[at + 6])
    dof = 6 * block
    mass = body_mass[world, geom]
    spin = _three(qvel, world, dof + 3)
    moments = wp.vec3(body_inertia[world, geom, 0], body_inertia[world, geom, 1], body_inertia[world, geom, 2])
    torque = -wp.cross(spin, wp.cw_mul(moments, spin))
    for i in range(3):
        force = float(0.0)
        if geom == 1:
            force = carrier_force[world, i]
        inertia[world, dof + i] = mass
        inertia[world, dof + 3 + i] = moments[i]
        smooth[world, dof + i] = gravity[world, i] + force / mass
        smooth[world, dof + 3 + i] = torque[i] / moments[i]


@wp.kernel(enable_backward=False)
def list_contacts(
    nacon: wp.array(dtype=int),
    worldid: wp.array(dtype=int),
    geom: wp.array(dtype=wp.vec2i),
    n_geoms: int,
    n_contacts: wp.array(dtype=int),
    contact_key: wp.array2d(dtype=wp.int64),
):
    """Each world's contacts, in the order in which threads happen to come. One thread a contact of the pool.

    A key is the pair of geoms, then the contact's number in the pool: no two are alike.
    """
    contact = wp.tid()
    if contact >= nacon[0]:
        return
    world = worldid[contact]
    slot = wp.atomic_add(n_contacts, world, 1)
    if slot < contact_key.shape[1]:
        pair = geom[contact]
        order = wp.int64(wp.min(pair[0], pair[1]) * n_geoms + wp.max(pair[0], pair[1]))
        contact_key[world, slot] = order * wp.int64(worldid.shape[0]) + wp.int64(contact)


@wp.func
def _reference(solref: wp.vec2, solimp: vec5, depth: float, timestep: float) -> wp.vec3:
    """Stiffness, damping and impedance of a contact (MuJoCo, "Modeling: Solver parameters")."""
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
def make_rows(
    held: int,
    pyramidal: int,
    timestep: float,
    qvel: wp.array2d(dtype=float),
    body_invweight: wp.array3d(dtype=float),
    geom_xpos: wp.array2d(dtype=wp.vec3),
    geom_xmat: wp.array2d(dtype=wp.mat33),
    geom: wp.array(dtype=wp.vec2i),
    dist: wp.array(dtype=float),
    pos: wp.array(dtype=wp.vec3),
    frame: wp.array(dtype=wp.mat33),
    friction: wp.array(dtype=vec5),
    solref: wp.array(dtype=wp.vec2),
    solimp: wp.array(dtype=vec5),
    n_contacts: wp.array(dtype=int),
    contact_key: wp.array2d(dtype=wp.int64),
    rows: wp.array3d(dtype=float),
    blocks: wp.array3d(dtype=int),
    n_blocks: wp.array(dtype=int),
):
    """A contact's place among its world's, and its rows there. One thread a world and contact.

    Rows give the acceleration of the second block's body against the first's along normal and tangents. The moment
    arms are in the bodies' frames. With pyramidal cones the four edges' rows are normal ± friction × tangent, and
    are never written down.
    """
    world, slot = wp.tid()
    count = wp.min(n_contacts[world], contact_key.shape[1])
    if slot >= count:
        return
    key = contact_key[world, slot]
    me = int(key % wp.int64(geom.shape[0]))
    place = int(0)
    for begin in range(0, count, SEARCH):
        for i in range(SEARCH):
            its_key = contact_key[world, begin + i]
            place += wp.where(begin + i < count and its_key < key, 1, 0)
    first = geom[me][0]
    second = geom[me][1]
    axes = frame[me]
    if first > second:
        # Seen from the other body the whole frame turns around, and forces stay what they are.
        first = geom[me][1]
        second = geom[me][0]
        axes = -axes
    one = first - 1 - held
    two = second - 1 - held
    arms_one = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    arms_two = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    velocity = wp.vec3(0.0, 0.0, 0.0)
    if one >= 0:
        arms_one = _moment_arms(axes, pos[me] - geom_xpos[world, first], geom_xmat[world, first])
        velocity -= _velocity_along(axes, arms_one, qvel, world, one)
    if two >= 0:
        arms_two = _moment_arms(axes, pos[me] - geom_xpos[world, second], geom_xmat[world, second])
        velocity += _velocity_along(axes, arms_two, qvel, world, two)
    kbi = _reference(solref[me], solimp[me], dist[me], timestep)
    mu = friction[me][0]
    weight = body_invweight[world, first, 0] + body_invweight[world, second, 0]
    if pyramidal != 0:
        weight = 2.0 * mu * mu * weight * (1.0 + mu * mu)
    for r in range(3):
        for i in range(3):
            rows[world, place, 3 * r + i] = axes[r, i]
            rows[world, place, 9 + 3 * r + i] = arms_one[r, i]
            rows[world, place, 18 + 3 * r + i] = arms_two[r, i]
        rows[world, place, 27 + r] = -kbi[1] * velocity[r]
    rows[world, place, 27] = -kbi[1] * velocity[0] - kbi[0] * kbi[2] * dist[me]
    rows[world, place, 30] = 1.0 / wp.max(weight * (1.0 - kbi[2]) / kbi[2], MIN_VALUE)
    rows[world, place, 31] = mu
    blocks[world, place, 0] = one
    blocks[world, place, 1] = two
    wp.atomic_max(n_blocks, world, two + 1)


@wp.kernel(enable_backward=False)
def link_blocks(
    n_contacts: wp.array(dtype=int),
    n_blocks: wp.array(dtype=int),
    blocks: wp.array3d(dtype=int),
    link_begin: wp.array2d(dtype=int),
    links: wp.array2d(dtype=int),
    lowest: wp.array2d(dtype=int),
):
    """Each block's contacts: 2 × contact + side, those with lower blocks first. One thread a world and block.

    ``links[world, link_begin[world, b]:link_begin[world, b + 1]]`` are block b's; ``lowest`` is the lowest block
    that it touches, or itself.
    """
    world, block = wp.tid()
    if block > n_blocks[world]:
        return
    count = wp.min(n_contacts[world], blocks.shape[1])
    at = int(0)
    ones = vec8i()
    twos = vec8i()
    for begin in range(0, count, SEARCH):
        for i in range(SEARCH):
            ones[i] = blocks[world, begin + i, 0]
            twos[i] = blocks[world, begin + i, 1]
        for i in range(SEARCH):
            if begin + i < count:
                at += wp.where(ones[i] >= 0 and ones[i] < block, 1, 0)
                at += wp.where(twos[i] >= 0 and twos[i] < block, 1, 0)
    link_begin[world, block] = at
    if block == n_blocks[world]:
        return
    low = int(block)
    for begin in range(0, count, SEARCH):
        for i in range(SEARCH):
            ones[i] = blocks[world, begin + i, 0]
            twos[i] = blocks[world, begin + i, 1]
        for i in range(SEARCH):
            k = begin + i
            if k < count and (ones[i] == block or twos[i] == block):
                links[world, at] = 2 * k + wp.where(twos[i] == block, 1, 0)
                at += 1
                if twos[i] == block and ones[i] >= 0:
                    low = wp.min(low, ones[i])
    lowest[world, block] = low


@wp.kernel(enable_backward=False)
def end_step(
    held: int,
    timestep: float,
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    geom_xpos: wp.array2d(dtype=wp.vec3),
    smooth: wp.array2d(dtype=float),
    acceleration: wp.array2d(dtype=wp.float64),
    force: wp.array3d(dtype=wp.float64),
    rows: wp.array3d(dtype=float),
    blocks: wp.array3d(dtype=int),
    n_blocks: wp.array(dtype=int),
    link_begin: wp.array2d(dtype=int),
    links: wp.array2d(dtype=int),
    next_qpos: wp.array2d(dtype=float),
    next_qvel: wp.array2d(dtype=float),
    qacc: wp.array2d(dtype=float),
    top_force: wp.array2d(dtype=float),
):
    """Semi-implicit Euler, and the force on each box's top (spec, section 5). One thread a world and block."""
    world, block = wp.tid()
    dof = 6 * block
    at = 7 * block
    touched = block < n_blocks[world]
    for i in range(6):
        a = smooth[world, dof + i]
        if touched:
            a = float(acceleration[world, dof + i])
        qacc[world, dof + i] = a
        next_qvel[world, dof + i] = qvel[world, dof + i] + timestep * a
    for i in range(3):
        next_qpos[world, at + i] = qpos[world, at + i] + timestep * next_qvel[world, dof + i]
    spin = _three(next_qvel, world, dof + 3)
    angle = timestep * wp.length(spin)
    sine = timestep * 0.5
    if angle > 1e-6:
        sine = wp.sin(angle * 0.5) / wp.length(spin)
    cosine = wp.cos(angle * 0.5)
    v = sine * spin
    w = qpos[world, at + 3]
    u = _three(qpos, world, at + 4)
    turned_w = w * cosine - wp.dot(u, v)
    turned = w * v + cosine * u + wp.cross(u, v)
    size = wp.sqrt(turned_w * turned_w + wp.dot(turned, turned))
    next_qpos[world, at + 3] = turned_w / size
    for i in range(3):
        next_qpos[world, at + 4 + i] = turned[i] / size

    box = block - 1 + held
    if box < 0:
        return
    total = wp.float64(0.0)
    if touched:
        z = geom_xpos[world, block + 1 + held][2]
        end = link_begin[world, block + 1]
        for begin in range(link_begin[world, block], end, TOGETHER):
            # Nothing in here depends on what is in another contact: their loads wait side by side.
            for i in range(TOGETHER):
                link = links[world, wp.min(begin + i, end - 1)]
                k = link // 2
                side = link % 2
                its_z = geom_xpos[world, blocks[world, k, 1 - side] + 1 + held][2]
                up = wp.float64(0.0)
                for r in range(3):
                    up += wp.float64(rows[world, k, 3 * r + 2]) * force[world, k, r]
                up = wp.where(side == 1, -up, up)
                vertical = wp.abs(rows[world, k, 2]) >= VERTICAL_COSINE
                lower = z < its_z or (side == 1 and z == its_z)
                total += wp.where(begin + i < end and vertical and lower, up, wp.float64(0.0))
    top_force[world, box] = float(total)
