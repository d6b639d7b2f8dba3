"""The worlds that end in a time slice (one call of the kernels), and the outcomes that the CPU makes of them."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from threading import Lock
from typing import Final, NamedTuple

from petmjx.common.prefetch import prefetch
from petmjx.engines.mjx.frame_recorder import Recorder
from petmjx.engines.mjx.outcomes import outcomes
from petmjx.engines.mjx.readback import Readback
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.engines.warp.continued_worlds import ContinuedWorlds
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

MOST_AHEAD: Final = 40
"""Largest number of slices whose ended worlds may wait for the CPU: 4 s of a GPU's work. Each slice holds copies of the
rows of its ended worlds, padded to hundreds of rows. All slices together take 200 MB for plans of up to 76 boxes and
700 MB for 250 boxes. If slices hold several batches of ended worlds, these numbers are larger."""


class SliceResult(NamedTuple):
    """The worlds that have ended in a time slice.

    Attributes:
        picked: states and metrics of the ended worlds, on the device.
        recorder: object that holds the histories of recorded worlds.
        jobs: number of a table row → job of the ended world that was in this row. The row itself may already hold
            another world.
        stream_numbers: number of a table row → stream number of the job that ``jobs`` has for this row.
    """

    picked: Sequence[Readback]
    recorder: Recorder
    jobs: Mapping[int, Job]
    stream_numbers: Mapping[int, int]


def outcomes_of(
    slices: Generator[SliceResult],
    sim: Simulation,
    progress: Progress,
    *,
    waits: bool,
    continued: ContinuedWorlds | None = None,
) -> Iterator[Outcome]:
    """The outcomes of the worlds that end in these slices, with the stream numbers of their jobs.

    Args:
        waits: whether each slice waits for the outcomes of the previous slice. If slices do not wait, a thread runs
            them, since for small worlds the CPU may be slower than the device.
        continued: object that simulates worlds that have left the device, and is closed at the end; None if no world
            leaves the device.
    """
    counting, at_hand = Lock(), 0
    progress.at_hand = 0

    def count(more: int) -> None:
        nonlocal at_hand
        with counting:
            at_hand += more
            progress.at_hand = at_hand

    def counted() -> Generator[SliceResult]:
        with closing(slices):
            for next_slice in slices:
                count(sum(len(batch.rows) for batch in next_slice.picked))  # may be 0 if slices wait for the CPU
                yield next_slice

    try:
        with closing(counted() if waits else prefetch(counted(), most=MOST_AHEAD)) as ready_slices:
            for picked, recorder, jobs, stream_numbers in ready_slices:
                if progress.pauses and at_hand <= 0:
                    yield None  # type: ignore[misc]  # callers that set ``pauses`` expect it
                job_of = {stream_numbers[row]: job for row, job in jobs.items()} if continued is not None else {}
                for outcome in outcomes(picked, jobs, stream_numbers, sim, recorder):
                    count(-1)
                    if continued is None or not continued.take(job_of[outcome.job], outcome):
                        yield outcome
                if continued is not None:
                    yield from continued.ended()
        if continued is not None:
            yield from continued.last()
    finally:
        progress.at_hand = None  # no outcome follows after an error
        if continued is not None:
            continued.close()
