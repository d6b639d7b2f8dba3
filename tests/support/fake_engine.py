"""An engine without physics, for tests of what is done with outcomes: a world in microseconds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from support.outcomes import make_outcome


class LargestFirst:
    """Simulates the largest plans first, as engines do. Plans with an even number of boxes do not stand.

    Args:
        interrupt_after: worlds after which it is interrupted.
    """

    name = "largest-first"

    def __init__(self, interrupt_after: int | None = None) -> None:
        self._left = interrupt_after

    @staticmethod
    def verdict(n_boxes: int) -> Verdict:
        return Verdict.STABLE if n_boxes % 2 else Verdict.UNSTABLE

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for job in sorted(range(len(jobs)), key=lambda job: (-jobs[job].scene.n_boxes, -job)):
            if self._left == 0:
                raise KeyboardInterrupt
            self._left = None if self._left is None else self._left - 1
            n = jobs[job].scene.n_boxes
            falls = self.verdict(n) is Verdict.UNSTABLE
            ending = {"reason": Reason.DROP, "culprit": n - 1, "first_sign_s": 0.5} if falls else {}
            yield replace(make_outcome(n, self.verdict(n), **ending), job=job)
