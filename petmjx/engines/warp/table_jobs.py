"""``TableJobs`` moves the jobs of a run from a ``JobStream`` into the rows of a table of worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any, Final

from petmjx.engines.job_stream import JobStream
from petmjx.engines.mjx.padded_sizes import padded_rows, round_up
from petmjx.engines.warp.block_launch import Features
from petmjx.engines.warp.block_sizes import MAX_BOXES, SIZES
from petmjx.engines.warp.kernel_features import KernelFeatures, widths_of
from petmjx.engines.warp.world_table import RunningWorlds, WorldTable
from petmjx.world.job import Job

SPARE_ROWS: Final = 4
"""A table begins with this number of rows for each of its first jobs, if jobs may follow from outcomes."""

WAITING_ROWS: Final = 8
"""A table begins with this number of rows for each of its first jobs, if more jobs may come, but none that follow from
outcomes. Thread blocks begin with the longest worlds of the table. So the more worlds wait in the table, the shorter
are the worlds that are simulated last. A GPU begins with 1,600 worlds, and 12,800 rows are enough for all worlds
of a run of 10,000 plans."""

LEAST_FOLLOWING_ROWS: Final = 2048
"""Smallest number of rows of a table that further jobs may join later, such as the many drives that follow a single
placement. (A drive is a motion of the carrier.) If the stream has fewer jobs in all, the table has only as many rows as
jobs. A GPU runs fewer than 1,024 thread blocks at the same time, so the table has at least two rows per block."""

MOST_JOINING: Final = 256
"""Largest number of jobs that join a table between two time slices (calls of the kernels). Joining takes about 50 ms,
less than a time slice. With 512 jobs, the CPU needed more time between two slices than the device needed for a slice.
"""

REFILL_SHARE: Final = 2
"""New jobs join a table only while ``MOST_JOINING`` rows are free, so that many jobs join together. In a smaller table,
new jobs join while one in ``REFILL_SHARE`` rows is free. Jobs that follow from outcomes, such as the drives that start
from a settled placement, join at once."""

JOIN_ROWS, FEEDBACK_ROWS = 256, 64
"""Number of jobs that one call of a compiled program writes into a table: ``FEEDBACK_ROWS`` if the jobs follow from
outcomes and are no more than this number, otherwise ``JOIN_ROWS``. Four calls for 64 jobs each take twice as long as
one call for 256 jobs."""

MOST_PROFILE_BYTES: Final = 1 << 30
"""Largest memory for the profiles (motions of the carrier) of the drives that follow from settled placements, bytes.
1 GiB has room for 7,000 different profiles of 20 s. A world whose profile finds no room waits until no running world
needs one of the stored profiles."""

_SAMPLE_BYTES: Final = 3 * 4

LARGE_GRANULE: Final = 64
"""If larger plans may follow, a table's number of columns for boxes is rounded up to a multiple of this number, in all
block sizes but the smallest."""


class TableJobs:
    """Takes the jobs of a stream for one table, and for further tables if the first has no room for them.

    Args:
        size: largest number of rows of a table.
        least_rows: smallest number of rows of a table.
        granule: see ``KernelFeatures.of``.
        depth_first: whether jobs that follow from outcomes begin at once. The kernels of the first table then also have
            the features that these jobs need.

    Attributes:
        needs: features that the kernels of the latest table need.
        alone: whether there is only one job in total.
        running: worlds of the previous table, which continue in the next table.
        in_flight: stream number → job, for jobs that have been taken and have no outcome yet.
        left: stream numbers of those jobs in ``in_flight`` whose worlds have left the device.
    """

    def __init__(
        self, stream: JobStream[Any], size: int, least_rows: int, granule: int, *, depth_first: bool = False
    ) -> None:
        self.needs, self.in_flight = KernelFeatures({}), dict[int, Job]()
        self.alone = stream.closed and stream.ready == 1 and not stream.feedback
        self.left = set[int]()
        self.running: RunningWorlds | None = None
        self._stream, self._size, self._least_rows, self._granule = stream, size, least_rows, granule
        self._depth_first = depth_first
        self._begun, self._taken = False, 0

    @property
    def feedback(self) -> bool:
        """Whether the caller may put jobs that follow from outcomes into the stream."""
        return self._stream.feedback

    @property
    def ended(self) -> bool:
        """Whether no job waits, no further jobs come, and no world is about to move to another table. If no job waits,
        the call waits until the stream has a job or ends.
        """
        return self.running is None and not self._stream.peek(1, wait=True)

    @property
    def recorded(self) -> bool:
        """Whether a world of the next table is recorded."""
        return any(job.record is not None for job in self._stream.peek(self._size))

    def begin(self) -> tuple[list[Job], list[int], int]:
        """The jobs of the next table (the jobs of running worlds come first), their stream numbers, and the number of
        rows.

        Raises:
            InputError: a job has more boxes than the largest block has room for.
        """
        jobs, stream_numbers = list[Job](), list[int]()
        if self.running is not None:
            jobs, stream_numbers, _ = self.running
        room = self._size - len(jobs)
        least = min(1 if self._begun else self._stream.begin_with, room)
        further = self._stream.peek(room, least=least, wait=not jobs)
        every = [*jobs, *further]
        grows = self.feedback or not self._stream.closed or self._stream.ready > len(further)
        # If further jobs may join a table, it has columns for their boxes from the beginning, since programs are
        # compiled for each width.
        needs = KernelFeatures.of(every, self._granule) | KernelFeatures({}, stiff=self._stream.stiff)
        if grows and self._stream.bounds is not None:
            counts = [count for count in self._stream.bounds.box_counts if count <= MAX_BOXES]
            wraps = self._depth_first and self._stream.bounds.wraps
            needs |= KernelFeatures(widths_of(counts, self._granule), Features(wraps=wraps))
        elif grows and not self.feedback:
            needs = _roomy(needs | self.needs)
        self.needs, self._begun = needs, True
        taken = self._take(further)
        rows = (SPARE_ROWS if self.feedback else WAITING_ROWS) * len(every) if grows else 0
        if grows and (bounds := self._stream.bounds) is not None:
            rows = min(max(rows, LEAST_FOLLOWING_ROWS), bounds.jobs)
        rows = min(max(rows, self._least_rows), self._size)
        return every, [*stream_numbers, *taken], padded_rows(max(len(every), rows))

    def profile_room(self, jobs: Sequence[Job], rows: int) -> tuple[int, int]:
        """The room for profiles in a table with these jobs and this number of rows: the number of profiles, and the
        number of steps of each profile.
        """
        bounds = self._stream.bounds
        if bounds is not None and bounds.drive_steps:
            most = MOST_PROFILE_BYTES // (bounds.drive_steps * _SAMPLE_BYTES)
            return min(rows, most, rows if bounds.excitations is None else bounds.excitations), bounds.drive_steps
        spare = SPARE_ROWS if rows >= SPARE_ROWS * len(jobs) else 1
        return spare * len({id(job.drive.excitation) for job in jobs if job.drive}), 0

    def join(self, table: WorldTable, *, wait: bool = False) -> list[int]:
        """Put waiting jobs into free rows of a table, in order, up to the first job that does not fit. Returns the
        numbers of the rows.

        Args:
            wait: whether to wait for a job if further jobs may come.
        """
        free = min(table.rows, self._size) - int(table.live.sum())
        if free < (1 if self.feedback else min(MOST_JOINING, table.rows // REFILL_SHARE)):
            return []
        most = free if self.feedback else min(free, MOST_JOINING)
        fitting = list(takewhile(table.fits, self._stream.peek(most, wait=wait)))
        if not fitting:
            return []
        stream_numbers = range(self._taken, self._taken + len(fitting))
        at_once = FEEDBACK_ROWS if self.feedback and len(fitting) <= FEEDBACK_ROWS else JOIN_ROWS
        rows: list[int] = table.add(fitting, stream_numbers, at_once).tolist()
        self._take(fitting[: len(rows)])
        return rows

    def needs_another(self, table: WorldTable, blocks: int) -> bool:
        """Whether another table is needed: the next job does not fit in this table, and the number of running worlds is
        at most the number of the device's blocks.

        Args:
            blocks: number of thread blocks of the device.
        """
        live = int(table.live.sum())
        waiting = self._stream.peek(1)
        if not waiting or live == 0 or live > blocks:
            return False
        (job,) = waiting
        # a plan that is too large, or recorded, waits until all outcomes before it have been taken
        apart = job.scene.n_boxes > MAX_BOXES or job.record is not None or not table.recorder.idle
        return not apart and not table.fits(job)

    def wait_for_following(self) -> bool:
        """See ``JobStream.wait_for_following``."""
        return self._stream.wait_for_following(self.in_flight, self.left)

    def answered(self, stream_number: int) -> None:
        """Record that the caller has taken the outcome of a job, and has put the jobs that follow from this outcome
        into the stream."""
        del self.in_flight[stream_number]
        self.left.discard(stream_number)
        self._stream.wake()

    def lose(self) -> dict[int, Job]:
        """Remove all jobs without an outcome, whose states are lost, and return them by stream number."""
        lost, self.in_flight, self.left, self.running = self.in_flight, {}, set(), None
        return lost

    def _take(self, jobs: Sequence[Job]) -> Sequence[int]:
        """Take the first jobs of the stream. Returns their stream numbers."""
        stream_numbers = range(self._taken, self._taken + len(jobs))
        self._stream.take_peeked(jobs)
        self.in_flight.update(zip(stream_numbers, jobs, strict=True))
        self._taken += len(jobs)
        return stream_numbers


def _roomy(needs: KernelFeatures) -> KernelFeatures:
    """The same features and block sizes, but with more columns for boxes in each block size, since larger plans may
    follow."""
    small = SIZES[0].most_boxes
    widths = {
        size: size if size == small else min(round_up(width, LARGE_GRANULE), size)
        for size, width in needs.widths.items()
    }
    return replace(needs, widths=widths)
