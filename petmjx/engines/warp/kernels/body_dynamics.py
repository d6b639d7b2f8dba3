"""Motion of a world's bodies: from poses to accelerations without contacts, and from accelerations to the next poses.

Bodies are rigid, with diagonal inertia in their frames (petmjx/world/body_shapes.py). Body 0 is the carrier, and box k
is body k + 1. All bodies are free, except a held carrier. A free body can move, and has six rows in the equations of
motion. Free bodies are numbered from 0: the number is the body's number, or one less if the carrier is held. A negative
number stands for a body that cannot move. Geom 0 is the floor, and shape k is geom k + 1.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.mjx import top_forces as force_metrics
from petmjx.engines.mjx.rules import UNBELIEVABLE
from petmjx.engines.warp.kernels.block_collectives import cross, fused, fused_double, times, times_double
from petmjx.engines.warp.kernels.efc import number_of
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds

VERTICAL_COSINE = wp.constant(force_metrics.VERTICAL_COSINE)
MOST = wp.constant(UNBELIEVABLE)

ROOM = wp.constant(2e-3)
"""Distance by which a body may move before pairs are listed again, m: about half of the distance at which pairs are
listed (collision.APART)."""

vec6 = wp.types.vector(length=6, dtype=float)


@wp.func
def body_of(worlds: Ref[Worlds], world: int, geom: int) -> int:
    """The body of a geom; -1 for the floor."""
    if geom == 0:
        return -1
    return worlds.shape_body[world, geom - 1]


@wp.func
def first_geom(worlds: Ref[Worlds], world: int, body: int) -> int:
    """The first geom of a body. The geoms of the previous body end before this geom."""
    return worlds.first_shape[world, body] + 1


@wp.func
def box_half(worlds: Ref[Worlds], world: int, box: int) -> wp.vec3:
    """Half extents of a box, m."""
    return wp.vec3(worlds.half[world, box, 0], worlds.half[world, box, 1], worlds.half[world, box, 2])


@wp.func
def geom_half(worlds: Ref[Worlds], world: int, geom: int) -> wp.vec3:
    """Half extents of a geom other than the floor, m."""
    half = worlds.shape_half[world, geom - 1]
    return wp.vec3(half[0], half[1], half[2])


@wp.func
def middle_of(worlds: Ref[Worlds], world: int, box: int, place: wp.vec3, q: wp.vec4) -> wp.vec3:
    """The centre of a box whose frame has the origin ``place`` and the orientation ``q``, m."""
    middle = wp.vec3(worlds.middle[world, box, 0], worlds.middle[world, box, 1], worlds.middle[world, box, 2])
    return place + rotation(q) * middle


@wp.func
def skin_of(model: Ref[Model], worlds: Ref[Worlds], world: int, geom: int) -> float:
    """Skin by which a geom is enlarged for the collider, m (as in petmjx/world/mujoco_model.py). The floor has none."""
    body = body_of(worlds, world, geom)
    return wp.where(body < 0, 0.0, wp.where(body == 0, model.carrier_skin, model.skin))


@wp.func
def moments(half: wp.vec3, mass: float) -> wp.vec3:
    """Principal moments of a solid box, kg·m²: m/3 · (b² + c²)."""
    squares = wp.vec3(times(half[0], half[0]), times(half[1], half[1]), times(half[2], half[2]))
    total = squares[0] + squares[1] + squares[2]
    third = mass / 3.0
    return wp.vec3(third * (total - squares[0]), third * (total - squares[1]), third * (total - squares[2]))


@wp.func
def doubled(v: wp.vec3) -> wp.vec3d:
    """The same vector in double precision."""
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def center(state: Ref[State], world: int, body: int) -> wp.vec3:
    """Centre of mass of a body, m."""
    if body == 0:
        return wp.vec3(state.carrier_qpos[world, 0], state.carrier_qpos[world, 1], state.carrier_qpos[world, 2])
    box = body - 1
    return wp.vec3(state.qpos[world, box, 0], state.qpos[world, box, 1], state.qpos[world, box, 2])


@wp.func
def exact_center(state: Ref[State], world: int, body: int) -> wp.vec3d:
    """Centre of mass of a body in double precision, m."""
    place = center(state, world, body)
    remainder = wp.vec3(0.0, 0.0, 0.0)
    for i in range(3):
        if body == 0:
            remainder[i] = state.carrier_qpos_remainder[world, i]
        else:
            remainder[i] = state.qpos_remainder[world, body - 1, i]
    return doubled(place) + doubled(remainder)


@wp.func
def orientation(state: Ref[State], world: int, body: int) -> wp.vec4:
    """Quaternion of a body, w first."""
    if body == 0:
        p = state.carrier_qpos[world]
        return wp.vec4(p[3], p[4], p[5], p[6])
    q = state.qpos[world, body - 1]
    return wp.vec4(q[3], q[4], q[5], q[6])


@wp.func
def linear_velocity(state: Ref[State], world: int, body: int) -> wp.vec3:
    """Velocity of a body's centre of mass, m/s."""
    if body == 0:
        return wp.vec3(state.carrier_qvel[world, 0], state.carrier_qvel[world, 1], state.carrier_qvel[world, 2])
    v = state.qvel[world, body - 1]
    return wp.vec3(v[0], v[1], v[2])


