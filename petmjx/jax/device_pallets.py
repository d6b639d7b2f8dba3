"""Pallets for jitted programs, simulated by the engine ``mjx-warp``. The state of the pallets, a pytree
(``DeviceState``), has the simulated worlds on the device; the kernel runs inside the jitted program."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from petmjx.common.errors import InputError
from petmjx.common.units import MICROMETRES_PER_M, MM_PER_M
from petmjx.engines.metrics import BoxMetrics, judged_samples
from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx.world_state import Status, take_rows
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import INVALID_FLAGS, Reason, failures
from petmjx.engines.warp.next_boxes import NewBox
from petmjx.engines.warp.open_world_functions import OpenState, Simulator
from petmjx.engines.warp.open_worlds import WarpWorlds
from petmjx.jax.placement_arrays import ENDED, REASONS, PlacementArrays
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import largest_excess
from petmjx.world.bearings import TOUCH_M
from petmjx.world.contact_laws import CONTACTS_PER_FACE, DEPTHS_M, cone_factor, pulls_m_s2
from petmjx.world.growing_scenes import EmptyCarrier
from petmjx.world.history import CARRIER
from petmjx.world.release_places import NOTHING
from petmjx.world.scene import IDENTITY_QUAT

ROOM: Final = 2
"""Factor by which the simulator's buffers are larger than its default buffers, because a jitted program cannot enlarge
them. If a pallet needs even larger buffers, its result is invalid."""


_EPSILON: Final = float(np.finfo(np.float32).eps)


class Device:
    """The constant part of a state: the options, the simulator with its kernel, and the numbers of boards and boxes for
    which the simulator has room."""

    def __init__(self, sim: Simulation, simulator: Simulator, boards: int, width: int) -> None:
        self.sim, self.simulator, self.boards, self.width = sim, simulator, boards, width
        self.still = jnp.zeros((1, 1, 3))
        blank, physics = EmptyCarrier(sim), sim.physics
        self.friction, self.surface = jnp.asarray(blank.friction, jnp.float32), blank.surface
        box_friction, carrier = float(blank.friction[0]), float(blank.scene.carrier.friction[:, 0].max())
        self._soft = (
            float(cone_factor(physics, box_friction, box_friction)),
            float(cone_factor(physics, box_friction, carrier)),
        )
        self._pulls = jnp.asarray(pulls_m_s2(physics.solref, physics.solimp, physics.timestep_s), jnp.float32)

    def new_box(self, open_: OpenState, size_mm: jax.Array, corner_mm: jax.Array, mass: jax.Array) -> NewBox:
        """The same as ``petmjx.engines.warp.next_boxes.new_box``, as a JAX function in single precision."""
        sim, worlds = self.sim, open_.worlds
        m = len(mass)
        falls = float(sim.physics.falls_into_place)
        size = size_mm - sim.size_reduction_mm * jnp.array([1.0, 1.0, falls])
        half, target = (_rounded(values / MM_PER_M) for values in (size / 2, corner_mm + size / 2))
        support, z = self._released(worlds, half, target, mass) if not falls else (jnp.full(m, NOTHING), target[:, 2])
        start = jnp.concatenate([target[:, :2], z[:, None], jnp.tile(jnp.array(IDENTITY_QUAT), (m, 1))], axis=1)
        return NewBox(
            half=half,
            target=target,
            start=start,
            support=support.astype(jnp.int32),
            mass=mass,
            friction=jnp.tile(self.friction, (m, 1)),
            surface=jnp.full(m, self.surface, jnp.int32),
        )

    def _released(
        self, worlds: Any, half: jax.Array, target: jax.Array, mass: jax.Array
    ) -> tuple[Int[Array, " world"], Float[Array, " world"]]:
        """Two values for each new box: the body on which the box lies, and the height of the box's centre at the moment
        of its release, m (petmjx/world/release_places.py)."""
        physics = self.sim.physics
        present = jnp.arange(self.width) < worlds.n_boxes[:, None]
        low, high = target - half, target + half
        ends = jnp.minimum(worlds.target + worlds.half, high[:, None])
        side = jnp.maximum(ends - jnp.maximum(worlds.target - worlds.half, low[:, None]), 0.0)
        top = worlds.target[:, :, 2] + worlds.half[:, :, 2]
        area = side[..., 0] * side[..., 1] * (jnp.abs(top - low[:, None, 2]) <= TOUCH_M) * present
        bearer = jnp.where(area.any(axis=1), area.argmax(axis=1), NOTHING)
        support = jnp.where(low[:, 2] <= TOUCH_M, CARRIER, bearer)
        below = jnp.take_along_axis(worlds.mass, jnp.maximum(support + 1, 0)[:, None], axis=1)[:, 0]
        soft = jnp.where(support == CARRIER, self._soft[1], self._soft[0])
        pull = soft * (1.0 + mass / below) * physics.gravity_m_s2 / CONTACTS_PER_FACE
        depth = jnp.interp(pull, self._pulls, jnp.asarray(DEPTHS_M, jnp.float32), left=0.0)
        return support, target[:, 2] - jnp.where(support != NOTHING, depth, 0.0)

    def placed(self, open_: OpenState, box: NewBox, gets: jax.Array) -> OpenState:
        """The state of the worlds after one more box has been placed in each world for which ``gets`` is true, and all
        these worlds have come to rest. Worlds for which ``gets`` is false do not change.

        Under ``jax.vmap``, the worlds of all states in the batch are simulated side by side.
        """

        @jax.custom_batching.custom_vmap
        def placed(open_: OpenState, box: NewBox, gets: jax.Array) -> OpenState:
            n = len(gets)
            rows = jnp.where(gets, jnp.arange(n), n)
            return self.simulator.go_on(self.simulator.put_next(open_, rows, box), self.still)

        @placed.def_vmap
        def of_all(count: int, batched: Any, *arguments: Any) -> tuple[OpenState, Any]:
            def flat(values: jax.Array, is_batched: bool) -> jax.Array:
                batch = values if is_batched else jnp.broadcast_to(values, (count, *values.shape))
                return batch.reshape(-1, *batch.shape[2:])

            worlds = placed(*jax.tree.map(flat, arguments, tuple(batched)))
            worlds = jax.tree.map(lambda values: values.reshape(count, -1, *values.shape[1:]), worlds)
            return worlds, jax.tree.map(lambda _: True, worlds)

        after: OpenState = placed(open_, box, gets)
        return after

    def results(self, open_: OpenState, known: jax.Array) -> PlacementArrays:
        """The results of the last placement in each world. ``known`` tells for which worlds a box was placed. In the
        results of all other worlds, the reason is ``ended``, and numbers are 0 or -1.

        ``PlacementResults.of_snapshots`` (petmjx/loop/placement_results.py) and petmjx/engines/margin.py compute the
        same in NumPy.
        """
        state, worlds, limits = open_.state, open_.worlds, self.sim.thresholds
        here = jnp.arange(self.width) < state.placed[:, None]
        middle, quat = motion.middles(state.qpos, worlds.middle), state.qpos[..., 3:]
        shift = jnp.where(here[..., None], motion.shift(middle, worlds.target, limits.shift_floor_m), 0.0)
        tilt = jnp.where(here, jnp.fmax(state.metrics.max_tilt, motion.tilt_deg(quat)), 0.0)
        dropped = here & ((state.metrics.drop_step >= 0) | motion.has_dropped(middle, quat, worlds.half, limits))
        full = state.status == Status.OVERFLOWED
        reason = jnp.zeros(len(full), jnp.int32)
        top_force = jnp.fmax(state.metrics.max_top_force, state.top_force)
        # the types of ``BoxMetrics`` are NumPy's; here, the arrays are JAX's
        measured: Any = {"shift_m": shift, "max_tilt_deg": tilt, "dropped": dropped, "max_top_force_n": top_force}
        measured |= {name: getattr(state.metrics, name) for name in judged_samples()}
        boxes = BoxMetrics.measured(*here.shape, **measured)
        over = largest_excess(boxes, limits)
        failed = (
            *((why, (here & failing).any(axis=1)) for why, failing in reversed(list(failures(boxes, limits)))),
            *((why, (state.flags & int(bits)) != 0) for bits, why in reversed(INVALID_FLAGS)),
            (Reason.OVERFLOW, full),
        )
        for why, is_so in failed:  # the last condition that is true decides
            reason = jnp.where(is_so, REASONS.index(str(why)), reason)
        invalid = full | jnp.any(jnp.array([(state.flags & int(bits)) != 0 for bits, _ in INVALID_FLAGS]), axis=0)
        stable = reason == 0
        worst = jnp.where(
            state.metrics.culprit >= 0, state.metrics.culprit, jnp.where(invalid, -1, over.argmax(axis=1))
        )
        margin = 1.0 - over.max(axis=1)
        margin = jnp.where(stable, jnp.maximum(margin, 0.0), jnp.minimum(margin, -_EPSILON))
        return PlacementArrays(
            stable=stable & known,
            reason=jnp.where(known, reason, REASONS.index(ENDED)),
            culprit=jnp.where(stable | ~known, -1, worst).astype(jnp.int32),
            margin=jnp.where(known & ~invalid, margin, -1.0),
            shift_mm=jnp.where(known, jnp.abs(shift).max(axis=(1, 2)) * MM_PER_M, 0.0),
            tilt_deg=jnp.where(known, tilt.max(axis=1), 0.0),
            n_boxes=jnp.where(known, state.placed, 0),
            ended=~known | full | (state.status == Status.FINISHED),
            top_force_n=jnp.where(here & known[:, None], state.top_force, 0.0),
            middle_mm=jnp.where(here[..., None] & known[:, None, None], middle * MM_PER_M, 0.0),
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DeviceState:
    """The state of n pallets: simulated worlds on the device."""

    open: OpenState
    device: Device = field(metadata={"static": True})
    most_boxes: int = field(metadata={"static": True})

    @property
    def n(self) -> int:
        """Number of pallets."""
        return int(self.open.worlds.n_boxes.shape[0])

    def place(
        self, size: jax.Array, corner: jax.Array, mass: jax.Array, gets: jax.Array
    ) -> tuple[DeviceState, PlacementArrays]:
        """See ``petmjx.jax.place``."""
        gets = gets & self._can(self.open)
        after = self.device.placed(self.open, self.device.new_box(self.open, size, corner, mass), gets)
        return replace(self, open=after), self.device.results(after, gets | (after.state.status == Status.PAUSED))

    def try_all(self, size: jax.Array, corner: jax.Array, mass: jax.Array, pallet: jax.Array) -> PlacementArrays:
        """See ``petmjx.jax.try_all``."""
        valid = (pallet >= 0) & (pallet < self.n)
        rows = jnp.clip(pallet, 0, self.n - 1)
        forks = OpenState(take_rows(self.open.worlds, rows), take_rows(self.open.state, rows))
        gets = valid & self._can(forks)
        after = self.device.placed(forks, self.device.new_box(forks, size, corner, mass), gets)
        return self.device.results(after, gets)

    def _can(self, open_: OpenState) -> jax.Array:
        """(n,) whether each pallet may receive another box."""
        return (open_.state.status == Status.PAUSED) & (open_.worlds.n_boxes < self.most_boxes)


def empty_device(n: int, sim: Simulation, engine: Engine, most_boxes: int) -> DeviceState:
    """The state of n empty pallets.

    Raises:
        InputError: the option ``placing`` moves boxes to their places, instead of letting them appear there.
    """
    blank = EmptyCarrier(sim)
    if not blank.scene.placing.appears:
        raise InputError("placing must be 'exact': in petmjx.jax on mjx-warp, boxes appear at their places")
    one = engine.open([blank.scene], sim, most_boxes)
    assert isinstance(one, WarpWorlds)
    one.go_on()
    simulator = one.roomier(ROOM)
    simulator.load()
    device = Device(sim, simulator, one.boards, one.width)
    rows = jnp.zeros(n, jnp.int32)
    worlds = OpenState(take_rows(one.open.worlds, rows), take_rows(one.open.state, rows))
    return DeviceState(worlds, device, most_boxes)


def _rounded(metres: jax.Array) -> jax.Array:
    """The same as ``petmjx.common.units.round_to_micrometre``, as a JAX function."""
    return jnp.floor(jnp.round(metres * MICROMETRES_PER_M, 2) + 0.5) / MICROMETRES_PER_M
