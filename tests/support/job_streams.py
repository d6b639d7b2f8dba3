"""Streams of jobs for tests of engines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from petmjx.engines.job_stream import JobStream
from petmjx.world.job import Job


def feedback_stream(jobs: Iterable[Job]) -> JobStream[Any]:
    """A stream with these jobs, into which a test puts further jobs that follow from outcomes."""
    stream = JobStream[Any](feedback=True)
    put(stream, *jobs)
    stream.close()
    return stream


def put(stream: JobStream[Any], *jobs: Job) -> None:
    """Put jobs into a stream as jobs that follow from outcomes."""
    for job in jobs:
        stream.put(job, None)


class LateStream(JobStream[Any]):
    """A stream with some jobs at once. The other jobs come when an engine has asked for jobs ``looks`` times without
    getting any, or waits for jobs."""

    def __init__(self, jobs: Sequence[Job], late: Sequence[Job], looks: int = 3) -> None:
        super().__init__(begin_with=len(jobs))
        self._late, self._looks = late, looks
        put(self, *jobs)

    def peek(self, most: int, *, least: int = 1, wait: bool = False) -> list[Job]:
        if self.ready < least and not self.closed:
            if wait or not self._looks:
                put(self, *self._late)
                self.close()
            self._looks -= 1
        return super().peek(most, least=least, wait=wait)
