"""The rollout of a batch: in each pass, all worlds take a step, and then the rules are applied. A compiled program
makes many passes in one call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from petmjx.engines.metrics import RESTLESS_M_S, RISING_M_S2
from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx import film, hand
from petmjx.engines.mjx.batch_step import Memory, PaddedModel
from petmjx.engines.mjx.face_contacts import Faces
from petmjx.engines.mjx.frame_recorder import Trail
from petmjx.engines.mjx.jax_setup import compiler_options
from petmjx.engines.mjx.landing import Landing
from petmjx.engines.mjx.padded_template import FIRST_BOX_BODY, override_fields
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.engines.mjx.world_state import State, select_rows
from petmjx.options.simulation import SOFT_START_STEPS

CHUNK_PASSES = 25
"""Number of passes in one call of a program. Between two calls, the host checks whether any world still runs."""


@dataclass(frozen=True)
class Program:
    """A compiled ``BatchRollout.chunk``, with the model whose worlds it steps."""

    model: PaddedModel
    chunk: Any


class BatchRollout:
    """Runs chunks of passes of a batch, in placements or in drives (``rules.driven``).

    In a pass, each world takes a step, unless the world has ended or pauses (``PaddedModel``). ``gives``: whether there
    are compliant boxes; ``wraps``: whether film holds boxes in drives.
    """

    def __init__(self, rules: Rules, model: PaddedModel, gives: bool = False, wraps: bool = False) -> None:
        self.rules, self.model, self.gives, self.wraps = rules, model, gives, wraps

    def jitted(self) -> Any:
        """``chunk``, as a function that JAX compiles for the shapes of its arguments."""
        return jax.jit(self.chunk, compiler_options=compiler_options())

    def chunk(
        self,
        state: State,
        memory: Memory,
        worlds: Worlds,
        profiles: Float[Array, "profile step 3"],
    ) -> tuple[State, Memory, Trail]:
        """The states and the solver's memory after a chunk of passes, and the poses and forces in each pass
        (``Trail``). The trail is always kept: the program must be the same with and without a recorder, since another
        program might round differently."""
        held, physics = self.model.held, self.rules.sim.physics
        fields = override_fields(worlds, self.model.model, held=held, physics=physics, gives=self.gives)
        faces = Faces.of(worlds, fields["body_invweight0"][:, 1:, 0]) if self.gives else None
        if self.rules.driven:
            state = self.rules.begin_drives(state, worlds)

        def body(carry: tuple[State, Memory], _: None) -> tuple[tuple[State, Memory], Trail]:
            before, memory = carry
            after, memory, top_force = self._advance(before, memory, worlds, fields, profiles, faces)
            passed = Trail(
                ran=after.step > before.step,
                fresh=(after.last_placed_at == after.step) & (after.placed > before.placed),
                number=after.step,
                placed=after.placed,
                status=after.status,
                pose=after.qpos,
                top_force=top_force,
                carrier_pose=after.carrier_qpos,
            )
            return (after, memory), passed

        # by default, GPUs round the factors of matrix products to 10 bits
        with jax.default_matmul_precision("highest"):
            (state, memory), trail = jax.lax.scan(body, (state, memory), None, length=CHUNK_PASSES)
        return state, memory, trail

    def _advance(
        self,
        state: State,
        memory: Memory,
        worlds: Worlds,
        fields: dict[str, Float[Array, "world ..."]],
        profiles: Float[Array, "profile step 3"],
        faces: Faces | None,
    ) -> tuple[State, Memory, Float[Array, "world box"]]:
        """Take one step in every world that does not pause, and apply the rules. Returns states, the solver's memory,
        and the forces on tops in the step."""
        rules, held, unchanged = self.rules, self.model.held, state
        gravity, push = self._excitation(state, worlds, profiles)
        shown = rules.park(state)
        # Boxes in the air fall freely during the step. If the solver starts from free fall, it has nothing to solve for
        # waiting boxes. If the solver started from zero acceleration, each waiting box would add ½·m·g² to the cost,
        # and float32 would lose the cost of contacts in the sum.
        standing = rules.standing(state)[..., None]
        start = shown.qacc.at[..., :3].set(jnp.where(standing, shown.qacc[..., :3], gravity[:, None]))
        inputs = {
            "qpos": self._join(shown.carrier_qpos, shown.qpos),
            "qvel": self._join(shown.carrier_qvel, shown.qvel),
            "qacc_warmstart": self._join(shown.carrier_qacc, start),
            "xfrc_applied": jnp.zeros((len(push), self.model.bodies, 6)).at[:, self.model.carrier, :3].set(push),
        }
        if rules.carries and not rules.driven:
            inputs["xfrc_applied"] = (
                inputs["xfrc_applied"].at[:, FIRST_BOX_BODY:].set(hand.wrenches(state, worlds, rules.sim))
            )
        if self.wraps and rules.driven:
            forces_n, state = film.hold(state, worlds, rules.sim.physics.timestep_s)
            inputs["xfrc_applied"] = (
                inputs["xfrc_applied"]
                .at[:, FIRST_BOX_BODY:, :3]
                .set(forces_n)
                .at[:, self.model.carrier, :3]
                .add(-forces_n.sum(1))
            )
        if held:
            inputs["mocap_pos"] = state.carrier_qpos[:, None, :3]
            inputs["mocap_quat"] = state.carrier_qpos[:, None, 3:]
        landing = Landing.of(state, worlds) if rules.sim.physics.has_landings else None
        stepped = self.model.step({**fields, "opt.gravity": gravity}, inputs, memory, faces, landing)
        if stepped.landing is not None:
            state = state._replace(landing_left=stepped.landing.left, landing_qvel=stepped.landing.before)
        running = state.running[:, None]

        def moved(
            row: Float[Array, "world coordinate"], carrier: Float[Array, "world k"], boxes: Float[Array, "world box k"]
        ) -> tuple[Float[Array, "world k"], Float[Array, "world box k"]]:
            """The values after a step, for worlds that still run and boxes that are already placed. All other values
            stay the same."""
            new_carrier, new_boxes = self._split(row, carrier)
            return jnp.where(running, new_carrier, carrier), jnp.where(standing, new_boxes, boxes)

        seen_qpos, before = state.qpos, state
        carrier_qpos, qpos = moved(stepped.qpos, state.carrier_qpos, state.qpos)
        carrier_qvel, qvel = moved(stepped.qvel, state.carrier_qvel, state.qvel)
        carrier_qacc, qacc = moved(stepped.qacc_warmstart, state.carrier_qacc, state.qacc)
        _, seen_qacc = self._split(stepped.qacc, state.carrier_qvel)
        state = state._replace(
            qpos=qpos,
            qvel=qvel,
            qacc=qacc,
            qacc_warmstart=qacc,
            carrier_qpos=carrier_qpos,
            carrier_qvel=carrier_qvel,
            carrier_qacc=carrier_qacc,
            carrier_qacc_warmstart=carrier_qacc,
            step=state.step + state.running,
            iterations_done=state.iterations_done + stepped.iterations * state.running,
        )
        presses = self._presses(before, worlds, jnp.maximum(seen_qacc[..., 2].max(-1), carrier_qacc[:, 2]))
        after = rules.after_step(state, worlds, seen_qpos, seen_qacc, stepped.top_force, presses)
        if stepped.pauses is not None:
            after = select_rows(stepped.pauses, unchanged, after)
        return after, stepped.memory, stepped.top_force

    def _presses(self, before: State, worlds: Worlds, rising: Float[Array, " world"]) -> Bool[Array, " world"]:
        """(world,) whether the largest forces on tops include the forces of the step that follows the state ``before``,
        although no sample is due. While a drive acts, the forces of every step are included. Without a drive, two
        conditions must hold: a box is fast; and either a box accelerates upwards by more than ``RISING_M_S2``, or a
        check whether the pallet is quiet is due. ``rising``: the largest upward acceleration, m/s²."""
        rules, step = self.rules, before.step + 1
        if not rules.sim.waits_for_rest:
            return jnp.zeros_like(before.running)
        fast = (rules.standing(before) & (motion.speed(before.qvel, worlds.half) > RESTLESS_M_S)).any(-1)
        polled = step % rules.sim.quiet.poll_steps == 0
        acts = step - before.driven_from <= worlds.profile_steps
        return (fast & (polled | (rising > RISING_M_S2))) | (acts & rules.driven)

    def _excitation(
        self, state: State, worlds: Worlds, profiles: Float[Array, "profile step 3"]
    ) -> tuple[Float[Array, "world 3"], Float[Array, "world 3"]]:
        """Gravity (m/s²), and the force on the carrier (N), for the next step."""
        ramp = jnp.clip((state.step + SOFT_START_STEPS) / SOFT_START_STEPS, 0.0, 1.0)
        gravity = ramp[:, None] * jnp.array([[0.0, 0.0, -self.rules.sim.physics.gravity_m_s2]])
        if not self.rules.driven:
            return gravity, jnp.zeros_like(gravity)
        at = state.step - state.driven_from
        inside = (at >= 0) & (at < profiles.shape[1])
        sample = profiles[worlds.profile, jnp.clip(at, 0, profiles.shape[1] - 1)]
        x, y, z = (jnp.where(inside[:, None], sample, 0.0) * worlds.drive_scale[:, None]).T
        cos, sin = worlds.drive_yaw[:, 0], worlds.drive_yaw[:, 1]
        turned = jnp.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
        return (gravity - turned, jnp.zeros_like(gravity)) if self.model.held else (gravity, turned)

    def _join(
        self, carrier: Float[Array, "world k"], boxes: Float[Array, "world box k"]
    ) -> Float[Array, "world coordinate"]:
        """Generalised coordinates: first those of the carrier (left out if the carrier is held), then those of the
        boxes."""
        flat = boxes.reshape(len(boxes), -1)
        return flat if self.model.held else jnp.concatenate([carrier, flat], axis=-1)

    def _split(
        self, row: Float[Array, "world coordinate"], carrier: Float[Array, "world k"]
    ) -> tuple[Float[Array, "world k"], Float[Array, "world box k"]]:
        """The coordinates of carriers and of boxes (the inverse of ``_join``). A held carrier keeps its coordinates."""
        width = carrier.shape[-1]
        if not self.model.held:
            carrier, row = row[:, :width], row[:, width:]
        return carrier, row.reshape(len(row), self.rules.capacity, width)
