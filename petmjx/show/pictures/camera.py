"""The camera of a picture: views with names, and the camera that shows given points as large as possible."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.checked_records import hint
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray, deg_to_rad

TANGENT: Final = math.tan(deg_to_rad(12.0))
"""Tangent of half the vertical angle of view, which is 24°, as with a 56 mm lens on 24 × 36 mm film. With so small an
angle, vertical edges look nearly parallel."""

NEAREST_M: Final = 0.3
"""Smallest distance from the camera to a framed point, m."""


class View(NamedTuple):
    """The direction from the pallet to the camera, degrees. ``azimuth_deg`` is 0 in front (at −y) and 90 on the right
    (at +x). ``elevation_deg`` is the angle above the horizontal."""

    azimuth_deg: float
    elevation_deg: float


VIEWS: Final = {
    "front": View(0, 8),
    "right": View(90, 8),
    "back": View(180, 8),
    "left": View(270, 8),
    "top": View(0, 90),
    "iso": View(35, 24),
}

_ANGLES: Final = re.compile(r"\s*([+-]?\d+(?:\.\d*)?)\s*/\s*([+-]?\d+(?:\.\d*)?)\s*")


def view_of(text: str) -> View:
    """The view with a name such as "front", or with angles as in "35/24" (azimuth/elevation in degrees).

    Raises:
        InputError: the text has another form, or the elevation is outside ±90°.
    """
    if text in VIEWS:
        return VIEWS[text]
    angles = _ANGLES.fullmatch(text)
    if angles is None:
        raise InputError(
            f"unknown view {printable_name(text)}; {hint(text, VIEWS)} (or AZIMUTH/ELEVATION in degrees, such as 35/24)"
        )
    view = View(float(angles[1]), float(angles[2]))
    if abs(view.elevation_deg) > 90:
        raise InputError(f"{printable_name(text)}: the elevation must be from -90 to 90")
    return view


class Margins(NamedTuple):
    """Widths of the free strips at the edges of a picture, as shares of the picture's width (left, right) or height
    (top, bottom)."""

    left: float = 0.04
    right: float = 0.04
    top: float = 0.04
    bottom: float = 0.04


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Attributes:
        pos: (3,) position of the camera, m.
        right, up, forward: (3,) unit vectors of the camera's axes.
        width, height: size of the picture, px.
        depth_m: distances, along ``forward``, from the camera to the nearest and the farthest point that it must show.
    """

    pos: FloatArray
    right: FloatArray
    up: FloatArray
    forward: FloatArray
    width: int
    height: int
    depth_m: tuple[float, float]

    def scaled(self, factor: int) -> Camera:
        """The same camera with a picture that is larger by a factor."""
        return replace(self, width=factor * self.width, height=factor * self.height)

    def project(self, points: FloatArray) -> FloatArray:
        """(k, 2) places of (k, 3) points in the picture, px, to the right and downwards from the upper left corner. All
        points must be in front of the camera."""
        x, y, z = _along((self.right, self.up, self.forward), points - self.pos)
        scale = self.height / (2 * TANGENT)
        return np.stack((self.width / 2 + scale * x / z, self.height / 2 - scale * y / z), axis=1)


def framing(points: FloatArray, view: View, size: tuple[int, int], margins: Margins | None = None) -> Camera:
    """The nearest camera with which all points are within the margins of its picture.

    Let (cx, cy, cz) be the camera's position along its own axes, and r and l the tangents of the angles between its
    forward direction and the right and the left margin. A point (x, y, z) is to the left of the right margin if x − cx
    ≤ r (z − cz). So cx − r cz ≥ A with A = max(x − r z) over all points. Likewise, −cx − l cz ≥ B with B = max(−x − l
    z) for the left margin. The sum of both inequalities gives cz ≤ −(A + B) / (r + l). The upper and lower margins give
    another limit for cz. The smaller one of the two limits is used.

    Args:
        points: (k, 3) the points, m.
        view: direction from the pallet to the camera.
        size: width and height of the picture, px.
        margins: the margins. If ``margins`` is None, the default margins are used.
    """
    margins = margins or Margins()
    right, up, forward = _axes(view)
    x, y, z = _along((right, up, forward), points)
    wide = TANGENT * size[0] / size[1]
    to_right, to_left = wide * (1 - 2 * margins.right), wide * (1 - 2 * margins.left)
    to_top, to_bottom = TANGENT * (1 - 2 * margins.top), TANGENT * (1 - 2 * margins.bottom)
    limits = [(x - to_right * z).max(), (-x - to_left * z).max(), (y - to_top * z).max(), (-y - to_bottom * z).max()]
    across = -(limits[0] + limits[1]) / (to_right + to_left)
    upright = -(limits[2] + limits[3]) / (to_top + to_bottom)
    cz = min(across, upright, z.min() - NEAREST_M)
    cx = ((limits[0] + to_right * cz) - (limits[1] + to_left * cz)) / 2
    cy = ((limits[2] + to_top * cz) - (limits[3] + to_bottom * cz)) / 2
    pos = cx * right + cy * up + cz * forward
    return Camera(pos, right, up, forward, *size, depth_m=(float(z.min() - cz), float(z.max() - cz)))


def _axes(view: View) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The unit vectors right, up and forward of a camera that is directed at the pallet."""
    azimuth, elevation = deg_to_rad(view.azimuth_deg), deg_to_rad(view.elevation_deg)
    flat = math.cos(elevation)
    right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    forward = np.array([-math.sin(azimuth) * flat, math.cos(azimuth) * flat, -math.sin(elevation)])
    return right, np.cross(right, forward), forward


def _along(axes: tuple[FloatArray, ...], points: FloatArray) -> tuple[FloatArray, ...]:
    """The coordinates of (k, 3) points along each axis: one (k,) array per axis."""
    return tuple(np.asarray(points @ axis) for axis in axes)
