"""The rules of a run, one step of all lanes at a time: sampling, placing, resting, ending (docs/rules.md).

Pure functions of states; nothing here knows how a step is taken. The C engine follows the same rules in its own
words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from petmjx.config import Schedule, Simulation
from petmjx.engines.batch.state import NEVER, Metrics, State, Status, Worlds
from petmjx.engines.batch.template import parked_positions
from petmjx.engines.batch.timetable import Timetable
from petmjx.metrics import motion_jax as motion
from petmjx.verdict import Flag
from petmjx.world.scene import IDENTITY_QUAT

UNBELIEVABLE = 1e10
"""MuJoCo calls positions and velocities beyond this bad (mjMAXVAL)."""


class _Seen(NamedTuple):
    """What samples see: values at the beginning of a step. Shapes and units as in ``Rules.after_step``."""

    pose: Float[Array, "lane box 7"]
    acceleration: Float[Array, "lane box 6"]
    top_force: Float[Array, "lane box"]


@dataclass(frozen=True, eq=False)
class Rules:
    """The rules with their numbers. ``driven``: this stage shakes settled worlds instead of placing boxes."""

    sim: Simulation
    timetable: Timetable
    capacity: int
    driven: bool

    def parked_pose(self) -> Float[Array, "box 7"]:
        """Poses of boxes that are not in play."""
        quat = jnp.broadcast_to(jnp.array(IDENTITY_QUAT), (self.capacity, 4))
        return jnp.concatenate([parked_positions(self.capacity), quat], axis=-1)

    def standing(self, state: State) -> Bool[Array, "lane box"]:
        """Boxes in play: placed, in a world that runs."""
        placed = jnp.arange(self.capacity)[None] < state.placed[:, None]
        return placed & state.running[:, None]

    def park(self, state: State) -> State:
        """Put boxes that are not in play to the places where they wait, at rest."""
        standing = self.standing(state)[..., None]
        return state._replace(
            pose=jnp.where(standing, state.pose, self.parked_pose()[None]),
            vel=jnp.where(standing, state.vel, 0.0),
            warm=jnp.where(standing, state.warm, 0.0),
        )

    def place_next(self, state: State, worlds: Worlds, where: Bool[Array, " lane"]) -> State:
        """Release the next box: at its release pose, at rest."""
        chosen = ((jnp.arange(self.capacity)[None] == state.placed[:, None]) & where[:, None])[..., None]
        return state._replace(
            pose=jnp.where(chosen, worlds.start, state.pose),
            vel=jnp.where(chosen, 0.0, state.vel),
            warm=jnp.where(chosen, 0.0, state.warm),
            ahead=jnp.where(chosen, 0.0, state.ahead),
            placed=state.placed + where,
            last_placed_at=jnp.where(where, state.step, state.last_placed_at),
            quiet_steps=jnp.where(where, 0, state.quiet_steps),
        )

    def enter(self, state: State, worlds: Worlds) -> State:
        """Take up worlds that an earlier stage handed on."""
        if self.driven:
            begins = state.status == Status.SETTLED
            end = state.driven_from + worlds.drive_steps
            metrics = self._forget_transients(state, worlds, begins)
            anchor = jnp.where(begins[:, None, None], state.pose[..., :2], metrics.sway_anchor)
            return state._replace(
                status=jnp.where(begins, Status.RUNNING, state.status),
                end=jnp.where(begins, end, state.end),
                rest_from=jnp.where(begins, end - self.timetable.rest_steps, state.rest_from),
                metrics=metrics._replace(sway_anchor=anchor),
            )
        waited = (state.status == Status.READY) & (state.placed < self.capacity)
        return self.place_next(state._replace(status=jnp.where(waited, Status.RUNNING, state.status)), worlds, waited)

    def _forget_transients(self, state: State, worlds: Worlds, begins: Bool[Array, " lane"]) -> Metrics:
        """Forget signs from the placement (a hard landing) in worlds in which no box is over a threshold now."""
        m, limits = state.metrics, self.sim.thresholds
        pos, quat = state.pose[..., :3], state.pose[..., 3:]
        shift = motion.shift(pos, worlds.target, limits.shift_floor_m)
        excess = motion.excess(shift, motion.tilt_deg(quat), m.drop_step >= 0, limits)
        placed = jnp.arange(self.capacity)[None] < state.placed[:, None]
        clean = begins & ~(placed & (excess > 1)).any(-1)
        return m._replace(
            culprit=jnp.where(clean, -1, m.culprit),
            sign_step=jnp.where(clean, -1, m.sign_step),
        )

    def after_step(
        self,
        state: State,
        worlds: Worlds,
        seen_pose: Float[Array, "lane box 7"],
        acceleration: Float[Array, "lane box 6"],
        top_force: Float[Array, "lane box"],
        overflow: Int[Array, " lane"],
    ) -> State:
        """Everything that happens between two steps.

        Args:
            state: poses, velocities and step counters as the step left them.
            seen_pose: poses at the beginning of the step, to which contacts and accelerations belong.
            acceleration: linear (m/s²) and angular (rad/s²) of each box in that step.
            top_force: N.
            overflow: non-zero where a buffer was too small for the step to be right.
        """
        before = state.running
        moving = (state.pose, state.vel, state.carrier_pose, state.carrier_vel)
        values = jnp.concatenate([part.reshape(len(before), -1) for part in moving], -1)
        nonfinite = before & ~(jnp.abs(values) < UNBELIEVABLE).all(-1)
        state = self._sample(state, worlds, _Seen(seen_pose, acceleration, top_force), nonfinite)
        overflowed = before & (overflow != 0)
        state = state._replace(
            steps_done=state.steps_done + (before & (state.step > 0)),
            flags=state.flags | jnp.where(nonfinite, int(Flag.NONFINITE), 0) | jnp.where(overflowed, overflow, 0),
            status=jnp.where(nonfinite, Status.FINISHED, state.status),
        )
        state = state._replace(status=jnp.where(overflowed, Status.OVERFLOWED, state.status))
        return state if self.driven else self._proceed(state, worlds)

    def _sample(self, state: State, worlds: Worlds, seen: _Seen, nonfinite: Bool[Array, " lane"]) -> State:
        limits, m = self.sim.thresholds, state.metrics
        counted = state.running & (state.step > 0) & ~nonfinite
        sample = counted & (state.step % self.timetable.sample_every == 0)
        last = counted & (state.step >= state.end)
        resting = counted & (state.step > state.rest_from)
        standing = self.standing(state)
        sampled = standing & sample[:, None]
        looked = standing & (sample | last)[:, None]

        pose = jnp.where(sample[:, None, None], seen.pose, state.pose)
        pos, quat = pose[..., :3], pose[..., 3:]
        tilt = motion.tilt_deg(quat)
        dropped = looked & motion.has_dropped(pos, quat, worlds.half, limits)
        excess = motion.excess(motion.shift(pos, worlds.target, limits.shift_floor_m), tilt, dropped, limits)
        excess = jnp.where(looked, excess, 0.0)
        signs = (m.culprit < 0) & (excess.max(-1) > 1)
        culprit = jnp.where(signs, excess.argmax(-1).astype(jnp.int32), m.culprit)
        lin = jnp.sqrt((seen.acceleration[..., :3] ** 2).sum(-1))
        ang = jnp.sqrt((seen.acceleration[..., 3:] ** 2).sum(-1))
        violent = (sampled & ((lin > limits.lin_acc_m_s2) | (ang > limits.ang_acc_rad_s2))).any(-1) & (culprit < 0)
        # Light boxes land, and tipping ones hit, with up to 240 rad/s² for a few steps. So samples right after a
        # placement do not count, and a violent one is an explosion only if those that follow say the same.
        landing = self.sim.quiet.min_steps
        counts = sample & (state.step - state.last_placed_at >= landing)
        since = jnp.where(violent, jnp.minimum(state.violent_since, state.step), NEVER)
        violent_since = jnp.where(counts, since, state.violent_since)
        exploded = counts & violent & (state.step - since >= landing) & (not self.driven)

        def keep_max(old: Array, new: Array, where: Array) -> Array:
            return jnp.where(where, jnp.maximum(old, new), old)

        max_sway = m.max_sway
        if self.driven:
            sway = jnp.sqrt(((pos[..., :2] - m.sway_anchor) ** 2).sum(-1))
            max_sway = keep_max(max_sway, sway, looked)
        metrics = Metrics(
            max_tilt=keep_max(m.max_tilt, tilt, sampled),
            max_lin_acc=keep_max(m.max_lin_acc, lin, sampled),
            max_ang_acc=keep_max(m.max_ang_acc, ang, sampled),
            max_top_force=keep_max(m.max_top_force, seen.top_force, sampled),
            rest_force_sum=m.rest_force_sum + jnp.where(standing & resting[:, None], seen.top_force, 0.0),
            rest_samples=m.rest_samples + resting,
            drop_step=jnp.where(dropped & (m.drop_step < 0), state.step[:, None], m.drop_step),
            max_sway=max_sway,
            sway_anchor=m.sway_anchor,
            culprit=culprit,
            sign_step=jnp.where(signs, state.step, m.sign_step),
        )
        stopped = dropped.any(-1) & self.sim.early_stop & ~last
        flags = jnp.where(exploded, int(Flag.EXPLOSION), 0) | jnp.where(stopped, int(Flag.EARLY_STOP), 0)
        return state._replace(
            metrics=metrics,
            violent_since=violent_since,
            flags=state.flags | flags,
            status=jnp.where(last | stopped | exploded, Status.FINISHED, state.status),
        )

    def count_quiet(self, state: State, poll: Bool[Array, " lane"]) -> tuple[State, Bool[Array, " lane"]]:
        """In lanes with ``poll``, count the steps for which all boxes were slow. If one creeps, start again.

        A pallet is quiet, which is the second answer, from ``quiet.steps`` on, if none creeps.
        """
        quiet = self.sim.quiet
        pace = jnp.where(self.standing(state), motion.pace_squared(state.vel, quiet), 0.0)
        count = jnp.where((pace < 1).all(-1), state.quiet_steps + quiet.poll_steps, 0)
        enough = poll & (count >= quiet.steps)
        if not self.sim.waits_for_creep:
            return state._replace(quiet_steps=jnp.where(poll, count, state.quiet_steps)), enough

        at_begin = jnp.where((count <= quiet.poll_steps)[:, None], pace, state.quiet_pace)
        slowed = pace < jnp.maximum(quiet.rest_share**2, quiet.slowing**2 * at_begin)
        anew = enough & ~slowed.all(-1) & (state.metrics.culprit < 0)
        count = jnp.where(anew, quiet.poll_steps, count)
        at_begin = jnp.where(anew[:, None], pace, at_begin)
        counted = state._replace(
            quiet_steps=jnp.where(poll, count, state.quiet_steps),
            quiet_pace=jnp.where(poll[:, None], at_begin, state.quiet_pace),
        )
        return counted, enough & ~anew

    def _proceed(self, state: State, worlds: Worlds) -> State:
        """Place the next box, hand the world on, or let it come to rest."""
        quiet, table = self.sim.quiet, self.timetable
        counted = state.running & (state.step > 0)
        poll = counted & (state.step % quiet.poll_steps == 0)
        still = jnp.zeros_like(poll)
        if self.sim.schedule is not Schedule.FIXED:
            state, still = self.count_quiet(state, poll)
        more = state.placed < worlds.n_boxes
        due = state.step >= jnp.asarray(table.due)[state.last_placed_at]
        if self.sim.schedule is Schedule.FIXED:
            settled = state.step >= jnp.asarray(table.settled_nominally)[worlds.n_boxes]
        else:
            settled = state.step >= jnp.asarray(table.settled)[state.last_placed_at]
        if self.sim.check == "static":
            due = state.step >= table.static_end
        due = jnp.where(~more & worlds.settles, settled, due)
        due = due | (still & (state.step - state.last_placed_at >= quiet.min_steps))
        go = counted & due
        full = state.placed >= self.capacity
        rests = go & ~more & ~worlds.settles & (state.end == NEVER)
        settles = go & ~more & worlds.settles
        state = state._replace(
            rest_from=jnp.where(rests, state.step, state.rest_from),
            end=jnp.where(rests, state.step + table.rest_steps, state.end),
            driven_from=jnp.where(settles, state.step, state.driven_from),
            status=jnp.where(go & more & full, Status.READY, jnp.where(settles, Status.SETTLED, state.status)),
        )
        return self.place_next(state, worlds, go & more & ~full)
