"""Simulates one world on C MuJoCo, from the soft start to the verdict, by the rules of docs/rules.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from petmjx.common.units import seconds_to_steps
from petmjx.engines.metrics import CONFIRM_S, BoxSample
from petmjx.engines.mujoco.drive import ActingDrive
from petmjx.engines.mujoco.explosion import Explosion
from petmjx.engines.mujoco.frame_recorder import WorldRecorder
from petmjx.engines.mujoco.hand import Hand
from petmjx.engines.mujoco.live_world import BodyState, LiveWorld
from petmjx.engines.mujoco.open_models import Templates
from petmjx.engines.mujoco.rest import QuietRule
from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.engines.mujoco.soft_boxes import SoftState, SoftWorld
from petmjx.engines.mujoco.stepper import Stepper
from petmjx.engines.mujoco.timetable import NEVER, Waits
from petmjx.engines.mujoco.world_timeout import Budget
from petmjx.engines.step_clock import Clock
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict, judge
from petmjx.options.simulation import SOFT_START_STEPS, Check, Simulation
from petmjx.world.job import Drive, Job
from petmjx.world.scene import Scene

_FATAL = Flag.NONFINITE | Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW


@dataclass(frozen=True, eq=False)
class SettledState:
    """The state of a world at the end of its placement, from which other worlds (*forks*) start."""

    step: int
    bodies: BodyState | SoftState | None
    metrics: OracleMetrics
    flags: Flag
    ended: Outcome | None
    """The outcome of the world, if it ended before it settled: all forks then have this outcome, too. If the world
    settled, the value is None."""

    def ended_as(self, stream_number: int) -> Outcome | None:
        """The outcome of a fork that needs no simulation. If the world that made this state ended before it settled,
        the fork has the outcome of that world, but with 0 steps. If that world settled, the result is None, and the
        fork must be simulated."""
        if self.ended is None:
            return None
        return replace(self.ended, job=stream_number, flags=self.ended.flags | Flag.FORKED, n_steps=0, state=None)

    def resumed(self, scene: Scene, sim: Simulation, time_s: float) -> LiveWorld | SoftWorld:
        """A world in this state, ready for a drive (motion of the carrier)."""
        assert self.bodies is not None
        if isinstance(self.bodies, SoftState):
            return SoftWorld.resume(scene, sim, self.bodies, time_s)
        return LiveWorld.resume(scene, sim, self.bodies, time_s)


class WorldCancelled(Exception):
    """The run was interrupted, so the world has no outcome."""


class WorldRun:
    """The simulation of one job. Call :meth:`run` once."""

    def __init__(
        self,
        stream_number: int,
        job: Job,
        sim: Simulation,
        cancelled: Callable[[], bool],
        budget: Budget | None = None,
    ) -> None:
        self._stepper = Stepper(sim, budget, job.most_iterations(sim.iteration_limit))
        self._budget = budget
        self._begun, self._stream_number = False, stream_number
        self._job = job
        self._sim = sim
        self._cancelled = cancelled
        self._scene = job.scene
        self._dt = dt = sim.physics.timestep_s
        self._clock = Clock(dt)
        self._sample_steps = max(seconds_to_steps(sim.sample_interval_s, dt), 1)
        self._rest_steps = seconds_to_steps(sim.rest_window_s, dt)
        self._static = sim.check is Check.STATIC
        self._down = np.array([0.0, 0.0, -sim.physics.gravity_m_s2])
        self._step = self._first_step = 0
        self._waits = Waits(sim, self._clock, job.settles)
        self._quiet = QuietRule(sim, job.scene)
        self._explosion = Explosion(sim.quiet.landing_steps)
        self._sign_step = self._n_at_sign = 0
        self._waiting = True
        self._pauses = self.paused = False
        self._still_pose = np.zeros((job.scene.n_boxes, 7))
        self._set_end(NEVER)
        self._drive: ActingDrive | None = None
        self._flags = Flag.NONE
        self._kept: SettledState | None = None
        self._recorder = WorldRecorder(job.record, job, dt) if job.record is not None else None
        self._templates: Templates | None = None

    # ------------------------------------------------------------------ life of a world

    def run(self) -> Outcome:
        """Simulate the world to its end.

        Raises:
            WorldCancelled: the run was interrupted.
        """
        start = self._job.start
        if isinstance(start, SettledState):
            if (end_outcome := start.ended_as(self._stream_number)) is not None:
                return end_outcome
            self._resume(start)
            begun = True
        else:
            begun = self._start()
        return self._outcome(came_to_end=begun and self._loop())

    def _start(self) -> bool:
        """Simulate the soft start. Returns False if the world's time or iterations are used up before the soft start
        ends."""
        kind = LiveWorld if self._scene.soft is None else SoftWorld
        self._live = kind(self._scene, self._sim, self._scene.n_boxes * self._static, templates=self._templates)
        self._metrics = OracleMetrics(self._scene, self._sim.thresholds, self._sim.physics.gravity_m_s2)
        begun = self._soft_start()
        self._set_end(self._waits.end_of_fixed(self._scene.n_boxes))
        self._wait(self._step)
        return begun

    def _soft_start(self) -> bool:
        live = self._live
        live.set_gravity(np.zeros(3))
        begun = self._take_steps(SOFT_START_STEPS) == SOFT_START_STEPS and not self._is_spent()
        for k in range(SOFT_START_STEPS):
            live.set_gravity(self._down * (k / SOFT_START_STEPS))
            begun = begun and self._take_steps(1) == 1 and not self._is_spent()
        live.set_gravity(self._down)
        live.data.time = 0.0
        self._begun = True
        if self._recorder is not None and live.n_placed:
            self._recorder.look(0, live)
        return begun

    def _resume(self, start: SettledState) -> None:
        self._begun = True
        self._step = self._first_step = self._waits.last_placement = start.step
        self._live = start.resumed(self._scene, self._sim, self._clock.time_s(start.step))
        self._metrics = start.metrics.fork()
        self._flags |= start.flags | Flag.FORKED
        if self._recorder is not None:
            self._recorder.begin(self._step, self._live)
        assert self._job.drive is not None
        self._begin_drive(self._job.drive)

    def _loop(self) -> bool:
        """Simulate from one event (placement, start of the drive, rest window) to the next. Returns whether the world
        reached its end or a pause."""
        while self._step < self._end and not self.paused:
            if self._cancelled():
                raise WorldCancelled
            target = self._next_event()
            self._go_to(target)
            if self._step < target:
                return False
            if self._drive is not None:
                self._drive.act(self._step, self._live)
            if not self._observe():
                return False
            if self._recorder is not None and self._recorder.is_due(self._step):
                self._recorder.look(self._step, self._live)
            if self._step < self._end and self._is_spent():
                return False
            self._transition()
            if self._step == self._end:
                self._look_at_the_end()
        return not self._flags & _FATAL

    def _go_to(self, target: int) -> None:
        """Simulate up to the next event, and record the frames that are due before it. The simulation stops earlier if
        the world's time or iterations are used up."""
        recorder = self._recorder
        while recorder is not None and (frame := recorder.next_after(self._step)) < target:
            count = frame - self._step
            self._step += (n_steps := self._take_steps(count))
            if n_steps < count or self._is_spent():
                return
            recorder.look(self._step, self._live)
        self._step += self._take_steps(target - self._step)

    def _take_steps(self, count: int) -> int:
        """Take ``count`` steps. Returns the number of steps taken, which is smaller if the world's time or iterations
        are used up."""
        acts = self._drive is not None and self._drive.acts(self._step)
        n_steps = self._stepper.take(self._live, self._step + 1, count, self._metrics if self._begun else None, acts)
        if n_steps < count and not self._is_spent():
            self._flags |= self._flag_of_end(Flag.TIMEOUT)
        return n_steps

    def _is_spent(self) -> bool:
        """Whether the world has used up its iterations. A world without further iterations gets the flag
        ``ITERATION_LIMIT``, or ``EARLY_STOP`` if a box has failed for good."""
        if self._stepper.is_spent:
            self._flags |= self._flag_of_end(Flag.ITERATION_LIMIT)
        return self._stepper.is_spent

    def _flag_of_end(self, flag: Flag) -> Flag:
        """The flag of a world that must end now: ``flag``, or ``EARLY_STOP`` if a box has failed for good."""
        return Flag.EARLY_STOP if self._begun and self._metrics.has_failed else flag

    # ------------------------------------------------------------------ events

    @property
    def _driving(self) -> bool:
        return self._drive is not None

    def _next_event(self) -> int:
        step, poll = self._step, self._sim.quiet.poll_steps
        if self._live.hand is not None:
            return step + 1
        target = min(self._end, step + self._sample_steps - step % self._sample_steps)
        if self._waiting:
            begin = max(step, self._waits.since)
            target = min(target, max(self._waits.deadline(self._sign), step + 1), begin + poll - begin % poll)
        if self._drive is not None:
            look = step + poll - step % poll if self._sim.waits_for_rest else NEVER
            target = min(target, self._drive.next_change(step), look)
        if step < self._still_from:
            target = min(target, self._still_from)
        window = self._end - self._rest_steps
        return min(target, step + 1 if step >= window else window)

    def _observe(self) -> bool:
        """After a step, take the measurement that is due: a sample of all metrics, the force at rest, or only the
        poses. Returns whether the world continues."""
        step, live = self._step, self._live
        sampled = step % self._sample_steps == 0
        polled = step % self._sim.quiet.poll_steps == 0
        if sampled or polled:
            self._flags |= live.error_flags()
            if self._flags & _FATAL:
                return False
        in_rest = step > self._end - self._rest_steps
        k, looks = live.n_free, self._driving and self._sim.waits_for_rest
        if in_rest:
            self._metrics.add_rest(live.top_forces()[:k])
        if not (sampled or (looks and polled)):
            return True
        pos, quat = live.sampled_pose() if sampled else np.split(live.pose, [3], axis=1)
        time_s, pos, quat = self._clock.time_s(step), pos[:k], quat[:k]
        culprit, too_fast = self._metrics.culprit, False
        if sampled:
            moving = live.sampled_velocity()[:k], live.qacc[:k], live.top_forces()[:k]
            too_fast = self._metrics.add_sample(time_s, BoxSample(pos, quat, *moving, self._scene.target[:k]))
        else:
            self._metrics.add_look(time_s, pos, quat)
        if culprit < 0 <= self._metrics.culprit:
            self._sign_step, self._n_at_sign = step, live.n_placed
        placing_at = step if live.hand is not None else self._waits.last_placement
        if not self._driving and self._explosion.seen(step, placing_at, too_fast):
            self._flags |= Flag.EXPLOSION
            return False
        known = self._metrics.tells_all(self._job, pos, quat, culprit if looks else -1)
        if self._job.confirms and sampled and culprit >= 0 and self._may_confirm():
            known = known or bool(self._metrics.are_over(pos, quat)[culprit])
        if self._sim.early_stop and step < self._end and known:
            self._flags |= Flag.EARLY_STOP
            return False
        return True

    def _may_confirm(self) -> bool:
        """Whether the fall is confirmed if the culprit is still over a threshold: since the first sign of failure,
        enough time has passed and enough boxes have been placed (``CONFIRM_S``)."""
        step, live = self._step, self._live
        steps = seconds_to_steps(CONFIRM_S, self._sim.physics.timestep_s)
        is_complete = live.n_placed == self._job.scene.n_boxes and live.hand is None
        is_complete = is_complete and step - self._waits.last_placement >= steps
        return step - self._sign_step >= steps and (is_complete or live.n_placed > self._n_at_sign + 1)

    def _transition(self) -> None:
        """After a step, place the next box or start the phase after the placement, if either is due."""
        if self._live.hand is not None:
            self._carry_on(self._live.hand)
        elif self._waiting:
            self._wait_or_go_on()
        self._keep_still_pose()

    def _wait_or_go_on(self) -> None:
        quiet = self._look_for_quiet() and self._waits.adapts
        enough = self._sim.waits_for_rest or self._step - self._waits.since >= self._sim.quiet.landing_steps
        if self._waits.in_drive and self._step > self._end - 2 * self._rest_steps:
            # It is too late for an early end of the drive: a rest window that began now would overlap the rest window
            # before the planned end.
            self._waiting = False
        elif (quiet and enough) or self._step >= self._waits.deadline(self._sign):
            self.paused = self._pauses and self._live.n_placed == self._scene.n_boxes
            if not self.paused:
                self._proceed()

    def _proceed(self) -> None:
        """After a wait: place the next box, settle, or start the rest window."""
        live = self._live
        places = live.n_placed < self._scene.n_boxes
        settles = self._job.settles and not self._driving and not self._waits.rests_first
        if (places or settles) and not self._quiet.holds and not self._metrics.has_failed:
            self._flags |= Flag.MOVING
        if places:
            if self._recorder is not None:
                self._recorder.look(self._step, live)
            live.place_next()
            if self._recorder is not None:
                self._recorder.place(live)
            self._has_placed()
        elif settles:
            self._settle()
        else:
            self._waiting = False
            if self._end == NEVER or self._driving:
                landed = 0 if self._driving else self._waits.last_placement + self._sim.quiet.landing_steps
                self._set_end(max(self._step, landed) + self._rest_steps)

    def _carry_on(self, hand: Hand) -> None:
        """After a step with a carried box: carry the box farther, or release it."""
        box = slice(hand.box, hand.box + 1)
        if self._live.carry_on(self._quiet.is_slow(self._live.velocity[box], box)):
            self._flags |= Flag.NOT_PLACED if hand.missed and self._metrics.culprit < 0 else Flag.NONE
            self._has_placed()

    def _has_placed(self) -> None:
        """The last box now stands, falls or is in the hand, so the wait for the next event begins. For a carried box,
        the wait starts again when the hand releases it."""
        self._still_pose[self._live.n_placed - 1] = self._live.pose[self._live.n_placed - 1]
        self._waits.last_placement = self._step
        self._wait(self._step)

    def _wait(self, since: int) -> None:
        """Begin to wait for the next event. The length of the wait is counted from step ``since``."""
        self._waiting = True
        self._quiet.restart()
        all_placed = self._live.n_placed == self._scene.n_boxes
        restless = Flag.MOVING in self._flags and (self._pauses or not all_placed)
        self._waits.begin(since, self._scene.n_boxes, all_placed, restless)

    @property
    def _sign(self) -> int | None:
        """The step at which the first sign of failure was seen, if a box has failed for good; otherwise None."""
        return self._sign_step if self._metrics.has_failed else None

    def _set_end(self, step: int) -> None:
        """Set the last step of the world, and the step after which boxes must not move if the world is to end at
        rest."""
        self._end = step
        self._still_from = max(step - min(self._rest_steps, self._sim.quiet.still_steps), self._step)
        self._keep_still_pose()

    def _keep_still_pose(self) -> None:
        if self._step == self._still_from:
            k = self._live.n_placed
            self._still_pose[:k] = self._live.pose[:k]

    def _look_at_the_end(self) -> None:
        """When the world has reached the last step that is set: decide whether the world goes on.

        If boxes move, the world gets more time, as long as ``Waits.may_go_on`` allows it. If a box is lost (fallen or
        tilted too far), the world gets more time only until the end of its drive. A world that gets no more time
        settles (``_settle``), if it must settle and has not done so; otherwise it ends.
        """
        self._flags |= self._live.error_flags()
        if self._flags & _FATAL:
            return
        k = self._live.n_placed
        pose = self._live.pose[:k]
        if self._step % self._sample_steps:
            self._metrics.add_pose(self._clock.time_s(self._step), pose[:, :3], pose[:, 3:])
        seconds = (self._step - self._still_from) * self._dt
        moves, waits = self._quiet.motion(self._still_pose[:k], pose, self._live.velocity[:k], seconds)
        last_end = self._waits.last_end(self._step)
        lost = self._metrics.is_lost(pose[:, :3], pose[:, 3:], self._job.drive if self._driving else None)
        if waits and (last_end != NEVER or not lost) and self._waits.may_go_on(self._step):
            self._set_end(last_end)
            self._metrics.restart_rest()
            self._wait(self._step)
            return
        if moves and not lost:
            self._flags |= Flag.MOVING
        if self._job.settles and self._waits.rests_first and not self._driving:
            self._settle()

    def _look_for_quiet(self) -> bool:
        """If a check is due, check whether the pallet is quiet. Returns False if no check is due."""
        if self._step % self._sim.quiet.poll_steps or self._step <= self._waits.since:
            return False
        live, k = self._live, self._live.n_placed
        return self._quiet.look(live.pose[:k], live.velocity[:k], self._metrics.has_failed, self._waits.adapts)

    # ------------------------------------------------------------------ drive

    def _settle(self) -> None:
        """The placement has settled: keep the state if requested, start the drive, and set the last step of the
        world."""
        if self._recorder is not None:
            self._recorder.look(self._step, self._live)
        self._waiting = False
        if self._job.keep_state:
            self._kept = SettledState(self._step, self._live.body_state(), self._metrics.fork(), self._flags, None)
        if self._job.drive is not None:
            self._begin_drive(self._job.drive)
        elif self._end != self._step:
            self._set_end(self._step + self._rest_steps)

    def _begin_drive(self, drive: Drive) -> None:
        self._waiting, self._quiet = False, QuietRule(self._sim, self._scene)
        self._stepper.restart_iterations()
        last_sample = self._step + len(drive.excitation.samples)
        rest_steps = seconds_to_steps(drive.rest_s, self._dt)
        self._waits.drive_end = last_sample + rest_steps
        self._set_end(self._waits.drive_end)
        if self._waits.rests_first and rest_steps > 2 * self._rest_steps:
            self._wait(last_sample)
        if self._job.poses is not None:
            self._live.put_at_rest(self._job.poses)
        self._drive = ActingDrive(drive, self._step, self._scene.total_mass, self._down)
        self._metrics.begin_drive(self._live.pose[:, :3], self._live.pose[:, 3:])
        if self._drive.holds_carrier:
            self._live.hold_carrier()
        self._drive.wrap(self._scene, self._dt, self._live)
        self._drive.act(self._step, self._live)

    # ------------------------------------------------------------------ result

    def _outcome(self, came_to_end: bool) -> Outcome:
        scene, live, metrics = self._scene, self._live, self._metrics
        k = live.n_free
        pos, quat = scene.start_pos.copy(), scene.start_quat.copy()
        pos[:k], quat[:k] = live.pose[:k, :3], live.pose[:k, 3:]
        boxes = metrics.finish(pos, quat, k, came_to_end)
        verdict, reason = judge(self._flags, boxes, k, self._sim.thresholds)
        culprit, first_sign_s, n_at_sign = metrics.culprit, metrics.first_sign_s, self._n_at_sign
        if verdict is Verdict.STABLE:
            culprit, first_sign_s, n_at_sign = -1, float("nan"), 0
        elif verdict is Verdict.UNSTABLE and culprit < 0:
            culprit = metrics.worst_box(pos[:k], quat[:k])
        outcome = Outcome(
            job=self._stream_number,
            verdict=verdict,
            reason=reason,
            culprit=culprit,
            first_sign_s=first_sign_s,
            n_boxes=scene.n_boxes,
            n_placed=k,
            sim_time_s=self._clock.time_s(self._step),
            n_steps=self._step - self._first_step,
            flags=self._flags,
            boxes=boxes,
            n_at_sign=n_at_sign,
            solver=self._sim.solver.value,
            message=self._budget.words if self._budget is not None and reason is Reason.TIMEOUT else "",
        )
        if self._recorder is not None:
            self._recorder.look(self._step, live)
            outcome.history = self._recorder.history(
                self._clock.time_s, self._drive.begin if self._drive is not None else None
            )
        if self._job.keep_state:
            end_state = SettledState(self._step, None, metrics, self._flags, replace(outcome))
            outcome.state = self._kept if self._kept is not None else end_state
        return outcome
