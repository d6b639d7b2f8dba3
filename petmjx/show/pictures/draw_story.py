"""Draws a story (the simulation of one plan) at one time: boxes with edges, the carrier, shadows on the floor, planned
places, and contact forces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.story import Story, thresholds_of
from petmjx.common.errors import InputError
from petmjx.common.text import next_round_number, printable_name
from petmjx.common.units import FloatArray
from petmjx.show.pages.contact_forces import pushes
from petmjx.show.pages.palette import Rgb, look
from petmjx.show.pictures.box_colours import CARRIER, FIRST, GHOST, Colouring
from petmjx.show.pictures.camera import Camera, View
from petmjx.show.pictures.offscreen import Canvas
from petmjx.show.pictures.picture_options import Colour
from petmjx.show.pictures.story_poses import Poses, poses_of_frame, shaking_g, shift_mm, tilts_deg
from petmjx.world.history import Contacts
from petmjx.world.rotation import corners, rotations
from petmjx.world.scene import IDENTITY_QUAT

FLOOR: Final[Rgb] = (1.0, 1.0, 1.0)
SHADOW: Final[Rgb] = (0.85, 0.86, 0.88)
EDGE: Final[Rgb] = (0.0, 0.0, 0.0)

_SUN: Final = (0.26, 0.36, -1.0)
"""Direction of the light that casts the shadows on the floor."""

_FLOOR_HALF_M: Final = 60.0

_TOWARDS_CAMERA: Final = 1.5e-3
"""The edges of a box are drawn nearer to the camera than the box: their distance from the camera is smaller by this
share. Edges are also drawn smaller by this share. So the edges cover the same pixels, but lie in front of the faces."""

_SEE_THROUGH: Final = 0.24
"""Opacity of boxes if contact forces are drawn."""

_AWAY: Final = 0.25
"""The planned place of a box is drawn if the box is away from it: if its shift or tilt is above this share of the
threshold."""

_LEAST_FORCE: Final = 0.02
"""Smallest force that gets an arrow, as a share of the force whose arrow has the length ``_ARROW_SHARE``."""

_ARROW_SHARE: Final = 0.4
"""Length of the arrow for a force of four times the 90 % quantile of all contact forces, as a share of the largest
extent of the planned load. Since ``newtons_per_m`` is rounded up, the arrow may be shorter."""

LEAST_LEVEL_G: Final = 0.005
"""Level above which shaking gets an arrow and a text, g."""

REACH: Final = 1.25
LEAST_REACH_M: Final = 1.0
"""A picture need not show a box that is farther from the load than ``REACH`` × the largest extent of the planned load.
This distance is at least ``LEAST_REACH_M``. To show a box that has rolled away, all other boxes would have to be
small."""


@dataclass(frozen=True, eq=False)
class PictureStyle:
    """How the pictures of a story look. All pictures of one call of ``petmjx.draw`` have the same style.

    Attributes:
        colours: colours of the boxes.
        view: direction from the pallet to the camera.
        size: width and height of a picture, px.
        newtons_per_m: force per length of the arrows for contact forces. If arrows are drawn, boxes are transparent. If
            ``newtons_per_m`` is None, no arrows are drawn.
    """

    colours: Colouring
    view: View
    size: tuple[int, int]
    newtons_per_m: float | None = None

    @property
    def story(self) -> Story:
        return self.colours.story

    @property
    def arrows(self) -> str:
        """The line of text that explains the arrows; "" if there are no arrows."""
        return "" if self.newtons_per_m is None else f"arrows: contact forces, 0.1 m for {self.newtons_per_m / 10:g} N"


class Painter:
    """Draws pictures of one story, all of the same size. Use this object in a ``with`` statement, in one thread.

    Args:
        finer: factor by which pictures are drawn larger.

    Raises:
        InputError: this machine cannot draw.
    """

    def __init__(self, look: PictureStyle, finer: int = 1) -> None:
        self.story, self.colours, self.newtons_per_m = look.story, look.colours, look.newtons_per_m
        contacts = self.story.history.contacts
        most_arrows = 0 if self.newtons_per_m is None or contacts is None else _most_in_a_frame(contacts)
        most_boxes = self.story.plan.n_boxes + len(self.story.scene.carrier.half_size)
        width, height = look.size
        line_px = finer * max(1.0, min(width, height) / 600)
        self.canvas = Canvas((finer * width, finer * height), line_px, 4 * most_boxes + most_arrows + 1)

    def __enter__(self) -> Self:
        self.canvas.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.canvas.__exit__()

    def picture(self, poses: Poses, camera: Camera) -> NDArray[np.uint8]:
        """(height, width, 3) the picture: red, green and blue of each pixel."""
        scene = self.story.scene
        half_size, turned = scene.half_size[: poses.n_placed], rotations(poses.quat)
        centers, turns, half_sizes = scene.carrier.shapes_at(poses.carrier_pos, poses.carrier_quat)
        shapes = list(zip(half_sizes, centers, turns, strict=True))
        boards, walls = shapes[: scene.carrier.n_boards], shapes[scene.carrier.n_boards :]
        self.canvas.begin(camera)
        self._floor()
        visible = _far_to_near(poses, camera)
        for solid in (*boards, *((half_size[box], poses.pos[box], turned[box]) for box in visible)):
            self._shadow(*solid)
        for board in boards:
            self.canvas.box(*board, CARRIER)
            self._edges(*board, EDGE, camera)
        self._shaking(poses)
        if self.newtons_per_m is not None:
            self._forces(poses, self.newtons_per_m)
        alpha = 1.0 if self.newtons_per_m is None else _SEE_THROUGH
        colours = self.colours.of(poses)
        for box in visible:
            red, green, blue = (float(part) for part in colours[box])
            self.canvas.box(half_size[box], poses.pos[box], turned[box], (red, green, blue), alpha)
            self._edges(half_size[box], poses.pos[box], turned[box], EDGE, camera)
        for wall in walls:
            self.canvas.box(*wall, CARRIER, look()["wall"])
            self._edges(*wall, EDGE, camera)
        if self.colours.colour is Colour.PLANNED:
            for box in _away(self.story, poses):
                self._edges(half_size[box], scene.target[box], np.eye(3), GHOST, camera)
        return self.canvas.pixels()

    def _floor(self) -> None:
        half_size = np.array([_FLOOR_HALF_M, _FLOOR_HALF_M, 0.01])
        self.canvas.box(half_size, np.array([0.0, 0.0, self.story.scene.floor_z - 0.012]), np.eye(3), FLOOR)

    def _shadow(self, half_size: FloatArray, pos: FloatArray, turned: FloatArray) -> None:
        """Draw the shadow of a box: a box that is flattened onto the floor, along the direction of the light. The
        flattened box keeps a little of its height, since faces need normals."""
        across = np.array(_SUN[:2]) / _SUN[2]
        flatten = np.array([[1.0, 0.0, -across[0]], [0.0, 1.0, -across[1]], [0.0, 0.0, 1e-3]])
        above = pos - np.array([0.0, 0.0, self.story.scene.floor_z])
        place = flatten @ above + np.array([0.0, 0.0, self.story.scene.floor_z - 0.001])
        self.canvas.box(half_size, place, flatten @ turned, SHADOW)

    def _edges(self, half_size: FloatArray, pos: FloatArray, turned: FloatArray, rgb: Rgb, camera: Camera) -> None:
        nearer = camera.pos + (1 - _TOWARDS_CAMERA) * (pos - camera.pos)
        self.canvas.edges((1 - _TOWARDS_CAMERA) * half_size, nearer, turned, rgb)

    def _shaking(self, poses: Poses) -> None:
        """Draw an arrow above the load that shows the shaking of the carrier. The arrow's length is proportional to the
        carrier's acceleration or to the force on it."""
        level = shaking_g(self.story, poses)
        if np.linalg.norm(level) > LEAST_LEVEL_G:
            start, longest = _above(self.story)
            peak = np.linalg.norm(self.story.history.drive, axis=1).max()
            along = longest * self.story.history.drive[poses.frame] / peak
            self.canvas.arrow(start - along / 2, start + along / 2, 0.03 * longest, EDGE)

    def _forces(self, poses: Poses, newtons_per_m: float) -> None:
        contacts = self.story.history.contacts
        if contacts is None:
            return
        width_m = 0.007 * largest_extent_m(self.story)
        least_n = _LEAST_FORCE * _ARROW_SHARE * largest_extent_m(self.story) * newtons_per_m
        for end, force in forces_of_pairs(contacts, poses):
            if np.linalg.norm(force) >= least_n:
                self.canvas.arrow(end - force / newtons_per_m, end, width_m, FIRST)


