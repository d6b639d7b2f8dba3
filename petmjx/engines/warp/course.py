"""A run on the device: which groups of worlds come one after another, and what goes on from each to the next."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from petmjx.engines.base import Progress
from petmjx.engines.warp.ahead import Ahead
from petmjx.engines.warp.group import Run
from petmjx.engines.warp.groups import Groups
from petmjx.engines.warp.handover import Left
from petmjx.options.config import Simulation
from petmjx.world.job import Job


class Begun(NamedTuple):
    """A group that begins: its own jobs, and those that the one before has left, with their numbers in the run."""

    run: Run
    jobs: list[Job]
    numbers: list[int]
    left: Left | None = None


@dataclass(eq=False)
class Course:
    """The groups of a run.

    Attributes:
        most_left: worlds that a group may leave to the next one. 0: it leaves none.
        alone: whether there is one job in all.
        left: what the last group has left.
        ahead: tables of the next one.
        asked: number → job of those that have begun and have no outcome.
    """

    groups: Groups
    sim: Simulation
    progress: Progress
    most_left: int
    alone: bool
    left: Left | None = None
    ahead: Ahead = field(default_factory=Ahead)
    asked: dict[int, Job] = field(default_factory=dict)

    @property
    def waits_for_host(self) -> bool:
        """Whether each slice of the next group waits until the host has made outcomes of the one before: more jobs may
        follow from these, or the host takes frames of recorded worlds away."""
        return self.groups.grows or self.groups.recorded

    def next_run(self) -> Run:
        """Of the next group."""
        return Run.of(self.groups.needs, self.sim, self.progress)

    def next_is_due(self, rest: int, most: int, blocks: int) -> bool:
        """Whether the tables of the next group are to be made. Their rows are begun on the host as soon as it is known.

        Args:
            rest: worlds of this group that have not ended.
            most: of them then.
            blocks: of the device. While more worlds are left, rows that are not there yet are made beside it.
        """
        self.ahead.prepare(self.groups, self.sim)
        return 0 < rest <= most and bool(self.groups.following()) and (rest <= blocks or self.ahead.made)

    def begin(self) -> Begun:
        """The next group."""
        jobs = self.groups.take()
        numbers = list(range(self.groups.first, self.groups.first + len(jobs)))
        self.asked.update(zip(numbers, jobs, strict=True))
        run = self.next_run()  # after that: where memory runs out for it, these are lost, and not begun again for ever
        left, self.left = self.left, None
        if left is not None:
            jobs, numbers = jobs + left.jobs, numbers + left.numbers
        return Begun(run, jobs, numbers, left)

    def join(self, jobs: list[Job], numbers: list[int]) -> None:
        """Jobs that were waiting are in a group now."""
        numbers += range(self.groups.first + len(numbers), self.groups.first + len(numbers) + len(jobs))
        self.asked.update(zip(numbers[-len(jobs) :], jobs, strict=True))

    def lose(self) -> dict[int, Job]:
        """The jobs without an outcome, whose states are lost. They are not of this course any more."""
        lost, self.asked, self.left = self.asked, {}, None
        return lost

    def close(self) -> None:
        """Nothing more is prepared."""
        self.ahead.close()
