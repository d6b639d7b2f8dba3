"""One stage: a compiled program of fixed shape that takes worlds with a state and hands on worlds with a state.

A stage has lanes; worlds take lanes in turn, as an inference server batches requests. Stepping runs in chunks of
a fixed number of steps without the host; between chunks finished lanes are written back to the table of
worlds and refilled from the queue, all on the device. The host reads one small counter per chunk, one chunk late.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from petmjx.config import SOFT_START_STEPS, Physics
from petmjx.engines.batch.groups import OVERFLOW_BITS
from petmjx.engines.batch.recorder import Trail
from petmjx.engines.batch.rules import Rules
from petmjx.engines.batch.setup import compiler_options
from petmjx.engines.batch.state import State, Status, Worlds, choose_rows, narrow, put_rows, take_rows
from petmjx.engines.batch.template import CARRIER_BODY, PARKING_HEIGHT_M, override_fields


@runtime_checkable
class Stepper(Protocol):
    """What differs between the MJX implementations: stepping, reading contacts, reading overflow."""

    @property
    def model(self) -> Any:
        """The template's MJX model."""
        ...

    def scratch(self) -> Any:
        """Batched MJX data to step in; its contents do not matter between steps."""
        ...

    def step(
        self, overrides: dict[str, Float[Array, "lane ..."]], inputs: dict[str, Float[Array, "lane ..."]], scratch: Any
    ) -> Any:
        """One step of all lanes from ``inputs`` (qpos, qvel, qacc_warmstart, xfrc_applied)."""
        ...

    def top_force(self, overrides: dict[str, Float[Array, "lane ..."]], scratch: Any) -> Float[Array, "lane box"]:
        """Force pressing on each box's top in the last step, N."""
        ...

    def overflow(self, scratch: Any) -> Int[Array, " lane"]:
        """Flag bits of buffers that were too small in the last step, 0 where all fitted."""
        ...

    def usage(self, scratch: Any) -> Int[Array, " 2"]:
        """Contacts of all lanes together, and constraint rows of the fullest lane, in the last step."""
        ...

    def iterations(self, scratch: Any) -> Int[Array, " lane"]:
        """Solver iterations of each lane in the last step."""
        ...


class Lanes(NamedTuple):
    """Everything a stage carries from step to step.

    ``row``: which world a lane runs; past the table's end: none. ``iterations``: solver iterations of the running
    lanes, and of the slowest lane of each step, summed over steps: the device waits for the slowest.
    """

    row: Int[Array, " lane"]
    worlds: Worlds
    state: State
    overrides: dict[str, Float[Array, "lane ..."]]
    usage: Int[Array, " 2"]
    iterations: Float[Array, " 2"]
    scratch: Any


class Queue(NamedTuple):
    """Rows of worlds in the order in which they take lanes; entries past ``length`` are padding."""

    rows: Int[Array, " world"]
    length: Int[Array, ""]
    head: Int[Array, ""]


