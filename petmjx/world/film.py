"""Forces of stretch film on the boxes of a pallet: film presses on the outer faces, and holds them by friction.
docs/wrap.md explains the model.

If there is a gap behind a box, the film draws the box into the gap and slackens: after the distance ``SLACK_M``, the
film no longer presses on the box. If a face stands back from the outermost face of its side by more than
``MOST_BACK_M``, the face does not touch the film.
"""

from __future__ import annotations

from typing import Final, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.world.scene import Scene

MOST_BACK_M: Final = 0.02
"""Largest distance by which a face may stand back from the outermost face of its side and still touch the film, m."""

SLACK_M: Final = 0.005
"""Distance by which film draws a box into a gap before the film slackens, m. The value of 5 mm is an assumption. Real
film that is stretched more draws boxes farther, and so closes wider gaps."""

RATE_1_S: Final = 100.0
"""Natural angular frequency of a box that film holds, 1/s. At a rate of 100 / s, a force equal to the box's weight
displaces the box by 1 mm."""

MOST_RATE_PER_STEP: Final = 0.2
"""Largest product of the timestep and the natural angular frequency of a box that film holds (``spring_rate_1_s``).
With a larger product, the spring with which the film holds the box would be unstable."""

SIDES: Final = ((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0))
"""Axis and sign of the outward normal of each side of the load."""


class Film(NamedTuple):
    """Forces of film on n boxes.

    Attributes:
        press: (n, 3) force with which film presses on each box, N.
        hold: (n,) largest force with which film can hold each box by friction, N.
    """

    press: FloatArray
    hold: FloatArray


def spring_rate_1_s(timestep_s: float) -> float:
    """Natural angular frequency of a box that film holds, reduced if the timestep is long, 1/s."""
    return min(RATE_1_S, MOST_RATE_PER_STEP / timestep_s)


_FILMS: Final = WeakKeyDictionary[Scene, Film]()
"""Cached films, by scene. A film is kept as long as its scene is in use."""


def film_of(scene: Scene) -> Film:
    """The forces of a scene's film, computed from the planned places."""
    if scene not in _FILMS:
        _FILMS[scene] = _film(scene)
    return _FILMS[scene]


def _film(scene: Scene) -> Film:
    wrap, low, high = scene.wrap, scene.target - scene.half_size, scene.target + scene.half_size
    pressure_n_m = 2.0 * wrap.force_n * wrap.turns * MM_PER_M / wrap.film_mm
    levels = np.unique(np.round(np.concatenate([low[:, 2], high[:, 2]]), 6))
    begin, end = levels[:-1, None], levels[1:, None]
    at_level = (low[:, 2] <= begin + 1e-6) & (high[:, 2] >= end - 1e-6)
    full = at_level.any(axis=1)
    at_level, height = at_level[full], (end - begin)[full]
    of_sides = np.zeros((len(height), len(SIDES), scene.n_boxes))  # force on a box, N; axes: level, side, box
    for number, (axis, sign) in enumerate(SIDES):
        reach = sign * (high if sign > 0 else low)[:, axis]
        outermost = np.where(at_level, reach, -np.inf).max(axis=1, keepdims=True)
        width = np.where(at_level & (reach >= outermost - MOST_BACK_M), 2.0 * scene.half_size[:, 1 - axis], 0.0)
        of_sides[:, number] = pressure_n_m * height * width / width.sum(axis=1, keepdims=True)
    press, hold = np.zeros((scene.n_boxes, 3)), np.zeros(scene.n_boxes)
    for of_level in of_sides:
        for (axis, sign), force in zip(SIDES, of_level, strict=True):
            press[:, axis] -= sign * force
            hold += wrap.friction * force
    press[:, 2] -= _hat(low, high) * wrap.hat_n
    return Film(press, hold)


def _hat(low: FloatArray, high: FloatArray) -> FloatArray:
    """(n,) area of each box's top as a share of the area of all tops on which no box stands; 0 for a box on which
    another box stands."""
    over = (low[:, None, :2] < high[None, :, :2]) & (high[:, None, :2] > low[None, :, :2])
    is_under = (over.all(axis=2) & (low[None, :, 2] >= high[:, None, 2] - 1e-3)).any(axis=1)
    area = np.where(is_under, 0.0, (high - low)[:, :2].prod(axis=1))
    return np.asarray(area / area.sum())