@wp.func
def angular_velocity(state: Ref[State], world: int, body: int) -> wp.vec3:
    """Angular velocity of a body in its own frame, rad/s."""
    if body == 0:
        return wp.vec3(state.carrier_qvel[world, 3], state.carrier_qvel[world, 4], state.carrier_qvel[world, 5])
    v = state.qvel[world, body - 1]
    return wp.vec3(v[3], v[4], v[5])


@wp.func
def rotation(q: wp.vec4) -> wp.mat33:
    """Rotation matrix of a quaternion, which need not be of unit length, but must not be zero."""
    w = q[0]
    x = q[1]
    y = q[2]
    z = q[3]
    xx = times(x, x)
    yy = times(y, y)
    zz = times(z, z)
    wx = times(w, x)
    wy = times(w, y)
    wz = times(w, z)
    s = 2.0 / (w * w + xx + yy + zz)
    return wp.mat33(
        1.0 - s * (yy + zz),
        s * fused(x, y, -wz),
        s * fused(x, z, wy),
        s * fused(x, y, wz),
        1.0 - s * (xx + zz),
        s * fused(y, z, -wx),
        s * fused(x, z, -wy),
        s * fused(y, z, wx),
        1.0 - s * (xx + yy),
    )


@wp.func
def exact_rotation(q: wp.vec4) -> wp.mat33d:
    """``rotation`` in double precision."""
    w = wp.float64(q[0])
    x = wp.float64(q[1])
    y = wp.float64(q[2])
    z = wp.float64(q[3])
    one = wp.float64(1.0)
    xx = times_double(x, x)
    yy = times_double(y, y)
    zz = times_double(z, z)
    wx = times_double(w, x)
    wy = times_double(w, y)
    wz = times_double(w, z)
    s = wp.float64(2.0) / fused_double(w, w, xx + yy + zz)
    return wp.mat33d(
        fused_double(-s, yy + zz, one),
        times_double(s, fused_double(x, y, -wz)),
        times_double(s, fused_double(x, z, wy)),
        times_double(s, fused_double(x, y, wz)),
        fused_double(-s, xx + zz, one),
        times_double(s, fused_double(y, z, -wx)),
        times_double(s, fused_double(x, z, -wy)),
        times_double(s, fused_double(y, z, wx)),
        fused_double(-s, xx + yy, one),
    )