def newtons_per_m(story: Story) -> float:
    """Force per length of the arrows for contact forces, N/m: a round number with which arrows are neither as short as
    dots nor longer than the pallet.

    Raises:
        InputError: contacts were not recorded.
    """
    contacts = story.history.contacts
    if contacts is None:
        raise InputError(
            f"plan {printable_name(story.plan.plan_id)}: no contact forces were recorded (engine {story.engine}); "
            "engine mujoco records them"
        )
    strength = np.linalg.norm(contacts.force, axis=1)
    strength = strength[strength > 0]
    usual_n = 4 * float(np.quantile(strength, 0.9)) if len(strength) else 1.0
    return next_round_number(usual_n / (_ARROW_SHARE * largest_extent_m(story)))


def forces_of_pairs(contacts: Contacts, poses: Poses) -> list[tuple[FloatArray, FloatArray]]:
    """For each pair of bodies that press on each other in a frame, the (3,) point at which the force acts, m, and the
    (3,) force on the lower body, N."""
    is_drawn = np.zeros(int(contacts.frame.max(initial=0)) + 1, dtype=bool)
    is_drawn[poses.frame : poses.frame + 1] = True
    forces = pushes(contacts.of_frames(is_drawn, 0))
    return list(zip(forces.point, forces.force, strict=True))


