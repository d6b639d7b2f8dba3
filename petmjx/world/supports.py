"""Finds the supports of boxes in plans (``find_bearings``). A support of a box is a body below the box that touches its
base. petmjx.world.bearings has the loads on supports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.bearings import TOUCH_M, Bearing, Boxes, IntArray, spans
from petmjx.world.body_shapes import Body
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene, carrier_of, half_size_and_target, slab_places

_LEAST_OVERLAP_M: Final = 1e-6


@lru_cache(maxsize=256)
def bearing_of(scene: Scene) -> Bearing:
    """The contacts of a scene, from ``find_bearings``. The contacts are cached, since many worlds of a sweep have the
    same scene."""
    return find_bearings([scene], [scene.target])


def bearings_of(
    scenes: Sequence[Scene],
    elsewhere: Sequence[Scene] = (),
    pos: Sequence[FloatArray] = (),
    most_gap_m: Sequence[float] = (),
    up: Sequence[FloatArray] = (),
) -> Bearing:
    """The contacts of several scenes in one ``Bearing``, scene after scene.

    Args:
        scenes: scenes whose boxes are at their planned places. The contacts of these scenes come first.
        elsewhere: scenes whose boxes are at other places. The contacts of these scenes come after the contacts of
            ``scenes``.
        pos: (n, 3) places of the boxes in each scene of ``elsewhere``, m.
        most_gap_m: ``most_gap_m`` of ``find_bearings`` for each scene of ``elsewhere``.
        up: ``up`` of ``find_bearings`` for each scene of ``elsewhere``. If ``up`` is empty, all boxes stand upright.
    """
    if len({id(scene) for scene in scenes}) == 1 and not elsewhere:
        one = bearing_of(scenes[0])
        return one if len(scenes) == 1 else one.of_scenes(np.zeros(len(scenes), np.intp))[0]
    gaps_m = np.array([TOUCH_M] * len(scenes) + list(most_gap_m))
    upright = [np.broadcast_to(UPRIGHT, scene.target.shape) for scene in scenes] if len(up) else []
    return find_bearings([*scenes, *elsewhere], [*(scene.target for scene in scenes), *pos], gaps_m, [*upright, *up])


_SORTED_M: Final = 1e-4
"""Tolerance of a first, rough search for contacts, m. The search raises the heights of each scene by a different
amount, and the sums have rounding errors."""


UPRIGHT: Final = (0.0, 0.0, 1.0)
"""Unit vector along the vertical edges of a box that stands upright."""

_MOST_TILT_COSINE: Final = 0.5
"""Boxes that are tilted by more than 60° are treated as if they stood upright: they no longer rest on the bases that
they have in the plan. For such a box, the unit vector along the edges that are vertical in the plan has a z component
below this value."""


@dataclass(frozen=True, eq=False)
class _Faces:
    """The bottom and top faces of n boxes that may be tilted.

    Attributes:
        slope: (n, 2) slope of each box's bottom and top along x and y.
        aside_m: (n, 2) horizontal vector from the middle of a box to the middle of its top face, m.
        bottom, top: (n,) heights of the planes of each box's bottom and top at the x and y of the box's middle, m.
        rise_m: (n,) largest height of a point of the bottom face above the middle of the face, m.
    """

    slope: FloatArray
    aside_m: FloatArray
    bottom: FloatArray
    top: FloatArray
    rise_m: FloatArray

    @classmethod
    def of(cls, boxes: Boxes, up: Sequence[FloatArray]) -> _Faces:
        half, height = boxes.half_size, boxes.target[:, 2]
        if not len(up):
            flat = np.zeros((len(half), 2))
            return cls(flat, flat, height - half[:, 2], height + half[:, 2], np.zeros(len(half)))
        axis = np.concatenate(up)
        stands = axis[:, 2] >= _MOST_TILT_COSINE  # False for NaN
        axis = np.where(stands[:, None], axis, UPRIGHT)
        slope = -axis[:, :2] / axis[:, 2:]
        half_height = half[:, 2] / axis[:, 2]
        rise_m = (np.abs(slope) * half[:, :2]).sum(axis=1)
        return cls(slope, axis[:, :2] * half[:, 2:], height - half_height, height + half_height, rise_m)


def find_bearings(
    scenes: Sequence[Scene],
    targets: Sequence[FloatArray],
    most_gap_m: float | FloatArray = TOUCH_M,
    up: Sequence[FloatArray] = (),
) -> Bearing:
    """The contacts between boxes and their supports in several scenes, in one ``Bearing``, scene after scene.

    A box lies on a board of the carrier's deck if the box's bottom is not above the deck. Box A lies on box B if B's
    bottom is lower than A's bottom, and B's top is at the height of A's bottom. Heights are compared with the tolerance
    ``TOUCH_M``, and the two bodies must overlap along x and y. A box above a sheet or a pallet lies on the pieces of
    the sheet, or on the boards of the pallet's deck.

    Args:
        targets: (n, 3) middles of the boxes in each scene, m.
        most_gap_m: largest gap, m, below a box's bottom across which the box still counts as lying on a body. One value
            for all scenes, or (s,) one value for each scene. The gap can exceed ``TOUCH_M``, since a box may lean onto
            a lower body.
        up: (n, 3) unit vectors along those edges of the boxes in each scene that are vertical in the plan. A tilted box
            touches a body below it where the gap between the two faces is at most ``most_gap_m``. A contact is the
            rectangle around this part of the faces. If ``up`` is empty, all boxes stand upright.
    """
    boxes, decks = Boxes.of(scenes, targets), _decks([scene.carrier for scene in scenes])
    return _find_bearings(boxes, decks, most_gap_m, scenes, up)


def find_plain_bearings(
    size_mm: FloatArray, corner_mm: FloatArray, mass_kg: FloatArray, counts: Sequence[int], sim: Simulation
) -> Bearing:
    """The contacts in several plans with ``has_plain_scene``, as ``find_bearings`` finds them in the scenes of the
    plans. No ``Scene`` is made, which saves more than half of the time.

    Args:
        size_mm, corner_mm: (n, 3) extents and corners of the boxes of all plans, plan after plan, mm.
        mass_kg: (n,) masses of these boxes, kg.
        counts: number of boxes of each plan.
    """
    n, first = len(mass_kg), np.concatenate([[0], np.cumsum(counts)])
    half_size, target = half_size_and_target(size_mm, corner_mm, sim)
    carrier_mass = np.full(n, sim.physics.carrier_mass_kg)
    boxes = Boxes(first, target, half_size, mass_kg, np.zeros((n, 3)), carrier_mass, np.zeros((n, 2, 2)))
    place, half = slab_places(corner_mm, size_mm, first[:-1], sim)
    decks = (place - half)[:, :2], (place + half)[:, :2], np.ones(len(counts), np.intp)
    return _find_bearings(boxes, decks, TOUCH_M, ())


def _find_bearings(
    boxes: Boxes,
    decks: tuple[FloatArray, FloatArray, IntArray],
    most_gap_m: float | FloatArray,
    scenes: Sequence[Scene],
    up: Sequence[FloatArray] = (),
) -> Bearing:
    """The contacts of ``find_bearings``.

    Args:
        decks: the result of ``_decks``.
        most_gap_m, up: as for ``find_bearings``.
        scenes: the scenes, if some of them have sheets or pallets among their boxes.
    """
    low, high, counts = boxes.target - boxes.half_size, boxes.target + boxes.half_size, np.diff(boxes.first)
    faces_of_boxes = _Faces.of(boxes, up)
    scene_of = np.repeat(np.arange(len(counts)), counts)
    gap_m = np.broadcast_to(most_gap_m, len(counts))[scene_of]
    deck_low, deck_high, boards = decks
    bottom, top, rise_m = faces_of_boxes.bottom, faces_of_boxes.top, faces_of_boxes.rise_m
    lies = np.flatnonzero(bottom - rise_m <= gap_m)
    lying, board = np.repeat(lies, boards[scene_of[lies]]), spans(boards, scene_of[lies])
    below, above = _touching(scene_of, bottom, top, gap_m, rise_m, is_tilted=len(up) > 0)
    face_low, face_high, faces = _top_faces(boxes, scenes, low, high)
    if len(up):
        aside_m = np.repeat(faces_of_boxes.aside_m, faces, axis=0)
        face_low, face_high = face_low + aside_m, face_high + aside_m
    above, face, below = np.repeat(above, faces[below]), spans(faces, below), np.repeat(below, faces[below])
    upper = np.concatenate([lying, above])
    lower = np.concatenate([np.full(len(board), CARRIER), below])
    low, high = low[:, :2] - faces_of_boxes.aside_m, high[:, :2] - faces_of_boxes.aside_m
    area_low = np.maximum(low.take(upper, axis=0), np.concatenate([deck_low[board], face_low.take(face, axis=0)]))
    area_high = np.minimum(high.take(upper, axis=0), np.concatenate([deck_high[board], face_high.take(face, axis=0)]))
    if len(up):
        area_low, area_high = _pressed(boxes, faces_of_boxes, upper, lower, area_low, area_high, gap_m)
    extent = area_high - area_low
    wide = np.flatnonzero((extent[:, 0] > _LEAST_OVERLAP_M) & (extent[:, 1] > _LEAST_OVERLAP_M))
    # lexsort is stable: contacts of a box with several boards keep their order
    order = wide[np.lexsort((lower[wide], upper[wide]))]
    if len(up):
        order = order[without_circles(upper[order], lower[order], boxes.target[:, 2])]
    return Bearing(boxes, upper[order], lower[order], area_low.take(order, axis=0), area_high.take(order, axis=0))


def _pressed(
    boxes: Boxes,
    faces: _Faces,
    upper: IntArray,
    lower: IntArray,
    low: FloatArray,
    high: FloatArray,
    most_gap_m: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(c, 2) lowest and (c, 2) highest corners of smaller rectangles within the contacts' rectangles, m: each is around
    the part in which the gap between the two faces is at most ``most_gap_m``. ``high`` is below ``low`` if no part is
    left, or if two boxes overlap by more than ``TOUCH_M`` everywhere.

    Args:
        upper, lower: (c,) numbers of the two bodies of each contact.
        low, high: (c, 2) corners of the rectangles in which the two faces are above each other, m.
        most_gap_m: (n,) ``most_gap_m`` of ``find_bearings`` for each box.
    """
    on_box = lower != CARRIER
    below = np.where(on_box, lower, 0)
    # the gap is ``gap`` at the low corner, and grows by ``rise`` along x and y to the opposite sides of the rectangle
    slope = faces.slope[upper] - np.where(on_box[:, None], faces.slope[below], 0.0)
    gap = faces.bottom[upper] + (faces.slope[upper] * (low - boxes.target[upper, :2])).sum(axis=1)
    gap -= np.where(on_box, faces.top[below] + (faces.slope[below] * (low - boxes.target[below, :2])).sum(axis=1), 0.0)
    extent = high - low
    rise = slope * extent
    least, most = np.minimum(rise, 0.0), np.maximum(rise, 0.0)
    room = most_gap_m[upper] - gap - least.sum(axis=1)
    touches = (room >= 0.0) & (~on_box | (gap + most.sum(axis=1) >= -TOUCH_M))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(np.where(rise != 0.0, room[:, None] / np.abs(rise), 1.0), 0.0, 1.0)
    new_low = np.where(rise < 0.0, high - share * extent, low)
    new_high = np.where(rise > 0.0, low + share * extent, high)
    return new_low, np.where(touches[:, None], new_high, -np.inf)