@wp.func
def begin_step(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    at: Thread,
    gravity: wp.vec3,
    push: wp.vec3,
    sample: bool,
    # Data out:
    work: Ref[Workspace],
) -> bool:
    """Compute the poses of geoms, the diagonal of the inertia matrix, the accelerations without contacts, and the
    accelerations from which the solver starts.

    A free body's angular velocity is in its own frame, so Euler's equation gives the torque −ω × I·ω. All memory loads
    come before the first store, so that the loads run at the same time.

    Args:
        push: force on the carrier, N.
        sample: whether to keep the poses.

    Returns:
        Whether any of the thread's bodies has moved by more than ``ROOM``, so that pairs must be listed again.
    """
    block = at.block
    world = at.world
    left = bool(False)
    if at.thread == 0:
        work.geom_xpos[block, 0] = wp.vec3(0.0, 0.0, worlds.floor_z[world])
        work.geom_xmat[block, 0] = wp.identity(n=3, dtype=float)
        work.geom_reach[block, 0] = wp.vec3(0.0, 0.0, 0.0)
        work.nfree[block] = at.placed + 1 - at.held
        work.worst[block] = wp.int64(0)
    for geom in range(1 + at.thread, at.geoms, at.threads):
        body = body_of(worlds, world, geom)
        frame = center(state, world, body)
        q = orientation(state, world, body)
        spin = angular_velocity(state, world, body)
        half = geom_half(worlds, world, geom)
        offset = worlds.shape_pos[world, geom - 1]
        mass = worlds.mass[world, body]
        equal = worlds.inertia_box[world, body]
        home = work.listed_xpos[block, geom]
        home_reach = work.listed_reach[block, geom]
        leads = first_geom(worlds, world, body) == geom
        start = vec6()
        for i in range(6):
            if body == 0:
                start[i] = state.carrier_qacc_warmstart[world, i]
            else:
                start[i] = state.qacc_warmstart[world, body - 1, i]
        turn = rotation(q)
        place = frame + turn * wp.vec3(offset[0], offset[1], offset[2])
        # ``reach``: half extents of the bounding box of the geom after its enlargement by the skin (a margin). The skin
        # is then subtracted, since a contact begins only when two enlarged geoms overlap by both skins.
        skin = wp.where(body == 0, model.carrier_skin, model.skin)
        skinned = half + wp.vec3(skin, skin, skin)
        reach = wp.vec3(
            wp.dot(wp.abs(turn[0]), skinned) - skin,
            wp.dot(wp.abs(turn[1]), skinned) - skin,
            wp.dot(wp.abs(turn[2]), skinned) - skin,
        )
        out = wp.abs(place - home) + reach - home_reach
        if wp.max(out[0], wp.max(out[1], out[2])) > ROOM:
            left = True
        work.geom_xpos[block, geom] = place
        work.geom_xmat[block, geom] = turn
        work.geom_reach[block, geom] = reach
        free_body = body - at.held
        if not leads:
            continue
        if sample and body >= 1:
            for i in range(3):
                work.qpos_before[block, body - 1, i] = frame[i]
            for i in range(4):
                work.qpos_before[block, body - 1, 3 + i] = q[i]
        if free_body < 0:
            continue
        inertia = moments(wp.vec3(equal[0], equal[1], equal[2]), mass)
        torque = -cross(spin, wp.cw_mul(inertia, spin))
        dof = 6 * free_body
        for i in range(3):
            force = wp.where(body == 0, push[i], 0.0)
            work.qM[block, dof + i] = mass
            work.qM[block, dof + 3 + i] = inertia[i]
            work.qacc_smooth[block, dof + i] = gravity[i] + force / mass
            work.qacc_smooth[block, dof + 3 + i] = torque[i] / inertia[i]
        for i in range(6):
            work.qacc[block, dof + i] = wp.float64(start[i])
    return left


@wp.func
def _is_number(x: float) -> bool:
    """Whether MuJoCo would accept a position or velocity."""
    return wp.abs(x) < MOST


