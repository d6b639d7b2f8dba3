"""Engine ``mjx-jax``: simulates batches of worlds in pure JAX. All worlds of a batch share one MJX model, which has
room for the largest of them. The rules of docs/rules.md are computed on arrays, for all worlds at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from petmjx.common.errors import is_out_of_memory
from petmjx.common.machine import cpu_threads
from petmjx.common.units import FloatArray
from petmjx.engines.mjx.batch_run import BatchRun, EndedWorlds, Phase
from petmjx.engines.mjx.batch_step import PaddedModel
from petmjx.engines.mjx.free_bodies import paths
from petmjx.engines.mjx.host_to_device import Batch, load
from petmjx.engines.mjx.jax_setup import set_up_jax
from petmjx.engines.mjx.outcomes import outcomes
from petmjx.engines.mjx.padded_sizes import GRANULE, padded_rows, round_up
from petmjx.engines.mjx.rollout import BatchRollout, Program
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
"""Largest number of worlds in a batch on a GPU or another accelerator if the user does not set ``lanes``.

On a CPU, if ``lanes`` is not set, each world is a separate batch, and each thread simulates a batch. There are two
reasons: on a CPU, XLA needs eight times as long for eight worlds as for one; and worlds that do not wait for each other
need fewer steps.
"""

FEWEST_WORLDS = 8
"""Smallest number of rows of a batch. Each number of rows needs its own program, which takes ten seconds to compile."""


@dataclass(frozen=True)
class ProgramKey:
    """The values on which a compiled program depends.

    Attributes:
        capacity: number of boxes for which each world has room.
        worlds: number of worlds for which a batch has room.
        boards: number of shapes of each carrier.
        drive: kind of the excitation; None: the program is for the placement.
        profiles: shape of the table of profiles.
        carries: whether boxes fall to their places or are carried to them, instead of appearing there.
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


@dataclass
class Group:
    """Jobs that can share a program.

    Attributes:
        indices: indices of the group's jobs that are not in a batch yet.
        capacity: number of boxes for which each world of a batch has room.
        profile_steps: number of steps of the longest profile.
        rows: largest useful number of rows of a batch. All batches of the group have equal numbers of rows, so that all
            can use one program.
    """

    indices: list[int]
    capacity: int
    profile_steps: int
    rows: int

    @classmethod
    def of(cls, jobs: Sequence[Job], indices: list[int]) -> Group:
        """A group of jobs that may share a batch (``batch_groups``). ``indices``: the indices of these jobs."""
        alike = [jobs[index] for index in indices]
        steps = max(len(job.drive.excitation.samples) if job.drive else 0 for job in alike)
        rows = max(padded_rows(len(indices)), FEWEST_WORLDS)
        return cls(indices, round_up(max(job.scene.n_boxes for job in alike)), steps, rows)

    def take(self, most: int) -> list[int]:
        """The indices of the next jobs, at most ``most``."""
        some, self.indices = self.indices[:most], self.indices[most:]
        return some


MOST_KEPT = 16
"""Largest number of compiled programs that a process keeps for later engines."""

_kept: dict[tuple[type, ProgramKey], Program] = {}
"""(Class of an engine, key) → program; the newest program is last. Engines of several threads may share a program."""


