"""Which thread blocks the worlds of a group have, and how much room there is for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from petmjx.engines.warp.block_launch import FEW_BOXES, Launch
from petmjx.engines.warp.kernel_launcher import CONTACTS_PER_BOX, MORE_BOXES, PAIRS_PER_BOX, BlockPool
from petmjx.engines.warp.small_world_blocks import small_world_pool
from petmjx.engines.warp.tail_blocks import tail_pool
from petmjx.engines.warp.world_groups import MAX_GROWTH, Group, Run
from petmjx.options.physics import Cone
from petmjx.world.contact_laws import is_stiff


def most_room(size: int) -> int:
    """Boxes for which a world of a size may have contacts and pairs at most: the same in all runs, so that which
    worlds are given up does not depend on the largest plan of a run."""
    return MAX_GROWTH * (size + MORE_BOXES)


class BlockPools:
    """The fleets of an engine's groups. Where worlds overflow their buffers these grow, and stay so.

    Args:
        lanes: most worlds of a size at the same time; None: as many as the device has room for.
        blocks: of a launch.
    """

    def __init__(self, lanes: int | None, blocks: Callable[[Launch], int]) -> None:
        self._lanes, self._blocks = lanes, blocks
        self._growth: dict[tuple[Cone, int], int] = {}
        """How much larger than usual buffers have to be, by size of worlds."""

    def of(self, group: Group) -> tuple[BlockPool, ...]:
        """Those of a group: for the last worlds and for few boxes, if they are worth while, then by size, for the
        largest worlds first."""
        run = group.run
        fleets = tuple(self._of_size(run, size, group.boards) for size in run.needs.sizes)
        usual = self._growth_of(run, run.needs.sizes[-1]) == 1
        # not with larger buffers of all lanes, and not in stiff contacts: there a step takes five times as many
        # iterations, in some worlds many more, for which the others of their block would wait
        if usual and not is_stiff(run.sim.physics):
            worlds = int((np.asarray(group.table.placed)[: len(group.jobs)] <= FEW_BOXES.most_boxes).sum())
            few = small_world_pool(fleets[-1], worlds, self._lanes)
            fleets = (few, *fleets) if few else fleets
        last = tail_pool(fleets[-1], self._lanes)
        return (last, *fleets) if last else fleets

    def grow(self, run: Run, size: int) -> int | None:
        """Make the buffers for worlds of a size twice as large. Returns how much larger than usual they are now, or
        None where they already are as large as they may be."""
        if self._boxes_of_room(run, size) == most_room(size):
            return None
        growth = 2 * self._growth_of(run, size)
        self._growth[run.sim.physics.cone, size] = growth
        return growth

    def _growth_of(self, run: Run, size: int) -> int:
        return self._growth.get((run.sim.physics.cone, size), 1)

    def _boxes_of_room(self, run: Run, size: int) -> int:
        """Boxes for which a world of a size has contacts and pairs, as far as buffers have grown."""
        return min(self._growth_of(run, size) * (run.needs.widths[size] + MORE_BOXES), most_room(size))

    def _of_size(self, run: Run, size: int, boards: int) -> BlockPool:
        """Thread blocks for worlds of a size, as many as there can be, for carriers of so many shapes."""
        n_boxes = run.needs.widths[size]
        launch = Launch.here(n_boxes, run.needs.hands, run.needs.gives, run.needs.wraps)
        launch = replace(launch, lands=run.sim.physics.has_landings)
        shapes = self._boxes_of_room(run, size) + boards - 1
        return BlockPool(
            launch, self._blocks(launch), n_boxes, boards, PAIRS_PER_BOX * shapes, CONTACTS_PER_BOX * shapes
        )
