"""The poses of carrier and boxes at any time of a story (the simulation of one plan), and the moments at which pictures
are taken."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from petmjx.analysis.story import Story
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.engines.mujoco.box_motion import shift, tilt_deg
from petmjx.show.pictures.picture_options import BEFORE, END, FIRST_SIGN, START, moment_of
from petmjx.world.history import History
from petmjx.world.job import FORCE

LOST_M: Final = 1000.0

_ROUNDED_S: Final = 0.01
"""A picture may be requested for a time that is up to this much after the end of the story, s, because times are
printed with two decimals."""


@dataclass(frozen=True, eq=False)
class Poses:
    """The poses of the carrier and the boxes at one time. Arrays have one row for each of the k placed boxes.

    Attributes:
        time_s: the time, s.
        frame: number of the frame of the history that is nearest to this time.
        pos: (k, 3) positions of the boxes, m; NaN if the position is unknown.
        quat: (k, 4) orientations of the boxes as quaternions (w, x, y, z).
        carrier_pos: (3,) position of the carrier, m.
        carrier_quat: (4,) orientation of the carrier as a quaternion.
    """

    time_s: float
    frame: int
    pos: FloatArray
    quat: FloatArray
    carrier_pos: FloatArray
    carrier_quat: FloatArray

    @property
    def n_placed(self) -> int:
        return len(self.pos)


class Moment(NamedTuple):
    """A moment of a simulation that is drawn: the number of its frame in the history, and its name ("start", "end" …).
    The name is "" if the moment was requested by its time."""

    frame: int
    name: str


def poses_of_frame(history: History, frame: int) -> Poses:
    """The recorded poses of a frame. The pose of a box is NaN if it is not finite, or farther away than ``LOST_M``,
    which occurs in invalid worlds."""
    placed = slice(int(history.n_placed[frame]))
    pos, quat = history.pos[frame, placed], history.quat[frame, placed]
    is_near = (np.abs(pos) < LOST_M).all(axis=1, keepdims=True) & np.isfinite(quat).all(axis=1, keepdims=True)
    return Poses(
        float(history.time_s[frame]),
        frame,
        np.where(is_near, pos, np.nan),
        np.where(is_near, quat, np.nan),
        history.carrier_pos[frame],
        history.carrier_quat[frame],
    )


def poses_at(history: History, time_s: float) -> Poses:
    """The poses at a time. Between two frames, poses are interpolated for the boxes that were already placed in the
    earlier frame."""
    later = int(np.searchsorted(history.time_s, time_s, side="right"))
    if later == 0 or later == len(history.time_s):
        return poses_of_frame(history, min(later, len(history.time_s) - 1))
    before, after = poses_of_frame(history, later - 1), poses_of_frame(history, later)
    share = (time_s - before.time_s) / (after.time_s - before.time_s)
    placed = slice(before.n_placed)
    return Poses(
        time_s,
        before.frame if share < 0.5 else after.frame,
        before.pos + share * (after.pos[placed] - before.pos),
        _interpolated_quats(before.quat, after.quat[placed], share),
        before.carrier_pos + share * (after.carrier_pos - before.carrier_pos),
        _interpolated_quats(before.carrier_quat, after.carrier_quat, share),
    )


def nearest_frame(history: History, time_s: float) -> int:
    """The number of the frame nearest to a time. If several frames are equally near, the last of them is taken."""
    distance = np.abs(history.time_s - time_s)
    return int(np.flatnonzero(distance == distance.min())[-1])


def moments(story: Story, names: str | None) -> list[Moment]:
    """The requested moments, in the order of the request.

    Args:
        names: moments, separated by commas. If ``names`` is None, there are three moments: before the first sign (the
            first crossing of a threshold by a box), at the first sign, and at the end. If no box failed, there is only
            the end.

    Raises:
        InputError: a name is unknown, or the story has no such moment.
    """
    if names is None:
        names = ",".join((BEFORE, FIRST_SIGN, END) if math.isfinite(story.outcome.first_sign_s) else (END,))
    return [_moment(story, moment_of(part)) for part in names.split(",")]


def _moment(story: Story, which: str | float) -> Moment:
    history, sign_s = story.history, story.outcome.first_sign_s
    if isinstance(which, float):
        end_s = float(history.time_s[-1])
        if not 0 <= which <= end_s + _ROUNDED_S:
            raise InputError(
                f"there is no moment {which:g} s: plan {printable_name(story.plan.plan_id)} ends at {end_s:.2f} s"
            )
        return Moment(nearest_frame(history, which), "")
    if which in (START, END):
        return Moment(0 if which == START else len(history.time_s) - 1, which)
    if not math.isfinite(sign_s):
        raise InputError(f"there is no moment '{which}': nothing failed in plan {printable_name(story.plan.plan_id)}")
    if which == FIRST_SIGN:
        return Moment(nearest_frame(history, sign_s), which)
    grown = np.flatnonzero(np.diff(history.n_placed, prepend=0) > 0)
    earlier = grown[history.time_s[grown] < sign_s]
    return Moment(int(earlier[-1]) if len(earlier) else 0, which)


def shift_mm(story: Story, poses: Poses) -> FloatArray:
    """(k,) largest component of each placed box's shift from its planned place, mm. This is the component that the
    verdict compares with the threshold of shifts."""
    moved = shift(poses.pos, story.scene.target[: poses.n_placed], 0.0)
    return np.asarray(1000.0 * np.abs(moved).max(axis=1, initial=0.0))


def tilts_deg(poses: Poses) -> FloatArray:
    """(k,) tilt of each placed box against the vertical, degrees."""
    return np.asarray(tilt_deg(poses.quat), dtype=np.float64)


def shaking_g(story: Story, poses: Poses) -> FloatArray:
    """(3,) what shakes the carrier, in g: the carrier's acceleration, or the force on the carrier divided by the total
    weight. The values are 0 if nothing shakes the carrier."""
    if story.drive is None:
        return np.zeros(3)
    of_force = story.drive.excitation.kind == FORCE
    unit = story.scene.total_mass * STANDARD_GRAVITY if of_force else STANDARD_GRAVITY
    return np.asarray(story.history.drive[poses.frame] / unit)


def _interpolated_quats(first: FloatArray, second: FloatArray, share: float) -> FloatArray:
    """Orientations between the orientations in two frames; ``share`` is 0 at the first frame and 1 at the second.
    Quaternions are interpolated linearly and normalised, which is accurate enough for the small angles between two
    frames."""
    same_side = np.where((first * second).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    mixed = first + share * (same_side * second - first)
    return np.asarray(mixed / np.linalg.norm(mixed, axis=-1, keepdims=True))
