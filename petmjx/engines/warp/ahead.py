"""The tables of the next group of worlds, begun by a thread while the device has the one before: it would wait."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

from petmjx.engines.batch.scene_rows import Rows, rows_of
from petmjx.engines.warp.groups import Groups
from petmjx.options.config import Simulation
from petmjx.world.job import Job


@dataclass(eq=False)
class Ahead:
    """Rows of some jobs' scenes, made before these are loaded. They are on the host: on the device they are loaded when
    the group before is down to its last worlds."""

    _thread: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "petmjx-tables"))
    _begun: tuple[Sequence[Job], int, Future[Rows]] | None = None

    def prepare(self, groups: Groups, sim: Simulation) -> None:
        """Begin the rows of the next group's jobs once these are known, with its box columns."""
        jobs = groups.following()
        if jobs and (self._begun is None or self._begun[0] is not jobs):
            width = groups.needs.of_sizes(jobs).most_boxes
            self._begun = jobs, width, self._thread.submit(rows_of, [job.scene for job in jobs], width, sim)

    @property
    def made(self) -> bool:
        """Whether rows have been begun and are there, or could not be made."""
        return self._begun is not None and self._begun[2].done()

    def take(self, jobs: Sequence[Job], width: int) -> Rows | None:
        """The rows of the first of some jobs, once; None if they have not been begun, or could not be made: whoever
        makes them then meets the error."""
        if self._begun is None:
            return None
        begun, columns, rows = self._begun
        same = columns == width and len(begun) <= len(jobs)
        if not same or any(one is not other for one, other in zip(begun, jobs, strict=False)):
            return None
        self._begun = None
        return None if rows.exception() is not None else rows.result()

    def close(self) -> None:
        """Nothing more is needed; rows that are being made are waited for."""
        self._begun = None
        self._thread.shutdown(cancel_futures=True)
