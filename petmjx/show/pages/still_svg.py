"""A still picture of boxes as SVG, for browsers without WebGL.

The boxes are seen from the front left. Boxes farther away are drawn first.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.story import Story
from petmjx.common.text import box_label
from petmjx.common.units import FloatArray
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.show.pages.html_page import escaped_html
from petmjx.show.pages.markup import Markup
from petmjx.show.pages.palette import article_colours, hex_of, look, rgb_of
from petmjx.show.pages.story_data import framed_corners
from petmjx.world.rotation import corners, rotations
from petmjx.world.scene import IDENTITY_QUAT, build_scene

# the same view as the first view of petmjx/show/pages/static/camera.js, but without perspective
_LOOK: Final = look()
_AZIMUTH, _ELEVATION = _LOOK["view"]["azimuth"], _LOOK["view"]["elevation"]
_TOWARDS: Final = np.array(
    [np.sin(_AZIMUTH) * np.cos(_ELEVATION), -np.cos(_AZIMUTH) * np.cos(_ELEVATION), np.sin(_ELEVATION)]
)
"""(3,) unit vector from the scene towards the eye."""
_RIGHT: Final = np.array([np.cos(_AZIMUTH), np.sin(_AZIMUTH), 0.0])
_DOWN: Final = -np.cross(_TOWARDS, _RIGHT)
_SUNWARD: Final = np.array(_LOOK["sunward"]) / np.linalg.norm(_LOOK["sunward"])

_WIDTH: Final = 800.0
_MARGIN: Final = 12.0
_TOUCHING_M: Final = 1e-3
"""Two boxes that overlap by at most this length, m, count as side by side."""

# the numbers of the four corners of each face of a box; the faces are −x, +x, −y, +y, −z, +z
_FACES: Final = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


_Blocks = tuple[FloatArray, FloatArray, FloatArray]
"""Centres, axes and half sizes of boxes or boards, as in ``drawing_order``."""


def still_svg(
    story: Story,
    marked: Collection[int] | None = None,
    numbers: Sequence[int] | None = None,
    numbered: Collection[int] = (),
    beside: Sequence[Story] = (),
) -> Markup:
    """The last frame of a story (the simulation of one plan) as SVG.

    Args:
        marked: numbers of the boxes that are outlined. If ``marked`` is None, the first box to fail is outlined.
        numbers: the number that the picture shows for each box. If ``numbers`` is None, the picture shows the boxes'
            numbers in the plan.
        numbered: those of ``numbers`` that are written on their boxes.
        beside: other stories whose pictures have the same scale as this one.
    """
    marked = (story.outcome.culprit,) if marked is None else marked
    stories = story, *beside
    frames = [_last_frame(one) for one in stories]
    placed, carrier, shown = frames[0]
    called = range(story.plan.n_boxes) if numbers is None else numbers
    return _svg(
        placed,
        carrier,
        story.plan,
        shown,
        [called[box] for box in shown],
        marked,
        len(story.scene.carrier.walls),
        f"Still picture of plan {story.plan.plan_id} as it ended",
        [
            _extent(corners(*_joined(*frame[:2])), framed_corners(one))
            for frame, one in zip(frames, stories, strict=True)
        ],
        numbered,
    )


def _last_frame(story: Story) -> tuple[_Blocks, _Blocks, list[int]]:
    """The boxes in the last frame of a story, its carrier's boards and walls, and the numbers of these boxes in the
    plan."""
    history, scene = story.history, story.scene
    shown = np.flatnonzero(np.isfinite(history.pos[-1]).all(axis=1))
    carrier_pos, carrier_quat = history.carrier_pos[-1], history.carrier_quat[-1]
    if not np.isfinite(carrier_pos).all():
        carrier_pos, carrier_quat = scene.carrier.pos, np.array(IDENTITY_QUAT)
    placed = history.pos[-1][shown], rotations(history.quat[-1][shown]), scene.half_size[shown]
    return placed, scene.carrier.shapes_at(carrier_pos, carrier_quat), shown.tolist()


def plan_svg(plan: Plan) -> Markup:
    """An SVG picture of a plan with all boxes at their planned places, on its carrier. Nothing is simulated."""
    scene = build_scene(plan, Simulation(size_reduction_mm=0.0))
    numbers = list(range(plan.n_boxes))
    return _svg(
        (scene.target, np.tile(np.eye(3), (plan.n_boxes, 1, 1)), scene.half_size),
        scene.carrier.shapes_at(scene.carrier.pos, np.array(IDENTITY_QUAT)),
        plan,
        numbers,
        numbers,
        (),
        len(scene.carrier.walls),
        f"Plan {plan.plan_id} as it was read",
    )


def _svg(
    placed: _Blocks,
    carrier: _Blocks,
    plan: Plan,
    shown: Sequence[int],
    numbers: Sequence[int],
    marked: Collection[int],
    n_walls: int,
    label: str,
    extents: Sequence[FloatArray] = (),
    numbered: Collection[int] = (),
) -> Markup:
    """The boxes of a plan and the boards of its carrier as SVG.

    Args:
        placed: the boxes that are drawn.
        carrier: the carrier's boards and walls.
        shown: number in the plan of each box that is drawn.
        numbers: the number that the picture shows for each of these boxes.
        marked: numbers in the plan of the boxes that are outlined.
        n_walls: number of walls, which are the last entries in ``carrier`` and are drawn transparent.
        label: description of the picture for screen readers.
        extents: the parts of the drawing that must fit into the picture (``_extent``). If empty, all boxes must fit.
        numbered: those of ``numbers`` that are written on their boxes. If other boxes hide a box, its number is written
            on them, in parentheses.
    """
    pos, axes, half = _joined(placed, carrier)
    n_boards = len(pos) - len(shown)
    colours = article_colours(plan.articles)
    fills = [*(colours[row] for row in shown), *[hex_of(_LOOK["wood"])] * n_boards]
    names = [
        *(box_label(number, plan.articles[row]) for number, row in zip(numbers, shown, strict=True)),
        *["carrier"] * n_boards,
    ]
    points = corners(pos, axes, half)
    low, scale, height = _picture_fit(extents or [_extent(points)])
    flat = (_projection(points) - low) * scale + _MARGIN
    parts = []
    order = drawing_order(pos, axes, half)
    for k in order:
        faces = "".join(_face(flat[k], axes[k], fills[k], number) for number in range(6))
        mark = ' class="first"' if k < len(shown) and shown[k] in marked else ""
        pane = f' fill-opacity="{_LOOK["wall"]}"' if k >= len(pos) - n_walls else ""
        parts.append(f"<g{mark}{pane}><title>{escaped_html(names[k])}</title>{faces}</g>")
    walls = range(len(pos) - n_walls, len(pos))
    for at, k in enumerate(order):
        if k < len(shown) and numbers[k] in numbered:
            nearer = [other for other in order[at + 1 :] if other not in walls]
            parts.append(_number(str(numbers[k]), flat, axes, k, nearer))
    return Markup(
        f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" aria-label="{escaped_html(label)}" '
        f'stroke="#1b1815" stroke-width="1" stroke-linejoin="round">{"".join(parts)}</svg>'
    )


def _projection(points: FloatArray) -> FloatArray:
    """(…, 2) positions of (…, 3) points in the picture, m to the right and downwards."""
    return np.stack([points @ _RIGHT, points @ _DOWN], axis=-1)


def _joined(placed: _Blocks, carrier: _Blocks) -> _Blocks:
    pos, axes, half = (np.concatenate(both) for both in zip(placed, carrier, strict=True))
    return pos, axes, half


def _extent(points: FloatArray, framed: tuple[FloatArray, FloatArray] | None = None) -> FloatArray:
    """(2, 2) lowest and highest position, as in ``_projection``, of the part of a scene that its picture must show.

    Args:
        points: (…, 3) corners of all boxes, m.
        framed: lowest and highest corner of this part of the scene. Boxes far outside are cut off. If ``framed`` is
            None, the picture shows all boxes.
    """
    projected = _projection(points).reshape(-1, 2)
    if framed is not None:
        ends = np.array(framed)
        room = _projection(
            np.array([[ends[x, 0], ends[y, 1], ends[z, 2]] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        )
        low, high = room.min(axis=0), room.max(axis=0)
        projected = np.vstack([np.clip(projected, low - 0.2, high + 0.2), [low, high]])
    return np.array([projected.min(axis=0), projected.max(axis=0)])


def _picture_fit(extents: Sequence[FloatArray]) -> tuple[FloatArray, float, float]:
    """The place and the scale of the scene in a picture that shows all extents (``_extent``). The result is (2,) the
    position of the picture's upper left corner, as in ``_projection``; the number of pixels per m; and the height of
    the picture, px."""
    ends = np.concatenate(extents)
    low, high = ends.min(axis=0), ends.max(axis=0)
    scale = (_WIDTH - 2 * _MARGIN) / max(high[0] - low[0], 1.25 * (high[1] - low[1]))
    low[0] -= ((_WIDTH - 2 * _MARGIN) / scale - (high[0] - low[0])) / 2
    return low, float(scale), float((high[1] - low[1]) * scale + 2 * _MARGIN)


def _number(text: str, flat: FloatArray, axes: FloatArray, box: int, nearer: Sequence[int]) -> str:
    """The number of a box as SVG, on a face of the box that no nearer box hides there. If there is no such face, the
    number is in parentheses.

    Args:
        flat: (k, 8, 2) corners of all boxes in the picture, px.
        axes: (k, 3, 3) as in ``drawing_order``.
        nearer: numbers of the boxes that are drawn later.
    """
    faces = [flat[box, _FACES[face]] for face in (5, 4, 3, 2, 1, 0) if _faces_eye(axes[box], face)]
    middles = [face.mean(axis=0) for face in faces]
    places = middles + [(middle + end) / 2 for middle, face in zip(middles, faces, strict=True) for end in face]
    cover = [flat[other, _FACES[face]] for other in nearer for face in range(6) if _faces_eye(axes[other], face)]
    free = next((place for place in places if not any(_is_inside(place, face) for face in cover)), None)
    x, y = places[0] if free is None else free
    words = f"({text})" if free is None else text
    return f'<text class="number" x="{x:.1f}" y="{y:.1f}">{words}</text>'


def _is_inside(point: FloatArray, corners_of_face: FloatArray) -> bool:
    """Whether a point is inside a convex polygon. ``corners_of_face``: (4, 2)."""
    (x, y), (dx, dy) = (corners_of_face - point).T, (np.roll(corners_of_face, -1, axis=0) - corners_of_face).T
    sides = x * dy - y * dx
    return bool((sides > 0).all() or (sides < 0).all())


def _normal(axes: FloatArray, number: int) -> FloatArray:
    """(3,) outward normal of a face of a box."""
    normal: FloatArray = axes[:, number // 2] * (1 if number % 2 else -1)
    return normal


def _faces_eye(axes: FloatArray, number: int) -> bool:
    """Whether a face of a box is turned towards the eye."""
    return bool(_normal(axes, number) @ _TOWARDS > 1e-9)


def _face(flat: FloatArray, axes: FloatArray, fill: str, number: int) -> str:
    """A face of a box as an SVG polygon; "" if the face is turned away from the eye."""
    if not _faces_eye(axes, number):
        return ""
    light = 0.62 + 0.38 * max(float(_normal(axes, number) @ _SUNWARD), 0.0)
    red, green, blue = (light * part for part in rgb_of(fill))
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in flat[list(_FACES[number])])
    return f'<polygon points="{points}" fill="{hex_of((red, green, blue))}"/>'


def drawing_order(pos: FloatArray, axes: FloatArray, half: FloatArray) -> list[int]:
    """The order in which boxes must be drawn so that near boxes cover the boxes behind them.

    If the plane through a face of one box separates it from another box, the plane determines which of the two boxes is
    nearer to the eye. If no such plane separates two boxes, or if boxes form a cycle in which each box is behind the
    next, boxes are ordered by the distance of their centres from the eye.

    Args:
        pos: (k, 3) centres of the boxes, m.
        axes: (k, 3, 3) rotation matrices of the boxes. The columns are the boxes' axes.
        half: (k, 3) half sizes of the boxes, m.
    """
    before = _before(pos, axes, half)
    depth = pos @ _TOWARDS
    waiting = before.sum(axis=0)
    order: list[int] = []
    left = np.ones(len(pos), dtype=bool)
    while left.any():
        free = left & (waiting == 0)
        among = np.flatnonzero(free if free.any() else left)
        chosen = int(among[np.argmin(depth[among])])
        order.append(chosen)
        left[chosen] = False
        waiting -= before[chosen]
    return order


def _before(pos: FloatArray, axes: FloatArray, half: FloatArray) -> NDArray[np.bool_]:
    """(k, k) whether the box of the row must be drawn before the box of the column."""
    points = corners(pos, axes, half)
    flat = _projection(points)
    low, high = flat.min(axis=1), flat.max(axis=1)
    apart = ((low[:, None] > high[None]) | (high[:, None] < low[None])).any(axis=2)
    before = np.zeros(apart.shape, dtype=bool)
    for k in range(len(pos)):
        local = (points - pos[k]) @ axes[k]
        facing = _TOWARDS @ axes[k]
        above = local.min(axis=1) >= half[k] - _TOUCHING_M
        below = local.max(axis=1) <= -half[k] + _TOUCHING_M
        nearer = (above & (facing > 0) | below & (facing < 0)).any(axis=1)
        farther = (above & (facing < 0) | below & (facing > 0)).any(axis=1)
        before[k] |= nearer & ~farther
        before[:, k] |= farther & ~nearer
    np.fill_diagonal(before, False)
    return np.asarray(before & ~apart)
