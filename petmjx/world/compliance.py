"""Compliance of boxes: contacts are springs whose stiffness depends on the two boxes that touch.

A load F on top of a box of stiffness k compresses the box by F/k. In this model, half of the compression is at the top
face, and half at the bottom face. So a box sinks by m·g / (2k) under its own weight. A face is a bed of springs
(Winkler 1867, "Die Lehre von der Elasticität und Festigkeit") with a stiffness of 2k/A per area, where A is the area of
the face. If two faces press on one another, their beds of springs are in series. The stiffness of the contact is
proportional to the area in which the two faces overlap, seen from above, at the boxes' planned places. So a box sinks
deeper if less of its base is supported, and a narrow box presses deeper into its support.

At rest, MuJoCo's contact of impedance d and time constant τ is the spring f = x / (τ²·ζ²·(1 − d)·A), where A is the sum
of the inverse masses (petmjx/world/contact_laws.py). By this formula, each stiffness f / x corresponds to an impedance
d. If a stiffness corresponds to an impedance below ``LEAST_IMPEDANCE``, the contact gets the impedance
``LEAST_IMPEDANCE`` and a longer time constant. No impedance is larger than the largest one in ``Physics.solimp``, which
limits the stiffness of boxes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics, Triple
from petmjx.world.bearings import TOUCH_M
from petmjx.world.contact_laws import CONTACTS_PER_FACE
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene
from petmjx.world.supports import bearing_of

LEAST_IMPEDANCE: Final = 0.5
"""Smallest impedance. With a smaller impedance, friction would give way: boxes on a slope would creep by tenths of a
millimetre per second."""

LEAST_SHARE: Final = 0.05
"""The common area of two faces that touch is taken to be at least this share of the smaller face. Position errors can
make two boxes overlap by a thin strip, which does not behave like a bed of springs."""


POINTS_PER_BED: Final = 4
"""Number of contacts between two faces that press on one another, if at least one of the boxes is compliant."""

EDGE_SHARE: Final = 2 / 3
"""If more than this share of the common area of two faces is pressed, the stiffness of the contact is proportional to
the pressed share. If less of the area is pressed, the springs are as stiff as if ``EDGE_SHARE`` of the area were
pressed. If stiffness were always proportional to the pressed share, a load near an edge would sink without limit. A
real carton spreads such a load, and its edges carry more than its middle. ``EDGE_SHARE`` has no effect if the load acts
at most 0.28 × the width away from the middle of the area."""

OUTWARD: Final = 0.6
"""If the pressed share of a face is below ``EDGE_SHARE``, the contact points move towards the deepest edge, by
``OUTWARD`` × (``EDGE_SHARE`` / share − 1) × the distance to that edge. If a quarter of the face is pressed, the
pressure reaches the edge. The angle between the two faces is then 12 F / (k·L), rad. F is the force of the contact, L
the width of its common area, and k its stiffness if the whole common area is pressed. Simpson's rule evaluates the
pressure at nine points. At this angle, only the points at one edge carry load."""

FACE_COSINE: Final = 0.5
"""Two faces press on one another if the cosine of the angle between one face's normal and the other face's reversed
normal is at least this value. If the cosine is smaller, an edge presses on a body."""


@dataclass(frozen=True)
class Face:
    """The properties of a shape that determine how stiff its contacts are.

    Attributes:
        give: area of the shape's face divided by twice the body's stiffness, A / (2k), m³/N; 0 if the face is rigid.
        middle, half: planned middle and half extents of the shape, m.
        inverse_mass: 1 / mass of the shape's body, 1/kg; 0 if the body does not move.
    """

    give: float
    middle: Triple
    half: Triple
    inverse_mass: float


def compliances(stiffness_n_m: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n,) area of each box's top divided by twice its stiffness, m³/N; 0 for a rigid box (stiffness inf)."""
    area: FloatArray = 4.0 * half_size[:, 0] * half_size[:, 1]
    return area / (2.0 * stiffness_n_m)


def shared_area_m2(one: Face, two: Face) -> float:
    """Area in which two shapes overlap, seen from above, at their planned places, m². If they overlap by less than
    ``LEAST_SHARE`` of the smaller shape's area, the result is ``LEAST_SHARE`` times this area. If neither shape is
    above the other, the area of the smaller shape is used."""
    (ax, ay, az), (bx, by, bz) = one.middle, two.middle
    (al, aw, ah), (bl, bw, bh) = one.half, two.half
    smaller = 4.0 * min(al * aw, bl * bw)
    length, width = min(ax + al, bx + bl) - max(ax - al, bx - bl), min(ay + aw, by + bw) - max(ay - aw, by - bw)
    if abs(az - bz) < ah + bh - TOUCH_M or length <= 0.0 or width <= 0.0:
        return smaller
    return max(length * width, LEAST_SHARE * smaller)


