"""``JobStream``: a queue of the jobs (simulations) of a run, from which an engine takes jobs."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection, Iterable
from itertools import chain, islice
from typing import Any, Final, Generic, NamedTuple, TypeVar

from petmjx.world.job import Job

WAIT_S: Final = 0.25
"""Longest uninterrupted wait for a job, s. This wait may delay the reaction to a signal, such as Ctrl-C."""

Tag = TypeVar("Tag")


class JobBounds(NamedTuple):
    """Limits that hold for all jobs of a run. With these limits, an engine can reserve memory before it gets the jobs.

    Attributes:
        jobs: largest number of jobs that are ready at the same time.
        box_counts: all numbers of boxes that occur in the jobs' scenes.
        drive_steps: number of samples of the longest drive (motion of the carrier).
        excitations: number of different excitations (motions as arrays). If ``excitations`` is None, each world may
            have its own excitation.
        wraps: whether stretch film is around the boxes in some drives.
    """

    jobs: int
    box_counts: Collection[int]
    drive_steps: int
    excitations: int | None
    wraps: bool = False


class JobStream(Generic[Tag]):
    """The jobs of a run, in order. Each job has a tag, by which the run recognises the job's outcome. Thread-safe.

    One thread, the *source*, puts the jobs of the run's worlds into the stream, and waits while the stream is full. The
    thread that takes outcomes puts in the jobs that follow from outcomes, such as the drives of a settled pallet. The
    engine takes jobs that follow from outcomes first. So at any time, only few settled states wait in memory for their
    drives.

    The stream number of a job is the number of jobs that were taken before it since ``begin``.

    Args:
        most_boxes: ``put`` waits while the waiting jobs have at least this number of boxes in total.
        feedback: whether jobs may follow from outcomes.
        begin_with: number of jobs for which an engine that simulates many jobs at once should wait at first.
        bounds: limits that hold for all jobs, including those that follow from outcomes; None if the limits are
            unknown.
        stiff: values that ``Job.stiff`` may have, apart from None, in jobs that follow from outcomes.

    Attributes:
        in_flight: stream number → tag, for the jobs that were taken and have no outcome yet.
    """

    def __init__(
        self,
        *,
        most_boxes: int | None = None,
        feedback: bool = False,
        begin_with: int = 1,
        bounds: JobBounds | None = None,
        stiff: Collection[float] = (),
    ) -> None:
        self.feedback, self.begin_with, self.bounds = feedback, begin_with, bounds
        self.stiff = frozenset(stiff)
        self.in_flight: dict[int, Tag] = {}
        self._most_boxes = most_boxes
        self._following: deque[tuple[Job, Tag]] = deque()
        self._waiting: deque[tuple[Job, Tag]] = deque()
        self._boxes = self._taken = self._unfollowed = 0
        self._open, self._paused = True, False
        self._changed = threading.Condition()

    @classmethod
    def of(cls, jobs: Iterable[Job] | JobStream[Any]) -> JobStream[Any]:
        """A closed stream with the jobs of a list. If ``jobs`` is a stream already, it is returned unchanged."""
        if isinstance(jobs, JobStream):
            return jobs
        stream: JobStream[Any] = cls()
        for job in jobs:
            stream.put(job, None)
        stream.close()
        return stream

    def begin(self) -> None:
        """Begin an engine's run with the waiting jobs: stream numbers start at 0 again, and no job is in flight."""
        self.in_flight, self._taken, self._unfollowed = {}, 0, 0

    def put(self, job: Job, tag: Tag, *, bounded: bool = False) -> bool:
        """Add a job.

        Args:
            bounded: if True, the job comes from the source, and the call waits while the stream is full. If ``bounded``
                is False, the job follows from an outcome: the call never waits, and the job is taken before the jobs of
                the source.

        Returns:
            Whether the job was added. A closed stream accepts no jobs from the source.
        """
        with self._changed:
            while bounded and self._open and self._is_full:
                self._changed.wait()
            if self._open or not bounded:
                (self._waiting if bounded else self._following).append((job, tag))
                self._boxes += job.scene.n_boxes
                self._changed.notify_all()
            return self._open or not bounded

    def put_all(self, entries: Iterable[tuple[Job, Tag]]) -> None:
        """Add several jobs, which follow from outcomes, and their tags at once (see ``put``). An engine that waits for
        jobs gets all these jobs together."""
        with self._changed:
            for job, tag in entries:
                self._following.append((job, tag))
                self._boxes += job.scene.n_boxes
            self._changed.notify_all()

    def close(self) -> None:
        """Declare that the source has no more jobs. Jobs that follow from outcomes may still be put."""
        with self._changed:
            self._open = False
            self._changed.notify_all()

    def pause(self, paused: bool = True) -> None:
        """Declare whether the source is waiting for something other than the engine. While the source waits, ``take``
        does not wait for further jobs.
        """
        with self._changed:
            self._paused = paused
            self._changed.notify_all()

    def take(self, most: int, *, least: int = 1, wait: bool = True) -> list[Job]:
        """Take up to ``most`` jobs, in order.

        Args:
            least: wait until this number of jobs is ready, the stream is full, or the source has no more jobs.
            wait: if False, return an empty list instead of waiting.

        Returns:
            The jobs. If ``wait`` is True, an empty list means that no further jobs come, so that an engine without jobs
            in flight ends its run.
        """
        with self._changed:
            if not self._ready(least, wait):
                return []
            return [self._pop(self._following or self._waiting) for _ in range(min(most, self.ready))]

    def take_peeked(self, jobs: Iterable[Job]) -> None:
        """Take jobs that the last ``peek`` returned out of the stream. Jobs that were added after this ``peek`` stay in
        the stream.

        Args:
            jobs: the first of the jobs that ``peek`` returned, in the same order.
        """
        with self._changed:
            for job in jobs:
                follows = bool(self._following) and self._following[0][0] is job
                self._pop(self._following if follows else self._waiting)

    def peek(self, most: int, *, least: int = 1, wait: bool = False) -> list[Job]:
        """Return the jobs that ``take`` would return with these arguments, and leave them in the stream."""
        with self._changed:
            ready = chain(self._following, self._waiting) if self._ready(least, wait) else ()
            return [job for job, _ in islice(ready, most)]

    def wait_for(self, count: int) -> int:
        """Wait until ``count`` jobs are ready, the stream is full, or the source has no more jobs. Returns the number
        of ready jobs.
        """
        with self._changed:
            self._ready(count, True)
            return self.ready

    def answered(self, stream_number: int) -> Tag:
        """Note that the outcome of a job has arrived. Returns the job's tag.

        Raises:
            KeyError: the job is not in flight.
        """
        with self._changed:
            tag = self.in_flight.pop(stream_number)
            self._unfollowed += 1
            return tag

    def followed(self) -> None:
        """Declare that all jobs that follow from the outcomes so far have been put into the stream."""
        with self._changed:
            self._unfollowed = 0
            self._changed.notify_all()

    @property
    def all_followed(self) -> bool:
        """Whether all jobs that follow from the outcomes so far have been put into the stream."""
        return not self._unfollowed

    def wait_for_following(self, in_flight: Collection[int], left: Collection[int] = ()) -> bool:
        """Wait briefly for a job that follows from an outcome, or for a job that the source may put in only after an
        outcome. An engine without running worlds calls this method. In the thread that takes outcomes, the engine may
        call this method only if worlds have left the engine's device.

        Args:
            in_flight: stream numbers of the engine's jobs whose outcomes have not been taken. The thread that takes
                outcomes calls ``wake`` after each change of ``in_flight``.
            left: stream numbers of those jobs in ``in_flight`` whose worlds have left the device.

        Returns:
            Whether to wait again: no job is ready, and jobs may still come.
        """
        with self._changed:
            if self._may_follow(in_flight, left):
                self._changed.wait(WAIT_S)
            return self._may_follow(in_flight, left)

    def wake(self) -> None:
        """End all waits for jobs early."""
        with self._changed:
            self._changed.notify_all()

    @property
    def ready(self) -> int:
        """Number of jobs that wait in the stream."""
        return len(self._following) + len(self._waiting)

    @property
    def taken(self) -> int:
        """Number of jobs that have been taken since ``begin``."""
        return self._taken

    @property
    def closed(self) -> bool:
        """Whether the source has no more jobs."""
        return not self._open

    @property
    def ended(self) -> bool:
        """Whether no job is ready and none comes from the source."""
        with self._changed:
            return not self.ready and not self._comes

    @property
    def _comes(self) -> bool:
        return self._open and not self._paused

    def _may_follow(self, in_flight: Collection[int], left: Collection[int]) -> bool:
        """Whether no job is ready, but a job may still come. The job may follow from an outcome that has not been
        processed, or the source may put it in after the outcome of a world that has left the device."""
        if self.ready:
            return False
        return (self.feedback and bool(in_flight or self._unfollowed)) or (self._comes and bool(left))

    @property
    def _is_full(self) -> bool:
        return self._most_boxes is not None and self._boxes >= self._most_boxes

    def _ready(self, least: int, wait: bool) -> bool:
        """Whether jobs can be taken: ``least`` jobs are ready, the stream is full, or the source brings no more jobs
        for now. ``wait``: whether the call waits until jobs can be taken."""
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