@wp.func
def end_step(
    # Model:
    model: Ref[Model],
    # In:
    at: Thread,
    measured: bool,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> bool:
    """Take a step of semi-implicit Euler. Returns whether any of the thread's bodies has a position or velocity that is
    too large or not finite.

    The accelerations from which the solver starts in the next step are extrapolated from the accelerations of the
    previous step and of this step. With this start, the solver takes a quarter fewer iterations than with the
    accelerations of this step (benchmarks/notebook/performance.md).

    Args:
        measured: whether to compute the force on each box's top, too.
    """
    block = at.block
    world = at.world
    astray = bool(False)
    for body in range(at.held + at.thread, at.placed + 1, at.threads):
        free_body = body - at.held
        dof = 6 * free_body
        qacc = vec6()
        for i in range(6):
            qacc[i] = float(work.qacc[block, dof + i])
        linear = linear_velocity(state, world, body)
        spin = angular_velocity(state, world, body)
        for i in range(3):
            linear[i] = linear[i] + model.timestep * qacc[i]
            spin[i] = spin[i] + model.timestep * qacc[3 + i]
        exact = exact_center(state, world, body)
        where = wp.vec3(0.0, 0.0, 0.0)
        remainder = wp.vec3(0.0, 0.0, 0.0)
        for i in range(3):
            exact[i] = fused_double(wp.float64(model.timestep), wp.float64(linear[i]), exact[i])
            where[i] = float(exact[i])
            remainder[i] = float(exact[i] - wp.float64(where[i]))
        speed = wp.length(spin)
        angle = model.timestep * speed
        sine = model.timestep * 0.5
        if angle > 1e-6:
            sine = wp.sin(angle * 0.5) / speed
        cosine = wp.cos(angle * 0.5)
        v = sine * spin
        q = orientation(state, world, body)
        w = q[0]
        u = wp.vec3(q[1], q[2], q[3])
        turned_w = w * cosine - wp.dot(u, v)
        turned = w * v + cosine * u + cross(u, v)
        size = wp.sqrt(turned_w * turned_w + wp.dot(turned, turned))
        after = wp.vec4(turned_w / size, turned[0] / size, turned[1] / size, turned[2] / size)
        for i in range(3):
            good = _is_number(where[i]) and _is_number(linear[i]) and _is_number(spin[i]) and _is_number(after[1 + i])
            if not good or not _is_number(after[0]):
                astray = True
        if body == 0:
            for i in range(3):
                state.carrier_qpos[world, i] = where[i]
                state.carrier_qpos_remainder[world, i] = remainder[i]
                state.carrier_qvel[world, i] = linear[i]
                state.carrier_qvel[world, 3 + i] = spin[i]
            for i in range(4):
                state.carrier_qpos[world, 3 + i] = after[i]
            for i in range(6):
                state.carrier_qacc_warmstart[world, i] = 2.0 * qacc[i] - state.carrier_qacc[world, i]
                state.carrier_qacc[world, i] = qacc[i]
        else:
            box = body - 1
            for i in range(3):
                state.qpos[world, box, i] = where[i]
                state.qpos_remainder[world, box, i] = remainder[i]
                state.qvel[world, box, i] = linear[i]
                state.qvel[world, box, 3 + i] = spin[i]
            for i in range(4):
                state.qpos[world, box, 3 + i] = after[i]
            for i in range(6):
                state.qacc_warmstart[world, box, i] = 2.0 * qacc[i] - state.qacc[world, box, i]
                state.qacc[world, box, i] = qacc[i]
            if measured:
                work.top_force[block, box] = _top_force(work, block, free_body)
    return astray


@wp.func
def _top_force(work: Ref[Workspace], block: int, free_body: int) -> float:
    """Force that presses on a box from above, N: the sum over its contacts whose normal is within 45° of z and points
    upwards from the box."""
    total = wp.float64(0.0)
    for entry in range(work.body_conadr[block, free_body], work.body_conadr[block, free_body + 1]):
        link = work.body_contact[block, entry]
        k = link // 2
        side = link % 2
        normal_z = number_of(work.efc, block, k, 2)  # the normal points from the first body to the second
        if wp.where(side == 1, -normal_z, normal_z) >= VERTICAL_COSINE:
            up = wp.float64(0.0)
            for r in range(3):
                up += wp.float64(number_of(work.efc, block, k, 3 * r + 2)) * work.contact_force[block, k, r]
            total += wp.where(side == 1, -up, up)
    return float(total)
