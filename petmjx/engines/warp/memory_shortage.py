"""What mjx-warp does if the device's memory is short: it simulates with fewer blocks, or fewer worlds at a time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import is_out_of_memory
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool_choice import BlockPools
from petmjx.engines.warp.kernel_features import size_of
from petmjx.engines.warp.time_slices import Rollout
from petmjx.engines.warp.world_table import WorldTable
from petmjx.world.job import Job


class KeptRollouts:
    """The rollouts that an engine keeps for its next run. A rollout (``Rollout``) holds the buffers of a run on the
    device.

    Args:
        pools: object that chooses the block pools (the thread blocks) for the worlds of a table.
    """

    def __init__(self, pools: BlockPools) -> None:
        self._pools = pools
        self._kept: dict[tuple[Launch, ...], tuple[object, Rollout]] = {}
        """Launches (one for each block pool of a table) → the rollout that was last used with these launches, and the
        rollout's key. A later table uses the rollout again if the table's options, timetable and block pools equal the
        key."""

    def drop(self) -> None:
        """Free the device's memory that the kept rollouts hold, and keep none of them."""
        while self._kept:
            _, (_, rollout) = self._kept.popitem()
            rollout.close()

    def of(self, table: WorldTable, slice_ns: int) -> Rollout | None:
        """The rollout for the simulation of a table, with fewer blocks if memory is short. If not even ``MIN_BLOCKS``
        blocks fit in memory, the result is None; if the table has several block pools, the memory error is raised
        instead.

        Args:
            slice_ns: length of a time slice, ns.
        """
        run = table.run
        pools = self._pools.of(table)
        launches = tuple(pool.launch for pool in pools)
        key = run.sim, run.timetable, pools
        if launches in self._kept and self._kept[launches][0] == key:
            return self._kept[launches][1]
        if launches in self._kept:
            self._kept.pop(launches)[1].close()
        while True:
            try:
                rollout = Rollout(run, pools, slice_ns)
            except Exception as error:
                if not is_out_of_memory(error):
                    raise
                if not self._kept and any(pool.is_extra for pool in pools):
                    pools = tuple(pool for pool in pools if not pool.is_extra)
                elif not self._kept:
                    more, pools = pools, tuple(pool.halved() for pool in pools)
                    if pools == more:
                        if len(pools) > 1:
                            raise  # the caller then simulates each block size alone, which needs less memory
                        return None
                self.drop()  # rollouts of other sizes may hold the memory: try again without them
                lanes = sum(pool.lanes for pool in pools)
                run.progress.message = f"out of device memory: trying again with {lanes} worlds at once"
            else:
                self._kept[launches] = (key, rollout)
                return rollout


def smaller_parts(lost: Mapping[int, Job]) -> list[NDArray[np.int64]]:
    """Divide jobs into parts that are simulated one after another: by block size, or in half if all jobs have the same
    size. The worlds of these jobs were lost when memory ran out.

    Args:
        lost: stream number of a job (its number in the run's stream of jobs) → job.

    Returns:
        The stream numbers of the jobs of each part.
    """
    stream_numbers = np.array([*lost], int)
    sizes = np.array([size_of(job) for job in lost.values()])
    apart = [stream_numbers[sizes == size] for size in np.unique(sizes)]
    parts = apart if len(apart) > 1 else np.array_split(stream_numbers, 2)
    return [part for part in parts if len(part)]
