"""Contact tilt: how soft contacts make stacks lean, and how near these stacks come to tipping over.

The contacts below a box give way, and they give way more on the side on which the load acts. So the box turns by an
angle: the difference between the depths of the contacts on its two sides, divided by the width between these sides. The
load is at a height above the contacts, so the load moves towards the edge when the box turns. A box stands on a base of
width w, and the side of the base away from the edge carries the share r of the load. Then the load acts at the distance
r·w from the edge. If no contact had given way, the load would act at the distance

    e(r) = r·w + h·(x(1 − r) − x(r)) / w

from the edge. h is the height of the load's centre, and x is the depth of a side that carries a share of the load
(``petmjx.world.contact_laws``). The smallest e(r) is called the *tipping distance*. A load that would act nearer to the
edge than its tipping distance tips over. If boxes below lean, the angle by which they lean, times h, is added to the
tipping distance.

The tipping distance may be millimetres for a column of slender boxes, or for a light box under a heavy box, but is much
less for real cartons. If the tilt by soft contacts may have decided the verdict of a world, the world is simulated
again with stiffer contacts (petmjx/engines/attempt_settings.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Outcome
from petmjx.options.physics import Physics
from petmjx.options.simulation import Simulation
from petmjx.world.bearings import Bearing
from petmjx.world.contact_laws import depth_m, is_stiff
from petmjx.world.history import CARRIER
from petmjx.world.job import Job

CONTACTS_PER_SIDE: Final = 2

SHARES: Final = np.array([1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5])
"""The shares r for which e(r) is computed (see the module's docstring)."""

SAFETY: Final = 10.0
"""A load may tip over if its distance from the edge is at most this multiple of its tipping distance (see the module's
docstring). The multiple is larger than 1, since a box rocks when the next box is placed on it. Some stacks are stable
by statics, but fall because contacts are soft. In these stacks, the distance of a load from its edge was at most 8
times the load's tipping distance."""

STIFF_SAFETY: Final = 40.0
"""Multiple of the tipping distance that replaces ``SAFETY`` in a further attempt with stiffer contacts. Stiffer
contacts make the tipping distance 40 times smaller. In stacks that fell, the distance of a load from its edge was at
most 28 times the load's tipping distance."""

SURE: Final = 1.0
"""Multiple of the tipping distance that replaces ``SAFETY`` for a stack in which a load acts beyond an edge in the
plan. A stack with a load beyond an edge would also fall on hard contacts. So soft contacts may be the cause of the fall
only if another load is nearer to its edge than the tipping distance of this load."""

BEYOND_M: Final = 0.0004
"""A load that is farther beyond an edge than this distance, m, surely acts beyond the edge. The distance is half a
millimetre in the plan, minus the amount by which simulated boxes are smaller than planned."""

ROCKING_M: Final = 0.001
"""A load that acts less than this distance (m) inside the edge may have tipped over because of soft contacts, even if
its tipping distance is smaller. The reason: a box rocks by some tenths of a millimetre when the next box is placed."""

BOUND_SHARE: Final = 0.25
"""Soft contacts may have decided the verdict if they tilt a box by more than this share of the tilt threshold, or move
it, down or sideways, by more than this share of the shift threshold (5 mm of 20 mm). A stack of ten equal boxes
descends by 1 mm, a stack of thirty by 9 mm."""


class ContactTilt(NamedTuple):
    """How soft contacts tilt and move n boxes.

    Attributes:
        tipping_m: (n,) the tipping distance of the load of each box (see the module's docstring), m.
        angle_rad: (n,) angle by which each box leans, rad.
        shift_m: (n,) distance by which each box's centre moves sideways, m.
    """

    tipping_m: FloatArray
    angle_rad: FloatArray
    shift_m: FloatArray


def contact_tilt_of(bearing: Bearing, load: FloatArray, edge_m: FloatArray, physics: Physics) -> ContactTilt:
    """Upper estimates of how far boxes lean under loads that act ``edge_m`` inside the edges of their supports.

    Args:
        load: (n, 4) the loads of the boxes, as returned by ``Bearing.loads``.
        edge_m: (n,) distance of each box's load from the nearest edge of its supports, m.
    """
    boxes, width = bearing.boxes, bearing.widths_m
    with np.errstate(divide="ignore", invalid="ignore"):
        height = load[:, 3] / load[:, 0] - boxes.bottom
    of_carrier = bearing.lower == CARRIER
    mass_below = np.where(of_carrier, boxes.carrier_mass[bearing.upper], boxes.mass[bearing.lower])
    inverse_below = np.zeros(len(boxes.mass))
    np.maximum.at(inverse_below, bearing.upper, 1 / mass_below)
    pull = (1 / boxes.mass + inverse_below) * load[:, 0] * physics.gravity_m_s2 / CONTACTS_PER_SIDE

    def angle(share: FloatArray) -> FloatArray:
        turned: FloatArray = (depth_m(physics, pull * (1 - share)) - depth_m(physics, pull * share)) / width
        return turned

    own_lean = np.nan_to_num(angle(np.clip(edge_m / width, 0.0, 0.5)))
    # A box whose load acts beyond the edge would tip over on hard contacts, too. So its tilt is not due to soft
    # contacts.
    own_lean[edge_m < -BEYOND_M] = 0.0
    below, shift = _tilt_from_below(bearing, own_lean)
    tipping = (SHARES[:, None] * width + angle(SHARES[:, None]) * height).min(axis=0)
    return ContactTilt(tipping + below * height, below + own_lean, shift)


def _tilt_from_below(bearing: Bearing, own_lean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two arrays (n,): the angle (rad) by which each box leans because the boxes below it lean, and the distance (m) by
    which the centre of each box moves sideways."""
    bottom, middle, half = bearing.boxes.bottom, bearing.boxes.target[:, 2], bearing.boxes.half_size[:, 2]
    below, moved = np.zeros((2, len(own_lean)))
    turned, shift = own_lean.copy(), own_lean * half
    for between in reversed(bearing.levels):  # the loop goes from the lowest boxes up
        upper, lower = bearing.upper[between], bearing.lower[between]
        below[upper] = moved[upper] = -np.inf
        np.maximum.at(below, upper, turned[lower])
        np.maximum.at(moved, upper, shift[lower] + turned[lower] * (bottom[upper] - middle[lower]))
        turned[upper] = below[upper] + own_lean[upper]
        shift[upper] = moved[upper] + turned[upper] * half[upper]
    return below, shift


def n_loading(outcome: Outcome) -> int:
    """Number of boxes that had been placed when a world first failed. If the world did not fail: the number of placed
    boxes."""
    return outcome.n_at_sign if outcome.n_at_sign > 0 else outcome.n_placed


def places_with_errors(job: Job) -> FloatArray:
    """(n, 3) the places of boxes from which loads are computed in a world with placement or size errors, m. With such
    errors, every body below a box counts as a support of the box if the gap between the two is at most the shift
    threshold.

    A box with errors often overlaps a neighbour that is millimetres higher, and is released on the strip in which the
    two overlap. The box does not stay on this strip: it tips and leans on the bodies beside the strip. So loads are
    computed at the places of release, and the bodies beside the strip count as supports, too. If the higher neighbour
    were the only support, 75 of 167 unstable worlds with errors would be simulated again. Since the bodies beside the
    strip count, too, only a few of these worlds are simulated again.
    """
    places: FloatArray = np.c_[job.scene.start_pos[:, :2], job.scene.target[:, 2]]
    return places


def contact_tilt_suspects(
    outcomes: Sequence[Outcome],
    jobs: Sequence[Job],
    sim: Simulation,
    bearing: Bearing,
    load: FloatArray,
    edge: FloatArray,
) -> list[bool]:
    """For each world, whether it may be unstable because contacts are soft. A world may be unstable for this reason if
    its boxes lean too far, or if a load that acts inside an edge in the plan may have moved beyond this edge.
    ``outcomes`` must not be empty.

    Args:
        bearing: the supports of the boxes in all these worlds; worlds with errors have the places of
            ``places_with_errors``.
        load: (n, 4) the loads of the boxes, as returned by ``Bearing.loads``, when ``n_loading`` boxes are placed.
        edge: (n,) distances of these loads from the edges, m.
    """
    placed = [n_loading(outcome) for outcome in outcomes]
    under = _supports(bearing)
    lean = contact_tilt_of(bearing, load, edge, sim.physics)
    limits, first = sim.thresholds, bearing.boxes.first.tolist()
    most_safety = STIFF_SAFETY if is_stiff(sim.physics) else SAFETY

    def leans(outcome: Outcome, has_errors: bool, first: int, end: int) -> bool:
        shifts_far = lean.shift_m[first:end].max(initial=0.0) > BOUND_SHARE * limits.shift_m
        if shifts_far or np.degrees(lean.angle_rad[first:end].max(initial=0.0)) > BOUND_SHARE * limits.tilt_deg:
            return True
        pile = _pile_of(under, first + outcome.culprit) if outcome.culprit >= 0 else [*range(first, end)]
        edges, tipping = edge[pile], lean.tipping_m[pile]
        beyond = bool((edges < -BEYOND_M).any())
        reach = (SURE if beyond else most_safety) * tipping
        least = BEYOND_M
        # the value ``ROCKING_M`` only holds if all boxes were placed at their planned places
        if not (beyond or has_errors):
            reach, least = np.maximum(reach, ROCKING_M), 0.0
        return bool(((edges > least) & (edges <= reach)).any())

    return [
        leans(outcome, job.has_errors, k, k + n)
        for outcome, job, k, n in zip(outcomes, jobs, first, placed, strict=False)
    ]


def _supports(bearing: Bearing) -> list[list[int]]:
    """For each box, the numbers of the boxes that carry it."""
    under: list[list[int]] = [[] for _ in bearing.boxes.mass]
    for upper, lower in zip(bearing.upper.tolist(), bearing.lower.tolist(), strict=True):
        if lower != CARRIER:
            under[upper].append(lower)
    return under


def _pile_of(under: Sequence[Sequence[int]], box: int) -> list[int]:
    """The numbers of a box and of all boxes that carry it, directly or through other boxes."""
    pile, new = {box}, [box]
    while new:
        below = [lower for lower in under[new.pop()] if lower not in pile]
        pile.update(below)
        new += below
    return sorted(pile)
