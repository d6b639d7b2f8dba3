"""History of a world: the frames that an engine records for a job with ``record``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text
from petmjx.common.units import FloatArray

CARRIER = -1
FLOOR = -2
"""Numbers by which contacts name the bodies that are not boxes. Boxes are numbered from 0, in packing order."""


@dataclass(frozen=True)
class Record:
    """The frames of a world that an engine should record.

    Attributes:
        interval_s: time between frames, s, rounded to whole steps. The moments of placements and the last state are
            additional frames.
        details: True: also record accelerations, penetrations and contacts; engine ``mujoco`` only.
    """

    interval_s: float
    details: bool = False


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of all frames, as c rows in order of frames.

    Attributes:
        frame: (c,) number of the frame.
        body: (c, 2) the two bodies: boxes from 0, ``CARRIER``, ``FLOOR``.
        point: (c, 3) position of the contact in world axes, m.
        normal: (c, 3) unit vector from the first body to the second.
        force: (c, 3) force of the first body on the second in world axes, N.
        distance: (c,) distance of the bodies, m; negative if they penetrate.
    """

    frame: NDArray[np.int32]
    body: NDArray[np.int32]
    point: FloatArray
    normal: FloatArray
    force: FloatArray
    distance: FloatArray

    @classmethod
    def none(cls) -> Contacts:
        """No contacts."""
        vectors = np.zeros((0, 3))
        return cls(np.zeros(0, np.int32), np.zeros((0, 2), np.int32), vectors, vectors, vectors, np.zeros(0))

    def of_frames(self, kept: NDArray[np.bool_], shift: int) -> Contacts:
        """The contacts of the kept frames, with ``shift`` added to the frame numbers."""
        rows = kept[self.frame]
        field_rows = {field.name: getattr(self, field.name)[rows] for field in fields(self)}
        return Contacts(**field_rows | {"frame": field_rows["frame"] + np.int32(shift)})

    def __repr__(self) -> str:
        return f"Contacts({count_text(len(self.frame), 'contact')})"

    def then(self, later: Contacts) -> Contacts:
        """These contacts, followed by ``later``."""
        names = [field.name for field in fields(self)]
        return Contacts(**{name: np.concatenate((getattr(self, name), getattr(later, name))) for name in names})


@dataclass(frozen=True, eq=False)
class History:
    """The history of one world: f frames of n boxes, in packing order. The values of a box are NaN until it is placed.

    A frame is taken after a step. Its poses are those after the step. Its forces, accelerations, contacts and drive are
    those during the step; MuJoCo evaluates them at the beginning of the step. For a box that was placed after the step,
    forces and accelerations are 0.

    Attributes:
        time_s: (f,) time since the soft start; the first frame is the first placement or, with check ``static``, 0.
        n_placed: (f,) number of boxes in the world.
        pos: (f, n, 3) centres, m.
        quat: (f, n, 4) orientations, (w, x, y, z).
        top_force_n: (f, n) force on top of each box, N.
        carrier_pos: (f, 3) centre of the carrier, m.
        carrier_quat: (f, 4) orientation of the carrier, (w, x, y, z).
        drive: (f, 3) the drive: force on the carrier, N, or its acceleration, m/s²; zero without a drive.
        drive_kind: "force" or "acceleration"; "" without a drive.
        lin_acc, ang_acc: (f, n, 3) accelerations, m/s² and rad/s²; None if details were not recorded.
        penetration_m: (f, n) greatest depth of any contact of the box; None if details were not recorded.
        contacts: all contacts; None if details were not recorded.
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
        """This history up to the first frame of a later one, followed by the later one.

        If both have a frame at the same moment, the frame of this history is kept: the later world started at that
        moment and does not know the forces before it.
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