def without_circles(upper: IntArray, lower: IntArray, height: FloatArray) -> NDArray[np.bool_]:
    """(c,) which contacts remain if no box may lie on itself through other boxes. Tilted boxes may lie on one another
    in a circle. Of the contacts in and below a circle, those remain whose upper box has the higher middle.

    Args:
        upper, lower: (c,) numbers of the two bodies of each contact.
        height: (n,) heights of the boxes' middles, m.
    """
    may_be_circle = lower != CARRIER
    while True:
        has_load = np.zeros(len(height), bool)
        has_load[lower[may_be_circle]] = True
        remaining = may_be_circle & has_load[upper]
        if (remaining == may_be_circle).all():
            kept: NDArray[np.bool_] = ~remaining | (height[lower] < height[upper])
            return kept
        may_be_circle = remaining


def deck_mm(plan: Plan, sim: Simulation) -> FloatArray:
    """(b, 2, 2) lowest and highest corner (x, y) of each board of the deck of a plan's carrier, mm. The deck consists
    of the boards on which boxes can stand."""
    low, high, _ = _decks([carrier_of(plan, sim)])
    return MM_PER_M * np.stack([low, high], axis=1)


def _decks(carriers: Sequence[Body]) -> tuple[FloatArray, FloatArray, IntArray]:
    """Three arrays: (b, 2) lowest and (b, 2) highest corners (x, y) of the boards that form the carriers' decks, m,
    carrier after carrier; and (s,) the number of these boards of each carrier."""
    n_boards = [carrier.n_boards for carrier in carriers]
    shape_pos, half = (
        np.concatenate([getattr(carrier, name)[:n] for carrier, n in zip(carriers, n_boards, strict=True)])
        for name in ("shape_pos", "half_size")
    )
    center = np.repeat([carrier.pos for carrier in carriers], n_boards, axis=0) + shape_pos
    deck = (center + half)[:, 2] >= -TOUCH_M
    boards = np.bincount(np.repeat(np.arange(len(carriers)), n_boards)[deck], minlength=len(carriers))
    return (center - half)[deck, :2], (center + half)[deck, :2], boards


