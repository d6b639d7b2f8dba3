"""What a group of worlds gives after each time slice, and the outcomes that the host makes of it."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from threading import Lock
from typing import Final, NamedTuple

from petmjx.common.prefetch import prefetch
from petmjx.engines.mjx.frame_recorder import Recorder
from petmjx.engines.mjx.outcomes import outcomes
from petmjx.engines.mjx.readback import Readback
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

MOST_AHEAD: Final = 40
"""Slices whose worlds may wait for the host: 4 s of a GPU. They are copies of a group's rows, those of a slice filled
up to hundreds: 200 MB for plans of up to 76 boxes, 700 MB for 250; more where so many end in a slice that it has
several batches."""


class SliceResult(NamedTuple):
    """The worlds that have ended in a time slice.

    Attributes:
        picked: their rows of a group, states and metrics, on the device.
        recorder: has their histories.
        jobs, numbers: of all worlds of the group, and their numbers in the run.
    """

    picked: Sequence[Readback]
    recorder: Recorder
    jobs: Sequence[Job]
    numbers: Sequence[int]


def outcomes_of(
    rounds: Generator[SliceResult], sim: Simulation, progress: Progress, *, waits: bool
) -> Iterator[Outcome]:
    """The outcomes of worlds, with their numbers in the run.

    Args:
        waits: each slice waits for them. Else a thread runs the slices: the host may take longer for small worlds than
            the device.
    """
    counting, at_hand = Lock(), 0
    progress.at_hand = 0

    def count(more: int) -> None:
        nonlocal at_hand
        with counting:
            at_hand += more
            progress.at_hand = at_hand

    def counted() -> Generator[SliceResult]:
        with closing(rounds):
            for next_round in rounds:
                count(sum(len(batch.rows) for batch in next_round.picked))  # a slice that waits may have none
                yield next_round

    try:
        with closing(counted() if waits else prefetch(counted(), MOST_AHEAD)) as each_slice:
            for picked, recorder, jobs, numbers in each_slice:
                if progress.pauses and at_hand <= 0:
                    yield None  # type: ignore[misc]  # who asked for pauses takes it
                for outcome in outcomes(picked, jobs, sim, recorder):
                    outcome.job = numbers[outcome.job]
                    count(-1)
                    yield outcome
    finally:
        progress.at_hand = None  # after an error none follows
