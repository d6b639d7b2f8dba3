"""Queues of worlds, one for each size, from which thread blocks take them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Int

from petmjx.engines.cost_model import MEASURED
from petmjx.engines.mjx.world_constants import device_array
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job


class Queues:
    """A queue for each size of worlds. Among worlds that are added together the longest come first, so that the last
    ones to end are short.

    Args:
        sizes: most boxes of a world of each size, in the order of the queues.
        size_of: gives the size of a job's world.
        rows: rows of the tables.
    """

    def __init__(self, sizes: Sequence[int], size_of: Callable[[Job], int], rows: int) -> None:
        self._sizes, self._size_of = sizes, size_of
        self._host = np.full((len(sizes), rows), -1, np.int32)
        self.order: Int[jax.Array, "queue world"] = device_array(self._host.copy())

    def add(self, jobs: Sequence[Job], first_row: int, sim: Simulation) -> None:
        """Append jobs to their queues. Their rows begin at ``first_row``."""
        sizes = np.array([self._size_of(job) for job in jobs])
        by_cost = np.argsort(-MEASURED.of_jobs_on_device(jobs, sim), kind="stable")
        for queue, size in enumerate(self._sizes):
            rows = first_row + by_cost[sizes[by_cost] == size]
            begin = np.count_nonzero(self._host[queue] >= 0)
            self._host[queue, begin : begin + len(rows)] = rows
        self.order = device_array(self._host.copy())
