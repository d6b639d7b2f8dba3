"""Groups of worlds go through stages: hand-over between capacities, outcomes as they come."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from petmjx.config import Check, Cone, Simulation
from petmjx.engines.base import GROUP_WORLDS
from petmjx.engines.batch.capacities import class_capacities, growing_capacities
from petmjx.engines.batch.groups import MAX_GROWTH, MIN_LANES, Group, GroupEngine, Run, is_out_of_memory
from petmjx.engines.batch.outcomes import outcomes, pick
from petmjx.engines.batch.rules import Rules
from petmjx.engines.batch.stage import Queue, Stage, Stepper
from petmjx.engines.batch.state import NEVER, Status
from petmjx.verdict import Flag, Outcome
from petmjx.world.job import Job

MAX_STAGES = 6
"""Most capacities of a run; each is compiled once."""

DEFAULT_LANES = 256
"""Number of lanes of a stage, if the user gives none."""


@dataclass(frozen=True)
class StageKey:
    """What a compiled stage depends on. ``drive`` is "", "force" or "acceleration"."""

    sim: Simulation
    capacity: int
    boards: int
    lanes: int
    drive: str
    growth: int
    table_steps: int


class StageEngine(GroupEngine):
    """Simulates worlds side by side, in stages of padded models.

    Args:
        lanes: most worlds stepped side by side; fewer if there are fewer worlds, or if memory runs out.
        group_size: worlds whose states are on the device at the same time; it bounds memory for any number of jobs.
        capacities: fixed capacities, instead of capacities chosen from the plans (for tests).
        chunk_steps: steps between two looks at which lanes have finished.
        drain_share: when fewer than this share of a stage's lanes run, the stage ends, and its worlds continue in the
            next capacity. The last stage simulates all its worlds to their end.
    """

    def __init__(
        self,
        lanes: int | None = None,
        *,
        group_size: int = GROUP_WORLDS["mjx-jax"],
        capacities: Sequence[int] | None = None,
        chunk_steps: int = 25,
        drain_share: float = 0.25,
    ) -> None:
        super().__init__(lanes, group_size)
        self.capacities, self.chunk_steps, self.drain_share = capacities, chunk_steps, drain_share
        self.stages: dict[StageKey, Stage] = {}
        """The stages that are compiled, and kept for later runs."""
        self._warm: set[Stage] = set()
        self._growth: dict[tuple[Cone, int], int] = {}

    @abstractmethod
    def make_stepper(
        self, capacity: int, boards: int, lanes: int, sim: Simulation, *, held: bool, growth: int
    ) -> Stepper:
        """The stepper for a shape; ``growth`` multiplies the sizes of its contact and constraint buffers."""

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
                if lanes <= MIN_LANES:
                    group.give_up(rows, Flag.OUT_OF_MEMORY)
                    return
                run.lane_limit = lanes // 2
                run.progress.message = f"out of device memory with {lanes} lanes, again with {run.lane_limit}"
                continue
            rows = group.overflowed()
            group.recorder.go_back(marks, rows.tolist())
            if len(rows) == 0:
                return
            if growth >= MAX_GROWTH:
                group.give_up(rows, Flag.NONE)
                return
            growth *= 2
            self._growth[run.sim.physics.cone, capacity] = growth
            run.progress.message = f"{len(rows)} worlds overflowed their buffers, again with {growth}× as large ones"
            group.retry(rows)

    def _lane_count(self, run: Run, capacity: int, n_worlds: int) -> int:
        """Lanes for a stage: a power of two, so that few shapes are compiled."""
        wanted = max(MIN_LANES, 1 << (n_worlds - 1).bit_length())
        return min(wanted, self.lanes or DEFAULT_LANES, run.lane_limit)

    def _stage(self, group: Group, capacity: int, lanes: int, drive: str, growth: int) -> Stage:
        sim, timetable = group.run.sim, group.run.timetable
        boards = group.boards
        if any(len(job.scene.carrier.half_size) != boards for job in group.jobs):
            raise ValueError("worlds of one run of mjx-jax need carriers with the same number of shapes")
        key = StageKey(sim, capacity, boards, lanes, drive, growth, len(timetable.clock))
        if key not in self.stages:
            held = drive == "acceleration"
            begin = time.perf_counter()
            stepper = self.make_stepper(capacity, boards, lanes, sim, held=held, growth=growth)
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
