"""The data in the page of a story (the simulation of one plan): values for the page's script, and arrays with the
story's frames."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.story import Story, sinks_of, thresholds_of
from petmjx.analysis.story_in_words import first_box_in_words
from petmjx.common.text import printable
from petmjx.common.units import MM_PER_M, STANDARD_GRAVITY, FloatArray
from petmjx.engines.mujoco import box_motion
from petmjx.options.thresholds import Thresholds
from petmjx.show.pages.contact_forces import pushes
from petmjx.show.pages.page_arrays import PackedArray, block, integer_column, quantised_column
from petmjx.show.pages.palette import article_colours, ramp
from petmjx.world.history import Contacts, History
from petmjx.world.job import FORCE

_FAR_M: Final = 0.8
_FAR_SHARE: Final = 0.5
"""The view must show each box that ends near the planned load: at a distance of less than ``_FAR_M`` + ``_FAR_SHARE`` ×
the height of the load."""
_LOST_M: Final = 50.0
"""Distance from the origin beyond which boxes are not drawn, m. Boxes beyond 50 m occur in simulations that became
numerically unstable. If they were drawn, the range of the stored positions would be much larger, so all positions would
be stored less precisely."""
_ARROW_M: Final = 0.45
"""Width of the space to the left of the carrier for the arrow of gravity, m (petmjx/show/pages/static/arrows.js)."""


def story_info(story: Story) -> dict[str, Any]:
    """The values that the page's script reads with ``readInfo()``. Lengths are in m unless their name contains mm."""
    limits, outcome = thresholds_of(story), story.outcome
    first = None
    if outcome.culprit >= 0:
        first = {"box": outcome.culprit, "time": outcome.first_sign_s, "words": first_box_in_words(story)}
    low, high = framed_corners(story)
    carrier = story.scene.carrier
    return {
        "boxes": _boxes(story),
        "first": first,
        "limits": {"shift_mm": MM_PER_M * limits.shift_m, "tilt_deg": limits.tilt_deg},
        "ramp": ramp(),
        "carrier": {"pos": carrier.pos, "boards": carrier.boards.ravel(), "walls": len(carrier.walls)},
        "floorZ": story.scene.floor_z,
        "frame": {"low": low, "high": high},
        "drive": _drive(story),
    }


def _boxes(story: Story) -> dict[str, Any]:
    """Properties of the boxes: name → one value per box, in packing order."""
    plan, metrics = story.plan, story.outcome.boxes
    return {
        "article": [printable(name) for name in plan.articles],
        "item": [printable(name) for name in plan.item_ids],
        "colour": article_colours(plan.articles),
        "size": (2 * story.scene.half_size).ravel(),
        "target": story.scene.target.ravel(),
        "size_mm": plan.size_mm,
        "mass_kg": story.scene.mass,
        "sequence": plan.sequence,
        "placed_s": placed_s(story.history),
        "drop_s": metrics.drop_s,
        "end_shift_mm": MM_PER_M * np.abs(metrics.shift_m).max(axis=1, initial=0.0),
        "max_tilt_deg": metrics.max_tilt_deg,
        "max_force_n": metrics.max_top_force_n,
        "rest_force_n": metrics.rest_top_force_n,
    }


def placed_s(history: History) -> FloatArray:
    """(n,) time at which each box was placed, s; NaN for boxes that were not placed."""
    frame = np.searchsorted(history.n_placed, np.arange(history.pos.shape[1]), side="right")
    times = np.append(history.time_s, np.nan)
    return np.asarray(times[frame], dtype=np.float64)


def _drive(story: Story) -> dict[str, Any] | None:
    """The force or acceleration that shakes the carrier: its kind ("force" or "acceleration"), its name, and the value
    that corresponds to 1 g. The result is None if nothing shakes the carrier."""
    if story.drive is None or not np.any(story.history.drive):
        return None
    kind = story.drive.excitation.kind
    mass = story.scene.total_mass if kind == FORCE else 1.0
    return {"kind": kind, "name": story.drive.excitation.name, "one_g": mass * STANDARD_GRAVITY}


def framed_corners(story: Story) -> tuple[FloatArray, FloatArray]:
    """(3,) lowest and (3,) highest corner of the volume that the view must show, m: the carrier, the planned load, and
    the boxes that are near the planned load at the end."""
    scene = story.scene
    low = np.vstack([scene.target - scene.half_size, scene.carrier.low]).min(axis=0)
    high = np.vstack([scene.target + scene.half_size, scene.carrier.high]).max(axis=0)
    last = story.history.pos[-1]
    last = last[np.isfinite(last).all(axis=1)]
    reach_m = _FAR_M + _FAR_SHARE * (high[2] - low[2])
    clipped = np.clip(last, low - np.array([reach_m, reach_m, 0.0]), high + np.array([reach_m, reach_m, 0.2]))
    if story.drive is not None:
        low[0] -= _ARROW_M
    return np.vstack([clipped, [low]]).min(axis=0), np.vstack([clipped, [high]]).max(axis=0)


def story_blocks(story: Story) -> dict[str, str]:
    """The arrays that the page's script reads with ``readBlock``: the block ``frames``, and the block ``contacts`` if
    contacts were recorded."""
    blocks = {"frames": block(_frames(story, thresholds_of(story)))}
    if story.history.contacts is not None:
        blocks["contacts"] = block(_contacts(story.history.contacts))
    return blocks


def _frames(story: Story, limits: Thresholds) -> dict[str, NDArray[Any] | PackedArray]:
    """The arrays of the block ``frames``, for f frames of n boxes. ``shift_mm`` and ``tilt_deg`` are the values to
    which the thresholds apply.

    For each force, the square root of its magnitude is stored, with the sign of the force. Impacts are a thousand times
    as large as forces at rest, and with square roots, forces at rest are stored precisely enough, too.
    """
    history = story.history
    n_frames, n = history.pos.shape[:2]
    lost = ~(np.abs(history.pos) < _LOST_M).all(axis=2, keepdims=True)
    pos, quat = np.where(lost, np.nan, history.pos), np.where(lost, np.nan, history.quat)
    moved = box_motion.shift(pos, story.scene.target, limits.shift_floor_m, sinks_of(story))
    shift = np.abs(moved).max(axis=2, initial=0.0)
    tilt = box_motion.tilt_deg(quat.reshape(-1, 4)).reshape(n_frames, n)
    force = history.top_force_n
    return {
        "time": history.time_s.astype(np.float64),
        "placed": integer_column(history.n_placed, steps=True),
        "pos": quantised_column(pos, steps=True),
        "quat": quantised_column(quat, steps=True),
        "shift_mm": quantised_column(MM_PER_M * shift, steps=True),
        "tilt_deg": quantised_column(tilt, steps=True),
        "force_root": quantised_column(np.copysign(np.sqrt(np.abs(force)), force), steps=True),
        "carrier_pos": quantised_column(history.carrier_pos, steps=True),
        "carrier_quat": quantised_column(history.carrier_quat, steps=True),
        "drive": history.drive.astype(np.float32),
    }


def _contacts(contacts: Contacts) -> dict[str, NDArray[Any] | PackedArray]:
    """The arrays of the block ``contacts``: one force for each pair of bodies and each frame. The rows of a pair are
    adjacent, so each row differs little from the row before, and the rows deflate well."""
    forces = pushes(contacts)
    return {
        "frame": integer_column(forces.frame, steps=True),
        "point": quantised_column(forces.point, steps=True),
        "force": quantised_column(forces.force, steps=True),
    }
