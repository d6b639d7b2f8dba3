"""The timetable of a run in whole steps. Events happen at the same steps as in the reference implementation.

MuJoCo's clock is a float64 running sum of the timestep. A wait ends after the first step at which ``time − time at
which the wait began ≥ length of the wait``. The batched engines count steps as integers. The tables of this module give
the batched engines the results of these float64 comparisons.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float64, Int32

from petmjx.common.units import seconds_to_steps
from petmjx.options.simulation import Check, Simulation
from petmjx.world.approach_paths import MOST_WAY_S
from petmjx.world.hand import MOST_STUCK_S

KEPT: Final = 8
"""Number of timetables in the cache. Each timetable takes up to 20 bytes per step: 25 MB for 250 boxes."""


@dataclass(frozen=True, eq=False)
class Timetable:
    """The step numbers of a run, and its clock.

    Attributes:
        clock: time after each step, s.
        due: for each step s, the step at which a wait of ``interval_s`` ends if it begins after step s.
        longest: for each step s, the step at which a wait of ``longest_wait_s`` ends if it begins after step s.
        settled: for each step s, the step at which a wait of ``settle_s`` ends if it begins after step s. This wait is
            rounded in another way than all other waits: the time ``clock[s] + settle_s`` is converted to whole steps.
        settled_nominally: for each number of boxes, the step after which a drive (the motion of the carrier in a test)
            starts with the fixed schedule. As in the reference implementation, ``settle_s`` is counted from the nominal
            time of the last placement. The actual placement is a little later, since its time is rounded to steps.
        sample_every: number of steps between two samples.
        rest_steps: number of steps of the rest window.
        still_steps: number of steps before a world's end during which boxes must be still.
        due_steps: number of steps of a wait of ``interval_s`` after a drive. After a drive, waits are counted in steps,
            not by the clock.
        longest_steps: number of steps of a wait of ``longest_wait_s`` after a drive.
        one_by_one_end: for each number of boxes, the last step of a check that places boxes one by one with the fixed
            schedule.
        static_end: last step of the static check.
    """

    clock: Float64[np.ndarray, " step"]
    due: Int32[np.ndarray, " step"]
    longest: Int32[np.ndarray, " step"]
    settled: Int32[np.ndarray, " step"]
    settled_nominally: Int32[np.ndarray, " n_boxes"]
    sample_every: int
    rest_steps: int
    still_steps: int
    due_steps: int
    longest_steps: int
    one_by_one_end: Int32[np.ndarray, " n_boxes"]
    static_end: int

    @property
    def most_boxes(self) -> int:
        """Largest number of boxes for which the timetable is long enough."""
        return len(self.one_by_one_end) - 1


@functools.lru_cache(KEPT)
def build_timetable(sim: Simulation, max_boxes: int) -> Timetable:
    """The timetable, long enough for the placement of ``max_boxes`` boxes, including settling. Timetables are cached,
    so they must not be changed."""
    dt = sim.physics.timestep_s
    wait_s = max(sim.interval_s, sim.longest_wait_s)
    # every wait takes a whole number of steps, and rounding of the clock may add one step
    waits = 2 if sim.check is Check.STATIC else max_boxes + 2
    if sim.may_carry:
        wait_s += MOST_WAY_S + 2 * MOST_STUCK_S
    n = waits * (seconds_to_steps(wait_s, dt) + 2) + seconds_to_steps(sim.settle_s, dt) + 4
    n += seconds_to_steps(sim.duration_s, dt) if sim.check is Check.STATIC else 0
    clock = np.concatenate([[0.0], np.cumsum(np.full(n, dt))])
    placing_s = 0.0 if sim.check is Check.STATIC else sim.interval_s
    nominal = [seconds_to_steps(k * placing_s + sim.settle_s, dt) for k in range(max_boxes + 1)]
    ends = [seconds_to_steps((k + 1) * sim.interval_s, dt) for k in range(max_boxes + 1)]
    rest_steps = max(1, seconds_to_steps(sim.rest_window_s, dt))
    return Timetable(
        clock=clock,
        due=_after(clock, sim.interval_s, dt),
        longest=_after(clock, sim.longest_wait_s, dt),
        settled=((clock + sim.settle_s) / dt).astype(np.int32),
        settled_nominally=np.array(nominal, np.int32),
        sample_every=max(1, seconds_to_steps(sim.sample_interval_s, dt)),
        rest_steps=rest_steps,
        still_steps=min(rest_steps, sim.quiet.still_steps),
        due_steps=seconds_to_steps(sim.interval_s, dt),
        longest_steps=seconds_to_steps(sim.longest_wait_s, dt),
        one_by_one_end=np.array(ends, np.int32),
        static_end=seconds_to_steps(sim.duration_s, dt),
    )


def _after(clock: Float64[np.ndarray, " step"], wait_s: float, timestep_s: float) -> Int32[np.ndarray, " step"]:
    """For each step, the first step that is at least ``wait_s`` later. ``clock``: the time after 0, 1, … steps, s. If
    the wait would end after the clock's last step, the value is the number of the last step + 1."""
    n = len(clock) - 1
    # The clock is a sum of rounded timesteps, so the right step differs from this estimate by at most one.
    after = np.minimum(np.arange(n + 1) + seconds_to_steps(wait_s, timestep_s), n + 1)
    for _ in range(2):
        inside = np.minimum(after, n)
        after = np.where((clock[np.maximum(inside - 1, 0)] - clock >= wait_s) & (inside > 0), inside - 1, after)
        inside = np.minimum(after, n)
        after = np.where((clock[inside] - clock < wait_s) & (after <= n), after + 1, after)
    return after.astype(np.int32)
