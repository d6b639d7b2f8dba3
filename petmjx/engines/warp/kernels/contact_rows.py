"""Rows of contacts: the constraints of a world in the solver, and the contacts of each body.

Contacts have MuJoCo's parameters (MuJoCo's documentation, "Modeling", "Solver parameters"). Each of the two bodies of a
contact is either free to move in all directions or does not move at all. So 27 numbers describe a contact: nine for its
frame, and nine (three moment arms) for each body.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import cross, fused, prefix_sums, times, wait_for_all
from petmjx.engines.warp.kernels.body_dynamics import angular_velocity, body_of, center, first_geom, linear_velocity
from petmjx.engines.warp.kernels.compliance import spring_law
from petmjx.engines.warp.kernels.efc import is_new, put_number
from petmjx.engines.warp.kernels.elimination_order import free_position
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds
from petmjx.world.contact_laws import STICKS_M_S

# MuJoCo's bounds (mjMINVAL, mjMINIMP, mjMAXIMP, mjMINMU), and its power and midpoint of impedances (solimp).
MIN_VALUE = wp.constant(1e-15)
MIN_IMPEDANCE = wp.constant(1e-4)
MAX_IMPEDANCE = wp.constant(0.9999)
MIN_FRICTION = wp.constant(1e-5)

STICKS = wp.constant(STICKS_M_S)


@wp.func
def _frame_of(direction: wp.vec3) -> wp.mat33:
    """The frame of a contact, one axis per row, as in MuJoCo (mujoco_warp's make_frame)."""
    normal = wp.normalize(direction)
    other = wp.where((-0.5 < normal[1]) and (normal[1] < 0.5), wp.vec3(0.0, 1.0, 0.0), wp.vec3(0.0, 0.0, 1.0))
    one = wp.normalize(other - normal * wp.dot(normal, other))
    two = cross(normal, one)
    return wp.matrix_from_rows(normal, one, two)


@wp.func
def _stiffness(model: Ref[Model]) -> wp.vec2:
    """Stiffness and damping of contacts (MuJoCo's documentation, "Modeling", "Solver parameters")."""
    high = wp.clamp(model.solimp[1], MIN_IMPEDANCE, MAX_IMPEDANCE)
    time = model.solref[0]
    ratio = model.solref[1]
    if time <= 0.0:
        return wp.vec2(-time / (high * high), -ratio / high)
    time = wp.max(time, 2.0 * model.timestep)
    return wp.vec2(1.0 / (high * high * time * time * ratio * ratio), 2.0 / (high * time))


@wp.func
def _impedance(model: Ref[Model], depth: float) -> float:
    """Impedance of a contact (MuJoCo's documentation, "Modeling", "Solver parameters")."""
    low = wp.clamp(model.solimp[0], MIN_IMPEDANCE, MAX_IMPEDANCE)
    high = wp.clamp(model.solimp[1], MIN_IMPEDANCE, MAX_IMPEDANCE)
    x = wp.min(wp.abs(depth) / wp.max(model.solimp[2], MIN_VALUE), 1.0)
    # this curve has the midpoint 0.5 and the power 2, which are MuJoCo's defaults
    y = wp.where(x <= 0.5, 2.0 * x * x, 1.0 - 2.0 * (1.0 - x) * (1.0 - x))
    return low + y * (high - low)


@wp.func
def _moment_arms(axes: wp.mat33, lever: wp.vec3, turn: wp.mat33) -> wp.mat33:
    """Moment arms: velocity along each axis at the end of a lever, per angular velocity in the body's own frame."""
    arms = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for r in range(3):
        arms[r] = wp.transpose(turn) * cross(lever, axes[r])
    return arms


@wp.func
def _pair_compliance(worlds: Ref[Worlds], at: Thread, body: int) -> float:
    """MuJoCo's inverse weight of a body, 1/kg; 0 if it does not move."""
    if body - at.held < 0:
        return 0.0
    return 1.0 / worlds.mass[at.world, body]


@wp.func
def _friction(worlds: Ref[Worlds], world: int, geom: int) -> float:
    """Sliding friction of a geom."""
    if geom == 0:
        return worlds.floor_friction[world, 0]
    return worlds.friction[world, geom - 1, 0]


@wp.func
def surface_of(worlds: Ref[Worlds], world: int, geom: int) -> int:
    """Number of the surface of a geom. The floor has surface 0, for which no pair of surfaces has values."""
    if geom == 0:
        return 0
    return worlds.shape_surface[world, geom - 1]


@wp.func
def _friction_of_pair(worlds: Ref[Worlds], world: int, first: int, second: int) -> float:
    """Sliding friction between two geoms: the value that is given for their pair of surfaces; if there is none, the
    larger of the two geoms' values."""
    pair_friction = worlds.pair_friction[world, surface_of(worlds, world, first), surface_of(worlds, world, second)]
    if pair_friction >= 0.0:
        return pair_friction
    return wp.max(_friction(worlds, world, first), _friction(worlds, world, second))


@wp.func
def _kinetic_share(model: Ref[Model], worlds: Ref[Worlds], world: int, first: int, second: int) -> float:
    """Friction between two geoms while they slide, as a share of their friction at rest."""
    of_pair = worlds.pair_kinetic[world, surface_of(worlds, world, first), surface_of(worlds, world, second)]
    return wp.where(of_pair >= 0.0, of_pair, model.kinetic_share)


@wp.func
def friction_share(kinetic: float, slip: float) -> float:
    """Share of the friction at rest that a contact has while it slides at this speed. Twin of
    petmjx/world/contact_laws.py."""
    return 1.0 - times(1.0 - kinetic, wp.clamp(slip / STICKS - 1.0, 0.0, 1.0))


@wp.func
def make_constraint(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    at: Thread,
    ncon: int,
    # Data out:
    work: Ref[Workspace],
) -> None:
    """Write the constraints of all contacts into ``efc`` (``world_arrays.EFC_WORDS``).

    Rows give the acceleration of the second body relative to the first, along normal and tangents. Moment arms are in
    the frames of the bodies. Sliding contacts have the law of petmjx/world/contact_laws.py. With pyramidal cones the
    rows of the four edges are normal ± friction × tangent; they are not stored. ``excess`` is set to the largest slip
    excess with which the solver may begin.
    """
    block = at.block
    world = at.world
    stiffness = _stiffness(model)
    last_pair = int(-1)
    first = int(0)
    second = int(0)
    body_one = int(0)
    body_two = int(0)
    friction = float(0.0)
    weight = float(0.0)
    axes = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for contact in range(at.thread, ncon, at.threads):
        pair = work.contact_pair[block, contact]
        if is_new(pair, last_pair):
            last_pair = pair
            first = work.pair_geom1[block, pair]
            second = work.pair_geom2[block, pair]
            axes = _frame_of(work.pair_normal[block, pair])
            body_one = body_of(worlds, world, first)
            body_two = body_of(worlds, world, second)
            friction = wp.max(_friction_of_pair(worlds, world, first, second), MIN_FRICTION)
            weight = _pair_compliance(worlds, at, body_one) + _pair_compliance(worlds, at, body_two)
            if model.pyramidal != 0:
                weight = 2.0 * friction * friction * weight * (1.0 + friction * friction)
        one = body_one - at.held
        two = body_two - at.held
        mu = friction
        point = work.pair_points[block, pair, contact - work.pair_conadr[block, pair]]
        touch = wp.vec3(point[0], point[1], point[2])
        arms_one = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        arms_two = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        velocity = wp.vec3(0.0, 0.0, 0.0)
        if one >= 0:
            arms_one = _moment_arms(axes, touch - center(state, world, body_one), work.geom_xmat[block, first])
            along = axes * linear_velocity(state, world, body_one)
            velocity -= along + arms_one * angular_velocity(state, world, body_one)
        if two >= 0:
            arms_two = _moment_arms(axes, touch - center(state, world, body_two), work.geom_xmat[block, second])
            along = axes * linear_velocity(state, world, body_two)
            velocity += along + arms_two * angular_velocity(state, world, body_two)
        kbi = wp.vec3(stiffness[0], stiffness[1], _impedance(model, point[3]))
        if at.gives != 0:
            spring = work.pair_spring[block, pair]
            if spring > 0.0:
                kbi = spring_law(model, spring, weight)
        damping = wp.where(model.friction_damping > 0.0, model.friction_damping, kbi[1])
        for r in range(3):
            for i in range(3):
                put_number(work.efc, block, contact, 3 * r + i, axes[r, i])
                put_number(work.efc, block, contact, 9 + 3 * r + i, arms_one[r, i])
                put_number(work.efc, block, contact, 18 + 3 * r + i, arms_two[r, i])
        pull = -times(times(kbi[0], kbi[2]), point[3])
        slip = wp.sqrt(fused(velocity[1], velocity[1], times(velocity[2], velocity[2])))
        if slip > STICKS:  # slower contacts have full friction, so most contacts need no look-up of the kinetic share
            mu = times(mu, friction_share(_kinetic_share(model, worlds, world, first, second), slip))
        excess = times(damping, slip) - model.slip_slack
        work.excess[block, contact] = wp.where(excess > 0.0, excess, -1.0)
        put_number(work.efc, block, contact, 27, fused(-kbi[1], velocity[0], pull))
        put_number(work.efc, block, contact, 28, -damping * velocity[1])
        put_number(work.efc, block, contact, 29, -damping * velocity[2])
        put_number(work.efc, block, contact, 30, 1.0 / wp.max(weight * (1.0 - kbi[2]) / kbi[2], MIN_VALUE))
        put_number(work.efc, block, contact, 31, mu)
        work.contact_bodies[block, contact, 0] = one
        work.contact_bodies[block, contact, 1] = two
    wait_for_all()


@wp.func
def link_contacts(
    # Model:
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    at: Thread,
    # Data out:
    work: Ref[Workspace],
) -> None:
    """List the contacts of each free body. Each entry is a link: 2 × number of the contact + side of the body (0 or 1).

    ``body_contact[block, body_conadr[block, b]:body_conadr[block, b + 1]]`` are the links of free body b, in the order
    of contacts. Contacts in which b is the second body come first. ``lowest``, indexed by a body's position in the
    system, is the lowest position among this body and the free bodies that it touches.
    """
    block = at.block
    nfree = work.nfree[block]
    for free_body in range(at.thread, nfree, at.threads):
        geom = first_geom(worlds, at.world, free_body + at.held)
        end_geom = first_geom(worlds, at.world, free_body + at.held + 1)
        first = work.geom1_pairadr[block, geom]
        end = work.geom1_pairadr[block, end_geom]
        count = work.pair_conadr[block, end] - work.pair_conadr[block, first]
        for entry in range(work.geom2_pairadr[block, geom], work.geom2_pairadr[block, end_geom]):
            pair = work.geom2_pair[block, entry]
            count += work.pair_conadr[block, pair + 1] - work.pair_conadr[block, pair]
        work.body_conadr[block, free_body] = count
    wait_for_all()
    prefix_sums(work.body_conadr, block, nfree, at.thread)
    wait_for_all()
    for free_body in range(at.thread, nfree, at.threads):
        geom = first_geom(worlds, at.world, free_body + at.held)
        end_geom = first_geom(worlds, at.world, free_body + at.held + 1)
        position = free_position(state, at, free_body)
        low = int(position)
        link = work.body_conadr[block, free_body]
        for entry in range(work.geom2_pairadr[block, geom], work.geom2_pairadr[block, end_geom]):
            pair = work.geom2_pair[block, entry]
            begin = work.pair_conadr[block, pair]
            end = work.pair_conadr[block, pair + 1]
            for contact in range(begin, end):
                work.body_contact[block, link] = 2 * contact + 1
                link += 1
            other = body_of(worlds, at.world, work.pair_geom1[block, pair]) - at.held
            if end > begin and other >= 0:
                low = wp.min(low, free_position(state, at, other))
        for pair in range(work.geom1_pairadr[block, geom], work.geom1_pairadr[block, end_geom]):
            begin = work.pair_conadr[block, pair]
            end = work.pair_conadr[block, pair + 1]
            for contact in range(begin, end):
                work.body_contact[block, link] = 2 * contact
                link += 1
            if end > begin:
                low = wp.min(
                    low, free_position(state, at, body_of(worlds, at.world, work.pair_geom2[block, pair]) - at.held)
                )
        work.position[block, free_body] = position
        work.lowest[block, position] = low
    wait_for_all()
