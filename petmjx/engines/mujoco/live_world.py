"""``LiveWorld``: a MuJoCo world that grows while boxes are placed. The code that applies the rules (docs/rules.md)
reads the boxes' states from this world."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.elimination_order import body_order
from petmjx.engines.mujoco.face_contacts import Beds
from petmjx.engines.mujoco.hand import Hand
from petmjx.engines.mujoco.landing import Landings
from petmjx.engines.mujoco.open_models import ModelInstance, Templates, set_options
from petmjx.engines.mujoco.slip import LOOK_STEPS, SlipLaw
from petmjx.engines.mujoco.top_forces import top_forces
from petmjx.engines.mujoco.waiting_boxes import add_waiting, press_waiting
from petmjx.engines.verdict import Flag
from petmjx.options.physics import Cone
from petmjx.options.simulation import Simulation
from petmjx.world.approach_paths import ApproachPath, approach_path_of, free_begin, reach, way_steps
from petmjx.world.mujoco_model import CARRIER_NAME, HeldCarrier, add_boxes, build_spec, geom_bodies, geom_surfaces
from petmjx.world.release_places import Release, release_of
from petmjx.world.scene import IDENTITY_QUAT, Scene

GROWTH_BLOCK = 8
"""Number of boxes that are added to the model at once. A box that waits in the model costs 0.5 µs per step, and
compiling the model again costs about 1 ms. For a plan of 40 boxes and the adaptive schedule, a simulation that adds
boxes one by one, or all at once, takes 5 % longer than a simulation that adds 8 boxes at once."""

ORDERED_FROM = 64
"""Smallest number of boxes of a plan whose bodies are sorted in elimination order. In elimination order, third-party
plans of 76 or more boxes are simulated 1.3 to 4.6 times as fast as in packing order. Third-party plans of 45 and 66
boxes, and generated plans, gain at most 2 %. For these plans, compiling the model again for a new order costs as much
time as the order saves."""

_PARKING_M = 100.0
_PARKING_PITCH_M = 10.0

_NO_CONTACTS = np.zeros((0, 2), dtype=np.intp)


@dataclass(frozen=True, eq=False)
class BodyState:
    """State of the carrier and the boxes: qpos (7), qvel (6) and warm start of the solver (6) of each body. The rows
    are carrier, box 0, box 1, …"""

    pose: FloatArray
    velocity: FloatArray
    warmstart: FloatArray


class LiveWorld:
    """MuJoCo's model and data of one world, in which the first ``n_placed`` boxes are placed.

    Boxes that are in the model but not yet placed hang far apart in the air. Each waiting box is held by a force equal
    to the weight of this box. Waiting boxes touch nothing, so they do not influence the pallet.

    With pyramidal friction cones, an additional body represents the waiting boxes
    (``petmjx.engines.mujoco.waiting_boxes``).

    The bodies of a large plan are sorted in elimination order (``petmjx.engines.mujoco.elimination_order``). The bodies
    of a smaller plan are in packing order. With pyramidal cones, all bodies are in packing order, so that results are
    bit-identical to the reference implementation. All arrays that this class takes and returns have rows in packing
    order.

    Args:
        templates: compiled models for open worlds. The values of this world are written into such a model, so that no
            model need be compiled. If ``templates`` is None, models are compiled.
        held: pose in which the carrier is clamped from the beginning. If ``held`` is None, the carrier is free.

    Attributes:
        order: (capacity,) numbers of the boxes in the order of their bodies.
        hand: the hand that carries the box placed last; None if all placed boxes are released.
        geom_bodies: (ngeom,) the body to which each geom belongs: the number of a box, ``CARRIER`` or ``FLOOR``.
        pyramidal: whether friction cones are pyramidal.
    """

    def __init__(
        self,
        scene: Scene,
        sim: Simulation,
        n_boxes: int = 0,
        shaken: bool = False,
        templates: Templates | None = None,
        held: HeldCarrier | None = None,
    ) -> None:
        self.scene = scene
        self.pyramidal = sim.physics.cone is Cone.PYRAMIDAL
        self._sim = sim
        self._shaken = shaken
        self._templates = templates
        self._held = held
        self._beds: Beds | None = None
        self.n_placed = n_boxes
        self.hand: Hand | None = None
        self._has_waiting = n_boxes < scene.n_boxes and self.pyramidal
        self._slip = SlipLaw(sim.physics)
        self._slides, self._looked = False, 0  # whether boxes slid at the last check; number of steps since this check
        lands = sim.physics.has_landings and scene.soft is None
        self._landings = Landings(scene, sim) if lands else None
        self._build(n_boxes)

    @property
    def _ordered(self) -> bool:
        return not self.pyramidal and self.scene.n_boxes >= ORDERED_FROM

    def _build(self, capacity: int, contacts: NDArray[np.integer] = _NO_CONTACTS) -> None:
        """Make model and data. ``contacts``: (m, 2) pairs of boxes that touch now."""
        self.order = body_order(self.scene, capacity, contacts, self._shaken) if self._ordered else np.arange(capacity)
        if self._templates is not None and self._templates.fits(self.scene):
            self._take(self._templates.filled(self.scene, self.order))
            return
        self._spec = build_spec(self.scene, self._sim.physics, held_carrier=self._held, n_boxes=0)
        if self._has_waiting:
            add_waiting(self._spec, self._sim.physics)
        held = self._held is not None
        add_boxes(self._spec, self.scene, self._sim.physics, self.order.tolist(), held=held)
        self._compile()

    def _compile(self) -> None:
        model = self._spec.compile()
        set_options(model, self._sim)
        self._take(ModelInstance(model, mujoco.MjData(model)))

    def _take(self, instance: ModelInstance) -> None:
        """Use this model and its data from now on. The bodies must be in the order ``order``."""
        self.model, self.data = instance
        self.capacity = len(self.order)
        self._row = np.argsort(self.order)
        self.geom_bodies = geom_bodies(self.model, self.order)
        gives = self.scene.stiffness is not None and bool(np.isfinite(self.scene.stiffness).any())
        self._beds = Beds(self.scene, self._sim.physics, self.model, self.geom_bodies) if gives else None
        if "kinetic" in self.scene.pairs:
            surfaces = geom_surfaces(self.scene, self.geom_bodies)
            self._slip = SlipLaw(self._sim.physics, self.scene.pairs["kinetic"], surfaces)
        self._look_into_data()

    def _look_into_data(self) -> None:
        """Make NumPy views of the boxes' rows in MuJoCo's data."""
        capacity = self.capacity
        self._warnings: NDArray[np.int32] = self.data.warning.number
        self._carrier, self._first_body = self.model.body(CARRIER_NAME).id, self.model.nbody - capacity
        free = self._held is None
        self._first_q, self._first_v = 7 * free + self._has_waiting, 6 * free + self._has_waiting
        self._poses: FloatArray = self.data.qpos[self._first_q :].reshape(capacity, 7)
        self._velocities: FloatArray = self.data.qvel[self._first_v :].reshape(capacity, 6)
        self._warmstarts: FloatArray = self.data.qacc_warmstart[self._first_v :].reshape(capacity, 6)

    @cached_property
    def release(self) -> Release:
        """The places at which boxes are released. Worlds that start from a settled state release no boxes."""
        return release_of(self.scene, self._sim)

    @cached_property
    def approach_path(self) -> ApproachPath | None:
        """The paths along which boxes approach their places. The result is None if boxes appear at their places."""
        return approach_path_of(self.scene, self._sim)

    @property
    def n_free(self) -> int:
        """Number of released boxes: all placed boxes, except a box that a hand still carries."""
        return self.n_placed - (self.hand is not None)

    @property
    def pose(self) -> FloatArray:
        """(capacity, 7) centres (m) and quaternions of the boxes after the last step."""
        poses = self._poses[self._row]
        poses[:, :3] = self.scene.middles(poses[:, :3], poses[:, 3:])
        return poses

    @property
    def velocity(self) -> FloatArray:
        """(capacity, 6) velocities (m/s) and angular velocities (rad/s) of the boxes after the last step."""
        return self._velocities[self._row]

    @property
    def qacc(self) -> FloatArray:
        """(capacity, 6) accelerations (m/s²) and angular accelerations (rad/s²) of the boxes in the last step. Angular
        accelerations are in the axes of the boxes."""
        rows: FloatArray = self.data.qacc[self._first_v :].reshape(-1, 6)
        return rows[self._row]

    def _grow(self) -> None:
        """Add the next boxes to the model. The states of all other bodies are copied bit for bit."""
        old, count = self.data, self.capacity
        boxes = self._poses[self._row], self._velocities[self._row], self._warmstarts[self._row]
        capacity = min(self.scene.n_boxes, count + GROWTH_BLOCK)
        if self._ordered or self._templates is not None:
            self._build(capacity, self._contacts() if self._ordered else _NO_CONTACTS)
        else:
            add_boxes(self._spec, self.scene, self._sim.physics, range(count, capacity), before=range(count))
            self.order = np.arange(capacity)
            self._compile()
        new, earlier_rows = self.data, self._row[:count]
        for name, first in (("qpos", self._first_q), ("qvel", self._first_v), ("qacc_warmstart", self._first_v)):
            getattr(new, name)[:first] = getattr(old, name)[:first]
        self._poses[earlier_rows], self._velocities[earlier_rows], self._warmstarts[earlier_rows] = boxes
        new.time = old.time
        for box in range(count, self.capacity):
            self._poses[self._row[box], :3] = (_PARKING_M + _PARKING_PITCH_M * box, 0.0, _PARKING_M)
            self._forces(box)[2] = self.scene.mass[box] * self._sim.physics.gravity_m_s2

    def extend(self, scene: Scene) -> None:
        """Replace the scene by a scene with additional boxes after the existing boxes."""
        self.scene = scene
        if self._landings is not None:
            self._landings = self._landings.extended(scene)
        for name in ("release", "approach_path"):  # these properties are computed again when they are needed
            vars(self).pop(name, None)

    def fork(self, *, grows: bool = False) -> LiveWorld:
        """An independent copy of this world in the same state, bit for bit.

        Args:
            grows: whether the next change of the copy is an additional box. If this box needs a new model, the data of
                the old model are only read and need not be copied.
        """
        twin = copy.copy(self)
        twin._landings = self._landings and self._landings.fork()
        if self._templates is None:
            twin._spec, twin.model = self._spec.copy(), copy.copy(self.model)
        elif grows and self.n_placed == self.capacity:
            return twin
        # A model from a template is not changed any more, so the copy uses the same model. Other models were copied
        # above.
        twin.data = copy.copy(self.data)
        twin._look_into_data()
        return twin

    def give_back(self) -> None:
        """Return the model and its data to the templates, for use in other worlds. This world must not be used
        afterwards."""
        if self._templates is not None and self._templates.fits(self.scene):
            self._templates.give_back(ModelInstance(self.model, self.data), self.scene, self.capacity)

    def _contacts(self) -> NDArray[np.integer]:
        """(m, 2) pairs of boxes that touch in the last step."""
        bodies = self.geom_bodies[np.reshape(self.data.contact.geom, (-1, 2))]
        return bodies[(bodies >= 0).all(axis=1)]

    def _forces(self, box: int) -> FloatArray:
        row: FloatArray = self.data.xfrc_applied[self._first_body + self._row[box]]
        return row

    def place_next(self) -> None:
        """Place the next box: at rest at its release place, or at the start of its fall or of its approach path."""
        if self.n_placed == self.capacity:
            self._grow()
        box = self.n_placed
        row = self._row[box]
        place = self.release.place_of(box, self.scene, self.pose[:, 2], self.carrier_pose[2])
        quat = self.scene.start_quat[box]
        if self.approach_path is not None:
            place, quat = self._take_up(self.approach_path, box, place)
        self._poses[row, :3] = self.scene.frame(box, place, quat)
        self._poses[row, 3:] = quat
        self._velocities[row] = 0.0
        self._warmstarts[row] = 0.0
        self._forces(box)[2] = 0.0
        self.n_placed += 1
        self._carry()
        if self._has_waiting:
            waiting_kg = float(self.scene.mass[self.n_placed :].sum())
            press_waiting(self.model, self.data, waiting_kg, self._sim.physics.gravity_m_s2)

    def _take_up(self, path: ApproachPath, box: int, rest: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3,) the position at which a box begins its approach or its fall, m, and (4,) the quaternion of its
        orientation. If the box is carried, a hand is created.

        Args:
            rest: (3,) the position at which the box would be at rest, m.
        """
        scene, physics = self.scene, self._sim.physics
        end, quat = rest + path.lift[box], path.quat[box]
        planned, pose = end + path.offset[box], self.pose[:box]
        box_reach = reach(quat[None], scene.half_size[box, None])[0]
        reaches = reach(pose[:, 3:], scene.half_size[:box])
        begin = free_begin(planned, box_reach, pose[:, :3], reaches, path.aside[box])
        steps = int(path.steps[box])
        if steps and (begin != planned).any():
            length = float(np.linalg.norm(begin - end))
            steps = int(way_steps(length, scene.mass[box], scene.placing, physics.timestep_s))
        if steps:
            ends = scene.frame(box, begin, quat), scene.frame(box, end, quat)
            falls = bool(path.falls[box])
            self.hand = Hand(scene, box, *ends, quat, steps, falls, physics.gravity_m_s2, physics.timestep_s)
        return begin, quat

    def carry_on(self, slow: bool) -> bool:
        """Whether a carried box is released after this step. ``slow``: see ``Hand.has_let_go``."""
        hand = self.hand
        if hand is None or not hand.has_let_go(self._poses[self._row[hand.box]], slow):
            self._carry()
            return False
        self._forces(hand.box)[:] = 0.0
        self.hand = None
        return True

    def _carry(self) -> None:
        """Set the force and moment of the hand for the next step."""
        if self.hand is not None:
            row = self._row[self.hand.box]
            self._forces(self.hand.box)[:] = self.hand.wrench(self._poses[row], self._velocities[row])

    def step(self, count: int) -> None:
        """Take ``count`` steps in C, without Python's global interpreter lock. The steps are taken one at a time if
        boxes are compliant, are landing, or may slide.

        Whether boxes slide is checked every ``LOOK_STEPS`` steps of the world, independently of ``count``.
        """
        while count > 0:
            if self._looked == 0:
                self._slides = self._slip.may_slide(self.data.qvel)
            n_steps = min(count, LOOK_STEPS - self._looked)
            self._take_steps(n_steps)
            self._looked = (self._looked + n_steps) % LOOK_STEPS
            count -= n_steps

    def _take_steps(self, count: int) -> None:
        landings = self._landings if self.n_placed else None
        if self._beds is None and not self._slides and (landings is None or landings.over(self)):
            mujoco.mj_step(self.model, self.data, nstep=count)
            return
        for _ in range(count):
            if self._beds is None:
                mujoco.mj_step1(self.model, self.data)
            else:
                self._beds.step1(self.model, self.data)
            if landings is not None:
                landings.act(self)
            self._slip.step2(self.model, self.data)

    def set_gravity(self, gravity: FloatArray) -> None:
        """Set the gravity of the world, (3,) m/s²."""
        self.model.opt.gravity[:] = gravity

    def set_carrier_force(self, force_n: FloatArray) -> None:
        """Set the force on the carrier's centre of mass from the next step on, (3,) N."""
        self.data.xfrc_applied[self._carrier, :3] = force_n

    def from_carrier(self) -> tuple[FloatArray, FloatArray]:
        """(capacity, 3) the boxes' centres of mass, m, and (capacity, 3) their velocities, m/s, relative to the
        carrier."""
        speed = np.zeros(3) if self._held is not None else self.data.qvel[:3]
        return self._poses[self._row, :3] - self.carrier_pose[:3], self.velocity[:, :3] - speed

    def set_box_forces(self, force_n: FloatArray) -> None:
        """Set the forces on the boxes' centres of mass from the next step on, (capacity, 3) N."""
        self.data.xfrc_applied[self._first_body + self._row, :3] = force_n

    def with_velocities(self, boxes: NDArray[np.bool_], velocity: FloatArray) -> FloatArray:
        """(nv,) velocities of all bodies, in which the velocities of the given boxes are replaced by rows of
        ``velocity``."""
        speeds: FloatArray = self.data.qvel.copy()
        chosen = np.flatnonzero(boxes[: self.capacity])
        speeds[self._first_v :].reshape(-1, 6)[self._row[chosen]] = velocity[chosen]
        return speeds

    def sampled_pose(self) -> tuple[FloatArray, FloatArray]:
        """(k, 3) centres (m) and (k, 4) quaternions of the placed boxes at the beginning of the last step.

        The accelerations and contact forces of a step belong to the poses at its beginning.
        """
        rows = self._first_body + self._row[: self.n_placed]
        pos, quat = self.data.xpos[rows], self.data.xquat[rows]
        return self.scene.middles(pos, quat), quat

    def sampled_velocity(self) -> FloatArray:
        """(capacity, 6) velocities (m/s) and angular velocities (rad/s) of the boxes at the beginning of the last step.
        Angular velocities are in the axes of the boxes."""
        velocity: FloatArray = self.velocity - self.model.opt.timestep * self.qacc
        return velocity

    def top_forces(self) -> FloatArray:
        """(k,) force on top of each placed box in the last step, N."""
        return top_forces(self.data, self.geom_bodies, self.capacity, self.pyramidal)[: self.n_placed]

    def accelerations(self) -> tuple[FloatArray, FloatArray]:
        """(k, 3) linear accelerations (m/s²) and (k, 3) angular accelerations (rad/s²) of the placed boxes in the last
        step, in world axes. MuJoCo stores angular values of a free body in the axes of this body."""
        acceleration = self.qacc[: self.n_placed]
        rows = self._first_body + self._row[: self.n_placed]
        turn = self.data.xmat[rows].reshape(-1, 3, 3)
        return acceleration[:, :3], np.einsum("kij,kj->ki", turn, acceleration[:, 3:])

    def contact_bodies(self) -> NDArray[np.intp]:
        """(ncon, 2) the two bodies of each contact of the last step: the number of a box, ``CARRIER`` or ``FLOOR``."""
        bodies: NDArray[np.intp] = self.geom_bodies[np.reshape(self.data.contact.geom, (-1, 2))]
        return bodies

    @property
    def carrier_pose(self) -> FloatArray:
        """(7,) position (m) and quaternion of the carrier after the last step."""
        if self._held is not None:
            return np.concatenate((self._held.pos, self._held.quat))
        return np.array(self.data.qpos[:7])

    def put_at_rest(self, poses: FloatArray) -> None:
        """Move all boxes to ``poses``, with zero velocity. ``poses``: (n, 7) centres (m) and quaternions."""
        self._poses[self._row, :3] = self.scene.frames(poses[:, :3], poses[:, 3:])
        self._poses[self._row, 3:] = poses[:, 3:]
        self._velocities[self._row] = self._warmstarts[self._row] = 0.0

    def hold_carrier(self) -> None:
        """Clamp the carrier at its current pose. The boxes keep their poses and velocities."""
        state, time_s = self.body_state(), self.data.time
        self._held = HeldCarrier(pos=state.pose[0, :3], quat=state.pose[0, 3:])
        self._has_waiting = False
        self._shaken = True
        self._templates = None  # templates are only for free carriers: the place of a clamped carrier differs by world
        self._build(self.capacity)
        self._restore(state, time_s)

    def body_state(self) -> BodyState:
        """A copy of the state of carrier and boxes. The carrier must be free."""
        data = self.data
        return BodyState(
            pose=np.vstack((data.qpos[:7], self._poses[self._row])),
            velocity=np.vstack((data.qvel[:6], self.velocity)),
            warmstart=np.vstack((data.qacc_warmstart[:6], self._warmstarts[self._row])),
        )

    @classmethod
    def resume(cls, scene: Scene, sim: Simulation, state: BodyState, time_s: float) -> LiveWorld:
        """A world with all its boxes, in a state that another world has reached. The result is a world in which a drive
        (motion of the carrier) can begin."""
        live = cls(scene, sim, n_boxes=len(state.pose) - 1, shaken=True)
        live._restore(state, time_s)
        return live

    @classmethod
    def let_go(cls, scene: Scene, sim: Simulation, velocity: FloatArray) -> LiveWorld:
        """A world with a clamped carrier, whose boxes are at their release places with the (n, 6) velocities
        ``velocity``."""
        held = HeldCarrier(scene.carrier.pos, np.array(IDENTITY_QUAT))
        live = cls(scene, sim, n_boxes=scene.n_boxes, held=held)
        live._velocities[live._row] = velocity
        return live

    def _restore(self, state: BodyState, time_s: float) -> None:
        if self._held is None:
            self.data.qpos[:7] = state.pose[0]
            self.data.qvel[:6] = state.velocity[0]
            self.data.qacc_warmstart[:6] = state.warmstart[0]
        self._poses[self._row] = state.pose[1:]
        self._velocities[self._row] = state.velocity[1:]
        self._warmstarts[self._row] = state.warmstart[1:]
        self.data.time = time_s

    def error_flags(self) -> Flag:
        """The flags of errors in this world, from MuJoCo's warnings and from numbers that are not finite."""
        flags = Flag.NONE
        count = self._warnings
        if count.any():
            kind = mujoco.mjtWarning
            if count[kind.mjWARN_BADQPOS] or count[kind.mjWARN_BADQVEL] or count[kind.mjWARN_BADQACC]:
                flags |= Flag.NONFINITE
            if count[kind.mjWARN_CONTACTFULL]:
                flags |= Flag.CONTACT_OVERFLOW
            if count[kind.mjWARN_CNSTRFULL]:
                flags |= Flag.CONSTRAINT_OVERFLOW
        if not (np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all()):
            flags |= Flag.NONFINITE
        return flags
