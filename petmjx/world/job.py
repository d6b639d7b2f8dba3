"""Jobs for engines. A job is one world to simulate: a scene, and the drive (the motion or force) that shakes it."""

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
"""The two kinds of excitations and of profiles: their samples are forces, or accelerations."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """A force or acceleration profile as an array: one vector per timestep, in the profile's own axes.

    Attributes:
        name: name of the profile, for messages.
        kind: "force" or "acceleration". Samples that are forces act on the carrier; their unit is total mass × 9.81
            m/s². Samples that are accelerations are accelerations of the carrier; their unit is m/s². The engine clamps
            the carrier and subtracts the acceleration from gravity.
        samples: (n_steps, 3) vectors. Row i acts during step i + 1 of the profile. Nothing acts after the last row.
    """

    name: str
    kind: str
    samples: FloatArray

    @cached_property
    def peak_g(self) -> float:
        """The largest horizontal acceleration of carrier and boxes together, in units of 9.81 m/s²."""
        return float(self.reached_g[-1]) if len(self.samples) else 0.0

    @cached_property
    def reached_g(self) -> FloatArray:
        """(n_steps,) the largest horizontal acceleration of carrier and boxes together up to each step, in units of
        9.81 m/s²."""
        reached = np.maximum.accumulate(np.hypot(self.samples[:, 0], self.samples[:, 1]))
        return np.asarray(reached if self.kind == FORCE else reached / STANDARD_GRAVITY)


@dataclass(frozen=True, eq=False)
class Drive:
    """An excitation as it acts on one world: multiplied by ``scale``, and rotated about the vertical by ``yaw_rad``."""

    excitation: Excitation
    scale: float = 1.0
    yaw_rad: float = 0.0
    rest_s: float = 1.0
    """Time that the boxes have to come to rest after the last sample of the excitation, s."""
    allowed_sway_m: float = 0.0
    """If the culprit (the box that failed first) tilts too far, it counts as lost only once it has swayed by at least
    this distance, m. While the culprit has swayed less, the pallet may still pass the test from which the profile
    comes."""

    def unit(self, total_mass: float) -> float:
        """Factor that converts the excitation's samples to N (forces) or to m/s² (accelerations; the factor is 1).

        The factor for forces is ``total_mass`` (boxes and carrier, kg) × 9.81 m/s², even if the simulation uses another
        gravity. A push must not become weaker because boxes weigh less in a weaker gravity. The factor is the same on
        all engines. The reference implementation also uses the weight of boxes and carrier at 9.81 m/s².
        """
        return total_mass * STANDARD_GRAVITY if self.excitation.kind == FORCE else 1.0

    def rows(self, total_mass: float) -> FloatArray:
        """(n_steps, 3) force, N, or acceleration, m/s², during each step of the drive, along the world's axes.

        Args:
            total_mass: mass of boxes and carrier, kg.
        """
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        rows: FloatArray = (self.scale * self.excitation.samples @ turn.T) * self.unit(total_mass)
        return rows


class EngineState(Protocol):
    """State of a world whose placement has settled or paused. The engine can continue from this state. Everything
    except ``step`` is private to the engine."""

    @property
    def step(self) -> SupportsInt:
        """Number of steps since the soft start (the first 200 steps, in which gravity grows to its full value)."""
        ...


@dataclass(frozen=True, eq=False)
class KeptState:
    """A settled state and the name of the engine that made the state. Only the engine that made a settled state can
    start from it."""

    engine: str
    state: EngineState


@dataclass(frozen=True, eq=False)
class Job:
    """One world to simulate.

    With early stop, a world ends when a box has dropped. A world in which places of boxes have errors (``has_errors``),
    or which must only give a verdict (``until_lost``), also ends when a box is *lost*: tilted by more than the
    threshold. The verdict depends on the largest tilt, so the verdict is known once a box is lost. Simulating further
    after a box is lost would be the most expensive part of the simulation. A large shift does not end a world, since it
    may be temporary. For example, a board that tips when one box is placed on it may become level again when the next
    box is placed. A world with a drive ends when the culprit (the box that failed first) is lost, since only then is it
    known how the culprit failed.

    Attributes:
        scene: the boxes and the carrier.
        drive: the drive that shakes the world. If ``drive`` is None, nothing shakes the world.
        start: the ``state`` of an earlier outcome. If the placement had settled, the world skips the soft start and the
            placement, and begins with the drive. If the placement had paused, the world begins with the placement of
            its next box. Engines get a state of their own type; outside engines, a ``KeptState`` holds the state.
        pauses_after: number of boxes after which the placement pauses; smaller than the scene's number of boxes. The
            world ends when the next box would be placed, and the outcome has the world's state. The state serves as
            ``start`` of all jobs whose worlds are equal up to the pause (``petmjx.engines.warp.equal_beginnings``). The
            outcome has no state if the world ended earlier. A placement can pause only on engines with
            ``Capability.PAUSES``, in worlds without a drive in which each box is placed as soon as the other boxes are
            at rest.
        poses: (n, 7) middles, m, and orientations (w, x, y, z) with which the boxes begin the drive. All boxes begin at
            rest. With ``poses``, a drive can continue where another drive left the boxes, on any engine. The carrier is
            where the placement left it, since engines clamp the carrier in acceleration profiles. If ``poses`` is None,
            the boxes also are where the placement left them.
        keep_state: whether the outcome must have the state in which the placement has settled. A job with
            ``keep_state`` and no drive may end as soon as the placement has settled, without the further time in which
            boxes come to rest.
        record: what to record as the world's history; recording changes no other result.
        has_errors: whether the boxes' places differ from the planned places, so that a box may stand on a neighbour
            that is a little higher (``petmjx.engines.contact_tilt``).
        until_lost: whether the world ends when a box is lost. This does not change the verdict, but the reason is
            ``tilt`` in some worlds in which a box would have dropped later.
        confirms: whether an earlier attempt found that the pallet falls, and this simulation only has to confirm the
            fall (``petmjx.engines.metrics.CONFIRM_S``).
        stiff: time constant of this world's contacts, as a share of the time constant in the run's options; the world
            has the options of ``petmjx.engines.contact_penetration.stiffened``. If ``stiff`` is None, the world has the
            run's options. ``stiff`` is set only on engines with ``Capability.STIFF_JOBS``, for a world that is
            simulated again together with other worlds.
        iteration_limit: largest number of solver iterations of the placement, and of the drive. The smaller of
            ``iteration_limit`` and ``Simulation.iteration_limit`` applies; None: only the run's limit applies. Further
            attempts do not change ``iteration_limit``.
        edge_risk: the result of a quick static test of the scene's loads (``petmjx.world.edge_distances.EdgeRisk``),
            from which an engine derives the order of worlds; None if it is not known.
    """

    scene: Scene
    drive: Drive | None = None
    start: KeptState | EngineState | None = None
    poses: FloatArray | None = None
    pauses_after: int | None = None
    keep_state: bool = False
    record: Record | None = None
    has_errors: bool = False
    until_lost: bool = False
    confirms: bool = False
    stiff: float | None = None
    iteration_limit: int | None = None
    edge_risk: int | None = None

    @property
    def ends_when_lost(self) -> bool:
        """Whether the world ends when a box is lost."""
        return self.has_errors or self.until_lost

    def most_iterations(self, limit_of_run: int | None) -> int | None:
        """The smaller of this job's limit and the run's limit (``Simulation.iteration_limit``); None: no limit."""
        limits = [limit for limit in (self.iteration_limit, limit_of_run) if limit is not None]
        return min(limits, default=None)

    @property
    def settles(self) -> bool:
        """Whether the placement must end in a settled state, because a drive starts from it or because it is kept."""
        return self.drive is not None or self.keep_state

    @property
    def forks(self) -> bool:
        """Whether the world begins with its drive, from the settled state of another world."""
        return self.start is not None and self.drive is not None
