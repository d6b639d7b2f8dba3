"""Simulates the boxes of a scene in a referee's world, and judges them as petmjx judges its own worlds. Placing,
waiting, the rule for quiet, metrics and thresholds are petmjx's (docs/rules.md, section 5), so only the simulator
differs. Where petmjx's rules count steps, times are used here, because a referee may have another timestep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.referees.referee import RefereeWorld
from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.engines.margin import margin_of
from petmjx.engines.metrics import BoxMetrics, BoxSample
from petmjx.engines.mujoco.rest import QuietRule
from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.engines.verdict import Flag, Reason, Verdict, judge
from petmjx.options.simulation import Check, Simulation
from petmjx.world.scene import Scene

SETTLE_S = 0.2
"""Time before the first box, in which the carrier comes to rest on the floor, s."""


@dataclass(frozen=True, eq=False)
class Stood:
    """The result of a referee for a world. ``moving``: whether boxes still moved when the time was up."""

    verdict: Verdict
    reason: Reason
    margin: float
    moving: bool
    boxes: BoxMetrics


def stand(world: RefereeWorld, scene: Scene, sim: Simulation) -> Stood:
    """Place the boxes one by one, or all at once in a static check, and wait until they rest or have failed."""
    return _Run(world, scene, sim).run()


class _Run:
    def __init__(self, world: RefereeWorld, scene: Scene, sim: Simulation) -> None:
        self._world, self._scene, self._sim = world, scene, sim
        self._metrics = OracleMetrics(scene, sim.thresholds)
        self._quiet = QuietRule(sim, scene)
        self._poll_s = sim.quiet.poll_steps * sim.physics.timestep_s
        self._poll_steps = max(round(self._poll_s / world.timestep_s), 1)
        self._polls_per_sample = max(round(sim.sample_interval_s / self._poll_s), 1)
        self._polls = 0
        self._last: FloatArray = np.zeros((0, 7))
        self._finite = True

    def run(self) -> Stood:
        sim, count = self._sim, self._scene.n_boxes
        self._world.step(seconds_to_steps(SETTLE_S, self._world.timestep_s))
        static = sim.check is Check.STATIC
        placed, moving = 0, False
        while self._goes_on and placed < count:
            upto = count if static else placed + 1
            for box in range(placed, upto):
                self._world.place(box)
            self._last = self._world.pose()
            placed = upto
            longest_s = sim.duration_s if static else sim.longest_wait_s
            moving = self._wait(longest_s, to_rest=placed == count)
        return self._judged(placed, moving)

    @property
    def _goes_on(self) -> bool:
        return self._finite and not (self._sim.early_stop and self._metrics.any_dropped)

    def _wait(self, longest_s: float, to_rest: bool) -> bool:
        """Take steps until the boxes are quiet, or, at the end, until they rest. Returns whether they still move."""
        begin_s, failed_s = self._time_s, None
        self._quiet.restart()
        while self._goes_on and self._time_s - begin_s < longest_s:
            quiet = self._look()
            if self._metrics.has_failed:  # a longer wait would not change the verdict
                failed_s = self._time_s if failed_s is None else failed_s
                if self._time_s - failed_s >= self._sim.interval_s:
                    return True
            if not quiet:
                continue
            if not to_rest or self._rests():
                return False
        return True

    def _rests(self) -> bool:
        """Take the steps of a rest window. Returns whether no point moved faster than petmjx's limit in this window."""
        before = self._world.pose()
        window_s = self._sim.rest_window_s
        self._metrics.restart_rest()
        for _ in range(max(round(window_s / self._poll_s), 1)):
            self._look()
            self._metrics.add_rest(self._world.top_forces())
        if not self._goes_on:
            return False
        after = self._world.pose()  # the boxes' speeds at one moment are ignored, since referees' boxes jitter
        _, waits = self._quiet.motion(before, after, np.zeros((len(after), 6)), window_s)
        return not waits

    @property
    def _time_s(self) -> float:
        return self._polls * self._poll_s

    def _look(self) -> bool:
        """Take the steps to the next look, with a sample if one is due. Returns whether the boxes are quiet at this
        look."""
        world = self._world
        world.step(self._poll_steps)
        self._polls += 1
        pose = world.pose()
        self._finite = bool(np.isfinite(pose).all())
        if not self._finite:
            return False
        velocity = _velocity(self._last, pose, self._poll_s)
        self._last = pose
        if self._polls % self._polls_per_sample == 0:
            k, none = len(pose), np.zeros((len(pose), 6))
            sample = BoxSample(pose[:, :3], pose[:, 3:], none, none, np.zeros(k), self._scene.target[:k])
            self._metrics.add_sample(self._time_s, sample)
        return self._quiet.look(pose, velocity, has_failed=self._metrics.has_failed)

    def _judged(self, placed: int, moving: bool) -> Stood:
        scene, sim = self._scene, self._sim
        pose: FloatArray = np.column_stack((scene.start_pos, scene.start_quat))
        pose[:placed] = self._world.pose()
        if self._finite and placed:
            self._metrics.add_pose(self._time_s, pose[:placed, :3], pose[:placed, 3:])
        boxes = self._metrics.finish(pose[:, :3], pose[:, 3:], placed, came_to_end=not moving)
        flags = Flag.NONE if self._finite else Flag.NONFINITE
        verdict, reason = judge(flags, boxes, placed, sim.thresholds)
        return Stood(verdict, reason, margin_of(verdict, boxes, placed, sim.thresholds), moving, boxes)


def _velocity(before: FloatArray, after: FloatArray, seconds: float) -> FloatArray:
    """(k, 6) mean velocities between two (k, 7) poses, m/s and rad/s, for small turns. Mean velocities replace a
    simulator's own velocities, which are never small enough: iterative solvers leave a part of gravity's velocity in
    each step.
    """
    change = (after - before) / seconds
    turn = np.zeros((len(after), 3))
    turn[:, 0] = 2 * np.linalg.norm(change[:, 3:], axis=1)  # only the length of the angular velocity matters
    return np.column_stack((change[:, :3], turn))
