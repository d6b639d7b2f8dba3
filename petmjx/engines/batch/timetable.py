"""Times of a run as whole steps, the same steps as in the reference implementation.

MuJoCo's clock is a float64 running sum of the timestep, and events happen after the first step at which
``time − earlier time ≥ interval``. The batched engines count steps in integers; these tables carry the
float64 comparisons over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int32

from petmjx.config import Check, Simulation
from petmjx.units import seconds_to_steps


@dataclass(frozen=True, eq=False)
class Timetable:
    """Step numbers of a run; ``clock[s]`` is the time after step s, s (seconds).

    Attributes:
        clock: time after each step, s.
        due: a box placed after step s is followed by the next one after step ``due[s]`` at the latest.
        settled: the drive of a world whose last box was placed after step s starts after step ``settled[s]`` at the
            latest (adaptive schedule).
        settled_nominally: the same for the fixed schedule, by number of boxes: the reference counts from the nominal
            moment of the last placement, which rounding to steps puts a little later.
        sample_every, rest_steps: steps between two samples, and in the rest window.
        one_by_one_end: last step of the fixed one-by-one check by number of boxes; static_end: of the static one.
    """

    clock: Float64[np.ndarray, " step"]
    due: Int32[np.ndarray, " step"]
    settled: Int32[np.ndarray, " step"]
    settled_nominally: Int32[np.ndarray, " n_boxes"]
    sample_every: int
    rest_steps: int
    one_by_one_end: Int32[np.ndarray, " n_boxes"]
    static_end: int


def build_timetable(sim: Simulation, max_boxes: int) -> Timetable:
    """Tables long enough for a plan of ``max_boxes`` boxes, settling included."""
    dt = sim.physics.timestep_s
    if sim.check is Check.ONE_BY_ONE:
        # a placement takes whole steps, and the clock's rounding may make it one more
        placement = (max_boxes + 2) * (seconds_to_steps(sim.interval_s, dt) + 2)
    else:
        placement = seconds_to_steps(sim.duration_s, dt)
    n = placement + seconds_to_steps(sim.settle_s, dt) + 4
    clock = np.concatenate([[0.0], np.cumsum(np.full(n, dt))])
    # searchsorted compares a time with (earlier time + interval), which rounds differently from the difference of
    # times in the rule. So its answer is corrected with the comparison of the rule.
    due = np.searchsorted(clock, clock + sim.interval_s - dt / 2).astype(np.int64)
    for _ in range(2):
        inside = np.minimum(due, n)
        due = np.where((clock[np.maximum(inside - 1, 0)] - clock >= sim.interval_s) & (inside > 0), inside - 1, due)
        inside = np.minimum(due, n)
        due = np.where((clock[inside] - clock < sim.interval_s) & (due <= n), due + 1, due)
    settled = np.array([seconds_to_steps(t + sim.settle_s, dt) for t in clock])
    placing_s = 0.0 if sim.check is Check.STATIC else sim.interval_s
    nominal = [seconds_to_steps(k * placing_s + sim.settle_s, dt) for k in range(max_boxes + 1)]
    ends = [seconds_to_steps((k + 1) * sim.interval_s, dt) for k in range(max_boxes + 1)]
    return Timetable(
        clock=clock,
        due=due.astype(np.int32),
        settled=settled.astype(np.int32),
        settled_nominally=np.array(nominal, np.int32),
        sample_every=max(1, seconds_to_steps(sim.sample_interval_s, dt)),
        rest_steps=max(1, seconds_to_steps(sim.rest_window_s, dt)),
        one_by_one_end=np.array(ends, np.int32),
        static_end=seconds_to_steps(sim.duration_s, dt),
    )
