"""The events in a world with the number of their steps, read from a history with one frame per step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.engines.mujoco import box_motion
from petmjx.engines.mujoco.running_metrics import excess
from petmjx.engines.verdict import Flag, Outcome, Reason
from petmjx.options.simulation import Schedule, Simulation
from petmjx.world.history import History, Record
from petmjx.world.job import Job
from support.histories import history_of


def every_step(sim: Simulation) -> Record:
    return Record(sim.physics.timestep_s)


@dataclass(frozen=True)
class Trace:
    """The events in a world. Numbers are numbers of steps, or −1 for events that never happen.

    Attributes:
        placed: the step after which each box was placed.
        quiet: the looks (checks whether the pallet is quiet) that found it quiet; creeping boxes are not considered.
        driven: the first and the last step in which the carrier was shaken.
        sign: the first sign of failure: step, box, and number of placed boxes.
        dropped: the step at which each box had dropped.
        end: the last step.
    """

    placed: tuple[int, ...]
    quiet: tuple[int, ...]
    driven: tuple[int, int]
    sign: tuple[int, int, int]
    dropped: tuple[int, ...]
    end: int
    reason: Reason
    flags: Flag

    def near(self, other: Trace, steps: int) -> bool:
        """Whether two traces have the same events, each at most ``steps`` steps apart. Looks are not compared."""

        def kinds(trace: Trace) -> tuple[object, ...]:
            never = [step < 0 for step in (*trace.driven, trace.sign[0], *trace.dropped)]
            return trace.sign[1:], trace.reason, trace.flags, len(trace.placed), never

        def times(trace: Trace) -> list[int]:
            return [*trace.placed, *trace.driven, trace.sign[0], *trace.dropped, trace.end]

        return kinds(self) == kinds(other) and bool((np.abs(np.subtract(times(self), times(other))) <= steps).all())


@dataclass(frozen=True, eq=False)
class Seen:
    """A recorded world, and what the rules (docs/rules.md) require for its frames. The rules are written here once
    more, independently."""

    job: Job
    sim: Simulation
    outcome: Outcome

    @property
    def history(self) -> History:
        return history_of(self.outcome)

    @cached_property
    def steps(self) -> list[int]:
        numbers: list[int] = np.round(self.history.time_s / self.sim.physics.timestep_s).astype(int).tolist()
        assert numbers == list(range(numbers[0], numbers[-1] + 1)), "a frame a step"
        return numbers

    def step_of(self, time_s: float) -> int:
        return -1 if np.isnan(time_s) else round(time_s / self.sim.physics.timestep_s)

    @cached_property
    def trace(self) -> Trace:
        outcome, acts = self.outcome, np.flatnonzero(self.history.drive.any(axis=1))
        return Trace(
            placed=tuple(self.placed),
            quiet=tuple(step for step, count in self.looks.items() if count >= self.sim.quiet.steps),
            driven=(self.steps[acts[0]], self.steps[acts[-1]]) if len(acts) else (-1, -1),
            sign=(self.step_of(outcome.first_sign_s), outcome.culprit, outcome.n_at_sign),
            dropped=tuple(map(self.step_of, outcome.boxes.drop_s)),
            end=self.steps[-1],
            reason=outcome.reason,
            flags=outcome.flags,
        )

    @cached_property
    def placed(self) -> list[int]:
        return [self.steps[int(np.argmax(self.history.n_placed > box))] for box in range(self.outcome.n_placed)]

    @cached_property
    def looks(self) -> dict[int, int]:
        """Step of each look → number of steps for which boxes had been quiet."""
        radius_m = np.linalg.norm(self.job.scene.half_size, axis=1)
        pose = np.concatenate([self.history.pos, self.history.quat], axis=-1)
        count, quiet_by_look, every = 0, {}, self.sim.quiet.poll_steps
        for frame, step in enumerate(self.steps[1:], start=1):
            if step % every == 0:
                moved_m = box_motion.moved(pose[frame - 1], pose[frame], radius_m)  # NaN if not placed yet
                fast = (moved_m >= self.sim.quiet.quiet_m_s * self.sim.physics.timestep_s).any()
                quiet_by_look[step] = count = 0 if fast else count + every
            if step in self.placed:
                count = 0
        return quiet_by_look

    @cached_property
    def samples(self) -> list[int]:
        """Frames at the beginning of the steps in which a sample is taken."""
        every = seconds_to_steps(self.sim.sample_interval_s, self.sim.physics.timestep_s)
        return [frame for frame, step in enumerate(self.steps[:-1]) if (step + 1) % every == 0]

    @cached_property
    def poses(self) -> list[tuple[int, int]]:
        """Pairs (step, frame) at which poses are checked: at samples, at looks in the drive, at the end of a fixed
        schedule, and at the last step."""
        frame_by_step, acts, first = {}, self.trace.driven[0], self.steps[0]
        if acts > 0 and self.sim.waits_for_rest:
            frame_by_step = {
                step: step - first for step in self.steps if step >= acts and not step % self.sim.quiet.poll_steps
            }
        fixed_end = seconds_to_steps((self.outcome.n_boxes + 1) * self.sim.interval_s, self.sim.physics.timestep_s)
        if self.sim.schedule is Schedule.FIXED and acts < 0 and fixed_end in self.steps:
            frame_by_step[fixed_end] = fixed_end - first  # a world that moves at this step continues
        frame_by_step |= {self.steps[frame] + 1: frame for frame in self.samples}
        return [*sorted(frame_by_step.items()), (self.steps[-1], len(self.steps) - 1)]

    def excess(self, frame: int) -> FloatArray:
        """(placed,) excess of the boxes in a frame."""
        scene, limits, k = self.job.scene, self.sim.thresholds, int(self.history.n_placed[frame])
        pos, quat = self.history.pos[frame, :k], self.history.quat[frame, :k]
        dropped = box_motion.has_dropped(pos, quat, scene.half_size[:k], limits)
        shift = box_motion.shift(pos, scene.target[:k], limits.shift_floor_m)
        over: FloatArray = excess(shift, box_motion.tilt_deg(quat), dropped, limits)
        return over

    def first_sign(self) -> tuple[int, int]:
        """Step and box of the first sign of failure. (−1, −1) if there is none."""
        begin = self.steps.index(self.trace.driven[0]) - 1 if self.trace.driven[0] > 0 else 0
        if (self.excess(begin) > 1).any():
            begin = 0  # a sign during the placement is forgotten only if no box is beyond a threshold
        for step, frame in [pose for pose in self.poses if pose[1] >= begin]:
            over = self.excess(frame)
            if (over > 1).any():
                return step, int(over.argmax())
        return -1, -1

    def tilt_deg(self) -> FloatArray:
        """(n,) largest tilt of each box over all checked poses, degrees."""
        quat = self.history.quat[[frame for _, frame in self.poses]]
        angles = np.array([box_motion.tilt_deg(orientation) for orientation in quat])
        return np.nan_to_num(np.fmax.reduce(angles, axis=0))

    def rest_force_n(self) -> FloatArray:
        """(n,) mean force on top of each box over the rest window, N."""
        window = seconds_to_steps(self.sim.rest_window_s, self.sim.physics.timestep_s)
        mean: FloatArray = self.history.top_force_n[-window:].mean(axis=0)
        return mean

    def top_force_n(self) -> FloatArray:
        """(n,) largest force on top of each box over all steps after the soft start, N."""
        largest: FloatArray = np.fmax.reduce(self.history.top_force_n[1:], axis=0, initial=0.0)
        return largest
