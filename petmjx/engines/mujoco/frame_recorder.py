"""Records the frames of one world on C MuJoCo: poses after a step, and forces and accelerations during the step."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray, seconds_to_steps
from petmjx.engines.frame_history import history_of
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.engines.mujoco.top_forces import contact_normal_and_tangents
from petmjx.world.history import Contacts, History, Record
from petmjx.world.job import Job


@dataclass(eq=False)
class _Frame:
    """One recorded frame of a world with n boxes. ``acted``: (n, 8) force on top (N), linear acceleration (m/s²),
    angular acceleration (rad/s²) and penetration (m) of each box."""

    step: int
    placed: int
    pose: FloatArray
    carrier_pose: FloatArray
    acted: FloatArray
    contacts: Contacts


class WorldRecorder:
    """Records the frames of one world.

    Args:
        record: which frames are recorded, and whether with details.
        timestep_s: timestep of the simulation, s.
    """

    def __init__(self, record: Record, job: Job, timestep_s: float) -> None:
        self._job, self._details = job, record.details
        self._every = max(seconds_to_steps(record.interval_s, timestep_s), 1)
        self._frames: list[_Frame] = []
        self._begun = False

    def is_due(self, step: int) -> bool:
        """Whether a frame must be recorded after this step. No frame is due before the first box is placed."""
        return self._begun and step % self._every == 0

    def next_after(self, step: int) -> int:
        """The next step after which a frame is due. Before the first frame, the value is a very large number."""
        if not self._begun:
            return sys.maxsize
        return step + self._every - step % self._every

    def look(self, step: int, live: LiveWorld) -> None:
        """Record a frame after a step, unless the step already has a frame. Call this method before you change the
        world: after a change, MuJoCo no longer has the forces of the step."""
        if self._frames and self._frames[-1].step == step:
            return
        self._take(step, live, acted=True)

    def begin(self, step: int, live: LiveWorld) -> None:
        """Record the first frame of a world that starts from a settled state. The forces in this frame are unknown."""
        self._take(step, live, acted=False)

    def place(self, live: LiveWorld) -> None:
        """Add the box that was just placed to the frame of the current step. No force has acted on the box yet."""
        frame, box = self._frames[-1], live.n_placed - 1
        frame.placed = live.n_placed
        frame.pose[box] = live.pose[box]
        frame.acted[box] = 0.0
        self._begun = True

    def history(self, time_s: Callable[[int], float], driven_from: int | None) -> History:
        """All recorded frames, as a history.

        Args:
            time_s: function that returns the time after a step, s.
            driven_from: the step after which the drive (motion of the carrier) began; None if there is no drive.
        """
        frames = self._frames
        acted = np.array([frame.acted for frame in frames])
        history = history_of(
            self._job,
            np.array([frame.step for frame in frames]),
            np.array([frame.placed for frame in frames]),
            [frame.pose for frame in frames],
            acted[..., 0],
            [frame.carrier_pose for frame in frames],
            time_s,
            driven_from,
        )
        if not self._details:
            return history
        return replace(
            history,
            lin_acc=acted[..., 1:4],
            ang_acc=acted[..., 4:7],
            penetration_m=acted[..., 7],
            contacts=_joined_contacts([frame.contacts for frame in frames]),
        )

    def _take(self, step: int, live: LiveWorld, acted: bool) -> None:
        n, k = self._job.scene.n_boxes, live.n_placed
        pose, values = np.full((n, 7), np.nan), np.full((n, 8), np.nan)
        pose[:k] = live.pose[:k]
        contacts = Contacts.none()
        if acted:
            values[:k, 0] = live.top_forces()
            if self._details:
                values[:k, 1:4], values[:k, 4:7] = live.accelerations()
                contacts = read_contacts(live.data, live.contact_bodies(), live.pyramidal, len(self._frames))
                values[:k, 7] = _penetration(contacts, k)
        self._begun = self._begun or k > 0
        self._frames.append(_Frame(step, k, pose, live.carrier_pose, values, contacts))


def read_contacts(data: mujoco.MjData, bodies: NDArray[np.integer], pyramidal: bool, frame: int) -> Contacts:
    """All contacts of the last step.

    Args:
        bodies: (ncon, 2) the two bodies of each contact (``LiveWorld.contact_bodies``).
        frame: number of the recorded frame to which the contacts belong.
    """
    body = bodies.astype(np.int32)
    axes = np.array(data.contact.frame).reshape(-1, 3, 3)
    force = np.zeros((len(body), 3))
    if len(body):
        index, along = contact_normal_and_tangents(data, pyramidal)
        force[index] = np.einsum("kr,krc->kc", along, axes[index])
    return Contacts(
        frame=np.full(len(body), frame, np.int32),
        body=body,
        point=np.array(data.contact.pos).reshape(-1, 3),
        normal=axes[:, 0],
        force=force,
        distance=np.reshape(data.contact.dist - data.contact.includemargin, -1),
    )


def _penetration(contacts: Contacts, n_placed: int) -> FloatArray:
    """(n_placed,) largest penetration at any contact of each box, m. The value is 0 for a box without contacts."""
    depth = np.zeros(n_placed)
    for side in range(2):
        box = contacts.body[:, side]
        np.maximum.at(depth, box[box >= 0], -contacts.distance[box >= 0])
    return depth


def _joined_contacts(parts: list[Contacts]) -> Contacts:
    return Contacts(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})
