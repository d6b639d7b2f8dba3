"""History of a world: the frames (states at certain times) that an engine records for a job with ``record``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text
from petmjx.common.units import FloatArray

CARRIER = -1
FLOOR = -2
"""Numbers of the carrier and the floor in lists of contacts. Boxes are numbered from 0, in packing order."""


@dataclass(frozen=True)
class Record:
    """A request to an engine to record frames of a world.

    Attributes:
        interval_s: time between frames, s, rounded to whole steps. In addition, a frame is recorded whenever a box is
            placed, and at the end.
        details: whether to also record accelerations, penetrations and contacts, which only the engine ``mujoco`` can
            record.
    """

    interval_s: float
    details: bool = False


@dataclass(frozen=True, eq=False)
class Contacts:
    """The contacts of all frames of a history: c contacts, in order of frames.

    Attributes:
        frame: (c,) number of the frame in which each contact occurs.
        body: (c, 2) the two bodies that touch: numbers of boxes, ``CARRIER`` or ``FLOOR``.
        point: (c, 3) position of the contact in world axes, m.
        normal: (c, 3) unit vector that points from the first body to the second.
        force: (c, 3) force of the first body on the second in world axes, N.
        distance: (c,) distance between the bodies' surfaces, m; negative if the bodies penetrate one another.
    """

    frame: NDArray[np.int32]
    body: NDArray[np.int32]
    point: FloatArray
    normal: FloatArray
    force: FloatArray
    distance: FloatArray

    @classmethod
    def none(cls) -> Contacts:
        """An object without any contacts."""
        vectors = np.zeros((0, 3))
        return cls(np.zeros(0, np.int32), np.zeros((0, 2), np.int32), vectors, vectors, vectors, np.zeros(0))

    def of_frames(self, kept: NDArray[np.bool_], shift: int) -> Contacts:
        """The contacts in some of the f frames, with ``shift`` added to their frame numbers.

        Args:
            kept: (f,) for each frame, whether its contacts are returned.
        """
        rows = kept[self.frame]
        field_rows = {field.name: getattr(self, field.name)[rows] for field in fields(self)}
        return Contacts(**field_rows | {"frame": field_rows["frame"] + np.int32(shift)})

    def __repr__(self) -> str:
        return f"Contacts({count_text(len(self.frame), 'contact')})"

    def then(self, later: Contacts) -> Contacts:
        """The contacts of this object, followed by the contacts of ``later``."""
        names = [field.name for field in fields(self)]
        return Contacts(**{name: np.concatenate((getattr(self, name), getattr(later, name))) for name in names})


@dataclass(frozen=True, eq=False)
class History:
    """The history of one world: f frames of n boxes, in packing order. The values of a box are NaN until it is placed.

    A frame is taken after a step. The poses are the poses after the step. The forces, accelerations, contacts and drive
    (what shakes the carrier) are the values during the step; MuJoCo evaluates them at the beginning of the step. If a
    box was placed directly after the step, its forces and accelerations in this frame are 0.

    Attributes:
        time_s: (f,) time since the soft start (the phase in which gravity grows), s. The first frame is taken at the
            first placement or, with check ``static``, at time 0.
        n_placed: (f,) number of boxes placed so far.
        pos: (f, n, 3) centres of the boxes, m.
        quat: (f, n, 4) orientations of the boxes as quaternions (w, x, y, z).
        top_force_n: (f, n) sum of the vertical forces on each box from above, N.
        carrier_pos: (f, 3) centre of the carrier, m.
        carrier_quat: (f, 4) orientation of the carrier as a quaternion (w, x, y, z).
        drive: (f, 3) force on the carrier, N, or acceleration of the carrier, m/s²; zero without a drive.
        drive_kind: "force" or "acceleration"; "" without a drive.
        lin_acc: (f, n, 3) linear accelerations of the boxes, m/s²; None if details were not recorded.
        ang_acc: (f, n, 3) angular accelerations of the boxes, rad/s²; None if details were not recorded.
        penetration_m: (f, n) depth of the deepest contact of each box, m; None if details were not recorded.
        contacts: the contacts in all frames; None if details were not recorded.
    """

    time_s: FloatArray
    n_placed: NDArray[np.int32]
    pos: FloatArray
    quat: FloatArray
    top_force_n: FloatArray
    carrier_pos: FloatArray
    carrier_quat: FloatArray
    drive: FloatArray
    drive_kind: str = ""
    lin_acc: FloatArray | None = None
    ang_acc: FloatArray | None = None
    penetration_m: FloatArray | None = None
    contacts: Contacts | None = None

    def __repr__(self) -> str:
        frames, boxes = self.pos.shape[:2]
        span = f"{self.time_s[0]:.2f} to {self.time_s[-1]:.2f} s" if frames else "empty"
        return f"History({count_text(frames, 'frame')} of {count_text(boxes, 'box', 'boxes')}, {span})"

    def then(self, later: History) -> History:
        """This history up to the first frame of ``later``, followed by the history ``later``.

        If both histories have a frame at the same time, the frame of this history is kept. The later simulation started
        at that time, so its first frame lacks the forces of the step before.
        """
        is_before, is_after = self.time_s <= later.time_s[0], later.time_s > later.time_s[0]
        joined: dict[str, Any] = {}
        for field in fields(self):
            ours, theirs = getattr(self, field.name), getattr(later, field.name)
            if isinstance(ours, str):
                joined[field.name] = theirs
            elif ours is None or theirs is None:
                joined[field.name] = None
            elif isinstance(ours, Contacts):
                first = int(is_before.sum()) - int((~is_after).sum())
                joined[field.name] = ours.of_frames(is_before, 0).then(theirs.of_frames(is_after, first))
            else:
                joined[field.name] = np.concatenate((ours[is_before], theirs[is_after]))
        return History(**joined)