class MjxJaxEngine(Engine):
    """Simulates worlds of similar size in batches. Rows of worlds that have ended are given to waiting jobs.

    Boxes that are not yet placed hang in the air. So a batch keeps one model from its first step to its last.

    Boxes have no skin (contact margin). MJX's collider always prefers a face to an edge that is almost parallel to it,
    and it measures depths along the face's normal (MuJoCo 3.17: ``collision_convex.py``). With a skin, contacts of
    edges and corners would be deeper than they should be.

    Args:
        lanes: largest number of worlds in a batch. A batch has fewer worlds if there are not enough jobs, or if memory
            runs out.
    """

    name = "mjx-jax"

    def __init__(self, lanes: int | None = None) -> None:
        set_up_jax()
        self.lanes = lanes or MOST_WORLDS
        self._one_by_one = lanes is None and jax.default_backend() == "cpu"
        self._counting = threading.Lock()
        self.programs: dict[ProgramKey, Program] = {}
        """The compiled programs that runs of this engine have used, by key."""
        self._running = RunLock(self.name)

    def make_model(self, capacity: int, boards: int, sim: Simulation, *, held: bool, pausing: bool) -> PaddedModel:
        """A model for worlds of up to ``capacity`` boxes and ``boards`` boards of the carrier. ``held``: whether the
        carrier is clamped; ``pausing``: whether worlds may pause."""
        return PaddedModel(capacity, boards, sim, held=held, pausing=pausing)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """See ``Engine.paths``. At most ``lanes`` worlds are simulated at a time."""
        with self._running:
            return paths(bodies, without_skin(sim), self.lanes)

    @says_at_hand
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once. Outcomes are yielded as worlds of a batch end.

        Raises:
            RuntimeError: an earlier run of the same thread has not ended. (This run waits for runs of other threads.)
        """
        if not jobs:
            return
        sim = without_skin(sim)
        progress = progress or Progress()
        with self._running, closing(self._ended_worlds(jobs, sim, progress)) as parts:
            for picked, of_rows, indices, recorder in parts:
                made = outcomes(picked, of_rows, indices, sim, recorder)
                for count, outcome in enumerate(made, start=1):
                    progress.at_hand = len(indices) - count
                    yield outcome

    def _ended_worlds(
        self, jobs: Sequence[Job], sim: Simulation, progress: Progress
    ) -> Generator[EndedWorlds, None, None]:
        """Worlds that have ended, several at a time. If memory runs out, batches are halved.

        Each batch runs in a separate thread. If batches are single worlds, the caller's thread meanwhile loads the next
        worlds and compiles their programs. If batches are larger, as on a GPU, the caller's thread waits.
        """
        most, stop = 1 if self._one_by_one else self.lanes, threading.Event()
        threads = cpu_threads() if self._one_by_one else 1
        groups = [Group.of(jobs, alike) for alike in batch_groups(jobs)]
        running: dict[Future[None], tuple[Group, BatchRun]] = {}

        with ThreadPoolExecutor(threads, thread_name_prefix="petmjx-mjx-jax") as pool:

            def go_on(group: Group, run: BatchRun, added: Mapping[int, Job]) -> None:
                """Give free rows of a batch to jobs (index → job), and simulate the batch. Memory may run out before
                the simulation begins, while jobs get their rows. So an error of this function is stored as the error of
                the simulation."""

                def interrupts() -> bool:
                    return stop.is_set() or (run.refills and bool(group.indices) and len(run.ended()) >= run.at_once)

                simulation: Future[None] = Future()
                try:
                    run.add(added, build_timetable(sim, group.capacity))
                    run.phases = run.phases or self._phases(run.batch, sim, progress)
                    simulation = pool.submit(run.simulate, interrupts, progress, self._counting)
                except Exception as error:
                    simulation.set_exception(error)
                running[simulation] = group, run

            try:
                while running or any(group.indices for group in groups):
                    while len(running) < (2 * threads if self._one_by_one else 1):
                        group = next((group for group in groups if group.indices), None)
                        if group is None:
                            break
                        go_on(group, _load(jobs, group, min(group.rows, most), sim), {})
                    for simulation in wait(running, return_when=FIRST_COMPLETED).done:
                        group, run = running.pop(simulation)
                        if (failure := simulation.exception()) is not None:
                            if not (isinstance(failure, Exception) and is_out_of_memory(failure)):
                                raise failure
                            self.programs.clear()
                            _kept.clear()
                            group.indices = [*run.indices.values(), *group.indices]
                            if most > 1:
                                most = max(run.rows // 2, 1)
                                progress.message = f"out of device memory: trying again with {most} worlds at once"
                                continue
                            run = _load(jobs, group, 1, sim)
                            run.batch.give_up(np.arange(1), Flag.OUT_OF_MEMORY)
                        ended = run.take_ended()
                        some = group.take(run.fitting(jobs[index] for index in group.indices))
                        if some or run.indices:
                            go_on(group, run, {index: jobs[index] for index in some})
                        yield ended
            finally:
                stop.set()

    def _phases(self, batch: Batch, sim: Simulation, progress: Progress) -> list[Phase]:
        """The phases of a batch: first the placement, then the drive."""
        job = batch.jobs[0]
        drives: list[str | None] = [] if isinstance(job.start, State) else [None]
        if job.drive is not None:
            drives.append(job.drive.excitation.kind)
        phases = []
        for drive in drives:
            # The placement needs no profiles. If its program had the table of profiles as an argument, the program
            # would be compiled again for each shape of the table.
            profiles = jnp.zeros((1, 1, 3)) if drive is None else batch.profiles
            phases.append(Phase(self._program(batch, sim, drive, profiles, progress), drive, profiles))
        return phases

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
            model = self.make_model(capacity, batch.boards, sim, held=drive == ACCELERATION, pausing=worlds > 1)
            rules = Rules(sim, build_timetable(sim, capacity), capacity, drive is not None, carries)
            arguments = batch.table, model.blank_memory(worlds), batch.worlds, profiles
            chunk = BatchRollout(rules, model, gives, wraps).jitted().lower(*arguments).compile()
            self.programs[key] = _kept[type(self), key] = Program(model, chunk)
            for oldest in list(_kept)[:-MOST_KEPT]:
                _kept.pop(oldest, None)
            progress.compile_s += time.perf_counter() - begin
        return self.programs[key]


def without_skin(sim: Simulation) -> Simulation:
    """The options ``sim``, but boxes have no skin (contact margin)."""
    return sim.changed(physics=sim.physics.changed(skin_m=0.0))


def batch_groups(jobs: Sequence[Job]) -> list[list[int]]:
    """Groups of jobs that may share a batch, as lists of the jobs' indices. Groups with the largest plans come first.

    All jobs of a group have the same kind of drive, and carriers with the same number of boards. Either all jobs begin
    with a placement, or all begin from a settled state. Boxes that appear at their places, compliant boxes, and film:
    each of these three occurs in all worlds of a group or in none. Plans of a group are of similar size: 1 to 4 boxes,
    5 to 8, 9 to 16, ….
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


def _load(jobs: Sequence[Job], group: Group, rows: int, sim: Simulation) -> BatchRun:
    """A batch of the next jobs of a group. Rows that are padding hold worlds that have already ended."""
    some = group.take(rows)
    timetable = build_timetable(sim, group.capacity)
    batch = load([jobs[index] for index in some], rows, group.capacity, sim, timetable, (0, group.profile_steps))
    status = np.array(batch.table.status)
    status[len(some) :] = Status.FINISHED
    batch.table = batch.table._replace(status=device_array(status))
    return BatchRun(batch, dict(enumerate(some)), sim, refills=rows > 1)
