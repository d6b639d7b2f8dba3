"""Queues of worlds, one for each size, from which thread blocks take them."""

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

    Args:
        sizes: most boxes of a world of each size, in the order of the queues.
        size_of: gives the size of a job's world.
        rows: rows of the table.
    """

    def __init__(self, sizes: Sequence[int], size_of: Callable[[Job], int], rows: int) -> None:
        self._sizes, self._size_of = sizes, size_of
        self._size, self._cost = np.zeros(rows, np.int64), np.zeros(rows)
        self.order: Int[jax.Array, "queue world"]

    def add(self, jobs: Sequence[Job], rows: NDArray[np.intp], live: NDArray[np.bool_], sim: Simulation) -> None:
        """Queue jobs, and take ended worlds out.

        Args:
            rows: the row of each job.
            live: (row,) whether its world has not ended.
        """
        self._size[rows] = [self._sizes.index(self._size_of(job)) for job in jobs]
        self._cost[rows] = MEASURED.of_jobs_on_device(jobs, sim)
        by_cost = np.argsort(-self._cost, kind="stable")
        by_cost = by_cost[live[by_cost]]
        order = np.full((len(self._sizes), len(live)), -1, np.int32)
        for queue in range(len(self._sizes)):
            of_size = by_cost[self._size[by_cost] == queue]
            order[queue, : len(of_size)] = of_size
        self.order = device_array(order)
