"""Histories (recorded frames of a world) of the engine mujoco, compared with a plain loop over C MuJoCo.

The loop measures everything in its own way.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import mujoco
import numpy as np
from support.reference import real_plans

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.live_world import GROWTH_BLOCK
from petmjx.options.simulation import SOFT_START_STEPS, Schedule, Simulation
from petmjx.world.history import History, Record
from petmjx.world.job import Job
from petmjx.world.mujoco_model import add_boxes, build_spec
from petmjx.world.scene import Scene, build_scene

SAME_PLACE_M = 1e-9
SAME_ACCELERATION = 1e-6
"""Tolerance of accelerations, in m/s² and rad/s²."""
SAME_FORCE_N = 1e-6
SAME_DEPTH_M = 1e-9

EVERY = 17
"""Steps between two frames. Frames are at other steps than samples, looks for quiet boxes, and placements."""
SIM = Simulation(physics="reference", schedule=Schedule.FIXED, interval_s=0.3, early_stop=False)
FIRST_BOX = 3
"""Number of bodies before the boxes: the world, the carrier, and the body that stands for boxes not placed yet."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What the plain loop saw in a frame: poses, accelerations and forces of boxes, and contacts.

    A row of ``contacts`` has 12 numbers: the two bodies, the position, the normal, the force, and the distance.
    """

    pose: FloatArray
    lin_acc: FloatArray
    ang_acc: FloatArray
    top_force_n: FloatArray
    contacts: FloatArray


class PlainLoop:
    """A plain simulation of a scene, which places a box every ``SIM.interval_s``.

    The simulation builds a new MuJoCo model for each block of boxes.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.placed = scene, 0
        self.model, self.data = self._build(0)
        self.frames: dict[int, Seen] = {}

    def _build(self, n_boxes: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        spec = build_spec(self.scene, SIM.physics, n_boxes=0)
        waiting = spec.worldbody.add_body(name="waiting", pos=[0.0, 0.0, -100.0])
        waiting.mass, waiting.inertia, waiting.explicitinertial = 1.0, np.ones(3), True
        stop = waiting.add_joint(name="stop", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
        stop.range, stop.limited = np.array([0.0, 1.0]), mujoco.mjtLimited.mjLIMITED_TRUE
        stop.solimp_limit[:3] = SIM.physics.solimp
        add_boxes(spec, self.scene, SIM.physics, range(n_boxes))
        model = spec.compile()
        data = mujoco.MjData(model)
        for box in range(self.placed, n_boxes):
            data.qpos[self.q(box)][:3] = 200.0 + 10.0 * box, 0.0, 100.0
            data.xfrc_applied[FIRST_BOX + box, 2] = self.scene.mass[box] * SIM.physics.gravity_m_s2
        return model, data

    @staticmethod
    def q(box: int) -> slice:
        return slice(8 + 7 * box, 15 + 7 * box)

    @staticmethod
    def v(box: int) -> slice:
        return slice(7 + 6 * box, 13 + 6 * box)

    def place(self) -> None:
        box = self.placed
        if box == self.model.nbody - FIRST_BOX:
            model, data = self._build(min(box + GROWTH_BLOCK, self.scene.n_boxes))
            nq, nv = self.model.nq, self.model.nv
            data.qpos[:nq], data.qvel[:nv], data.time = self.data.qpos, self.data.qvel, self.data.time
            data.qacc_warmstart[:nv] = self.data.qacc_warmstart
            self.model, self.data = model, data
        self.data.qpos[self.q(box)] = np.concatenate((self.scene.start_pos[box], self.scene.start_quat[box]))
        self.data.qvel[self.v(box)] = self.data.qacc_warmstart[self.v(box)] = 0.0
        self.data.xfrc_applied[FIRST_BOX + box] = 0.0
        self.placed += 1
        # The body for waiting boxes is pressed as hard as these would press on the floor (mujoco/live_world.py).
        waiting_kg = self.scene.mass[self.placed :].sum()
        self.data.xfrc_applied[2, 2] = SIM.physics.gravity_m_s2 * (1.0 - sqrt(3.97 * waiting_kg))

    def step(self, look: int | None = None) -> None:
        """Make one step. If ``look`` is given, store a frame under that number.

        The frame has the accelerations and contacts of the beginning of the step, and the poses of its end.
        """
        model, data = self.model, self.data
        mujoco.mj_forward(model, data)
        if look is not None:
            mujoco.mj_rnePostConstraint(model, data)
            seen = self._accelerations(), self._contacts()
        mujoco.mj_Euler(model, data)
        if look is not None:
            (lin, ang), contacts = seen
            pose = np.array([data.qpos[self.q(box)] for box in range(self.placed)]).reshape(-1, 7)
            self.frames[look] = Seen(pose, lin, ang, self._on_tops(contacts), contacts)

    def _accelerations(self) -> tuple[FloatArray, FloatArray]:
        accelerations = np.zeros((self.placed, 6))
        for box in range(self.placed):
            kind = mujoco.mjtObj.mjOBJ_BODY
            mujoco.mj_objectAcceleration(self.model, self.data, kind, FIRST_BOX + box, accelerations[box], 0)
        return accelerations[:, 3:] + self.model.opt.gravity, accelerations[:, :3]

    def _contacts(self) -> FloatArray:
        rows = []
        for number in range(self.data.ncon):
            contact, force = self.data.contact[number], np.zeros(6)
            mujoco.mj_contactForce(self.model, self.data, number, force)
            axes = contact.frame.reshape(3, 3)
            pair = [int(geom) - 2 for geom in contact.geom]
            rows.append([*pair, *contact.pos, *axes[0], *(force[:3] @ axes), contact.dist])
        return np.array(rows).reshape(-1, 12)

    def _on_tops(self, contacts: FloatArray) -> FloatArray:
        """Return the vertical forces on the tops of boxes.

        The normal of a contact counts if it is within 45° of vertical. The force of such a contact acts on the box
        whose centre is lower.
        """
        total = np.zeros(self.placed)
        height = {-2: -np.inf, **{box - 2: z for box, z in enumerate(self.data.geom_xpos[:, 2]) if box}}
        for first, second, *values in contacts:
            lower, sign = (first, 1.0) if height[first] < height[second] else (second, -1.0)
            if lower >= 0 and abs(values[5]) >= sqrt(0.5):
                total[int(lower)] += sign * values[8]
        return total


def plain_frames(scene: Scene) -> dict[int, Seen]:
    loop, gravity = PlainLoop(scene), SIM.physics.gravity_m_s2
    for ramp in [0.0] * SOFT_START_STEPS + [k / SOFT_START_STEPS for k in range(SOFT_START_STEPS)]:
        loop.model.opt.gravity[:] = 0.0, 0.0, -gravity * ramp
        loop.step()
    loop.model.opt.gravity[2] = -gravity
    loop.data.time = placed_at = 0.0
    last = int((scene.n_boxes + 1) * SIM.interval_s / SIM.physics.timestep_s)
    for step in range(1, last + 1):
        due = loop.data.time + SIM.physics.timestep_s - placed_at >= SIM.interval_s
        places = due and loop.placed < scene.n_boxes
        regular = loop.placed > 0 and step % EVERY == 0
        loop.step(step if regular or places or step == last else None)
        if places:
            placed_at = loop.data.time
            loop.place()
    return loop.frames


def test_frames_are_those_of_a_plain_loop() -> None:
    scene = build_scene(real_plans()["packing_plan_a"], SIM)
    record = Record(EVERY * SIM.physics.timestep_s, details=True)
    (outcome,) = MujocoEngine(1).run([Job(scene, record=record)], SIM)
    history = outcome.history
    assert history is not None
    assert history.contacts is not None
    expected = plain_frames(scene)
    steps = np.round(history.time_s / SIM.physics.timestep_s).astype(int)
    assert steps.tolist() == list(expected)
    for frame, seen in enumerate(expected.values()):
        compare(history, frame, seen)
    assert len(history.contacts.frame) == sum(len(seen.contacts) for seen in expected.values())
    assert np.nanmax(history.top_force_n) > 100.0
    assert np.nanmax(np.abs(history.ang_acc)) > 0.1


def compare(history: History, frame: int, seen: Seen) -> None:
    """Compare a frame of a history with that of the plain loop. The history's frame may have one more box."""
    k = len(seen.pose)
    assert history.n_placed[frame] in (k, k + 1)
    assert history.lin_acc is not None
    assert history.ang_acc is not None
    assert history.penetration_m is not None
    for recorded, expected, most in (
        (history.pos, seen.pose[:, :3], SAME_PLACE_M),
        (history.quat, seen.pose[:, 3:], SAME_PLACE_M),
        (history.lin_acc, seen.lin_acc, SAME_ACCELERATION),
        (history.ang_acc, seen.ang_acc, SAME_ACCELERATION),
        (history.top_force_n, seen.top_force_n, SAME_FORCE_N),
    ):
        np.testing.assert_allclose(recorded[frame, :k], expected, rtol=0, atol=most)
    contacts = history.contacts
    assert contacts is not None
    of = contacts.frame == frame
    columns = [contacts.body, contacts.point, contacts.normal, contacts.force, contacts.distance[:, None]]
    rows = np.concatenate([values[of] for values in columns], axis=1)
    assert np.array_equal(rows[:, :2], seen.contacts[:, :2])
    np.testing.assert_allclose(rows[:, 2:8], seen.contacts[:, 2:8], rtol=0, atol=SAME_PLACE_M)
    np.testing.assert_allclose(rows[:, 8:11], seen.contacts[:, 8:11], rtol=0, atol=SAME_FORCE_N)
    np.testing.assert_allclose(rows[:, 11], seen.contacts[:, 11], rtol=0, atol=SAME_DEPTH_M)
    for box in range(k):
        touching = seen.contacts[(seen.contacts[:, :2] == box).any(axis=1), 11]
        depth = max(-touching.min(initial=0.0), 0.0)
        assert abs(history.penetration_m[frame, box] - depth) <= SAME_DEPTH_M
