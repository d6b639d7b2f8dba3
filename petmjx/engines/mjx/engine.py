"""Engine ``mjx-jax``: batches of worlds on one padded MJX model, in pure JAX. The rules are array programs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mjx.batch_step import PaddedModel
from petmjx.engines.mjx.free_bodies import paths
from petmjx.engines.mjx.host_to_device import GRANULE, Batch, is_out_of_memory, load, padded_rows, round_up
from petmjx.engines.mjx.jax_setup import set_up_jax
from petmjx.engines.mjx.outcomes import outcomes
from petmjx.engines.mjx.readback import read_back
from petmjx.engines.mjx.rollout import CHUNK_STEPS, BatchRollout
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import device_array
from petmjx.engines.mjx.world_state import State, Status
from petmjx.engines.protocol import Engine, Progress, RunLock, says_at_hand
from petmjx.engines.verdict import Flag, Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import ACCELERATION, Job

MOST_WORLDS = 256
"""Largest number of worlds in a batch if the user does not set ``lanes``."""

FEWEST_WORLDS = 8
"""Smallest number of rows of a batch. Each number of rows needs its own program, which takes a minute to compile."""


@dataclass(frozen=True)
class ProgramKey:
    """The values on which a compiled program depends.

    Attributes:
        capacity, worlds: number of boxes and worlds for which there is room.
        boards: number of shapes of each carrier.
        drive: kind of the excitation; None: the program is for the placement.
        profiles: shape of the table of profiles.
        carries: whether there are boxes that do not just appear at their places.
        gives: whether there are compliant boxes.
        wraps: whether film holds boxes.
    """

    sim: Simulation
    capacity: int
    worlds: int
    boards: int
    drive: str | None
    profiles: tuple[int, ...]
    carries: bool
    gives: bool
    wraps: bool


@dataclass(frozen=True)
class Program:
    """A compiled ``BatchRollout.chunk``, with the model whose worlds it steps."""

    model: PaddedModel
    chunk: Any


MOST_KEPT = 16
"""Number of programs that a process keeps for later engines."""

_kept: dict[tuple[type, ProgramKey], Program] = {}
"""(Class of an engine, key) → program; the newest program is last. Engines of several threads may share a program."""


class MjxJaxEngine(Engine):
    """Simulates worlds of similar size in batches. All worlds of a batch are stepped together until the last one ends.

    Boxes that are not yet placed hang in the air. So a batch keeps one model from its first step to its last.

    Boxes have no skin. MJX's collider always prefers a face to an edge that is almost parallel to it, and it measures
    depths along the face's normal (3.17: ``collision_convex.py``). With a skin, contacts of edges and corners would be
    deeper than they should be.

    Args:
        lanes: largest number of worlds in a batch. A batch has fewer if there are fewer worlds, or if memory runs out.
    """

    name = "mjx-jax"

    def __init__(self, lanes: int | None = None) -> None:
        set_up_jax()
        self.lanes = lanes or MOST_WORLDS
        self.programs: dict[ProgramKey, Program] = {}
        """The compiled programs that runs of this engine have used, by key."""
        self._running = RunLock(self.name)

    def make_model(self, capacity: int, boards: int, sim: Simulation, *, held: bool) -> PaddedModel:
        """The padded model for worlds of up to ``capacity`` boxes."""
        return PaddedModel(capacity, boards, sim, held=held)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """See ``Engine.paths``. At most ``lanes`` worlds are simulated at a time."""
        with self._running:
            return paths(bodies, without_skin(sim), self.lanes)

    @says_at_hand
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once. The outcomes of a batch are yielded together. If memory runs out, batches are halved.

        Raises:
            RuntimeError: an earlier run of the same thread has not ended. (This run waits for runs of other threads.)
        """
        if not jobs:
            return
        sim = without_skin(sim)
        progress = progress or Progress()
        most = self.lanes
        with self._running:
            for alike in stackable_jobs(jobs):
                capacity = round_up(max(jobs[index].scene.n_boxes for index in alike))
                while alike:
                    # batches of equal size, so that all can use one program
                    batch_jobs = alike[: math.ceil(len(alike) / math.ceil(len(alike) / most))]
                    room = min(max(padded_rows(len(batch_jobs)), FEWEST_WORLDS), most)
                    rows, batch = np.arange(len(batch_jobs)), _load(jobs, batch_jobs, room, capacity, sim)
                    if not self._simulate(batch, sim, progress):
                        if most > 1:
                            most = max(room // 2, 1)
                            progress.message = f"out of device memory: trying again with {most} worlds at once"
                            continue
                        batch = _load(jobs, batch_jobs, room, capacity, sim)
                        batch.give_up(rows, Flag.OUT_OF_MEMORY)
                    picked = read_back(rows, batch.table, batch.worlds, sim)
                    made = outcomes(picked, batch.jobs, batch_jobs, sim, batch.recorder)
                    for count, outcome in enumerate(made, start=1):
                        progress.at_hand = len(batch_jobs) - count
                        yield outcome
                    alike = alike[len(batch_jobs) :]

    def _simulate(self, batch: Batch, sim: Simulation, progress: Progress) -> bool:
        """Run a batch of stackable worlds to its end: first the placement, then the drive.

        Returns:
            Whether device memory was sufficient. If not, compiled programs are dropped.
        """
        job = batch.jobs[0]
        try:
            if not isinstance(job.start, State):
                self._go_on(batch, sim, None, progress)
            if job.drive is not None:
                self._go_on(batch, sim, job.drive.excitation.kind, progress)
        except Exception as error:
            if not is_out_of_memory(error):
                raise
            self.programs.clear()
            _kept.clear()
            return False
        return True

    def _go_on(self, batch: Batch, sim: Simulation, drive: str | None, progress: Progress) -> None:
        """Step the batch until no world is left in the placement or, with a drive, in the drive."""
        # the placement needs no profiles; if it got their table, it would be compiled again for each shape of the table
        profiles = jnp.zeros((1, 1, 3)) if drive is None else batch.profiles
        program = self._program(batch, sim, drive, profiles, progress)
        worlds, capacity, _ = batch.worlds.half.shape
        forces = program.model.no_forces(worlds)
        going = (Status.RUNNING,) if drive is None else (Status.RUNNING, Status.SETTLED)
        label = f"{'place' if drive is None else 'drive'} capacity {capacity}"
        begin = time.perf_counter()
        while running := int(np.isin(np.asarray(batch.table.status), going).sum()):
            progress.message = f"{label}: {running} worlds running"
            batch.table, forces, trail = program.chunk(batch.table, forces, batch.worlds, profiles)
            if not batch.recorder.idle:
                batch.recorder.add_trail(trail)
            progress.world_steps += running * CHUNK_STEPS
        spent = f"{label} seconds"
        progress.extra[spent] = progress.extra.get(spent, 0) + time.perf_counter() - begin
        progress.extra[f"{label} lanes"] = worlds

    def _program(
        self, batch: Batch, sim: Simulation, drive: str | None, profiles: jax.Array, progress: Progress
    ) -> Program:
        worlds, capacity, _ = batch.worlds.half.shape
        scene = batch.jobs[0].scene
        carries = drive is None and not scene.placing.appears
        gives, wraps = scene.stiffness is not None, drive is not None and scene.wrap.holds
        key = ProgramKey(sim, capacity, worlds, batch.boards, drive, profiles.shape, carries, gives, wraps)
        if key not in self.programs and (type(self), key) in _kept:
            self.programs[key] = _kept[type(self), key]
        if key not in self.programs:
            progress.message = f"compiling for {worlds} worlds of up to {capacity} boxes"
            begin = time.perf_counter()
            model = self.make_model(capacity, batch.boards, sim, held=drive == ACCELERATION)
            rules = Rules(sim, build_timetable(sim, capacity), capacity, drive is not None, carries)
            chunk = BatchRollout(rules, model, gives, wraps).compiled(
                batch.table, model.no_forces(worlds), batch.worlds, profiles
            )
            self.programs[key] = _kept[type(self), key] = Program(model, chunk)
            for oldest in list(_kept)[:-MOST_KEPT]:
                _kept.pop(oldest, None)
            progress.compile_s += time.perf_counter() - begin
        return self.programs[key]


def without_skin(sim: Simulation) -> Simulation:
    """The same options, with boxes that have no skin."""
    return sim.changed(physics=sim.physics.changed(skin_m=0.0))


def stackable_jobs(jobs: Sequence[Job]) -> list[list[int]]:
    """Groups of jobs that may share a batch, as indices. Groups with the largest plans come first.

    All jobs of a group have the same kind of drive, and carriers with the same number of boards. Either all start from
    their beginning, or all from a settled state. Appearing boxes, compliant boxes and film each occur in all worlds of
    a group or in none. Plans of a group are of similar size: 1 to 4 boxes, 5 to 8, 9 to 16, ….
    """
    indices_by_key: dict[tuple[int, int, str | None, bool, bool, bool, bool], list[int]] = {}
    for index, job in enumerate(jobs):
        size = ((job.scene.n_boxes - 1) // GRANULE).bit_length()
        drive = job.drive.excitation.kind if job.drive is not None else None
        boards, begun = len(job.scene.carrier.half_size), isinstance(job.start, State)
        scene = job.scene
        key = (size, boards, drive, begun, scene.placing.appears, scene.stiffness is not None, scene.wrap.holds)
        indices_by_key.setdefault(key, []).append(index)
    return [indices_by_key[key] for key in sorted(indices_by_key, key=lambda key: -key[0])]


def _load(jobs: Sequence[Job], some: list[int], room: int, capacity: int, sim: Simulation) -> Batch:
    """A batch of the jobs ``some``, with ``room`` rows and ``capacity`` boxes. Padding rows have already ended."""
    timetable = build_timetable(sim, capacity)
    batch = load([jobs[index] for index in some], room, capacity, sim, timetable)
    status = np.array(batch.table.status)
    status[len(some) :] = Status.FINISHED
    batch.table = batch.table._replace(status=device_array(status))
    return batch