def _top_faces(
    boxes: Boxes, scenes: Sequence[Scene], low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Three arrays: (t, 2) lowest and (t, 2) highest corners of the top faces of boxes, m, box after box; and (n,) the
    number of top faces of each box.

    A box has one top face, a sheet has one per piece, and a pallet among the boxes has one per board of its deck.

    Args:
        low, high: (n, 3) lowest and highest corners of the boxes, m.
    """
    counts = np.ones(len(low), np.intp)
    if not any(scene.pieces for scene in scenes):
        return low[:, :2], high[:, :2], counts
    face_low, face_high = [], []
    for scene, (first, end) in zip(scenes, pairwise(boxes.first.tolist()), strict=True):
        shapes, rows = scene.shapes, slice(first, end)
        of_boxes = np.flatnonzero(shapes.body != CARRIER)
        box = shapes.body[of_boxes]
        middle = boxes.target[rows][box] + shapes.pos[of_boxes] - scene.middle[box]
        half = shapes.half_size[of_boxes]
        on_top = (middle + half)[:, 2] >= high[rows][box, 2] - TOUCH_M
        counts[rows] = np.bincount(box[on_top], minlength=scene.n_boxes)
        face_low.append((middle - half)[on_top, :2])
        face_high.append((middle + half)[on_top, :2])
    return np.concatenate(face_low), np.concatenate(face_high), counts


def _touching(
    scene: IntArray, low: FloatArray, high: FloatArray, most_gap_m: FloatArray, rise_m: FloatArray, is_tilted: bool
) -> tuple[IntArray, IntArray]:
    """(p,) lower and (p,) upper boxes of pairs in the same scene whose vertical gap is small enough for a contact.

    Heights are sorted first, so that few pairs must be compared.

    Args:
        scene: (n,) number of the scene of each box.
        low, high: (n,) heights of the boxes' bottoms and tops, m. Boxes whose heights are not finite have no contacts.
        most_gap_m: (n,) ``most_gap_m`` of ``find_bearings`` for each box.
        rise_m: (n,) largest height of a point of each box's bottom or top above the height in ``low`` or ``high``, m.
        is_tilted: whether boxes may be tilted. The middle of a tilted box may be lower than that of the box on which it
            lies, so the order of heights is not considered.
    """
    rows = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    scene, rise_m = scene[rows], rise_m[rows]
    most_rise_m = rise_m.max(initial=0.0)
    most_gap_m, most_over_m = most_gap_m[rows] + rise_m, TOUCH_M + rise_m
    bottom, top = low[rows], high[rows]
    reach = TOUCH_M + most_gap_m.max(initial=0.0) + 2 * most_rise_m
    # Heights are raised by a different amount for each scene, so that boxes of different scenes are far apart.
    rise = scene * (np.maximum(bottom, top).max(initial=0.0) - np.minimum(bottom, top).min(initial=0.0) + 2 * reach)
    least_m = bottom + rise - most_gap_m - most_rise_m - _SORTED_M
    most_m = bottom + rise + most_over_m + most_rise_m + _SORTED_M
    tops, bottoms = np.argsort(top + rise), np.argsort(least_m)
    in_order = (top + rise)[tops]
    begins = np.searchsorted(in_order, least_m[bottoms])
    times = np.maximum(np.searchsorted(in_order, most_m[bottoms], side="right") - begins, 0)
    above = np.repeat(bottoms, times)
    below = tops[np.arange(times.sum()) + np.repeat(begins - (np.cumsum(times) - times), times)]
    over = top[below] - bottom[above]
    touching = (over <= most_over_m[above] + rise_m[below]) & (over >= -most_gap_m[above] - rise_m[below])
    touching &= (below != above) if is_tilted else bottom[below] < bottom[above]
    touching &= scene[below] == scene[above]
    return rows[below[touching]], rows[above[touching]]
