"""Open worlds (to which boxes can be added) on the engine mjx-warp. The states of open worlds stay on the device
between calls.

petmjx/engines/warp/open_world_functions.py has the pure functions that return changed open worlds. ``WarpWorlds``
offers the same operations to ordinary Python code.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from petmjx.engines.mjx.host_to_device import Batch, load
from petmjx.engines.mjx.outcomes import outcomes
from petmjx.engines.mjx.padded_sizes import padded_rows, round_up
from petmjx.engines.mjx.readback import readbacks_of
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import Worlds, device_array, upload_worlds
from petmjx.engines.mjx.world_state import State, Status, put_rows, take_rows
from petmjx.engines.open_world_protocol import OpenWorlds, Snapshots
from petmjx.engines.verdict import Flag, Outcome
from petmjx.engines.warp.block_launch import Features
from petmjx.engines.warp.block_sizes import MAX_BOXES
from petmjx.engines.warp.contact_buffers import MAX_GROWTH
from petmjx.engines.warp.kernel_features import needs_of
from petmjx.engines.warp.next_boxes import NewBox, new_box, snapshot_inputs, snapshots_of
from petmjx.engines.warp.open_world_functions import OpenState, Simulator
from petmjx.engines.warp.world_table import OVERFLOW_BITS
from petmjx.options.simulation import Simulation
from petmjx.world.growing_scenes import NextBoxes, Stacks
from petmjx.world.job import Drive, Job
from petmjx.world.scene import Scene

MOST_TRIED: Final = 16_384
"""Largest number of tried places that are simulated at the same time. A world of 80 boxes takes 27 kB."""


def fork(open_: OpenState, sources: Int[Array, " row"], into: Int[Array, " row"]) -> OpenState:
    """Copy the constants and states of the worlds ``sources`` into the worlds ``into``."""
    worlds, state = open_
    return OpenState(
        put_rows(worlds, into, take_rows(worlds, sources)),
        put_rows(state, into, take_rows(state, sources)),
    )


class WarpWorlds(OpenWorlds):
    """Open worlds on the engines mjx-warp and mjx-warp-cpu.

    Args:
        scenes: the scenes of the worlds.
        most_boxes: largest number of boxes that a world will ever have.
        threads: number of CPU threads on which the worlds run. If ``threads`` is None, there is one thread.

    Attributes:
        open: the worlds, on the device.
        simulator: the pure functions that return changed states of these worlds. Jitted programs can call these
            functions, too.
        width: number of boxes for which each world has room.
        boards: number of shapes for which the carrier of each world has room.
    """

    def __init__(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int, threads: int | None = None) -> None:
        super().__init__(scenes, sim)
        if not 1 <= most_boxes <= MAX_BOXES:
            raise ValueError(f"most_boxes must be from 1 to {MAX_BOXES}, got {most_boxes!r}")
        self._sim, self._threads = sim, threads
        self.width = round_up(most_boxes)
        self.boards = max(len(scene.carrier.half_size) for scene in scenes)
        self._timetable = build_timetable(sim, self.width)
        self._room = 1
        self._features = needs_of(self._blank.scene, driven=True)._replace(lands=sim.physics.has_landings)
        self._most_rows = 1
        self._make_simulator()
        worlds = self._constants(scenes, padded_rows(len(scenes)))
        self.open = OpenState(worlds, _without_padding(self.simulator.begin(worlds), len(scenes)))

    def go_on(self) -> None:
        """See ``OpenWorlds.go_on``."""
        self.open = self._to_the_end(self.open, jnp.zeros((1, 1, 3)))

    def _reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        rows = self._rows(worlds)
        self.open = self._jitted_reset(self.open, rows, self._constants(scenes, len(rows)))

    def _ended(self, worlds: Sequence[int]) -> list[bool]:
        ended: list[bool] = (np.asarray(self.open.state.status)[list(worlds)] == Status.FINISHED).tolist()
        return ended

    def _put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        rows = self._rows(worlds)
        self.open = self._jitted_put(self.open, rows, self._constants(scenes, len(rows)))

    def _put_next(self, worlds: Sequence[int], boxes: NextBoxes) -> None:
        if not self._appears:
            super()._put_next(worlds, boxes)
            return
        rows = self._rows(worlds)
        box = self._new_box(self._scenes.stacks(worlds), boxes, len(rows))
        self.open = self._jitted_put_next(self.open, rows, box)

    def _try_next(self, worlds: Sequence[int], boxes: NextBoxes, *, until_lost: bool) -> Snapshots:
        if len(worlds) <= MOST_TRIED:
            return self._tried(worlds, boxes, until_lost)
        parts = []
        for first in range(0, len(worlds), MOST_TRIED):
            some = slice(first, first + MOST_TRIED)
            parts.append(self._tried(worlds[some], boxes.take(np.arange(len(boxes))[some]), until_lost))
        return Snapshots.joined(parts)

    def _tried(self, worlds: Sequence[int], boxes: NextBoxes, until_lost: bool) -> Snapshots:
        count, before = len(worlds), self._scenes.stacks(worlds)
        padded = _coarsely_padded(count)
        forks = _take(self.open, self._rows(worlds, padded), count)
        if self._appears:
            begun = self._jitted_put_next(forks, jnp.arange(padded), self._new_box(before, boxes, padded))
        else:
            more = self._constants(self.with_next(worlds, boxes), padded)
            rows = jnp.where(jnp.arange(padded) < count, jnp.arange(padded), padded)
            begun = self._jitted_put(forks, rows, more)
        if until_lost:
            ends = jnp.ones_like(begun.worlds.ends_when_lost)
            begun = begun._replace(worlds=begun.worlds._replace(ends_when_lost=ends, ends_when_gone=ends))
        after = self._to_the_end(begun, jnp.zeros((1, 1, 3)))
        report = snapshot_inputs(*after, device_array(np.arange(padded, dtype=np.int32)))
        return snapshots_of(report, *before.with_next(boxes), self._sim)

    def _new_box(self, before: Stacks, boxes: NextBoxes, rows: int) -> NewBox:
        if before.mass.shape[1] >= self.width and np.isfinite(before.mass[:, self.width - 1]).any():
            raise ValueError(
                f"each world has room for {self.width} boxes, and one world is full; use a larger most_boxes"
            )
        return new_box(before, boxes, self._blank, self._sim, rows)

    def _try_scenes(
        self, worlds: Sequence[int], scenes: Sequence[Scene], drives: Sequence[Drive | None]
    ) -> list[Outcome]:
        count = len(worlds)
        jobs = [Job(scene, drive) for scene, drive in zip(scenes, drives, strict=True)]
        padded = padded_rows(count)
        batch = load(jobs, padded, self.width, self._sim, self._timetable)
        forks = _take(self.open, self._rows(worlds, padded), count)
        more = self._constants(scenes, padded)  # these constants have no drives: drives begin after this placement
        rows = jnp.where(jnp.arange(padded) < count, jnp.arange(padded), padded)
        settled = self._to_the_end(self._jitted_put(forks, rows, more), jnp.zeros((1, 1, 3)))
        return self._ended_outcomes(settled.state, jobs, batch)

    def _snapshots(self, worlds: Sequence[int]) -> Snapshots:
        report = snapshot_inputs(*self.open, self._rows(worlds))
        stacks = self._scenes.stacks(worlds)
        return snapshots_of(report, stacks.half_size, stacks.target, self._sim)

    @property
    def _appears(self) -> bool:
        """Whether boxes appear at their places, and are neither carried nor dropped."""
        return self._blank.scene.placing.appears

    def _fork(self, sources: Sequence[int], into: Sequence[int]) -> None:
        self.open = _jitted_fork(self.open, self._rows(sources), self._rows(into))

    def _finish(self, worlds: Sequence[int], drives: Sequence[Drive | None]) -> list[Outcome]:
        self.go_on()
        jobs = [Job(self._scenes[world], drive) for world, drive in zip(worlds, drives, strict=True)]
        batch = load(jobs, padded_rows(len(jobs)), self.width, self._sim, self._timetable)
        state = _without_padding(take_rows(self.open.state, self._rows(worlds, padded_rows(len(jobs)))), len(jobs))
        return self._ended_outcomes(state, jobs, batch)

    def _ended_outcomes(self, state: State, jobs: Sequence[Job], batch: Batch) -> list[Outcome]:
        """The outcomes of paused worlds that get no more boxes."""
        begun = OpenState(batch.worlds, self._jitted_finish(OpenState(batch.worlds, state)))
        ended = self._to_the_end(begun, batch.profiles)
        picked = readbacks_of(np.arange(len(jobs)), ended.state, ended.worlds, self._sim)
        return list(outcomes(picked, jobs, range(len(jobs)), self._sim, batch.recorder))

    def _to_the_end(self, open_: OpenState, profiles: Float[Array, "profile step 3"]) -> OpenState:
        """Simulate until each world pauses or ends. Worlds that overflow their buffers continue with larger buffers."""
        while bool(self.simulator.going(open_)):
            open_ = self._jitted_slice(open_, profiles)
            full = open_.state.status == Status.OVERFLOWED
            if not np.asarray(full).any():
                continue
            enough = self._room < MAX_GROWTH
            flags = (open_.state.flags & ~OVERFLOW_BITS) | int(Flag.RERUN_AFTER_OVERFLOW)
            state = open_.state._replace(
                flags=jnp.where(full & enough, flags, open_.state.flags),
                status=jnp.where(full, Status.RUNNING if enough else Status.FINISHED, open_.state.status),
            )
            open_ = open_._replace(state=state)
            if enough:
                self._room *= 2
                self._make_simulator()
        return open_

    def _make_simulator(self) -> None:
        self.simulator = self.roomier(self._room)
        self.simulator.load()
        self._jitted_slice, self._jitted_put, self._jitted_finish, self._jitted_put_next, self._jitted_reset = (
            jax.jit(function)
            for function in (
                self.simulator.time_slice,
                self.simulator.put,
                self.simulator.finish,
                self.simulator.put_next,
                self.simulator.reset,
            )
        )

    def roomier(self, times: int) -> Simulator:
        """The pure functions with buffers that are ``times`` as large as the default. Jitted programs cannot enlarge
        buffers, so they need large buffers from the beginning."""
        sizes = self.width, self.boards, times, self._threads
        return Simulator(self._sim, self._timetable, *sizes, features=self._features)

    def _know(self, scenes: Sequence[Scene]) -> None:
        """Compile the kernels again if these scenes have features that the kernels lack."""
        features = Features.joined([self._features, *(needs_of(scene, driven=True) for scene in scenes)])
        if features != self._features:
            self._features = features
            self._make_simulator()

    def _constants(self, scenes: Sequence[Scene], rows: int) -> Worlds:
        """The constants of open worlds, in a table with ``rows`` rows."""
        self._know(scenes)
        most = max(scene.n_boxes for scene in scenes)
        if most > self.width:
            raise ValueError(
                f"each world has room for {self.width} boxes, but one scene has {most}; use a larger most_boxes"
            )
        boards = max(len(scene.carrier.half_size) for scene in scenes)
        if boards > self.boards:
            raise ValueError(f"there is room for carriers of {self.boards} boards, but one carrier has {boards}")
        jobs = [Job(scene) for scene in scenes]
        worlds = upload_worlds(jobs, rows, self.width, {}, self._sim, self.boards)
        return worlds._replace(pauses=device_array(np.ones(rows, np.bool_)))

    def _rows(self, worlds: Sequence[int], length: int | None = None) -> Int[Array, " row"]:
        """The row numbers of these worlds, padded with a row number that is beyond the last row of the tables.

        Args:
            length: length of the result. If ``length`` is None, the length is a power of two, and is not smaller than
                in any earlier call. So later calls compile nothing, although the number of worlds changes as pallets
                end and start again.
        """
        if length is None:
            length = self._most_rows = max(self._most_rows, padded_rows(len(worlds)))
        rows = np.full(length, len(self.open.state.status), np.int32)
        rows[: len(worlds)] = worlds
        return device_array(rows)


_jitted_fork = jax.jit(fork)


@jax.jit
def _take(open_: OpenState, rows: Int[Array, " row"], count: Int[Array, ""]) -> OpenState:
    """Copies of these worlds. Only the first ``count`` copies can continue. All other copies only fill up the table,
    and get the status ``FINISHED``."""
    return OpenState(take_rows(open_.worlds, rows), _without_padding(take_rows(open_.state, rows), count))


def _coarsely_padded(count: int) -> int:
    """Number of table rows for ``count`` tried places: a power of four, so that few programs are compiled."""
    return int(4 ** ((count - 1).bit_length() + 1 >> 1)) if count > 1 else 1


def _without_padding(state: State, count: int | Int[Array, ""]) -> State:
    """The states, changed so that only the first ``count`` worlds can continue. All other worlds get the status
    ``FINISHED``."""
    padding = jnp.arange(len(state.status)) >= count
    return state._replace(status=jnp.where(padding, Status.FINISHED, state.status))
