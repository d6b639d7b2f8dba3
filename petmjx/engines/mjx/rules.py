"""The rules of a run, applied after each step of all worlds: sampling, placing, resting, ending (docs/rules.md).

The rules are pure functions of states. This module does not depend on how a step is computed. The engine ``mujoco`` has
its own implementation of the same rules.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.metrics import BoxSample
from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx import hand, trembling
from petmjx.engines.mjx.padded_template import PARKING_HEIGHT_M, parked_positions
from petmjx.engines.mjx.running_metrics import Sample
from petmjx.engines.mjx.timetable import Timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds
from petmjx.engines.mjx.world_state import State, Status
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Schedule, Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.world.history import CARRIER
from petmjx.world.release_places import NOTHING
from petmjx.world.scene import IDENTITY_QUAT

UNBELIEVABLE = 1e10
"""MuJoCo considers positions and velocities beyond this value bad (mjMAXVAL)."""


def _drive_end(state: State, worlds: Worlds) -> Int[Array, " world"]:
    """The latest step at which the drive of each world (the motion of its carrier in a test) can end. A drive ends
    earlier if the world comes to rest."""
    return state.driven_from + worlds.drive_steps


def excess(
    shift_m: Float[Array, "world box 3"],
    tilt: Float[Array, "world box"],
    dropped: Bool[Array, "world box"],
    thresholds: Thresholds,
) -> Float[Array, "world box"]:
    """Excess of each box: the larger of shift / its threshold and tilt / its threshold.

    A value above 1 is a sign of failure. The excess of a dropped box is at least the smallest float32 above 1.
    """
    worst = jnp.maximum(jnp.abs(shift_m).max(-1) / thresholds.shift_m, tilt / thresholds.tilt_deg)
    just_over = jnp.nextafter(jnp.float32(1), jnp.float32(2))
    return jnp.where(dropped, jnp.maximum(worst, just_over), worst)


@dataclass(frozen=True, eq=False)
class Rules:
    """The rules of a run, and the constants of these rules.

    Attributes:
        capacity: number of boxes for which the arrays of a world have room.
        driven: True if the program shakes settled worlds; False if it places boxes.
        carries: whether boxes of some worlds fall to their places or are carried to them, instead of appearing there.
    """

    sim: Simulation
    timetable: Timetable
    capacity: int
    driven: bool
    carries: bool = False

    def parked_pose(self) -> Float[Array, "box 7"]:
        """Poses to which the rules move boxes that are out of play: boxes that are not placed, or that are in a world
        that has ended."""
        quat = jnp.broadcast_to(jnp.array(IDENTITY_QUAT), (self.capacity, 4))
        return jnp.concatenate([parked_positions(self.capacity), quat], axis=-1)

    def standing(self, state: State) -> Bool[Array, "world box"]:
        """Whether each box is in play, that is, placed and in a running world."""
        return self._placed(state) & state.running[:, None]

    def _placed(self, state: State) -> Bool[Array, "world box"]:
        return jnp.arange(self.capacity)[None] < state.placed[:, None]

    def judged(self, state: State) -> Bool[Array, "world box"]:
        """Whether each box is in play (placed, in a running world), and no hand carries it."""
        standing = self.standing(state)
        if not self.carries:
            return standing
        in_hand = hand.carried_worlds(state)[:, None] & (jnp.arange(self.capacity)[None] == state.placed[:, None] - 1)
        return standing & ~in_hand

    def park(self, state: State) -> State:
        """Move boxes that are not in play to the poses of ``parked_pose``, at rest. The carriers of ended worlds are
        also lifted into the air, since the solver has nothing to solve in a world without contacts."""
        standing, ended = self.standing(state)[..., None], ~state.running[:, None]
        aloft = jnp.array([[0.0, 0.0, PARKING_HEIGHT_M, *IDENTITY_QUAT]])
        return state._replace(
            qpos=jnp.where(standing, state.qpos, self.parked_pose()[None]),
            qvel=jnp.where(standing, state.qvel, 0.0),
            qacc=jnp.where(standing, state.qacc, 0.0),
            carrier_qpos=jnp.where(ended, aloft, state.carrier_qpos),
            carrier_qvel=jnp.where(ended, 0.0, state.carrier_qvel),
            carrier_qacc=jnp.where(ended, 0.0, state.carrier_qacc),
        )

    def place_next(self, state: State, worlds: Worlds, where: Bool[Array, " world"]) -> State:
        """Release the next box of each world for which ``where`` is True. The box is at rest, at its release pose or at
        the start of its fall or path."""
        chosen = ((jnp.arange(self.capacity)[None] == state.placed[:, None]) & where[:, None])[..., None]
        release = worlds.start.at[..., 2].add(self._come_down(state, worlds))
        placed = state._replace(
            qpos=jnp.where(chosen, release, state.qpos),
            still_qpos=jnp.where(chosen, release, state.still_qpos),
            qvel=jnp.where(chosen, 0.0, state.qvel),
            qacc=jnp.where(chosen, 0.0, state.qacc),
            qacc_warmstart=jnp.where(chosen, 0.0, state.qacc_warmstart),
            placed=state.placed + where,
            last_placed_at=jnp.where(where, state.step, state.last_placed_at),
            waits_since=jnp.where(where, state.step, state.waits_since),
            quiet_steps=jnp.where(where, 0, state.quiet_steps),
            tremble_looks=jnp.where(where, 0, state.tremble_looks),
        )
        if not self.carries:
            return placed
        timestep_s = self.sim.physics.timestep_s
        next_state: State = jax.lax.cond(
            where.any(), lambda: hand.take_up(placed, worlds, where, timestep_s), lambda: placed
        )
        return next_state

    def _come_down(self, state: State, worlds: Worlds) -> Float[Array, "world box"]:
        """(world, box) height of each box's support above the support's planned height, m, limited to
        ± ``worlds.most_followed``. The value is 0 for boxes without a support."""
        boxes = motion.middles(state.qpos, worlds.middle)[..., 2] - worlds.target[..., 2]
        carrier = state.carrier_qpos[:, 2] - worlds.carrier_pos[:, 2]
        moved = jnp.take_along_axis(boxes, jnp.maximum(worlds.support, 0), axis=1)
        moved = jnp.where(worlds.support == CARRIER, carrier[:, None], moved)
        most = worlds.most_followed[:, None]
        return jnp.where(worlds.support == NOTHING, 0.0, jnp.clip(moved, -most, most))

    def go_on_placing(self, state: State, worlds: Worlds) -> State:
        """Place the next box of each paused world whose constants describe a further box."""
        goes = (state.status == Status.PAUSED) & (state.placed < worlds.n_boxes)
        state = self.place_next(self.noting_motion(state, goes), worlds, goes)
        return state._replace(status=jnp.where(goes, Status.RUNNING, state.status))

    def go_on_in_kernels(self, state: State, worlds: Worlds) -> State:
        """Let each paused world continue that has boxes left to place (``worlds.n_boxes``). The next box is not placed
        here but by the kernels of mjx-warp, because JAX might compute other last digits of its place."""
        goes = (state.status == Status.PAUSED) & (state.placed < worlds.n_boxes)
        return self.noting_motion(state, goes)._replace(status=jnp.where(goes, Status.PLACES, state.status))

    def noting_motion(self, state: State, goes: Bool[Array, " world"]) -> State:
        """The states, with the flag ``MOVING`` in worlds that continue (``goes``) although they are not at rest."""
        moves = goes & self.moves(state)
        return state._replace(flags=state.flags | jnp.where(moves, int(Flag.MOVING), 0))

    def moves(self, state: State) -> Bool[Array, " world"]:
        """Whether each paused world still moves: its pallet is not quiet, and no box of the world has failed."""
        return ~state.metrics.has_failed(self.sim.thresholds) & (state.quiet_steps < self.sim.quiet.steps)

    def begin_drives(self, state: State, worlds: Worlds) -> State:
        """Begin the drives of worlds whose placement has settled."""
        begins = (state.status == Status.SETTLED) & worlds.driven
        end = _drive_end(state, worlds)
        # signs of failure during the placement (such as a hard landing) are forgotten if no box is beyond a threshold
        # now
        metrics = state.metrics.without_sign(begins & ~self._is_over(state, worlds)).without_rest(begins)
        middles = motion.middles(state.qpos, worlds.middle)
        anchor = jnp.where(begins[:, None, None], middles[..., :2], metrics.sway_anchor)
        return state._replace(
            status=jnp.where(begins, Status.RUNNING, state.status),
            end=jnp.where(begins, end, state.end),
            rest_from=jnp.where(begins, end - self.timetable.rest_steps, state.rest_from),
            still_qpos=jnp.where(begins[:, None, None], state.qpos, state.still_qpos),
            waits_since=jnp.where(begins, state.driven_from + worlds.profile_steps, state.waits_since),
            quiet_steps=jnp.where(begins, 0, state.quiet_steps),
            tremble_looks=jnp.where(begins, 0, state.tremble_looks),
            iterations_done=jnp.where(begins, 0, state.iterations_done),
            metrics=metrics._replace(sway_anchor=anchor),
        )

    def _is_over(self, state: State, worlds: Worlds) -> Bool[Array, " world"]:
        """(world,) whether any box of the world is now beyond the threshold of shift or of tilt, or has dropped."""
        middles, tilt = motion.middles(state.qpos, worlds.middle), motion.tilt_deg(state.qpos[..., 3:])
        over = self._excess(worlds, middles, tilt, state.metrics.drop_step >= 0) > 1
        return (self._placed(state) & over).any(-1)

    def _excess(
        self,
        worlds: Worlds,
        pos: Float[Array, "world box 3"],
        tilt: Float[Array, "world box"],
        dropped: Bool[Array, "world box"],
    ) -> Float[Array, "world box"]:
        """Excess of each box at a place."""
        limits = self.sim.thresholds
        shift = motion.shift(pos, worlds.target, limits.shift_floor_m, worlds.sinks)
        return excess(shift, tilt, dropped, limits)

    def _is_lost(self, state: State, worlds: Worlds) -> Bool[Array, " world"]:
        """(world,) whether any box of the world has dropped, or is now tilted beyond the threshold. In a drive, a
        tilted box counts only if it has also moved sideways as far as the drive allows (``worlds.allowed_sway``)."""
        tilted = motion.tilt_deg(state.qpos[..., 3:]) > self.sim.thresholds.tilt_deg
        if self.driven:
            tilted &= state.metrics.sway(motion.middles(state.qpos, worlds.middle)) >= worlds.allowed_sway[:, None]
        return (self._placed(state) & (tilted | (state.metrics.drop_step >= 0))).any(-1)

    def after_step(
        self,
        state: State,
        worlds: Worlds,
        seen_qpos: Float[Array, "world box 7"],
        qacc: Float[Array, "world box 6"],
        top_force: Float[Array, "world box"],
        presses: Bool[Array, " world"],
    ) -> State:
        """Apply all rules between two steps.

        Args:
            state: poses, velocities and step counters after the step.
            seen_qpos: poses at the beginning of the step, to which the contacts and accelerations of the step belong.
            qacc: linear (m/s²) and angular (rad/s²) accelerations of each box in the step. Angular accelerations are
                in the axes of the box.
            top_force: force on each box's top, N.
            presses: whether the ``top_force`` of each world's boxes is recorded even in a step without a sample.
        """
        before, in_hand = state.running, hand.carried_worlds(state)
        moving = (state.qpos, state.qvel, state.carrier_qpos, state.carrier_qvel)
        values = jnp.concatenate([part.reshape(len(before), -1) for part in moving], -1)
        nonfinite = before & ~(jnp.abs(values) < UNBELIEVABLE).all(-1)
        state = self._sample(state, worlds, seen_qpos, qacc, top_force, presses, nonfinite)
        state = state._replace(
            steps_done=state.steps_done + (before & (state.step > 0)),
            flags=state.flags | jnp.where(nonfinite, int(Flag.NONFINITE), 0),
            status=jnp.where(nonfinite, Status.FINISHED, state.status),
        )
        state = self._end_spent(state, worlds)
        state = self._look_at_the_end(self._proceed(state, worlds), worlds)
        if self.carries:
            state = hand.carry_on(state, worlds, state.running & in_hand, self.sim)
            state = state._replace(placed=state.placed - (before & in_hand & ~state.running))
        still_from = state.end - self.timetable.still_steps
        still_from = jnp.maximum(still_from, state.driven_from if self.driven else 0)
        window_begins = state.running & (state.step == still_from)
        return state._replace(still_qpos=jnp.where(window_begins[:, None, None], state.qpos, state.still_qpos))

    def _sample(
        self,
        state: State,
        worlds: Worlds,
        seen_qpos: Float[Array, "world box 7"],
        qacc: Float[Array, "world box 6"],
        top_force: Float[Array, "world box"],
        presses: Bool[Array, " world"],
        nonfinite: Bool[Array, " world"],
    ) -> State:
        """Measure the boxes, and end the worlds whose fate the measurements decide. The arguments are as in
        ``after_step``."""
        limits, m = self.sim.thresholds, state.metrics
        counted = state.running & (state.step > 0) & ~nonfinite
        sample = counted & (state.step % self.timetable.sample_every == 0)
        last = counted & (state.step >= state.end)
        resting = counted & (state.step > state.rest_from)
        looks = self.driven and self.sim.waits_for_rest
        look = counted & looks & (state.step % self.sim.quiet.poll_steps == 0) & ~sample
        standing = self.judged(state)
        sampled = standing & sample[:, None]
        looked = standing & (sample | look | last)[:, None]
        qpos = jnp.where(sample[:, None, None], seen_qpos, state.qpos)
        pos, quat = motion.middles(qpos, worlds.middle), qpos[..., 3:]
        velocity = state.qvel - self.sim.physics.timestep_s * qacc  # at the beginning of the step
        tilt = motion.tilt_deg(quat)
        dropped = looked & motion.has_dropped(pos, quat, worlds.half, limits)
        over = jnp.where(looked, self._excess(worlds, pos, tilt, dropped), 0.0)
        signs = (m.culprit < 0) & (over.max(-1) > 1)
        culprit = jnp.where(signs, over.argmax(-1).astype(jnp.int32), m.culprit)
        lin = jnp.sqrt((qacc[..., :3] ** 2).sum(-1))
        ang = jnp.sqrt((qacc[..., 3:] ** 2).sum(-1))
        at_corners = motion.corner_acceleration(qacc[..., 3:], worlds.half)
        turns = (ang > limits.ang_acc_rad_s2) & (at_corners > self.sim.physics.gravity_m_s2)
        violent = (sampled & ((lin > limits.lin_acc_m_s2) | turns)).any(-1) & (culprit < 0)
        # Light boxes that land, and tipping boxes that hit something, reach up to 240 rad/s² for a few steps. So a
        # violent sample (accelerations above the thresholds) is an explosion only if the samples before it were
        # violent, too, for the time that a box needs to land. Samples right after a placement are no evidence of an
        # explosion. But if such a sample is not violent, the series of violent samples before it has ended: one box has
        # landed, and another may land later.
        landing = self.sim.quiet.landing_steps
        counts = sample & (state.step - state.last_placed_at >= landing)
        if self.carries:
            counts &= ~hand.carried_worlds(state)
        since = jnp.where(counts & violent, jnp.minimum(state.violent_since, state.step), state.violent_since)
        violent_since = jnp.where(sample & ~violent, NEVER, since)
        exploded = counts & violent & (state.step - since >= landing) & (not self.driven)

        new_sample = Sample(
            step=state.step,
            boxes=BoxSample(pos, quat, velocity, qacc, top_force, worlds.target),
            tilt=tilt,
            dropped=dropped,
            sampled=sampled,
            presses=standing & (sample | (counted & presses))[:, None],
            tilts=standing & (sample | look)[:, None],
            looked=looked,
            rested=standing & resting[:, None],
            rests=resting,
        )
        metrics = m.with_sample(new_sample, worlds, driven=self.driven)._replace(
            culprit=culprit,
            sign_step=jnp.where(signs, state.step, m.sign_step),
            sign_placed=jnp.where(signs & (sample | look), state.placed, m.sign_placed),
        )
        tilted = looked & (tilt > limits.tilt_deg)
        lost = dropped | (tilted & worlds.ends_when_lost[:, None])
        # whether each box is the culprit: the box that crossed a threshold first, at an earlier check
        is_culprit = jnp.arange(self.capacity)[None] == m.culprit[:, None]
        complete = (state.placed == worlds.n_boxes) & (state.step - state.last_placed_at >= worlds.confirm_steps)
        if self.carries:
            complete &= ~hand.carried_worlds(state)
        confirms = (state.step - m.sign_step >= worlds.confirm_steps) & (complete | (state.placed > m.sign_placed + 1))
        lost |= confirms[:, None] & sampled & is_culprit & (over > 1)
        if looks:
            lost |= tilted & is_culprit & (m.sway(pos) >= worlds.allowed_sway[:, None])
        stopped = lost.any(-1) & self.sim.early_stop & ~last
        flags = jnp.where(exploded, int(Flag.EXPLOSION), 0) | jnp.where(stopped, int(Flag.EARLY_STOP), 0)
        return state._replace(
            metrics=metrics,
            violent_since=violent_since,
            flags=state.flags | flags,
            status=jnp.where(stopped | exploded, Status.FINISHED, state.status),
        )

    def _end_spent(self, state: State, worlds: Worlds) -> State:
        """End the worlds that have used up their iterations (``Worlds.most_iterations``), unless they end after this
        step anyway."""
        spent = state.running & (state.iterations_done >= worlds.most_iterations)
        spent &= ~((state.step > 0) & (state.step >= state.end))
        failed = state.metrics.has_failed(self.sim.thresholds)
        flags = jnp.where(failed, int(Flag.EARLY_STOP), int(Flag.ITERATION_LIMIT))
        return state._replace(
            flags=state.flags | jnp.where(spent, flags, 0),
            status=jnp.where(spent, Status.FINISHED, state.status),
        )

    def count_quiet(
        self, state: State, worlds: Worlds, poll: Bool[Array, " world"], adapts: Bool[Array, " world"]
    ) -> tuple[State, Bool[Array, " world"]]:
        """In worlds for which ``poll`` is True, count the steps for which all boxes were quiet. The count starts again
        if a box creeps (moves slowly without slowing down).

        A pallet is quiet if all boxes were quiet for ``quiet.steps`` steps and no box creeps. Trembling boxes count as
        quiet. If a pallet is quiet although a box trembles, the stored count becomes 0. Because of this 0, the world is
        later recognised as still moving. Boxes are examined for trembling only in worlds for which ``adapts`` is True,
        whose waits end as soon as the pallet is quiet.

        Returns:
            The states, and for each world whether its pallet is quiet.
        """
        quiet = self.sim.quiet
        speed = jnp.where(self.standing(state), motion.speed(state.qvel, worlds.half), 0.0)
        if self.sim.waits_for_rest:
            state = trembling.after_look(state, worlds, poll & adapts, speed, self.sim)
        trembles = self.standing(state) & trembling.trembling_mask(state, self.sim)
        speed = jnp.where(trembles, 0.0, speed)
        count = jnp.where((speed < quiet.quiet_m_s).all(-1), state.quiet_steps + quiet.poll_steps, 0)
        enough = poll & (count >= quiet.steps)
        if not self.sim.waits_for_rest:
            return state._replace(quiet_steps=jnp.where(poll, count, state.quiet_steps)), enough

        at_begin = jnp.where((count <= quiet.poll_steps)[:, None], speed, state.quiet_speed)
        creeps = speed >= jnp.maximum(quiet.slow_m_s, quiet.slowing * at_begin)
        faster = speed > jnp.maximum(quiet.still_m_s, at_begin)
        creeps = ((creeps | faster) & ~trembling.stay_mask(state, self.sim)).any(-1)
        anew = enough & creeps & ~state.metrics.has_failed(self.sim.thresholds)
        count = jnp.where(anew, quiet.poll_steps, count)
        at_begin = jnp.where(anew[:, None], speed, at_begin)
        count = jnp.where(enough & ~anew & trembles.any(-1), 0, count)
        counted = state._replace(
            quiet_steps=jnp.where(poll, count, state.quiet_steps),
            quiet_speed=jnp.where(poll[:, None], at_begin, state.quiet_speed),
        )
        return counted, enough & ~anew

    def _proceed(self, state: State, worlds: Worlds) -> State:
        """In each world whose wait is over, place the next box. In a world without a further box, mark the world as
        settled, or begin its rest window (the last steps, in which forces at rest are measured)."""
        quiet, table = self.sim.quiet, self.timetable
        has_more = (state.placed < worlds.n_boxes) & (not self.driven)
        in_drive = self._rests_in_drive(state)
        waits = state.running & (state.step > 0) & (has_more | (state.end == NEVER) | in_drive)
        if self.carries:
            waits &= ~hand.carried_worlds(state)
        poll = waits & (state.step % quiet.poll_steps == 0) & (state.step > state.waits_since)
        adapts = self._adaptive | (state.waits_since > state.last_placed_at)
        state, still = self.count_quiet(state, worlds, poll, adapts)
        failed = state.metrics.has_failed(self.sim.thresholds)
        enough = self.sim.waits_for_rest | (state.step - state.waits_since >= quiet.landing_steps)
        past_deadline = ~in_drive & (state.step >= self._deadline(state, worlds, has_more, adapts))
        go = waits & (past_deadline | (still & adapts & enough))
        # in worlds with ``settles`` set, the drive begins at once, without a check whether the pallet is at rest
        settles = go & ~has_more & worlds.settles & (not self.driven and not self._rests_first)
        rests = go & ~has_more & ~settles
        moves = (settles | (go & has_more)) & ~failed & (state.quiet_steps < quiet.steps)
        rest_from = self.rest_from(state)
        state = state._replace(
            rest_from=jnp.where(rests, rest_from, state.rest_from),
            end=jnp.where(rests, rest_from + table.rest_steps, state.end),
            driven_from=jnp.where(settles, state.step, state.driven_from),
            flags=state.flags | jnp.where(moves, int(Flag.MOVING), 0),
            status=jnp.where(settles, Status.SETTLED, state.status),
        )
        return self.place_next(state, worlds, go & has_more)

    def rest_from(self, state: State) -> Int[Array, " world"]:
        """The step after which the rest window of a quiet world begins. The window begins only after the world's last
        box has landed. In a drive, all boxes have already landed."""
        if self.driven:
            return state.step
        return jnp.maximum(state.step, state.last_placed_at + self.sim.quiet.landing_steps)

    @property
    def _adaptive(self) -> bool:
        return self.sim.schedule is not Schedule.FIXED

    @property
    def _rests_first(self) -> bool:
        """Whether a rest window, with a check at its end, comes before a drive."""
        return self._adaptive and self.sim.waits_for_rest

    def _rests_in_drive(self, state: State) -> Bool[Array, " world"]:
        """(world,) whether the drive may end early if the pallet is quiet. There must be time for two rest windows: the
        window that begins now, and the one before the world's planned end."""
        early = (state.end != NEVER) & (state.step <= state.end - 2 * self.timetable.rest_steps)
        return early & (self.driven and self._rests_first)

    def _deadline(
        self, state: State, worlds: Worlds, more: Bool[Array, " world"], adapts: Bool[Array, " world"]
    ) -> Int[Array, " world"]:
        """The latest step at which the present wait of each world can end.

        If worlds wait for rest, a wait may last ``longest_wait_s`` while no box has failed. When a box has failed, only
        a short wait remains (such as ``interval_s`` before the next box), counted from the first sign of failure. The
        wait before the next box is also short if an earlier wait ended while the world still moved.
        """
        sim, table = self.sim, self.timetable
        hopeful = ~state.metrics.has_failed(sim.thresholds)
        plain_static = ~worlds.settles if sim.check == "static" and not self.driven else jnp.zeros_like(more)
        patient = adapts & ~plain_static & sim.waits_for_rest
        since = jnp.maximum(state.waits_since, jnp.where(patient, state.metrics.sign_step, -1))
        if self.driven:
            return jnp.where(patient & hopeful, self._longest_wait(state, worlds), since + table.due_steps)
        due = jnp.asarray(table.due)[since]
        due = jnp.where(plain_static, table.static_end, due)
        settled = jnp.asarray(table.settled)[since]
        if not self._adaptive:
            settled = jnp.asarray(table.settled_nominally)[worlds.n_boxes]
        due = jnp.where(~more & worlds.settles, settled, due)
        restless = more & ((state.flags & int(Flag.MOVING)) != 0)
        return jnp.where(patient & hopeful & ~restless, self._longest_wait(state, worlds), due)

    def _longest_wait(self, state: State, worlds: Worlds) -> Int[Array, " world"]:
        """The step at which the longest wait (``longest_wait_s``) of each world ends. The wait is counted from the last
        placement or, in a drive, from the end of the drive."""
        if self.driven:
            return _drive_end(state, worlds) + self.timetable.longest_steps
        return jnp.asarray(self.timetable.longest)[state.last_placed_at]

    def _look_at_the_end(self, state: State, worlds: Worlds) -> State:
        """Decide what follows the last step of a world. A world that still moves gets more time if no box is lost, or
        if its drive has ended early and may continue. A world at rest may begin its drive. All other worlds end."""
        sim, table = self.sim, self.timetable
        ends = state.running & (state.step > 0) & (state.step >= state.end)
        moved = motion.moved(state.still_qpos, state.qpos, worlds.half)
        still_from = jnp.maximum(state.end - table.still_steps, state.driven_from if self.driven else 0)
        seconds = (state.step - still_from) * sim.physics.timestep_s
        trembles, stays = trembling.trembling_mask(state, sim), trembling.stay_mask(state, sim, moved)
        most = jnp.where(trembles, sim.quiet.slow_m_s, sim.quiet.still_m_s) * seconds[:, None]
        standing = self.standing(state)
        turns = sim.waits_for_rest & ~trembles & ~stays & (motion.speed(state.qvel, worlds.half) > sim.quiet.still_m_s)
        moves = (standing & (turns | (moved > sim.quiet.still_m_s * seconds[:, None]))).any(-1)
        waits = (standing & (turns | ((moved > most) & ~stays))).any(-1)
        last_end = jnp.full_like(state.end, NEVER)
        if self.driven:
            drive_end = _drive_end(state, worlds)
            last_end = jnp.where(state.step < drive_end, drive_end, NEVER)
        moves, lost = ends & moves, self._is_lost(state, worlds)
        limit = self._longest_wait(state, worlds)
        if sim.check == "static" and not self.driven:
            limit = jnp.where(worlds.settles, limit, table.static_end)
        may_wait = sim.waits_for_rest and sim.total_time_factor is None
        gets_time = moves & waits & ((last_end != NEVER) | ~lost) & (state.step < limit) & may_wait
        settles = ends & ~gets_time & worlds.settles & (not self.driven)
        finished = ends & ~gets_time & ~settles
        last_window = jnp.where(last_end == NEVER, NEVER, last_end - table.rest_steps)
        return state._replace(
            end=jnp.where(gets_time, last_end, state.end),
            rest_from=jnp.where(gets_time, last_window, state.rest_from),
            waits_since=jnp.where(gets_time, state.step, state.waits_since),
            quiet_steps=jnp.where(gets_time, 0, state.quiet_steps),
            driven_from=jnp.where(settles, state.step, state.driven_from),
            flags=state.flags | jnp.where(moves & ~lost & ~gets_time, int(Flag.MOVING), 0),
            status=jnp.where(settles, Status.SETTLED, jnp.where(finished, Status.FINISHED, state.status)),
            metrics=state.metrics.without_rest(gets_time),
        )
