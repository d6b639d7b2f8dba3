"""Contact laws of compliant boxes: contacts are springs with the stiffness of both boxes. Twin of
petmjx/world/compliance.py."""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.body_dynamics import body_of, geom_half
from petmjx.engines.warp.world_arrays import Model, Ref, Worlds
from petmjx.world.bearings import TOUCH_M
from petmjx.world.compliance import LEAST_IMPEDANCE, LEAST_SHARE
from petmjx.world.contact_laws import CONTACTS_PER_FACE

TOUCH = wp.constant(TOUCH_M)
LEAST = wp.constant(LEAST_IMPEDANCE)
SHARE = wp.constant(LEAST_SHARE)
CONTACTS = wp.constant(float(CONTACTS_PER_FACE))


@wp.func
def _planned_middle(worlds: Ref[Worlds], world: int, geom: int) -> wp.vec3:
    """Planned centre of a geom other than the floor, m."""
    body = body_of(worlds, world, geom)
    place = wp.vec3(0.0, 0.0, 0.0)
    for i in range(3):
        if body == 0:
            place[i] = worlds.carrier_pos[world, i] + worlds.shape_pos[world, geom - 1, i]
        else:
            offset = worlds.shape_pos[world, geom - 1, i] - worlds.middle[world, body - 1, i]
            place[i] = worlds.target[world, body - 1, i] + offset
    return place


@wp.func
def _shared_area(worlds: Ref[Worlds], world: int, first: int, second: int) -> float:
    """Planned area in which two geoms press on one another, m²."""
    one = geom_half(worlds, world, first)
    two = geom_half(worlds, world, second)
    a = _planned_middle(worlds, world, first)
    b = _planned_middle(worlds, world, second)
    smaller = 4.0 * wp.min(one[0] * one[1], two[0] * two[1])
    length = wp.min(a[0] + one[0], b[0] + two[0]) - wp.max(a[0] - one[0], b[0] - two[0])
    width = wp.min(a[1] + one[1], b[1] + two[1]) - wp.max(a[1] - one[1], b[1] - two[1])
    if wp.abs(a[2] - b[2]) < one[2] + two[2] - TOUCH or length <= 0.0 or width <= 0.0:
        return smaller
    return wp.max(length * width, SHARE * smaller)


@wp.func
def compliance_of_pair(worlds: Ref[Worlds], world: int, first: int, second: int) -> float:
    """Area divided by the stiffness of two geoms' beds of springs in series, m³/N; 0: both geoms are rigid."""
    give = worlds.shape_give[world, second - 1]
    if first != 0:
        give += worlds.shape_give[world, first - 1]
    return give


@wp.func
def spring_of_bed(area: float, give: float) -> float:
    """Stiffness of a contact between two faces that press on one another with this area (m²), N/m."""
    return area / give / CONTACTS


@wp.func
def spring_of_pair(worlds: Ref[Worlds], world: int, first: int, second: int) -> float:
    """Stiffness of a contact of two geoms whose faces do not meet, N/m. The stiffness is 0 if both geoms are rigid."""
    give = compliance_of_pair(worlds, world, first, second)
    half = geom_half(worlds, world, second)
    area = 4.0 * half[0] * half[1]
    if first != 0:
        area = _shared_area(worlds, world, first, second)
    if give == 0.0:
        return 0.0
    return area / give / CONTACTS


@wp.func
def spring_law(model: Ref[Model], spring: float, inverse_mass: float) -> wp.vec3:
    """Stiffness, damping and impedance with which a contact at rest behaves like a spring of the stiffness ``spring``,
    N/m."""
    time = model.solref[0]
    ratio = model.solref[1]
    if time > 0.0:
        time = wp.max(time, 2.0 * model.timestep)
    stiffness = wp.where(time > 0.0, 1.0 / (time * time * ratio * ratio), -time)
    lack = stiffness / (spring * inverse_mass)
    impedance = wp.clamp(1.0 - lack, LEAST, wp.min(model.solimp[1], 0.9999))
    longer = wp.max(lack / (1.0 - LEAST), 1.0)
    if time <= 0.0:
        of_length = longer * impedance * impedance
        return wp.vec3(-time / of_length, -ratio / (impedance * wp.sqrt(longer)), impedance)
    time = time * wp.sqrt(longer)
    return wp.vec3(1.0 / (impedance * impedance * time * time * ratio * ratio), 2.0 / (impedance * time), impedance)
