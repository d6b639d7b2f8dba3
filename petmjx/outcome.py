"""What an engine is asked to simulate, and what it answers, world by world (NumPy only)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntFlag, StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from petmjx.config import SimConfig
from petmjx.scene import Scene

FloatArray = NDArray[np.float64]


class Verdict(StrEnum):
    STABLE = "stable"
    UNSTABLE = "unstable"
    INVALID = "invalid"


class Reason(StrEnum):
    """Why a world is not stable. Empty for worlds that are."""

    NONE = ""
    NONFINITE = "nonfinite"
    OVERFLOW = "overflow"
    EXPLOSION = "explosion"
    OUT_OF_MEMORY = "out-of-memory"
    DROP = "drop"
    TILT = "tilt"
    SHIFT = "shift"


class Flag(IntFlag):
    """What happened to a world that the metrics alone do not tell. Kept in the results."""

    NONE = 0
    NONFINITE = 1
    CONTACT_OVERFLOW = 2
    CONSTRAINT_OVERFLOW = 4
    EXPLOSION = 8
    EARLY_STOP = 16
    RERUN_AFTER_OVERFLOW = 32
    OUT_OF_MEMORY = 64
    OTHER_OVERFLOW = 128
    FORKED = 256
    """The world started from a settled state that another world had reached."""


@dataclass(eq=False)
class BoxMetrics:
    """Per-box results of one world, in packing order. Definitions: docs/metrics.md.

    Attributes:
        shift_m: (n, 3) final centre − planned centre; components under the floor are 0.
        max_tilt_deg: (n,) over samples since the box was placed.
        max_lin_acc: (n,) m/s², max_ang_acc: (n,) rad/s².
        max_top_force_n: (n,) N; rest_top_force_n: (n,) N, NaN where the world never came to rest.
        dropped: (n,) bool; drop_s: (n,) s, NaN where the box did not drop.
        max_sway_m: (n,) largest horizontal displacement from the start of the force profile, m; NaN without one.
        pos: (n, 3) final centres, m; quat: (n, 4) final orientations (w, x, y, z).
    """

    shift_m: FloatArray
    max_tilt_deg: FloatArray
    max_lin_acc: FloatArray
    max_ang_acc: FloatArray
    max_top_force_n: FloatArray
    rest_top_force_n: FloatArray
    dropped: NDArray[np.bool_]
    drop_s: FloatArray
    max_sway_m: FloatArray
    pos: FloatArray
    quat: FloatArray


@dataclass(eq=False)
class Outcome:
    """What one simulated world came to. ``culprit`` is a box index (packing order from 0), −1 for none."""

    job: int
    verdict: Verdict
    reason: Reason
    culprit: int
    first_sign_s: float
    n_boxes: int
    n_placed: int
    sim_time_s: float
    n_steps: int
    flags: Flag
    boxes: BoxMetrics
    solver: str = "newton"
    attempt: int = 1
    state: Any = None
    """The settled state, where the job asked for it: opaque to all but the engine that made it."""


@dataclass(frozen=True, eq=False)
class Excitation:
    """A force or acceleration profile as dense per-step samples, in profile coordinates.

    Attributes:
        name: for messages.
        kind: "force" (on the carrier, samples in units of scale × total mass × g) or "acceleration"
            (of the carrier, samples in m/s²; simulated as gravity − a with the carrier held fast).
        samples: (n_steps, 3); row i acts during step i + 1 of the profile; zero beyond its end.
    """

    name: str
    kind: str
    samples: FloatArray


@dataclass(frozen=True, eq=False)
class Drive:
    """One excitation as one world feels it: scaled, and turned about the vertical by ``yaw_rad``."""

    excitation: Excitation
    scale: float = 1.0
    yaw_rad: float = 0.0
    rest_s: float = 1.0
    """Time to come to rest after the last sample of the excitation."""


@dataclass(frozen=True, eq=False)
class Job:
    """One world to simulate.

    ``start`` is the ``state`` of an earlier outcome of the same engine: the world then skips soft start
    and placement and begins with its drive. ``keep_state`` asks for such a state, taken where placement has
    settled; a job that keeps its state and has no drive may end there, without a rest window.
    """

    scene: Scene
    drive: Drive | None = None
    start: Any = None
    keep_state: bool = False


@dataclass
class Progress:
    """Running totals an engine reports while it works; ``message`` tells of compilation and such."""

    worlds_done: int = 0
    world_steps: int = 0
    compile_s: float = 0.0
    message: str = ""
    extra: dict[str, float] = field(default_factory=dict)


class Engine(Protocol):
    """Simulates worlds. Outcomes come in any order, as they finish; ``Outcome.job`` says whose they are."""

    name: str

    def run(self, jobs: Sequence[Job], sim: SimConfig, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once with ``sim.solver``. No retries: those are the runner's."""
        ...
