"""Queues of worlds, one for each size. Thread blocks take worlds from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

from petmjx.engines.cost_model import MEASURED
from petmjx.engines.mjx.world_constants import device_array
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job


class Queues:
    """A queue for each size of worlds. The longest worlds come first, so that the last worlds to end are short.

    Worlds that have completed a leg of a chain come before all others; among them, the world that was queued last comes
    first. So worlds complete their chains all the time, and the host makes their rows during the simulation. If length
    alone decided, the short last legs of all worlds would come at the end.

    Args:
        sizes: largest number of boxes of each size, in the order of the queues.
        size_of: function that returns the size of a job's world.
        rows: number of rows of the table.
        depth_first: whether all worlds that start from a state come first.
    """

    def __init__(
        self, sizes: Sequence[int], size_of: Callable[[Job], int], rows: int, *, depth_first: bool = False
    ) -> None:
        self._sizes, self._size_of, self._depth_first = sizes, size_of, depth_first
        self._size, self._cost = np.zeros(rows, np.int64), np.zeros(rows)
        self._turn = np.zeros(rows, np.int64)
        """0, or a negative number for worlds that come before all worlds with 0; smaller numbers come first."""
        self._n_added = 0
        self.order: Int[jax.Array, "queue world"]

    def add(self, jobs: Sequence[Job], rows: NDArray[np.intp], live: NDArray[np.bool_], sim: Simulation) -> None:
        """Queue jobs, and remove ended worlds from the queues.

        Args:
            rows: the row of each job.
            live: (row,) whether the row's world has not ended.
        """
        self._size[rows] = [self._sizes.index(self._size_of(job)) for job in jobs]
        self._cost[rows] = MEASURED.of_jobs_on_device(jobs, sim)
        self._turn[rows] = [
            -number if self._is_ahead(job) else 0 for number, job in enumerate(jobs, start=self._n_added + 1)
        ]
        self._n_added += len(jobs)
        ranked = np.lexsort((-self._cost, self._turn))
        ranked = ranked[live[ranked]]
        order = np.full((len(self._sizes), len(live)), -1, np.int32)
        for queue in range(len(self._sizes)):
            of_size = ranked[self._size[ranked] == queue]
            order[queue, : len(of_size)] = of_size
        self.order = device_array(order)

    def _is_ahead(self, job: Job) -> bool:
        """Whether a world takes precedence over worlds that begin with their placement."""
        return job.poses is not None or (self._depth_first and job.start is not None)
