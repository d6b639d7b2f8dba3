"""Frames of recorded worlds, as they come from the device, and the histories made from these frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from petmjx.common.units import seconds_to_steps
from petmjx.engines.frame_history import history_of
from petmjx.engines.mjx.world_constants import NEVER
from petmjx.engines.mjx.world_state import State, Status
from petmjx.options.simulation import Simulation
from petmjx.world.history import History
from petmjx.world.job import Job


class Trail(NamedTuple):
    """The steps of a chunk, for each world. All values hold after a step, when the rules have been applied.

    ``ran``: whether the world took the step; ``fresh``: whether a box was placed after the step.
    """

    ran: Bool[Array, "step world"]
    fresh: Bool[Array, "step world"]
    number: Int[Array, "step world"]
    placed: Int[Array, "step world"]
    status: Int[Array, "step world"]
    pose: Float[Array, "step world box 7"]
    top_force: Float[Array, "step world box"]
    carrier_pose: Float[Array, "step world 7"]


class Frames(NamedTuple):
    """Frames of one world with n boxes, as NumPy arrays. The fields are arguments of ``history_of``."""

    step: NDArray[np.int32]
    placed: NDArray[np.int32]
    pose: NDArray[np.float32]
    top_force: NDArray[np.float32]
    carrier_pose: NDArray[np.float32]


class Recorder:
    """Collects the frames of worlds whose jobs request a history.

    Args:
        jobs: jobs that are simulated together; job i has row i.
        sim: the options of the run.

    Attributes:
        every: (job,) number of steps between two frames of a world; 0: the world is not recorded.
    """

    def __init__(self, jobs: Sequence[Job], sim: Simulation) -> None:
        self._jobs, self._sim = jobs, sim
        timestep_s = sim.physics.timestep_s
        intervals = [None if job.record is None else job.record.interval_s for job in jobs]
        steps = [0 if interval is None else max(seconds_to_steps(interval, timestep_s), 1) for interval in intervals]
        self.every = np.array(steps, np.int32)
        self._recorded: dict[int, list[Frames]] = {row: [] for row in np.flatnonzero(self.every).tolist()}

    @property
    def idle(self) -> bool:
        """Whether no world is recorded."""
        return not self._recorded

    def add(self, row: int, frames: Frames) -> None:
        """Append frames of a world. The frames must be later than the world's earlier frames, and may have columns for
        more boxes than the world has."""
        n = self._jobs[row].scene.n_boxes
        self._recorded[row].append(frames._replace(pose=frames.pose[:, :n], top_force=frames.top_force[:, :n]))

    def add_trail(self, trail: Trail) -> None:
        """Append the frames that are due in the steps of a chunk."""
        rows = list(self._recorded)
        columns: list[Any] = [np.asarray(values)[:, rows] for values in trail]
        trail_part = Trail(*columns)
        regular = (trail_part.number >= 0) & (trail_part.number % self.every[rows] == 0) & (trail_part.placed > 0)
        due = np.asarray(trail_part.ran & (regular | trail_part.fresh | (trail_part.status != Status.RUNNING)))
        for column, row in enumerate(rows):
            (at,) = np.nonzero(due[:, column])
            if len(at):
                passed: list[Any] = [values[at, column] for values in trail_part]
                self.add(row, self._frames(Trail(*passed)))

    @staticmethod
    def _frames(steps: Any) -> Frames:
        """Makes frames of one world from its steps. The steps are a ``Trail`` on the host, without the axis of worlds.
        In the frame after its placement, a box has no force on its top yet."""
        (fresh,) = np.nonzero(steps.fresh)
        steps.top_force[fresh, steps.placed[fresh] - 1] = 0.0
        return Frames(steps.number, steps.placed, steps.pose, steps.top_force, steps.carrier_pose)

    def history(self, row: int, world: State, time_s: Callable[[int], float]) -> History | None:
        """The history of a world that has ended; None if it was not recorded. The recorder then forgets the world's
        frames.

        Args:
            world: the last state of the world: one row, on the host.
            time_s: function that returns the time after a step, s.
        """
        frames = self._recorded.pop(row, None)
        if frames is None:
            return None
        job = self._jobs[row]
        if isinstance(job.start, State):
            frames.insert(0, _of_state(job, job.start))
        last = _of_state(job, world)
        if not frames or frames[-1].step[-1] != last.step[0]:
            frames.append(last)  # the host ended the world after its last recorded step
        parts: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in frames]) for name in Frames._fields
        }
        driven_from = None if world.driven_from == NEVER else int(world.driven_from)
        pose = parts["pose"].astype(np.float64)
        with np.errstate(invalid="ignore"):  # the poses of boxes that are not yet placed are NaN
            pose[..., :3] = job.scene.middles(pose[..., :3], pose[..., 3:])
        return history_of(
            job,
            parts["step"],
            parts["placed"],
            pose,
            parts["top_force"],
            parts["carrier_pose"],
            lambda step: time_s(max(step, 0)),
            driven_from,
        )


def _of_state(job: Job, state: State) -> Frames:
    """The frame of a state. The forces on the boxes' tops are unknown."""
    n = job.scene.n_boxes
    pose = np.array(state.qpos, np.float32)[None, :n]
    return Frames(
        np.array([state.step], np.int32),
        np.array([state.placed], np.int32),
        pose,
        np.full((1, n), np.nan, np.float32),
        np.array(state.carrier_qpos, np.float32)[None],
    )
