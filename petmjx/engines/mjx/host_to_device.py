"""Loads jobs, and released boxes, into tables on the device. The worlds of a table are simulated together."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mjx.first_states import paused_start, started_states
from petmjx.engines.mjx.frame_recorder import Recorder
from petmjx.engines.mjx.padded_sizes import PROFILE_GRANULE, padded_rows, round_up
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import Timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds, device_array, upload_worlds
from petmjx.engines.mjx.world_state import State, Status, fresh_state, put_rows
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job

MOST_KEPT = 16
"""Number of results that ``_going_on`` (compiled programs) and ``_state_shapes`` each keep for later calls."""


Table = TypeVar("Table", State, Worlds)

_put = jax.jit(put_rows, donate_argnums=0)


@dataclass
class Batch:
    """Worlds that are simulated together. Job i has row i; the remaining rows are padding.

    Attributes:
        table: the states of the worlds; replaced after each step or slice.
        profiles: (profile, step, 3) samples of all excitations.
        profile_rows: ``id`` of an excitation → its row in ``profiles``.
    """

    jobs: list[Job]
    worlds: Worlds
    table: State
    profiles: jax.Array
    profile_rows: dict[int, int]
    recorder: Recorder

    @property
    def boards(self) -> int:
        """Number of shapes of a carrier for which the tables have room."""
        return int(self.worlds.shape_half.shape[1] - self.worlds.half.shape[1])

    def give_up(self, rows: NDArray[np.int64], flag: Flag) -> None:
        """End worlds that cannot be simulated on this device, and give them this flag."""
        flags = self.table.flags.at[rows].set(self.table.flags[rows] | int(flag))
        self.table = self.table._replace(flags=flags, status=self.table.status.at[rows].set(Status.FINISHED))


def load(
    jobs: list[Job],
    rows: int,
    width: int,
    sim: Simulation,
    timetable: Timetable,
    profile_room: tuple[int, int] = (0, 0),
) -> Batch:
    """Make the tables for some jobs.

    Args:
        rows: number of rows of the tables, at least one per job.
        width: number of box columns, at least the number of boxes of the largest plan.
        profile_room: smallest number of rows for profiles, and smallest number of steps for each profile.
    """
    excitations = {id(job.drive.excitation): job.drive.excitation for job in jobs if job.drive}
    least_rows, least_steps = profile_room
    steps = round_up(max(1, least_steps, *(len(e.samples) for e in excitations.values())), PROFILE_GRANULE)
    profiles = np.zeros((padded_rows(max(1, least_rows, len(excitations))), steps, 3), np.float32)
    for row, excitation in enumerate(excitations.values()):
        profiles[row, : len(excitation.samples)] = excitation.samples
    profile_rows = {key: row for row, key in enumerate(excitations)}
    worlds, table = tables(jobs, rows, width, profile_rows, sim, timetable)
    return Batch(jobs, worlds, table, device_array(profiles), profile_rows, Recorder(jobs, sim))


def tables(
    jobs: Sequence[Job],
    rows: int,
    width: int,
    profile_rows: dict[int, int],
    sim: Simulation,
    timetable: Timetable,
    boards: int = 1,
) -> tuple[Worlds, State]:
    """The constants and first states of jobs. ``boards``: see ``upload_worlds``."""
    worlds = upload_worlds(jobs, rows, width, profile_rows, sim, boards)
    static = sim.check is Check.STATIC
    ends = np.full(rows, NEVER, np.int32)
    if sim.schedule is Schedule.FIXED:
        for row, job in enumerate(jobs):
            if not job.settles:
                ends[row] = timetable.static_end if static else timetable.one_by_one_end[job.scene.n_boxes]
    fresh = partial(fresh_state, all_placed=static, rest_steps=timetable.rest_steps)
    paused = any(paused_start(job) is not None for job in jobs)
    if not paused and all(isinstance(job.start, State) for job in jobs):
        # no job needs a fresh state, so the program for fresh states need not be compiled
        return worlds, started_states(jobs, _state_shapes(*worlds.half.shape[:2]))
    states = started_states(jobs, fresh(worlds, ends=device_array(ends)))
    return worlds, _going_on(sim, timetable, width)(states, worlds) if paused else states


@functools.lru_cache(MOST_KEPT)
def _state_shapes(rows: int, width: int) -> State:
    """A ``State`` that holds the shape and type of each array instead of the array. The last ``MOST_KEPT`` results are
    kept, since computing a result takes 5 ms."""

    def shape(*axes: int, kind: Any = np.float32) -> Any:
        return jax.ShapeDtypeStruct((rows, *axes), kind)  # type: ignore[no-untyped-call]  # JAX has no types for it

    used = {
        "n_boxes": shape(kind=np.int32),
        "half": shape(width, 3),
        "start": shape(width, 7),
        "carrier_pos": shape(3),
    }
    worlds = Worlds(**(dict.fromkeys(Worlds._fields) | used))  # type: ignore[arg-type]  # other fields have no shape here
    shapes: State = jax.eval_shape(partial(fresh_state, all_placed=False, rest_steps=0), worlds, ends=used["n_boxes"])
    return shapes


_HELD: Final = Drive(Excitation("held", ACCELERATION, np.zeros((0, 3))), scale=0.0, rest_s=0.0)
"""A drive without excitation. Like all drives of the kind ``acceleration``, this drive holds the carrier. The drive has
no other effect."""


def let_go(bodies: FreeBodies, sim: Simulation, rows: int, width: int) -> tuple[Worlds, State]:
    """Worlds in which all boxes are released, and their states. Nothing shakes them. The worlds end after the last
    requested step.

    Args:
        rows: number of rows of the tables, at least one per world; all further rows hold worlds that have already
            ended.
        width: number of box columns.
    """
    n, k = bodies.velocity.shape[:2]
    jobs = [Job(scene, _HELD) for scene in bodies.scenes]
    boards = len(bodies.scenes[0].carrier.half_size)
    worlds = upload_worlds(jobs, rows, width, {id(_HELD.excitation): 0}, sim, boards)
    ends = jnp.full(rows, int(bodies.steps[-1]), jnp.int32)
    fresh = fresh_state(worlds, all_placed=True, ends=ends, rest_steps=0)
    qpos, qvel = np.array(fresh.qpos), np.zeros((rows, width, 6), np.float32)
    qpos[:n, :k], qvel[:n, :k] = bodies.pose, bodies.velocity
    status = np.where(np.arange(rows) < n, Status.RUNNING, Status.FINISHED).astype(np.int32)
    return worlds, fresh._replace(
        qpos=device_array(qpos),
        qvel=device_array(qvel),
        step=jnp.zeros(rows, jnp.int32),
        driven_from=jnp.zeros(rows, jnp.int32),
        rest_from=jnp.full(rows, NEVER, jnp.int32),
        status=device_array(status),
    )


@functools.lru_cache(MOST_KEPT)
def _going_on(sim: Simulation, timetable: Timetable, width: int) -> Callable[[State, Worlds], State]:
    """The program that lets paused placements continue. The program is kept for later calls with the same options,
    width and timetable object."""
    going_on: Callable[[State, Worlds], State] = jax.jit(Rules(sim, timetable, width, driven=False).go_on_in_kernels)
    return going_on


def put_into(table: Table, rows: NDArray[np.intp], values: Table, put: Callable[..., Table] = _put) -> Table:
    """The table, with the first rows of ``values`` written into the rows ``rows``. The memory of the old table is
    reused.

    Args:
        values: table with at least as many rows as ``rows`` has entries.
        put: function that works like ``put_rows``.
    """
    length, end = len(jax.tree.leaves(values)[0]), len(jax.tree.leaves(table)[0])
    padded = np.full(length, end, np.int32)  # rows beyond the end of the table are dropped
    padded[: len(rows)] = rows
    return put(table, device_array(padded), values)
