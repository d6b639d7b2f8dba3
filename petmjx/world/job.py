"""Jobs for engines: one world to simulate, and the drive that shakes it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol, SupportsInt

import numpy as np

from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.world.history import Record
from petmjx.world.scene import Scene

FORCE: Final = "force"
ACCELERATION: Final = "acceleration"
"""Kinds of excitations and of profiles."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """A force or acceleration profile as an array: one vector per step, in the profile's own axes.

    Attributes:
        name: name for messages.
        kind: "force" (on the carrier, samples in units of total mass × 9.81 m/s²) or "acceleration"
            (of the carrier, samples in m/s²; simulated as gravity − a with the carrier clamped).
        samples: (n_steps, 3); row i acts during step i + 1 of the profile; zero beyond its end.
    """

    name: str
    kind: str
    samples: FloatArray

    @cached_property
    def peak_g(self) -> float:
        """The largest horizontal acceleration of carrier and boxes, in units of 9.81 m/s²."""
        peak = float(np.hypot(self.samples[:, 0], self.samples[:, 1]).max(initial=0.0))
        return peak if self.kind == FORCE else peak / STANDARD_GRAVITY


@dataclass(frozen=True, eq=False)
class Drive:
    """One excitation as it acts on one world: scaled, and turned about the vertical by ``yaw_rad``."""

    excitation: Excitation
    scale: float = 1.0
    yaw_rad: float = 0.0
    rest_s: float = 1.0
    """Time to come to rest after the last sample of the excitation."""
    allowed_sway_m: float = 0.0
    """A culprit that tilts too far counts as lost only after a sway of this distance. Until this sway the test may
    still be passed."""

    def unit(self, total_mass: float) -> float:
        """The unit of the excitation's samples, in N for forces and in m/s² for accelerations (1).

        The unit of forces is ``total_mass`` (boxes and carrier, kg) × 9.81 m/s², on all engines, and also if the
        physics has another gravity. The total weight is the unit of the reference implementation; a push must not
        become weaker because boxes weigh less.
        """
        return total_mass * STANDARD_GRAVITY if self.excitation.kind == FORCE else 1.0

    def rows(self, total_mass: float) -> FloatArray:
        """(n_steps, 3) the force, N, or the acceleration, m/s², in world axes during each step of the drive.

        Args:
            total_mass: mass of boxes and carrier, kg.
        """
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        rows: FloatArray = (self.scale * self.excitation.samples @ turn.T) * self.unit(total_mass)
        return rows


class EngineState(Protocol):
    """State of a world after its placement has settled, from which the engine can continue. All but ``step`` is private
    to the engine."""

    @property
    def step(self) -> SupportsInt:
        """Steps since the soft start."""
        ...


@dataclass(frozen=True, eq=False)
class KeptState:
    """A settled state and the name of the engine that made it. Only this engine can start from the state."""

    engine: str
    state: EngineState


@dataclass(frozen=True, eq=False)
class Job:
    """One world to simulate.

    ``start`` is the ``state`` of an earlier outcome: the world then skips soft start and placement, and begins with its
    drive. The engine gets its own state; outside the engine this is a ``KeptState``. ``keep_state`` asks for a state,
    taken when the placement has settled. A job with ``keep_state`` and no drive may end when the placement has settled,
    without a rest window. ``record`` asks for the world's history; no other result changes. ``has_errors``: boxes are
    not exactly at their planned places, and may stand on a neighbour that is a little higher
    (``petmjx.engines.contact_tilt``).

    With early stop a world with errors ends when a box is *lost*, which means tilted by more than the threshold, and
    not only when a box has dropped. The largest tilt counts, so the verdict is known when a box is lost. The rest would
    be the dearest part of the simulation. A large shift decides nothing: a board that tips under one load is level
    again under the next one. A world with a drive ends when its culprit is lost: only by then is the way in which the
    first box failed known.

    ``poses``, (n, 7): middles, m, and orientations (w, x, y, z) of the boxes when the drive begins. The boxes are at
    rest at these poses. So a drive continues from the poses that another drive left, on any engine: the carrier is
    where the placement left it, since drives of accelerations clamp it. None: the boxes are where the placement left
    them.
    """

    scene: Scene
    drive: Drive | None = None
    start: KeptState | EngineState | None = None
    poses: FloatArray | None = None
    keep_state: bool = False
    record: Record | None = None
    has_errors: bool = False

    @property
    def settles(self) -> bool:
        """Whether the placement ends in a settled state, for a drive or to keep."""
        return self.drive is not None or self.keep_state