def framed_points(story: Story, frames: Iterable[int]) -> FloatArray:
    """(k, 3) points that pictures of the given frames must show, m: the corners of the planned load, of the carrier,
    and of boxes that are near enough."""
    scene = story.scene
    upright = np.tile(np.eye(3), (scene.n_boxes, 1, 1))
    planned = corners(scene.target, upright, scene.half_size).reshape(-1, 3)
    carrier = corners(*scene.carrier.shapes_at(scene.carrier.pos, np.array(IDENTITY_QUAT))).reshape(-1, 3)
    load = np.concatenate((planned, carrier))
    low, high = load.min(axis=0), load.max(axis=0)
    if story.drive is not None:
        middle, longest = _above(story)
        load = np.concatenate((load, middle + longest / 2 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])))
    reach = max(REACH * largest_extent_m(story), LEAST_REACH_M)
    point_parts = [load]
    for frame in frames:
        poses = poses_of_frame(story.history, frame)
        box_corners = corners(poses.pos, rotations(poses.quat), scene.half_size[: poses.n_placed])
        is_near = ((poses.pos >= low - reach) & (poses.pos <= high + reach)).all(axis=1)
        moved = corners(*scene.carrier.shapes_at(poses.carrier_pos, poses.carrier_quat))
        point_parts += [box_corners[is_near].reshape(-1, 3), moved.reshape(-1, 3)]
    return np.concatenate(point_parts)


def _above(story: Story) -> tuple[FloatArray, float]:
    """(3,) middle of the arrow that shows the shaking of the carrier, m, and the arrow's length at the strongest
    shaking, m."""
    scene, longest = story.scene, 0.5 * largest_extent_m(story)
    top = float((scene.target + scene.half_size)[:, 2].max()) + 0.15 * longest
    return np.array([*scene.carrier.pos[:2], top]), longest


def largest_extent_m(story: Story) -> float:
    """The largest side of the planned load, m."""
    scene = story.scene
    low, high = (scene.target - scene.half_size).min(axis=0), (scene.target + scene.half_size).max(axis=0)
    return float((high - low).max())


def _most_in_a_frame(contacts: Contacts) -> int:
    return int(np.bincount(contacts.frame).max()) if len(contacts.frame) else 0


def _far_to_near(poses: Poses, camera: Camera) -> list[int]:
    """Numbers of the boxes with known poses, from the farthest to the nearest: transparent boxes must be drawn in this
    order."""
    depth = (poses.pos - camera.pos) @ camera.forward
    return [int(box) for box in np.argsort(-depth, kind="stable") if np.isfinite(depth[box])]


def _away(story: Story, poses: Poses) -> list[int]:
    """Numbers of the boxes that are clearly away from their planned places."""
    limits = thresholds_of(story)
    is_far = shift_mm(story, poses) > _AWAY * 1000 * limits.shift_m
    return [int(box) for box in np.flatnonzero(is_far | (tilts_deg(poses) > _AWAY * limits.tilt_deg))]
