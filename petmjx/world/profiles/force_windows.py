"""Force profiles made of windows. A window is a span of time during which a constant force acts on the carrier.

Vectors are in units of scale × total mass × 9.81 m/s² (``petmjx.world.job.Drive.unit``). So a vector of length 1 is the
force that accelerates carrier and boxes together by 1 g.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from petmjx.common.units import seconds_to_steps
from petmjx.world.job import FORCE, Excitation
from petmjx.world.profiles.profile import Profile, Strength
from petmjx.world.random_streams import WorldKey

Vector = tuple[float, float, float]

PET_PHYSICS = "PET-Physics, the reference implementation"


@dataclass(frozen=True)
class Window:
    """One push: ``vector`` acts from ``start_s`` for ``duration_s``.

    ``offset_s`` is the time in a chain at which the window's profile begins. The window stores a duration instead of an
    end, because sums must be computed in the order of the reference implementation: profile's start + offset + window's
    start + duration. Another order can change the last digit of the sum, and so change the step to which the sum is
    truncated.
    """

    start_s: float
    duration_s: float
    vector: Vector
    offset_s: float = 0.0

    def absolute_s(self, profile_start_s: float) -> tuple[float, float]:
        """Beginning and end of the window, s, on the clock on which the profile begins at ``profile_start_s``."""
        begin_s = (profile_start_s + self.offset_s) + self.start_s
        return begin_s, begin_s + self.duration_s


@dataclass(frozen=True)
class WindowProfile:
    """A force profile.

    ``replaces`` states what happens when windows overlap. If ``replaces`` is False, the forces of overlapping windows
    add up. If ``replaces`` is True, windows act as in the reference implementation. The beginning of a window ends the
    previous window. The next end of any window sets the force to zero, even if that window no longer acts. If several
    windows begin in the same step, only the last of them acts. The profile ``radial-chain``, from the demo of the
    reference implementation, needs ``replaces``.
    """

    name: str
    windows: tuple[Window, ...]
    source: str
    replaces: bool = False
    kind: str = FORCE
    strength: Strength = Strength.SCALE
    random: bool = False

    @property
    def end_s(self) -> float:
        """End of the last window, s."""
        return max(window.absolute_s(0.0)[1] for window in self.windows)

    def n_steps(self, timestep_s: float) -> int:
        return max(seconds_to_steps(self.end_s, timestep_s), 1)

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        """The forces of all windows. A window acts from step int(begin / dt) to step int(end / dt), where step 0 is at
        time 0.

        Row 0 of the samples acts in the step after step int(start_s / dt). A window that is shorter than a step may act
        in no row.
        """
        first_step = seconds_to_steps(start_s, timestep_s)
        spans = []
        for window in self.windows:
            begin_s, end_s = window.absolute_s(start_s)
            begin = seconds_to_steps(begin_s, timestep_s) - first_step
            end = seconds_to_steps(end_s, timestep_s) - first_step
            spans.append((begin, end, window.vector))
        samples = np.zeros((max(1, *(end for _, end, _ in spans)), 3))
        if self.replaces:
            spans = _one_at_a_time(spans)
        for begin, end, vector in spans:
            samples[begin:end] += np.asarray(vector)
        return Excitation(self.name, self.kind, samples)


def _one_at_a_time(spans: Sequence[tuple[int, int, Vector]]) -> list[tuple[int, int, Vector]]:
    """Spans (first step, end step, force) that do not overlap, made from overlapping spans as in the reference
    implementation.

    The force changes at the beginning and at the end of every given span, in order of time. At each change, the old
    force is removed. After that, the force of the span that begins at this change is set; if several spans begin, the
    force of the last one is set. Windows that follow one another may overlap by a step, since times are rounded to
    whole steps. The end of the earlier window would then remove the force of the later window. So, unlike in the
    reference implementation, an end that comes one step after the beginning of another span is moved to this beginning.
    Spans without a step are left out.
    """
    spans = [span for span in spans if span[0] < span[1]]
    waiting = deque(sorted(spans, key=lambda span: span[0]))
    begins = {begin for begin, _, _ in spans}
    ends = {end - 1 if begin < end - 1 and end - 1 in begins else end for begin, end, _ in spans}
    changes = sorted(begins | ends)
    acting: list[tuple[int, int, Vector]] = []
    for change, next_change in pairwise(changes):
        force = None
        while waiting and waiting[0][0] == change:
            force = waiting.popleft()[2]
        if force is not None:
            acting.append((change, next_change, force))
    return acting


def chain(
    name: str, links: Sequence[tuple[WindowProfile, float, float]], source: str, replaces: bool = False
) -> WindowProfile:
    """A profile made of several force profiles, one after another or overlapping.

    Args:
        links: (profile, its offset from the beginning of the chain in s, factor on its forces) for each profile.
        replaces: what happens when windows overlap; see ``WindowProfile``.
    """
    windows = [
        replace(
            window,
            offset_s=offset_s + window.offset_s,
            vector=(window.vector[0] * scale, window.vector[1] * scale, window.vector[2] * scale),
        )
        for profile, offset_s, scale in links
        for window in profile.windows
    ]
    return WindowProfile(name, tuple(windows), source, replaces)


def _pushes(duration_s: float, *pushes: tuple[float, Vector]) -> tuple[Window, ...]:
    """Windows of equal duration. Each push is given as (beginning in s, force vector)."""
    return tuple(Window(start_s, duration_s, vector) for start_s, vector in pushes)


_SQRT2 = math.sqrt(2)

RADIAL = WindowProfile(
    "radial",
    _pushes(
        0.03,
        (0.0, (_SQRT2, 0.0, 0.1)),
        (0.3, (1.0, 1.0, 0.1)),
        (0.6, (0.0, _SQRT2, 0.1)),
        (0.9, (-1.0, 1.0, 0.1)),
        (1.2, (-_SQRT2, 0.0, 0.1)),
        (1.5, (-1.0, -1.0, 0.1)),
        (1.8, (0.0, -_SQRT2, 0.1)),
        (2.1, (1.0, -1.0, 0.1)),
        (3.1, (1.0, 0.0, 1.0)),
        (3.4, (0.0, 1.0, 1.0)),
    ),
    f"{PET_PHYSICS}, profile 'radial'",
)
"""Eight pushes in all horizontal directions, then two pushes that also lift the carrier. Source: PET-Physics."""

JOLTS = WindowProfile(
    "jolts",
    _pushes(
        0.15,
        (1.0, (0.9, 0.1, 0.0)),
        (1.1, (-0.4, -0.1, 0.0)),
        (2.0, (-0.95, -0.1, 0.1)),
        (3.0, (0.55, 0.2, 0.1)),
        (4.0, (-0.75, -0.3, 0.15)),
        (5.0, (-1.0, -0.25, 0.1)),
        (6.0, (1.1, 0.2, 0.1)),
        (7.0, (1.2, 0.2, 0.1)),
        (8.0, (1.2, 0.2, 10.0)),
    ),
    f"{PET_PHYSICS}, profile 'dummy'",
)
"""Nine long jolts, mainly along x. The last jolt throws the pallet up. Source: profile "dummy" of PET-Physics."""

SINE = WindowProfile(
    "sine",
    tuple(Window(i / 10, 0.1, (math.sin(i / 10), 0.0, math.sin(3 * (i / 10)))) for i in range(1, 100)),
    f"{PET_PHYSICS}, profile 'sin dummy'",
)
"""Windows of 0.1 s, with the forces sin t along x and sin 3t along z. Source: profile "sin dummy" of PET-Physics."""

RADIAL_CHAIN = chain(
    "radial-chain",
    [
        (RADIAL, offset_s, scale)
        for offset_s, scale in ((2.0, 1.0), (4.0, 1.1), (7.0, 1.2), (9.5, 1.3), (12.0, 1.4), (14.5, 1.5), (17.0, 2.0))
    ],
    f"{PET_PHYSICS}, dynamic stability demo",
    replaces=True,
)
"""Seven profiles ``radial`` of growing strength: the dynamic check in the demo of PET-Physics, the reference
implementation. In that demo, the chain begins 2 s (``settle_s``) after the nominal end of the placement (number of
boxes × interval), and the first push comes 2 s later. From the third profile on, the last two pushes of a profile act
at the same time as two pushes of the next profile (the first time at 10.1 and 10.4 s). Of two pushes at the same time,
the reference implementation applies only one, and so does this profile."""

BUILT_IN_FORCES: tuple[Profile, ...] = (RADIAL, JOLTS, SINE, RADIAL_CHAIN)
"""To add a built-in force profile: define it above, list it here, and describe it in docs/profiles.md."""
