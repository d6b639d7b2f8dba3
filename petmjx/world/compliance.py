"""Compliance of boxes: contacts are springs whose stiffness depends on the two boxes that touch.

A box of stiffness k is compressed by F/k between a load F on its top and its support. Half of the compression is at
each face, as in a column. So a box sinks by m·g/2k under its own weight. A face is a bed of springs (Winkler 1867, "Die
Lehre von der Elasticität und Festigkeit") with a stiffness of 2k/A per area, where A is the area of the face. If two
faces press on one another, their beds are in series. The planned common area of the two faces determines the stiffness
of the contact. So a box sinks deeper if less of its base is supported, and a narrow box presses deeper into its
support.

At rest, MuJoCo's contact of impedance d and time constant τ is the spring f = x / (τ²·ζ²·(1 − d)·A), where A is the sum
of the inverse masses (petmjx/world/contact_laws.py). So each stiffness corresponds to an impedance. If that impedance
were below ``LEAST_IMPEDANCE``, the time constant is made longer instead. No box can be stiffer than the contacts of
``Physics``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.options.physics import Physics, Triple
from petmjx.world.contact_laws import CONTACTS_PER_FACE
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene
from petmjx.world.supports import TOUCH_M, bearing_of

LEAST_IMPEDANCE: Final = 0.5
"""Smallest impedance. With a smaller impedance, friction would give way: boxes on a slope would creep by tenths of a
millimetre per second."""

LEAST_SHARE: Final = 0.05
"""Smallest common area of two faces, as a share of the smaller face. A sliver that two boxes share only because of
position errors is not a bed of springs."""


POINTS_PER_BED: Final = 4
"""Number of contacts between two faces that press on one another, if at least one of the boxes is compliant."""

EDGE_SHARE: Final = 2 / 3
"""Smallest share of the common area of two faces that counts as pressed; smaller shares are treated as equal to this
one. On springs alone, a load near an edge would sink without limit. A real carton spreads such a load, and its edges
bear more than its middle. A load up to 0.28 of the width from the middle leans as on springs alone."""

OUTWARD: Final = 0.6
"""If the pressed share is below ``EDGE_SHARE``, the pressure also moves outwards, towards the deepest line. The
pressure moves by this factor times (``EDGE_SHARE`` / share − 1) of the distance to that line. At a quarter of the face,
the pressure reaches the deepest line. The lean is then 12 F / (k·L). At this lean, of the nine points of Simpson's
rule, only those at one edge bear load."""

FACE_COSINE: Final = 0.5
"""Two faces press on one another if the cosine between the normal of one and the reversed normal of the other is at
least this. Otherwise, an edge presses on a body."""


@dataclass(frozen=True)
class Face:
    """The values of a shape that determine the law of its contacts: those of its face and of its body.

    Attributes:
        give: area of the face over twice the stiffness, A/2k, m³/N; 0: the face is rigid.
        middle, half: planned middle and half extents, m.
        inverse_mass: 1 / mass of its body, 1/kg; 0: the body does not move.
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
    """Planned area over which two shapes press on one another. If neither shape is above the other, it is the area of
    the smaller shape."""
    (ax, ay, az), (bx, by, bz) = one.middle, two.middle
    (al, aw, ah), (bl, bw, bh) = one.half, two.half
    smaller = 4.0 * min(al * aw, bl * bw)
    length, width = min(ax + al, bx + bl) - max(ax - al, bx - bl), min(ay + aw, by + bw) - max(ay - aw, by - bw)
    if abs(az - bz) < ah + bh - TOUCH_M or length <= 0.0 or width <= 0.0:
        return smaller
    return max(length * width, LEAST_SHARE * smaller)


def spring_laws(physics: Physics, spring_n_m: FloatArray, inverse_mass: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(p, 2) MuJoCo's solref and (p,) impedances of contacts that behave at rest like springs of these stiffnesses."""
    time_s, damping, impedance = _spring_terms(physics, spring_n_m, inverse_mass)
    return np.column_stack(np.broadcast_arrays(time_s, damping)), impedance


def spring_law(physics: Physics, spring_n_m: float, inverse_mass: float) -> tuple[tuple[float, float], Triple]:
    """MuJoCo's solref and solimp of a contact that behaves at rest like a spring of this stiffness."""
    time_s, damping, impedance = map(float, _spring_terms(physics, spring_n_m, inverse_mass))
    return (time_s, damping), (impedance, impedance, physics.solimp[2])


def _spring_terms(physics: Physics, spring_n_m: Any, inverse_mass: Any) -> tuple[Any, Any, Any]:
    """Both numbers of solref, and the impedance: three numbers for one contact, or arrays (p,) for p contacts."""
    time_s, damping = physics.solref
    time_s = time_s if time_s < 0 else max(time_s, 2 * physics.timestep_s)
    # stiffness of the contact's spring at rest, multiplied by (1 − d)·A; the product is in 1/s²
    stiffness = -time_s if time_s < 0 else 1 / (time_s * damping) ** 2
    lack = stiffness / (spring_n_m * inverse_mass)
    impedance = np.clip(1 - lack, LEAST_IMPEDANCE, physics.solimp[1])
    longer = np.maximum(lack / (1 - LEAST_IMPEDANCE), 1.0)
    if time_s < 0:
        return time_s / longer, damping / longer**0.5, impedance
    return time_s * longer**0.5, damping, impedance


def law_between(physics: Physics, one: Face, two: Face | None) -> tuple[tuple[float, float], Triple]:
    """MuJoCo's solref and solimp of the contacts between two shapes, or between a shape and the floor if ``two`` is
    None."""
    give = one.give + (two.give if two is not None else 0.0)
    if give == 0.0:
        return physics.solref, physics.solimp
    area = 4.0 * one.half[0] * one.half[1] if two is None else shared_area_m2(one, two)
    inverse_mass = one.inverse_mass + (two.inverse_mass if two is not None else 0.0)
    return spring_law(physics, area / give / CONTACTS_PER_FACE, inverse_mass)


def bed_depth_m(scene: Scene, load_n: FloatArray) -> FloatArray:
    """(n,) planned compression of the springs below each box, m; 0 if nothing is compliant.

    Args:
        load_n: (n,) weight of each box plus its load, N.
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

    The descent of a box is the compression of the springs below it plus the largest descent of the boxes on which it
    rests, under the planned loads.
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
