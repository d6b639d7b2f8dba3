"""Engine ``mjx-warp``: simulates worlds in NVIDIA Warp's kernels, each world at its own pace. The fastest engine."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from functools import partial
from typing import Any

from petmjx.common.errors import EngineUnavailable, is_out_of_memory
from petmjx.common.machine import why_no_warp
from petmjx.common.units import FloatArray
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mjx.host_to_device import load
from petmjx.engines.mjx.jax_setup import set_up_jax
from petmjx.engines.mjx.padded_sizes import GRANULE
from petmjx.engines.open_world_protocol import MOST_BOXES
from petmjx.engines.protocol import GPU_WORLDS, Capability, Engine, Progress, RunLock, says_at_hand, takes_stream
from petmjx.engines.verdict import Outcome
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool_choice import BlockPools
from petmjx.engines.warp.block_queues import Queues
from petmjx.engines.warp.equal_beginnings import beginnings
from petmjx.engines.warp.free_bodies import paths
from petmjx.engines.warp.kernel_features import KernelFeatures, queue_of
from petmjx.engines.warp.long_worlds import LongWorlds
from petmjx.engines.warp.memory_shortage import KeptRollouts, smaller_parts
from petmjx.engines.warp.open_worlds import WarpWorlds
from petmjx.engines.warp.table_jobs import TableJobs
from petmjx.engines.warp.time_slices import SliceResult, TableSlices, outcomes_of
from petmjx.engines.warp.world_table import TableRun, WorldTable
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job
from petmjx.world.scene import Scene

GPU_SLICE_NS = 100_000_000
"""Length of a time slice (one call of the kernels) on a GPU, ns. With longer slices, the CPU waits for worlds; with
shorter slices, the GPU waits for calls."""


class MjxWarpEngine(Engine):
    """Simulates worlds in Warp's kernels, each world at its own pace in a thread block
    (petmjx/engines/warp/kernel_launcher.py).

    The only solver of this engine is Newton's method. C MuJoCo makes the attempts that need another solver
    (petmjx/engines/attempt_settings.py).

    Args:
        lanes: largest number of worlds that run at the same time in blocks of one size (``block_sizes.Size``). If
            ``lanes`` is None, the limit is the number for which the device has room.
        allow_cpu: whether to run Warp's kernels on the CPU if there is no CUDA device. Running on the CPU is slow, and
            meant for tests.
        most_rows: largest number of worlds whose states are on the device at the same time. ``most_rows`` limits the
            memory, whatever the number of jobs.
        slice_ns: length of a time slice (one call of the kernels), ns. After each slice, the CPU reads which worlds
            have ended.

    Attributes:
        granule: the number of box columns of tables is a multiple of this number.
        least_rows: smallest number of rows of a table. Programs are compiled anew for each size of a table, that is,
            for each number of rows and of box columns. So a larger ``least_rows`` saves compilations in long runs that
            begin with few jobs, and in series of runs with different numbers of jobs.
        depth_first: whether worlds that follow from outcomes, such as the drives of a settled pallet, are simulated
            before other worlds begin. On a GPU, the value is False, so that the longest of all worlds come first: if
            long worlds came last, many blocks would be idle.

    Raises:
        EngineUnavailable: there is no CUDA device, or Warp is not installed. The message names the reason.
    """

    name = "mjx-warp"
    depth_first = False

    def __init__(
        self,
        lanes: int | None = None,
        *,
        allow_cpu: bool = False,
        most_rows: int = GPU_WORLDS,
        slice_ns: int = GPU_SLICE_NS,
    ) -> None:
        problem = None if allow_cpu else why_no_warp()
        if problem:
            raise EngineUnavailable(f"engine mjx-warp cannot run here: {problem}")
        set_up_warp()
        set_up_jax()
        self.lanes, self.most_rows, self.slice_ns = lanes, most_rows, slice_ns
        self.granule, self.least_rows = GRANULE, 0
        self._running = RunLock(self.name)
        self._pools = BlockPools(lanes, self._blocks)
        self._rollouts = KeptRollouts(self._pools)

    def open(self, scenes: Sequence[Scene], sim: Simulation, most_boxes: int = MOST_BOXES) -> WarpWorlds:
        """See ``Engine.open``."""
        return WarpWorlds(scenes, sim, most_boxes)

    @property
    def capabilities(self) -> Capability:
        """See ``Engine.capabilities``."""
        return super().capabilities | Capability.PAUSES

    def beginnings(self, scenes: Sequence[Scene], sim: Simulation) -> list[list[bytes]]:
        """See ``Engine.beginnings``."""
        return beginnings(scenes, sim)

    def paths(self, bodies: FreeBodies, sim: Simulation) -> FloatArray:
        """See ``Engine.paths``."""
        with self._running:
            return paths(bodies, sim, self._blocks, self.slice_ns, self.most_rows)

    def _long_worlds(self, sim: Simulation, progress: Progress) -> LongWorlds | None:
        """An object that takes long worlds from this engine, and simulates them to their ends. If the result is None,
        this engine simulates all worlds to their ends."""
        return None

    @says_at_hand
    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        """Simulate each job once. An outcome is yielded when its world ends.

        Raises:
            RuntimeError: an earlier run of the same thread has not ended. (If a run of another thread has not ended,
                the call waits for it.)
        """
        stream = JobStream.of(jobs)
        if stream.ended:
            return
        with self._running:
            yield from self._outcomes(self._table_jobs(stream), sim, progress or Progress())

    def _table_jobs(self, stream: JobStream[Any]) -> TableJobs:
        return TableJobs(stream, self.most_rows, self.least_rows, self.granule, depth_first=self.depth_first)

    def _outcomes(self, source: TableJobs, sim: Simulation, progress: Progress) -> Iterator[Outcome]:
        """The outcomes of all jobs of a source, with the stream numbers of the jobs."""
        while not source.ended:
            waits = source.recorded
            continued = self._long_worlds(sim, progress)
            slices = self._slices(source, sim, progress, waits, continued)
            try:
                for outcome in outcomes_of(slices, sim, progress, waits=waits, continued=continued):
                    stream_number = outcome.job if outcome is not None else None  # None means that the engine pauses
                    yield outcome
                    if stream_number is not None:  # by now, the jobs that follow from this outcome are in the stream
                        source.answered(stream_number)
            except Exception as error:
                if not is_out_of_memory(error):
                    raise
            else:
                continue
            self._rollouts.drop()
            # The following call is outside the ``except`` block, in which the traceback would keep the tables in
            # memory.
            yield from self._again(source, sim, progress)

    def _again(self, source: TableJobs, sim: Simulation, progress: Progress) -> Iterator[Outcome]:
        """After memory ran out and the states of all worlds were lost, simulate the jobs without an outcome again. The
        jobs are divided into parts (``smaller_parts``), which are simulated one after another. A job that already had
        the device to itself is given up."""
        lost = source.lose()
        if source.alone and lost:
            needs = KernelFeatures.of([*lost.values()], self.granule)
            table = self._load(TableRun.of(needs, sim, progress), [*lost.values()], [*lost], 1)
            yield from outcomes_of(
                self._slices_of(table, source, waits=True, simulate=False), sim, progress, waits=True
            )
            return
        for part in smaller_parts(lost):
            progress.message = f"out of device memory: trying again with {len(part)} of the worlds"
            jobs = self._table_jobs(JobStream.of([lost[stream_number] for stream_number in part.tolist()]))
            for outcome in self._outcomes(jobs, sim, progress):
                if outcome is not None:
                    outcome.job = int(part[outcome.job])
                yield outcome

    def _slices(
        self,
        source: TableJobs,
        sim: Simulation,
        progress: Progress,
        waits: bool,
        continued: LongWorlds | None,
    ) -> Generator[SliceResult]:
        """The ended worlds of one table after another. The iteration stops before the first table whose time slices
        need the other value of ``waits``.

        Args:
            waits: whether each time slice waits for the CPU, as it must if worlds are recorded.
            continued: object that simulates the worlds that leave the device; None if no world leaves it.
        """
        is_first = True
        while not source.ended and source.recorded == waits:
            jobs, stream_numbers, rows = source.begin()
            running, source.running = source.running, None
            room = source.profile_room(jobs, rows)
            if continued is not None and is_first:
                # The calling thread uses ``continued`` only after the first slice, so this thread may use it here.
                continued.prepare(jobs)
            is_first = False
            run = TableRun.of(source.needs, sim, progress, long_leave=continued is not None)
            table = self._load(run, jobs, stream_numbers, rows, room)
            if running is not None:
                table.put_running(running)
                running = None  # deleting these arrays frees their memory for the simulation
            yield from self._slices_of(table, source, waits=waits)
            del table  # the next table needs this memory

    def _load(
        self,
        run: TableRun,
        jobs: list[Job],
        stream_numbers: list[int],
        rows: int,
        profile_room: tuple[int, int] = (0, 0),
    ) -> WorldTable:
        """A table of worlds on the device.

        Args:
            rows: number of rows.
            profile_room: see ``load``.
        """
        batch = load(jobs, rows, run.needs.most_boxes, run.sim, run.timetable, profile_room)
        batch.worlds = run.with_most_steps(batch.worlds, jobs)
        return WorldTable(**vars(batch), run=run, stream_numbers=stream_numbers)

    def _slices_of(
        self, table: WorldTable, source: TableJobs, *, waits: bool, simulate: bool = True
    ) -> Generator[SliceResult]:
        """The ended worlds of each time slice of a table (``TableSlices``). After an error, the buffers that the engine
        keeps for its next run are freed."""
        queues = Queues(table.run.needs.queues, queue_of, table.rows, depth_first=self.depth_first)
        rollout_for = partial(self._rollouts.of, slice_ns=self.slice_ns)
        slices = TableSlices(table, source, queues, waits, self._pools, rollout_for)
        try:
            yield from slices.results(simulate=simulate)
        except BaseException:
            self._rollouts.drop()  # the buffers that a failed call received can no longer be used
            raise

    def _blocks(self, launch: Launch) -> int:
        """The number of blocks of a launch, at most ``lanes``."""
        return min(self.lanes or launch.blocks, launch.blocks)