def spring_laws(physics: Physics, spring_n_m: FloatArray, inverse_mass: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(p, 2) MuJoCo's ``solref`` and (p,) impedances of contacts that behave at rest like given springs.

    Args:
        spring_n_m: (p,) stiffness of each spring, N/m.
        inverse_mass: (p,) sum of the inverse masses of the two bodies at each contact, 1/kg.
    """
    time_s, damping, impedance = _spring_terms(physics, spring_n_m, inverse_mass)
    return np.column_stack(np.broadcast_arrays(time_s, damping)), impedance


def spring_law(physics: Physics, spring_n_m: float, inverse_mass: float) -> tuple[tuple[float, float], Triple]:
    """MuJoCo's ``solref`` and ``solimp`` of one contact that behaves at rest like a spring; see ``spring_laws``."""
    time_s, damping, impedance = map(float, _spring_terms(physics, spring_n_m, inverse_mass))
    return (time_s, damping), (impedance, impedance, physics.solimp[2])


def _spring_terms(physics: Physics, spring_n_m: Any, inverse_mass: Any) -> tuple[Any, Any, Any]:
    """Three values with which a contact at rest acts like the given spring: the two numbers of ``solref``, and the
    impedance. They are numbers for one contact, and arrays (p,) for p contacts."""
    time_s, damping = physics.solref
    time_s = time_s if time_s < 0 else max(time_s, 2 * physics.timestep_s)
    # ``stiffness`` has the unit 1/s². At rest, it equals spring_n_m · inverse_mass · (1 − impedance).
    stiffness = -time_s if time_s < 0 else 1 / (time_s * damping) ** 2
    lack = stiffness / (spring_n_m * inverse_mass)
    impedance = np.clip(1 - lack, LEAST_IMPEDANCE, physics.solimp[1])
    longer = np.maximum(lack / (1 - LEAST_IMPEDANCE), 1.0)
    if time_s < 0:
        return time_s / longer, damping / longer**0.5, impedance
    return time_s * longer**0.5, damping, impedance


def law_between(physics: Physics, one: Face, two: Face | None) -> tuple[tuple[float, float], Triple] | None:
    """MuJoCo's ``solref`` and ``solimp`` of the contacts between two shapes; None: neither shape is compliant, so their
    contacts have the law of rigid bodies. If ``two`` is None, the second shape is the floor."""
    give = one.give + (two.give if two is not None else 0.0)
    if give == 0.0:
        return None
    area = 4.0 * one.half[0] * one.half[1] if two is None else shared_area_m2(one, two)
    inverse_mass = one.inverse_mass + (two.inverse_mass if two is not None else 0.0)
    return spring_law(physics, area / give / CONTACTS_PER_FACE, inverse_mass)


def bed_depth_m(scene: Scene, load_n: FloatArray) -> FloatArray:
    """(n,) compression of the springs between each box and its supports, m; 0 if neither the box nor its supports are
    compliant.

    Args:
        load_n: (n,) force with which each box presses on its supports, N.
    """
    if scene.stiffness is None:
        return np.zeros(scene.n_boxes)
    bearing = bearing_of(scene)
    give = np.append(compliances(scene.stiffness, scene.half_size), 0.0)  # the last entry is for CARRIER
    area = (bearing.high - bearing.low).prod(axis=1)
    with np.errstate(divide="ignore"):
        spring = area / (give[bearing.upper] + give[bearing.lower])
    total = np.zeros(scene.n_boxes)
    np.add.at(total, bearing.upper, spring)
    return np.where(total > 0, load_n / np.where(total > 0, total, 1.0), 0.0)


@lru_cache(maxsize=256)
def sinks_m(scene: Scene, gravity_m_s2: float) -> FloatArray | None:
    """(n,) distance by which each box is expected to sink once all boxes are placed, m; None if no box is compliant.

    A box sinks by the compression of the springs below it, plus the distance by which its supports sink (the largest,
    if they differ). The loads on the springs are the loads of the complete plan.
    """
    if scene.stiffness is None:
        return None
    bearing = bearing_of(scene)
    depth = bed_depth_m(scene, gravity_m_s2 * bearing.loads(scene.n_boxes)[:, 0])
    sink_m = np.zeros(scene.n_boxes)
    for box in np.argsort(scene.target[:, 2] - scene.half_size[:, 2], kind="stable").tolist():
        lower = bearing.lower[bearing.upper == box]
        below = sink_m[lower[lower != CARRIER]]
        sink_m[box] = depth[box] + below.max(initial=0.0)
    return sink_m
