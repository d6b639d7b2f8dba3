"""What happened in a world over time: frames that an engine recorded, for jobs that ask for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petmjx.units import FloatArray

CARRIER = -1
FLOOR = -2
"""Bodies of contacts that are not boxes; boxes count from 0, in packing order."""


@dataclass(frozen=True)
class Record:
    """What an engine is to record of a world.

    Attributes:
        interval_s: time between frames, s, rounded to steps. Besides them the moments of placements and the last state
            are frames.
        details: also accelerations, penetrations and contacts; engine ``mujoco`` only.
    """

    interval_s: float
    details: bool = False


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of all frames, c rows in order of frames.

    Attributes:
        frame: (c,) the frame.
        body: (c, 2) the two bodies: boxes from 0, ``CARRIER``, ``FLOOR``.
        point: (c, 3) where, m, world axes.
        normal: (c, 3) unit vector from the first body to the second.
        force: (c, 3) force of the first body on the second, N, world axes.
        distance: (c,) m; negative where the bodies penetrate.
    """

    frame: NDArray[np.int32]
    body: NDArray[np.int32]
    point: FloatArray
    normal: FloatArray
    force: FloatArray
    distance: FloatArray


@dataclass(frozen=True, eq=False)
class History:
    """One world's f frames of n boxes, in packing order. Values of boxes that are not placed yet are NaN.

    Attributes:
        time_s: (f,) time since the soft start; the first frame is the first placement or, with check ``static``, 0.
        n_placed: (f,) boxes in the world.
        pos: (f, n, 3) centres, m.
        quat: (f, n, 4) orientations, (w, x, y, z).
        top_force_n: (f, n) force on top of each box, N.
        carrier_pos: (f, 3) the carrier's centre, m; carrier_quat: (f, 4).
        drive: (f, 3) what shakes the world: force on the carrier, N, or its acceleration, m/s²; zero without a drive.
        lin_acc, ang_acc: (f, n, 3) m/s² and rad/s²; penetration_m: (f, n) greatest depth of any contact of the box.
            None where details were not recorded, as ``contacts``.
    """

    time_s: FloatArray
    n_placed: NDArray[np.int32]
    pos: FloatArray
    quat: FloatArray
    top_force_n: FloatArray
    carrier_pos: FloatArray
    carrier_quat: FloatArray
    drive: FloatArray
    lin_acc: FloatArray | None = None
    ang_acc: FloatArray | None = None
    penetration_m: FloatArray | None = None
    contacts: Contacts | None = None
