"""``JobStream``: the jobs of a run, on their way to an engine."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection, Iterable, Iterator
from itertools import chain, islice
from typing import Any, Final, Generic, NamedTuple, TypeVar

from petmjx.world.job import Job

WAIT_S: Final = 0.25
"""Longest wait without an interruption, s. A signal that arrives just before a wait is noticed only after it."""

Tag = TypeVar("Tag")


class JobBounds(NamedTuple):
    """Bounds of all jobs of a run, for an engine that makes room before they come.

    Attributes:
        jobs: largest number of jobs that are ready at the same time.
        box_counts: all numbers of boxes that the jobs' scenes have.
        drive_steps: samples of the longest drive.
        excitations: number of different excitations; None: as many as worlds.
        wraps: whether film is around the boxes of some drives.
    """

    jobs: int
    box_counts: Collection[int]
    drive_steps: int
    excitations: int | None
    wraps: bool = False


class JobStream(Generic[Tag]):
    """The jobs of a run in order. Each has a tag, by which the run recognises the job. Thread-safe.

    One thread puts the jobs of the run's worlds and waits while the stream is full. The thread that takes outcomes also
    puts the jobs that follow from outcomes. These jobs are taken first, so that few worlds are half done at any time,
    and few of their states wait in memory. An engine takes jobs when it has capacity.

    The stream number of a job is its place among the jobs that were taken since ``begin``.

    Args:
        most_boxes: ``put`` waits while the waiting jobs have at least this many boxes.
        feedback: whether jobs may follow from outcomes.
        begin_with: number of jobs for which an engine that simulates many at once should wait at first.
        bounds: bounds of all jobs, also of those that follow; None: unknown.

    Attributes:
        in_flight: stream number → tag of the jobs that were taken and have no outcome.
    """

    def __init__(
        self,
        *,
        most_boxes: int | None = None,
        feedback: bool = False,
        begin_with: int = 1,
        bounds: JobBounds | None = None,
    ) -> None:
        self.feedback, self.begin_with, self.bounds = feedback, begin_with, bounds
        self.in_flight: dict[int, Tag] = {}
        self._most_boxes = most_boxes
        self._following: deque[tuple[Job, Tag]] = deque()
        self._waiting: deque[tuple[Job, Tag]] = deque()
        self._boxes = self._taken = self._unfollowed = 0
        self._open, self._paused = True, False
        self._changed = threading.Condition()

    @classmethod
    def of(cls, jobs: Iterable[Job] | JobStream[Any]) -> JobStream[Any]:
        """A closed stream with a list of jobs. If ``jobs`` is a stream already, it is returned unchanged."""
        if isinstance(jobs, JobStream):
            return jobs
        stream: JobStream[Any] = cls()
        for job in jobs:
            stream.put(job, None)
        stream.close()
        return stream

    def begin(self) -> None:
        """Begin a run of an engine with the waiting jobs: stream numbers begin at 0, and no job is in flight."""
        self.in_flight, self._taken, self._unfollowed = {}, 0, 0

    def put(self, job: Job, tag: Tag, *, bounded: bool = False) -> bool:
        """Add a job.

        Args:
            bounded: wait while the stream is full, for jobs of the source. False: jobs that follow from outcomes never
                wait, and are taken before those of the source.

        Returns:
            Whether the stream was open. A closed stream takes no job.
        """
        with self._changed:
            while bounded and self._open and self._is_full:
                self._changed.wait()
            if self._open or not bounded:
                (self._waiting if bounded else self._following).append((job, tag))
                self._boxes += job.scene.n_boxes
                self._changed.notify_all()
            return self._open or not bounded

    def close(self) -> None:
        """Declare that no more jobs come from the source. Jobs that follow from outcomes may still come."""
        with self._changed:
            self._open = False
            self._changed.notify_all()

    def pause(self, paused: bool = True) -> None:
        """Declare whether the source waits for something other than the engine. Meanwhile, ``take`` does not wait for
        further jobs.
        """
        with self._changed:
            self._paused = paused
            self._changed.notify_all()

    def take(self, most: int, *, least: int = 1, wait: bool = True) -> list[Job]:
        """Take at most ``most`` jobs, in order.

        Args:
            least: wait until this many jobs are ready, the stream is full, or no job comes from the source.
            wait: False: return without a job instead of waiting.

        Returns:
            The jobs. With ``wait``, an empty list means the end of all jobs: an engine without jobs in flight ends its
            run.
        """
        with self._changed:
            if not self._ready(least, wait):
                return []
            return [self._pop(self._following or self._waiting) for _ in range(min(most, self.ready))]

    def take_peeked(self, jobs: Iterable[Job]) -> None:
        """Take the first jobs of the last ``peek``. Jobs that were added since then keep waiting."""
        with self._changed:
            for job in jobs:
                follows = bool(self._following) and self._following[0][0] is job
                self._pop(self._following if follows else self._waiting)

    def __iter__(self) -> Iterator[Job]:
        """Take one job after another, and wait for each."""
        while jobs := self.take(1):
            yield jobs[0]

    def peek(self, most: int, *, least: int = 1, wait: bool = False) -> list[Job]:
        """As ``take``, but the jobs stay in the stream."""
        with self._changed:
            ready = chain(self._following, self._waiting) if self._ready(least, wait) else ()
            return [job for job, _ in islice(ready, most)]

    def wait_for(self, count: int) -> int:
        """Wait as ``take`` for ``count`` jobs; returns the number of jobs that are ready."""
        with self._changed:
            self._ready(count, True)
            return self.ready

    def answered(self, stream_number: int) -> Tag:
        """Note that a job has its outcome. Returns the job's tag.

        Raises:
            KeyError: the job is not in flight.
        """
        with self._changed:
            tag = self.in_flight.pop(stream_number)
            self._unfollowed += 1
            return tag

    def followed(self) -> None:
        """Declare that the jobs that follow from all outcomes so far have been put."""
        with self._changed:
            self._unfollowed = 0
            self._changed.notify_all()

    def wait_for_following(self, in_flight: Collection[int]) -> bool:
        """Wait briefly for a job that follows from an outcome. Called by an engine without worlds, in a thread other
        than the one that takes its outcomes.

        Args:
            in_flight: stream numbers of the engine's jobs whose outcomes have not been taken. The thread that takes
                outcomes calls ``wake`` when it has changed them.

        Returns:
            Whether no job is ready, and jobs may still follow from outcomes.
        """
        with self._changed:
            if self._may_follow(in_flight):
                self._changed.wait(WAIT_S)
            return self._may_follow(in_flight)

    def wake(self) -> None:
        """End a wait for jobs early."""
        with self._changed:
            self._changed.notify_all()

    @property
    def ready(self) -> int:
        """Number of jobs that wait in the stream."""
        return len(self._following) + len(self._waiting)

    @property
    def taken(self) -> int:
        """Number of jobs that were taken since ``begin``."""
        return self._taken

    @property
    def closed(self) -> bool:
        """Whether no more jobs come from the source."""
        return not self._open

    @property
    def ended(self) -> bool:
        """Whether no job is ready, and the source has ended."""
        with self._changed:
            return not self.ready and not self._comes

    @property
    def _comes(self) -> bool:
        return self._open and not self._paused

    def _may_follow(self, in_flight: Collection[int]) -> bool:
        """Whether no job is ready, and an outcome is left from which jobs may follow."""
        return self.feedback and not self.ready and bool(in_flight or self._unfollowed)

    @property
    def _is_full(self) -> bool:
        return self._most_boxes is not None and self._boxes >= self._most_boxes

    def _ready(self, least: int, wait: bool) -> bool:
        """Whether ``least`` jobs are ready, or all jobs of the source."""
        while self.ready < least and self._comes and not self._is_full:
            if not wait:
                return False
            self._changed.wait(WAIT_S)
        return True

    def _pop(self, entries: deque[tuple[Job, Tag]]) -> Job:
        job, tag = entries.popleft()
        self._boxes -= job.scene.n_boxes
        self.in_flight[self._taken] = tag
        self._taken += 1
        self._changed.notify_all()
        return job