class Stage:
    """Compiled programs of one shape: ``empty``, ``refill``, ``run_chunk`` and ``unload``.

    Args:
        lanes: worlds stepped side by side.
        chunk_steps: steps of one ``run_chunk``.
        held: the carrier is held fast (acceleration profiles).
    """

    def __init__(
        self, rules: Rules, stepper: Stepper, physics: Physics, lanes: int, chunk_steps: int, *, held: bool
    ) -> None:
        self.rules = rules
        self.stepper = stepper
        self.physics = physics
        self.lanes = lanes
        self.chunk_steps = chunk_steps
        self.held = held
        # Lanes are donated: their buffers are large and are rewritten in place. The table is not: after running
        # out of memory a stage begins again from the table as it was.
        options = compiler_options()
        self._empty_lanes = jax.jit(self._empty, compiler_options=options)
        self.refill = jax.jit(self._refill, donate_argnums=0, compiler_options=options)
        self.run_chunk = jax.jit(self._run_chunk, donate_argnums=0, compiler_options=options)
        self.unload = jax.jit(self._unload, compiler_options=options)

    @property
    def label(self) -> str:
        """What the stage does, for messages."""
        return "drive" if self.rules.driven else "place"

    @property
    def compiled(self) -> dict[str, int]:
        """Program → how often it was compiled: once, for any worlds."""
        programs: dict[str, Any] = {"refill": self.refill, "run_chunk": self.run_chunk, "unload": self.unload}
        return {name: program._cache_size() for name, program in programs.items()}

    def _empty(self, worlds: Worlds, table: State) -> Lanes:
        nowhere = jnp.full(self.lanes, len(table.step), jnp.int32)
        narrow_worlds = take_rows(narrow(worlds, self.rules.capacity), nowhere)
        state = take_rows(narrow(table, self.rules.capacity), nowhere)
        state = state._replace(status=jnp.full(self.lanes, Status.FINISHED, jnp.int32))
        return Lanes(
            row=nowhere,
            worlds=narrow_worlds,
            state=state,
            overrides=self._overrides(narrow_worlds),
            usage=jnp.zeros(2, jnp.int32),
            iterations=jnp.zeros(2),
            scratch=(),
        )

    def empty(self, worlds: Worlds, table: State) -> Lanes:
        """Lanes in which nothing runs yet."""
        lanes: Lanes = self._empty_lanes(worlds, table)
        return lanes._replace(scratch=self.stepper.scratch())

    def _overrides(self, worlds: Worlds) -> dict[str, Float[Array, "lane ..."]]:
        return override_fields(worlds, self.stepper.model, held=self.held, physics=self.physics)

    def _refill(
        self, lanes: Lanes, table: State, worlds: Worlds, queue: Queue
    ) -> tuple[Lanes, State, Queue, Float[Array, " 6"]]:
        """Write back lanes whose world has ended and give them to the next worlds of the queue.

        Returns:
            Lanes, table, queue, and for the host: lanes running, worlds still queued, usage, iterations.
        """
        n_rows = len(table.step)
        free = ~lanes.state.running
        table = self._write_back(lanes, table, free, n_rows)
        position = queue.head + jnp.cumsum(free) - 1
        takes = free & (position < queue.length)
        row = jnp.where(takes, jnp.take(queue.rows, position, mode="clip"), jnp.where(free, n_rows, lanes.row))

        fresh_worlds = take_rows(narrow(worlds, self.rules.capacity), row)
        new_worlds = choose_rows(takes, fresh_worlds, lanes.worlds)
        entered = self.rules.enter(take_rows(narrow(table, self.rules.capacity), row), fresh_worlds)
        state = choose_rows(takes, entered, lanes.state)
        idle = row >= n_rows
        state = state._replace(status=jnp.where(idle, Status.FINISHED, state.status))
        queue = queue._replace(head=queue.head + takes.sum())
        running = jnp.stack([state.running.sum(), queue.length - queue.head])
        counters = jnp.concatenate([running, lanes.usage, lanes.iterations])
        renewed = lanes._replace(row=row, worlds=new_worlds, state=state, overrides=self._overrides(new_worlds))
        return renewed, table, queue, counters

    def _unload(self, lanes: Lanes, table: State) -> State:
        """Write the worlds of all lanes back as they are. Later stages continue those that still run."""
        return self._write_back(lanes, table, jnp.ones_like(lanes.state.running), len(table.step))

    @staticmethod
    def _write_back(lanes: Lanes, table: State, where: Bool[Array, " lane"], n_rows: int) -> State:
        """A world whose buffers overflowed keeps the state it entered with, and is flagged: the stage is repeated."""
        failed = lanes.state.status == Status.OVERFLOWED
        table = put_rows(table, jnp.where(where & ~failed, lanes.row, n_rows), lanes.state)
        row = jnp.where(where & failed, lanes.row, n_rows)
        # what else the void step may have shown does not count
        flags = jnp.take(table.flags, row, mode="clip") | (lanes.state.flags & OVERFLOW_BITS)
        return table._replace(flags=table.flags.at[row].set(flags, mode="drop"))

    def _park_idle(self, state: State) -> State:
        """Put the carriers of idle lanes into the air too: a world without contacts costs almost nothing."""
        idle = ~state.running[:, None]
        aloft = jnp.array([[0.0, 0.0, PARKING_HEIGHT_M, 1.0, 0.0, 0.0, 0.0]])
        return state._replace(
            carrier_pose=jnp.where(idle, aloft, state.carrier_pose),
            carrier_vel=jnp.where(idle, 0.0, state.carrier_vel),
            carrier_warm=jnp.where(idle, 0.0, state.carrier_warm),
        )

    def _run_chunk(self, lanes: Lanes, profiles: Float[Array, "profile step 3"]) -> tuple[Lanes, Trail]:
        """The lanes after a chunk, and what they went through. That is always kept: with and without a recorder it must
        be the same program, since another one might round differently."""

        def body(carry: Lanes, _: None) -> tuple[Lanes, Trail]:
            after, top_force = self._advance(carry, profiles)
            state = after.state
            passed = Trail(
                row=carry.row,
                ran=carry.state.running,
                fresh=(state.last_placed_at == state.step) & (state.placed > carry.state.placed),
                number=state.step,
                placed=state.placed,
                status=state.status,
                pose=state.pose,
                top_force=top_force,
                carrier_pose=state.carrier_pose,
            )
            return after, passed

        return jax.lax.scan(body, lanes, None, length=self.chunk_steps)

    def _excitation(
        self, lanes: Lanes, profiles: Float[Array, "profile step 3"]
    ) -> tuple[Float[Array, "lane 3"], Float[Array, "lane 3"]]:
        """Gravity (m/s²) and the force on the carrier (N) for the step to come."""
        state, worlds = lanes.state, lanes.worlds
        ramp = jnp.clip((state.step + SOFT_START_STEPS) / SOFT_START_STEPS, 0.0, 1.0)
        gravity = ramp[:, None] * jnp.array([[0.0, 0.0, -self.physics.gravity_m_s2]])
        force = jnp.zeros_like(gravity)
        if self.rules.driven:
            at = state.step - state.driven_from
            inside = (at >= 0) & (at < profiles.shape[1])
            sample = profiles[worlds.profile, jnp.clip(at, 0, profiles.shape[1] - 1)]
            sample = jnp.where(inside[:, None], sample, 0.0) * worlds.drive_scale[:, None]
            cos, sin = worlds.drive_yaw[:, 0], worlds.drive_yaw[:, 1]
            x, y, z = sample.T
            turned = jnp.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
            if self.held:
                gravity = gravity - turned
            else:
                force = turned
        active = state.running[:, None]
        return jnp.where(active, gravity, 0.0), jnp.where(active, force, 0.0)

    def _advance(
        self, lanes: Lanes, profiles: Float[Array, "profile step 3"]
    ) -> tuple[Lanes, Float[Array, "lane box"]]:
        """One step of every lane and all that follows from it; and the forces on tops during it."""
        state, rules = lanes.state, self.rules
        n, capacity = self.lanes, rules.capacity
        gravity, force = self._excitation(lanes, profiles)
        bodies = CARRIER_BODY + 1 + capacity
        shown = self._park_idle(rules.park(state))
        # Boxes in the air fall freely during the step. With that as its start, the solver has nothing to find for
        # them. From zero, each would add ½·m·g² to the cost, and float32 would lose the contacts in that sum.
        waiting = ~rules.standing(state)[..., None]
        warm = shown.warm.at[..., :3].set(jnp.where(waiting, gravity[:, None], shown.warm[..., :3]))
        inputs = {
            "qpos": self._join(shown.carrier_pose, shown.pose),
            "qvel": self._join(shown.carrier_vel, shown.vel),
            "qacc_warmstart": self._join(shown.carrier_warm, warm),
            "xfrc_applied": jnp.zeros((n, bodies, 6)).at[:, CARRIER_BODY, :3].set(force),
        }
        if self.held:
            inputs["mocap_pos"] = state.carrier_pose[:, None, :3]
            inputs["mocap_quat"] = state.carrier_pose[:, None, 3:]
        overrides = {**lanes.overrides, "opt.gravity": gravity}
        seen_pose = state.pose
        scratch = self.stepper.step(overrides, inputs, lanes.scratch)
        running, standing = state.running[:, None], ~waiting

        def moved(
            row: Float[Array, "lane coordinate"], carrier: Float[Array, "lane k"], boxes: Float[Array, "lane box k"]
        ) -> tuple[Float[Array, "lane k"], Float[Array, "lane box k"]]:
            """What a step changed, for lanes that run and boxes in play; all else stays as it was."""
            new_carrier, new_boxes = self._split(row, carrier)
            return jnp.where(running, new_carrier, carrier), jnp.where(standing, new_boxes, boxes)

        carrier_pose, pose = moved(scratch.qpos, state.carrier_pose, state.pose)
        carrier_vel, vel = moved(scratch.qvel, state.carrier_vel, state.vel)
        carrier_warm, warm = moved(scratch.qacc_warmstart, state.carrier_warm, state.warm)
        _, acceleration = self._split(scratch.qacc, state.carrier_vel)
        state = state._replace(
            pose=pose,
            vel=vel,
            warm=warm,
            ahead=warm,
            carrier_pose=carrier_pose,
            carrier_vel=carrier_vel,
            carrier_warm=carrier_warm,
            carrier_ahead=carrier_warm,
            step=state.step + state.running,
        )
        # Read in every step, though few count: a condition would make the host wait for the device in each step.
        top_force = self.stepper.top_force(overrides, scratch)
        overflow = self.stepper.overflow(scratch)
        state = rules.after_step(state, lanes.worlds, seen_pose, acceleration, top_force, overflow)
        usage = jnp.maximum(lanes.usage, self.stepper.usage(scratch))
        spent = jnp.where(lanes.state.running, self.stepper.iterations(scratch), 0)
        iterations = lanes.iterations + jnp.stack([spent.sum(), spent.max()])
        return lanes._replace(state=state, scratch=scratch, usage=usage, iterations=iterations), top_force

    def _join(
        self, carrier: Float[Array, "lane k"], boxes: Float[Array, "lane box k"]
    ) -> Float[Array, "lane coordinate"]:
        """One row of generalized coordinates for each lane: the carrier's, unless it is held, then the boxes'."""
        flat = boxes.reshape(len(boxes), -1)
        return flat if self.held else jnp.concatenate([carrier, flat], axis=-1)

    def _split(
        self, row: Float[Array, "lane coordinate"], carrier: Float[Array, "lane k"]
    ) -> tuple[Float[Array, "lane k"], Float[Array, "lane box k"]]:
        """The reverse of ``_join``; a held carrier keeps what it has."""
        width = carrier.shape[-1]
        if not self.held:
            carrier, row = row[:, :width], row[:, width:]
        return carrier, row.reshape(len(row), self.rules.capacity, width)
