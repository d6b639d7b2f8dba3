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
"""The two kinds of excitations and of profiles, by what the samples are: forces or accelerations."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """A force or acceleration profile as an array: one vector per step, in the profile's own axes.

    Attributes:
        name: name for messages.
        kind: "force" (on the carrier, samples in units of total mass × 9.81 m/s²) or "acceleration"
            (of the carrier, samples in m/s²; simulated as gravity − a with the carrier clamped).
        samples: (n_steps, 3) vectors; row i acts during step i + 1 of the profile. After the last row, nothing acts.
    """

    name: str
    kind: str
    samples: FloatArray

    @cached_property
    def peak_g(self) -> float:
        """The largest horizontal acceleration of carrier and boxes together, in units of 9.81 m/s²."""
        peak = float(np.hypot(self.samples[:, 0], self.samples[:, 1]).max(initial=0.0))
        return peak if self.kind == FORCE else peak / STANDARD_GRAVITY


@dataclass(frozen=True, eq=False)
class Drive:
    """An excitation as it acts on one world: scaled, and rotated about the vertical by ``yaw_rad``."""

    excitation: Excitation
    scale: float = 1.0
    yaw_rad: float = 0.0
    rest_s: float = 1.0
    """Time to come to rest after the last sample of the excitation, s."""
    allowed_sway_m: float = 0.0
    """A culprit that tilts too far counts as lost only once it has swayed by this distance, m. Until then, the pallet
    may still pass the test."""

    def unit(self, total_mass: float) -> float:
        """Size of one unit of the excitation's samples: in N for forces (see below), 1 m/s² for accelerations.

        The unit of forces is ``total_mass`` (boxes and carrier, kg) × 9.81 m/s². This unit is the same on all engines,
        and it does not depend on the gravity of the physics. The reference implementation uses the total weight as the
        unit, too. A push must not become weaker because boxes weigh less.
        """
        return total_mass * STANDARD_GRAVITY if self.excitation.kind == FORCE else 1.0

    def rows(self, total_mass: float) -> FloatArray:
        """(n_steps, 3) force, N, or acceleration, m/s², during each step of the drive, in world axes.

        Args:
            total_mass: mass of boxes and carrier, kg.
        """
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        rows: FloatArray = (self.scale * self.excitation.samples @ turn.T) * self.unit(total_mass)
        return rows


class EngineState(Protocol):
    """State of a world whose placement has settled. The engine can continue from it. Everything except ``step`` is
    private to the engine."""

    @property
    def step(self) -> SupportsInt:
        """Number of steps since the soft start."""
        ...


@dataclass(frozen=True, eq=False)
class KeptState:
    """A settled state and the name of the engine that made it. Only this engine can start from the state."""

    engine: str
    state: EngineState


@dataclass(frozen=True, eq=False)
class Job:
    """One world to simulate.

    ``start`` is the ``state`` of an earlier outcome: the world skips soft start and placement, and begins with its
    drive. The engine gets a state of its own type; outside the engine, the state is wrapped in a ``KeptState``.
    ``keep_state`` requests a state, taken when the placement has settled. A job with ``keep_state`` and no drive may
    end once the placement has settled, without a rest window. ``record`` requests the world's history; no other result
    changes. ``has_errors``: boxes are not exactly at their planned places, and may stand on a neighbour that is a
    little higher (``petmjx.engines.contact_tilt``).

    With early stop, a world with errors ends not only when a box has dropped, but also when a box is *lost*: tilted by
    more than the threshold. Since the largest tilt counts, the verdict is known once a box is lost. The remaining time
    would be the most expensive part of the simulation. A large shift does not end the world: a board that tips under
    one load is level again under the next one. A world with a drive ends when its culprit is lost, since only then is
    it known how the first box failed.

    ``poses``, (n, 7): middles, m, and orientations (w, x, y, z) of the boxes when the drive begins. The boxes are at
    rest at these poses. So a drive can continue from the poses that another drive left, on any engine. The carrier is
    where the placement left it, since drives of accelerations clamp it. None: the boxes, too, are where the placement
    left them.
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
        """Whether the placement ends in a settled state, from which a drive starts or which is kept."""
        return self.drive is not None or self.keep_state
