"""A MuJoCo world that grows as boxes are placed: model, data, and the views the rules need."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from petmjx.config import SimConfig, Solver
from petmjx.model import HeldCarrier, add_boxes, build_spec
from petmjx.outcome import Flag, FloatArray
from petmjx.scene import Scene

GROWTH_BLOCK = 4
"""Boxes added to the model at once. A box that waits in the model costs 0.5 µs a step, a recompilation about
1 ms: with a placement every 50 to 350 steps, 4 and 8 are equally good and 1 and 40 are worse."""

_PARKING_M = 100.0
_PARKING_PITCH_M = 10.0

_SOLVER = {Solver.NEWTON: mujoco.mjtSolver.mjSOL_NEWTON, Solver.CG: mujoco.mjtSolver.mjSOL_CG}


@dataclass(frozen=True, eq=False)
class BodyState:
    """Positions (7), velocities (6) and solver warm start (6) of carrier and all boxes; rows: carrier, box 0, …"""

    pose: FloatArray
    velocity: FloatArray
    warmstart: FloatArray


class LiveWorld:
    """Model and data of one world with the first ``n_placed`` boxes in play.

    Boxes that are in the model but not yet placed stand far apart in the air, held by a force equal to
    their weight. They touch nothing, so they do not influence the pallet at all.
    """

    def __init__(self, scene: Scene, sim: SimConfig, n_boxes: int = 0) -> None:
        self.scene = scene
        self._sim = sim
        self._held: BodyState | None = None
        self.n_placed = n_boxes
        self._build(n_boxes)

    def _build(self, capacity: int) -> None:
        held = None
        if self._held is not None:
            held = HeldCarrier(pos=self._held.pose[0, :3], quat=self._held.pose[0, 3:])
        self._spec = build_spec(self.scene, self._sim.physics, held_carrier=held, n_boxes=capacity)
        self._compile(capacity)

    def _compile(self, capacity: int) -> None:
        self.capacity = capacity
        self.model = self._spec.compile()
        self.model.opt.solver = _SOLVER[self._sim.solver]
        # MuJoCo would silently start a diverged world afresh; here it has to stay visible.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        carrier_free = 0 if self._held is not None else 1
        # View rows: the carrier too where it is free.
        self._pose = self.data.qpos.reshape(capacity + carrier_free, 7)
        self._velocity = self.data.qvel.reshape(capacity + carrier_free, 6)
        self._warmstart = self.data.qacc_warmstart.reshape(capacity + carrier_free, 6)
        self._first_row = carrier_free
        self.qacc = self.data.qacc.reshape(capacity + carrier_free, 6)[carrier_free:]
        self.pose = self._pose[carrier_free:]
        self.velocity = self._velocity[carrier_free:]

    def _grow(self) -> None:
        """Add the next boxes to the model; everything that is there moves over bit for bit."""
        old_pose, old_velocity, old_warmstart = self._pose, self._velocity, self._warmstart
        time_s, old_capacity = self.data.time, self.capacity
        capacity = min(self.scene.n_boxes, old_capacity + GROWTH_BLOCK)
        add_boxes(self._spec, self.scene, self._sim.physics, old_capacity, capacity)
        self._compile(capacity)
        rows = len(old_pose)
        self._pose[:rows] = old_pose
        self._velocity[:rows] = old_velocity
        self._warmstart[:rows] = old_warmstart
        self.data.time = time_s
        for box in range(old_capacity, capacity):
            self.pose[box, :3] = (_PARKING_M + _PARKING_PITCH_M * box, 0.0, _PARKING_M)
            self._box_force(box)[2] = self.scene.mass[box] * self._sim.physics.gravity_m_s2

    def _box_force(self, box: int) -> FloatArray:
        row: FloatArray = self.data.xfrc_applied[2 + box]
        return row

    def place_next(self) -> None:
        """Put the next box at its release pose, at rest."""
        if self.n_placed == self.capacity:
            self._grow()
        box = self.n_placed
        self.pose[box, :3] = self.scene.start_pos[box]
        self.pose[box, 3:] = self.scene.start_quat[box]
        self.velocity[box] = 0.0
        self._warmstart[self._first_row + box] = 0.0
        self._box_force(box)[2] = 0.0
        self.n_placed += 1

    def step(self, count: int) -> None:
        mujoco.mj_step(self.model, self.data, nstep=count)

    def set_gravity(self, gravity: FloatArray) -> None:
        """(3,) m/s²."""
        self.model.opt.gravity[:] = gravity

    def set_carrier_force(self, force_n: FloatArray) -> None:
        """(3,) N on the carrier's centre of mass, from the next step on."""
        self.data.xfrc_applied[1, :3] = force_n

    def hold_carrier(self) -> None:
        """Clamp the carrier where it is. What stands on it keeps pose and velocity."""
        state = self.body_state()
        self._held = state
        time_s = self.data.time
        self._build(self.capacity)
        self.pose[:] = state.pose[1:]
        self.velocity[:] = state.velocity[1:]
        self._warmstart[:] = state.warmstart[1:]
        self.data.time = time_s

    def body_state(self) -> BodyState:
        """A copy of the moving state of a world whose carrier is free."""
        return BodyState(self._pose.copy(), self._velocity.copy(), self._warmstart.copy())

    @classmethod
    def resume(cls, scene: Scene, sim: SimConfig, state: BodyState, time_s: float) -> LiveWorld:
        """A world with all boxes, in a state that another world had reached."""
        live = cls(scene, sim, n_boxes=len(state.pose) - 1)
        live._pose[:] = state.pose
        live._velocity[:] = state.velocity
        live._warmstart[:] = state.warmstart
        live.data.time = time_s
        return live

    def trouble(self) -> Flag:
        """What MuJoCo or the numbers themselves say against this world."""
        flags = Flag.NONE
        numbers = self.data.warning.number
        if numbers.any():
            kind = mujoco.mjtWarning
            if numbers[[kind.mjWARN_BADQPOS, kind.mjWARN_BADQVEL, kind.mjWARN_BADQACC]].any():
                flags |= Flag.NONFINITE
            if numbers[kind.mjWARN_CONTACTFULL]:
                flags |= Flag.CONTACT_OVERFLOW
            if numbers[kind.mjWARN_CNSTRFULL]:
                flags |= Flag.CONSTRAINT_OVERFLOW
        if not (np.isfinite(self._pose).all() and np.isfinite(self._velocity).all()):
            flags |= Flag.NONFINITE
        return flags
