"""What happened in a world, to the step: read from its frames, of which there is one after each step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.engines.mujoco import box_motion
from petmjx.engines.verdict import Flag, Outcome, Reason
from petmjx.options.simulation import Schedule, Simulation
from petmjx.world.history import History, Record
from petmjx.world.job import Job
from support.histories import history_of


def every_step(sim: Simulation) -> Record:
    return Record(sim.physics.timestep_s)


@dataclass(frozen=True)
class Trace:
    """Events of a world; numbers are steps, −1: never.

    Attributes:
        placed: the step after which each box was placed.
        quiet: looks that found the pallet quiet, creep left out.
        driven: the first and the last step that something shook the world.
        sign: the first sign: step, box, and boxes that were placed then.
        dropped: of each box.
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
        """Whether the same happened, each event at most so many steps earlier or later. Looks are not compared."""

        def kinds(trace: Trace) -> tuple[object, ...]:
            never = [step < 0 for step in (*trace.driven, trace.sign[0], *trace.dropped)]
            return trace.sign[1:], trace.reason, trace.flags, len(trace.placed), never

        def times(trace: Trace) -> list[int]:
            return [*trace.placed, *trace.driven, trace.sign[0], *trace.dropped, trace.end]

        return kinds(self) == kinds(other) and bool((np.abs(np.subtract(times(self), times(other))) <= steps).all())


@dataclass(frozen=True, eq=False)
class Seen:
    """A recorded world, and what the rules (docs/rules.md) say of its frames, in plain words of their own."""

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
        """Look → for how many steps boxes had been quiet then."""
        radius_m = np.linalg.norm(self.job.scene.half_size, axis=1)
        pose = np.concatenate([self.history.pos, self.history.quat], axis=-1)
        count, quiet_by_look, every = 0, {}, self.sim.quiet.poll_steps
        for frame, step in enumerate(self.steps[1:], start=1):
            if step % every == 0:
                moved_m = box_motion.moved(pose[frame - 1], pose[frame], radius_m)  # NaN: not placed yet
                fast = (moved_m >= self.sim.quiet.quiet_m_s * self.sim.physics.timestep_s).any()
                quiet_by_look[step] = count = 0 if fast else count + every
            if step in self.placed:
                count = 0
        return quiet_by_look

    @cached_property
    def samples(self) -> list[int]:
        """Frames at the beginning of steps with a sample."""
        every = seconds_to_steps(self.sim.sample_interval_s, self.sim.physics.timestep_s)
        return [frame for frame, step in enumerate(self.steps[:-1]) if (step + 1) % every == 0]

    @cached_property
    def poses(self) -> list[tuple[int, int]]:
        """Steps at which poses are looked at, and their frames: of samples, of looks in the drive, at the end of a
        fixed schedule, and the last one."""
        frame_by_step, acts, first = {}, self.trace.driven[0], self.steps[0]
        if acts > 0 and self.sim.waits_for_rest:
            frame_by_step = {
                step: step - first for step in self.steps if step >= acts and not step % self.sim.quiet.poll_steps
            }
        fixed_end = seconds_to_steps((self.outcome.n_boxes + 1) * self.sim.interval_s, self.sim.physics.timestep_s)
        if self.sim.schedule is Schedule.FIXED and acts < 0 and fixed_end in self.steps:
            frame_by_step[fixed_end] = fixed_end - first  # a world that moves there goes on
        frame_by_step |= {self.steps[frame] + 1: frame for frame in self.samples}
        return [*sorted(frame_by_step.items()), (self.steps[-1], len(self.steps) - 1)]

    def excess(self, frame: int) -> FloatArray:
        """(placed,) of the boxes of a frame."""
        scene, limits, k = self.job.scene, self.sim.thresholds, int(self.history.n_placed[frame])
        pos, quat = self.history.pos[frame, :k], self.history.quat[frame, :k]
        dropped = box_motion.has_dropped(pos, quat, scene.half_size[:k], limits)
        shift = box_motion.shift(pos, scene.target[:k], limits.shift_floor_m)
        over: FloatArray = box_motion.excess(shift, box_motion.tilt_deg(quat), dropped, limits)
        return over

    def first_sign(self) -> tuple[int, int]:
        """Step and box of the first sign: (−1, −1) where there is none."""
        begin = self.steps.index(self.trace.driven[0]) - 1 if self.trace.driven[0] > 0 else 0
        if (self.excess(begin) > 1).any():
            begin = 0  # a sign of the placement is forgotten only where nothing is over a threshold
        for step, frame in [pose for pose in self.poses if pose[1] >= begin]:
            over = self.excess(frame)
            if (over > 1).any():
                return step, int(over.argmax())
        return -1, -1

    def tilt_deg(self) -> FloatArray:
        """(n,) the largest in all poses that are looked at."""
        quat = self.history.quat[[frame for _, frame in self.poses]]
        angles = np.array([box_motion.tilt_deg(orientation) for orientation in quat])
        return np.nan_to_num(np.fmax.reduce(angles, axis=0))

    def rest_force_n(self) -> FloatArray:
        """(n,) the mean over the rest window."""
        window = seconds_to_steps(self.sim.rest_window_s, self.sim.physics.timestep_s)
        mean: FloatArray = self.history.top_force_n[-window:].mean(axis=0)
        return mean

    def top_force_n(self) -> FloatArray:
        """(n,) the largest of all steps after the soft start."""
        largest: FloatArray = np.fmax.reduce(self.history.top_force_n[1:], axis=0, initial=0.0)
        return largest
