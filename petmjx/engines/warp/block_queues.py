"""Queues of worlds, one for each kind of blocks. Thread blocks take their worlds from these queues."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from time import perf_counter
from typing import Final

import jax
import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

from petmjx.engines.cost_model import MEASURED
from petmjx.engines.mjx.world_constants import device_array
from petmjx.options.simulation import Simulation
from petmjx.world.edge_distances import EdgeRisk, edge_risks
from petmjx.world.job import Job

EXAMINED_AT_ONCE: Final = 32
"""Number of worlds whose loads are examined together (``Queues.examine``). Examining a world takes 0.15 ms for a
generated plan, and 6 ms for 96 boxes that each lie on several others."""

EXAMINING_S: Final = 0.015
"""Longest time, s, for which worlds are examined between two time slices, which take 0.1 s each. So the device need not
wait, and other threads get Python's lock. When up to 256 worlds were examined between two slices, 10,003 plans took the
device a second longer."""


class Queues:
    """The queues of worlds. The following three rules give the order of worlds in each queue. A later rule takes
    precedence over an earlier one.

    First, worlds with a longer expected time come earlier, so that a run ends with short worlds. Second, worlds in
    which a load acts beyond or near an edge, according to a quick test of statics (``EdgeRisk``), come before worlds
    without such loads. A run then ends with worlds that stand. How long a collapse takes cannot be predicted, so worlds
    that may collapse begin early. (Of 10,003 generated plans, 42 took more than 5,000 steps, and 40 of these were among
    the 4,279 plans with a load beyond an edge.) Besides, worlds that fall may be simulated again with stiffer contacts,
    which takes up to ten seconds on a CPU thread. A second simulation is likely if a load acts near an edge, so worlds
    with a load near an edge come before worlds with a load beyond an edge.

    Third, worlds that have completed a leg of a chain (a part of a journey) come before all others. Among them, the
    world that was queued last comes first. So chains end one after another during the whole run, and the CPU writes
    their results during the simulation. If worlds were sorted by expected time alone, the short last legs of all chains
    would come at the end of the run.

    Args:
        queues: the queues, in order (``kernel_features.Queue``).
        queue_of: function that returns the queue of a job's world.
        rows: number of rows of the table of worlds.
        depth_first: whether worlds that start from another world's state come before all others.
    """

    def __init__(
        self, queues: Sequence[Hashable], queue_of: Callable[[Job], Hashable], rows: int, *, depth_first: bool = False
    ) -> None:
        self._queues, self._queue_of, self._depth_first = queues, queue_of, depth_first
        self._queue, self._cost = np.zeros(rows, np.int64), np.zeros(rows)
        self._turn = np.zeros(rows, np.int64)
        """Rank of the world in each row: smaller ranks come first. Most worlds have the rank 0; worlds that come before
        these have negative ranks."""
        self._risk = np.zeros(rows, np.int8)
        """``EdgeRisk`` of each row's world; 0 until it is known."""
        self._unexamined = np.zeros(rows, bool)
        """For each row, whether the world begins with its placement and has not been examined yet."""
        self._n_added = 0
        self.order: Int[jax.Array, "queue world"]

    def add(self, jobs: Sequence[Job], rows: NDArray[np.intp], live: NDArray[np.bool_], sim: Simulation) -> None:
        """Add jobs to the queues, and remove ended worlds from the queues.

        Args:
            rows: number of the table row of each job.
            live: (row,) whether the world in each row has not ended.
        """
        self._queue[rows] = [self._queues.index(self._queue_of(job)) for job in jobs]
        self._cost[rows] = MEASURED.of_jobs_on_device(jobs, sim)
        self._turn[rows] = [
            -number if self._is_ahead(job) else 0 for number, job in enumerate(jobs, start=self._n_added + 1)
        ]
        self._n_added += len(jobs)
        self._unexamined[rows] = [job.start is None and not job.has_errors and job.edge_risk is None for job in jobs]
        self._risk[rows] = [job.edge_risk or EdgeRisk.INSIDE for job in jobs]
        self._rank(live)

    def examine(self, jobs: Sequence[Job], live: NDArray[np.bool_]) -> None:
        """Find out in which worlds loads act beyond or near edges. Worlds with the longest expected times are examined
        first, until the time ``EXAMINING_S`` is over. Worlds with loads beyond or near edges then begin earlier.

        Args:
            jobs: the job of each row.
            live: (row,) whether the world in each row has not ended.
        """
        rows = np.flatnonzero(self._unexamined & live)
        if not len(rows):
            return
        rows = rows[np.argsort(-self._cost[rows], kind="stable")]
        end = perf_counter() + EXAMINING_S
        for begin in range(0, len(rows), EXAMINED_AT_ONCE):
            some = rows[begin : begin + EXAMINED_AT_ONCE]
            self._risk[some] = edge_risks([jobs[row].scene for row in some.tolist()])
            self._unexamined[some] = False
            if perf_counter() >= end:
                break
        self._rank(live)

    def _rank(self, live: NDArray[np.bool_]) -> None:
        """Sort the live worlds, and write the order of each queue to the device."""
        ranked = np.lexsort((-self._cost, -self._risk, self._turn))
        ranked = ranked[live[ranked]]
        order = np.full((len(self._queues), len(live)), -1, np.int32)
        for queue in range(len(self._queues)):
            worlds = ranked[self._queue[ranked] == queue]
            order[queue, : len(worlds)] = worlds
        self.order = device_array(order)

    def _is_ahead(self, job: Job) -> bool:
        """Whether the world of a job comes before all worlds that begin with their placement."""
        return job.poses is not None or (self._depth_first and job.start is not None)
