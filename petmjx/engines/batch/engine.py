"""The base class of the MJX engines: groups of worlds, stages, hand-over between capacities, outcomes as they come."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from petmjx.config import Check, Cone, Schedule, Simulation
from petmjx.engines.base import GROUP_WORLDS, Progress, RunLock
from petmjx.engines.batch.capacities import class_capacities, growing_capacities
from petmjx.engines.batch.outcomes import handed_on, outcomes, pick, started_states
from petmjx.engines.batch.recorder import Recorder
from petmjx.engines.batch.rules import Rules
from petmjx.engines.batch.setup import set_up_jax
from petmjx.engines.batch.stage import OVERFLOW_BITS, Queue, Stage, Stepper
from petmjx.engines.batch.state import NEVER, State, Status, Worlds, fresh_state, put_rows, upload_worlds, uploaded
from petmjx.engines.batch.timetable import Timetable, build_timetable
from petmjx.verdict import Flag, Outcome
from petmjx.world.job import Job

MAX_GROWTH = 8
"""Largest factor for buffers that overflow; they are doubled each time. A world that needs more is invalid."""

MAX_STAGES = 6
"""Most capacities of a run; each is compiled once."""

MAX_LANES = 1 << 16
MIN_LANES = 16
"""With fewer lanes than this, no useful amount of memory is saved."""

_put = jax.jit(put_rows)


@dataclass(frozen=True)
class StageKey:
    """What a compiled stage depends on. ``drive`` is "", "force" or "acceleration"."""

    sim: Simulation
    capacity: int
    lanes: int
    drive: str
    growth: int
    table_steps: int


@dataclass
class Run:
    """One run: what its groups have in common.

    ``capacities``: of the placement stages ("") and of the stages of each kind of drive, or by another key of the
    engine's own. ``lane_limit``: most lanes, lowered when device memory runs out.
    """

    sim: Simulation
    timetable: Timetable
    capacities: dict[str, list[int]]
    progress: Progress
    jobs: Sequence[Job] = ()
    """All jobs of the run, to which more may be appended: ``GrowingJobs``."""
    lane_limit: int = MAX_LANES


@dataclass
class Group:
    """Worlds that go through the stages together."""

    run: Run
    jobs: list[Job]
    worlds: Worlds
    table: State
    profiles: jax.Array
    profile_rows: dict[int, int]
    """``id`` of an excitation → its row in ``profiles``."""
    recorder: Recorder
    frames: dict[str, jax.Array] | None = None
    """Room for frames on the device, of engines that have some there."""

    def status(self) -> NDArray[np.int32]:
        """Statuses of the jobs' rows, on the host."""
        return np.asarray(self.table.status)[: len(self.jobs)]

    def handed_on(self, status: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which jobs are at their end, by the statuses of their rows."""
        return handed_on(status, self.driven)

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """Jobs with a drive."""
        return np.array([job.drive is not None for job in self.jobs], bool)

    def add(self, jobs: Sequence[Job], worlds: Worlds, table: State) -> None:
        """Put more jobs into the rows behind those that are taken. Tables have a row for each of them at least."""
        first, rows = len(self.jobs), np.full(len(table.status), len(self.table.status), np.int32)
        rows[: len(jobs)] = np.arange(first, first + len(jobs))
        self.worlds = _put(self.worlds, uploaded(rows), worlds)
        self.table = _put(self.table, uploaded(rows), table)
        self.jobs += jobs
        self.__dict__.pop("driven", None)  # is worked out anew

    def overflowed(self) -> NDArray[np.int64]:
        """Rows that a stage returned unchanged, because a buffer was too small."""
        flags = np.asarray(self.table.flags)[: len(self.jobs)]
        return np.flatnonzero((flags & OVERFLOW_BITS != 0) & (self.status() != Status.FINISHED))

    def retry(self, rows: NDArray[np.int64]) -> None:
        """Clear the overflow bits and set the bit for a re-run: in larger buffers the result is valid."""
        flags = (self.table.flags[rows] & ~OVERFLOW_BITS) | int(Flag.RERUN_AFTER_OVERFLOW)
        self.table = self.table._replace(flags=self.table.flags.at[rows].set(flags))

    def give_up(self, rows: NDArray[np.int64], flag: Flag) -> None:
        """End worlds that cannot be simulated on this device."""
        flags = self.table.flags.at[rows].set(self.table.flags[rows] | int(flag))
        self.table = self.table._replace(flags=flags, status=self.table.status.at[rows].set(Status.FINISHED))


class MjxEngine(ABC):
    """Simulates worlds in batches on one JAX device.

    Args:
        lanes: most worlds stepped side by side; fewer if there are fewer worlds, or if memory runs out.
        group_size: worlds whose states are on the device at the same time; it bounds memory for any number of jobs.
        capacities: fixed capacities, instead of capacities chosen from the plans (for tests).
        chunk_steps: steps between two looks at which lanes have finished.
        drain_share: when fewer than this share of a stage's lanes run, the stage ends, and its worlds continue in the
            next capacity. The last stage simulates all its worlds to their end.
    """

    name = "mjx"

    def __init__(
        self,
        lanes: int | None = None,
        *,
        group_size: int = GROUP_WORLDS["mjx-jax"],
        capacities: Sequence[int] | None = None,
        chunk_steps: int = 25,
        drain_share: float = 0.25,
    ) -> None:
        set_up_jax()
        self.lanes, self.capacities, self.group_size = lanes, capacities, group_size
        self.chunk_steps, self.drain_share = chunk_steps, drain_share
        self.stages: dict[StageKey, Stage] = {}
        """The stages that are compiled, and kept for later runs."""
        self._warm: set[Stage] = set()
        self._growth: dict[tuple[Cone, int], int] = {}
        self._running = RunLock(self.name)

    @abstractmethod
    def make_stepper(self, capacity: int, lanes: int, sim: Simulation, *, held: bool, growth: int) -> Stepper:
        """The stepper for a shape; ``growth`` multiplies the sizes of its contact and constraint buffers."""

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once. Outcomes come stage by stage, as worlds reach their end.

        Raises:
            RuntimeError: an earlier run of the same thread has not ended. (Runs of other threads are waited for.)
        """
        if not jobs:
            return
        progress = progress or Progress()
        first = 0
        with self._running:
            while first < len(jobs):  # more may have been appended
                rest = jobs[first:]
                timetable = build_timetable(sim, max(job.scene.n_boxes for job in rest))
                run = Run(sim, timetable, self._choose_capacities(rest, sim), progress, jobs)
                size = math.ceil(len(rest) / math.ceil(len(rest) / self.group_size))
                end = len(jobs)
                while first < end:
                    group = list(jobs[first : min(first + size, end)])
                    yield from self._run_group(run, group, first)
                    first += len(group)  # a group may have taken more

    def _choose_capacities(self, jobs: Sequence[Job], sim: Simulation) -> dict[str, list[int]]:
        """Capacities of the placement stages ("") and of the stages of each kind of drive."""
        sizes: dict[str, list[int]] = {}
        for job in jobs:
            for kind in ([""] if job.start is None else []) + ([job.drive.excitation.kind] if job.drive else []):
                sizes.setdefault(kind, []).append(job.scene.n_boxes)
        if self.capacities is not None:
            return {kind: list(self.capacities) for kind in sizes}
        grows = sim.check is Check.ONE_BY_ONE
        return {
            kind: (growing_capacities if grows and not kind else class_capacities)(found, MAX_STAGES)
            for kind, found in sizes.items()
        }

    def _run_group(self, run: Run, jobs: list[Job], first_job: int) -> Iterator[Outcome]:
        """Outcomes of a group of jobs, which may take more of the run's jobs behind them; these are appended to it."""
        group = self._load_group(run, jobs)
        emitted = np.zeros(len(jobs), bool)

        def finished() -> Iterator[Outcome]:
            rows = np.flatnonzero(group.handed_on(group.status()) & ~emitted)
            emitted[rows] = True
            picked = pick(rows, group.table, group.worlds, run.sim)
            yield from outcomes(rows, picked, jobs, first_job, run.sim, group.recorder)

        n_boxes = np.array([job.scene.n_boxes for job in jobs])
        for kind in sorted(run.capacities, key=("", "force", "acceleration").index):
            mine = np.array([not kind or (job.drive is not None and job.drive.excitation.kind == kind) for job in jobs])
            yield from self._run_stages(group, run.capacities[kind], kind, np.where(mine, n_boxes, NEVER), finished)

    def _load_group(self, run: Run, jobs: list[Job], most: int = 0) -> Group:
        """The tables of a group. ``most``: rows for as many jobs, if there are fewer now."""
        width = max(max(capacities) for capacities in run.capacities.values())
        excitations = {id(job.drive.excitation): job.drive.excitation for job in jobs if job.drive}
        steps = max([len(e.samples) for e in excitations.values()], default=1)
        profiles = np.zeros((max(len(excitations), 1), steps, 3), np.float32)
        for row, excitation in enumerate(excitations.values()):
            profiles[row, : len(excitation.samples)] = excitation.samples
        profile_rows = {key: row for row, key in enumerate(excitations)}
        rows = 1 << (max(len(jobs), most) - 1).bit_length()
        worlds, table = self._tables(run, jobs, rows, width, profile_rows)
        recorder = Recorder(jobs, run.sim.physics.timestep_s)
        return Group(run, jobs, worlds, table, uploaded(profiles), profile_rows, recorder)

    @staticmethod
    def _tables(
        run: Run, jobs: Sequence[Job], rows: int, width: int, profile_rows: dict[int, int]
    ) -> tuple[Worlds, State]:
        """Constants and first states of jobs, for tables of so many rows and box columns."""
        sim, timetable = run.sim, run.timetable
        worlds = upload_worlds(jobs, rows, width, profile_rows, sim.physics.timestep_s)
        static = sim.check is Check.STATIC
        ends = np.full(rows, NEVER, np.int32)
        if sim.schedule is Schedule.FIXED:
            for row, job in enumerate(jobs):
                if job.drive is None and not job.keep_state:
                    n = job.scene.n_boxes
                    ends[row] = timetable.static_end if static else timetable.one_by_one_end[n]
        fresh = fresh_state(worlds, all_placed=static, ends=uploaded(ends), rest_steps=timetable.rest_steps)
        return worlds, started_states(jobs, fresh)

    def _run_stages(
        self,
        group: Group,
        capacities: Sequence[int],
        drive: str,
        n_boxes: NDArray[np.int64],
        finished: Callable[[], Iterator[Outcome]],
    ) -> Iterator[Outcome]:
        """Run the stages one after the other. ``n_boxes`` is NEVER for worlds that do not belong to these stages."""
        grows = drive == "" and group.run.sim.check is Check.ONE_BY_ONE
        waiting = (Status.SETTLED, Status.RUNNING) if drive else (Status.READY, Status.RUNNING)
        for capacity in capacities:
            last = capacity == capacities[-1]
            status = group.status()
            fits = n_boxes < NEVER if grows else n_boxes <= capacity
            rows = np.flatnonzero(np.isin(status, waiting) & fits)
            if len(rows):
                self._run_stage(group, capacity, drive, rows, may_drain=not last)
                yield from finished()

    def _run_stage(self, group: Group, capacity: int, drive: str, rows: NDArray[np.int64], *, may_drain: bool) -> None:
        """Run a stage over some worlds, and again with larger buffers over those that overflowed."""
        run = group.run
        growth = self._growth.get((run.sim.physics.cone, capacity), 1)
        while len(rows):
            lanes = self._lane_count(run, capacity, len(rows))
            entered, marks = group.table, group.recorder.marks()
            try:
                stage = self._stage(group, capacity, lanes, drive, growth)
                self._drive_lanes(group, stage, rows, may_drain=may_drain)
                group.table.status.block_until_ready()  # what runs out of memory is known at the latest now
            except Exception as error:
                if not is_out_of_memory(error):
                    raise
                group.table = entered
                group.recorder.go_back(marks, rows.tolist())
                self.stages.clear()
                self._warm.clear()
                self.release()
                if lanes <= MIN_LANES:
                    group.give_up(rows, Flag.OUT_OF_MEMORY)
                    return
                run.lane_limit = lanes // 2
                run.progress.message = f"out of device memory with {lanes} lanes, again with {run.lane_limit}"
                continue
            rows = group.overflowed()
            group.recorder.go_back(marks, rows.tolist())
            self.release()
            if len(rows) == 0:
                return
            if growth >= MAX_GROWTH:
                group.give_up(rows, Flag.NONE)
                return
            growth *= 2
            self._growth[run.sim.physics.cone, capacity] = growth
            run.progress.message = f"{len(rows)} worlds overflowed their buffers, again with {growth}× as large ones"
            group.retry(rows)

    def release(self) -> None:  # noqa: B027 (most implementations hold nothing)
        """Free device memory that an implementation keeps between stages. Called when nothing runs."""

    def _lane_count(self, run: Run, capacity: int, n_worlds: int) -> int:
        """Lanes for a stage: a power of two, so that few shapes are compiled."""
        wanted = max(MIN_LANES, 1 << (n_worlds - 1).bit_length())
        limit: int = min(self.lanes or self.default_lanes(capacity), run.lane_limit)
        return min(wanted, limit)

    def default_lanes(self, capacity: int) -> int:
        """Number of lanes at a capacity, if the user gives none."""
        return 256

    def _stage(self, group: Group, capacity: int, lanes: int, drive: str, growth: int) -> Stage:
        sim, timetable = group.run.sim, group.run.timetable
        key = StageKey(sim, capacity, lanes, drive, growth, len(timetable.clock))
        if key not in self.stages:
            held = drive == "acceleration"
            begin = time.perf_counter()
            stepper = self.make_stepper(capacity, lanes, sim, held=held, growth=growth)
            rules = Rules(sim, timetable, capacity, driven=bool(drive))
            self.stages[key] = Stage(rules, stepper, sim.physics, lanes, self.chunk_steps, held=held)
            group.run.progress.compile_s += time.perf_counter() - begin
        return self.stages[key]

    def _drive_lanes(self, group: Group, stage: Stage, rows: NDArray[np.int64], *, may_drain: bool) -> None:
        """Run chunks and refill lanes until the stage's worlds are finished, or few enough run to end the stage.

        The counters that decide are one chunk old: the host starts the next chunk before it reads them, so that the
        device never waits for the host.
        """
        progress, capacity = group.run.progress, stage.rules.capacity
        padded = np.zeros(len(group.table.step), np.int32)
        padded[: len(rows)] = rows
        queue = Queue(jnp.asarray(padded), jnp.int32(len(rows)), jnp.int32(0))
        fresh = stage not in self._warm
        begin = time.perf_counter()
        chunks = lane_steps = 0
        # Placement needs no profiles. Their table would make it compile again for each new shape of the table.
        profiles = group.profiles if stage.rules.driven else jnp.zeros((1, 1, 3))
        if fresh:
            progress.message = f"compiling capacity {capacity} for {stage.lanes} lanes"
        lanes = stage.empty(group.worlds, group.table)
        lanes, table, queue, counters = stage.refill(lanes, group.table, group.worlds, queue)
        while True:
            lanes, trail = stage.run_chunk(lanes, profiles)
            if not group.recorder.idle:
                group.recorder.add_trail(trail)
            lanes, table, queue, following = stage.refill(lanes, table, group.worlds, queue)
            running, queued, contacts, constraint_rows, iterations, slowest = (int(n) for n in np.asarray(counters))
            counters = following
            if fresh:
                following.block_until_ready()
                self._warm.add(stage)
                progress.compile_s += time.perf_counter() - begin
                fresh = False
            progress.message = f"capacity {capacity}: {running} worlds running, {queued} waiting"
            progress.world_steps += running * stage.chunk_steps
            lane_steps += running * stage.chunk_steps
            chunks += 1
            if queued == 0 and (running == 0 or (may_drain and running < self.drain_share * stage.lanes)):
                break
        group.table = stage.unload(lanes, table)
        key = f"{stage.label} capacity {capacity}"
        seconds = time.perf_counter() - begin
        spent = {"seconds": seconds, "chunks": chunks, "lane-steps": lane_steps}
        spent |= {"iterations": iterations, "slowest iterations": slowest}
        for what, amount in spent.items():
            progress.extra[f"{key} {what}"] = progress.extra.get(f"{key} {what}", 0) + amount
        progress.extra[f"{key} lanes"] = stage.lanes
        for what, most in (("contacts", contacts), ("rows", constraint_rows)):
            progress.extra[f"{key} {what}"] = max(progress.extra.get(f"{key} {what}", 0), most)


def is_out_of_memory(error: Exception) -> bool:
    """Whether an error of JAX, XLA or Warp says that device memory ran out, or one of Python that the host's did."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or any(
        words in text for words in ("resource_exhausted", "out of memory", "failed to allocate")
    )
